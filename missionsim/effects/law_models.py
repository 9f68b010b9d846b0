"""Laws of components by the name that a robot file gives under ``law: model:``, those of other packages too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from missionsim.effects import law_cpu
from missionsim.effects.base import ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, number
from missionsim.physics import khepera


@dataclass(frozen=True)
class LawModel:
    """A law of a component: declared parameters, covariates it needs, power of one unit that is on [W]."""

    id: str
    equation: str
    parameters: tuple[ParameterSpec, ...]
    needs: tuple[str, ...]
    power: Callable[[Covariates, Mapping[str, Any]], Any]


def _sampled(cov: Covariates, p: Mapping[str, Any]) -> Any:
    rate = number(cov, "sensor_rate_hz", p["rate"])
    return khepera.sensor_power(rate, per_rate_w_s=p["per_rate"], constant_w=p["constant"])


_OWN = (
    LawModel(
        "multicore_cpu",
        "P_board + Σ (P_idle(f) + P_work(f)·U), rover paper, Eq. 6",
        law_cpu.PARAMETERS,
        law_cpu.NEEDS,
        law_cpu.power,
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
