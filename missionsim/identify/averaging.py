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

from missionsim.identify.data import Array

LAG_NODES = ((0.4157745568, 0.7110930099), (2.2942803603, 0.2785177336), (6.2899450829, 0.0103892565))
"""Gauss-Laguerre nodes: a first-order lag is an exponentially weighted mean of delays."""


def integral_curves(values: Array) -> Array:
    """Cumulative integral of columns at the row edges (unit step), rows, and slope of the integral at the edges.

    The slope is the mean of the neighbours, limited so that the cubic between edges stays monotone; a linear ramp
    between rows is thereby reproduced although each row holds only its mean.

    Parameters
    ----------
    values : ndarray, shape (k, n)

    Returns
    -------
    ndarray, shape (3 * (n + 1), k)
        Integral, row (0 after the last) and slope of edge 0, then of edge 1, and so on.
    """
    k, n = values.shape
    out = np.zeros((n + 1, 3, k))
    out[1:, 0] = np.cumsum(values, axis=1).T
    rows = np.ascontiguousarray(values.T)
    out[:-1, 1] = rows
    left, right = rows[:-1], rows[1:]
    limit = 3.0 * np.minimum(np.abs(left), np.abs(right))
    inner = np.clip(0.5 * (left + right), -limit, limit)
    out[1:-1, 2] = np.where(left * right > 0, inner, 0.0)
    out[0, 2], out[-1, 2] = rows[0], rows[-1]
    return out.reshape(-1, k)


@dataclass(frozen=True)
class Weights:
    """Weights of one clock: of the stacked curves at every edge, and how much of each interval the rows cover."""

    at_edges: Any
    """Sparse, shape (edges, 3 * (rows + runs))."""
    covered: Array
    """Rows, shape (intervals,)."""


@dataclass(frozen=True)
class Intervals:
    """Analysis intervals of several runs on the even raw grid of each.

    Attributes
    ----------
    edges_s, run : shape (edges,)
        Edges in the order of time, run by run, and the number of their run.
    low_at : shape (intervals,)
        Edge at which each interval begins; it ends at the next.
    start_s, step_s, rows : shape (runs,)
        Raw grid of each run.
    least : shape (intervals,)
        Least number of rows that a mean is divided by.
    """

    edges_s: Array
    run: NDArray[np.intp]
    low_at: NDArray[np.intp]
    start_s: Array
    step_s: Array
    rows: NDArray[np.intp]
    least: Array

    @classmethod
    def of(
        cls, intervals_s: Sequence[tuple[Array, Array]], start_s: Sequence[float], step_s: Sequence[float],
        rows: Sequence[int],
    ) -> Intervals:  # fmt: skip
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
        return cls(
            np.concatenate(edges), run, np.concatenate(low_at).astype(np.intp), np.asarray(start_s, dtype=float),
            np.asarray(step_s, dtype=float), np.asarray(rows, dtype=np.intp), np.concatenate(least),
        )  # fmt: skip

    def weights(self, delay_s: Array, lag_s: float) -> Weights:
        """Weights for the delay of each run, shape (runs,), and a common lag [s].

        Cubic Hermite interpolation of the integral at the fractional row positions of the edges.
        """
        from scipy.sparse import csr_array

        nodes = LAG_NODES if lag_s > 0 else ((0.0, 1.0),)
        late = (self.edges_s - delay_s[self.run])[:, None] - lag_s * np.array([node for node, _ in nodes])
        size = self.rows[self.run][:, None]
        position = np.clip((late - self.start_s[self.run][:, None]) / self.step_s[self.run][:, None], 0.0, size)
        left = np.minimum(position.astype(np.intp), size - 1)
        s = position - left
        weight = np.array([weight for _, weight in nodes])
        s2 = s * s
        s3 = s2 * s
        data = np.empty((*s.shape, 4))
        data[..., 0] = weight
        data[..., 1] = weight * (3 * s2 - 2 * s3)
        data[..., 2] = weight * (s - 2 * s2 + s3)
        data[..., 3] = weight * (s3 - s2)
        first = np.concatenate([[0], np.cumsum(self.rows[:-1] + 1)])
        # integral, row and slope at the edge before; slope at the edge after
        at = 3 * (left + first[self.run][:, None])[..., None] + np.array([0, 1, 2, 5])
        count = len(self.edges_s)
        ends = np.arange(count + 1) * (4 * len(nodes))
        shape = (count, 3 * int(np.sum(self.rows + 1)))
        matrix = csr_array((data.ravel(), at.ravel().astype(np.int32), ends.astype(np.int32)), shape=shape)
        mean = position @ weight
        return Weights(matrix, mean[self.low_at + 1] - mean[self.low_at])

    def means(self, curves: Array, weights: Weights) -> Array:
        """Mean of columns over every interval, shape (intervals, k), from the runs' stacked `integral_curves`."""
        whole = weights.at_edges @ curves
        difference = np.diff(whole, axis=0)[self.low_at]
        # at the ends of the log a delayed column is known for a part of the interval only; a constant stays one
        difference /= np.maximum(weights.covered, self.least)[:, None]
        return np.asarray(difference)
