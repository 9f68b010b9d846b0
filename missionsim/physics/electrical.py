"""Power of electronics: sensors, converters, processors and radios. Scalars or arrays, SI units, watts.

The on-board computer that must keep up with its sensors is the rover paper's ("Simulation of Mechanical and
Computational Power Consumption in Mobile Robots"), Eqs. 6–7 and section 3. It prints Eq. 6 without any of its values;
the f·V² scaling of a core's power and the form of the loop time are assumptions named where they stand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array, Value, f64


def sonar_power(rate_hz: Value, p2: Value, p1: Value) -> Value:
    """Sonar at a recruitment rate, ``p2 f² + p1 f`` (Jaiem 2021, Eq. 12; p2 in W/Hz², p1 in W/Hz)."""
    return p2 * np.square(rate_hz) + p1 * rate_hz


def warmup_power(units_on: Value, on_time_s: Value, k: Value, tau_s: Value) -> Value:
    """Extra power after switching on that fades, ``k exp(−t/τ)`` while on (library effect `component_warmup`)."""
    return k * np.exp(-f64(on_time_s) / tau_s) * (f64(units_on) > 0)


def resistance_loss(load_w: Value, voltage_v: Value, k: Value) -> Value:
    """Heat in the leads of a battery whose voltage is known, ``k (P/U)²`` of the load on it (k in ohm; Joule)."""
    return k * np.square(np.asarray(load_w) / voltage_v)


def cpu_frequency_power(load: Value, frequency_hz: Value, k: Value) -> Value:
    """Dynamic processor power, ``k u f³`` with voltage following frequency (k in W/Hz³; Jaiem 2021, section 3.2)."""
    return k * load * np.asarray(frequency_hz) ** 3


def sensor_power(rate_hz: ArrayLike, *, per_rate_w_s: ArrayLike, constant_w: ArrayLike) -> Array:
    """Power of a sensor that samples at a rate, W (Parasuraman 2012, Eq. 5: s₁ f + s₂); nought without sampling."""
    rate = f64(rate_hz)
    return np.where(rate > 0.0, f64(per_rate_w_s) * rate + f64(constant_w), 0.0)


def multicore_power(
    freq_hz: ArrayLike,
    utilisation: ArrayLike,
    *,
    board_idle_w: ArrayLike,
    core_work_w: ArrayLike,
    core_idle_w: ArrayLike,
    core_idle_floor_w: ArrayLike,
    cores: ArrayLike,
    cores_busy: ArrayLike,
    low_hz: ArrayLike,
    high_hz: ArrayLike,
    low_v: ArrayLike,
    high_v: ArrayLike,
) -> Array:
    """Power of a multi-core board, W (rover paper, Eq. 6): P_board + Σ_i [P_idle,i(f) + P_work,i(f) U_i].

    Parameters
    ----------
    freq_hz : array_like
        Clock of all cores, Hz.
    utilisation : array_like
        U of each busy core, 0 to 1; the other cores idle.
    board_idle_w : array_like
        The board without its cores (with or without the camera, as the caller divides it), W.
    core_work_w, core_idle_w : array_like
        P_work and P_idle of one core at the highest clock, W; both scale as f V², the idle part above its floor.
    core_idle_floor_w : array_like
        Leakage of an idle core at any clock, W.
    cores, cores_busy : array_like
        Number of cores on, and of those that run the applications.
    low_hz, high_hz, low_v, high_v : array_like
        Ends of the clock range and the supply voltages there.
    """
    # f V² / (f_max V_max²), CMOS switching; the voltage goes straight between the ends of the clock range (assumed)
    share = (f64(freq_hz) - f64(low_hz)) / (f64(high_hz) - f64(low_hz))
    voltage = f64(low_v) + (f64(high_v) - f64(low_v)) * np.clip(share, 0.0, 1.0)
    scale = f64(freq_hz) * voltage**2 / (f64(high_hz) * f64(high_v) ** 2)
    floor = f64(core_idle_floor_w)
    idle = floor + (f64(core_idle_w) - floor) * scale
    work = f64(core_work_w) * scale
    return f64(board_idle_w) + f64(cores) * idle + f64(cores_busy) * work * f64(utilisation)


def loop_time(
    freq_hz: ArrayLike,
    speed_m_s: ArrayLike,
    complexity: ArrayLike,
    *,
    fixed_s: ArrayLike,
    cycles: ArrayLike,
    cycles_per_speed: ArrayLike,
) -> Array:
    """Time to process one batch of events (PLPT), s: T = T₀ + s_c (w₀ + w₁ v) / f.

    The paper says that the work rises with the speed and with the environment's complexity and falls with the clock;
    it prints no numbers. T₀ is memory-bound time that no clock shortens.

    Parameters
    ----------
    freq_hz, speed_m_s : array_like
        Clock and speed of the robot.
    complexity : array_like
        s_c, work relative to the paper's high-complexity environment (1 = high).
    fixed_s : array_like
        T₀, s.
    cycles, cycles_per_speed : array_like
        w₀ (cycles per batch) and w₁ (cycles per batch and m/s).
    """
    work = f64(cycles) + f64(cycles_per_speed) * np.abs(f64(speed_m_s))
    return f64(fixed_s) + f64(complexity) * work / f64(freq_hz)


def throughput(loop_time_s: ArrayLike, *, batch_rate_hz: ArrayLike) -> Array:
    """Batches processed per second (the quality of service): min(R, 1 / T); it saturates at the arrival rate R."""
    return np.minimum(f64(batch_rate_hz), 1.0 / f64(loop_time_s))


def utilisation(loop_time_s: ArrayLike, *, batch_rate_hz: ArrayLike) -> Array:
    """Share of the time that a busy core works: min(1, R T)."""
    return np.minimum(1.0, f64(batch_rate_hz) * f64(loop_time_s))


def energy_per_metre(power_w: ArrayLike, speed_m_s: ArrayLike) -> Array:
    """Energy per distance, J/m (rover paper, Eq. 7): (P_m(v) + P_c(f)) / v; infinite at rest."""
    speed = f64(speed_m_s)
    with np.errstate(divide="ignore"):
        return np.where(speed > 0.0, f64(power_w) / np.where(speed > 0.0, speed, 1.0), np.inf)
