"""Newtonian traction of a wheeled robot: the forces at the wheels and the power that they need.

Every function takes scalars or arrays (NumPy broadcasting) and returns the same. Source: rover paper ("Simulation of
Mechanical and Computational Power Consumption in Mobile Robots"), Eqs. 1–5; grade and skid terms are Newton's second
law and Coulomb friction, not in that paper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from missionsim.glossary import GRAVITY_M_S2
from missionsim.physics.arrays import Array, f64
from missionsim.physics.motion import grade_force as grade_force


def acceleration_force(accel_m_s2: ArrayLike, mass_kg: ArrayLike) -> Array:
    """Force that accelerates the mass, N (rover paper, Eq. 3: F_a = m dv/dt); negative when braking."""
    return f64(mass_kg) * f64(accel_m_s2)


def rolling_force(
    speed_m_s: ArrayLike,
    mass_kg: ArrayLike,
    slope_rad: ArrayLike = 0.0,
    *,
    rolling_coefficient: ArrayLike,
    viscous_coefficient_s_m: ArrayLike = 0.0,
) -> Array:
    """Rolling friction, N (rover paper, Eq. 4: F_f = (C_r + C_v |v|) m g, times cos θ on a slope); zero at rest.

    Parameters
    ----------
    speed_m_s, mass_kg, slope_rad : array_like
        Speed (m/s, either sign), mass with payload (kg), slope of the ground (rad).
    rolling_coefficient : array_like
        C_r, dimensionless.
    viscous_coefficient_s_m : array_like
        C_v in s/m: the only unit in which the paper's Eq. 4 is consistent.
    """
    speed = np.abs(f64(speed_m_s))
    normal = f64(mass_kg) * GRAVITY_M_S2 * np.cos(f64(slope_rad))
    coefficient = f64(rolling_coefficient) + f64(viscous_coefficient_s_m) * speed
    return np.where(speed > 0.0, coefficient * normal, 0.0)


def drag_force(
    speed_m_s: ArrayLike, *, drag_coefficient: ArrayLike, frontal_area_m2: ArrayLike, air_density_kg_m3: ArrayLike = 1.2
) -> Array:
    """Aerodynamic drag, N (rover paper, Eq. 5: F_d = ½ ρ C_d A_f v²)."""
    speed = f64(speed_m_s)
    return 0.5 * f64(air_density_kg_m3) * f64(drag_coefficient) * f64(frontal_area_m2) * speed**2


def propulsive_force(
    speed_m_s: ArrayLike,
    accel_m_s2: ArrayLike = 0.0,
    slope_rad: ArrayLike = 0.0,
    *,
    mass_kg: ArrayLike,
    rolling_coefficient: ArrayLike,
    viscous_coefficient_s_m: ArrayLike = 0.0,
    drag_coefficient: ArrayLike = 0.0,
    frontal_area_m2: ArrayLike = 0.0,
    air_density_kg_m3: ArrayLike = 1.2,
) -> Array:
    """Force that the motors must give, N (rover paper, Eq. 2: F = F_a + F_f + F_d, here with the weight on a slope)."""
    return (
        acceleration_force(accel_m_s2, mass_kg)
        + rolling_force(
            speed_m_s,
            mass_kg,
            slope_rad,
            rolling_coefficient=rolling_coefficient,
            viscous_coefficient_s_m=viscous_coefficient_s_m,
        )
        + drag_force(
            speed_m_s,
            drag_coefficient=drag_coefficient,
            frontal_area_m2=frontal_area_m2,
            air_density_kg_m3=air_density_kg_m3,
        )
        + f64(grade_force(slope_rad, mass_kg))
    )


def speed_of_least_energy(constant_w: float, speeds_m_s: ArrayLike, power_w: ArrayLike) -> float:
    """Speed at which (constant + power(v)) / v is least on a grid, refined by a parabola through the three best points.

    Parameters
    ----------
    constant_w : float
        Power that runs whatever the speed, W.
    speeds_m_s, power_w : array_like, shape (n,)
        Grid of positive speeds (m/s, increasing) and the motion power at each (W).

    Returns
    -------
    float
        m/s; an end of the grid where the least lies there.
    """
    speeds = f64(speeds_m_s)
    energy = (constant_w + f64(power_w)) / speeds
    best = int(np.argmin(energy))
    if best in (0, len(speeds) - 1):
        return float(speeds[best])
    x, y = speeds[best - 1 : best + 2], energy[best - 1 : best + 2]
    curvature, slope, _ = np.polyfit(x - x[1], y, 2)
    return float(x[1] - slope / (2.0 * curvature)) if curvature > 0.0 else float(x[1])
