"""The environment file: places, ways between them, chargers, ambient."""

from __future__ import annotations

import functools
import math
from collections.abc import Container, Iterator
from typing import Annotated, Literal

from pydantic import Field

from missionsim.errors import Fault
from missionsim.files import grouped
from missionsim.inputs import values
from missionsim.inputs.base import DescribedFile, Identifier, Model, Name, Text, wrong
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.tree import Where
from missionsim.inputs.validation import Checker

_ROUNDING = 1e-3
"""Lengths may be this much (relative) below the straight distance: maps are rounded."""


class ChargerSpec(Model):
    """Charger at a place: power delivered to each battery that charges, and how many robots at once."""

    power: values.Power
    batteries: tuple[Identifier, ...] = ()
    slots: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 1


class PlaceSpec(Model):
    """A named place; coordinates may be left out where every edge has a length. No way leads to a closed one."""

    x: values.Coordinate | None = None
    y: values.Coordinate | None = None
    heading: values.Angle | None = None
    charger: ChargerSpec | None = None
    closed: bool = False
    title: Text = ""

    def _check(self) -> None:
        if (self.x is None) != (self.y is None):
            raise wrong("a place has both coordinates or none", "x" if self.x else "y", "x: 0 m, y: 0 m")

    @property
    def position(self) -> tuple[float, float] | None:
        """Coordinates, m."""
        return None if self.x is None or self.y is None else (self.x.value, self.y.value)


class EdgeSpec(Model):
    """A way between two places; slope uphill positive from `from` to `to`. A closed one is not driven."""

    name: Name | None = None
    from_: Name = Field(alias="from")
    to: Name
    length: values.Distance | None = None
    slope: values.Slope = Parameter(0.0, unit="rad")
    surface: Name | None = None
    both_ways: bool = True
    closed: bool = False
    max_speed: values.Speed | None = None
    temperature: values.Temperature | None = None
    access_point_distance: values.Length | None = None
    conditions: dict[Identifier, values.Condition] = Field(default_factory=dict)


class AmbientSpec(Model):
    """What holds everywhere unless an edge or a segment says otherwise."""

    temperature: values.Temperature | None = None
    surface: Name | None = None
    access_point_distance: values.Length | None = None
    conditions: dict[Identifier, values.Condition] = Field(default_factory=dict)


class AccessPointSpec(Model):
    """Radio access point."""

    x: values.Coordinate
    y: values.Coordinate


class EnvironmentSpec(DescribedFile):
    """An environment file."""

    kind: Literal["environment"]
    places: Annotated[dict[Name, PlaceSpec], Field(min_length=1, max_length=20_000)]
    edges: Annotated[tuple[EdgeSpec, ...], Field(max_length=50_000)] = ()
    ambient: AmbientSpec = AmbientSpec.model_construct()
    access_points: dict[Name, AccessPointSpec] = Field(default_factory=dict)

    def length_m(self, edge: EdgeSpec) -> float | None:
        """Length of an edge, m: as given, else the straight distance; None where neither is known."""
        if edge.length is not None:
            return edge.length.value
        return self.straight_m(edge.from_, edge.to)

    def next_along(self, here: str, name: str) -> tuple[int, str] | None:
        """The edge that `along` names at a place: its index and where it leads.

        `name` is the place at its other end, or the edge's own name. Of parallel edges to a place, the shortest; the
        others are driven by their names. None where no such edge leaves `here`.
        """
        to_place: list[tuple[float, int]] = []
        by_name: tuple[int, str] | None = None
        for index, edge, _, end in self._open_from.get(here, ()):
            if end == name:
                to_place.append((self.length_m(edge) or 0.0, index))
            if edge.name == name and by_name is None:
                by_name = index, end
        return (min(to_place)[1], name) if to_place else by_name

    @functools.cached_property
    def _open_from(self) -> dict[str, list[tuple[int, EdgeSpec, str, str]]]:
        return grouped(self.open_ways(), lambda way: way[2])

    def open_ways(self) -> Iterator[tuple[int, EdgeSpec, str, str]]:
        """Every way that may be driven: the edge's index, the edge, begin and end in the direction of travel."""
        closed = {name for name, place in self.places.items() if place.closed}
        for index, edge in enumerate(self.edges):
            if edge.closed:
                continue
            if edge.to not in closed:
                yield index, edge, edge.from_, edge.to
            if edge.both_ways and edge.from_ not in closed:
                yield index, edge, edge.to, edge.from_

    def straight_m(self, first: str, second: str) -> float | None:
        """Straight distance between two places, m."""
        ends = [self.places[name].position if name in self.places else None for name in (first, second)]
        if ends[0] is None or ends[1] is None:
            return None
        return math.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1])

    @property
    def chargers(self) -> tuple[str, ...]:
        """Places with a charger."""
        return tuple(name for name, place in self.places.items() if place.charger is not None)

    def charging(self, battery: str) -> tuple[str, ...]:
        """Places with a charger that serves a battery; one that names none serves all."""
        found = ((name, place.charger) for name, place in self.places.items() if place.charger is not None)
        return tuple(name for name, charger in found if not charger.batteries or battery in charger.batteries)

    def reached(self, start: str, shut: Container[str | None] = (), *, against: bool = False) -> set[str]:
        """Places that open ways lead to from a place; `against` their direction, the places that lead to it. Edges
        whose names are in `shut` are left out."""
        ways: dict[str, set[str]] = {}
        for _, edge, begin, end in self.open_ways():
            if edge.name not in shut:
                begin, end = (end, begin) if against else (begin, end)
                ways.setdefault(begin, set()).add(end)
        found, waiting = {start}, [start]
        while waiting:
            new = ways.get(waiting.pop(), set()) - found
            found |= new
            waiting += new
        return found

    def opened(self, name: str | None = None) -> EnvironmentSpec:
        """The environment with all that is closed open, or with the edge or place of that name open."""
        edges = tuple(e.model_copy(update={"closed": False}) if name in (None, e.name) else e for e in self.edges)
        places = {
            key: place.model_copy(update={"closed": False}) if name in (None, key) else place
            for key, place in self.places.items()
        }
        made = self.model_copy(update={"edges": edges, "places": places})
        made.__dict__.pop("_open_from", None)
        return made

    def faults(self) -> list[Fault]:
        """Edges join known places, are not loops, have a length that is possible."""
        check = Checker(self.document)
        places = self.document.names("places")
        for index, edge in enumerate(self.edges):
            where: Where = ("edges", index)
            ends = {"from": edge.from_, "to": edge.to}
            known = [check.known((*where, key), name, places, "place") for key, name in ends.items()]
            if not all(known) or any(self.document.is_faulty(("places", name), below=True) for name in ends.values()):
                continue
            if edge.from_ == edge.to:
                check.add((*where, "to"), "an edge from a place to itself", edge.to, "another place")
                continue
            straight = self.straight_m(edge.from_, edge.to)
            written = self.document.node(where).children
            given = isinstance(written, dict) and "length" in written  # perhaps with a value that is at fault
            if edge.length is not None:
                if straight is not None and edge.length.value < straight * (1 - _ROUNDING):
                    message, allowed = "shorter than the straight line between its places", f"at least {straight:.3f} m"
                    check.add((*where, "length"), message, f"{edge.length.value:g} m", allowed)
            elif straight is None and not given:
                message = "edge without a length, and its places have no coordinates"
                check.add(where, message, f"{edge.from_} to {edge.to}", "length: 16 m, or x and y for both places")
            elif straight == 0.0 and not given:
                got = f"{edge.from_} and {edge.to} at the same point"
                check.add(where, "edge of length 0", got, "length: 16 m")
        return check.faults
