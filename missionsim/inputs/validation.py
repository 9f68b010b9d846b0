"""From a document to its model: validated, salvaged where it has faults, and sealed with positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from missionsim.errors import Fault
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.faults import file_path, follows_from_entries, to_faults
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


@dataclass(slots=True)
class View(Document):
    """A document with parts left out; paths are translated to those of the file."""

    shape: Any = None
    faulty: frozenset[Path_] = field(default_factory=frozenset)

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


def view_of(document: Document, shape: Any, faulty: Iterable[Path_]) -> View:
    """`document` as what is left of it, `shape`."""
    view = View(document.file, document.data, document.root, document.sha256, document.overrides, document.prefix)
    view.shape, view.faulty = shape, frozenset(faulty)
    return view


def under(path: Sequence[str | int], faulty: Iterable[Path_]) -> bool:
    """Whether a path is, or lies below, a faulty one."""
    return any(tuple(path[: len(other)]) == other for other in faulty)


def related(path: Sequence[str | int], faulty: Iterable[Path_]) -> bool:
    """Whether a path is, lies below or above a faulty one."""
    return any(tuple(path[: len(other)]) == other[: len(path)] for other in faulty)


def repaired(view: View, problem: ValidationError, tried: dict[Path_, int]) -> Any:
    """What is left after taking out or replacing what `problem` names; None where nothing can be done.

    Parameters
    ----------
    view : View
        What was validated.
    problem : pydantic.ValidationError
    tried : dict
        How many stand-ins were tried at a path (of the file); changed.
    """
    result = view.shape
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
            exists = _exists(view.shape, path)
            if error["type"] == "literal_error":
                result = _put(result, path, str(error["ctx"]["expected"]).split("'")[1])
            elif exists and not count:
                drops.append(path)
            elif count < len(_STAND_INS) and _exists(view.shape, path[:-1]):
                result = _put(result, path, _STAND_INS[count])
                tried[key] = count + 1
            else:
                drops.append(_existing(view.shape, path[:-1]))
    for path in sorted(set(drops), key=lambda path: [str(item).rjust(8) for item in path], reverse=True):
        if not path:
            return None
        result = _drop(result, path)
    return result


def _existing(data: Any, path: Path_) -> Path_:
    while path and not _exists(data, path):
        path = path[:-1]
    return path


def _exists(data: Any, path: Sequence[str | int]) -> bool:
    for item in path:
        if isinstance(data, dict) and item in data:
            data = data[item]
            continue
        if not isinstance(data, list) or not isinstance(item, int) or item >= len(data):
            return False
        data = data[item]
    return True


def _like(old: list[Any], items: list[Any], numbers: list[int]) -> list[Any]:
    result = _Numbered(items)
    known = old.numbers if isinstance(old, _Numbered) else list(range(len(old)))
    result.numbers = [known[number] for number in numbers]
    return result


def _put(data: Any, path: Sequence[str | int], value: Any) -> Any:
    if not path:
        return value
    head, rest = path[0], path[1:]
    if isinstance(data, dict):
        return {**data, str(head): _put(data.get(str(head)), rest, value)}
    if isinstance(data, list) and isinstance(head, int):
        items = [_put(item, rest, value) if index == head else item for index, item in enumerate(data)]
        return _like(data, items, list(range(len(items))))
    return data


def _drop(data: Any, path: Sequence[str | int]) -> Any:
    head, rest = path[0], path[1:]
    if isinstance(data, dict):
        if not rest:
            return {key: value for key, value in data.items() if key != head}
        return {key: _drop(value, rest) if key == head else value for key, value in data.items()}
    if isinstance(data, list):
        if not rest:
            kept = [index for index in range(len(data)) if index != head]
            return _like(data, [data[index] for index in kept], kept)
        items = [_drop(value, rest) if index == head else value for index, value in enumerate(data)]
        return _like(data, items, list(range(len(items))))
    return data


Loaded = TypeVar("Loaded", bound=FileModel)
_ROUNDS = 30


def validate_document(document: Document, model: type[Loaded], faults: list[Fault]) -> Loaded | None:
    """Validate; after faults, try again without the faulty parts, so that the other checks can still speak.

    Returns
    -------
    FileModel or None
        Perhaps without its faulty parts, or with stand-ins for them (`FileModel.whole` is False then); None where
        nothing could be made of the file.
    """
    context = {"folder": Path(document.file).parent}
    shape = document.data
    faulty: set[tuple[str | int, ...]] = set()
    tried: dict[tuple[str | int, ...], int] = {}
    for _ in range(_ROUNDS):
        view = view_of(document, shape, faulty) if faulty else document
        try:
            result = model.model_validate(shape, context=context)
        except ValidationError as problem:
            located = to_faults(problem, view, model, shape)
            faults.extend(fault for path, fault in located if not related(view.original(path), faulty))
            shape = repaired(view_of(document, shape, faulty), problem, tried)
            faulty |= {view.original(path) for path, _ in located}
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
