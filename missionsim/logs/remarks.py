"""Remarks: what was wrong with a log, and what was done about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from missionsim.errors import Fault


@dataclass(frozen=True)
class Remark:
    """One finding of the log checks."""

    kind: str
    """Short name of the check: ``time_backwards``, ``duplicate``, ``gap``, ``missing``, ``repeated``, ``frozen``,
    ``range``, ``unit``, ``sign``, ``clock``, ``name``, ``format``, ``disagreement``, ``obstacle`` (stands in the way of
    a diagnosis), ``damaged`` (part of the file is missing)."""
    column: str
    """The column it is about; empty for the whole file."""
    message: str
    """What is wrong, with numbers."""
    action: str
    """What was done: nothing is dropped or changed without saying so here."""
    severity: str = "warning"
    """``note`` (good to know), ``warning`` (doubtful), ``error`` (against the contract of the columns; the log is still
    read, but ``missionsim validate`` refuses it)."""
    line: int = 0
    """Line of the first occurrence in a text file (1-based), 0 where there is none."""
    count: int = 0
    """Rows concerned."""

    def __str__(self) -> str:
        where = f" (line {self.line})" if self.line else ""
        about = f"{self.column}: " if self.column else ""
        return f"{about}{self.message}{where}; {self.action}"

    def fault(self, file: str) -> Fault:
        """The remark as a fault of `file`, for ``missionsim validate``."""
        severity = "error" if self.severity == "error" else "warning"
        return Fault(file, self.line, 0, f"{self.message}; {self.action}", path=self.column, severity=severity)


def merge(remarks: Iterable[Remark]) -> list[Remark]:
    """Join the remarks of several blocks: one for the same check, column, severity and action."""
    joined: dict[tuple[str, ...], Remark] = {}
    for remark in remarks:
        key = (remark.kind, remark.column, remark.severity, remark.action)
        seen = joined.get(key)
        joined[key] = remark if seen is None else replace(seen, count=seen.count + remark.count)
    return list(joined.values())
