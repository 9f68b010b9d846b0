"""What the checks across the parts of a file share; whether a formula is a power, as far as the units in it tell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from missionsim.effects.base_terms import unit_named
from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import Lag, Powers, UnlikeError, compile_expression, units_in
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Document, Where, as_written
from missionsim.inputs.units import exponents

_BASE = ("m", "kg", "s", "A", "K")


def dimension_fault(formula: str, units: Mapping[str, str]) -> str:
    """What is wrong with the dimension of a formula that gives watts; empty where nothing is known to be.

    `units`: of its parameters, empty where the file gives none. A number in the formula may stand for something with a
    unit, and so may a parameter without one: of what they are multiplied with nothing is known.
    """
    known = {name: "" if unit == "1" else unit for name, unit in units.items()}  # 1: a number without one
    if not any(known.values()):
        return ""
    try:
        found = units_in(formula, lambda name: _powers(known[name] if name in known else unit_named(name)))
    except UnlikeError as problem:
        told = " and ".join(f"{text} in {_told(powers)}" for text, powers in problem.parts.items())
        return f"the formula adds or compares {told}"
    return "" if found is None or _told(found) == "W" else f"the formula gives {_told(found)}, no power"


def _powers(unit: str) -> Powers | None:
    powers = exponents(unit) if unit else None
    return None if powers is None else dict(zip(_BASE, powers, strict=True))


def _told(found: Powers) -> str:
    powers = tuple(found.get(name, 0.0) for name in _BASE)
    named = next((unit for unit in ("W", "J", "N", "m/s", "m/s^2", "V") if exponents(unit) == powers), "")
    bare = " ".join(n if p == 1 else f"{n}^{p:g}" for n, p in zip(_BASE, powers, strict=True) if p)
    return named or bare or "a plain number"


_SHOWN = 24

DERIVED = ("moving_time_s", "moving", "starts", "mass_kg", "drive_w", "load_w")
"""Covariates that a run or a log adds to the glossary's columns."""


class Checker:
    """Collects faults of one document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[Fault] = []

    def add(self, where: Where, message: str, got: str = "", allowed: str = "", hint: str = "", **marks: bool) -> None:
        """One fault at a path of the file, unless that place was told to be faulty already."""
        if not self.document.is_faulty(where):
            self.faults.append(self.document.fault(where, message, got, allowed, hint, **marks))

    def known(
        self, where: Where, name: str, names: Iterable[str], what: str, *, key: bool = False, message: str = ""
    ) -> bool:
        """Whether `name` is one of `names`; a fault with did-you-mean where it is not."""
        options = list(names)
        if name in options:
            return True
        shown = ", ".join(options[:_SHOWN]) + (f" and {len(options) - _SHOWN} more" if len(options) > _SHOWN else "")
        allowed, hint = shown or f"there is no {what} here", did_you_mean(name, options)
        self.add(where, message or f"no {what} '{name}'", as_written(name), allowed, hint, key=key)
        return False

    def named(self, where: Where, name: str, block: str, what: str) -> bool:
        """The same with the names of a block of the file; nothing is told where the block is at fault itself."""
        if self.document.is_faulty((block,)):
            return False
        return self.known(where, name, self.document.names(block), what)

    def keys(self, where: Where, given: object, names: Iterable[str], what: str) -> None:
        """Faults for the keys of a mapping that are none of `names`."""
        for name in given if isinstance(given, Mapping) else ():
            self.known((*where, name), name, names, what, key=True)

    def units(self, where: Where, name: str, count: int, robot: RobotSpec, least: int = 0, message: str = "") -> bool:
        """Whether a robot has a component, and as many units of it."""
        key = where[-1] == name
        known = robot.document.names("components")
        if not self.known(where, name, known, "component", key=key, message=message):
            return False
        spec = robot.components.get(name)
        if spec is not None and count > spec.units:
            at = where if key else (*where[:-1], "units")
            self.add(at, f"more units of '{name}' than the robot has", str(count), f"{least} to {spec.units}")
            return False
        return spec is not None

    def stands_still(self, where: Where, scheme: str, robot: RobotSpec, got: str, *, key: bool = False) -> None:
        """The fault of a control scheme that drives nowhere, where one that moves is needed."""
        moves = ", ".join(name for name, item in robot.schemes.items() if item.motion)
        self.add(where, f"control scheme '{scheme}' stands still", got, moves, key=key)

    def formulas(
        self, texts: Mapping[Where, str], own: Mapping[str, Parameter], times: Mapping[str, Parameter] | None = None
    ) -> None:
        """Formulas of a power, by their paths, that can be read, give watts as far as units tell, name what there is
        and together use all their parameters. Names of further log columns are allowed; one that is nearly a known name
        gets a warning.

        `own`: their parameters; `times`: those that may be time constants of lags; no lag is allowed where there can be
        none.
        """
        from missionsim.effects.base_terms import ALIASES

        parameters = list(own)
        known = [*parameters, *ALIASES, *DERIVED, *(column.name for column in COLUMNS)]
        used: set[str] = set()
        for where, text in texts.items():
            try:
                expression = compile_expression(text, **self.document.place(where)._asdict())
            except InputError as problem:
                self.faults.extend(problem.faults)
                return
            self.faults += [fault for lag in expression.lags for fault in _lag_faults(lag, times)]
            used |= expression.names
            if wrong := dimension_fault(text, {name: parameter.unit for name, parameter in own.items()}):
                self.add(where, wrong, text[:80], "a power in W, of terms that can be added")
            mass = next((name for name in ("m", "mass_kg") if name in expression.names and name not in own), None)
            if mass is not None and "payload_kg" in expression.names - own.keys():
                message = f"'{mass}' holds the payload already: a formula with payload_kg beside it may count it twice"
                self.add(where, message, text[:80], f"{mass} alone, or the robot's own mass as a number", warning=True)
            for name in sorted(expression.names):
                if name in known or column_of(name) is not None or name.startswith(("on_time_", "starting_")):
                    continue
                hint = did_you_mean(name, known, 0.8)
                if hint:
                    message = f"formula names '{name}', which is no column of the glossary"
                    allowed = "a parameter, a glossary column, or a further column of your logs"
                    self.add(where, message, text[:80], allowed, hint, warning=True)
        where, text = next(iter(texts.items()))
        for name in parameters:
            if name not in used:
                self.add(where, f"parameter '{name}' does not occur in the formula", got=text[:80], warning=True)
            elif (column := ALIASES.get(name, name)) != name or column_of(name) is not None:
                message = f"'{name}' in the formula is the parameter of that name, not what {column} is"
                self.add(where, message, text[:80], "another name for the parameter", warning=True)


def _lag_faults(lag: Lag, times: Mapping[str, Parameter] | None) -> Iterator[Fault]:
    """What is wrong with the lag of a formula beside its parameters."""
    if times is None:
        yield lag.place.fault("a lag has no place here", got=lag.text, allowed="lag(x, tau) in the power of an effect")
        return
    if lag.names <= times.keys():
        told = "a lag of columns: lag(abs(speed_m_s), 8)"
        yield lag.place.fault("lag of something that is constant", got=lag.text, allowed=told)
    if not lag.parameter:
        return
    told, tau = f"a number in s, or a parameter {lag.parameter} with a unit of time", times.get(lag.parameter)
    if tau is None:
        yield lag.place.fault(f"the time constant '{lag.parameter}' is no parameter", got=lag.text, allowed=told)
    elif tau.unit not in ("", "1", "s"):  # a plain number is in s
        yield lag.place.fault(f"wrong unit of the time constant '{lag.parameter}'", got=tau.unit, allowed=told)
    elif not tau.value > 0.0:
        got, allowed = f"{tau.value:g} s", "more than 0 s"
        yield lag.place.fault(f"impossible time constant '{lag.parameter}'", got=got, allowed=allowed)
