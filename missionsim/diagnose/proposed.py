"""The law that a diagnosis proposes where no effect of the library fits, and its errors on held-out runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from missionsim.diagnose.features import Features
from missionsim.diagnose.heldout import Models
from missionsim.effects.base import ParameterSpec
from missionsim.effects.base_terms import expression_term
from missionsim.effects.covariates import Covariates
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.identify.findings import Estimate, Finding, Judged, Unexplained
from missionsim.identify.identification import Identification
from missionsim.identify.proposed import Proposal
from missionsim.laws.grammar import unit_of
from missionsim.laws.proposal import Z95, plain, propose
from missionsim.runs.covariates import logged_name
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
MOTION = frozenset({"speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s", "accel_m_s2", "slope_rad"})
PROPOSED = "proposed: no effect of the library fits"
STANDS_IN = "stood in for a law that the library does not hold"


def proposed_laws(
    found: Identification, covariates: Sequence[Covariates], models: Models | None = None, heldout: Sequence[Run] = ()
) -> tuple[Proposal, ...]:
    """The proposal, if any form passes every gate, with its errors on held-out runs.

    `covariates`: of the fitted runs, at the raw rate; `models`: models fitted to these runs, for the errors on others;
    `heldout`: runs that nothing was fitted to.
    """
    made = propose(found, covariates)
    if made is None:
        return ()
    if models is None or not heldout:
        return (made.proposal,)
    named = [e for e in found.effects if e.effect not in made.proposal.instead_of]
    law = as_finding(made.proposal)
    fits = [models.fit(named), with_law(models, law.effect, law.effect).fit([*named, law])]
    errors = [models.errors(fit.model, heldout) for fit in fits]
    return (
        replace(
            made.proposal,
            heldout_rmse_w=(errors[0].power_rmse_w, errors[1].power_rmse_w),
            heldout_energy_pct=(errors[0].run_energy_error_pct, errors[1].run_energy_error_pct),
        ),
    )


def with_law(models: Models, name: str, formula: str) -> Models:
    """Models that can hold a law under a name."""
    specs = (ParameterSpec("k", unit_of(formula), low=-math.inf if _may_give_back(formula) else 0.0),)
    effect = expression_term(name, compile_expression(formula), specs, drive=_about_motion(formula))
    return replace(models, features=replace(models.features, effects={**models.features.effects, name: effect}))


def without_stand_ins(
    laws: Sequence[Proposal], effects: Sequence[Finding], candidates: Sequence[Judged]
) -> tuple[tuple[Finding, ...], tuple[Judged, ...]]:
    """Effects and candidates once those that stood in for a law are no longer named."""
    gone = {name for law in laws for name in law.instead_of}
    judged = tuple(
        replace(c, accepted=False, reason=STANDS_IN, open=True) if c.effect in gone else c for c in candidates
    )
    return tuple(e for e in effects if e.effect not in gone), judged


def of_motion(law: Proposal) -> bool:
    """Whether a law reads how the robot moves and what it carries alone, which loads that nobody logged do not follow:
    these look like a law of time, temperature or processor load."""
    read = {name for form in law.laws for name in form.variables}
    return bool(read & MOTION) and read <= MOTION | {"payload_kg", "mass_kg"}


def depends_on(laws: Sequence[Proposal], left: Unexplained) -> Unexplained:
    """What remains, with the quantities of the law before those that one curve at a time showed."""
    certain = [name for law in laws for name in law.certain]
    return replace(left, depends_on=tuple(dict.fromkeys((*certain, *left.depends_on))))


def law_name(formula: str) -> str:
    """A name for a law that goes into a robot file: ``law_speed_turning_payload``."""
    names = compile_expression(formula).names - {"k"}
    words = [_SHORT.get(name, name) for name in sorted(names, key=formula.index)]
    return "_".join(["law", *words])[:60]


def called(finding: Finding) -> str:
    """The name that what is about to be added would have in a robot file."""
    return law_name(finding.effect) if finding.level == PROPOSED else finding.effect


def with_candidate(text: str, battery: str, formula: str) -> tuple[str, str]:
    """The text of a robot file with a law as a candidate of its own, and the candidate's name.

    `text`: robot file. `formula`: ``k * …`` over columns of the log; its only parameter is ``k``, whose unit follows
    from the columns. Raises InputError: for a formula that cannot be read or has no ``k``.
    """
    from missionsim.inputs import edit
    from missionsim.inputs.loading import robot_from_text

    expression = compile_expression(formula)
    if "k" not in expression.names:
        raise InputError.single("the formula has no coefficient k", got=formula, allowed="'k * abs(yaw_rate_rad_s)'")
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


def _about_motion(formula: str) -> bool:
    return bool(compile_expression(formula).names & {"speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "lateral_speed_m_s"})


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
        raise InputError.single(
            "these logs propose no such form",
            got=asked,
            allowed=", ".join(f"{i}: {law.formula}" for i, law in enumerate(forms, 1)) or "none: nothing is proposed",
        )
    return forms[number - 1].formula


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


def something_else(laws: Sequence[Proposal], effects: Sequence[Finding], features: Features) -> bool:
    """Whether a proposed law reads quantities that no single named effect reads; else it is the form of that effect,
    told beside it."""
    known = [{logged_name(name) for name in features.effects[effect.effect].needs} for effect in effects]
    return any(not any({logged_name(v) for v in law.first.variables} <= own for own in known) for law in laws)


def beside_law(effect: Finding, laws: Sequence[Proposal], features: Features) -> str:
    """In words, that a law of another form reads what an effect goes by, which may then stand for a part of it."""
    goes_by = {logged_name(c.covariate) for c in features.candidates if c.effect == effect.effect}
    shared = [name for law in laws for name in law.first.variables if name in goes_by]
    if not shared:
        return effect.remark
    return f"a law of {plain(shared[0])} explains beside it what that effect cannot"
