"""The library of effects, every id of the contract, and the door for effects of other packages.

Coefficients are called ``k`` (``E`` for the start surge); each effect is linear in its first parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, label_equals, number
from missionsim.errors import InputError, did_you_mean
from missionsim.glossary import column_of
from missionsim.physics import electrical, motion

TAU_GRID_S = (20.0, 60.0, 180.0, 540.0)
REFERENCE_GRID_C = (25.0,)
LOGGED = "logged"
"""Component under which watts that are logged beside are booked."""
_SPEED = ("speed_m_s",)
_SOURCES = {
    "grade": "Newton: weight along the slope; in none of the four papers",
    "payload": "Coulomb friction of the added weight; Parasuraman 2012, Eq. 14 has it without the speed",
    "acceleration": "rover paper, Eq. 3 (m dv/dt); Jaiem 2021, Eq. 5, term C6 a v, without recovery",
    "turning_scrub": "Coulomb friction of tyres that slide sideways; in none of the four papers",
    "surface_turning_scrub": "Coulomb friction of tyres that slide sideways, by floor; in none of the four papers",
    "copper_loss": "Joule: current follows the torque of the drive; Hou et al. 2019, section 2, for four wheels",
    "battery_resistance": "Joule: resistance times current squared, with the voltage that was measured",
    "logged_power": "assumed: what another meter measured is drawn from this battery, with k the loss on the way",
    "rolling_friction": "Jaiem 2021, Eq. 6, term C3 v; rover paper, Eq. 4, term C_r",
    "viscous_friction": "Jaiem 2021, Eq. 6, term C2 v^2; rover paper, Eq. 4, term C_v",
    "aerodynamic_drag": "rover paper, Eqs. 1 and 5, k = rho C_d A / 2",
    "surface_rolling_resistance": "rover paper, Eq. 4, with C_r by surface",
    "cold_friction": "assumed form: grease that warms up, one time constant",
    "temperature_friction": "assumed form: first order about the reference temperature",
    "start_surge": "assumed form: one energy a start",
    "conversion_loss": "Joule: resistance times current squared at nearly constant voltage",
    "standby_load": "assumed form: a constant, as the controller boards of Jaiem 2021",
    "cpu_load": "rover paper, Eq. 6, term P_work U at one clock",
    "cpu_frequency": "Jaiem 2021, section 3.2; rover paper, Eq. 6, with the voltage following the clock",
    "radio_range": "free space: sending power with the distance squared; assumed for the whole radio",
    "component_power": "Jaiem 2021, Eq. 3",
    "component_warmup": "assumed form: one time constant after switching on",
    "path_stretch": "Jaiem 2021, sections 3.4.1 and 3.4.2, in words",
    "speed_tracking": "Jaiem 2021, section 3.4.2, in words",
    "dwell": "assumed: standing that no segment plans",
}
"""Where each form comes from, or that it is assumed."""


def _k(unit: str, meaning: str, high: float = float("inf")) -> ParameterSpec:
    return ParameterSpec("k", unit, meaning, high=high)


def _drive(
    id: str, equation: str, unit: str, meaning: str, needs: tuple[str, ...], power: Callable[..., Any], **more: Any
) -> Effect:
    parameters = (_k(unit, "coefficient"), *more.pop("shape", ()))
    return Effect(
        id,
        equation,
        _SOURCES[id.partition(":")[0]],
        meaning,
        parameters,
        needs,
        power,
        drive=True,
        covariate=more.pop("covariate", needs[0] if needs else "speed_m_s"),
        **more,
    )


def _grade(cov: Covariates, p: Mapping[str, Any]) -> Any:
    lifting = motion.grade_power(cov["speed_m_s"], cov["slope_rad"], number(cov, "mass_kg", 1.0), p["k"])
    if "regeneration" in p:
        return motion.two_sided(lifting, p["regeneration"])
    return lifting


def _acceleration(cov: Covariates, p: Mapping[str, Any]) -> Any:
    back = p["regeneration"] if "regeneration" in p else number(cov, "regeneration")
    return motion.acceleration_power(cov["speed_m_s"], cov["accel_m_s2"], number(cov, "mass_kg", 1.0), p["k"], back)


def _copper(cov: Covariates, p: Mapping[str, Any]) -> Any:
    slope, mass = number(cov, "slope_rad"), number(cov, "mass_kg", 1.0)
    return motion.traction_copper_loss(cov["speed_m_s"], cov["accel_m_s2"], slope, mass, p["k"], p["rolling"])


_TAU = ParameterSpec("tau", "s", "time constant", low=1.0, high=7200.0, default=120.0, grid=TAU_GRID_S)
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
_ROLLING = ParameterSpec("rolling", "1", "C_r of the rolling force", high=0.5, default=0.02, grid=(0.0, 0.02, 0.06))

_EFFECTS: tuple[Effect, ...] = (
    _drive(
        "grade",
        "k·m·g·v·sin θ, never below what the drive can give back; downhill times regeneration where that is given",
        "1",
        "lifting the robot on a slope",
        ("slope_rad", "speed_m_s"),
        _grade,
        shape=(_BACK,),
        back="regeneration",
        recovers=True,
        relief=lambda p: motion.relieved_part(p["k"]),
    ),
    _drive(
        "payload",
        "k·m_payload·v",
        "m/s^2",
        "rolling resistance of the load carried",
        ("payload_kg", "speed_m_s"),
        lambda c, p: motion.payload_power(c["speed_m_s"], c["payload_kg"], p["k"]),
    ),
    _drive(
        "acceleration",
        "k·m·a·v when speeding up, times regeneration when braking",
        "1",
        "inertia of the robot when it speeds up, and what braking gives back",
        ("speed_m_s", "accel_m_s2"),
        covariate="accel_m_s2",
        power=_acceleration,
        shape=(_BACK,),
        back="regeneration",
    ),
    _drive(
        "copper_loss",
        "k·F², F = m·(a + g·sin θ + C_r·g)",
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
        "W s/rad",
        "tyres or rollers scrubbing sideways in turns",
        ("yaw_rate_rad_s",),
        lambda c, p: motion.turning_power(c["yaw_rate_rad_s"], p["k"]),
    ),
    _drive(
        "rolling_friction",
        "k·v",
        "N",
        "constant friction force",
        _SPEED,
        lambda c, p: motion.rolling_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "viscous_friction",
        "k·v²",
        "N s/m",
        "friction force that grows with speed",
        _SPEED,
        lambda c, p: motion.viscous_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "aerodynamic_drag",
        "k·v³",
        "kg/m",
        "air resistance",
        _SPEED,
        lambda c, p: motion.drag_power(c["speed_m_s"], p["k"]),
    ),
    _drive(
        "cold_friction",
        "k·v·exp(−moving time/τ)",
        "N",
        "cold grease that warms up as the robot moves",
        ("speed_m_s", "moving_time_s"),
        shape=(_TAU,),
        memory=("moving_time_s",),
        covariate="moving_time_s",
        power=lambda c, p: motion.cold_friction_power(c["speed_m_s"], c["moving_time_s"], p["k"], p["tau"]),
    ),
    _drive(
        "temperature_friction",
        "k·v·(T₀ − T)",
        "N/K",
        "friction that falls with the ambient temperature",
        ("temp_ambient_c", "speed_m_s"),
        shape=(_REFERENCE,),
        power=lambda c, p: motion.temperature_friction_power(c["speed_m_s"], c["temp_ambient_c"], p["k"], p["T0"]),
    ),
    Effect(
        "start_surge",
        "E joules at each start from rest",
        _SOURCES["start_surge"],
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
        _SOURCES["conversion_loss"],
        "ohmic loss of converters and wiring",
        (_k("1/W", "coefficient", 1.0),),
        (),
        lambda c, p: electrical.conversion_loss(number(c, "load_w"), p["k"]),
        component="conversion",
        of_load=True,
        covariate="load_w",
    ),
    Effect(
        "standby_load",
        "k, always",
        _SOURCES["standby_load"],
        "a constant load that nobody listed",
        (_k("W", "power"),),
        (),
        lambda c, p: p["k"] * np.ones_like(number(c, "speed_m_s", 0.0), dtype=float),
        component="standby",
        covariate="time_s",
    ),
    Effect(
        "cpu_load",
        "k·load",
        _SOURCES["cpu_load"],
        "processor power that follows its load",
        (_k("W", "power at full load"),),
        ("cpu_load",),
        lambda c, p: electrical.cpu_load_power(c["cpu_load"], p["k"]),
        component="cpu",
        covariate="cpu_load",
    ),
    Effect(
        "cpu_frequency",
        "k·load·f³",
        _SOURCES["cpu_frequency"],
        "dynamic processor power with voltage following frequency",
        (_k("W/Hz^3", "coefficient"),),
        ("cpu_load", "cpu_freq_hz"),
        lambda c, p: electrical.cpu_frequency_power(c["cpu_load"], c["cpu_freq_hz"], p["k"]),
        component="cpu",
        covariate="cpu_freq_hz",
    ),
    Effect(
        "radio_range",
        "k·d²",
        _SOURCES["radio_range"],
        "radio that sends harder far from its access point",
        (_k("W/m^2", "coefficient"),),
        ("access_point_distance_m",),
        lambda c, p: electrical.radio_power(c["access_point_distance_m"], p["k"]),
        component="radio",
        covariate="access_point_distance_m",
    ),
)


def _execution(id: str, equation: str, unit: str, meaning: str) -> Effect:
    return Effect(
        id,
        equation,
        _SOURCES[id],
        meaning,
        (ParameterSpec("k", unit, meaning),),
        ("speed_m_s",),
        lambda c, p: 0.0 * number(c, "speed_m_s"),
        component="motors",
        execution=True,
        covariate="speed_m_s",
    )


_EXECUTION: tuple[Effect, ...] = (
    _execution("path_stretch", "distance driven / distance planned, per scheme", "1", "paths longer than planned"),
    _execution("speed_tracking", "speed reached / speed asked, per scheme", "1", "speeds lower than asked"),
    _execution("dwell", "unplanned standing still", "s", "time stood still that no segment plans"),
)


def surface_effect(surface: str) -> Effect:
    """`surface_rolling_resistance` on one surface: ``k_s |v|`` where the floor is `surface`."""
    return _drive(
        f"surface_rolling_resistance:{surface}",
        f"k·v on surface '{surface}'",
        "N",
        f"more rolling resistance on {surface}",
        ("surface", "speed_m_s"),
        covariate="surface",
        power=lambda c, p: motion.rolling_power(c["speed_m_s"], p["k"]) * label_equals(c["surface"], surface),
    )


def surfaces_effect(surfaces: tuple[str, ...]) -> Effect:
    """`surface_rolling_resistance` on several surfaces at once, one coefficient ``k_<surface>`` each."""

    def power(c: Covariates, p: Mapping[str, Any]) -> Any:
        total = 0.0 * number(c, "speed_m_s")
        for name in surfaces:
            total = total + motion.rolling_power(c["speed_m_s"], p[f"k_{name}"]) * label_equals(c["surface"], name)
        return total

    return Effect(
        "surface_rolling_resistance",
        "k_s·v on surface s",
        _SOURCES["surface_rolling_resistance"],
        "rolling resistance of the floor",
        tuple(ParameterSpec(f"k_{name}", "N", f"friction force on {name}") for name in surfaces),
        ("surface", "speed_m_s"),
        power,
        drive=True,
        covariate="surface",
        parts=tuple(f"k_{name}" for name in surfaces),
    )


def surface_scrub_effect(surface: str) -> Effect:
    """`surface_turning_scrub` on one surface: ``k_s |ω|`` where the floor is `surface`."""
    one = surface_scrubs_effect((surface,))
    k = f"k_{surface}"
    return one.renamed(
        id=f"surface_turning_scrub:{surface}",
        parameters=(_k("W s/rad", f"scrub on {surface}"),),
        parts=(),
        power=lambda c, p: one.power(c, {k: p["k"]}),
    )


def surface_scrubs_effect(surfaces: tuple[str, ...]) -> Effect:
    """`surface_turning_scrub` on several surfaces at once, one coefficient ``k_<surface>`` each."""

    def power(c: Covariates, p: Mapping[str, Any]) -> Any:
        scrub = motion.turning_power(c["yaw_rate_rad_s"], 1.0)
        return sum((p[f"k_{name}"] * scrub * label_equals(c["surface"], name) for name in surfaces), start=0.0 * scrub)

    return Effect(
        "surface_turning_scrub",
        "k_s·|ω| on surface s",
        _SOURCES["surface_turning_scrub"],
        "tyres scrubbing sideways in turns, by floor",
        tuple(ParameterSpec(f"k_{name}", "W s/rad", f"scrub on {name}") for name in surfaces),
        ("surface", "yaw_rate_rad_s"),
        power,
        drive=True,
        covariate="yaw_rate_rad_s",
        parts=tuple(f"k_{name}" for name in surfaces),
    )


def logged_power_effect(column: str) -> Effect:
    """`logged_power:<column>`: ``k`` times the watts of a log column (``…_w``, or ``…_kw`` times 1000)."""
    factor = 1000.0 if column.endswith("_kw") else 1.0
    return Effect(
        f"logged_power:{column}",
        f"k·{column}" + (" in W" if factor > 1.0 else ""),
        _SOURCES["logged_power"],
        f"{column}, which is logged beside, drawn from this battery",
        (_k("1", "battery power for each watt logged, near 1", 10.0),),
        (column,),
        lambda c, p: p["k"] * factor * c[column],
        component=LOGGED,
        covariate=column,
    )


def battery_resistance_effect(battery: str) -> Effect:
    """`battery_resistance`: ``k (P/U)²`` of the load on a battery whose voltage is known."""
    voltage = f"voltage_{battery}_v"
    return Effect(
        "battery_resistance",
        "k·(P/U)² of the load on that battery",
        _SOURCES["battery_resistance"],
        "heat in the battery's leads",
        (_k("ohm", "resistance", 10.0),),
        (voltage,),
        lambda c, p: electrical.resistance_loss(number(c, "load_w"), c[voltage], p["k"]),
        component="conversion",
        of_load=True,
        covariate="load_w",
    )


def component_power_effect(component: str) -> Effect:
    """`component_power:<component>`: ``k`` watts per unit switched on."""
    column = f"on_{component}"
    return Effect(
        f"component_power:{component}",
        f"k per unit of {component} switched on",
        _SOURCES["component_power"],
        f"{component} draws more than its data sheet says",
        (_k("W", "power of one unit"),),
        (column,),
        lambda c, p: electrical.component_power(c[column], p["k"]),
        component=component,
        covariate=column,
    )


def component_warmup_effect(component: str) -> Effect:
    """`component_warmup:<component>`: ``k exp(−t/τ)`` after it was switched on."""
    column, clock = f"on_{component}", f"on_time_{component}_s"
    return Effect(
        f"component_warmup:{component}",
        "k·exp(−time since switched on/τ)",
        _SOURCES["component_warmup"],
        f"{component} draws more until it is warm",
        (_k("W", "extra power when switched on"), _TAU),
        (column, clock),
        lambda c, p: electrical.warmup_power(c[column], c[clock], p["k"], p["tau"]),
        component=component,
        memory=(clock,),
        covariate=clock,
    )


_FAMILIES: dict[str, Callable[[str], Effect]] = {
    "component_power": component_power_effect,
    "component_warmup": component_warmup_effect,
    "surface_rolling_resistance": surface_effect,
    "surface_turning_scrub": surface_scrub_effect,
    "logged_power": logged_power_effect,
}
SURFACE_FAMILIES: dict[str, Callable[[tuple[str, ...]], Effect]] = {
    "surface_rolling_resistance": surfaces_effect,
    "surface_turning_scrub": surface_scrubs_effect,
}
"""Effects with a coefficient for each floor."""


def effect_ids() -> tuple[str, ...]:
    """Every id of the library; families stand as ``component_power:<component>``."""
    plain = [effect.id for effect in (*_EFFECTS, *_EXECUTION)]
    return (
        *plain,
        *SURFACE_FAMILIES,
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
    if id in SURFACE_FAMILIES:
        return SURFACE_FAMILIES[id](surfaces)
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
        *(one(surfaces) for one in SURFACE_FAMILIES.values() if surfaces),
        *(logged_power_effect(name) for name in columns),
        *(component_power_effect(name) for name in components),
        *(component_warmup_effect(name) for name in components),
        *(effect for effect in plugins(Effect).values() if not effect.execution),
    )


def execution_effects() -> tuple[Effect, ...]:
    """`path_stretch`, `speed_tracking` and `dwell`."""
    return _EXECUTION


_OWN_WATTS = frozenset(("drive_w", "load_w", "measured_w", "base_w"))
_WHOLE = frozenset(("total", "battery", "batt", "pack", "bus", "sum"))


def logged_power_columns(names: Iterable[str], batteries: Sequence[str]) -> tuple[str, ...]:
    """Columns that hold watts of something beside the batteries: what may be a `logged_power`.

    The name ends in ``_w`` or ``_kw``, is no column of the glossary (``power_<x>_w`` is one where the robot has a
    battery x), and has no word for the whole (total, battery, pack, bus, sum).
    """
    found = []
    for name in sorted(names):
        of = name.removeprefix("power_").removesuffix("_w")
        known = name in _OWN_WATTS or (column_of(name) is not None and of in batteries)
        if name.endswith(("_w", "_kw")) and not known and _WHOLE.isdisjoint(name.split("_")):
            found.append(name)
    return tuple(found)
