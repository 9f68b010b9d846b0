"""Many visits in any order: an order by local search, then the best plan in that order, and a bound on all orders."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.check_task import earlier_of
from missionsim.physics import Array
from missionsim.planner.answer import Answer
from missionsim.planner.bounds import matrix
from missionsim.planner.site import Order, Site

STARTS = 4
MOST_LOADS = 40
"""Loads up to which the least that a drive takes under any of them is known."""
MORE_VALUE = "more value may be possible"
CUTS = 25
"""Rounds of cuts after which the bound is what it is."""
LATE = 1e3
"""What a second after the end of a window counts, relative to a second of the whole drive."""


def solve_large(site: Site, solve: Callable[[Site], Answer]) -> Answer:
    """The plan of an order that local search finds (moves of up to three visits, and reversals; Or 1976, Croes 1958).
    `solve`: site with a given order → its best plan."""
    found = orders(site, matrix(site, site.order.load_kg, site.weights))
    best = Answer(site, False)
    valued = any(visit.value is not None for visit in site.task.visits)
    for order in found:
        answer = solve(replace(site, order=Order(site.task, order)))
        if answer.feasible and (not best.feasible or (-answer.value, answer.objective) < (-best.value, best.objective)):
            best = answer
        if answer.stopped or (best.feasible and not valued):
            break
    if not best.feasible:
        count = len(found)
        return Answer(site, False, notes=[f"no plan in the {count} orders that were tried of {len(order)} visits"])
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
    arcs: NDArray[np.intp], cost: Array, rows: list[Array], sides: list[float], needed: list[float]
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
        found = linprog(
            cost,
            A_eq=degrees,
            b_eq=once,
            A_ub=np.array(rows),
            b_ub=np.array(sides) * (1.0 + np.sign(sides) * 1e-9),
            bounds=[*((0.0, 1.0) for _ in number), *((low, 1.0) for low in needed)],
            method="highs",
        )
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
    made = []
    count = len(order)
    for i in range(count):
        for length in (1, 2, 3):
            part, rest = order[i : i + length], order[:i] + order[i + length :]
            if len(part) == length:
                for k in range(len(rest) + 1):
                    if k != i:
                        made.append(rest[:k] + part + rest[k:])
                        made.append(rest[:k] + part[::-1] + rest[k:])
        made += [order[:i] + order[i:k][::-1] + order[k:] for k in range(i + 2, count + 1)]
    return made
