"""Noise of the power and its whitening (step 2): two AR(1) processes beside white noise, an ARMA(2,2) process.

The moving-average part comes from spectral factorisation, so that whitening is one recursive filter, which runs over
stretches of like length side by side. Runs differ by meter offset, meter gain, motion gain, clock jitter and lag
jitter: random effects that are integrated out (`missionsim.identify.gram`).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.identify.design import Design
from missionsim.identify.settings import JITTER_SD_S, LAG_JITTER_SD_S2, NOISE_FLOOR, SLOW_LEFT
from missionsim.physics import Array, Ints

if TYPE_CHECKING:
    from missionsim.identify.predictive import LeastSquares


START_ROWS = 40
APART = np.abs(np.subtract.outer(np.arange(START_ROWS), np.arange(START_ROWS)))
FILLED = 0.8
"""Stretches are filtered together, filled up with zeros to the longest, as long as they fill this part themselves."""
BLOCK = 32
"""Rows that are filtered by one product of matrices."""
NO_DENORMALS, NO_DENORMALS_IN_FILTER = 1e-170, 1e-100
"""Where rows are zero for long the filter fades into numbers that processors are slow with; the first's square is no
number, the product of both is one."""
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
    diagonal = factor.diagonal()
    excess = 2.0 * float(np.sum(np.log(diagonal * ratio)))
    return np.ascontiguousarray(dtrtri(factor, lower=1)[0]), diagonal, excess


@lru_cache(maxsize=16)
def block_filter(shape: Shape, block: int = BLOCK) -> Array:
    """The recursive filter over a block of rows as one matrix: from these rows and the filter's two states before them
    to its answers and the two states after them, shape (block + 2, block + 2)."""
    (_, a1, a2), (_, m1, m2), _ = arma_of(*shape)
    answers, states = [1.0], [(a1 - m1, a2 - m2)]  # to one row alone
    faded = [1.0, -m1]  # to the first of the states alone
    for _ in range(1, block):
        first, second = states[-1]
        answers.append(first)
        states.append((second - m1 * first, -m2 * first))
        faded.append(-m1 * faded[-1] - m2 * faded[-2])
    one, all_faded = np.array(answers), np.array(faded)
    out = np.empty((block + 2, block + 2))
    out[:block, :block] = np.concatenate([one, np.zeros(block)])[_ages(block)]
    out[:block, block:] = states[::-1]
    out[block, :block], out[block + 1, :block] = all_faded[:block], np.append(0.0, all_faded[: block - 1])
    out[block:, block] = all_faded[block], all_faded[block - 1]
    out[block:, block + 1] = -m2 * out[block:, block - 1]
    out[np.abs(out) < NO_DENORMALS_IN_FILTER] = 0.0
    return out


@cache
def _ages(block: int) -> Ints:
    """How many rows each row of a block (second axis) lies behind each other one; -1 where it lies before it."""
    behind = np.subtract.outer(np.arange(block), np.arange(block)).T
    return np.where(behind < 0, -1, behind)


def states_after(shape: Shape, rows: Array, white: Array) -> Array:
    """The filter's two states after two rows and their innovations, the older first, each shape (k, 2)."""
    ar, ma, _ = arma_of(*shape)
    return np.stack([rows @ ar[:0:-1] - white @ ma[:0:-1], ar[2] * rows[:, 1] - ma[2] * white[:, 1]], axis=1)


@dataclass(frozen=True)
class Group:
    """Stretches side by side, their first `START_ROWS` rows (stretches, k, at most START_ROWS) and the others in whole
    blocks (stretches, k, blocks, BLOCK + 2), of which the last two are room for what the filter knows of the block
    before, each with the roots of the weights (stretches, 1, rows), 0 beyond the end of a stretch, and where each
    stretch came from."""

    head: Array
    head_root: Array
    tail: Array
    tail_root: Array
    parts: tuple[slice, ...]
    run: Ints
    alone: bool
    """No two of the stretches lie in one run."""

    @classmethod
    def of(cls, rows: Array, root: Array, parts: Sequence[slice], begins: Ints) -> Group:
        """Cut `parts` out of rows (k, n) with the roots of their weights (n,); runs begin at `begins`."""
        longest = max(part.stop - part.start for part in parts)
        begun = min(START_ROWS, longest)
        blocks = -(-(longest - begun) // BLOCK)
        head, tail = (np.full((len(parts), len(rows), n), NO_DENORMALS) for n in (begun, blocks * BLOCK))
        head_root, tail_root = (np.zeros((len(parts), 1, n)) for n in (begun, blocks * BLOCK))
        for i, part in enumerate(parts):
            middle = min(part.start + begun, part.stop)
            first, rest = slice(part.start, middle), slice(middle, part.stop)
            head[i, :, : middle - part.start], head_root[i, 0, : middle - part.start] = rows[:, first], root[first]
            tail[i, :, : part.stop - middle], tail_root[i, 0, : part.stop - middle] = rows[:, rest], root[rest]
        at = np.searchsorted(begins, [part.start for part in parts], side="right") - 1
        room = np.empty((len(parts), len(rows), blocks, BLOCK + 2))
        room[..., :BLOCK] = tail.reshape(len(parts), len(rows), blocks, BLOCK)
        return cls(head, head_root, room, tail_root, tuple(parts), at, len(set(at.tolist())) == len(at))

    def filtered(self, shape: Shape) -> tuple[Array, Array]:
        """White rows of unit variance, weighted: the first `START_ROWS` and the others.

        Blocks are products of matrices, of all rows at once; what a block needs of those before it are two states.
        """
        inverse, diagonal, _ = start_factor(*shape)
        count = self.head.shape[2]
        head = (self.head.reshape(-1, count) @ inverse[:count, :count].T).reshape(self.head.shape)
        tail = np.zeros((*self.head.shape[:2], 0))
        if self.tail.shape[2]:
            matrix = block_filter(shape)
            rows = self.tail.reshape(-1, BLOCK + 2)
            ends = rows[:, :BLOCK] @ matrix[:BLOCK, BLOCK:]
            states = np.ascontiguousarray(ends.reshape(-1, self.tail.shape[2], 2).swapaxes(0, 1))
            last = (head[:, :, -2:] * diagonal[-2:]).reshape(-1, 2)
            both = states_after(shape, self.head[:, :, -2:].reshape(-1, 2), last)
            for block in states:
                after = both @ matrix[BLOCK:, BLOCK:]
                after += block
                block[:] = both
                both = after
            rows.reshape(-1, self.tail.shape[2], BLOCK + 2)[:, :, BLOCK:] = states.swapaxes(0, 1)
            tail = (rows @ matrix[:, :BLOCK]).reshape(*self.head.shape[:2], -1)
            tail *= self.tail_root
        head *= self.head_root / arma_of(*shape)[2]
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
        groups = [Group.of(scaled, root, parts, begins) for parts in alike]
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


@dataclass(frozen=True)
class Noise:
    """Noise parameters.

    ``sigma_w`` is the standard deviation of the one-step innovation at mean power; ``fast_share`` and ``slow_share``
    are parts of the variance; ``exponent`` says how the noise grows with power; ``offset_w``, ``gain`` and
    ``motion_gain`` are the standard deviations between runs (W, relative, share of mean power); ``ramp_error`` and
    ``switch_error`` are squared relative errors where the base model changes or switches; ``weight`` (n,)
    down-weights such rows and outliers.
    """

    step_s: float
    fast_s: float
    slow_s: float
    fast_share: float
    slow_share: float
    sigma_w: float
    exponent: float
    offset_w: float
    _: KW_ONLY
    gain: float
    motion_gain: float
    ramp_error: float
    switch_error: float
    weight: Array
    scale: Array

    def of_rows(self, at: Ints) -> Noise:
        """The same noise at some of the rows."""
        return replace(self, weight=self.weight[at], scale=self.scale[at])

    def random_sd(self) -> Array:
        """Standard deviations of the random effects between runs, shape (5,)."""
        return np.array([self.offset_w, self.gain, self.motion_gain, JITTER_SD_S, LAG_JITTER_SD_S2])

    @property
    def shape(self) -> Shape:
        """Analysis step and the four shape parameters."""
        return self.step_s, self.fast_s, self.slow_s, self.fast_share, self.slow_share

    @property
    def total_sd_w(self) -> float:
        """Standard deviation of the noise at mean power [W]."""
        return self.sigma_w * arma_of(*self.shape)[2]


def start_noise(design: Design) -> Noise:
    """First guess, from published figures: 3 % noise, mostly a few seconds long, meters apart by 0.5 %."""
    power = design.layout.mean_power_w
    n = len(design.y)
    step = design.layout.step_s
    sigma = 0.02 * power * min(1.0, np.sqrt(step))
    has_motion = 0.005 if np.any(design.random[2]) else 1e-6
    errors: dict[str, Any] = {"gain": 0.005, "motion_gain": has_motion, "ramp_error": 0.0, "switch_error": 0.0}
    errors |= {"weight": np.ones(n), "scale": np.ones(n)}
    return Noise(step, max(4.0, 2 * step), max(60.0, 20 * step), 0.6, 0.1, sigma, 0.0, 0.005 * power, **errors)


def bounded_noise(design: Design, squares: LeastSquares, chosen: Sequence[int]) -> Noise:
    """The first guess at the size of what least squares leaves: noise without a slow part that could take a signal."""
    noise = start_noise(design)
    one_run = len(design.runs) == 1  # whose parts, predicted from each other, say nothing of the noise
    left = squares.errors(squares.index(chosen), squares.fit(chosen)) if one_run else squares.leave_out(chosen)
    error = float(np.sqrt(left.total / float(squares.seconds.sum())))
    return replace(noise, sigma_w=noise.sigma_w * error / noise.total_sd_w, slow_share=SLOW_LEFT)


def log_level(design: Design) -> Array:
    mean = design.layout.mean_power_w
    return np.log(np.maximum(design.base, NOISE_FLOOR * mean) / mean)


def for_rows(design: Design, noise: Noise) -> Noise:
    """The same noise for the rows of another design (held-out or imagined runs), none of them an outlier."""
    return replace(noise, weight=np.ones(len(design.y)), scale=np.exp(noise.exponent * log_level(design)))


def without_outliers(design: Design, noise: Noise) -> Noise:
    """The same noise with no row called an outlier: what a model lacks looks like outliers to it."""
    ramp, switch = edge_variance(design, noise, noise.scale)
    return replace(noise, weight=1.0 / (1.0 + noise.ramp_error * ramp + noise.switch_error * switch))


def edge_variance(design: Design, noise: Noise, scale: Array) -> tuple[Array, Array]:
    """Squared change of the base model around each row, and squared jumps of its switching terms, both in innovation
    variances and with their echo in the next row.

    Where the model changes fast, small errors of time, speed or of the moving/standing threshold are large errors
    of power; such rows say less.
    """
    ar, ma, _ = arma_of(*noise.shape)
    echo = float(ar[1] - ma[1]) ** 2
    jumps = design.gradient[-1]
    out = np.empty((2, len(design.y)))
    for part in design.stretches:
        base = design.base[part]
        change = np.abs(np.diff(base, prepend=base[0], append=base[-1]))
        jump = np.pad(jumps[part], 1)
        unit = noise.sigma_w * scale[part]
        square = np.vstack([np.maximum(change[1:], change[:-1]), np.maximum(jump[:-2], jump[1:-1])]) / unit
        square *= square
        out[:, part] = square
        out[:, part.start + 1 : part.stop] += echo * square[:, :-1]
    return out[0], out[1]


def mean_variance(noise: Mapping[str, float], seconds: float) -> float:
    """Variance of the mean of the noise over some time, relative to that of single rows.

    ``2 τ/T (1 − τ/T (1 − exp(−T/τ)))`` for each of its two parts of correlation time τ; white noise averages out.
    """
    total = 0.0
    for part in ("fast", "slow"):
        reach = noise[f"{part}_s"] / seconds
        total += noise[f"{part}_share"] * 2.0 * reach * (1.0 - reach * (1.0 - math.exp(-1.0 / reach)))
    return total
