"""CSV into columns: finds the delimiter, the decimal mark and the header, and says where a cell cannot be read."""

from __future__ import annotations

import codecs
import csv
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from missionsim.errors import Fault, InputError
from missionsim.logs.raw import RawTable, from_arrow, wanted_kind
from missionsim.logs.remarks import Remark

_HEAD_BYTES = 65536
_MOST_FAULTS = 20
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
    remarks : list of Remark
        What is unusual.
    """

    names: tuple[str, ...]
    delimiter: str
    decimal: str
    encoding: str
    header_line: int
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
    return Dialect(names, delimiter, decimal, encoding, skipped + (0 if header else 1), remarks)


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
    if names and all(_is_number(name) for name in names):
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
            column = _position(header, delimiter, index)
            faults.append(Fault(file, line, column, f"the column '{name}' stands twice in the header", path=name))
    if faults:
        raise InputError(faults)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def read_csv(
    path: Path, file: str, *, typed: bool = True, header: Sequence[str] = (), delimiter: str | None = None
) -> RawTable:
    """Read a whole CSV file.

    Parameters
    ----------
    path, file
        The file, and its name in messages.
    typed : bool
        Whether columns with names of the glossary have to hold what the glossary says.
    header, delimiter
        See `sniff`.

    Raises
    ------
    missionsim.errors.InputError
        With line and column of every cell that cannot be read (the first 20, and the number of the others).
    """
    import pyarrow as pa
    import pyarrow.csv as arrow_csv

    dialect = sniff(path, file, header, delimiter)
    ragged: list[str] = []
    options = _options(dialect, typed, ragged)
    try:
        table = arrow_csv.read_csv(str(path), **options)
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
        raise InputError(_explain(path, file, dialect, typed, str(error))) from None
    raw = from_arrow(table, file, line_finder(path, dialect))
    raw.remarks[:0] = dialect.remarks
    _ragged(path, file, dialect, typed, ragged, raw)
    return raw


def iter_csv(path: Path, file: str, rows: int) -> Iterator[RawTable]:
    """Read a CSV file in blocks of at least `rows` rows (the last may be shorter), in bounded memory."""
    import pyarrow as pa
    import pyarrow.csv as arrow_csv

    dialect = sniff(path, file)
    ragged: list[str] = []
    options = _options(dialect, True, ragged)
    lines = line_finder(path, dialect)
    try:
        probe = arrow_csv.open_csv(str(path), **options).schema
        # the streaming reader fixes types from its first block: whole numbers there may be fractions later
        types = {f.name: pa.float64() for f in probe if pa.types.is_integer(f.type) or pa.types.is_null(f.type)}
        options["convert_options"].column_types = {**types, **_types(dialect, True)}
        first, held, count = 0, [], 0
        for batch in arrow_csv.open_csv(str(path), **options):
            held.append(batch)
            count += batch.num_rows
            if count >= rows:
                yield from_arrow(pa.Table.from_batches(held), file, lines, first)
                first, held, count = first + count, [], 0
        if count:
            yield from_arrow(pa.Table.from_batches(held), file, lines, first)
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
        raise InputError(_explain(path, file, dialect, True, str(error))) from None
    if ragged:
        raise InputError(_explain(path, file, dialect, True, "a row has the wrong number of values"))


def _types(dialect: Dialect, typed: bool) -> dict[str, Any]:
    import pyarrow as pa

    kinds = {"number": pa.float64(), "text": pa.dictionary(pa.int32(), pa.string())}
    return {name: kinds[wanted_kind(name)] for name in dialect.names if wanted_kind(name) in kinds} if typed else {}


def _options(dialect: Dialect, typed: bool, ragged: list[str]) -> dict[str, Any]:
    import pyarrow.csv as arrow_csv

    def on_ragged(row: Any) -> str:
        ragged.append(row.text)
        return "skip"

    encoding = "utf-16" if dialect.encoding == "utf-16" else "utf8"
    return {
        "read_options": arrow_csv.ReadOptions(
            column_names=list(dialect.names), skip_rows=dialect.header_line, encoding=encoding, block_size=1 << 22
        ),
        "parse_options": arrow_csv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=on_ragged),
        "convert_options": arrow_csv.ConvertOptions(
            column_types=_types(dialect, typed),
            null_values=list(MISSING_WORDS),
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
            true_values=["true", "True", "TRUE"],
            false_values=["false", "False", "FALSE"],
        ),
    }


def _ragged(path: Path, file: str, dialect: Dialect, typed: bool, ragged: list[str], raw: RawTable) -> None:
    """A last line cut short (the logger was switched off) is left out and told; any other such line is a fault."""
    if not ragged:
        return
    with open(path, encoding=dialect.encoding) as handle:
        last_number, last = 0, ""
        for number, line in enumerate(handle, start=1):
            if line.strip():
                last_number, last = number, line
    if len(ragged) > 1 or last.strip("\r\n") != ragged[0].strip("\r\n"):
        raise InputError(_explain(path, file, dialect, typed, "a row has the wrong number of values"))
    raw.remarks.append(Remark("format", "", "the last line is cut short", "it was left out", "warning", last_number, 1))


def _explain(path: Path, file: str, dialect: Dialect, typed: bool, reason: str) -> list[Fault]:
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
        faults.append(Fault(file, 0, 0, f"and {more} more such cells"))
    return faults or [Fault(file, 0, 0, f"the table cannot be read: {reason.splitlines()[0][:200]}")]


def _line_faults(line: str, number: int, file: str, dialect: Dialect, typed: bool) -> Iterator[Fault]:
    try:
        cells = next(csv.reader([line], delimiter=dialect.delimiter, strict=True))
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
        if wanted_kind(name) != "number" or word in MISSING_WORDS:
            continue
        if not _is_number(word.replace(",", ".") if dialect.decimal == "," else word) or "_" in word:
            yield Fault(
                file,
                number,
                _position(line, dialect.delimiter, index),
                "this is not a number",
                name,
                word[:40] or "''",
                "a number, or nothing for a missing value",
            )


def _position(line: str, delimiter: str, index: int) -> int:
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
