"""Noise of the power: fast and slow AR(1) parts and white noise, levels that differ between runs (step 2).

Two AR(1) processes beside white noise (`missionsim.identify.whitening`). Runs differ by meter offset, meter gain,
motion gain, clock jitter and lag jitter: random effects that are integrated out (`missionsim.identify.gram`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array
from missionsim.identify.design import Design
from missionsim.identify.settings import JITTER_SD_S, LAG_JITTER_SD_S2, NOISE_FLOOR, SLOW_LEFT
from missionsim.identify.whitening import Packed, Shape, arma_of

if TYPE_CHECKING:
    from missionsim.identify.predictive import LeastSquares


@dataclass(frozen=True)
class Noise:
    """Noise parameters.

    ``sigma_w`` is the standard deviation of the one-step innovation at mean power; ``fast_share`` and ``slow_share``
    are parts of the variance; ``exponent`` says how the noise grows with power; ``offset_w``, ``gain`` and
    ``motion_gain`` are the standard deviations between runs (W, relative, share of mean power); ``ramp_error`` and
    ``switch_error`` are squared relative errors where the base model changes or switches; ``weight`` (n,)
    down-weights such rows and outliers.
    """

    step_s: float
    fast_s: float
    slow_s: float
    fast_share: float
    slow_share: float
    sigma_w: float
    exponent: float
    offset_w: float
    gain: float
    motion_gain: float
    ramp_error: float
    switch_error: float
    weight: Array
    scale: Array

    def of_rows(self, at: NDArray[np.intp]) -> Noise:
        """The same noise at some of the rows."""
        return replace(self, weight=self.weight[at], scale=self.scale[at])

    def random_sd(self) -> Array:
        """Standard deviations of the random effects between runs, shape (5,)."""
        return np.array([self.offset_w, self.gain, self.motion_gain, JITTER_SD_S, LAG_JITTER_SD_S2])

    @property
    def shape(self) -> Shape:
        """Analysis step and the four shape parameters."""
        return self.step_s, self.fast_s, self.slow_s, self.fast_share, self.slow_share

    @property
    def total_sd_w(self) -> float:
        """Standard deviation of the noise at mean power [W]."""
        return self.sigma_w * arma_of(*self.shape)[2]


def packed(design: Design, noise: Noise, rows: Array) -> Packed:
    """Rows (k, n), divided by the scale of the noise, ready to be whitened with any shape of the noise."""
    return Packed.of(rows, noise.scale, noise.weight, design.stretches, design.runs)


def start_noise(design: Design) -> Noise:
    """First guess, from published figures: 3 % noise, mostly a few seconds long, meters apart by 0.5 %."""
    power = design.layout.mean_power_w
    n = len(design.y)
    step = design.layout.step_s
    sigma = 0.02 * power * min(1.0, np.sqrt(step))
    has_motion = 0.005 if np.any(design.random[2]) else 1e-6
    return Noise(
        step,
        max(4.0, 2 * step),
        max(60.0, 20 * step),
        0.6,
        0.1,
        sigma,
        0.0,
        0.005 * power,
        0.005,
        has_motion,
        0.0,
        0.0,
        np.ones(n),
        np.ones(n),
    )


def bounded_noise(design: Design, squares: LeastSquares, chosen: Sequence[int]) -> Noise:
    """The first guess at the size of what least squares leaves: noise without a slow part that could take a signal."""
    noise = start_noise(design)
    error = float(np.sqrt(squares.leave_out(chosen).total / float(squares.seconds.sum())))
    return replace(noise, sigma_w=noise.sigma_w * error / noise.total_sd_w, slow_share=SLOW_LEFT)


def log_level(design: Design) -> Array:
    mean = design.layout.mean_power_w
    return np.log(np.maximum(design.base, NOISE_FLOOR * mean) / mean)


def for_rows(design: Design, noise: Noise) -> Noise:
    """The same noise for the rows of another design (held-out or imagined runs), none of them an outlier."""
    return replace(noise, weight=np.ones(len(design.y)), scale=np.exp(noise.exponent * log_level(design)))


def without_outliers(design: Design, noise: Noise) -> Noise:
    """The same noise with no row called an outlier: what a model lacks looks like outliers to it."""
    ramp, switch = edge_variance(design, noise, noise.scale)
    return replace(noise, weight=1.0 / (1.0 + noise.ramp_error * ramp + noise.switch_error * switch))


def edge_variance(design: Design, noise: Noise, scale: Array) -> tuple[Array, Array]:
    """Squared change of the base model around each row, and squared jumps of its switching terms, both in innovation
    variances and with their echo in the next row.

    Where the model changes fast, small errors of time, speed or of the moving/standing threshold are large errors
    of power; such rows say less.
    """
    ar, ma, _ = arma_of(*noise.shape)
    echo = float(ar[1] - ma[1]) ** 2
    jumps = design.gradient[-1]
    out = np.empty((2, len(design.y)))
    for part in design.stretches:
        base = design.base[part]
        change = np.abs(np.diff(base, prepend=base[0], append=base[-1]))
        jump = np.pad(jumps[part], 1)
        unit = noise.sigma_w * scale[part]
        square = np.vstack([np.maximum(change[1:], change[:-1]), np.maximum(jump[:-2], jump[1:-1])]) / unit
        square *= square
        out[:, part] = square
        out[:, part.start + 1 : part.stop] += echo * square[:, :-1]
    return out[0], out[1]
