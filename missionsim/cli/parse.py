"""A command line as a call of a command's function, and what that call is to write, checked before it computes."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import re
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING

from missionsim.cli.options import SHARED, Target
from missionsim.errors import Fault, InputError
from missionsim.files import is_device

if TYPE_CHECKING:
    from cyclopts import App


@dataclass(frozen=True)
class Call:
    """A command's function with what it is given."""

    function: Callable[..., object]
    arguments: tuple[object, ...] = ()
    options: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Option:
    """An option of a command: the parameter that takes it, and, in a group of options, which of its fields."""

    parameter: str
    hint: object
    group: type | None = None
    field: str = ""


def load(target: str) -> Callable[..., object]:
    """A command's function, from ``module:name`` inside `missionsim.cli`."""
    module, _, name = target.partition(":")
    function: Callable[..., object] = getattr(importlib.import_module(f"missionsim.cli.{module}"), name)
    return function


def options_of(function: Callable[..., object]) -> dict[str, Option]:
    """Every option of a command by its name, groups of options opened; positional parameters are among them."""
    found: dict[str, Option] = {}
    for name, hint in typing.get_type_hints(function, include_extras=True).items():
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            for part, inner in typing.get_type_hints(hint, include_extras=True).items():
                found[_dashed(part)] = Option(name, inner, hint, part)
        elif name != "return":
            found[_dashed(name)] = Option(name, hint, field=name)
    return found


def _dashed(name: str) -> str:
    return "--" + name.strip("_").replace("_", "-")


def plain_call(words: Sequence[str], target: str) -> Call | None:
    """A plain call; None for whatever is not plain, which is left to the whole parser.

    Plain is a command with its files, options that take one value, and flags. Help, figures, faults on the command line
    and anything unusual are not. The parser takes longer to load, and to open each command's options, than many
    commands take.
    """
    function = load(target)
    signature = inspect.signature(function)
    first = next(iter(signature.parameters.values()), None)
    if first is None or first.annotation != "Path" or first.kind is first.KEYWORD_ONLY:
        return None
    known = options_of(function)
    files: list[str] = []
    given: dict[str, dict[str, object]] = {}
    rest = iter(words)
    for word in rest:
        if not word.startswith("-"):
            files.append(word)
            continue
        name, equals, value = word.partition("=")
        option = known.get(name)
        types = _types(option.hint) if option is not None else ()
        if option is None or not types or (bool in types and equals):
            return None
        if bool not in types and not equals:
            value = next(rest, "")
        taken = given.setdefault(option.parameter, {})
        choices = [typing.get_args(one) for one in types if typing.get_origin(one) is typing.Literal]
        if choices and value not in choices[0]:
            return None
        dash = value.startswith("-") and not (name == "--json" and value == "-")
        if dash or not (value or bool in types) or (option.field in taken and list[str] not in types):
            return None
        if list[str] in types:
            taken.setdefault(option.field, []).append(value)  # type: ignore[attr-defined]
        else:
            taken[option.field] = bool in types or (Path(value) if Path in types else value)
    several = first.kind is first.VAR_POSITIONAL
    if not files or not all(files) or (len(files) > 1 and not several) or first.name in given:
        return None
    groups = {option.parameter: option.group for option in known.values()}
    paths = tuple(Path(file) for file in files)
    try:
        made = {name: (group(**told) if (group := groups[name]) else told[name]) for name, told in given.items()}
        signature.bind(*paths, **made)
    except TypeError:
        return None  # something that must be given is not
    return Call(function, paths, made)


def _types(hint: object) -> tuple[object, ...]:
    """What an option that takes one word (or one word each time) may hold; nothing for another."""
    if typing.get_origin(hint) is typing.Annotated:
        return _types(typing.get_args(hint)[0])
    if isinstance(hint, UnionType) or typing.get_origin(hint) is typing.Union:
        members = [_types(one) for one in typing.get_args(hint)]
        return tuple(one for member in members for one in member) if all(members) else ()
    return (
        (hint,) if hint in (str, bool, Path, type(None), list[str]) or typing.get_origin(hint) is typing.Literal else ()
    )


def build_app(commands: Mapping[str, tuple[str, str]], help: str) -> App:
    """The command-line application with every command."""
    from cyclopts import App, Parameter

    from missionsim import __version__

    for group in SHARED:
        Parameter(name="*")(group)
    app = App(
        name="missionsim",
        help=help,
        version=__version__,
        help_format="plaintext",
        default_parameter=Parameter(negative=()),
    )
    app.register_install_completion_command(help="Install completion for a shell: bash, zsh or fish.")
    for name, (target, summary) in commands.items():
        app.command(f"missionsim.cli.{target}", name=name, help=summary)
    return app


def whole_call(app: App, words: Sequence[str]) -> Call:
    """A call by the whole parser.

    Raises
    ------
    cyclopts.CycloptsError
        Where the command line is at fault.
    """
    function, bound, _ = app.parse_args(spelled_out(words), exit_on_error=False, print_error=False)
    return Call(function, bound.args, bound.kwargs)


def spelled_out(words: Sequence[str]) -> list[str]:
    """The command line with each value joined to its option where the parser could take it for something else.

    ``--json -`` is standard output; ``run --plot`` may be followed by formats, but a word that is a path (has a dot
    or a separator, or is there as a file) is none.
    """
    found: list[str] = []
    formats = False
    for word in words:
        if formats and not (word.startswith("-") or "." in word or "/" in word or Path(word).is_file()):
            found[-1:] = [f"--plot={word}"] if found[-1] == "--plot" else [found[-1], f"--plot={word}"]
            continue
        if formats and found[-1] == "--plot":
            found[-1] = "--plot=png"
        formats = word == "--plot" and words[0] == "run"
        if word == "-" and found[-1:] == ["--json"]:
            found[-1] = "--json=-"
        else:
            found.append(word)
    if formats and found[-1] == "--plot":
        found[-1] = "--plot=png"
    return found


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
        kinds = [mark for mark in _marks(option.hint) if isinstance(mark, Target)]
        if not kinds:
            inputs += _words(value)
        elif value is not None and value != "-":
            targets.append((name, kinds[0], Path(str(value))))
    if targets:
        faults = list(_faults(targets)) or list(_clashes(targets, inputs))
        if faults:
            raise InputError(faults)


def _marks(hint: object) -> tuple[object, ...]:
    """What annotations say about a type, or about a member of a union."""
    inner = (mark for part in typing.get_args(hint) for mark in _marks(part))
    return (*getattr(hint, "__metadata__", ()), *inner)


def _words(value: object) -> list[str]:
    """Inputs, if they are there, among the words of a value: in lists of files (--holdout a,b) and in --set too."""
    if isinstance(value, (list, tuple)):
        return [word for one in value for word in _words(one)]
    if not isinstance(value, (str, Path)):
        return []
    text = str(value)
    return [part for part in dict.fromkeys([text, text.partition("=")[2], *re.split("[=,]", text)]) if part.strip()]


def _faults(targets: Sequence[tuple[str, Target, Path]]) -> Iterator[Fault]:
    for option, target, path in targets:
        is_file, is_folder = target.kind in ("file", "robot file"), target.kind == "folder"
        if message := _problem(path, is_file, is_folder):
            allowed = "a file's path" if is_file else "a folder's path"
            yield _fault(f"{option} {message}", path, allowed + (", or -" * (option == "--json")))
        elif target.kind == "robot file" and path.suffix.lower() not in (".yaml", ".yml") and not is_device(path):
            yield _fault(f"{option} is a robot file", path, "a name that ends in .yaml or .yml")


def _fault(message: str, path: Path, allowed: str) -> Fault:
    return Fault("", 0, 0, message, "", f"'{path}'", allowed)


def _clashes(targets: Sequence[tuple[str, Target, Path]], inputs: Sequence[str]) -> Iterator[Fault]:
    """Outputs that are a file the command reads, or that another option writes too; links are followed."""
    written: dict[tuple[int, int] | str, str] = {}
    for option, target, path in targets:
        if is_device(path):
            continue
        name = _identity(path)
        if (first := written.setdefault(name, option)) != option:
            yield _fault(f"{first} and {option} are the same path", path, "two different paths")
        elif path.is_file() and (read := _reads(inputs, path, name)) is not None:
            yield _fault(f"{option} would overwrite an input of this command{read}", path, "another path")
        elif target.kind == "folder" and any(name == _identity(Path(one)) for one in inputs):
            yield _fault(f"{option} is a folder of logs; the tables in it would count as logs", path, "another folder")


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


def _problem(path: Path, is_file: bool, is_folder: bool) -> str:
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


def check_picture(path: Path | None) -> None:
    """Refuse a picture that is neither PNG nor SVG."""
    if path is not None and path.suffix.lower() not in (".png", ".svg"):
        raise InputError.single("--plot is a picture", got=f"'{path}'", allowed="a name that ends in .png or .svg")
