"""Noise by restricted maximum likelihood (Patterson and Thompson 1971, Harville 1977), with weak priors.

Alternates between the filter (correlation times and shares, which need the data), the levels between runs (Gram
matrices only), and the growth of the noise with power, edges and outliers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from missionsim.identify.data import Array
from missionsim.identify.design import Design
from missionsim.identify.gram import Blocks, innovations, total_without_random
from missionsim.identify.noise import Noise, edge_variance, log_level, start_noise
from missionsim.identify.settings import HUBER, LARGEST_GAIN, NOISE_SPLIT_S
from missionsim.identify.whitening import start_factor


def fit_noise(design: Design, chosen: Sequence[int], guess: Noise | None = None, thorough: bool = True) -> Noise:
    """Noise by restricted maximum likelihood with the chosen candidates in the mean.

    Weak log-normal priors hold parameters that few runs cannot show. Alternates between filter parameters (each
    needs the data) and the levels between runs (need Gram matrices only), then heteroscedasticity and outliers.
    """
    noise = guess or start_noise(design)
    # refits start beside their end: half the evaluations find it
    effort = (90, 50) if thorough else (45,)
    for round_, evaluations in enumerate(effort):
        rows = Blocks.of(design, noise, design.residual[None, :], chosen)
        noise = _fit_filter(design, noise, rows, len(chosen), evaluations)
        noise = _fit_levels(design, noise, rows.at(noise.shape), len(chosen), evaluations + 20)
        if round_ == 0:
            noise = _fit_scale(design, noise, chosen)
    return noise


def _objective(design: Design, noise: Noise, blocks: Array, count: int, chosen: int) -> float:
    """Minus two times the restricted log-likelihood plus priors, from blocks whitened with sigma 1."""
    q = len(design.layout.prior_sd)
    total, log_det = total_without_random(blocks, noise.random_sd(), noise.sigma_w)
    size = 1 + q + chosen
    inner = total[1:size, 1:size].copy()
    precision = np.concatenate([design.layout.prior_sd**-2.0, np.full(chosen, 4.0)])
    inner[np.diag_indices(q + chosen)] += precision
    try:
        factor = np.linalg.cholesky(inner) if q + chosen else np.empty((0, 0))
    except np.linalg.LinAlgError:
        return np.inf  # noise so small that the numbers run out, as a constant meter makes it: not a better fit
    rss = total[0, 0]
    if q + chosen:
        half = np.linalg.solve(factor, total[1:size, 0])
        rss -= half @ half
    det = 2 * float(np.sum(np.log(np.diag(factor)))) - float(np.sum(np.log(precision)))
    start = len(design.stretches) * start_factor(*noise.shape)[2]
    return float(count * np.log(noise.sigma_w**2) + log_det + rss + det + start + _prior(design, noise))


def _prior(design: Design, noise: Noise) -> float:
    power = design.layout.mean_power_w
    h = noise.step_s
    white = max(1e-6, 1 - noise.fast_share - noise.slow_share)
    terms = [
        (math.log(noise.offset_w / (0.005 * power)), 1.0),
        (math.log(noise.gain / 0.005), 0.7),
        (math.log(noise.motion_gain / 0.005), 0.7),
        (math.log(noise.fast_s / max(4.0, 1.5 * h)), 0.9),
        (math.log(noise.slow_s / max(50.0, 20 * h)), 0.6),
        (math.log(noise.slow_share / white) + 1.5, 1.5),
        (math.log(noise.fast_share / white) - 0.5, 2.0),
    ]
    return float(sum((value / sd) ** 2 for value, sd in terms))


def _fit_filter(design: Design, noise: Noise, rows: Blocks, chosen: int, evaluations: int) -> Noise:
    from scipy.optimize import minimize

    count = len(design.y)
    border = max(NOISE_SPLIT_S, 10 * noise.step_s)

    def at(x: Array) -> Noise:
        odds = np.exp(np.clip(x[2:4], -12, 12))
        shares = odds / (1 + odds.sum())
        return replace(
            noise,
            fast_s=float(np.exp(x[0])),
            slow_s=float(np.exp(x[1])),
            fast_share=float(shares[0]),
            slow_share=float(shares[1]),
            sigma_w=float(np.exp(x[4])),
        )

    def cost(x: Array) -> float:
        if not (0.05 * noise.step_s < np.exp(x[0]) < border < np.exp(x[1]) < 40 * border):
            return 1e12
        trial = at(x)
        return _objective(design, trial, rows.at(trial.shape), count, chosen)

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
    return at(found.x)


def _fit_levels(design: Design, noise: Noise, blocks: Array, chosen: int, evaluations: int) -> Noise:
    from scipy.optimize import minimize

    count = len(design.y)
    names = ["sigma_w", "offset_w", "gain"] + (["motion_gain"] if np.any(design.random[2]) else [])

    def at(x: Array) -> Noise:
        levels: dict[str, Any] = {n: float(v) for n, v in zip(names, np.exp(np.clip(x, -25, 15)), strict=True)}
        for name in ("gain", "motion_gain"):
            levels[name] = min(levels.get(name, 0.0), LARGEST_GAIN) if name in levels else getattr(noise, name)
        return replace(noise, **levels)

    x0 = np.log([getattr(noise, n) for n in names])
    found = minimize(
        lambda x: _objective(design, at(x), blocks, count, chosen),
        x0,
        method="Nelder-Mead",
        options={
            "maxfev": evaluations,
            "xatol": 0.03,
            "fatol": 0.05,
            "initial_simplex": np.vstack([x0] + [x0 + s for s in np.diag([0.1, *([0.5] * (len(names) - 1))])]),
        },
    )
    return at(found.x)


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
    variance = 1.0 + ramp_error * ramp + switch_error * switch
    e = e / np.sqrt(variance)
    # the median is not moved by the outliers that it shall find
    typical = 1.4826 * float(np.median(np.abs(e)))
    huber = np.minimum(1.0, HUBER / np.maximum(np.abs(e) / max(typical, 1e-9), 1e-9))
    return replace(
        noise, exponent=exponent, scale=scale, ramp_error=ramp_error, switch_error=switch_error, weight=huber / variance
    )
