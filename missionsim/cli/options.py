"""What commands share: options declared once, how a result is told, and the checks of files that are to be written."""

from __future__ import annotations

import dataclasses
import shlex
import sys
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Literal

from missionsim.errors import Fault, InputError, visible
from missionsim.files import to_json, write_text
from missionsim.identify.settings import ALPHA, Settings  # a module that loads nothing: the command line begins at once
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from rich.progress import Progress


@dataclass(frozen=True)
class Target:
    """An option's value is a path to write: a file (of what kind, and how its name ends), a folder, or either."""

    kind: Literal["file", "folder", "path"]
    what: str = ""
    endings: tuple[str, ...] = ()


OutFile = Annotated[Path, Target("file")]
OutPicture = Annotated[Path, Target("file", "a picture", (".png", ".svg"))]
OutPage = Annotated[Path, Target("file", "a page", (".html", ".htm"))]
OutRecording = Annotated[Path, Target("file", "a recording", (".mcap",))]
RobotFile = Annotated[Path, Target("file", "a robot file", (".yaml", ".yml"))]
OutFolder = Annotated[Path, Target("folder")]
OutPath = Annotated[Path, Target("path")]


@dataclass(frozen=True)
class Output:
    """How a result is told.

    Parameters
    ----------
    json
        Write the result as JSON to this file, or - for standard output.
    quiet
        Print nothing but what was asked for.
    """

    json: Annotated[str | None, Target("file")] = None
    quiet: bool = False

    @property
    def text(self) -> bool:
        """Whether tables are printed: not with ``--quiet``, nor where JSON goes to standard output."""
        return not self.quiet and self.json != "-"

    def emit(self, data: object) -> None:
        """Write a result as JSON to a file (whole or not at all) or to standard output for ``-``; nothing for None."""
        if self.json == "-":
            sys.stdout.write(to_json(data, not (sys.stdout.encoding or "").lower().startswith("utf")))
        elif self.json is not None:
            write_text(self.json, to_json(data))

    def warn(self, faults: Iterable[Fault]) -> None:
        """Say on standard error what the checks of the files found strange but possible, each once."""
        for fault in [] if self.quiet else dict.fromkeys(faults):
            print(fault, file=sys.stderr)

    def written(self, *paths: Path | None) -> None:
        """Say which files were written."""
        if self.text and (names := ", ".join(str(path) for path in paths if path is not None)):
            console().print(f"Written: {names}", soft_wrap=True)

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """A progress bar with rate and time left on standard error; hidden where it is no terminal."""
        from rich import progress
        from rich.text import Text

        class Rate(progress.ProgressColumn):
            """How many a second."""

            def render(self, task: progress.Task) -> Text:
                speed = task.finished_speed or task.speed
                return Text("" if speed is None else f"{speed:,.3g}/s" if speed < 100 else f"{speed:,.0f}/s")

        terminal = console(stderr=True)
        text = progress.TextColumn("{task.description}", markup=False)
        columns = (text, progress.BarColumn(), progress.MofNCompleteColumn(), Rate())
        more = (progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
        hidden = self.quiet or not terminal.is_terminal
        with progress.Progress(*columns, *more, console=terminal, transient=True, disable=hidden) as bar:
            yield bar


@dataclass(frozen=True)
class Changes:
    """What differs from the files.

    Parameters
    ----------
    set_
        path=value, such as defaults.speed=0.5 or robot.batteries.robot.capacity="100 Wh"; may be given several times.
    robot
        Shipped robot or robot file in place of the one that the file names.
    """

    set_: list[str] | None = None
    robot: str | None = None

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Paths and values of ``--set``. Raises InputError: not an assignment, or a path that is given twice."""
        from missionsim.inputs.overrides import route, split_assignment

        pairs = tuple(split_assignment(text) for text in self.set_ or ())
        for given in route(pairs).values():
            for path in dict(given):
                values = [value for one, value in given if one == path]
                if len(values) > 1:
                    told, got = "set more than once; only the last would hold", " and ".join(values)
                    raise InputError.single(told, path=path, got=got, allowed="one --set for each path")
        return pairs


@dataclass(frozen=True)
class Search:
    """What a search for effects is told.

    Parameters
    ----------
    robot
        Shipped robot's name or a robot file.
    battery
        Only this battery; add-effect takes the one of the motors unless told otherwise.
    holdout
        Runs that are not fitted but tested on: a fraction, run names with commas between, a condition such as
        "surface == 'carpet'", or files and folders of other logs; none for no hold-out. By default the last quarter of
        four or more runs, or others where these show most of a load or a floor.
    alpha
        Family-wise rate of false alarms; 0.01 names more small effects, and more wrong ones.
    no_align
        Take the clocks of meter and motion as they are, for logs that were aligned already.
    """

    robot: str
    battery: str | None = None
    holdout: list[str] | None = None
    alpha: float = ALPHA
    no_align: bool = False

    def check(self, logs: Sequence[Path]) -> None:
        """Raises InputError: a search for effects without logs, or at a rate of false alarms that is none."""
        if not logs:
            raise InputError.single("give at least one log", allowed="files or folders")
        if not 0.0 < self.alpha < 0.5:
            raise InputError.single("--alpha is a probability", got=self.alpha, allowed="such as 0.01 or 0.05")

    @property
    def settings(self) -> Settings:
        """Settings of the identification."""
        return Settings(alpha=self.alpha, align=not self.no_align)

    @property
    def given(self) -> str:
        """The options that are not as by default, but the robot, as they are typed."""
        words = [] if self.battery is None else ["--battery", self.battery]
        words += [word for one in self.holdout or () for word in ("--holdout", one)]
        words += [] if self.alpha == ALPHA else ["--alpha", f"{self.alpha:g}"]
        return shlex.join([*words, *(["--no-align"] if self.no_align else [])])


SHARED = (Output, Changes, Search)
"""Groups of options; their fields are options of the commands that take one."""
TERMINAL = Output()
AS_FILED = Changes()


def tell_left_out(told: Sequence[str], to: Output) -> None:
    """Say before anything else, where the answer is read, which runs were left out; the exit code will be 1."""
    for line in told:
        print(visible(f"LEFT OUT {line}"), file=sys.stdout if to.text else sys.stderr)


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
    field: str
    group: type | None
    types: tuple[object, ...]
    """What it may hold; the members of a union."""
    target: Target | None

    @property
    def one_word(self) -> bool:
        """Whether it takes one word, or one word each time."""
        words = (str, bool, Path, type(None), list[str])
        return all(one in words or typing.get_origin(one) is Literal for one in self.types)


def options_of(function: Callable[..., object]) -> dict[str, Option]:
    """Every option of a command by its name, groups of options opened; positional parameters are among them."""
    found: dict[str, Option] = {}
    for name, hint in typing.get_type_hints(function, include_extras=True).items():
        group = hint if isinstance(hint, type) and dataclasses.is_dataclass(hint) else None
        inside = {name: hint} if group is None else typing.get_type_hints(group, include_extras=True)
        for part, inner in inside.items():
            members = list(_members(inner))
            targets = [mark for _, marks in members for mark in marks if isinstance(mark, Target)]
            types, option = tuple(one for one, _ in members), "--" + part.strip("_").replace("_", "-")
            found[option] = Option(name, part, group, types, next(iter(targets), None))
    found.pop("--return", None)
    return found


def _members(hint: object, marks: tuple[object, ...] = ()) -> Iterator[tuple[object, tuple[object, ...]]]:
    """A type, or the members of a union, each with what annotations say about it."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        yield from _members(inner[0], (*marks, *inner[1:]))
    elif origin is UnionType or origin is typing.Union:
        for one in inner:
            yield from _members(one, marks)
    else:
        yield hint, marks
