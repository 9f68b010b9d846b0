"""Text tables into columns, whole or in blocks, through Arrow's reader."""

from __future__ import annotations

import codecs
import csv
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.labels import Labels
from missionsim.logs.formats.dialect import (
    MISSING_WORDS,
    Dialect,
    count_rows,
    field_position,
    has_cut_end,
    has_utf8,
    is_number,
    line_finder,
    one_byte_encoding,
    sniff,
)
from missionsim.logs.raw import RawTable, Remark, from_arrow, measures, wanted_kind
from missionsim.logs.readers import Options, Reader
from missionsim.logs.times import is_stamp

_BLOCK_BYTES = 1 << 22


class TextColumn(Exception):
    """A column that began with numbers and goes on with text, after so many batches."""

    def __init__(self, name: str, given: int) -> None:
        super().__init__(name)
        self.name, self.given = name, given


def read_csv(path: Path, options: Options) -> RawTable:
    """Read a whole text table.

    `options`: `typed`, `header`, `delimiter`, `wants`, and `most`: rows that suffice. Raises InputError: with line and
    column of every cell that cannot be read (the first 20, and the number of the others).
    """
    import pyarrow as pa

    def whole(file: _File) -> RawTable:
        held, rows, words = [], 0, frozenset[str]()
        while True:
            try:
                for batch in file.batches(options.wants, words):
                    held.append(batch)
                    rows += batch.num_rows
                    if options.most is not None and rows >= options.most:
                        break
                else:
                    file.check(rows)
                break
            except TextColumn as text:
                held, rows, words = [], 0, words | {text.name}
        raw = file.raw(pa.Table.from_batches(held, file.schema))
        raw.remarks[:0] = file.dialect.remarks
        raw.headless, raw.names = file.dialect.headless, file.dialect.names
        if file.cut and (options.most is None or rows < options.most):
            raw.remarks.append(_cut_end(raw, raw.rows))
        elif not file.ended:
            action = "read as it is; if the file was cut there, its last number is wrong"
            raw.remarks.append(Remark("format", "", "the last line has no end of line", action, "note"))
        return raw

    return _in_its_encoding(path, options, whole)


def iter_csv(
    path: Path, rows: int, columns: Sequence[str] | None = None, options: Options | None = None
) -> Iterator[RawTable]:
    """Read a text table in blocks of at least `rows` rows (the last may be shorter), in bounded memory. With `columns`
    the batteries' are read as well; with `options` what they say."""
    import pyarrow as pa

    options = options or Options(typed=True, wants=lambda name: columns is None or name in columns or measures(name))
    file = _in_its_encoding(path, options, _opened)
    words, done = frozenset[str](), 0

    def table() -> RawTable:
        raw = file.raw(pa.Table.from_batches(held), first)
        raw.remarks[:0] = file.dialect.remarks if not first else []
        raw.names = file.dialect.names
        return raw

    while True:
        first, held, count = 0, [], 0
        try:
            for batch in file.batches(options.wants, words):
                held.append(batch)
                count += batch.num_rows
                if count >= rows:
                    raw = table()
                    first, held, count = first + count, [], 0
                    if first > done:
                        done = first
                        yield raw
            file.check(first + count)
            break
        except TextColumn as text:  # begin again with it as text, without what was given already
            words |= {text.name}
        except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
            raise InputError(explain(path, str(path), file.dialect, options.typed, str(error))) from None
    if count:
        raw = table()
        if file.cut:
            raw.remarks.append(_cut_end(raw, count))
        yield raw


Result = TypeVar("Result")


def _in_its_encoding(path: Path, options: Options, use: Callable[[_File], Result]) -> Result:
    """Read as UTF-8; where a later byte is none, and no letter beyond ASCII was, as Latin-1."""
    import pyarrow as pa

    def attempt(dialect: Dialect) -> Result | Exception:
        try:
            return use(_File(path, dialect, options.typed))
        except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
            return error

    dialect = sniff(path, str(path), options.header, options.delimiter, options.typed)
    found = attempt(dialect)
    if isinstance(found, Exception) and dialect.encoding == "utf-8" and text_faults(path, str(path)):
        data = path.read_bytes()
        if not has_utf8(data):
            told: list[Remark] = []
            encoding = one_byte_encoding(data, told)
            dialect = sniff(path, str(path), options.header, options.delimiter, options.typed, encoding)
            dialect.remarks[:0] = told
            found = attempt(dialect)
    if isinstance(found, Exception):
        raise InputError(explain(path, str(path), dialect, options.typed, str(found))) from None
    return found


def _opened(file: _File) -> _File:
    file.block_bytes = _BLOCK_BYTES // 4  # Arrow reads some thirty blocks ahead
    next(file.batches(None), None)
    return file


class _File:
    """One text table, opened with Arrow's streaming reader."""

    def __init__(self, path: Path, dialect: Dialect, typed: bool) -> None:
        self.path, self.dialect, self.typed = path, dialect, typed
        self.cut = has_cut_end(path, dialect)
        with open(path, "rb") as handle:
            handle.seek(-1, 2)
            self.ended = handle.read(1) in b"\r\n\0"  # UTF-16 ends in a zero byte
        if self.cut and dialect.encoding == "utf-8" and text_faults(path, str(path)):
            raise UnicodeError("bad text")  # Arrow cannot tell bad text from a ragged line
        self.skipped: list[int] = []
        self.block_bytes = _BLOCK_BYTES
        self.lines = line_finder(path, dialect)
        self.schema: Any = None

    def batches(self, wants: Callable[[str], bool] | None, words: frozenset[str] = frozenset()) -> Iterator[Any]:
        """Record batches of the file, numbers as float64; `words`: columns that are read as text."""
        import pyarrow as pa
        import pyarrow.csv as arrow_csv

        chosen = list(filter(wants, self.dialect.names))
        read, parse = self._options()

        def convert(types: dict[str, Any]) -> Any:
            return arrow_csv.ConvertOptions(
                include_columns=chosen,
                column_types={name: kind for name, kind in types.items() if name in chosen},
                null_values=list(MISSING_WORDS),
                strings_can_be_null=True,
                decimal_point=self.dialect.decimal,
                true_values=["true", "True", "TRUE"],
                false_values=["false", "False", "FALSE"],
            )

        kinds = {"number": pa.float64(), "text": pa.dictionary(pa.int32(), pa.string())}
        wanted = {name: wanted_kind(name) for name in self.dialect.names} if self.typed else {}
        fixed = {name: kinds[kind] for name, kind in wanted.items() if kind in kinds and not self._is_stamp(name)}
        fixed |= dict.fromkeys(words, pa.string())
        probe = arrow_csv.open_csv(str(self.path), read, parse, convert(fixed)).schema
        # the streaming reader fixes types from its first block: whole numbers there may be fractions later
        loose = {f.name: pa.float64() for f in probe if pa.types.is_integer(f.type) or pa.types.is_null(f.type)}
        self.skipped.clear()
        given = 0
        try:
            reader = arrow_csv.open_csv(str(self.path), read, parse, convert({**loose, **fixed}))
            self.schema = reader.schema
            for batch in reader:
                given += 1
                yield batch
        except pa.ArrowInvalid as error:
            found = re.search(r"In CSV column #(\d+)", str(error))
            name = chosen[int(found[1])] if found and int(found[1]) < len(chosen) else None
            if name is None or name in fixed:
                raise
            raise TextColumn(name, given) from None

    def raw(self, table: Any, first_row: int = 0) -> RawTable:
        """The table's columns. A label that begins with the word none (no payload) is not missing where it says so."""
        raw = from_arrow(table, str(self.path), self.lines, first_row)
        for name, word in zip(self.dialect.names, self.dialect.first, strict=False):
            if word == "none" and wanted_kind(name) != "number" and (data := raw.columns.get(name)) is not None:
                if isinstance(data, Labels):
                    codes = np.where(data.codes < 0, len(data.names), data.codes)
                    raw.columns[name] = Labels(codes, (*data.names, word))
                elif np.isnan(data).all():
                    raw.columns[name] = Labels(np.zeros(len(data), dtype=np.int64), (word,))
        return raw

    def _is_stamp(self, name: str) -> bool:
        """Whether a column of times begins with no number: a date or a time of day."""
        at = self.dialect.names.index(name)
        first = self.dialect.first
        return name == "time_s" and at < len(first) and not is_number(first[at]) and is_stamp(first[at])

    def check(self, rows: int) -> None:
        """ArrowInvalid where rows of the file are not in the table: an open quotation mark swallows what follows."""
        import pyarrow as pa

        counted = self.dialect.quoted and rows + len(self.skipped) != count_rows(self.path, self.dialect)
        if len(self.skipped) > 1 or counted:
            raise pa.ArrowInvalid(
                "rows are lost in it: a quotation mark that does not end, or rows of the wrong length"
            )

    def _options(self) -> tuple[Any, Any]:
        """Options of Arrow's reader; where the end is cut, rows of the wrong length are left out and noted."""
        import pyarrow.csv as arrow_csv

        def on_ragged(row: Any) -> str:
            self.skipped.append(row.actual_columns)
            return "skip"

        utf8 = self.dialect.encoding in ("utf-8", "utf-8-sig")
        return arrow_csv.ReadOptions(
            column_names=list(self.dialect.names),
            skip_rows=self.dialect.header_line,
            encoding="utf8" if utf8 else self.dialect.encoding,
            block_size=self.block_bytes,
        ), arrow_csv.ParseOptions(
            delimiter=self.dialect.delimiter,
            quote_char='"' if self.dialect.quoted else False,
            invalid_row_handler=on_ragged if self.cut else None,
        )


def _cut_end(raw: RawTable, row: int) -> Remark:
    return Remark("format", "", "the last line is cut short", "it was left out", "warning", raw.line(row), 1)


READERS = (
    Reader("csv", "text table", (".csv", ".tsv"), table=read_csv, blocks=iter_csv, loose=(".txt", ".dat", ".log")),
)


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
        told = f"{len(cells)} values where the header names {len(dialect.names)} columns"
        yield Fault(file, number, 1, told, got=line[:60], hint=hint)
        return
    if not typed:
        return
    for index, (name, cell) in enumerate(zip(dialect.names, cells, strict=True)):
        word = cell.strip()
        if wanted_kind(name) != "number" or word in MISSING_WORDS or (name == "time_s" and is_stamp(word)):
            continue
        if not is_number(word.replace(",", ".") if dialect.decimal == "," else word) or "_" in word:
            at, allowed = field_position(line, dialect.delimiter, index), "a number, or nothing for a missing value"
            yield Fault(file, number, at, "this is not a number", name, word[:40] or "''", allowed)


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
