"""Hou et al. 2019, four-wheel Mecanum robot: tables, fits and directions from the robot file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, mecanum
from missionsim.published.figures import Figure, Ours, load_figures, mission, run, shipped_robot

PAPER = "hou2019"
START = "mecanum4/start_straight"
TABLES = {"3": "motion", "4": "robot"}
"""Table of the start → whose power it prints."""
MOTION_TERMS = ("wheel_friction", "roller_friction", "copper_loss", "kinetic", "lifting")
"""Terms of the motion system (the paper's Table 3); the rest is control, sensors and communication (Table 4)."""


def ours() -> dict[str, Ours]:
    """What we compute for each figure, by key."""
    figures = load_figures(PAPER)
    found: dict[str, Ours] = {}
    times, _ = table_series(figures, "3", "measured")
    powers = start_powers(times)
    for table, name in TABLES.items():
        for i, time in enumerate(times):
            found[f"table{table}.t{time:.1f}.speed"] = Ours(float(powers["speed"][i]))
            found[f"table{table}.t{time:.1f}.measured"] = Ours(float(powers[name][i]))
    for key in figures:
        if key.endswith(".mean") and key.startswith("table"):
            stem = key.removesuffix(".mean")
            found[key] = Ours(0.5 * (figures[f"{stem}.front"].value + figures[f"{stem}.back"].value))
    first = [f.value for key, f in figures.items() if key.startswith(("table1.left", "table1.right"))]
    second = [f.value for key, f in figures.items() if key.startswith(("table2.left", "table2.right"))]
    found["table2.differs"] = Ours(float(sum(a != b for a, b in zip(first, second, strict=True))))
    (_, mean, most), (_, mean_robot, most_robot) = model_errors(figures)["paper"].values()
    columns = "the paper's own columns"
    found["acc.abstract"] = Ours(100.0 - max(mean, mean_robot), columns)
    found["acc.motion"] = Ours(100.0 - mean, columns)
    found["acc.motion.pointwise"] = Ours(100.0 - most, f"{columns}, worst sample")
    found["acc.robot"] = Ours(100.0 - mean_robot, columns)
    found["acc.robot.pointwise"] = Ours(100.0 - most_robot, f"{columns}, worst sample")
    line = run(START).timeline
    ramp = np.asarray(line.duration_s)[np.asarray(line.columns["accel_m_s2"]) > 0.0]
    found["time.max"] = Ours(float(np.sum(ramp)), "simulated start")
    found["wheels"] = Ours(float(len(mecanum.wheel_speeds(1.0))))
    return found | dict(_directions(figures))


def start_powers(times_s: Array) -> dict[str, Array]:
    """Speed (m/s), motion power and robot power (W) of the simulated start of Tables 3 and 4.

    The sample at an instant sees what was just before it: at the end of the ramp the control pulse still counts, while
    the motors' power is that of the speed reached (the measured power has fallen by then).
    """
    spec = mission(START)
    robot = spec.robot
    model = build_power_model(robot)
    accel, top = float(robot.body.max_acceleration or 0.0), float(spec.defaults.speed or 0.0)
    speed, rate = mecanum.linear_ramp(times_s, speed_m_s=top, duration_s=top / accel)
    pulse = (times_s > 0.0) & (times_s <= top / accel + 1e-9)
    cov = {"speed_m_s": speed, "accel_m_s2": rate, "moving": (speed > 0.0).astype(float)}
    powers = {key.name: np.asarray(watts) for key, watts in model.evaluate(cov, battery="robot")["robot"].items()}
    values = {name: p.value for name, p in model.parameters.items()}
    motion = sum((powers[name] for name in MOTION_TERMS if name in powers), start=np.zeros_like(times_s))
    return {
        "speed": speed,
        "motion": motion,
        "robot": motion + powers["electronics"] + np.where(pulse, values["robot/control_pulse"], 0.0),
    }


def model_errors(figures: Mapping[str, Figure]) -> dict[str, dict[str, tuple[float, float, float]]]:
    """RMSE (W), mean and greatest absolute error (%) by table: of the paper's own model, from its printed columns, and
    of the shipped robot file."""
    measured = {table: table_series(figures, table, "measured") for table in TABLES}
    powers = start_powers(measured["3"][0])
    made = {table: table_series(figures, table, "modelled")[1] for table in TABLES}
    return {
        model: {table: errors(watts[table], measured[table][1]) for table in TABLES}
        for model, watts in (("paper", made), ("mecanum4.yaml", {t: powers[name] for t, name in TABLES.items()}))
    }


def direction_power(angles_rad: Array, friction_ratio: float | None = None) -> Array:
    """Power (W) of the robot at its greatest speed in directions from straight ahead. `friction_ratio`: roller over
    wheel friction; that of the robot file if not given."""
    robot = shipped_robot("mecanum4")
    model = build_power_model(robot)
    values: dict[str, Any] = {}
    if friction_ratio is not None:
        values["robot/roller_friction"] = friction_ratio * model.parameters["robot/wheel_friction"].value
    speed = float(robot.body.max_speed)
    cov = {"speed_m_s": speed * np.cos(angles_rad), "lateral_speed_m_s": speed * np.sin(angles_rad)}
    return np.asarray(model.total(cov, "robot", values))


def threshold_ratio() -> float:
    """Friction ratio of rollers to wheels below which 45° takes less power than straight ahead."""
    from scipy.optimize import brentq

    def gain(ratio: float) -> float:
        power = direction_power(np.radians([0.0, 45.0]), ratio)
        return float(power[1] - power[0])

    return float(brentq(gain, 0.0, 1.0))


def _directions(figures: Mapping[str, Figure]) -> Iterator[tuple[str, Ours]]:
    step = figures["angle.step"].value
    angles = np.arange(0.0, figures["angle.range"].value + 0.5 * step, step)
    low = direction_power(np.radians(angles))
    threshold = threshold_ratio()
    parameters = build_power_model(shipped_robot("mecanum4")).parameters
    ratio = parameters["robot/roller_friction"].value / parameters["robot/wheel_friction"].value
    high = direction_power(np.radians(angles), 2.0 * threshold)
    half = angles <= 90.0
    least, least_high = (float(angles[half][int(np.argmin(power[half]))]) for power in (low, high))
    note = f"friction ratio {ratio:.2f}, below the threshold of {threshold:.3f}; above it the least is straight ahead"
    yield "angle.min", Ours(least, note)
    yield "angle.min.fig14", Ours(least, note)
    yield "angle.min.conclusion", Ours(least, f"{note} ({least_high:.0f}° at a ratio of {2 * threshold:.2f})")
    for key in ("angle.max", "angle.max.conclusion"):
        yield key, Ours(float(angles[int(np.argmax(low))]))
    mirrored = direction_power(np.radians(180.0 - angles))
    axis = 90.0 if np.allclose(low, mirrored, rtol=1e-9) else float("nan")
    yield "angle.symmetry", Ours(axis)
    yield "angle.range", Ours(float(angles[-1] - angles[0]))
    yield "angle.step", Ours(float(angles[1] - angles[0]))
    quarter = angles[half]
    same = np.allclose(direction_power(np.radians(quarter)), direction_power(np.radians(-quarter)), rtol=1e-9)
    yield "angle.within", Ours(float(quarter[-1]) if same else None)


def identifiability() -> list[dict[str, object]]:
    """Fits with different speed profiles of the start: what the data say about each parameter. Gives one row a fit,
    first the robot file's; the mass runs from one end of its range to the other at equal error."""
    rows: list[dict[str, object]] = []
    figures = load_figures(PAPER)
    top = figures["time.max"].value
    for profile, duration in (("linear", top), ("minimum_jerk", top), ("minimum_jerk", top + 0.02)):
        fit = mecanum_fit(figures, profile=profile, duration_s=duration)
        names = ("rmse_table{}_w", "mape_table{}_pct", "max_table{}_pct")
        scores = zip(names, zip(*fit.errors.values(), strict=True), strict=True)
        row: dict[str, object] = {"profile": profile, "duration_s": duration, "wheel_friction_n": fit.friction_n}
        row |= {key: getattr(fit, key) for key in ("mass_kg", "copper_w_n2", "electronics_w", "pulse_w")}
        row |= {name.format(table): v for name, both in scores for table, v in zip("34", both, strict=True)}
        rows.append({**row, "condition": fit.condition})
    return rows


@dataclass(frozen=True)
class MecanumFit:
    """A fit of the few-parameter model to Hou's Tables 3 and 4."""

    friction_n: float
    mass_kg: float
    copper_w_n2: float
    electronics_w: float
    pulse_w: float
    """These: the five fitted parameters."""
    errors: dict[str, tuple[float, float, float]]
    """By table: RMSE (W), mean and greatest absolute error (%) over the moving samples."""
    condition: float
    """Of the Jacobian scaled by the parameters: large where the data do not see some direction."""


Profile = Callable[..., tuple[Array, Array]]
PROFILES: dict[str, Profile] = {"linear": mecanum.linear_ramp, "minimum_jerk": mecanum.minimum_jerk}


def table_series(figures: Mapping[str, Figure], table: str, column: str) -> tuple[Array, Array]:
    """Times (s) and values of one column (``speed``, ``modelled``, ``measured``) of Hou's Table 3 or 4."""
    prefix, suffix = f"table{table}.t", f".{column}"
    keys = [key for key in figures if key.startswith(prefix) and key.endswith(suffix)]
    times = [float(key[len(prefix) : -len(suffix)]) for key in keys]
    return np.array(times), np.array([figures[key].value for key in keys])


def errors(model_w: Array, measured_w: Array) -> tuple[float, float, float]:
    """RMSE (W), mean and greatest absolute error (%) over the samples in which the robot moves."""
    moving = measured_w > 0.0
    miss = model_w[moving] - measured_w[moving]
    relative = 100.0 * np.abs(miss) / measured_w[moving]
    return float(np.sqrt(np.mean(miss**2))), float(np.mean(relative)), float(np.max(relative))


def mecanum_fit(figures: Mapping[str, Figure], *, profile: str = "linear", duration_s: float = 0.3) -> MecanumFit:
    """Least squares of friction, mass, copper loss, electronics and pulse to the measured columns of Tables 3 and 4.

    Motion power is (F + M a) v + R_c (F + M a)², the robot's has a constant and, while speeding up, a pulse on top.
    `figures`: of the paper. `profile`, `duration_s`: the start's speed profile and its duration; the printed speed
    column fits no mass at all.
    """
    from scipy.optimize import least_squares

    times, motion_measured = table_series(figures, "3", "measured")
    _, robot_measured = table_series(figures, "4", "measured")
    speed, accel = PROFILES[profile](times, speed_m_s=figures["speed.max"].value, duration_s=duration_s)
    moving = (speed > 0.0).astype(float)
    speeding = ((times > 0.0) & (times <= duration_s + 1e-9)).astype(float)

    def model(x: Array) -> tuple[Array, Array]:
        friction, mass, copper, electronics, pulse = x
        force = (friction + mass * accel) * moving
        motion_w = force * speed + copper * force**2
        return motion_w, motion_w + electronics * moving + pulse * speeding

    def residuals(x: Array) -> Array:
        motion_w, robot_w = model(x)
        return np.concatenate([motion_w - motion_measured, robot_w - robot_measured])[np.tile(moving, 2) > 0]

    first = np.array([17.0, 3.0, 0.01, 1.0, 1.0])
    fit = least_squares(residuals, first, bounds=(0.0, np.inf), x_scale=first, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    friction, mass, copper, electronics, pulse = map(float, fit.x)
    motion_w, robot_w = model(fit.x)
    missed = {"3": errors(motion_w, motion_measured), "4": errors(robot_w, robot_measured)}
    return MecanumFit(friction, mass, copper, electronics, pulse, missed, float(np.linalg.cond(fit.jac * fit.x)))
