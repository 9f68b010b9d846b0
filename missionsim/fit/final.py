"""The last fit: the numbers of base and effects that a robot file gets, and that every held-out error is told with.

What is found decides on names with the likelihood of its noise model. What is written must predict: on the runs that it
was fitted to the energy agrees in all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.fit.prepare import Prepared, prepare
from missionsim.identify.align import Clock
from missionsim.identify.data import RunData
from missionsim.identify.design import Source, make_source
from missionsim.identify.settings import SEVERAL_RUNS, Settings
from missionsim.physics import Array, Ints
from missionsim.physics.lag import Meter
from missionsim.runs.run import Run

ROUNDS = 3
"""Steps of Gauss and Newton; nearly all models are linear in what is fitted."""
STILL = 1e-7
"""Relative change below which a fit has come to rest, and a model is linear."""
FREE_SD = 1e3
"""Relative prior standard deviation that leaves a parameter to the logs."""
LEFT = 1e-3
"""Part of its value that is left of a base parameter that comes to nothing: nought has no gradient to come back by."""
ALIKE = 1e-9
"""Columns whose correlation is nearer to one than this are multiples of each other."""
MOST_ROWS = 200_000
"""Longer logs are fitted to means alone: 360,000 rows as logged took half as much memory again."""
CLEARLY = 0.01
"""Part of the squared error of left-out rows by which rows as logged must be the better ones (assumed)."""
EXACT = 1e4
"""Weight of the energy of all runs against all rows together."""


@dataclass(frozen=True)
class Value:
    """A fitted number with its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True)
class FinalFit:
    """What a robot file gets."""

    model: PowerModel
    """With the fitted values."""
    values: Mapping[str, Value]
    """By parameter within the battery; those that moved."""
    alike: Mapping[str, str] = field(default_factory=dict)
    """Base parameters that stay as they are, since another one, which was fitted, acts in the same way."""


def final_fit(
    model: PowerModel,
    runs: Sequence[Run],
    battery: str,
    prior_sd: Mapping[str, float],
    clock: Clock,
    settings: Settings,
    *,
    fixed: Sequence[str] = (),
    keep_base: bool = False,
) -> FinalFit:
    """Fit base parameters and the coefficients of effects to runs, as they will stand in the robot file.

    Least squares over means of about a second, each weighing its time, at the clock that was found; base parameters are
    held by their priors, which count against errors clustered by run; the energy of all runs agrees exactly. Rows as
    they were logged take the place of the means where an effect follows acceleration and they predict left-out rows
    better: it may act otherwise in a jolt than over a second. The model shows its power as late and sluggishly as the
    clock says where the rows that were fitted agree better with that. `model`: base and effects with start values;
    effects are the terms that are not base. `prior_sd`: relative standard deviation of each base parameter, about the
    value in `model`. `clock`: delay and lag of the meter. `fixed`: parameters that stay as they are. `keep_base`: fit
    the effects alone.
    """
    ready = prepare(model, runs, battery)
    plain, means = _fit(model, ready, prior_sd, clock, settings, fixed, keep_base)
    own = [driven.run for driven in ready.runs]
    step = float(np.median(np.concatenate([run.dt_s for run in own])))
    few = sum(run.rows for run in own) <= MOST_ROWS
    jolts = any("accel_m_s2" in (*t.effect.needs, t.effect.covariate) for t in model.of(battery) if not t.base)
    best = plain
    if means is not None and jolts and few and step <= 0.5 * settings.period_s:
        other, raw = _fit(model, ready, prior_sd, clock, replace(settings, period_s=step), fixed, keep_base)
        if raw is not None and raw.names == means.names:
            best = other if raw.left_out(raw) < (1.0 - CLEARLY) * means.left_out(raw) else plain
    late = late_as_seen(best.model, ready, clock)
    return best if late is best.model else replace(best, model=late)


def late_as_seen(model: PowerModel, ready: Prepared, clock: Clock) -> PowerModel:
    """The model that shows its power as late and sluggishly as the clock says, where the rows agree better so."""
    battery, found = ready.battery, Meter(clock.delay_s, clock.lag_s)
    if model.meter(battery) == found:
        return model
    powers, squares = ready.powers(model), dict[Meter, float]()
    for meter in (Meter(), found):
        shown = (run.shown_w(battery, w, meter) for run, w in zip(ready.runs, powers, strict=True))
        errors = (run.measured_w[battery] - w for run, w in zip(ready.runs, shown, strict=True))
        squares[meter] = sum(float(np.nansum(e**2 * run.dt_s)) for run, e in zip(ready.runs, errors, strict=True))
    squares[Meter()] *= 1.0 - CLEARLY
    return replace(model, meters={**model.meters, battery: min(squares, key=squares.__getitem__)})


def _fit(
    model: PowerModel,
    ready: Prepared,
    prior_sd: Mapping[str, float],
    clock: Clock,
    settings: Settings,
    fixed: Sequence[str],
    keep_base: bool,
) -> tuple[FinalFit, _System | None]:
    """The fit to means over one period, and its rows."""
    battery = ready.battery
    added = {t.name_of(n) for t in model.of(battery) if not t.base for n in t.parameters}
    shapes = {
        t.name_of(s.name) for t in model.of(battery) if not t.base for s in t.effect.shape if s.name in t.parameters
    }
    shapes -= {n for n in shapes if n.rpartition(".")[2].startswith(("k_", "regeneration"))}
    still = {*fixed, *shapes}
    start = {n: p.value for n, p in model.parameters_of(battery).items()}
    low, high = _bounds(model, battery)
    nought: dict[str, Value] = {}
    whole: _System | None = None
    for round_ in range(ROUNDS):
        whole = _System.of(ready, clock, settings) if whole is None else whole.at(ready, settings)
        names = [n for n in whole.names if n not in still and start[n] != 0.0 and not (keep_base and n not in added)]
        # columns that are multiples of another's, which is less well known and takes their part
        unit = {n: x / max(float(np.linalg.norm(x)), 1e-300) for n, x in zip(whole.names, whole.x.T, strict=True)}
        order = sorted((n for n in names if n not in added), key=lambda name: -prior_sd.get(name, 0.0))
        alike: dict[str, str] = {}
        for i, name in enumerate(order):
            known = (o for o in order[:i] if o not in alike)
            if twin := next((o for o in known if abs(float(unit[name] @ unit[o])) > 1.0 - ALIKE), None):
                alike[name] = twin
        names = [n for n in names if n not in alike]
        if not names:
            return FinalFit(model, {}), None
        now = {n: p.value for n, p in ready.parameters.items()}
        # columns per relative change from the start, so that the prior stays where it was
        at, scale = [whole.names.index(n) for n in names], [start[n] / now[n] for n in names]
        system = replace(whole, names=names, x=whole.x[:, at] * scale, energy_x=whole.energy_x[at] * scale)
        done = np.array([now[n] / start[n] - 1.0 for n in names])
        sd = np.array([FREE_SD if n in added else min(max(prior_sd.get(n, 0.03), 1e-6), FREE_SD) for n in names])
        ends = np.sort([[low[n] / start[n] - 1.0, high[n] / start[n] - 1.0] for n in names], axis=1)
        shift, cov = _solve(system, done, sd, ends, energy=not keep_base)
        values = {n: start[n] * (1.0 + float(s)) for n, s in zip(names, shift, strict=True)}
        # rounding must not take what lies at its bound beyond it
        values = {n: min(max(value, low[n]), high[n]) for n, value in values.items()}
        values |= {n: 0.0 for n in added & set(names) if abs(values[n]) < STILL * abs(start[n])}
        model = model.with_values({f"{battery}/{n}": v for n, v in values.items()})
        sds = np.sqrt(np.maximum(np.diag(cov), 0.0))
        told = {n: Value(values[n], abs(start[n]) * float(s)) for n, s in zip(names, sds, strict=True)}
        # what comes to nothing has no column in the next round
        nought |= {n: value for n, value in told.items() if value.value == 0.0}
        if np.all(np.abs(shift - done) < STILL) or round_ == ROUNDS - 1:
            break
        ready = ready.at(model)
    return FinalFit(model, nought | told, alike), system


def of_formula(parameter: ModelParameter) -> bool:
    """Whether a parameter is one of several in the formula of motion, and no power of its own."""
    return parameter.path.startswith("motion.") and not parameter.path.endswith(".standing")


def _bounds(model: PowerModel, battery: str) -> tuple[dict[str, float], dict[str, float]]:
    """Lowest and highest value of each parameter, of the file and of physics."""
    low: dict[str, float] = {"regeneration": 0.0}
    high: dict[str, float] = {"regeneration": 1.0}
    for term in model.of(battery):
        specs = {spec.name: spec for spec in term.effect.parameters}
        for name, parameter in term.parameters.items():
            spec, short = specs.get(name), term.name_of(name)
            low[short] = max(-np.inf if spec is None else spec.low, min(parameter.low, parameter.value))
            high[short] = min(np.inf if spec is None else spec.high, max(parameter.high, parameter.value))
            if term.base and not of_formula(parameter) and parameter.value > 0.0:
                # what is drawn at rest or by a component may be unknown, not negative
                low[short] = max(low[short], 0.0)
            if term.base and parameter.value > 0.0 and low[short] == 0.0:
                low[short] = LEFT * parameter.value
            free = not term.base and term.effect.sign == 0
            if free or (term.base and parameter.value < 0.0 and low[short] >= 0.0):
                low[short] = -np.inf
    return low, high


@dataclass(frozen=True)
class _System:
    """Rows of a fit: gradient, what is left, time and cluster of each; energy of all rows at the raw rate [J]."""

    names: list[str]
    x: Array
    y: Array
    seconds: Array
    cluster: Ints
    energy_x: Array
    energy_y: float
    measured_w: Array
    _: KW_ONLY
    runs: Sequence[RunData]
    source: Source
    clock: Clock

    @classmethod
    def of(cls, ready: Prepared, clock: Clock, settings: Settings) -> _System:
        data = ready.data()
        source = make_source(data, [], {}, replace(settings, align=False))
        clock = clock.in_all(len(source.runs))
        design = source.design(clock)
        names = list(design.layout.parameters)
        x = np.asarray(design.gradient[: len(names)]).T
        left, seconds, cluster = design.y - design.base, design.duration_s, design.run_index()
        if len(design.runs) <= SEVERAL_RUNS:  # too few to be the sample
            blocks = np.floor((design.time_s - design.time_s.min()) / settings.block_s).astype(np.intp)
            cluster = np.asarray(cluster * (int(blocks.max()) + 2) + blocks, dtype=np.intp)
        raw = _energies(data, names)
        return cls(names, x, left, seconds, cluster, *raw, design.y, runs=data, source=source, clock=clock)

    def at(self, ready: Prepared, settings: Settings) -> _System:
        """The rows at other values of the parameters in any model."""
        data = ready.data()
        if any(run.measured_w is not was.measured_w for run, was in zip(data, self.runs, strict=True)):
            return _System.of(ready, self.clock, settings)  # other rows have no value now
        kept = [data[i] for i in self.source.kept]
        names = [name for name in data[0].gradient if any(np.any(run.gradient[name]) for run in kept)]
        raw = [np.vstack([run.base_w, *(run.gradient[name] for name in names)]) for run in kept]
        rows, (energy_x, energy_y) = self.source.averaged(raw, self.clock), _energies(data, names)
        y = self.measured_w - rows[0]
        return replace(self, names=names, x=rows[1:].T, y=y, energy_x=energy_x, energy_y=energy_y, runs=data)

    def left_out(self, raw: _System) -> float:
        """Mean squared error [W2] of other rows of the same runs, each cluster predicted from a fit to the others."""
        weighed = self.x * self.seconds[:, None]
        square = 0.0
        for number in np.unique(raw.cluster):
            kept, out = self.cluster != number, raw.cluster == number
            shift = np.linalg.lstsq(weighed[kept].T @ self.x[kept], weighed[kept].T @ self.y[kept], rcond=1e-9)[0]
            square += float(raw.seconds[out] @ (raw.y[out] - raw.x[out] @ shift) ** 2)
        return square / float(raw.seconds.sum())


def _energies(runs: Sequence[RunData], names: Sequence[str]) -> tuple[Array, float]:
    """Energy of all rows that were measured by parameter, and what the base leaves of the measured one [J]."""
    seconds = [np.where(np.isfinite(run.measured_w), run.dt_s, 0.0) for run in runs]
    x = [[float(dt @ run.gradient[n]) for n in names] for run, dt in zip(runs, seconds, strict=True)]
    y = sum(float(dt @ np.nan_to_num(run.measured_w - run.base_w)) for run, dt in zip(runs, seconds, strict=True))
    return np.sum(x, axis=0), y


def _solve(system: _System, done: Array, sd: Array, ends: Array, *, energy: bool) -> tuple[Array, Array]:
    """Relative shifts s of the parameters from their start, and their covariance clustered by run.

    Minimises ``Σ w (y − x (s − done))² / (σ² d) + Σ (s / sd)²`` within bounds; σ² is the variance of what is left, d by
    how much the clustered variance of the estimates exceeds that of white noise. The energy of all rows enters as one
    observation without error.
    """
    x, y = system.x, system.y + system.x @ done
    weight = system.seconds / np.mean(system.seconds)
    normal = (x * weight[:, None]).T @ x
    prior = np.diag(1.0 / sd**2)
    if not (np.isfinite(normal).all() and np.isfinite(y).all()):  # LAPACK may never end on such numbers
        raise OverflowError("no finite power on the way to the best values")
    shift, cov, d = done, np.linalg.pinv(normal + prior), 1.0
    for _ in range(2):
        root = np.sqrt(weight / d)
        rows, right = [x * root[:, None], np.diag(_noise(x, y, weight, shift) / sd)], [y * root, np.zeros(len(sd))]
        if energy:
            heavy = EXACT * np.linalg.norm(rows[0]) / max(float(np.linalg.norm(system.energy_x)), 1e-300)
            rows.append(heavy * system.energy_x[None, :])
            right.append(np.array([heavy * (system.energy_y + system.energy_x @ done)]))
        # the triangle of the rows has the same least squares, and few of them
        triangle = np.asarray(np.linalg.qr(np.column_stack([np.vstack(rows), np.concatenate(right)]), mode="r"))
        shift = np.linalg.lstsq(triangle[:, :-1], triangle[:, -1], rcond=-1)[0]
        low, high = ends[:, 0] - 1e-12, ends[:, 1] + 1e-12
        if not np.all((shift >= low) & (shift <= high)):
            from scipy.optimize import lsq_linear  # which takes a tenth of a second to import

            shift = np.asarray(lsq_linear(triangle[:, :-1], triangle[:, -1], (low, high)).x)
        noise = _noise(x, y, weight, shift)
        bread = np.linalg.pinv(normal / (noise**2 * d) + prior)
        numbers, cluster = np.unique(system.cluster, return_inverse=True)
        scores = np.zeros((len(numbers), len(sd)))
        np.add.at(scores, cluster, x * ((y - x @ shift) * weight)[:, None])
        count = len(scores)
        meat = scores.T @ scores * count / max(count - 1, 1)
        # eigenvalues of meat over normal: by how much a cluster says less than its rows would
        white = np.trace(np.linalg.pinv(normal) @ meat) / (noise**2 * len(sd))
        d = float(np.clip(white, 1.0, len(y) / max(count, 1)))
        cov = bread @ (meat / (noise**2 * d) ** 2 + prior) @ bread
    return shift, np.asarray(cov, dtype=float)


def _noise(x: Array, y: Array, weight: Array, shift: Array) -> float:
    """Standard deviation of what is left [W]."""
    left = y - x @ shift
    return max(float(np.sqrt(np.average(left**2, weights=weight))), 1e-9)
