"""From a task to its plan; of many visits in any order that of a good order, with a bound on all orders."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from missionsim.inputs.check_task import earlier_of
from missionsim.physics import Array, Ints
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import best_prices, bounds_of, in_time, matrix, prices_ahead, slack_of
from missionsim.planner.chains import within
from missionsim.planner.core import Label, Outcome, quick, search
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
SAME = 1e-10
"""A plan whose objective is within this of the bound (relative) is the best, and sums of values that differ by less
(relative to all) are the same."""
STEP = 8.0
"""By which that grows."""
FIRST_GAP = 0.002
"""Drives whose price is within this (relative to the bound) of the cheapest are tried first."""


def solve_site(site: Site, watch: Watch | None = None, *, valued: bool = True, labels: int = MOST_LABELS) -> Answer:
    """The best plan of a site; where visits may be left out, first (if `valued`) as much value as can be. `labels`:
    after so many a search that has a plan gives up its proof."""
    if site.order.sequence is None and len(site.task.visits) > MOST_FREE:
        return solve_large(site, watch, labels)
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
    if best is not None and objective - bound <= SAME * scale:
        return answer_of(tour, best, objective, objective)
    if not (site.timeless or site.weights[0] or prices.best[0] or site.windowed):
        # where the best plan of all takes no longer than it may, nothing is to be chosen for its time
        free = _search(replace(site, deadline_s=math.inf, timeless=True), network, watch, labels, soon=soon)
        if free.duration_s <= site.deadline_s * (1.0 + SAME) if free.feasible else not free.stopped:
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
    assumed = charges_tried(tour) if objective - sure > SAME * scale else []
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


STARTS = 4
MOST_LOADS = 40
"""Loads up to which the least that a drive takes under any of them is known."""
MORE_VALUE = "more value may be possible"
CUTS = 25
"""Rounds of cuts after which the bound is what it is."""
LATE = 1e3
"""What a second after the end of a window counts, relative to a second of the whole drive."""


def solve_large(site: Site, watch: Watch | None = None, labels: int = MOST_LABELS) -> Answer:
    """The plan of an order that local search finds (moves of up to three visits, reversals; Or 1976, Croes 1958)."""
    found = orders(site, matrix(site, site.order.load_kg, site.weights))
    best = Answer(site, False)
    valued = any(visit.value is not None for visit in site.task.visits)
    for order in found:
        answer = solve_site(replace(site, order=Order(site.task, order)), watch, labels=labels)
        if answer.feasible and (not best.feasible or (-answer.value, answer.objective) < (-best.value, best.objective)):
            best = answer
        if answer.stopped or (best.feasible and not valued):
            break
    if not best.feasible:
        return Answer(site, False, notes=[f"no plan in the {len(found)} orders that were tried of {len(order)} visits"])
    bound, most = _bound(site, best.value)
    best.bound = min(best.objective, bound)
    assumed = [text for text in best.extra.get("assumed", ()) if text != MORE_VALUE]
    best.extra["assumed"] = [*assumed, "the order was found by a heuristic"]
    if valued:
        best.extra["value_at_most"] = max(best.value, most)
        if most > best.value * (1.0 + 1e-9) + 1e-9:
            best.extra["assumed"].append(MORE_VALUE)
    return best


def _bound(site: Site, made: float) -> tuple[float, float]:
    """Below which the objective of no plan is that makes as much value, and the most value that there is.

    A linear program: each stop that is made is left and entered once, each drive takes its least under any load, what
    is limited and cannot be charged suffices, and no set of stops is left by less than its stop that is made most
    (Dantzig, Fulkerson and Johnson 1954; Fischetti, Salazar and Toth 1998 where stops may be left out), with the sets
    that a minimal cut finds violated.
    """
    visits = site.task.visits
    values = np.array([visit.value or 0.0 for visit in visits])
    found = {round(site.order.load_kg, 9)}  # all loads that some visits together may lead to
    limit = math.inf if site.task.most_kg is None else site.task.most_kg * (1.0 + 1e-12)
    for visit in visits:
        found |= {round(load + visit.load_kg, 9) for load in found}
        if len(found) > MOST_LOADS**2:
            return -math.inf, float(values.sum())
    loads = sorted(load for load in found if 0.0 <= load <= limit)
    if len(loads) > MOST_LOADS:
        return -math.inf, float(values.sum())
    count = len(visits)

    def least(weights: Array) -> tuple[Array, Array]:
        """Of drives between stops and of what is done at visits."""
        apart = np.min([matrix(site, load, weights)[: count + 2, : count + 2] for load in loads], axis=0)
        stands = [min((site.standing(1 + i, load) @ weights).min() for load in loads) for i in range(count)]
        return apart, np.array(stands)

    finite = np.isfinite(least(site.weights)[0])
    ends = [(i, j) for i in range(count + 1) for j in range(1, count + 2) if i != j and finite[i, j]]
    arcs = np.array(ends).T

    def row(weights: Array) -> Array:
        apart, stands = least(weights)
        return np.append(apart[arcs[0], arcs[1]], stands)

    # what is limited: time, and the charge of batteries that no dock serves; each, and all together
    physics = site.physics
    limits = np.array([site.deadline_s, *(physics.initial_wh - physics.reserve_wh)])
    for stop in site.stops:
        if stop.charger is not None:
            limits[1:][stop.charger.gain_w > 0.0] = math.inf
    kept = np.flatnonzero(np.isfinite(limits) & (limits > 0.0))
    scaled = [np.eye(len(limits))[r] / limits[r] for r in kept]
    rows = [row(weights) for weights in (*scaled, sum(scaled, np.zeros(len(limits))))]
    sides = [1.0] * len(kept) + [float(len(kept))]
    needed = [0.0 if visit.value is not None else 1.0 for visit in visits]
    value = np.append(np.zeros(arcs.shape[1]), -values)
    most, rows, sides = _cut(arcs, value, rows, sides, needed) if values.any() else (0.0, rows, sides)
    bound = _cut(arcs, row(site.weights), [*rows, value], [*sides, -made * (1.0 - 1e-12)], needed)[0]
    return bound, -most if math.isfinite(most) else float(values.sum())


def _cut(
    arcs: Ints, cost: Array, rows: list[Array], sides: list[float], needed: list[float]
) -> tuple[float, list[Array], list[float]]:
    """The least cost of drives (one variable for each of the arcs) and visits, and the rows with the cuts found."""
    import networkx as nx
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    (tails, heads), drives, count = arcs, arcs.shape[1], len(needed)
    number, visit = np.arange(drives), np.arange(count)
    # 0 … count are left, count + 1 … 2 · count + 1 entered: the start and the end once, a visit as much as it is made
    places = np.concatenate([tails, count + heads, 1 + visit, count + 1 + visit])
    columns = np.concatenate([number, number, drives + visit, drives + visit])
    entries = np.concatenate([np.ones(2 * drives), -np.ones(2 * count)])
    degrees = coo_array((entries, (places, columns)), shape=(2 * count + 2, drives + count)).tocsr()
    once = np.isin(np.arange(2 * count + 2), [0, 2 * count + 1]).astype(float)
    rows, sides, bound = list(rows), list(sides), -math.inf
    for _ in range(CUTS):
        b_ub = np.array(sides) * (1.0 + np.sign(sides) * 1e-9)
        bounds = [*((0.0, 1.0) for _ in number), *((low, 1.0) for low in needed)]
        found = linprog(cost, A_eq=degrees, b_eq=once, A_ub=np.array(rows), b_ub=b_ub, bounds=bounds, method="highs")
        if not found.success:
            break
        bound = float(found.fun)
        graph = nx.DiGraph()
        for i in np.flatnonzero(found.x[:drives] > 1e-9).tolist():
            graph.add_edge(int(tails[i]), int(heads[i]), capacity=float(found.x[i]))
        new: dict[frozenset[int], int] = {}
        for stop in np.flatnonzero(found.x[drives:] > 1e-6).tolist():
            value, (side, _) = nx.minimum_cut(graph, 1 + stop, count + 1)
            if value < found.x[drives + stop] - 1e-6:
                new.setdefault(frozenset(side), stop)
        if not new:
            break
        for side, stop in new.items():
            inside = np.isin(arcs, list(side))
            rows.append(np.append(-(inside[0] & ~inside[1]).astype(float), (visit == stop).astype(float)))
            sides.append(0.0)
    return bound, rows, sides


def orders(site: Site, apart: Array) -> list[tuple[int, ...]]:
    """Orders that keep to before and after, the best first."""
    visits = site.task.visits
    fast = matrix(site, site.order.load_kg, np.eye(len(site.weights))[0])
    stands = [float(site.standing(1 + i, site.order.load_kg)[0, 0]) for i in range(len(visits))]
    earlier, limit = earlier_of(visits), math.inf if site.task.most_kg is None else site.task.most_kg * (1 + 1e-12)
    scale = LATE * float(np.nanmean(apart[np.isfinite(apart)])) / max(float(np.nanmean(fast[np.isfinite(fast)])), 1e-9)

    def allowed(order: Sequence[int]) -> bool:
        done, load = set[int](), site.order.load_kg
        for i in order:
            load += visits[i].load_kg
            if not earlier[i] <= done or not -1e-9 <= load <= limit:
                return False
            done.add(i)
        return True

    def cost(order: Sequence[int]) -> float:
        total, clock, here = 0.0, 0.0, 0
        for i in order:
            total += apart[here, 1 + i]
            clock += fast[here, 1 + i]
            window = visits[i].window
            if window is not None:
                clock = max(clock, window.from_.value)
                if window.until is not None:
                    total += scale * max(0.0, clock - window.until.value)
            clock += stands[i]
            here = 1 + i
        clock += fast[here, site.goal]
        late = max(0.0, clock - site.deadline_s) if math.isfinite(site.deadline_s) else 0.0
        return float(total + apart[here, site.goal] + scale * late)

    rng = np.random.default_rng(1)
    found: dict[tuple[int, ...], float] = {}
    for start in range(STARTS):
        order: list[int] = []  # always the nearest visit that may come next, or (but at the first start) any of them
        left = set(range(len(visits)))
        while left:
            free = sorted(i for i in left if not earlier[i] & left)
            row = apart[1 + order[-1] if order else 0]
            order.append(int(rng.choice(free)) if start else min(free, key=lambda i: row[1 + i]))
            left.discard(order[-1])
        if not allowed(order):
            continue
        best = cost(order)
        improved = True
        while improved:
            improved = False
            for other in _near(order):
                if (value := cost(other)) < best - 1e-9 * abs(best) and allowed(other):
                    order, best, improved = other, value, True
                    break
        found[tuple(order)] = best
    return sorted(found, key=lambda order: found[order])


def _near(order: list[int]) -> list[list[int]]:
    made, count = [], len(order)
    for i in range(count):
        for length in range(1, min(3, count - i) + 1):
            part, rest = order[i : i + length], order[:i] + order[i + length :]
            for k in [k for k in range(len(rest) + 1) if k != i]:
                made += [rest[:k] + part + rest[k:], rest[:k] + part[::-1] + rest[k:]]
        made += [order[:i] + order[i:k][::-1] + order[k:] for k in range(i + 2, count + 1)]
    return made
