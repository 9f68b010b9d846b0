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
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
EPSILON = 1e-10
"""Resources that differ by less (relative to 1 or their size) are taken as equal."""


class Leaving(NamedTuple):
    """Arcs out of a node: heads, shape (n,), resources used, shape (n, resources), and what they stand for."""

    heads: NDArray[np.intp]
    use: Array
    moves: Sequence[Any]


class Refill(Protocol):
    """What may be done at a node to have more of some resources again."""

    def options(self, x: Array) -> list[Array]:
        """Ways to refill from a vector: each a chain of vectors, shape (points, resources).

        Between the points of a chain everything between them may be had; a chain of one point is a level.
        """
        ...


class Network(Protocol):
    """A directed graph over whole numbers."""

    def leaving(self, node: int) -> Leaving:
        """Arcs out of a node."""
        ...

    def refill(self, node: int) -> Refill | None:
        """What may be refilled at a node."""
        ...

    def opens(self, node: int) -> Callable[[Array], Array] | None:
        """Waiting at a node: points of a chain before → after; None where there is none."""
        ...


class Label:
    """A way to a node: its points (one, or a chain of them), where it came from and by what."""

    __slots__ = ("alive", "move", "node", "parent", "points")

    def __init__(self, node: int, points: Array, parent: Label | None = None, move: Any = None) -> None:
        self.node, self.points, self.parent, self.move = node, points, parent, move
        self.alive = True


@dataclass(frozen=True)
class Bounds:
    """What is known of the rest of the way from each node.

    Attributes
    ----------
    most : ndarray, shape (resources,)
        Limit of each resource, at every node.
    least : ndarray, shape (nodes, resources)
        What the rest of the way takes at least of the limit; infinite where no goal can be reached.
    weights : ndarray, shape (multipliers, resources)
        Each row bounds the objective: ``x · weights + rest[node] - offset``.
    rest : ndarray, shape (nodes, multipliers)
    offset : ndarray, shape (multipliers,)
    shear : ndarray, shape (resources,), optional
        What waiting for a unit of the second resource takes of each: where labels may have to wait, an earlier one is
        no better than a later one by more than waiting would cost it.
    """

    most: Array
    least: Array
    weights: Array
    rest: Array
    offset: Array
    shear: Array | None = None

    def sheared(self, points: Array) -> Array:
        """Vectors as they are compared."""
        return points if self.shear is None else points - points[:, 1:2] * self.shear

    def of(self, nodes: Any, x: Array) -> Array:
        """Lower bounds of the objective by way of vectors ``x`` at nodes, shape (n,)."""
        return np.asarray((x @ self.weights.T + self.rest[nodes] - self.offset).max(axis=-1))


@dataclass
class Outcome:
    """What a search found.

    Attributes
    ----------
    label : Label or None
        The best way to a goal.
    objective, bound : float
        Of that way, and below which no way is; equal where it is proved optimal.
    labels : int
        How many were taken.
    """

    label: Label | None = None
    objective: float = math.inf
    bound: float = -math.inf
    labels: int = 0
    runners_up: list[Label] = field(default_factory=list)
    interrupted: bool = False


class _Front:
    """The labels of one node that none of the others dominates."""

    __slots__ = ("chains", "count", "labels", "values")

    def __init__(self, resources: int) -> None:
        self.values = np.empty((8, resources))
        self.labels: list[Label] = []
        self.count = 0
        self.chains: list[tuple[Label, Array]] = []

    def add(self, label: Label, points: Array) -> bool:
        """Add a label unless it is dominated, and drop those that it dominates; `points` are what is compared."""
        single = len(points) == 1
        if self.count:
            known = self.values[: self.count]
            if single:
                if (known <= points[0] + EPSILON * (1.0 + np.abs(points[0]))).all(axis=1).any():
                    return False
            elif all((known <= point + EPSILON * (1.0 + np.abs(point))).all(axis=1).any() for point in points):
                return False
        if self.chains and any(_chain_dominates(chain, points) for _, chain in self.chains):
            return False
        if self.chains:
            kept = []
            for other, chain in self.chains:
                if (points[0] <= chain + EPSILON).all() or (not single and _chain_dominates(points, chain)):
                    other.alive = False
                else:
                    kept.append((other, chain))
            self.chains = kept
        if not single:
            self.chains.append((label, points))
            return True
        known = self.values[: self.count]
        beaten = (points[0] <= known).all(axis=1)
        if beaten.any():
            stay = np.flatnonzero(~beaten)
            for i in np.flatnonzero(beaten):
                self.labels[i].alive = False
            self.values[: stay.size] = known[stay]
            self.labels = [self.labels[i] for i in stay]
            self.count = int(stay.size)
        if self.count == len(self.values):
            self.values = np.concatenate([self.values, np.empty_like(self.values)])
        self.values[self.count] = points[0]
        self.labels.append(label)
        self.count += 1
        return True


def _chain_dominates(chain: Array, points: Array) -> bool:
    """Whether every point is dominated by one on the chain: what a chain dominates is convex, so points suffice."""
    if len(chain) == 1:
        return bool((chain[0] <= points + EPSILON).all())
    for point in points:
        limit = point + EPSILON * (1.0 + np.abs(point))
        for first, second in itertools.pairwise(chain):
            low, high = 0.0, 1.0
            step = second - first
            for a, b, most in zip(first.tolist(), step.tolist(), limit.tolist(), strict=True):
                if b > 0.0:
                    high = min(high, (most - a) / b)
                elif b < 0.0:
                    low = max(low, (most - a) / b)
                elif a > most:
                    high = -1.0
            if low <= high:
                break
        else:
            return False
    return True


def within(points: Array, limit: Array) -> Array:
    """The part of a chain of points that keeps to limits, shape (m, resources); empty where none does."""
    if len(points) == 1:
        return points if bool((points[0] <= limit).all()) else points[:0]
    if bool((points <= limit).all()):
        return points
    kept: list[Array] = []
    for first, second in itertools.pairwise(points):
        step = second - first
        low, high = 0.0, 1.0
        for a, b, most in zip(first.tolist(), step.tolist(), limit.tolist(), strict=True):
            if b > 0.0:
                high = min(high, (most - a) / b)
            elif b < 0.0:
                low = max(low, (most - a) / b)
            elif a > most:
                high = -1.0
        if low <= high:
            for share in (low, high):
                point = np.minimum(first + share * step, np.maximum(limit, first))
                if not kept or np.abs(point - kept[-1]).max() > 1e-12:
                    kept.append(point)
    return np.array(kept).reshape(len(kept), points.shape[1])


def search(
    network: Network,
    starts: Sequence[Label],
    goal: Callable[[int], bool],
    bounds: Bounds,
    *,
    best: float = math.inf,
    gap: float = 0.0,
    close: float = 0.0,
    most_labels: int | None = None,
    watch: Callable[[Outcome, int], bool] | None = None,
    every_goal: bool = False,
) -> Outcome:
    """The best way to a goal, or with `every_goal` all ways to goals that none dominates.

    Parameters
    ----------
    network : Network
    starts : sequence of Label
    goal : callable
        Whether a node is one.
    bounds : Bounds
    best : float
        Objective of a way that is known already; ways whose bound is not below it are not followed.
        With `every_goal`, the bound from which on ways are left out.
    gap : float
        Stop as soon as the best way is proved to be within this of the optimum.
    close : float
        Stop as soon as the bound has come so near to the best way.
    most_labels : int, optional
        Stop after so many labels.
    watch : callable, optional
        ``(outcome so far, labels waiting) -> stop?``, called now and then.
    every_goal : bool
        Go on after the first goal and collect all that are not dominated in `runners_up`.

    Returns
    -------
    Outcome
    """
    limit = bounds.most
    fronts: dict[int, _Front] = {}
    outcome = Outcome(objective=best)
    slack = limit + EPSILON * (1.0 + np.abs(limit))
    heap: list[tuple[float, int, Label]] = []
    serial = 0

    def push(label: Label) -> None:
        nonlocal serial
        label.points = within(label.points, slack - bounds.least[label.node])
        if not len(label.points):
            return
        value = float(bounds.of(label.node, label.points).min())
        if value >= (best + EPSILON if every_goal else outcome.objective - gap):
            return
        front = fronts.get(label.node)
        if front is None:
            front = fronts[label.node] = _Front(label.points.shape[1])
        if front.add(label, bounds.sheared(label.points)):
            serial += 1
            heapq.heappush(heap, (value, serial, label))

    for label in starts:
        push(label)
    try:
        while heap:
            value, _, label = heapq.heappop(heap)
            if not label.alive:
                continue
            outcome.bound = max(outcome.bound, value)
            if value >= outcome.objective - max(gap, close) and not every_goal:
                if outcome.label is not None and value < outcome.objective - gap:
                    return outcome
                break
            outcome.labels += 1
            if most_labels is not None and outcome.labels > most_labels:
                return outcome
            if watch is not None and outcome.labels % 256 == 0 and watch(outcome, len(heap)):
                return outcome
            node = label.node
            if goal(node):
                outcome.runners_up.append(label)
                cost = float(label.points[:, 0].min())
                if cost < outcome.objective and not every_goal:
                    outcome.label, outcome.objective = label, cost
                if not every_goal:
                    continue
            _expand(network, label, bounds, slack, best + EPSILON if every_goal else outcome.objective - gap, push)
    except KeyboardInterrupt:
        if outcome.label is None or every_goal:
            raise
        outcome.interrupted = True
        return outcome
    outcome.bound = outcome.objective if outcome.label is not None or math.isfinite(best) else math.inf
    return outcome


def _expand(
    network: Network, label: Label, bounds: Bounds, slack: Array, best: float, push: Callable[[Label], None]
) -> None:
    node, points = label.node, label.points
    refill = network.refill(node)
    if refill is not None and not (isinstance(label.move, tuple) and label.move[0] == "refill"):
        for i, point in enumerate(points):
            for chain in refill.options(point):
                push(Label(node, chain, label, ("refill", i)))
    leaving = network.leaving(node)
    heads, use = leaving.heads, leaving.use
    if not len(heads):
        return
    if len(points) == 1:
        after = points[0] + use
        fits = (after <= slack - bounds.least[heads]).all(axis=1)
        picked = np.flatnonzero(fits)
        if picked.size:
            picked = picked[bounds.of(heads[picked], after[picked]) < best]
        for i in picked.tolist():
            head = int(heads[i])
            moved = after[i : i + 1]
            wait = network.opens(head)
            push(Label(head, moved if wait is None else wait(moved), label, leaving.moves[i]))
        return
    for k, there in enumerate(heads.tolist()):
        moved = points + use[k]
        wait = network.opens(there)
        push(Label(there, moved if wait is None else wait(moved), label, leaving.moves[k]))


def chain_of(label: Label) -> list[Label]:
    """The labels of a way, from its start."""
    found = [label]
    while found[-1].parent is not None:
        found.append(found[-1].parent)
    return found[::-1]


def plain_bounds(nodes: int, most: Array) -> Bounds:
    """Bounds that know nothing of the rest of the way."""
    resources = len(most)
    weights = np.zeros((1, resources))
    weights[0, 0] = 1.0
    return Bounds(most, np.zeros((nodes, resources)), weights, np.zeros((nodes, 1)), np.zeros(1))
