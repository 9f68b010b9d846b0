"""Base models of moving, by the name that a robot file gives under ``motion: model:``.

A model declares its parameters and turns their values into base terms; robots of users name it in YAML.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from missionsim.effects import base_terms
from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.model import ModelParameter, Term, TermKey
from missionsim.errors import InputError, did_you_mean

Builder = Callable[[str, Mapping[str, ModelParameter]], list[Term]]


@dataclass(frozen=True)
class MotionModel:
    """A base model of the power of moving.

    Attributes
    ----------
    id, equation, source : str
    parameters : tuple of ParameterSpec
        With bounds; those whose default is not nan may be left out of a robot file.
    build : callable
        ``(battery, parameters) -> terms``.
    """

    id: str
    equation: str
    source: str
    parameters: tuple[ParameterSpec, ...]
    build: Builder

    @property
    def required(self) -> tuple[str, ...]:
        """Parameters that a robot file must give."""
        return tuple(spec.name for spec in self.parameters if spec.required)


_MODELS: dict[str, MotionModel] = {}
# modules that register models of their own, imported when a name is not known yet
_MODULES = (
    "missionsim.effects.motion_traction",
    "missionsim.effects.motion_mecanum",
    "missionsim.effects.motion_linear",
)


def register(model: MotionModel) -> MotionModel:
    """Make a motion model known under its id."""
    _MODELS[model.id] = model
    return model


def motion_model_ids() -> tuple[str, ...]:
    """Ids of all motion models that a robot file may name (beside ``expression`` and ``none``)."""
    _load()
    return tuple(sorted(_MODELS))


def get_motion_model(id: str) -> MotionModel:
    """The motion model of an id.

    Raises
    ------
    missionsim.errors.InputError
        For an unknown id, with the closest one.
    """
    if id not in _MODELS:
        _load()
    if id not in _MODELS:
        raise InputError.single(
            f"unknown motion model '{id}'",
            got=id,
            allowed=", ".join((*motion_model_ids(), "expression", "none")),
            hint=did_you_mean(id, _MODELS),
        )
    return _MODELS[id]


def _load() -> None:
    for name in _MODULES:
        if importlib.util.find_spec(name) is not None:
            importlib.import_module(name)


def single(battery: str, effect: Effect, name: str, parameter: ModelParameter, component: str = "motors") -> Term:
    """A base term with one parameter, called `name` within the battery."""
    spec = effect.coefficient.name
    return Term(TermKey(battery, component, effect.id), effect, {spec: parameter}, {spec: name})


_POLYNOMIAL_TERMS: dict[str, Effect] = {
    "c1": base_terms.ACCELERATION_LOSS,
    "c2": base_terms.VISCOUS,
    "c3": base_terms.ROLLING,
    "c5": base_terms.ACCELERATION_LINEAR,
    "c6": base_terms.KINETIC,
}


def _polynomial(battery: str, parameters: Mapping[str, ModelParameter]) -> list[Term]:
    terms = [
        single(battery, effect, name, parameters[name])
        for name, effect in _POLYNOMIAL_TERMS.items()
        if name in parameters
    ]
    levels = {"moving": parameters["c4"]} if "c4" in parameters else {}
    names = {"moving": "c4"}
    if "standing" in parameters:
        levels["standing"] = parameters["standing"]
        names["standing"] = "standing"
    if "moving" in levels:
        effect = base_terms.controller_term("standing" in levels)
        terms.append(Term(TermKey(battery, "controller", "controller"), effect, levels, names))
    return terms


POLYNOMIAL = register(
    MotionModel(
        "polynomial",
        "c1·a² + c2·v² + c3·v + c4 + c5·a + c6·a·v while moving, standing at rest",
        "Jaiem 2021, Eqs. 5–8; Tokekar 2011",
        (
            ParameterSpec("c2", "W s^2/m^2", "viscous friction"),
            ParameterSpec("c3", "W s/m", "rolling friction"),
            ParameterSpec("c4", "W", "controller boards while moving"),
            ParameterSpec("standing", "W", "controller boards at rest; c4 where not given", default=0.0),
            ParameterSpec("c1", "W s^4/m^2", "copper loss of acceleration", default=0.0),
            ParameterSpec("c5", "W s^2/m", "linear term of acceleration", default=0.0, low=-float("inf")),
            ParameterSpec("c6", "kg", "kinetic energy, mass over efficiency", default=0.0),
        ),
        _polynomial,
    )
)
