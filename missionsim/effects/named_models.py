"""Models by the names that a robot file gives: of moving under ``motion: model:``, of components under ``law: model:``.

A model of moving is a tuple of terms. The one called ``id`` is the file ``motion_<id>.yaml`` here, whose terms are
written as the effects of ``library.yaml`` are, with all their `parameters`. Laws are those of ``law_models.yaml``. Both
may also come from another package by the entry point ``missionsim.effects``.

``multicore_cpu`` is an on-board computer at a clock, loaded by what it must process (rover paper, Eq. 6). Covariates:
``cpu_freq_hz`` (the highest clock where absent), and either ``cpu_load`` (measured or given) or ``speed_m_s`` and
``complexity`` (work relative to the hardest environment), from which the load follows as the time of one batch times
the rate at which batches come.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from missionsim.effects.base import Effect, Parameters, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, Value, number
from missionsim.effects.library import declarations, declared, specs_of
from missionsim.effects.model import ModelParameter, Term, TermKey
from missionsim.physics import electrical

_PREFIX = "motion_"


@dataclass(frozen=True)
class MotionModel:
    """A base model of the power of moving."""

    id: str
    equation: str
    source: str
    terms: tuple[Effect, ...]
    """In order of evaluation; parameters of the same name are one number of the robot file."""

    @property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Every parameter of the terms once, in order; those that are not required may be left out of a robot file."""
        return tuple({spec.name: spec for effect in self.terms for spec in effect.parameters}.values())

    def build(self, battery: str, parameters: Mapping[str, ModelParameter]) -> list[Term]:
        """One base term per effect. Parameters that the robot file leaves out take their defaults and are held exact; a
        term whose coefficient is left out and is nought by default is not built."""
        terms = []
        for effect in self.terms:
            if effect.coefficient.name not in parameters and not effect.coefficient.default:
                continue
            held = ("assumed", "default of the motion model")
            values = {
                spec.name: parameters.get(spec.name)
                or ModelParameter(spec.default, spec.unit, 0.0, spec.low, spec.high, *held)
                for spec in effect.parameters
                if spec.name in parameters or not spec.optional
            }
            names = {name: name for name in values}
            terms.append(Term(TermKey(battery, effect.component, effect.id), effect, values, names))
        return terms


def _own() -> tuple[str, ...]:
    found = Path(__file__).parent.glob(f"{_PREFIX}*.yaml")
    return tuple(sorted(path.stem.removeprefix(_PREFIX) for path in found))


@functools.cache
def _read(id: str) -> MotionModel:
    told = declarations(f"{_PREFIX}{id}.yaml")
    terms = tuple(declared(name, term) for name, term in told["terms"].items())
    return MotionModel(id, told["equation"], told["source"], terms)


def motion_model_ids() -> tuple[str, ...]:
    """Ids of all motion models that a robot file may name (beside ``expression`` and ``none``)."""
    return (*_own(), *sorted(plugins(MotionModel)))


def get_motion_model(id: str) -> MotionModel:
    """The motion model of an id, one of `motion_model_ids`."""
    return _read(id) if id in _own() else plugins(MotionModel)[id]


@dataclass(frozen=True)
class LawModel:
    """A law of a component: declared parameters, covariates it needs, power of one unit that is on [W]."""

    id: str
    equation: str
    parameters: tuple[ParameterSpec, ...]
    needs: tuple[str, ...]
    power: Callable[[Covariates, Parameters], Value]


def loop_time(cov: Covariates, p: Parameters) -> Value:
    """Time per batch (PLPT) [s]."""
    return electrical.loop_time(
        _given(cov, "cpu_freq_hz", p["high_freq"]),
        cov["speed_m_s"],
        _given(cov, "complexity", 1.0),
        fixed_s=p["fixed_time"],
        cycles=p["cycles"],
        cycles_per_speed=p["cycles_per_speed"],
    )


def cpu_power(cov: Covariates, p: Parameters) -> Value:
    """Power of one board that is on [W]: at ``cpu_freq_hz``, else the highest clock; its busy cores loaded with
    ``cpu_load``, else by the batches that come times the time that one takes."""
    return electrical.multicore_power(
        _given(cov, "cpu_freq_hz", p["high_freq"]),
        _given(cov, "cpu_load", electrical.utilisation(loop_time(cov, p), batch_rate_hz=p["batch_rate"])),
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


_POWERS: dict[str, Callable[[Covariates, Parameters], Value]] = {
    "multicore_cpu": cpu_power,
    "sampled_sensor": lambda cov, p: electrical.sensor_power(
        number(cov, "sensor_rate_hz", p["rate"]), per_rate_w_s=p["per_rate"], constant_w=p["constant"]
    ),
}


@functools.cache
def _own_laws() -> dict[str, LawModel]:
    return {
        id: LawModel(id, told["equation"], specs_of(told["parameters"]), tuple(told.get("needs", ())), _POWERS[id])
        for id, told in declarations("law_models.yaml").items()
    }


def law_models() -> dict[str, LawModel]:
    """Every law by its id."""
    return _own_laws() | plugins(LawModel)
