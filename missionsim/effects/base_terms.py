"""Terms of base models: the effects from which robot files build what a robot draws before any finding."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

import numpy as np

from missionsim.effects.base import Effect, Parameters, ParameterSpec
from missionsim.effects.covariates import Covariates, Value, is_clock, is_moving, label_equals, number
from missionsim.errors import InputError
from missionsim.expressions import REMEMBERED, Expression
from missionsim.glossary import column_of
from missionsim.physics.lag import lagged
from missionsim.runs.covariates import MOTION


def load_term(
    id: str,
    component: str,
    equation: str,
    source: str,
    meaning: str,
    parameters: tuple[ParameterSpec, ...],
    unit_power: Callable[[Covariates, Parameters], Value],
    column: str = "",
    needs: tuple[str, ...] = (),
) -> Effect:
    """Power of one unit of a component times the units in `column`, always one without it; off where a log lacks it."""

    def power(cov: Covariates, p: Parameters) -> Any:
        units = number(cov, column) if column else _ones(cov)
        return unit_power(cov, p) * units

    text, about = (equation, source, f"{component}, {meaning}"), needs[0] if needs else column or "time_s"
    return Effect(id, *text, parameters, needs, power, component=component, covariate=about)


def component_term(component: str, *, starting: bool = False, always_on: bool = False) -> Effect:
    """Constant power per unit that is on, or that is starting up (Jaiem 2021, Eqs. 3 and 4)."""
    id, state = (
        ("startup", "starting") if starting else ("always_on", "always on") if always_on else ("component", "on")
    )
    column = "" if always_on else f"{state}_{component}"
    source = "data sheet of the component" if starting else "Jaiem 2021, Eqs. 3 and 4"
    spec = ParameterSpec("power", "W", "power of one unit")
    return load_term(
        id, component, f"P·units {state}", source, f"per unit {state}", (spec,), lambda _, p: p["power"], column
    )


def law_term(component: str, formula: Expression, specs: tuple[ParameterSpec, ...], always_on: bool) -> Effect:
    """Power per unit on by a formula of covariates and parameters (sonar: Jaiem 2021, Eq. 12)."""
    column, needs = "" if always_on else f"on_{component}", _needs(formula, {spec.name for spec in specs})

    def unit_power(cov: Covariates, p: Parameters) -> Any:
        return formula.evaluate({**aliased(cov), **p})

    return load_term("law", component, formula.source, "robot file", formula.source, specs, unit_power, column, needs)


def switchboard_term(name: str, levels: int, components: tuple[str, ...]) -> Effect:
    """USB switchboard: power by the number of relays that are closed (Jaiem 2021, Table 3). One parameter per number of
    relays; the relays are those of the units that are on or start."""
    specs = tuple(ParameterSpec(f"relays_{i}", "W", f"with {i} relays closed") for i in range(levels))

    def power(cov: Covariates, p: Parameters) -> Any:
        units = (number(cov, f"{state}_{component}") for component in components for state in ("on", "starting"))
        closed = sum(map(np.asarray, units), start=np.asarray(0.0))
        table = [p[spec.name] for spec in specs]
        result: Any = table[0] * np.ones_like(closed, dtype=float)
        for i, watts in enumerate(table[1:], start=1):
            result = np.where(closed >= i, watts, result)
        return result

    text = ("P(relays closed)", "Jaiem 2021, Table 3", f"switchboard {name}")
    return Effect("switchboard", *text, specs, (), power, component=name)


def processor_term(
    entries: tuple[tuple[str, str, Mapping[str, int], str], ...],
    columns: tuple[str, ...],
    idle: str | None = None,
    exact: bool = False,
) -> Effect:
    """Processor power by control scheme, navigation and sensor set (Jaiem 2021, Table 4).

    A configuration that no row names takes the row of its scheme with the fewest units differing (another navigation
    counts as half a unit). Where no scheme runs, or one without any row, the power is `idle`. `entries`: one row of the
    table each, the larger power first among equals; an empty navigation fits any. `columns`: the ``on_…`` columns that
    distinguish configurations. `idle`: parameter that holds where no scheme runs; 0 W without it. `exact`: whether a
    configuration that no row names is a fault instead.
    """
    names = tuple(dict.fromkeys(entry[3] for entry in entries))
    specs = tuple(ParameterSpec(name, "W", "processor power") for name in (*names, *((idle,) if idle else ())))

    wanted = [
        [(column, units) for column in columns if (units := sensors.get(column[3:], 0))] for _, _, sensors, _ in entries
    ]

    def power(cov: Covariates, p: Parameters) -> Any:
        units = {column: np.asarray(number(cov, column), dtype=float) for column in columns}
        on = sum(map(np.abs, units.values()), start=0.0)
        # grows to the shape of what distinguishes the rows, which is often less than that of the speed
        nearest: Any = np.asarray(np.inf)
        result: Any = p[idle] if idle else 0.0
        for (scheme, navigation, _, name), differs in zip(entries, wanted, strict=True):
            distance = sum((np.abs(units[c] - count) - np.abs(units[c]) for c, count in differs), start=on)
            if navigation:
                distance = distance + 0.5 * ~np.asarray(label_equals(cov.get("navigation", navigation), navigation))
            distance = np.where(label_equals(cov["scheme"], scheme), distance, np.inf)
            closer = distance < nearest
            nearest = np.where(closer, distance, nearest)
            result = np.where(closer, p[name], result)
        if exact and np.any(np.isfinite(nearest) & (nearest > 0.0)):
            raise InputError.single(
                "the processor's table has no row for a set of sensors that was used",
                allowed="a row under schemes.<scheme>.processor for it, or processor.fallback: nearest",
            )
        return result

    text = ("P(scheme, navigation, sensors)", "Jaiem 2021, Table 4", "processor")
    return Effect("processor", *text, specs, ("scheme",), power, component="processor")


def motion_expression_terms(
    formula: Expression, standing: Expression | None, parameters: tuple[str, ...]
) -> tuple[Effect, Effect]:
    """A user's base formula as two terms: what motion adds, and what is left when nothing moves.

    At rest the power is `standing`, or the formula at zero speed where that is not given. Gives ``motion`` (of the
    drive) and ``electronics``.
    """
    used = tuple(name for name in parameters if name in formula.names)
    rest = tuple(name for name in parameters if name in formula.names | (standing.names if standing else frozenset()))
    needs = _needs(formula, frozenset(parameters))

    def at_rest(cov: Covariates, p: Parameters) -> Any:
        still = {**cov, **{name: 0.0 * np.asarray(cov[name]) for name in MOTION if name in cov}}
        return formula.evaluate({**aliased(still), **p})

    def drive(cov: Covariates, p: Parameters) -> Any:
        return (formula.evaluate({**aliased(cov), **p}) - at_rest(cov, p)) * is_moving(cov)

    def electronics(cov: Covariates, p: Parameters) -> Any:
        moving = at_rest(cov, p) * _ones(cov)
        if standing is None:
            return moving
        return np.where(is_moving(cov), moving, np.asarray(standing.evaluate({**aliased(cov), **p})))

    def specs(names: tuple[str, ...]) -> tuple[ParameterSpec, ...]:
        return tuple(ParameterSpec(name, "", "base parameter", low=-float("inf")) for name in names)

    told, about = (formula.source, "robot file"), needs[0] if needs else "speed_m_s"
    moving = (*told, "base power of moving", specs(used), needs, drive)
    resting = (*told, "power when nothing moves", specs(rest), needs, electronics)
    return (
        Effect("motion", *moving, drive=True, covariate=about),
        Effect("electronics", *resting, component="controller", covariate="time_s"),
    )


def expression_term(id: str, formula: Expression, specs: tuple[ParameterSpec, ...], *, drive: bool = False) -> Effect:
    """A user's own formula over covariates and parameters as an effect."""
    own = {spec.name for spec in specs}
    needs = _needs(formula, own)

    def power(cov: Covariates, p: Parameters) -> Any:
        return formula.evaluate({**aliased(cov), **p, REMEMBERED: partial(_remembered, cov)}) * _ones(cov)

    text, sign = (formula.source, "robot file", formula.source), 1 if specs and specs[0].low >= 0.0 else 0
    memory = tuple(filter(is_clock, needs))
    return Effect(id, *text, specs, needs, power, drive=drive, sign=sign, memory=memory, lags=formula.lags)


def _remembered(cov: Covariates, text: str, x: Value, tau_s: Value) -> Value:
    """The lag of x: as given with the covariates, or of the rows of a log; x itself where no time goes on."""
    if text in cov:
        given: Value = cov[text]
        return given
    time_s = cov.get("time_s", 0.0)
    if np.ndim(x) != 1 or np.shape(x) != np.shape(time_s):
        return x
    return lagged(np.asarray(x), np.asarray(time_s), float(tau_s))


ALIASES = {"v": "speed_m_s", "a": "accel_m_s2", "w": "yaw_rate_rad_s", "u": "lateral_speed_m_s"}
ALIASES |= {"theta": "slope_rad", "m": "mass_kg"}
"""Short names that formulas may use."""
_UNITS = {"moving_time_s": "s", "mass_kg": "kg", "drive_w": "W", "load_w": "W"}


def unit_named(name: str) -> str:
    """Unit of what a formula names so, beside its own parameters; empty where nobody knows."""
    own = ALIASES.get(name, name)
    column = None if own.startswith("on_time_") else column_of(own)
    return column[0].unit if column else "s" if own.startswith("on_time_") else _UNITS.get(own, "")


def _needs(formula: Expression, own: Collection[str]) -> tuple[str, ...]:
    """Covariates that a formula reads beside its own parameters; the mass is always there."""
    return tuple(sorted({ALIASES.get(name, name) for name in formula.names - set(own)} - {"mass_kg"}))


def aliased(cov: Covariates) -> Covariates:
    """Covariates under their own and their short names.

    ``v`` is how fast, forwards or backwards, and ``a`` the rate of that: a robot that reverses draws power as well, and
    a formula such as ``c2*v**2 + c3*v`` means its magnitude. ``speed_m_s`` keeps its sign.
    """
    short = {name: cov[column] for name, column in ALIASES.items() if column in cov}
    if "v" in short:
        backwards = np.asarray(short["v"]) < 0.0
        short["v"] = np.abs(short["v"])
        if "a" in short:
            short["a"] = np.where(backwards, -1.0, 1.0) * short["a"]
    return {**cov, **short}


def _ones(cov: Covariates) -> Any:
    return np.ones(np.shape(number(cov, "speed_m_s", 0.0))[-1:])  # one row for all draws
