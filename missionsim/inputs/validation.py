"""From a document to its model: validated, salvaged where it is faulty, sealed with positions; what checks across its
parts share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from missionsim.effects.base_terms import ALIASES, unit_named
from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import Lag, Powers, UnlikeError, compile_expression, units_in
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Document, Numbered, Where, as_written
from missionsim.inputs.units import exponents

Loaded = TypeVar("Loaded", bound=FileModel)
_ROUNDS = 30
_STAND_INS: tuple[Any, ...] = (
    Parameter(1.0), "x", 1, {}, [{"wait": {"duration": 1}}], {"x": {"capacity": 1}}, {"x": {}},
    [{"battery": "x", "power": 1}],
)  # fmt: skip
"""Tried one after the other where a required value is faulty: a number, a name, a count, and the required blocks."""


def validate_document(document: Document, model: type[Loaded], faults: list[Fault]) -> Loaded | None:
    """Validate; after faults, try again without the faulty parts, so that the other checks can still speak.

    The model is perhaps without its faulty parts, or with stand-ins for them (`FileModel.whole` is False then); None
    where nothing could be made of the file.
    """
    context = {"folder": Path(document.file).parent}
    view = document
    tried: dict[Where, int] = {}
    meant: set[Where] = set()
    for _ in range(_ROUNDS):
        shape = document.data if view is document else view.shape
        try:
            result = model.model_validate(shape, context=context)
        except ValidationError as problem:
            told = [found for error in problem.errors(include_url=False) for found in _told(error, view, shape)]
            # a key that is missing because it is misspelt is one mistake
            new = [(view.original(path), fault) for path, fault, _ in told if not view.is_faulty(path, below=True)]
            hints = {(*path[:-1], fault.hint) for path, fault in new if fault.message.startswith("unknown key")}
            meant |= {where for where in hints if where[-1]}
            faults += [fault for path, fault in new if path not in meant]
            edits: _Edits = {}
            drops: list[Where] = []
            faulty = dict(view.faulty)
            for path, _, word in told:
                if not path or path == ("kind",):
                    return None
                at, there = view.original(path), _within(shape, path)
                count = tried.get(at, 0)
                if word:
                    _note(edits, path, _PUT, word)
                elif there == path and not count:
                    drops.append(path)
                elif count < len(_STAND_INS) and len(there) >= len(path) - 1:
                    _note(edits, path, _PUT, _STAND_INS[count])
                    tried[at] = count + 1
                else:
                    drops.append(there[: len(path) - 1])
                faulty |= {at[:n]: faulty.get(at[:n], False) for n in range(len(at))} | {at: True}
            if () in drops:
                return None
            for path in drops:
                _note(edits, path, _DROP, True)
            view = replace(document, shape=_edited(shape, edits), faulty=faulty)
        else:
            vars(result).update(document=view, whole=view is document)
            _seal(result, view, ())
            return result
    return None


_Edits = dict[Any, Any]
"""What is put or dropped, by the keys on the way there: one pass does all of it, however many faults there are."""
_PUT, _DROP = object(), object()


def _note(edits: _Edits, path: Where, what: object, value: Any) -> None:
    for item in path:
        edits = edits.setdefault(item, {})
    edits[what] = value


def _edited(data: Any, edits: _Edits) -> Any:
    data = edits.get(_PUT, data)
    below = {key: more for key, more in edits.items() if key is not _PUT}
    if isinstance(data, dict) and below:
        kept = {key: value for key, value in data.items() if _DROP not in below.get(key, ())}
        return kept | {key: _edited(data.get(key), more) for key, more in below.items() if _DROP not in more}
    if isinstance(data, list) and below:
        left = [index for index in range(len(data)) if _DROP not in below.get(index, ())]
        result = Numbered(_edited(data[index], below.get(index, {})) for index in left)
        result.numbers = [data.numbers[index] for index in left] if isinstance(data, Numbered) else left
        return result
    return data


def _within(data: Any, path: Where) -> Where:
    """As much of a path as plain data has."""
    for depth, item in enumerate(path):
        inside = isinstance(data, (list, tuple)) and isinstance(item, int) and item < len(data)
        if not inside and not (isinstance(data, dict) and item in data):
            return path[:depth]
        data = data[item]
    return path


def _seal(value: Any, document: Document, path: Where) -> None:
    """Give each object and number of a fresh model its path and line in the file."""
    if isinstance(value, Model):
        kind = getattr(value, "kind", None)
        if len(path) >= 2 and isinstance(path[-1], int) and kind is not None:
            here = document.node(path)
            if isinstance(here.children, dict) and "kind" not in here.children and kind in here.children:
                path = (*path, kind)
        vars(value).update(line=document.position(path)[0], where=path)
        fields = type(value).model_fields
        for name in value.model_fields_set:
            _seal(getattr(value, name), document, (*path, fields[name].alias or name))
    elif isinstance(value, Parameter):
        object.__setattr__(value, "path", ".".join(map(str, path)))
        object.__setattr__(value, "line", document.position(path)[0])
    elif isinstance(value, (dict, tuple)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _seal(item, document, (*path, key))


_LIMITS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
_WANTED = {
    "text": "string_type",
    "a whole number": "int_type int_from_float int_parsing",
    "a number": "float_type float_parsing",
    "true or false": "bool_type bool_parsing",
    "a mapping": "dict_type model_type model_attributes_type mapping_type",
    "a list": "tuple_type list_type",
    "a finite number": "finite_number",
}
_KINDS = {kind: words for words, kinds in _WANTED.items() for kind in kinds.split()}


def _told(error: ErrorDetails, document: Document, shape: object) -> list[tuple[Where, Fault, str]]:
    """What one error of pydantic says: path, fault, and the word that would be right where only few words are.

    `document`: where the data came from; `shape`: the data that was validated.
    """
    kind, loc, raw = error["type"], error["loc"], error.get("input")
    context: dict[str, Any] = error.get("ctx", {})
    path = _file_path(loc, shape, missing=kind == "missing")
    if kind == "quantity":
        found = []
        for entry in context["entries"]:
            at, told = (*path, *entry["at"]), {key: entry[key] for key in ("message", "got", "allowed", "hint")}
            unknown = told["message"].startswith(("unknown key", "unknown kind"))
            found.append((at, document.fault(at, **told, key=unknown), ""))
        return found
    if kind == "too_short" and isinstance(raw, (list, tuple, dict)) and len(raw) >= context["min_length"]:
        return []  # only for entries that are at fault, which are told
    at, got, allowed, hint, key, word = path, as_written(raw), "", "", False, ""
    if kind in ("missing", "too_short") and path[:1] == ("components",) and loc[-1] == "loads":
        at = path[:2] if kind == "missing" else path
        message, allowed = f"component '{path[1]}' is fed by no battery", "loads: [{battery: …, power: …}]"
    elif kind == "missing":
        at = path if _within(shape, path) == path else path[:-1]
        message, allowed = f"'{loc[-1]}' is missing", f"{loc[-1]}: …"
    elif kind in _LIMITS:
        more, limit = _LIMITS[kind]
        message, allowed = "impossible value", f"{more} {context[limit]:g}"
    elif kind in ("literal_error", "enum"):
        options = [item.strip("'") for item in str(context["expected"]).replace(" or ", ", ").split(", ")]
        message, allowed, word = "not one of the allowed words", ", ".join(options), options[0]
        hint = did_you_mean(raw, options) if isinstance(raw, str) else ""
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        options = [item.strip("'") for item in str(context.get("expected_tags") or "").split(", ") if item]
        tag = context.get("tag", "")
        at, message, got = (*path, "kind"), "unknown kind" if tag else "'kind' is missing", as_written(tag or raw)
        allowed, hint = ", ".join(options) or "kind: …", did_you_mean(str(tag), options)
    elif kind in _KINDS:
        message, allowed = f"must be {_KINDS[kind]}", _KINDS[kind]
    elif kind == "string_pattern_mismatch":
        letters = "lower-case letters, digits and _, beginning with a letter"
        message, allowed, key = "not a name that can be used here", context["pattern"], True
        allowed = letters if "a-z0-9" in allowed else allowed
    elif kind in ("too_short", "too_long"):
        few = kind == "too_short"
        message = "too few entries" if few else "too many entries"
        allowed = f"at least {context['min_length']}" if few else f"at most {context['max_length']}"
    elif kind in ("string_too_short", "string_too_long"):
        message = "text too short" if "short" in kind else "text too long"
        allowed = f"{context.get('min_length', context.get('max_length'))} characters"
    else:
        message = error["msg"].removeprefix("Value error, ")
        message = message[:1].lower() + message[1:]
    if kind == "missing" and document.overridden(at) is None:
        got = as_written(document.node(at).data)  # with what was left out
    return [(path, document.fault(at, message, got=got, allowed=allowed, hint=hint, key=key), word)]


def _file_path(loc: Sequence[str | int], data: object, *, missing: bool) -> Where:
    """pydantic's location without its union tags and key marks: the path of the value, or of a key that is missing."""
    path: Where = ()
    here: Any = data
    for index, item in enumerate(loc):
        if _within(here, (item,)):
            path, here = (*path, item), here[item]
        elif missing and isinstance(here, dict) and index == len(loc) - 1:
            path = (*path, item)
    return path


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
        told = " and ".join(f"{text} in {_unit_told(powers)}" for text, powers in problem.parts.items())
        return f"the formula adds or compares {told}"
    return "" if found is None or _unit_told(found) == "W" else f"the formula gives {_unit_told(found)}, no power"


def _powers(unit: str) -> Powers | None:
    powers = exponents(unit) if unit else None
    return None if powers is None else dict(zip(_BASE, powers, strict=True))


def _unit_told(found: Powers) -> str:
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
