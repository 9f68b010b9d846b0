"""Laws of components by the name that a robot file gives under ``law: model:`` (``law_models.yaml``, other packages).

``multicore_cpu`` is an on-board computer at a clock, loaded by what it must process (rover paper, Eq. 6). Covariates:
``cpu_freq_hz`` (the highest clock where absent), and either ``cpu_load`` (measured or given) or ``speed_m_s`` and
``complexity`` (work relative to the hardest environment), from which the load follows as the time of one batch times
the rate at which batches come.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from missionsim.effects.base import Parameters, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, Value, number
from missionsim.effects.library import declarations, specs_of
from missionsim.physics import electrical, khepera


@dataclass(frozen=True)
class LawModel:
    """A law of a component: declared parameters, covariates it needs, power of one unit that is on [W]."""

    id: str
    equation: str
    parameters: tuple[ParameterSpec, ...]
    needs: tuple[str, ...]
    power: Callable[[Covariates, Parameters], Value]


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


def _sampled(cov: Covariates, p: Parameters) -> Value:
    rate = number(cov, "sensor_rate_hz", p["rate"])
    return khepera.sensor_power(rate, per_rate_w_s=p["per_rate"], constant_w=p["constant"])


_POWERS: dict[str, Callable[[Covariates, Parameters], Value]] = {"multicore_cpu": cpu_power, "sampled_sensor": _sampled}


@functools.cache
def _own() -> dict[str, LawModel]:
    return {
        id: LawModel(id, told["equation"], specs_of(told["parameters"]), tuple(told.get("needs", ())), _POWERS[id])
        for id, told in declarations("law_models.yaml").items()
    }


def law_models() -> dict[str, LawModel]:
    """Every law by its id."""
    return _own() | plugins(LawModel)
