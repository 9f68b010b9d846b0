"""Features for the peers and the oracle: the contract's library written down once more, from a log's own columns.

This is neither the world's truth nor the product's library; it is what a user of a general tool would tabulate.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .motion import ROBOTS, Array

Log = dict[str, NDArray[Any]]
GRAVITY = 9.81


@dataclass(frozen=True)
class Table:
    """One run at 1 s: measured power, base model, gradient of the base (per unit of its parameter), library columns."""

    seconds: Array
    measured_w: Array
    base_w: Array
    base: dict[str, Array]
    library: dict[str, Array]
    covariates: dict[str, Array]


def read_log(path: Path) -> Log:
    """Read one run's CSV."""
    import pandas as pd

    frame = pd.read_csv(path)
    return {name: frame[name].to_numpy() for name in frame.columns}


def windows(time_s: Array) -> Array:
    """Time that each row stands for [s]: half-way to its neighbours, at most 2.5 times the usual step (gaps)."""
    step = np.diff(time_s)
    usual = float(np.median(step))
    left = np.concatenate([[usual], step])
    right = np.concatenate([step, [usual]])
    return np.asarray(0.5 * (np.minimum(left, 2.5 * usual) + np.minimum(right, 2.5 * usual)))


def measured_power(log: Log) -> Array:
    """Power of the battery ``robot`` [W] from whichever columns the log has."""
    if "power_robot_w" in log:
        return np.asarray(log["power_robot_w"], dtype=float)
    if "energy_robot_wh" in log:
        t, e = np.asarray(log["time_s"], dtype=float), 3600.0 * np.asarray(log["energy_robot_wh"], dtype=float)
        mid = np.concatenate([[t[0]], 0.5 * (t[1:] + t[:-1]), [t[-1]]])
        area = np.interp(mid, t, e)
        return np.asarray(np.diff(area) / np.diff(mid))
    return np.asarray(log["voltage_robot_v"] * log["current_robot_a"], dtype=float)


def seconds_of(time_s: Array) -> NDArray[np.int64]:
    """Index of the 1 s group of each row where the log is faster than 2 Hz, else of the row itself."""
    if np.median(np.diff(time_s)) < 0.5:
        return np.asarray(np.unique(np.floor(time_s), return_inverse=True)[1], dtype=np.int64)
    return np.arange(len(time_s))


def table(log: Log, robot_name: str) -> Table:
    """Tabulate one run: features at the log's rate, then averaged over 1 s where the log is faster."""
    robot = ROBOTS[robot_name]
    t = np.asarray(log["time_s"], dtype=float)
    dt = windows(t)
    n = len(t)
    v = np.abs(np.asarray(log["speed_m_s"], dtype=float))
    w = np.abs(np.asarray(log["yaw_rate_rad_s"], dtype=float))
    zeros = np.zeros(n)
    on = {name: np.asarray(log.get(f"on_{name}", zeros), dtype=float) for name in robot.components}
    moving = ((v >= 0.005) | (w >= 0.02)).astype(float)
    base = {"c2": v * v * moving, "c3": v * moving, "c4": moving, "rest": 1.0 - moving}
    base |= {f"on_{name}": units for name, units in on.items()}
    nominal = nominal_base(robot_name)
    base_w = np.asarray(sum(nominal[key] * column for key, column in base.items()))
    payload = np.asarray(log.get("payload_kg", zeros), dtype=float)
    mass = robot.mass_kg + payload
    slope = np.asarray(log.get("slope_rad", zeros), dtype=float)
    accel = np.asarray(
        log["accel_m_s2"] if "accel_m_s2" in log else np.gradient(_moving_mean(v, t, 0.5), t), dtype=float
    )
    starts = moving * np.concatenate([[1.0], 1.0 - moving[:-1]])
    driven = np.cumsum(moving * dt)
    library = {
        "grade": np.maximum(mass * GRAVITY * v * np.sin(slope), -nominal["c3"] * v),
        "payload": payload * v,
        "acceleration": mass * np.maximum(accel, 0.0) * v,
        "turning_scrub": w,
        "aerodynamic_drag": v**3,
        "start_surge": starts / dt,
        "conversion_loss": base_w**2 / np.mean(base_w),
    }
    library |= {f"cold_friction|{tau}": v * np.exp(-driven / tau) for tau in (30, 90, 300)}
    if "temp_ambient_c" in log:
        library["temperature_friction"] = v * (25.0 - np.asarray(log["temp_ambient_c"], dtype=float))
    if "surface" in log:
        names = np.asarray(log["surface"]).astype(str)
        library |= {
            f"surface_rolling_resistance|{s}": v * (names == s) for s in ("carpet", "gravel") if np.any(names == s)
        }
    for name, units in on.items():
        since = _time_since_on(units, dt)
        library |= {f"component_warmup:{name}|{tau}": units * np.exp(-since / tau) for tau in (15, 40, 120)}
    if "cpu_load" in log:
        load = np.asarray(log["cpu_load"], dtype=float)
        library["cpu_load"] = load
        if "cpu_freq_hz" in log:
            library["cpu_frequency"] = load * (np.asarray(log["cpu_freq_hz"], dtype=float) / 1e9) ** 3
    if "access_point_distance_m" in log:
        library["radio_range"] = np.asarray(log["access_point_distance_m"], dtype=float) ** 2
    raw = {k: np.asarray(x, dtype=float) for k, x in log.items() if k != "time_s" and np.asarray(x).dtype.kind in "if"}
    raw = {k: x for k, x in raw.items() if not k.startswith(("power_", "energy_", "current_"))}
    if "surface" in log:
        raw["carpet"] = (np.asarray(log["surface"]).astype(str) == "carpet").astype(float)
    group = seconds_of(t)
    weight = np.bincount(group, dt)

    def mean(x: Array) -> Array:
        return np.asarray(np.bincount(group, x * dt) / weight)

    def means(columns: dict[str, Array]) -> dict[str, Array]:
        return {key: mean(np.asarray(x, dtype=float)) for key, x in columns.items()}

    return Table(weight, mean(measured_power(log)), mean(base_w), means(base), means(library), means(raw))


def nominal_base(robot_name: str) -> dict[str, float]:
    """Base parameters as the user has them."""
    robot = ROBOTS[robot_name]
    parts = {f"on_{name}": power for name, power in robot.components.items()}
    return {"c2": robot.c2, "c3": robot.c3, "c4": robot.c4, "rest": robot.rest_w} | parts


def effect_of(column: str) -> str:
    """Effect id of a column name; a base column belongs to its calibration twin."""
    twins = {"c2": "viscous_friction", "c3": "rolling_friction", "c4": "standby_load", "rest": "standby_load"}
    if column.startswith("on_"):
        return f"component_power:{column[3:]}"
    return twins.get(column, column.split("|")[0])


def _moving_mean(x: Array, t: Array, seconds: float) -> Array:
    width = max(1, round(seconds / float(np.median(np.diff(t)))))
    return np.convolve(
        np.pad(x, (width // 2, width - 1 - width // 2), mode="edge"), np.ones(width) / width, mode="valid"
    )


def _time_since_on(units: Array, dt: Array) -> Array:
    """Time since the last switch-on [s], shape (n,)."""
    clock = np.cumsum(dt)
    switched = (units > 0) & np.concatenate([[True], units[:-1] == 0])
    return np.asarray(clock - np.maximum.accumulate(np.where(switched, clock, clock[0])))
