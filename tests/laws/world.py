"""Robots with a law that no library holds: motion, meter and base of the little world, formulas of its own.

Nothing here comes from the package under test.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.hidden_effects.meter import Rows, draw_meter, log_rows, reading, row_times
from tests.hidden_effects.motion import ROBOTS, Array, Motion, Robot, design_runs, levels, smooth
from tests.hidden_effects.plant import base_power, draw_world, voltage
from tests.hidden_effects.track import drive
from tests.hidden_effects.world import Log, write_csv

State = Mapping[str, Array]
MEMORY = frozenset({"duty_heater", "hysteresis", "fan_memory"})
"""Laws with a state of their own, which no curve over logged quantities can hold."""


@dataclass(frozen=True)
class Law:
    """A hidden law: the logged quantities it depends on, and its form (coefficient 1) over them."""

    variables: tuple[str, ...]
    form: Callable[[State], Array]


def _still(s: State) -> Array:
    return ((np.abs(s["speed_m_s"]) < 0.005) & (np.abs(s["yaw_rate_rad_s"]) < 0.02)).astype(float)


def _v(s: State) -> Array:
    return np.abs(s["speed_m_s"])


def _w(s: State) -> Array:
    return np.abs(s["yaw_rate_rad_s"])


LAWS: dict[str, Law] = {
    "v_w_m": Law(("speed_m_s", "yaw_rate_rad_s", "payload_kg"), lambda s: _v(s) * _w(s) * s["payload_kg"]),
    "v_w": Law(("speed_m_s", "yaw_rate_rad_s"), lambda s: _v(s) * _w(s)),
    "rest_payload": Law(("payload_kg", "speed_m_s"), lambda s: _still(s) * s["payload_kg"]),
    "braking": Law(("accel_m_s2", "speed_m_s"), lambda s: _v(s) * np.maximum(-s["accel_m_s2"], 0.0)),
    "cpu_v": Law(("cpu_load", "speed_m_s"), lambda s: s["cpu_load"] * _v(s)),
    "heater": Law(("temp_ambient_c",), lambda s: np.maximum(18.0 - s["temp_ambient_c"], 0.0)),
    "stribeck": Law(("speed_m_s",), lambda s: (1 - _still(s)) * np.exp(-_v(s) / 0.12)),
    "dead_zone": Law(("yaw_rate_rad_s",), lambda s: np.maximum(_w(s) - 0.5, 0.0)),
    "slope_turn": Law(("slope_rad", "yaw_rate_rad_s"), lambda s: np.abs(s["slope_rad"]) * _w(s)),
    "camera_driving": Law(("on_kinect", "speed_m_s"), lambda s: s["on_kinect"] * (_v(s) > 0.02)),
    "camera_hot": Law(
        ("on_kinect", "temp_ambient_c"), lambda s: s["on_kinect"] * np.maximum(s["temp_ambient_c"] - 17.0, 0.0)
    ),
    "carpet_payload": Law(
        ("surface", "payload_kg", "speed_m_s"), lambda s: s["carpet"] * s["payload_kg"] * np.tanh(_v(s) / 0.2)
    ),
    "tyre_time": Law(("time_s", "speed_m_s"), lambda s: s["time_s"] * _v(s)),
    "v2_m": Law(("payload_kg", "speed_m_s"), lambda s: s["payload_kg"] * _v(s) ** 2),
    "arm": Law(("arm_torque",), lambda s: np.abs(s["arm_torque"]) ** 1.5),
    "arm_v": Law(("arm_torque", "speed_m_s"), lambda s: s["arm_torque"] * _v(s)),
    "turn_saturates": Law(("yaw_rate_rad_s", "payload_kg"), lambda s: np.tanh(_w(s) / 0.25) * s["payload_kg"]),
    "cpu_turn": Law(("cpu_load", "yaw_rate_rad_s"), lambda s: s["cpu_load"] * _w(s)),
    "duty_heater": Law(("time_s",), lambda s: s["duty"]),
    "hysteresis": Law(("speed_m_s",), lambda s: s["peak"]),
}


@dataclass(frozen=True)
class Made:
    """A made case: logs of training and held-out runs, the law's strength, its true power at the rows of each run."""

    train: dict[str, Log]
    heldout: dict[str, Log]
    strength: float
    truth_w: dict[str, Array]
    power_w: dict[str, Array]
    """True power at the rows of each run, without the meter's noise, delay and lag: errors are told at clocks as
    logged, so that a model that knows the truth leaves the meter's."""

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Both folders of CSV files."""
        for kind, logs in (("train", self.train), ("heldout", self.heldout)):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            for run, log in logs.items():
                write_csv(log, folder / kind / f"{run}.csv")
        return folder / "train", folder / "heldout"


def make(
    law: str | None,
    seed: int,
    share: float = 0.05,
    *,
    robot: str = "pioneer3dx",
    runs: int = 10,
    heldout: int = 4,
    duration_s: float = 420.0,
    rate_hz: float = 1.0,
) -> Made:
    """Logs of a robot in which a law takes ``share`` of the energy; ``law=None`` hides nothing."""
    body = ROBOTS[robot]
    root = np.random.SeedSequence([seed, zlib.crc32(f"laws {law}".encode()), runs])
    world_seed, design_seed, *seeds = root.spawn(2 + runs + heldout)
    rng = np.random.default_rng(world_seed)
    draw = draw_world(body, 2, rng)
    common = (float(rng.uniform(-0.2, 0.25)), float(rng.uniform(0.1, 0.4)))
    rng = np.random.default_rng(design_seed)
    plans = design_runs("rich", body, runs + heldout, duration_s, rng)
    prepared = []
    for plan, seq in zip(plans, seeds, strict=True):
        rng = np.random.default_rng(seq)
        motion = drive(body, replace(plan, duration_s=duration_s), rng)
        state = state_of(motion, rng)
        meter = draw_meter(body, 2, common, rng)
        base_w = base_power(motion, body, draw)
        unit = np.zeros_like(base_w) if law is None else np.asarray(LAWS[law].form(state), dtype=float)
        prepared.append((motion, state, meter, base_w, smooth(unit, 0.15), voltage(motion, body, base_w, 0.9), rng))
    strength = 0.0
    if law is not None:
        unit_mean = float(np.mean([np.mean(np.abs(p[4])) for p in prepared[:runs]]))
        strength = share / (1 - share) * float(np.mean([np.mean(p[3]) for p in prepared[:runs]])) / unit_mean
    names = [f"run_{i:02d}" for i in range(runs)] + [f"held_{i:02d}" for i in range(heldout)]
    logs, truth, clean = {}, {}, {}
    for name, part in zip(names, prepared, strict=True):
        logs[name], truth[name], clean[name] = _record(part, strength, body, rate_hz)
    return Made({n: logs[n] for n in names[:runs]}, {n: logs[n] for n in names[runs:]}, strength, truth, clean)


def state_of(motion: Motion, rng: np.random.Generator) -> dict[str, Array]:
    """True quantities of a run under the names of its log; an arm's torque that only this world has."""
    t = motion.time_s
    torque = smooth(levels(t, 8.0, 30.0, 5, rng).astype(float) * 1.5, 0.5)
    peak, held = np.zeros_like(t), 0.0
    for i, speed in enumerate(np.abs(motion.speed).tolist()):
        held = max(speed, held * 0.998)
        peak[i] = max(held - speed, 0.0)
    phase, period = rng.uniform(0, 90.0), rng.uniform(70.0, 110.0)
    state = {
        "speed_m_s": motion.speed,
        "yaw_rate_rad_s": motion.yaw,
        "accel_m_s2": motion.accel,
        "slope_rad": motion.slope,
        "payload_kg": motion.payload,
        "temp_ambient_c": motion.temp,
        "cpu_load": motion.cpu,
        "time_s": t,
        "carpet": (motion.surface == 1).astype(float),
        "arm_torque": torque,
        "peak": peak,
        "duty": ((t + phase) % period < 0.45 * period).astype(float),
    }
    return state | {f"on_{name}": on for name, on in motion.on.items()}


def _record(part: tuple, strength: float, body: Robot, rate_hz: float) -> tuple[Log, Array, Array]:
    from tests.hidden_effects.meter import through

    motion, state, meter, base_w, unit, volt, rng = part
    duration = len(base_w) * 0.1
    times, keep = row_times(duration, rate_hz, 2, rng)
    rows = Rows(times, duration)
    total = base_w + strength * unit
    shown = reading(meter, total, 2, float(rng.uniform(1.0, 4.0)), rng)
    columns = frozenset({"accel", "cpu_freq", "access_point"})
    log = log_rows(motion, body, shown, volt, rows, 2, columns, "power", rng)
    log["arm_torque"] = np.round(rows.mean(state["arm_torque"]) + 0.02 * rng.standard_normal(len(times)), 3)
    truth = rows.mean(through(meter, strength * unit))
    clean = rows.mean(total)
    return {k: v[keep] for k, v in log.items()}, truth[keep], clean[keep]
