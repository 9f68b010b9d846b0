"""Resource-constrained shortest paths with published optima (Beasley and Christofides 1989), by the planner's core."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from missionsim.planner.core import Bounds, Label, Leaving, Outcome, search


class _Graph:
    def __init__(self, path: Path) -> None:
        numbers = iter(path.read_text().split())
        nodes, arcs, kinds = (int(next(numbers)) for _ in range(3))
        self.lower = np.array([float(next(numbers)) for _ in range(kinds)])
        self.upper = np.array([float(next(numbers)) for _ in range(kinds)])
        spent = np.array([[float(next(numbers)) for _ in range(kinds)] for _ in range(nodes)])
        rows = [[float(next(numbers)) for _ in range(3 + kinds)] for _ in range(arcs)]
        self.tails = np.array([int(row[0]) - 1 for row in rows])
        self.heads = np.array([int(row[1]) - 1 for row in rows])
        self.use = np.array([row[2:] for row in rows])
        self.use[:, 1:] += spent[self.heads]
        self.nodes = nodes
        self._leaving = {}
        for node in range(nodes):
            index = np.flatnonzero(self.tails == node)
            self._leaving[node] = Leaving(self.heads[index], self.use[index], list(index))

    def leaving(self, node: int) -> Leaving:
        return self._leaving[node]

    def refill(self, node: int) -> None:
        return None

    def opens(self, node: int) -> None:
        return None

    def bounds(self) -> Bounds:
        least = np.empty((self.nodes, self.use.shape[1]))
        for k in range(self.use.shape[1]):
            cheapest: dict[tuple[int, int], float] = {}
            for i, j, amount in zip(self.tails, self.heads, self.use[:, k], strict=True):
                cheapest[j, i] = min(amount, cheapest.get((j, i), math.inf))
            ends = np.array(list(cheapest))
            # a stored zero is an arc, but csgraph needs it to be more than nothing
            weights = np.maximum(np.array(list(cheapest.values())), 1e-12)
            graph = csr_array((weights, (ends[:, 0], ends[:, 1])), shape=(self.nodes, self.nodes))
            least[:, k] = dijkstra(graph, indices=self.nodes - 1)
        weights = np.zeros((1, self.use.shape[1]))
        weights[0, 0] = 1.0
        return Bounds(np.concatenate([[math.inf], self.upper]), least, weights, least[:, :1], np.zeros(1))


def _solve(graph: _Graph) -> Outcome:
    assert (graph.lower == 0.0).all()
    start = Label(0, np.zeros((1, graph.use.shape[1])))
    return search(graph, [start], lambda node: node == graph.nodes - 1, graph.bounds())


def test_all_published_optima(shared: Path) -> None:
    folder = shared / "planning" / "rcsp"
    answers = {row["file"]: row["cost"] for row in csv.DictReader((folder / "results.csv").open())}
    assert len(answers) == 18
    for name, cost in answers.items():
        found = _solve(_Graph(folder / f"{name}.txt"))
        if cost == "infeasible":
            assert math.isinf(found.objective), name
        else:
            assert found.objective == pytest.approx(float(cost), abs=1e-6), name
        # of 1,000 to 5,000 arcs; at most 547 and 709 when this was written
        assert found.labels < 1000, name
        assert found.arcs < 1000, name
