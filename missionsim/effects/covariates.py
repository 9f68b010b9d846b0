"""What the power of a robot depends on, under glossary names, as scalars or arrays, and what follows from a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels as Labels
from missionsim.physics import Array
from missionsim.physics import Value as Value

Truth = bool | NDArray[np.bool_]
"""Yes or no, or an array of them."""
Covariates = Mapping[str, Any]
"""Glossary name → `Value`, or a str / `Labels` for text columns."""
Columns = dict[str, Any]
"""The same, made for one use."""
SMOOTHING_S = (0.5, 1.0, 1.5, 2.0)
"""Widths over which a speed is smoothed before it is differentiated: the least that its noise allows."""
_OF_WHEELS = re.compile(r"(^|_)wheels?_(.*_)?(rad_s|m_s)$")
QUIET = 0.15
"""Part of the robot's acceleration that noise may make up: what is beyond counts as speeding up, max(a, 0), all the
time."""


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


def is_moving(cov: Covariates) -> Truth:
    """Whether the robot moves: it stands where |v| < 0.005 m/s and |ω| < 0.02 rad/s (contract); sideways counts as v.

    A plan says itself when the robot moves (column ``moving``), so that a ramp from rest is moving from its start.
    Where wheels are logged beside (``wheel_yaw_rad_s``, ``left_wheel_rad_s``, ``wheel_speed_m_s``), a robot whose
    wheels turn does not stand: in snow or mud a drive works hard and gets nowhere.
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
            moving = moving | (np.abs(cov[name]) >= least)
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
    for name in [name for name in columns if name.startswith("on_") and not name.startswith("on_time_")]:
        clock = f"on_time_{name[3:]}_s"
        if clock not in cov:
            cov[clock] = elapsed(np.asarray(cov[name], dtype=float) > 0.0, dt_s, reset=True)
    return cov


def elapsed(active: NDArray[np.bool_], dt_s: Array, *, reset: bool) -> Array:
    """Time spent active up to the middle of each row [s], shape (n,). `active`: shape (n,); `dt_s`: shape (n,);
    `reset`: whether the clock starts again from zero at each switching on."""
    spent = np.where(active, dt_s, 0.0)
    total = np.cumsum(spent)
    middle = total - 0.5 * spent
    if not reset:
        return middle
    before = np.where(~active, total, 0.0)
    return np.where(active, middle - np.maximum.accumulate(before), 0.0)


def acceleration(speed_m_s: Array, time_s: Array, smoothing_s: float | None = None) -> Array:
    """Rate of a noisy speed: slope of a local least-squares line over a width or three rows [m/s²]. `speed_m_s`,
    `time_s`: shape (n,). `smoothing_s`: width; by default that of `smoothing_of`."""
    count = len(time_s)
    if count < 3:
        return np.gradient(speed_m_s, time_s) if count == 2 and time_s[1] > time_s[0] else np.zeros(count)
    width = smoothing_of(speed_m_s, time_s) if smoothing_s is None else smoothing_s
    step = float(np.median(np.diff(time_s)))
    reach = max(1, round(0.5 * width / max(step, 1e-6)))
    first = np.maximum(np.arange(count) - reach, 0)
    last = np.minimum(np.arange(count) + reach + 1, count)
    clock = time_s - time_s[0]
    middle = float(np.mean(clock))
    sums = [
        np.concatenate([[0.0], np.cumsum(x)])
        for x in (clock - middle, speed_m_s, (clock - middle) ** 2, (clock - middle) * speed_m_s)
    ]
    st, sv, stt, stv = (s[last] - s[first] for s in sums)
    number = last - first
    spread = stt - st * st / number
    return np.asarray(np.where(spread > 0.0, (stv - st * sv / number) / np.where(spread > 0.0, spread, 1.0), 0.0))


def smoothing_of(speed_m_s: Array, time_s: Array) -> float:
    """The least of `SMOOTHING_S` over which a line leaves little of the noise of a speed in its rate [s].

    The noise is that of second differences, whose median a robot's own changes of speed do not reach; its part in the
    slope of a line over n rows is σ sqrt(12 / (n (n² − 1))) per row.
    """
    if len(time_s) < 50:
        return SMOOTHING_S[0]
    step = max(float(np.median(np.diff(time_s))), 1e-6)
    bend = np.abs(np.diff(speed_m_s, 2))
    noise = float(np.median(bend)) / (0.6745 * np.sqrt(6.0))
    if not noise > 0.0:
        return SMOOTHING_S[0]

    def left(width_s: float) -> float:
        rows = 2 * max(1, round(0.5 * width_s / step)) + 1
        return float(noise * np.sqrt(12.0 / (rows * (rows**2 - 1.0))) / step)

    seen = acceleration(speed_m_s, time_s, SMOOTHING_S[-1])
    own = float(np.sqrt(max(float(np.mean(seen**2)) - left(SMOOTHING_S[-1]) ** 2, 0.0)))
    return next((width for width in SMOOTHING_S if left(width) <= QUIET * own), SMOOTHING_S[-1])
