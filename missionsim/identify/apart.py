"""Runs that differ in what they draw, by more than meters and drives usually do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from missionsim.identify.evidence import AT_REST_TOO, REST_S, cause_is_constant, seconds_at_rest
from missionsim.identify.findings import Structure
from missionsim.identify.gram import random_effects
from missionsim.identify.model import Model, log_likelihood
from missionsim.identify.settings import FEWEST_FOLDS, LARGEST_GAIN, ODDS_NATS, SEVERAL_RUNS, UNUSUAL_GAIN, USUAL_GAIN
from missionsim.numerals import watts
from missionsim.physics import Array
from missionsim.runs.covariates import MOTION, may_be_cause

ALONG, ALONG_LEVEL = 0.9, 0.01
"""Correlation over the runs from which on what they differ by goes with a column, and the most that chance may have."""
STAYS, BY_CHANCE = 0.1, 0.1
"""Spread within runs, of that between them, below which a column differs between runs alone; chance that as good an
order of one of these columns may have (assumed)."""
_ANY_DRIVE = MOTION | {"moving_time_s", "time_s"}
"""What any drive has more or less of."""


def runs_apart(model: Model) -> tuple[Structure | None, str]:
    """Runs that differ in what the same motion costs, by several times what meters and drives usually do; or, in words,
    that the meters of the runs differ.

    By the spread of the runs' gains, not by their size: gains that all runs share are the base model's, however the
    fit divided them. Where the likelihood says that the motion alone does not explain it, what is drawn at rest differs
    in the same ratio: so does a meter.
    """
    noise, design, constraints = model.noise, model.design, model.constraints
    mean_w, gain = abs(design.layout.mean_power_w), max(noise.gain, noise.motion_gain)
    if len(design.runs) < SEVERAL_RUNS or max(gain, noise.offset_w / mean_w) < UNUSUAL_GAIN:
        return None, ""
    drawn = random_effects(design, noise, model.chosen)[:, :3] / [mean_w, 1.0, 1.0]
    offset, size = float(np.std(drawn[:, 0], ddof=1)), float(np.max(np.std(drawn[:, 1:], axis=0, ddof=1)))
    if max(offset, size) < UNUSUAL_GAIN:
        return None, ""
    by = ("at least " if gain > 0.99 * LARGEST_GAIN else "") + f"{100 * size:.2g} %"
    if offset > size:
        drawn, size, costs = drawn[:, :1], offset, "it costs"
        words = f"the runs differ by {watts(offset * mean_w, 2)} ({100 * offset:.2g} % of the power)"
    else:
        drawn, costs = drawn[:, 1:], "the same motion costs"
        of_motion = replace(
            noise, gain=min(noise.gain, USUAL_GAIN), motion_gain=float(np.hypot(noise.gain, noise.motion_gain))
        )
        more = log_likelihood(model) - log_likelihood(replace(model, noise=of_motion)) > ODDS_NATS
        rest = _at_rest(model, drawn.sum(axis=1)) if more else 0.0
        if more and (rest is None or rest > AT_REST_TOO):
            too, also = ", at rest too", ""
            if rest is None:
                too, causes = "", " or ".join(_constant_causes(model))
                also = f", or it may be {causes}: a minute at rest in each run would tell" if causes else ""
            return None, (
                f"the runs differ by {by} in all that they draw{too}: meters that differ, or were set "
                f"differently, do that; check them before two runs are held against each other{also}"
            )
        words = f"the runs differ by {by} in what the same motion costs"
    most, least = (design.names[int(f(drawn.sum(axis=1)))] for f in (np.argmax, np.argmin))
    words += (
        ", several times what meters and drives usually do: something that changes from run to run is missing; "
        f"{costs} most in {most} and least in {least}"
    )
    chance = 0.0
    if along := _goes_with(model, drawn.sum(axis=1)):
        words += f"; from run to run it goes with {' and '.join(along)}"
    else:
        along, chance = _in_order(model, drawn.sum(axis=1))
    if along and chance:
        words += f"; it may be {' or '.join(along)}, in whose order these {len(drawn)} runs cost, of the columns that "
        words += f"differ between them alone (by chance so in {100 * chance:.1g} % of cases)"
    if any(_once_each(model, number) for number in range(len(constraints.candidates))):
        words += "; each floor was driven in one run alone, so that it may be the floor: drive two of them once more"
    constant = _constant_causes(model)
    if constant:
        words += (
            f"; it may be {' or '.join(constant)}, whose cause is constant in runs, of which these are too few to tell"
        )
    return Structure("run", 0.0, 0.0, size, words, effects=tuple(constant), columns=tuple(along)), ""


def _once_each(model: Model, number: int) -> bool:
    """Whether each column of an effect acts in one run alone, and in each run one of them."""
    own = np.flatnonzero(model.constraints.effect == number)
    acts = np.array([np.any(model.design.phi[own][:, rows], axis=1) for rows in model.design.runs])
    return bool(len(own) and np.all(acts.sum(axis=0) == 1) and np.all(acts.sum(axis=1) == 1))


def _constant_causes(model: Model) -> list[str]:
    """Effects not in the model whose cause is constant in runs, where these are too few to tell one of them."""
    found, constraints = list[str](), model.constraints
    for number, candidate in enumerate(constraints.candidates):
        own = np.flatnonzero(constraints.effect == number).tolist()
        few = len(model.design.runs) <= max(FEWEST_FOLDS, SEVERAL_RUNS * len(candidate.levels))  # more would tell
        if own and few and not {*own} & {*model.chosen} and cause_is_constant(model, own[0]):
            found += [] if _once_each(model, number) else [candidate.effect]
    return found


def _goes_with(model: Model, drawn: Array) -> list[str]:
    """Columns whose mean of each run goes with what the runs differ by, shape (runs,), the likest first; chance is
    charged for all."""
    from scipy.special import stdtr

    runs, count, found = model.source.runs, len(drawn), dict[str, float]()
    names = [n for n in model.source.covariates if may_be_cause(n) and n not in _ANY_DRIVE]
    for name in names:
        means = np.array([float(np.nanmean(run.covariates[name])) for run in runs])
        if np.ptp(means):
            r = abs(float(np.corrcoef(means, drawn)[0, 1]))
            t = r * np.sqrt((count - 2) / max(1.0 - r**2, 1e-12))
            if 2.0 * float(stdtr(count - 2, -t)) < ALONG_LEVEL / len(names) and r > ALONG:
                found[name] = r
    return sorted(found, key=lambda name: -found[name])


def _in_order(model: Model, drawn: Array) -> tuple[list[str], float]:
    """Columns that differ between runs alone and in whose order, or the reverse, all runs cost; and the chance that one
    of the columns that differ so would be. None where chance does it too often: three runs are always in some order."""
    runs, count, found = model.source.runs, 0, list[str]()
    for name in (n for n in model.source.covariates if may_be_cause(n) and n not in _ANY_DRIVE):
        values = [np.asarray(run.covariates[name], dtype=float) for run in runs]
        means = np.array([float(np.nanmean(one)) for one in values])
        if len({*means}) == len(runs) and max(float(np.nanstd(one)) for one in values) < STAYS * np.std(means):
            count += 1
            ranked = np.diff(means[np.argsort(drawn)])
            found += [name] if np.all(ranked > 0.0) or np.all(ranked < 0.0) else []
    chance = 2.0 * count / math.factorial(len(runs))
    return (found, chance) if chance < BY_CHANCE else ([], 0.0)


def _at_rest(model: Model, drawn: Array) -> float | None:
    """Part of the gain of each run, shape (runs,), with which its power at rest goes; None where few runs rest."""
    design, rest_s = model.design, seconds_at_rest(model)
    gains, ratios = [], []
    for rows, gain in zip(design.runs, drawn, strict=True):
        seconds = rest_s[rows]
        expected = float(seconds @ design.base[rows])
        if seconds.sum() >= REST_S and expected > 0.0:
            gains.append(float(gain))
            ratios.append(float(seconds @ design.y[rows]) / expected)
    if len(gains) < SEVERAL_RUNS or not np.ptp(gains):
        return None
    return float(np.polyfit(gains, ratios, 1)[0])
