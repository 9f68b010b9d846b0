"""Matrices of runs × intervals: sums along a run, interpolation at even instants, covariates within intervals.

They are kept in Fortran order here and in `arrays`: the runs of one interval lie side by side, so that what holds for
an interval meets them as one number, and sums over intervals add whole rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import SAMPLES

Array = NDArray[np.float64]


def table(numbers: Sequence[float | Array]) -> Array:
    """Numbers of intervals, each a float or an array of all runs.

    Returns
    -------
    ndarray, shape (intervals, runs)
        Or (intervals,) where none of them is an array.
    """
    if not any(isinstance(number, np.ndarray) for number in numbers):
        return np.array(numbers, dtype=float)
    rows = np.empty((len(numbers), max(np.size(number) for number in numbers)))
    for row, number in zip(rows, numbers, strict=True):
        row[:] = number
    return rows


def running_sum(rows: Array) -> Array:
    """Sums of the rows before each row, and of all: shape (k, n) → (k + 1, n)."""
    sums = np.empty((len(rows) + 1, rows.shape[1]))
    sums[0] = 0.0
    for i, row in enumerate(rows):
        np.add(sums[i], row, out=sums[i + 1])
    return sums


class Progress:
    """Linear interpolation at even parts of each run's duration.

    Parameters
    ----------
    knots : ndarray, shape (k, runs)
        Instants from 0 that do not decrease along a run, the last one its duration.
    points : int
        How many parts, with both ends.
    """

    def __init__(self, knots: Array, points: int) -> None:
        last, count = len(knots) - 1, knots.shape[1]
        total = knots[-1]
        column = np.arange(count)
        # the first of the even instants that a knot does not come after, counted, tells the knots before each of them
        place = knots[1:] * ((points - 1) / np.where(total > 0.0, total, 1.0))
        np.ceil(place, out=place)
        place *= count
        place += column
        passed = np.bincount(place.astype(np.intp).ravel(), minlength=points * count)
        at = np.empty((points - 2, count), dtype=np.intp)
        before = passed[:count].copy()
        for g in range(1, points - 1):
            before += passed[g * count : (g + 1) * count]
            np.minimum(before, last - 1, out=at[g - 1])
        at *= count
        at += column
        self.at, self.after, self.points = at, at + count, points
        flat = knots.ravel()
        begin, length = flat.take(at), flat.take(self.after)
        length -= begin
        part = np.multiply.outer(np.arange(1, points - 1) / (points - 1), total)
        part -= begin
        if not length.all():
            part = np.where(length > 0.0, part, 1.0)
            length = np.where(length > 0.0, length, 1.0)
        part /= length
        self.part = np.clip(part, 0.0, 1.0, out=part)

    def __call__(self, values: Array) -> Array:
        """Values at the even instants, shape (points, runs), from values at the knots, shape (k, runs)."""
        flat = values.ravel()
        found = np.empty((self.points, values.shape[1]))
        found[0], found[-1] = values[0], values[-1]
        before, inner = flat.take(self.at), found[1:-1]
        np.subtract(flat.take(self.after), before, out=inner)
        inner *= self.part
        inner += before
        return found


def at_nodes(
    cov: Mapping[str, Any], rates: Mapping[str, Any], curved: NDArray[np.intp], times: Array
) -> dict[str, Any]:
    """Covariates at the samples of the intervals in which power changes, in their last axis interval by interval."""
    repeated = np.repeat(curved, len(SAMPLES))
    nodes = take(cov, repeated)
    for name, change in rates.items():
        if np.any(change):
            nodes[name] = nodes[name] + times * np.asarray(change)[..., repeated]
    return nodes


def take(cov: Mapping[str, Any], index: NDArray[np.intp]) -> dict[str, Any]:
    """Covariates of some intervals."""
    return {
        name: value[index] if hasattr(value, "codes") else np.asarray(value)[..., index] for name, value in cov.items()
    }
