"""Four-wheel Mecanum robot: wheel speeds of any planar motion, friction of wheels and rollers, copper loss.

After Hou et al. 2019 (Symmetry 11, 1372), Eqs. 3–4 and 12–13 in meaning; their Eqs. 5–13 cannot be evaluated as printed
(missing values, inconsistent units), so the terms here are the textbook ones: Coulomb friction at wheels and rollers,
copper loss of the motor currents (force squared), kinetic power M a·v. Scalars or arrays everywhere.

Wheels are ordered front-left, front-right, rear-left, rear-right; x forward, y to the left, yaw anticlockwise; the
rollers stand at 45°.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array, Value, f64
from missionsim.physics.motion import grade_force

STEADY_M_S2 = 1e-9
"""Acceleration below which the control system sends no speed-up pulses."""
_SIDEWAYS = (-1.0, 1.0, 1.0, -1.0)
_TURNING = (-1.0, 1.0, -1.0, 1.0)
_FORE = (1.0, 1.0, -1.0, -1.0)


def wheel_speeds(
    speed_m_s: ArrayLike,
    lateral_speed_m_s: ArrayLike = 0.0,
    yaw_rate_rad_s: ArrayLike = 0.0,
    *,
    half_sum_m: ArrayLike = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Peripheral speeds u_i of the four wheels, m/s: u_i = v_x ∓ v_y ∓ (l_x + l_y) ω (inverse kinematics).

    Parameters
    ----------
    speed_m_s, lateral_speed_m_s, yaw_rate_rad_s : array_like
        Planar motion of the body's centre.
    half_sum_m : array_like
        l_x + l_y, half the wheelbase plus half the track, m.

    Returns
    -------
    tuple of four arrays
        Front-left, front-right, rear-left, rear-right.
    """
    forward, left = f64(speed_m_s), f64(lateral_speed_m_s)
    turning = f64(half_sum_m) * f64(yaw_rate_rad_s)
    speeds = [forward + s * left + t * turning for s, t in zip(_SIDEWAYS, _TURNING, strict=True)]
    return speeds[0], speeds[1], speeds[2], speeds[3]


def planar_kinetic_power(
    speed_m_s: Value,
    accel_m_s2: Value,
    lateral_speed_m_s: Value,
    lateral_accel_m_s2: Value,
    mass_kg: Value,
    inertia: Value = 1.0,
) -> Array:
    """Rate of the kinetic energy, W: λ M (a·v) (Hou 2019, derivative of Eq. 4, λ for what turns)."""
    along = f64(speed_m_s) * f64(accel_m_s2)
    across = f64(lateral_speed_m_s) * f64(lateral_accel_m_s2)
    return f64(inertia) * (f64(mass_kg) * (along + across))


def wheel_forces(
    speed_m_s: ArrayLike,
    lateral_speed_m_s: ArrayLike = 0.0,
    accel_m_s2: ArrayLike = 0.0,
    lateral_accel_m_s2: ArrayLike = 0.0,
    *,
    mass_kg: ArrayLike,
    wheel_friction_n: ArrayLike,
    roller_friction_n: ArrayLike = 0.0,
    grade_force_n: ArrayLike = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Force that each motor gives at its wheel's rim, N, by virtual work (the four forces times u_i are the power).

    A wheel at rest is held by static friction and has no friction force of its own; that is what makes driving at
    exactly 45° (two wheels stopped) cheaper than a degree beside it.
    """
    wheels = wheel_speeds(speed_m_s, lateral_speed_m_s)
    # what is rounding of the direction does not turn: a share of the speed, so that starts from rest stay smooth
    still = 1e-9 * np.hypot(f64(speed_m_s), f64(lateral_speed_m_s))

    def direction(speed: Array) -> Array:
        return np.sign(np.where(np.abs(speed) <= still, 0.0, speed))

    left = direction(f64(lateral_speed_m_s))
    mass = f64(mass_kg)
    along = mass * f64(accel_m_s2) + f64(grade_force_n)
    across = mass * f64(lateral_accel_m_s2)
    wheel, roller = f64(wheel_friction_n) / 4.0, f64(roller_friction_n) / 4.0
    forces = [
        wheel * direction(u) + s * np.sqrt(2.0) * roller * left + (along + s * across) / 4.0
        for u, s in zip(wheels, _SIDEWAYS, strict=True)
    ]
    return forces[0], forces[1], forces[2], forces[3]


def _loaded(force_n: ArrayLike, mass_kg: ArrayLike, payload_kg: ArrayLike) -> Array:
    """A friction force of the empty robot under the weight that it carries."""
    return f64(force_n) * (f64(mass_kg) / (f64(mass_kg) - f64(payload_kg)))


def wheels_power(
    speed_m_s: Value,
    lateral_speed_m_s: Value,
    yaw_rate_rad_s: Value,
    mass_kg: Value,
    payload_kg: Value,
    friction_n: Value,
    half_sum_m: Value,
) -> Array:
    """Power lost at the wheels' rolling contact and bearings, W: Σ f |u_i|, `friction_n` = 4 f of the empty robot;
    `mass_kg` with the payload."""
    speeds = wheel_speeds(speed_m_s, lateral_speed_m_s, yaw_rate_rad_s, half_sum_m=half_sum_m)
    total: Array = sum((np.abs(u) for u in speeds), start=np.zeros(()))
    return _loaded(friction_n, mass_kg, payload_kg) / 4.0 * total


def rollers_power(
    lateral_speed_m_s: Value,
    yaw_rate_rad_s: Value,
    mass_kg: Value,
    payload_kg: Value,
    friction_n: Value,
    half_wheelbase_m: Value,
) -> Array:
    """The same of the 45° rollers, which turn at √2 (v_y ± l_x ω); nought straight ahead."""
    left, turning = f64(lateral_speed_m_s), f64(half_wheelbase_m) * f64(yaw_rate_rad_s)
    total: Array = sum((np.abs(np.sqrt(2.0) * (left + f * turning)) for f in _FORE), start=np.zeros(()))
    return _loaded(friction_n, mass_kg, payload_kg) / 4.0 * total


def windings_power(
    speed_m_s: Value,
    lateral_speed_m_s: Value,
    accel_m_s2: Value,
    lateral_accel_m_s2: Value,
    slope_rad: Value,
    mass_kg: Value,
    payload_kg: Value,
    wheel_friction_n: Value,
    roller_friction_n: Value,
    resistance_w_n2: Value,
) -> Array:
    """Loss in the windings, W: 4 R_c Σ g_i² of the `wheel_forces` that a motion takes, frictions of the empty robot;
    straight ahead this is R_c (F + M a)² with the total force (W/N²)."""
    forces = wheel_forces(
        speed_m_s,
        lateral_speed_m_s,
        accel_m_s2,
        lateral_accel_m_s2,
        mass_kg=mass_kg,
        wheel_friction_n=_loaded(wheel_friction_n, mass_kg, payload_kg),
        roller_friction_n=_loaded(roller_friction_n, mass_kg, payload_kg),
        grade_force_n=grade_force(slope_rad, mass_kg),
    )
    total: Array = sum((g**2 for g in forces), start=np.zeros(()))
    return 4.0 * f64(resistance_w_n2) * total


def pulse_power(accel_m_s2: Value, lateral_accel_m_s2: Value, pulse_w: Value) -> Array:
    """Control power that pulses take while the speed changes (Hou 2019, section 2.2)."""
    return f64(pulse_w) * np.where(np.hypot(accel_m_s2, lateral_accel_m_s2) > STEADY_M_S2, 1.0, 0.0)


def minimum_jerk(time_s: ArrayLike, *, speed_m_s: float, duration_s: float) -> tuple[Array, Array]:
    """Speed and acceleration of a start along a minimum-jerk curve (quintic position → speed 10τ³−15τ⁴+6τ⁵).

    Parameters
    ----------
    time_s : array_like
        Time from the start, s; after `duration_s` the speed is held.
    speed_m_s, duration_s : float
        Final speed and the time to reach it.

    Returns
    -------
    tuple of arrays
        Speed (m/s) and acceleration (m/s²).
    """
    tau = np.clip(f64(time_s) / duration_s, 0.0, 1.0)
    speed = speed_m_s * tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)
    accel = speed_m_s / duration_s * 30.0 * tau**2 * (1.0 - tau) ** 2
    return speed, accel


def linear_ramp(time_s: ArrayLike, *, speed_m_s: float, duration_s: float) -> tuple[Array, Array]:
    """Speed and acceleration of a start at constant acceleration; from `duration_s` on the speed is held."""
    time = f64(time_s)
    speed = speed_m_s * np.clip(time / duration_s, 0.0, 1.0)
    accel = np.where((time >= 0.0) & (time < duration_s * (1.0 - 1e-12)), speed_m_s / duration_s, 0.0)
    return speed, accel
