"""Motion model ``linear_payload``: small robots whose motion power is linear in speed and payload.

Parasuraman et al. 2012, Eqs. 14–15: P = C_v v + C_mp m_p + C_I while moving, nothing at rest. Robots that meet slopes
may add ``grade`` (1 = the whole weight counts; the paper drove on a flat floor and has none).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.covariates import Covariates, is_moving, number
from missionsim.effects.motion_build import builder, parameters_of
from missionsim.effects.motion_models import MotionModel, register
from missionsim.physics import khepera, motion, traction

_SOURCE = "Parasuraman et al. 2012, Eqs. 14–15"


def _speed(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return khepera.motion_power(cov["speed_m_s"], per_speed_w_s_m=p["per_speed"], per_payload_w_kg=0.0, constant_w=0.0)


def _payload(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["per_payload"] * number(cov, "payload_kg") * is_moving(cov)


def _constant(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["constant"] * np.where(is_moving(cov), 1.0, 0.0)


def _lifting(cov: Covariates, p: Mapping[str, Any]) -> Any:
    watts = p["grade"] * traction.grade_force(number(cov, "slope_rad"), cov["mass_kg"]) * np.abs(cov["speed_m_s"])
    return motion.recovered_power(watts, number(cov, "drive_w"), number(cov, "regeneration"))


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "speed",
        "C_v·v",
        _SOURCE,
        "friction",
        (ParameterSpec("per_speed", "W s/m", "C_v"),),
        ("speed_m_s",),
        _speed,
        drive=True,
        covariate="speed_m_s",
    ),
    Effect(
        "payload",
        "C_mp·m_p while moving",
        _SOURCE,
        "load carried",
        (ParameterSpec("per_payload", "W/kg", "C_mp", default=0.0),),
        ("speed_m_s",),
        _payload,
        drive=True,
        covariate="payload_kg",
    ),
    Effect(
        "motor_constant",
        "C_I while moving",
        _SOURCE,
        "motors and their drivers when they turn",
        (ParameterSpec("constant", "W", "C_I", default=0.0),),
        ("speed_m_s",),
        _constant,
        drive=True,
        covariate="speed_m_s",
    ),
    Effect(
        "lifting",
        "m·g·sin θ·v",
        "Newton's second law on a slope",
        "lifting the robot",
        (ParameterSpec("grade", "1", "share of the weight that counts", default=1.0),),
        ("speed_m_s",),
        _lifting,
        drive=True,
        recovers=True,
        covariate="slope_rad",
    ),
)
"""Terms in order of evaluation."""

LINEAR_PAYLOAD = register(
    MotionModel(
        "linear_payload", "C_v·v + C_mp·m_p + C_I while moving", _SOURCE, parameters_of(EFFECTS), builder(EFFECTS)
    )
)
"""For robots of a kilogramme or so."""
