"""Dimensions of formulas: whether what a robot file calls a power is one, as far as the units in it tell."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from missionsim.effects.base_terms import ALIASES
from missionsim.glossary import column_of
from missionsim.inputs.units import exponents

Exponents = tuple[float, ...]
"""Of m, kg, s, A and K."""

_PLAIN: Exponents = (0.0,) * 5
_OWN = {"moving_time_s": "s", "mass_kg": "kg", "drive_w": "W", "load_w": "W"}
_SAME = frozenset({"abs", "floor", "lag"})
_ALIKE = frozenset({"max", "min", "maximum", "minimum", "clip", "hypot"})


def dimension_fault(formula: str, units: Mapping[str, str]) -> str:
    """What is wrong with the dimension of a formula that gives watts; empty where nothing is known to be.

    `units`: of its parameters, empty where the file gives none. A number in the formula may stand for something with a
    unit, and so may a parameter without one: of what they are multiplied with nothing is known.
    """
    known = {name: "" if unit == "1" else unit for name, unit in units.items()}  # 1: a number without one
    if not any(known.values()):
        return ""
    try:
        found = _of(ast.parse(formula.strip(), mode="eval").body, known)
    except _Unlike as problem:
        return str(problem)
    return "" if found is None or found == exponents("W") else f"the formula gives {_told(found)}, no power"


class _Unlike(Exception):
    """A sum of what cannot be added."""


def _of(node: ast.expr, units: Mapping[str, str]) -> Exponents | None:
    """Exponents of part of a formula; None where they are not known."""
    match node:
        case ast.Name(id=name) if name in units:
            return exponents(units[name]) if units[name] else None
        case ast.Name(id=name):
            column = column_of(ALIASES.get(name, name))
            unit = "s" if name.startswith("on_time_") else column[0].unit if column else ""
            unit = _OWN.get(ALIASES.get(name, name), unit)
            return exponents(unit) if unit else None
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
            return _of(inner, units)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            first, second = _of(left, units), _of(right, units)
            sign = 1.0 if isinstance(op, ast.Mult) else -1.0
            if first is None or second is None:
                return None
            return tuple(a + sign * b for a, b in zip(first, second, strict=True))
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _alike([left, right], units)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() | float() as power)):
            return _powered(_of(left, units), power)
        case ast.IfExp(body=body, orelse=orelse):
            return _alike([body, orelse], units)
        case ast.Call(func=ast.Name(id="sqrt"), args=[inner]):
            return _powered(_of(inner, units), 0.5)
        case ast.Call(func=ast.Name(id="where"), args=[_, *both]):
            return _alike(both, units)
        case ast.Call(func=ast.Name(id=name), args=[inner, *_]) if name in _SAME:
            return _of(inner, units)
        case ast.Call(func=ast.Name(id=name), args=args) if name in _ALIKE:
            return _alike(args, units)
        case ast.Call() | ast.Compare() | ast.BoolOp():
            return _PLAIN  # sines, exponentials, what holds or not
    return None


def _powered(base: Exponents | None, power: float) -> Exponents | None:
    return None if base is None else tuple(round(one * power, 6) for one in base)


def _alike(parts: list[ast.expr], units: Mapping[str, str]) -> Exponents | None:
    """Of a sum, or of the greatest of several: that of any part that is known; all have to have the same."""
    known = {ast.unparse(part): found for part in parts if (found := _of(part, units)) is not None}
    if len({*known.values()}) > 1:
        told = " and ".join(f"{text} in {_told(found)}" for text, found in known.items())
        raise _Unlike(f"the formula adds or compares {told}")
    return next(iter(known.values()), None)


def _told(found: Exponents) -> str:
    named = next((unit for unit in ("W", "J", "N", "m/s", "m/s^2", "V") if exponents(unit) == found), "")
    bare = " ".join(n if p == 1 else f"{n}^{p:g}" for n, p in zip(("m", "kg", "s", "A", "K"), found, strict=True) if p)
    return named or bare or "a plain number"
