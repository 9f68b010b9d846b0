"""Safe arithmetic expressions over named numbers: parsed, checked, compiled to closures, never evaluated as Python.

Only what a formula needs is allowed: numbers, names, ``+ - * / // % **``, comparisons, ``and``/``or``/``not``, a
conditional ``a if c else b``, the functions of `FUNCTIONS`, comparison of a text column with a quoted word, and
``lag(x, tau)``, a first-order lag whose past whoever evaluates the formula gives (`REMEMBERED`).
"""

from __future__ import annotations

import ast
import functools
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.numerals import counted

_OF_NUMPY = (
    "abs arctan arctan2 arcsin arccos clip cos degrees exp floor hypot log maximum minimum radians sign sin sqrt"
)
FUNCTIONS: dict[str, Callable[..., Any]] = {name: getattr(np, name) for name in f"{_OF_NUMPY} tan tanh where".split()}
FUNCTIONS |= {"max": np.maximum, "min": np.minimum}
_ARGUMENTS = {"arctan2": 2, "clip": 3, "hypot": 2, "lag": 2, "max": 2, "maximum": 2, "min": 2, "minimum": 2, "where": 3}
_KNOWN = {*FUNCTIONS, "lag"}
CONSTANTS: dict[str, float] = {"pi": float(np.pi)}
_MAX_LENGTH = 2000
_MAX_NODES = 400
_MAX_POWER = 64.0
_LARGEST = sys.float_info.max

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.FloorDiv: np.floor_divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: lambda a, b: _equal(a, b),
    ast.NotEq: lambda a, b: np.logical_not(_equal(a, b)),
}
_Node = Callable[[Mapping[str, Any]], Any]
REMEMBERED = "lag()"
"""Among the values of a formula: ``(text of the lag, x, tau) -> lag of x``. Without it x is settled: it is its lag."""


class Place(NamedTuple):
    """Where something stands: file, 1-based line and column (0 where there is none), dotted path."""

    file: str = ""
    line: int = 0
    column: int = 0
    path: str = ""

    def fault(self, message: str, *, got: str = "", allowed: str = "", hint: str = "") -> Fault:
        """An error here."""
        return Fault(self.file, self.line, self.column, message, self.path, got, allowed, hint)

    def warning(self, message: str, *, got: str = "", allowed: str = "") -> Fault:
        """A warning here."""
        return replace(self.fault(message, got=got, allowed=allowed), severity="warning")


class Lag(NamedTuple):
    """A ``lag(x, tau)`` in a formula."""

    text: str
    names: frozenset[str]
    """Names that x reads."""
    parameter: str
    """Name of tau; empty for a number."""
    signal: _Node
    tau: _Node
    """Both: x and tau as functions of the formula's values."""
    place: Place

    def x(self, values: Mapping[str, object]) -> float | NDArray[np.float64]:
        """What lags, as `Expression.evaluate`."""
        found: float | NDArray[np.float64] = _computed(self.signal, values, self.names, self.text, self.place)
        return found


def _computed(run: _Node, values: Mapping[str, object], names: frozenset[str], source: str, place: Place) -> Any:
    """What a formula or a part of one gives. Raises InputError: where it computes with words."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        try:
            return run(values)
        except (TypeError, ValueError) as problem:
            of_words = ((name, values.get(name)) for name in sorted(names))
            texts = [name for name, value in of_words if hasattr(value, "equals") or isinstance(value, str)]
            if not texts and not any(quote in source for quote in "'\""):
                raise
            told = f"{' and '.join(texts)}, which holds words" if texts else "words"
            message, name = f"the formula computes with {told}", (*texts, "surface")[0]
            allowed = f"words in comparisons only, such as k * ({name} == 'name')"
            raise InputError(place.fault(message, got=source, allowed=allowed)) from problem


@dataclass(frozen=True)
class Expression:
    """A checked formula."""

    source: str
    """The text as written."""
    names: frozenset[str]
    """Names it reads."""
    lags: tuple[Lag, ...] = field(repr=False, compare=False)
    _run: _Node = field(repr=False, compare=False)
    place: Place = field(default=Place(), repr=False, compare=False)
    """Where it was written, for messages."""

    def evaluate(self, values: Mapping[str, object]) -> object:
        """Value of the formula; arrays broadcast as in NumPy, and division by zero gives inf or nan as there."""
        result = _computed(self._run, values, self.names, self.source, self.place)
        return result + 0.0 if isinstance(result, (bool, np.bool_)) else result

    def proportional_to(self, name: str) -> bool:
        """Whether nothing at a few values of the other names speaks against ``name * …``."""
        others = sorted(self.names - {name})
        for scale in (0.3, 1.7, -0.6):
            values = {other: scale * (1.0 + 0.37 * place) for place, other in enumerate(others)}
            none, once, twice = (np.asarray(self.evaluate({**values, name: x})) for x in (0.0, 1.0, 2.0))
            if np.isfinite([once, twice]).all() and not (
                np.isclose(twice, 2.0 * once) and abs(np.nan_to_num(none)) == 0.0
            ):
                return False
        return True

    def __reduce__(self) -> tuple[Any, ...]:
        return functools.partial(compile_expression, **self.place._asdict()), (self.source,)


def compile_expression(
    text: str, *, names: Iterable[str] | None = None, file: str = "", line: int = 0, column: int = 0, path: str = ""
) -> Expression:
    """Parse and check a formula.

    `text`: the formula, such as ``"k * abs(yaw_rate_rad_s) * payload_kg"``. `names`: the names it may read; any name
    when not given. `file`, `line`, `column`, `path`: where the text stands, for messages. Raises InputError: with every
    fault of the formula at once.
    """
    faults: list[Fault] = []

    def fault(message: str, node: ast.AST | None = None, got: str = "", allowed: str = "", hint: str = "") -> None:
        offset = getattr(node, "col_offset", 0) if node is not None else 0
        faults.append(Fault(file, line, column + offset if column else 0, message, path, got, allowed, hint))

    text = str(text)
    if len(text) > _MAX_LENGTH:
        fault("formula is too long", got=f"{len(text)} characters", allowed=f"at most {_MAX_LENGTH}")
        raise InputError(faults)
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        # Python's own words for it, without the advice that some of them give
        reason = str(getattr(error, "msg", "") or "too deep").partition(". ")[0]
        fault(f"formula cannot be read: {reason}", got=text, allowed="arithmetic such as 'c2*v**2 + c3*abs(w)'")
        raise InputError(faults) from None
    if sum(1 for _ in ast.walk(tree)) > _MAX_NODES:
        fault("formula has too many parts", allowed=f"at most {_MAX_NODES}")
        raise InputError(faults)
    allowed = None if names is None else frozenset(names)
    found: set[str] = set()
    run = _compile(tree.body, allowed, found, fault)
    place = Place(file, line, column, path)
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "lag"]
    lags = [_lag(node, place, fault) for node in calls if len(node.args) == _ARGUMENTS["lag"]]
    if faults:
        raise InputError(faults)
    return Expression(text.strip(), frozenset(found), tuple(lags), run, place)


def _lag(node: Any, place: Place, fault: Callable[..., None]) -> Lag:
    x, tau = node.args
    names: set[str] = set()
    signal = _compile(x, None, names, lambda *_: None)
    if any(isinstance(inner, ast.Call) and ast.unparse(inner.func) == "lag" for inner in ast.walk(x)):
        fault("a lag of a lag", node, ast.unparse(node), "one lag(x, tau), in which x holds no other")
    elif not names:
        fault("lag of something that is constant", node, ast.unparse(node), "a lag of columns: lag(abs(speed_m_s), 8)")
    try:
        number = float(ast.literal_eval(tau))
    except (ValueError, TypeError):
        number = 1.0 if isinstance(tau, ast.Name) and tau.id not in CONSTANTS else math.nan
    if not 0.0 < number < math.inf:
        fault("lag has no such time constant", tau, ast.unparse(tau), "a positive number in s, or a parameter in s")
    at = place._replace(column=place.column + node.col_offset if place.column else 0)
    parameter, constant = tau.id if isinstance(tau, ast.Name) else "", _compile(tau, None, set(), lambda *_: None)
    return Lag(ast.unparse(node), frozenset(names), parameter, signal, constant, at)


def _compile(node: ast.AST, allowed: frozenset[str] | None, found: set[str], fault: Callable[..., None]) -> _Node:
    def recurse(child: ast.AST) -> _Node:
        return _compile(child, allowed, found, fault)

    match node:
        case ast.Constant(value=bool() | int() | float() as number):
            constant = float(number) if abs(number) <= _LARGEST else math.inf
            if constant == math.inf:
                fault("number is too large", node, f"more than {_LARGEST:.3g}", f"at most {_LARGEST:.3g}")
            return _constant(constant)
        case ast.Constant(value=str() as word):
            fault("a word stands alone", node, repr(word)[:40], "a comparison such as k * (surface == 'carpet')")
            return _constant(word)
        case ast.Name(id=name) if name in CONSTANTS and (allowed is None or name not in allowed):
            return _constant(CONSTANTS[name])
        case ast.Name(id=name) if allowed is None and name.lower() in ("nan", "inf", "infinity"):
            fault(f"'{name}' is no number that a formula can hold", node, name, "numbers and names")
            return _constant(np.nan)
        case ast.Name(id=name):
            if allowed is not None and name not in allowed:
                known, meant = ", ".join(sorted(allowed)) or "no names", did_you_mean(name, allowed | _KNOWN)
                fault(f"'{name}' is not known here", node, name, known, meant)
            found.add(name)
            return lambda v: v[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            high = getattr(right, "value", None)
            if isinstance(op, ast.Pow) and isinstance(high, (int, float)) and abs(high) > _MAX_POWER:
                fault("exponent is too large", right, str(high), f"at most {_MAX_POWER:g}")
            a, b, operation = recurse(left), recurse(right), _BINARY[type(op)]
            return lambda v: operation(a(v), b(v))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            a = recurse(operand)
            return lambda v: np.negative(a(v))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return recurse(operand)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            a = recurse(operand)
            return lambda v: 1.0 * np.logical_not(a(v))  # truth counts as one, which NumPy's bool does not everywhere
        case ast.BoolOp(op=op, values=values):
            parts = [recurse(value) for value in values]
            both = np.logical_and if isinstance(op, ast.And) else np.logical_or
            return lambda v: 1.0 * functools.reduce(both, [part(v) for part in parts])
        case ast.Compare(left=left, ops=ops, comparators=comparators) if all(type(op) in _COMPARE for op in ops):
            words = all(isinstance(op, (ast.Eq, ast.NotEq)) for op in ops)
            sides = []
            for side in (left, *comparators):
                said = getattr(side, "value", None)
                sides.append(_constant(said) if words and isinstance(said, str) else recurse(side))
            tests = [_COMPARE[type(op)] for op in ops]
            return lambda v: (
                1.0
                * functools.reduce(np.logical_and, [test(sides[i](v), sides[i + 1](v)) for i, test in enumerate(tests)])
            )
        case ast.IfExp(test=test, body=body, orelse=orelse):
            c, a, b = recurse(test), recurse(body), recurse(orelse)
            return lambda v: np.where(c(v), a(v), b(v))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            return _call(node, name, args, [recurse(arg) for arg in args], allowed, fault)
    fault(
        "this is not allowed in a formula",
        node,
        ast.unparse(node)[:60],
        "numbers, names, + - * / // % **, comparisons, and/or/not, 'a if c else b', " + ", ".join(sorted(_KNOWN)),
    )
    return _constant(np.nan)


def _call(
    node: ast.AST,
    name: str,
    args: list[ast.expr],
    parts: list[_Node],
    allowed: frozenset[str] | None,
    fault: Callable[..., None],
) -> _Node:
    known = _KNOWN if allowed is None else FUNCTIONS.keys()  # what maps a log has no lag
    if name not in known:
        fault(f"unknown function '{name}'", node, name, ", ".join(sorted(known)), did_you_mean(name, known))
        return _constant(np.nan)
    wanted = _ARGUMENTS.get(name, 1)
    if len(args) != wanted:
        if name in ("max", "min", "maximum", "minimum") and len(args) > wanted:
            return lambda v: functools.reduce(FUNCTIONS[name], [part(v) for part in parts])
        fault(f"'{name}' takes {counted(wanted, 'argument')}", node, str(len(args)), str(wanted))
        return _constant(np.nan)
    if name == "lag":
        text = ast.unparse(node)
        return lambda v: v.get(REMEMBERED, lambda _, x, tau: x)(text, *(part(v) for part in parts))
    function = FUNCTIONS[name]
    return lambda v: function(*(part(v) for part in parts))


def _constant(value: float | str) -> _Node:
    return lambda _: value


def _equal(a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        if isinstance(other, str) and hasattr(one, "equals"):
            return one.equals(other)
    return np.equal(a, b) if not (isinstance(a, str) or isinstance(b, str)) else np.asarray(a == b)


Powers = dict[str, float]
"""Powers of units, by their names."""


class UnlikeError(ValueError):
    """A formula adds or compares what has unlike units: `parts`, by their text."""

    def __init__(self, parts: Mapping[str, Powers]) -> None:
        super().__init__(*parts)
        self.parts = parts


def units_in(formula: str, of: Callable[[str], Powers | None], unknown: Powers | None = None) -> Powers | None:
    """Powers of the units that the value of a formula has, from those `of` its names.

    `unknown`: what numbers count as, and all of which nothing is known. With None nothing is known of a product with
    them either, and what is known of a sum has to be alike. Raises UnlikeError: where it is not.
    """

    def times(a: Powers | None, b: Powers | None, power: float) -> Powers | None:
        if a is None or b is None:
            return None
        return {name: round(a.get(name, 0.0) + power * b.get(name, 0.0), 6) for name in {**a, **b}}

    def alike(*parts: ast.expr) -> Powers | None:
        known = {ast.unparse(part): found for part in parts if (found := walk(part)) is not None}
        if unknown is None and len({frozenset((n, p) for n, p in found.items() if p) for found in known.values()}) > 1:
            raise UnlikeError(known)
        return next(filter(None, known.values()), {} if known else unknown)

    def walk(node: ast.expr) -> Powers | None:
        match node:
            case ast.Name(id=name):
                return of(name)
            case ast.UnaryOp(operand=inner) | ast.Call(func=ast.Name(id="abs" | "floor" | "lag"), args=[inner, *_]):
                return walk(inner)
            case ast.BinOp(left=left, op=ast.Mult() | ast.Div() | ast.FloorDiv() as op, right=right):
                return times(walk(left), walk(right), 1.0 if isinstance(op, ast.Mult) else -1.0)
            case ast.BinOp(left=base, op=ast.Pow(), right=ast.Constant(value=int() | float() as power)):
                return times({}, walk(base), power)
            case ast.Call(func=ast.Name(id="sqrt"), args=[base]):
                return times({}, walk(base), 0.5)
            case ast.BinOp(left=first, op=ast.Add() | ast.Sub() | ast.Mod(), right=second):
                return alike(first, second)
            case ast.IfExp(body=first, orelse=second) | ast.Call(func=ast.Name(id="where"), args=[_, first, second]):
                return alike(first, second)
            case ast.Call(func=ast.Name(id="max" | "min" | "maximum" | "minimum" | "clip" | "hypot"), args=parts):
                return alike(*parts)
            case ast.Call() | ast.Compare() | ast.BoolOp():
                return {}  # sines, exponentials, what holds or not
        return unknown

    return walk(ast.parse(formula.strip(), mode="eval").body)
