"""From raw rows to the analysis rate, with a delay and a first-order lag of the power meter (steps 0 and 1).

Columns are evaluated at the raw rate by the caller and averaged here: a non-linear feature of an average is biased.
Averages come from cumulative integrals, so that any delay, also a fraction of a sample, is exact for rows that hold
their value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.averaging import Intervals, integral_curves
from missionsim.identify.data import RunData
from missionsim.identify.settings import CLOCK_RUNS, FINEST_STEP_S, GAP_ROWS
from missionsim.physics import Array

CONSTANT = 1e-16
"""What is left of a column's square without its mean, when it is rounding only: scaled up it would be pure chance."""


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


@dataclass(frozen=True)
class EvenGrid:
    """How columns at the rows of one run are put on an even grid, unchanged where the rows already are even.

    ``before`` and ``inside_s`` say in which row, and how far behind its edge, each edge of the even grid lies.
    """

    start_s: float
    step_s: float
    length_s: Array
    before: NDArray[np.intp] | None = None
    inside_s: Array | None = None

    @classmethod
    def of(cls, run: RunData) -> EvenGrid:
        """Grid of a run."""
        edges, gaps, step = _row_edges(run.time_s)
        length = np.diff(edges)
        if bool(np.all(np.abs(gaps - step) <= 0.02 * step)) and step >= 0.99 * FINEST_STEP_S:
            return cls(float(edges[0]), step, length)
        target = max(step, FINEST_STEP_S)
        count = max(2, int(np.ceil((edges[-1] - edges[0]) / target - 1e-6)))
        target = float(edges[-1] - edges[0]) / count  # no part of a row beyond the end
        grid = np.linspace(edges[0], edges[-1], count + 1)
        before = np.clip(np.searchsorted(edges, grid, side="right") - 1, 0, len(length) - 1)
        return cls(float(edges[0]), target, length, before, grid - edges[before])

    def on(self, values: Array) -> Array:
        """Columns (k, rows) as means over the rows of the even grid, which keep their integral."""
        if self.before is None or self.inside_s is None:
            return values
        cumulative = np.zeros((values.shape[0], values.shape[1] + 1))
        np.cumsum(values * self.length_s, axis=1, out=cumulative[:, 1:])
        at_edges = values.take(self.before, axis=1)
        at_edges *= self.inside_s
        at_edges += cumulative.take(self.before, axis=1)
        return np.asarray((at_edges[:, 1:] - at_edges[:, :-1]) / self.step_s)


@dataclass
class RunColumns:
    """Columns of one run on an even raw grid, ready to be lagged, delayed and averaged; ``values`` (columns, rows)."""

    bins: Bins
    start_s: float
    step_s: float
    values: Array

    @classmethod
    def of(cls, run: RunData, bins: Bins, rows: Sequence[Array]) -> RunColumns:
        """Put the given raw columns on an even grid (unchanged where the rows already are even)."""
        grid = EvenGrid.of(run)
        values = np.ascontiguousarray(np.vstack([np.asarray(r, dtype=float) for r in rows]))
        return cls(bins, grid.start_s, grid.step_s, grid.on(values))

    def averaged(self, delay_s: float, lag_s: float) -> Array:
        """Mean of columns over every bin, shape (columns, bins), as a late and sluggish meter would see it."""
        intervals = intervals_of([self])
        weights = intervals.weights(np.array([delay_s]), lag_s)
        return np.ascontiguousarray(intervals.means(integral_curves([self.values]), weights).T)


def intervals_of(runs: Sequence[RunColumns]) -> Intervals:
    """Analysis intervals of several runs, to be averaged over together."""
    ends = [(r.bins.low_s, r.bins.high_s) for r in runs]
    return Intervals.of(ends, [r.start_s for r in runs], [r.step_s for r in runs], [r.values.shape[1] for r in runs])


@dataclass(frozen=True)
class Clock:
    """Delay of the power meter behind the motion [s] (common, and of each run) and its first-order lag [s]."""

    delay_s: float
    lag_s: float
    run_delay_s: tuple[float, ...]
    at_edge: bool = False

    @classmethod
    def as_logged(cls, runs: int) -> Clock:
        """No delay and no lag."""
        return cls(0.0, 0.0, (0.0,) * runs)

    def in_all(self, runs: int) -> Clock:
        """The common delay and lag, with no delay of a run's own."""
        return replace(self, run_delay_s=(0.0,) * runs)

    def of_runs(self, numbers: Sequence[int]) -> Clock:
        """The clock of some of the runs."""
        return replace(self, run_delay_s=tuple(self.run_delay_s[j] for j in numbers))


def find_clock(runs: Sequence[RunColumns], step_s: float) -> Clock:
    """Common delay and lag by profile likelihood of a prewhitened regression with all columns in.

    Row 0 of each run's columns is the base model; keeping every candidate in leaves a real inertia effect alone.
    """
    reach = max(1.0, 1.0 * step_s)
    if len(runs) > CLOCK_RUNS:
        runs = runs[:: -(-len(runs) // 4)]  # a start is all that is wanted; the model refines it with every run
    best: dict[tuple[float, float], float] = {}
    trial = _Alignment.of(runs, step_s)

    def score(delay: float, lag: float) -> float:
        key = (round(delay, 4), round(lag, 4))
        if key not in best:
            best[key] = trial.score(key[0], key[1])
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


@dataclass(frozen=True)
class _Alignment:
    """Runs prepared for the profile likelihood of a common delay and lag."""

    intervals: Intervals
    curves: Array
    measured_w: Array
    keep: float
    known: Array
    """1 where a bin has one before it in the same stretch, 0 elsewhere, but for the first bin of all."""
    firsts: NDArray[np.intp]
    """First bin of each run."""

    @classmethod
    def of(cls, runs: Sequence[RunColumns], step_s: float) -> _Alignment:
        """Everything that does not depend on the clock."""
        firsts = np.concatenate([[0], np.cumsum([len(run.bins.measured_w) for run in runs])])
        measured = np.concatenate([run.bins.measured_w for run in runs])
        known = np.ones(len(measured))
        for run, first in zip(runs, firsts[:-1], strict=True):
            known[first + run.bins.starts] = 0.0
        curves = integral_curves([run.values for run in runs])
        return cls(intervals_of(runs), curves, measured, 0.85**step_s, known[1:], firsts[:-1])

    def score(self, delay_s: float, lag_s: float) -> float:
        """Log-likelihood of differenced rows, every column in."""
        weights = self.intervals.weights(np.full(len(self.firsts), delay_s), lag_s)
        rows = self.intervals.means(self.curves, weights)
        white = np.empty((len(rows) - 1, rows.shape[1] + 1))
        np.subtract(rows[1:], self.keep * rows[:-1], out=white[:, 1:])
        residual = self.measured_w - rows[:, 0]
        white[:, 0] = residual[1:] - self.keep * residual[:-1]
        white *= self.known[:, None]
        least = CONSTANT * np.einsum("ij,ij->j", white, white)
        begins = np.maximum(self.firsts - 1, 0)
        counts = np.add.reduceat(self.known, begins)
        own = np.add.reduceat(white, begins, axis=0) / counts[:, None]
        white -= np.repeat(own, np.diff(begins, append=len(white)), axis=0) * self.known[:, None]
        full = white.T @ white
        constant = np.diag(full) < least
        full[constant] = 0.0
        full[:, constant] = 0.0
        size = np.sqrt(np.maximum(np.diag(full), 1e-300))
        normal = full / size[:, None] / size[None, :]
        inner = normal[1:, 1:] + 1e-6 * np.eye(len(normal) - 1)
        rss = normal[0, 0] - normal[0, 1:] @ np.linalg.solve(inner, normal[0, 1:])
        freedom = self.known.sum() - len(counts)
        return float(-0.5 * freedom * np.log(max(rss, 1e-12) * full[0, 0]))
