"""From raw rows to means over the analysis intervals of all runs at once, for any delay and lag of the meter.

Columns are evaluated at the raw rate by the caller and averaged here: a non-linear feature of an average is biased.
A mean is linear in the column once its cumulative integral and the slopes of that are known, so that any delay, also a
fraction of a sample, is exact for rows that hold their value, and one sparse matrix of weights for a clock serves every
column of every run. The clock begins where the profile likelihood of a prewhitened regression has its best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import RunData
from missionsim.identify.settings import CLOCK_RUNS, FINEST_STEP_S, GAP_ROWS
from missionsim.physics import Array

CONSTANT = 1e-16
"""What is left of a column's square without its mean, when it is rounding only: scaled up it would be pure chance."""
STILL = 1e-9
"""Relative change of a column from which on it changes at all."""
Place = tuple[float, float]
"""Delay and lag [s]."""
LAG_NODES = (
    (0.117749, 0.414886, 0.756347, 1.169002, 1.672137, 2.305652, 3.236879, 5.173300),
    (0.234149, 0.208057, 0.174883, 0.141027, 0.103961, 0.073272, 0.045579, 0.019072),
)
"""Delays, in times a first-order lag, and their weights: steps averaged over a quarter of it err by 3 %."""
Weights = tuple[Any, Array]
"""Of one clock: a sparse matrix (edges, 2 * edges of the rows) for the stacked curves, and the time in the rows of each
edge [s], shape (edges,)."""


@dataclass(frozen=True)
class Bins:
    """Analysis intervals of one run: measured means and where they lie in time; arrays of shape (bins,)."""

    low_s: Array
    high_s: Array
    measured_w: Array
    starts: NDArray[np.intp]
    """First bin of each stretch without a gap."""


def _row_edges(time_s: Array) -> tuple[Array, Array, Array, float]:
    """Edges that split the time half-way between the rows, where the reach of each row begins and ends, which is
    shorter beside a gap, and the usual step."""
    step = float(np.median(np.diff(time_s)))
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    edges = np.concatenate([[time_s[0] - 0.5 * step], middle, [time_s[-1] + 0.5 * step]])
    low, high = np.maximum(edges[:-1], time_s - 0.75 * step), np.minimum(edges[1:], time_s + 0.75 * step)
    return edges, low, high, step


def make_bins(run: RunData, period_s: float) -> Bins:
    """Group rows into intervals of about `period_s`; a slow power topic sets its own intervals.

    Rows without a measurement leave a gap; a group never spans one.
    """
    time_s, power = run.time_s, run.measured_w
    _, low, high, step = _row_edges(time_s)
    usable = np.isfinite(power)
    if run.fresh is not None and not bool(np.all(run.fresh)):
        # a value that is first seen in row r was measured between the refresh before and r
        rows = np.flatnonzero(run.fresh & usable)
        if len(rows) < 3:
            raise ValueError(f"run {run.run}: power was refreshed {len(rows)} times only")
        refresh_s = np.diff(time_s[rows])
        step = float(np.median(refresh_s))
        whole = refresh_s <= GAP_ROWS * step
        low, high, power = (x[whole] for x in (high[rows[:-1]], high[rows[1:]], power[rows[1:]]))
    else:
        low, high, power = low[usable], high[usable], power[usable]
    if len(low) == 0:
        return Bins(low, low, low, np.empty(0, dtype=np.intp))
    per_bin = max(1, round(period_s / step))
    breaks = np.flatnonzero(low[1:] - high[:-1] > (GAP_ROWS - 1.5) * step) + 1
    begins, ends, starts = list[int](), list[int](), list[int]()
    for begin, end in pairwise([0, *breaks.tolist(), len(low)]):
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
class Rows:
    """Rows of one run as columns are kept: as they were logged, or means of those that are faster than `FINEST_STEP_S`.

    Each keeps its own edges. On an even grid in their place, rows at uneven times would be mixed with their neighbours,
    which takes the height off whatever changes from row to row, and from acceleration most.
    """

    edges_s: Array
    """Shape (rows + 1,)."""
    logged: NDArray[np.intp] | None = None
    """Number of the logged row of each piece, where a row beside a gap is two: its own reach and what fills the gap."""
    together: tuple[NDArray[np.intp], Array] | None = None
    """Of pieces that were put together: the first of each row, and the length of every piece [s]."""

    @classmethod
    def of(cls, run: RunData) -> Rows:
        """Rows of a run; none is put together with what fills a gap."""
        own, low, high, step = _row_edges(run.time_s)
        far = np.diff(own) > 2.0 * step
        edges = np.unique(np.concatenate([own, low[far], high[far]]))
        length = np.diff(edges)
        logged = None if len(edges) == len(own) else np.searchsorted(own, edges[:-1], side="right") - 1
        if step >= 0.99 * FINEST_STEP_S:
            return cls(edges, logged)
        cell = np.floor((edges[:-1] - edges[0]) / FINEST_STEP_S + 1e-6)
        apart = length > 2.0 * step
        starts = np.flatnonzero(np.append(True, (np.diff(cell) > 0.0) | apart[1:] | apart[:-1]))
        return cls(np.append(edges[starts], edges[-1]), logged, (starts, length))

    def on(self, values: Array) -> Array:
        """Columns (k, logged rows) as means over these rows, which keep their integral."""
        pieces = values if self.logged is None else values.take(self.logged, axis=1)
        if self.together is None:
            return pieces
        starts, length = self.together
        return np.asarray(np.add.reduceat(pieces * length, starts, axis=1) / np.diff(self.edges_s))


@dataclass
class RunColumns:
    """Columns of one run, ready to be lagged, delayed and averaged; ``values`` (columns, rows)."""

    bins: Bins
    rows: Rows
    values: Array

    @classmethod
    def of(cls, run: RunData, bins: Bins, columns: Sequence[Array]) -> RunColumns:
        """The given columns, one value for each logged row."""
        rows = Rows.of(run)
        return cls(bins, rows, rows.on(np.ascontiguousarray(np.vstack([np.asarray(c, dtype=float) for c in columns]))))


def integral_curves(columns: Sequence[Array], rows: Sequence[Rows]) -> Array:
    """Cumulative integral of columns of each run as a cubic inside each row, runs one after the other.

    Its slope at a row's edge, half-way between two rows' times, is the mean of both, limited so that the cubic stays
    monotone; a linear ramp between rows is thereby reproduced although each row holds its mean.

    Parameters
    ----------
    columns : sequence of ndarray, shape (k, rows of the run)
    rows : sequence of Rows
        When those rows are.

    Returns
    -------
    ndarray, shape (2, edges of the rows of all runs, k)
        The integral and its slope at each edge; a run has one edge more than rows.
    """
    out = np.empty((2, sum(values.shape[1] + 1 for values in columns), columns[0].shape[0]))
    begin = 0
    for values, own in zip(columns, rows, strict=True):
        means = np.ascontiguousarray(values.T)
        length = np.diff(own.edges_s)
        integral, slope = out[:, begin : begin + len(means) + 1]
        begin += len(means) + 1
        integral[0] = 0.0
        np.cumsum(means * length[:, None], axis=0, out=integral[1:])
        left, right = means[:-1], means[1:]
        slope[0], slope[-1] = means[0], means[-1]
        # in place: no arrays are larger than these
        inner = np.add(left, right, out=slope[1:-1])
        inner *= 0.5
        size = np.abs(means)
        limit = np.minimum(size[:-1], size[1:])
        limit *= 3.0
        np.minimum(inner, limit, out=inner)
        np.negative(limit, out=limit)
        np.maximum(inner, limit, out=inner)
        np.multiply(left, right, out=limit)
        inner *= limit > 0.0
    return out


def _hermite(s: Array, length_s: Array) -> tuple[Array, ...]:
    """Weights of the integral at both edges of a row, and of its slope there, for the place s in the row (0 to 1)."""
    rise = s * s * (3.0 - 2.0 * s)
    back = s * (1.0 - s) * length_s
    return 1.0 - rise, rise, back * (1.0 - s), -back * s


@dataclass(frozen=True)
class Intervals:
    """Analysis intervals of several runs among the rows of each; the times of a run begin where the last one ends."""

    edges_s: Array
    run: NDArray[np.intp]
    """Both: edges in the order of time, run by run, and the number of their run. Shape (edges,)."""
    low_at: NDArray[np.intp]
    """Edge at which each interval begins; it ends at the next. Shape (intervals,)."""
    least_s: Array
    """Least time that a mean is taken over. Shape (intervals,)."""
    rows_s: Array
    """Edges of all runs' rows, stacked."""
    first: NDArray[np.intp]
    last: NDArray[np.intp]
    """Both: the first and the last of these edges in the run of each edge. Shape (edges,)."""

    @classmethod
    def of(cls, runs: Sequence[RunColumns]) -> Intervals:
        """Intervals of several runs, which never overlap, to be averaged over together."""
        edges, rows, low_at, least, total, end_s = [], [], [], [], 0, 0.0
        for low, high, row_edges in ((r.bins.low_s, r.bins.high_s, r.rows.edges_s) for r in runs):
            # where intervals touch, one edge serves both
            apart = np.append(np.abs(high[:-1] - low[1:]) >= 1e-9, True)
            begin = np.arange(len(low)) + np.concatenate([[0], np.cumsum(apart[:-1])])
            own = np.empty(len(low) + int(apart.sum()))
            own[begin] = low
            own[begin[apart] + 1] = high[apart]
            shift = end_s - row_edges[0]
            edges.append(own + shift)
            rows.append(row_edges + shift)
            low_at.append(begin + total)
            least.append(0.1 * (high - low))
            total += len(own)
            end_s = rows[-1][-1]
        run = np.repeat(np.arange(len(edges)), [len(e) for e in edges])
        ends = np.cumsum([len(r) for r in rows])
        return cls(
            np.concatenate(edges),
            run,
            np.concatenate(low_at).astype(np.intp),
            np.concatenate(least),
            rows_s=np.concatenate(rows),
            first=np.append(0, ends[:-1])[run],
            last=(ends - 1)[run],
        )

    def weights(self, delay_s: Array, lag_s: float) -> Weights:
        """Weights for the delay of each run, shape (runs,), and a common lag [s]."""
        from scipy.sparse import csr_array

        left, parts, at_s, weight = self._places(delay_s, lag_s)
        rows = len(self.rows_s)
        # filled along the edges and turned once: a matrix has its numbers row by row
        data = np.empty((len(weight), 4, left.shape[1]))
        at = np.empty(data.shape, dtype=np.int32)
        for i, (part, edge) in enumerate(zip(parts, (0, 1, rows, rows + 1), strict=True)):
            np.multiply(weight[:, None], part, out=data[:, i])
            np.add(left, edge, out=at[:, i])
        by_row, places = (x.reshape(-1, left.shape[1]).T.ravel() for x in (data, at))
        count = len(self.edges_s)
        ends = np.arange(count + 1, dtype=np.int32) * np.int32(4 * len(weight))
        return csr_array((by_row, places, ends), shape=(count, 2 * rows)), weight @ at_s

    def means(self, curves: Array, weights: Weights) -> Array:
        """Mean of columns over every interval, shape (intervals, k), from their `integral_curves`."""
        at_edges, at_s = weights
        return self._mean(at_edges @ curves.reshape(-1, curves.shape[2]), at_s)

    def means_of_one(self, curve: Array, delay_s: Array, lag_s: float) -> Array:
        """The same for a single column without a matrix, shape (intervals,), from its curve (2, edges, 1)."""
        left, parts, at_s, weight = self._places(delay_s, lag_s)
        integral, slope = curve[:, :, 0]
        values = (integral.take(left), integral.take(left + 1), slope.take(left), slope.take(left + 1))
        whole = weight @ sum(part * value for part, value in zip(parts, values, strict=True))
        return self._mean(whole[:, None], weight @ at_s)[:, 0]

    def _mean(self, whole: Array, at_s: Array) -> Array:
        """Means over the intervals from integrals at their edges, shape (edges, k), and the times of these."""
        difference = (whole[1:] - whole[:-1]).take(self.low_at, axis=0)
        # at the ends of the log a delayed column is known for a part of the interval only; a constant stays one
        difference /= np.maximum(np.diff(at_s).take(self.low_at), self.least_s)[:, None]
        return np.asarray(difference)

    def _places(self, delay_s: Array, lag_s: float) -> tuple[NDArray[np.intp], tuple[Array, ...], Array, Array]:
        """Edge at the start of a row, the weights of `_hermite` and the time at every node of the lag and edge, all of
        shape (nodes, edges); weights (nodes,)."""
        if not np.isfinite(np.sum(delay_s) + lag_s):  # rows are taken without a check of their numbers
            raise ValueError("the clock of the meter comes out as no number")
        late, weight = np.array(LAG_NODES if lag_s > 0 else ((0.0,), (1.0,)))
        late_s = (self.edges_s - delay_s[self.run]) - late[:, None] * lag_s
        at_s = np.clip(late_s, self.rows_s[self.first], self.rows_s[self.last])
        left = np.clip(np.searchsorted(self.rows_s, at_s, side="right") - 1, self.first, self.last - 1)
        length = np.diff(self.rows_s).take(left)
        return left, _hermite((at_s - self.rows_s.take(left)) / length, length), at_s, weight


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


CLOCK_STEPS = (*((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)), (-1, 2), (1, -2))
"""Of delay and lag, which nearly trade against each other."""


def uphill(
    score: Callable[[float, float], float],
    centre: Place,
    reach: float,
    steps: Sequence[tuple[int, int]],
    turns: int,
    digits: int,
    least: float = 0.0,
) -> Place:
    """The best delay and lag by a pattern search, first with steps of a tenth of `reach`, then with half of that; it
    ends after so many turns, or where a step gains less than the `least`."""
    for width in (0.1 * reach, 0.05 * reach):
        for _ in range(turns):
            around = [
                (round(centre[0] + i * width, digits), round(max(0.0, centre[1] + j * width), digits)) for i, j in steps
            ]
            top = max(around, key=lambda place: score(*place))
            if top == centre or score(*top) < score(*centre) + least:
                break
            centre = top
    return centre


def still(runs: Sequence[RunColumns]) -> bool:
    """Whether no column changes within any run: such a power is neither late nor early."""
    return all(np.ptp(row) <= STILL * np.max(np.abs(row), initial=0.0) for run in runs for row in run.values)


def find_clock(runs: Sequence[RunColumns], step_s: float) -> Place:
    """Common delay and lag [s] by profile likelihood of a prewhitened regression with all columns in.

    Row 0 of each run's columns is the base model; keeping every candidate in leaves a real inertia effect alone.
    """
    reach = max(1.0, step_s)
    # a start is all that is wanted; the model refines it with every run
    runs = runs[:: -(-len(runs) // 4)] if len(runs) > CLOCK_RUNS else runs
    score = cache(alignment(runs, step_s))
    grid = [(round(0.2 * d * reach, 4), round(lag * reach, 4)) for lag in (0.0, 0.2, 0.45, 0.8) for d in range(-4, 5)]
    centre = max(grid, key=lambda place: score(*place))
    return uphill(score, centre, reach, CLOCK_STEPS, 4, 4)


def alignment(runs: Sequence[RunColumns], step_s: float) -> Callable[[float, float], float]:
    """Log-likelihood of differenced rows, every column in, for a delay and a lag."""
    intervals = Intervals.of(runs)
    curves = integral_curves([run.values for run in runs], [run.rows for run in runs])
    measured_w = np.concatenate([run.bins.measured_w for run in runs])
    # first bin of each run, and 1 where a bin has one before it in the same stretch, but for the first bin of all
    firsts = np.cumsum([0, *(len(run.bins.measured_w) for run in runs[:-1])])
    known = np.ones(len(measured_w))
    known[np.concatenate([first + run.bins.starts for run, first in zip(runs, firsts, strict=True)])] = 0.0
    known, begins, keep = known[1:], np.maximum(firsts - 1, 0), 0.85**step_s
    counts = np.add.reduceat(known, begins)

    def score(delay_s: float, lag_s: float) -> float:
        rows = intervals.means(curves, intervals.weights(np.full(len(runs), delay_s), lag_s))
        white: Array = np.empty((len(rows) - 1, rows.shape[1] + 1))
        np.subtract(rows[1:], keep * rows[:-1], out=white[:, 1:])
        residual = measured_w - rows[:, 0]
        white[:, 0] = residual[1:] - keep * residual[:-1]
        white *= known[:, None]
        least = CONSTANT * np.einsum("ij,ij->j", white, white)
        own = np.add.reduceat(white, begins, axis=0) / counts[:, None]
        white -= np.repeat(own, np.diff(begins, append=len(white)), axis=0) * known[:, None]
        full = white.T @ white
        constant = np.diag(full) < least
        full[constant] = 0.0
        full[:, constant] = 0.0
        size = np.sqrt(np.maximum(np.diag(full), 1e-300))
        normal = full / size[:, None] / size[None, :]
        inner = normal[1:, 1:] + 1e-6 * np.eye(len(normal) - 1)
        rss = normal[0, 0] - normal[0, 1:] @ np.linalg.solve(inner, normal[0, 1:])
        return float(-0.5 * (known.sum() - len(counts)) * np.log(max(rss, 1e-12) * full[0, 0]))

    return score
