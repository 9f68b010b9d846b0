"""A command line as a call of a command's function: plain ones quickly, all others by the whole parser."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING

from missionsim.cli.options import SHARED

if TYPE_CHECKING:
    from cyclopts import App

PLAIN = ("run", "validate")
"""Commands that take less time than the parser takes to load."""


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


def plain_call(command: str, words: Sequence[str], target: str) -> Call | None:
    """A plain call; None for whatever is not plain, which is left to the whole parser.

    Plain is a command with its files, options that take one value, and flags. Help, figures, faults on the command line
    and anything unusual are not.
    """
    if command not in PLAIN:
        return None
    function = load(target)
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
    first = next(iter(inspect.signature(function).parameters.values()))
    several = first.kind is first.VAR_POSITIONAL
    if not files or not all(files) or (len(files) > 1 and not several) or first.name in given:
        return None
    groups = {option.parameter: option.group for option in known.values()}
    made = {name: (group(**told) if (group := groups[name]) else told[name]) for name, told in given.items()}
    return Call(function, tuple(Path(file) for file in files), made)


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
