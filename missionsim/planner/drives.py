"""Drives from stop to stop: all ways that none is better than in time and every battery."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.physics import Array, Ints
from missionsim.planner.core import Bounds, Label, Leaving, chain_of, search
from missionsim.planner.pieces import Piece, Road


@dataclass(frozen=True, eq=False)
class Drive:
    """A way from a stop to another: seconds and Wh of each battery, its pieces, and those of each piece."""

    use: Array
    peak: Array
    """The most that has been drawn of each battery on the way, Wh."""
    pieces: tuple[Piece, ...] = ()
    costs: tuple[Array, ...] = ()


class _OnRoad:
    """A label is seconds, Wh of each battery, and of those that are given back to the most so far and the last drop."""

    def __init__(self, road: Road) -> None:
        count, width = len(road.states), road.use.shape[1]
        drop = road.peak - road.use[:, 1:]
        given = np.flatnonzero((road.peak - np.maximum(road.use[:, 1:], 0.0) > 1e-15).any(axis=0))
        self.size = width + 2 * len(given)
        self._of, self._most = 1 + given, slice(width, width + len(given))
        self._drop = slice(width + len(given), self.size)
        use = np.concatenate([road.use, np.zeros((len(drop), len(given))), drop[:, given]], axis=1)
        order = np.argsort(road.tails, kind="stable")
        begins = np.searchsorted(road.tails[order], np.arange(count + 1))
        self._leaving = []
        for node in range(count):
            arcs = order[begins[node] : begins[node + 1]]
            self._leaving.append(Leaving(road.heads[arcs], use[arcs], arcs.tolist()))

    def leaving(self, node: int) -> Leaving:
        return self._leaving[node]

    def refill(self, node: int) -> None:
        return None

    def opens(self, node: int) -> Callable[..., Array] | None:
        return self._top if len(self._of) else None

    def _top(self, points: Array, *, apart: bool = False) -> Array:
        made = points.copy()
        made[:, self._most] = np.maximum(made[:, self._most], made[:, self._of] + made[:, self._drop])
        made[:, self._drop] = 0.0
        return made


class Drives:
    """The drives of one road between some of its states."""

    def __init__(self, road: Road) -> None:
        self.road = road
        pairs = road.tails * len(road.states) + road.heads
        self._by_pair = np.argsort(pairs, kind="stable")
        self._pairs, self._begins, self._counts = np.unique(pairs[self._by_pair], return_index=True, return_counts=True)
        self._distances: dict[tuple[bytes, bytes, bool], Array] = {}

    def distances(self, weights: Array, nodes: Ints, *, back: bool = False) -> Array:
        """Least weighted use from nodes to every state, shape (nodes, states); with `back`, from every state to them.

        `weights` (shape (1 + batteries,)): of seconds and Wh; the weighted use may be negative on single arcs
        (downhill), not on circles.
        """
        key = (weights.tobytes(), nodes.tobytes(), back)
        if key not in self._distances:
            self._distances[key] = self._solve(weights, nodes, back=back)[0]
        return self._distances[key]

    def supported(self, weights: Sequence[Array], sources: Ints, targets: Ints) -> dict[tuple[int, int], list[Drive]]:
        """The drives of least weighted use by any of some weights, between all sources and targets."""
        found: dict[tuple[int, int], list[Drive]] = {}
        for row in weights:
            _, befores, chosen = self._solve(row, sources)
            for source, before in zip(sources.tolist(), befores, strict=True):
                for target in targets.tolist():
                    known = found.setdefault((source, target), [])
                    if source == target or before[target] < 0:
                        continue
                    arcs, here, size = [], target, len(self.road.states)
                    while here != source:
                        earlier = int(before[here])
                        arcs.append(int(chosen[np.searchsorted(self._pairs, earlier * size + here)]))
                        here = earlier
                    drive = self._drive(arcs[::-1])
                    if not any((other.use <= drive.use).all() for other in known):
                        known.append(drive)
        return found

    def _graph(self, cost: Array, back: bool) -> tuple[Any, Ints]:
        """The cheapest arc between any two states, as a graph; which arcs these are."""
        from scipy.sparse import csr_array

        road, cost = self.road, cost[self._by_pair]
        least = np.minimum.reduceat(cost, self._begins) if len(cost) else cost
        same = np.flatnonzero(cost == np.repeat(least, self._counts))
        first = same[np.searchsorted(same, self._begins)] if len(cost) else same
        chosen = self._by_pair[first]
        # csgraph takes a stored zero for no arc
        weight = np.where(least == 0.0, 1e-300, least)
        size = len(road.states)
        # csgraph reads indices of 32 bits only
        tails, heads = (ends[chosen].astype(np.int32) for ends in (road.tails, road.heads))
        return csr_array((weight, (heads, tails) if back else (tails, heads)), shape=(size, size)), chosen

    def _solve(self, weights: Array, nodes: Ints, *, back: bool = False) -> tuple[Array, Any, Any]:
        """Distances and predecessors by Dijkstra's method, on costs that potentials keep from being negative."""
        from scipy.sparse.csgraph import dijkstra

        height, road = self._potentials @ weights, self.road
        cost = np.maximum(road.use @ weights + height[road.tails] - height[road.heads], 0.0)
        graph, chosen = self._graph(cost, back)
        found, before = dijkstra(graph, indices=nodes, return_predecessors=True)
        step = height[None, :] - height[nodes][:, None]
        return found - step if back else found + step, before, chosen

    @cached_property
    def _potentials(self) -> Array:
        """For each state the least use of each resource on any way there, at most 0 (Johnson 1977)."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import NegativeCycleError, bellman_ford

        road = self.road
        size = len(road.states)
        made = np.zeros((size, road.use.shape[1]))
        for r in np.flatnonzero((road.use < 0.0).any(axis=0)):
            graph = self._graph(road.use[:, r], False)[0]
            ends = coo_array(graph).coords
            tails = np.append(ends[0], np.full(size, size)).astype(np.int32)
            heads = np.append(ends[1], np.arange(size)).astype(np.int32)
            whole = coo_array((np.append(graph.data, np.full(size, 1e-300)), (tails, heads)), shape=(size + 1,) * 2)
            try:
                made[:, r] = bellman_ford(whole.tocsr(), indices=size)[:size]
            except NegativeCycleError:
                import networkx as nx

                net = nx.from_scipy_sparse_array(graph, create_using=nx.DiGraph)
                for source in net:
                    with suppress(nx.NetworkXError):
                        states = nx.find_negative_cycle(net, source)
                        places = list(dict.fromkeys(road.states[state].place for state in states))
                        break
                told = "driving in a circle would charge a battery: the slopes of its edges do not close"
                allowed = "slopes by which a way round comes back to the height where it began"
                raise InputError.single(told, got=", ".join(places), allowed=allowed) from None
        return made

    @cached_property
    def _network(self) -> _OnRoad:
        return _OnRoad(self.road)

    def _drive(self, arcs: list[int]) -> Drive:
        road = self.road
        use = np.zeros(road.use.shape[1])
        peak = use[1:]
        for arc in arcs:  # in the order in which a label adds them up
            peak = np.maximum(peak, use[1:] + road.peak[arc])
            use = use + road.use[arc]
        return Drive(use, peak, tuple(road.driven[arc] for arc in arcs), tuple(road.use[arcs]))

    def between(
        self,
        source: int,
        targets: Ints,
        more: Array | None = None,
        *,
        weights: Array | None = None,
        gap: float = math.inf,
        latest_s: float = math.inf,
        timeless: bool = False,
        waiting: Array | None = None,
        until: float = math.inf,
        patience: int = 10**9,
    ) -> tuple[dict[int, list[Drive]], int]:
        """The undominated drives from a state to others.

        `targets`: states. `weights` (shape (1 + batteries,)): with `gap`: only drives whose weighted use is within
        `gap` of the least one's. `more` (shape (targets,)): what is added to the weighted use of all drives to each
        target. `latest_s`: no drive may take longer. `timeless`: a drive is not kept for being quicker; then `weights`
        has nothing for seconds. `waiting` (shape (1 + batteries,)): what an earlier drive may take by the second until
        the later one ends, but no longer than `until`. `patience`: labels after which the search ends. Gives target →
        drives, by weighted use, and the labels that this took; where those are more than `patience`, there may be more.
        """
        resources = self.road.use.shape[1]
        chosen = np.ones(resources) if weights is None else weights
        to_targets = self.distances(chosen, targets, back=True)
        start = to_targets[:, source]
        with np.errstate(invalid="ignore"):
            slack = np.where(np.isfinite(start)[:, None], to_targets - start[:, None], math.inf)
            slack += 0.0 if more is None else more[:, None]
        rest = slack.min(axis=0)
        limit = np.append(latest_s, np.full(resources - 1, math.inf))
        least = np.where(np.isfinite(rest), 0.0, math.inf)[:, None] * np.ones(resources)
        if latest_s < math.inf:
            least[:, 0] = np.maximum(least[:, 0], self.distances(np.eye(resources)[0], targets, back=True).min(axis=0))
        more_of = self._network.size - resources
        wide = partial(np.pad, pad_width=(0, more_of))
        bounds = Bounds(
            wide(limit, constant_values=math.inf),
            np.pad(least, ((0, 0), (0, more_of))),
            wide(chosen)[None],
            rest[:, None],
            np.zeros(1),
            wide(waiting) if waiting is not None and waiting.any() else None,
            until,
            clock=0,
            timeless=timeless,
        )
        wanted = set(targets.tolist())
        outcome = search(
            self._network,
            [Label(source, np.zeros((1, self._network.size)))],
            lambda node: node in wanted,
            bounds,
            best=gap,
            every_goal=True,
            most_labels=max(1, patience),
        )
        found: dict[int, list[Drive]] = {int(target): [] for target in targets}
        for label in outcome.runners_up:
            if label.parent is not None:
                found[label.node].append(self._drive([step.move for step in chain_of(label)[1:]]))
        return found, outcome.labels
