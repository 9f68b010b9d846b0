"""The library of effects, every id of the contract, and the door for effects of other packages.

Coefficients are called ``k`` (``E`` for the start surge); each effect is linear in its first parameter.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, number
from missionsim.effects.families import (
    FLOORS,
    TAU,
    battery_resistance_effect,
    coefficient,
    component_power_effect,
    component_warmup_effect,
    floor_effect,
    floors_effect,
    logged_power_effect,
)
from missionsim.errors import InputError, did_you_mean
from missionsim.physics import electrical, motion

REFERENCE_GRID_C = (25.0,)
_SPEED = ("speed_m_s",)


def _drive(
    id: str,
    equation: str,
    source: str,
    unit: str,
    meaning: str,
    needs: tuple[str, ...],
    power: Callable[..., Any],
    **more: Any,
) -> Effect:
    parameters = (coefficient(unit, "coefficient"), *more.pop("shape", ()))
    return Effect(id, equation, source, meaning, parameters, needs, power, drive=True, **more)


def _grade(cov: Covariates, p: Mapping[str, Any]) -> Any:
    lifting = motion.grade_power(cov["speed_m_s"], cov["slope_rad"], number(cov, "mass_kg", 1.0), p["k"])
    return _given_back(lifting, p["regeneration"], p) if "regeneration" in p else lifting


def _given_back(power_w: Any, regeneration: Any, p: Mapping[str, Any]) -> Any:
    """Its share of what braking gives back; all of it where the model limits all such terms together."""
    return motion.two_sided(power_w, np.where(np.asarray(p.get("relief", 0.0)) > 0.0, 1.0, regeneration))


def _acceleration(cov: Covariates, p: Mapping[str, Any]) -> Any:
    kinetic = motion.acceleration_power(cov["speed_m_s"], cov["accel_m_s2"], number(cov, "mass_kg", 1.0), p["k"], 1.0)
    if "regeneration" in p:
        return _given_back(kinetic, p["regeneration"], p)
    return kinetic if np.any(np.asarray(number(cov, "regeneration")) > 0.0) else np.maximum(kinetic, 0.0)


def _copper(cov: Covariates, p: Mapping[str, Any]) -> Any:
    slope, mass = number(cov, "slope_rad"), number(cov, "mass_kg", 1.0)
    return motion.traction_copper_loss(cov["speed_m_s"], cov["accel_m_s2"], slope, mass, p["k"], p["rolling"])


_REFERENCE = ParameterSpec(
    "T0", "degC", "temperature at which nothing is added", low=-20.0, high=60.0, default=25.0, grid=REFERENCE_GRID_C
)

_BACK = ParameterSpec(
    "regeneration",
    "1",
    "share of it that braking or a descent gives back; without it that of the robot's body",
    high=1.0,
    default=0.0,
    grid=(0.0, 0.7),
    optional=True,
)
_RELIEF = ParameterSpec(
    "relief",
    "1",
    "1 where what it gives back first takes over what the drive needs, with all such terms together; 0: by itself",
    high=1.0,
    default=0.0,
    optional=True,
)
_ROLLING = ParameterSpec("rolling", "1", "C_r of the rolling force", high=0.5, default=0.02, grid=(0.0, 0.02, 0.06))

_EFFECTS: tuple[Effect, ...] = (
    _drive(
        "grade",
        "k·m·g·v·sin θ, never below what the drive can give back; downhill times regeneration where that is given",
        "Newton: weight along the slope; in none of the four papers",
        "1",
        "lifting the robot on a slope",
        ("slope_rad", "speed_m_s"),
        _grade,
        shape=(_BACK, _RELIEF),
        back="regeneration",
        recovers=True,
        relief=lambda p: motion.relieved_part(p["k"]),
    ),
    _drive(
        "payload",
        "k·m_payload·v",
        "Coulomb friction of the added weight; Parasuraman 2012, Eq. 14 has it without the speed",
        "m/s^2",
        "rolling resistance of the load carried",
        ("payload_kg", "speed_m_s"),
        lambda c, p: motion.payload_power(c["speed_m_s"], c["payload_kg"], p["k"]),
    ),
    _drive(
        "acceleration",
        "k·m·a·v when speeding up, times regeneration when braking",
        "rover paper, Eq. 3 (m dv/dt); Jaiem 2021, Eq. 5, term C6 a v, without recovery",
        "1",
        "inertia of the robot when it speeds up, and what braking gives back",
        ("speed_m_s", "accel_m_s2"),
        covariate="accel_m_s2",
        power=_acceleration,
        shape=(_BACK, _RELIEF),
        back="regeneration",
        recovers=True,
        one_sided=True,
    ),
    _drive(
        "copper_loss",
        "k·F², F = m·(a + g·sin θ + C_r·g)",
        "Joule: current follows the torque of the drive; Hou et al. 2019, section 2, for four wheels",
        "W/N^2",
        "heat in the motors' windings, with the force of the drive squared",
        ("speed_m_s", "accel_m_s2"),
        covariate="accel_m_s2",
        power=_copper,
        shape=(_ROLLING,),
    ),
    _drive(
        "turning_scrub",
        "k·|ω|",
        "Coulomb friction of tyres that slide sideways; in none of the four papers",
        "W s/rad",
        "tyres or rollers scrubbing sideways in turns",
        ("yaw_rate_rad_s",),
        lambda c, p: motion.turning_power(c["yaw_rate_rad_s"], p["k"]),
    ),
    _drive(
        "rolling_friction",
        "k·v",
        "Jaiem 2021, Eq. 6, term C3 v; rover paper, Eq. 4, term C_r",
        "N",
        "constant friction force",
        _SPEED,
        lambda c, p: motion.rolling_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "viscous_friction",
        "k·v²",
        "Jaiem 2021, Eq. 6, term C2 v^2; rover paper, Eq. 4, term C_v",
        "N s/m",
        "friction force that grows with speed",
        _SPEED,
        lambda c, p: motion.viscous_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "aerodynamic_drag",
        "k·v³",
        "rover paper, Eqs. 1 and 5, k = rho C_d A / 2",
        "kg/m",
        "air resistance",
        _SPEED,
        lambda c, p: motion.drag_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "cold_friction",
        "k·v·exp(−moving time/τ)",
        "assumed form: grease that warms up, one time constant",
        "N",
        "cold grease that warms up as the robot moves",
        ("speed_m_s", "moving_time_s"),
        shape=(TAU,),
        memory=("moving_time_s",),
        covariate="moving_time_s",
        power=lambda c, p: motion.cold_friction_power(c["speed_m_s"], c["moving_time_s"], p["k"], p["tau"]),
    ),
    _drive(
        "temperature_friction",
        "k·v·(T₀ − T)",
        "assumed form: first order about the reference temperature",
        "N/K",
        "friction that falls with the ambient temperature",
        ("temp_ambient_c", "speed_m_s"),
        shape=(_REFERENCE,),
        power=lambda c, p: motion.temperature_friction_power(c["speed_m_s"], c["temp_ambient_c"], p["k"], p["T0"]),
    ),
    Effect(
        "start_surge",
        "E joules at each start from rest",
        "assumed form: one energy a start",
        "inrush when the motors start",
        (ParameterSpec("E", "J", "energy of one start"),),
        ("speed_m_s", "starts"),
        power=lambda c, p: p["E"] * number(c, "starts_per_s"),
        impulse=lambda c, p: p["E"] * c["starts"],
        drive=True,
        covariate="starts",
    ),
    Effect(
        "conversion_loss",
        "k·P² of the load on that battery",
        "Joule: resistance times current squared at nearly constant voltage",
        "ohmic loss of converters and wiring",
        (coefficient("1/W", "coefficient", 1.0),),
        (),
        lambda c, p: electrical.conversion_loss(number(c, "load_w"), p["k"]),
        component="conversion",
        of_load=True,
        covariate="load_w",
    ),
    Effect(
        "standby_load",
        "k, always",
        "assumed form: a constant, as the controller boards of Jaiem 2021",
        "a constant load that nobody listed",
        (coefficient("W", "power"),),
        (),
        lambda c, p: p["k"] * np.ones_like(number(c, "speed_m_s", 0.0), dtype=float),
        component="standby",
    ),
    Effect(
        "cpu_load",
        "k·load",
        "rover paper, Eq. 6, term P_work U at one clock",
        "processor power that follows its load",
        (coefficient("W", "power at full load"),),
        ("cpu_load",),
        lambda c, p: p["k"] * c["cpu_load"],
        component="cpu",
    ),
    Effect(
        "cpu_frequency",
        "k·load·f³",
        "Jaiem 2021, section 3.2; rover paper, Eq. 6, with the voltage following the clock",
        "dynamic processor power with voltage following frequency",
        (coefficient("W/Hz^3", "coefficient"),),
        ("cpu_load", "cpu_freq_hz"),
        lambda c, p: electrical.cpu_frequency_power(c["cpu_load"], c["cpu_freq_hz"], p["k"]),
        component="cpu",
        covariate="cpu_freq_hz",
    ),
    Effect(
        "radio_range",
        "k·d²",
        "free space: sending power with the distance squared; assumed for the whole radio",
        "radio that sends harder far from its access point",
        (coefficient("W/m^2", "coefficient"),),
        ("access_point_distance_m",),
        lambda c, p: electrical.radio_power(c["access_point_distance_m"], p["k"]),
        component="radio",
    ),
)


def _execution(id: str, equation: str, source: str, unit: str, meaning: str) -> Effect:
    return Effect(
        id,
        equation,
        source,
        meaning,
        (ParameterSpec("k", unit, meaning),),
        ("speed_m_s",),
        lambda c, p: 0.0 * number(c, "speed_m_s"),
        component="motors",
        execution=True,
    )


_EXECUTION: tuple[Effect, ...] = (
    _execution(
        "path_stretch",
        "distance driven / distance planned, per scheme",
        "Jaiem 2021, sections 3.4.1 and 3.4.2, in words",
        "1",
        "paths longer than planned",
    ),
    _execution(
        "speed_tracking",
        "speed reached / speed asked, per scheme",
        "Jaiem 2021, section 3.4.2, in words",
        "1",
        "speeds lower than asked",
    ),
    _execution(
        "dwell",
        "unplanned standing still",
        "assumed: standing that no segment plans",
        "s",
        "time stood still that no segment plans",
    ),
)


_FAMILIES: dict[str, Callable[[str], Effect]] = {
    "component_power": component_power_effect,
    "component_warmup": component_warmup_effect,
    "logged_power": logged_power_effect,
    **{id: functools.partial(floor_effect, id) for id in FLOORS},
}


def effect_ids() -> tuple[str, ...]:
    """Every id of the library; families stand as ``component_power:<component>``."""
    plain = [effect.id for effect in (*_EFFECTS, *_EXECUTION)]
    return (
        *plain,
        *FLOORS,
        "battery_resistance",
        "component_power:<component>",
        "component_warmup:<component>",
        "logged_power:<column>",
        *sorted(plugins(Effect)),
    )


def get_effect(id: str, surfaces: tuple[str, ...] = (), battery: str = "<battery>") -> Effect:
    """The effect of an id.

    Parameters
    ----------
    id : str
        ``grade``, ``component_power:kinect``, ``surface_rolling_resistance`` (with `surfaces`),
        ``surface_rolling_resistance:carpet``, or the name of a plug-in.
    surfaces : tuple of str
        The surfaces of a robot's ``surface_rolling_resistance`` or ``surface_turning_scrub``.
    battery : str
        The battery that ``battery_resistance`` loads.

    Raises
    ------
    missionsim.errors.InputError
        For an id that the library does not hold, with the closest one.
    """
    known = {effect.id: effect for effect in (*_EFFECTS, *_EXECUTION)}
    if id in known:
        return known[id]
    family, _, name = id.partition(":")
    if family in _FAMILIES and name:
        return _FAMILIES[family](name)
    if id in FLOORS:
        return floors_effect(id, surfaces)
    if id == "battery_resistance":
        return battery_resistance_effect(battery)
    others = plugins(Effect)
    if id in others:
        return others[id]
    ids = effect_ids()
    raise InputError.single(
        f"unknown effect '{id}'",
        got=id,
        allowed=", ".join(ids),
        hint=did_you_mean(family, [i.partition(":")[0] for i in ids]),
    )


def all_effects(
    components: tuple[str, ...] = (),
    surfaces: tuple[str, ...] = (),
    columns: tuple[str, ...] = (),
    battery: str = "<battery>",
) -> tuple[Effect, ...]:
    """The whole library for a robot: plain effects, those by surface, component and column of watts, and plug-ins.

    Execution effects are not in it; they need a plan (`execution_effects`).
    """
    return (
        *_EFFECTS,
        battery_resistance_effect(battery),
        *(floors_effect(id, surfaces) for id in FLOORS if surfaces),
        *(logged_power_effect(name) for name in columns),
        *(component_power_effect(name) for name in components),
        *(component_warmup_effect(name) for name in components),
        *(effect for effect in plugins(Effect).values() if not effect.execution),
    )


def execution_effects() -> tuple[Effect, ...]:
    """`path_stretch`, `speed_tracking` and `dwell`."""
    return _EXECUTION
