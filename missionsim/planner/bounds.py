"""Bounds on the rest of each way, and on every plan, by prices on time, charge and value (Lagrangian relaxation)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from missionsim.physics import Array, Ints
from missionsim.planner.core import Bounds, Label
from missionsim.planner.site import Site
from missionsim.planner.tour import Tour

LONGEST_S = 1e6
ROUNDS = 40
CLOSE = 1e-7
"""Relative difference of the price's bound and what the best prices could give at most, at which it ends."""


def matrix(site: Site, payload_kg: float, weights: Array, *, straight: bool = False) -> Array:
    """Least weighted seconds and Wh of driving from each stop to each, without what is done there. To stand at a dock
    on the way may take less than to roll through; with `straight` that is left out."""
    road, out, into = site.road(payload_kg)
    found = road.distances(weights, out)[:, into]
    places = np.array([stop.place for stop in site.stops])
    found = np.where(places[:, None] == places[None, :], 0.0, found)
    for dock in () if straight else range(site.goal + 1, len(site.stops)):
        found = np.minimum(found, found[:, dock, None] + found[None, dock, :])
    return found


def _by_load(
    site: Site, weights: Array, worth: Array | None = None, *, straight: bool = False
) -> tuple[Array, Array, Ints]:
    """For each load that may come up `matrix`, shape (loads, stops, stops), and the least of what is done at each visit
    less what it is worth, shape (loads, visits); the number of each state's load."""
    loads, which = site.order.loads
    apart = np.full((len(loads), len(site.stops), len(site.stops)), math.inf)
    for load in site.order.driven:
        apart[load] = matrix(site, float(loads[load]), weights, straight=straight)
    stands = np.zeros((len(loads), len(site.task.visits)))
    for load, visit in site.order.standing:
        stands[load, visit] = (site.standing(1 + visit, float(loads[load])) @ weights).min()
        stands[load, visit] -= 0.0 if worth is None else worth[visit]
    return apart, stands, which


def rest_of(
    site: Site, weights: Array, worth: Array | None = None, ahead: Array | None = None, *, straight: bool = False
) -> Array:
    """Least weighted seconds and Wh from each state and stop to the end, shape (states, stops).

    What charging takes is left out; with `ahead` the way leads by a dock, and these are the weights as far as there.
    `worth` is taken off for each visit made; `straight` as for `matrix`. Held and Karp (1962), backwards over the
    visits that are left.
    """
    order, goal = site.order, site.goal
    apart, stands, which = _by_load(site, weights if ahead is None else ahead, worth, straight=straight)
    table = np.full((order.count, len(site.stops)), math.inf)
    if ahead is None:
        table[order.ends] = apart[which[order.ends], :, goal]
        table[order.ends, goal] = 0.0
    else:
        after, full = rest_of(site, weights, worth), (site.physics.initial_wh >= site.physics.capacity_wh).all()
        for dock in [i for i, stop in enumerate(site.stops) if stop.charger is not None]:
            by = apart[which, :, dock] + after[:, dock, None]
            if full and site.stops[dock].place == site.task.start:
                by[:, 0] = math.inf  # nothing to charge yet
            table = np.minimum(table, by)
        table[:, goal] = math.inf
    for states, visits, afters in order.steps:
        there = stands[which[afters], visits] + table[afters, 1 + visits]
        through = apart[which[states], :, 1 + visits] + there[:, None]
        begins = np.flatnonzero(np.diff(states, prepend=-1))
        one = states[begins]
        at_goal = table[one, goal]
        table[one] = np.minimum(table[one], np.minimum.reduceat(through, begins, axis=0))
        table[one, goal] = at_goal
    return table


def rest(tour: Tour, prices: Array, ahead: Array | None = None, *, straight: bool = False) -> Array:
    """`rest_of` the site with prices on all resources but the objective. With `ahead` by way of a dock, these prices on
    top as far as there."""
    weights, worth = tour.priced(prices)
    return rest_of(
        tour.site, weights, worth, None if ahead is None else weights + ahead[: len(weights)], straight=straight
    )


def slack_of(tour: Tour, prices: Array) -> tuple[Array, Array]:
    """By how much the cheapest tour with prices on top that drives between two stops is above the cheapest of all.

    Without limits, and by docks where it likes. Gives an array of shape (loads, stops, stops): from, to; and the least
    weighted use up to each state and stop, shape (states, stops).
    """
    site, order, goal = tour.site, tour.site.order, tour.site.goal
    apart, stands, which = _by_load(site, *tour.priced(prices))
    after = rest(tour, prices)
    found = np.full(apart.shape, math.inf)
    before = np.full_like(after, math.inf)
    before[0, 0] = 0.0

    def way(states: Ints, heads: Ints, rest: Array) -> Array:
        through = before[states] + apart[which[states], :, heads]
        ends = which[states][:, None], np.arange(tour.size)[None, :], heads[:, None]
        np.minimum.at(found, ends, through + rest[:, None])
        return np.asarray(through.min(axis=1))

    def by_docks(states: Ints) -> None:
        for dock in range(goal + 1, tour.size):
            by = way(states, np.full(len(states), dock), after[states, dock])
            before[states, dock] = np.minimum(before[states, dock], by)

    for states, visits, afters in reversed(order.steps):
        by_docks(np.unique(states))
        there = stands[which[afters], visits]
        best = way(states, 1 + visits, there + after[afters, 1 + visits])
        np.minimum.at(before, (afters, 1 + visits), best + there)
    ends = np.flatnonzero(order.ends)
    by_docks(ends)
    way(ends, np.full(len(ends), goal), np.zeros(len(ends)))
    return np.asarray(np.maximum(found - after[0, 0], 0.0)), before


def in_time(site: Site) -> Ints:
    """States to end in for which some order keeps all windows and the deadline, driven as fast as can be."""
    order, visits = site.order, site.task.visits
    apart, stands, which = _by_load(site, np.eye(len(site.weights))[0])
    opens = np.array([0.0 if visit.window is None else visit.window.from_.value for visit in visits])
    ends = [None if visit.window is None else visit.window.until for visit in visits]
    until = np.array([math.inf if end is None else end.value for end in ends]) * (1.0 + 1e-9)
    early = np.full((order.count, len(site.stops)), math.inf)
    early[0, 0] = 0.0
    for states, nexts, afters in reversed(order.steps):
        begin = np.maximum((early[states] + apart[which[states], :, 1 + nexts]).min(axis=1), opens[nexts])
        begin[begin > until[nexts]] = math.inf
        np.minimum.at(early, (afters, 1 + nexts), begin + stands[which[afters], nexts])
    last = np.flatnonzero(order.ends)
    arrives = (early[last] + apart[which[last], :, site.goal]).min(axis=1)
    return np.asarray(last[np.isfinite(arrives) & (arrives <= site.deadline_s * (1.0 + 1e-9))])


def bounds_of(
    tour: Tour, multipliers: list[Array], uncharged: list[Array] | None = None, ahead: list[Array] | None = None
) -> Bounds:
    """What the search may know of the rest of each way.

    `multipliers` (shape (resources - 1,)): prices on all but the objective; the row of zeros is added. `uncharged`:
    prices for ways on which there is no more charging; then the others are for ways that lead by a dock. `ahead`:
    prices on top of the first multiplier's as far as the next dock, where each battery must last.
    """
    site = tour.site
    physics, order = site.physics, site.order
    count = len(physics.names)
    most = tour.limits.copy()
    if site.windowed:
        most[1] = min(site.deadline_s, LONGEST_S)  # that windows end can be said of an end only
    most[2 : 2 + count] = site.usable_wh
    # what must be left at the end beyond what must be left always
    reserve = np.maximum(np.maximum(physics.reserve_wh, 0.0) - (physics.capacity_wh - site.usable_wh), 0.0)
    least = np.zeros((tour.nodes, len(most)))
    unit = np.eye(1 + count)
    least[:, 1] = tour.over(rest_of(site, unit[0]))
    for b in range(count):
        apart, _, which = _by_load(site, unit[1 + b])
        docks = [i for i, charger in enumerate(tour.chargers) if charger is not None and charger.served[b]]
        to_dock = apart[:, :, docks].min(axis=2, initial=math.inf)[which]
        to_dock[:, site.goal] = math.inf  # the mission ends there
        to_end = tour.over(rest_of(site, unit[1 + b])) + reserve[b]
        least[:, 2 + b] = np.minimum(to_end, tour.over(to_dock, whole=False))
    least[~np.isfinite(least[:, 1]), 0] = math.inf
    if tour.counted and tour.values is not None:
        made = np.repeat(-order.left(tour.values)[:, None], tour.size, axis=1)
        made[:, site.goal] = 0.0
        least[:, -1] = made.ravel()
    _, stands, which = _by_load(site, unit[0])
    for i, visit in enumerate(site.task.visits):
        if visit.window is not None and visit.window.until is not None:
            done = slice(1 + i, order.count * tour.size, tour.size)
            least[done, 1] = np.maximum(least[done, 1], most[1] - visit.window.until.value - stands[which, i])
    zero = np.zeros(len(most) - 1)
    first = [] if uncharged is None else [zero, *uncharged]
    later = [(multiplier, None if uncharged is None else zero) for multiplier in [zero, *multipliers]]
    weights: list[Array] = []
    rests: list[Array] = []
    offsets: list[float] = []
    for multiplier, more in [*((m, None) for m in first), *later, *((multipliers[0], one) for one in ahead or ())]:
        on_top = zero if more is None else more
        priced, lasting = multiplier > 0.0, on_top > 0.0
        weights.append(np.concatenate([[1.0], multiplier + on_top]))
        rests.append(tour.over(rest(tour, multiplier, more, straight=len(rests) < len(first))))
        offsets.append(float(multiplier[priced] @ tour.limits[1:][priced] + on_top[lasting] @ most[1:][lasting]))
    shear = None
    if tour.latest > 0.0:
        shear = tour.vector(site.waiting)
        shear[1] = 0.0
    table, offset = np.stack(rests, axis=1), np.array(offsets)
    apart_rows, timeless = len(first) or None, site.timeless
    return Bounds(
        most, least, np.array(weights), table, offset, shear, tour.latest, timeless=timeless, apart=apart_rows
    )


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
    site, order, table = tour.site, tour.site.order, rest(tour, prices, straight=straight)
    if not math.isfinite(table[0, 0]):
        return None
    apart, stands, which = _by_load(site, *tour.priced(prices), straight=straight)
    here, state = 0, 0
    steps: list[tuple[int, int]] = []
    while here != site.goal:
        drives = apart[which[state], here]
        options = [
            (drives[1 + visit] + stands[which[after], visit] + table[after, 1 + visit], 1 + visit, after)
            for visit, after in order.after(state)
        ]
        if order.may_end(state):
            options.append((drives[site.goal], site.goal, state))
        _, here, state = min(options)
        steps.append((here, state))
    return steps, float(table[0, 0])


def best_prices(tour: Tour, *, charging: bool = True) -> Prices:
    """Prices by cutting planes (Kelley 1960); of plans without charging only, where that is said.

    A price on charge that a dock sells is at most what charging costs there, so that a plan may charge as it likes
    and the bound holds.
    """
    from scipy.optimize import linprog

    site, left = tour.site, tour.left
    count, usable = len(site.weights), site.usable_wh * (1 + 1e-12)
    chargers = [charger for charger in tour.chargers if charger is not None and charging]
    result = Prices(np.zeros(len(left)))
    # ten thousand times what a unit is worth: high enough for every price
    highest = np.where(np.isfinite(left), 1e4 * tour.unit, 0.0)
    room = np.where(np.isfinite(left), left, 0.0)
    prices = np.zeros(len(left))
    cuts: list[tuple[float, Array]] = []
    tried: list[tuple[float, Array]] = []
    most = float(tour.first[0])  # above which no plan's objective is
    if not tour.by_value:
        limits = left[:count].copy()
        for b in range(1, count):
            gain = max([0.0, *(float(charger.gain_w[b - 1]) for charger in chargers)])
            limits[b] += gain / 3600.0 * limits[0] if gain else 0.0
        counts = site.weights > 0.0
        most = float(site.weights[counts] @ limits[counts])
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
        label, lasts = _label(tour, found[0], site.weights + prices[:count], usable)
        use, objective = label.points[0][1:] - tour.first[1:], float(label.points[0][0])
        over = np.where(np.isfinite(left), use - room, 0.0)
        kept = (over <= 1e-12 * (1.0 + np.abs(use))).all() and not site.windowed and lasts
        if kept and objective < result.objective:
            result.plan, result.objective = label, objective
        cuts.append((objective, over))
        # max θ with θ ≤ objective + prices · over for every tour so far
        lines = np.array([[*(-over), 1.0] for _, over in cuts])
        sides = np.array([objective for objective, _ in cuts])
        if chargers:
            zeros = [0.0] * (len(left) - count + 1)
            sold = np.array([[-1.0, *(np.maximum(c.gain_w, 0.0) / 3600.0), *zeros] for c in chargers])
            lines, sides = np.concatenate([lines, sold]), np.concatenate([sides, [c.rate for c in chargers]])
        bounds = [*((0.0, high) for high in highest), (None, None)]
        answer = linprog(np.array([0.0] * len(left) + [-1.0]), A_ub=lines, b_ub=sides, bounds=bounds, method="highs")
        if not answer.success or -answer.fun - result.bound <= CLOSE * max(1.0, abs(result.bound)):
            break
        prices = np.maximum(np.asarray(answer.x[: len(left)]), 0.0)
        if any(np.array_equal(prices, old) for _, old in tried):
            break
    near = sorted((bound, tuple(p)) for bound, p in tried)[-4:]
    result.others = [np.array(p) for _, p in near if any(p) and not np.array_equal(np.array(p), result.best)][:3]
    return result


def _label(tour: Tour, steps: list[tuple[int, int]], weights: Array, usable_wh: Array) -> tuple[Label, bool]:
    """The label of a tour whose drives are those of least weighted use, and whether no battery runs low on the way."""
    site, missing, lasts = tour.site, slice(2, 2 + len(usable_wh)), True
    label = Label(0, tour.first[None, :])
    stop, state = 0, 0
    for head, after in steps:
        drive = tour.none
        if site.stops[stop].place != site.stops[head].place:
            road, out, into = site.road(site.order.payload_kg(state))
            (found,) = road.supported([weights], out[[stop]], into[[head]]).values()
            drive = found[0]
        uses = dict(tour.arc_uses(drive, head, after))
        stands = site.standing(head, site.order.payload_kg(after)) @ weights
        choice = min(uses, key=lambda i: float(stands[i]))
        points = label.points + uses[choice]
        lasts &= bool(
            (label.points[0][missing] + drive.peak <= usable_wh).all() and (points[0][missing] <= usable_wh).all()
        )
        label = Label(after * tour.size + head, points, label, (head, drive, uses[choice], choice))
        stop, state = head, after
    return label, lasts


def prices_ahead(tour: Tour, prices: Array) -> list[Array]:
    """Prices on the charge until the next dock, on top of others: some that raise the bound at the start, most last.
    Each battery must last until that dock. Sought one battery after the other (coordinate ascent)."""
    most = tour.site.usable_wh
    room = most - tour.first[2 : 2 + len(most)]
    best, bound = np.zeros(len(prices)), -math.inf
    for steps in (tour.unit * np.array([0.1, 0.5, 2.5]), np.array([0.5, 1.6])):
        for b in range(1, 1 + len(most)):
            base = best.copy()
            for step in steps.tolist():
                tried = base.copy()
                tried[b] = base[b] * step if base[b] else step
                found = float(rest(tour, prices, tried)[0, 0] - tried[1 : 1 + len(most)] @ room)
                if found > bound:
                    best, bound = tried, found
    return [0.3 * best, 3.0 * best, best]
