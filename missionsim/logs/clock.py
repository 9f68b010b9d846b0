"""Offset between the clock of the power meter and that of the motion, by cross-correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LONGEST_S = 3.0
_MOST_SAMPLES = 40_000


@dataclass(frozen=True)
class ClockEstimate:
    """Delay of power behind motion.

    Attributes
    ----------
    delay_s : float
        Positive: power comes later than the motion that causes it [s].
    correlation : float
        Between changes of power and changes of motion, at that delay.
    correlation_at_zero : float
    resolution_s : float
        Step of the log that limits the estimate [s].
    """

    delay_s: float
    correlation: float
    correlation_at_zero: float
    resolution_s: float


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
    A simple check: both series on an even grid, differenced (so that slow drifts do not matter), the lag of the largest
    absolute correlation within ±3 s, refined by a parabola. The diagnosis aligns the clocks by likelihood.
    """
    step = max(float(np.median(np.diff(time_s))), 0.05)
    grid = np.arange(time_s[0], time_s[-1], step)[:_MOST_SAMPLES]
    if len(grid) < 60:
        return None
    power = np.diff(np.interp(grid, time_s, power_w))
    most = round(_LONGEST_S / step)
    best: ClockEstimate | None = None
    for motion in (np.abs(speed_m_s), None if yaw_rate_rad_s is None else np.abs(yaw_rate_rad_s)):
        if motion is None:
            continue
        found = _peak(power, np.diff(np.interp(grid, time_s, motion)), most, step)
        if found is not None and (best is None or found.correlation > best.correlation):
            best = found
    return best if best is not None and best.correlation > 0.2 else None


def _peak(power: Floats, motion: Floats, most: int, step: float) -> ClockEstimate | None:
    power, motion = power - power.mean(), motion - motion.mean()
    scale = float(np.sqrt((power @ power) * (motion @ motion)))
    n = len(power)
    if scale <= 0 or n <= 4 * most:
        return None
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(power, size) * np.conj(np.fft.rfft(motion, size))
    cross = np.fft.irfft(spectrum, size)
    lags = np.arange(-most, most + 1)
    correlation = np.asarray(cross[lags] / scale)
    top = int(np.argmax(correlation))
    offset = 0.0
    if 0 < top < len(lags) - 1:
        left, middle, right = correlation[top - 1 : top + 2]
        bend = left - 2 * middle + right
        offset = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return ClockEstimate(float((lags[top] + offset) * step), float(correlation[top]), float(correlation[most]), step)
