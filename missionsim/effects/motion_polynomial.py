"""Motion model ``polynomial``: a DC-motor drive by its speed and acceleration (Jaiem 2021, Eqs. 5–8; Tokekar 2011)."""

from __future__ import annotations

from missionsim.effects.base import ParameterSpec
from missionsim.effects.base_terms import boards_term, drive_term
from missionsim.effects.motion_models import MotionModel
from missionsim.physics import motion

_SOURCE = "Jaiem 2021, Eqs. 5–8; Tokekar 2011"
_ACCEL = ("speed_m_s", "accel_m_s2")

MODEL = MotionModel(
    "polynomial",
    "c1·a² + c2·v² + c3·v + c4 + c5·a + c6·a·v while moving, standing at rest",
    _SOURCE,
    (
        drive_term(
            "acceleration_loss",
            "c1·a²",
            (ParameterSpec("c1", "W s^4/m^2", "copper loss of acceleration", default=0.0),),
            lambda c, p: motion.acceleration_loss(c["accel_m_s2"], p["c1"]),
            needs=_ACCEL,
        ),
        drive_term(
            "viscous",
            "c2·v²",
            (ParameterSpec("c2", "W s^2/m^2", "viscous friction"),),
            lambda c, p: motion.viscous_power(c["speed_m_s"], p["c2"]),
        ),
        drive_term(
            "rolling",
            "c3·v",
            (ParameterSpec("c3", "W s/m", "rolling friction"),),
            lambda c, p: motion.rolling_power(c["speed_m_s"], p["c3"]),
        ),
        drive_term(
            "acceleration_linear",
            "c5·a",
            (ParameterSpec("c5", "W s^2/m", "linear term of acceleration", default=0.0, low=-float("inf")),),
            lambda c, p: motion.acceleration_linear(c["accel_m_s2"], p["c5"]),
            needs=_ACCEL,
            recovers=True,
        ),
        drive_term(
            "kinetic",
            "c6·a·v",
            (ParameterSpec("c6", "kg", "kinetic energy, mass over efficiency", default=0.0),),
            lambda c, p: motion.kinetic_power(c["speed_m_s"], c["accel_m_s2"], p["c6"]),
            needs=_ACCEL,
            recovers=True,
        ),
        boards_term(
            "controller",
            ParameterSpec("c4", "W", "controller boards while moving"),
            ParameterSpec("standing", "W", "controller boards at rest; c4 where not given", optional=True),
            "controller boards",
            _SOURCE,
        ),
    ),
)
"""For any robot whose power was measured against its speed."""
