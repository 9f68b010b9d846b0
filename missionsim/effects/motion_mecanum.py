"""Motion model ``mecanum``: a four-wheel Mecanum robot that drives in any direction (after Hou et al. 2019).

Friction grows with the load on the wheels: the friction forces, given for the empty robot, scale with the total mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.base_terms import LIFTING
from missionsim.effects.covariates import Covariates, is_moving, number
from missionsim.effects.motion_models import MotionModel
from missionsim.physics import mecanum, motion

_SOURCE = "after Hou et al. 2019, section 2"
_WHEEL = ParameterSpec("wheel_friction", "N", "friction of all four wheels, empty robot")
_ROLLER = ParameterSpec("roller_friction", "N", "friction of all rollers in contact, empty robot", default=0.0)
_LEVER = ParameterSpec("half_sum", "m", "half the wheelbase plus half the track", default=0.0)
_BASE = ParameterSpec("half_wheelbase", "m", "half the wheelbase", default=0.0)
STEADY_M_S2 = 1e-9
"""Acceleration below which the control system sends no speed-up pulses."""


def _load(cov: Covariates) -> Any:
    """Weight on the wheels relative to the empty robot."""
    empty = cov["mass_kg"] - number(cov, "payload_kg")
    return cov["mass_kg"] / empty


def _wheels(cov: Covariates, p: Mapping[str, Any]) -> Any:
    speeds = mecanum.wheel_speeds(
        cov["speed_m_s"], number(cov, "lateral_speed_m_s"), number(cov, "yaw_rate_rad_s"), half_sum_m=p["half_sum"]
    )
    return mecanum.friction_power(speeds, friction_n=p["wheel_friction"] * _load(cov))


def _rollers(cov: Covariates, p: Mapping[str, Any]) -> Any:
    speeds = mecanum.roller_speeds(
        number(cov, "lateral_speed_m_s"), number(cov, "yaw_rate_rad_s"), half_wheelbase_m=p["half_wheelbase"]
    )
    return mecanum.friction_power(speeds, friction_n=p["roller_friction"] * _load(cov))


def _copper(cov: Covariates, p: Mapping[str, Any]) -> Any:
    load = _load(cov)
    forces = mecanum.wheel_forces(
        cov["speed_m_s"],
        number(cov, "lateral_speed_m_s"),
        number(cov, "accel_m_s2"),
        number(cov, "lateral_accel_m_s2"),
        mass_kg=cov["mass_kg"],
        wheel_friction_n=p["wheel_friction"] * load,
        roller_friction_n=p["roller_friction"] * load,
        grade_force_n=motion.grade_force(number(cov, "slope_rad"), cov["mass_kg"]),
    )
    return mecanum.copper_loss(forces, resistance_w_n2=p["copper_resistance"]) * is_moving(cov)


def _kinetic(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["inertia"] * mecanum.kinetic_power(
        cov["speed_m_s"],
        number(cov, "accel_m_s2"),
        number(cov, "lateral_speed_m_s"),
        number(cov, "lateral_accel_m_s2"),
        mass_kg=cov["mass_kg"],
    )


def _pulse(cov: Covariates, p: Mapping[str, Any]) -> Any:
    change = np.hypot(number(cov, "accel_m_s2"), number(cov, "lateral_accel_m_s2"))
    return p["control_pulse"] * np.where(change > STEADY_M_S2, 1.0, 0.0)


def _electronics(cov: Covariates, p: Mapping[str, Any]) -> Any:
    return p["electronics"] * np.ones_like(np.asarray(cov["speed_m_s"], dtype=float))


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "wheel_friction",
        "Σ f_w·|u_i|",
        _SOURCE,
        "rolling friction of the wheels",
        (_WHEEL, _LEVER),
        ("speed_m_s",),
        _wheels,
        drive=True,
    ),
    Effect(
        "roller_friction",
        "Σ f_r·√2·|v_y|",
        _SOURCE,
        "friction of the rollers",
        (_ROLLER, _BASE),
        ("speed_m_s",),
        _rollers,
        drive=True,
        covariate="lateral_speed_m_s",
    ),
    Effect(
        "copper_loss",
        "4·R_c·Σ g_i²",
        _SOURCE,
        "heat in the motor windings",
        (ParameterSpec("copper_resistance", "W/N^2", "R_c", default=0.0), _WHEEL, _ROLLER),
        ("speed_m_s",),
        _copper,
        component="motors",
        covariate="accel_m_s2",
    ),
    Effect(
        "kinetic",
        "M·(a·v)",
        "Hou et al. 2019, Eq. 4",
        "kinetic energy",
        (ParameterSpec("inertia", "1", "rotating masses: effective over real mass", default=1.0),),
        ("speed_m_s",),
        _kinetic,
        drive=True,
        recovers=True,
        covariate="accel_m_s2",
    ),
    LIFTING,
    Effect(
        "control_pulse",
        "P while speeding up or braking",
        "Hou et al. 2019, section 2.2 and Fig. 12",
        "control system sends pulses",
        (ParameterSpec("control_pulse", "W", "control power", default=0.0),),
        (),
        _pulse,
        component="control",
        covariate="accel_m_s2",
    ),
    Effect(
        "electronics",
        "P always",
        "Hou et al. 2019, sections 2.2–2.4",
        "control, sensors and communication",
        (ParameterSpec("electronics", "W", "constant load", default=0.0),),
        ("speed_m_s",),
        _electronics,
        component="electronics",
        covariate="time_s",
    ),
)
"""Terms in order of evaluation; parameters of the same name are one number of the robot file."""

MODEL = MotionModel(
    "mecanum", "friction of wheels and rollers, copper loss, kinetic power, control pulses", _SOURCE, EFFECTS
)
"""For robots with four Mecanum wheels."""
