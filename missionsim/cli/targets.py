"""What a command is to write, checked before it computes: a folder where a file is due is told at once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from missionsim.errors import Fault, InputError

_FOLDER = {"run", "montecarlo", "compare", "reproduce", "schema"}
"""Commands whose ``--out`` is a folder."""
_FILE = {"whatif", "calibrate", "add-effect", "improve"}
"""Commands whose ``--out`` is a file; `import` takes either."""


def check_targets(arguments: Sequence[str]) -> None:
    """Refuse ``--json``, ``--out`` and ``--report`` that cannot be written.

    Parameters
    ----------
    arguments : sequence of str
        The command line without the program's name.

    Raises
    ------
    missionsim.errors.InputError
        With every such path as the user wrote it.
    """
    if faults := list(_faults(arguments)):
        raise InputError(faults)


def _faults(arguments: Sequence[str]) -> Iterator[Fault]:
    command, *words = arguments or [""]
    for index, word in enumerate(words):
        option, equals, value = word.partition("=")
        if option not in ("--json", "--out", "--report"):
            continue
        if not equals:
            value = words[index + 1] if index + 1 < len(words) else "-"
        if value.startswith("-"):
            continue  # standard output, or no value: the parser tells
        is_file = option != "--out" or command in _FILE
        is_folder = option == "--out" and command in _FOLDER
        if message := _problem(value, is_file, is_folder):
            allowed = "a file's path" if is_file else "a folder's path"
            yield Fault("", 0, 0, f"{option} {message}", "", f"'{value}'", allowed + (", or -" * (option == "--json")))


def _problem(value: str, is_file: bool, is_folder: bool) -> str:
    if not value.strip():
        return "names nothing"
    path = Path(value)
    try:
        if path.is_dir():
            if is_file:
                return "is a folder, a file is to be written"
            return "" if os.access(path, os.W_OK) else "is a folder that may not be written to"
        if path.exists():
            if is_folder:
                return "is a file, a folder is to be written"
            return "" if os.access(path, os.W_OK) else "is a file that may not be written"
        parent = next(part for part in path.absolute().parents if part.exists())
    except (OSError, ValueError) as error:
        return f"is no path ({getattr(error, 'strerror', None) or error})"
    if not parent.is_dir():
        return f"leads through {os.path.relpath(parent)}, which is no folder"
    return "" if os.access(parent, os.W_OK) else "lies in a folder that may not be written to"
