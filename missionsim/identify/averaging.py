"""From raw rows to means over the analysis intervals of all runs at once, for any delay and lag of the meter.

Columns are evaluated at the raw rate by the caller and averaged here: a non-linear feature of an average is biased.
A mean is linear in the column once its cumulative integral and the slopes of that are known, so that any delay, also a
fraction of a sample, is exact for rows that hold their value, and one sparse matrix of weights for a clock serves every
column of every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from missionsim.identify.data import RunData
from missionsim.identify.settings import FINEST_STEP_S, GAP_ROWS
from missionsim.physics import Array, Ints

LAG_NODES = (
    (0.117749, 0.414886, 0.756347, 1.169002, 1.672137, 2.305652, 3.236879, 5.173300),
    (0.234149, 0.208057, 0.174883, 0.141027, 0.103961, 0.073272, 0.045579, 0.019072),
)
"""Delays, in times a first-order lag, and their weights: steps averaged over a quarter of it err by 3 %."""
Weights = tuple[Any, Array]
"""Of one clock: a sparse matrix (edges, 2 * edges of the rows) for the stacked curves, and the time in the rows of each
edge [s], shape (edges,)."""
MOST_CELLS = 8
"""Cells of time for each edge of rows, up to which rows are looked up; rows of very unlike length are searched for."""


@dataclass(frozen=True)
class Bins:
    """Analysis intervals of one run: measured means and where they lie in time; arrays of shape (bins,)."""

    low_s: Array
    high_s: Array
    measured_w: Array
    starts: Ints
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
    logged: Ints | None = None
    """Number of the logged row of each piece, where a row beside a gap is two: its own reach and what fills the gap."""
    together: tuple[Ints, Array] | None = None
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


@dataclass(frozen=True)
class Intervals:
    """Analysis intervals of several runs among the rows of each; the times of a run begin where the last one ends."""

    edges_s: Array
    run: Ints
    """Both: edges in the order of time, run by run, and the number of their run. Shape (edges,)."""
    low_at: Ints
    """Edge at which each interval begins; it ends at the next. Shape (intervals,)."""
    least_s: Array
    """Least time that a mean is taken over. Shape (intervals,)."""
    rows_s: Array
    """Edges of all runs' rows, stacked."""
    first: Ints
    last: Ints
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

    @cached_property
    def _rows_last(self) -> tuple[Array, Array, Ints]:
        """Of each edge, the time at which the rows of its run begin and end, and the last of these rows."""
        return self.rows_s[self.first], self.rows_s[self.last], self.last - 1

    @cached_property
    def _length_s(self) -> Array:
        """Of the rows of all runs; what lies between two runs has none."""
        return np.diff(self.rows_s)

    @cached_property
    def _cells(self) -> tuple[float, Ints] | None:
        """Cells of even length, so short that one row at most ends in each: how many there are in a second, and the row
        in which each begins. None where there would be too many."""
        inside = np.delete(self._length_s, np.unique(self.last)[:-1])
        step = 0.9 * float(inside.min())
        count = (self.rows_s[-1] - self.rows_s[0]) / step if step > 0.0 else np.inf
        if not count < MOST_CELLS * len(self.rows_s):
            return None
        # a hair earlier, so that rounding never puts a time into a row that has not begun
        begins = self.rows_s[0] + step * (np.arange(int(count) + 2) - 1e-6)
        row = np.searchsorted(self.rows_s, begins, side="right") - 1
        return 1.0 / step, np.clip(row, 0, len(self.rows_s) - 2)

    def _row_of(self, at_s: Array) -> Ints:
        """The last row that has begun at each time, among those of all runs."""
        if self._cells is None:
            return np.searchsorted(self.rows_s, at_s, side="right") - 1
        per_s, row = self._cells
        found: Ints = row.take(((at_s - self.rows_s[0]) * per_s).astype(np.intp))
        found += self.rows_s.take(found + 1) <= at_s
        return found

    def weights(self, delay_s: Array, lag_s: float) -> Weights:
        """Weights for the delay of each run, shape (runs,), and a common lag [s]."""
        from scipy.sparse import csr_array

        left, s, at_s, weight = self._places(delay_s, lag_s)
        count, rows = len(self.edges_s), len(self.rows_s)
        # of the integral at both edges of a row, and of its slope there, for the place s in the row
        rise = s * s * (3.0 - 2.0 * s)
        back = s * (1.0 - s) * self._length_s.take(left)
        late = back * s
        rise *= weight[:, None]
        # a matrix has its numbers row by row
        first = np.ascontiguousarray(left.T, dtype=np.int32)
        data, at = np.empty((count, len(weight), 4)), np.empty((count, len(weight), 4), dtype=np.int32)
        parts = (weight[:, None] - rise, rise, (back - late) * weight[:, None], late * -weight[:, None])
        for i, (part, edge) in enumerate(zip(parts, (0, 1, rows, rows + 1), strict=True)):
            data[:, :, i] = part.T
            np.add(first, np.int32(edge), out=at[:, :, i])
        ends = np.arange(count + 1, dtype=np.int32) * np.int32(4 * len(weight))
        return csr_array((data.ravel(), at.ravel(), ends), shape=(count, 2 * rows)), weight @ at_s

    def means(self, curves: Array, weights: Weights) -> Array:
        """Mean of columns over every interval, shape (intervals, k), from their `integral_curves`."""
        at_edges, at_s = weights
        return self._mean(at_edges @ curves.reshape(-1, curves.shape[2]), at_s)

    def cubics(self, curve: Array) -> Array:
        """The integral of a single column in every row as a cubic of the place in it, from its curve (2, edges, 1):
        coefficients (4, rows), the constant first."""
        integral, slope = curve[:, :, 0]
        whole, early, late = np.diff(integral), slope[:-1] * self._length_s, slope[1:] * self._length_s
        return np.stack([integral[:-1], early, 3.0 * whole - 2.0 * early - late, early + late - 2.0 * whole])

    def means_of_one(self, cubics: Array, delay_s: Array, lag_s: float) -> Array:
        """Mean of a single column over every interval without a matrix, shape (intervals,), from its `cubics`."""
        left, s, at_s, weight = self._places(delay_s, lag_s)
        value = cubics[3].take(left)
        for coefficient in cubics[2::-1]:
            value *= s
            value += coefficient.take(left)
        return self._mean((weight @ value)[:, None], weight @ at_s)[:, 0]

    def _mean(self, whole: Array, at_s: Array) -> Array:
        """Means over the intervals from integrals at their edges, shape (edges, k), and the times of these."""
        difference = (whole[1:] - whole[:-1]).take(self.low_at, axis=0)
        # at the ends of the log a delayed column is known for a part of the interval only; a constant stays one
        difference /= np.maximum(np.diff(at_s).take(self.low_at), self.least_s)[:, None]
        return np.asarray(difference)

    def _places(self, delay_s: Array, lag_s: float) -> tuple[Ints, Array, Array, Array]:
        """Row, place in it (0 to 1) and time at every node of the lag and edge, all of shape (nodes, edges); weights of
        the nodes, shape (nodes,)."""
        if not np.isfinite(np.sum(delay_s) + lag_s):  # rows are taken without a check of their numbers
            raise ValueError("the clock of the meter comes out as no number")
        begin_s, end_s, last = self._rows_last
        late, weight = np.array(LAG_NODES if lag_s > 0 else ((0.0,), (1.0,)))
        at_s = (self.edges_s - delay_s[self.run]) - late[:, None] * lag_s
        np.minimum(np.maximum(at_s, begin_s, out=at_s), end_s, out=at_s)
        left = self._row_of(at_s)
        np.minimum(np.maximum(left, self.first, out=left), last, out=left)
        place = at_s - self.rows_s.take(left)
        place /= self._length_s.take(left)
        return left, place, at_s, weight
