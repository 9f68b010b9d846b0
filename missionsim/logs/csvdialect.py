"""How a CSV file is written: delimiter, decimal mark, encoding, header; and the line of each row."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from missionsim.errors import Fault, InputError
from missionsim.logs.remarks import Remark

_HEAD_BYTES = 65536
_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
MISSING_WORDS = (
    "",
    "#N/A",
    "#NA",
    "-NaN",
    "-nan",
    "N/A",
    "NA",
    "NULL",
    "NaN",
    "n/a",
    "nan",
    "null",
    "None",
    "none",
    "NAN",
)
_COMMA_NUMBER = re.compile(r"^[+-]?\d+,\d+$")


@dataclass
class Dialect:
    """How a CSV file is written.

    Attributes
    ----------
    names : tuple of str
        Column names of the header.
    delimiter, decimal, encoding : str
    header_line : int
        1-based line of the header.
    quoted : bool
        Whether the start of the file has quotation marks; where it has none, a later one is part of its cell.
    remarks : list of Remark
        What is unusual.
    """

    names: tuple[str, ...]
    delimiter: str
    decimal: str
    encoding: str
    header_line: int
    quoted: bool = False
    remarks: list[Remark] = field(default_factory=list)


def sniff(path: Path, file: str, header: Sequence[str] = (), delimiter: str | None = None) -> Dialect:
    """Read the start of a CSV file and find out how it is written.

    Parameters
    ----------
    path, file
        The file, and its name in messages.
    header : sequence of str
        Names of the columns of a file that has no header line.
    delimiter : str, optional
        Where it is known.

    Raises
    ------
    missionsim.errors.InputError
        Empty, binary, without a header, or with a header that names a column twice.
    """
    with open(path, "rb") as handle:
        head = handle.read(_HEAD_BYTES)
    if not head.strip():
        raise InputError(Fault(file, 1, 1, "the file is empty", allowed="a header line and rows"))
    remarks: list[Remark] = []
    encoding = "utf-8"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
        remarks.append(Remark("format", "", "the text is UTF-16", "read as such", "note"))
        head = head[: len(head) // 2 * 2]
    elif head.startswith(codecs.BOM_UTF8):
        encoding = "utf-8-sig"
        remarks.append(Remark("format", "", "the text starts with a byte order mark", "it was skipped", "note"))
    elif b"\0" in head:
        raise InputError(Fault(file, 1, 1, "this is not a text file", allowed="CSV, or Parquet"))
    text = head.decode(encoding, errors="replace")
    lines = text.splitlines()
    skipped = 0
    while skipped < len(lines) and (not lines[skipped].strip() or lines[skipped].lstrip().startswith("#")):
        skipped += 1
    if skipped == len(lines):
        raise InputError(Fault(file, 1, 1, "there is no header line", allowed="a header line and rows"))
    if skipped:
        remarks.append(
            Remark("format", "", f"{skipped} lines before the header", "they were skipped", "note", 1, skipped)
        )
    first, body = lines[skipped], [line for line in lines[skipped + 1 : -1] if line.strip()][:200]
    delimiter = delimiter or _delimiter(first, body)
    names = tuple(header) or tuple(name.strip() for name in next(csv.reader([first], delimiter=delimiter)))
    if not header:
        _check_header(names, first, delimiter, file, skipped + 1)
    decimal = _decimal(body, delimiter)
    if delimiter != ",":
        remarks.append(
            Remark(
                "format",
                "",
                f"the columns are separated by {_NAMES.get(delimiter, delimiter)}, not commas",
                "read as such",
                "note",
            )
        )
    if decimal == ",":
        remarks.append(Remark("format", "", "numbers are written with a decimal comma", "read as such", "note"))
    if "" in names:
        names = tuple(name or f"unnamed_{index}" for index, name in enumerate(names))
        remarks.append(
            Remark("format", "", "a column has no name", "it was called unnamed_<position>", "note", skipped + 1)
        )
    line = skipped + (0 if header else 1)
    return Dialect(names, delimiter, decimal, encoding, line, '"' in text, remarks)


def _delimiter(header: str, body: list[str]) -> str:
    counts = {mark: header.count(mark) for mark in (",", ";", "\t", "|")}
    best = max(counts, key=lambda mark: counts[mark])
    if counts[best]:
        return best
    return (
        " " if " " in header.strip() and all(len(line.split(" ")) == len(header.split(" ")) for line in body) else ","
    )


def _decimal(body: list[str], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [cell.strip() for row in csv.reader(body, delimiter=delimiter) for cell in row]
    with_comma = sum(bool(_COMMA_NUMBER.match(cell)) for cell in cells)
    with_point = sum(bool(re.match(r"^[+-]?\d*\.\d+", cell)) for cell in cells)
    return "," if with_comma > with_point else "."


def _check_header(names: tuple[str, ...], header: str, delimiter: str, file: str, line: int) -> None:
    if names and all(is_number(name) for name in names):
        raise InputError(
            Fault(
                file,
                line,
                1,
                "the first line holds numbers, not column names",
                got=header[:80],
                allowed="a header line such as time_s,power_robot_w,speed_m_s",
            )
        )
    faults = []
    for index, name in enumerate(names):
        if name and name in names[:index]:
            column = field_position(header, delimiter, index)
            faults.append(Fault(file, line, column, f"the column '{name}' stands twice in the header", path=name))
    if faults:
        raise InputError(faults)


def is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def line_finder(path: Path, dialect: Dialect) -> Callable[[int], int]:
    """Function from row number (0-based, -1 the header) to line number (1-based); empty lines hold no row."""

    blank: list[int] = []
    scanned = False

    def line_of(row: int) -> int:
        nonlocal scanned
        if row < 0:
            return dialect.header_line
        if not scanned:  # once, and only where a line is asked for
            scanned = True
            with open(path, encoding=dialect.encoding, errors="replace") as handle:
                blank.extend(n for n, line in enumerate(handle, 1) if n > dialect.header_line and not line.strip())
        line = dialect.header_line + 1 + row
        for empty in blank:
            if empty > line:
                break
            line += 1
        return line

    return line_of


def count_rows(path: Path, dialect: Dialect) -> int:
    """Lines after the header that are not empty."""
    with open(path, encoding=dialect.encoding, errors="replace") as handle:
        return sum(1 for number, line in enumerate(handle, 1) if number > dialect.header_line and line.strip())


def has_cut_end(path: Path, dialect: Dialect) -> bool:
    """Whether the last line has another number of cells than the header: the logger was switched off while writing."""
    with open(path, "rb") as handle:
        handle.seek(0, 2)
        handle.seek(max(0, handle.tell() - _HEAD_BYTES))
        lines = handle.read().rstrip().splitlines()
    if dialect.encoding == "utf-16" or len(lines) < 3:
        return False
    try:
        cells = next(csv.reader([lines[-1].decode("utf-8")], delimiter=dialect.delimiter))
    except (UnicodeDecodeError, csv.Error):
        return False
    return len(cells) != len(dialect.names)


def field_position(line: str, delimiter: str, index: int) -> int:
    """1-based character position of a field in its line, quotes respected."""
    quoted, fields = False, 0
    for position, mark in enumerate(line):
        if fields == index:
            return position + 1
        if mark == '"':
            quoted = not quoted
        elif mark == delimiter and not quoted:
            fields += 1
    return len(line) + 1 if fields <= index else 1
