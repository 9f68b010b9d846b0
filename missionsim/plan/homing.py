"""The way home from where the robot is, for the reserve that a mission needs (Parasuraman 2012, Eqs. 11–13)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from missionsim.inputs.mission import MissionSpec
from missionsim.plan.legs import Leg, Limits, OnEdge, Step
from missionsim.plan.routes import Routes, Way, along
from missionsim.plan.steps import group


class Homing:
    """Ways to the dock of a mission.

    The dock is the policy's; without one the nearest place with a charger; without any charger the place where the
    mission starts. The way is the shortest by length, driven with the scheme, sensors, payload and speed of the last
    leg that drove (the defaults before the first), without stretch.

    Parameters
    ----------
    mission : MissionSpec
    limits : Limits
    routes : Routes or None
        None without an environment: then there is no way home.
    """

    def __init__(self, mission: MissionSpec, limits: Limits, routes: Routes | None) -> None:
        self.limits = limits
        self.routes = routes
        self.docks: tuple[str, ...] = ()
        self._found: dict[str, list[Way] | None] = {}
        if routes is None or mission.environment is None:
            return
        chargers = tuple(name for name, place in mission.environment.places.items() if place.charger is not None)
        start = (mission.start,) if mission.start else ()
        self.docks = (mission.policy.dock,) if mission.policy.dock else chargers or start

    def ways(self, place: str) -> list[Way] | None:
        """Shortest way from a place to a dock; None where there is none or the place is not known."""
        if self.routes is None or place not in self.routes.ways:
            return None
        if place not in self._found:
            found = [way for dock in self.docks if (way := self.routes.shortest(place, dock)) is not None]
            self._found[place] = min(found, key=_length, default=None)
        return self._found[place]

    def from_place(self, place: str, like: Leg) -> list[Leg] | None:
        """Legs home from a place, driven like a leg; [] at the dock, None where there is no way."""
        ways = self.ways(place)
        return None if ways is None else [_leg(like, way) for way in ways]

    def from_edge(self, leg: Leg, done_m: float, brake_m: float) -> list[Leg] | None:
        """Legs home from a point of an edge: on to its end or back, whichever is shorter in all.

        Parameters
        ----------
        leg : Leg
            Under way.
        done_m : float
            Metres driven on it so far.
        brake_m : float
            Metres that it takes to stop.
        """
        if leg.kind != "roll" or leg.edge is None or leg.distance_m <= 0.0:
            return self.from_place(leg.place, leg)
        edge = leg.edge
        here = min(edge.from_m + (edge.to_m - edge.from_m) * (done_m + brake_m) / leg.distance_m, edge.to_m)
        if self.routes is None:
            return None
        ways = [way for place in (edge.begin, edge.end) for way in self.routes.ways[place] if way.edge == edge.edge]
        options = [(way.end, way, way.length_m - here if way.end == edge.end else here) for way in ways]
        best: list[Leg] | None = None
        shortest = math.inf
        for place, way, metres in options:
            rest = self.ways(place)
            if rest is not None and metres + _length(rest) < shortest:
                shortest = metres + _length(rest)
                first = [_leg(leg, way)._replace(distance_m=metres)] if metres > 0.0 else []
                best = first + [_leg(leg, other) for other in rest]
        return best

    def detour(
        self, leg: Leg, done_m: float, brake_m: float, segment: int, driven: Leg | None
    ) -> tuple[list[Leg], tuple[Step, ...]] | None:
        """Legs and steps home for the engine, booked on a segment of their own; None where there is no way."""
        rolling = leg.kind == "roll"
        way = self.from_edge(leg, done_m, brake_m) if rolling else self.from_place(leg.place, driven or leg)
        if way is None:
            return None
        legs = [item._replace(settings=item.settings._replace(segment=segment)) for item in way]
        if not legs:
            still = leg.settings._replace(segment=segment)
            legs = [Leg("stand", still, place=leg.place)]
        legs[0] = legs[0]._replace(first=True)
        legs[-1] = legs[-1]._replace(last=True)
        return legs, group(legs, self.limits)

    def excursion(
        self, leg: Leg, done_m: float, brake_m: float, place: str, docks: Sequence[str]
    ) -> tuple[list[Leg], str, list[Leg], bool] | None:
        """The way to the nearest of some docks and back to where a leg begins or ends, whichever is shorter in all.

        Returns
        -------
        tuple or None
            Legs to the dock, the dock, legs back, and whether they lead to the end of the edge under way.
        """
        if self.routes is None:
            return None
        starts: list[tuple[str, list[Leg], bool]] = []
        if leg.kind == "roll" and leg.edge is not None and leg.distance_m > 0.0:
            edge = leg.edge
            here = min(edge.from_m + (edge.to_m - edge.from_m) * (done_m + brake_m) / leg.distance_m, edge.to_m)
            ways = [*self.routes.ways[edge.begin], *self.routes.ways[edge.end]]
            for way in (way for way in ways if way.edge == edge.edge):
                on = way.end == edge.end
                metres = way.length_m - here if on else here
                starts.append((way.end, [_leg(leg, way)._replace(distance_m=metres)] if metres > 0.0 else [], on))
        elif place:
            starts.append((place, [], False))
        best: tuple[list[Leg], str, list[Leg], bool] | None = None
        least = math.inf
        for begin, first, on in starts:
            for dock in docks:
                out, back = self.routes.shortest(begin, dock), self.routes.shortest(dock, begin)
                if out is None or back is None:
                    continue
                length = _length(out) + _length(back) + math.fsum(item.distance_m for item in first)
                if length < least:
                    least = length
                    best = [*first, *(_leg(leg, way) for way in out)], dock, [_leg(leg, way) for way in back], on
        return best


def last_driven(legs: Sequence[Leg]) -> list[Leg | None]:
    """Of each leg, itself or the last one before it that drives; before the first such, that one; None without any."""
    last = next((leg for leg in legs if leg.kind == "roll"), None)
    found: list[Leg | None] = []
    for leg in legs:
        last = leg if leg.kind == "roll" else last
        found.append(last)
    return found


def _leg(like: Leg, way: Way) -> Leg:
    speed = min(like.speed_m_s, way.max_speed_m_s)
    return Leg(
        "roll",
        along(like.settings, way),
        way.length_m,
        speed,
        instant=like.instant,
        place=way.end,
        edge=OnEdge(way.begin, way.end, way.edge, 0.0, way.length_m),
    )


def _length(ways: Sequence[Way]) -> float:
    return math.fsum(way.length_m for way in ways)
