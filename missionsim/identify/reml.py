"""Noise by restricted maximum likelihood (Patterson and Thompson 1971, Harville 1977), with weak priors.

Filter (correlation times and shares) and levels between runs together, in turns with the growth of the noise with
power, edges and outliers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from missionsim.identify.design import Design
from missionsim.identify.gram import Blocks, innovations, total_without_random
from missionsim.identify.noise import (
    Noise,
    Shape,
    arma_of,
    edge_variance,
    for_rows,
    log_level,
    start_factor,
    start_noise,
    without_outliers,
)
from missionsim.identify.settings import (
    HUBER,
    JITTER_SD_S,
    LAG_JITTER_SD_S2,
    LARGEST_GAIN,
    MOST_SLOW,
    NOISE_SPLIT_S,
    SHARE_PRIOR,
)
from missionsim.physics import Array

PRIOR_SD = np.array([0.9, 0.6, 2.0, 1.5, np.inf, 1.0, 0.7, 0.7])
"""Of the logarithms of fast and slow correlation time, fast and slow variance against white, innovation, offset, gain
and motion gain."""
TURN = np.exp(-1j * np.pi * (np.arange(400) + 0.5) / 400)
STEP = 1e-4
LARGEST_STEP = 1.5
MOST_STEPS, MOST_HALVINGS = 20, 6
ENOUGH = 0.02
"""A step that gains less ends the fit; a hundredth of what decides anything."""
ROUGHLY = 1.0
"""The same of a fit that only outliers and the growth of the noise are read off."""
FAR = 20.0
"""After a larger gain the information is computed anew."""


def fit_noise(design: Design, chosen: Sequence[int], guess: Noise | None = None, thorough: bool = True) -> Noise:
    """Noise by restricted maximum likelihood with the chosen candidates in the mean.

    Weak log-normal priors hold parameters that few runs cannot show. Where it is `thorough`, heteroscedasticity and
    outliers are read off a first fit, and the second takes them in.
    """
    noise = guess or start_noise(design)
    likelihood, moves = _Likelihood(design, len(chosen)), bool(np.any(design.random[2]))
    for enough in (ROUGHLY, ENOUGH) if thorough else (ENOUGH,):
        rows = Blocks.of(design, noise, design.residual[None, :], chosen)
        noise = _fitted(likelihood, noise, rows, moves, enough)
        if enough == ROUGHLY or not thorough:
            noise = _fit_scale(design, noise, chosen)
    return noise


class _Likelihood:
    """Minus two times the restricted log-likelihood plus priors, for any noise, from blocks of unit variance."""

    def __init__(self, design: Design, chosen: int) -> None:
        sd = design.layout.prior_sd
        self.fixed = 1 + len(sd) + chosen
        self.precision = np.concatenate([sd**-2.0, np.full(chosen, SHARE_PRIOR)])
        self.log_precision = float(np.sum(np.log(self.precision)))
        self.count, self.stretches = len(design.y), len(design.stretches)
        self.power, self.step_s = design.layout.mean_power_w, design.layout.step_s

    def __call__(self, noise: Levels, shape: Shape, blocks: Array) -> float:
        """For the levels of a noise and its shape."""
        sd = np.array([noise.offset_w, noise.gain, noise.motion_gain, JITTER_SD_S, LAG_JITTER_SD_S2])
        total, log_det = total_without_random(blocks, sd, noise.sigma_w)
        inner = total[1 : self.fixed, 1 : self.fixed]
        inner.flat[:: self.fixed] += self.precision
        try:
            factor = np.linalg.cholesky(inner)
        except np.linalg.LinAlgError:
            return np.inf  # noise so small that the numbers run out, as a constant meter makes it: not a better fit
        half = np.linalg.solve(factor, total[1 : self.fixed, 0])
        rss = float(total[0, 0] - half @ half)
        det = 2.0 * float(np.log(factor.diagonal()).sum()) - self.log_precision
        start = self.stretches * start_factor(*shape)[2]
        return self.count * math.log(noise.sigma_w**2) + log_det + rss + det + start + self._prior(noise, shape)

    def _prior(self, noise: Levels, shape: Shape) -> float:
        h, fast_s, slow_s, fast_share, slow_share = shape
        white = max(1e-6, 1 - fast_share - slow_share)
        off = (
            math.log(fast_s / max(4.0, 1.5 * h)),
            math.log(slow_s / max(50.0, 20 * h)),
            math.log(fast_share / white) - 0.5,
            math.log(slow_share / white) + 1.5,
            0.0,
            math.log(noise.offset_w / (0.005 * self.power)),
            math.log(noise.gain / 0.005),
            math.log(noise.motion_gain / 0.005),
        )
        return float(np.sum((off / PRIOR_SD) ** 2))


class Levels(NamedTuple):
    """Innovation of the noise and what differs between runs; see `Noise`."""

    sigma_w: float
    offset_w: float
    gain: float
    motion_gain: float


class _Place(NamedTuple):
    """Logarithms of the noise's parameters with their bounds, the filter's five first, and what else the noise has."""

    step_s: float
    motion_gain: float
    start: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, noise: Noise, moves: bool) -> _Place:
        border = max(NOISE_SPLIT_S, 10 * noise.step_s)
        white = max(1e-6, 1 - noise.fast_share - noise.slow_share)
        shares = (noise.fast_share / white, noise.slow_share / noise.fast_share)
        start = (noise.fast_s, noise.slow_s, *shares, noise.sigma_w, noise.offset_w, noise.gain, noise.motion_gain)
        low = (0.05 * noise.step_s, border, *[math.exp(-12.0)] * 2, *[math.exp(-25.0)] * 4)
        high = (border, 40 * border, math.exp(12.0), MOST_SLOW, *[math.exp(15.0)] * 2, LARGEST_GAIN, LARGEST_GAIN)
        # without motion there is no motion gain to fit
        count = len(start) if moves else len(start) - 1
        own, least, most = (np.log(values)[:count] for values in (start, low, high))
        return cls(noise.step_s, noise.motion_gain, np.clip(own, least, most), least, most)

    def shape(self, x: Array) -> Shape:
        fast_s, slow_s, fast, part = np.exp(x[:4]).tolist()
        every = 1.0 + fast * (1.0 + part)
        return self.step_s, fast_s, slow_s, fast / every, fast * part / every

    def levels(self, x: Array) -> Levels:
        return Levels(*[*np.exp(x[4:]).tolist(), self.motion_gain][:4])


def _fitted(likelihood: _Likelihood, noise: Noise, rows: Blocks, moves: bool, enough: float) -> Noise:
    """Filter and levels at the likelihood's best, by quasi-Newton steps (BFGS) from the expected information.

    The Fisher information knows the scale of every parameter and which of them go together, far from the best as well;
    near it, updates from the gradients take in what a misfit of the mean does to the curvature.
    """
    place = _Place.of(noise, moves)
    low, high = place.low, place.high

    def cost(x: Array, blocks: Array) -> float:
        return likelihood(place.levels(x), place.shape(x), blocks)

    def gradient(x: Array, value: float, blocks: Array) -> Array:
        out = np.empty(len(x))
        for i in range(len(x)):
            near = x.copy()
            near[i] += STEP if x[i] + STEP < high[i] else -STEP
            out[i] = (cost(near, rows.at(place.shape(near)) if i < 4 else blocks) - value) / (near[i] - x[i])
        return out

    x = place.start
    blocks = rows.at(place.shape(x))
    value = cost(x, blocks)
    slope, curve = gradient(x, value, blocks), _information(place, x, blocks, likelihood.count)
    for _ in range(MOST_STEPS):
        free = ~((x <= low) & (slope > 0.0) | (x >= high) & (slope < 0.0))
        step = np.zeros(len(x))
        step[free] = np.linalg.solve(curve[np.ix_(free, free)], -slope[free])
        step *= min(1.0, LARGEST_STEP / float(np.abs(step).max(initial=1e-12)))
        for _ in range(MOST_HALVINGS):
            there = np.clip(x + step, low, high)
            blocks = rows.at(place.shape(there))
            found = cost(there, blocks)
            step = there - x
            promised = -float(slope @ step)
            if found < value or promised < enough:
                break
            # the least of the parabola through both values and the slope
            step *= min(0.5, max(0.1, 0.5 * promised / (found - value + promised)))
        fall = value - found
        if not fall > 0.0:
            break
        x, value = there, found
        if fall < enough:
            break
        before, slope = slope, gradient(x, value, blocks)
        if fall > FAR:
            curve = _information(place, x, blocks, likelihood.count)
            continue
        rise, was = slope - before, curve @ step
        if rise @ step > 0.05 * (was @ step):  # else it would no longer be a minimum
            curve = curve + np.outer(rise, rise) / (rise @ step) - np.outer(was, was) / (was @ step)
    _, fast_s, slow_s, fast_share, slow_share = place.shape(x)
    filtered = replace(noise, fast_s=fast_s, slow_s=slow_s, fast_share=fast_share, slow_share=slow_share)
    return replace(filtered, **place.levels(x)._asdict())


def _information(place: _Place, x: Array, blocks: Array, count: int) -> Array:
    """Expected curvature of the likelihood: of the filter from its spectrum (Whittle 1953), of the levels from what the
    runs say of their random effects, with that of the priors."""
    spectrum = _log_spectrum(place.shape(x))
    slopes = np.full((5, len(spectrum)), 2.0)
    for i in range(4):
        slopes[i] = (_log_spectrum(place.shape(x + np.where(np.arange(len(x)) == i, STEP, 0.0))) - spectrum) / STEP
    out = np.diag(2.0 / PRIOR_SD[: len(x)] ** 2)
    out[2, 2:4] += out[3, 3]  # the prior is on the slow variance against white
    out[3, 2] = out[3, 3]
    out[:5, :5] += count / len(spectrum) * slopes @ slopes.T
    levels = place.levels(x)
    sd = np.array([*levels[1:], JITTER_SD_S, LAG_JITTER_SD_S2]) / levels.sigma_w
    inner = blocks[:, -len(sd) :, -len(sd) :] * sd[:, None] * sd
    known = np.linalg.solve(inner + np.eye(len(sd)), inner)[:, : len(x) - 5, : len(x) - 5]
    out[5:, 5:] += 4.0 * np.sum(known**2, axis=0)
    return out


def _log_spectrum(shape: Shape) -> Array:
    """Logarithm of the power spectrum of noise with innovations of unit variance, evenly over all frequencies."""
    ar, ma, _ = arma_of(*shape)
    own, past = (np.abs(p[0] + p[1] * TURN + p[2] * TURN**2) for p in (ma, ar))
    return np.asarray(2.0 * np.log(own / past))


def _fit_scale(design: Design, noise: Noise, chosen: Sequence[int]) -> Noise:
    """Growth of the noise with power, and Huber weights, from the innovations."""
    e = innovations(design, replace(noise, weight=np.minimum(1.0, noise.weight)), chosen) / np.sqrt(noise.weight)
    level = log_level(design)
    spread = float(np.var(level))
    exponent = noise.exponent
    if spread > 1e-4:
        size = np.log(np.maximum(np.abs(e), 0.05))
        # regression of log size on log power: its slope is the exponent
        slope = float(np.mean((level - level.mean()) * (size - size.mean()))) / spread
        certainty = len(e) * spread / (len(e) * spread + 1.2 / 0.25)
        exponent = float(np.clip(noise.exponent + certainty * slope, 0.0, 1.0))
    scale = np.exp(exponent * level)
    # innovations under the new scale, without whitening anew
    e = e * noise.scale / scale
    ramp, switch = edge_variance(design, noise, scale)
    tried_ramp = np.concatenate([[0.0], np.geomspace(3e-4, 0.3, 13)])
    tried_switch = np.concatenate([[0.0], np.geomspace(0.01, 1.0, 9)]) if np.any(switch) else np.zeros(1)
    grid = np.array([(a, b) for a in tried_ramp for b in tried_switch])
    near = (ramp > 0.01) | (switch > 0.01)
    variance = 1.0 + grid @ np.vstack([ramp[near], switch[near]])
    # outliers capped at five sd must not pass for uncertain edges
    cost = np.sum(np.log(variance) + np.minimum(e[near] ** 2, 25.0) / variance, axis=1)
    ramp_error, switch_error = (float(x) for x in grid[int(np.argmin(cost))])
    found = replace(noise, exponent=exponent, scale=scale, ramp_error=ramp_error, switch_error=switch_error)
    return replace(found, weight=_weights(e, 1.0 + ramp_error * ramp + switch_error * switch))


def _weights(e: Array, variance: Array) -> Array:
    """Weights of rows with innovations e and the variance that edges add: outliers count less (Huber 1981)."""
    e = e / np.sqrt(variance)
    # the median is not moved by the outliers that it shall find
    typical = 1.4826 * float(np.median(np.abs(e)))
    huber = np.minimum(1.0, HUBER / np.maximum(np.abs(e) / max(typical, 1e-9), 1e-9))
    return np.asarray(huber / variance)


def on_rows(design: Design, noise: Noise, chosen: Sequence[int]) -> Noise:
    """A noise that was fitted to some of the runs, with the scale and the weights of all rows of a design."""
    plain = without_outliers(design, for_rows(design, noise))
    e = innovations(design, plain, chosen) / np.sqrt(plain.weight)
    return replace(plain, weight=_weights(e, 1.0 / plain.weight))
