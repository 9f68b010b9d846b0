"""Refit the parameters of a robot file, each with its own prior, and write them back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.fit.parameters import ModelFit, fit_parameters
from missionsim.fit.provenance import CALIBRATION, as_fitted, fitted_source, fitted_to, ranges_of, sd_on_other_logs
from missionsim.runs.error import errors_of
from missionsim.runs.run import Run


@dataclass(frozen=True)
class Refit:
    """A robot file with refitted parameters: its text, one fit a battery, remarks."""

    text: str
    fits: tuple[ModelFit, ...]
    remarks: tuple[str, ...]


def refit_robot(robot: str | Path, logs: Sequence[Run], battery: str | None = None) -> Refit:
    """Fit every parameter of a robot that the logs say something about.

    Parameters
    ----------
    robot : str or path
        Shipped robot or file.
    logs : sequence of Run
    battery : str, optional
        Only this one; by default every battery that the logs measure and whose model they can drive.

    Raises
    ------
    missionsim.errors.InputError
        Where no battery can be fitted.
    """
    from missionsim.inputs import edit
    from missionsim.inputs.loading import load_robot, robot_from_text
    from missionsim.inputs.power import build_power_model

    spec = load_robot(robot)
    model = build_power_model(spec)
    measured = list(dict.fromkeys(name for log in logs for name in log.power_w))
    wanted = measured if battery is None else [battery]
    # what was fitted to other logs is known less well: see `sd_on_other_logs`
    terms = []
    for term in model.terms:
        aged = dict(term.parameters)
        for name, own in term.parameters.items():
            source = spec.sources.get(own.source, own.source)
            if own.value != 0.0 and not fitted_to(source, logs):
                aged[name] = replace(own, sd=sd_on_other_logs(own.prior_sd, source) * abs(own.value))
        terms.append(replace(term, parameters=aged))
    aged_model = replace(model, terms=tuple(terms))
    fits: list[ModelFit] = []
    remarks: list[str] = []
    refused: list[InputError] = []
    updates: dict[str, dict[str, Any]] = {}
    for name in wanted:
        if name not in model.batteries:
            refused.append(
                InputError.single(f"the robot has no battery '{name}'", got=name, allowed=", ".join(model.batteries))
            )
            continue
        try:
            fit = fit_parameters(aged_model, logs, name)
        except InputError as error:
            refused.append(error)
            remarks.append(f"battery {name} was not fitted: {' '.join(str(error).split())}")
            continue
        fits.append(fit)
        remarks += fit.remarks
        for parameter in fit.parameters.values():
            whole = model.parameters[f"{name}/{parameter.name}"]
            if parameter.seen and whole.path:
                updates[whole.path] = as_fitted(whole, parameter.value, parameter.sd)
    if not fits:
        raise refused[0]
    if twice := [n for n, p in model.parameters.items() if fitted_to(spec.sources.get(p.source, p.source), logs)]:
        remarks.append(
            f"{', '.join(n.partition('/')[2] for n in twice)}: fitted to these very logs before, so that "
            "they count twice now and the intervals are too narrow; refit the file as it was before"
        )
    editing = edit.Editing(edit.robot_text(robot)).set_values(updates)
    written = build_power_model(robot_from_text(editing.text))
    # what has no place in the file does not move: the errors are those of the file
    owns = [[log for log in logs if fit.battery in log.power_w] for fit in fits]
    afters = [errors_of(written, own, fit.battery) for fit, own in zip(fits, owns, strict=True)]
    fits = [replace(fit, model=written, after=after) for fit, after in zip(fits, afters, strict=True)]
    text = editing.set_source(CALIBRATION, fitted_source(logs), ranges_of(logs)).text
    return Refit(text, tuple(fits), tuple(dict.fromkeys(remarks)))
