"""Long series made short enough to draw, without losing a peak."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def min_max_indices(values: NDArray[np.float64], points: int) -> NDArray[np.int64]:
    """Indices of a series to draw: the lowest and highest value of each of ``points/2`` equal stretches, and both ends.

    Parameters
    ----------
    values : ndarray, shape (n,)
        The series; NaN are kept only where a stretch has nothing else.
    points : int
        Upper limit of the number of indices, at least 4.

    Returns
    -------
    ndarray of int, shape (m,)
        Increasing, m ≤ max(points, 4).
    """
    size = len(values)
    limit = max(points, 4)
    if size <= limit:
        return np.arange(size)
    buckets = (limit - 2) // 2
    edges = np.linspace(0, size, buckets + 1).astype(np.int64)
    chosen = np.empty(2 * buckets + 2, dtype=np.int64)
    chosen[0], chosen[-1] = 0, size - 1
    low = np.where(np.isnan(values), np.inf, values)
    high = np.where(np.isnan(values), -np.inf, values)
    for k in range(buckets):
        first, last = edges[k], edges[k + 1]
        chosen[1 + 2 * k] = first + int(np.argmin(low[first:last]))
        chosen[2 + 2 * k] = first + int(np.argmax(high[first:last]))
    return np.unique(chosen)


def shared_indices(series: list[NDArray[np.float64]], points: int) -> NDArray[np.int64]:
    """Indices that keep the peaks of several series on one axis; `points` is the limit for all of them together."""
    if not series:
        return np.zeros(0, dtype=np.int64)
    each = max(4, points // len(series))
    return np.unique(np.concatenate([min_max_indices(values, each) for values in series]))


def literal(text: str) -> str:
    """A name for Matplotlib, which takes what stands between dollar signs for mathematics."""
    return text.replace("$", r"\$")
