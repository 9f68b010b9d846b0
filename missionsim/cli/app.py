"""All commands, loaded when they are called, and one place where faults become messages and exit codes."""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from missionsim.cli.parse import Call, build_app, check_targets, plain_call, whole_call
from missionsim.errors import InputError, did_you_mean, visible

EXIT_FINE, EXIT_NO, EXIT_INPUT, EXIT_OURS = 0, 1, 2, 3
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
    """Run one command line.

    Parameters
    ----------
    arguments : sequence of str
        Without the program's name.

    Returns
    -------
    int
        Exit code: 0 fine, 1 the answer is "no", 2 a fault in the user's input, 3 our own fault, 130 interrupted,
        141 the reader of the output has gone.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="missionsim")
    word = next(iter(arguments), "")
    if word and not word.startswith("-") and word not in COMMANDS:
        hint = did_you_mean(word, COMMANDS)
        print(
            InputError.single(f"there is no command '{word}'", got=word, allowed=", ".join(COMMANDS), hint=hint),
            file=sys.stderr,
        )
        return EXIT_INPUT
    try:
        if "" in arguments:
            raise InputError.single(
                "an argument is empty", got=f"number {list(arguments).index('') + 1}", allowed="text"
            )
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
    except BrokenPipeError:
        return _reader_gone()
    except SystemExit as end:
        # rich ends the program itself where it meets a closed pipe
        if isinstance(end.__context__, BrokenPipeError):
            return _reader_gone()
        raise
    except OSError as error:
        print(visible(f"{error.filename or 'file'}: error: {error.strerror or error}"), file=sys.stderr)
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
    """The call that a command line means; None, with a message on standard error, where the parser refuses it.

    Parameters
    ----------
    arguments : sequence of str
    plain : bool
        Whether plain calls go without the whole parser.
    """
    word = next(iter(arguments), "")
    if plain and word in COMMANDS and (call := plain_call(arguments[1:], COMMANDS[word][0])) is not None:
        return call
    for before, after in itertools.pairwise([*arguments, "-"]):
        # as a path, nothing would be the present folder
        if before.strip("=") in ("--out", "--json", "--report", "--mcap") and (before[-1] == "=" or not after.strip()):
            raise InputError.single(f"{before.strip('=')} names nothing", got="''", allowed="a path")
    from cyclopts import CycloptsError

    try:
        return whole_call(build_app(COMMANDS, HELP), arguments)
    except CycloptsError as error:
        print(visible(f"command line: error: {' '.join(str(error).split())}"), file=sys.stderr)
        print("    see: missionsim --help", file=sys.stderr)
        return None


def _reader_gone() -> int:
    """The reader of our output has gone (`| head`): end quietly, as programs do that the signal ends.

    Not 0, because what a command does after printing may be undone.
    """
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    return EXIT_PIPE
