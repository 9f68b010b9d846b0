"""Means of raw columns over the analysis intervals of all runs at once, for any delay and lag of the meter.

A mean is linear in the column once its cumulative integral and the slopes of that are known: one sparse matrix of
weights for a clock serves every column of every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.physics import Array

LAG_NODES = ((0.4157745568, 0.7110930099), (2.2942803603, 0.2785177336), (6.2899450829, 0.0103892565))
"""Gauss-Laguerre nodes: a first-order lag is an exponentially weighted mean of delays."""


def integral_curves(columns: Sequence[Array]) -> Array:
    """Cumulative integral of columns (unit step) of each run as a cubic inside each row, runs one after the other.

    Its slope at a row's edge is the mean of the neighbours, limited so that the cubic stays monotone; a linear ramp
    between rows is thereby reproduced although each row holds only its mean.

    Parameters
    ----------
    columns : sequence of ndarray, shape (k, rows of the run)

    Returns
    -------
    ndarray, shape (2, edges of the rows of all runs, k)
        The integral and its slope at each edge; a run has one edge more than rows.
    """
    out = np.empty((2, sum(values.shape[1] + 1 for values in columns), columns[0].shape[0]))
    begin = 0
    for values in columns:
        end = begin + values.shape[1] + 1
        _one_curve(np.ascontiguousarray(values.T), *out[:, begin:end])
        begin = end
    return out


def _one_curve(rows: Array, integral: Array, slope: Array) -> None:
    """Fill in integral and slope (n + 1, k) at the edges of one run's rows (n, k)."""
    integral[0] = 0.0
    np.cumsum(rows, axis=0, out=integral[1:])
    left, right = rows[:-1], rows[1:]
    slope[0], slope[-1] = rows[0], rows[-1]
    inner = np.add(left, right, out=slope[1:-1])
    inner *= 0.5
    size = np.abs(rows)
    limit = np.minimum(size[:-1], size[1:])
    limit *= 3.0
    np.minimum(inner, limit, out=inner)
    np.negative(limit, out=limit)
    np.maximum(inner, limit, out=inner)
    np.multiply(left, right, out=limit)
    inner *= limit > 0.0


def _hermite(s: Array) -> tuple[Array, Array, Array, Array]:
    """Weights of the integral at both edges of a row, and of its slope there, for the place s in the row (0 to 1)."""
    rise = s * s * (3.0 - 2.0 * s)
    back = s * (1.0 - s)
    return 1.0 - rise, rise, back * (1.0 - s), -back * s


@dataclass(frozen=True)
class Weights:
    """Weights of one clock: of the stacked curves at every edge, and how much of each interval the rows cover."""

    at_edges: Any
    """Sparse, shape (edges, 2 * edges of the rows)."""
    covered: Array
    """Rows, shape (intervals,)."""


@dataclass(frozen=True)
class Grid:
    """Even raw grid of a run: its beginning and step [s], its rows, and the number of its first edge when the edges of
    all runs' rows are stacked; arrays with one value for each edge of an interval."""

    start_s: Array
    step_s: Array
    rows: NDArray[np.int32]
    first: NDArray[np.int32]


@dataclass(frozen=True)
class Intervals:
    """Analysis intervals of several runs on the even raw grid of each."""

    edges_s: Array
    run: NDArray[np.intp]
    """Both: edges in the order of time, run by run, and the number of their run. Shape (edges,)."""
    low_at: NDArray[np.intp]
    """Edge at which each interval begins; it ends at the next. Shape (intervals,)."""
    at_edges: Grid
    """Raw grid of the run of each edge."""
    rows: int
    """Edges of the rows of all runs."""
    least: Array
    """Least number of rows that a mean is divided by. Shape (intervals,)."""

    @classmethod
    def of(
        cls,
        intervals_s: Sequence[tuple[Array, Array]],
        start_s: Sequence[float],
        step_s: Sequence[float],
        rows: Sequence[int],
    ) -> Intervals:
        """From the lower and upper ends [s] of the intervals of each run, which never overlap."""
        edges, low_at, least, total = [], [], [], 0
        for (low, high), step in zip(intervals_s, step_s, strict=True):
            # where intervals touch, one edge serves both
            apart = np.append(np.abs(high[:-1] - low[1:]) >= 1e-9, True)
            begin = np.arange(len(low)) + np.concatenate([[0], np.cumsum(apart[:-1])])
            own = np.empty(len(low) + int(apart.sum()))
            own[begin] = low
            own[begin[apart] + 1] = high[apart]
            edges.append(own)
            low_at.append(begin + total)
            least.append(0.1 * (high - low) / step)
            total += len(own)
        run = np.repeat(np.arange(len(edges)), [len(e) for e in edges])
        first = np.concatenate([[0], np.cumsum(np.asarray(rows) + 1)[:-1]])
        grid = Grid(
            np.asarray(start_s, dtype=float)[run],
            np.asarray(step_s, dtype=float)[run],
            np.asarray(rows, dtype=np.int32)[run],
            first.astype(np.int32)[run],
        )
        return cls(
            np.concatenate(edges),
            run,
            np.concatenate(low_at).astype(np.intp),
            grid,
            int(np.sum(rows)) + len(rows),
            np.concatenate(least),
        )

    def weights(self, delay_s: Array, lag_s: float) -> Weights:
        """Weights for the delay of each run, shape (runs,), and a common lag [s]."""
        from scipy.sparse import csr_array

        left, s, weight = self._places(delay_s, lag_s)
        covered = self._covered(left, s, weight)
        data = np.empty((s.shape[1], len(weight), 4))
        at = np.empty(data.shape, dtype=np.int32)
        for i, part in enumerate(_hermite(s)):
            data[:, :, i] = (weight[:, None] * part).T
            at[:, :, i] = left.T
            at[:, :, i] += (0, 1, self.rows, self.rows + 1)[i]
        count = len(self.edges_s)
        ends = np.arange(count + 1, dtype=np.int32) * np.int32(4 * len(weight))
        matrix = csr_array((data.ravel(), at.ravel(), ends), shape=(count, 2 * self.rows))
        return Weights(matrix, covered)

    def means(self, curves: Array, weights: Weights) -> Array:
        """Mean of columns over every interval, shape (intervals, k), from their `integral_curves`."""
        return self._means(weights.at_edges @ curves.reshape(-1, curves.shape[2]), weights.covered)

    def means_of_one(self, curve: Array, delay_s: Array, lag_s: float) -> Array:
        """The same for a single column without a matrix, shape (intervals,), from its curve (2, edges, 1)."""
        left, s, weight = self._places(delay_s, lag_s)
        integral, slope = curve[:, :, 0]
        parts = (integral.take(left), integral.take(left + 1), slope.take(left), slope.take(left + 1))
        whole = sum(part * value for part, value in zip(_hermite(s), parts, strict=True))
        return self._means((weight @ whole)[:, None], self._covered(left, s, weight))[:, 0]

    def _places(self, delay_s: Array, lag_s: float) -> tuple[NDArray[np.int32], Array, Array]:
        """Stacked edge at the start of a row, and place in the row, at every node of the lag and edge, shapes
        (nodes, edges); weights (nodes,)."""
        if not np.isfinite(np.sum(delay_s) + lag_s):  # rows are taken without a check of their numbers
            raise ValueError("the clock of the meter comes out as no number")
        nodes = np.array(LAG_NODES if lag_s > 0 else ((0.0, 1.0),))
        edge = self.at_edges
        late = (self.edges_s - delay_s[self.run] - edge.start_s) / edge.step_s
        position = late - nodes[:, :1] * (lag_s / edge.step_s)
        np.maximum(position, 0.0, out=position)
        np.minimum(position, edge.rows, out=position)
        left = position.astype(np.int32)
        np.minimum(left, edge.rows - 1, out=left)
        position -= left
        left += edge.first
        return left, position, nodes[:, 1]

    def _covered(self, left: NDArray[np.int32], s: Array, weight: Array) -> Array:
        mean = weight @ (left + s)
        return np.asarray(np.diff(mean).take(self.low_at))

    def _means(self, whole: Array, covered: Array) -> Array:
        difference = (whole[1:] - whole[:-1]).take(self.low_at, axis=0)
        # at the ends of the log a delayed column is known for a part of the interval only; a constant stays one
        difference /= np.maximum(covered, self.least)[:, None]
        return difference
