"""Which physical effect is missing? The whole identification of one battery (steps 0 to 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from missionsim.identify.choose import Choice, choose, forced
from missionsim.identify.credible import pairs, rivals
from missionsim.identify.data import Candidate, RunData, Settings
from missionsim.identify.design import Source, make_source
from missionsim.identify.gates import SEVERAL_RUNS, Evidence, between_runs, smallest_detectable
from missionsim.identify.model import UNUSUAL_GAIN, Model
from missionsim.identify.noise import LARGEST_GAIN
from missionsim.identify.remainder import dependences, periodic, ramps, stands_without, wander, wrong_form
from missionsim.identify.result import (
    BaseShift,
    CandidateReport,
    ClockReport,
    Estimate,
    FoundEffect,
    Identification,
    NoiseReport,
    Structure,
    Unexplained,
)
from missionsim.identify.search import Rules
from missionsim.identify.shape import refit_shapes, without_shadows

RAMP_SYSTEMATIC = 0.3
"""Further relative allowance of a coefficient that rests on ramps, which the meter's lag and the averaging blur."""
STEADY_LOADS = ("standby_load", "component_power", "component_warmup", "conversion_loss")
FAINT_NATS = 50.0
FAINT_SHARE = 0.2
"""Beside a residual that wanders, an effect below this part of its size is not named."""


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

    Returns
    -------
    Identification
        ``verdict`` is ``effects_found``, ``nothing_missing``, ``ambiguous`` or ``unexplained_structure``.

    Raises
    ------
    ValueError
        Without a run of at least eight analysis intervals, or with arrays of different lengths.
    """
    source = make_source(runs, candidates, prior_sd, settings)
    return _report(source, candidates, choose(source, candidates, settings), settings, len(runs))


def fit_effects(
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    effects: Sequence[str],
    prior_sd: Mapping[str, float],
    settings: Settings = Settings(),  # noqa: B008 (frozen)
) -> Identification:
    """Fit a given set of effects (no search); of a grid of shapes the best column is taken and refitted.

    Raises
    ------
    ValueError
        If an effect is not among the candidates or never acts in these runs.
    """
    source = make_source(runs, candidates, prior_sd, settings)
    return _report(source, candidates, forced(source, candidates, effects, settings), settings, len(runs), given=True)


def _report(
    source: Source,
    candidates: Sequence[Candidate],
    choice: Choice,
    settings: Settings,
    given_runs: int,
    given: bool = False,
) -> Identification:
    rules = Rules.of(source.layout, candidates)
    if not given:
        choice = without_shadows(choice, candidates, rules, settings)
    choice, shapes = refit_shapes(choice, candidates, rules, settings)
    source = choice.model.source
    structures, doubtful = _structures(choice, candidates, rules, settings)
    demoted: tuple[str, ...] = ()
    if doubtful and not given:
        demoted = tuple(dict.fromkeys(candidates[int(rules.effect[k])].effect for k in doubtful))
    effects = _effects(choice, candidates, rules, settings, shapes, set() if given else doubtful)
    if structures and (doubtful or not effects) and not given:
        verdict = "unexplained_structure"
    elif any(e.indistinguishable_from for e in effects):
        verdict = "ambiguous"
    else:
        verdict = "effects_found" if effects else ("unexplained_structure" if structures else "nothing_missing")
    model = choice.model
    layout, noise = model.design.layout, model.noise
    shifts, covariance = model.gram.shifts(model.chosen)
    recalibration = tuple(
        BaseShift(name, float(shifts[i]), float(np.sqrt(covariance[i, i])), float(shifts[i] / layout.prior_sd[i]))
        for i, name in enumerate(layout.parameters)
    )
    clock = ClockReport(
        model.clock.delay_s,
        model.clock.lag_s,
        {n: model.clock.delay_s + d for n, d in zip(model.design.names, model.clock.run_delay_s, strict=True)},
        model.clock.at_edge,
    )
    return Identification(
        verdict=verdict,
        effects=effects,
        candidates=_candidates(choice, candidates, rules, settings, demoted),
        recalibration=recalibration,
        clock=clock,
        noise=NoiseReport(
            noise.total_sd_w / layout.mean_power_w,
            noise.fast_s,
            noise.slow_s,
            noise.offset_w,
            noise.gain,
            noise.motion_gain,
            choice.spread,
        ),
        unexplained=_unexplained(choice, structures),
        pairs=pairs(model, rules, candidates),
        remarks=_remarks(choice, given_runs),
        mean_power_w=layout.mean_power_w,
        residual_share={},
        settings=settings,
        library=tuple(candidates),
        choice=choice,
        covariance=model.gram.coefficients(model.chosen)[1] if model.chosen else None,
        shapes=shapes,
        demoted=demoted,
    )


def _structures(
    choice: Choice, candidates: Sequence[Candidate], rules: Rules, settings: Settings
) -> tuple[list[Structure], set[int]]:
    """What remains, and the columns whose effect it puts in doubt."""
    model, spread = choice.model, choice.spread
    doubtful: set[int] = set()
    found: list[Structure] = []
    for column in model.chosen:
        candidate = candidates[int(rules.effect[column])]
        wrong = wrong_form(model, column, candidate.covariate, spread, settings)
        if wrong is not None:
            found.append(wrong)
            doubtful.add(column)
    seen = {s.covariate for s in found}
    rest = [s for s in dependences(model, spread, settings, model.chosen) if s.covariate not in seen]
    line = periodic(model, model.innovations)
    restless = wander(model)
    loose = [s for s in (line, restless) if s is not None]
    if loose:
        rest += loose
        # the mean of a load that comes and goes looks like a load that is always there
        faint = FAINT_SHARE * (restless.size_share if restless is not None else 0.0)
        doubtful |= {
            k
            for k in model.chosen
            if candidates[int(rules.effect[k])].effect.partition(":")[0] in STEADY_LOADS
            or (choice.evidence[k].gain < FAINT_NATS and not between_runs(model, k))
            or abs(choice.evidence[k].share) < faint
        }
    for column in set(model.chosen) - doubtful:
        own = candidates[int(rules.effect[column])].covariate  # a curve over it is judged as the effect's form
        others = [s for s in found + rest if s not in loose and s.covariate != own]
        if any(not stands_without(model, column, s, spread) for s in others):
            doubtful.add(column)
    apart = _runs_apart(model)
    return found + rest + ([apart] if apart is not None else []), doubtful


def _runs_apart(model: Model) -> Structure | None:
    """Runs that differ in what the same motion costs, by several times what meters and drives usually do."""
    size = max(model.noise.gain, model.noise.motion_gain)
    if len(model.design.runs) < SEVERAL_RUNS or size < UNUSUAL_GAIN:
        return None
    at_least = "at least " if size > 0.99 * LARGEST_GAIN else ""
    words = (
        f"the runs differ by {at_least}{100 * size:.2g} % in what the same motion costs, several times what meters and "
        "drives usually do: something that changes from run to run is missing"
    )
    return Structure("run", 0.0, 0.0, size, words)


def _effects(
    choice: Choice,
    candidates: Sequence[Candidate],
    rules: Rules,
    settings: Settings,
    shapes: Mapping[str, Mapping[str, float]],
    doubtful: set[int],
) -> tuple[FoundEffect, ...]:
    model = choice.model
    on_ramps = _on_ramps(model)
    out: list[FoundEffect] = []
    for number in dict.fromkeys(int(rules.effect[k]) for k in model.chosen):
        own = [k for k in model.chosen if rules.effect[k] == number]
        if any(k in doubtful for k in own):
            continue
        candidate = candidates[number]
        estimates: list[Estimate] = []
        share_sd: list[float] = []
        for k in own:
            e = choice.evidence[k]
            column = model.design.layout.columns[k]
            unit = model.design.layout.mean_power_w / column.watts_per_unit
            form = abs(e.share) * _form_error(model, k, on_ramps[k], settings)
            share_sd.append(float(np.linalg.norm([e.share_sd, e.shape_sd, form])))
            sd = float(np.linalg.norm([e.share_sd, e.share * e.unit_shape_sd, form]))
            half = 1.96 * sd * unit
            level = candidate.levels[column.position] if candidate.levels else ""
            name = f"{candidate.coefficient}_{level}" if level else candidate.coefficient
            value = e.share * unit
            estimates.append(Estimate(name, value, value - half, value + half, sd * unit, candidate.unit))
        estimates += _shape_estimates(candidate, shapes.get(candidate.effect, {}))
        evidence = [choice.evidence[k] for k in own]
        share = sum(e.share for e in evidence)
        similar = rivals(model, number, rules, candidates, settings, choice.spread)
        out.append(
            FoundEffect(
                candidate.effect,
                tuple(estimates),
                float(share),
                float(np.linalg.norm(share_sd)),
                min(e.p_value for e in evidence),
                min((e.p_runs for e in evidence), default=float("nan")),
                max(e.gain for e in evidence),
                similar,
                _confidence(evidence),
            )
        )
    return tuple(sorted(out, key=lambda f: -f.gain_nats))


def _form_error(model: Model, column: int, on_ramps: float, settings: Settings) -> float:
    """Relative systematic standard error of a coefficient: form of the effect, blurred ramps, gain of the meter.

    The more of an effect hides in recalibration, the smaller the part its coefficient rests on, and the larger what
    an error of the form does to it.
    """
    q = model.gram.q
    whole = float(model.gram.per_run[:, 1 + q + column, 1 + q + column].sum())
    left = max(float(model.gram.full[1 + column, 1 + column]), 1e-12 * whole)
    hidden = settings.form_error * np.sqrt(whole / left) if left > 0 else 0.0
    gain = model.noise.gain / np.sqrt(len(model.design.runs))
    return float(np.linalg.norm([settings.systematic, hidden, RAMP_SYSTEMATIC * on_ramps, gain]))


def _on_ramps(model: Model) -> dict[int, float]:
    """How much more of each chosen column than of the base model's power lies beside ramps, from 0 to 1.

    Where the whole drive is one ramp, all columns are blurred alike and keep their relations.
    """
    edge = ramps(model)
    base = model.design.base**2
    usual = float(base[edge].sum() / max(float(base.sum()), 1e-300))
    out = {}
    for k in model.chosen:
        square = model.design.phi[k] ** 2
        part = float(square[edge].sum() / max(float(square.sum()), 1e-300))
        out[k] = max(0.0, part - usual) / max(1.0 - usual, 1e-9)
    return out


def _shape_estimates(candidate: Candidate, shape: Mapping[str, float]) -> list[Estimate]:
    out = []
    for name, value in shape.items():
        if name.endswith((".low", ".high", ".sd")):
            continue
        low, high = shape.get(f"{name}.low", value), shape.get(f"{name}.high", value)
        unit = "s" if name.startswith("tau") else ("degC" if name.lower().startswith("t0") else "1")
        out.append(Estimate(name, value, low, high, (high - low) / 3.92, unit))
    return out


def _confidence(evidence: Sequence[Evidence]) -> str:
    best = max(evidence, key=lambda e: e.gain)
    if np.isfinite(best.p_runs) and best.p_runs < 0.05:
        return "identified, repeated across runs"
    return "identified"


GATE_WORDS = {
    "likelihood": "the rise of the likelihood could be chance",
    "runs": "left-out runs are not predicted better",
    "robust": "not significant with errors that allow for correlated noise",
    "practical": "significant but negligible",
    "repeated in the runs": "seen as differences between runs that do not repeat well enough",
    "several runs": "rests on one run, which may differ from the others in something else",
    "changes": "what it depends on changes only once in these runs, and much else may have changed then",
    "plain error": "helps only with gains of single runs that make up for it",
    "beyond form": "corrects the form of a similar effect in the model, no more",
    "beyond recalibration": "within what recalibration of the base model allows",
}


def _candidates(
    choice: Choice, candidates: Sequence[Candidate], rules: Rules, settings: Settings, demoted: Sequence[str]
) -> tuple[CandidateReport, ...]:
    model = choice.model
    count = max(1, len({int(e) for e in rules.effect}))
    limits = smallest_detectable(model, rules, choice.spread, settings, count)
    plain = np.maximum(np.diag(model.gram.per_run.sum(axis=0))[1 + model.gram.q :], 1e-300)
    absorbed = 1.0 - np.clip(np.diag(model.gram.full)[1:] / plain, 0.0, 1.0)
    out = []
    for number, candidate in enumerate(candidates):
        own = [k for k in range(len(rules.effect)) if rules.effect[k] == number]
        if not own:
            reason = "never acts in these runs" if candidate.columns else "its columns are missing"
            out.append(CandidateReport(candidate.effect, False, reason, float("inf"), 1.0))
            continue
        inside = [k for k in own if k in model.chosen]
        best = min(own, key=lambda k: limits[k])
        accepted = bool(inside) and candidate.effect not in demoted
        if accepted:
            reason = f"explains {100 * sum(choice.evidence[k].share for k in inside):.2g} % of the energy"
        elif inside:
            reason = "helps, but its form is not right or a louder structure remains"
        else:
            tried = [choice.refused[k] for k in own if k in choice.refused]
            reason = _refusal(tried) if tried else "adds nothing beyond what is in the model"
        out.append(CandidateReport(candidate.effect, accepted, reason, float(limits[best]), float(absorbed[best])))
    return tuple(out)


def _refusal(tried: Sequence[Evidence]) -> str:
    best = max(tried, key=lambda e: e.gain)
    words = [GATE_WORDS[g] for g, passed in best.passed.items() if not passed]
    return f"{100 * best.share:.2g} % of the energy ± {100 * best.share_sd:.2g}: " + "; ".join(words)


def _unexplained(choice: Choice, structures: Sequence[Structure]) -> Unexplained:
    """Share of the squared error that the structures make, judged by their size against the residual."""
    model = choice.model
    left = model.design.residual
    if model.chosen:
        left = left - model.gram.coefficients(model.chosen)[0] @ model.design.phi[list(model.chosen)]
    variance = float(np.average(left**2, weights=model.design.duration_s))
    made = sum((s.size_share * model.design.layout.mean_power_w) ** 2 for s in structures)
    share = min(1.0, made / max(variance, 1e-300))
    depends = tuple(dict.fromkeys(s.covariate for s in structures))
    return Unexplained(float(share), depends, "; ".join(s.shape for s in structures), tuple(structures))


def _remarks(choice: Choice, given_runs: int) -> tuple[str, ...]:
    model = choice.model
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
    if model.clock.at_edge:
        out.append("the delay or lag of the power meter lies at the edge of what was searched; check the clocks")
    return tuple(out)
