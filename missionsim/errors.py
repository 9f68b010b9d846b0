"""Faults in the user's input and how they are told: where, what came, what was allowed, what was perhaps meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

_CONTROL = {
    code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
    for code in (*range(0x20), *range(0x7F, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A), 0x2028, 0x2029)
    if chr(code) not in "\t\n"
}


def visible(text: str) -> str:
    """A text without what a terminal obeys: control characters and turns of direction stand as ``\\x1b``."""
    return text.translate(_CONTROL)


MOST_ECHOED = 400
"""Characters of what came that a message repeats."""


@dataclass(frozen=True, order=True)
class Fault:
    """One fault in a file of the user."""

    file: str
    """Path as the user gave it; empty for the command line itself."""
    line: int
    column: int
    """1-based position; 0 where a file has no such position (a Parquet column, a missing file)."""
    message: str
    """What is wrong, in one sentence without a full stop."""
    path: str = ""
    """Dotted path of the value inside the file (``batteries.robot.capacity``); may be empty."""
    got: str = ""
    """What came, as written."""
    allowed: str = ""
    """What would have been accepted."""
    hint: str = ""
    """What was perhaps meant."""
    severity: str = "error"
    """``"error"`` or ``"warning"``; only errors stop a command."""

    def __str__(self) -> str:
        where = self.file or "command line"
        if self.line:
            where += f":{self.line}:{self.column}" if self.column else f":{self.line}"
        # the two ends of a long text; nobody needs ten thousand digits back
        middle = f" … {self.got[-20:]} ({len(self.got):,} characters)"
        short = self.got if len(self.got) <= MOST_ECHOED else self.got[: MOST_ECHOED // 2] + middle
        told = {"at": self.path, "got": short, "allowed": self.allowed, "did you mean": self.hint}
        rest = "".join(f"\n    {what}: {text}" for what, text in told.items() if text)
        return visible(f"{where}: {self.severity}: {self.message}{rest}")


class MissionsimError(Exception):
    """Base of all errors that missionsim raises on purpose."""


class InputError(MissionsimError):
    """Faults in the user's input, all of them at once; the command line exits with 2.

    Parameters
    ----------
    faults : iterable of Fault
        At least one.
    """

    def __init__(self, faults: Iterable[Fault] | Fault) -> None:
        self.faults: tuple[Fault, ...] = (faults,) if isinstance(faults, Fault) else tuple(sorted(set(faults)))
        # the argument is what makes the same error again: SimPy and pickle do that
        super().__init__(self.faults)

    def __str__(self) -> str:
        return "\n".join(str(fault) for fault in self.faults)

    @classmethod
    def single(
        cls, message: str, *, file: str = "", got: object = "", allowed: str = "", hint: str = "", path: str = ""
    ) -> InputError:
        """One fault without a position in a file."""
        return cls(Fault(file, 0, 0, message, path, str(got) if got != "" else "", allowed, hint))

    @classmethod
    def unknown(cls, message: str, got: str, known: Iterable[str], *, allowed: str = "", file: str = "") -> InputError:
        """A name that is none of the known ones, with the closest of them; `allowed` where they are not all of it."""
        names = list(known)
        hint = did_you_mean(got, names)
        return cls.single(message, file=file, got=got, allowed=allowed or ", ".join(names), hint=hint)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name closest to a word; an empty string where none has at least that likeness, 0 to 1."""
    names = {name: name for name in known}
    found = difflib.get_close_matches(word, names, n=1, cutoff=cutoff)
    if not found:
        names = {name.lower(): name for name in names}
        found = difflib.get_close_matches(word.lower(), names, n=1, cutoff=cutoff)
    return names[found[0]] if found else ""
