"""From a document to its model: validated, salvaged where it has faults, and sealed with positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from missionsim.errors import Fault
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.faults import exists, file_path, follows_from_entries, to_faults
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.tree import Document

Path_ = tuple[str | int, ...]
_STAND_INS: tuple[Any, ...] = (
    Parameter(1.0),
    "x",
    1,
    {},
    [{"wait": {"duration": 1}}],
    {"x": {"capacity": 1}},
    {"x": {}},
    [{"battery": "x", "power": 1}],
)
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
    view = View(document.file, document.data, document.root, document.sha256, document.overrides, document.prefix)
    view.shape, view.faulty = shape, faulty
    return view


def repaired(view: View, problem: ValidationError, tried: dict[Path_, int]) -> object:
    """What is left after taking out or replacing what `problem` names; None where nothing can be done.

    `view`: what was validated. `tried`: how many stand-ins were tried at a path (of the file); changed.
    """
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


def _like(old: list[Any], items: list[Any], numbers: list[int]) -> list[Any]:
    result = _Numbered(items)
    known = old.numbers if isinstance(old, _Numbered) else list(range(len(old)))
    result.numbers = [known[number] for number in numbers]
    return result


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
        return _like(data, [_edited(data[index], below.get(index, {})) for index in left], left)
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
            item = getattr(value, name)
            if isinstance(item, (Parameter, Model, dict, tuple)):
                _seal(item, document, (*body, fields[name].alias or name))
    elif isinstance(value, Parameter):
        object.__setattr__(value, "path", ".".join(map(str, path)))
        object.__setattr__(value, "line", document.position(path)[0])
    elif isinstance(value, dict):
        for key, item in value.items():
            if isinstance(item, (Parameter, Model, dict, tuple)):
                _seal(item, document, (*path, key))
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            if isinstance(item, (Parameter, Model, dict, tuple)):
                _seal(item, document, (*path, index))
