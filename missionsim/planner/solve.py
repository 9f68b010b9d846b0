"""From a task to its plan."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.task import TaskSpec
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import bounds_of
from missionsim.planner.core import Label, search
from missionsim.planner.drives import Drive
from missionsim.planner.tour import Site, Tour, make_site

Array = NDArray[np.float64]
Watch = Callable[[str, float, float], bool]
"""``(what is done, objective so far, bound) -> stop?``"""


class Fronts:
    """The undominated drives between stops, found when first asked for.

    Parameters
    ----------
    site : Site
    weights : ndarray, shape (1 + batteries,), optional
        With `gap`, see `missionsim.planner.drives.Drives.between`.
    gap : float
    """

    def __init__(self, site: Site, weights: Array | None = None, gap: float = math.inf) -> None:
        self.site, self.weights, self.gap = site, weights, gap
        self._found: dict[tuple[float, int], dict[int, list[Drive]]] = {}

    def __call__(self, payload_kg: float, stop: int, head: int) -> list[Drive]:
        site = self.site
        if site.stops[stop].place == site.stops[head].place:
            return [Drive(np.zeros(1 + len(site.physics.names)))]
        road = site.road(payload_kg)
        out, into = site.nodes[payload_kg]
        key = (payload_kg, int(out[stop]))
        if key not in self._found:
            most = None
            if site.task.within.deadline is not None:
                most = np.full(1 + len(site.physics.names), math.inf)
                most[0] = site.task.within.deadline.value
            self._found[key] = road.between(
                int(out[stop]), np.unique(into), weights=self.weights, gap=self.gap, most=most
            )
        return self._found[key].get(int(into[head]), [])


def solve(task: TaskSpec) -> Answer:
    """The best plan of a task, or an answer that says that there is none."""
    site = make_site(task)
    tour = Tour(site, Fronts(site))
    bounds = bounds_of(tour, [])
    outcome = search(tour, [Label(0 * tour.size, tour.start())], tour.is_goal, bounds)
    if outcome.label is None:
        return Answer(site, False)
    return answer_of(site, outcome.label, outcome.objective, outcome.bound)
