"""pydantic's errors to `Fault`s with file, line and column."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from missionsim.errors import Fault, did_you_mean
from missionsim.inputs.tree import Document, as_written

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


def to_faults(
    problem: ValidationError, document: Document, model: type[BaseModel], shape: object
) -> list[tuple[tuple[str | int, ...], Fault]]:
    """All errors of one validation, each with its path in the file. `document`: where the data came from; `model`: the
    file's model, for the keys that are allowed; `shape`: the data that was validated."""
    result: list[tuple[tuple[str | int, ...], Fault]] = []
    for error in problem.errors(include_url=False):
        kind = error["type"]
        path = file_path(error["loc"], shape, missing=kind == "missing")
        context: dict[str, Any] = error.get("ctx", {})
        raw = error.get("input")
        if kind == "quantity":
            for entry in context["entries"]:
                at, told = (*path, *entry["at"]), {key: entry[key] for key in ("message", "got", "allowed", "hint")}
                unknown = told["message"].startswith(("unknown key", "unknown kind"))
                result.append((at, document.fault(at, **told, key=unknown)))
            continue
        if follows_from_entries(error):
            continue
        at, got, allowed, hint, key = path, as_written(raw), "", "", False
        if kind in ("missing", "too_short") and path[:1] == ("components",) and error["loc"][-1] == "loads":
            at = path[:2] if kind == "missing" else path
            message, allowed = f"component '{path[1]}' is fed by no battery", "loads: [{battery: …, power: …}]"
        elif kind == "extra_forbidden":
            known, got, key = _allowed_keys(model, error["loc"][:-1]), str(path[-1]), True
            message, allowed, hint = f"unknown key '{got}'", ", ".join(known), _close_key(got, known)
        elif kind == "missing":
            at = path if exists(shape, path) else path[:-1]
            message, allowed = f"'{error['loc'][-1]}' is missing", f"{error['loc'][-1]}: …"
        elif kind in _LIMITS:
            word, limit = _LIMITS[kind]
            message, allowed = "impossible value", f"{word} {context[limit]:g}"
        elif kind in ("literal_error", "enum"):
            options = [item.strip("'") for item in str(context["expected"]).replace(" or ", ", ").split(", ")]
            message, allowed = "not one of the allowed words", ", ".join(options)
            hint = did_you_mean(raw, options) if isinstance(raw, str) else ""
        elif kind in ("union_tag_invalid", "union_tag_not_found"):
            options = [item.strip("'") for item in str(context.get("expected_tags") or "").split(", ") if item]
            tag = context.get("tag", "")
            at, message, got = (*path, "kind"), "unknown kind" if tag else "'kind' is missing", as_written(tag or raw)
            allowed, hint = ", ".join(options) or "kind: …", did_you_mean(str(tag), options)
        elif kind in _KINDS:
            message, allowed = f"must be {_KINDS[kind]}", _KINDS[kind]
            if allowed == "a mapping" and (keys := _allowed_keys(model, error["loc"])):
                allowed += f" with {', '.join(keys)}"
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
            message = error["msg"][:1].lower() + error["msg"][1:]
        result.append((path, document.fault(at, message, got=got, allowed=allowed, hint=hint, key=key)))
    return result


def follows_from_entries(error: ErrorDetails) -> bool:
    """Whether a list is called too short only because entries are at fault (those are told)."""
    raw = error.get("input")
    return bool(
        error["type"] == "too_short" and isinstance(raw, (list, tuple, dict)) and len(raw) >= error["ctx"]["min_length"]
    )


def file_path(loc: Sequence[str | int], data: object, *, missing: bool = True) -> tuple[str | int, ...]:
    """pydantic's location without its union tags and key marks: the path of the value, or of a key that is missing."""
    path: list[str | int] = []
    for index, item in enumerate(loc):
        if item == "[key]":
            continue
        if isinstance(data, dict):
            if item in data:
                path.append(item)
                data = data[item]
            elif missing and index == len(loc) - 1:
                path.append(item)
        elif isinstance(data, (list, tuple)) and isinstance(item, int) and item < len(data):
            path.append(item)
            data = data[item]
    return tuple(path)


def exists(data: object, path: Sequence[str | int]) -> bool:
    """Whether plain data has a value at a path."""
    here: Any = data
    for item in path:
        inside = isinstance(here, (list, tuple)) and isinstance(item, int) and item < len(here)
        if not inside and not (isinstance(here, dict) and item in here):
            return False
        here = here[item]
    return True


def _close_key(key: str, known: Iterable[str]) -> str:
    words = list(known)
    spelled = key.replace("-", "_").replace(" ", "_").lower()
    return spelled if spelled in words else did_you_mean(key, words)


def _allowed_keys(model: type[BaseModel], loc: Sequence[str | int]) -> list[str]:
    """Keys of the model that lies at `loc` below `model`."""
    current: list[Any] = [model]
    for item in loc:
        current = [found for kind in current for found in _below(kind, item)]
    keys: dict[str, None] = {}
    for kind in current:
        for candidate in _models(kind):
            keys |= dict.fromkeys(
                field.alias or name
                for name, field in candidate.model_fields.items()
                if name != "kind" or candidate is model
            )
    return list(keys)


def _below(kind: Any, item: str | int) -> list[Any]:
    result: list[Any] = []
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            if item in (name, field.alias):
                # the hint, for a repeat block names its segments in advance
                result.append(get_type_hints(kind)[name])
        if (
            not result
            and kind.model_fields.get("kind") is not None
            and item in get_args(kind.model_fields["kind"].annotation)
        ):
            result.append(kind)  # a union tag
        return result
    origin = get_origin(kind)
    arguments = get_args(kind)
    if origin is dict:
        return [arguments[1]]
    if origin in (tuple, list) and isinstance(item, int):
        return [argument for argument in arguments if argument is not ...]
    if arguments:
        for argument in arguments:
            result += _below(argument, item)
    return result


def _models(kind: Any) -> list[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [model for argument in get_args(kind) for model in _models(argument)]
