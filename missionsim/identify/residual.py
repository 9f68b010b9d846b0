"""Structure of the residual: dependence on a covariate, wrong form of an effect, periodic load, low-frequency noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.evidence import block_numbers, chance_of
from missionsim.identify.findings import Structure
from missionsim.identify.gram import innovations, project
from missionsim.identify.model import Model
from missionsim.identify.noise import mean_variance
from missionsim.identify.proposed import plain, unit_of
from missionsim.numerals import rounded, watts
from missionsim.physics import Array, Bools
from missionsim.runs.covariates import known

SPEED = "speed_m_s"


def ramps(model: Model) -> Bools:
    """Rows beside a change of the base model, shape (n,)."""
    design = model.design
    change = np.zeros(len(design.y))
    for part in design.stretches:
        base = design.base[part]
        step = np.abs(np.diff(base, prepend=base[0], append=base[-1]))
        change[part] = np.maximum(step[1:], step[:-1])
        for later in range(1, min(const.RAMP_TAIL_ROWS, len(base) - 1) + 1):
            change[part][later:] = np.maximum(change[part][later:], step[: -later - 1])
    return np.asarray(change > const.RAMP * design.layout.mean_power_w)


def steady(model: Model) -> Model:
    """The same model for tests of form: rows beside a ramp of the base model hardly count, because averaging over a
    ramp bends every curve, and the base parameters are freer than their priors."""
    design = model.design
    ramp = ramps(model)
    weight = np.where(ramp, const.RAMP_WEIGHT, 1.0) * model.noise.weight
    free = design.layout.prior_sd.copy()
    free[: len(design.layout.parameters)] *= const.FREER
    layout = replace(design.layout, prior_sd=free)
    return replace(model, design=replace(design, layout=layout), noise=replace(model.noise, weight=weight))


def knots_of(values: Array) -> Array:
    """Knots of a piecewise linear curve: between the 2 % and 98 % quantile, ends included; fewer for few values."""
    distinct = np.unique(np.round(values, 9))
    if len(distinct) <= const.KNOTS:
        return np.asarray(distinct)
    low, high = np.quantile(values, [0.01, 0.99])
    # much standing would take the lower knots, where nothing happens
    if np.mean(values == 0) > 0.3:
        moving = values[np.abs(values) > 0.02 * max(abs(low), abs(high))]
        if len(moving) > 20:
            low, high = min(0.0, float(np.quantile(moving, 0.02))), float(np.quantile(moving, 0.98))
    if high <= low:
        return np.asarray(np.unique([distinct[0], distinct[-1]]))
    return np.linspace(low, high, const.KNOTS)


def hats(values: Array, knots: Array) -> Array:
    """Hat functions of a piecewise linear curve, shape (knots - 1, n): the first knot is the reference."""
    inside = np.clip(values, knots[0], knots[-1])
    return np.array([np.interp(inside, knots, unit) for unit in np.eye(len(knots))[1:]]).reshape(-1, len(values))


def curve_rows(model: Model, covariate: str, times: str = "") -> tuple[Array, Array]:
    """Basis of a free curve over a covariate at the analysis rate (k, n), and its knots."""
    runs = model.source.runs
    raw = [np.nan_to_num(np.asarray(run.covariates[covariate], dtype=float)) for run in runs]
    if known(covariate).magnitude or covariate == SPEED:
        raw = [np.abs(r) for r in raw]
    knots = knots_of(np.concatenate(raw))
    if len(knots) < 2:
        return np.zeros((0, len(model.design.y))), knots
    rows = [hats(r, knots) for r in raw]
    if times:
        rows = [h * np.abs(np.nan_to_num(run.covariates[times])) for h, run in zip(rows, runs, strict=True)]
    averaged = model.source.averaged(rows, model.clock)
    # a stretch of the curve that only rows beside ramps support says nothing about its shape
    seconds = np.abs(averaged) @ (model.design.duration_s * ~ramps(model))
    limit = const.SUPPORT_S * (1.0 if not times else float(np.mean(np.abs(averaged))))
    if known(covariate).ramps:
        return averaged, knots
    return averaged[seconds > limit], knots


def test_curve(model: Model, rows: Array, chosen: Sequence[int]) -> tuple[float, float, Array]:
    """Gain of a group of columns [nats], p-value (the more careful of likelihood and sandwich), coefficients."""
    from scipy.special import fdtrc

    k = rows.shape[0]
    if not k:
        return 0.0, 1.0, np.zeros(0)
    whole, pseudo = project(model.design, model.noise, np.vstack([model.design.residual, rows]), chosen)
    x, y = whole[1:], whole[0]
    info = x @ x.T + pseudo[1:] @ pseudo[1:].T
    b = x @ y + pseudo[1:] @ pseudo[0]
    # knots that the base imitates carry rounding only
    keep = np.diag(info) > 1e-6 * np.sum((rows / model.noise.scale) ** 2, axis=1) / model.noise.sigma_w**2
    values = np.zeros(k)
    if not np.any(keep):
        return 0.0, 1.0, values
    inner = info[np.ix_(keep, keep)]
    inner[np.diag_indices_from(inner)] *= 1 + 1e-6
    values[keep] = np.linalg.solve(inner, b[keep])
    gain = 0.5 * float(b[keep] @ values[keep])
    freedom = int(keep.sum())
    p_like = chance_of(gain, freedom)
    residual = y - values @ x
    blocks = block_numbers(model, max(const.LONG_BLOCK_S, 15 * model.design.layout.step_s))
    count = int(blocks.max()) + 1
    # too few blocks for a sandwich; the likelihood decides alone
    if count <= freedom + 3:
        return gain, p_like, values
    scores = np.stack([np.bincount(blocks, weights=row * residual, minlength=count) for row in x[keep]])
    meat = scores @ scores.T * count / (count - freedom) + pseudo[1:][keep] @ pseudo[1:][keep].T
    meat[np.diag_indices_from(meat)] *= 1 + 1e-6
    statistic = float(b[keep] @ np.linalg.solve(meat, b[keep]))
    wald = statistic * (count - freedom) / (freedom * max(count - 1, 1))
    p_robust = float(fdtrc(freedom, count - freedom, wald))
    return gain, max(p_like, p_robust), values


def dependences(model: Model) -> list[Structure]:
    """Covariates on which the residual still depends, loudest first."""
    flat = steady(model)
    names = [n for n in model.source.covariates if not known(n).ramps]
    tests = [(n, "") for n in names]
    if SPEED in names:
        tests += [(n, SPEED) for n in names if known(n).multiplies_speed]
    out: dict[str, Structure] = {}
    for name, times in tests:
        rows, knots = curve_rows(model, name, times)
        if len(knots) > 3 and rows.shape[0] < const.FEWEST_HATS:
            continue
        for judge, least, level in (
            (flat, const.CURVE_NATS, const.CURVE_LEVEL),
            (model, const.CURVE_NATS_ON_RAMPS, 0.1 * const.CURVE_LEVEL),
        ):
            gain, p_value, values = test_curve(judge, rows, model.chosen)
            fitted = values @ rows
            size = _size(model, fitted)
            if not (p_value * len(tests) < level and gain > least and size > 2 * model.constraints.settings.min_share):
                continue
            left_w = _beside(model, fitted)
            if _size(model, left_w) > const.LEAST_LEFT and (name not in out or out[name].gain_nats < gain):
                shape = _words(model, name, times, knots, values, left_w)
                out[name] = Structure(name, p_value * len(tests), gain, _size(model, left_w), shape, times)
            break
    return sorted(out.values(), key=lambda s: -s.gain_nats)


def _size(model: Model, power_w: Array) -> float:
    """How much a curve over the rows [W] varies, in parts of the mean power."""
    return float(np.mean(np.abs(power_w - np.average(power_w)))) / model.design.layout.mean_power_w


def _words(model: Model, name: str, times: str, knots: Array, values: Array, left_w: Array) -> str:
    """What is said of a curve with values at the knots beyond the first, which is its reference. `left_w`: what base
    and effects leave of it in each row [W]."""
    what = f"residual varies with {plain(name)}" + (f" (times {plain(times)})" if times else "")
    what += f" (by {100 * float(np.mean(np.abs(left_w))) / model.design.layout.mean_power_w:.1f} % of the power)"
    if len(values) != len(knots) - 1 or known(name).text:
        return what
    curve = np.append(0.0, values)
    top, bottom = int(np.argmax(curve)), int(np.argmin(curve))
    lowest, highest = (f"{rounded(knots[i])} {unit_of(name)}".strip() for i in (bottom, top))
    if texts := model.source.runs[0].texts.get(name):
        lowest, highest = (texts[int(knots[i])] if knots[i] in range(len(texts)) else "no text" for i in (bottom, top))
    return f"{what}: lowest at {lowest}, highest at {highest}"


def _beside(model: Model, power_w: Array) -> Array:
    """What of a curve over the rows [W] neither the base nor the effects in the model can take: along those, which it
    was fitted beside, it may have any size."""
    design = model.design
    known = np.vstack([design.gradient[: len(design.layout.parameters)], design.phi[list(model.chosen)]]).T
    return np.asarray(power_w - known @ np.linalg.lstsq(known, power_w, rcond=1e-9)[0])


def periodic(model: Model) -> Structure | None:
    """A line in the mean periodogram of the whitened residual that stands out of its neighbourhood."""
    from scipy.special import gammaincc

    design = model.design
    step = design.layout.step_s
    white = innovations(design, model.noise, model.chosen)
    parts = [white[r] for r in design.runs if r.stop - r.start >= 64]
    if not parts:
        return None
    longest = max(len(p) for p in parts)
    length = 2 ** int(np.ceil(np.log2(longest)))
    power = np.zeros(length // 2)
    for p in parts:
        spectrum = np.abs(np.fft.rfft((p - p.mean()) * np.hanning(len(p)), length)[1 : length // 2 + 1]) ** 2
        power += spectrum / max(float(np.mean(spectrum)), 1e-300)
    power /= len(parts)
    # a window of three bins: a line of a load that is not quite steady spreads over them
    smooth = np.convolve(power, [0.25, 0.5, 0.25], mode="same")
    width = min(61, 2 * (len(smooth) // 4) + 1)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(smooth, width // 2, mode="edge"), width)
    ratio = smooth / np.maximum(np.median(around, axis=1), 1e-300)
    number = np.arange(1, length // 2 + 1)
    # two and a half periods at least, and slower than eight rows: faster is the robot's own motion
    usable = (number > 2.5 * length / longest) & (number < length // 8)
    if not np.any(usable):
        return None
    ratio = np.where(usable, ratio, 0.0)
    top = int(np.argmax(ratio))
    looks = 1.3 * len(parts)  # the smoothed mean of so many periodograms is distributed as gamma
    p_value = float(gammaincc(looks, ratio[top] * 0.97 * looks)) * int(usable.sum())
    if p_value > const.PERIODIC_LEVEL or ratio[top] < const.LINE_RATIO:
        return None
    # the line lies between the frequencies of the periodogram; its period and about its standard error, both in rows
    frequency = (top + 1) / length
    tried = np.linspace(max(frequency - 1.0 / longest, 0.3 * frequency), frequency + 1.0 / longest, 81)
    fine = np.zeros(len(tried))
    for p in parts:
        wave = np.exp(-2j * np.pi * tried[:, None] * np.arange(len(p)))
        line = np.abs(wave @ ((p - p.mean()) * np.hanning(len(p)))) ** 2
        fine += line / max(float(np.mean(p**2)) * len(p), 1e-300)
    period = 1.0 / float(tried[int(np.argmax(fine))])
    sd = 0.5 * period**2 / (longest * np.sqrt(len(parts)))
    words = f"periodic load, period {period * step:.0f} ± {max(1.0, sd * step):.0f} s"
    return Structure("time_s", p_value, float(ratio[top]), 0.0, words)


def low_frequency_noise(model: Model) -> Structure | None:
    """Noise that is too slow and too loud for a meter: a load that comes and goes, or a state that no column shows.

    Without this, the correlated noise of the model would take up in silence whatever is unknown.
    """
    variance = mean_variance(vars(model.noise), const.SLOW_NOISE_S)
    size = float(model.noise.total_sd_w * np.sqrt(variance) / model.design.layout.mean_power_w)
    if size < const.SLOW_NOISE:
        return None
    words = (
        f"the residual wanders by {100 * size:.2g} % of the power from one half minute to the next, more than a meter "
        "does: a load that comes and goes, or a state that no column shows"
    )
    return Structure("time_s", 0.0, 0.0, size, words)


def peaks(left_w: Array, seconds: Array) -> str:
    """In words, that few rows hold most of what is left of the power [W], which no curve over a column shows; empty
    where they do not. Both of shape (n,), with the time that each row stands for."""
    order = np.argsort(-np.abs(left_w))
    square, time = np.cumsum((left_w**2 * seconds)[order]), np.cumsum(seconds[order])
    rare = int(np.searchsorted(time, const.RARE_TIME * time[-1], side="right"))
    if rare < const.FEWEST_PEAKS or not square[rare - 1] > const.PEAKS * square[-1]:
        return ""
    size_w = float(np.sqrt(np.average(left_w[order[:rare]] ** 2, weights=seconds[order[:rare]])))
    return (
        f"peaks of about {watts(size_w, 2)} hold {100 * square[rare - 1] / square[-1]:.0f} % of the squared error in "
        f"{100 * const.RARE_TIME:.0f} % of the time, and no column says when: starts between two rows, or faulty "
        "readings"
    )


def wrong_form(model: Model, column: int) -> Structure | None:
    """Whether a free curve over an effect's covariate explains so much more that the effect's form is not right.

    What the base parameter that is the twin of the effect takes of it is explained by the same form.
    """
    candidate, settings = model.constraints.of_column(column), model.constraints.settings
    covariate = candidate.covariate
    if covariate not in model.source.covariates:
        return None
    rest = [k for k in model.chosen if k != column]
    times = SPEED if known(covariate).multiplies_speed and SPEED in model.source.covariates else ""
    rows, knots = curve_rows(model, covariate, times)
    if rows.shape[0] < 2:
        return None  # too few values of the covariate to judge a form
    own_row = model.design.phi[[column]]
    judges = [(model, const.RAMP_FORM_RATIO)]
    if not known(covariate).ramps:
        away = steady(model)
        gain, gain_away = (test_curve(m, own_row, rest)[0] for m in (model, away))
        if gain_away > const.STEADY_PART * gain:  # a surge at each start acts on ramps alone
            judges.insert(0, (away, settings.form_ratio))
    for judge, ratio in judges:
        beyond, p_value, values = test_curve(judge, rows, model.chosen)
        # blocks that differ much among themselves hide a misfit from the sandwich, but not one as loud as this
        loud = beyond > const.CURVE_NATS_ON_RAMPS
        faint = beyond < const.CURVE_NATS or (p_value > const.FORM_LEVEL and beyond < const.FORM_NATS)
        if faint or (p_value > const.FORM_FAINT and not loud):
            continue
        layout = judge.design.layout
        if candidate.prior in layout.parameters:
            sd = layout.prior_sd.copy()
            sd[layout.parameters.index(candidate.prior)] *= const.HELD
            judge = replace(judge, design=replace(judge.design, layout=replace(layout, prior_sd=sd)))
        # both against the model without the effect, so that they compare
        own, _, _ = test_curve(judge, own_row, rest)
        free, _, _ = test_curve(judge, np.vstack([rows, own_row]), rest)
        # five free values follow slow noise by some 10 nats; a small effect is not unnamed by that
        sure = p_value < const.FORM_SURE and beyond > const.FORM_NATS and not known(covariate).noisy_form
        if own < const.GROSS * free or (own < ratio * free and sure):
            size = float(np.mean(np.abs(values @ rows))) / model.design.layout.mean_power_w
            curve = _words(model, covariate, times, knots, values, _beside(model, values @ rows))
            words = f"{plain(covariate)}: form not right ({curve})"
            return Structure(covariate, p_value, beyond, size, words)
    return None


def stands_without(model: Model, column: int, structure: Structure) -> bool:
    """Whether an effect keeps at least half of its gain when a structure's free curve is in as well.

    If not, the effect may be no more than the shadow of the structure.
    """
    own, curve, both = _beside_curve(model, column, structure)
    return both - curve >= const.STANDS * own


def outdone(model: Model, column: int, structure: Structure) -> bool:
    """Whether a structure's free curve in the place of an effect takes most of its gain and explains far more."""
    own, curve, both = _beside_curve(model, column, structure)
    return both - curve < const.STANDS * own < const.STANDS * model.constraints.settings.form_ratio * curve


def _beside_curve(model: Model, column: int, structure: Structure) -> tuple[float, float, float]:
    """Gain of an effect, of a structure's free curve in its place, and of both [nats]; nought where there
    is no such curve."""
    if structure.covariate not in model.source.covariates:
        return 0.0, 0.0, 0.0
    rest = [k for k in model.chosen if k != column]
    rows, _ = curve_rows(model, structure.covariate, structure.times)
    own = model.design.phi[[column]]
    effect, curve, both = (test_curve(model, some, rest)[0] for some in (own, rows, np.vstack([rows, own])))
    return effect, curve, both
