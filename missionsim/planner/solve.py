"""From a task to its plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.task import TaskSpec
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import bounds_of
from missionsim.planner.core import Label, Outcome, search
from missionsim.planner.drives import Drive
from missionsim.planner.dual import Prices, best_prices
from missionsim.planner.large import solve_large
from missionsim.planner.orders import MOST_FREE
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
            if math.isfinite(site.deadline_s):
                most = np.full(1 + len(site.physics.names), math.inf)
                most[0] = site.deadline_s
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
    return solve_site(make_site(task), watch)


def solve_site(site: Site, watch: Watch | None = None) -> Answer:
    """The best plan of a site; where visits may be left out, first as much value as can be."""
    if site.order.sequence is None and len(site.task.visits) > MOST_FREE:
        return solve_large(site, lambda one: solve_site(one, watch))
    values = np.array([visit.value or 0.0 for visit in site.task.visits])
    if not any(visit.value is not None for visit in site.task.visits):
        return _solve(site, None, math.inf, watch)
    first = _solve(replace(site, weights=np.zeros_like(site.weights)), values, math.inf, watch, by_value=True)
    if not first.feasible:
        return first
    return _solve(site, values, first.objective, watch)


def _solve(
    site: Site, missed: Array | None, most_missed: float, watch: Watch | None, *, by_value: bool = False
) -> Answer:
    """The plan of least objective, or (`by_value`) the one that leaves out least value."""
    tour = Tour(site, Fronts(site), missed, by_value=by_value)
    prices = Prices(np.zeros(len(site.weights)), 0.0) if by_value else best_prices(tour)
    if prices.impossible:
        return Answer(site, False)
    best, objective = prices.plan, prices.objective
    bound = prices.bound
    scale = max(abs(bound), 1e-6)
    if best is not None and objective - bound <= PROVED * scale:
        return answer_of(tour, best, objective, objective)
    gap = math.inf if by_value else min(objective - bound, FIRST_GAP * scale)
    stopped = False
    bounds = bounds_of(tour, [] if by_value else [prices.best, *prices.others])
    if missed is not None:
        bounds.most[-1] = most_missed
    while not stopped:
        gap = max(gap, 1e-9 * scale)
        tour = Tour(site, Fronts(site, site.weights + prices.best, gap), missed, by_value=by_value)

        def told(outcome: Outcome, waiting: int, low: float = bound, high: float = prices.bound + gap) -> bool:
            nonlocal stopped
            if watch is not None:
                stopped = watch("search", outcome.objective, min(max(outcome.bound, low), high))
            return stopped

        try:
            outcome = search(tour, [Label(0, tour.start())], tour.is_goal, bounds, best=objective, watch=told)
        except KeyboardInterrupt:
            stopped = True
            break
        stopped = stopped or outcome.interrupted
        if outcome.label is not None:
            best, objective = outcome.label, outcome.objective
        bound = max(bound, min(outcome.bound, prices.bound + gap))
        if objective <= prices.bound + gap or math.isinf(gap):
            break
        gap = min(max(4.0 * gap, 1e-6), objective - prices.bound)
        if gap > MOST_GAP * scale:
            gap = math.inf
    if best is None:
        early = "the search was stopped before it found a plan; there may be one"
        return Answer(site, False, notes=[early] if stopped else [])
    return answer_of(tour, best, objective, bound)
