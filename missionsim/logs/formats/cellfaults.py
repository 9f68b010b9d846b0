"""Why a CSV file cannot be read: each bad cell with its line and column."""

from __future__ import annotations

import codecs
import csv
import itertools
from collections.abc import Iterator
from pathlib import Path

from missionsim.errors import Fault
from missionsim.logs.formats.dialect import Dialect, field_position
from missionsim.logs.formats.header import MISSING_WORDS, is_number
from missionsim.logs.raw import wanted_kind
from missionsim.logs.times import is_stamp

_MOST_FAULTS = 20


def explain(path: Path, file: str, dialect: Dialect, typed: bool, reason: str) -> list[Fault]:
    """Find by a slow second reading what stopped the fast one: each bad cell with line and column."""
    faults: list[Fault] = []
    more = 0
    rows = 0
    try:
        with open(path, encoding=dialect.encoding, newline="") as handle:
            for number, line in itertools.islice(enumerate(handle, start=1), dialect.header_line, None):
                if not line.strip():
                    continue
                rows += 1
                for fault in _line_faults(line.rstrip("\r\n"), number, file, dialect, typed):
                    if len(faults) < _MOST_FAULTS:
                        faults.append(fault)
                    else:
                        more += 1
    except UnicodeError as error:
        return [_bad_text(path, file, error)]
    if not rows:
        return [Fault(file, dialect.header_line, 1, "there is a header but no rows", allowed="at least two rows")]
    if more:
        faults.append(Fault(file, faults[-1].line + 1, 0, f"and {more} more such cells"))
    return faults or [Fault(file, 0, 0, f"the table cannot be read: {reason.splitlines()[0][:200]}")]


def _line_faults(line: str, number: int, file: str, dialect: Dialect, typed: bool) -> Iterator[Fault]:
    try:
        cells = (
            next(csv.reader([line], delimiter=dialect.delimiter, strict=True))
            if dialect.quoted
            else line.split(dialect.delimiter)
        )
    except (csv.Error, StopIteration):
        yield Fault(file, number, 1, "the line cannot be split into cells (an open quote?)", got=line[:60])
        return
    if len(cells) != len(dialect.names):
        hint = "decimal commas? then separate the columns with semicolons" if len(cells) > len(dialect.names) else ""
        yield Fault(
            file,
            number,
            1,
            f"{len(cells)} values where the header names {len(dialect.names)} columns",
            got=line[:60],
            hint=hint,
        )
        return
    if not typed:
        return
    for index, (name, cell) in enumerate(zip(dialect.names, cells, strict=True)):
        word = cell.strip()
        if wanted_kind(name) != "number" or word in MISSING_WORDS or (name == "time_s" and is_stamp(word)):
            continue
        if not is_number(word.replace(",", ".") if dialect.decimal == "," else word) or "_" in word:
            yield Fault(
                file,
                number,
                field_position(line, dialect.delimiter, index),
                "this is not a number",
                name,
                word[:40] or "''",
                "a number, or nothing for a missing value",
            )


def text_faults(path: Path, file: str) -> list[Fault]:
    """A fault where a byte of the file is not UTF-8, else nothing; in bounded memory."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    with open(path, "rb") as handle:
        while True:
            block = handle.read(1 << 22)
            try:
                decoder.decode(block, final=not block)
            except UnicodeDecodeError as error:
                return [_bad_text(path, file, error)]
            if not block:
                return []


def _bad_text(path: Path, file: str, error: UnicodeError) -> Fault:
    data = path.read_bytes()
    start = getattr(error, "start", 0)
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        decoder.decode(data, True)
    except UnicodeDecodeError as exact:
        start = exact.start
    line = data.count(b"\n", 0, start) + 1
    column = start - (data.rfind(b"\n", 0, start) + 1) + 1
    return Fault(file, line, column, "a byte that is not UTF-8 text", allowed="UTF-8 (or UTF-16 with its mark)")
