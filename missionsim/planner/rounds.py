"""Rounds and shifts: how many rounds, which way and how fast each, where and how long to charge between and on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import Prices, best_prices, bounds_of, cheapest, matrix, rest_of, slack_of
from missionsim.planner.core import Label, Leaving, Outcome, chain_of, quick, search
from missionsim.planner.drives import Drives
from missionsim.planner.pieces import Road, State
from missionsim.planner.site import MOST_FREE, Order, Site, make_site
from missionsim.planner.solve import FIRST_GAP, Watch, charges_tried, orders, solve_site
from missionsim.planner.tour import PATIENCE, Fronts, Tour

MOST_ROUNDS = 1000
MOST_NODES = 400_000
"""Of all rounds; beyond it the visits are made in one order."""
LABELS = 800
"""Labels that the beam keeps at all rounds' ends together, and that a proof of few rounds may take for each."""
SOON = 500
"""Labels after which the search for the arcs of a node ends, for the first search for rounds."""
FEW_HEADS = 60
"""Heads of each node in the first search for rounds."""
MOST_STOPS = 4000
"""States with a stop that it goes through, those of the least rounds."""
NEAR = 1e-4
"""Gap that is not worth more labels."""
FEW, FAR = 4, 0.05
"""Rounds, and relative gap, up to which a proof among all drives is tried."""


class Ways(Tour):
    """Arcs of one round: each from where the robot has charged (or sets out) to where it charges next, or to the end.

    All visits between are made on it, in the best order. `weights` (shape (1 + batteries,)): of seconds and Wh. `gap`:
    of the arcs between two nodes only those whose weighted use is within this of the least one's. `few`: so many heads
    of each node only, by what a round through them takes least; else all whose rounds are within the gap.
    """

    def __init__(self, site: Site, weights: Array, gap: float, few: int | None = None) -> None:
        super().__init__(site, Fronts(site, weights, gap))
        self.weights, self.gap, self.few = weights, gap, few
        self.complete = True
        """Whether no search for arcs had to end before it had all."""
        self._before = slack_of(self, weights - site.weights)[1].ravel()
        self._rest = rest_of(site, weights).ravel()

    def _make(self, node: int) -> Leaving:
        """The arcs from a node (state and stop, as of the tour) that the robot sets out from or has charged at."""
        (drives, index), site = self._road, self.site
        source = index[~node]
        ends = {number: inner for inner, number in index.items() if inner >= 0 and self._ends(inner)}
        found = drives.distances(self.weights, np.array([source]))[0]
        targets = np.array([number for number in ends if np.isfinite(found[number])], dtype=np.intp)
        whole = found[targets] + self._rest[[ends[number] for number in targets.tolist()]]
        more: Array | None = np.maximum(self._before[node] + whole - self._rest[0], 0.0)
        if self.few is not None:
            targets, more = targets[np.argsort(whole, kind="stable")[: self.few]], None
        elif more is not None:
            targets, more = targets[more <= self.gap], more[more <= self.gap]
        if not len(targets):
            return self.arcs([])
        ways, taken = drives.between(
            source,
            targets,
            more,
            weights=self.weights,
            gap=self.gap,
            timeless=site.timeless,
            waiting=site.shear,
            until=self.latest,
            patience=PATIENCE if self.few is None else SOON,
        )
        self.complete &= taken <= PATIENCE
        return self.arcs((ends[head], way, self.vector(way.use), 0) for head, some in ways.items() for way in some)

    def _ends(self, node: int) -> bool:
        return node % self.size >= self.site.goal

    @cached_property
    def _road(self) -> tuple[Drives, dict[int, int]]:
        """All drives of a round as a road, and the numbers of its nodes; of ``~node`` where it is left."""
        whole = np.sort(self._before + self._rest)
        few = math.inf if self.few is None or len(whole) <= MOST_STOPS else whole[MOST_STOPS]
        reach = self._rest[0] + self.gap if self.few is None else few
        index, waiting = {~0: 0}, [~0]
        ends: list[tuple[int, int]] = []
        moves: list[tuple[int, Any]] = []
        while waiting:
            here = waiting.pop()
            node = max(here, ~here)
            arcs = super()._make(node)
            through = self._before[node] + arcs.use[:, 1:] @ self.weights + self._rest[arcs.heads]
            for i in np.flatnonzero(through <= reach).tolist():
                head = int(arcs.heads[i])
                if head not in index:
                    index[head] = len(index)
                    if not self._ends(head):
                        waiting.append(head)
                    elif head % self.size > self.site.goal:
                        index[~head] = len(index)
                        waiting.append(~head)
                ends.append((index[here], index[head]))
                moves.append((head, arcs.moves[i]))
        tails, heads = np.array(ends, dtype=np.intp).reshape(-1, 2).T
        use = np.array([move[2][1:] for _, move in moves]).reshape(len(moves), len(self.weights))
        drawn = np.array([move[1].peak for _, move in moves]).reshape(len(moves), -1)
        states = [State(self.site.stops[max(node, ~node) % self.size].place) for node in index]
        return Drives(Road(states, tails, heads, use, np.maximum(drawn, np.maximum(use[:, 1:], 0.0)), moves)), index


class Rounds(Tour):
    """The network of one round so many times; each round's nodes and one where it sets out from its start.

    `ways`: arcs of one round; `every_s`: no round sets out before so long after the one before was due.
    """

    def __init__(self, ways: Ways, rounds: int, every_s: float) -> None:
        super().__init__(ways.site, ways.drives)
        self.ways, self.rounds, self.every_s = ways, rounds, every_s
        self.latest = (rounds - 1) * every_s
        self._out = self.nodes
        self._each = self.nodes + self.size
        self.nodes = self._each * rounds
        stops, start = self.site.stops, self.site.task.start
        self._home = [i for i, stop in enumerate(stops) if stop.charger is not None and stop.place == start]

    def at(self, node: int) -> tuple[int, int]:
        """State of the order and stop of a node."""
        inner = node % self._each
        return (0, 0) if inner == self._out else divmod(inner, self.size)

    def is_goal(self, node: int) -> bool:
        """Whether the last round ends here."""
        return node >= self.nodes - self._each and self.at(node)[1] == self.site.goal

    def _make(self, node: int) -> Leaving:
        """Ways to all docks that may come next, and to the end of the round; from there the next one."""
        number, inner = divmod(node, self._each)
        first, last = number * self._each, number + 1 == self.rounds
        heads: list[int] | None = None
        if inner == 0 or (inner != self._out and inner % self.size == self.site.goal):
            # charged at home as much as it likes or sets out, unless that was the last round
            begin = first + self._each if inner else first
            heads = [] if inner and last else [*(begin + dock for dock in self._home), begin + self._out]
        elif inner in self._home and self.every_s > 0.0:
            heads = [first + self._out]
        if heads is not None:
            return self.arcs((head, self.none, np.zeros(len(self.first)), 0) for head in heads)
        one = self.ways.leaving(0 if inner in (self._out, *self._home) else inner)
        # before the first visit and after the last one it charges between the rounds
        state, stop = np.divmod(one.heads, self.size)
        idle = (inner in (self._out, *self._home)) & (state == 0) | (self.site.order.ends[state] & (not last))
        there = ~(np.isin(stop, self._home) & idle)
        moves = [move for move, kept in zip(one.moves, there, strict=True) if kept]
        return Leaving(one.heads[there] + first, one.use[there], moves, None if one.peak is None else one.peak[there])

    def each(self, label: Label) -> Label:
        """The same way, stop by stop."""
        made, *steps = chain_of(label)
        for step in steps:
            points, first = made.points, step.node - step.node % self._each
            inner = () if step.move[0] == "refill" else step.move[1].pieces
            for node, move in inner[:-1]:
                points = points + move[2]
                made = Label(first + node, points, made, move)
            made = Label(step.node, step.points, made, inner[-1][1] if inner else step.move)
        return made

    def opens(self, node: int) -> Callable[..., Array] | None:
        """Waiting until a round is due."""
        number, inner = divmod(node, self._each)
        return self.until(number * self.every_s) if self.every_s > 0.0 and number and inner == self._out else None

    def over(self, table: Array, whole: bool = True) -> Array:
        """A table of one round, shape (states, stops), for the nodes of all; with what the `whole` rest adds."""
        count = table.shape[0]
        each = np.full((self.rounds, count + 1, self.size), math.inf)
        each[:, :count] = table
        each[:, count, 0] = table[0, 0]
        if whole:
            each += np.arange(self.rounds - 1, -1, -1)[:, None, None] * table[0, 0]
        else:
            each[:-1, :count, self.site.goal] = table[0, 0]
        return each.ravel()


def _share(site: Site, rounds: int) -> Site:
    """One round with its share of the time and the charge of so many: what bounds it, bounds them all."""
    physics = site.physics
    share = physics.reserve_wh + (physics.initial_wh - physics.reserve_wh) / rounds
    return replace(site, physics=physics.but(initial_wh=share), deadline_s=site.deadline_s / rounds)


def _prices(site: Site, rounds: int) -> Prices:
    one = _share(site, rounds)
    return best_prices(Tour(one, Fronts(one)))


def of_one_kind(task: TaskSpec) -> TaskSpec:
    """Without the visits that even a round of its own, on full batteries, has to leave out."""
    if not any(visit.value is not None for visit in task.visits):
        return task
    one = make_site(task)
    full = one.physics.but(initial_wh=one.physics.capacity_wh)
    made = solve_site(replace(one, physics=full)).order()
    kept = tuple(visit.model_copy(update={"value": None}) for visit in task.visits if visit.label in made)
    return task.model_copy(update={"visits": kept or task.visits})


def _ways(site: Site, prices: Prices, gap: float, few: int | None = None) -> Ways:
    return Ways(site, site.weights + prices.best[: len(site.weights)], gap, few)


def _drive(
    site: Site, rounds: int, every_s: float, prices: Prices, ways: Ways, watch: Watch | None, *, soon: bool
) -> Answer | None:
    """So many rounds of nearly the least objective; None where none were found. `soon`: by few labels."""
    bound = rounds * prices.bound

    def told(outcome: Outcome, waiting: int) -> bool:
        return watch is not None and watch("rounds", outcome.objective, bound)

    tour = Rounds(ways, rounds, every_s)
    bounds = bounds_of(tour, [prices.best, *prices.others])
    start = Label(0, tour.first[None, :])
    best, objective, lower, stopped = None, math.inf, bound, False
    wide = max(4, min(300, LABELS // rounds))
    for width, ask in ((3, None), (wide // 3, told)) if soon else ((wide, told),):
        if not stopped and best is None:
            outcome = quick(tour, [start], tour.is_goal, bounds, watch=ask, width=width)
            objective, stopped = outcome.objective, outcome.interrupted
            best = outcome.label and tour.each(outcome.label)
    near = objective - bound <= FAR * abs(bound)
    if best is not None and rounds <= FEW and near and not stopped and not soon:
        gap = max(ways.gap, objective - bound)
        wider = Rounds(_ways(site, prices, gap), rounds, every_s)
        proof = search(wider, [start], wider.is_goal, bounds, best=objective, watch=told, most_labels=LABELS * rounds)
        if wider.ways.complete and wider.ways.drives.complete and not charges_tried(tour):
            lower = max(bound, min(proof.bound, bound + gap))
        stopped = proof.interrupted
        if proof.label is not None:
            best, objective = wider.each(proof.label), proof.objective
    if best is None:
        return Answer(site, False, stopped=True) if stopped else None
    answer = answer_of(tour, best, objective, min(lower, objective))
    answer.extra["rounds"] = rounds
    answer.extra["assumed"] = []
    answer.stopped = stopped
    return answer


def plan_rounds(site: Site, watch: Watch | None = None) -> Answer:
    """As many rounds as asked for, or as can be, with the least objective among those."""
    repeat = site.task.repeat
    assert repeat is not None
    every = 0.0 if repeat.every is None else repeat.every.value
    many = repeat.rounds == "as_often_as_possible"
    asked = MOST_ROUNDS if repeat.rounds == "as_often_as_possible" else repeat.rounds
    if site.order.sequence is None and len(site.task.visits) > MOST_FREE:
        found = orders(site, matrix(site, site.order.load_kg, site.weights))
        site = replace(site, order=Order(site.task, found[0]))
    known: dict[int, Prices] = {}
    low, high = 0, asked
    while low < high:
        middle = asked if high == asked and not many and low == 0 and not known else (low + high + 1) // 2
        known[middle] = _prices(site, middle)
        possible = not known[middle].impossible and (middle - 1) * every < site.deadline_s
        low, high = (middle, high) if possible else (low, middle - 1)
    at_most, fixed = low, False
    if at_most and site.order.sequence is None and site.order.count * len(site.stops) * at_most > MOST_NODES:
        one = _share(site, at_most)
        steps = cheapest(Tour(one, Fronts(one)), known[at_most].best)
        assert steps is not None
        sequence = tuple(head - 1 for head, _ in steps[0] if head != site.goal)
        site, fixed = replace(site, order=Order(site.task, sequence)), True
    if at_most:
        priced = known.get(at_most) or _prices(site, at_most)
        ways = _ways(site, priced, FIRST_GAP * max(abs(priced.bound), 1e-6), FEW_HEADS)
    best: Answer | None = None

    def look(rounds: int, *, soon: bool) -> bool:
        """Whether so many rounds were found; the best so far is kept, told to be stopped where the search was."""
        nonlocal best
        made = _drive(site, rounds, every, known.get(rounds) or _prices(site, rounds), ways, watch, soon=soon)
        if made is None:
            return False
        same = best is not None and best.extra["rounds"] == rounds and best.objective <= made.objective
        if best is None or (made.feasible and not same):
            best = made
        elif made.stopped or made.bound > best.bound:
            best.stopped, best.bound = made.stopped, max(best.bound, made.bound)
        return made.feasible and not made.stopped

    # down from the most there can be in growing steps, then up again between what was found and what was not
    below, above, step = 0, at_most + 1, 1
    while above - below > 1 and not (best is not None and best.stopped):
        rounds = max(above - step, 1) if best is None else (below + above) // 2
        if look(rounds, soon=True):
            below = rounds
        else:
            above, step = rounds, 2 * step
    # with more labels one round more, as long as that is found; else the same rounds for less
    for rounds in range(below + 1, at_most + 1):
        if (best is not None and best.stopped) or not look(rounds, soon=False):
            break
    if best is not None and not best.stopped and best.extra["rounds"] == below and best.gap > NEAR:
        look(below, soon=False)
    if best is None or not best.feasible:
        early = "the search was stopped before it found a plan; there may be one"
        note = early if best is not None else "not even one round can be done within the time and the charge"
        return Answer(site, False, notes=[note], extra={"explained": best is not None}, stopped=best is not None)
    done = best.extra["rounds"]
    if fixed:
        best.extra["assumed"].append("in one order of the visits")
    if many:
        best.extra["rounds_at_most"] = at_most
        return best
    if done == asked:
        return best
    note = f"{asked} rounds cannot be done within the time and the charge, {done} can"
    if at_most == asked:
        note = f"no plan of {asked} rounds was found, one of {done} was"
    charged = "" if site.task.docks else "; no dock may be used (choose: docks)"
    would_do = [{"change": "repeat.rounds", "to": done, "unit": "", "text": f"{done} rounds"}]
    longer = replace(site, deadline_s=math.inf)
    made = None
    if math.isfinite(site.deadline_s):
        priced = _prices(longer, asked)
        wider = _ways(longer, priced, ways.gap, FEW_HEADS)
        made = _drive(longer, asked, every, priced, wider, watch, soon=True)
    if made is not None and made.feasible:
        text = f"an end {(made.duration_s - site.deadline_s) / 60.0:.1f} min later"
        would_do.append({"change": "repeat.until", "to": made.duration_s, "unit": "s", "text": text})
    return Answer(site, False, notes=[note + charged], extra={"rounds": done, "would_do": would_do})
