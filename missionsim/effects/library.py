"""The library of effects, every id of the contract (``library.yaml``), and the door for effects of other packages."""

from __future__ import annotations

import functools
import inspect
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from missionsim.effects.base import Effect, Parameters, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, is_moving, label_equals, number
from missionsim.errors import InputError, did_you_mean
from missionsim.files import Json
from missionsim.glossary import column_of
from missionsim.physics import electrical, mecanum, motion

Power = Callable[[Covariates, Parameters], Any]

LOGGED = "logged"
"""Component under which watts that are logged beside are booked."""


def declarations(name: str) -> Json:
    """What a file of declarations in this folder holds."""
    text = Path(__file__).with_name(name).read_text("utf-8")
    found: Json = yaml.load(text, Loader=yaml.CSafeLoader)
    return found


_FILE: dict[str, dict[str, Json]] = declarations("library.yaml")


def _given_back(power_w: Any, regeneration: Any, p: Parameters) -> Any:
    """Its share of what braking gives back; all of it where the model limits all such terms together."""
    return motion.two_sided(power_w, np.where(np.asarray(p.get("relief", 0.0)) > 0.0, 1.0, regeneration))


def _grade(cov: Covariates, p: Parameters) -> Any:
    lifting = motion.grade_power(cov["speed_m_s"], cov["slope_rad"], number(cov, "mass_kg", 1.0), p["k"])
    return _given_back(lifting, p["regeneration"], p) if "regeneration" in p else lifting


def _acceleration(cov: Covariates, p: Parameters) -> Any:
    kinetic = motion.inertial_power(cov["speed_m_s"], cov["accel_m_s2"], number(cov, "mass_kg", 1.0), p["k"])
    if "regeneration" in p:
        return _given_back(kinetic, p["regeneration"], p)
    return kinetic if np.any(np.asarray(number(cov, "regeneration")) > 0.0) else np.maximum(kinetic, 0.0)


_WRITTEN: dict[str, Power] = {"grade": _grade, "acceleration": _acceleration}
"""Powers that are more than one function of physics."""
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: one for module in (motion, mecanum, electrical) for name, one in vars(module).items() if callable(one)},
    "product": operator.mul,
    "just": lambda value: value,
    "constant": lambda value, like: value * np.ones_like(like, dtype=float),
    "nothing": lambda like: 0.0 * like,
}
_ABSENT = {"mass_kg": 1.0}
"""What a covariate counts as where nothing tells it; 0 any other."""
_PLAIN = ("component", "covariate", "drive", "of_drive", "of_load", "execution", "recovers", "one_sided", "back")


def _called(call: str, needs: Sequence[str]) -> Power:
    """A power that is written as ``function(argument, …)`` of parameters and covariates."""
    name, inner = call.rstrip(")").split("(")
    function, arguments = _FUNCTIONS[name], [(a, a in needs, _ABSENT.get(a, 0.0)) for a in inner.split(", ")]
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        allowed = f"{name}{inspect.signature(function)}"
        raise InputError.single(f"'{name}' takes other arguments", got=call, allowed=allowed) from None

    def power(cov: Covariates, p: Parameters) -> Any:
        return function(*[p[a] if a in p else cov[a] if needed else number(cov, a, k) for a, needed, k in arguments])

    return power


def _boards(moving: str, standing: str) -> Power:
    """Controller boards: one power while the robot moves, another at rest; the same where no other is given."""

    def power(cov: Covariates, p: Parameters) -> Any:
        moves = is_moving(cov)
        if standing not in p:
            return p[moving] * np.ones_like(moves, dtype=float)
        if np.ndim(p[moving]) > np.ndim(moves) and np.all(moves):
            return p[moving]  # one column of draws serves all intervals
        return np.where(moves, p[moving], p[standing])

    return power


def _while_moving(power: Power, over: str, ahead: bool) -> Power:
    """A power while the robot moves (`ahead`: and does not only turn), over an efficiency; of many draws without a pass
    where all is moving."""

    def moving_power(cov: Covariates, p: Parameters) -> Any:
        moving = is_moving({**cov, "yaw_rate_rad_s": 0.0} if ahead else cov)
        watts = power(cov, p) / p[over] if over else power(cov, p)
        if np.ndim(watts) > np.ndim(moving):
            return watts if np.all(moving) else watts * np.asarray(moving, dtype=float)
        return watts * moving

    return moving_power


def specs_of(told: Mapping[str, Json]) -> tuple[ParameterSpec, ...]:
    """Parameters as a file declares them."""
    return tuple(ParameterSpec(name, **{**spec, "grid": tuple(spec.get("grid", ()))}) for name, spec in told.items())


def declared(id: str, told: Json) -> Effect:
    """The effect of an entry of a file."""
    needs = tuple(told.get("needs", ()))
    more: dict[str, Any] = {"drive": "component" not in told}
    more |= {key: told[key] for key in (*_PLAIN, "beyond", "sign") if key in told}
    if "impulse" in told:
        more["impulse"] = _called(told["impulse"], needs)
    if "relief" in told:
        relief = _called(told["relief"], ())
        more["relief"] = lambda p: relief({}, p)
    if "asked" in told:
        more["asked"] = _called(told["asked"], ("body_mass_kg",))
    if "parameters" in told:
        specs = specs_of(told["parameters"])
    else:
        name, meaning = told.get("coefficient", ("k", "coefficient"))
        high, plausible = (float(told.get(key, "inf")) for key in ("high", "plausible"))
        first = ParameterSpec(name, told["unit"], meaning, high=high, plausible=plausible)
        specs = (first, *specs_of({one: _FILE["shapes"][one] for one in told.get("shape", ())}))
    call = told.get("power")
    power = _boards(*told["parameters"]) if call == "boards" else _called(call, needs) if call else _WRITTEN[id]
    if told.get("while_moving"):
        power = _while_moving(power, told.get("over", ""), told["while_moving"] == "ahead")
    text = (told["equation"], told["source"], told.get("meaning") or told["equation"])
    return Effect(id, *text, specs, needs, power, memory=tuple(told.get("memory", ())), **more)


def _named(value: Any, name: str) -> Any:
    """An entry of a family, or a part of one, with what ``{name}`` stands for."""
    if isinstance(value, dict):
        return {key: _named(one, name) for key, one in value.items()}
    if isinstance(value, list):
        return [_named(one, name) for one in value]
    return value.replace("{name}", name) if isinstance(value, str) else value


_EFFECTS = tuple(declared(id, told) for id, told in _FILE["effects"].items())
_EXECUTION = tuple(declared(id, told) for id, told in _FILE["execution"].items())
_KNOWN = {effect.id: effect for effect in (*_EFFECTS, *_EXECUTION)}
FLOORS = tuple(_FILE["floors"])
"""Ids of the effects with a coefficient for each floor."""


def floors_effect(id: str, surfaces: tuple[str, ...]) -> Effect:
    """An effect of `FLOORS` on several surfaces at once, one coefficient ``k_<surface>`` each."""
    of = _FILE["floors"][id]
    unit_power = _called(of["power"], of["needs"])

    def power(c: Covariates, p: Parameters) -> Any:
        whole = unit_power(c, {"k": 1.0})
        return sum((p[f"k_{name}"] * whole * label_equals(c["surface"], name) for name in surfaces), start=0.0 * whole)

    specs = tuple(ParameterSpec(f"k_{name}", of["unit"], f"{of['meaning']} on {name}") for name in surfaces)
    text = (f"k_s·{of['equation']} on surface s", of["source"], f"{of['meaning']}, by floor")
    parts = tuple(spec.name for spec in specs)
    return Effect(id, *text, specs, tuple(of["needs"]), power, drive=True, covariate=of["covariate"], parts=parts)


def floor_effect(id: str, surface: str) -> Effect:
    """An effect of `FLOORS` on one surface: ``k`` where the floor is `surface`."""
    of, whole = _FILE["floors"][id], floors_effect(id, (surface,))
    return replace(
        whole,
        id=f"{id}:{surface}",
        equation=f"k·{of['equation']} on surface '{surface}'",
        meaning=f"more {of['meaning']} on {surface}",
        parameters=(ParameterSpec("k", of["unit"], "coefficient"),),
        parts=(),
        power=lambda c, p: whole.power(c, {f"k_{surface}": p["k"]}),
    )


def _of_family(family: str, name: str) -> Effect:
    """The effect of a family for what its id names; of ``battery_resistance`` for the battery that it loads."""
    id = family if family == "battery_resistance" else f"{family}:{name}"
    return declared(id, _named(_FILE["families"][family], name))


def logged_power_effect(column: str) -> Effect:
    """`logged_power:<column>`: ``k`` times the watts of a log column (``…_w``, or ``…_kw`` times 1000)."""
    factor = 1000.0 if column.endswith("_kw") else 1.0
    return Effect(
        f"logged_power:{column}",
        f"k·{column}" + (" in W" if factor > 1.0 else ""),
        "assumed: what another meter measured is drawn from this battery, with k the loss on the way",
        f"{column}, which is logged beside, drawn from this battery",
        (ParameterSpec("k", "1", "battery power for each watt logged, near 1", high=10.0),),
        (column,),
        lambda c, p: p["k"] * factor * c[column],
        component=LOGGED,
        covariate=column,
    )


_OWN_WATTS = frozenset(("load_w", "measured_w", "base_w"))
_WHOLE = frozenset(
    (
        *("total", "battery", "batt", "pack", "bus", "sum", "motor", "motors", "drive", "drives", "traction", "wheel"),
        *("wheels", "propulsion", "engine", "inverter", "mech", "mechanical", "regen", "brake"),
    )
)


def logged_power_columns(names: Iterable[str], batteries: Sequence[str]) -> tuple[str, ...]:
    """Columns that hold watts of something beside the batteries: what may be a `logged_power`.

    The name ends in ``_w`` or ``_kw``, is no column of the glossary (``power_<x>_w`` is one where the robot has a
    battery x), and has no word for the whole (total, battery, bus, …) or for the drive.
    """
    found = []
    for name in sorted(names):
        of = name.removeprefix("power_").removesuffix("_w")
        known = name in _OWN_WATTS or (column_of(name) is not None and of in batteries)
        if name.endswith(("_w", "_kw")) and not known and _WHOLE.isdisjoint(name.split("_")):
            found.append(name)
    return tuple(found)


_FAMILIES: dict[str, Callable[[str], Effect]] = {
    "component_power": functools.partial(_of_family, "component_power"),
    "component_warmup": functools.partial(_of_family, "component_warmup"),
    "logged_power": logged_power_effect,
    **{id: functools.partial(floor_effect, id) for id in FLOORS},
}


def effect_ids() -> tuple[str, ...]:
    """Every id of the library; families stand as ``component_power:<component>``."""
    return (
        *_KNOWN,
        *FLOORS,
        "battery_resistance",
        "component_power:<component>",
        "component_warmup:<component>",
        "logged_power:<column>",
        *sorted(plugins(Effect)),
    )


def get_effect(id: str, surfaces: tuple[str, ...] = (), battery: str = "<battery>") -> Effect:
    """The effect of an id.

    `id`: ``grade``, ``component_power:kinect``, ``surface_rolling_resistance`` (with `surfaces`),
    ``surface_rolling_resistance:carpet``, or the name of a plug-in. `surfaces`: the surfaces of a robot's
    ``surface_rolling_resistance`` or ``surface_turning_scrub``. `battery`: the battery that ``battery_resistance``
    loads. Raises InputError: for an id that the library does not hold, with the closest one.
    """
    if id in _KNOWN:
        return _KNOWN[id]
    family, _, name = id.partition(":")
    if family in _FAMILIES and name:
        return _FAMILIES[family](name)
    if id in FLOORS:
        return floors_effect(id, surfaces)
    if id == "battery_resistance":
        return _of_family("battery_resistance", battery)
    others = plugins(Effect)
    if id in others:
        return others[id]
    ids = effect_ids()
    told = f"unknown effect '{id}'"
    raise InputError.single(
        told, got=id, allowed=", ".join(ids), hint=did_you_mean(family, [i.partition(":")[0] for i in ids])
    )


def all_effects(
    components: tuple[str, ...] = (),
    surfaces: tuple[str, ...] = (),
    columns: tuple[str, ...] = (),
    battery: str = "<battery>",
) -> tuple[Effect, ...]:
    """The whole library for a robot: plain effects, those by surface, component and column of watts, and plug-ins.
    Execution effects are not in it; they need a plan (`execution_effects`)."""
    return (
        *_EFFECTS,
        _of_family("battery_resistance", battery),
        *(floors_effect(id, surfaces) for id in FLOORS if surfaces),
        *(logged_power_effect(name) for name in columns),
        *(_of_family("component_power", name) for name in components),
        *(_of_family("component_warmup", name) for name in components),
        *(effect for effect in plugins(Effect).values() if not effect.execution),
    )


def execution_effects() -> tuple[Effect, ...]:
    """`path_stretch`, `speed_tracking` and `dwell`."""
    return _EXECUTION
