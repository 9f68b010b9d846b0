"""Take an effect into a robot file: fit it with its base, write term, uncertainty and where they come from."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.diagnose.diagnosis import Examined, Subject, examine
from missionsim.diagnose.features import Features
from missionsim.diagnose.priors import of_formula
from missionsim.diagnose.split import Split
from missionsim.errors import InputError, MissionsimError, did_you_mean
from missionsim.fit.provenance import CALIBRATION, data_tag, log_hash
from missionsim.identify.findings import Estimate, Finding
from missionsim.identify.identification import Identification, fit_effects
from missionsim.identify.settings import Settings

if TYPE_CHECKING:
    from missionsim.effects.model import ModelParameter
    from missionsim.inputs.robot import RobotSpec

METER_ALLOWANCE = 0.01
"""Relative standard deviation added to fitted base values: meters differ by about this much between runs (assumed)."""


class NotSignificant(MissionsimError):
    """The data do not support the effect; the command line exits with 1."""


@dataclass(frozen=True)
class Adopted:
    """A robot file with an effect added.

    Attributes
    ----------
    text : str
        The new file.
    effect : Finding
        What was fitted.
    significant : bool
    reason : str
        Why not, where it is not.
    rivals : tuple of str
        Effects that these data cannot tell from it.
    base : mapping of str to (value, sd)
        Recalibrated base parameters that were written.
    """

    text: str
    effect: Finding
    significant: bool
    reason: str
    rivals: tuple[str, ...]
    base: Mapping[str, tuple[float, float]]


def adopt(
    text: str,
    robot: RobotSpec,
    split: Split,
    effect: str,
    battery: str,
    settings: Settings,
    *,
    force: bool = False,
    recalibrate: bool = True,
    beside: Sequence[str] = (),
) -> Adopted:
    """Fit an effect to logs and write it into the text of a robot file.

    Parameters
    ----------
    text : str
        Robot file; its comments are kept.
    robot : RobotSpec
        The same file, loaded.
    split : Split
        Its training runs are fitted.
    effect : str
        Id in the library, or name of one of the file's candidates.
    battery : str
    settings : Settings
    force : bool
        Write it even if the data do not support it.
    recalibrate : bool
        Write the base parameters that were fitted with it.
    beside : sequence of str
        Effects that were taken in before, from the same file and logs: all are fitted together and written, so that no
        effect is fitted to a base that another one has bent.

    Raises
    ------
    NotSignificant
        The data do not support the effect, and `force` is not set.
    missionsim.errors.InputError
        Unknown effect, one that the file already holds, or one that these logs cannot test.
    """
    from missionsim.inputs import edit

    subject = Subject.of(robot)
    _refuse(subject, robot, effect, battery)
    seen = examine(subject, Split(split.train, (), split.how), battery, settings)
    features = seen.features
    if effect in features.untestable:
        raise InputError.single(
            f"these logs cannot test '{effect}'",
            got=effect,
            allowed="logs with " + ", ".join(features.untestable[effect]),
        )
    known = [candidate.effect for candidate in features.candidates]
    if effect not in known:
        raise InputError.single(
            f"'{effect}' is not an effect that these logs can test",
            got=effect,
            allowed=", ".join(known),
            hint=did_you_mean(effect, known),
        )
    found, fitted = _fit(seen, effect, settings)
    significant, reason = _supported(seen, fitted, effect)
    if not significant and not force:
        raise NotSignificant(reason)
    rivals = found.indistinguishable_from
    found, fitted = _alone(features, found, fitted, beside, settings)
    base = _base(features, fitted) if recalibrate else {}
    new = _based(text, features, base)
    for one in (*(e for e in fitted.effects if e.effect in beside), found):
        new = _with(new, robot, features, one, split, battery, base, *((significant, rivals) if one is found else ()))
    count = len(split.train)
    told = f"fitted to {count} run{'s' * (count != 1)}, data {data_tag(split.train)}"
    return Adopted(edit.set_source(new, CALIBRATION, told), found, significant, reason, rivals, base)


def _refuse(subject: Subject, robot: RobotSpec, effect: str, battery: str) -> None:
    from missionsim.effects.library import get_effect

    if battery not in robot.batteries:
        raise InputError.single(
            f"the robot has no battery '{battery}'", got=battery, allowed=", ".join(robot.batteries)
        )
    family, colon, component = effect.partition(":")
    if colon and family.startswith("component_") and component not in robot.components:
        raise InputError.single(
            f"the robot has no component '{component}'",
            got=effect,
            allowed=", ".join(f"{family}:{name}" for name in robot.components) or "a component in the robot file first",
            hint=f"{family}:{near}" if (near := did_you_mean(component, robot.components)) else "",
        )
    own = {e.id for e in subject.own.get(battery, ())}
    for spec in robot.effects:
        if not spec.candidate and effect in (spec.effect, spec.name) and spec.battery == battery:
            raise InputError.single(
                f"the robot file already has '{effect}' on battery '{battery}'",
                got=effect,
                allowed="missionsim calibrate --robot refits it",
            )
    if effect not in own and get_effect(effect, ("",)).execution:
        raise InputError.single(
            f"'{effect}' is how the robot drives, not what it draws: write it under 'behaviour' of the mission or of a "
            "scheme",
            got=effect,
            allowed="effects that add power",
        )


def _fit(seen: Examined, effect: str, settings: Settings) -> tuple[Finding, Identification]:
    """The effect fitted beside whatever else the logs ask for."""
    inside = next((e for e in seen.found.effects if e.effect == effect), None)
    if inside is not None:
        return inside, seen.found
    others = [e.effect for e in seen.found.effects if effect not in e.indistinguishable_from]
    features = seen.features
    try:
        fitted = fit_effects(features.runs, features.candidates, [*others, effect], features.prior_sd, settings)
    except ValueError as error:
        raise InputError.single(str(error), got=effect) from error
    return next(e for e in fitted.effects if e.effect == effect), fitted


def _alone(
    features: Features, found: Finding, fitted: Identification, beside: Sequence[str], settings: Settings
) -> tuple[Finding, Identification]:
    """Effect, those beside it and base fitted to each other, without what else is missing: the file holds just these.

    A base that was fitted beside a second effect is wrong in a file that lacks it.
    """
    layout = fitted.choice.model.design.layout
    inside = {fitted.library[layout.columns[k].candidate].effect for k in fitted.choice.model.chosen}
    wanted = {*beside, found.effect}
    if inside == wanted and wanted <= {e.effect for e in fitted.effects}:
        return found, fitted
    again = fit_effects(features.runs, features.candidates, [*beside, found.effect], features.prior_sd, settings)
    own = next(e for e in again.effects if e.effect == found.effect)
    turned = _first(own).value * _first(found).value < 0.0
    if not beside and (turned or len(own.parameters) != len(found.parameters)):
        return found, fitted
    size = replace(
        found,
        parameters=own.parameters,
        energy_share=own.energy_share,
        share_low=own.share_low,
        share_high=own.share_high,
    )
    return size, again


def _supported(seen: Examined, fitted: Identification, effect: str) -> tuple[bool, str]:
    searched = next(c for c in seen.found.candidates if c.effect == effect)
    if fitted is seen.found:
        return True, ""
    rival_of = [e.effect for e in seen.found.effects if effect in e.indistinguishable_from]
    layout = fitted.choice.model.design.layout
    own = [k for k in fitted.choice.model.chosen if fitted.library[layout.columns[k].candidate].effect == effect]
    right_sign = all(
        (fitted.library[layout.columns[k].candidate].sign or 1) * fitted.choice.evidence[k].share > 0
        or fitted.library[layout.columns[k].candidate].sign == 0
        for k in own
    )
    if right_sign and any(fitted.choice.evidence[k].accepted for k in own) and rival_of:
        return True, ""
    limit = searched.smallest_detectable_share
    told = f"{effect} is not supported by these logs: {searched.reason}"
    if not right_sign:
        told += "; its coefficient comes out with the wrong sign"
    if limit is not None and effect not in seen.found.demoted:
        told += f"; less than {100 * limit:.1f} % of the energy would not be seen"
    return False, told


def _first(found: Finding) -> Estimate:
    """The coefficient of an effect, or that of its first level."""
    return next(iter(found.parameters.values()))


def _base(features: Features, fitted: Identification) -> dict[str, tuple[float, float]]:
    """Recalibrated values of the parameters of the robot's base, those of effects found earlier among them."""
    base: dict[str, tuple[float, float]] = {}
    for shift in fitted.recalibration:
        parameter = features.parameters[shift.parameter]
        value = parameter.value * (1.0 + shift.shift)
        if parameter.value > 0.0 and not of_formula(parameter):
            value = max(value, 0.0)  # what is drawn at rest or by a component may be unknown, not negative
        if parameter.path and shift.shift_sd < 0.95 * features.prior_sd.get(shift.parameter, np.inf):
            base[shift.parameter] = (value, abs(parameter.value) * float(np.hypot(shift.shift_sd, METER_ALLOWANCE)))
    return base


def _based(text: str, features: Features, base: Mapping[str, tuple[float, float]]) -> str:
    """The text with recalibrated base values."""
    from missionsim.inputs import edit

    updates = {
        features.parameters[name].path: _of_file(features.parameters[name], value, sd)
        | {"note": f"{features.parameters[name].value / features.parameters[name].times:.6g} before"}
        for name, (value, sd) in base.items()
    }
    return edit.set_values(text, updates) if updates else text


def _with(
    text: str,
    robot: RobotSpec,
    features: Features,
    found: Finding,
    split: Split,
    battery: str,
    base: Mapping[str, tuple[float, float]],
    significant: bool = True,
    rivals: Sequence[str] = (),
) -> str:
    """The text with one effect more."""
    from missionsim.inputs import edit
    from missionsim.inputs.loading import robot_from_text

    candidate = next(c for c in features.candidates if c.effect == found.effect)
    if candidate.prior is not None and _first(found).value < 0.0:
        # less of something than the file says: the base itself is smaller, there is no effect to add
        return edit.set_values(text, _lowered(features, candidate.prior, candidate.columns[0], found, base))
    for i, spec in reversed(list(enumerate(robot_from_text(text).effects))):
        if spec.candidate and spec.name == found.effect and spec.battery == battery:
            text = edit.remove_effect(text, i)
    return edit.add_effect(text, _entry(robot, found, split, battery, significant, rivals))


def _lowered(
    features: Features, parameter: str, column: str, found: Finding, base: Mapping[str, tuple[float, float]]
) -> dict[str, dict[str, Any]]:
    x = np.concatenate([run.gradient[parameter] for run in features.runs])
    y = np.concatenate([run.columns[column] for run in features.runs])
    old = features.parameters[parameter]
    value, sd = base.get(parameter, (old.value, abs(old.value) * features.prior_sd[parameter]))
    value += old.value * float(x @ y) / float(x @ x) * _first(found).value
    return {old.path: _of_file(old, max(value, 0.0), sd)}


def _of_file(parameter: ModelParameter, value: float, sd: float) -> dict[str, Any]:
    """A fitted value as its file has it: of one unit, where the model has all units of a component."""
    return {"value": value / parameter.times, "sd": sd / parameter.times, "status": "fitted", "source": CALIBRATION}


def _entry(
    robot: RobotSpec, found: Finding, split: Split, battery: str, significant: bool, rivals: Sequence[str]
) -> dict[str, Any]:
    parameters = {
        name: {
            "value": p.value,
            "sd": max((p.high - p.low) / 3.92, 1e-9),
            "unit": p.unit,
            "status": "fitted",
            "source": CALIBRATION,
        }
        for name, p in found.parameters.items()
    }
    origin: dict[str, Any] = {
        "by": "missionsim add-effect",
        "date": dt.datetime.now(dt.UTC).date().isoformat(),
        "runs": [log.run for log in split.train],
        "sha256": [log_hash(log) for log in split.train],
        "p_value": found.p_value,
        "energy_share": found.energy_share,
    }
    if rivals:
        origin["cannot_be_told_from"] = list(rivals)
    if not significant:
        origin["forced"] = True
    own = next((e for e in robot.effects if e.candidate and e.name == found.effect and e.battery == battery), None)
    if own is not None:
        return {
            "name": own.name,
            "battery": battery,
            "power": str(getattr(own.power, "source", own.power)),
            "parameters": parameters,
            "origin": origin,
        }
    return {"effect": found.effect, "battery": battery, "parameters": parameters, "origin": origin}
