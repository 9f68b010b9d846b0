"""From a task to its plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from missionsim.physics import Array
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import best_prices, bounds_of, in_time, prices_ahead, slack_of
from missionsim.planner.chains import within
from missionsim.planner.core import Label, Outcome, quick, search
from missionsim.planner.large import MORE_VALUE, solve_large
from missionsim.planner.site import MOST_FREE, Order, Site
from missionsim.planner.tour import Fronts, Tour

Watch = Callable[[str, float, float], bool]
"""``(what is done, objective so far, bound) -> stop?``"""

MOST_LABELS = 4_500
FEW_LABELS = 400
"""Both: after which a search that has a plan gives up its proof; the second where that is to follow."""
WIDE = 0.03
"""Gap with which half of them are enough: more would not close it."""
MOST_GAP = 300.0
"""Drives whose price is not within so much of the first gap are tried all together."""
PROVED = 1e-10
"""A plan whose objective is within this of the bound (relative) is the best."""
SAME = 1e-10
"""Sums of values that differ by less (relative to all) are the same."""
STEP = 8.0
"""By which that grows."""
FIRST_GAP = 0.002
"""Drives whose price is within this (relative to the bound) of the cheapest are tried first."""


def solve_site(site: Site, watch: Watch | None = None, *, valued: bool = True, labels: int = MOST_LABELS) -> Answer:
    """The best plan of a site; where visits may be left out, first (if `valued`) as much value as can be. `labels`:
    after so many a search that has a plan gives up its proof."""
    if site.order.sequence is None and len(site.task.visits) > MOST_FREE:
        return solve_large(site, lambda one: solve_site(one, watch, labels=labels))
    _solve = partial(_search, watch=watch, labels=labels)
    if not valued or not any(visit.value is not None for visit in site.task.visits):
        return _solve(site, Tour)
    values = np.array([visit.value or 0.0 for visit in site.task.visits])
    needed = tuple(v.model_copy(update={"value": None}) if v.value else v for v in site.task.visits)
    whole = site.task.model_copy(update={"visits": needed})
    every = _solve(replace(site, task=whole, order=Order(whole, site.order.sequence)), Tour, soon=True)
    if every.feasible or every.stopped:
        return replace(every, site=site)
    first = replace(site, weights=np.zeros_like(site.weights))
    most = _solve(first, partial(Tour, values=values, by_value=True))
    if not most.feasible:
        return most
    missed = most.objective + 1e-9 * float(values.sum())
    best = _solve(site, partial(Tour, values=values, most_missed=missed))
    if not best.feasible:
        use = np.array([most.duration_s, *most.energy_wh.values()])
        best = replace(most, site=site, objective=float(use @ site.weights), bound=0.0)
    if most.objective - most.bound > 1e-9 * float(values.sum()):
        best.extra["assumed"] = [*best.extra.get("assumed", ()), MORE_VALUE]
    return best


def _search(
    site: Site, network: Callable[..., Tour], watch: Watch | None, labels: int, *, soon: bool = False
) -> Answer:
    """The plan of least objective of a network of stops, whose drives are still to be chosen. `soon`: none unless one
    is found among few drives."""
    tour = network(site, Fronts(site))
    prices = best_prices(tour)
    ends = in_time(site)
    if prices.impossible or not len(ends):
        return Answer(site, False)
    best, objective = prices.plan, prices.objective
    sums = np.zeros(1)  # what may be left out in all, where value is the objective and few visits have one; rising
    if tour.by_value and tour.values is not None and np.count_nonzero(tour.values) <= MOST_FREE:
        for value in tour.values[tour.values > 0.0]:
            sums = np.unique(np.concatenate([sums, sums + value]))
    else:
        sums = np.zeros(0)
    bound = _up(sums, prices.bound)
    if tour.by_value and tour.values is not None:
        bound = max(bound, float(site.order.left(tour.values)[ends].min()))
    scale = max(abs(bound), 1e-6)
    if best is not None and objective - bound <= PROVED * scale:
        return answer_of(tour, best, objective, objective)
    if not (site.timeless or site.weights[0] or prices.best[0] or site.windowed):
        # where the best plan of all takes no longer than it may, nothing is to be chosen for its time
        free = _search(replace(site, deadline_s=math.inf, timeless=True), network, watch, labels, soon=soon)
        if free.duration_s <= site.deadline_s * (1.0 + PROVED) if free.feasible else not free.stopped:
            return replace(free, site=site)
        bound = max(bound, free.bound)
    # what the search leaves out keeps its bound from counting: it may only find a better plan
    vain = bool(charges_tried(tour))
    stopped, base, more = False, prices.bound, [prices.best, *prices.others]
    weights, slack = tour.priced(prices.best)[0], slack_of(tour, prices.best)[0]
    # where only value counts, all drives are as cheap: soon a plan by few of them, then all
    first = [] if weights.any() else [Fronts(site, weights, None)]
    if any(charger is not None for charger in tour.chargers):
        alone = best_prices(tour, charging=False)
        if alone.plan is not None and alone.objective < objective:
            best, objective = alone.plan, alone.objective
        rows = np.eye(len(tour.left))[1 : 1 + len(site.physics.names)]
        # what high prices on the charge of each battery say where it is nearly too little
        steep = [share * tour.unit * row for row in rows for share in (0.3, 1.0, 4.0)]
        bounds = bounds_of(tour, more, [alone.best, *alone.others, *steep], prices_ahead(tour, prices.best))
        first = [Fronts(site, weights, None)]
    else:
        bounds = bounds_of(tour, more)
    start = Label(0, tour.first[None, :])
    if not len(within(start.points, bounds.room[0])):
        return Answer(site, False)
    bound = sure = max(bound, _up(sums, float(bounds.of(0, start.points[:, None])[0])))
    gap = min(objective - base, FIRST_GAP * scale) if weights.any() else math.inf
    while True:
        gap = max(gap, 1e-9 * scale)
        drives = first.pop() if first else Fronts(site, weights, gap, slack)
        exact = drives.gap is not None
        tour = network(site, drives)
        tired = False

        def told(
            outcome: Outcome, waiting: int, low: float = bound, high: float = base + gap, proves: bool = exact
        ) -> bool:
            nonlocal tired
            wide = outcome.objective - max(outcome.bound, low) > WIDE * abs(outcome.objective)
            most = labels // 4 if vain else labels // 2 if wide and proves else labels
            tired = (soon or math.isfinite(outcome.objective)) and outcome.labels > most
            return tired or (
                watch is not None and watch("search", outcome.objective, min(max(outcome.bound, low), high))
            )

        for way in (quick, search):
            try:
                outcome = way(tour, [start], tour.is_goal, bounds, best=_below(sums, objective), watch=told)
            except KeyboardInterrupt:
                outcome = Outcome(interrupted=True)
            if outcome.label is not None:
                best, objective = outcome.label, outcome.objective
            if exact and drives.complete:
                bound = max(bound, _up(sums, min(outcome.bound, base + gap)))
            stopped = outcome.interrupted and not tired
            if outcome.interrupted or (best is not None and not drives.complete):
                break
        needed = _below(sums, objective) - base
        if objective <= bound:
            break
        if (
            stopped
            or (soon and best is None)
            or (vain and best is not None and labels < MOST_LABELS)
            or (exact and (tired or needed <= gap or math.isinf(gap) or (best and not drives.complete)))
        ):
            break
        gap = min(STEP * (gap if exact or math.isinf(needed) else FIRST_GAP * scale), needed)
        if gap > MOST_GAP * FIRST_GAP * scale:
            gap = math.inf
    if best is None:
        early = "the search was stopped before it found a plan; there may be one"
        missed = "no plan was found with the drives between stops that were tried; there may be one"
        notes = [early] if stopped else [] if drives.complete else [missed]
        return Answer(site, False, notes=notes, stopped=stopped)
    assumed = charges_tried(tour) if objective - sure > PROVED * scale else []
    answer = replace(answer_of(tour, best, objective, sure if assumed else bound), stopped=stopped)
    answer.extra["assumed"] = assumed
    return answer


def charges_tried(tour: Tour) -> list[str]:
    """What a search leaves out of the charges: of two batteries, a point between is found for the last charge only.

    Where all docks charge alike and nothing waits, no plan is lost by that: what an earlier dock gives on top of what
    leads to the next, that one gives at a lower level and so no slower.
    """
    alike = [(charger.gain_w.tolist(), charger.tapers) for charger in tour.chargers if charger is not None]
    some = len(tour.site.physics.names) > 1 and any(c is not None and c.levels is None for c in tour.chargers)
    lost = some and (tour.latest > 0.0 or any(one != alike[0] for one in alike))
    return ["of several charges in one mission only the last was tried to any level"] if lost else []


def _up(sums: Array, bound: float) -> float:
    """A bound, raised to what may come up."""
    return next((total for total in sums.tolist() if total >= bound - SAME * sums[-1]), bound)


def _below(sums: Array, objective: float) -> float:
    """The objective below which a plan would be better than one that is known."""
    if not len(sums) or math.isinf(objective):
        return objective
    lower = sums[sums < objective - 2 * SAME * sums[-1]]
    return float(lower[-1]) + 2 * SAME * float(sums[-1]) if len(lower) else 0.0
