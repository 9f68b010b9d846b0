"""What explains in the place of effects: one number (a factor, a level, a base parameter, its drift), or runs apart."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.design import Design, Source
from missionsim.identify.evidence import AT_REST_TOO, REST_S, cause_is_constant, seconds_at_rest
from missionsim.identify.findings import Structure
from missionsim.identify.gram import Gram, project, random_effects
from missionsim.identify.model import Model, log_likelihood
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.settings import FEWEST_FOLDS, LARGEST_GAIN, ODDS_NATS, SEVERAL_RUNS, UNUSUAL_GAIN, USUAL_GAIN
from missionsim.numerals import watts
from missionsim.physics import Array
from missionsim.runs.covariates import MOTION, may_be_cause


def may_differ(source: Source) -> bool:
    """Whether a factor between meter and model can be told at all.

    Not where the energies agree without any fit: a factor that shows only beside effects or a recalibration is the
    work of these. Nor where base parameters have no prior, as those fitted to these very logs: they follow the meter.
    """
    priors = source.layout.prior_sd[: len(source.layout.parameters)]
    return not np.any(priors >= const.LEAST_FREE_SD) and abs(plain_ratio(source) - 1.0) > const.AT_LEVEL


def plain_ratio(source: Source) -> float:
    """Measured energy over that of the file's model as it stands, all runs together."""
    measured = modelled = 0.0
    for run in source.runs:
        seen = np.isfinite(run.measured_w)
        measured += float(run.dt_s[seen] @ run.measured_w[seen])
        modelled += float(run.dt_s[seen] @ run.base_w[seen])
    return measured / modelled if modelled > 0.0 else np.inf


def common_factor(model: Model) -> tuple[float, float]:
    """The factor on the whole model that fits best, and the part of the effects' gain that it alone makes.

    Both are judged with the noise of the model that has the effects, base parameters and differences between runs
    integrated out, so that a factor within the priors counts for nothing.
    """
    design = model.design
    left, base = np.hstack(project(design, model.noise, np.vstack([design.residual, design.base]), ()))
    # a base that recalibration wholly takes up shows no factor
    size = float(base @ base)
    if not model.chosen or size <= 0.0:
        return 1.0, 0.0
    product = float(left @ base)
    gain = model.gram.gain(model.chosen)
    return 1.0 + product / size, 0.5 * product**2 / size / gain if gain > 0.0 else 0.0


def instead_of_effects(model: Model) -> float | None:
    """The factor that explains as much as the effects in the model; None where none does.

    Friction, a standing load and what components draw, each with its own size, imitate a meter that reads 1.5 times too
    much. A factor says the same with one number.
    """
    if not model.chosen or not may_differ(model.source):
        return None
    factor, part = common_factor(model)
    none = abs(factor - 1.0) < const.LEVEL_SHARE or part < const.AS_MUCH
    return None if none or not _at_rest_too(model, factor) else factor


def _at_rest_too(model: Model, factor: float) -> bool:
    """Whether the meter reads so many times what the file gives where the robot stands as well; yes where nothing tells
    when it does. Of the file as it is: a base fitted anew would spread over rest what motion lacks."""
    rest_s = seconds_at_rest(model)
    drawn_ws, shown_ws = float(model.design.base @ rest_s), float(model.design.y @ rest_s)
    return rest_s.sum() < REST_S or drawn_ws <= 0.0 or (shown_ws / drawn_ws - 1.0) / (factor - 1.0) > AT_REST_TOO


def parameters_instead(model: Model, doubtful: Collection[str] = ()) -> dict[str, Structure]:
    """Effects in the model in whose place one base parameter, left free, explains as much; each with what is said.

    Only parameters that no effect is the twin of: a twin is named, or among the rivals. How far off it is is told only
    where no effect beside it is `doubtful`, or told here itself: what these take would be its own without them.
    """
    gram, layout, constraints = model.gram, model.design.layout, model.constraints
    settings, twins = constraints.settings, set()
    for k in range(len(layout.columns)):
        name = constraints.of_column(k).prior
        if name in layout.parameters:  # what two parameters imitate together is the twin of neither
            a, b = model.design.phi[k], model.design.gradient[layout.parameters.index(name)]
            if abs(float(a @ b)) > const.SAME_COLUMN * float(np.linalg.norm(a) * np.linalg.norm(b)):
                twins.add(name)
    freed: dict[int, Gram] = {}
    for i in (i for i, name in enumerate(layout.parameters) if name not in twins):
        freedom = gram.prior_precision.copy()
        freedom[i] = const.LEAST_FREE_SD**-2.0
        freed[i] = Gram(gram.per_run, freedom)
    found: dict[str, tuple[str, float, list[str]]] = {}
    for number in constraints.numbers(model.chosen):
        if constraints.candidates[number].prior is not None:
            continue
        own, rest = constraints.split(model.chosen, number)
        gain = gram.gain(model.chosen) - gram.gain(rest) - float(constraints.grid_nats[own[0]])
        needed = gain - max(const.ODDS_NATS, settings.noisy_rival_loss * gain)
        left = float(gram.conditional(rest)[0, 0])
        for i, free in freed.items() if needed > 0.0 else ():
            rise = 0.5 * (left - float(free.conditional(rest)[0, 0]))
            shift = float(free.joint(rest, len(layout.parameters))[0][i])
            if rise > needed and abs(shift) > settings.recalibration_limit * layout.prior_sd[i]:
                beside = [constraints.of_column(k).effect for k in rest]
                found[constraints.candidates[number].effect] = layout.parameters[i], shift, beside
                break
    told: dict[str, Structure] = {}
    for effect, (name, shift, beside) in found.items():
        size, off = f"{100 * abs(shift):.0f} % ", f"too {'small' if shift > 0.0 else 'large'}"
        why = "fitted without the sd that binds it in the recalibration"
        if unsure := dict.fromkeys(other for other in beside if other in found or other in doubtful):
            size, why = "", f"by how much hangs on {' and '.join(unsure)}, in doubt as well"
        words = (
            f"either {effect}, or {name} of the robot file is {size}{off} ({why}): these data cannot tell; calibrate "
            "the file first"
        )
        own = [constraints.of_column(k).effect == effect for k in model.chosen]
        told[effect] = Structure("", 0.0, 0.0, abs(float(gram.shares(model.chosen)[own].sum())), words)
    return told


def drifts_instead(model: Model) -> dict[str, Structure]:
    """Effects whose cause is constant in runs and that a steady drift may stand behind; each with what is said."""
    constraints = model.constraints
    told: dict[str, Structure] = {}
    for number in constraints.numbers(model.chosen):
        own, rest = constraints.split(model.chosen, number)
        candidate = constraints.candidates[number]
        if candidate.prior is not None or not cause_is_constant(model, own[0]):
            continue
        if drifts_as_well(model.design, own, rest):
            words = (
                f"either {candidate.effect}, or a steady drift from run to run in their order, as over a long day: "
                "these data cannot tell; drive in another order"
            )
            share = model.gram.shares(model.chosen)[[k in own for k in model.chosen]].sum()
            told[candidate.effect] = Structure("", 0.0, 0.0, abs(float(share)), words, effects=(candidate.effect,))
    return told


def drifts_as_well(design: Design, own: Sequence[int], rest: Sequence[int]) -> bool:
    """Whether a steady drift over the runs, in their order, of a load or of one parameter of the base predicts left-out
    runs as well as some columns, beside others.

    Loads that grow with every trip, or the trips of a day that gets warmer, are in the order of the runs. Where their
    times do not tell it, it is that of names that begin alike: others are sorted by a floor or a load in the name.
    """
    # two or three runs that begin alike say nothing: a difference between two of them is no drift
    begin = [re.split(r"\d", name, maxsplit=1)[0] for name in design.names]
    alike = [np.flatnonzero([other == own for other in begin]) for own in begin]
    by_time = np.argsort(begins_s := np.array(design.begins_s))
    ends_s = begins_s + [design.time_s[rows][-1] for rows in design.runs]
    if np.all(begins_s[by_time[1:]] >= ends_s[by_time[:-1]]):  # one robot drives one run at a time
        alike = [by_time] * len(begin)
    if max(map(len, alike)) <= const.SEVERAL_RUNS:
        return False
    place = [2.0 * runs.tolist().index(j) - len(runs) + 1.0 for j, runs in enumerate(alike)]
    order = (np.array(place) / max(1.0, *place))[design.run_index()]
    drifts = order * np.vstack([np.ones_like(order), design.gradient[: len(design.layout.parameters)]])
    squares = LeastSquares.of(replace(design, phi=np.vstack([design.phi, drifts])))
    with_it, without = squares.leave_out([*rest, *own]), squares.leave_out(rest)
    for i in range(len(design.phi), len(design.phi) + len(drifts)):
        other = squares.leave_out([*rest, i])
        # most of what they explain is the drift's as well, and is not theirs beside it (Davidson and MacKinnon 1981)
        least = const.RIVAL_PART * (without.total - with_it.total)
        kept = other.total - squares.leave_out([*rest, *own, i]).total
        if other.within(with_it, const.UNCLEAR) and without.total - other.total > least > kept:
            return True
    return False


def level_difference(model: Model) -> Structure | None:
    """That model and meter differ by much in all runs, and whether at rest too; None where they do not.

    An unknown offset and gain of the meter in each run are part of the noise model. They are for per cents: wrong
    units, another robot's file or a large constant load must not hide in them.
    """
    if not may_differ(model.source):
        return None
    design = model.design
    # the most probable coefficients, not those that give the measured energy: these would hide the level
    count = len(design.layout.parameters)
    value, _ = model.gram.joint(model.chosen, count)
    error = value @ np.vstack([design.gradient[:count], design.phi[list(model.chosen)]]) - design.residual
    seconds = design.duration_s
    errors = np.array([float(error[r] @ seconds[r]) / float(design.y[r] @ seconds[r]) for r in design.runs])
    if not (np.all(errors > const.LEVEL_SHARE) or np.all(errors < -const.LEVEL_SHARE)):
        return None
    factor = 1.0 / (1.0 + float(np.median(errors)))
    words = f"the meter reads {factor:.3g} times what the model gives in every run"
    if _at_rest_too(model, factor):
        words += ", whatever the robot does: check the units of the log and the robot file, or look for a load that is "
        words += "always on"
    else:
        words += ", but not at rest: check the columns of motion (a slope sensor that is not level) and what drives"
    return Structure("", 0.0, 0.0, float(np.mean(np.abs(errors))), words)


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
