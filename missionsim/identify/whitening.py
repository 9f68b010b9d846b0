"""Whitening of rows with two AR(1) processes beside white noise, an ARMA(2,2) process, stretch by stretch.

The moving-average part comes from spectral factorisation, so that whitening is one recursive filter, which runs over
stretches of like length side by side.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array

START_ROWS = 40
APART = np.abs(np.subtract.outer(np.arange(START_ROWS), np.arange(START_ROWS)))
FILLED = 0.8
"""Stretches are filtered together, filled up with zeros to the longest, as long as they fill this part themselves."""
NO_DENORMALS = 1e-170
"""Where rows are zero for long the filter fades into numbers that processors are slow with; its square is no number."""
Shape = tuple[float, float, float, float, float]
"""Analysis step, fast and slow correlation time [s], shares of the variance of both."""


@lru_cache(maxsize=16)
def arma_of(
    step_s: float, fast_s: float, slow_s: float, fast_share: float, slow_share: float
) -> tuple[tuple[float, float, float], tuple[float, float, float], float]:
    """Sum of two AR(1) processes and white noise as ARMA(2,2).

    Returns the AR polynomial, the invertible MA polynomial and sd(process) / sd(innovation).
    """
    r1, r2 = math.exp(-step_s / fast_s), math.exp(-step_s / slow_s)
    v1, v2 = fast_share * (1 - r1**2), slow_share * (1 - r2**2)
    white = max(1e-6, 1.0 - fast_share - slow_share)
    ar = (1.0, -(r1 + r2), r1 * r2)
    g0 = v1 * (1 + r2**2) + v2 * (1 + r1**2) + white * (1.0 + ar[1] ** 2 + ar[2] ** 2)
    g1 = -v1 * r2 - v2 * r1 + white * (ar[1] + ar[1] * ar[2])
    g2 = white * ar[2]
    # with x = z + 1/z the spectrum of the MA part is a quadratic in x
    square = cmath.sqrt(complex(g1 * g1 - 4 * g2 * (g0 - 2 * g2)))
    roots = []
    for x in ((-g1 + square) / (2 * g2), (-g1 - square) / (2 * g2)):
        half = cmath.sqrt(x * x / 4 - 1)
        roots.append(min(x / 2 + half, x / 2 - half, key=abs))
    ma = (1.0, -(roots[0] + roots[1]).real, (roots[0] * roots[1]).real)
    innovation = math.sqrt(g2 / ma[2]) if abs(ma[2]) > 1e-12 else math.sqrt(g0)
    return ar, ma, 1.0 / innovation


@lru_cache(maxsize=16)
def start_factor(
    step_s: float, fast_s: float, slow_s: float, fast_share: float, slow_share: float
) -> tuple[Array, Array, float]:
    """Exact whitening of the first rows of a stretch, where the recursive filter has no past yet.

    Returns the inverse Cholesky factor of their correlation matrix, the factor's diagonal (both for unit variance of
    the noise) and the log-determinant that the start adds to that of the filter.
    """
    from scipy.linalg.lapack import dtrtri

    lags = step_s * np.arange(START_ROWS)
    correlation = fast_share * np.exp(-lags / fast_s) + slow_share * np.exp(-lags / slow_s)
    correlation[0] = 1.0 + 1e-9
    factor = np.linalg.cholesky(correlation[APART])
    ratio = arma_of(step_s, fast_s, slow_s, fast_share, slow_share)[2]
    diagonal = np.diag(factor)
    excess = 2.0 * float(np.sum(np.log(diagonal * ratio)))
    return np.ascontiguousarray(dtrtri(factor, lower=1)[0]), diagonal, excess


@dataclass(frozen=True)
class Group:
    """Stretches side by side: rows (stretches, k, longest), roots of the weights (stretches, 1, longest), 0 beyond
    the end of a stretch, and where each stretch came from."""

    rows: Array
    root: Array
    parts: tuple[slice, ...]
    run: NDArray[np.intp]
    alone: bool
    """No two of the stretches lie in one run."""

    def filtered(self, shape: Shape) -> tuple[Array, Array]:
        """White rows of unit variance, weighted: the first `START_ROWS` and the others."""
        from scipy.signal import lfilter

        ar, ma, ratio = arma_of(*shape)
        inverse, diagonal, _ = start_factor(*shape)
        x = self.rows
        count = min(START_ROWS, x.shape[2])
        head = x[:, :, :count] @ inverse[:count, :count].T
        if x.shape[2] > count:
            e1, e2 = head[:, :, -1] * diagonal[-1], head[:, :, -2] * diagonal[-2]
            x1, x2 = x[:, :, count - 1], x[:, :, count - 2]
            past = np.stack([ar[1] * x1 + ar[2] * x2 - ma[1] * e1 - ma[2] * e2, ar[2] * x1 - ma[2] * e1], axis=2)
            tail, _ = lfilter(ar, ma, x[:, :, count:], axis=2, zi=past)
            tail *= self.root[:, :, count:]
        else:
            tail = x[:, :, count:]
        head *= self.root[:, :, :count] / ratio
        return head, tail


@dataclass(frozen=True)
class Packed:
    """Rows (k, n) of several runs, divided by the scale of the noise and cut into stretches."""

    groups: tuple[Group, ...]
    size: tuple[int, int]
    runs: int

    @classmethod
    def of(cls, rows: Array, scale: Array, weight: Array, stretches: Sequence[slice], runs: Sequence[slice]) -> Packed:
        """Cut rows (k, n) with scale and weight (n,) into stretches; every stretch lies in one of the runs."""
        scaled, root = rows / scale + NO_DENORMALS, np.sqrt(weight)
        begins = np.array([run.start for run in runs])
        longest_first = sorted(stretches, key=lambda part: part.start - part.stop)
        alike: list[list[slice]] = []
        filled = 0
        for part in longest_first:
            length = part.stop - part.start
            whole = (len(alike[-1]) + 1) * (alike[-1][0].stop - alike[-1][0].start) if alike else 0
            if not alike or filled + length < FILLED * whole:
                alike.append([])
                filled = 0
            alike[-1].append(part)
            filled += length
        groups = []
        for parts in alike:
            length = parts[0].stop - parts[0].start
            own = np.full((len(parts), len(rows), length), NO_DENORMALS)
            roots = np.zeros((len(parts), 1, length))
            for i, part in enumerate(parts):
                own[i, :, : part.stop - part.start] = scaled[:, part]
                roots[i, 0, : part.stop - part.start] = root[part]
            at = np.searchsorted(begins, [part.start for part in parts], side="right") - 1
            groups.append(Group(own, roots, tuple(parts), at, len(set(at.tolist())) == len(at)))
        return cls(tuple(groups), (rows.shape[0], rows.shape[1]), len(runs))

    def blocks(self, shape: Shape) -> Array:
        """Gram matrix of the white rows (unit variance) of each run, shape (runs, k, k)."""
        out = np.zeros((self.runs, self.size[0], self.size[0]))
        for group in self.groups:
            head, tail = group.filtered(shape)
            own = head @ head.transpose(0, 2, 1) + tail @ tail.transpose(0, 2, 1)
            if group.alone:
                out[group.run] += own
            else:
                np.add.at(out, group.run, own)
        return out

    def white(self, shape: Shape) -> Array:
        """White rows of unit variance, weighted, shape (k, n)."""
        out = np.empty(self.size)
        for group in self.groups:
            for part, head, tail in zip(group.parts, *group.filtered(shape), strict=True):
                length = part.stop - part.start
                begun = min(START_ROWS, length)
                out[:, part.start : part.start + begun] = head[:, :begun]
                out[:, part.start + begun : part.stop] = tail[:, : length - begun]
        return out
