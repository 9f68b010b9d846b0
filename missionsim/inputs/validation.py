"""From a document to its model: validated, salvaged where it is faulty, sealed with positions; what checks share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import Lag, compile_expression
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.faults import exists, file_path, follows_from_entries, to_faults
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Document, as_written

Path_ = tuple[str | int, ...]
_STAND_INS: tuple[Any, ...] = (
    Parameter(1.0), "x", 1, {}, [{"wait": {"duration": 1}}], {"x": {"capacity": 1}}, {"x": {}},
    [{"battery": "x", "power": 1}],
)  # fmt: skip
"""Tried one after the other where a required value is faulty: a number, a name, a count, and the required blocks."""


class _Numbered(list[Any]):
    """A list that has lost items and remembers the places of the others."""

    numbers: list[int]


class Faulty:
    """Paths of a file that were told to be faulty."""

    def __init__(self) -> None:
        self._at: set[Path_] = set()
        self._above: set[Path_] = set()

    def add(self, paths: Iterable[Path_]) -> None:
        """More of them."""
        for path in paths:
            self._at.add(path)
            self._above.update(path[:length] for length in range(len(path) + 1))

    def __bool__(self) -> bool:
        return bool(self._at)

    def under(self, path: Path_) -> bool:
        """Whether a path is, or lies below, a faulty one."""
        return any(path[:length] in self._at for length in range(len(path) + 1))

    def related(self, path: Path_) -> bool:
        """Whether a path is, lies below or above a faulty one."""
        return path in self._above or self.under(path)


@dataclass(slots=True)
class View(Document):
    """A document with parts left out; paths are translated to those of the file."""

    shape: Any = None
    faulty: Faulty = field(default_factory=Faulty)

    def original(self, path: Sequence[str | int]) -> Path_:
        """The path in the file of a path in what is left."""
        data = self.shape
        result: list[str | int] = []
        for item in path:
            if isinstance(data, _Numbered) and isinstance(item, int) and item < len(data):
                result.append(data.numbers[item])
                data = data[item]
                continue
            result.append(item)
            try:
                data = data[item]
            except (KeyError, IndexError, TypeError):
                data = None
        return tuple(result)


def view_of(document: Document, shape: object, faulty: Faulty) -> View:
    """`document` as what is left of it, `shape`."""
    of_file = document.file, document.data, document.root, document.sha256, document.overrides, document.prefix
    return View(*of_file, shape, faulty)


def repaired(view: View, problem: ValidationError, tried: dict[Path_, int]) -> object:
    """What is left after taking out or replacing what `problem` names; None where nothing can be done. `view`: what was
    validated. `tried`: how many stand-ins were tried at a path (of the file); changed."""
    edits: _Edits = {}
    drops: list[Path_] = []
    for error in problem.errors(include_url=False):
        if follows_from_entries(error):
            continue
        base = file_path(error["loc"], view.shape)
        entries = error["ctx"]["entries"] if error["type"] == "quantity" else [{"at": ()}]
        for path in [(*base, *entry["at"]) for entry in entries]:
            if not path or path == ("kind",):
                return None
            key = view.original(path)
            count = tried.get(key, 0)
            there = exists(view.shape, path)
            if error["type"] == "literal_error":
                _note(edits, path, _PUT, str(error["ctx"]["expected"]).split("'")[1])
            elif there and not count:
                drops.append(path)
            elif count < len(_STAND_INS) and exists(view.shape, path[:-1]):
                _note(edits, path, _PUT, _STAND_INS[count])
                tried[key] = count + 1
            else:
                drops.append(_existing(view.shape, path[:-1]))
    if () in drops:
        return None
    for path in drops:
        _note(edits, path, _DROP, True)
    return _edited(view.shape, edits)


def _existing(data: Any, path: Path_) -> Path_:
    while path and not exists(data, path):
        path = path[:-1]
    return path


_Edits = dict[Any, Any]
"""What is put or dropped, by the keys on the way there: one pass does all of it, however many faults there are."""
_PUT, _DROP = object(), object()


def _note(edits: _Edits, path: Sequence[str | int], what: object, value: Any) -> None:
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
        result = _Numbered(_edited(data[index], below.get(index, {})) for index in left)
        result.numbers = [data.numbers[index] for index in left] if isinstance(data, _Numbered) else left
        return result
    return data


Loaded = TypeVar("Loaded", bound=FileModel)
_ROUNDS = 30


def validate_document(document: Document, model: type[Loaded], faults: list[Fault]) -> Loaded | None:
    """Validate; after faults, try again without the faulty parts, so that the other checks can still speak.

    The model is perhaps without its faulty parts, or with stand-ins for them (`FileModel.whole` is False then); None
    where nothing could be made of the file.
    """
    context = {"folder": Path(document.file).parent}
    shape = document.data
    faulty = Faulty()
    tried: dict[Path_, int] = {}
    for _ in range(_ROUNDS):
        view = view_of(document, shape, faulty) if faulty else document
        try:
            result = model.model_validate(shape, context=context)
        except ValidationError as problem:
            located = to_faults(problem, view, model, shape)
            places = [view.original(path) for path, _ in located]
            faults += [fault for at, (_, fault) in zip(places, located, strict=True) if not faulty.related(at)]
            shape = repaired(view_of(document, shape, faulty), problem, tried)
            faulty.add(places)
            if shape is None:
                return None
        else:
            seal(result, view)
            result._whole = not faulty
            return result
    return None


def seal(model: FileModel, document: Document) -> None:
    """Give each object and number of a fresh model its path and line in the file."""
    model._file = document.file
    model._sha256 = document.sha256
    model._document = document
    _seal(model, document, ())


def _seal(value: Any, document: Document, path: tuple[str | int, ...]) -> None:
    if isinstance(value, Model):
        body = path
        kind = getattr(value, "kind", None)
        if len(path) >= 2 and isinstance(path[-1], int) and kind is not None:
            here = document.node(path)
            if isinstance(here.children, dict) and "kind" not in here.children and kind in here.children:
                body = (*path, kind)
        value._line = document.position(body)[0]
        value._where = body
        fields = type(value).model_fields
        for name in value.model_fields_set:
            _seal(getattr(value, name), document, (*body, fields[name].alias or name))
    elif isinstance(value, Parameter):
        object.__setattr__(value, "path", ".".join(map(str, path)))
        object.__setattr__(value, "line", document.position(path)[0])
    elif isinstance(value, (dict, tuple)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _seal(item, document, (*path, key))


Where = Sequence[str | int]
_SHOWN = 24

DERIVED = ("moving_time_s", "moving", "starts", "mass_kg", "drive_w", "load_w")
"""Covariates that a run or a log adds to the glossary's columns."""


class Checker:
    """Collects faults of one document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[Fault] = []

    def add(
        self,
        where: Where,
        message: str,
        got: str = "",
        allowed: str = "",
        hint: str = "",
        *,
        key: bool = False,
        warning: bool = False,
    ) -> None:
        """One fault at a path of the file, unless that place was told to be faulty already."""
        if not self.faulty(where):
            told = {"got": got, "allowed": allowed, "hint": hint, "severity": "warning" if warning else "error"}
            self.faults.append(self.document.fault(where, message, key=key, **told))

    def faulty(self, where: Where) -> bool:
        """Whether a fault was told at this path or above it."""
        faulty: Faulty | None = getattr(self.document, "faulty", None)
        return faulty is not None and faulty.under(self.document.original(where))

    def touched(self, *where: str | int) -> bool:
        """Whether a fault was told at, above or below this path."""
        faulty: Faulty | None = getattr(self.document, "faulty", None)
        return faulty is not None and faulty.related(self.document.original(where))

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

    def keys(self, where: Where, given: object, names: Iterable[str], what: str) -> None:
        """Faults for the keys of a mapping that are none of `names`."""
        for name in given if isinstance(given, Mapping) else ():
            self.known((*where, name), name, names, what, key=True)

    def units(self, where: Where, name: str, count: int, robot: RobotSpec, least: int = 0, message: str = "") -> bool:
        """Whether a robot has a component, and as many units of it."""
        known = Checker(robot.document).raw_keys("components")
        key = where[-1] == name
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

    def given(self, where: Where, key: str) -> bool:
        """Whether a key stands in the file, also with a value that is at fault."""
        children = self.document.node(where).children
        return isinstance(children, dict) and key in children

    def raw_keys(self, *where: str | int) -> list[str]:
        """Keys of a mapping as the file has them, also those whose values are at fault."""
        data = self.document.data
        for item in where:
            if isinstance(data, dict) and item in data:
                data = data[item]
            else:
                return []
        return [str(key) for key in data] if isinstance(data, dict) else []

    def formulas(
        self,
        texts: Mapping[tuple[str | int, ...], str],
        own: Iterable[str],
        times: Mapping[str, Parameter] | None = None,
    ) -> None:
        """Formulas, by their paths, that can be read, name what there is and together use all their parameters.

        `times`: parameters that may be time constants of lags; no lag is allowed where there can be none.
        """
        parameters = list(own)
        used: set[str] = set()
        for where, text in texts.items():
            names = self._names(where, text, parameters, times)
            if names is None:
                return
            used |= names
        where, text = next(iter(texts.items()))
        for name in parameters:
            if name not in used:
                self.add(where, f"parameter '{name}' does not occur in the formula", got=text[:80], warning=True)

    def _names(
        self, where: Where, text: str, parameters: list[str], times: Mapping[str, Parameter] | None
    ) -> frozenset[str] | None:
        """Names that a formula reads, None where it cannot be read. Names of further log columns are allowed; one that
        is nearly a known name gets a warning."""
        from missionsim.effects.base_terms import ALIASES

        try:
            expression = compile_expression(text, **self.document.place(where)._asdict())
        except InputError as problem:
            self.faults.extend(problem.faults)
            return None
        self.faults += [fault for lag in expression.lags for fault in _lag_faults(lag, times)]
        known = [*parameters, *ALIASES, *DERIVED, *(column.name for column in COLUMNS)]
        for name in sorted(expression.names):
            if name in known or column_of(name) is not None or name.startswith(("on_time_", "starting_")):
                continue
            hint = did_you_mean(name, known, 0.8)
            if hint:
                message = f"formula names '{name}', which is no column of the glossary"
                allowed = "a parameter, a glossary column, or a further column of your logs"
                self.add(where, message, text[:80], allowed, hint, warning=True)
        return expression.names


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
