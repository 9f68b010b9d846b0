"""Shortest ways through an environment, as edges in the direction of travel.

Importing networkx takes as long as a whole run, so the one thing that a run needs of it, the shortest path, is here.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import Parameter
from missionsim.physics import Bools
from missionsim.plan.legs import Settings, least

_ROUNDING = 1e-12
RADIO_PIECE_M = 2.0
"""Edges are cut to this length where the distance to an access point changes along them."""
Number = Callable[[Parameter], float]


@dataclass(frozen=True, slots=True)
class Way:
    """An edge in the direction of travel."""

    begin: str
    end: str
    """Both: places."""
    length_m: float
    slope_rad: float
    """Both: uphill positive in this direction."""
    surface: str
    max_speed_m_s: float
    """Infinite where the edge sets none."""
    heading_rad: float | None
    """Direction on the map where both places have coordinates."""
    extra: Mapping[str, float | str]
    """``temp_ambient_c``, ``access_point_distance_m`` and conditions where the edge gives them."""
    edge: int = 0
    """Which of the environment's edges."""
    search_m: float = 0.0
    """Length by which routes are found: that of the files where `length_m` is an array of draws."""


class Routes:
    """The ways of an environment and the shortest routes among them.

    `number`: value of a parameter of the environment (an uncertain one may be drawn).
    """

    def __init__(self, environment: EnvironmentSpec, number: Number) -> None:
        self.environment = environment
        self.ways: dict[str, list[Way]] = {name: [] for name in environment.places}
        self.drawn = False
        known: dict[int, tuple[Any, ...]] = {}
        for index, edge, begin, end in environment.open_ways():
            if index not in known:
                length = environment.length_m(edge) if edge.length is None else number(edge.length)
                if length is None:
                    message = "neither a length nor coordinates at both ends"
                    message = f"the edge from '{edge.from_}' to '{edge.to}' has {message}"
                    raise InputError.single(message, file=str(environment.path), allowed="length: 16 m")
                drawn = isinstance(length, np.ndarray)
                self.drawn |= drawn
                search = environment.length_m(edge) or 0.0 if drawn else length
                extra: dict[str, float | str] = {
                    name: number(value) if isinstance(value, Parameter) else value
                    for name, value in (
                        ("temp_ambient_c", edge.temperature),
                        ("access_point_distance_m", edge.access_point_distance),
                        *edge.conditions.items(),
                    )
                    if value is not None
                }
                fastest = math.inf if edge.max_speed is None else number(edge.max_speed)
                surface = edge.surface or environment.ambient.surface or ""
                known[index] = length, search, number(edge.slope), surface, fastest, extra
            length, search, slope, surface, fastest, extra = known[index]
            grade = slope if begin == edge.from_ else -slope
            a, b = (environment.places[name].position for name in (begin, end))
            heading = None if a is None or b is None or a == b else math.atan2(b[1] - a[1], b[0] - a[0])
            self.ways[begin].append(Way(begin, end, length, grade, surface, fastest, heading, extra, index, search))

    def away_from(self, way: Way, points: Sequence[tuple[float, float]]) -> list[tuple[float, float, float]]:
        """Pieces of a way and the distance [m] from each to the nearest point (its root mean square over the piece).
        Begin and end are parts of the way; none where the way's ends have no coordinates."""
        a, b = (self.environment.places[name].position for name in (way.begin, way.end))
        if a is None or b is None:
            return []
        count = max(1, math.ceil(way.search_m / RADIO_PIECE_M))
        span = math.hypot(b[0] - a[0], b[1] - a[1]) / count
        pieces: list[tuple[float, float, float]] = []
        for i in range(count):
            low, high = i / count, (i + 1) / count
            middle = 0.5 * (low + high)
            x, y = a[0] + (b[0] - a[0]) * middle, a[1] + (b[1] - a[1]) * middle
            square = functools.reduce(least, ((x - px) ** 2 + (y - py) ** 2 for px, py in points)) + span * span / 12.0
            pieces.append((low, high, square**0.5))
        return pieces

    def shortest(self, begin: str, end: str, cost: Callable[[Way], float] | None = None) -> list[Way] | None:
        """The ways of the route of least cost (Dijkstra 1959), by default of least length; None where there is none. A
        cost may be negative (downhill with recuperation) as long as no round trip gains anything."""
        best: dict[str, tuple[float, Way | None]] = {begin: (0.0, None)}
        queue = [(0.0, 0, begin)]
        count = 0
        while queue:
            length, _, here = heapq.heappop(queue)
            if here == end and cost is None:
                break
            if length > best[here][0]:
                continue
            for way in self.ways[here]:
                there = length + (way.search_m if cost is None else cost(way))
                known = best.get(way.end)
                if known is None or there < known[0] - (0.0 if cost is None else _ROUNDING * abs(known[0])):
                    best[way.end] = (there, way)
                    count += 1
                    heapq.heappush(queue, (there, count, way.end))
        if end not in best:
            return None
        route: list[Way] = []
        here = end
        while (way_here := best[here][1]) is not None:
            route.append(way_here)
            here = way_here.begin
        return route[::-1]

    def route(self, begin: str, end: str, where: str = "", cost: Callable[[Way], float] | None = None) -> list[Way]:
        """The route of least cost (see `shortest`), or a fault that names both places."""
        for place in (begin, end):
            if place not in self.ways:
                raise InputError.unknown(f"unknown place '{place}'", place, self.ways, file=where)
        found = self.shortest(begin, end, cost)
        if found is None:
            raise InputError.single(
                f"no way from '{begin}' to '{end}'", file=where, got=end, allowed="a place that the edges connect"
            )
        return found

    def along(self, here: str, name: str, where: str = "") -> Way:
        """The edge that a drive `along` names, by its other end or its own name; a fault where none leaves `here`."""
        found = self.environment.next_along(here, name)
        if found is None:
            told = f"no edge from '{here}' to '{name}'"
            raise InputError.single(
                told, file=where, got=name, allowed=", ".join(dict.fromkeys(way.end for way in self.ways.get(here, ())))
            )
        return next(way for way in self.ways[here] if way.edge == found[0])

    def others_shorter(self, routes: Iterable[tuple[str, str, tuple[int, ...]]]) -> Bools:
        """Runs in which another way is shorter than one of these routes, shape (runs,) (Bellman 1958, Ford 1956)."""
        lengths = {way.edge: way.length_m for ways in self.ways.values() for way in ways}
        count = next(np.size(length) for length in lengths.values() if isinstance(length, np.ndarray))
        found = np.zeros(count, dtype=bool)
        wanted = list(dict.fromkeys(routes))
        for begin in dict.fromkeys(route[0] for route in wanted):
            best = {name: np.full(count, 0.0 if name == begin else math.inf) for name in self.ways}
            for _ in self.ways:
                settled = True
                for way in itertools.chain.from_iterable(self.ways.values()):
                    there = best[way.begin] + way.length_m
                    if (there < best[way.end]).any():
                        best[way.end], settled = np.minimum(best[way.end], there), False
                if settled:
                    break
            for start, end, edges in wanted:
                if start == begin:
                    found |= ~(best[end] >= sum(lengths[edge] for edge in edges) * (1.0 - _ROUNDING))
        return found


def along(base: Settings, way: Way, surface: str | None = None) -> Settings:
    """Settings on a way: its slope, its surface unless the segment names one, the covariates that the edge gives."""
    extra = base.extra if not way.extra else tuple(sorted({**dict(base.extra), **way.extra}.items()))
    return base._replace(slope_rad=way.slope_rad, surface=surface or way.surface or base.surface, extra=extra)


def routes_of(mission: MissionSpec, numbers: Mapping[str, float]) -> Routes | None:
    """The routes through a mission's environment; found once where none of its numbers is drawn."""
    environment = mission.environment
    if environment is None:
        return None
    if any(name.startswith("environment.") for name in numbers):
        return Routes(environment, lambda p: numbers.get(f"environment.{p.path}", p.value) if p.path else p.value)
    return mission.remembered("routes", lambda: Routes(environment, lambda parameter: parameter.value))
