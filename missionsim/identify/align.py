"""From raw rows to the analysis rate, with a delay and a first-order lag of the power meter (steps 0 and 1).

Columns are evaluated at the raw rate by the caller and averaged here: a non-linear feature of an average is biased.
Averages come from cumulative integrals, so that any delay, also a fraction of a sample, is exact for rows that hold
their value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array, RunData

FINEST_STEP_S = 0.1
MANY_RUNS = 8
GAP_ROWS = 4.0


@dataclass(frozen=True)
class Bins:
    """Analysis intervals of one run: measured means and where they lie in time; arrays of shape (bins,)."""

    low_s: Array
    high_s: Array
    measured_w: Array
    starts: NDArray[np.intp]
    """First bin of each stretch without a gap."""


def _row_edges(time_s: Array) -> tuple[Array, Array, float]:
    """Edges that split the time half-way between the rows, and the rows' own reach (shorter beside a gap)."""
    step = float(np.median(np.diff(time_s)))
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    edges = np.concatenate([[time_s[0] - 0.5 * step], middle, [time_s[-1] + 0.5 * step]])
    return edges, np.diff(time_s), step


def make_bins(run: RunData, period_s: float) -> Bins:
    """Group rows into intervals of about `period_s`; a slow power topic sets its own intervals.

    Rows without a measurement leave a gap; a group never spans one.
    """
    time_s, power = run.time_s, run.measured_w
    edges, _, step = _row_edges(time_s)
    reach = 0.75 * step
    low = np.maximum(edges[:-1], time_s - reach)
    high = np.minimum(edges[1:], time_s + reach)
    usable = np.isfinite(power)
    if run.fresh is not None and not bool(np.all(run.fresh)):
        # a value that is first seen in row r was measured between the refresh before and r
        rows = np.flatnonzero(run.fresh & usable)
        if len(rows) < 3:
            raise ValueError(f"run {run.run}: power was refreshed {len(rows)} times only")
        refresh_s = np.diff(time_s[rows])
        usual = float(np.median(refresh_s))
        per_bin = max(1, round(period_s / usual))
        bin_low, bin_high = high[rows[:-1]], high[rows[1:]]
        whole = refresh_s <= GAP_ROWS * usual
        return _grouped(bin_low[whole], bin_high[whole], power[rows[1:]][whole], per_bin, usual)
    per_bin = max(1, round(period_s / step))
    return _grouped(low[usable], high[usable], power[usable], per_bin, step)


def _grouped(low: Array, high: Array, power: Array, per_bin: int, step: float) -> Bins:
    if len(low) == 0:
        empty = np.empty(0)
        return Bins(empty, empty, empty, np.empty(0, dtype=np.intp))
    breaks = np.flatnonzero(low[1:] - high[:-1] > (GAP_ROWS - 1.5) * step) + 1
    edges = [0, *breaks.tolist(), len(low)]
    begins: list[int] = []
    ends: list[int] = []
    starts: list[int] = []
    for begin, end in pairwise(edges):
        groups = list(range(begin, end, per_bin))
        if len(groups) > 1 and end - groups[-1] < 0.6 * per_bin:
            groups.pop()  # a short rest joins the bin before it
        starts.append(len(begins))
        begins += groups
        ends += [*groups[1:], end]
    begin_at, end_at = np.asarray(begins), np.asarray(ends)
    length = high - low
    total = np.add.reduceat(power * length, begin_at)
    weight = np.add.reduceat(length, begin_at)
    return Bins(low[begin_at], high[end_at - 1], total / weight, np.asarray(starts, dtype=np.intp))


@dataclass
class RunColumns:
    """Columns of one run on an even raw grid, ready to be lagged, delayed and averaged; ``values`` (columns, rows)."""

    bins: Bins
    start_s: float
    step_s: float
    values: Array
    _curve: tuple[Array, ...] | None = None
    _picked: dict[tuple[int, ...], tuple[Array, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, run: RunData, bins: Bins, rows: Sequence[Array]) -> RunColumns:
        """Put the given raw columns on an even grid (unchanged where the rows already are even)."""
        edges, gaps, step = _row_edges(run.time_s)
        values = np.ascontiguousarray(np.vstack([np.asarray(r, dtype=float) for r in rows]))
        even = bool(np.all(np.abs(gaps - step) <= 0.02 * step)) and step >= 0.99 * FINEST_STEP_S
        if not even:
            target = max(step, FINEST_STEP_S)
            count = max(2, int(np.ceil((edges[-1] - edges[0]) / target - 1e-6)))
            target = float(edges[-1] - edges[0]) / count  # no part of a row beyond the end
            grid = np.linspace(edges[0], edges[-1], count + 1)
            cumulative = np.pad(np.cumsum(values * np.diff(edges), axis=1), ((0, 0), (1, 0)))
            values = np.diff(np.vstack([np.interp(grid, edges, row) for row in cumulative]), axis=1) / target
            step = target
        return cls(bins, float(edges[0]), step, values)

    def averaged(self, delay_s: float, lag_s: float, rows: Sequence[int] | None = None) -> Array:
        """Mean of columns over every bin, shape (columns, bins), as a late and sluggish meter would see it."""
        if self._curve is None:
            # one row of memory for each row of the log: picking rows is then fast
            self._curve = tuple(np.ascontiguousarray(p.T) for p in (self.values, *_integral_curve(self.values)))
        parts = self._curve
        if rows is not None and len(rows) < self.values.shape[0]:
            key = tuple(rows)
            if key not in self._picked:
                if len(self._picked) > 3:
                    self._picked.clear()
                self._picked[key] = tuple(np.ascontiguousarray(p[:, list(rows)]) for p in parts)
            parts = self._picked[key]
        low, high = self.bins.low_s, self.bins.high_s
        joined = bool(np.all(np.abs(high[:-1] - low[1:]) < 1e-9))
        edges = np.append(low, high[-1]) if joined else np.concatenate([low, high])
        total: Array | float = 0.0
        length: Array | float = 0.0
        n = len(low)
        for node, weight in LAG_NODES if lag_s > 0 else ((0.0, 1.0),):
            position = np.clip((edges - delay_s - node * lag_s - self.start_s) / self.step_s, 0.0, self.values.shape[1])
            total = total + weight * _integral_at(parts, position)
            length = length + weight * (np.diff(position) if joined else position[n:] - position[:n])
        whole = np.asarray(total)
        difference = np.diff(whole, axis=1) if joined else whole[:, n:] - whole[:, :n]
        # at the ends of the log a delayed column is known for a part of the bin only; a constant stays a constant
        return np.asarray(difference / np.maximum(length, 0.1 * (high - low) / self.step_s))


LAG_NODES = ((0.4157745568, 0.7110930099), (2.2942803603, 0.2785177336), (6.2899450829, 0.0103892565))
"""Gauss-Laguerre nodes: a first-order lag is an exponentially weighted mean of delays."""


def _integral_curve(values: Array) -> tuple[Array, Array]:
    """Cumulative integral at the row edges (unit step) and its slope there.

    The slope is the mean of the neighbours, limited so that the cubic between edges stays monotone; a linear ramp
    between rows is thereby reproduced although each row holds only its mean.
    """
    cumulative = np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0)))
    left, right = values[:, :-1], values[:, 1:]
    limit = 3.0 * np.minimum(np.abs(left), np.abs(right))
    inner = np.clip(0.5 * (left + right), -limit, limit)
    inner = np.where(left * right > 0, inner, 0.0)
    slope = np.concatenate([values[:, :1], inner, values[:, -1:]], axis=1)
    return cumulative, slope


def _integral_at(parts: tuple[Array, ...], position: Array) -> Array:
    """Cubic Hermite interpolation of the cumulative integral at fractional row positions; parts have a row each."""
    values, cumulative, slope = parts
    left = np.minimum(position.astype(np.intp), values.shape[0] - 1)
    s = (position - left)[:, None]
    s2 = s * s
    s3 = s2 * s
    out = cumulative.take(left, axis=0)
    out += values.take(left, axis=0) * (3 * s2 - 2 * s3)
    out += slope.take(left, axis=0) * (s - 2 * s2 + s3)
    out += slope.take(left + 1, axis=0) * (s3 - s2)
    return np.asarray(out.T)


@dataclass(frozen=True)
class Clock:
    """Delay of the power meter behind the motion [s] (common, and of each run) and its first-order lag [s]."""

    delay_s: float
    lag_s: float
    run_delay_s: tuple[float, ...]
    at_edge: bool = False


def find_clock(runs: Sequence[RunColumns], step_s: float) -> Clock:
    """Common delay and lag by profile likelihood of a prewhitened regression with all columns in.

    Row 0 of each run's columns is the base model; keeping every candidate in leaves a real inertia effect alone.
    """
    reach = max(1.0, 1.0 * step_s)
    if len(runs) > MANY_RUNS:
        runs = runs[:: -(-len(runs) // 4)]  # a start is all that is wanted; the model refines it with every run
    best: dict[tuple[float, float], float] = {}

    def score(delay: float, lag: float) -> float:
        key = (round(delay, 4), round(lag, 4))
        if key not in best:
            best[key] = _alignment_score(runs, key[0], key[1], step_s)
        return best[key]

    delays = [round(float(d), 4) for d in np.arange(-0.8, 0.81, 0.2) * reach]
    lags = [round(float(t), 4) for t in np.array([0.0, 0.2, 0.45, 0.8]) * reach]
    # the two nearly trade against each other, so each lag is searched along its own ridge
    for lag in lags:
        for delay in delays:
            score(delay, lag)
    centre = max(best, key=lambda k: best[k])
    for width in (0.1 * reach, 0.05 * reach):
        for _ in range(4):
            around = [(centre[0] + i * width, max(0.0, centre[1] + j * width)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            around += [(centre[0] - width, centre[1] + 2 * width), (centre[0] + width, max(0.0, centre[1] - 2 * width))]
            top = max(around, key=lambda k: score(*k))
            top = (round(top[0], 4), round(top[1], 4))
            if top == centre:
                break
            centre = top
    at_edge = abs(centre[0]) > 0.79 * reach or centre[1] > 1.2 * reach
    return Clock(centre[0], centre[1], tuple(0.0 for _ in runs), at_edge)


def _alignment_score(runs: Sequence[RunColumns], delay_s: float, lag_s: float, step_s: float) -> float:
    from scipy.signal import lfilter

    keep = 0.85**step_s
    gram: Array | float = 0.0
    count = 0
    for run in runs:
        rows = np.vstack([run.bins.measured_w, run.averaged(delay_s, lag_s)])
        rows[0] -= rows[1]
        white = lfilter([1.0, -keep], [1.0], rows, axis=1)
        later = np.ones(white.shape[1], dtype=bool)
        later[run.bins.starts] = False
        white = white[:, later]
        white = white - white.mean(axis=1, keepdims=True)
        gram = gram + white @ white.T
        count += white.shape[1] - 1
    full = np.asarray(gram)
    size = np.sqrt(np.maximum(np.diag(full), 1e-300))
    normal = full / size[:, None] / size[None, :]
    inner = normal[1:, 1:] + 1e-6 * np.eye(len(normal) - 1)
    rss = normal[0, 0] - normal[0, 1:] @ np.linalg.solve(inner, normal[0, 1:])
    return float(-0.5 * count * np.log(max(rss, 1e-12) * full[0, 0]))
