"""Fits to what the papers print: made here from the published data files, nothing is written down.

The robot files hold the results with status ``fitted``; a test compares them with these fits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from missionsim.physics import Array, khepera, mecanum
from missionsim.published.figures import Figure


@dataclass(frozen=True)
class StaticPowers:
    """Khepera III: powers that the paper shows only in figures, and the standing time that its savings need."""

    without_radio_w: float
    bluetooth_w: float
    wifi_w: float
    standing_s_m: float


def static_powers(figures: Mapping[str, Figure]) -> StaticPowers:
    """The one solution of four unknowns in four printed figures (savings of 73, 33, 83 % and the share of 28 %).

    Unknown are the static power without radio, Bluetooth, WiFi, and the standing time per metre of the crossing.
    Eqs. 12 and 15 link them; task A's times are printed.
    """
    from scipy.optimize import fsolve

    f = {name: figure.value for name, figure in figures.items()}
    law = {"per_speed_w_s_m": f["eq15.cv"], "per_payload_w_kg": f["eq15.cm"], "constant_w": f["eq15.ci"]}
    slow, fast, task = f["speed.min"] / 1e3, f["speed.max"] / 1e3, f["taskA.speed"] / 1e3

    def crossing(speed: float, static: float, standing: float) -> float:
        power = float(khepera.motion_power(speed, **law))
        return float(khepera.energy_needed(1.0, speed, static_w=static, motion_w=power, standing_s=standing))

    def residuals(x: Array) -> list[float]:
        plain, bluetooth, wifi, standing = (float(v) for v in x)
        moving = float(khepera.motion_power(task, **law)) * f["taskA.tp"]
        with_wifi, with_bluetooth = ((plain + radio) * f["taskA.tn"] + moving for radio in (wifi, bluetooth))
        slow_j = crossing(slow, plain + wifi, standing)
        greatest = f["table1.khepera.power"]
        return [
            float(khepera.saving(slow_j, crossing(fast, plain + wifi, standing))) - f["saving.speed"],
            float(khepera.saving(with_wifi, with_bluetooth)) - f["saving.bluetooth"],
            float(khepera.saving(slow_j, crossing(fast, plain, standing))) - f["saving.no_radio"],
            100.0 * greatest / (greatest + plain + wifi) - f["table1.khepera.share"],
        ]

    x, _, ok, message = fsolve(residuals, [1.0, 0.1, 1.0, 2.0], full_output=True)
    if ok != 1:
        raise RuntimeError(f"the four figures have no solution: {message}")
    return StaticPowers(*(float(v) for v in x))


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


def mecanum_fit(
    figures: Mapping[str, Figure], *, profile: str = "linear", duration_s: float = 0.3, mass_kg: float | None = None
) -> MecanumFit:
    """Least squares of friction, mass, copper loss, electronics and pulse to the measured columns of Tables 3 and 4.

    Motion power is (F + M a) v + R_c (F + M a)², the robot's has a constant and, while speeding up, a pulse on top.
    `figures`: of the paper. `profile`, `duration_s`: the start's speed profile and its duration; the printed speed
    column fits no mass at all. `mass_kg`: hold the mass, to see what the data say about it.
    """
    from scipy.optimize import least_squares

    times, motion_measured = table_series(figures, "3", "measured")
    _, robot_measured = table_series(figures, "4", "measured")
    top = figures["speed.max"].value
    speed, accel = PROFILES[profile](times, speed_m_s=top, duration_s=duration_s)
    moving = (speed > 0.0).astype(float)
    speeding = ((times > 0.0) & (times <= duration_s + 1e-9)).astype(float)

    def unpack(x: Array) -> Array:
        return x if mass_kg is None else np.concatenate([x[:1], [mass_kg], x[1:]])

    def model(x: Array) -> tuple[Array, Array]:
        friction, mass, copper, electronics, pulse = unpack(x)
        force = (friction + mass * accel) * moving
        motion_w = force * speed + copper * force**2
        return motion_w, motion_w + electronics * moving + pulse * speeding

    def residuals(x: Array) -> Array:
        motion_w, robot_w = model(x)
        return np.concatenate([motion_w - motion_measured, robot_w - robot_measured])[np.tile(moving, 2) > 0]

    start = np.array([17.0, 3.0, 0.01, 1.0, 1.0])
    first = start if mass_kg is None else np.delete(start, 1)
    fit = least_squares(residuals, first, bounds=(0.0, np.inf), x_scale=first, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    friction, mass, copper, electronics, pulse = (float(v) for v in unpack(fit.x))
    motion_w, robot_w = model(fit.x)
    return MecanumFit(
        friction_n=friction,
        mass_kg=mass,
        copper_w_n2=copper,
        electronics_w=electronics,
        pulse_w=pulse,
        errors={"3": errors(motion_w, motion_measured), "4": errors(robot_w, robot_measured)},
        condition=float(np.linalg.cond(fit.jac * fit.x)),
    )
