"""A bound on every plan, by prices on time and charge (Lagrangian relaxation), and plans found on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from missionsim.planner.bounds import limits_left, matrix, rest_of
from missionsim.planner.core import Label
from missionsim.planner.drives import Drive
from missionsim.planner.tour import Site, Tour

Array = NDArray[np.float64]
ROUNDS = 40
CLOSE = 1e-7
"""Relative difference of the price's bound and what the best prices could give at most, at which it ends."""


@dataclass
class Prices:
    """What the relaxation gives.

    Attributes
    ----------
    best : ndarray, shape (1 + batteries,)
        Prices of a second and of a Wh of each battery that give the best bound.
    bound : float
        Below which no plan's objective is.
    plan : Label or None
        The best plan among those that came up, and its `objective`.
    others : list of ndarray
        Prices tried on the way that gave bounds near the best.
    impossible : bool
        Proved that there is no plan.
    """

    best: Array
    bound: float = -math.inf
    plan: Label | None = None
    objective: float = math.inf
    others: list[Array] = field(default_factory=list)
    impossible: bool = False


def cheapest(site: Site, prices: Array) -> tuple[list[tuple[int, int]], Array] | None:
    """The tour of least weighted use with prices on top, without charging and without limits.

    Returns
    -------
    tuple or None
        Stops with the state after each, from the first after the start, and the table of the rest from each state.
    """
    weights = site.weights + prices
    table = rest_of(site, weights)
    if not math.isfinite(table[0, 0]):
        return None
    order = site.order
    known: dict[float, Array] = {}
    here, state = 0, 0
    steps: list[tuple[int, int]] = []
    while here != site.goal:
        payload = order.payload_kg(state)
        if payload not in known:
            known[payload] = matrix(site, payload, weights)
        apart = known[payload][here]
        options = []
        for visit, after in order.after(state):
            there = float(site.standing(1 + visit, order.payload_kg(after)) @ weights)
            options.append((apart[1 + visit] + there + table[after, 1 + visit], 1 + visit, after))
        if order.may_end(state):
            options.append((apart[site.goal], site.goal, state))
        _, here, state = min(options)
        steps.append((here, state))
    return steps, table


def tour_label(tour: Tour, steps: list[tuple[int, int]], weights: Array) -> Label:
    """The label of a tour whose drives are those of least weighted use."""
    site = tour.site
    label = Label(0, tour.start())
    stop, state = 0, 0
    for head, after in steps:
        payload = site.order.payload_kg(state)
        if site.stops[stop].place == site.stops[head].place:
            drive = Drive(np.zeros(len(weights)))
        else:
            out, into = site.nodes[payload]
            drive = site.road(payload).shortest(weights, int(out[stop]), int(into[head]))
        use = tour.arc_use(drive, head, after)
        label = Label(after * tour.size + head, label.points + use, label, (head, drive, use))
        stop, state = head, after
    return label


def best_prices(tour: Tour) -> Prices:
    """Prices by cutting planes (Kelley 1960).

    A price on charge that a dock sells is at most what charging costs there, so that a plan may charge as it likes
    and the bound holds.
    """
    from scipy.optimize import linprog

    site = tour.site
    count = 1 + len(site.physics.names)
    left = limits_left(site)
    chargers = [stop.charger for stop in site.stops if stop.charger is not None]
    result = Prices(np.zeros(count))
    highest = np.where(np.isfinite(left), _ceiling(site, left), 0.0)
    prices = np.zeros(count)
    cuts: list[tuple[float, Array]] = []
    tried: list[tuple[float, Array]] = []
    most = objective_at_most(site, left) if not chargers else math.inf
    for _ in range(ROUNDS):
        found = cheapest(site, prices)
        if found is None:
            result.impossible = True
            break
        steps, table = found
        active = prices > 0.0
        bound = float(table[0, 0] - prices[active] @ left[active])
        tried.append((bound, prices))
        if bound > result.bound:
            result.bound, result.best = bound, prices
        if bound > most * (1.0 + 1e-9) + 1e-9:
            result.impossible = True
            break
        label = tour_label(tour, steps, site.weights + prices)
        use, objective = label.points[0][1 : 1 + count].copy(), float(label.points[0][0])
        use[1:] -= tour.start()[0, 2 : 1 + count]
        over = np.where(np.isfinite(left), use - np.where(np.isfinite(left), left, 0.0), -1.0)
        if (
            (over <= 1e-12 * (1.0 + np.abs(use))).all()
            and objective < result.objective
            and not (tour.valued or site.windowed)
        ):
            result.plan, result.objective = label, objective
        cuts.append((objective, np.where(np.isfinite(left), over, 0.0)))
        # max θ with θ ≤ objective + prices · over for every tour so far
        lines = np.array([[*(-over), 1.0] for _, over in cuts])
        sides = np.array([objective for objective, _ in cuts])
        if chargers:
            sold = np.array([[-1.0, *(np.maximum(charger.gain_w, 0.0) / 3600.0), 0.0] for charger in chargers])
            lines, sides = np.concatenate([lines, sold]), np.concatenate([sides, [c.rate for c in chargers]])
        answer = linprog(
            np.array([0.0] * count + [-1.0]),
            A_ub=lines,
            b_ub=sides,
            bounds=[*((0.0, high) for high in highest), (None, None)],
            method="highs",
        )
        if not answer.success:
            break
        if -answer.fun - result.bound <= CLOSE * max(1.0, abs(result.bound)):
            break
        prices = np.maximum(np.asarray(answer.x[:count]), 0.0)
        if any(np.array_equal(prices, old) for _, old in tried):
            break
    near = sorted((bound, tuple(p)) for bound, p in tried)[-4:]
    result.others = [np.array(p) for _, p in near if any(p) and not np.array_equal(np.array(p), result.best)][:3]
    return result


def objective_at_most(site: Site, left: Array) -> float:
    """Objective that no plan without charging is above, from its limits."""
    weights = site.weights
    return float(sum(weight * limit for weight, limit in zip(weights, left, strict=True) if weight > 0.0))


def _ceiling(site: Site, left: Array) -> Array:
    """Prices that are high enough: a hundred times the whole objective for all that there is of a resource."""
    scale = max(1e-6, float(site.weights.max())) * 1e4
    return np.full(len(left), scale)
