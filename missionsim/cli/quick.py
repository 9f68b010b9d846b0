"""Plain calls of `run` and `validate` without the command-line parser, which takes longer to load than they take."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

_OPTIONS = {"run": {"--set", "--robot", "--out", "--format", "--json", "--mcap"}, "validate": {"--json"}}
"""Options that take one value."""


def quick(arguments: Sequence[str]) -> int | None:
    """Exit code of a plain call; None for whatever is not plain, which is left to the whole parser.

    Plain is a command with its files, options that take one value and ``--quiet``. Help, figures, faults on the command
    line and anything unusual are not.

    Parameters
    ----------
    arguments : sequence of str
        Command line without the program's name.
    """
    command, *words = arguments or [""]
    known = _OPTIONS.get(command)
    if known is None:
        return None
    files: list[str] = []
    given: dict[str, list[str]] = {}
    quiet = False
    rest = iter(words)
    for word in rest:
        if word == "--quiet":
            quiet = True
            continue
        if not word.startswith("-"):
            files.append(word)
            continue
        name, equals, value = word.partition("=")
        value = value if equals else next(rest, "")
        dash = value.startswith("-") and not (name == "--json" and value == "-")
        if name not in known or not value or dash or (name in given and name != "--set"):
            return None
        given.setdefault(name, []).append(value)
    if not files or not all(files):
        return None
    one = {name: values[-1] for name, values in given.items()}
    if command == "validate":
        from missionsim.cli.validate_files import validate_files

        return validate_files([Path(file) for file in files], one.get("--json"), quiet)
    format = one.get("--format", "csv")
    if len(files) != 1 or format not in ("csv", "parquet"):
        return None
    from missionsim.cli.run_mission import run_mission

    out = Path(one["--out"]) if "--out" in one else None
    return run_mission(
        Path(files[0]),
        given.get("--set"),
        one.get("--robot"),
        out,
        "parquet" if format == "parquet" else "csv",
        None,
        one.get("--json"),
        quiet,
        Path(one["--mcap"]) if "--mcap" in one else None,
    )


def with_plot_last(arguments: Sequence[str]) -> list[str]:
    """The command line with ``run --plot [png|svg] MISSION`` brought into the order that the parser can tell apart.

    ``--plot`` may be followed by formats; a mission after it would be taken for one. A word that is a path (has a dot
    or a separator, or is there as a file) is none.
    """
    words = list(arguments)
    if words[:1] != ["run"] or "--plot" not in words:
        return words
    begin = words.index("--plot")
    end = begin + 1
    while end < len(words) and not words[end].startswith("-") and not _is_path(words[end]):
        end += 1
    return [*words[:begin], *words[end:], *words[begin:end]]


def _is_path(word: str) -> bool:
    return "." in word or "/" in word or Path(word).is_file()
