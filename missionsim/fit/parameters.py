"""Fit the parameters of a model to logs by generalised least squares, with or without prior knowledge of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.fit.prepare import Prepared, prepare
from missionsim.identify.data import Settings
from missionsim.identify.design import make_source
from missionsim.identify.model import Model, fit_model

FREE_SD = 100.0
"""Relative prior standard deviation that leaves a parameter to the data."""
BLOCK_S = 20.0
WORSE = 0.01
"""Share of the variance by which generalised least squares may explain less than ordinary ones before it is doubted."""
LARGEST_INFLATION = 1e8
ROUNDS = 5
SETTLING_ROUNDS = 30
Z95 = 1.959963984540054


@dataclass(frozen=True)
class FittedParameter:
    """One fitted parameter, in its own unit.

    Attributes
    ----------
    name, unit : str
    value, sd : float
    low, high : float
        95 % interval.
    before : float
        Value that the model had.
    seen : bool
        Whether the logs say anything about it; where not, value and sd are those of the prior.
    """

    name: str
    unit: str
    value: float
    sd: float
    low: float
    high: float
    before: float
    seen: bool = True


@dataclass(frozen=True)
class ModelFit:
    """A model fitted to logs.

    Attributes
    ----------
    battery : str
    model : PowerModel
        With the fitted values.
    parameters : mapping of str to FittedParameter
    delay_s, lag_s : float
        How far the meter is behind the motion.
    noise_w : float
        Standard deviation of what is left, at the analysis rate.
    rmse_before_w, rmse_w : float
        Power error before and after, at the analysis rate, clocks aligned.
    explained : float
        Share of the variance of the measured power that the model explains (R²).
    runs : tuple of str
    seconds : float
    remarks : tuple of str
    """

    battery: str
    model: PowerModel
    parameters: Mapping[str, FittedParameter]
    delay_s: float
    lag_s: float
    noise_w: float
    rmse_before_w: float
    rmse_w: float
    explained: float
    runs: tuple[str, ...]
    seconds: float
    remarks: tuple[str, ...]


def fit_parameters(
    model: PowerModel, logs: Sequence[Any], battery: str, *, free: bool = False, settings: Settings | None = None
) -> ModelFit:
    """Fit every parameter of one battery's model to logs.

    Generalised least squares with AR noise, offset and gain of the meter differing between runs, and clocks aligned
    (the identification's own noise model); parameters in which the model is not linear by Gauss-Newton.

    Parameters
    ----------
    model : PowerModel
        Start values, units, priors.
    logs : sequence of LogTable
    battery : str
    free : bool
        Ignore the priors, for a model whose values are only start values.
    settings : Settings, optional

    Raises
    ------
    missionsim.errors.InputError
        Where the model needs a column that the logs lack, or no log measures the battery.
    """
    settings = settings or Settings()
    ready = prepare(model, logs, battery)
    before = ready
    plain: Plain | None = None
    if free:
        model, plain = _settled(model, ready, logs)
        ready = prepare(model, logs, battery)
    known = {name: p for name, p in ready.parameters.items() if p.value != 0.0}
    prior_sd = _free_priors(ready, known) if free else {name: p.prior_sd for name, p in known.items()}
    told = _told_apart(ready) if free else frozenset(known)
    prior_value = {name: p.value for name, p in known.items()}
    fitted: Model | None = None
    for step in range(ROUNDS):
        # the prior stays where it was while the point of linearisation moves
        ready = prepare(model, logs, battery) if step else ready
        source = make_source(ready.data(), [], prior_sd, replace(settings, align=settings.align and fitted is None))
        if fitted is not None:
            source.clock, source.aligned = fitted.clock, settings.align
        fitted = fit_model(source, (), fitted, thorough=False)
        shift, covariance = fitted.gram.shifts(())
        names = fitted.design.layout.parameters
        moved = {name: float(np.clip(s, -0.9, 9.0)) for name, s in zip(names, shift, strict=False)}
        settled = all(abs(s) < 0.1 * np.sqrt(covariance[i, i]) for i, s in enumerate(shift[: len(names)]))
        if not free or settled or step == ROUNDS - 1:
            break
        model = _moved(model, battery, moved)
    assert fitted is not None  # there is at least one round
    final = _moved(model, battery, moved)
    sd = {name: float(np.sqrt(covariance[i, i])) for i, name in enumerate(names)}
    parameters = {
        name: _fitted(name, p.unit, p.value, moved.get(name), sd.get(name), prior_sd[name], prior_value[name],
                      name in told)
        for name, p in ((n, ready.parameters[n]) for n in known)
    }
    errors = _errors(fitted, before, ready, moved)
    if plain is not None and errors[2] < plain.explained - WORSE:
        return _plain_fit(battery, plain, before, told, errors[0])
    return ModelFit(
        battery, final, parameters, fitted.clock.delay_s, fitted.clock.lag_s, fitted.noise.total_sd_w, *errors,
        tuple(run.name for run in ready.runs), float(sum(np.sum(run.dt_s) for run in ready.runs)),
        tuple(dict.fromkeys(before.remarks)),
    )  # fmt: skip


def _moved(model: PowerModel, battery: str, moved: Mapping[str, float]) -> PowerModel:
    values = {f"{battery}/{name}": model.parameters[f"{battery}/{name}"].value * (1.0 + s) for name, s in moved.items()}
    return model.with_values(values)


def _fitted(
    name: str, unit: str, value: float, moved: float | None, sd: float | None, prior_sd: float, before: float,
    told: bool,
) -> FittedParameter:
    seen = moved is not None and sd is not None and told
    new = value * (1.0 + (moved or 0.0))
    absolute = abs(value) * (prior_sd if sd is None else sd)
    return FittedParameter(name, unit, new, absolute, new - Z95 * absolute, new + Z95 * absolute, before, seen)


@dataclass(frozen=True)
class Plain:
    """Ordinary least squares: model, covariance of the relative shifts clustered in blocks, what it explains."""

    model: PowerModel
    names: tuple[str, ...]
    covariance: NDArray[np.float64]
    explained: float
    rmse_w: float
    noise_w: float


def _settled(model: PowerModel, ready: Prepared, logs: Sequence[Any]) -> tuple[PowerModel, Plain]:
    """Ordinary least squares repeated until a formula that is not linear settles, with errors clustered in blocks."""
    for _ in range(SETTLING_ROUNDS):
        again, new = _shortened(model, ready, _least_squares_start(model, ready), logs)
        change = max(
            (abs(new.parameters[n].value - p.value) / max(abs(p.value), 1e-300) for n, p in ready.parameters.items()),
            default=0.0,
        )
        model, ready = again, new
        if change < 1e-6:
            break
    names, x, y, seconds = _stacked(ready)
    mean = float(np.average(y, weights=seconds))
    square = float(np.average(y**2, weights=seconds)) if len(y) else 0.0
    measured = np.concatenate([run.measured_w for run in ready.runs])
    usable = np.isfinite(measured)
    level = float(np.average(measured[usable], weights=_seconds(ready)[usable]))
    spread = float(np.average((measured[usable] - level) ** 2, weights=_seconds(ready)[usable]))
    inverse = np.linalg.pinv((x * seconds[:, None]).T @ x, rcond=1e-12)
    block = _blocks(ready)
    score = np.zeros((int(block.max()) + 1, len(names)))
    np.add.at(score, block, x * (y * seconds)[:, None])
    count = int(np.sum(np.any(score != 0.0, axis=1)))
    factor = count / max(count - len(names), 1)
    covariance = factor * inverse @ (score.T @ score) @ inverse
    explained = 1.0 - square / spread if spread > 0.0 else 0.0
    return model, Plain(model, names, covariance, explained, float(np.sqrt(square)), float(np.sqrt(square - mean**2)))


def _shortened(
    model: PowerModel, ready: Prepared, aim: PowerModel, logs: Sequence[Any]
) -> tuple[PowerModel, Prepared]:
    """The step towards `aim`, halved until the squared error does not rise; a linear formula takes the whole step."""
    before = _square(ready)
    battery = ready.battery
    start = {name: p.value for name, p in ready.parameters.items()}
    goal = {name: aim.parameters[f"{battery}/{name}"].value for name in start}
    for power in range(10):
        part = 0.5**power
        trial = model.with_values({f"{battery}/{n}": start[n] + part * (goal[n] - start[n]) for n in start})
        with np.errstate(all="ignore"):
            after = prepare(trial, logs, battery)
            if _square(after) <= before * (1.0 + 1e-9):
                return trial, after
    return model, ready


def _square(ready: Prepared) -> float:
    """Squared error over time; infinite where the model has no value."""
    total = 0.0
    for run, base in zip(ready.runs, ready.base_w, strict=True):
        usable = np.isfinite(run.measured_w)
        total += float(np.sum((run.measured_w - base)[usable] ** 2 * run.dt_s[usable]))
    return total if np.isfinite(total) else float("inf")


def _seconds(ready: Prepared) -> NDArray[np.float64]:
    return np.concatenate([run.dt_s for run in ready.runs])


def _stacked(
    ready: Prepared,
) -> tuple[tuple[str, ...], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Names, gradient rows, residual and seconds of all rows; rows without a measurement weigh nothing."""
    names = tuple(name for name in ready.gradients[0] if any(np.any(g[name]) for g in ready.gradients))
    x = np.column_stack([np.concatenate([g[name] for g in ready.gradients]) for name in names])
    y = np.concatenate([run.measured_w - base for run, base in zip(ready.runs, ready.base_w, strict=True)])
    usable = np.isfinite(y) & np.all(np.isfinite(x), axis=1)
    return names, np.where(usable[:, None], x, 0.0), np.where(usable, y, 0.0), np.where(usable, _seconds(ready), 0.0)


def _blocks(ready: Prepared) -> NDArray[np.intp]:
    """Number of the block of `BLOCK_S` of each row; blocks never span two runs."""
    numbers, total = [], 0
    for run in ready.runs:
        own = np.floor((run.time_s - run.time_s[0]) / BLOCK_S).astype(np.intp)
        numbers.append(total + own)
        total += int(own.max()) + 1
    return np.concatenate(numbers)


def _plain_fit(
    battery: str, plain: Plain, before: Prepared, told: frozenset[str], rmse_before_w: float
) -> ModelFit:
    parameters = {}
    for i, name in enumerate(plain.names):
        p = plain.model.parameters[f"{battery}/{name}"]
        sd = abs(p.value) * float(np.sqrt(plain.covariance[i, i]))
        parameters[name] = FittedParameter(
            name, p.unit, p.value, sd, p.value - Z95 * sd, p.value + Z95 * sd, before.parameters[name].value,
            name in told,
        )  # fmt: skip
    remark = ("weighting by the noise model explains clearly less than ordinary least squares, so these are used, with "
              f"errors clustered in blocks of {BLOCK_S:.0f} s")
    return ModelFit(
        battery, plain.model, parameters, 0.0, 0.0, plain.noise_w, rmse_before_w,
        plain.rmse_w, plain.explained, tuple(run.name for run in before.runs), float(np.sum(_seconds(before))),
        tuple(dict.fromkeys([*before.remarks, remark])),
    )  # fmt: skip


def _free_priors(ready: Prepared, known: Mapping[str, ModelParameter]) -> dict[str, float]:
    """Priors so wide that they say nothing: many times the value, and many times what would make all the power."""
    power = float(np.mean([np.nanmean(np.abs(run.measured_w)) for run in ready.runs]))
    wide = {}
    for name in known:
        size = float(np.mean([float(np.mean(np.abs(g[name]))) for g in ready.gradients if name in g] or [0.0]))
        wide[name] = max(FREE_SD, 10.0 * power / size) if size > 0.0 else FREE_SD
    return wide


def _told_apart(ready: Prepared) -> frozenset[str]:
    """Parameters whose influence no combination of the others can imitate."""
    names = [name for name in ready.gradients[0] if any(np.any(g[name]) for g in ready.gradients)]
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
    names = [name for name in ready.gradients[0] if any(np.any(g[name]) for g in ready.gradients)]
    if not names:
        return model
    weight = np.concatenate([np.sqrt(run.dt_s) for run in ready.runs])
    y = np.concatenate([run.measured_w - base for run, base in zip(ready.runs, ready.base_w, strict=True)])
    x = np.column_stack([np.concatenate([g[name] for g in ready.gradients]) for name in names])
    usable = np.isfinite(y) & np.all(np.isfinite(x), axis=1)
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


def _errors(fitted: Model, before: Prepared, ready: Prepared, moved: Mapping[str, float]) -> tuple[float, float, float]:
    """RMSE before and after [W] and the share of the variance explained, at the analysis rate."""
    design = fitted.design
    seconds = design.duration_s
    first = fitted.source.averaged([base[None, :] for base in before.base_w], fitted.clock)[0]
    now = design.base + sum(
        (shift * row for shift, row in zip(moved.values(), design.gradient, strict=False)), start=np.zeros_like(seconds)
    )
    total = float(np.sum(seconds))
    mean = float(np.sum(design.y * seconds) / total)
    spread = float(np.sum((design.y - mean) ** 2 * seconds) / total)
    square = float(np.sum((design.y - now) ** 2 * seconds) / total)
    start = float(np.sum((design.y - first) ** 2 * seconds) / total)
    return float(np.sqrt(start)), float(np.sqrt(square)), 1.0 - square / spread if spread > 0 else 0.0
