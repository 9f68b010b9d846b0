"""The law that a diagnosis proposes where no effect of the library fits, and its errors on held-out runs."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

from missionsim.diagnose.heldout import Models
from missionsim.effects.base import ParameterSpec
from missionsim.effects.base_terms import expression_term
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.fit.final import FinalFit
from missionsim.identify.estimates import Z95
from missionsim.identify.findings import Estimate, Finding
from missionsim.identify.proposed import Law, Proposal
from missionsim.inputs import edit
from missionsim.inputs.loading import robot_from_text
from missionsim.laws.grammar import unit_of
from missionsim.runs.covariates import MOTION
from missionsim.runs.run import Run

_SHORT = {
    "speed_m_s": "speed",
    "yaw_rate_rad_s": "turning",
    "accel_m_s2": "acceleration",
    "lateral_speed_m_s": "sideways",
    "slope_rad": "slope",
    "payload_kg": "payload",
    "temp_ambient_c": "temperature",
    "temp_motor_c": "motor_temperature",
    "access_point_distance_m": "distance",
    "time_s": "time",
    "moving_time_s": "moving_time",
}
_MOVING = re.compile(r"\(abs\(speed_m_s\) >= [\d.]+ or abs\(yaw_rate_rad_s\) >= [\d.]+\)")
PROPOSED = "proposed: no effect of the library fits"


def as_written(
    law: Proposal, models: Models, effects: Sequence[Finding], heldout: Sequence[Run]
) -> tuple[Proposal, FinalFit]:
    """A proposal with the numbers that `add-effect` and `improve` write: those of each form fitted beside the effects
    that were named; and its errors on runs that nothing was fitted to. Then the fit of its first form.

    The search goes by the noise of its rows and by their likelihood; what is written has the energy that was measured.
    """
    forms, fits = [], []
    for form in law.laws:
        one = of_form(law, form)
        beside = with_law(models, one.effect, one.effect)
        fits.append(beside.fit([*effects, one]))
        *_, told = beside.told([*effects, one], fits[-1])
        k = told.parameters["k"]
        forms.append(replace(form, k=k.value, low=k.low, high=k.high, energy_share=told.energy_share))
        if len(forms) == 1:
            share_sd = 0.5 * (told.share_high - told.share_low) / Z95
    times = forms[0].k / law.first.k if law.first.k else 1.0
    curve = law.curve and law.curve.times(times)
    made = replace(law, laws=tuple(forms), curve=curve, energy_share=forms[0].energy_share, share_sd=share_sd)
    if not heldout:
        return made, fits[0]
    before, after = (models.errors(power, heldout) for power in (models.fit(effects).model, fits[0].model))
    energy_pct = (before.run_energy_error_pct, after.run_energy_error_pct)
    rmse_w = (before.power_rmse_w, after.power_rmse_w)
    return replace(made, heldout_rmse_w=rmse_w, heldout_energy_pct=energy_pct), fits[0]


def with_law(models: Models, name: str, formula: str) -> Models:
    """Models that can hold a law under a name."""
    expression = compile_expression(formula)
    specs = (ParameterSpec("k", unit_of(formula), low=-math.inf if _may_give_back(formula) else 0.0),)
    effect = expression_term(name, expression, specs, drive=bool(expression.names & MOTION))
    return replace(models, features=replace(models.features, effects={**models.features.effects, name: effect}))


def law_name(formula: str) -> str:
    """A name for a law that goes into a robot file: ``law_speed_turning_payload``."""
    formula = _MOVING.sub("speed_m_s", formula)  # which reads the turn rate, and is not about it
    names = compile_expression(formula).names - {"k"}
    words = [_SHORT.get(name, name) for name in sorted(names, key=formula.index)]
    return "_".join(["law", *words])[:60]


def called(finding: Finding) -> str:
    """The name that what is about to be added would have in a robot file."""
    return law_name(finding.effect) if finding.level == PROPOSED else finding.effect


def check_formula(formula: str) -> None:
    """Refuse a law of the user's own that cannot be read or is not ``k * …``."""
    expression = compile_expression(formula, file="--formula")
    if "k" not in expression.names:
        told = "the formula has no coefficient k"
    elif not expression.proportional_to("k"):
        told = "the formula is not proportional to k, which is fitted"
    else:
        return
    raise InputError.single(told, file="--formula", got=formula, allowed="k * …, such as 'k * abs(yaw_rate_rad_s)'")


def with_candidate(text: str, battery: str, formula: str) -> tuple[str, str]:
    """The text of a robot file with a law as a candidate of its own, and the candidate's name.

    `text`: robot file. `formula`: ``k * …`` over columns of the log; its only parameter is ``k``, whose unit follows
    from the columns. Raises InputError: for a formula that cannot be read or has no ``k``.
    """
    check_formula(formula)
    held = {effect.name for effect in robot_from_text(text).effects}
    name = law_name(formula)
    while name in held:
        name += "_again"
    entry = {
        "name": name,
        "battery": battery,
        "candidate": True,
        "power": formula,
        "parameters": {"k": {"value": 1.0, "unit": unit_of(formula)} | ({} if _may_give_back(formula) else {"low": 0})},
    }
    return edit.Editing(text).add_effect(entry).text, name


def _may_give_back(formula: str) -> bool:
    return any(part in formula for part in ("max(-accel_m_s2", "max(-slope_rad"))


def formula_of(proposed: Sequence[Proposal], asked: str) -> str:
    """The formula that a user asks for: as text, or by its number among the forms proposed.

    Raises InputError: for a number that no form has.
    """
    if not asked.strip().isdigit():
        return asked
    forms = [law for one in proposed for law in one.laws]
    number = int(asked)
    if not 1 <= number <= len(forms):
        allowed = ", ".join(f"{i}: {law.formula}" for i, law in enumerate(forms, 1)) or "none: nothing is proposed"
        raise InputError.single("these logs propose no such form", got=asked, allowed=allowed)
    return forms[number - 1].formula


def of_form(law: Proposal, form: Law) -> Finding:
    """One form of a proposal as a finding."""
    return as_finding(replace(law, laws=(form,), energy_share=form.energy_share))


def as_finding(law: Proposal) -> Finding:
    """A proposal as a finding, for whoever asks whether to add it."""
    first = law.first
    before, after = law.heldout_rmse_w or (None, None)
    z = abs(law.energy_share) / max(law.share_sd, 1e-300)
    return Finding(
        effect=first.formula,
        parameters={"k": Estimate(first.k, first.low, first.high, first.unit)},
        energy_share=law.energy_share,
        p_value=math.erfc(z / math.sqrt(2.0)),
        share_low=law.energy_share - Z95 * law.share_sd,
        share_high=law.energy_share + Z95 * law.share_sd,
        gain_nats=law.rise_nats,
        level=PROPOSED,
        heldout_rmse_before_w=before,
        heldout_rmse_after_w=after,
    )
