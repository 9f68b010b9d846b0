"""A bound on every plan, by prices on time, charge and value (Lagrangian relaxation), and plans found on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from missionsim.physics import Array
from missionsim.planner.bounds import Tour, matrix
from missionsim.planner.core import Label, chain_of
from missionsim.planner.tour import Charger

ROUNDS = 40
CLOSE = 1e-7
"""Relative difference of the price's bound and what the best prices could give at most, at which it ends."""


@dataclass
class Prices:
    """What the relaxation gives."""

    best: Array
    """Prices of a second, of a Wh of each battery (and of value not made) that give the best bound. Shape (resources -
    1,)."""
    bound: float = -math.inf
    """Below which no plan's objective is."""
    plan: Label | None = None
    """The best plan among those that came up, and its `objective`."""
    objective: float = math.inf
    others: list[Array] = field(default_factory=list)
    """Prices tried on the way that gave bounds near the best."""
    impossible: bool = False
    """Proved that there is no plan."""


def cheapest(tour: Tour, prices: Array, *, straight: bool = False) -> tuple[list[tuple[int, int]], float] | None:
    """The tour of least objective with prices on top, without charging and without limits.

    Docks are stood at where that takes less, unless it is to lead `straight` from visit to visit. Gives stops with the
    state after each, from the first after the start, and what the tour costs.
    """
    site, table = tour.site, tour.rest(prices, straight=straight)
    if not math.isfinite(table[0, 0]):
        return None
    weights, worth = tour.priced(prices)
    order = site.order
    known: dict[float, Array] = {}
    here, state = 0, 0
    steps: list[tuple[int, int]] = []
    while here != site.goal:
        payload = order.payload_kg(state)
        if payload not in known:
            known[payload] = matrix(site, payload, weights, straight=straight)
        apart = known[payload][here]
        options = []
        for visit, after in order.after(state):
            stands = site.standing(1 + visit, order.payload_kg(after)) @ weights
            there = float(stands.min()) - (0.0 if worth is None else float(worth[visit]))
            options.append((apart[1 + visit] + there + table[after, 1 + visit], 1 + visit, after))
        if order.may_end(state):
            options.append((apart[site.goal], site.goal, state))
        _, here, state = min(options)
        steps.append((here, state))
    return steps, float(table[0, 0])


def tour_label(tour: Tour, steps: list[tuple[int, int]], weights: Array) -> Label:
    """The label of a tour whose drives are those of least weighted use."""
    site = tour.site
    label = Label(0, tour.first[None, :])
    stop, state = 0, 0
    for head, after in steps:
        payload = site.order.payload_kg(state)
        if site.stops[stop].place == site.stops[head].place:
            drive = tour.none
        else:
            ends = [nodes[[number]] for nodes, number in zip(site.nodes[payload], (stop, head), strict=True)]
            drive = next(iter(site.road(payload).supported([weights], *ends).values()))[0]
        uses = dict(tour.arc_uses(drive, head, after))
        stands = site.standing(head, site.order.payload_kg(after)) @ weights
        choice = min(uses, key=lambda i: float(stands[i]))
        label = Label(after * tour.size + head, label.points + uses[choice], label, (head, drive, uses[choice], choice))
        stop, state = head, after
    return label


def best_prices(tour: Tour, *, charging: bool = True) -> Prices:
    """Prices by cutting planes (Kelley 1960); of plans without charging only, where that is said.

    A price on charge that a dock sells is at most what charging costs there, so that a plan may charge as it likes
    and the bound holds.
    """
    from scipy.optimize import linprog

    site = tour.site
    left = tour.left
    count = len(site.weights)
    chargers = [charger for charger in tour.chargers if charger is not None and charging]
    result = Prices(np.zeros(len(left)))
    # ten thousand times what a unit is worth: high enough for every price
    highest = np.where(np.isfinite(left), 1e4 * unit(tour), 0.0)
    room = np.where(np.isfinite(left), left, 0.0)
    prices = np.zeros(len(left))
    cuts: list[tuple[float, Array]] = []
    tried: list[tuple[float, Array]] = []
    most = float(tour.first[0]) if tour.by_value else _most(tour, chargers)
    for _ in range(ROUNDS):
        found = cheapest(tour, prices, straight=not charging)
        if found is None:
            result.impossible = True
            break
        bound = float(tour.first[0] + found[1] - prices @ room)
        tried.append((bound, prices))
        if bound > result.bound:
            result.bound, result.best = bound, prices
        if bound > most * (1.0 + 1e-9) + 1e-9:
            result.impossible = True
            break
        label = tour_label(tour, found[0], site.weights + prices[:count])
        use, objective = label.points[0][1:] - tour.first[1:], float(label.points[0][0])
        over = np.where(np.isfinite(left), use - room, 0.0)
        kept = (over <= 1e-12 * (1.0 + np.abs(use))).all() and not site.windowed and _lasts(tour, label)
        if kept and objective < result.objective:
            result.plan, result.objective = label, objective
        cuts.append((objective, over))
        # max θ with θ ≤ objective + prices · over for every tour so far
        lines = np.array([[*(-over), 1.0] for _, over in cuts])
        sides = np.array([objective for objective, _ in cuts])
        if chargers:
            rest = [0.0] * (len(left) - count + 1)
            sold = np.array([[-1.0, *(np.maximum(c.gain_w, 0.0) / 3600.0), *rest] for c in chargers])
            lines, sides = np.concatenate([lines, sold]), np.concatenate([sides, [c.rate for c in chargers]])
        answer = linprog(
            np.array([0.0] * len(left) + [-1.0]),
            A_ub=lines,
            b_ub=sides,
            bounds=[*((0.0, high) for high in highest), (None, None)],
            method="highs",
        )
        if not answer.success or -answer.fun - result.bound <= CLOSE * max(1.0, abs(result.bound)):
            break
        prices = np.maximum(np.asarray(answer.x[: len(left)]), 0.0)
        if any(np.array_equal(prices, old) for _, old in tried):
            break
    near = sorted((bound, tuple(p)) for bound, p in tried)[-4:]
    result.others = [np.array(p) for _, p in near if any(p) and not np.array_equal(np.array(p), result.best)][:3]
    return result


def _most(tour: Tour, chargers: list[Charger]) -> float:
    """Objective that no plan is above, from its limits."""
    weights, left = tour.site.weights, tour.left[: len(tour.site.weights)].copy()
    for b in range(1, len(left)):
        gain = max([0.0, *(float(charger.gain_w[b - 1]) for charger in chargers)])
        left[b] += gain / 3600.0 * left[0] if gain else 0.0
    priced = weights > 0.0
    return float(weights[priced] @ left[priced])


def _lasts(tour: Tour, label: Label) -> bool:
    """Whether no battery runs low on the way."""
    most = tour.site.usable_wh
    missing = slice(2, 2 + len(most))
    return all(
        bool((step.parent.points[0][missing] + step.move[1].peak <= most * (1 + 1e-12)).all())
        and bool((step.points[0][missing] <= most * (1 + 1e-12)).all())
        for step in chain_of(label)
        if step.parent is not None
    )


def prices_ahead(tour: Tour, prices: Array) -> list[Array]:
    """Prices on the charge until the next dock, on top of others: some that raise the bound at the start, most last.
    Each battery must last until that dock. Sought one battery after the other (coordinate ascent)."""
    most = tour.site.usable_wh
    room = most - tour.first[2 : 2 + len(most)]
    best, bound = np.zeros(len(prices)), -math.inf
    for steps in (unit(tour) * np.array([0.1, 0.5, 2.5]), np.array([0.5, 1.6])):
        for b in range(1, 1 + len(most)):
            base = best.copy()
            for step in steps.tolist():
                tried = base.copy()
                tried[b] = base[b] * step if base[b] else step
                found = float(tour.rest(prices, tried)[0, 0] - tried[1 : 1 + len(most)] @ room)
                if found > bound:
                    best, bound = tried, found
    return [0.3 * best, 3.0 * best, best]


def unit(tour: Tour) -> float:
    """The order of size of a price."""
    return max(1e-6, float(tour.site.weights.max()), 0.0 if tour.values is None else float(tour.values.max()))
