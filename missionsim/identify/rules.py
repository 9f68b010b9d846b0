"""The rules that decide, as two tables in the order in which they are asked: gates into the model, and demotions.

A gate is asked of every effect that would enter the model, after each fit. A demotion is asked of every effect in the
model once the search has ended, against what remains in the residual; a demoted effect stays in the fit unnamed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from missionsim.identify.data import Candidate
from missionsim.identify.evidence import (
    Evidence,
    cause_is_constant,
    evidence_of,
    nats_needed,
    predicts_left_out,
    rests_on_one_run,
    tails,
)
from missionsim.identify.findings import Structure
from missionsim.identify.gram import Constraints
from missionsim.identify.model import Model
from missionsim.identify.residual import stands_without
from missionsim.identify.settings import FAINT_NATS, WORSE_ENERGY_LEVEL, Settings

STEADY_LOADS = ("standby_load", "component_power", "component_warmup", "conversion_loss")
"""The mean of a load that comes and goes looks like one of these."""


@dataclass(frozen=True)
class Question:
    """An effect in a fitted model, and everything that a gate may look at."""

    model: Model
    evidence: Evidence
    constraints: Constraints
    candidates: Sequence[Candidate]
    settings: Settings

    @property
    def tail(self) -> float:
        """False alarms that this column is allowed, in one tail."""
        # the misfit of another effect goes either way, whatever sign physics gives
        beside = len(self.model.chosen) > 1
        return float(tails(self.constraints, self.settings, beside)[self.evidence.column])

    @cached_property
    def left_out(self) -> tuple[bool, float]:
        """Whether left-out runs are predicted better with the effect, and the p-value that their energy is no worse."""
        own = self.constraints.effect[self.evidence.column]
        return predicts_left_out(self.model, [k for k in self.model.chosen if self.constraints.effect[k] == own])


@dataclass(frozen=True)
class Gate:
    """One condition that every effect in the model must meet, and what is said where it does not."""

    name: str
    holds: Callable[[Question], bool]
    refusal: str


def _likelihood(q: Question) -> bool:
    return q.evidence.gain > nats_needed(q.tail)


def _robust(q: Question) -> bool:
    return q.evidence.p_robust < 2.0 * q.tail


def _practical(q: Question) -> bool:
    return abs(q.evidence.share) > q.settings.min_share


def _clock(q: Question) -> bool:
    return len(q.model.design.runs) > 1 or not _candidate(q).by_clock


def _several_runs(q: Question) -> bool:
    if len(q.model.design.runs) < 2 or not cause_is_constant(q.model, q.evidence.column, q.candidates):
        return True
    return not rests_on_one_run(q.model, q.evidence.column)


def _beyond_recalibration(q: Question) -> bool:
    shift = implied_shift(q.model, q.candidates, q.evidence.column, q.evidence.share)
    return not abs(shift) <= q.settings.recalibration_limit  # NaN for effects without a twin in the base


GATES: tuple[Gate, ...] = (
    Gate("likelihood", _likelihood, "the rise of the likelihood could be chance"),
    Gate("robust", _robust, "not significant with errors that allow for correlated noise"),
    Gate("practical", _practical, "significant but negligible"),
    Gate("clock", _clock, "in so few runs whatever wanders looks like warming up or like starts"),
    Gate("several runs", _several_runs, "rests on one run, which may differ from the others in something else"),
    Gate("beyond recalibration", _beyond_recalibration, "within what recalibration of the base model allows"),
)


def _power_left_out(q: Question) -> bool:
    return q.left_out[0]


def _energy_left_out(q: Question) -> bool:
    return q.left_out[1] > WORSE_ENERGY_LEVEL


LAST_GATES: tuple[Gate, ...] = (
    Gate("runs", _power_left_out, "left-out runs are not predicted better"),
    Gate("energy", _energy_left_out, "the energy of left-out runs is predicted worse"),
)
"""Asked of the final model: what does not predict runs that it has not seen is of no use in a robot file."""
REFUSALS = {gate.name: gate.refusal for gate in (*GATES, *LAST_GATES)}
"""What is said where a gate does not hold; the last two are those of `missionsim.identify.forward`."""


def weigh(
    model: Model, column: int, constraints: Constraints, candidates: Sequence[Candidate], settings: Settings
) -> Evidence:
    """Evidence for a column in a model, with the answer of every gate."""
    evidence = evidence_of(model, column, constraints, settings)
    question = Question(model, evidence, constraints, candidates, settings)
    return replace(evidence, passed={gate.name: gate.holds(question) for gate in GATES})


def refusal(evidence: Evidence) -> str:
    """In words, why an effect did not enter."""
    words = [text for name, text in REFUSALS.items() if not evidence.passed.get(name, True)]
    return f"{100 * evidence.share:.2g} % of the energy ± {100 * evidence.share_sd:.2g}: " + "; ".join(words)


def implied_shift(model: Model, candidates: Sequence[Candidate], column: int, share: float) -> float:
    """Shift of the twin base parameter, in prior sd, that a coefficient amounts to; NaN for effects without a twin."""
    layout = model.design.layout
    twin = candidates[layout.columns[column].candidate].prior
    if twin is None or twin not in layout.parameters:
        return float("nan")
    q = layout.parameters.index(twin)
    gradient, phi = model.design.gradient[q], model.design.phi[column]
    size = float(gradient @ gradient)
    if size <= 0:
        return float("nan")
    return float(share * (phi @ gradient) / size / layout.prior_sd[q])


@dataclass(frozen=True)
class Remains:
    """What remains in the residual, by kind: wrong forms of effects in the model by their column, dependences on
    covariates, and loose structure (a periodic load, low-frequency noise)."""

    forms: dict[int, Structure]
    dependences: tuple[Structure, ...]
    loose: tuple[Structure, ...]


@dataclass(frozen=True)
class Demotion:
    """One reason not to name an effect that the model keeps."""

    name: str
    holds: Callable[[Question, Remains], bool]


def _wrong_form(q: Question, remains: Remains) -> bool:
    return q.evidence.column in remains.forms


def _steady_beside_loose(q: Question, remains: Remains) -> bool:
    return bool(remains.loose) and _family(q) in STEADY_LOADS


def _faint_beside_loose(q: Question, remains: Remains) -> bool:
    # told with a load whose switch is stuck, it is a question, and the answer to what comes and goes may be that load
    stuck = _candidate(q).may_be(abs(q.evidence.share) * q.model.design.layout.mean_power_w)
    return bool(remains.loose) and not stuck and _gain(q) < FAINT_NATS


def _shadow(q: Question, remains: Remains) -> bool:
    own = _candidate(q).covariate  # a curve over it is judged as the effect's form
    others = [s for s in (*remains.forms.values(), *remains.dependences) if s.covariate != own]
    return any(not stands_without(q.model, q.evidence.column, s) for s in others)


DEMOTIONS: tuple[Demotion, ...] = (
    Demotion("its form is not right", _wrong_form),
    Demotion("a load that comes and goes has its mean", _steady_beside_loose),
    Demotion("faint beside low-frequency noise", _faint_beside_loose),
    Demotion("shadow of another structure", _shadow),
)


def demoted(question: Question, remains: Remains) -> str:
    """The first demotion that holds, empty where none does."""
    return next((rule.name for rule in DEMOTIONS if rule.holds(question, remains)), "")


def _gain(q: Question) -> float:
    """Rise of the log-likelihood [nats], of a label by all its levels together."""
    column, chosen, effect = q.evidence.column, q.model.chosen, q.constraints.effect
    if not q.constraints.joint[column]:
        return q.evidence.gain
    return float(q.model.gram.gain(chosen) - q.model.gram.gain([k for k in chosen if effect[k] != effect[column]]))


def _candidate(q: Question) -> Candidate:
    return q.candidates[int(q.constraints.effect[q.evidence.column])]


def _family(q: Question) -> str:
    return _candidate(q).effect.partition(":")[0]
