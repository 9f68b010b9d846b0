"""Power of electronics: sensors, converters, processors and radios. Scalars or arrays, SI units, watts."""

from __future__ import annotations

from typing import Any

import numpy as np

Value = Any


def sonar_power(rate_hz: Value, p2: Value, p1: Value) -> Value:
    """Sonar at a recruitment rate, ``p2 f² + p1 f`` (Jaiem 2021, Eq. 12; p2 in W/Hz², p1 in W/Hz)."""
    return p2 * np.square(rate_hz) + p1 * rate_hz


def component_power(units_on: Value, k: Value) -> Value:
    """Constant power per unit that is switched on, ``k n`` (Jaiem 2021, Eq. 3; k in W)."""
    return k * units_on


def warmup_power(units_on: Value, on_time_s: Value, k: Value, tau_s: Value) -> Value:
    """Extra power after switching on that fades, ``k exp(−t/τ)`` while on (library effect `component_warmup`)."""
    return k * (np.asarray(units_on) > 0) * np.exp(-np.asarray(on_time_s) / tau_s)


def conversion_loss(load_w: Value, k: Value) -> Value:
    """Ohmic loss of converters and wiring, ``k P²`` of the load on a battery (k in 1/W)."""
    return k * np.square(load_w)


def resistance_loss(load_w: Value, voltage_v: Value, k: Value) -> Value:
    """Heat in the leads of a battery whose voltage is known, ``k (P/U)²`` of the load on it (k in ohm; Joule)."""
    return k * np.square(np.asarray(load_w) / voltage_v)


def cpu_load_power(load: Value, k: Value) -> Value:
    """Processor power that follows its load, ``k u`` (k in W at full load)."""
    return k * load


def cpu_frequency_power(load: Value, frequency_hz: Value, k: Value) -> Value:
    """Dynamic processor power, ``k u f³`` with voltage following frequency (k in W/Hz³; Jaiem 2021, section 3.2)."""
    return k * load * np.asarray(frequency_hz) ** 3


def radio_power(distance_m: Value, k: Value) -> Value:
    """Transmit power that follows the squared distance to the access point, ``k d²`` (k in W/m²)."""
    return k * np.square(distance_m)
