"""Drives from stop to stop: all ways that none is better than in time and every battery."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.planner.core import Bounds, Label, Leaving, chain_of, search
from missionsim.planner.pieces import Piece, Road

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drive:
    """A way from a stop to another: seconds and Wh of each battery, its pieces, and those of each piece."""

    use: Array
    pieces: tuple[Piece, ...] = ()
    costs: tuple[Array, ...] = ()


class _OnRoad:
    def __init__(self, road: Road) -> None:
        count = len(road.states)
        order = np.argsort(road.tails, kind="stable")
        begins = np.searchsorted(road.tails[order], np.arange(count + 1))
        self._leaving = []
        for node in range(count):
            arcs = order[begins[node] : begins[node + 1]]
            self._leaving.append(Leaving(road.heads[arcs], road.use[arcs], arcs.tolist()))

    def leaving(self, node: int) -> Leaving:
        return self._leaving[node]

    def refill(self, node: int) -> None:
        return None

    def opens(self, node: int) -> None:
        return None


class Drives:
    """The drives of one road between some of its states.

    Parameters
    ----------
    road : Road

    Attributes
    ----------
    complete : bool
        False as soon as a search had to stop before it had all drives.
    """

    def __init__(self, road: Road) -> None:
        self.road = road
        self._network = _OnRoad(road)
        self.complete = True

    def distances(self, weights: Array, nodes: NDArray[np.intp], *, back: bool = False) -> Array:
        """Least weighted use from nodes to every state, shape (nodes, states); with `back`, from every state to them.

        Parameters
        ----------
        weights : ndarray, shape (1 + batteries,)
            Of seconds and Wh; the weighted use may be negative on single arcs (downhill), not on circles.
        nodes : ndarray of int
        """
        return self._shortest(weights, nodes, back=back)[0]

    def shortest(self, weights: Array, source: int, target: int) -> Drive:
        """The drive of least weighted use."""
        _, before, arc_of = self._shortest(weights, np.array([source], dtype=np.intp), paths=True)
        arcs: list[int] = []
        here = target
        while here != source:
            earlier = int(before[0, here])
            arcs.append(arc_of[earlier, here])
            here = earlier
        return self._drive(arcs[::-1])

    def _drive(self, arcs: list[int]) -> Drive:
        road = self.road
        use = np.zeros(road.use.shape[1])
        for arc in arcs:  # in the order in which a label adds them up
            use = use + road.use[arc]
        return Drive(use, tuple(road.driven[arc] for arc in arcs), tuple(road.use[arcs]))

    def _shortest(
        self, weights: Array, nodes: NDArray[np.intp], *, back: bool = False, paths: bool = False
    ) -> tuple[Array, Any, dict[tuple[int, int], int]]:
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import bellman_ford, dijkstra

        road = self.road
        cost = road.use @ weights
        size = len(road.states)
        begins, ends = (road.heads, road.tails) if back else (road.tails, road.heads)
        order = np.lexsort((cost, ends, begins))
        pairs = begins[order] * size + ends[order]
        first = np.concatenate([[True], pairs[1:] != pairs[:-1]]) if len(pairs) else np.zeros(0, dtype=bool)
        kept = order[first]
        # csgraph takes a stored zero for no arc
        least = np.where(cost[kept] == 0.0, 1e-300, cost[kept])
        graph = csr_array((least, (begins[kept], ends[kept])), shape=(size, size))
        solve = dijkstra if not (least < 0.0).any() else bellman_ford
        found = solve(graph, indices=nodes, return_predecessors=paths)
        if not paths:
            return np.asarray(found).reshape(len(nodes), size), None, {}
        arc_of = {
            (int(begin), int(end)): int(arc) for begin, end, arc in zip(begins[kept], ends[kept], kept, strict=True)
        }
        return np.asarray(found[0]).reshape(len(nodes), size), found[1].reshape(len(nodes), size), arc_of

    def between(
        self,
        source: int,
        targets: NDArray[np.intp],
        *,
        weights: Array | None = None,
        gap: float = math.inf,
        most: Array | None = None,
        most_labels: int = 400_000,
    ) -> dict[int, list[Drive]]:
        """The undominated drives from a state to others.

        Parameters
        ----------
        source : int
        targets : ndarray of int
            States.
        weights : ndarray, shape (1 + batteries,), optional
            With `gap`: only drives whose weighted use is within `gap` of the least one's.
        gap : float
        most : ndarray, shape (1 + batteries,), optional
            Seconds and Wh that no drive may take more than.
        most_labels : int

        Returns
        -------
        dict
            Target → drives, by weighted use.
        """
        road = self.road
        resources = road.use.shape[1]
        chosen = np.ones(resources) if weights is None else weights
        to_targets = self.distances(chosen, targets, back=True)
        start = to_targets[:, source]
        with np.errstate(invalid="ignore"):
            slack = np.where(np.isfinite(start)[:, None], to_targets - start[:, None], math.inf)
        rest = slack.min(axis=0)
        limit = np.full(resources, math.inf) if most is None else most
        least = np.where(np.isfinite(rest), 0.0, math.inf)[:, None] * np.ones(resources)
        if most is not None:
            for r in range(resources):
                unit = np.zeros(resources)
                unit[r] = 1.0
                least[:, r] = np.maximum(least[:, r], self.distances(unit, targets, back=True).min(axis=0))
        bounds = Bounds(limit, np.where(np.isnan(least), math.inf, least), chosen[None, :], rest[:, None], np.zeros(1))
        wanted = set(targets.tolist())
        outcome = search(
            self._network,
            [Label(source, np.zeros((1, resources)))],
            lambda node: node in wanted,
            bounds,
            best=gap,
            every_goal=True,
            most_labels=most_labels,
        )
        self.complete = self.complete and outcome.labels <= most_labels
        found: dict[int, list[Drive]] = {int(target): [] for target in targets}
        for label in outcome.runners_up:
            if label.alive and label.parent is not None:
                found[label.node].append(self._drive([step.move for step in chain_of(label)[1:]]))
        return found
