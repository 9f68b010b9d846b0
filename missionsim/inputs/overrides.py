"""`--set path=value`: changes on the YAML tree before it is checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.inputs.tree import Document, parse_document

T = TypeVar("T")
ROOTS = ("robot", "environment")
"""First parts of a path that lead into another file."""
OF_ROBOT = ("body", "batteries", "motion", "components", "links", "switchboards", "processor", "schemes", "effects")
"""First parts that only a robot's file has; ``robot.`` before them may be left out."""


def split_assignment(text: str) -> tuple[str, str]:
    """``"defaults.speed=0.5 m/s"`` to its path and value. Raises InputError: no ``=`` or an empty path."""
    path, equals, value = text.partition("=")
    if not equals or not path.strip():
        raise InputError(
            Fault("", 0, 0, "not an assignment", got=text, allowed="path=value, such as defaults.speed=0.5")
        )
    return path.strip(), value.strip()


def route(overrides: Iterable[tuple[str, T]]) -> dict[str, list[tuple[str, T]]]:
    """Overrides by file: ``""`` (the mission), ``robot``, ``environment``. ``robot`` alone replaces the mission's
    robot; ``robot.x`` goes into the robot's file, and so does ``schemes.x``."""
    result: dict[str, list[tuple[str, T]]] = {"": [], **{root: [] for root in ROOTS}}
    for path, value in overrides:
        first, _, rest = path.partition(".")
        if first in ROOTS and rest:
            result[first].append((rest, value))
        elif first in OF_ROBOT:
            result["robot"].append((path, value))
        else:
            result[""].append((path, value))
    return result


def apply(document: Document, overrides: Iterable[tuple[str, object]]) -> list[Fault]:
    """Set each path in the document's data.

    `document`: changed in place: its `data` is replaced by a changed copy, `overrides` remembers the paths.
    `overrides`: values are YAML text or plain data. List items are named by index or by their ``name``. Gives faults:
    paths that do not exist, values that are not YAML.
    """
    faults: list[Fault] = []
    for path, value in overrides:
        shown = value if isinstance(value, str) else repr(value)
        try:
            data = value_of(value, document.prefix + path) if isinstance(value, str) else value
        except InputError as problem:
            faults += problem.faults
            continue
        found = resolve(document.data, path)
        if isinstance(found, Fault):
            faults.append(replace(found, path=document.prefix + path))
            continue
        document.data = _changed(document.data, found, data)
        document.overrides[found] = shown
    return faults


def value_of(text: str, path: str) -> object:
    """The data of a value. `path`: where it goes, for messages. Raises InputError: `text` is not YAML."""
    try:
        return parse_document(text or "null", name="").data
    except InputError as problem:
        reason = problem.faults[0].message
        told = f"value is {reason}" if reason.startswith("not") else reason
        raise InputError(Fault("", 0, 0, told, path, text)) from None


def resolve(data: object, path: str) -> tuple[str | int, ...] | Fault:
    """Keys and indices of a dotted path, or a fault that says how far it leads.

    The last key may be new; everything before it must exist, except that a missing mapping is made when it is the only
    one missing (``behaviour.path_stretch`` in a mission without ``behaviour``).
    """
    keys = [part.strip() for part in path.split(".")]
    result: list[str | int] = []
    here: Any = data
    while keys:
        key = keys[0]
        names: list[str] = []
        if not key:
            return Fault("", 0, 0, "empty part in a path", path, path, "parts between the dots")
        if isinstance(here, dict):
            count = next((count for count in range(len(keys), 0, -1) if ".".join(keys[:count]) in here), 0)
            if count:
                joined, keys = ".".join(keys[:count]), keys[count:]
                result.append(joined)
                here = here[joined]
                continue
            # one of several things with names of their own (batteries, components): a misspelt name makes no new one
            named = bool(here) and all(isinstance(item, dict) for item in here.values())
            if len(keys) <= 2 and not (len(keys) == 2 and named and did_you_mean(key, here)):
                return (*result, *keys)
            names = list(here)
        elif isinstance(here, list):
            # a segment is a mapping with one key, its kind
            wrapped = [isinstance(item, dict) and "name" not in item and len(item) == 1 for item in here]
            bodies = [next(iter(item.values())) if one else item for item, one in zip(here, wrapped, strict=True)]
            called = [str(b["name"]) if isinstance(b, dict) and "name" in b else None for b in bodies]
            index = int(key) if key.lstrip("-").isdecimal() and len(key) < 8 else len(here)
            if key in called or -len(here) <= index < len(here):
                index, keys = called.index(key) if key in called else index % len(here), keys[1:]
                result.append(index)
                here = here[index]
                if keys and isinstance(here, dict) and len(here) == 1 and keys[0] not in here:
                    inner = next(iter(here))
                    if isinstance(here[inner], dict):
                        result.append(inner)
                        here = here[inner]
                continue
            names = [*(name for name in called if name is not None), *map(str, range(min(len(here), 20)))]
        elif here is None or (len(keys) == 1 and isinstance(here, (str, int, float))):
            return (*result, *keys)
        told, hint = f"nothing called '{key}' on this path", did_you_mean(key, names)
        return Fault("", 0, 0, told, path, key, ", ".join(names[:20]), hint)
    return tuple(result)


def _changed(data: Any, path: Sequence[str | int], value: Any) -> Any:
    """A copy of `data` with `path` set; only what lies along the path is copied (aliases share the rest)."""
    if not path:
        return value
    head, rest = path[0], path[1:]
    if isinstance(data, list):
        assert isinstance(head, int)
        return [_changed(item, rest, value) if index == head else item for index, item in enumerate(data)]
    if isinstance(data, dict):
        return {**data, str(head): _changed(data.get(str(head)), rest, value)}
    if data is not None and head not in ("value",) and isinstance(data, (str, int, float)):
        return {"value": data, str(head): _changed(None, rest, value)}  # sd of a number that was plain
    return {str(head): _changed(None, rest, value)}
