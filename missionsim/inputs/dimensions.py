"""Dimensions of formulas: whether what a robot file calls a power is one, as far as the units in it tell."""

from __future__ import annotations

from collections.abc import Mapping

from missionsim.effects.base_terms import unit_named
from missionsim.expressions import Powers, UnlikeError, units_in
from missionsim.inputs.units import exponents

_BASE = ("m", "kg", "s", "A", "K")


def dimension_fault(formula: str, units: Mapping[str, str]) -> str:
    """What is wrong with the dimension of a formula that gives watts; empty where nothing is known to be.

    `units`: of its parameters, empty where the file gives none. A number in the formula may stand for something with a
    unit, and so may a parameter without one: of what they are multiplied with nothing is known.
    """
    known = {name: "" if unit == "1" else unit for name, unit in units.items()}  # 1: a number without one
    if not any(known.values()):
        return ""
    try:
        found = units_in(formula, lambda name: _powers(known[name] if name in known else unit_named(name)))
    except UnlikeError as problem:
        told = " and ".join(f"{text} in {_told(powers)}" for text, powers in problem.parts.items())
        return f"the formula adds or compares {told}"
    return "" if found is None or _told(found) == "W" else f"the formula gives {_told(found)}, no power"


def _powers(unit: str) -> Powers | None:
    powers = exponents(unit) if unit else None
    return None if powers is None else dict(zip(_BASE, powers, strict=True))


def _told(found: Powers) -> str:
    powers = tuple(found.get(name, 0.0) for name in _BASE)
    named = next((unit for unit in ("W", "J", "N", "m/s", "m/s^2", "V") if exponents(unit) == powers), "")
    bare = " ".join(n if p == 1 else f"{n}^{p:g}" for n, p in zip(_BASE, powers, strict=True) if p)
    return named or bare or "a plain number"
