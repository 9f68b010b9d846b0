"""Motion model ``traction``: Newton's second law at the wheels, for any wheeled robot (rover paper, Eqs. 1–5).

Also for skid-steered robots, whose tyres scrub sideways in turns (``scrub_moment``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.covariates import Covariates, is_moving, number
from missionsim.effects.motion_build import builder, parameters_of
from missionsim.effects.motion_models import MotionModel, register
from missionsim.physics import motion, traction

_SOURCE = "rover paper, Eqs. 1–5"
_EFFICIENCY = ParameterSpec("efficiency", "1", "of the drive, battery to wheel", default=1.0, low=0.01, high=1.0)


def _term(
    id: str,
    equation: str,
    parameters: tuple[ParameterSpec, ...],
    needs: tuple[str, ...],
    power: Callable[[Covariates, Mapping[str, Any]], Any],
    *,
    recovers: bool = False,
    source: str = _SOURCE,
) -> Effect:
    def electrical(cov: Covariates, p: Mapping[str, Any]) -> Any:
        watts = power(cov, p) / p["efficiency"] * is_moving(cov)
        if not recovers:
            return watts
        return motion.recovered_power(watts, number(cov, "drive_w"), number(cov, "regeneration"))

    return Effect(
        id,
        equation,
        source,
        equation,
        (*parameters, _EFFICIENCY),
        needs,
        electrical,
        drive=True,
        recovers=recovers,
        covariate=needs[0],
    )


def _rolling(cov: Covariates, p: Mapping[str, Any]) -> Any:
    # the normal force as on level ground (Eq. 4): cos θ would make a round trip over a hill cheaper than a flat one
    force = traction.rolling_force(cov["speed_m_s"], cov["mass_kg"], rolling_coefficient=p["rolling_coefficient"])
    return force * np.abs(cov["speed_m_s"])


def _viscous(cov: Covariates, p: Mapping[str, Any]) -> Any:
    force = traction.rolling_force(
        cov["speed_m_s"], cov["mass_kg"], rolling_coefficient=0.0, viscous_coefficient_s_m=p["viscous_coefficient"]
    )
    return force * np.abs(cov["speed_m_s"])


def _drag(cov: Covariates, p: Mapping[str, Any]) -> Any:
    force = traction.drag_force(
        cov["speed_m_s"],
        drag_coefficient=p["drag_coefficient"],
        frontal_area_m2=p["frontal_area"],
        air_density_kg_m3=p["air_density"],
    )
    return force * np.abs(cov["speed_m_s"])


def _inertia(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["inertia"] * traction.acceleration_force(number(cov, "accel_m_s2"), cov["mass_kg"]) * cov["speed_m_s"]


def _grade(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["grade"] * traction.grade_force(number(cov, "slope_rad"), cov["mass_kg"]) * np.abs(cov["speed_m_s"])


def _skid(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return traction.skid_power(number(cov, "yaw_rate_rad_s"), cov["mass_kg"], scrub_moment_m=p["scrub_moment"])


def _boards(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return np.where(is_moving(cov), p["drive_constant"], p["standing"])


EFFECTS: tuple[Effect, ...] = (
    _term("rolling", "C_r·m·g·v", (ParameterSpec("rolling_coefficient", "1", "C_r"),), ("speed_m_s",), _rolling),
    _term(
        "viscous_rolling",
        "C_v·v·m·g·v",
        (ParameterSpec("viscous_coefficient", "s/m", "C_v", default=0.0),),
        ("speed_m_s",),
        _viscous,
    ),
    _term(
        "drag",
        "½·ρ·C_d·A_f·v³",
        (
            ParameterSpec("drag_coefficient", "1", "C_d", default=0.0),
            ParameterSpec("frontal_area", "m^2", "A_f", default=0.0),
            ParameterSpec("air_density", "kg/m^3", "ρ", default=1.2),
        ),
        ("speed_m_s",),
        _drag,
    ),
    _term(
        "skid",
        "scrub_moment·m·g·|ω|",
        (ParameterSpec("scrub_moment", "m", "sideways tyre friction times lever arm", default=0.0),),
        ("speed_m_s",),
        _skid,
        source="Coulomb friction of tyres that slide sideways",
    ),
    _term(
        "inertia",
        "m·a·v",
        (ParameterSpec("inertia", "1", "effective mass over real mass", default=1.0),),
        ("speed_m_s",),
        _inertia,
        recovers=True,
    ),
    _term(
        "lifting",
        "m·g·sin θ·v",
        (ParameterSpec("grade", "1", "share of the weight that counts", default=1.0),),
        ("speed_m_s",),
        _grade,
        recovers=True,
        source="Newton's second law on a slope",
    ),
    Effect(
        "drive_boards",
        "P while moving, P_standing at rest",
        "robot file",
        "speed controller and no-load losses",
        (
            ParameterSpec("drive_constant", "W", "controller and no-load losses while moving", default=0.0),
            ParameterSpec("standing", "W", "the same at rest", default=0.0),
        ),
        (),
        _boards,
        component="controller",
        covariate="speed_m_s",
    ),
)
"""Terms in order of evaluation; parameters of the same name are one number of the robot file."""

TRACTION = register(
    MotionModel(
        "traction",
        "F·v, F = m·a + (C_r + C_v·v)·m·g + ½·ρ·C_d·A_f·v² + m·g·sin θ",
        _SOURCE,
        parameters_of(EFFECTS),
        builder(EFFECTS),
    )
)
"""For any wheeled robot whose mass and coefficients are known."""
