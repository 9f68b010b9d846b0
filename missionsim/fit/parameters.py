"""Fit the parameters of a model to logs, with or without prior knowledge of them; where fitted numbers come from: short
hashes of the logs, kept in the robot file and recognised again."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from missionsim.effects.covariates import is_moving
from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.errors import InputError
from missionsim.files import Json, fields_of
from missionsim.fit.final import FREE_SD, Value, final_fit
from missionsim.fit.prepare import Prepared, acting, prepare
from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate
from missionsim.identify.design import make_source
from missionsim.identify.estimates import Z95
from missionsim.identify.predictive import far_from_right
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import robot_from_text
from missionsim.labels import Labels
from missionsim.numerals import counted
from missionsim.physics import Array
from missionsim.physics.motion import inertial_power
from missionsim.runs.covariates import COVARIATES
from missionsim.runs.error import Errors, errors_of
from missionsim.runs.run import Run

MOST_HASHES = 2_000
"""Runs that a robot file names; a text in a file has at most 20,000 characters."""
LENGTH = 8
CALIBRATION = "calibration"
"""Key of a robot file's ``sources`` that says to which logs its parameters were fitted."""


OTHER_DAY_SD = 0.03
"""Relative change of a fitted parameter from the logs that it was fitted to, to others: meter, tyres, warmth, load of
the computer. The same as for a parameter that comes without a standard deviation (assumed)."""
_TAG = re.compile(r"\bdata ((?:[0-9a-f]{8}\s?)+)")


def log_hash(log: Run) -> str:
    """SHA-256 of a log's file, or of its power where it was made in memory; 64 hexadecimal digits."""
    if log.sha256:
        return str(log.sha256)
    digest = hashlib.sha256()
    for battery in sorted(log.power_w):
        digest.update(log.power_w[battery].tobytes())
    return digest.hexdigest()


def data_tag(logs: Sequence[Run]) -> str:
    """The first digits of the hashes of the logs, one a run; beyond `MOST_HASHES` runs the lowest of them, of which any
    larger part of the runs holds one."""
    return " ".join(digest[:LENGTH] for digest in sorted(map(log_hash, logs))[:MOST_HASHES])


def fitted_source(logs: Sequence[Run]) -> str:
    """What a robot file says of numbers that were fitted to some logs."""
    return f"fitted to {counted(len(logs), 'run')}, data {data_tag(logs)}"


def as_fitted(parameter: ModelParameter, value: float, sd: float) -> Json:
    """A fitted value as its file has it: of one unit, where the model has all units of a component."""
    return {
        "value": value / parameter.times,
        "sd": sd / parameter.times,
        "status": "fitted",
        "source": CALIBRATION,
        # what stands beside it in the file may be in another unit
        "note": f"{parameter.value / parameter.times:.6g} {parameter.unit} before".replace(" 1 ", " "),
    }


def fitted_to(source: str, logs: Iterable[Run]) -> bool:
    """Whether a parameter's source says that it was fitted to one of these very logs.

    Such a number is no knowledge beside the logs: as a prior it would count the same data twice.
    """
    match = _TAG.search(source)
    if not match:
        return False
    known = set(match.group(1).split())
    hashes = sorted(map(log_hash, logs))
    # files of before have one hash for all runs where these were more than 40
    of_all = hashlib.sha256("".join(hashes).encode()).hexdigest()
    return not known.isdisjoint(digest[:LENGTH] for digest in (*hashes, of_all))


def sd_on_other_logs(sd: float, source: str) -> float:
    """Relative standard deviation of a parameter for logs that it was not fitted to.

    What `calibrate` writes is how well the average over its own logs is known. On another day the robot is not quite
    the same, so that `OTHER_DAY_SD` adds to it; else drift would pass for a missing effect. `sd`: as the robot file has
    it. `source`: what the file says of where the number comes from; others than fits keep their sd.
    """
    return math.hypot(sd, OTHER_DAY_SD) if _TAG.search(source) else sd


def ranges_of(runs: Sequence[Run], origin: Json | None = None) -> Json:
    """Least and greatest value of each covariate over runs, in units of the glossary; the names of floors. `origin`: of
    a robot file, whose ranges they join."""
    found: Json = dict((origin or {}).get("range", {}))
    for name in (name for name in COVARIATES if name != "heading_rad"):  # an angle has no range
        columns = [run.columns[name] for run in runs if name in run.columns]
        before = found.get(name, [])
        if name == "surface" and columns:
            floors = {text for one in columns if isinstance(one, Labels) for text in one.names}
            found[name] = sorted(floors.union(before))
        numbers = [one[np.isfinite(one)] for one in columns if not isinstance(one, Labels)]
        values = np.concatenate(numbers) if numbers else np.zeros(0)
        if len(values):
            values = np.append(values, np.asarray(before, dtype=float))
            found[name] = [float(f"{limit:.4g}") for limit in (np.min(values), np.max(values))]
    return found


def short_of(text: str, battery: str, logs: Sequence[Run]) -> Iterator[str]:
    """In words, what the robot of a file can do less than the one that was logged."""
    spec = robot_from_text(text)
    top, held_wh = spec.body.max_speed.value, spec.batteries[battery].capacity_wh
    speeds = [np.abs(log.number("speed_m_s")) for log in logs if "speed_m_s" in log.columns]
    fastest = max((float(np.nanmax(speed)) for speed in speeds), default=0.0)
    most_wh = max(log.energy_wh(battery) for log in logs if battery in log.power_w)
    if top < 0.9 * fastest:
        yield f"the top speed, {top:.3g} m/s, is below the {fastest:.3g} m/s of the logs"
    if held_wh < most_wh:
        yield f"the capacity, {held_wh:.3g} Wh, is less than the {most_wh:.3g} Wh that one of the runs took"


LARGEST_W = 1e30
"""Powers from here on are no numbers to compute with: their squares must still be finite."""
LEAST_USABLE = 0.5
"""Part of the rows in which a model must have a value to be fitted."""
LEAST_EXPLAINED = -10.0
"""Share of the variance below which a fit has run away: a plain mean explains nought of it."""
LARGEST_INFLATION = 1e8
SLOW_ROW_S, OFTEN = 0.3, 0.05
"""From rows of that length on, it matters where in a row the robot starts or stops, if it does so in that part of the
rows in which it moves: in a small world what moving costs was then off by up to the same part."""
SETTLING_ROUNDS = 30


def settled(model: PowerModel, ready: Prepared, logs: Sequence[Run]) -> tuple[PowerModel, Prepared]:
    """Ordinary least squares repeated until a formula that is not linear settles.

    Each step is halved until the squared error does not rise and every parameter still acts, which ends beyond the bend
    of a ``max``: a parameter that acts no more never comes back. A linear formula takes the whole step.
    """
    battery = ready.battery
    for _ in range(SETTLING_ROUNDS):
        aim, before, acts = _least_squares_start(model, ready), _square(ready), {*acting(ready.gradients)}
        start = {name: p.value for name, p in ready.parameters.items()}
        goal = {name: aim.parameters[f"{battery}/{name}"].value for name in start}
        for power in range(10):
            part = 0.5**power
            trial = model.with_values({f"{battery}/{n}": start[n] + part * (goal[n] - start[n]) for n in start})
            with np.errstate(all="ignore"):
                after = prepare(trial, logs, battery)
                if _square(after) <= before * (1.0 + 1e-9) and acts <= {*acting(after.gradients)}:
                    model, ready = trial, after
                    break
        moved = (abs(ready.parameters[n].value - v) / max(abs(v), 1e-300) for n, v in start.items())
        if max(moved, default=0.0) < 1e-6:
            break
    return model, ready


def _square(ready: Prepared) -> float:
    """Squared error over time; infinite where the model has no value."""
    total = 0.0
    for run, base in zip(ready.runs, ready.base_w, strict=True):
        measured = run.run.power_w[ready.battery]
        usable = np.isfinite(measured)
        total += float(np.sum((measured - base)[usable] ** 2 * run.dt_s[usable]))
    return total if np.isfinite(total) else float("inf")


def told_apart(ready: Prepared) -> frozenset[str]:
    """Parameters whose influence no combination of the others can imitate."""
    names = acting(ready.gradients)
    if not names:
        return frozenset()
    x = np.column_stack([np.concatenate([g[name] for g in ready.gradients]) for name in names])
    x = x / np.linalg.norm(x, axis=0)
    # the variance inflation of a column is the diagonal of the inverse of the correlations
    values, vectors = np.linalg.eigh(x.T @ x)
    inflation = np.sum(vectors**2 / np.maximum(values, 1e-14), axis=1)
    return frozenset(name for name, size in zip(names, inflation, strict=True) if size < LARGEST_INFLATION)


def _least_squares_start(model: PowerModel, ready: Prepared) -> PowerModel:
    """Ordinary least squares on the gradient, from the start values; rows count by the time that they stand for."""
    names = acting(ready.gradients)
    weight = np.concatenate([np.sqrt(run.dt_s) for run in ready.runs])
    y = ready.measured_w() - np.concatenate(ready.base_w)
    x = np.array([np.concatenate([g[name] for g in ready.gradients]) for name in names]).reshape(len(names), len(y)).T
    usable = (np.abs(y) < LARGEST_W) & np.all(np.abs(x) < LARGEST_W, axis=1)
    if np.mean(usable) < LEAST_USABLE:
        raise InputError.single(
            f"the model of battery '{ready.battery}' gives no number in "
            + (f"{np.mean(~usable):.0%} of the rows" if usable.any() else "any row of these logs"),
            got="nothing that can be fitted",
            allowed="a formula with a finite value (no division by nought?)",
        )
    if not names:
        return model
    size = np.linalg.norm(x[usable], axis=0)
    shift, *_ = np.linalg.lstsq(x[usable] / size * weight[usable, None], y[usable] * weight[usable], rcond=1e-9)
    shift = shift / size
    values = {}
    for name, move in zip(names, shift, strict=True):
        start = ready.parameters[name].value
        value = start * (1.0 + float(move))
        # a parameter at nought has no logarithm; a small one can still grow
        values[f"{ready.battery}/{name}"] = value if abs(value) > 1e-6 * abs(start) else 1e-3 * start
    return model.with_values(values)


@dataclass(frozen=True)
class FittedParameter:
    """One fitted parameter, in its own unit."""

    name: str
    unit: str
    value: float
    sd: float
    low: float
    high: float
    """95 % interval."""
    before: float
    """Value that the model had."""
    seen: bool = True
    """Whether the logs say anything about it; where not, value and sd are those of the prior."""


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to logs."""

    battery: str
    model: PowerModel
    """With the fitted values."""
    parameters: Mapping[str, FittedParameter]
    delay_s: float
    lag_s: float
    """Both: how far the meter is behind the motion."""
    before: Errors
    after: Errors
    """Both: of the model as it was and as it was fitted, as `missionsim compare` measures them."""
    explained: float
    """Share of the variance of the measured power that the model explains (R²)."""
    _: KW_ONLY
    runs: tuple[str, ...]
    seconds: float
    remarks: tuple[str, ...]

    def to_json(self) -> Json:
        """As ``missionsim calibrate --json`` has a battery."""
        return {
            "parameters": {p.name: fields_of(p, "value sd low high before unit") for p in self.parameters.values()},
            **fields_of(self, "rmse_before_w=before.power_rmse_w rmse_w=after.power_rmse_w"),
            **fields_of(self.after, "energy_error_pct=total.energy_error_pct run_energy_error_pct"),
            "explained_variance": self.explained,
            "clock": fields_of(self, "delay_s lag_s"),
            **fields_of(self, "runs seconds"),
        }


def _ramps(cov: Mapping[str, Any]) -> dict[str, Array]:
    """Rate of half the speed's square while a robot speeds up and while it brakes [m²/s³], where both are known."""
    if not {"speed_m_s", "accel_m_s2"} <= cov.keys():
        return {}
    rate = np.nan_to_num(inertial_power(cov["speed_m_s"], cov["accel_m_s2"], 1.0, 1.0))
    return {"speeding up": np.maximum(rate, 0.0), "braking": np.minimum(rate, 0.0)}


@np.errstate(over="ignore", invalid="ignore")  # a formula without a value is told, not warned of
def fit_parameters(model: PowerModel, logs: Sequence[Run], battery: str, *, free: bool = False) -> ModelFit:
    """Fit every parameter of one battery's model to logs; see `missionsim.fit.final.final_fit`.

    `model`: start values, units, priors; `free`: ignore the priors, for a model whose values are only start values.
    Raises InputError: where the model needs a column that the logs lack, or no log measures the battery.
    """
    settings = Settings()
    ready = prepare(model, logs, battery)
    logs = [run.run for run in ready.runs]
    if all(float(np.ptp(log.power_w[battery])) == 0.0 for log in logs):
        raise InputError.single(
            f"battery '{battery}': the measured power never changes in any run, so that nothing can be fitted to it",
            got=f"{ready.measured_w()[0]:g} W in every row",
            allowed="a meter that is not frozen",
        )
    given = model
    try:
        if free:
            model, ready = settled(model, ready, logs)
        known = {name: p for name, p in ready.parameters.items() if p.value != 0.0}
        told = told_apart(ready) if free else frozenset(known)
        prior_sd = {name: max(p.prior_sd, 1e-6) for name, p in known.items()}
        if free:
            # so wide that they say nothing: many times the value, and many times what would make all the power
            power = float(np.nanmean(np.abs(ready.measured_w())))
            for name in known:
                size = float(np.mean([float(np.mean(np.abs(g[name]))) for g in ready.gradients if name in g] or [0.0]))
                prior_sd[name] = max(FREE_SD, 10.0 * power / size) if size > 0.0 else FREE_SD
        ramps = [_ramps(run.covariates) for run in ready.runs]
        # beside inertia, which a base may lack and an advance of the meter looks like
        inertia = [Candidate(name, (name,)) for name in ramps[0]]
        source = make_source(ready.data(ramps), inertia, prior_sd, settings)
        # far from right, a delay stands for what the model lacks: an advance looks like inertia
        clock = source.clock if far_from_right(source) is None else Clock.as_logged(len(source.runs))
        fitted = final_fit(model, logs, battery, prior_sd, clock, settings)
        after = errors_of(fitted.model, logs, battery)
        measured, seconds = ready.measured_w(), ready.seconds()
        level = float(np.average(measured, weights=seconds))
        spread = float(np.average((measured - level) ** 2, weights=seconds))
        explained = 1.0 - after.power_rmse_w**2 / spread if spread > 0.0 else 0.0
        if not explained > LEAST_EXPLAINED:
            raise OverflowError("an error far larger than the power at the values that were tried")
    except (np.linalg.LinAlgError, OverflowError) as error:
        raise InputError.single(
            f"the model of battery '{battery}' cannot be fitted: its values or its parameters run out of all numbers",
            got=str(error),
            allowed="a formula that stays finite, and linear in its parameters if possible",
        ) from error
    except ValueError as error:  # the logs hold too little
        if isinstance(error, InputError):
            raise
        raise InputError.single(f"battery '{battery}': {error}") from error
    parameters = {}
    for name, own in known.items():
        new = fitted.values.get(name, Value(own.value, abs(own.value) * prior_sd[name]))
        seen = name in fitted.values and name in told
        low, high = new.value - Z95 * new.sd, new.value + Z95 * new.sd
        if name.rpartition(".")[2] == "regeneration":  # a part is no less than none and no more than all
            low, high = max(low, 0.0), min(high, 1.0)
        parameters[name] = FittedParameter(name, own.unit, new.value, new.sd, low, high, own.value, seen)
    remarks = [
        f"{name} and {twin} act on the power in the same way: {twin} is fitted, {name} stays as it is"
        for name, twin in fitted.alike.items()
    ]
    on = [np.asarray(is_moving(run.covariates)) for run in ready.runs if "speed_m_s" in run.covariates]
    moving = sum(int(np.count_nonzero(one)) for one in on)
    changes = sum(int(np.count_nonzero(np.diff(one))) for one in on)
    row_s = float(np.median(seconds))
    if row_s >= SLOW_ROW_S and changes >= max(OFTEN * moving, 1.0):
        remarks.append(
            f"the robot starts or stops in {changes / moving:.0%} of the rows in which it moves, each {row_s:.2g} s "
            "long: where in them, the log does not say, so that what moving costs and what grows with speed may be off "
            "by as much, beyond their intervals; log at 5 Hz or more, or drive longer between stops"
        )
    return ModelFit(
        battery,
        fitted.model,
        parameters,
        clock.delay_s,
        clock.lag_s,
        errors_of(given, logs, battery),
        after,
        explained,
        runs=tuple(log.run for log in logs),
        seconds=after.total.seconds,
        remarks=tuple(dict.fromkeys([*ready.remarks, *remarks])),
    )
