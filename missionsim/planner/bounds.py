"""The graph of stops that the core searches, and bounds on the rest of each way through it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.physics import Array
from missionsim.planner.core import Bounds, Leaving
from missionsim.planner.drives import Drive
from missionsim.planner.pieces import undominated
from missionsim.planner.tour import Charger, Site

LONGEST_S = 1e6
HAIR = 2e-9


class Tour:
    """Network of the core: a node is a state of the order and a stop; resources are objective, time, Wh missing.

    `drives`: ``(payload, from stop, to stop) -> list of Drive``; `values`: value of each visit, where some may be left
    out: then one more resource is the value that is not made yet; `most_missed`: limit of that resource; `by_value`:
    the value that is not made is the objective, in place of that resource.
    """

    def __init__(
        self,
        site: Site,
        drives: Callable[[float, int, int], list[Drive]],
        values: Array | None = None,
        most_missed: float = math.inf,
        *,
        by_value: bool = False,
    ) -> None:
        self.site = site
        self.none = Drive(np.zeros(len(site.weights)), np.zeros(len(site.physics.names)))
        self.size = len(site.stops)
        self.nodes = site.order.count * self.size
        self.values = values
        self.by_value = by_value
        self.counted = values is not None and not by_value
        self.latest = site.waits_until
        self.drives = drives
        self._known: dict[int, Leaving] = {}
        self.chargers = [site.charger(number) for number in range(self.size)]
        physics = site.physics
        total = 0.0 if values is None else float(values.sum())
        more = [total] if self.counted else []
        self.first = np.array([total if by_value else 0.0, 0.0, *physics.missing_wh(), *more])
        kept = physics.capacity_wh - physics.reserve_wh
        self.limits = np.array([math.inf, site.deadline_s, *kept, *([most_missed] if self.counted else [])])

    @property
    def left(self) -> Array:
        """Of each resource but the objective what a plan without charging may use."""
        return np.asarray((self.limits - self.first)[1:])

    def at(self, node: int) -> tuple[int, int]:
        """State of the order and stop of a node."""
        return divmod(node, self.size)

    def over(self, table: Array, whole: bool = True) -> Array:
        """A table by state and stop, for all nodes."""
        return table.ravel()

    def is_goal(self, node: int) -> bool:
        """Whether the mission ends here."""
        return node % self.size == self.site.goal

    def leaving(self, node: int) -> Leaving:
        """Drives to all stops that may come next."""
        known = self._known.get(node)
        if known is None:
            known = self._known[node] = self._make(node)
        return known

    def refill(self, node: int) -> Charger | None:
        """The charger of a dock."""
        return self.chargers[self.at(node)[1]]

    def opens(self, node: int) -> Callable[..., Array] | None:
        """Waiting at a visit until its window opens."""
        if not self.site.windowed:
            return None
        visit = self.site.stops[node % self.size].visit
        window = None if visit is None else self.site.task.visits[visit].window
        if window is None or window.from_.value <= 0.0:
            return None
        state = node // self.size
        stand = float(self.site.standing(node % self.size, self.site.order.payload_kg(state))[0, 0])
        return self.until(window.from_.value + stand)

    def until(self, begin: float) -> Callable[..., Array]:
        """What waiting until some time does to the points of a chain, or to points apart."""
        waiting = self.waiting()

        def wait(points: Array, *, apart: bool = False) -> Array:
            kept = list(points) if apart else [points[0]]
            for first, second in itertools.pairwise(() if apart else points):
                if first[1] < begin < second[1]:
                    kept.append(first + (begin - first[1]) / (second[1] - first[1]) * (second - first))
                kept.append(second)
            made = np.array(kept)
            return np.asarray(made + np.maximum(begin - made[:, 1:2], 0.0) * waiting)

        return wait

    def waiting(self) -> Array:
        """What waiting for a second adds to the vector."""
        return self.vector(self.site.waiting)

    def _make(self, node: int) -> Leaving:
        state, stop = divmod(node, self.size)
        site = self.site
        nexts: list[tuple[int, int]] = []
        if stop != site.goal:
            nexts = [(1 + visit, after) for visit, after in site.order.after(state)]
            nexts += [(site.goal, state)] if site.order.may_end(state) else []
            nexts += [(dock, state) for dock in range(site.goal + 1, self.size) if dock != stop]
        payload = site.order.payload_kg(state)
        heads: list[int] = []
        use: list[Array] = []
        peaks: list[Array] = []
        moves: list[Any] = []
        for head, after in nexts:
            for drive in self.drives(payload, stop, head):
                for choice, whole in self.arc_uses(drive, head, after):
                    use.append(whole)
                    peaks.append(drive.peak)
                    heads.append(after * self.size + head)
                    moves.append((head, drive, whole, choice))
        whole_use = np.array(use).reshape(len(heads), len(self.first))
        count = len(site.physics.names)
        peak = np.zeros_like(whole_use)
        peak[:, 2 : 2 + count] = np.array(peaks).reshape(len(heads), count)
        dips = (peak > np.maximum(whole_use, 0.0) + 1e-12)[:, 2 : 2 + count].any()
        return Leaving(np.array(heads, dtype=np.intp), whole_use, moves, peak if dips else None)

    def arc_uses(self, drive: Drive, head: int, after: int) -> list[tuple[int, Array]]:
        """What driving to a stop and what is done there add to the vector, for each scheme that none is better than."""
        visit = self.site.stops[head].visit
        made = 0.0 if self.values is None or visit is None else float(self.values[visit])
        stands = self.site.standing(head, self.site.order.payload_kg(after))
        kept = undominated(stands, self.site.shear, np.zeros((len(stands), 0))).tolist()
        return [(i, self.vector(drive.use + stands[i], made)) for i in kept]

    def vector(self, use: Array, made: float = 0.0) -> Array:
        """What seconds and Wh, and value made, add to the vector."""
        objective = -made if self.by_value else float(self.site.objective(use))
        return np.array([objective, *use, *([-made] if self.counted else [])])

    def rest(self, prices: Array, ahead: Array | None = None, *, straight: bool = False) -> Array:
        """Least objective from each state and stop to the end, with prices on all resources but the objective. With
        `ahead` by way of a dock, these prices on top as far as there; `straight` by way of none."""
        weights, worth = self.priced(prices)
        more = None if ahead is None else weights + ahead[: len(weights)]
        return rest_of(self.site, weights, worth, more, straight=straight)

    def priced(self, prices: Array) -> tuple[Array, Array | None]:
        """Weights of seconds and Wh, and what each visit is worth, with prices on top."""
        count = len(self.site.weights)
        worth = None if self.values is None else self.values * (1.0 if self.by_value else float(prices[count]))
        return self.site.weights + prices[:count], worth


def matrix(site: Site, payload_kg: float, weights: Array, *, straight: bool = False) -> Array:
    """Least weighted seconds and Wh of driving from each stop to each, without what is done there. To stand at a dock
    on the way may take less than to roll through; with `straight` that is left out."""
    road = site.road(payload_kg)
    out, into = site.nodes[payload_kg]
    found = road.distances(weights, out)[:, into]
    places = np.array([stop.place for stop in site.stops])
    found = np.where(places[:, None] == places[None, :], 0.0, found)
    for dock in () if straight else range(site.goal + 1, len(site.stops)):
        found = np.minimum(found, found[:, dock, None] + found[None, dock, :])
    return found


def rest_of(
    site: Site, weights: Array, worth: Array | None = None, ahead: Array | None = None, *, straight: bool = False
) -> Array:
    """Least weighted seconds and Wh from each state and stop to the end, shape (states, stops).

    What charging takes is left out; with `ahead` the way leads by a dock, and these are the weights as far as there.
    `worth` is taken off for each visit made; `straight` as for `matrix`. Held and Karp (1962), backwards over the
    visits that are left.
    """
    if ahead is not None:
        table = rest_of(site, weights, worth)
        return _back(site, ahead, worth, _by_dock(site, ahead, table))
    order, goal = site.order, site.goal
    apart = _by_load(site, weights, straight)
    table = np.full((order.count, len(site.stops)), math.inf)
    table[order.ends] = apart[order.loads[1][order.ends], :, goal]
    table[order.ends, goal] = 0.0
    return _back(site, weights, worth, table, straight)


def _by_dock(site: Site, weights: Array, table: Array) -> Array:
    """Least weighted use of going straight to a dock and what a table says from there on."""
    which = site.order.loads[1]
    apart = _by_load(site, weights)
    docks = [i for i, stop in enumerate(site.stops) if stop.charger is not None]
    found = np.full_like(table, math.inf)
    full = (site.physics.missing_wh() <= 0.0).all()
    for dock in docks:
        by = apart[which, :, dock] + table[:, dock, None]
        if full and site.stops[dock].place == site.task.start:
            by[:, 0] = math.inf  # nothing to charge yet
        found = np.minimum(found, by)
    found[:, site.goal] = math.inf
    return found


def _back(site: Site, weights: Array, worth: Array | None, table: Array, straight: bool = False) -> Array:
    """A table of what the end takes, filled in backwards over the visits."""
    order, goal = site.order, site.goal
    apart, stands = _by_load(site, weights, straight), _stands(site, weights, worth)
    which = order.loads[1]
    for states, visits, afters in order.steps:
        there = stands[which[afters], visits] + table[afters, 1 + visits]
        through = apart[which[states], :, 1 + visits] + there[:, None]
        begins = np.flatnonzero(np.diff(states, prepend=-1))
        one = states[begins]
        at_goal = table[one, goal]
        table[one] = np.minimum(table[one], np.minimum.reduceat(through, begins, axis=0))
        table[one, goal] = at_goal
    return table


def _stands(site: Site, weights: Array, worth: Array | None) -> Array:
    """Least weighted use of what is done at each visit less what it is worth, shape (loads, visits)."""
    order, which = site.order, site.order.loads[1]
    made = np.zeros((len(order.loads[0]), len(site.task.visits)))
    for _, visits, afters in order.steps:
        for load, visit in set(zip(which[afters].tolist(), visits.tolist(), strict=True)):
            made[load, visit] = (site.standing(1 + visit, float(order.loads[0][load])) @ weights).min()
            made[load, visit] -= 0.0 if worth is None else worth[visit]
    return made


def slack_of(tour: Tour, prices: Array) -> tuple[Array, Array]:
    """By how much the cheapest tour with prices on top that drives between two stops is above the cheapest of all.

    Without limits, and by docks where it likes. Gives an array of shape (loads, stops, stops): from, to; and the least
    weighted use up to each state and stop, shape (states, stops).
    """
    site, order, goal = tour.site, tour.site.order, tour.site.goal
    weights, worth = tour.priced(prices)
    apart, stands, after = _by_load(site, weights), _stands(site, weights, worth), rest_of(site, weights, worth)
    which = order.loads[1]
    docks = list(range(goal + 1, tour.size))
    found = np.full(apart.shape, math.inf)
    before = np.full_like(after, math.inf)
    before[0, 0] = 0.0

    def way(states: NDArray[np.intp], heads: NDArray[np.intp], rest: Array) -> Array:
        through = before[states] + apart[which[states], :, heads]
        ends = which[states][:, None], np.arange(tour.size)[None, :], heads[:, None]
        np.minimum.at(found, ends, through + rest[:, None])
        return np.asarray(through.min(axis=1))

    def leave(states: NDArray[np.intp]) -> None:
        for dock in docks:
            before[states, dock] = np.minimum(
                before[states, dock], way(states, np.full(len(states), dock), after[states, dock])
            )

    for states, visits, afters in reversed(order.steps):
        leave(np.unique(states))
        there = stands[which[afters], visits]
        best = way(states, 1 + visits, there + after[afters, 1 + visits])
        np.minimum.at(before, (afters, 1 + visits), best + there)
    ends = np.flatnonzero(order.ends)
    leave(ends)
    way(ends, np.full(len(ends), goal), np.zeros(len(ends)))
    return np.asarray(np.maximum(found - after[0, 0], 0.0)), before


def in_time(site: Site) -> NDArray[np.intp]:
    """States to end in for which some order keeps all windows and the deadline, driven as fast as can be."""
    order, which, visits = site.order, site.order.loads[1], site.task.visits
    seconds = np.eye(len(site.weights))[0]
    apart, stands = _by_load(site, seconds), _stands(site, seconds, None)
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


def _by_load(site: Site, weights: Array, straight: bool = False) -> Array:
    """`matrix` for each load that may come up, shape (loads, stops, stops)."""
    loads, which = site.order.loads
    used = {int(which[0])}
    for states, _, afters in site.order.steps:
        used |= {*which[states].tolist(), *which[afters].tolist()}
    made = np.full((len(loads), len(site.stops), len(site.stops)), math.inf)
    for load in used:
        made[load] = matrix(site, float(loads[load]), weights, straight=straight)
    return made


def to_docks(site: Site, weights: Array, served: NDArray[np.bool_]) -> Array:
    """Least weighted use from each state and stop to a dock that serves a battery, shape (states, stops)."""
    docks = [i for i, stop in enumerate(site.stops) if stop.charger is not None and served[i]]
    if not docks:
        return np.full((site.order.count, len(site.stops)), math.inf)
    found = _by_load(site, weights)[:, :, docks].min(axis=2)[site.order.loads[1]]
    found[:, site.goal] = math.inf  # the mission ends there
    return np.asarray(found)


def bounds_of(
    tour: Tour, multipliers: list[Array], uncharged: list[Array] | None = None, ahead: list[Array] | None = None
) -> Bounds:
    """What the search may know of the rest of each way.

    `multipliers` (shape (resources - 1,)): prices on all but the objective; the row of zeros is added. `uncharged`:
    prices for ways on which there is no more charging; then the others are for ways that lead by a dock. `ahead`:
    prices on top of the first multiplier's as far as the next dock, where each battery must last.
    """
    site = tour.site
    physics, task = site.physics, site.task
    count = len(physics.names)
    reserve = np.maximum(physics.reserve_wh, 0.0)
    most = tour.limits.copy()
    if site.windowed:
        most[1] = min(site.deadline_s, LONGEST_S)  # that windows end can be said of an end only
    most[2 : 2 + count] = site.usable_wh
    if any(charger is not None and charger.levels is None for charger in tour.chargers):
        # charged just as much as will do, a battery must not come out empty by rounding
        most[2 : 2 + count] -= HAIR * physics.capacity_wh
    # what must be left at the end beyond what must be left always
    reserve = np.maximum(reserve - (physics.capacity_wh - site.usable_wh), 0.0)
    least = np.zeros((tour.nodes, len(most)))
    unit = np.eye(1 + count)
    least[:, 1] = tour.over(rest_of(site, unit[0]))
    for b in range(count):
        to_end = tour.over(rest_of(site, unit[1 + b])) + reserve[b]
        served = np.array([charger is not None and bool(charger.served[b]) for charger in tour.chargers])
        least[:, 2 + b] = np.minimum(to_end, tour.over(to_docks(site, unit[1 + b], served), whole=False))
    least[~np.isfinite(least[:, 1]), 0] = math.inf
    if tour.counted and tour.values is not None:
        made = np.repeat(-site.order.left(tour.values)[:, None], tour.size, axis=1)
        made[:, site.goal] = 0.0
        least[:, -1] = made.ravel()
    for i, visit in enumerate(task.visits):
        if visit.window is not None and visit.window.until is not None:
            for state in range(site.order.count):
                node = state * tour.size + 1 + i
                stand = float(site.standing(1 + i, max(0.0, site.order.payload_kg(state)))[0, 0])
                least[node, 1] = max(least[node, 1], most[1] - visit.window.until.value - stand)
    rows: list[Array] = []
    rests: list[Array] = []
    offsets: list[float] = []
    zero = np.zeros(len(most) - 1)
    first = [] if uncharged is None else [zero, *uncharged]
    later = [(multiplier, None if uncharged is None else zero) for multiplier in [zero, *multipliers]]
    for multiplier, more in [*((m, None) for m in first), *later, *((multipliers[0], one) for one in ahead or ())]:
        on_top = zero if more is None else more
        priced, lasting = multiplier > 0.0, on_top > 0.0
        rows.append(np.concatenate([[1.0], multiplier + on_top]))
        rests.append(tour.over(tour.rest(multiplier, more, straight=len(rests) < len(first))))
        offsets.append(float(multiplier[priced] @ tour.limits[1:][priced] + on_top[lasting] @ most[1:][lasting]))
    shear = None
    if tour.latest > 0.0:
        shear = tour.waiting()
        shear[1] = 0.0
    apart = len(first) or None
    rest = np.stack(rests, axis=1)
    timeless = site.timeless
    return Bounds(
        most, least, np.array(rows), rest, np.array(offsets), shear, tour.latest, timeless=timeless, apart=apart
    )
