"""Base models of moving, by the name that a robot file gives under ``motion: model:``.

A model is a tuple of terms. The one called ``id`` is the file ``motion_<id>.yaml`` here, whose terms are written as the
effects of ``library.yaml`` are, with all their `parameters`; or it comes from another package by the entry point
``missionsim.effects``.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from missionsim.effects.base import Effect, ParameterSpec, plugins
from missionsim.effects.library import declarations, declared
from missionsim.effects.model import ModelParameter, Term, TermKey
from missionsim.errors import InputError

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
            values = {
                spec.name: parameters.get(spec.name) or _default(spec)
                for spec in effect.parameters
                if spec.name in parameters or not spec.optional
            }
            names = {name: name for name in values}
            terms.append(Term(TermKey(battery, effect.component, effect.id), effect, values, names))
        return terms


def _default(spec: ParameterSpec) -> ModelParameter:
    return ModelParameter(spec.default, spec.unit, 0.0, spec.low, spec.high, "assumed", "default of the motion model")


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
    """The motion model of an id. Raises InputError: for an unknown id, with the closest one."""
    if id in _own():
        return _read(id)
    others = plugins(MotionModel)
    if id in others:
        return others[id]
    ids = motion_model_ids()
    raise InputError.unknown(f"unknown motion model '{id}'", id, ids, allowed=", ".join((*ids, "expression", "none")))
