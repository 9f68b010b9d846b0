"""Fit the parameters of a model to logs by generalised least squares, with or without prior knowledge of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.fit.plain import BLOCK_S, Plain, free_priors, settled, told_apart
from missionsim.fit.prepare import Prepared, prepare
from missionsim.identify.design import make_source
from missionsim.identify.model import Model, fit_model
from missionsim.identify.settings import Settings

WORSE = 0.01
"""Share of the variance by which generalised least squares may explain less than ordinary ones before it is doubted."""
ROUNDS = 5
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


@np.errstate(over="ignore", invalid="ignore")  # a formula without a value is told, not warned of
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
    if all(float(np.ptp(run.run.power_w[battery])) == 0.0 for run in ready.runs):
        raise InputError.single(
            f"battery '{battery}': the measured power never changes in any run, so that nothing can be fitted to it",
            got=f"{ready.measured_w()[0]:g} W in every row",
            allowed="a meter that is not frozen",
        )
    before = ready
    plain: Plain | None = None
    try:
        if free:
            model, plain = settled(model, ready, logs)
            ready = prepare(model, logs, battery)
        known = {name: p for name, p in ready.parameters.items() if p.value != 0.0}
        prior_sd = free_priors(ready, known) if free else {name: max(p.prior_sd, 1e-6) for name, p in known.items()}
        told = told_apart(ready) if free else frozenset(known)
    except (np.linalg.LinAlgError, OverflowError) as error:
        raise InputError.single(
            f"the model of battery '{battery}' cannot be fitted: its values or its parameters run out of all numbers",
            got=str(error),
            allowed="a formula that stays finite, and linear in its parameters if possible",
        ) from error
    prior_value = {name: p.value for name, p in known.items()}
    fitted: Model | None = None
    for step in range(ROUNDS):
        # the prior stays where it was while the point of linearisation moves
        ready = prepare(model, logs, battery) if step else ready
        try:
            source = make_source(ready.data(), [], prior_sd, replace(settings, align=settings.align and fitted is None))
        except ValueError as error:  # the logs hold too little
            raise InputError.single(f"battery '{battery}': {error}") from error
        if fitted is not None:
            source.clock, source.aligned = fitted.clock, settings.align
        fitted = fit_model(source, (), fitted, thorough=False)
        shift, covariance = fitted.gram.shifts(())
        names = fitted.design.layout.parameters
        moved = {name: float(np.clip(s, -0.9, 9.0)) for name, s in zip(names, shift, strict=False)}
        steady = all(abs(s) < 0.1 * np.sqrt(covariance[i, i]) for i, s in enumerate(shift[: len(names)]))
        if not free or steady or step == ROUNDS - 1:
            break
        model = _moved(model, battery, moved)
    assert fitted is not None  # there is at least one round
    final = _moved(model, battery, moved)
    sd = {name: float(np.sqrt(covariance[i, i])) for i, name in enumerate(names)}
    parameters = {
        name: _fitted(
            name, p.unit, p.value, moved.get(name), sd.get(name), prior_sd[name], prior_value[name], name in told
        )
        for name, p in ((n, ready.parameters[n]) for n in known)
    }
    errors = _errors(fitted, before, ready, moved)
    if plain is not None and errors[2] < plain.explained - WORSE:
        return _plain_fit(battery, plain, before, told, errors[0])
    return ModelFit(
        battery,
        final,
        parameters,
        fitted.clock.delay_s,
        fitted.clock.lag_s,
        fitted.noise.total_sd_w,
        *errors,
        tuple(run.run.run for run in ready.runs),
        float(sum(np.sum(run.dt_s) for run in ready.runs)),
        tuple(dict.fromkeys(before.remarks)),
    )


def _moved(model: PowerModel, battery: str, moved: Mapping[str, float]) -> PowerModel:
    values = {f"{battery}/{name}": model.parameters[f"{battery}/{name}"].value * (1.0 + s) for name, s in moved.items()}
    return model.with_values(values)


def _fitted(
    name: str,
    unit: str,
    value: float,
    moved: float | None,
    sd: float | None,
    prior_sd: float,
    before: float,
    told: bool,
) -> FittedParameter:
    seen = moved is not None and sd is not None and told
    new = value * (1.0 + (moved or 0.0))
    absolute = abs(value) * (prior_sd if sd is None else sd)
    return FittedParameter(name, unit, new, absolute, new - Z95 * absolute, new + Z95 * absolute, before, seen)


def _plain_fit(battery: str, plain: Plain, before: Prepared, told: frozenset[str], rmse_before_w: float) -> ModelFit:
    parameters = {}
    for i, name in enumerate(plain.names):
        p = plain.model.parameters[f"{battery}/{name}"]
        sd = abs(p.value) * float(np.sqrt(plain.covariance[i, i]))
        parameters[name] = FittedParameter(
            name,
            p.unit,
            p.value,
            sd,
            p.value - Z95 * sd,
            p.value + Z95 * sd,
            before.parameters[name].value,
            name in told,
        )
    remark = (
        "weighting by the noise model explains clearly less than ordinary least squares, so these are used, with "
        f"errors clustered in blocks of {BLOCK_S:.0f} s"
    )
    return ModelFit(
        battery,
        plain.model,
        parameters,
        0.0,
        0.0,
        plain.noise_w,
        rmse_before_w,
        plain.rmse_w,
        plain.explained,
        tuple(run.run.run for run in before.runs),
        float(np.sum(before.seconds())),
        tuple(dict.fromkeys([*before.remarks, remark])),
    )


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
