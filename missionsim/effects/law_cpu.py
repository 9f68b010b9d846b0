"""Law ``multicore_cpu`` of a component: an on-board computer at a clock, loaded by what it must process.

Rover paper, Eq. 6, with the loop time of `missionsim.physics.processor`. Covariates: ``cpu_freq_hz`` (the highest clock
where absent), and either ``cpu_load`` (measured or given) or ``speed_m_s`` and ``complexity`` (work relative to the
hardest environment), from which the load follows as the time of one batch times the rate at which batches come.
"""

from __future__ import annotations

import numpy as np

from missionsim.effects.base import Parameters, ParameterSpec
from missionsim.effects.covariates import Covariates, Value
from missionsim.physics import processor

PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec("board_idle", "W", "board without its cores"),
    ParameterSpec("core_work", "W", "one core fully used at the highest clock"),
    ParameterSpec("core_idle", "W", "one idle core at the highest clock", default=0.0),
    ParameterSpec("core_idle_floor", "W", "leakage of an idle core", default=0.0),
    ParameterSpec("cores", "1", "cores on", default=1.0),
    ParameterSpec("cores_busy", "1", "cores that run the applications", default=1.0),
    ParameterSpec("low_freq", "Hz", "lowest clock"),
    ParameterSpec("high_freq", "Hz", "highest clock"),
    ParameterSpec("low_voltage", "V", "core voltage at the lowest clock"),
    ParameterSpec("high_voltage", "V", "core voltage at the highest clock"),
    ParameterSpec("batch_rate", "Hz", "batches that come per second", default=0.0),
    ParameterSpec("fixed_time", "s", "time per batch that no clock shortens", default=0.0),
    ParameterSpec("cycles", "1", "cycles per batch at rest", default=0.0),
    ParameterSpec("cycles_per_speed", "s/m", "more cycles per batch and m/s", default=0.0),
)
NEEDS = ("speed_m_s",)


def clock(cov: Covariates, p: Parameters) -> Value:
    """Clock [Hz]: ``cpu_freq_hz`` where it is known, else the highest."""
    return _given(cov, "cpu_freq_hz", p["high_freq"])


def load(cov: Covariates, p: Parameters) -> Value:
    """Utilisation of a busy core: ``cpu_load`` where it is known, else batch rate times loop time, at most 1."""
    return _given(cov, "cpu_load", processor.utilisation(loop_time(cov, p), batch_rate_hz=p["batch_rate"]))


def loop_time(cov: Covariates, p: Parameters) -> Value:
    """Time per batch (PLPT) [s]."""
    return processor.loop_time(
        clock(cov, p),
        cov["speed_m_s"],
        _given(cov, "complexity", 1.0),
        fixed_s=p["fixed_time"],
        cycles=p["cycles"],
        cycles_per_speed=p["cycles_per_speed"],
    )


def power(cov: Covariates, p: Parameters) -> Value:
    """Power of one board that is on [W]."""
    return processor.multicore_power(
        clock(cov, p),
        load(cov, p),
        board_idle_w=p["board_idle"],
        core_work_w=p["core_work"],
        core_idle_w=p["core_idle"],
        core_idle_floor_w=p["core_idle_floor"],
        cores=p["cores"],
        cores_busy=p["cores_busy"],
        low_hz=p["low_freq"],
        high_hz=p["high_freq"],
        low_v=p["low_voltage"],
        high_v=p["high_voltage"],
    )


def _given(cov: Covariates, name: str, default: Value) -> Value:
    """A covariate where it is known; rows without it (not a number) take the default."""
    value = cov.get(name)
    return default if value is None else np.where(np.isnan(value), default, value)
