"""Motion model ``linear_payload``: small robots whose motion power is linear in speed and payload.

Parasuraman et al. 2012, Eqs. 14–15: P = C_v v + C_mp m_p + C_I while moving, nothing at rest. Robots that meet slopes
may add ``grade`` (1 = the whole weight counts; the paper drove on a flat floor and has none).
"""

from __future__ import annotations

from missionsim.effects.base import ParameterSpec
from missionsim.effects.base_terms import LIFTING, drive_term
from missionsim.effects.covariates import number
from missionsim.effects.motion_models import MotionModel
from missionsim.physics import motion

_SOURCE = "Parasuraman et al. 2012, Eqs. 14–15"

MODEL = MotionModel(
    "linear_payload",
    "C_v·v + C_mp·m_p + C_I while moving",
    _SOURCE,
    (
        drive_term(
            "speed",
            "C_v·v",
            (ParameterSpec("per_speed", "W s/m", "C_v"),),
            lambda c, p: motion.rolling_power(c["speed_m_s"], p["per_speed"]),
            source=_SOURCE,
        ),
        drive_term(
            "payload",
            "C_mp·m_p while moving",
            (ParameterSpec("per_payload", "W/kg", "C_mp", default=0.0),),
            lambda c, p: p["per_payload"] * number(c, "payload_kg"),
            source=_SOURCE,
            covariate="payload_kg",
        ),
        drive_term(
            "motor_constant",
            "C_I while moving",
            (ParameterSpec("constant", "W", "C_I: motors and their drivers when they turn", default=0.0),),
            lambda _, p: p["constant"],
            source=_SOURCE,
        ),
        LIFTING,
    ),
)
"""For robots of a kilogramme or so."""
