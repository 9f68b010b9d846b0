"""Assemble all runs into one regression: y - P0 = N nu + Phi beta + Z_j u_j + noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.align import Bins, Clock, EvenGrid, RunColumns, find_clock, intervals_of, make_bins
from missionsim.identify.averaging import Intervals, Weights, integral_curves
from missionsim.identify.data import Candidate, Column, Layout, RunData
from missionsim.identify.settings import (
    CLOCK_SD_S,
    CLOCK_SD_S2,
    CURVATURE_SD,
    DEFAULT_PRIOR_SD,
    DERIVATIVE_STEP_S,
    FEWEST_INTERVALS,
    SWITCH_SD,
    Settings,
)
from missionsim.physics import Array

KEPT_CURVES = 4
HEAD_ROWS = 4
"""Rows before the gradient in a run's columns: base, motion, switching, speed change inside a row."""


@dataclass(frozen=True)
class Design:
    """Rows of all runs one after the other, at the analysis rate.

    Shapes: ``y``, ``base``, ``duration_s``, ``time_s`` (n,); ``gradient`` (q+4, n); ``phi`` (p, n), in watts for a
    coefficient that makes 100 % of the mean measured power; ``random`` (5, n). ``gradient`` ends with four
    nuisances: the first and second derivative of the base model after the delay, what a change of speed inside a
    row adds to a curved model, and the jumps at rows where a term switches. ``runs`` are slices, ``stretches`` are
    slices without a gap.
    """

    layout: Layout
    y: Array
    base: Array
    duration_s: Array
    time_s: Array
    gradient: Array
    phi: Array
    random: Array
    _: KW_ONLY
    runs: tuple[slice, ...]
    stretches: tuple[slice, ...]
    names: tuple[str, ...]

    @property
    def residual(self) -> Array:
        """Measured minus base model [W], shape (n,)."""
        return self.y - self.base

    def of_runs(self, numbers: Sequence[int], most: int | None = None) -> tuple[Design, NDArray[np.intp]]:
        """The rows of some runs, the first `most` of each, and where they stand in all, shape (rows,)."""
        at: list[NDArray[np.intp]] = []
        runs: list[slice] = []
        stretches: list[slice] = []
        for j in numbers:
            run, begin = self.runs[j], runs[-1].stop if runs else 0
            stop = run.stop if most is None else min(run.stop, run.start + most)
            at.append(np.arange(run.start, stop))
            runs.append(slice(begin, begin + stop - run.start))
            own = [(part.start, min(part.stop, stop)) for part in self.stretches if run.start <= part.start < stop]
            stretches += [slice(first - run.start + begin, last - run.start + begin) for first, last in own]
        part, names = np.concatenate(at), tuple(self.names[j] for j in numbers)
        rows = {name: getattr(self, name)[part] for name in ("y", "base", "duration_s", "time_s")}
        stacks = {name: getattr(self, name)[:, part] for name in ("gradient", "phi", "random")}
        return replace(self, **rows, **stacks, runs=tuple(runs), stretches=tuple(stretches), names=names), part

    def run_index(self) -> NDArray[np.intp]:
        """Number of the run of each row, shape (n,)."""
        out = np.empty(len(self.y), dtype=np.intp)
        for j, rows in enumerate(self.runs):
            out[rows] = j
        return out


@dataclass(frozen=True)
class Frame:
    """What a design holds for any clock: measured power, times, and where runs and stretches lie."""

    y: Array
    duration_s: Array
    time_s: Array
    runs: tuple[slice, ...]
    stretches: tuple[slice, ...]

    @classmethod
    def of(cls, bins: Sequence[Bins]) -> Frame:
        """Intervals of all runs one after the other."""
        runs: list[slice] = []
        stretches: list[slice] = []
        total = 0
        for b in bins:
            count = len(b.measured_w)
            runs.append(slice(total, total + count))
            ends = [*(total + b.starts[1:]), total + count]
            stretches += [slice(int(total + first), int(end)) for first, end in zip(b.starts, ends, strict=True)]
            total += count
        low, high = np.concatenate([b.low_s for b in bins]), np.concatenate([b.high_s for b in bins])
        y = np.concatenate([b.measured_w for b in bins])
        return cls(y, high - low, 0.5 * (high + low), tuple(runs), tuple(stretches))


@dataclass
class Source:
    """Runs at the raw rate, kept so that the design can be rebuilt for another clock or other columns."""

    runs: tuple[RunData, ...]
    columns: list[RunColumns]
    covariates: tuple[str, ...]
    layout: Layout
    clock: Clock
    aligned: bool = False
    kept: tuple[int, ...] = ()
    """Numbers of the given runs that were long enough."""
    _root: Source | None = None
    """The source that this one varies, and the integral curves of the columns that differ."""
    _: KW_ONLY
    _varied: dict[int, Array] = field(default_factory=dict)
    _kept_design: tuple[tuple[Clock, tuple[int, ...]], Design] | None = None
    _even: list[EvenGrid] | None = None
    _frame: Frame | None = None
    _grid: Intervals | None = None
    _kept_base: Array | None = None
    _kept_curves: dict[tuple[int, ...], Array] = field(default_factory=dict)
    _kept_weights: tuple[Clock, Weights] | None = None

    def with_column(self, column: int, layout: Layout, rows: Sequence[Array]) -> Source:
        """The same runs with one column, an array (rows,) for each run, evaluated anew; the rest is shared."""
        root = self._root or self
        curve = integral_curves(
            [
                grid.on(np.asarray(values, dtype=float)[None, :])
                for grid, values in zip(root._grids(), rows, strict=True)
            ]
        )
        return Source(
            self.runs,
            self.columns,
            self.covariates,
            layout,
            self.clock,
            self.aligned,
            self.kept,
            _root=root,
            _varied={**self._varied, column: curve},
        )

    def of_runs(self, numbers: Sequence[int]) -> Source:
        """The same columns in some of the runs."""
        root = self._root or self
        ends = np.cumsum([0, *(run.values.shape[1] + 1 for run in self.columns)])
        at = np.concatenate([np.arange(ends[j], ends[j + 1]) for j in numbers])
        return Source(
            tuple(self.runs[j] for j in numbers),
            [self.columns[j] for j in numbers],
            self.covariates,
            self.layout,
            self.clock.of_runs(numbers),
            self.aligned,
            tuple(self.kept[j] for j in numbers),
            _root=None if self._root is None else root.of_runs(numbers),
            _varied={k: curve[:, at] for k, curve in self._varied.items()},
        )

    def rows_of(self, numbers: Sequence[int]) -> NDArray[np.intp]:
        """Where the rows of some runs stand in a design, shape (rows,)."""
        runs = (self._root or self)._rows().runs
        return np.concatenate([np.arange(runs[j].start, runs[j].stop) for j in numbers])

    def design(self, clock: Clock, only: Sequence[int] | None = None) -> Design:
        """Build the regression for a clock, with all candidate columns or some only."""
        chosen = tuple(range(len(self.layout.columns))) if only is None else tuple(only)
        root = self._root or self
        found = root._kept_design[1] if root._kept_design and root._kept_design[0] == (clock, chosen) else None
        if found is None:
            found = root._built(clock, chosen)
            root._kept_design = ((clock, chosen), found)
        if root is self:
            return found
        phi = found.phi.copy()
        for place, k in enumerate(chosen):
            if k in self._varied:
                means = root._intervals().means(self._varied[k], root._weights(clock))[:, 0]
                phi[place] = means * self.layout.unit(k)
        return replace(found, layout=self.layout, phi=phi)

    def _built(self, clock: Clock, chosen: Sequence[int]) -> Design:
        q = len(self.layout.parameters)
        grid = self._intervals()
        curves = self._curves((*range(HEAD_ROWS + q), *(HEAD_ROWS + q + k for k in chosen)))
        here = np.ascontiguousarray(grid.means(curves, self._weights(clock)).T)
        run_delay = clock.delay_s + np.asarray(clock.run_delay_s)
        later, earlier = (
            grid.means_of_one(self._base_curve(), run_delay + shift, clock.lag_s)
            for shift in (DERIVATIVE_STEP_S, -DERIVATIVE_STEP_S)
        )
        base, motion, switching, spread = here[:HEAD_ROWS]
        slope = (later - earlier) / (2 * DERIVATIVE_STEP_S)
        bend = (later - 2 * base + earlier) / DERIVATIVE_STEP_S**2
        scale = np.array([self.layout.unit(k) for k in chosen])
        frame = self._rows()
        return Design(
            self.layout,
            frame.y,
            base,
            frame.duration_s,
            frame.time_s,
            np.vstack([here[HEAD_ROWS : HEAD_ROWS + q], slope, bend, spread, switching]),
            here[HEAD_ROWS + q :] * scale[:, None],
            np.vstack([np.ones_like(base), base, motion, slope, bend]),
            runs=frame.runs,
            stretches=frame.stretches,
            names=tuple(r.run for r in self.runs),
        )

    def _rows(self) -> Frame:
        if self._frame is None:
            self._frame = Frame.of([run.bins for run in self.columns])
        return self._frame

    def averaged(self, raw: Sequence[Array], clock: Clock) -> Array:
        """Any raw columns, one array (k, rows) a run, averaged to the analysis rate with a clock, shape (k, n)."""
        root = self._root or self
        finite = [np.nan_to_num(np.asarray(rows, dtype=float)) for rows in raw]
        even = [grid.on(rows) for grid, rows in zip(root._grids(), finite, strict=True)]
        return np.ascontiguousarray(root._intervals().means(integral_curves(even), root._weights(clock)).T)

    def _grids(self) -> list[EvenGrid]:
        if self._even is None:
            self._even = [EvenGrid.of(run) for run in self.runs]
        return self._even

    def _intervals(self) -> Intervals:
        if self._grid is None:
            self._grid = intervals_of(self.columns)
        return self._grid

    def _base_curve(self) -> Array:
        """Integral curve of the base model, shape (2, edges, 1)."""
        if self._kept_base is None:
            self._kept_base = integral_curves([run.values[:1] for run in self.columns])
        return self._kept_base

    def _curves(self, rows: tuple[int, ...]) -> Array:
        """Integral curves of some columns; those that were used last are kept."""
        found = self._kept_curves.pop(rows, None)
        if found is None:
            found = integral_curves([run.values[list(rows)] for run in self.columns])
        self._kept_curves[rows] = found
        if len(self._kept_curves) > KEPT_CURVES:
            del self._kept_curves[next(iter(self._kept_curves))]
        return found

    def _weights(self, clock: Clock) -> Weights:
        """Weights of a clock; those of the last one are kept."""
        if self._kept_weights is None or self._kept_weights[0] != clock:
            delays = clock.delay_s + np.asarray(clock.run_delay_s)
            self._kept_weights = (clock, self._intervals().weights(delays, clock.lag_s))
        return self._kept_weights[1]


def switch_jumps(run: RunData) -> Array:
    """Power that terms of the base model switch on or off at the edge of each row [W], shape (n,).

    A term switches where its gradient goes from or to zero; the jump is booked on the side with more power, which
    counts as wholly on although the switch may fall anywhere inside the row.
    """
    out = np.zeros(len(run.time_s))
    if not run.gradient:
        return out
    terms = np.vstack(list(run.gradient.values()))
    on = terms != 0.0
    jump = np.sum(np.where(on[:, 1:] != on[:, :-1], np.diff(terms, axis=1), 0.0), axis=0)
    out[1:] += np.maximum(jump, 0.0)
    out[:-1] += np.maximum(-jump, 0.0)
    return out


def _speed_spread(run: RunData, speed: Array) -> Array:
    """Variance of the speed inside each row when it changes evenly [m2/s2]: a row holds the power of its mean speed,
    but the mean of a curved power is more (Jensen)."""
    step = np.diff(speed)
    inside = 0.5 * (np.pad(step, (1, 0), mode="edge") + np.pad(step, (0, 1), mode="edge"))
    return np.asarray(inside**2 / 12.0)


def analysis_step(runs: Sequence[RunData], period_s: float) -> float:
    """Typical length of an analysis interval [s]."""
    steps = []
    for run in runs:
        times = run.time_s if run.fresh is None else run.time_s[run.fresh]
        step = float(np.median(np.diff(times)))
        steps.append(step * max(1, round(period_s / step)))
    return float(np.median(steps))


def make_source(
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    prior_sd: Mapping[str, float],
    settings: Settings,
    like: Source | None = None,
) -> Source:
    """Prepare runs; with `like`, reuse its layout and clock (for held-out runs).

    Candidates without a column in every run, or whose columns never act, get no regression column.
    """
    if not runs:
        raise ValueError("identify needs at least one run")
    bins = [make_bins(run, settings.period_s) for run in runs]
    # a handful of intervals fits its own offset and gain and says nothing more
    kept = tuple(i for i, b in enumerate(bins) if len(b.measured_w) >= FEWEST_INTERVALS)
    runs, bins = [runs[i] for i in kept], [bins[i] for i in kept]
    if not runs:
        raise ValueError(f"no run has at least {FEWEST_INTERVALS} analysis intervals with measured power")
    layout = like.layout if like else _layout(runs, candidates, prior_sd, settings)
    columns: list[RunColumns] = []
    for run, b in zip(runs, bins, strict=True):
        zero = np.zeros_like(run.base_w)
        speed = np.abs(run.covariates.get("speed_m_s", zero))
        motion = np.nan_to_num(speed)
        rows = [run.base_w, motion, switch_jumps(run), _speed_spread(run, motion)]
        rows += [run.gradient.get(name, zero) for name in layout.parameters]
        rows += [_raw_column(run, c) for c in layout.columns]
        columns.append(RunColumns.of(run, b, rows))
    # a unit of the random "motion gain" is the mean measured power
    moving = np.concatenate([c.values[1] for c in columns])
    level = float(np.mean(moving))
    square = float(np.mean(moving**2))
    for c in columns:
        c.values[1] *= layout.mean_power_w / level if level > 0 else 0.0
        c.values[3] *= layout.mean_power_w / square if square > 0 else 0.0
    clock = like.clock.in_all(len(runs)) if like else Clock.as_logged(len(runs))
    source = Source(tuple(runs), columns, _common_covariates(runs), layout, clock, kept=kept)
    if like is None and settings.align:
        source.clock = find_clock(columns, layout.step_s).in_all(len(runs))
        source.aligned = True
    return source


def _raw_column(run: RunData, column: Column) -> Array:
    zero = np.zeros_like(run.base_w)
    if not column.mix:
        return run.columns.get(column.name, zero)
    return np.asarray(sum((w * run.columns.get(name, zero) for name, w in column.mix), start=zero))


def _common_covariates(runs: Sequence[RunData]) -> tuple[str, ...]:
    names = set(runs[0].covariates)
    for run in runs[1:]:
        names &= set(run.covariates)
    return tuple(n for n in runs[0].covariates if n in names)


def _layout(
    runs: Sequence[RunData], candidates: Sequence[Candidate], prior_sd: Mapping[str, float], settings: Settings
) -> Layout:
    parameters = tuple(n for n in runs[0].gradient if all(n in r.gradient for r in runs))
    parameters = tuple(n for n in parameters if any(np.any(r.gradient[n] != 0) for r in runs))
    energy = sum(float(np.nansum(r.measured_w * r.dt_s)) for r in runs)
    seconds = sum(float(np.sum(r.dt_s[np.isfinite(r.measured_w)])) for r in runs)
    mean_power = abs(energy / seconds)
    # shares of energy need energy
    if not mean_power > 0:
        raise ValueError("the measured mean power is zero")
    columns = []
    for number, candidate in enumerate(candidates):
        for position, name in enumerate(candidate.columns):
            if not all(name in r.columns for r in runs):
                continue
            total = sum(float(np.sum(np.abs(r.columns[name]) * r.dt_s)) for r in runs)
            mean = total / sum(float(np.sum(r.dt_s)) for r in runs)
            if np.isfinite(mean) and mean > 1e-12 * mean_power:
                columns.append(Column(number, position, name, mean))
    sd = np.array(
        [*(prior_sd.get(n, DEFAULT_PRIOR_SD) for n in parameters), CLOCK_SD_S, CLOCK_SD_S2, CURVATURE_SD, SWITCH_SD]
    )
    return Layout(parameters, sd, tuple(columns), mean_power, analysis_step(runs, settings.period_s))
