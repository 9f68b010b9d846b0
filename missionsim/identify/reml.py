"""Noise by restricted maximum likelihood (Patterson and Thompson 1971, Harville 1977), with weak priors.

Alternates between the filter (correlation times and shares, which need the data), the levels between runs (Gram
matrices only), and the growth of the noise with power, edges and outliers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from missionsim.identify.data import Array
from missionsim.identify.design import Design
from missionsim.identify.gram import Blocks, innovations, total_without_random
from missionsim.identify.noise import (
    Noise,
    Shape,
    edge_variance,
    for_rows,
    log_level,
    start_factor,
    start_noise,
    without_outliers,
)
from missionsim.identify.settings import HUBER, JITTER_SD_S, LAG_JITTER_SD_S2, LARGEST_GAIN, NOISE_SPLIT_S, SHARE_PRIOR


def fit_noise(design: Design, chosen: Sequence[int], guess: Noise | None = None, thorough: bool = True) -> Noise:
    """Noise by restricted maximum likelihood with the chosen candidates in the mean.

    Weak log-normal priors hold parameters that few runs cannot show. Alternates between filter parameters (each
    needs the data) and the levels between runs (need Gram matrices only), then heteroscedasticity and outliers.
    """
    noise = guess or start_noise(design)
    # refits start beside their end: half the evaluations find it
    effort = (90, 50) if thorough else (45,)
    likelihood, moves = _Likelihood(design, len(chosen)), bool(np.any(design.random[2]))
    for round_, evaluations in enumerate(effort):
        rows = Blocks.of(design, noise, design.residual[None, :], chosen)
        noise = _fit_filter(likelihood, noise, rows, evaluations)
        noise = _fit_levels(likelihood, noise, rows.at(noise.shape), moves, evaluations + 20)
        if round_ == 0:
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
        terms = (
            (math.log(noise.offset_w / (0.005 * self.power)), 1.0),
            (math.log(noise.gain / 0.005), 0.7),
            (math.log(noise.motion_gain / 0.005), 0.7),
            (math.log(fast_s / max(4.0, 1.5 * h)), 0.9),
            (math.log(slow_s / max(50.0, 20 * h)), 0.6),
            (math.log(slow_share / white) + 1.5, 1.5),
            (math.log(fast_share / white) - 0.5, 2.0),
        )
        return sum((value / sd) ** 2 for value, sd in terms)


class Levels(NamedTuple):
    """Innovation of the noise and what differs between runs; see `Noise`."""

    sigma_w: float
    offset_w: float
    gain: float
    motion_gain: float


def _levels(noise: Noise) -> Levels:
    return Levels(noise.sigma_w, noise.offset_w, noise.gain, noise.motion_gain)


def _fit_filter(likelihood: _Likelihood, noise: Noise, rows: Blocks, evaluations: int) -> Noise:
    from scipy.optimize import minimize

    step_s = noise.step_s
    border = max(NOISE_SPLIT_S, 10 * step_s)
    levels = _levels(noise)

    def at(x: Array) -> tuple[float, Shape]:
        fast, slow = (math.exp(min(max(float(v), -12.0), 12.0)) for v in x[2:4])
        every = 1.0 + fast + slow
        return math.exp(x[4]), (step_s, math.exp(x[0]), math.exp(x[1]), fast / every, slow / every)

    def cost(x: Array) -> float:
        sigma_w, shape = at(x)
        if not (0.05 * step_s < shape[1] < border < shape[2] < 40 * border):
            return 1e12
        return likelihood(levels._replace(sigma_w=sigma_w), shape, rows.at(shape))

    white = max(1e-6, 1 - noise.fast_share - noise.slow_share)
    x0 = np.array(
        [
            np.log(noise.fast_s),
            np.log(noise.slow_s),
            np.log(noise.fast_share / white),
            np.log(noise.slow_share / white),
            np.log(noise.sigma_w),
        ]
    )
    size = 1.0 if evaluations > 60 else 0.6
    simplex = np.vstack([x0] + [x0 + size * step for step in np.diag([0.5, 0.4, 0.7, 0.7, 0.3])])
    found = minimize(
        cost,
        x0,
        method="Nelder-Mead",
        options={"maxfev": evaluations, "initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05},
    )
    sigma_w, (_, fast_s, slow_s, fast_share, slow_share) = at(found.x)
    return replace(noise, fast_s=fast_s, slow_s=slow_s, fast_share=fast_share, slow_share=slow_share, sigma_w=sigma_w)


def _fit_levels(likelihood: _Likelihood, noise: Noise, blocks: Array, moves: bool, evaluations: int) -> Noise:
    from scipy.optimize import minimize

    shape = noise.shape
    # without motion there is no motion gain to fit
    x0 = np.log(_levels(noise) if moves else _levels(noise)[:-1])

    def at(x: Array) -> Levels:
        sigma_w, offset_w, *gains = (math.exp(min(max(float(v), -25.0), 15.0)) for v in x)
        gain, motion_gain = (*(min(g, LARGEST_GAIN) for g in gains), noise.motion_gain)[:2]
        return Levels(sigma_w, offset_w, gain, motion_gain)

    found = minimize(
        lambda x: likelihood(at(x), shape, blocks),
        x0,
        method="Nelder-Mead",
        options={
            "maxfev": evaluations,
            "xatol": 0.03,
            "fatol": 0.05,
            "initial_simplex": np.vstack([x0] + [x0 + s for s in np.diag([0.1, *([0.5] * (len(x0) - 1))])]),
        },
    )
    return replace(noise, **at(found.x)._asdict())


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
