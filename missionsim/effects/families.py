"""Effects of the library that come in families: by floor, component, logged column or battery."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.covariates import Covariates, label_equals, number
from missionsim.glossary import column_of
from missionsim.physics import electrical, motion

TAU_GRID_S = (20.0, 60.0, 180.0, 540.0)
TAU = ParameterSpec("tau", "s", "time constant", low=1.0, high=7200.0, default=120.0, grid=TAU_GRID_S)
LOGGED = "logged"
"""Component under which watts that are logged beside are booked."""


def coefficient(unit: str, meaning: str, high: float = float("inf")) -> ParameterSpec:
    """The parameter ``k``, in which an effect is linear."""
    return ParameterSpec("k", unit, meaning, high=high)


class _ByFloor(NamedTuple):
    """An effect with a coefficient for each floor."""

    equation: str
    unit: str
    meaning: str
    source: str
    needs: tuple[str, ...]
    covariate: str
    unit_power: Callable[[Covariates], Any]


_FLOORS = {
    "surface_rolling_resistance": _ByFloor(
        "v",
        "N",
        "rolling resistance",
        "rover paper, Eq. 4, with C_r by surface",
        ("surface", "speed_m_s"),
        "surface",
        lambda c: motion.rolling_power(c["speed_m_s"], 1.0),
    ),
    "surface_turning_scrub": _ByFloor(
        "|ω|",
        "W s/rad",
        "tyres scrubbing sideways in turns",
        "Coulomb friction of tyres that slide sideways, by floor; in none of the four papers",
        ("surface", "yaw_rate_rad_s"),
        "yaw_rate_rad_s",
        lambda c: motion.turning_power(c["yaw_rate_rad_s"], 1.0),
    ),
}
FLOORS = tuple(_FLOORS)
"""Ids of the effects with a coefficient for each floor."""


def floors_effect(id: str, surfaces: tuple[str, ...]) -> Effect:
    """An effect of `FLOORS` on several surfaces at once, one coefficient ``k_<surface>`` each."""
    of = _FLOORS[id]

    def power(c: Covariates, p: Mapping[str, Any]) -> Any:
        whole = of.unit_power(c)
        return sum((p[f"k_{name}"] * whole * label_equals(c["surface"], name) for name in surfaces), start=0.0 * whole)

    specs = tuple(ParameterSpec(f"k_{name}", of.unit, f"{of.meaning} on {name}") for name in surfaces)
    equation, meaning = f"k_s·{of.equation} on surface s", f"{of.meaning}, by floor"
    parts = tuple(spec.name for spec in specs)
    return Effect(
        id, equation, of.source, meaning, specs, of.needs, power, drive=True, covariate=of.covariate, parts=parts
    )


def floor_effect(id: str, surface: str) -> Effect:
    """An effect of `FLOORS` on one surface: ``k`` where the floor is `surface`."""
    of, whole = _FLOORS[id], floors_effect(id, (surface,))
    return replace(
        whole,
        id=f"{id}:{surface}",
        equation=f"k·{of.equation} on surface '{surface}'",
        meaning=f"more {of.meaning} on {surface}",
        parameters=(coefficient(of.unit, "coefficient"),),
        parts=(),
        power=lambda c, p: whole.power(c, {f"k_{surface}": p["k"]}),
    )


def logged_power_effect(column: str) -> Effect:
    """`logged_power:<column>`: ``k`` times the watts of a log column (``…_w``, or ``…_kw`` times 1000)."""
    factor = 1000.0 if column.endswith("_kw") else 1.0
    return Effect(
        f"logged_power:{column}",
        f"k·{column}" + (" in W" if factor > 1.0 else ""),
        "assumed: what another meter measured is drawn from this battery, with k the loss on the way",
        f"{column}, which is logged beside, drawn from this battery",
        (coefficient("1", "battery power for each watt logged, near 1", 10.0),),
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
        "Joule: resistance times current squared, with the voltage that was measured",
        "heat in the battery's leads",
        (coefficient("ohm", "resistance", 10.0),),
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
        "Jaiem 2021, Eq. 3",
        f"{component} draws more than its data sheet says",
        (coefficient("W", "power of one unit"),),
        (column,),
        lambda c, p: p["k"] * c[column],
        component=component,
        covariate=column,
    )


def component_warmup_effect(component: str) -> Effect:
    """`component_warmup:<component>`: ``k exp(−t/τ)`` after it was switched on."""
    column, clock = f"on_{component}", f"on_time_{component}_s"
    return Effect(
        f"component_warmup:{component}",
        "k·exp(−time since switched on/τ)",
        "assumed form: one time constant after switching on",
        f"{component} draws more until it is warm",
        (coefficient("W", "extra power when switched on"), TAU),
        (column, clock),
        lambda c, p: electrical.warmup_power(c[column], c[clock], p["k"], p["tau"]),
        component=component,
        memory=(clock,),
        covariate=clock,
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
