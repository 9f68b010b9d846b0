"""Units in text (``14.8 V``, ``10 min``, ``2200 mAh``) to SI floats, with the dimension checked.

The units that robot files use are in a small table (``units.json``: their factors to SI), since loading pint costs more
than a whole `missionsim validate`; any other unit goes to pint, which is loaded then.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from missionsim.errors import did_you_mean

_MOST_POWERS = 100
"""Product of all exponents of a unit: (m^9)^9 is no unit of anything."""
_TOKEN = re.compile(r"([A-Za-zΩµ°%1]+)(?:\^(-?\d))?")
_WORD = re.compile(r"[A-Za-zΩµ°]+")
_NUMBER = re.compile(r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$", re.DOTALL)


@dataclass(frozen=True)
class Dimension:
    """A kind of quantity: its SI unit inside, the unit of a plain number in YAML, an example for messages."""

    name: str
    si: str
    plain: str
    example: str
    pint: str
    exponents: Sequence[int]
    """Of m, kg, s, A and K; an angle counts as a plain number."""
    units: dict[str, float]
    """Factors to SI of the units that robot files use; any other of pint's is known as well."""

    def __str__(self) -> str:
        """``a length such as 50 m``."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name} such as {self.example}"

    def plain_to_si(self, number: float) -> float:
        """A plain YAML number in the field's plain unit to SI (Wh to J, Ah to C; others unchanged)."""
        return number * self.units.get("" if self.plain == "1" else self.plain, 1.0)


_TABLE: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("units.json").read_text("utf-8"))
DIMENSIONS = {name: Dimension(name, **told) for name, told in _TABLE.items()}
_OF = {unit: dimension for dimension in reversed(DIMENSIONS.values()) for unit in dimension.units if unit}
_SIMPLE: dict[str, tuple[float | None, Sequence[int]]] = {
    **{unit: (None if of.name == "temperature" else of.units[unit], of.exponents) for unit, of in _OF.items()},
    "1": (1.0, (0, 0, 0, 0, 0)),
    "K": (1.0, (0, 0, 0, 0, 1)),
    "N": (None, (1, 1, -2, 0, 0)),
}
"""Units that stand in products: factor to SI (None: pint knows it) and exponents."""


class UnitError(ValueError):
    """A text that is not a quantity of the wanted dimension; `allowed` says what is."""

    def __init__(self, message: str, got: str, allowed: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.got, self.allowed, self.hint = message, got, allowed, hint


def split(text: str) -> tuple[float, str] | None:
    """``"14.8 V"`` to ``(14.8, "V")``, or None where the text does not begin with a number."""
    match = _NUMBER.match(text)
    if match is None:
        return None
    return float(match.group(1)), " ".join(match.group(2).split())


def unit_factor(unit: str, dimension: str) -> tuple[float, float]:
    """Factor and offset to SI (``si = factor * number + offset``) of a unit of the wanted dimension. Raises UnitError:
    unknown unit, or a unit of another dimension."""
    if scaled := re.fullmatch(r"(\d*\.?\d+)\s*([^\d\s/].*)", unit):  # the tenth volts of a register, `0.1 V`
        factor, zero = _factor(scaled[2], dimension)
        if zero == 0.0 < float(scaled[1]):
            return float(scaled[1]) * factor, 0.0
    return _factor(unit, dimension)


def _factor(unit: str, dimension: str) -> tuple[float, float]:
    """The same of a unit without a number before it: `1 500 Wh` is no quantity."""
    of = DIMENSIONS[dimension]
    if unit in of.units:
        return of.units[unit], 0.0
    if unit in _OF:
        raise UnitError(f"wrong unit: {unit} is a unit of {_OF[unit].name}", unit, str(of))
    quantity = _pint_unit(unit, str(of), of.units)
    try:
        zero, one = (float(_registry().Quantity(n, quantity.units).to(of.pint).magnitude) for n in (0.0, 1.0))
    except Exception:
        raise UnitError("wrong unit", repr(unit)[:60], str(of)) from None
    return one - zero, zero


def parse(text: str, dimension: str = "") -> tuple[float, str]:
    """Text with a unit to a number in SI, and the SI unit's name.

    `text`: ``"14.8 V"``; without a unit the number is in the field's plain unit. `dimension`: key of `DIMENSIONS`; any
    unit without it (parameters of effects). Raises UnitError: not a number with a unit of that dimension.
    """
    of, parts = DIMENSIONS.get(dimension), split(text)
    if parts is None:
        raise UnitError("not a number with a unit", repr(text)[:60], str(of or "a number, with a unit or without"))
    number, unit = parts
    if of is None:
        factor, si = any_unit(unit) if unit else (1.0, "")
        return number * factor, si
    if not unit:
        return of.plain_to_si(number), of.si
    try:
        factor, offset = _factor(unit, dimension)
    except UnitError as problem:
        raise UnitError(problem.message, text[:60], problem.allowed, problem.hint) from None
    return number * factor + offset, of.si


def si_factor(unit: str) -> float | None:
    """Factor to SI of a unit (``Wh``, ``%``, ``W/rpm``), or None for one of temperature or that is not known."""
    if unit in _OF:
        return _SIMPLE[unit][0]
    try:
        return None if exponents(unit) == exponents("K") else any_unit(unit)[0]
    except UnitError:
        return None


def any_unit(unit: str) -> tuple[float, str]:
    """Factor to coherent SI of any unit, and the SI unit's name (the unit itself where the factor is 1). Raises
    UnitError: unknown unit, or one with an offset (degC inside a product)."""
    if unit in _OF:
        return _OF[unit].units[unit], _OF[unit].si
    known = _product(unit)
    if known is not None and known[0] == 1.0:
        return 1.0, unit
    quantity = _pint_unit(unit, "a unit such as W s/m", _OF)
    try:
        base = quantity.to_base_units()
        offset = (0.0 * quantity).to_base_units().magnitude
    except Exception:
        offset = math.nan
    if offset != 0.0:
        raise UnitError("unit with an offset", repr(unit), "K for differences of temperature")
    size = float(base.magnitude)
    if math.isclose(size, 1.0):
        return size, unit
    # W min/m is W s/m rather than kg m/s^2, where SI units of the table in place of its own say the same
    plain = _WORD.sub(lambda match: _in_si(match[0]), unit)
    same = plain != unit and math.isclose(float(_pint_unit(plain, "", ()).to_base_units().magnitude), 1.0)
    return size, plain if same else "W" if exponents(unit) == exponents("W") else f"{base.units:~}" or "1"


def _in_si(name: str) -> str:
    si = _OF[name].si if name in _OF else name
    return f"({si})" if "/" in si else si


def same_dimension(unit: str, other: str) -> bool:
    """Whether two units, simple or compound, measure the same kind of quantity (``N`` and ``W s/m`` do). A unit that
    cannot be read here counts as the same: reading the number has told that fault already."""
    if unit == other:
        return True
    first, second = exponents(unit), exponents(other)
    return first is None or second is None or first == second


def exponents(unit: str) -> tuple[float, ...] | None:
    """Exponents of m, kg, s, A, K; None for a unit that neither the table nor pint knows."""
    known = _product(unit)
    if known is not None:
        return known[1]
    try:
        found = _pint_unit(unit, "", ()).dimensionality
    except UnitError:
        return None
    axes = ("[length]", "[mass]", "[time]", "[current]", "[temperature]")
    return tuple(round(float(found.get(axis, 0)), 6) for axis in axes)


def _product(unit: str) -> tuple[float | None, tuple[int, ...]] | None:
    """Factor and exponents of a product of simple units (``W s^2/m^2``, ``W/(m/s)^2``), where the table has all their
    factors; None where pint has to read it."""
    flat = unit.replace("**", "^").replace("*", " ").replace("·", " ")
    flat = re.sub(r"\(m/s\)\^(\d)", r"m^\1 s^-\1", re.sub(r"\s*\^\s*", "^", flat))
    if "(" in flat:
        return None
    factor: float | None = 1.0
    total = [0, 0, 0, 0, 0]
    for index, part in enumerate(flat.split("/")):
        for token in part.split():
            match = _TOKEN.fullmatch(token)
            if match is None or match[1] not in _SIMPLE:
                return None
            size, exponents = _SIMPLE[match[1]]
            power = int(match[2] or 1) * (1 if index == 0 else -1)
            factor = None if factor is None or size is None else factor * size**power
            total = [old + power * new for old, new in zip(total, exponents, strict=True)]
    return factor, tuple(total)


def _pint_unit(unit: str, allowed: str, known: Iterable[str]) -> Any:
    flat = unit.replace("²", "^2").replace("³", "^3").replace("·", "*").replace("**", "^").replace("%", "percent")
    powers = math.prod(int(digits) for digits in re.findall(r"\^[\s(]*[-+]?(\d+)", flat[:60]))
    if (
        len(unit) > 60
        or not re.fullmatch(r"[A-Za-zµμΩ°/*^. ()0-9-]+", flat)
        or re.search(r"\d{3}|[\^*]\s*\d{2}|\d[\s)]*\^", flat)  # powers of numbers, and of powers, never end
        or powers > _MOST_POWERS
    ):
        raise UnitError("unknown unit", repr(unit)[:60], allowed)
    import pint

    try:
        return _registry().Quantity(1.0, flat)
    except pint.OffsetUnitCalculusError:
        raise UnitError("unit with an offset", repr(unit), allowed) from None
    except Exception:  # pint raises whatever its tokenizer meets (TypeError, AttributeError, TokenError…)
        names = list(known)
        same = [name for name in names if name.lower() == unit.lower()]
        hint = same[0] if same else did_you_mean(unit, names, 0.5)
        raise UnitError("unknown unit", repr(unit)[:60], allowed, hint) from None


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()
