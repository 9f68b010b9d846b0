"""The unit of a law's coefficient, from the units of the quantities that its formula reads."""

from __future__ import annotations

import ast
import re

from missionsim.glossary import column_of

_SAME = frozenset({"abs", "max", "min", "maximum", "minimum", "clip", "lag"})
_DERIVED = {"moving_time_s": "s", "mass_kg": "kg", "v": "m/s", "a": "m/s^2", "w": "rad/s", "u": "m/s", "m": "kg"}

Powers = dict[str, float]


def unit_of(formula: str) -> str:
    """Unit of ``k`` in ``k * …``, such as ``W s/rad/kg``, so that the whole is in W.

    Quantities that the glossary does not hold count as plain numbers, and so do switches, comparisons and what stands
    in an exponential or a hyperbolic tangent.
    """
    powers = _unit(ast.parse(formula, mode="eval").body)
    left = {name: -power for name, power in powers.items() if power}
    over = [name if p == 1 else f"{name}^{p:g}" for name, p in left.items() if p > 0]
    under = [f"/{name}" if p == -1 else f"/{name}^{-p:g}" for name, p in left.items() if p < 0]
    return " ".join(["W", *over]) + "".join(under)


def _unit(node: ast.AST) -> Powers:
    match node:
        case ast.Name(id=name):
            return _of_name(name)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _sum(_unit(left), _unit(right), 1.0)
        case ast.BinOp(left=left, op=ast.Div() | ast.FloorDiv(), right=right):
            return _sum(_unit(left), _unit(right), -1.0)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() | float() as power)):
            return {name: p * power for name, p in _unit(left).items()}
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mod(), right=right):
            return _unit(left) or _unit(right)
        case ast.UnaryOp(operand=operand):
            return _unit(operand)
        case ast.IfExp(body=body, orelse=orelse):
            return _unit(body) or _unit(orelse)
        case ast.Call(func=ast.Name(id="sqrt"), args=[inner]):
            return {name: 0.5 * p for name, p in _unit(inner).items()}
        case ast.Call(func=ast.Name(id="where"), args=[_, first, second]):
            return _unit(first) or _unit(second)
        case ast.Call(func=ast.Name(id=name), args=args) if name in _SAME:
            return next((found for found in map(_unit, args) if found), {})
    return {}


def _of_name(name: str) -> Powers:
    column = column_of(name)
    text = _DERIVED.get(name) or ("s" if name.startswith("on_time_") else column[0].unit if column else "")
    powers: Powers = {}
    for index, part in enumerate(text.split("/")):
        for token in part.split():
            match = re.fullmatch(r"([A-Za-z]+)(?:\^(\d))?", token)
            if match:
                base = "K" if match.group(1) == "degC" else match.group(1)
                powers[base] = float(match.group(2) or 1) * (1 if index == 0 else -1)
    return powers


def _sum(a: Powers, b: Powers, sign: float) -> Powers:
    return {name: a.get(name, 0.0) + sign * b.get(name, 0.0) for name in (*a, *(n for n in b if n not in a))}
