"""Leave out what is faulty, so that the rest of a file can still be checked against the other files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any


def without(data: Any, paths: Iterable[Sequence[str | int]]) -> Any:
    """A copy of `data` without the values at `paths`; None where nothing is left.

    A path that leads to something that is not there (a missing key) takes out the mapping that misses it.
    """
    result = data
    ordered = sorted(
        {tuple(path) for path in paths}, key=lambda path: [str(item).rjust(8) for item in path], reverse=True
    )
    for path in ordered:
        if not path:
            return None
        shorter = path
        while shorter and not _exists(result, shorter):
            shorter = shorter[:-1]
            if _exists(result, shorter) and len(shorter) == len(path) - 1:
                break
        if not shorter or shorter == ("kind",):
            return None
        result = _drop(result, shorter)
    return result


def _exists(data: Any, path: Sequence[str | int]) -> bool:
    for item in path:
        if isinstance(data, dict) and item in data:
            data = data[item]
            continue
        if not isinstance(data, list) or not isinstance(item, int) or item >= len(data):
            return False
        data = data[item]
    return True


def _drop(data: Any, path: Sequence[str | int]) -> Any:
    head, rest = path[0], path[1:]
    if isinstance(data, dict):
        if not rest:
            return {key: value for key, value in data.items() if key != head}
        return {key: _drop(value, rest) if key == head else value for key, value in data.items()}
    if isinstance(data, list):
        if not rest:
            return [value for index, value in enumerate(data) if index != head]
        return [_drop(value, rest) if index == head else value for index, value in enumerate(data)]
    return data
