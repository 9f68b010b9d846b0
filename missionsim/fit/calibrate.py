"""What `calibrate` writes: a robot file refitted to logs, or one for a robot that is only known from its logs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from missionsim.effects.base_terms import ALIASES
from missionsim.effects.covariates import elapsed, is_moving
from missionsim.effects.model import PowerModel
from missionsim.errors import InputError, did_you_mean
from missionsim.expressions import FUNCTIONS, compile_expression
from missionsim.fit import parameters as fitting
from missionsim.glossary import column_of
from missionsim.identify.estimates import Z95
from missionsim.inputs import edit
from missionsim.inputs.edit import Editing
from missionsim.inputs.loading import load_robot, robot_from_text
from missionsim.inputs.power import build_power_model
from missionsim.numerals import rounded
from missionsim.runs.covariates import is_switch
from missionsim.runs.drive import drive
from missionsim.runs.error import errors_of
from missionsim.runs.run import Run

SHORTEST_STANDING_S = 5.0
"""Time at rest from which the standing power is fitted on its own."""
SETTLING_S = 3.0
REST_BLOCK_S = 10.0
_OPTIONS = {
    "name": "--new",
    "body.mass": "--mass",
    "body.drive": "--drive",
    "body.max_speed": "--max-speed",
    "batteries": "--battery",
}
_NEAR, _LIKELY = 0.5, 0.75
"""Similarity from which a parameter may be, or probably is, a column's name written wrong."""
_UNKNOWN = "not known from logs; put your own"


@dataclass(frozen=True)
class NewRobot:
    """What the user says of a robot beside its logs."""

    name: str
    base: str
    battery: str = "robot"
    """All three: name, formula over ``v a w u theta m`` or log columns and parameters, and battery that the formula
    describes."""
    mass: str = ""
    capacity: str = ""
    max_speed: str = ""
    """All three: as the user wrote them, such as ``25 kg``; empty where not given."""
    drive: str = "differential"


@dataclass(frozen=True)
class Calibration:
    """A fitted robot file: its text, one fit a battery, remarks, runs that were left out and why."""

    text: str
    fits: tuple[fitting.ModelFit, ...]
    remarks: tuple[str, ...]
    left_out: tuple[str, ...] = ()

    @property
    def fit(self) -> fitting.ModelFit:
        """The fit of the first battery, of a new robot the only one."""
        return self.fits[0]


def refit_robot(robot: str | Path, logs: Sequence[Run], battery: str | None = None) -> Calibration:
    """Fit every parameter of a robot that the logs say something about.

    Parameters
    ----------
    robot : str or path
        Shipped robot or file.
    battery : str, optional
        Only this one; by default every battery that the logs measure and whose model they can drive.

    Raises
    ------
    missionsim.errors.InputError
        Where no battery can be fitted.
    """
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
            if own.value != 0.0 and not fitting.fitted_to(source, logs):
                aged[name] = replace(own, sd=fitting.sd_on_other_logs(own.prior_sd, source) * abs(own.value))
        terms.append(replace(term, parameters=aged))
    aged_model = replace(model, terms=tuple(terms))
    fits: list[fitting.ModelFit] = []
    remarks: list[str] = []
    refused: list[InputError] = []
    updates: dict[str, dict[str, Any]] = {}
    for name in wanted:
        if name not in model.batteries:
            refused.append(InputError.unknown(f"the robot has no battery '{name}'", name, model.batteries))
            continue
        try:
            fit = fitting.fit_parameters(aged_model, logs, name)
        except InputError as error:
            refused.append(error)
            remarks.append(f"battery {name} was not fitted: {' '.join(str(error).split())}")
            continue
        fits.append(fit)
        remarks += fit.remarks
        for parameter in fit.parameters.values():
            whole = model.parameters[f"{name}/{parameter.name}"]
            if parameter.seen and whole.path:
                updates[whole.path] = fitting.as_fitted(whole, parameter.value, parameter.sd)
    if not fits:
        raise refused[0]
    if twice := [
        n for n, p in model.parameters.items() if fitting.fitted_to(spec.sources.get(p.source, p.source), logs)
    ]:
        remarks.append(
            f"{', '.join(n.partition('/')[2] for n in twice)}: fitted to these very logs before, so that "
            "they count twice now and the intervals are too narrow; refit the file as it was before"
        )
    editing = edit.Editing(edit.robot_text(robot)).set_values(updates)
    for fit in fits:
        editing.set_meter(fit.battery, fit.model.meter(fit.battery))
    written = build_power_model(robot_from_text(editing.text))
    # what has no place in the file does not move: the errors are those of the file
    owns = [[log for log in logs if fit.battery in log.power_w] for fit in fits]
    afters = [errors_of(written, own, fit.battery) for fit, own in zip(fits, owns, strict=True)]
    fits = [replace(fit, model=written, after=after) for fit, after in zip(fits, afters, strict=True)]
    text = editing.set_source(fitting.CALIBRATION, fitting.fitted_source(logs), fitting.ranges_of(logs)).text
    return Calibration(text, tuple(fits), tuple(dict.fromkeys(remarks)))


def calibrate_new(robot: NewRobot, logs: Sequence[Run]) -> Calibration:
    """Fit a base formula to logs and write the robot file of it.

    Every component with an ``on_…`` column that changes gets a power; standing still gets a level of its own where the
    logs show it.

    Raises
    ------
    missionsim.errors.InputError
        For a formula that cannot be read, that names columns which the logs lack, or whose parameters the logs cannot
        tell apart.
    """
    if not any(robot.battery in log.power_w for log in logs):
        measured = sorted({name for log in logs for name in log.power_w})
        told = f"no log measures the battery '{robot.battery}'"
        raise InputError.unknown(told, robot.battery, measured, file="--battery")
    remarks: list[str] = []
    formula = compile_expression(robot.base, file="--base")
    shared = set.intersection(*(set(log.columns) for log in logs))
    columns = {name for log in logs for name in log.columns}
    for name in sorted(formula.names):
        wanted = ALIASES.get(name, name)
        derived = wanted in ("accel_m_s2", "mass_kg")
        known = name in ALIASES or column_of(name) is not None
        if known and not derived and wanted not in shared:
            others, hint = ", ".join(sorted(columns)), did_you_mean(wanted, columns)
            raise InputError.single(
                f"--base reads '{name}' ({wanted}), which not every log has", got=name, allowed=others, hint=hint
            )
    for name in sorted(formula.names):
        # turns (or ways) to one side may give other power by the formula than those to the other
        if (column := ALIASES.get(name, name)) not in ("yaw_rate_rad_s", "lateral_speed_m_s"):
            continue
        left, right = (formula.evaluate(dict.fromkeys(formula.names, 1.0) | {name: sign}) for sign in (1.0, -1.0))
        values = [log.number(column) for log in logs if column in log.columns]
        if left != right and min(map(np.nanmin, values)) < 0.0 < max(map(np.nanmax, values)):
            remarks.append(
                f"{name} has a sign, this formula gives one side more power than the other: for both alike, abs({name})"
            )
    components = _components(logs, remarks)
    parameters = sorted(
        n for n in formula.names if not (n in ALIASES or n in shared or column_of(n) is not None or n in FUNCTIONS)
    )
    standing, still = all("speed_m_s" in log.columns for log in logs), False
    if standing:
        rest = sum(float(np.sum(log.dt_s[~np.asarray(is_moving(log.columns))])) for log in logs)
        still = rest >= sum(float(np.sum(log.dt_s)) for log in logs)
        standing = rest >= SHORTEST_STANDING_S
        if not standing:
            remarks.append(f"the robot stood still for {rest:.0f} s only: power at rest is the formula's at zero speed")
    if still and parameters:
        message = "the robot stands still in every row, so that these logs say nothing of the power while it moves"
        allowed = "0, which fits the power at rest alone; or logs in which it moves"
        raise InputError.single(message, file="--base", got=robot.base, allowed=allowed)
    if not (still or parameters):
        raise InputError.single(
            "--base has no parameter that could be fitted", got=robot.base, allowed="names of your own: 'c3*v + c4'"
        )
    if standing and "standing" in parameters:
        raise InputError.single(
            "'standing' is the name of the power at rest; call the parameter otherwise", got=robot.base
        )
    names = [*parameters, *(["standing"] if standing else [])]
    draft = _text(robot, dict.fromkeys(names), components, standing, logs, "")
    fit = fitting.fit_parameters(_load(draft), logs, robot.battery, free=True)
    # columns that every log has and a formula may read
    readable = sorted(name for name in shared if name != "time_s" and not name.startswith(("power_", "energy_")))
    asked = [*names, *(f"{c}.power" for c in components)]
    if unseen := [name for name in asked if name in fit.parameters and not fit.parameters[name].seen]:
        near = dict.fromkeys(column for name in unseen if (column := did_you_mean(name, readable, _NEAR)))
        raise InputError.single(
            "these logs cannot tell some parameters of --base apart",
            got=", ".join(unseen),
            allowed=f"parameters that each change the power on their own, and columns: {', '.join(readable)}",
            hint=", ".join(near),
        )
    for name in parameters:
        if column := did_you_mean(name, readable, _LIKELY):
            remarks.append(f"{name} was fitted as a parameter; if the column {column} is meant, write that")
    if standing:
        fit = _with_rest(fit, logs, robot.battery)
    for name, value in fit.parameters.items():
        if value.value < 0.0:
            told, low, high = map(rounded, (value.value, value.low, value.high))
            why = "the formula lacks something that goes along with it: add that, or let missionsim diagnose name it"
            if value.high > 0.0:
                why = "these logs do not tell it from zero: leave its term out of --base, or vary it more"
            remarks.append(f"{name} came out negative ({told}, 95 % {low} to {high}): {why}")
    text = _text(robot, fit.parameters, components, standing, logs, fitting.fitted_source(logs))
    text = Editing(text).set_meter(robot.battery, fit.model.meter(robot.battery)).text
    written = _load(text)
    remarks += fitting.short_of(text, robot.battery, logs)
    after = errors_of(written, [log for log in logs if robot.battery in log.power_w], robot.battery)
    return Calibration(text, (replace(fit, model=written, after=after),), (*fit.remarks, *remarks))


def _load(text: str) -> PowerModel:
    """The model of a robot file that we write; its faults are told at the options that they come from."""
    try:
        return build_power_model(robot_from_text(text))
    except InputError as error:
        faults = []
        for fault in error.faults:
            option = next((option for begin, option in _OPTIONS.items() if fault.path.startswith(begin)), "--base")
            if option == "--battery" and fault.path.endswith(".capacity"):
                option = "--capacity"
            faults.append(replace(fault, file=option, line=0, column=0, path=""))
        raise InputError(faults) from None


def _components(logs: Sequence[Run], remarks: list[str]) -> dict[str, int]:
    """Components with a switch in the logs that was used: name and most units."""
    found: dict[str, int] = {}
    for column in sorted({name for log in logs for name in filter(is_switch, log.columns)}):
        values = np.concatenate([np.asarray(log.columns[column], dtype=float) for log in logs if column in log.columns])
        values = values[np.isfinite(values)]
        if len(np.unique(values)) > 1:
            found[column[3:]] = max(1, math.ceil(float(np.max(values))))
        else:
            remarks.append(f"{column[3:]} was never switched in these logs: its power is part of the base")
    return found


def _with_rest(fit: fitting.ModelFit, logs: Sequence[Run], battery: str) -> fitting.ModelFit:
    """Power at rest from the rows at rest alone, where they say more of it than all rows together.

    Noise of a driving robot can be far larger than all that it draws at rest. Rows just after a stop are left out, for
    meters lag; blocks of `REST_BLOCK_S` count as one observation.
    """
    blocks: list[float] = []
    for log in logs:
        if battery not in log.power_w:
            continue
        still = ~np.asarray(is_moving(log.columns))
        seconds = np.asarray(log.dt_s)
        clock = elapsed(still, seconds, reset=True)
        rows = still & (clock > SETTLING_S) & np.isfinite(log.power_w[battery])
        if not rows.any():
            continue
        model = drive(fit.model, log, battery).row_w(battery)
        left = (log.power_w[battery] - model)[rows]
        stops = np.cumsum(np.diff(still, prepend=False))  # a block never spans two of them
        blocks_of = np.column_stack([stops, np.floor((clock - 0.5 * seconds - SETTLING_S) / REST_BLOCK_S)])
        number = np.unique(blocks_of[rows], axis=0, return_inverse=True)[1]
        weight = np.bincount(number, seconds[rows])
        mean = np.bincount(number, left * seconds[rows]) / np.maximum(weight, 1e-9)
        blocks += mean[weight > 0.0].tolist()
    old = fit.parameters["standing"]
    sd = float(np.std(blocks, ddof=1) / np.sqrt(len(blocks))) if len(blocks) > 2 else np.inf
    if sd >= old.sd:
        return fit
    value = old.value + float(np.mean(blocks))
    value *= abs(value) > 1e-9 * sd  # a meter that reads nought leaves what rounding leaves
    new = replace(old, value=value, sd=sd, low=value - Z95 * sd, high=value + Z95 * sd)
    return replace(fit, parameters={**fit.parameters, "standing": new})


def _text(
    robot: NewRobot,
    values: Mapping[str, fitting.FittedParameter | None],
    components: Mapping[str, int],
    standing: bool,
    logs: Sequence[Run],
    source: str,
) -> str:
    speeds = [np.abs(np.asarray(log.columns["speed_m_s"], dtype=float)) for log in logs if "speed_m_s" in log.columns]
    fastest = float(np.nanmax(np.concatenate(speeds))) if speeds else 0.0
    max_speed = f"{{value: {fastest:.3g} m/s, status: measured, note: fastest in the logs}}"
    if robot.max_speed:
        max_speed = json.dumps(robot.max_speed)
    elif fastest <= 0.0:
        max_speed = f"{{value: 1 m/s, status: assumed, note: {json.dumps(_UNKNOWN)}}}"
    most_wh = max(abs(log.energy_wh(robot.battery)) for log in logs if robot.battery in log.power_w)
    capacity = f"{{value: {max(10.0 * most_wh, 1.0):.2g} Wh, status: assumed, note: {json.dumps(_UNKNOWN)}}}"
    capacity = json.dumps(robot.capacity) if robot.capacity else capacity
    base = [name for name in values if "." not in name]
    lines = [
        "kind: robot",
        f"name: {_word(robot.name)}",
        f"title: {json.dumps(f'{robot.name}, base model fitted to measured logs')}",
        *([f"sources: {{{fitting.CALIBRATION}: {json.dumps(source)}}}"] if source else []),
        *([f"origin: {{range: {json.dumps(fitting.ranges_of(logs))}}}"] if source else []),
        "body:",
        *([f"  mass: {json.dumps(robot.mass)}"] if robot.mass else []),
        f"  drive: {_word(robot.drive)}",
        f"  max_speed: {max_speed}",
        "batteries:",
        f"  {_word(robot.battery)}: {{capacity: {capacity}}}",
        "motion:",
        f"  battery: {_word(robot.battery)}",
        "  model: expression",
        f"  power: {json.dumps(robot.base)}",
        *(["  standing: standing"] if standing else []),
        "  parameters:",
        *(f"    {_word(name)}: {_number(values[name])}" for name in base),
    ]
    if components:
        lines.append("components:")
    for name, units in components.items():
        number = _number(values.get(f"{name}.power"), "W")
        lines += [
            f"  {_word(name)}:",
            *([f"    units: {units}"] if units > 1 else []),
            "    loads:",
            f"      - {{battery: {_word(robot.battery)}, power: {number}}}",
        ]
    sensors = ", ".join(f"{_word(name)}: {units}" for name, units in components.items())
    lines += [
        "schemes:",
        "  drive:",
        "    motion: true",
        *([f"    sensors: {{optional: {{{sensors}}}}}"] if sensors else []),
    ]
    return "\n".join(lines) + "\n"


def _word(text: str) -> str:
    """A name as YAML has it, in quotes where some YAML reads it as something else (`true`, `null`, `yes`)."""
    return text if text.isidentifier() and yaml.safe_load(text) == text else json.dumps(text)


def _number(value: fitting.FittedParameter | None, unit: str = "") -> str:
    # power of a component may not be negative in a robot file
    if value is None:
        return f"1 {unit}".strip()
    shown = max(value.value, 0.0) if unit else value.value
    suffix = f" {unit}" if unit else ""
    sd = f"{max(value.sd, 1e-12):.3g}{suffix}"
    return f"{{value: {shown:.6g}{suffix}, sd: {sd}, status: fitted, source: {fitting.CALIBRATION}}}"
