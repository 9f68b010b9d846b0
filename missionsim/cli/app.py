"""All commands, loaded when they are called, how a command line becomes a call, one place where faults become messages
and exit codes, and the checks of the files that a command is to write."""

from __future__ import annotations

import codecs
import csv
import importlib
import inspect
import io
import itertools
import os
import re
import sys
import tempfile
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from missionsim.cli.options import SHARED, Call, Target, options_of
from missionsim.errors import Fault, InputError, visible
from missionsim.files import is_device

EXIT_FINE, EXIT_INPUT, EXIT_OURS = 0, 2, 3
EXIT_INTERRUPTED, EXIT_PIPE = 130, 141
"""128 and the number of the signal, as shells count."""

with Path(__file__).with_name("commands.csv").open(newline="", encoding="utf-8") as _table:
    COMMANDS = {name: (function, told) for name, function, told in itertools.islice(csv.reader(_table), 1, None)}
"""Command → (function inside `missionsim.cli`, one line of help); the function is imported when it is called."""

HELP = """Energy that mobile robots spend on missions: simulate, vary, compare with measurements, find what is missing.

Exit codes: 0 fine, 1 the answer is no (infeasible, outside the tolerance), 2 a fault in the input, 3 our own fault."""


_PLAIN = {
    "−": "-", "–": "-", "→": "->", "←": "<-", "≤": "<=", "≥": ">=", "…": "...", "×": "x", "·": "*", "²": "^2",
    "³": "^3", "√": "sqrt", "±": "+-", "≈": "~", "°": " deg", "Ω": "Ohm", "ω": "w", "θ": "theta", "σ": "sigma",
    "α": "alpha", "τ": "tau", "η": "eta", "λ": "lambda", "Σ": "sum", "₀": "0", "₁": "1", "₂": "2", "₃": "3",
}  # fmt: skip


def _plainly(error: UnicodeError) -> tuple[str, int]:
    """For streams that cannot show a character (ASCII, Windows-1252): a plain spelling, or its code."""
    assert isinstance(error, UnicodeEncodeError)
    bad = error.object[error.start : error.end]
    return "".join(_PLAIN.get(one) or f"\\u{ord(one):04x}" for one in bad), error.end


codecs.register_error("missionsim", _plainly)


def run_command(arguments: Sequence[str]) -> int:
    """Run one command line, given without the program's name.

    Gives the exit code: 0 fine, 1 the answer is "no", 2 a fault in the user's input, 3 our own fault, 130 interrupted,
    141 the reader of the output has gone.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="missionsim")
    closed = sys.stdout is None  # as of a service without a terminal
    sys.stdout, sys.stderr = (open(os.devnull, "w") if one is None else one for one in (sys.stdout, sys.stderr))  # noqa: SIM115
    word = next(iter(arguments), "")
    try:
        if closed and ("--json=-" in arguments or ("--json", "-") in itertools.pairwise(arguments)):
            raise InputError.single("standard output is closed", got="--json -", allowed="--json FILE")
        if word and not word.startswith("-") and word not in COMMANDS:
            raise InputError.unknown(f"there is no command '{word}'", word, COMMANDS)
        if "" in arguments:
            told = "an argument is empty"
            raise InputError.single(told, got=f"number {list(arguments).index('') + 1}", allowed="text")
        call = read_call(arguments)
        if call is None:
            return EXIT_INPUT
        if call.function.__module__.startswith(__package__):  # help and completion write nothing
            check_targets(call)
        result = call.function(*call.arguments, **call.options)
        sys.stdout.flush()
        return result if isinstance(result, int) and not isinstance(result, bool) else EXIT_FINE
    except InputError as error:
        print(error, file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except (BrokenPipeError, SystemExit) as end:
        # rich ends the program itself where it meets a closed pipe
        if isinstance(end, SystemExit) and not isinstance(end.__context__, BrokenPipeError):
            raise
        # the reader of our output has gone (`| head`): end quietly, as programs do that the signal ends, and not with
        # 0, because what a command does after printing may be undone
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return EXIT_PIPE
    except OSError as error:
        if error.filename is None:  # what is buffered would fail once more when the program ends
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        print(visible(f"{error.filename or 'standard output'}: error: {error.strerror or error}"), file=sys.stderr)
        return EXIT_INPUT
    except Exception as error:
        if os.environ.get("MISSIONSIM_DEBUG"):
            raise
        print(
            f"missionsim: our own fault: {type(error).__name__}: {error}\n"
            "    set MISSIONSIM_DEBUG=1 for the traceback and tell us, please",
            file=sys.stderr,
        )
        return EXIT_OURS


def read_call(arguments: Sequence[str], plain: bool = True) -> Call | None:
    """The call that a command line means; None, with a message on standard error, where the parser refuses it. `plain`:
    whether plain calls go without the whole parser."""
    word = next(iter(arguments), "")
    if plain and word in COMMANDS and (call := plain_call(arguments[1:], COMMANDS[word][0])) is not None:
        return call
    for before, after in itertools.pairwise([*arguments, "-"]):
        # as a path, nothing would be the present folder
        if before.strip("=") in ("--out", "--json", "--report", "--mcap") and (before[-1] == "=" or not after.strip()):
            raise InputError.single(f"{before.strip('=')} names nothing", got="''", allowed="a path")
    from cyclopts import App, CycloptsError, Parameter

    from missionsim import __version__

    for group in SHARED:
        Parameter(name="*")(group)
    usual = Parameter(negative=())
    app = App(name="missionsim", help=HELP, version=__version__, help_format="plaintext", default_parameter=usual)
    app.register_install_completion_command(help="Install completion for a shell: bash, zsh or fish.")
    for name, (target, summary) in COMMANDS.items():
        app.command(f"missionsim.cli.{target}", name=name, help=summary)
    try:
        function, bound, _ = app.parse_args(spelled_out(arguments), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        print(visible(f"command line: error: {' '.join(str(error).split())}"), file=sys.stderr)
        for before, after in itertools.pairwise(arguments):
            if "requires an argument" in str(error) and f" {before} " in str(error) and after[:1] == "-" != after[1:2]:
                print(f"    a value that begins with - is joined to its option: {before}={after!r}", file=sys.stderr)
        print("    see: missionsim --help", file=sys.stderr)
        return None
    known = options_of(function) if function.__module__.startswith(__package__) else {}
    for before, after in itertools.pairwise([*arguments, ""]):
        name, equals, value = before.partition("=")
        value = value if equals else after
        if name in known and int in known[name].types and "." in value:  # which the parser would round
            raise InputError.single(f"{name} takes a whole number", got=value, allowed="such as 5")
    return Call(function, bound.args, bound.kwargs)


def plain_call(words: Sequence[str], target: str) -> Call | None:
    """A plain call; None for whatever is not plain, which is left to the whole parser.

    Plain is a command with its files, options that take one value, and flags. Help, figures, faults on the command line
    and anything unusual are not. The parser takes longer to load, and to open each command's options, than many
    commands take. `target`: ``module:name`` of the command's function inside `missionsim.cli`.
    """
    module, _, attribute = target.partition(":")
    function = getattr(importlib.import_module(f"missionsim.cli.{module}"), attribute)
    # an application of commands has no signature that names a file
    first = next(iter(inspect.signature(function).parameters.values()), None)
    if first is None or first.annotation != "Path" or first.kind is first.KEYWORD_ONLY:
        return None
    known = options_of(function)
    files: list[str] = []
    given: dict[str, dict[str, Any]] = {}
    rest = iter(words)
    for word in rest:
        if not word.startswith("-"):
            files.append(word)
            continue
        name, equals, value = word.partition("=")
        option = known.get(name)
        if option is None or not option.one_word or (bool in option.types and equals):
            return None
        flag, several = bool in option.types, list[str] in option.types
        if not flag and not equals:
            value = next(rest, "")
        taken = given.setdefault(option.parameter, {})
        choices = [typing.get_args(one) for one in option.types if typing.get_origin(one) is typing.Literal]
        if choices and value not in choices[0]:
            return None
        dash = value.startswith("-") and not (name == "--json" and value == "-")
        if dash or not (value or flag) or (option.field in taken and not several):
            return None
        if several:
            taken.setdefault(option.field, []).append(value)
        else:
            taken[option.field] = flag or (Path(value) if Path in option.types else value)
    if not files or not all(files) or (len(files) > 1 and first.kind is not first.VAR_POSITIONAL):
        return None
    if first.name in given:
        return None
    groups = {option.parameter: option.group for option in known.values()}
    paths = tuple(Path(file) for file in files)
    try:
        made = {name: (group(**told) if (group := groups[name]) else told[name]) for name, told in given.items()}
        inspect.signature(function).bind(*paths, **made)
    except TypeError:
        return None  # something that must be given is not
    return Call(function, paths, made)


def spelled_out(words: Sequence[str]) -> list[str]:
    """The command line with each value joined to its option where the parser could take it for something else.

    ``--json -`` is standard output; ``run --plot`` may be followed by formats, but a word that is a path (has a dot
    or a separator, or is there as a file) is none.
    """
    found: list[str] = []
    formats = False
    for word in (*words, "--"):
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
    return found[:-1]


_REFERENCES = ("robot", "environment", "mission")
"""Keys under which a mission or study names another file."""


def check_targets(call: Call) -> None:
    """Refuse ``--json``, ``--out`` and ``--report`` that cannot be written, or that are an input or each other. Raises
    InputError: with every such path."""
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
