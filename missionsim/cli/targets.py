"""Checks of the files that a command is to write: that they can be, and are neither an input nor each other."""

from __future__ import annotations

import inspect
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from missionsim.cli.options import Call, Target, options_of
from missionsim.errors import Fault, InputError
from missionsim.files import is_device

_REFERENCES = ("robot", "environment", "mission")
"""Keys under which a mission or study names another file."""


def check_targets(call: Call) -> None:
    """Refuse ``--json``, ``--out`` and ``--report`` that cannot be written, or that are an input or each other.

    Raises
    ------
    missionsim.errors.InputError
        With every such path.
    """
    bound = inspect.signature(call.function).bind(*call.arguments, **call.options).arguments
    targets: list[tuple[str, Target, Path]] = []
    inputs: list[str] = []
    for name, option in options_of(call.function).items():
        value = bound.get(option.parameter)
        if option.group is not None and value is not None:
            value = getattr(value, option.field)
        if option.target is None:
            inputs += _words(value)
        elif value is not None and value != "-":
            targets.append((name, option.target, Path(str(value))))
    faults: list[Fault] = []

    def refuse(message: str, path: Path, allowed: str) -> None:
        faults.append(Fault("", 0, 0, message, "", f"'{path}'", allowed))

    for name, of, path in targets:
        if message := _problem(path, of.kind):
            allowed = "a file's path" if of.kind == "file" else "a folder's path"
            refuse(f"{name} {message}", path, allowed + (", or -" * (name == "--json")))
        elif of.endings and path.suffix.lower() not in of.endings and not is_device(path):
            refuse(f"{name} is {of.what}", path, f"a name that ends in {' or '.join(of.endings)}")
    # outputs that are a file the command reads, or that another option writes too; links are followed
    written: dict[tuple[int, int] | str, str] = {}
    for name, of, path in targets if not faults else ():
        if is_device(path):
            continue
        file = _identity(path)
        if (other := written.setdefault(file, name)) != name:
            refuse(f"{other} and {name} are the same path", path, "two different paths")
        elif path.is_file() and (read := _reads(inputs, path, file)) is not None:
            refuse(f"{name} would overwrite an input of this command{read}", path, "another path")
        elif of.kind == "folder" and any(file == _identity(Path(one)) for one in inputs):
            refuse(f"{name} is a folder of logs; the tables in it would count as logs", path, "another folder")
    if faults:
        raise InputError(faults)


def _words(value: object) -> list[str]:
    """Inputs, if they are there, among the words of a value: in lists of files (--holdout a,b) and in --set too."""
    if isinstance(value, (list, tuple)):
        return [word for one in value for word in _words(one)]
    if not isinstance(value, (str, Path)):
        return []
    text = str(value)
    return [part for part in dict.fromkeys([text, text.partition("=")[2], *re.split("[=,]", text)]) if part.strip()]


def _reads(words: Sequence[str], target: Path, name: tuple[int, int] | str) -> str | None:
    """How an existing file is read, in words for the end of a sentence; None where it is not."""
    from missionsim.logs.readers import source_suffixes

    for word in words:
        path = Path(word)
        try:
            if path.is_dir():
                inside = target.resolve().is_relative_to(path.resolve())
                if inside and (target.suffix.lower() in source_suffixes() or target.name == "metadata.yaml"):
                    return f", which lies in {word}"
            elif path.is_file():
                if _identity(path) == name:
                    return "" if word == str(target) else f", {word}"
                if other := _named_in(path, name, 3):
                    return f", which {other} names"
        except (OSError, ValueError):
            continue  # a word that cannot be a path
    return None


def _named_in(path: Path, name: tuple[int, int] | str, depth: int) -> str | None:
    """The mission or study, from `path` on, that names a file as its robot, environment or mission."""
    if path.suffix.lower() not in (".yaml", ".yml") or depth == 0:
        return None
    from missionsim.inputs.tree import read_document

    try:
        data = read_document(path).data
    except InputError:
        return None  # its faults are told where it is read
    for reference in _references(data):
        other = path.parent / reference
        if other.is_file():
            if _identity(other) == name:
                return str(path)
            if found := _named_in(other, name, depth - 1):
                return found
    return None


def _references(data: object) -> Iterator[str]:
    for key, value in data.items() if isinstance(data, dict) else ():
        if key in _REFERENCES and isinstance(value, str):
            yield value
        yield from _references(value)


def _identity(path: Path) -> tuple[int, int] | str:
    """The same for two paths to one file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def _problem(path: Path, kind: str) -> str:
    """Why a path cannot be written, as the end of a sentence; empty where it can."""
    try:
        if path.is_dir():
            if kind not in ("folder", "path"):
                return "is a folder, a file is to be written"
            return "" if _takes_files(path) else "is a folder that may not be written to"
        if path.exists():
            if kind == "folder":
                return "is a file, a folder is to be written"
            if not os.access(path, os.W_OK):
                return "is a file that may not be written"
            if is_device(path):
                return ""
        parent = next(part for part in path.absolute().parents if part.exists())
    except (OSError, ValueError) as error:
        return f"is no path ({getattr(error, 'strerror', None) or error})"
    if not parent.is_dir():
        return f"leads through {os.path.relpath(parent)}, which is no folder"
    return "" if _takes_files(parent) else "lies in a folder that may not be written to"


def _takes_files(folder: Path) -> bool:
    """Whether a file can be made in a folder: rights do not tell it of every file system (``/proc``)."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
