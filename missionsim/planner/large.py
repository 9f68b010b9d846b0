"""Many visits in any order: an order by local search, then the best plan in that order, and a bound on all orders."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from missionsim.inputs.check_task import earlier_of
from missionsim.physics import Array
from missionsim.planner.answer import Answer
from missionsim.planner.bounds import matrix
from missionsim.planner.orders import Order
from missionsim.planner.tour import Site

STARTS = 4
CUTS = 25
"""Rounds of cuts after which the bound is what it is."""
LATE = 1e3
"""What a second after the end of a window counts, relative to a second of the whole drive."""


def solve_large(site: Site, solve: Callable[[Site], Answer]) -> Answer:
    """The plan of an order that local search finds (moves of up to three visits, and reversals; Or 1976, Croes 1958).

    `solve`: site with a given order → its best plan.
    """
    apart = matrix(site, site.order.load_kg, site.weights)
    found = orders(site, apart)
    answer = Answer(site, False)
    for order in found:
        answer = solve(replace(site, order=Order(site.task, order)))
        if answer.feasible:
            break
    else:
        count = len(found)
        return Answer(site, False, notes=[f"no plan in the {count} orders that were tried of {len(order)} visits"])
    answer.bound = min(answer.objective, _bound(site, apart))
    answer.extra["assumed"] = [*answer.extra.get("assumed", ()), "the order was found by a heuristic"]
    return answer


def _bound(site: Site, apart: Array) -> float:
    """Below which no order's objective is; -infinity where visits may be left out or change the load.

    Each stop is left and entered once, and no set of stops is left by less than one drive in all: the linear program of
    Dantzig, Fulkerson and Johnson (1954), with the sets that a minimal cut finds violated.
    """
    import networkx as nx
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    visits = site.task.visits
    if any(v.value is not None or v.take_up is not None or v.set_down is not None for v in visits):
        return -math.inf
    count = len(visits)
    ends = [(i, j) for i in range(count + 1) for j in range(1, count + 2) if i != j and (i, j) != (0, count + 1)]
    arcs = np.array([(i, j) for i, j in ends if math.isfinite(apart[i, j])])
    tails, heads = arcs.T
    number = np.arange(len(arcs))
    degrees = coo_array(
        (np.ones(2 * len(arcs)), (np.append(tails, count + heads), np.append(number, number))),
        shape=(2 * count + 2, len(arcs)),
    ).tocsr()
    standing = sum(float((site.standing(1 + i, site.order.load_kg) @ site.weights).min()) for i in range(count))
    cuts: list[Array] = []
    bound = -math.inf
    for _ in range(CUTS):
        found = linprog(
            apart[tails, heads],
            A_eq=degrees,
            b_eq=np.ones(2 * count + 2),
            A_ub=np.array(cuts) if cuts else None,
            b_ub=-np.ones(len(cuts)) if cuts else None,
            method="highs",
        )
        if not found.success:
            break
        bound = float(found.fun) + standing
        graph = nx.DiGraph()
        graph.add_weighted_edges_from(zip(tails.tolist(), heads.tolist(), found.x.tolist(), strict=True), "capacity")
        new: set[frozenset[int]] = set()
        for stop in range(1, count + 1):
            value, (side, _) = nx.minimum_cut(graph, stop, count + 1)
            if value < 1.0 - 1e-6:
                new.add(frozenset(side))
        if not new:
            break
        inside = [np.isin(arcs, list(side)) for side in new]
        cuts += [-(one[:, 0] & ~one[:, 1]).astype(float) for one in inside]
    return bound


def orders(site: Site, apart: Array) -> list[tuple[int, ...]]:
    """Orders that keep to before and after, the best first."""
    visits = site.task.visits
    seconds = np.zeros_like(site.weights)
    seconds[0] = 1.0
    fast = matrix(site, site.order.load_kg, seconds)
    stands = [float(site.standing(1 + i, site.order.load_kg)[0, 0]) for i in range(len(visits))]
    earlier = earlier_of(visits)
    scale = LATE * float(np.nanmean(apart[np.isfinite(apart)])) / max(float(np.nanmean(fast[np.isfinite(fast)])), 1e-9)

    def allowed(order: Sequence[int]) -> bool:
        done: set[int] = set()
        for i in order:
            if not earlier[i] <= done:
                return False
            done.add(i)
        load = site.order.load_kg
        for i in order:
            visit = visits[i]
            load += (visit.take_up.value if visit.take_up else 0.0) - (visit.set_down.value if visit.set_down else 0.0)
            most = site.task.most_kg
            if load < -1e-9 or (most is not None and load > most * (1 + 1e-12)):
                return False
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
        order = _start(earlier, apart, rng if start else None)
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


def _start(earlier: list[set[int]], apart: Array, rng: np.random.Generator | None) -> list[int]:
    """Always the nearest visit that may come next, or (with a generator) any of them."""
    order: list[int] = []
    here, left = 0, set(range(len(earlier)))
    while left:
        free = sorted(i for i in left if not earlier[i] & left)
        chosen = min(free, key=lambda i: apart[here, 1 + i]) if rng is None else int(rng.choice(free))
        order.append(chosen)
        left.discard(chosen)
        here = 1 + chosen
    return order


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
