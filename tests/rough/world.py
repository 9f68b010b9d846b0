"""A rough little world: robots and a car whose base formula is far from right, with formulas of its own.

Shares nothing with the library of effects: forces, converters and meters are written here anew. Each kind of world
gives runs as data frames in the columns of a measured log, so that tests drive the product as users do: calibrate a
formula of speed only, improve, compare on runs that were not used.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

G = 9.80665


@dataclass(frozen=True)
class World:
    """One kind of rough data.

    Attributes
    ----------
    truth : ids of which one must be named first; empty where nothing may be named
    mass_kg, drive : for ``calibrate --new``
    """

    truth: tuple[str, ...]
    mass_kg: float
    drive: str = "differential"


WORLDS = {
    "recuperation": World(("acceleration", "inertia"), 1500.0, "ackermann"),
    "heater": World(("logged_power:heater_w",), 1500.0, "ackermann"),
    "floors": World(("surface_rolling_resistance",), 60.0, "skid_steer"),
    "scrub": World(("turning_scrub",), 80.0, "skid_steer"),
    "cpu": World(("cpu_load",), 5.0),
    "wander": World((), 60.0, "skid_steer"),
}


def make(kind: str, seed: int, count: int = 16) -> list[pd.DataFrame]:
    """Runs of a kind, each from its own stream of the seed."""
    return [_run(kind, np.random.default_rng([seed, number]), number) for number in range(count)]


def write(kind: str, seed: int, folder: Path, count: int = 16) -> tuple[Path, Path]:
    """Three quarters of the runs as files in ``folder/train``, the rest in ``folder/heldout``."""
    runs = make(kind, seed, count)
    for name, part in (("train", runs[: 3 * count // 4]), ("heldout", runs[3 * count // 4 :])):
        (folder / name).mkdir(parents=True)
        for number, frame in enumerate(part):
            frame.to_csv(folder / name / f"{name}_{number:02d}.csv", index=False)
    return folder / "train", folder / "heldout"


def _run(kind: str, rng: np.random.Generator, number: int) -> pd.DataFrame:
    if kind in ("recuperation", "heater"):
        return _car(rng, heater=kind == "heater")
    if kind == "cpu":
        return _computer(rng)
    return _skid(rng, kind, number)


def _walk(rng: np.random.Generator, rows: int, seconds: float, step: float) -> np.ndarray:
    """A stationary random walk of unit variance with a time constant."""
    keep = np.exp(-step / seconds)
    noise = rng.standard_normal(rows) * np.sqrt(1 - keep**2)
    out = np.empty(rows)
    out[0] = rng.standard_normal()
    for i in range(1, rows):
        out[i] = keep * out[i - 1] + noise[i]
    return out


def _traffic(rng: np.random.Generator, rows: int, top: float, pull: float) -> np.ndarray:
    """Speed between stops: pull away, cruise with a driver's unrest, brake to rest [m/s], one row a second."""
    speed = np.zeros(rows)
    aim, hold = 0.0, 0
    for i in range(1, rows):
        if hold <= 0:
            aim = 0.0 if aim > 0 and rng.random() < 0.35 else top * rng.uniform(0.25, 1.0)
            hold = int(rng.uniform(8, 60))
        change = min(max(0.35 * (aim - speed[i - 1]), -1.3 * pull), pull)
        speed[i] = max(0.0, speed[i - 1] + change + 0.05 * pull * rng.standard_normal())
        if aim == 0.0 and speed[i] < 0.3 * pull:
            speed[i] = 0.0
        hold -= 1
    return speed


def _car(rng: np.random.Generator, heater: bool) -> pd.DataFrame:
    rows = int(rng.uniform(500, 1100))
    mass = 1500.0
    speed = _traffic(rng, rows, float(rng.uniform(12, 32)), 1.4)
    accel = np.gradient(speed)
    slope = 0.02 * _walk(rng, rows, 45.0, 1.0) * (speed > 1)
    force = 160.0 + 0.42 * speed**2 + mass * G * np.sin(slope) + 1.04 * mass * accel
    wheel = force * speed
    motor = np.where(wheel > 0, wheel / 0.82, 0.62 * wheel)  # a drive train that loses both ways
    ambient = rng.uniform(-8, 8) if heater else rng.uniform(15, 28)
    temperature, heat = ambient + rng.uniform(0, 4), np.zeros(rows)
    on = True
    for i in range(rows if heater else 0):
        on = temperature < 20.0 if on else temperature < 18.0
        heat[i] = 4200.0 * on if temperature < 15 else 1900.0 * on
        temperature += (heat[i] - 95.0 * (temperature - ambient)) / 60_000.0
    power = 420.0 + motor + heat + 250.0 * _walk(rng, rows, 40.0, 1.0)
    power *= 1 + 0.01 * rng.standard_normal()
    return pd.DataFrame(
        {
            "time_s": np.arange(rows) + 0.5,
            "power_robot_w": np.round(power + 120 * rng.standard_normal(rows), 0),
            "speed_m_s": np.round(np.maximum(speed + 0.03 * rng.standard_normal(rows) * (speed > 0), 0), 2),
            "accel_m_s2": np.round(accel + 0.03 * rng.standard_normal(rows), 3),
            "slope_rad": np.round(slope + 0.003 * rng.standard_normal(rows), 4),
            "temp_ambient_c": np.round(ambient + 0.2 * _walk(rng, rows, 300.0, 1.0), 1),
            **({"heater_w": np.round(heat, 0)} if heater else {}),
        }
    )


def _skid(rng: np.random.Generator, kind: str, number: int) -> pd.DataFrame:
    step, rows = 0.2, int(rng.uniform(700, 1100))
    speed = np.repeat(rng.choice([0.0, 0.3, 0.5, 0.8, 1.0], -(-rows // 40)), 40)[:rows]
    yaw = np.repeat(rng.choice([0.0, 0.0, 0.3, -0.3, 0.7, -0.7], -(-rows // 30)), 30)[:rows]
    yaw = np.where(speed > 0.9, 0.0, yaw)
    floor = ["tiles", "gravel", "mud"][number % 3]
    roll = {"tiles": 55.0, "gravel": 120.0, "mud": 210.0}[floor] if kind == "floors" else 70.0
    scrub = {"floors": 30.0, "scrub": 260.0, "wander": 25.0}[kind]
    power = 24.0 + roll * speed + 14.0 * speed**2 + scrub * np.tanh(np.abs(yaw) / 0.9)
    if kind == "floors":
        power *= 1 + 0.12 * rng.standard_normal()  # no two pieces of ground are alike
    if kind == "wander":
        power += 45.0 * np.abs(_walk(rng, rows, 25.0, step))  # an arm that nobody logged
    power += 0.0008 * power**2  # copper
    late = np.empty(rows)
    late[0] = power[0]
    for i in range(1, rows):
        late[i] = late[i - 1] + (power[i] - late[i - 1]) * (1 - np.exp(-step / 0.3))
    late += 4.0 * rng.standard_normal(rows)
    held = np.repeat(late[:: int(1 / step)], int(1 / step))[:rows]  # the topic refreshes once a second
    return pd.DataFrame(
        {
            "time_s": np.round(step * np.arange(rows), 3),
            "power_robot_w": np.round(held, 0),
            "speed_m_s": np.round(speed + 0.01 * rng.standard_normal(rows) * (speed > 0), 3),
            "yaw_rate_rad_s": np.round(yaw + 0.01 * rng.standard_normal(rows) * (yaw != 0), 3),
            "surface": floor,
            "wheel_temp_c": np.round(20 + 5 * _walk(rng, rows, 200.0, step), 1),
        }
    )


def _computer(rng: np.random.Generator) -> pd.DataFrame:
    rows = int(rng.uniform(300, 500))
    load = np.clip(
        np.repeat(rng.uniform(0.05, 0.95, -(-rows // 25)), 25)[:rows] + 0.03 * rng.standard_normal(rows), 0, 1
    )
    memory = np.clip(0.3 + 0.25 * load + 0.1 * _walk(rng, rows, 60.0, 1.0), 0, 1)
    speed = np.repeat(rng.choice([0.0, 0.1, 0.15, 0.22], -(-rows // 20)), 20)[:rows]
    power = 3.1 + 6.0 * speed + 6.5 * load + 0.15 * _walk(rng, rows, 20.0, 1.0)
    return pd.DataFrame(
        {
            "time_s": np.arange(rows, dtype=float),
            "power_robot_w": np.round(power + 0.1 * rng.standard_normal(rows), 2),
            "speed_m_s": speed,
            "cpu_load": np.round(load, 3),
            "memory_share": np.round(memory, 3),
        }
    )
