"""Stepwise search: add the best effect, refit clock and noise, check the gates, swap, until nothing passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from missionsim.identify.data import Array, Candidate, Settings
from missionsim.identify.design import Layout, Source
from missionsim.identify.gates import (
    BESIDE,
    SEVERAL_RUNS,
    Evidence,
    differs_between,
    nats_needed,
    overdispersion,
    rests_on_one_run,
    tails,
    weigh,
)
from missionsim.identify.gram import make_gram
from missionsim.identify.model import Model, blunted, fit_model, log_likelihood
from missionsim.identify.search import Rules, best_set, single_gains
from missionsim.identify.shape import bend

TRIED = 2
PROMISING = 0.5
"""A candidate is fitted when its gain before the refit reaches this part of what is needed."""
USUAL_OFFSET = 0.006
USUAL_GAIN = 0.008
"""Differences between runs that a power meter and a drive usually show."""
REPEATED = 0.02
LEAST_RISE = -2.0
"""Of the log evidence, which already charges some 4 nats for one more coefficient."""
PLAIN_RISE = 1.02
"""An effect must not need opposite gains of the single runs to make up for it."""
ALIKE = 0.7
ALIKE_IN_KIND = 0.4
FORM_LOSS = 0.2
"""An effect like one in the model counts from this part of the other's gain on."""
FAINT = 0.015
CLEAR_NATS = 10.0
"""Beside a loud effect its misfit passes for others of up to this part of its gain, but not for clear ones."""
ONCE_NATS = 30.0
"""What changes a single time in one or two runs must be this clear: slow noise takes such steps too."""
CLOSE_NATS = 8.0
"""Options that lie no further behind the best are compared with common noise."""
STEEPER = 0.05
"""What the steeper of two curves may lack of the gain, because slow rows blunt it more (between the most, `BLUNTED`,
and nothing)."""
CLOSE = 0.6
"""The second best is fitted too when it reaches this part of the best."""


@dataclass
class Choice:
    """Result of the search: the model, what spoke for each column in it, and what was tried and refused."""

    model: Model
    empty: Model
    spread: float
    evidence: dict[int, Evidence]
    refused: dict[int, Evidence] = field(default_factory=dict)


def implied_shift(layout: Layout, candidates: Sequence[Candidate], model: Model, column: int, share: float) -> float:
    """Shift of the twin base parameter, in prior sd, that a coefficient amounts to; NaN for effects without a twin."""
    twin = candidates[layout.columns[column].candidate].prior
    if twin is None or twin not in layout.parameters:
        return float("nan")
    q = layout.parameters.index(twin)
    gradient, phi = model.design.gradient[q], model.design.phi[column]
    size = float(gradient @ gradient)
    if size <= 0:
        return float("nan")
    return float(share * (phi @ gradient) / size / layout.prior_sd[q])


def choose(source: Source, candidates: Sequence[Candidate], settings: Settings) -> Choice:
    """Search for the missing effects."""
    layout = source.layout
    rules = Rules.of(layout, candidates)
    effects = max(1, len({c.candidate for c in layout.columns}))
    empty = fit_model(source, ())
    spread = overdispersion(empty, settings)
    found = Choice(empty, empty, spread, {})
    while len(found.model.chosen) < settings.max_effects and layout.columns:
        step = _next_step(source, candidates, rules, settings, effects, found)
        if step is None:
            break
        new = set(step.model.chosen) - set(found.model.chosen)
        # what is left beside an effect is judged with that effect at its best: a reference temperature 5 K off leaves
        # a constant friction over
        found = bend(step, candidates, rules, settings, new)
        source = found.model.source
    return found


def _next_step(
    source: Source, candidates: Sequence[Candidate], rules: Rules, settings: Settings, effects: int, found: Choice
) -> Choice | None:
    model = found.model
    gains = single_gains(model.gram, rules, model.chosen)
    needed = nats_needed(float(np.max(tails(rules, settings, effects, bool(model.chosen)))))
    order = [int(k) for k in np.argsort(-gains) if np.isfinite(gains[k]) and gains[k] > PROMISING * needed]
    first_of: list[int] = []
    rest = model.gram.conditional(model.chosen)
    for k in order:
        if any(rules.effect[k] == rules.effect[o] for o in first_of):
            continue
        if abs(rest[0, 1 + k]) / rest[1 + k, 1 + k] < 0.6 * settings.min_share:
            found.refused.setdefault(k, _at_a_glance(model, k, float(gains[k]), found.spread))
            continue
        if first_of and gains[k] < CLOSE * gains[first_of[0]]:
            break
        first_of.append(k)
    trials: list[tuple[int, ...]] = [(*model.chosen, k) for k in first_of[:TRIED]]
    hidden = _hidden_in_runs(model, rules, needed, settings)
    if hidden is not None and hidden not in first_of[:TRIED]:
        trials.append((*model.chosen, hidden))
    if not trials:
        return None
    if model.chosen:
        swapped, _ = best_set(model.gram, rules, len(model.chosen) + 1, trials[0])
        if set(swapped) not in [set(t) for t in trials]:
            trials.append(swapped)
    refused = dict(found.refused)
    before = log_likelihood(model)
    options: list[tuple[float, Choice]] = []
    for trial in trials:
        fitted = fit_model(source, trial, model, thorough=False)
        spread = overdispersion(fitted, settings)
        weighed = {
            c: _with_twin_limit(weigh(fitted, c, rules, settings, spread, effects), fitted, candidates, settings)
            for c in trial
        }
        if hidden is not None and trial[-1] == hidden and hidden not in first_of:
            weighed[hidden].passed["repeated in the runs"] = weighed[hidden].p_runs < REPEATED
        rise = log_likelihood(fitted) - before
        more = fitted.gram.gain(trial) - fitted.gram.gain(model.chosen)
        for c in set(trial) - set(model.chosen):
            # noise refitted on both sides: an effect must not live on a noise model of its own
            weighed[c].passed["likelihood"] &= rise > LEAST_RISE
            if model.chosen:
                # shifts of the base have their own limit, of four prior sd
                part = 1.0 if candidates[int(rules.effect[c])].prior else BESIDE
                limit = spread * nats_needed(part * float(tails(rules, settings, effects, True)[c]))
                weighed[c].passed["likelihood"] &= min(more, weighed[c].gain) > limit
            weighed[c].passed["plain error"] = plain_error(fitted) < PLAIN_RISE * plain_error(model)
            if len(fitted.design.runs) > 1 and constant_in_runs(fitted, c, candidates):
                weighed[c].passed["several runs"] = not rests_on_one_run(fitted, c, spread)
            if len(fitted.design.runs) < SEVERAL_RUNS:
                weighed[c].passed["changes"] = weighed[c].gain > ONCE_NATS or changes(fitted, c, candidates) > 1
            weighed[c].passed["beyond form"] = _beyond_form(fitted, c, weighed[c].gain, found, candidates)
        if all(e.accepted for e in weighed.values()):
            options.append((rise, Choice(fitted, found.empty, spread, weighed, refused)))
        else:
            new = [c for c in trial if c not in model.chosen]
            refused.update({c: weighed[c] for c in new if not weighed[c].accepted})
    found.refused.update(refused)
    if not options:
        return None
    best = _best(options, found.model.chosen, candidates, rules)
    best.refused.update(refused)
    return best


def _shapes(choice: Choice, rules: Rules) -> float:
    """Nats that a set owes to the grids its columns were picked from: each grid is one effect, not several."""
    grids = [np.sum(rules.effect == rules.effect[k]) for k in choice.model.chosen if not rules.joint[k]]
    return float(np.sum(np.log(grids)))


def _best(
    options: Sequence[tuple[float, Choice]], before: Sequence[int], candidates: Sequence[Candidate], rules: Rules
) -> Choice:
    """The option with the highest likelihood; those that come close are compared with the noise of each in turn.

    Noise that is fitted separately differs by a few nats by chance, more than v2 and v3 often differ.
    """
    top = max(rise for rise, _ in options)
    close = [choice for rise, choice in options if rise > top - CLOSE_NATS]
    best = close[0]
    for other in close[1:]:
        lead = 2.0 * (_shapes(best, rules) - _shapes(other, rules))
        lead += sum(m.gram.gain(other.model.chosen) - m.gram.gain(best.model.chosen) for m in (best.model, other.model))
        sets = [set(c.model.chosen) for c in (other, best)]
        new = [sets[0] - sets[1], sets[1] - sets[0]]
        if len(new[0]) == len(new[1]) == 1:
            a, b = (next(iter(n)) for n in new)
            if _about(best.model, a, candidates) == _about(best.model, b, candidates):
                size = sum(m.gram.gain(best.model.chosen) - m.gram.gain(before) for m in (best.model, other.model))
                lead += STEEPER * size * (int(blunted(best.model, a, b)) - int(blunted(best.model, b, a)))
        if lead > 0:
            best = other
    return best


def _about(model: Model, column: int, candidates: Sequence[Candidate]) -> str:
    """Name of the covariate that a column's effect depends on."""
    return candidates[model.design.layout.columns[column].candidate].covariate


def _covariate(model: Model, column: int, candidates: Sequence[Candidate]) -> list[Array]:
    """Values of that covariate in each run that has it."""
    name = _about(model, column, candidates)
    return [np.asarray(run.covariates[name]) for run in model.source.runs if name in run.covariates]


def constant_in_runs(model: Model, column: int, candidates: Sequence[Candidate]) -> bool:
    """Whether what an effect depends on hardly changes within the runs, so that each run is a single observation."""
    values = _covariate(model, column, candidates)
    return bool(values) and differs_between(values)


def changes(model: Model, column: int, candidates: Sequence[Candidate]) -> int:
    """How often the covariate of a column changes within the runs; one change comes with all else that changes then."""
    values = _covariate(model, column, candidates)
    if not values:
        return 2
    return sum(int(np.count_nonzero(np.diff(v[np.isfinite(v)]))) for v in values)


def _beyond_form(fitted: Model, column: int, gain: float, found: Choice, candidates: Sequence[Candidate]) -> bool:
    """Whether a column is more than a correction to the form of an effect in the model.

    No form is exact: v2 with a little v3 explains any friction curve better than either alone, and only one is there.
    """
    loudest = max((found.evidence[k].gain for k in found.model.chosen), default=0.0)
    if gain < min(FAINT * loudest, CLEAR_NATS):
        return False
    for other in set(found.model.chosen) & set(fitted.chosen):
        r = fitted.gram.correlation(column, other, fitted.chosen)
        same = _about(fitted, column, candidates) == _about(fitted, other, candidates)
        alike = ALIKE_IN_KIND if same else ALIKE
        if abs(r) > alike and gain < FORM_LOSS * found.evidence[other].gain:
            return False
    return True


def _hidden_in_runs(model: Model, rules: Rules, needed: float, settings: Settings) -> int | None:
    """Candidate that differences between runs may have swallowed: it stands out once these are as small as usual."""
    noise, mean = model.noise, model.design.layout.mean_power_w
    usual = replace(
        noise,
        offset_w=min(noise.offset_w, USUAL_OFFSET * mean),
        gain=min(noise.gain, USUAL_GAIN),
        motion_gain=min(noise.motion_gain, USUAL_GAIN),
    )
    same = (usual.offset_w, usual.gain, usual.motion_gain) == (noise.offset_w, noise.gain, noise.motion_gain)
    if same or len(model.design.runs) < 4:
        return None
    gram = make_gram(model.design, usual)
    gains = single_gains(gram, rules, model.chosen)
    top = int(np.argmax(gains))
    rest = gram.conditional(model.chosen)
    share = abs(rest[0, 1 + top]) / max(rest[1 + top, 1 + top], 1e-300)
    return top if gains[top] > needed and share > settings.min_share else None


def plain_error(model: Model) -> float:
    """Mean square error of what the model predicts without meter offsets and gains of single runs [W2]."""
    design = model.design
    shifts, _ = model.gram.shifts(model.chosen)
    left = design.residual - shifts @ design.gradient
    if model.chosen:
        left = left - model.gram.coefficients(model.chosen)[0] @ design.phi[list(model.chosen)]
    return float(np.average(left**2, weights=design.duration_s))


def _at_a_glance(model: Model, column: int, gain: float, spread: float) -> Evidence:
    """Evidence of a candidate too small to matter, without a refit."""
    from scipy.stats import chi2

    rest = model.gram.conditional(model.chosen)
    share = float(rest[0, 1 + column] / rest[1 + column, 1 + column])
    sd = float(np.sqrt(spread / rest[1 + column, 1 + column]))
    p_value = float(chi2.sf(2 * gain / spread, 1))
    nan = float("nan")
    return Evidence(column, gain, spread, share, sd, p_value, nan, nan, 0, 0, {"practical": False})


def _with_twin_limit(e: Evidence, model: Model, candidates: Sequence[Candidate], settings: Settings) -> Evidence:
    """Small shifts of a base parameter are recalibration, not an effect."""
    shift = implied_shift(model.design.layout, candidates, model, e.column, e.share)
    if np.isfinite(shift):
        e.passed["beyond recalibration"] = abs(shift) > settings.recalibration_limit
    return e


def forced(source: Source, candidates: Sequence[Candidate], effects: Sequence[str], settings: Settings) -> Choice:
    """Fit given effects without a search: the best column of each grid, all levels of a label that act.

    Raises
    ------
    ValueError
        If an effect is unknown or has no column that acts in these runs.
    """
    layout = source.layout
    rules = Rules.of(layout, candidates)
    count = max(1, len({c.candidate for c in layout.columns}))
    empty = fit_model(source, ())
    model = empty
    for name in effects:
        own = [k for k, c in enumerate(layout.columns) if candidates[c.candidate].effect == name]
        if not own:
            raise ValueError(f"effect {name} has no column that acts in these runs")
        if rules.joint[own[0]]:
            gains = single_gains(model.gram, rules, model.chosen)
            new = [k for k in own if np.isfinite(gains[k]) and gains[k] > 0.5] or [own[int(np.argmax(gains[own]))]]
        else:
            new = [own[int(np.argmax(_unsigned_gains(model, own)))]]
        model = fit_model(source, (*model.chosen, *new), model, thorough=False)
    spread = overdispersion(model, settings)
    return Choice(model, empty, spread, {c: weigh(model, c, rules, settings, spread, count) for c in model.chosen})


def _unsigned_gains(model: Model, columns: Sequence[int]) -> list[float]:
    rest = model.gram.conditional(model.chosen)
    return [float(0.5 * rest[0, 1 + k] ** 2 / max(rest[1 + k, 1 + k], 1e-300)) for k in columns]
