"""Power that motion takes, what the drive relieves, and how much longer than planned a path gets.

All functions take scalars or arrays that broadcast, in SI units, and return watts where nothing else is said. The
causes of path stretch are those that Jaiem et al. 2021 name in sections 3.4.1 and 3.4.2; the paper prints no formula
for them, so these (small-angle geometry) are ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from missionsim.glossary import GRAVITY_M_S2
from missionsim.physics import Array, Value, f64


def coulomb_power(rate: Value, k: Value) -> Value:
    """Power against a constant friction, ``k |v|`` of a force (Jaiem 2021, Eq. 6, term C3 v; k in N) or ``k |ω|`` of
    tyres that scrub in a turn (k in W s/rad)."""
    return k * np.abs(rate)


def quadratic_power(value: Value, k: Value) -> Value:
    """``k x²``: friction that grows with speed (Jaiem 2021, Eq. 6, term C2 v²; k in N s/m), copper loss of the
    accelerating torque (Eq. 5, term C1 a²; W s⁴/m²), ohmic loss of converters and wiring with the load on a battery
    (1/W), a radio's sending power with the distance to its access point (W/m²)."""
    return k * np.square(value)


def drag_power(speed_m_s: Value, k: Value) -> Value:
    """Aerodynamic drag, ``k |v|³`` with ``k = ½ ρ C_d A`` (rover paper, Eqs. 1 and 5; k in kg/m)."""
    return k * np.abs(speed_m_s) ** 3


def drag_of_body(mass_kg: Value) -> Value:
    """`drag_power`'s k that air asks of a body of some mass [kg/m]: ``½ ρ C_d A``, ρ = 1.2 kg/m³.

    ``C_d A = 0.05 m² · (m / kg)^⅔``: bodies of one density and shape grow with the square of their length, and a person
    of 75 kg who stands upright has 0.9 m² (Hoerner, Fluid-Dynamic Drag, 1965: 0.5 to 0.9 m²). A car of 1300 kg with its
    0.65 m² has a tenth of that. Assumed to hold for robots too, which are as dense; those with sails are told anyway.
    """
    return 0.5 * 1.2 * 0.05 * np.abs(mass_kg) ** (2.0 / 3.0)


def air_drag_power(speed_m_s: Value, density_kg_m3: Value, drag: Value, area_m2: Value) -> Value:
    """`drag_power` with ``½ ρ C_d A`` from its parts."""
    return drag_power(speed_m_s, 0.5 * density_kg_m3 * drag * area_m2)


def tyre_power(rate: Value, mass_kg: Value, coefficient: Value) -> Value:
    """Coulomb friction under the weight: rolling resistance, ``C_r m g |v|`` (rover paper, Eq. 4), and tyres that slide
    sideways in a turn, ``l m g |ω|``, with l their friction times its lever arm."""
    return coulomb_power(rate, coefficient * (mass_kg * GRAVITY_M_S2))


def tyre_viscous_power(speed_m_s: Value, mass_kg: Value, coefficient: Value) -> Value:
    """Its part that grows with speed, ``C_v m g v²`` (rover paper, Eq. 4; C_v in s/m)."""
    return quadratic_power(speed_m_s, coefficient * (mass_kg * GRAVITY_M_S2))


def kinetic_power(speed_m_s: Value, accel_m_s2: Value, k: Value) -> Value:
    """Power into kinetic energy, ``k a v`` (Jaiem 2021, Eq. 5, term C6 a v; k in kg); negative when braking."""
    return k * accel_m_s2 * np.abs(speed_m_s)


def two_sided(power_w: Value, regeneration: Value) -> Value:
    """What a store of mechanical energy takes from a battery and gives back, ``max(P, 0) + r min(P, 0)``.

    With the efficiencies η into the store and η' out of it, P = P_mechanical/η and r = η η' (Guzzella and Sciarretta
    2013, Vehicle Propulsion Systems, section 2.2).
    """
    return np.maximum(power_w, 0.0) + regeneration * np.minimum(power_w, 0.0)


def inertial_power(speed_m_s: Value, accel_m_s2: Value, mass_kg: Value, k: Value) -> Value:
    """Power into kinetic energy, ``k m a v`` (k without unit: effective over real mass); negative when braking.
    `accel_m_s2` is the rate of the speed itself, so for a robot driving backwards ``a v`` counts, not ``a |v|``."""
    return k * mass_kg * accel_m_s2 * speed_m_s


def traction_copper_loss(
    speed_m_s: Value, accel_m_s2: Value, slope_rad: Value, mass_kg: Value, k: Value, rolling: Value
) -> Value:
    """Heat in the windings of the drive, ``k F²`` with ``F = m (a + g sin θ + C_r g)`` along the direction of travel.

    A motor's current follows its torque, so I² R follows the force squared (library effect `copper_loss`; k in W/N²,
    `rolling` is C_r).
    """
    direction = np.sign(speed_m_s)
    resisting = np.abs(direction) * GRAVITY_M_S2 * (np.sin(slope_rad) + rolling)
    return k * np.square(mass_kg * (direction * accel_m_s2 + resisting))


def grade_force(slope_rad: Value, mass_kg: Value) -> Value:
    """Component of the weight along the slope, ``m g sin θ`` in N, uphill positive."""
    return mass_kg * GRAVITY_M_S2 * np.sin(slope_rad)


def grade_power(speed_m_s: Value, slope_rad: Value, mass_kg: Value, k: Value) -> Value:
    """Lifting power ``k m g |v| sin θ``, negative downhill (library effect `grade`; k without unit). The slope is the
    one in the direction of travel, so the speed counts by its magnitude."""
    return k * grade_force(slope_rad, mass_kg) * np.abs(speed_m_s)


def lifting_power(speed_m_s: Value, lateral_speed_m_s: Value, slope_rad: Value, mass_kg: Value, k: Value) -> Value:
    """`grade_power` of a robot that may move sideways as well."""
    return grade_power(np.hypot(speed_m_s, lateral_speed_m_s), slope_rad, mass_kg, k)


def payload_power(speed_m_s: Value, payload_kg: Value, k: Value) -> Value:
    """Rolling resistance of the load carried, ``k m_payload |v|`` (library effect `payload`; k in m/s²)."""
    return k * payload_kg * np.abs(speed_m_s)


def cold_friction_power(speed_m_s: Value, moving_time_s: Value, k: Value, tau_s: Value) -> Value:
    """Friction of a cold drive that fades as it moves, ``k |v| exp(−t/τ)`` (library effect `cold_friction`; k in N)."""
    return k * np.abs(speed_m_s) * np.exp(-np.asarray(moving_time_s) / tau_s)


def temperature_friction_power(speed_m_s: Value, temp_ambient_c: Value, k: Value, reference_c: Value) -> Value:
    """Stiffer grease below a reference temperature, ``k |v| (T₀ − T)`` (`temperature_friction`; k in N/K)."""
    return k * np.abs(speed_m_s) * (reference_c - temp_ambient_c)


def recovered_power(power_w: Value, drive_w: Value, regeneration: Value) -> Value:
    """What a term that may be negative leaves on the battery, given the drive's other power.

    Going downhill or braking first relieves the drive of `drive_w`; of what is beyond, only the fraction
    `regeneration` returns to the battery and the rest is braked away.

    Parameters
    ----------
    power_w : float or ndarray
        The term, negative when it helps [W].
    drive_w : float or ndarray
        The power that the drive takes without it [W].
    regeneration : float
        Fraction of the surplus given back, 0 to 1.

    Returns
    -------
    float or ndarray
        The term's part of the battery power [W], never below ``−drive − regeneration · surplus``.
    """
    floor = -np.maximum(drive_w, 0.0)
    return np.maximum(power_w, floor) + regeneration * np.minimum(power_w - floor, 0.0)


def lost_recuperation_power(traction_w: Value, k: Value) -> Value:
    """What a drive that pushes back does not return, ``k max(−P, 0)`` (library effect `lost_recuperation`; k
    without unit, 1 where the brakes or the windings take all of it)."""
    return k * np.maximum(-traction_w, 0.0)


def relieved_part(k: Value) -> Value:
    """Part of the drive's power that lifting with the factor ``k`` can relieve on the way down.

    With ``k`` = 1/efficiency, 1 or more: all of it. A factor below 1 stands for a weight that is felt only in part, and
    the weight then takes over the drive's work in the same part (assumed).
    """
    return np.minimum(k, 1.0)


def relieved_powers(
    powers_w: Sequence[Value],
    drive_w: Value,
    regeneration: Value | Sequence[Value],
    parts: Sequence[Value] | None = None,
) -> list[Value]:
    """What several terms that may be negative leave on the battery together; see `recovered_power`.

    Braking on the way uphill first pays for the lifting: the forces add up at the wheels before the brake takes what is
    beyond, so the limit holds for the sum, whatever the order. What is braked away is taken from the negative terms in
    proportion.

    Parameters
    ----------
    powers_w : sequence of float or ndarray
        The terms, negative when they help [W].
    drive_w : float or ndarray
        The power that the drive takes without them [W].
    regeneration : float or sequence of float
        Fraction of the surplus given back, 0 to 1; of several terms, each its own, in the part it has in them.
    parts : sequence of float or ndarray, optional
        The part of `drive_w` that each term can relieve, all of it where not given.

    Returns
    -------
    list of float or ndarray
        Their parts of the battery power [W], in the same order.
    """
    parts = [1.0] * len(powers_w) if parts is None else parts
    back = list(regeneration) if isinstance(regeneration, Sequence) else [regeneration] * len(powers_w)
    if len(powers_w) == 1:
        return [recovered_power(powers_w[0], parts[0] * drive_w, back[0])]
    helping = sum((np.minimum(watts, 0.0) for watts in powers_w), start=0.0)

    def of_all(values: Sequence[Value]) -> Value:
        """One value for all terms together, each in the part that it helps."""
        if all(one is values[0] or np.all(np.asarray(one) == values[0]) for one in values):
            return values[0]
        weighed = sum((one * np.minimum(watts, 0.0) for one, watts in zip(values, powers_w, strict=True)), start=0.0)
        return np.asarray(weighed / np.where(helping < 0.0, helping, 1.0))

    part = of_all(parts)
    taken = sum((np.maximum(watts, 0.0) for watts in powers_w), start=part * np.maximum(drive_w, 0.0))
    share = recovered_power(helping, taken, of_all(back)) / np.where(helping < 0.0, helping, 1.0)
    return [np.maximum(watts, 0.0) + share * np.minimum(watts, 0.0) for watts in powers_w]


def optimal_speed(c2: Value, c4: Value, other_w: Value = 0.0) -> Value:
    """Speed of least energy per metre, ``sqrt((C4 + P_other)/C2)`` in m/s (Jaiem 2021, Eqs. 10 and 11). `other_w` is
    the constant power of what else is on while driving (sensors) [W]."""
    return np.sqrt((c4 + other_w) / c2)


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


def relocalisation_stretch(spacing_m: ArrayLike, *, drift: ArrayLike, settle_m: ArrayLike) -> Array:
    """Path stretch of a robot that drifts and is put right at markers: 1 + drift² L / (2 s).

    Between markers L apart the position drifts sideways by drift · L; back on the path within the settling length s it
    drives √(s² + (drift L)²) instead of s, about (drift L)² / (2 s) more on each L.

    Parameters
    ----------
    spacing_m : array_like
        Distance between markers, m.
    drift : array_like
        Sideways drift per metre driven.
    settle_m : array_like
        Length on which an offset is driven off, m.
    """
    offset = f64(drift) * f64(spacing_m)
    return 1.0 + offset**2 / (2.0 * f64(settle_m) * f64(spacing_m))


def centring_stretch(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> Array:
    """Path stretch in a corridor whose walls the robot follows: 1 + (π A / λ)², a sine of amplitude A and length λ."""
    return 1.0 + (np.pi * f64(amplitude_m) / f64(wavelength_m)) ** 2


def settling_stretch(
    turns: ArrayLike, distance_m: ArrayLike, *, heading_error_rad: ArrayLike, settle_m: ArrayLike
) -> Array:
    """Path stretch of headings that settle after turns: each adds s δ² / 4 (heading error fading over length s)."""
    return 1.0 + f64(turns) * f64(settle_m) * f64(heading_error_rad) ** 2 / (4.0 * f64(distance_m))
