"""From a document to its model: validated, salvaged where it is faulty, sealed with positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from missionsim.errors import Fault, did_you_mean
from missionsim.inputs.base import FileModel, Model
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.tree import Document, Numbered, Where, as_written

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
