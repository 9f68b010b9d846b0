"""The solver: best-first label setting with dominance, resource limits, refills and Lagrangian bounds.

A label is a vector of resources spent so far, of which less is better: the objective first, then for instance time and
the charge missing in each battery. Refills (chargers) make some resources less again. Labels are taken in the order of
a lower bound on the whole way through them, so that the first one taken at a goal is optimal, and the bound of the
next is a bound on every plan (Desrochers and Soumis 1988 for the labels; Handler and Zang 1980 for bounds from
multipliers on resources; Froger et al. 2019 for labels that leave open how long was charged).
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from missionsim.physics import Array, Ints
from missionsim.planner.chains import EPSILON, Front, least_of_most, most_of_least, within

DOMINATED = 4
NARROW = 3
"""Width of the beam once it is to stop but has no plan yet."""


class Leaving(NamedTuple):
    """Arcs out of a node: heads, shape (n,), resources used, shape (n, resources), and what they stand for."""

    heads: Ints
    use: Array
    moves: Sequence[Any]
    peak: Array | None = None
    """The most that is used on the way, where that may be more than at its end. Shape (n, resources)."""


class Refill(Protocol):
    """What may be done at a node to have more of some resources again."""

    @property
    def obliged(self) -> bool:
        """Whether a way through the node has to do it: else it has no reason to stop there."""

    def options(self, x: Array) -> list[Array]:
        """Ways to refill from a vector: each a chain of vectors, shape (points, resources). Between the points of a
        chain everything between them may be had; a chain of one point is a level."""


class Network(Protocol):
    """A directed graph over whole numbers."""

    def leaving(self, node: int) -> Leaving:
        """Arcs out of a node."""

    def refill(self, node: int) -> Refill | None:
        """What may be refilled at a node."""

    def opens(self, node: int) -> Callable[..., Array] | None:
        """Waiting at a node: points of a chain (or, with ``apart=True``, points apart) before → after; or None."""


class Label:
    """A way to a node: its points (one, or a chain of them), where it came from and by what."""

    __slots__ = ("move", "node", "parent", "points", "ready")

    def __init__(self, node: int, points: Array, parent: Label | None = None, move: Any = None) -> None:
        self.node, self.points, self.parent, self.move = node, points, parent, move
        self.ready = True


@dataclass(frozen=True)
class Bounds:
    """What is known of the rest of the way from each node."""

    most: Array
    """Limit of each resource, at every node. Shape (resources,)."""
    least: Array
    """What the rest of the way takes at least of the limit; infinite where no goal can be reached. Shape (nodes,
    resources)."""
    weights: Array
    """Each row bounds the objective: ``x · weights + rest[node] - offset``. Shape (multipliers, resources)."""
    rest: Array
    """Shape (nodes, multipliers)."""
    offset: Array
    """Shape (multipliers,)."""
    shear: Array | None = None
    """What waiting for a unit of time takes of each: where labels may have to wait, an earlier one is no better than a
    later one by more than waiting would cost it. Shape (resources,)."""
    until: float = math.inf
    """Later than this nothing waits."""
    clock: int = 1
    """Which resource is time."""
    timeless: bool = False
    """Time counts for nothing where labels are compared."""
    apart: int | None = None
    """So many of the first rows bound the ways without, the others those with at least one more refill."""

    @cached_property
    def room(self) -> Array:
        """The most that labels may have used at each node, shape (nodes, resources)."""
        with np.errstate(invalid="ignore"):  # without a limit and without a way to a goal: nothing fits
            return np.asarray(self.most + EPSILON * (1.0 + np.abs(self.most)) - self.least)

    @cached_property
    def _without_time(self) -> Ints:
        return np.delete(np.arange(len(self.most)), self.clock)

    def sheared(self, points: Array) -> Array:
        """Vectors as they are compared."""
        if self.timeless:
            return np.asarray(points[:, self._without_time])
        return points if self.shear is None else points - np.minimum(points[:, [self.clock]], self.until) * self.shear

    def of(self, nodes: int | Ints, chains: Array, *, closely: bool = True) -> Array:
        """Lower bounds of the objective by way of any point of chains at nodes, shape (n,). `chains` (shape (points, n,
        resources)); without `closely` somewhat lower ones, sooner."""
        values = chains @ self.weights.T + self.rest[nodes] - self.offset
        apart = self.apart or 0
        groups = [slice(0, apart), slice(apart, None)] if apart else [slice(None)]
        if len(chains) == 1:
            least = [values[..., rows].max(axis=-1) for rows in groups]
        else:
            find = least_of_most if closely else most_of_least
            least = [find(values[:-1, ..., rows], values[1:, ..., rows]) for rows in groups]
        return np.asarray(np.min(least, axis=(0, 1)) if len(least) > 1 or len(chains) > 2 else least[0][0])


@dataclass
class Outcome:
    """What a search found."""

    label: Label | None = None
    """The best way to a goal."""
    objective: float = math.inf
    bound: float = -math.inf
    """Both: of that way, and below which no way is; equal where it is proved optimal."""
    labels: int = 0
    """How many were taken."""
    arcs: int = 0
    """How many arcs were looked at."""
    runners_up: list[Label] = field(default_factory=list)
    interrupted: bool = False


def search(
    network: Network,
    starts: Sequence[Label],
    goal: Callable[[int], bool],
    bounds: Bounds,
    *,
    best: float = math.inf,
    most_labels: int | None = None,
    watch: Callable[[Outcome, int], bool] | None = None,
    every_goal: bool = False,
) -> Outcome:
    """The best way to a goal, or with `every_goal` all ways to goals that none dominates, as `runners_up`.

    `goal`: whether a node is one. `best`: objective of a way that is known already; ways whose bound is not below it
    (with `every_goal`, from it on) are not followed. `most_labels`: stop after so many that none dominates, or
    `DOMINATED` times as many in all. `watch`: ``(outcome so far, labels waiting) -> stop?``, called now and then.
    """
    outcome = Outcome(objective=best)
    room = bounds.room
    fronts: dict[int, Front] = {}
    heap: list[tuple[float, float, int, Label]] = []
    serial = itertools.count()
    taken = 0

    def below() -> float:
        return best + EPSILON if every_goal else outcome.objective

    def push(label: Label) -> None:
        value = _settle(network, label, bounds, room)
        if value < below():
            heapq.heappush(heap, (value, float(label.points[0].sum()), next(serial), label))

    for label in starts:
        push(label)
    try:
        while heap:
            value, _, _, label = heapq.heappop(heap)
            outcome.bound = max(outcome.bound, value)
            if value >= outcome.objective and not every_goal:
                break
            if not label.ready:
                push(label)
                continue
            # whatever dominates a label has no larger bound, so that it was taken before
            compared = bounds.sheared(label.points)
            if label.node not in fronts:
                fronts[label.node] = Front(compared.shape[1])
            taken += 1
            if most_labels is not None and taken > DOMINATED * most_labels:
                outcome.labels = most_labels + 1
                return outcome
            if not fronts[label.node].add(compared):
                continue
            outcome.labels += 1
            if most_labels is not None and outcome.labels > most_labels:
                return outcome
            if watch is not None and outcome.labels % 64 == 0 and watch(outcome, len(heap)):
                outcome.interrupted = True
                return outcome
            if goal(label.node):
                outcome.runners_up.append(label)
                cost = float(label.points[:, 0].min())
                if cost < outcome.objective and not every_goal:
                    outcome.label, outcome.objective = label, cost
                if not every_goal:
                    continue
            refilled, values, make = expand(network, label, bounds, room)
            outcome.arcs += len(values)
            arcs = np.flatnonzero(values < below()).tolist()
            for value, new in itertools.chain(refilled, ((float(values[i]), make(i)) for i in arcs)):
                if value < below() and len(new.points):
                    heapq.heappush(heap, (value, float(new.points[0].sum()), next(serial), new))
    except KeyboardInterrupt:
        if every_goal:
            raise
        outcome.interrupted = True
        return outcome
    outcome.bound = outcome.objective if outcome.label is not None or math.isfinite(best) else math.inf
    return outcome


def quick(
    network: Network,
    starts: Sequence[Label],
    goal: Callable[[int], bool],
    bounds: Bounds,
    *,
    best: float = math.inf,
    watch: Callable[[Outcome, int], bool] | None = None,
    width: int = 60,
) -> Outcome:
    """A good way to a goal without proof: step by step the labels of least bound, so many of them (beam search).
    Parameters as those of `search`."""
    outcome = Outcome(objective=best)
    room = bounds.room
    layer = list(starts)
    fronts: dict[int, Front] = {}  # of all steps: a label that none was better than may still go round in circles
    try:
        while layer:
            made = [expand(network, label, bounds, room) for label in layer]
            ranked = [
                (value, -1 - k, new) for k, (value, new) in enumerate(r for refilled, _, _ in made for r in refilled)
            ]
            heapq.heapify(ranked)
            values = np.concatenate([each for _, each, _ in made])
            order = np.argsort(values, kind="stable").tolist()
            ends = np.cumsum([len(each) for _, each, _ in made])
            taken, layer = 0, []
            while len(layer) < width and (ranked or taken < len(order)):
                if ranked and (taken == len(order) or ranked[0][0] <= values[order[taken]]):
                    value, number, label = heapq.heappop(ranked)
                else:
                    value, number, taken = float(values[order[taken]]), order[taken], taken + 1
                    parent = int(np.searchsorted(ends, number, side="right"))
                    label = made[parent][2](number - int(ends[parent]))  # counted from the end
                if value >= outcome.objective:
                    break
                if not label.ready:
                    heapq.heappush(ranked, (_settle(network, label, bounds, room), number, label))
                elif goal(label.node):
                    outcome.label, outcome.objective = label, float(label.points[:, 0].min())
                else:
                    compared = bounds.sheared(label.points)
                    if fronts.setdefault(label.node, Front(compared.shape[1])).add(compared):
                        layer.append(label)
            outcome.labels += len(layer)
            if watch is not None and watch(outcome, len(layer)):
                outcome.interrupted = True
                if math.isfinite(outcome.objective):
                    break
                width = NARROW
    except KeyboardInterrupt:
        outcome.interrupted = True
    return outcome


def _settle(network: Network, label: Label, bounds: Bounds, room: Array) -> float:
    """Wait where a label has to, keep what of it is within the limits; its bound, infinite where nothing is."""
    label.ready = True
    wait = None if label.parent is None else network.opens(label.node)
    label.points = within(label.points if wait is None else wait(label.points), room[label.node])
    return float(bounds.of(label.node, label.points[:, None])[0]) if len(label.points) else math.inf


def expand(
    network: Network, label: Label, bounds: Bounds, room: Array
) -> tuple[list[tuple[float, Label]], Array, Callable[[int], Label]]:
    """What follows from a label: refilled, each with its bound; the bounds by way of arcs, and what makes their labels.
    Labels that may have to wait or to be cut are not ready yet."""
    refilled: list[tuple[float, Label]] = []
    node, points = label.node, label.points
    refill = network.refill(node)
    if refill is not None and not (isinstance(label.move, tuple) and label.move[0] == "refill"):
        for i, point in enumerate(points):
            for chain in refill.options(point):
                new = Label(node, chain, label, ("refill", i))
                refilled.append((_settle(network, new, bounds, room), new))
        if refill.obliged:
            return refilled, np.empty(0), lambda _: label
    leaving = network.leaving(node)
    heads, use = leaving.heads, leaving.use
    chains = points[:, None] + use
    after = chains[0] if len(points) == 1 else chains.min(axis=0)  # what no point of a chain is below
    fits = (after <= room[heads]).all(axis=1)
    highest = None if leaving.peak is None else bounds.most + EPSILON * (1.0 + np.abs(bounds.most)) - leaving.peak
    if highest is not None:
        fits &= (points.min(axis=0) <= highest).all(axis=1)
    if single := len(points) == 1:
        for head in np.unique(heads[fits]).tolist():
            wait = network.opens(head)
            if wait is not None:
                rows = np.flatnonzero(fits & (heads == head))
                after[rows] = wait(after[rows], apart=True)
                fits[rows] = (after[rows] <= room[head]).all(axis=1)
    picked = np.flatnonzero(fits)
    if single or any(network.opens(head) is not None for head in np.unique(heads[picked]).tolist()):
        chains = after[None]  # a chain that may have to wait is bounded by less than all of its points
    values = bounds.of(heads[picked], chains[:, picked], closely=False) if picked.size else np.empty(0)

    def make(number: int) -> Label:
        i = picked[number]
        if single:
            return Label(int(heads[i]), after[i : i + 1], label, leaving.moves[i])
        kept = points if highest is None else within(points, highest[i])
        new = Label(int(heads[i]), kept + use[i], label, leaving.moves[i])
        new.ready = False
        return new

    return refilled, values, make


def chain_of(label: Label) -> list[Label]:
    """The labels of a way, from its start."""
    found = [label]
    while found[-1].parent is not None:
        found.append(found[-1].parent)
    return found[::-1]
