"""Laws of components by the name that a robot file gives under ``law: model:``, those of other packages too.

``multicore_cpu`` is an on-board computer at a clock, loaded by what it must process (rover paper, Eq. 6). Covariates:
``cpu_freq_hz`` (the highest clock where absent), and either ``cpu_load`` (measured or given) or ``speed_m_s`` and
``complexity`` (work relative to the hardest environment), from which the load follows as the time of one batch times
the rate at which batches come.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from missionsim.effects.base import Parameters, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, Value, number
from missionsim.physics import electrical, khepera


@dataclass(frozen=True)
class LawModel:
    """A law of a component: declared parameters, covariates it needs, power of one unit that is on [W]."""

    id: str
    equation: str
    parameters: tuple[ParameterSpec, ...]
    needs: tuple[str, ...]
    power: Callable[[Covariates, Mapping[str, Any]], Any]


CPU_PARAMETERS: tuple[ParameterSpec, ...] = (
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


def clock(cov: Covariates, p: Parameters) -> Value:
    """Clock [Hz]: ``cpu_freq_hz`` where it is known, else the highest."""
    return _given(cov, "cpu_freq_hz", p["high_freq"])


def load(cov: Covariates, p: Parameters) -> Value:
    """Utilisation of a busy core: ``cpu_load`` where it is known, else batch rate times loop time, at most 1."""
    return _given(cov, "cpu_load", electrical.utilisation(loop_time(cov, p), batch_rate_hz=p["batch_rate"]))


def loop_time(cov: Covariates, p: Parameters) -> Value:
    """Time per batch (PLPT) [s]."""
    return electrical.loop_time(
        clock(cov, p),
        cov["speed_m_s"],
        _given(cov, "complexity", 1.0),
        fixed_s=p["fixed_time"],
        cycles=p["cycles"],
        cycles_per_speed=p["cycles_per_speed"],
    )


def cpu_power(cov: Covariates, p: Parameters) -> Value:
    """Power of one board that is on [W]."""
    return electrical.multicore_power(
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


def _sampled(cov: Covariates, p: Mapping[str, Any]) -> Any:
    rate = number(cov, "sensor_rate_hz", p["rate"])
    return khepera.sensor_power(rate, per_rate_w_s=p["per_rate"], constant_w=p["constant"])


_OWN = (
    LawModel(
        "multicore_cpu",
        "P_board + Σ (P_idle(f) + P_work(f)·U), rover paper, Eq. 6",
        CPU_PARAMETERS,
        ("speed_m_s",),
        cpu_power,
    ),
    LawModel(
        "sampled_sensor",
        "s1·f + s2, Parasuraman 2012, Eq. 5",
        (
            ParameterSpec("per_rate", "W s", "s1, energy of one sample"),
            ParameterSpec("constant", "W", "s2", default=0.0),
            ParameterSpec("rate", "Hz", "samples per second"),
        ),
        (),
        _sampled,
    ),
)


def law_models() -> dict[str, LawModel]:
    """Every law by its id."""
    return {law.id: law for law in _OWN} | plugins(LawModel)
