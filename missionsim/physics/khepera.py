"""Small differential robots of Parasuraman et al. 2012 (Khepera III): linear motion power, energy needed, reserve.

Scalars or arrays. Equation numbers are the paper's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array, f64


def motion_power(
    speed_m_s: ArrayLike,
    payload_kg: ArrayLike = 0.0,
    *,
    per_speed_w_s_m: ArrayLike,
    per_payload_w_kg: ArrayLike,
    constant_w: ArrayLike,
) -> Array:
    """Motion power, W (Eq. 14: C_v v + C_mp m_p + C_I); nought at rest, where the motors are off. Units of the printed
    Eq. 15 are not given; m/s and kg are the only ones in which Table I's 0.8 W can be met."""
    speed = np.abs(f64(speed_m_s))
    moving = f64(per_speed_w_s_m) * speed + f64(per_payload_w_kg) * f64(payload_kg) + f64(constant_w)
    return np.where(speed > 0.0, moving, 0.0)


def sensor_power(rate_hz: ArrayLike, *, per_rate_w_s: ArrayLike, constant_w: ArrayLike) -> Array:
    """Power of a sensor that samples at a rate, W (Eq. 5: s₁ f + s₂); nought when it does not sample."""
    rate = f64(rate_hz)
    return np.where(rate > 0.0, f64(per_rate_w_s) * rate + f64(constant_w), 0.0)


def energy_needed(
    distance_m: ArrayLike,
    speed_m_s: ArrayLike,
    *,
    static_w: ArrayLike,
    motion_w: ArrayLike,
    standing_s: ArrayLike = 0.0,
) -> Array:
    """Energy of a drive, J (Eq. 12: P_static t_n + P_motion t_p, t_p = d / v, t_n = t_p + standing time)."""
    moving_s = f64(distance_m) / f64(speed_m_s)
    return f64(static_w) * (moving_s + f64(standing_s)) + f64(motion_w) * moving_s


def saving(before: ArrayLike, after: ArrayLike) -> Array:
    """Share of energy saved, %: 100 (before − after) / before."""
    first = f64(before)
    return 100.0 * (first - f64(after)) / first


def component_powers(power_w: ArrayLike, switched_on: ArrayLike) -> Array:
    """Power of each component from a switching sequence (section III.B, Fig. 2), by least squares over all samples.

    Components are switched on one after the other; each one's power is the step. Least squares over the whole record
    does the same subtraction, also where components go off again, and with every sample counted.

    Parameters
    ----------
    power_w : array_like, shape (samples,)
        Measured power, W.
    switched_on : array_like, shape (samples, components)
        Units of each component on in each sample.

    Returns
    -------
    ndarray, shape (components,)
        W per unit.

    Raises
    ------
    ValueError
        Two components are never switched apart, so the record cannot tell their powers.
    """
    design = f64(switched_on)
    values, _, rank, _ = np.linalg.lstsq(design, f64(power_w), rcond=None)
    if rank < design.shape[1]:
        raise ValueError("some components are always on or off together: switch them one by one")
    return f64(values)
