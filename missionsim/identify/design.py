"""Assemble all runs into one regression: y - P0 = N nu + Phi beta + Z_j u_j + noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.align import Clock, find_clock, still
from missionsim.identify.averaging import Intervals, Rows, RunColumns, Weights, integral_curves, make_bins
from missionsim.identify.data import Candidate, Column, Constraints, Layout, RunData
from missionsim.physics import Array, Ints

KEPT_CURVES = 4
HEAD_ROWS = 4
"""Rows before the gradient in a run's columns: base, motion, switching, speed change inside a row."""


class TooShortError(ValueError):
    """No run is long enough to learn from."""


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
    begins_s: tuple[float, ...]

    @property
    def residual(self) -> Array:
        """Measured minus base model [W], shape (n,)."""
        return self.y - self.base

    def of_runs(self, numbers: Sequence[int], most: int | None = None) -> tuple[Design, Ints]:
        """The rows of some runs, the first `most` of each, and where they stand in all, shape (rows,)."""
        at: list[Ints] = []
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
        begins_s = tuple(self.begins_s[j] for j in numbers)
        rows = {name: getattr(self, name)[part] for name in ("y", "base", "duration_s", "time_s")}
        stacks = {name: getattr(self, name)[:, part] for name in ("gradient", "phi", "random")}
        cut = replace(self, **rows, **stacks, runs=tuple(runs), stretches=tuple(stretches))
        return replace(cut, names=names, begins_s=begins_s), part

    def run_index(self) -> Ints:
        """Number of the run of each row, shape (n,)."""
        return np.repeat(np.arange(len(self.runs)), [rows.stop - rows.start for rows in self.runs])


@dataclass
class Source:
    """Runs at the raw rate, kept so that the design can be rebuilt for another clock or other columns."""

    runs: tuple[RunData, ...]
    columns: list[RunColumns]
    covariates: tuple[str, ...]
    layout: Layout
    constraints: Constraints
    clock: Clock
    aligned: bool = False
    kept: tuple[int, ...] = ()
    """Numbers of the given runs that were long enough."""
    _: KW_ONLY
    root: Source | None = None
    """The source that this one varies."""
    varied: dict[int, Array] = field(default_factory=dict)
    """Integral curves of the columns that differ from those of the root."""
    _kept_design: tuple[tuple[Clock, tuple[int, ...], bool], Design] | None = field(default=None, init=False)
    _kept_curves: dict[tuple[int, ...], Array] = field(default_factory=dict, init=False)
    _kept_weights: tuple[Clock, Weights] | None = field(default=None, init=False)

    def with_column(self, column: int, layout: Layout, rows: Sequence[Array]) -> Source:
        """The same runs with one column, an array (rows,) for each run, evaluated anew; the rest is shared."""
        root = self.root or self
        raw = [np.asarray(values, dtype=float)[None, :] for values in rows]
        curve = self._curves(raw)
        return replace(self, layout=layout, root=root, varied={**self.varied, column: curve})

    def of_runs(self, numbers: Sequence[int]) -> Source:
        """The same columns in some of the runs."""
        ends = np.cumsum([0, *(run.values.shape[1] + 1 for run in self.columns)])
        at = np.concatenate([np.arange(ends[j], ends[j + 1]) for j in numbers])
        return replace(
            self,
            runs=tuple(self.runs[j] for j in numbers),
            columns=[self.columns[j] for j in numbers],
            clock=self.clock.of_runs(numbers),
            kept=tuple(self.kept[j] for j in numbers),
            root=None if self.root is None else self.root.of_runs(numbers),
            varied={k: curve[:, at] for k, curve in self.varied.items()},
        )

    def rows_of(self, numbers: Sequence[int]) -> Ints:
        """Where the rows of some runs stand in a design, shape (rows,)."""
        ends = np.cumsum([0, *(len(run.bins.measured_w) for run in self.columns)])
        return np.concatenate([np.arange(ends[j], ends[j + 1]) for j in numbers])

    def averaged(self, raw: Sequence[Array], clock: Clock) -> Array:
        """Any raw columns, one array (k, rows) a run, averaged to the analysis rate with a clock, shape (k, n)."""
        root = self.root or self
        finite = [np.nan_to_num(np.asarray(rows, dtype=float)) for rows in raw]
        curves = self._curves(finite)
        return np.ascontiguousarray(root.intervals.means(curves, root._weights(clock)).T)

    def _curves(self, raw: Sequence[Array]) -> Array:
        """Integral curves of columns at the rows as they were logged."""
        return integral_curves([own.on(values) for own, values in zip(self._rows, raw, strict=True)], self._rows)

    @property
    def _rows(self) -> list[Rows]:
        """When the rows of each run are."""
        return [run.rows for run in self.columns]

    @cached_property
    def intervals(self) -> Intervals:
        """Analysis intervals of all runs."""
        return Intervals.of(self.columns)

    @cached_property
    def _base_cubics(self) -> Array:
        """Integral of the base model in every row, see `Intervals.cubics`."""
        return self.intervals.cubics(integral_curves([run.values[:1] for run in self.columns], self._rows))

    def _weights(self, clock: Clock) -> Weights:
        """Weights of a clock; those of the last one are kept."""
        if self._kept_weights is None or self._kept_weights[0] != clock:
            delays = clock.delay_s + np.asarray(clock.run_delay_s)
            self._kept_weights = (clock, self.intervals.weights(delays, clock.lag_s))
        return self._kept_weights[1]

    def design(self, clock: Clock, only: Sequence[int] | None = None, *, timed: bool = True) -> Design:
        """Build the regression for a clock, with all candidate columns or some only; where it is not `timed`, without
        the derivatives after the delay, which take half of the time and least squares does not look at."""
        chosen = tuple(range(len(self.layout.columns))) if only is None else tuple(only)
        if self.root is not None:
            found = self.root.design(clock, chosen, timed=timed)
            phi = found.phi.copy()
            for place, k in enumerate(chosen):
                if k in self.varied:
                    means = self.root.intervals.means(self.varied[k], self.root._weights(clock))[:, 0]
                    phi[place] = means * self.layout.unit(k)
            return replace(found, layout=self.layout, phi=phi)
        asked = (clock, chosen, timed)
        if self._kept_design is None or self._kept_design[0] != asked:
            self._kept_design = (asked, self._built(*asked))
        return self._kept_design[1]

    def _built(self, clock: Clock, chosen: tuple[int, ...], timed: bool) -> Design:
        q = len(self.layout.parameters)
        used = (*range(HEAD_ROWS + q), *(HEAD_ROWS + q + k for k in chosen))
        curves = self._kept_curves.pop(used, None)
        if curves is None:
            curves = integral_curves([run.values[list(used)] for run in self.columns], self._rows)
        self._kept_curves[used] = curves
        if len(self._kept_curves) > KEPT_CURVES:  # those that were used last are kept
            del self._kept_curves[next(iter(self._kept_curves))]
        here = np.ascontiguousarray(self.intervals.means(curves, self._weights(clock)).T)
        base, motion, switching, spread = here[:HEAD_ROWS]
        slope, bend = self._derivatives(base, clock) if timed else np.zeros((2, len(base)))
        scale = np.array([self.layout.unit(k) for k in chosen])
        gradient = np.vstack([here[HEAD_ROWS : HEAD_ROWS + q], slope, bend, spread, switching])
        phi = here[HEAD_ROWS + q :] * scale[:, None]
        random = np.vstack([np.ones_like(base), base, motion, slope, bend])
        return replace(self._frame, base=base, gradient=gradient, phi=phi, random=random)

    @cached_property
    def _frame(self) -> Design:
        """What a design has whatever the clock: measured power, when its rows are, and where runs and stretches lie."""
        runs: list[slice] = []
        stretches: list[slice] = []
        bins = [run.bins for run in self.columns]
        for b in bins:
            first = runs[-1].stop if runs else 0
            runs.append(slice(first, first + len(b.measured_w)))
            ends = [*(first + b.starts[1:]), runs[-1].stop]
            stretches += [slice(int(first + start), int(end)) for start, end in zip(b.starts, ends, strict=True)]
        low, high, y = (np.concatenate([getattr(b, name) for b in bins]) for name in ("low_s", "high_s", "measured_w"))
        none = np.zeros((0, len(y)))
        return Design(
            self.layout,
            y,
            np.zeros(len(y)),
            high - low,
            0.5 * (high + low),
            none,
            none,
            none,
            runs=tuple(runs),
            stretches=tuple(stretches),
            names=tuple(r.run for r in self.runs),
            begins_s=tuple(r.begin_s for r in self.runs),
        )

    def _derivatives(self, base: Array, clock: Clock) -> tuple[Array, Array]:
        """First and second derivative of the base model after the delay."""
        run_delay = clock.delay_s + np.asarray(clock.run_delay_s)
        later, earlier = (
            self.intervals.means_of_one(self._base_cubics, run_delay + shift, clock.lag_s)
            for shift in (const.DERIVATIVE_STEP_S, -const.DERIVATIVE_STEP_S)
        )
        return (later - earlier) / (2 * const.DERIVATIVE_STEP_S), (
            later - 2 * base + earlier
        ) / const.DERIVATIVE_STEP_S**2


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


def make_source(
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    prior_sd: Mapping[str, float],
    settings: const.Settings,
    like: Source | None = None,
) -> Source:
    """Prepare runs; with `like`, reuse its layout and clock (for held-out runs).

    Candidates without a column in every run, or whose columns never act, get no regression column.
    """
    if not runs:
        raise ValueError("identify needs at least one run")
    bins = [make_bins(run, settings.period_s) for run in runs]
    # a handful of intervals fits its own offset and gain and says nothing more
    kept = tuple(i for i, b in enumerate(bins) if len(b.measured_w) >= const.FEWEST_INTERVALS)
    runs, bins = [runs[i] for i in kept], [bins[i] for i in kept]
    if not runs:
        raise TooShortError(f"no run has at least {const.FEWEST_INTERVALS} analysis intervals with measured power")
    layout = like.layout if like else _layout(runs, candidates, prior_sd, settings)
    columns: list[RunColumns] = []
    for run, b in zip(runs, bins, strict=True):
        zero = np.zeros_like(run.base_w)
        motion = np.nan_to_num(np.abs(run.covariates.get("speed_m_s", zero)))
        # variance of the speed inside each row when it changes evenly [m2/s2]: a row holds the power of its mean
        # speed, but the mean of a curved power is more (Jensen)
        step = np.diff(motion)
        inside = 0.5 * (np.pad(step, (1, 0), mode="edge") + np.pad(step, (0, 1), mode="edge"))
        rows = [run.base_w, motion, switch_jumps(run), inside**2 / 12.0]
        rows += [run.gradient.get(name, zero) for name in layout.parameters]
        rows += [run.columns.get(column.name, zero) for column in layout.columns]
        columns.append(RunColumns.of(run, b, rows))
    # a unit of the random "motion gain" is the mean measured power
    moving = np.concatenate([c.values[1] for c in columns])
    level = float(np.mean(moving))
    square = float(np.mean(moving**2))
    for c in columns:
        c.values[1] *= layout.mean_power_w / level if level > 0 else 0.0
        c.values[3] *= layout.mean_power_w / square if square > 0 else 0.0
    clock, aligned = Clock.as_logged(len(runs)), like is None and settings.align and not still(columns)
    if like is not None:
        clock = like.clock.in_all(len(runs))
    elif aligned:
        delay_s, lag_s = find_clock(columns, layout.step_s)
        clock = replace(clock, delay_s=delay_s, lag_s=lag_s)
    covariates = tuple(n for n in runs[0].covariates if all(n in run.covariates for run in runs))
    constraints = Constraints.of(layout, candidates, settings)
    return Source(tuple(runs), columns, covariates, layout, constraints, clock, aligned, kept)


def _layout(
    runs: Sequence[RunData], candidates: Sequence[Candidate], prior_sd: Mapping[str, float], settings: const.Settings
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
    nuisances = (const.CLOCK_SD_S, const.CLOCK_SD_S2, const.CURVATURE_SD, const.SWITCH_SD)
    sd = np.array([*(prior_sd.get(n, const.DEFAULT_PRIOR_SD) for n in parameters), *nuisances])
    steps = []  # typical length of an analysis interval of each run [s]
    for run in runs:
        step = float(np.median(np.diff(run.time_s if run.fresh is None else run.time_s[run.fresh])))
        steps.append(step * max(1, round(settings.period_s / step)))
    return Layout(parameters, sd, tuple(columns), mean_power, float(np.median(steps)))
