"""What the power of a robot depends on, under glossary names, as scalars or arrays, and what follows from a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels as Labels
from missionsim.physics import Array, Bools
from missionsim.physics import Value as Value
from missionsim.runs.covariates import clock_of, is_switch

Truth = bool | Bools
"""Yes or no, or an array of them."""
Covariates = Mapping[str, Any]
"""Glossary name → `Value`, or a str / `Labels` for text columns."""
Columns = dict[str, Any]
"""The same, made for one use."""
WIDTHS_S = (0.5, 1.0, 1.5, 2.0)
"""Widths over which a speed may be smoothed before it is differentiated [s], three rows at least."""
BORNE_OUT = 3.0
"""Standard deviations of their difference within which a slope bears out another."""
FEWEST_REFRESHES, EVEN = 10, 0.2
"""A speed is held where so many steps come at multiples of one time, but for this part of it and of them."""
WHEELS_TURN = 10.0
"""Times the limits of standing still from which wheels turn, and not their sensors: 3 mm/s of noise made a tenth of the
rows at rest a drive (assumed)."""
_OF_WHEELS = re.compile(r"(^|_)wheels?_(.*_)?(rad_s|m_s)$")


def is_text(value: object) -> bool:
    """Whether a covariate is text."""
    return isinstance(value, (str, Labels)) or (isinstance(value, np.ndarray) and value.dtype.kind in "OUS")


def label_equals(value: object, name: str) -> Truth:
    """Where a text covariate is `name`: bool for a str, array of bool for an array of texts or `Labels`."""
    if isinstance(value, Labels):
        return value.equals(name)
    if isinstance(value, str):
        return value == name
    return np.asarray(np.asarray(value) == name)


def number(cov: Covariates, name: str, default: float = 0.0) -> Value:
    """A numeric covariate, or `default` where it is not there."""
    value: Value | None = cov.get(name)
    return default if value is None else value


def is_clock(name: str) -> bool:
    """Whether a covariate is the time since something began."""
    return name == "moving_time_s" or name.startswith("on_time_")


def is_moving(cov: Covariates) -> Truth:
    """Whether the robot moves: it stands where |v| < 0.005 m/s and |ω| < 0.02 rad/s (contract); sideways counts as v.

    A plan says itself when the robot moves (column ``moving``), so that a ramp from rest is moving from its start.
    Where wheels are logged beside (``wheel_yaw_rad_s``, ``left_wheel_rad_s``, ``wheel_speed_m_s``), a robot whose
    wheels turn well beyond the noise of their sensors does not stand: in snow or mud a drive works hard and gets
    nowhere.
    """
    if "moving" in cov:
        return np.asarray(cov["moving"]) > 0.0
    speed = np.abs(number(cov, "speed_m_s"))
    if "lateral_speed_m_s" in cov:
        speed = np.hypot(speed, cov["lateral_speed_m_s"])
    turning = np.abs(number(cov, "yaw_rate_rad_s"))
    moving = np.asarray((speed >= STILL_SPEED_M_S) | (turning >= STILL_YAW_RATE_RAD_S))
    for name in cov:
        if _OF_WHEELS.search(name):
            least = STILL_SPEED_M_S if name.endswith("_m_s") else STILL_YAW_RATE_RAD_S
            moving = moving | (np.abs(cov[name]) >= WHEELS_TURN * least)
    return moving


def derive(columns: Covariates, time_s: Array, dt_s: Array) -> Columns:
    """Log columns with what follows from them.

    `columns`: glossary columns of one run, arrays of shape (n,). `time_s`, `dt_s` (shape (n,)): time of each row and
    the time it stands for. Gives `columns` with what they lack of ``accel_m_s2``, ``moving_time_s``, ``starts``,
    ``starts_per_s`` and ``on_time_<component>_s`` for each ``on_<component>``.
    """
    cov: Columns = dict(columns)
    if "speed_m_s" in cov:
        if "accel_m_s2" not in cov:
            cov["accel_m_s2"] = acceleration(np.asarray(cov["speed_m_s"], dtype=float), time_s)
        moving = np.asarray(is_moving(cov))
        if "moving_time_s" not in cov:
            cov["moving_time_s"] = elapsed(moving, dt_s, reset=False)
        if "starts" not in cov:
            starts = np.concatenate([[False], moving[1:] & ~moving[:-1]])
            cov["starts"] = starts.astype(float)
            cov["starts_per_s"] = starts / np.maximum(dt_s, 1e-9)
    for name in filter(is_switch, columns):
        if (clock := clock_of(name)) not in cov:
            cov[clock] = elapsed(np.asarray(cov[name], dtype=float) > 0.0, dt_s, reset=True)
    return cov


def elapsed(active: Bools, dt_s: Array, *, reset: bool) -> Array:
    """Time spent active up to the middle of each row [s], shape (n,). `active`: shape (n,); `dt_s`: shape (n,);
    `reset`: whether the clock starts again from zero at each switching on."""
    spent = np.where(active, dt_s, 0.0)
    total = np.cumsum(spent)
    middle = total - 0.5 * spent
    if not reset:
        return middle
    before = np.where(~active, total, 0.0)
    return np.where(active, middle - np.maximum.accumulate(before), 0.0)


def acceleration(speed_m_s: Array, time_s: Array, noise_m_s: float | None = None) -> Array:
    """Rate of a noisy speed [m/s²]: slope of a local least-squares line, over the longest of `WIDTHS_S` that the slopes
    over all shorter ones bear out within the noise (intersection of confidence intervals: Goldenshluger and Nemirovski
    1997), so that a cruise is smoothed and a jolt is not.

    `speed_m_s`, `time_s`: shape (n,). `noise_m_s`: standard deviation of the speed; by default that of `speed_noise`.
    """
    count = len(time_s)
    if count < 3:
        return np.gradient(speed_m_s, time_s) if count == 2 and time_s[1] > time_s[0] else np.zeros(count)
    speed_m_s = between_refreshes(speed_m_s, time_s)
    noise = speed_noise(speed_m_s) if noise_m_s is None else noise_m_s
    step = max(float(np.median(np.diff(time_s))), 1e-6)
    clock = time_s - time_s[0]
    middle = float(np.mean(clock))
    sums = [
        np.concatenate([[0.0], np.cumsum(x)])
        for x in (clock - middle, speed_m_s, (clock - middle) ** 2, (clock - middle) * speed_m_s)
    ]
    slope, borne_out = np.zeros(count), np.ones(count, dtype=bool)
    shorter: list[tuple[Array, float]] = []
    for reach in dict.fromkeys(max(1, round(0.5 * width / step)) for width in WIDTHS_S):
        first = np.maximum(np.arange(count) - reach, 0)
        last = np.minimum(np.arange(count) + reach + 1, count)
        st, sv, stt, stv = (s[last] - s[first] for s in sums)
        number = last - first
        spread = stt - st * st / number
        new = np.where(spread > 0.0, (stv - st * sv / number) / np.where(spread > 0.0, spread, 1.0), 0.0)
        rows = 2 * reach + 1
        square = 12.0 / (rows * (rows**2 - 1.0)) * (noise / step) ** 2
        for other, its in shorter:
            # the longer line is the efficient one: the variance of a difference is that of variances (Hausman 1978)
            borne_out &= np.abs(new - other) <= BORNE_OUT * np.sqrt(its - square)
        slope = np.where(borne_out, new, slope) if shorter else new
        shorter.append((new, square))
    return np.asarray(slope)


def between_refreshes(speed_m_s: Array, time_s: Array) -> Array:
    """A speed that rows repeat from a slower topic, such as a GPS, each step of it drawn out over the refresh before:
    what jumps in one row did not happen in it. Any other speed as it is, shape (n,)."""
    at = np.flatnonzero(speed_m_s[1:] != speed_m_s[:-1]) + 1
    gaps = np.diff(time_s[at])
    if len(gaps) < FEWEST_REFRESHES:
        return speed_m_s
    usual = float(np.quantile(gaps, 0.25))
    if not 1.5 * float(np.median(np.diff(time_s))) < usual <= WIDTHS_S[-1]:
        return speed_m_s
    # one that reads the same again is not seen
    if np.mean(np.abs(gaps / usual - np.rint(gaps / usual)) < EVEN) < 1.0 - EVEN:
        return speed_m_s
    before = np.maximum(time_s[at] - usual, time_s[np.concatenate([[0], at[:-1]])])
    times, values = np.stack([before, time_s[at]], axis=1), np.stack([speed_m_s[at - 1], speed_m_s[at]], axis=1)
    return np.asarray(np.interp(time_s, times.ravel(), values.ravel()))


def speed_noise(speed_m_s: Array) -> float:
    """Standard deviation of the noise of a speed [m/s], from the smaller half of its second differences, which a
    robot's own changes do not reach: their mean, since the median of a rounded speed is one of its steps."""
    if len(speed_m_s) < 50:
        return 0.0
    size = np.sort(np.abs(np.diff(speed_m_s, 2)))
    return float(np.mean(size[: len(size) // 2]) / (0.3246 * np.sqrt(6.0)))
