"""How a text table is written: encoding, delimiter, decimal mark, header; and the line of each row."""

from __future__ import annotations

import codecs
import collections
import csv
import functools
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path

from missionsim.errors import Fault, InputError
from missionsim.glossary import column_of
from missionsim.logs.raw import Remark, number_of
from missionsim.logs.times import is_stamp

MISSING_WORDS = (
    "", "#N/A", "#NA", "-NaN", "-nan", "N/A", "NA", "NULL", "NaN", "n/a", "nan", "null", "None", "none", "NAN",
)  # fmt: skip
UNITS = {
    "s", "ms", "us", "µs", "ns", "sec", "min", "h", "V", "mV", "A", "mA", "uA", "W", "kW", "mW", "Wh", "kWh", "J",
    "kJ", "m", "mm", "cm", "km", "m/s", "km/h", "kmh", "kph", "mph", "mm/s", "cm/s", "rad", "rad/s", "deg", "°",
    "deg/s", "°/s", "rpm", "1/min", "°C", "C", "degC", "K", "%", "Hz", "kg", "g", "N", "Nm", "m/s²", "m/s^2", "-",
    "1",
}  # fmt: skip


def is_number(word: str) -> bool:
    """Whether a text is a number, see `number_of`; ``nan`` is none."""
    return (number := number_of(word)) == number


def cells_of(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _shape(cells: Sequence[str]) -> str:
    """One letter a cell: ``1`` a number or a time, ``0`` nothing, ``a`` a text."""
    return "".join(
        "0" if cell in MISSING_WORDS else "1" if is_number(cell.replace(",", ".")) or is_stamp(cell) else "a"
        for cell in cells
    )


def first_row(lines: list[str], start: int, delimiter: str | None) -> tuple[int, int, str] | None:
    """Indices of the names and of the first row under them, and the delimiter, where the first line is no header.

    Rows are known by where numbers and times stand in them, which most lines have in common; the line above them holds
    the names, or the units under the names. None where the first line is as good a header, or nothing is sure.
    """
    end = min(len(lines), start + 300)
    for mark in (delimiter,) if delimiter else (";", "\t", ",", "|"):
        shapes = {i: _shape(cells_of(lines[i], mark)) for i in range(start, end) if lines[i].strip()}
        if len(shapes) < 4:
            continue
        width = collections.Counter(map(len, shapes.values())).most_common(1)[0][0]
        usual = collections.Counter(shape for shape in shapes.values() if len(shape) == width).most_common(1)[0][0]
        value = [k for k, sort in enumerate(usual) if sort == "1"]
        rows = [i for i, s in shapes.items() if len(s) == width and {"1"} <= {s[k] for k in value} <= {"0", "1"}]
        order = list(shapes)
        while len(rows) > 1 and "1" not in shapes[after := order[order.index(rows[0]) + 1]] and after not in rows:
            rows.pop(0)  # numbers of devices between the names of several lines (Motive)
        if width < 2 or not value or len(rows) < 0.5 * len(shapes) or rows[0] == start:
            continue
        above = [i for i in shapes if i < rows[0] and len(shapes[i]) == width and "1" not in shapes[i]]
        if not above or above[-1] != max(i for i in shapes if i < rows[0]):
            continue
        # the last line above the rows may hold units: in brackets, or mostly ones that loggers write
        told = list(filter(None, cells_of(lines[above[-1]], mark)))
        units = all(text[0] in "[(" and text[-1] in "])" for text in told)
        units |= sum(text in UNITS for text in told) >= 0.5 * len(told)
        names = above[-2] if len(above) > 1 and told and units else above[-1]
        return None if (names, rows[0]) == (start, start + 1) else (names, rows[0], mark)
    return None


_HEAD_BYTES = 65536
_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
_ENCODINGS = {"utf-16": "UTF-16", "utf-16-le": "UTF-16 (without its mark)", "utf-16-be": "UTF-16 (without its mark)"}
_COMMA_NUMBER = re.compile(r"^[+-]?\d+(?:[.'’\s]\d{3})*,\d+$")


@dataclass
class Dialect:
    """How a text table is written."""

    names: tuple[str, ...]
    """Column names, each once: one that stands twice in the header is numbered, ``name #1`` and ``name #2``."""
    delimiter: str
    decimal: str
    encoding: str
    header_line: int
    """1-based line of the header; 0 for a file without one."""
    _: KW_ONLY
    quoted: bool = False
    """Whether the start of the file has quotation marks; where it has none, a later one is part of its cell."""
    remarks: list[Remark] = field(default_factory=list)
    """What is unusual."""
    first: tuple[str, ...] = ()
    """Cells of the first row."""
    headless: bool = False
    """Whether the names were made up, because the first line holds numbers."""


def sniff(
    path: Path,
    header: Sequence[str] = (),
    delimiter: str | None = None,
    typed: bool = True,
    encoding: str | None = None,
) -> Dialect:
    """Read the start of a text table and find out how it is written.

    `header`: names of the columns of a file that has no header line; `delimiter`, `encoding`: where they are known;
    `typed`: whether the file has to be a log: a header, and names of the glossary once. Raises InputError: empty,
    binary, without a header, or with a header that names a column of the glossary twice.
    """
    file = str(path)
    with open(path, "rb") as handle:
        head = handle.read(_HEAD_BYTES)
    if not head.strip():
        raise InputError(Fault(file, 1, 1, "the file is empty", allowed="a header line and rows"))
    remarks: list[Remark] = []
    encoding = encoding or _encoding(head, file, remarks)
    if encoding.startswith("utf-16"):
        head = head[: len(head) // 2 * 2]
    text = head.decode(encoding, errors="replace").removeprefix("\ufeff")
    lines = text.splitlines()
    skipped = 0
    while skipped < len(lines) and (not lines[skipped].strip() or lines[skipped].lstrip().startswith("#")):
        skipped += 1
    if skipped == len(lines):
        raise InputError(Fault(file, 1, 1, "there is no header line", allowed="a header line and rows"))

    def note(message: str, action: str = "read as such", line: int = 0) -> None:
        remarks.append(Remark("format", "", message, action, "note", line))

    whole = lines[: -1 if len(head) == _HEAD_BYTES and len(lines) > 1 else None]
    begin = None if typed or header else first_row(whole, skipped, delimiter)
    skipped, rows, delimiter = begin or (skipped, skipped + 1, delimiter)
    if skipped:
        note(f"{skipped} lines before the header", "they were skipped", 1)
    first = lines[skipped]
    body = [line for line in whole[rows:] if line.strip()][:200]
    body = [line for line in body if not line.lstrip().startswith("#")] or body
    delimiter = delimiter or _delimiter(first, body)
    cells = tuple(cells_of(first, delimiter))
    names = tuple(header) or cells
    between = [i for i in range(skipped + 1, rows) if lines[i].strip()]  # of which there may be empty ones about it
    if between and len(units := cells_of(lines[between[-1]], delimiter)) == len(names):
        names = tuple(f"{n} [{unit.strip('[]() ')}]" if unit else n for n, unit in zip(names, units, strict=True))
        note("a line of units stands under the names", "each unit was written behind its name", between[-1] + 1)
    headless = not header and all(is_number(name) or not name for name in names)
    if not header and len(body) > 3 and (shape := _shape(cells)).count("1") > 1:  # numbers where the rows have theirs
        headless = headless or sum(_shape(cells_of(line, delimiter)) == shape for line in body) > 0.9 * len(body)
    if headless and skipped and not typed:  # the names may stand in the comment above the rows (``# t[s] v[m/s]``)
        told = lines[skipped - 1].strip().lstrip("#").strip()
        for words in (cells_of(told, delimiter), told.split()):
            if headless and len(words) == len(names) and all(words) and not any(map(is_number, words)):
                names, headless, rows = tuple(words), False, skipped
    if headless and typed:
        allowed = "a header line such as time_s,power_robot_w,speed_m_s"
        message = "the first line holds numbers, not column names"
        raise InputError(Fault(file, skipped + 1, 1, message, got=first[:80], allowed=allowed))
    if headless:
        names = tuple(f"col_{index}" for index in range(1, len(names) + 1))
        note("the first line holds numbers, not column names", "the columns were called col_1, col_2, …", skipped + 1)
    names = _once(names, first, delimiter, file, skipped + 1, typed, remarks)
    decimal = _decimal(body, delimiter)
    if delimiter != ",":
        note(f"the columns are separated by {_NAMES.get(delimiter, delimiter)}, not commas")
    if decimal == ",":
        note("numbers are written with a decimal comma")
    bare = bool(header) or headless or rows == skipped
    row = first if bare else (body[0] if body else "")
    line = skipped if bare else rows
    found = Dialect(names, delimiter, decimal, encoding, line, quoted='"' in text, remarks=remarks, headless=headless)
    found.first = tuple(cells_of(row, delimiter))
    return found


_PACKED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"7z\xbc": "7z"}
"""First bytes of archives."""
_NOT_READ = (
    (rb"PK\x03\x04.{26}(\[Content_Types\]|xl/|_rels/|docProps/|mimetype)|\xd0\xcf\x11\xe0", "a spreadsheet",
     "its sheet: save the sheet as CSV"),
    (rb"MATLAB 7\.3", "a MATLAB file of version 7.3", "one of version 7 (save(…, '-v7')), or writetable(…, 'run.csv')"),
    (rb"\x89HDF", "an HDF5 file", "its table as CSV or Parquet: pandas.read_hdf(FILE).to_parquet('run.parquet')"),
    (rb"\x80[\x02-\x05][\x95c}\](.]", "a Python pickle, which would run code", "what is in it as CSV or Parquet"),
    (rb"\s*\(\d+\.\d+\)\s+\w+\s+[0-9A-Fa-f]{3,8}#", "a candump of a CAN bus",
     "decode it with the DBC file of the robot, such as with cantools, into a table"),
)  # fmt: skip
"""What files that are no tables begin like, what they are called, and what is read in their place."""


def _encoding(head: bytes, file: str, remarks: list[Remark]) -> str:
    """Encoding by the first bytes; what is no UTF-8 there is Latin-1 (or Windows-1252), as many loggers write it."""
    encoding = "utf-8"
    for begin, name, allowed in _NOT_READ:
        if re.match(begin, head, re.DOTALL):
            raise InputError(Fault(file, 1, 1, f"this is {name}", allowed=allowed))
    if packed := next((name for begin, name in _PACKED.items() if head.startswith(begin)), ""):
        raise InputError(Fault(file, 1, 1, f"this is packed ({packed})", allowed="the table that is in it, unpacked"))
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif head.startswith(codecs.BOM_UTF8):
        remarks.append(Remark("format", "", "the text starts with a byte order mark", "it was skipped", "note"))
        return "utf-8-sig"
    elif b"\0" in head:
        start = head[:200]
        odd, even = start[1::2].count(0), start[::2].count(0)
        if max(odd, even) < 0.4 * len(start) or min(odd, even):
            raise InputError(Fault(file, 1, 1, "this is not a text file", allowed="CSV, or Parquet"))
        encoding = "utf-16-le" if odd > even else "utf-16-be"
    else:
        try:
            codecs.getincrementaldecoder("utf-8")().decode(head, final=len(head) < _HEAD_BYTES)
        except UnicodeDecodeError:
            if has_utf8(head):
                return "utf-8"  # a damaged file: the place of the bad byte is told when it is read
            return one_byte_encoding(head, remarks)
    if encoding in _ENCODINGS:
        remarks.append(Remark("format", "", f"the text is {_ENCODINGS[encoding]}", "read as such", "note"))
    return encoding


def one_byte_encoding(data: bytes, remarks: list[Remark]) -> str:
    """Latin-1, or Windows-1252 where its printable letters between 0x80 and 0x9f occur; told."""
    windows = any(0x80 <= byte <= 0x9F for byte in data) and not any(byte in b"\x81\x8d\x8f\x90\x9d" for byte in data)
    encoding, name = ("cp1252", "Windows-1252") if windows else ("latin-1", "Latin-1")
    remarks.append(Remark("format", "", f"the text is {name}, not UTF-8", "read as such", "note"))
    return encoding


def has_utf8(data: bytes) -> bool:
    """Whether letters beyond ASCII are written as UTF-8 somewhere."""
    return re.search(rb"[\xc3-\xf4][\x80-\xbf]", data) is not None


def _once(
    names: tuple[str, ...], line: str, delimiter: str, file: str, number: int, typed: bool, remarks: list[Remark]
) -> tuple[str, ...]:
    """Each name once: names that stand twice are numbered, columns without a name called by their position."""
    twice = {name for name, count in collections.Counter(names).items() if name and count > 1}
    told = "the column '{}' stands twice in the header"
    if faults := [
        Fault(file, number, field_position(line, delimiter, index), told.format(name), path=name)
        for index, name in enumerate(names)
        if typed and name in names[:index] and name and column_of(name) is not None
    ]:
        raise InputError(faults)
    if twice:
        shown = ", ".join(sorted(f"'{name}'" for name in twice))
        message = f"{shown} {'stands' if len(twice) == 1 else 'stand'} more than once in the header"
        remarks.append(Remark("format", "", message, "numbered: 'name #1', 'name #2'", "note", number))
    if "" in names:
        message, action = "a column has no name", "it was called unnamed_<position>"
        remarks.append(Remark("format", "", message, action, "note", number))
    return tuple(
        f"unnamed_{index}" if not name else f"{name} #{names[: index + 1].count(name)}" if name in twice else name
        for index, name in enumerate(names)
    )


def _delimiter(header: str, body: list[str]) -> str:
    counts = {mark: header.count(mark) for mark in (",", ";", "\t", "|")}
    best = max(counts, key=lambda mark: counts[mark])
    if counts[";"] and best == "," and all(line.count(";") == counts[";"] for line in body):
        return ";"  # decimal commas, or commas within names
    if counts[best]:
        return best
    blanks = header.count(" ")
    return " " if " " in header.strip() and all(line.count(" ") == blanks for line in body) else ","


def _decimal(body: list[str], delimiter: str) -> str:
    cells = [cell.strip() for row in csv.reader(body, delimiter=delimiter) for cell in row]
    if delimiter == ",":  # in quotes; ``"38,000"`` has a mark of thousands
        cells = [cell for cell in cells if not re.fullmatch(r"[+-]?[1-9]\d{0,2}(,\d{3})+", cell)]
    with_comma = sum(bool(_COMMA_NUMBER.match(cell)) for cell in cells)
    with_point = sum(bool(re.match(r"^[+-]?\d*\.\d+$", cell)) for cell in cells)
    return "," if with_comma > with_point else "."


def line_finder(path: Path, dialect: Dialect) -> Callable[[int], int]:
    """Function from row number (0-based, -1 the header) to line number (1-based); empty lines hold no row."""
    # once, and only where a line is asked for
    blank = functools.cache(lambda: [number for number, empty in _lines(path, dialect) if empty])

    def line_of(row: int) -> int:
        line = dialect.header_line + 1 + row
        for empty in blank() if row >= 0 else ():
            if empty > line:
                break
            line += 1
        return line

    return line_of


def _lines(path: Path, dialect: Dialect) -> Iterator[tuple[int, bool]]:
    """Number of each line after the header, and whether it is empty, or a comment."""
    with open(path, encoding=dialect.encoding, errors="replace") as handle:
        for number, line in itertools.islice(enumerate(handle, 1), dialect.header_line, None):
            yield number, not line.strip() or is_comment(line, dialect)


def is_comment(line: str, dialect: Dialect) -> bool:
    """Whether a line among the rows begins with # and is none of them."""
    return line.lstrip().startswith("#") and len(cells_of(line, dialect.delimiter)) != len(dialect.names)


def count_rows(path: Path, dialect: Dialect) -> int:
    """Lines after the header that are rows."""
    return sum(not empty for _, empty in _lines(path, dialect))


def has_cut_end(path: Path, dialect: Dialect) -> bool:
    """Whether the last line has another number of cells than the header: the logger was switched off while writing."""
    with open(path, "rb") as handle:
        handle.seek(0, 2)
        handle.seek(max(0, handle.tell() - _HEAD_BYTES))
        # ending tabs are cells without a value; the last line may be a comment
        lines = [line for line in handle.read().splitlines() if line.strip() and not line.startswith(b"#")]
    if dialect.encoding.startswith("utf-16") or len(lines) < 3:
        return False
    try:
        cells = next(csv.reader([lines[-1].decode(dialect.encoding)], delimiter=dialect.delimiter))
    except (UnicodeDecodeError, csv.Error):
        return False
    return len(cells) != len(dialect.names)


def field_position(line: str, delimiter: str, index: int) -> int:
    """1-based character position of a field in its line, quotes respected."""
    marks = re.finditer(rf'"[^"]*"|{re.escape(delimiter)}', line)
    starts = [0, *(mark.end() for mark in marks if mark[0] == delimiter), *[len(line)] * index]
    return starts[index] + 1
