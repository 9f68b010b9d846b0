"""Units in text (``14.8 V``, ``10 min``, ``2200 mAh``) to SI floats, with the dimension checked.

The units that robot files use are in a small table (``units.json``: their factors to SI), since loading pint costs more
than a whole `missionsim validate`; any other unit goes to pint, which is loaded then.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from missionsim.errors import did_you_mean

_MOST_POWERS = 100
"""Product of all exponents of a unit: (m^9)^9 is no unit of anything."""
_NUMBER = re.compile(r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$", re.DOTALL)


@dataclass(frozen=True)
class Dimension:
    """A kind of quantity: its SI unit inside, the unit of a plain number in YAML, an example for messages.

    `exponents` are those of m, kg, s, A and K; an angle counts as a plain number.
    """

    name: str
    si: str
    plain: str
    example: str
    pint: str
    exponents: tuple[int, int, int, int, int]


_TABLE: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("units.json").read_text("utf-8"))
_FACTORS: dict[str, dict[str, float]] = {name: told.pop("units") for name, told in _TABLE.items()}
DIMENSIONS = {name: Dimension(name, **told | {"exponents": tuple(told["exponents"])}) for name, told in _TABLE.items()}
_PLAIN = {name: _FACTORS[name].get("" if item.plain == "1" else item.plain, 1.0) for name, item in DIMENSIONS.items()}
_DIMENSION_OF = {unit: name for name, table in reversed(_FACTORS.items()) for unit in table if unit}


class UnitError(ValueError):
    """A text that is not a quantity of the wanted dimension; `allowed` says what is."""

    def __init__(self, message: str, got: str, allowed: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.got, self.allowed, self.hint = message, got, allowed, hint


def allowed_text(dimension: str) -> str:
    """``a length such as 50 m``."""
    article = "an" if dimension[0] in "aeiou" else "a"
    return f"{article} {dimension} such as {DIMENSIONS[dimension].example}"


def units_of(dimension: str) -> tuple[str, ...]:
    """Units of a dimension that robot files use; any other of pint's is known as well."""
    return tuple(_FACTORS[dimension])


def plain_to_si(number: float, dimension: str) -> float:
    """A plain YAML number in the field's plain unit to SI (Wh to J, Ah to C; others unchanged)."""
    return number * _PLAIN[dimension]


def split(text: str) -> tuple[float, str] | None:
    """``"14.8 V"`` to ``(14.8, "V")``, or None where the text does not begin with a number."""
    match = _NUMBER.match(text)
    if match is None:
        return None
    return float(match.group(1)), " ".join(match.group(2).split())


def unit_factor(unit: str, dimension: str) -> tuple[float, float]:
    """Factor and offset to SI (``si = factor * number + offset``) of a unit of the wanted dimension. Raises UnitError:
    unknown unit, or a unit of another dimension."""
    factor = _FACTORS[dimension].get(unit)
    if factor is not None:
        return factor, 0.0
    other = _DIMENSION_OF.get(unit)
    if other is None:
        return _by_pint(unit, dimension)
    raise UnitError(f"wrong unit: {unit} is a unit of {other}", unit, allowed_text(dimension))


def parse_quantity(text: str, dimension: str) -> float:
    """Text with a unit to an SI float.

    `text`: ``"14.8 V"``; without a unit the number is in the field's plain unit. `dimension`: key of `DIMENSIONS`.
    The result is in `DIMENSIONS[dimension].si`. Raises UnitError: not a number with a unit of that dimension.
    """
    parts = split(text)
    if parts is None:
        raise UnitError("not a number with a unit", repr(text)[:60], allowed_text(dimension))
    number, unit = parts
    if unit == "":
        return plain_to_si(number, dimension)
    try:
        factor, offset = unit_factor(unit, dimension)
    except UnitError as problem:
        raise UnitError(problem.message, text[:60], problem.allowed, problem.hint) from None
    return number * factor + offset


def si_factor(unit: str) -> float | None:
    """Factor to SI of a unit of the table (``Wh``, ``%``, ``deg``), or None for any other."""
    if unit == "%":
        return 0.01
    name = _DIMENSION_OF.get(unit)
    return None if name is None or name == "temperature" else _FACTORS[name][unit]


def parse_any(text: str) -> tuple[float, str]:
    """Text with any unit to a number in coherent SI units and the unit's name (for parameters of effects). Raises
    UnitError: not a number, or an unknown unit."""
    parts = split(text)
    if parts is None:
        raise UnitError("not a number with a unit", repr(text)[:60], "a number, with a unit or without")
    number, unit = parts
    if not unit:
        return number, ""
    factor, si = any_unit(unit)
    return number * factor, si


def any_unit(unit: str) -> tuple[float, str]:
    """Factor to coherent SI of any unit, and the SI unit's name (the unit itself where the factor is 1). Raises
    UnitError: unknown unit, or one with an offset (degC inside a product)."""
    if unit == "%":
        return 0.01, "1"
    name = _DIMENSION_OF.get(unit)
    if name is not None:
        return _FACTORS[name][unit], DIMENSIONS[name].si
    factor = _compound(unit)
    if factor is not None and factor == 1.0:
        return 1.0, unit
    quantity = _pint_unit(unit, "a unit such as W s/m", _DIMENSION_OF)
    try:
        base = quantity.to_base_units()
    except Exception:
        raise UnitError("unit with an offset", repr(unit), "K for differences of temperature") from None
    size = float(base.magnitude)
    return size, unit if math.isclose(size, 1.0) else f"{base.units:~}"


_TOKEN = re.compile(r"([A-Za-zΩµ°%1]+)(?:\^(-?\d))?")


def _factors_of(unit: str) -> list[tuple[str, int]] | None:
    """Simple units of a product (``W s^2/m^2``, ``W/(m/s)^2``) and their exponents; None where pint has to read it."""
    flat = unit.replace("**", "^").replace("*", " ").replace("·", " ")
    flat = re.sub(r"\(m/s\)\^(\d)", r"m^\1 s^-\1", re.sub(r"\s*\^\s*", "^", flat))
    if "(" in flat:
        return None
    found = []
    for index, part in enumerate(flat.split("/")):
        for token in part.split():
            match = _TOKEN.fullmatch(token)
            if match is None:
                return None
            found.append((match.group(1), int(match.group(2) or 1) * (1 if index == 0 else -1)))
    return found


def _compound(unit: str) -> float | None:
    """Factor of a product of known units, or None where pint has to read it."""
    factor = 1.0
    parts = _factors_of(unit)
    for name, power in parts or ():
        base = 1.0 if name in ("1", "K") else next((table[name] for table in _FACTORS.values() if name in table), None)
        if base is None or name in _FACTORS["temperature"]:
            return None
        factor *= base**power
    return None if parts is None else factor


def same_dimension(unit: str, other: str) -> bool:
    """Whether two units, simple or compound, measure the same kind of quantity (``N`` and ``W s/m`` do). A unit that
    cannot be read here counts as the same: reading the number has told that fault already."""
    if unit == other:
        return True
    first, second = _dimension(unit), _dimension(other)
    return first is None or second is None or first == second


def _dimension(unit: str) -> tuple[int, ...] | None:
    """Exponents of m, kg, s, A, K; None for a unit that neither the table nor pint knows."""
    total = [0, 0, 0, 0, 0]
    parts = _factors_of(unit)
    if parts is None:
        return _dimension_by_pint(unit)
    for base, power in parts:
        name = {"1": "number", "%": "number", "K": "temperature"}.get(base, _DIMENSION_OF.get(base))
        if name is None and base != "N":
            return _dimension_by_pint(unit)
        exponents = DIMENSIONS[name].exponents if name is not None else (1, 1, -2, 0, 0)
        total = [old + power * new for old, new in zip(total, exponents, strict=True)]
    return tuple(total)


def _dimension_by_pint(unit: str) -> tuple[int, ...] | None:
    try:
        found = _pint_unit(unit, "", ()).dimensionality
    except UnitError:
        return None
    axes = ("[length]", "[mass]", "[time]", "[current]", "[temperature]")
    return tuple(round(float(found.get(axis, 0))) for axis in axes)


def _pint_unit(unit: str, allowed: str, known: Iterable[str]) -> Any:
    flat = unit.replace("²", "^2").replace("³", "^3").replace("·", "*").replace("**", "^")
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
        raise UnitError("unknown unit", repr(unit)[:60], allowed, _close_unit(unit, list(known))) from None


def _close_unit(unit: str, known: list[str]) -> str:
    same = [name for name in known if name.lower() == unit.lower()]
    return same[0] if same else did_you_mean(unit, known, 0.5)


def _by_pint(unit: str, dimension: str) -> tuple[float, float]:
    allowed = allowed_text(dimension)
    quantity = _pint_unit(unit, allowed, _FACTORS[dimension])
    try:
        target = DIMENSIONS[dimension].pint
        zero = _registry().Quantity(0.0, quantity.units).to(target)
        one = _registry().Quantity(1.0, quantity.units).to(target)
    except Exception:
        raise UnitError("wrong unit", repr(unit)[:60], allowed) from None
    return float(one.magnitude - zero.magnitude), float(zero.magnitude)


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()
