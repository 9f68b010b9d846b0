"""Whether the routes of a plan remain the shortest ones when lengths of edges are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.mission import MissionSpec
from missionsim.plan.legs import Plan

Array = NDArray[np.float64]
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Edges:
    """An environment's edges in each direction of travel.

    Attributes
    ----------
    ends : tuple of (begin, end, index)
        Places as numbers, and the edge.
    lengths : tuple of (str, float)
        Of each edge: the name of its length among the draws, and its nominal length [m].
    routes : tuple of (begin, end, edges)
        Those that the plan takes.
    places : int
    """

    ends: tuple[tuple[int, int, int], ...]
    lengths: tuple[tuple[str, float], ...]
    routes: tuple[tuple[int, int, tuple[int, ...]], ...]
    places: int

    def others_shorter(self, draws: Mapping[str, Array], count: int) -> NDArray[np.bool_]:
        """Runs in which another way is shorter than a route of the plan, shape (count,) (Bellman 1958, Ford 1956)."""
        lengths = [draws.get(name, np.full(count, nominal)) for name, nominal in self.lengths]
        found = np.zeros(count, dtype=bool)
        for begin in dict.fromkeys(route[0] for route in self.routes):
            best = np.full((self.places, count), np.inf)
            best[begin] = 0.0
            for _ in range(self.places - 1):
                before = best.copy()
                for one, other, edge in self.ends:
                    np.minimum(best[other], best[one] + lengths[edge], out=best[other])
                if np.array_equal(before, best):
                    break
            for start, end, edges in self.routes:
                if start == begin:
                    found |= ~(best[end] >= sum(lengths[edge] for edge in edges) * (1.0 - _ROUNDING))
        return found


def drawn_edges(mission: MissionSpec, plan: Plan, names: frozenset[str]) -> Edges | None:
    """The edges, where draws may change which way is the shortest; None where they cannot.

    Parameters
    ----------
    mission : MissionSpec
    plan : Plan
    names : frozenset of str
        Uncertain values.
    """
    environment = mission.environment
    if environment is None or not plan.routes:
        return None
    places = {name: i for i, name in enumerate(environment.places)}
    lengths = []
    for edge in environment.edges:
        path = "" if edge.length is None else f"environment.{edge.length.path}"
        nominal = environment.length_m(edge) if edge.length is None else edge.length.value
        lengths.append((path, float("nan") if nominal is None else nominal))
    if not any(path in names for path, _ in lengths):
        return None
    ends = []
    for i, edge in enumerate(environment.edges):
        one, other = places[edge.from_], places[edge.to]
        ends += [(one, other, i), (other, one, i)] if edge.both_ways else [(one, other, i)]
    routes = tuple((places[begin], places[end], edges) for begin, end, edges in dict.fromkeys(plan.routes))
    return Edges(tuple(ends), tuple(lengths), routes, len(places))
