"""Rounds and shifts: how many rounds, which way and how fast each, where and how long to charge between and on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array
from missionsim.planner.answer import Answer, answer_of
from missionsim.planner.bounds import Tour, bounds_of, matrix
from missionsim.planner.core import Label, Leaving, Outcome, quick, search
from missionsim.planner.drives import Drive
from missionsim.planner.dual import Prices, best_prices, cheapest
from missionsim.planner.large import orders
from missionsim.planner.orders import MOST_FREE, Order
from missionsim.planner.solve import FIRST_GAP, Fronts, Watch, charges_tried, solve_site
from missionsim.planner.tour import Site, make_site

MOST_ROUNDS = 1000
MOST_NODES = 400_000
"""Of all rounds; beyond it the visits are made in one order."""
LABELS = 800
"""Labels that the beam keeps at all rounds' ends together, and that a proof of few rounds may take for each."""
FEW = 4
"""Rounds up to which a proof among all drives is tried."""


class Rounds(Tour):
    """The network of one round so many times; each round's nodes and one where it sets out from its start.

    `drives`: as of `Tour`; `every_s`: no round sets out before so long after the one before was due.
    """

    def __init__(
        self, site: Site, drives: Callable[[float, int, int], list[Drive]], rounds: int, every_s: float
    ) -> None:
        super().__init__(site, drives)
        self.rounds, self.every_s = rounds, every_s
        self.latest = (rounds - 1) * every_s
        self._out = self.nodes
        self._each = self.nodes + self.size
        self.nodes = self._each * rounds
        self._home = [i for i, s in enumerate(site.stops) if s.charger is not None and s.place == site.task.start]
        self._all: dict[int, Leaving] = {}

    def at(self, node: int) -> tuple[int, int]:
        """State of the order and stop of a node."""
        inner = node % self._each
        return (0, 0) if inner == self._out else divmod(inner, self.size)

    def is_goal(self, node: int) -> bool:
        """Whether the last round ends here."""
        return node >= self.nodes - self._each and self.at(node)[1] == self.site.goal

    def leaving(self, node: int) -> Leaving:
        """Drives to all stops that may come next; from the end of a round the next one."""
        known = self._all.get(node)
        if known is None:
            number, inner = divmod(node, self._each)
            first = number * self._each
            if inner != self._out and self.at(node)[1] == self.site.goal:
                known = self._still([first + self._each] if number + 1 < self.rounds else [])
            elif inner == 0:
                known = self._still([first + dock for dock in (*self._home, self._out)])
            elif inner in self._home:
                known = self._still([first + self._out])
            else:
                one = super().leaving(0 if inner == self._out else inner)
                there = ~np.isin(one.heads, self._home) if inner == self._out else np.ones(len(one.heads), dtype=bool)
                moves = [move for move, kept in zip(one.moves, there, strict=True) if kept]
                peak = None if one.peak is None else one.peak[there]
                known = Leaving(one.heads[there] + first, one.use[there], moves, peak)
            self._all[node] = known
        return known

    def _still(self, heads: list[int]) -> Leaving:
        nothing, use = self.none, np.zeros((len(heads), len(self.first)))
        return Leaving(np.array(heads, dtype=np.intp), use, [(self.at(head)[1], nothing, use[0], 0) for head in heads])

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


@contextmanager
def _share(site: Site, rounds: int) -> Iterator[Site]:
    """One round with its share of the time and the charge of so many: what bounds it, bounds them all."""
    physics = site.physics
    kept = physics.initial_wh
    physics.initial_wh = physics.reserve_wh + (kept - physics.reserve_wh) / rounds
    try:
        yield replace(site, deadline_s=site.deadline_s / rounds)
    finally:
        physics.initial_wh = kept


def _prices(site: Site, rounds: int) -> Prices:
    with _share(site, rounds) as one:
        return best_prices(Tour(one, Fronts(one)))


def of_one_kind(task: TaskSpec) -> TaskSpec:
    """Without the visits that even a round of its own, on full batteries, has to leave out."""
    if not any(visit.value is not None for visit in task.visits):
        return task
    one = make_site(task)
    one.physics.initial_wh = one.physics.capacity_wh.copy()
    made = solve_site(one).order()
    kept = tuple(visit.model_copy(update={"value": None}) for visit in task.visits if visit.label in made)
    return task.model_copy(update={"visits": kept or task.visits})


def _drive(site: Site, rounds: int, every_s: float, prices: Prices, watch: Watch | None) -> Answer | None:
    """So many rounds of nearly the least objective; None where none were found."""
    bound = rounds * prices.bound
    gap = FIRST_GAP * max(abs(prices.bound), 1e-6)
    weights = site.weights + prices.best[: len(site.weights)]

    def told(outcome: Outcome, waiting: int) -> bool:
        return watch is not None and watch("rounds", outcome.objective, bound)

    tour = Rounds(site, Fronts(site, weights, gap), rounds, every_s)
    bounds = bounds_of(tour, [prices.best, *prices.others])
    start = Label(0, tour.first[None, :])
    best, objective, lower, stopped = None, math.inf, bound, False
    # soon a plan, then a good one; of many visits each label has many to follow it
    wide = LABELS // rounds // max(1, len(site.task.visits) ** 2 // 9)
    for width, ask in ((3, None), (max(4, min(300, wide)), told)):
        if not stopped:
            outcome = quick(tour, [start], tour.is_goal, bounds, best=objective, watch=ask, width=width)
            best, objective, stopped = outcome.label or best, outcome.objective, outcome.interrupted
    if best is not None and rounds <= FEW and not stopped:
        gap = max(gap, objective - bound)
        drives = Fronts(site, weights, gap)
        wider = Rounds(site, drives, rounds, every_s)
        proof = search(wider, [start], wider.is_goal, bounds, best=objective, watch=told, most_labels=LABELS * rounds)
        if drives.complete and not charges_tried(tour):
            lower = max(bound, min(proof.bound, bound + gap))
        stopped = proof.interrupted
        if proof.label is not None:
            best, objective = proof.label, proof.objective
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

    def possible(rounds: int) -> bool:
        known[rounds] = _prices(site, rounds)
        return not known[rounds].impossible and (rounds - 1) * every < site.deadline_s

    low, high = 0, asked
    while low < high:
        middle = asked if high == asked and not many and low == 0 and not known else (low + high + 1) // 2
        low, high = (middle, high) if possible(middle) else (low, middle - 1)
    at_most, fixed = low, False
    if at_most and site.order.sequence is None and site.order.count * len(site.stops) * at_most > MOST_NODES:
        with _share(site, at_most) as one:
            steps = cheapest(Tour(one, Fronts(one)), known[at_most].best)
        assert steps is not None
        sequence = tuple(head - 1 for head, _ in steps[0] if head != site.goal)
        site, fixed = replace(site, order=Order(site.task, sequence)), True
    # down from the most there can be in growing steps, then up again between what was found and what was not
    best: Answer | None = None
    below, above, step = 0, at_most + 1, 1
    while above - below > 1:
        rounds = max(above - step, 1) if best is None else (below + above) // 2
        made = _drive(site, rounds, every, known.get(rounds) or _prices(site, rounds), watch)
        if made is not None and made.stopped:
            best = made if made.feasible else best or made
            break
        if made is None:
            above, step = rounds, 2 * step
        else:
            below, best = rounds, made
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
    made = _drive(longer, asked, every, _prices(longer, asked), watch) if math.isfinite(site.deadline_s) else None
    if made is not None and made.feasible:
        text = f"an end {(made.duration_s - site.deadline_s) / 60.0:.1f} min later"
        would_do.append({"change": "repeat.until", "to": made.duration_s, "unit": "s", "text": text})
    return Answer(site, False, notes=[note + charged], extra={"rounds": done, "would_do": would_do})
