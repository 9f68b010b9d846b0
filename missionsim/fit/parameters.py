"""Fit the parameters of a model to logs, with or without prior knowledge of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.fit.final import Value, final_fit
from missionsim.fit.plain import free_priors, settled, told_apart
from missionsim.fit.prepare import Prepared, prepare
from missionsim.identify.design import make_source
from missionsim.identify.settings import Settings
from missionsim.runs.error import Errors, errors_of
from missionsim.runs.run import Run

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
    before, after : Errors
        Of the model as it was and as it was fitted, as `missionsim compare` measures them.
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
    before: Errors
    after: Errors
    explained: float
    runs: tuple[str, ...]
    seconds: float
    remarks: tuple[str, ...]


@np.errstate(over="ignore", invalid="ignore")  # a formula without a value is told, not warned of
def fit_parameters(
    model: PowerModel, logs: Sequence[Run], battery: str, *, free: bool = False, settings: Settings | None = None
) -> ModelFit:
    """Fit every parameter of one battery's model to logs; see `missionsim.fit.final.final_fit`.

    Parameters
    ----------
    model : PowerModel
        Start values, units, priors.
    logs : sequence of Run
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
        prior_sd = free_priors(ready, known) if free else {name: max(p.prior_sd, 1e-6) for name, p in known.items()}
        clock = make_source(ready.data(), [], prior_sd, settings).clock
        fitted = final_fit(model, logs, battery, prior_sd, clock, settings)
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
        reach = Z95 * new.sd
        parameters[name] = FittedParameter(
            name, own.unit, new.value, new.sd, new.value - reach, new.value + reach, own.value, seen
        )
    remarks = [
        f"{name} and {twin} act on the power in the same way: {twin} is fitted, {name} stays as it is"
        for name, twin in fitted.alike.items()
    ]
    after = errors_of(fitted.model, logs, battery)
    return ModelFit(
        battery,
        fitted.model,
        parameters,
        clock.delay_s,
        clock.lag_s,
        errors_of(given, logs, battery),
        after,
        explained(after, ready),
        tuple(log.run for log in logs),
        after.total.seconds,
        tuple(dict.fromkeys([*ready.remarks, *remarks])),
    )


def explained(errors: Errors, ready: Prepared) -> float:
    """Share of the variance of the measured power that a model explains (R²)."""
    measured, seconds = ready.measured_w(), ready.seconds()
    level = float(np.average(measured, weights=seconds))
    spread = float(np.average((measured - level) ** 2, weights=seconds))
    return 1.0 - errors.power_rmse_w**2 / spread if spread > 0.0 else 0.0
