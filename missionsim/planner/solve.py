"""From a task to its plan."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.task import TaskSpec
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import bounds_of
from missionsim.planner.core import Label, Outcome, search
from missionsim.planner.drives import Drive
from missionsim.planner.dual import Prices, best_prices
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


MOST_GAP = 1e3
PROVED = 1e-10
"""A plan whose objective is within this of the bound (relative) is the best."""
FIRST_GAP = 0.002
"""Drives whose price is within this (relative to the bound) of the cheapest are tried first."""


def solve(task: TaskSpec, watch: Watch | None = None) -> Answer:
    """The best plan of a task, or an answer that says that there is none.

    Parameters
    ----------
    task : TaskSpec
    watch : callable, optional
        Told of the progress; stops the search where it returns True.
    """
    site = make_site(task)
    prices = best_prices(Tour(site, Fronts(site)))
    if prices.impossible:
        return Answer(site, False)
    return _search(site, prices, watch)


def _search(site: Site, prices: Prices, watch: Watch | None) -> Answer:
    """Labels over drives that are near the cheapest in price, more of them until the best plan is proved."""
    best, objective = prices.plan, prices.objective
    bound = prices.bound
    scale = max(abs(bound), 1e-6)
    gap = min(objective - bound, FIRST_GAP * scale)
    stopped = False
    if best is not None and objective - bound <= PROVED * scale:
        return answer_of(site, best, objective, objective)
    bounds = bounds_of(Tour(site, Fronts(site)), [prices.best, *prices.others])
    while not stopped:
        gap = max(gap, 1e-9 * scale)
        tour = Tour(site, Fronts(site, site.weights + prices.best, gap))

        def told(outcome: Outcome, waiting: int, low: float = bound, high: float = prices.bound + gap) -> bool:
            nonlocal stopped
            if watch is not None:
                stopped = watch("search", outcome.objective, min(max(outcome.bound, low), high))
            return stopped

        try:
            outcome = search(tour, [Label(0, tour.start())], tour.is_goal, bounds, best=objective, watch=told)
        except KeyboardInterrupt:
            break
        if outcome.label is not None:
            best, objective = outcome.label, outcome.objective
        bound = max(bound, min(outcome.bound, prices.bound + gap))
        if objective <= prices.bound + gap or math.isinf(gap):
            break
        gap = min(max(4.0 * gap, 1e-6), objective - prices.bound)
        if gap > MOST_GAP * scale:
            gap = math.inf
    if best is None:
        return Answer(site, False)
    return answer_of(site, best, objective, bound)
