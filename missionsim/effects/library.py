"""The library of effects, every id of the contract (``library.yaml``), and the door for effects of other packages."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from missionsim.effects.base import Effect, Parameters, ParameterSpec, plugins
from missionsim.effects.covariates import Covariates, label_equals, number
from missionsim.errors import InputError, did_you_mean
from missionsim.glossary import column_of
from missionsim.physics import electrical, motion

LOGGED = "logged"
"""Component under which watts that are logged beside are booked."""
_SHAPES = {
    "tau": ParameterSpec(
        "tau", "s", "time constant", low=1.0, high=7200.0, default=120.0, grid=(20.0, 60.0, 180.0, 540.0)
    ),
    "T0": ParameterSpec(
        "T0", "degC", "temperature at which nothing is added", low=-20.0, high=60.0, default=25.0, grid=(25.0,)
    ),
    "regeneration": ParameterSpec(
        "regeneration",
        "1",
        "share of it that braking or a descent gives back; without it that of the robot's body",
        high=1.0,
        default=0.0,
        grid=(0.0, 0.7),
        optional=True,
    ),
    "relief": ParameterSpec(
        "relief",
        "1",
        "1 where what it gives back first takes over what the drive needs, with all such terms together; 0: by itself",
        high=1.0,
        default=0.0,
        optional=True,
    ),
    "rolling": ParameterSpec(
        "rolling", "1", "C_r of the rolling force", high=0.5, default=0.02, grid=(0.0, 0.02, 0.06)
    ),
}
"""Parameters that set the form of effects, by name."""


def _given_back(power_w: Any, regeneration: Any, p: Parameters) -> Any:
    """Its share of what braking gives back; all of it where the model limits all such terms together."""
    return motion.two_sided(power_w, np.where(np.asarray(p.get("relief", 0.0)) > 0.0, 1.0, regeneration))


def _grade(cov: Covariates, p: Parameters) -> Any:
    lifting = motion.grade_power(cov["speed_m_s"], cov["slope_rad"], number(cov, "mass_kg", 1.0), p["k"])
    return _given_back(lifting, p["regeneration"], p) if "regeneration" in p else lifting


def _acceleration(cov: Covariates, p: Parameters) -> Any:
    kinetic = motion.acceleration_power(cov["speed_m_s"], cov["accel_m_s2"], number(cov, "mass_kg", 1.0), p["k"], 1.0)
    if "regeneration" in p:
        return _given_back(kinetic, p["regeneration"], p)
    return kinetic if np.any(np.asarray(number(cov, "regeneration")) > 0.0) else np.maximum(kinetic, 0.0)


def _copper(cov: Covariates, p: Parameters) -> Any:
    slope, mass = number(cov, "slope_rad"), number(cov, "mass_kg", 1.0)
    return motion.traction_copper_loss(cov["speed_m_s"], cov["accel_m_s2"], slope, mass, p["k"], p["rolling"])


_WRITTEN: dict[str, Callable[[Covariates, Parameters], Any]] = {
    "grade": _grade,
    "acceleration": _acceleration,
    "copper_loss": _copper,
    "standby_load": lambda c, p: p["k"] * np.ones_like(number(c, "speed_m_s", 0.0), dtype=float),
}
"""Powers that are more than one function of physics."""
_FUNCTIONS = {**vars(motion), **vars(electrical), "product": operator.mul}


_PLAIN = ("component", "covariate", "of_load", "recovers", "one_sided", "back")


def _called(call: str, needs: Sequence[str]) -> Callable[[Covariates, Parameters], Any]:
    """A power that is written as ``function(argument, …)`` of parameters and covariates."""
    name, inner = call.rstrip(")").split("(")
    function, arguments = _FUNCTIONS[name], inner.split(", ")

    def power(cov: Covariates, p: Parameters) -> Any:
        return function(*(p[a] if a in p else cov[a] if a in needs else number(cov, a) for a in arguments))

    return power


def _declared(id: str, told: Mapping[str, Any]) -> Effect:
    """The effect of an entry of the file."""
    needs, (name, meaning) = tuple(told.get("needs", ())), told.get("coefficient", ("k", "coefficient"))
    more: dict[str, Any] = {key: told[key] for key in _PLAIN if key in told} | {"drive": "component" not in told}
    if "impulse" in told:
        more["impulse"] = _called(told["impulse"], needs)
    if "relief" in told:
        relief = _called(told["relief"], ())
        more["relief"] = lambda p: relief({}, p)
    first = ParameterSpec(name, told["unit"], meaning, high=told.get("high", float("inf")))
    shape = tuple(_SHAPES[one] for one in told.get("shape", ()))
    power = _called(told["power"], needs) if "power" in told else _WRITTEN[id]
    text = (told["equation"], told["source"], told["meaning"])
    return Effect(id, *text, (first, *shape), needs, power, memory=tuple(told.get("memory", ())), **more)


def _named(value: Any, name: str) -> Any:
    """An entry of a family, or a part of one, with what ``{name}`` stands for."""
    if isinstance(value, dict):
        return {key: _named(one, name) for key, one in value.items()}
    if isinstance(value, list):
        return [_named(one, name) for one in value]
    return value.replace("{name}", name) if isinstance(value, str) else value


_FILE: dict[str, dict[str, dict[str, Any]]] = yaml.load(
    Path(__file__).with_name("library.yaml").read_text("utf-8"), Loader=yaml.CSafeLoader
)
_EFFECTS = tuple(_declared(id, told) for id, told in _FILE["effects"].items())
_EXECUTION = tuple(
    Effect(
        id,
        told["equation"],
        told["source"],
        told["meaning"],
        (ParameterSpec("k", told["unit"], told["meaning"]),),
        ("speed_m_s",),
        lambda c, p: 0.0 * number(c, "speed_m_s"),
        execution=True,
    )
    for id, told in _FILE["execution"].items()
)
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
    return _declared(f"{family}:{name}", _named(_FILE["families"][family], name))


def battery_resistance(battery: str) -> Effect:
    """`battery_resistance`: ``k (P/U)²`` of the load on a battery whose voltage is known."""
    return _declared("battery_resistance", _named(_FILE["families"]["battery_resistance"], battery))


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


_FAMILIES: dict[str, Callable[[str], Effect]] = {
    "component_power": functools.partial(_of_family, "component_power"),
    "component_warmup": functools.partial(_of_family, "component_warmup"),
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
        return battery_resistance(battery)
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
        battery_resistance(battery),
        *(floors_effect(id, surfaces) for id in FLOORS if surfaces),
        *(logged_power_effect(name) for name in columns),
        *(_of_family("component_power", name) for name in components),
        *(_of_family("component_warmup", name) for name in components),
        *(effect for effect in plugins(Effect).values() if not effect.execution),
    )


def execution_effects() -> tuple[Effect, ...]:
    """`path_stretch`, `speed_tracking` and `dwell`."""
    return _EXECUTION
