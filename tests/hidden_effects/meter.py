"""The instruments of the little world: power meter, clock, encoders, and what becomes of their rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .motion import STEP_S, SURFACES, Array, Motion, Robot, smooth, wander


@dataclass(frozen=True)
class Meter:
    """Errors of the power meter in one run."""

    gain: float
    offset_w: float
    delay_s: float
    lag_s: float


def draw_meter(robot: Robot, noise_level: int, common: tuple[float, float], rng: np.random.Generator) -> Meter:
    """Draw one run's meter; ``common`` = delay and lag shared by the campaign [s] (level 3: each run its own)."""
    delay, lag = common
    if noise_level == 1:
        delay, lag = 0.0, 0.0
    elif noise_level == 3:
        delay, lag = float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0.1, 0.5))
    else:
        delay, lag = delay + float(rng.uniform(-0.05, 0.05)), lag + float(rng.uniform(-0.05, 0.05))
    return Meter(
        1.0 + 0.008 * float(rng.standard_normal()),
        robot.meter_offset_w * float(rng.standard_normal()),
        delay,
        max(lag, 0.0),
    )


def through(meter: Meter, power_w: Array) -> Array:
    """The meter's lag and clock error, without gain and offset, shape (n,)."""
    t = np.arange(len(power_w)) * STEP_S
    return np.interp(t - meter.delay_s, t, smooth(power_w, meter.lag_s))


FAST, SLOW, WHITE = 0.026, 0.012, 0.01
"""Standard deviations of the noise: AR(1) of some seconds, AR(1) of `SLOW_S`, white, as parts of the power's level."""
SLOW_S = 40.0


def level_of(seen_w: Array) -> Array:
    """What the noise is a part of [W]: louder when power is high."""
    return np.asarray(0.5 * np.mean(seen_w) + 0.5 * seen_w)


def reading(meter: Meter, power_w: Array, noise_level: int, fast_s: float, rng: np.random.Generator) -> Array:
    """What the meter shows [W]: lag, clock, gain, offset, 3 % noise (AR(1); from level 2 also slow, heavy-tailed)."""
    n, seen = len(power_w), through(meter, power_w)
    tails = None if noise_level == 1 else 5.0
    noise = FAST * wander(n, fast_s, rng, tails)
    if noise_level > 1:
        noise = noise + SLOW * wander(n, SLOW_S, rng)
    white = WHITE * np.mean(seen) * rng.standard_normal(n)
    return np.asarray(meter.gain * seen + meter.offset_w + level_of(seen) * noise + white)


def row_times(
    duration_s: float, rate_hz: float, noise_level: int, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Row times [s] (jittered by up to 15 % from level 2) and the mask of rows that survive (1 % lost, some gaps)."""
    t = (np.arange(int(duration_s * rate_hz)) + 0.5) / rate_hz
    keep = np.ones(len(t), dtype=bool)
    if noise_level > 1:
        t = t + rng.uniform(-0.15, 0.15, len(t)) / rate_hz
        keep &= rng.random(len(t)) > 0.01
        if rng.random() < 0.3:
            start = rng.uniform(0.1, 0.8) * duration_s
            keep &= (t < start) | (t > start + rng.uniform(4.0, 12.0))
    return t, keep


class Rows:
    """Averages over the time that each row stands for (half-way to its neighbours)."""

    def __init__(self, times: Array, duration_s: float) -> None:
        edges = np.concatenate([[0.0], 0.5 * (times[1:] + times[:-1]), [duration_s]])
        self.left, self.right = edges[:-1], edges[1:]
        self.times = times

    def mean(self, values: Array) -> Array:
        """Mean of a fine signal in each row's window, shape (rows,)."""
        grid = np.arange(len(values) + 1) * STEP_S
        area = np.concatenate([[0.0], np.cumsum(values) * STEP_S])
        return np.asarray(
            (np.interp(self.right, grid, area) - np.interp(self.left, grid, area)) / (self.right - self.left)
        )

    def nearest(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Value at the row's own time."""
        return values[np.clip((self.times / STEP_S).astype(int), 0, len(values) - 1)]


def log_rows(
    motion: Motion,
    robot: Robot,
    power_w: Array,
    volt: Array,
    rows: Rows,
    noise_level: int,
    columns: frozenset[str],
    power_format: str,
    rng: np.random.Generator,
) -> dict[str, NDArray[np.generic]]:
    """The log of one run in the contract's columns, before rows get lost.

    Parameters
    ----------
    columns
        Optional columns to write: accel, cpu_freq, access_point, pose.
    power_format
        'power' | 'voltage_current' | 'energy'.
    """
    n = len(rows.times)
    still = rows.mean(((np.abs(motion.speed) > 1e-3) | (np.abs(motion.yaw) > 0.01)).astype(float)) < 0.5
    tick = 0.01 * robot.speed_m_s[1] / 0.75
    speed = rows.mean(motion.speed) + np.where(still, 0.1, 1.0) * tick * rng.standard_normal(n)
    yaw = rows.mean(motion.yaw) + np.where(still, 0.2, 1.0) * 0.01 * rng.standard_normal(n)
    slope_noise = np.radians(0.2) * (0.7 * wander(len(motion.speed), 3.0, rng) + 0.7 * rng.standard_normal())
    seen = rows.mean(power_w)
    out: dict[str, NDArray[np.generic]] = {"time_s": np.round(rows.times, 3)}
    volts = np.round(rows.mean(volt) + 0.01 * rng.standard_normal(n), 3)
    if power_format == "energy":
        area = np.concatenate([[0.0], np.cumsum(power_w) * STEP_S])
        out["energy_robot_wh"] = np.round(np.interp(rows.times, np.arange(len(area)) * STEP_S, area) / 3600.0, 6)
    elif power_format == "voltage_current":
        out["current_robot_a"] = np.round(seen / volts, 4)
    else:
        quantum = robot.quantum_w * (1.0 if rng.random() < 0.5 else 10.0)
        out["power_robot_w"] = np.round(np.round(seen / quantum) * quantum, 3)
    out["speed_m_s"] = np.round(speed, 3)
    if "accel" in columns:
        inertial = rows.mean(motion.accel) + 0.01 * rng.standard_normal(n)
        out["accel_m_s2"] = np.round(np.where(np.abs(inertial) < 0.02, 0.0, inertial), 4)
    out["yaw_rate_rad_s"] = np.round(yaw, 4)
    out["slope_rad"] = np.round(rows.mean(motion.slope + slope_noise), 4)
    out["payload_kg"] = np.asarray(rows.nearest(motion.payload))
    out["surface"] = np.array(SURFACES)[np.asarray(rows.nearest(motion.surface), dtype=int)]
    out["temp_ambient_c"] = np.round(rows.mean(motion.temp) + 0.05 * rng.standard_normal(n), 2)
    out["cpu_load"] = np.round(rows.mean(motion.cpu), 3)
    if "cpu_freq" in columns:
        out["cpu_freq_hz"] = np.asarray(rows.nearest(motion.freq_hz))
    if "access_point" in columns:
        out["access_point_distance_m"] = np.round(rows.mean(motion.distance_ap_m) + 0.3 * rng.standard_normal(n), 2)
    if "pose" in columns:
        out["x_m"], out["y_m"] = np.round(rows.nearest(motion.x), 3), np.round(rows.nearest(motion.y), 3)
        out["heading_rad"] = np.round(rows.nearest(motion.heading), 4)
    out["voltage_robot_v"] = volts
    for name in sorted(motion.on):
        out[f"on_{name}"] = np.asarray(rows.nearest(motion.on[name]), dtype=np.int64)
    return out
