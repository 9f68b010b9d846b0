"""What the commands share: JSON output, tables and progress."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from missionsim.files import write_text
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from rich.progress import Progress

    from missionsim.errors import Fault
    from missionsim.logs import LogTable


def plain(value: Any) -> Any:
    """A value as JSON knows it: NumPy scalars and arrays become numbers and lists, nan and inf become null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(data: Any) -> str:
    """JSON text of a result, ending with a line feed."""
    return json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def emit_json(data: Any, target: str | None) -> None:
    """Write a result as JSON to a file (whole or not at all) or to standard output for ``-``; nothing for None."""
    if target is None:
        return
    if target == "-":
        sys.stdout.write(to_json(data))
    else:
        write_text(target, to_json(data))


def shows_text(json_target: str | None, quiet: bool) -> bool:
    """Whether tables are printed: not with ``--quiet``, nor where JSON goes to standard output."""
    return not quiet and json_target != "-"


@contextmanager
def progress(quiet: bool = False) -> Iterator[Progress]:
    """A progress bar with rate and time left on standard error; hidden with `quiet` or where it is no terminal."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        """How many a second."""

        def render(self, task: Any) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None else f"{speed:,.3g}/s" if speed < 100 else f"{speed:,.0f}/s")

    terminal = console(stderr=True)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=terminal,
        transient=True,
        disable=quiet or not terminal.is_terminal,
    ) as bar:
        yield bar


def check_search(logs: Sequence[Path], alpha: float) -> None:
    """Refuse a search for effects without logs, or at a rate of false alarms that is none.

    Raises
    ------
    missionsim.errors.InputError
    """
    from missionsim.errors import InputError

    if not logs:
        raise InputError.single("give at least one log", allowed="files or folders")
    if not 0.0 < alpha < 0.5:
        raise InputError.single("--alpha is a probability", got=alpha, allowed="such as 0.01 or 0.05")


def tell_warnings(faults: Iterable[Fault], quiet: bool = False) -> None:
    """Say on standard error what the checks of the files found strange but possible, each once."""
    for fault in [] if quiet else dict.fromkeys(faults):
        print(fault, file=sys.stderr)


def tell_logs(logs: Sequence[LogTable], quiet: bool = False) -> None:
    """Say on standard error what the checks of the logs found and what was done about it."""
    from missionsim.logs import describe

    for line in [] if quiet else describe(logs):
        print(line, file=sys.stderr)


def tell_left_out(told: Sequence[str]) -> None:
    """Say before anything else which runs were left out; the command ends with exit code 1."""
    for line in told:
        print(f"LEFT OUT {line}", file=sys.stderr)
