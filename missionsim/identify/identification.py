"""Which physical effect is missing? The whole identification of one battery, as docs/method.md describes it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate, RunData
from missionsim.identify.design import make_source
from missionsim.identify.estimates import Z95, estimated, pairs
from missionsim.identify.evidence import cause_is_constant, smallest_detectable
from missionsim.identify.findings import Finding, Findings, Judged, Recalibrated, Structure, Unexplained
from missionsim.identify.forward import Choice
from missionsim.identify.model import Model
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.profile import refit_shapes
from missionsim.identify.residual import dependences, low_frequency_noise, peaks, periodic, wrong_form
from missionsim.identify.rules import demoted, other_curve, refusal
from missionsim.identify.settings import HALVED, SEVERAL_RUNS, TWIN, TWINS, Settings
from missionsim.identify.simpler import (
    drifts_instead,
    instead_of_effects,
    level_difference,
    parameters_instead,
    runs_apart,
)
from missionsim.identify.stepwise import choose, confirmed, forced
from missionsim.identify.verdict import decide


@dataclass(frozen=True, kw_only=True)
class Identification(Findings):
    """All findings of one battery, and the fit that they rest on, for later questions."""

    choice: Choice
    """The fitted model with what speaks for each effect in it, and the model without effects."""
    library: tuple[Candidate, ...]
    settings: Settings
    doubted: tuple[Finding, ...] = ()
    """Effects that the model keeps and does not name."""
    factor: float | None = None
    """The one factor on the whole model that took the place of all effects."""
    averages: tuple[Structure, ...] = ()
    """A level by which all runs differ."""

    def error_w2(self, clocks: Iterable[Clock]) -> float:
        """Mean squared error of left-out runs under least squares at the best of some clocks [W2]."""
        model = self.choice.model
        tried = [LeastSquares.of(model.source.design(clock)) for clock in clocks]
        return min(squares.leave_out(model.chosen).total / float(squares.seconds.sum()) for squares in tried)

    def base_doubtful(self, settings: Settings) -> bool:
        """Whether the base is far from right, or further off than what is known of it allows, or a twin of one of its
        parameters is named, which may have taken that."""
        beyond = (abs(one.shift_in_prior_sd) > settings.recalibration_limit for one in self.recalibration)
        return self.choice.forward is not None or self.twins > 0 or any(beyond)

    @property
    def demoted(self) -> tuple[str, ...]:
        """Names of the effects that the model keeps and does not name."""
        return tuple(one.effect for one in self.doubted)

    @property
    def twins(self) -> int:
        """Number of chosen columns that a base parameter imitates."""
        columns = self.choice.model.source.layout.columns
        return sum(self.library[columns[k].candidate].prior is not None for k in self.choice.model.chosen)


def identify(
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    prior_sd: Mapping[str, float],
    settings: Settings = Settings(),  # noqa: B008 (frozen)
) -> Identification:
    """Find the effects that the base model misses.

    Parameters
    ----------
    runs : measured runs of one battery with base model, its gradient and the candidate columns
    candidates : effects of the library
    prior_sd : relative standard deviation of each base parameter (3 % where absent)
    settings : choices of the method

    Raises
    ------
    ValueError
        Without a run of at least eight analysis intervals, or with arrays of different lengths.
    """
    return _told(choose(make_source(runs, candidates, prior_sd, settings)), len(runs))


def fit_effects(
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    effects: Sequence[str],
    prior_sd: Mapping[str, float],
    settings: Settings = Settings(),  # noqa: B008 (frozen)
) -> Identification:
    """Fit a given set of effects (no search, none demoted); of a grid of shapes the best column is taken and refitted.

    Raises
    ------
    ValueError
        If an effect is not among the candidates or never acts in these runs.
    """
    return _told(forced(make_source(runs, candidates, prior_sd, settings), effects), len(runs), given=True)


def refutes(free: Identification, held: Identification) -> bool:
    """Whether left-out runs refute what the file says of its base: far better predicted without it, or as well where
    effects that are twins of base parameters say that the base is off."""
    if not free.effects and (held.factor is not None or held.averages):
        return False  # one factor on all says as much
    far = held.choice.forward is not None
    part = TWINS if held.twins > (not far) else TWIN if held.twins or far else HALVED
    # two searches may end at clocks that the noise model takes for the same, and least squares does not
    clocks = {free.choice.model.clock, held.choice.model.clock}
    return free.error_w2(clocks) < part * held.error_w2(clocks)


def _told(choice: Choice, given_runs: int, given: bool = False) -> Identification:
    """Everything that is said of a choice; with `given` effects, all of them are named."""
    near = choice.forward is None
    choice, shapes = refit_shapes(choice, choice.model.chosen)
    if not given and near:  # the selection by prediction has gates of its own
        choice = confirmed(choice)
    model, constraints = choice.model, choice.model.constraints
    chosen = dict.fromkeys(constraints.of_column(k).effect for k in model.chosen)
    shapes = {name: shape for name, shape in shapes.items() if name in chosen}

    forms = {k: form for k in model.chosen if (form := wrong_form(model, k)) is not None}
    # a wrong form is told once, not as a dependence on its covariate too
    seen = {s.covariate for s in forms.values()}
    rest = tuple(s for s in dependences(model) if s.covariate not in seen)
    loose = tuple(s for s in (periodic(model), low_frequency_noise(model)) if s is not None)
    apart, meters_apart = runs_apart(model)
    structures = (*forms.values(), *rest, *loose, *(() if apart is None else (apart,)))

    unnamed: tuple[str, ...] = ()
    factor: float | None = None
    averages: tuple[Structure, ...] = ()
    if not given:
        shifted = drifts_instead(model)
        if near:
            doubtful = [k for k in model.chosen if demoted(model, choice.evidence[k], forms, rest, loose)]
            shifted |= parameters_instead(model, {*shifted, *(constraints.of_column(k).effect for k in doubtful)})
        else:  # what else is left is told, and takes nothing back that predicts; a label's levels are free as they are
            asked = [k for k in model.chosen if not constraints.of_column(k).levels]
            doubtful = [k for k in asked if k in forms or other_curve(model, k, rest)]
        structures = (*shifted.values(), *structures)
        unnamed = tuple(dict.fromkeys((*(constraints.of_column(k).effect for k in doubtful), *shifted)))
        named = [name for name in chosen if name not in unnamed]
        factor = instead_of_effects(model) if named else None
        if factor is not None:
            words = (
                f"the meter reads {factor:.3g} times what the model gives, whatever the robot does, which explains as "
                f"much as {' and '.join(named)} would: check the units of the log, the meter and the robot file"
            )
            structures = (Structure("", 0.0, 0.0, abs(factor - 1.0), words), *structures)
            unnamed = tuple(sorted(chosen))
        elif (level := level_difference(model)) is not None:
            averages = (level,)
    # after the refit of shapes, so that rivals meet the effect at its best
    alike = pairs(model)
    kept = estimated(choice, shapes, alike, rest)
    effects = tuple(one for one in kept if one.effect not in unnamed)
    found = {effect.effect for effect in effects}
    confounding = {a: {b: r for b, (r, _) in row.items() if math.isfinite(r)} for a, row in alike.items() if a in found}
    noise, layout = model.noise, model.design.layout
    shifts, covariance = model.estimate(model.chosen)
    told = ("fast_s", "slow_s", "fast_share", "slow_share", "offset_w", "gain", "motion_gain")
    size = {"sd_w": noise.total_sd_w, "sd_share": noise.total_sd_w / layout.mean_power_w}
    return Identification(
        verdict=decide(effects, structures, unnamed, averages=averages),
        effects=effects,
        candidates=_judged(choice, effects, unnamed, factor, 0.0 if apart is None else apart.size_share),
        recalibration=tuple(
            Recalibrated(
                parameter=name,
                shift=float(shifts[i]),
                shift_sd=float(np.sqrt(covariance[i, i])),
                shift_in_prior_sd=float(shifts[i] / layout.prior_sd[i]),
            )
            for i, name in enumerate(layout.parameters)
        ),
        delay_s=model.clock.delay_s,
        lag_s=model.clock.lag_s,
        clock_at_edge=model.clock.at_edge,
        noise=size | {name: getattr(noise, name) for name in told},
        unexplained=_unexplained(model, structures, averages, depends=factor is None),
        remarks=_remarks(model, given_runs, meters_apart),
        mean_power_w=layout.mean_power_w,
        confounding=confounding,
        choice=choice,
        library=tuple(constraints.candidates),
        settings=constraints.settings,
        doubted=tuple(one for one in kept if one.effect in unnamed),
        factor=factor,
        averages=averages,
    )


def _judged(
    choice: Choice, effects: Sequence[Finding], unnamed: Sequence[str], factor: float | None, apart: float
) -> tuple[Judged, ...]:
    """Every candidate with its reason and its detection limit; `apart`: what the runs differ by, as nothing usual does,
    in which a cause that is constant in runs may hide."""
    constraints = choice.model.constraints
    if choice.forward is None:
        limits = smallest_detectable(choice.model)
    else:
        limits = choice.forward.smallest_detectable(len(constraints.effect), constraints.settings)
    named = {one.effect for one in effects if one.is_clear}
    rival_of = {rival: one.effect for one in effects for rival in one.alike if rival not in named}
    out = []
    for number, candidate in enumerate(constraints.candidates):
        name = candidate.effect
        own, _ = constraints.split(range(len(constraints.effect)), number)
        inside = [k for k in own if k in choice.model.chosen]
        share = sum(choice.evidence[k].share for k in inside)
        tried = [choice.refused[k] for k in own if k in choice.refused]
        if name in rival_of:
            reason = f"these data cannot tell it from {rival_of[name]}"
        elif not own:
            reason = "never acts in these runs" if candidate.columns else "its columns are missing"
        elif inside and name not in unnamed:
            reason = f"explains {100 * share:.2g} % of the energy"
        elif inside and factor is not None:
            reason = f"a factor of {factor:.3g} on the whole model explains as much"
        elif inside:
            reason = "helps, but its form is not right or a louder structure remains"
        else:
            best = max(tried, key=lambda e: e.gain, default=None)
            reason = "adds nothing beyond what is in the model" if best is None else refusal(best)
        # the shape that would be seen first: smaller than that nothing of the effect is seen; levels are all there
        limit = (max if candidate.levels else min)((float(limits[k]) for k in own), default=math.inf)
        if apart and own and cause_is_constant(choice.model, own[0]):
            limit = max(limit, apart)
        # what is there by every test but that of runs it was not fitted to, one of which may be spoilt, is not excluded
        doubtable = {"runs", "energy"}
        if choice.forward is not None and choice.forward.halves(number, choice.model.chosen):
            doubtable = {"robust"}  # too few parts of too few runs, of which a test makes nothing
        spoilt = [e for e in tried if all(held or gate in doubtable for gate, held in e.passed.items())]
        unsure = [e for e in spoilt if not inside and not e.accepted]
        shares = {e.share: e.share + Z95 * e.share_sd for e in unsure}
        limit = max([limit, *shares.values()])
        least = limit if math.isfinite(limit) else None
        doubtful = share if inside and name in unnamed else max(shares, default=None)
        is_open = name in rival_of or name in unnamed or bool(unsure)
        out.append(Judged(name, bool(inside) and name not in unnamed, reason, least, is_open, doubtful))
    return tuple(out)


def _unexplained(
    model: Model, structures: Sequence[Structure], averages: Sequence[Structure], depends: bool
) -> Unexplained:
    """What is left, with the share of the squared error that the structures make; `averages` are told, not counted."""
    left = model.design.residual
    if model.chosen:
        left = left - model.gram.shares(model.chosen) @ model.design.phi[list(model.chosen)]
    variance = float(np.average(left**2, weights=model.design.duration_s))
    made = sum((s.size_share * model.design.layout.mean_power_w) ** 2 for s in structures)
    share = min(1.0, made / max(variance, 1e-300))
    on = tuple(dict.fromkeys(s.covariate for s in structures if s.covariate)) if depends else ()
    rare = peaks(left, model.design.duration_s)
    told = "; ".join(filter(None, (*dict.fromkeys(s.shape for s in (*averages, *structures)), rare)))  # levels once
    return Unexplained(float(share), on, told, (*averages, *structures))


def _remarks(model: Model, given_runs: int, meters_apart: str) -> tuple[str, ...]:
    out = []
    used = len(model.design.runs)
    if used < given_runs:
        out.append(f"{given_runs - used} of {given_runs} runs are too short and were left out")
    if used == 1:
        out.append(
            "one run only: whether a finding repeats cannot be shown, and what is constant during the run (payload, "
            "temperature, floor) cannot be told from a shift of the base model"
        )
    elif used < SEVERAL_RUNS:
        out.append("two runs only: no p-value across runs; differences between runs rest on two values")
    if meters_apart:
        out.append(meters_apart)
    if model.clock.at_edge:
        out.append("the delay or lag of the power meter lies at the edge of what was searched; check the clocks")
    return tuple(out)
