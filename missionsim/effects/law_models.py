"""Laws of components by the name that a robot file gives under ``law: model:``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from missionsim.effects import law_cpu
from missionsim.effects.base import ParameterSpec
from missionsim.effects.covariates import Covariates, number
from missionsim.physics import khepera


class LawModel(NamedTuple):
    """A law of a component: declared parameters, covariates it needs, power of one unit that is on [W]."""

    parameters: tuple[ParameterSpec, ...]
    needs: tuple[str, ...]
    power: Callable[[Covariates, Mapping[str, Any]], Any]


def _sampled(cov: Covariates, p: Mapping[str, Any]) -> Any:
    rate = number(cov, "sensor_rate_hz", p["rate"])
    return khepera.sensor_power(rate, per_rate_w_s=p["per_rate"], constant_w=p["constant"])


LAW_MODELS: dict[str, LawModel] = {
    "multicore_cpu": LawModel(law_cpu.PARAMETERS, law_cpu.NEEDS, law_cpu.power),
    # Parasuraman et al. 2012, Eq. 5
    "sampled_sensor": LawModel(
        (
            ParameterSpec("per_rate", "W s", "s1, energy of one sample"),
            ParameterSpec("constant", "W", "s2", default=0.0),
            ParameterSpec("rate", "Hz", "samples per second"),
        ),
        (),
        _sampled,
    ),
}
