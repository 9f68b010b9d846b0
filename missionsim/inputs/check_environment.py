"""Checks across the parts of an environment file."""

from __future__ import annotations

from missionsim.errors import Fault
from missionsim.inputs.checker import Checker
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.tree import Document

_ROUNDING = 1e-3
"""Lengths may be this much (relative) below the straight distance: maps are rounded."""


def check_environment(environment: EnvironmentSpec, document: Document) -> list[Fault]:
    """Edges join known places, are not loops, have a length that is possible."""
    check = Checker(document)
    places = check.raw_keys("places")
    for index, edge in enumerate(environment.edges):
        where: tuple[str | int, ...] = ("edges", index)
        known = check.known((*where, "from"), edge.from_, places, "place")
        known = check.known((*where, "to"), edge.to, places, "place") and known
        if not known:
            continue
        if check.touched("places", edge.from_) or check.touched("places", edge.to):
            continue
        if edge.from_ == edge.to:
            check.add((*where, "to"), "an edge from a place to itself", got=edge.to, allowed="another place")
            continue
        straight = environment.straight_m(edge.from_, edge.to)
        raw = check.document.node(where).children
        has_length = isinstance(raw, dict) and "length" in raw
        if straight is None and edge.length is None and not has_length:
            check.add(
                where,
                "edge without a length, and its places have no coordinates",
                got=f"{edge.from_} to {edge.to}",
                allowed="length: 16 m, or x and y for both places",
            )
        elif straight is not None and edge.length is None and straight == 0.0 and not has_length:
            check.add(
                where, "edge of length 0", got=f"{edge.from_} and {edge.to} at the same point", allowed="length: 16 m"
            )
        elif straight is not None and edge.length is not None and edge.length.value < straight * (1 - _ROUNDING):
            check.add(
                (*where, "length"),
                "shorter than the straight line between its places",
                got=f"{edge.length.value:g} m",
                allowed=f"at least {straight:.3f} m",
            )
    return check.faults
