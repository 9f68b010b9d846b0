"""Powers within intervals as functions of time, and the two solvers that the state of a battery needs."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan

import numpy as np

from missionsim.physics import Array, Ints
from missionsim.physics.lag import halving_helps

Sample = Callable[[Ints, Array], Array]
"""``(intervals (k,), seconds after their starts (k, q)) -> W (k, q)``."""
_NODES = 16
_ROUNDING = 1e-16
ROOT_TOLERANCE_S, TOLERANCE = 1e-9, 1e-11


def interpolants(sample: Sample, index: Ints, length: Array) -> dict[int, tuple[list[float], list[list[float]]]]:
    """Piecewise Chebyshev interpolants of powers, halved until their last coefficients vanish.

    `index` (shape (m,)): intervals; `length` (shape (m,)): their lengths [s]; their size is below `TOLERANCE` of
    the first then. Gives interval → (borders [s], coefficients of each piece between them; what is
    rounding at their end left out).
    """
    nodes = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    matrix = np.polynomial.chebyshev.chebvander(nodes, _NODES - 1)
    weights = np.full(_NODES, 2.0 / _NODES)
    weights[0] = 1.0 / _NODES
    low, high = np.zeros(index.size), np.asarray(length, dtype=float)
    made: list[tuple[int, float, float, list[float]]] = []
    count, depth = index.size, 0
    while index.size:
        half = 0.5 * (high - low)
        series = sample(index, (low + half)[:, None] + half[:, None] * nodes) @ matrix * weights
        size = np.abs(series).max(axis=1)
        bad = np.abs(series[:, -3:]).max(axis=1) > TOLERANCE * size
        if not halving_helps(depth, index.size, count):
            bad[:] = False
        good = np.flatnonzero(~bad)
        kept = _NODES - np.argmax(np.abs(series[good, ::-1]) > _ROUNDING * size[good, None], axis=1)
        made += [
            (int(index[i]), float(low[i]), float(high[i]), series[i, :n].tolist())
            for i, n in zip(good, kept, strict=True)
        ]
        index, middle, low, high = index[bad], (low + half)[bad], low[bad], high[bad]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        index, depth = np.concatenate([index, index]), depth + 1
    found: dict[int, tuple[list[float], list[list[float]]]] = {}
    for interval, _, end, coefficients in sorted(made, key=lambda item: item[:2]):
        borders, pieces = found.setdefault(interval, ([0.0], []))
        borders.append(end)
        pieces.append(coefficients)
    return found


def chebyshev(series: list[float], length: float) -> Callable[[float], float]:
    """Chebyshev series on [0, length] by Clenshaw's recurrence."""
    first, rest, scale = series[0], series[:0:-1], 2.0 / length

    def power(seconds: float) -> float:
        x = scale * seconds - 1.0
        ahead = further = 0.0
        for c in rest:
            ahead, further = c + 2.0 * x * ahead - further, ahead
        return first + x * ahead - further

    return power


def root(function: Callable[[float], float], low: float, high: float, at_low: float, at_high: float) -> float:
    """Zero of a continuous function between two points of different sign (Illinois variant of regula falsi).

    `at_low`, `at_high`: its values there. The result is within 1e-9 of a change of sign, or as near as floating-point
    numbers allow.
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
    slope: Callable[[float, float], float], start: float, duration: float
) -> list[tuple[float, float]]:
    """Solution of ``dy/dt = f(t, y)`` with steps whose error is below `TOLERANCE` each (Dormand and Prince 1980, 5(4)).

    `start`: y at t = 0, of the order of one. Gives time and value at the beginning and
    after each accepted step.
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
        if error <= TOLERANCE or step <= 1e-12 * duration:
            t = duration if duration - t - step <= 1e-14 * duration else t + step
            y = new
            points.append((t, y))
        step *= min(5.0, max(0.2, 0.9 * (TOLERANCE / error) ** 0.2)) if error > 0.0 else 5.0
    return points
