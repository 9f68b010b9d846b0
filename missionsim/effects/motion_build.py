"""Terms of a motion model whose effects share parameters by name."""

from __future__ import annotations

from collections.abc import Mapping

from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.model import ModelParameter, Term, TermKey
from missionsim.effects.motion_models import Builder


def parameters_of(effects: tuple[Effect, ...]) -> tuple[ParameterSpec, ...]:
    """Every parameter of the effects once, in order."""
    return tuple({spec.name: spec for effect in effects for spec in effect.parameters}.values())


def builder(effects: tuple[Effect, ...]) -> Builder:
    """A builder of one base term per effect.

    Parameters that the robot file leaves out take their defaults and are held exact; a term whose coefficient is left
    out and is nought by default is not built.
    """

    def build(battery: str, parameters: Mapping[str, ModelParameter]) -> list[Term]:
        terms = []
        for effect in effects:
            if effect.coefficient.name not in parameters and effect.coefficient.default == 0.0:
                continue
            values = {spec.name: parameters.get(spec.name) or _default(spec) for spec in effect.parameters}
            names = {spec.name: spec.name for spec in effect.parameters}
            terms.append(Term(TermKey(battery, effect.component, effect.id), effect, values, names))
        return terms

    return build


def _default(spec: ParameterSpec) -> ModelParameter:
    return ModelParameter(spec.default, spec.unit, 0.0, spec.low, spec.high, "assumed", "default of the motion model")
