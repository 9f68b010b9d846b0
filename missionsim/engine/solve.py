"""Two small solvers that the meter needs: a bracketed root, and steps of an ordinary differential equation."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan

ROOT_TOLERANCE_S = 1e-9


def root(function: Callable[[float], float], low: float, high: float, at_low: float, at_high: float) -> float:
    """Zero of a continuous function between two points of different sign (Illinois variant of regula falsi).

    Parameters
    ----------
    function : callable
    low, high : float
    at_low, at_high : float
        Its values there.

    Returns
    -------
    float
        Within 1e-9 of a change of sign, or as near as floating-point numbers allow.
    """
    if at_low == 0.0:
        return low
    if at_high == 0.0:
        return high
    side = 0
    for iteration in range(200):
        span = high - low
        if span <= max(ROOT_TOLERANCE_S, 4e-16 * abs(high)):
            break
        if iteration % 3 == 2:
            middle = low + 0.5 * span
        else:
            middle = (low * at_high - high * at_low) / (at_high - at_low)
            if not low < middle < high:
                middle = low + 0.5 * span
        value = function(middle)
        if value == 0.0:
            return middle
        if (value > 0.0) == (at_low > 0.0):
            low, at_low = middle, value
            if side == -1:
                at_high *= 0.5
            side = -1
        else:
            high, at_high = middle, value
            if side == 1:
                at_low *= 0.5
            side = 1
    return high


def adaptive_runge_kutta(
    slope: Callable[[float, float], float], start: float, duration: float, tolerance: float = 1e-11
) -> list[tuple[float, float]]:
    """Solution of ``dy/dt = f(t, y)`` with steps whose error is below `tolerance` each (Dormand and Prince 1980, 5(4)).

    Parameters
    ----------
    slope : callable
    start : float
        y at t = 0.
    duration : float
    tolerance : float
        Absolute, for y of the order of one.

    Returns
    -------
    list of (float, float)
        Time and value at the beginning and after each accepted step.
    """
    points = [(0.0, start)]
    if duration <= 0.0:
        return points
    t, y, step = 0.0, start, duration
    while t < duration:
        step = min(step, duration - t)
        k1 = slope(t, y)
        k2 = slope(t + step / 5, y + step * k1 / 5)
        k3 = slope(t + 3 * step / 10, y + step * (3 * k1 + 9 * k2) / 40)
        k4 = slope(t + 4 * step / 5, y + step * (44 * k1 / 45 - 56 * k2 / 15 + 32 * k3 / 9))
        k5 = slope(
            t + 8 * step / 9, y + step * (19372 * k1 / 6561 - 25360 * k2 / 2187 + 64448 * k3 / 6561 - 212 * k4 / 729)
        )
        k6 = slope(
            t + step,
            y + step * (9017 * k1 / 3168 - 355 * k2 / 33 + 46732 * k3 / 5247 + 49 * k4 / 176 - 5103 * k5 / 18656),
        )
        new = y + step * (35 * k1 / 384 + 500 * k3 / 1113 + 125 * k4 / 192 - 2187 * k5 / 6784 + 11 * k6 / 84)
        k7 = slope(t + step, new)
        error = abs(
            step * (71 * k1 / 57600 - 71 * k3 / 16695 + 71 * k4 / 1920 - 17253 * k5 / 339200 + 22 * k6 / 525 - k7 / 40)
        )
        if step <= 1e-12 * duration and not isfinite(error):  # the slope is no number here; the engine says whose
            return [*points, (duration, nan)]
        if error <= tolerance or step <= 1e-12 * duration:
            t = duration if duration - t - step <= 1e-14 * duration else t + step
            y = new
            points.append((t, y))
        step *= min(5.0, max(0.2, 0.9 * (tolerance / error) ** 0.2)) if error > 0.0 else 5.0
    return points
