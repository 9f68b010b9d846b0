"""From a document to its model: validated, salvaged where it has faults, and sealed with positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from missionsim.errors import Fault
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.faults import to_faults
from missionsim.inputs.salvage import related, repaired, view_of
from missionsim.inputs.tree import Document
from missionsim.inputs.values import Parameter

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
