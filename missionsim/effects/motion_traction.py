"""Motion model ``traction``: Newton's second law at the wheels, for any wheeled robot (rover paper, Eqs. 1–5).

Also for skid-steered robots, whose tyres scrub sideways in turns (``scrub_moment``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from missionsim.effects.base import Effect, Parameters, ParameterSpec
from missionsim.effects.base_terms import LIFTING, boards_term, drive_term, lifting_power
from missionsim.effects.covariates import Covariates, number
from missionsim.effects.motion_models import MotionModel
from missionsim.glossary import GRAVITY_M_S2
from missionsim.physics import motion

_SOURCE = "rover paper, Eqs. 1–5"
_EFFICIENCY = ParameterSpec("efficiency", "1", "of the drive, battery to wheel", default=1.0, low=0.01, high=1.0)


def _at_wheels(
    id: str,
    equation: str,
    parameters: tuple[ParameterSpec, ...],
    power: Callable[[Covariates, Parameters], Any],
    *,
    recovers: bool = False,
    source: str = _SOURCE,
) -> Effect:
    """A term of mechanical power at the wheels, which the drive's efficiency turns into that of the battery."""
    return drive_term(
        id,
        equation,
        (*parameters, _EFFICIENCY),
        lambda cov, p: power(cov, p) / p["efficiency"],
        recovers=recovers,
        source=source,
    )


def _weight(cov: Covariates) -> Any:
    # the normal force as on level ground (Eq. 4): cos θ would make a round trip over a hill cheaper than a flat one
    return cov["mass_kg"] * GRAVITY_M_S2


def _drag(cov: Covariates, p: Parameters) -> Any:
    k = motion.drag_coefficient(p["air_density"], p["drag_coefficient"], p["frontal_area"])
    return motion.drag_power(cov["speed_m_s"], k)


def _inertia(cov: Covariates, p: Parameters) -> Any:
    return p["inertia"] * cov["mass_kg"] * number(cov, "accel_m_s2") * cov["speed_m_s"]


MODEL = MotionModel(
    "traction",
    "F·v, F = m·a + (C_r + C_v·v)·m·g + ½·ρ·C_d·A_f·v² + m·g·sin θ",
    _SOURCE,
    (
        _at_wheels(
            "rolling",
            "C_r·m·g·v",
            (ParameterSpec("rolling_coefficient", "1", "C_r"),),
            lambda c, p: motion.rolling_power(c["speed_m_s"], p["rolling_coefficient"] * _weight(c)),
        ),
        _at_wheels(
            "viscous_rolling",
            "C_v·v·m·g·v",
            (ParameterSpec("viscous_coefficient", "s/m", "C_v", default=0.0),),
            lambda c, p: motion.viscous_power(c["speed_m_s"], p["viscous_coefficient"] * _weight(c)),
        ),
        _at_wheels(
            "drag",
            "½·ρ·C_d·A_f·v³",
            (
                ParameterSpec("drag_coefficient", "1", "C_d", default=0.0),
                ParameterSpec("frontal_area", "m^2", "A_f", default=0.0),
                ParameterSpec("air_density", "kg/m^3", "ρ", default=1.2),
            ),
            _drag,
        ),
        _at_wheels(
            "skid",
            "scrub_moment·m·g·|ω|",
            (ParameterSpec("scrub_moment", "m", "sideways tyre friction times lever arm", default=0.0),),
            lambda c, p: motion.turning_power(number(c, "yaw_rate_rad_s"), p["scrub_moment"] * _weight(c)),
            source="Coulomb friction of tyres that slide sideways",
        ),
        _at_wheels(
            "inertia",
            "m·a·v",
            (ParameterSpec("inertia", "1", "effective mass over real mass", default=1.0),),
            _inertia,
            recovers=True,
        ),
        _at_wheels(
            "lifting", LIFTING.equation, LIFTING.parameters, lifting_power, recovers=True, source=LIFTING.source
        ),
        boards_term(
            "drive_boards",
            ParameterSpec("drive_constant", "W", "controller and no-load losses while moving", default=0.0),
            ParameterSpec("standing", "W", "the same at rest", default=0.0),
            "speed controller and no-load losses",
        ),
    ),
)
"""For any wheeled robot whose mass and coefficients are known."""
