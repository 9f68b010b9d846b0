"""How power follows motion in time: the offset between two clocks, and a meter that smooths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LONGEST_S = 3.0
_MOST_SAMPLES = 40_000
_LEAST_SAMPLES = 60
_SMOOTHINGS_S = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Time constants tried for a meter that smooths [s]."""


@dataclass(frozen=True)
class ClockEstimate:
    """Delay of power behind motion.

    Attributes
    ----------
    delay_s : float
        Positive: power comes later than the motion that causes it [s].
    correlation : float
        Multiple correlation between changes of power and changes of motion, at that delay.
    correlation_at_zero : float
    resolution_s : float
        Step of the log that limits the estimate [s].
    smoothing_s : float
        Time constant of a first-order low pass of the motion that explains power better than any delay; 0 where none
        does [s].
    correlation_smoothed : float
        At that time constant.
    """

    delay_s: float
    correlation: float
    correlation_at_zero: float
    resolution_s: float
    smoothing_s: float = 0.0
    correlation_smoothed: float = 0.0


def clock_delay(
    time_s: Floats, power_w: Floats, speed_m_s: Floats, yaw_rate_rad_s: Floats | None = None
) -> ClockEstimate | None:
    """Delay between power and motion: the lag at which their changes agree best.

    Parameters
    ----------
    time_s, power_w, speed_m_s, yaw_rate_rad_s : ndarray, shape (n,)
        One run [s, W, m/s, rad/s].

    Returns
    -------
    ClockEstimate or None
        None where the log is too short, hardly moves, or the two do not go together (correlation under 0.2).

    Notes
    -----
    A simple check: all series on an even grid, differenced (so that slow drifts do not matter); changes of power are
    regressed on those of speed, its square, what speeding up takes (v·a) and turning, at every lag within ±3 s. Without
    v·a the power of a heavy vehicle, which leads its speed, looks like a clock that is wrong. The diagnosis aligns the
    clocks by likelihood.
    """
    step = max(float(np.median(np.diff(time_s))), 0.05)
    grid = np.arange(time_s[0], time_s[-1], step)[:_MOST_SAMPLES]
    if len(grid) < _LEAST_SAMPLES:
        return None
    power = np.diff(np.interp(grid, time_s, power_w))
    causes = _causes(grid, step, time_s, speed_m_s, yaw_rate_rad_s)
    most = round(_LONGEST_S / step)
    explained = _explained(power, np.diff(causes, axis=1), most)
    if explained is None:
        return None
    lags = range(-most, most + 1)
    top = int(np.argmax(explained))
    offset = 0.0
    if 0 < top < len(lags) - 1:
        left, middle, right = explained[top - 1 : top + 2]
        bend = left - 2 * middle + right
        offset = 0.5 * (left - right) / bend if bend < 0 else 0.0
    best = float(explained[top])
    if best <= 0.2:
        return None
    smooth = [_explained(power, np.diff(_low_pass(causes, step, tau), axis=1), 0) for tau in _SMOOTHINGS_S]
    values = [0.0 if one is None else float(one[0]) for one in smooth]
    at = int(np.argmax(values))
    better = values[at] > best
    return ClockEstimate(
        float((lags[top] + offset) * step),
        best,
        float(explained[most]),
        step,
        _SMOOTHINGS_S[at] if better else 0.0,
        values[at],
    )


def _causes(grid: Floats, step: float, time_s: Floats, speed_m_s: Floats, yaw_rate_rad_s: Floats | None) -> Floats:
    """What power follows, shape (k, n): speed, its square, what speeding up takes, turning."""
    speed = np.interp(grid, time_s, speed_m_s)
    # averaged over half a second: the rate of a noisy speed is noise
    width = max(1, round(0.5 / step))
    kernel = np.ones(width) / width
    rate = np.gradient(np.convolve(speed, kernel, mode="same"), step)
    rows = [np.abs(speed), speed**2, speed * rate]
    if yaw_rate_rad_s is not None:
        rows.append(np.abs(np.interp(grid, time_s, yaw_rate_rad_s)))
    return np.array(rows)


def _low_pass(causes: Floats, step: float, tau: float) -> Floats:
    from scipy.signal import lfilter

    keep = float(np.exp(-step / tau))
    causes = causes + 1e-100  # at rest the filter would fade into denormal numbers, which processors are slow with
    start = causes[:, :1] * keep
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], causes, axis=1, zi=start)[0])


def _explained(power: Floats, causes: Floats, most: int) -> Floats | None:
    """Multiple correlation of power with causes at each lag from -most to most, shape (2 most + 1,)."""
    power = power - power.mean()
    causes = causes - causes.mean(axis=1, keepdims=True)
    scale = np.sqrt((causes**2).sum(axis=1))
    causes = causes[scale > 0] / scale[scale > 0, None]
    total = float(power @ power)
    n = len(power)
    if total <= 0 or not len(causes) or n <= 4 * most:
        return None
    gram = causes @ causes.T + 1e-3 * np.eye(len(causes))
    lags = range(-most, most + 1)
    cross = np.stack([causes[:, max(0, -k) : n - max(0, k)] @ power[max(0, k) : n + min(0, k)] for k in lags], axis=1)
    squared = np.einsum("kl,kl->l", cross, np.linalg.solve(gram, cross)) / total
    return np.asarray(np.sqrt(np.clip(squared, 0.0, 1.0)))
