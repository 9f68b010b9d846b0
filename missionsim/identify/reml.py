"""Noise by restricted maximum likelihood (Patterson and Thompson 1971, Harville 1977), with weak priors.

Filter (correlation times and shares) and levels between runs together, in turns with the growth of the noise with
power, edges and outliers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify import noise as noises
from missionsim.identify.design import Design
from missionsim.identify.gram import Blocks, eliminate_random, innovations
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


def fit_noise(
    design: Design, chosen: Sequence[int], guess: noises.Noise | None = None, thorough: bool = True
) -> noises.Noise:
    """Noise by restricted maximum likelihood with the chosen candidates in the mean.

    Weak log-normal priors hold parameters that few runs cannot show. Where it is `thorough`, heteroscedasticity and
    outliers are read off a first fit, and the second takes them in.
    """
    noise = guess or noises.start_noise(design)
    likelihood = _Likelihood(design, len(chosen), noise)
    for enough in (ROUGHLY, ENOUGH) if thorough else (ENOUGH,):
        rows = Blocks.of(design, noise, design.residual[None, :], chosen)
        noise = _fitted(likelihood, noise, rows, enough)
        if enough == ROUGHLY or not thorough:
            noise = _fit_scale(design, noise, chosen)
    return noise


class _Likelihood:
    """Minus two times the restricted log-likelihood plus priors, for any noise, from blocks of unit variance.

    A noise is a place x: logarithms of the five parameters of its filter and innovation, then of what differs between
    runs. Without motion there is no motion gain to fit.
    """

    def __init__(self, design: Design, chosen: int, noise: noises.Noise) -> None:
        sd = design.layout.prior_sd
        self.fixed = 1 + len(sd) + chosen
        self.precision = np.concatenate([sd**-2.0, np.full(chosen, SHARE_PRIOR)])
        self.log_precision = float(np.sum(np.log(self.precision)))
        self.count, self.stretches = len(design.y), len(design.stretches)
        self.power, self.step_s = design.layout.mean_power_w, design.layout.step_s
        self.still = [] if np.any(design.random[2]) else [noise.motion_gain]
        border = max(NOISE_SPLIT_S, 10 * self.step_s)
        low = (0.05 * self.step_s, border, *[math.exp(-12.0)] * 2, *[math.exp(-25.0)] * 4)
        high = (border, 40 * border, math.exp(12.0), MOST_SLOW, *[math.exp(15.0)] * 2, LARGEST_GAIN, LARGEST_GAIN)
        self.low, self.high = (np.log(values)[: 8 - len(self.still)] for values in (low, high))

    def place(self, noise: noises.Noise) -> Array:
        """Where a noise lies, within the bounds."""
        white = max(1e-6, 1 - noise.fast_share - noise.slow_share)
        shares = (noise.fast_share / white, noise.slow_share / noise.fast_share)
        start = (noise.fast_s, noise.slow_s, *shares, noise.sigma_w, noise.offset_w, noise.gain, noise.motion_gain)
        return np.clip(np.log(start)[: len(self.low)], self.low, self.high)

    def shape(self, x: Array) -> noises.Shape:
        fast_s, slow_s, fast, part = np.exp(x[:4]).tolist()
        every = 1.0 + fast * (1.0 + part)
        return self.step_s, fast_s, slow_s, fast / every, fast * part / every

    def levels(self, x: Array) -> list[float]:
        """Innovation, offset, gain and motion gain; see `Noise`."""
        return [*np.exp(x[4:]).tolist(), *self.still]

    def __call__(self, places: Array | Sequence[Array], blocks: Array) -> Array:
        """Of several noises at once, each with its blocks, shape (noises, runs, k, k)."""
        levels = np.array([[*self.levels(x), JITTER_SD_S, LAG_JITTER_SD_S2] for x in places])
        left, log_dets = eliminate_random(blocks / levels[:, 0, None, None, None] ** 2, levels[:, 1:])
        total, log_det = left.sum(axis=1), log_dets.sum(axis=1)
        inner = total[:, 1 : self.fixed, 1 : self.fixed]
        inner[:, range(self.fixed - 1), range(self.fixed - 1)] += self.precision
        try:
            factor = np.linalg.cholesky(inner)
        except np.linalg.LinAlgError:
            # noise so small that the numbers run out, as a constant meter makes it, is no better fit
            if len(places) == 1:
                return np.array([np.inf])
            return np.concatenate([self([x], own) for x, own in zip(places, blocks[:, None], strict=True)])
        half = np.linalg.solve(factor, total[:, 1 : self.fixed, :1])[:, :, 0]
        rss = total[:, 0, 0] - np.sum(half**2, axis=1)
        det = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1) - self.log_precision
        own = np.array([self._of_noise(self.shape(x), *r[:4]) for x, r in zip(places, levels.tolist(), strict=True)])
        return np.asarray(log_det + rss + det + own)

    def _of_noise(self, shape: noises.Shape, sigma_w: float, offset_w: float, gain: float, motion_gain: float) -> float:
        """What a noise costs whatever the rows are: its size, the start of every stretch, and the priors."""
        start = self.stretches * noises.start_factor(*shape)[2]
        h, fast_s, slow_s, fast_share, slow_share = shape
        white = max(1e-6, 1 - fast_share - slow_share)
        off = (
            math.log(fast_s / max(4.0, 1.5 * h)),
            math.log(slow_s / max(50.0, 20 * h)),
            math.log(fast_share / white) - 0.5,
            math.log(slow_share / white) + 1.5,
            0.0,
            math.log(offset_w / (0.005 * self.power)),
            math.log(gain / 0.005),
            math.log(motion_gain / 0.005),
        )
        prior = math.fsum((distance / sd) ** 2 for distance, sd in zip(off, PRIOR_SD.tolist(), strict=True))
        return self.count * math.log(sigma_w**2) + start + prior

    def information(self, x: Array, blocks: Array) -> Array:
        """Expected curvature: of the filter from its spectrum (Whittle 1953), of the levels from what the runs say of
        their random effects, with that of the priors."""

        def log_spectrum(there: Array) -> Array:
            ar, ma, _ = noises.arma_of(*self.shape(there))
            own, past = (np.abs(p[0] + p[1] * TURN + p[2] * TURN**2) for p in (ma, ar))
            return np.asarray(2.0 * np.log(own / past))

        spectrum = log_spectrum(x)
        slopes = np.full((5, len(spectrum)), 2.0)
        for i in range(4):
            slopes[i] = (log_spectrum(x + np.where(np.arange(len(x)) == i, STEP, 0.0)) - spectrum) / STEP
        out = np.diag(2.0 / PRIOR_SD[: len(x)] ** 2)
        out[2, 2:4] += out[3, 3]  # the prior is on the slow variance against white
        out[3, 2] = out[3, 3]
        out[:5, :5] += self.count / len(spectrum) * slopes @ slopes.T
        sigma_w, *between = self.levels(x)
        sd = np.array([*between, JITTER_SD_S, LAG_JITTER_SD_S2]) / sigma_w
        inner = blocks[:, -len(sd) :, -len(sd) :] * sd[:, None] * sd
        known = np.linalg.solve(inner + np.eye(len(sd)), inner)[:, : len(x) - 5, : len(x) - 5]
        out[5:, 5:] += 4.0 * np.sum(known**2, axis=0)
        return out


def _fitted(cost: _Likelihood, noise: noises.Noise, rows: Blocks, enough: float) -> noises.Noise:
    """Filter and levels at the likelihood's best, by quasi-Newton steps (BFGS) from the expected information.

    The Fisher information knows the scale of every parameter and which of them go together, far from the best as well;
    near it, updates from the gradients take in what a misfit of the mean does to the curvature.
    """
    low, high = cost.low, cost.high

    def gradient(x: Array, value: float, blocks: Array) -> Array:
        step = np.where(x + STEP < high, STEP, -STEP)
        near = x + np.diag(step)
        every = np.stack([rows.at(cost.shape(place)) if i < 4 else blocks for i, place in enumerate(near)])
        return np.asarray((cost(near, every) - value) / (near.diagonal() - x))

    x = cost.place(noise)
    blocks = rows.at(cost.shape(x))
    value = float(cost([x], blocks[None])[0])
    slope, curve = gradient(x, value, blocks), cost.information(x, blocks)
    for _ in range(MOST_STEPS):
        free = ~((x <= low) & (slope > 0.0) | (x >= high) & (slope < 0.0))
        step = np.zeros(len(x))
        step[free] = np.linalg.solve(curve[np.ix_(free, free)], -slope[free])
        step *= min(1.0, LARGEST_STEP / float(np.abs(step).max(initial=1e-12)))
        for _ in range(MOST_HALVINGS):
            there = np.clip(x + step, low, high)
            blocks = rows.at(cost.shape(there))
            found = float(cost([there], blocks[None])[0])
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
            curve = cost.information(x, blocks)
            continue
        rise, was = slope - before, curve @ step
        if rise @ step > 0.05 * (was @ step):  # else it would no longer be a minimum
            curve = curve + np.outer(rise, rise) / (rise @ step) - np.outer(was, was) / (was @ step)
    _, fast_s, slow_s, fast_share, slow_share = cost.shape(x)
    sigma_w, offset_w, gain, motion_gain = cost.levels(x)
    noise = replace(noise, fast_s=fast_s, slow_s=slow_s, fast_share=fast_share, slow_share=slow_share)
    return replace(noise, sigma_w=sigma_w, offset_w=offset_w, gain=gain, motion_gain=motion_gain)


def _fit_scale(design: Design, noise: noises.Noise, chosen: Sequence[int]) -> noises.Noise:
    """Growth of the noise with power, and Huber weights, from the innovations."""
    e = innovations(design, replace(noise, weight=np.minimum(1.0, noise.weight)), chosen) / np.sqrt(noise.weight)
    level = noises.log_level(design)
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
    ramp, switch = noises.edge_variance(design, noise, scale)
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


def on_rows(design: Design, noise: noises.Noise, chosen: Sequence[int]) -> noises.Noise:
    """A noise that was fitted to some of the runs, with the scale and the weights of all rows of a design."""
    plain = noises.without_outliers(design, noises.for_rows(design, noise))
    e = innovations(design, plain, chosen) / np.sqrt(plain.weight)
    return replace(plain, weight=_weights(e, 1.0 / plain.weight))
