"""Small logs made in memory for the tests of the diagnosis; powers follow a formula written here, not the library."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from missionsim.labels import Labels
from missionsim.logs import LogTable


def drive(
    seed: int,
    *,
    seconds: float = 420.0,
    step_s: float = 1.0,
    scrub_w_s_rad: float = 0.0,
    noise: float = 0.02,
    run: str = "",
    **more: Any,
) -> LogTable:
    """One run of a Pioneer-like robot: random speeds, turns, stops and switching; AR noise on the power."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.5 * step_s, seconds, step_s)
    count = len(time_s)
    piece = np.repeat(np.arange(count), max(1, round(15.0 / step_s)))[:count]
    target = rng.choice([0.0, 0.2, 0.35, 0.5, 0.7], size=piece.max() + 1)[piece]
    alpha = 1.0 - np.exp(-step_s / 1.5)
    speed = np.zeros(count)
    for i in range(1, count):
        speed[i] = speed[i - 1] + alpha * (target[i] - speed[i - 1])
    speed[speed < 0.01] = 0.0
    yaw = rng.choice([0.0, 0.0, 0.4, -0.6, 0.9], size=piece.max() + 1)[np.roll(piece, 4)] * (speed > 0.0)
    kinect = rng.choice([0.0, 1.0], size=piece.max() + 1)[np.roll(piece, 7)]
    moving = (np.abs(speed) >= 0.005) | (np.abs(yaw) >= 0.02)
    power = np.where(moving, 6.25 * speed**2 + 9.79 * speed + 3.66, 2.67) + 2.34 + 2.82 * kinect
    power = power + scrub_w_s_rad * np.abs(yaw)
    error = np.zeros(count)
    keep = 0.85**step_s
    for i in range(1, count):
        error[i] = keep * error[i - 1] + rng.normal(0.0, noise * power.mean() * np.sqrt(1.0 - keep**2))
    columns: dict[str, Any] = {
        "time_s": time_s,
        "power_robot_w": power + error,
        "speed_m_s": speed,
        "yaw_rate_rad_s": yaw,
        "on_laser": np.ones(count),
        "on_kinect": kinect,
        **more,
    }
    columns = {n: Labels.of(v) if isinstance(v, list) else v for n, v in columns.items()}
    return LogTable(
        run or f"run_{seed:02d}",
        columns,
        np.full(count, step_s),
        {"robot": power + error},
        {"robot": None},
        {"robot": "power"},
    )


def drawing(log: LogTable, power_w: Any, **more: Any) -> LogTable:
    """The log of the same drive with another power, and more columns."""
    return replace(log, columns={**log.columns, "power_robot_w": power_w, **more}, power_w={"robot": power_w})
