"""The rules that decide, in the order in which they are asked: gates into the model, and demotions.

A gate is asked of every effect that would enter the model, after each fit. A demotion is asked of every effect in the
model once the search has ended, against what remains in the residual; a demoted effect stays in the fit unnamed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from missionsim.identify.evidence import (
    Evidence,
    cause_is_constant,
    driven_for,
    evidence_of,
    nats_needed,
    predicts_left_out,
    rests_on_one_run,
    tails,
)
from missionsim.identify.findings import Structure
from missionsim.identify.model import Model
from missionsim.identify.residual import outdone, stands_without
from missionsim.identify.settings import FAINT_NATS, HALVED, WORSE_ENERGY_LEVEL
from missionsim.runs.covariates import known

STEADY_LOADS = ("standby_load", "component_power", "component_warmup", "conversion_loss")
"""The mean of a load that comes and goes looks like one of these."""
REFUSALS = {
    "likelihood": "the rise of the likelihood could be chance",
    "robust": "not significant with errors that allow for correlated noise",
    "practical": "significant but negligible",
    "clock": "in so few runs whatever wanders looks like warming up or like starts",
    "several runs": "rests on one run, which may differ from the others in something else",
    "beyond recalibration": "within what recalibration of the base model allows",
    "runs": "left-out runs are not predicted better",
    "energy": "the energy of left-out runs is predicted worse",
}
"""What is said where a gate does not hold; the last two are asked of the final model."""


def gates(model: Model, evidence: Evidence) -> dict[str, bool]:
    """The conditions that every effect in the model must meet, and whether a column meets them."""
    column, settings, runs = evidence.column, model.constraints.settings, len(model.design.runs)
    # false alarms allowed to this column; the misfit of another effect goes either way, whatever sign physics gives
    tail = float(tails(model.constraints, len(model.chosen) > 1)[column])
    alone = rests_on_one_run(model, column) if runs > 1 and cause_is_constant(model, column) else None
    shift = implied_shift(model, column, evidence.share)
    return {
        "likelihood": evidence.gain > nats_needed(tail),
        "robust": evidence.p_robust < 2.0 * tail,
        "practical": abs(evidence.share) > settings.min_share or _of_left_out(model, column)[0] < HALVED,
        "clock": runs > 1 or not model.constraints.of_column(column).by_clock,
        "several runs": alone is None or bool(driven_for(model, column)[alone]),
        # NaN for effects without a twin in the base
        "beyond recalibration": not abs(shift) <= settings.recalibration_limit,
    }


def last_gates(model: Model, evidence: Evidence) -> dict[str, bool]:
    """Asked of the final model: what does not predict runs that it has not seen is of no use in a robot file."""
    left, energy_p = _of_left_out(model, evidence.column)
    return {"runs": left < 1.0, "energy": energy_p > WORSE_ENERGY_LEVEL}


def _of_left_out(model: Model, column: int) -> tuple[float, float]:
    """What `predicts_left_out` gives for all columns of a column's effect."""
    own, _ = model.constraints.split(model.chosen, model.constraints.effect[column])
    return predicts_left_out(model, own)


def weighed(model: Model, columns: Sequence[int]) -> dict[int, Evidence]:
    """Evidence for columns in a model, with the answer of every gate."""
    evidence = {column: evidence_of(model, column) for column in columns}
    return {column: replace(one, passed=gates(model, one)) for column, one in evidence.items()}


def refusal(evidence: Evidence) -> str:
    """In words, why an effect did not enter."""
    words = [text for name, text in REFUSALS.items() if not evidence.passed.get(name, True)]
    return f"{100 * evidence.share:.2g} % of the energy ± {100 * evidence.share_sd:.2g}: " + "; ".join(words)


def implied_shift(model: Model, column: int, share: float) -> float:
    """Shift of the twin base parameter, in prior sd, that a coefficient amounts to; NaN for effects without a twin."""
    layout = model.design.layout
    twin = model.constraints.of_column(column).prior
    if twin is None or twin not in layout.parameters:
        return float("nan")
    q = layout.parameters.index(twin)
    gradient, phi = model.design.gradient[q], model.design.phi[column]
    size = float(gradient @ gradient)
    if size <= 0:
        return float("nan")
    return float(share * (phi @ gradient) / size / layout.prior_sd[q])


def demoted(
    model: Model,
    evidence: Evidence,
    forms: Mapping[int, Structure],
    dependences: Sequence[Structure] = (),
    loose: Sequence[Structure] = (),
) -> str:
    """The first reason not to name an effect that the model keeps, empty where there is none.

    What remains in the residual, by kind: wrong `forms` of effects by their column, `dependences` on covariates, and
    `loose` structure (a periodic load, low-frequency noise).
    """
    column, candidate = evidence.column, model.constraints.of_column(evidence.column)
    if column in forms:
        return "its form is not right"
    if loose:
        if candidate.effect.partition(":")[0] in STEADY_LOADS:
            return "a load that comes and goes has its mean"
        gain = evidence.gain
        if model.constraints.joint[column]:  # of a label by all its levels together
            _, rest = model.constraints.split(model.chosen, model.constraints.effect[column])
            gain = float(model.gram.gain(model.chosen) - model.gram.gain(rest))
        # told with a load whose switch is stuck, it is a question, and that load may be what comes and goes
        stuck = candidate.may_be(abs(evidence.share) * model.design.layout.mean_power_w)
        # what is constant in a run is seen in the means of runs, over which the noise within them averages out
        tail = float(tails(model.constraints, True)[column])
        between = cause_is_constant(model, column) and evidence.p_runs < 2.0 * tail
        if not stuck and not between and gain < FAINT_NATS:
            return "faint beside low-frequency noise"
    if other_curve(model, column, dependences):
        return "its form is not right"
    # a curve over the effect's own covariate is judged as its form
    others = [s for s in (*forms.values(), *dependences) if s.covariate != candidate.covariate]
    if any(not stands_without(model, column, s) for s in others):
        return "shadow of another structure"
    return ""


def other_curve(model: Model, column: int, dependences: Sequence[Structure]) -> bool:
    """Whether a curve over its own covariate that does not go with speed does far better than an effect that does."""
    own = model.constraints.of_column(column).covariate
    plain = [s for s in dependences if s.covariate == own and not s.times and known(own).multiplies_speed]
    return any(outdone(model, column, s) for s in plain)
