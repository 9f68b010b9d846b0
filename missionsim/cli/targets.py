"""What a command is to write, checked before it computes: no folder where a file is due, no input overwritten."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from missionsim.errors import Fault, InputError

_FOLDER = {"run", "montecarlo", "compare", "reproduce", "schema", "examples"}
"""Commands whose ``--out`` is a folder."""
_FILE = {"whatif", "calibrate", "add-effect", "improve", "import-site", "import-robot", "export"}
"""Commands whose ``--out`` is a file; `import` takes either."""
_ROBOT_FILE = {"calibrate", "add-effect", "improve", "import-robot"}
"""Commands whose ``--out`` is a robot file."""
_TARGETS = ("--json", "--out", "--report", "--mcap")
_MORE_TARGETS = {"import-site": ("--mission",)}
"""Options that name an output in one command, and an input in others."""
_REFERENCE = re.compile(r"""(?:^|[\s{,])(?:robot|environment|mission)\s*:\s*["']?([^\s"'#,{}]+)""")
"""Another file that a mission or study names."""


def check_targets(arguments: Sequence[str]) -> None:
    """Refuse ``--json``, ``--out`` and ``--report`` that cannot be written, or that are an input or each other.

    Parameters
    ----------
    arguments : sequence of str
        The command line without the program's name.

    Raises
    ------
    missionsim.errors.InputError
        With every such path as the user wrote it.
    """
    command = next(iter(arguments), "")
    targets, others = _sorted(arguments[1:], (*_TARGETS, *_MORE_TARGETS.get(command, ())))
    if not targets:
        return
    faults = list(_faults(command, targets)) or list(_clashes(command, targets, others))
    if faults:
        raise InputError(faults)


def _sorted(words: Sequence[str], options: Sequence[str]) -> tuple[list[tuple[str, str]], list[str]]:
    """The (option, path) that are to be written, and all other words and values of options: inputs, if they are there.

    Standard output (``-``) is no path; a missing value is left to the parser.
    """
    targets: list[tuple[str, str]] = []
    others: list[str] = []
    index = 0
    while index < len(words):
        word = words[index]
        index += 1
        option, equals, value = word.partition("=")
        if option in options:
            if not equals:
                value = words[index] if index < len(words) else "-"
                index += not value.startswith("-")
            if not value.startswith("-"):
                targets.append((option, value))
        elif equals or not word.startswith("-"):
            # lists of files (--holdout a,b) and --set robot=bot.yaml too
            others += [part for part in dict.fromkeys([word, value, *re.split("[=,]", word)]) if part.strip()]
    return targets, others


def _faults(command: str, targets: Sequence[tuple[str, str]]) -> Iterator[Fault]:
    for option, value in targets:
        is_file = option != "--out" or command in _FILE
        is_folder = option == "--out" and command in _FOLDER
        if message := _problem(value, is_file, is_folder):
            allowed = "a file's path" if is_file else "a folder's path"
            yield Fault("", 0, 0, f"{option} {message}", "", f"'{value}'", allowed + (", or -" * (option == "--json")))
        elif option == "--out" and command in _ROBOT_FILE and not _may_be_yaml(Path(value)):
            yield Fault("", 0, 0, "--out is a robot file", "", f"'{value}'", "a name that ends in .yaml or .yml")


def _clashes(command: str, targets: Sequence[tuple[str, str]], others: Sequence[str]) -> Iterator[Fault]:
    """Outputs that are a file the command reads, or that another option writes too; links are followed."""
    written: dict[tuple[int, int] | str, str] = {}
    for option, value in targets:
        path = Path(value)
        if _is_device(path):
            continue
        name = _identity(path)
        if (first := written.setdefault(name, option)) != option:
            yield Fault("", 0, 0, f"{first} and {option} are the same path", "", f"'{value}'", "two different paths")
        elif path.is_file() and (read := _reads(others, path, name)) is not None:
            yield Fault(
                "", 0, 0, f"{option} would overwrite an input of this command{read}", "", f"'{value}'", "another path"
            )
        elif command == "compare" and option == "--out" and any(name == _identity(Path(o)) for o in others):
            yield Fault(
                "",
                0,
                0,
                "--out is a folder of logs; the tables in it would count as logs",
                "",
                f"'{value}'",
                "another folder",
            )


def _reads(words: Sequence[str], target: Path, name: tuple[int, int] | str) -> str | None:
    """How an existing file is read, in words for the end of a sentence; None where it is not."""
    for word in words:
        path = Path(word)
        try:
            if path.is_dir():
                inside = target.resolve().is_relative_to(path.resolve())
                if inside and (target.suffix.lower() in _read_in_folders() or target.name == "metadata.yaml"):
                    return f", which lies in {word}"
            elif path.is_file():
                if _identity(path) == name:
                    return "" if word == str(target) else f", {word}"
                if other := _named_in(path, name, 3):
                    return f", which {other} names"
        except (OSError, ValueError):
            continue  # a word that cannot be a path
    return None


def _read_in_folders() -> tuple[str, ...]:
    """What is read of a folder that is given as input; other files in it are not."""
    from missionsim.logs.readers import source_suffixes

    return source_suffixes()


def _named_in(path: Path, name: tuple[int, int] | str, depth: int) -> str | None:
    """The mission or study, from `path` on, that names a file as its robot, environment or mission."""
    if path.suffix.lower() not in (".yaml", ".yml") or depth == 0:
        return None
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        for reference in _REFERENCE.findall(line):
            other = path.parent / reference
            if other.is_file():
                if _identity(other) == name:
                    return str(path)
                if found := _named_in(other, name, depth - 1):
                    return found
    return None


def _identity(path: Path) -> tuple[int, int] | str:
    """The same for two paths to one file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def _may_be_yaml(path: Path) -> bool:
    return path.suffix.lower() in (".yaml", ".yml") or _is_device(path)


def _is_device(path: Path) -> bool:
    return "/dev" in map(str, path.absolute().parents) or (path.exists() and not path.is_file() and not path.is_dir())


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
