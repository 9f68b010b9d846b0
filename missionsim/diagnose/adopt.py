"""Take an effect into a robot file: fit it with its base, write term, uncertainty and where they come from."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from missionsim.diagnose.diagnosis import Named, judged
from missionsim.diagnose.examine import Examined, Subject, examine
from missionsim.diagnose.heldout import Models
from missionsim.diagnose.proposed import formula_of, of_form, with_candidate, with_law
from missionsim.diagnose.split import Split
from missionsim.diagnose.waterfall import bars_of, worse_note
from missionsim.effects.library import get_effect
from missionsim.errors import InputError, MissionsimError, did_you_mean
from missionsim.files import Json, fields_of
from missionsim.fit.final import FinalFit
from missionsim.fit.parameters import CALIBRATION, as_fitted, fitted_source, ranges_of
from missionsim.identify.findings import AT_BOUND, Estimate, Finding, HeldOut
from missionsim.identify.identification import fit_effects
from missionsim.identify.settings import Settings
from missionsim.inputs import edit
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.robot import RobotSpec
from missionsim.physics.lag import Meter
from missionsim.runs.covariates import is_switch


class NotSignificant(MissionsimError):
    """The data do not support the effect; the command line exits with 1."""


@dataclass(frozen=True)
class Adopted:
    """A robot file with an effect added."""

    text: str
    """The new file."""
    effect: Finding
    """What was fitted."""
    reason: str
    """Why the data do not support it; empty where they do."""
    base: Mapping[str, tuple[float, float]]
    """Recalibrated base parameters that were written. Mapping of str to (value, sd)."""
    heldout: HeldOut | None = None
    """Errors of the file before, recalibrated and as it was written."""
    meter: Meter = field(default_factory=Meter)
    """Delay and lag of the meter that were written."""

    def to_json(self) -> Json:
        """As ``missionsim add-effect --json`` has it."""
        return {
            "schema": "missionsim.add_effect/1",
            "effect": self.effect.effect,
            "added": True,
            "significant": not self.reason,
            "reason": self.reason,
            **fields_of(self.effect, "parameters energy_share energy_share_given_back=back p_value"),
            **fields_of(self, "indistinguishable_from=effect.indistinguishable_from heldout"),
            "worse": self.worse or None,
            "meter": self.meter._asdict(),
            "base": {name: {"value": value, "sd": sd} for name, (value, sd) in self.base.items()},
        }

    @property
    def worse(self) -> str:
        """In words, that the file predicts held-out runs worse; empty where it does not."""
        return "" if self.heldout is None else worse_note(bars_of(self.heldout))


def check_name(robot: RobotSpec, effect: str, split: Split | None = None) -> None:
    """Refuse an effect that neither the library nor the robot file nor the logs know.

    Parameters
    ----------
    effect : str
        Id in the library, or name of one of the file's candidates.
    split : Split, optional
        Runs, which may switch components that the file lacks; where none are read yet, no component is refused.

    Raises
    ------
    missionsim.errors.InputError
    """
    if any(effect == spec.name for spec in robot.effects):
        return
    family, colon, component = effect.partition(":")
    known = None
    if split is not None:
        runs = (*split.train, *split.heldout)
        logged = {name.removeprefix("on_") for run in runs for name in run.columns if is_switch(name)}
        known = [*robot.components, *sorted(logged - robot.components.keys())]
    if colon and family.startswith("component_") and known is not None and component not in known:
        allowed = ", ".join(f"{family}:{name}" for name in known) or "a component in the robot file first"
        hint = f"{family}:{near}" if (near := did_you_mean(component, known)) else ""
        raise InputError.single(f"the robot has no component '{component}'", got=effect, allowed=allowed, hint=hint)
    if get_effect(effect, ("",)).execution:
        raise InputError.single(
            f"'{effect}' is how the robot drives, not what it draws: write it under 'behaviour' of the mission or of a "
            "scheme",
            got=effect,
            allowed="effects that add power",
        )


def adopt(
    text: str,
    split: Split,
    effect: str,
    battery: str,
    settings: Settings,
    *,
    formula: bool = False,
    force: bool = False,
    recalibrate: bool = True,
) -> Adopted:
    """Fit an effect to logs and write it into the text of a robot file, as `diagnose` says it.

    Parameters
    ----------
    text : str
        Robot file; its comments are kept.
    split : Split
        Its training runs are fitted.
    effect : str
        Id in the library, name of one of the file's candidates, or a formula.
    formula : bool
        Whether `effect` is a formula, or the number of a form that is proposed.
    force : bool
        Write it even if the data do not support it.
    recalibrate : bool
        Write the base parameters that were fitted with it.

    Raises
    ------
    NotSignificant
        The data do not support the effect, and `force` is not set.
    missionsim.errors.InputError
        Unknown effect, one that the file already holds, or one that these logs cannot test.
    """
    subject = Subject.of(robot := robot_from_text(text))
    if battery not in robot.batteries:
        raise InputError.unknown(f"the robot has no battery '{battery}'", battery, robot.batteries)
    law: Finding | None = None
    if formula:
        named = judged(seen := examine(subject, split, battery, settings))
        law, own = _law_of(named, effect)
        text, effect = with_candidate(text, battery, own)
        robot = robot_from_text(text)
        if law is not None:
            law, seen = replace(law, effect=effect), replace(seen, models=with_law(seen.models, effect, own))
        else:  # of one's own: it has to pass what the library's effects pass
            subject = Subject.of(robot)
    check_name(robot, effect, split)
    for spec in robot.effects:
        if not spec.candidate and effect in (spec.effect, spec.name) and spec.battery == battery:
            told = f"the robot file already has '{effect}' on battery '{battery}'"
            raise InputError.single(told, got=effect, allowed="missionsim calibrate --robot refits it")
    if law is None:
        named = judged(seen := examine(subject, split, battery, settings))
        _check_testable(seen, effect)
    models = seen.models
    together, reason = _supported(seen, named, effect) if law is None else ((*named.effects, law), "")
    fitted = named.fitted
    if together != named.effects or not recalibrate:
        fitted = models.fit(together, keep_base=not recalibrate)
        together = models.leaning(models.told(together, fitted), fitted)
    found = next(one for one in together if one.effect == effect)
    if law is not None and found.may_be_nothing:
        reason = f"{effect} comes to nothing beside the base once both are fitted together"
    if reason and not force:
        raise NotSignificant(reason)
    if len(together) > 1 and recalibrate:
        # the base beside other effects is wrong in a file that lacks them; the size of this one is not
        fitted = models.fit([found], fixed=True)
    new, base = write(text, models, [found], fitted, split, forced=bool(reason))
    held = [log for log in split.heldout if battery in log.power_w]
    powers = (subject.model, models.fit(()).model, fitted.model)
    heldout = models.held_out(powers, held, split.how, split.shifted) if held else None
    meter = fitted.model.meter(battery)
    return Adopted(new, found, reason, base, heldout, meter)


def write(
    text: str, models: Models, effects: Sequence[Finding], fitted: FinalFit, split: Split, *, forced: bool = False
) -> tuple[str, dict[str, tuple[float, float]]]:
    """Write effects and the base that was fitted with them into the text of a robot file.

    `effects`: with the values of `fitted`; all of its effects. Gives the text and the base parameters written.
    """
    known = models.features.parameters
    base = {name: (new.value, new.sd) for name, new in fitted.values.items() if name in known}
    updates = {known[name].path: as_fitted(known[name], value, sd) for name, (value, sd) in base.items()}
    editing = edit.Editing(text).set_values(updates)
    # less of something than the file says: the base itself is smaller, there is no effect to add
    written = [one for one in effects if not models.lowers(one)]
    names = [one.effect for one in written]
    own = [
        (i, spec)
        for i, spec in enumerate(editing.robot.effects)
        if spec.candidate and spec.name in names and spec.battery == models.battery
    ]
    for i, _ in reversed(own):
        editing.remove_effect(i)
    families = (one.effect.partition(":") for one in written if one.effect.startswith("component_"))
    for name in {part for _, _, part in families} - editing.robot.components.keys():
        editing.add_component(name, models.battery)
    for one in written:
        fitted_now = {"status": "fitted", "source": CALIBRATION}
        parameters = {
            name: {"value": p.value, "sd": max((p.high - p.low) / 3.92, 1e-9), "unit": p.unit} | fitted_now | _noted(p)
            for name, p in one.parameters.items()
        }
        origin: dict[str, Any] = {
            "by": "missionsim add-effect",
            "date": dt.datetime.now(dt.UTC).date().isoformat(),
            "p_value": one.p_value,
            "energy_share": one.energy_share,
        } | ({"energy_share_given_back": one.back} if one.back else {})
        if one.indistinguishable_from:
            origin["cannot_be_told_from"] = list(one.indistinguishable_from)
        if forced:
            origin["forced"] = True
        entry: dict[str, Any] = {"effect": one.effect, "battery": models.battery}
        if candidate := next((spec for _, spec in own if spec.name == one.effect), None):
            entry = {"name": one.effect, "battery": models.battery, "power": candidate.power}
        editing.add_effect(entry | {"parameters": parameters, "origin": origin})
    editing.set_meter(models.battery, fitted.model.meter(models.battery))
    # which runs, and what they covered, stands once in a file: its base was fitted to them too
    ranges = ranges_of(split.train, editing.robot.origin)
    return editing.set_source(CALIBRATION, fitted_source(split.train), ranges).text, base


def _noted(told: Estimate) -> dict[str, str]:
    """What the number of a parameter does not say by itself: that it was chosen, or came out at nothing."""
    if told.low == told.high:
        return {"note": "chosen, not fitted"}
    return {"note": "none, its least"} if 0.0 <= told.value <= AT_BOUND * (told.high - told.low) else {}


def _law_of(named: Named, asked: str) -> tuple[Finding | None, str]:
    """The finding of a form that is proposed, None where it is a formula of one's own; and the formula."""
    formula = formula_of(named.proposed, asked)
    for law in named.proposed:
        for form in law.laws:
            if form.formula == formula:
                others = tuple(one.formula for one in law.laws if one.variables != form.variables) if law.open else ()
                return replace(of_form(law, form), indistinguishable_from=others), formula
    return None, formula


def _check_testable(seen: Examined, effect: str) -> None:
    """Refuse an effect that these logs cannot test."""
    features = seen.features
    if effect in features.untestable:
        told = f"these logs cannot test '{effect}'"
        raise InputError.single(told, got=effect, allowed="logs with " + ", ".join(features.untestable[effect]))
    known = [candidate.effect for candidate in features.candidates]
    if effect not in known:
        raise InputError.unknown(f"'{effect}' is not an effect that these logs can test", effect, known)


def _supported(seen: Examined, named: Named, effect: str) -> tuple[tuple[Finding, ...], str]:
    """The effect with everything that it is fitted beside, and why the logs do not support it; empty where they do."""
    if any(one.effect == effect for one in named.effects):
        return named.effects, ""
    others = [e.effect for e in named.effects if effect not in e.alike]
    features = seen.features
    try:
        fitted = fit_effects(
            features.runs, features.candidates, [*others, effect], features.prior_sd, seen.models.settings
        )
    except ValueError as error:
        raise InputError.single(str(error), got=effect) from error
    columns = fitted.choice.model.design.layout.columns
    own = [(fitted.library[columns[k].candidate], fitted.choice.evidence[k]) for k in fitted.choice.model.chosen]
    own = [(candidate, evidence) for candidate, evidence in own if candidate.effect == effect]
    right_sign = all(one.sign == 0 or one.sign * evidence.share > 0 for one, evidence in own)
    is_rival = any(effect in e.alike for e in named.effects)
    if right_sign and is_rival and any(evidence.accepted for _, evidence in own):
        return fitted.effects, ""
    searched = next(c for c in named.candidates if c.effect == effect)
    limit = searched.smallest_detectable_share
    told = f"{effect} is not supported by these logs: {searched.reason}"
    if not right_sign:
        told += "; its coefficient comes out with the wrong sign"
    if limit is not None and not searched.open:
        told += f"; less than {100 * limit:.1f} % of the energy would not be seen"
    return fitted.effects, told
