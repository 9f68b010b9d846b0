"""Tables into columns, whole or in blocks, through Arrow's readers: delimited text, and Parquet."""

from __future__ import annotations

import codecs
import contextlib
import csv
import itertools
import math
import mmap
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import unreadable
from missionsim.labels import Labels
from missionsim.logs.codes import Tally
from missionsim.logs.formats import dialect as style
from missionsim.logs.formats.arrays import elements, flattened, with_elements
from missionsim.logs.formats.second_header import of_the_whole, refuse_second_header
from missionsim.logs.raw import RawTable, Remark, from_arrow, leave_out_codes, measures, tallies_of, wanted_kind
from missionsim.logs.readers import Options, Reader
from missionsim.logs.times import is_stamp

_BLOCK_BYTES = 1 << 22
_MOST_FAULTS = 20


class TextColumn(Exception):
    """A column that began with numbers and goes on with text."""


def read_csv(path: Path, options: Options) -> RawTable:
    """Read a whole text table.

    `options`: `typed`, `header`, `delimiter`, `wants`, and `most`: rows that suffice. Raises InputError: with line and
    column of every cell that cannot be read (the first 20, and the number of the others).
    """
    most = options.most or math.inf

    def whole(file: _File) -> RawTable:
        raw = next(file.tables(options.wants, most))
        raw = raw if options.mixed else leave_out_codes(raw)
        if not file.ended and not (file.cut and raw.rows < most):
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

    def opened(file: _File) -> _File:
        file.block_bytes = _BLOCK_BYTES // 4  # Arrow reads some thirty blocks ahead
        next(file.batches(None), None)
        return file

    options = options or Options(typed=True, wants=lambda name: columns is None or name in columns or measures(name))
    file = _in_its_encoding(path, options, opened)
    try:
        yield from _judged_whole(lambda: _in_its_encoding(path, options, opened).tables(options.wants, rows))
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
        raise InputError(_explain(path, file.dialect, options.typed, str(error))) from None


def _judged_whole(blocks: Callable[[], Iterator[RawTable]]) -> Iterator[RawTable]:
    """Blocks without codes for no value, which are judged for whole columns: from the first block on that may have
    one, the others are read before it is given."""
    tallies: dict[str, Tally] = {}
    met = False
    for count, raw in enumerate(blocks(), 1):
        if not met:
            tallies_of(raw.columns, tallies)
        if not met and (met := any(tally.in_doubt() for tally in tallies.values())):
            for later in itertools.islice(blocks(), count, None):
                tallies_of(later.columns, tallies)
        yield leave_out_codes(raw, tallies) if met else raw


Result = TypeVar("Result")


def _in_its_encoding(path: Path, options: Options, use: Callable[[_File], Result]) -> Result:
    """Read as UTF-8; where a later byte is none, and no letter beyond ASCII was, as Latin-1."""
    import pyarrow as pa

    encoding, told = None, list[Remark]()
    while True:
        dialect = style.sniff(path, options.header, options.delimiter, options.typed, encoding)
        dialect.remarks[:0] = told
        try:
            return use(_File(path, dialect, options.typed))
        except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
            if encoding or dialect.encoding != "utf-8" or _is_utf8(path) or style.has_utf8(data := path.read_bytes()):
                raise InputError(_explain(path, dialect, options.typed, str(error))) from None
            encoding = style.one_byte_encoding(data, told)


class _File:
    """One text table, opened with Arrow's streaming reader."""

    def __init__(self, path: Path, dialect: style.Dialect, typed: bool) -> None:
        self.path, self.dialect, self.typed = path, dialect, typed
        self.cut = style.has_cut_end(path, dialect)
        with open(path, "rb") as handle:
            handle.seek(-1, 2)
            self.ended = handle.read(1) in b"\r\n\0"  # UTF-16 ends in a zero byte
            with mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as whole:
                self.commented = whole.find(b"\n#") >= 0
        if (self.cut or self.commented) and dialect.encoding == "utf-8" and not _is_utf8(path):
            raise UnicodeError("bad text")  # Arrow cannot tell bad text from a ragged line
        self.skipped: list[int] = []
        self.comments = 0
        self.block_bytes = _BLOCK_BYTES
        self.lines = style.line_finder(path, dialect)
        self.schema: Any = None

    def tables(self, wants: Callable[[str], bool] | None, rows: float) -> Iterator[RawTable]:
        """Tables of at least `rows` rows; the last may be shorter."""
        words, given = frozenset[str](), 0
        while True:
            first, held, count = 0, [], 0
            try:
                for batch in self.batches(wants, words):
                    held.append(batch)
                    count += batch.num_rows
                    if count >= rows:
                        raw = self._raw(held, first) if first + count > given else None
                        first, held, count = first + count, [], 0  # before it is given: of long files one block stays
                        if raw is not None:
                            given = first
                            yield raw
                self._check(first + count)
                break
            except TextColumn as text:  # begin again with it as text, without what was given already
                words |= {str(text)}
        if count or not given:
            raw = self._raw(held, first)
            if self.comments:
                told = f"lines that begin with # stand among the rows: {self.comments}"
                raw.remarks.append(Remark("format", "", told, "skipped, as comments are", "note"))
            if self.cut:
                told = "the last line is cut short"
                raw.remarks.append(Remark("format", "", told, "it was left out", "warning", raw.line(count), 1))
            yield raw

    def batches(self, wants: Callable[[str], bool] | None, words: frozenset[str] = frozenset()) -> Iterator[Any]:
        """Record batches of the file, numbers as float64; `words`: columns that are read as text."""
        import pyarrow as pa
        import pyarrow.csv as arrow_csv

        names, encoding = self.dialect.names, self.dialect.encoding
        chosen = [name for name in names if wants is None or wants(name) or any(map(wants, elements(name)))]
        read = arrow_csv.ReadOptions(
            column_names=list(names),
            skip_rows=self.dialect.header_line,
            encoding="utf8" if encoding in ("utf-8", "utf-8-sig") else encoding,
            block_size=self.block_bytes,
        )

        def on_ragged(row: Any) -> str:
            if comment := row.text.lstrip().startswith("#"):
                self.comments += 1
            elif self.cut:
                self.skipped.append(row.actual_columns)
            return "skip" if comment or self.cut else "error"

        parse = arrow_csv.ParseOptions(
            delimiter=self.dialect.delimiter,
            quote_char='"' if self.dialect.quoted else False,
            invalid_row_handler=on_ragged if self.cut or self.commented else None,
        )

        def opened(types: dict[str, Any]) -> Any:
            convert = arrow_csv.ConvertOptions(
                include_columns=chosen,
                column_types={name: kind for name, kind in types.items() if name in chosen},
                null_values=list(style.MISSING_WORDS),
                strings_can_be_null=True,
                decimal_point=self.dialect.decimal,
                true_values=["true", "True", "TRUE"],
                false_values=["false", "False", "FALSE"],
            )
            return arrow_csv.open_csv(pa.OSFile(str(self.path)), read, parse, convert)  # of a path, .gz is unpacked

        kinds = {"number": pa.float64(), "text": pa.dictionary(pa.int32(), pa.string())}
        wanted = {name: wanted_kind(name) for name in names} if self.typed else {}
        first = dict(zip(names, self.dialect.first, strict=False)).get("time_s", "0")
        if not style.is_number(first) and is_stamp(first):  # a date or a time of day
            wanted.pop("time_s", None)
        fixed = {name: kinds[kind] for name, kind in wanted.items() if kind in kinds}
        fixed |= dict.fromkeys(words, pa.string())
        probe = opened(fixed).schema
        # the streaming reader fixes types from its first block: whole numbers there may be fractions later
        loose = {f.name: pa.float64() for f in probe if pa.types.is_integer(f.type) or pa.types.is_null(f.type)}
        self.skipped.clear()
        self.comments = 0
        try:
            reader = opened({**loose, **fixed})
            self.schema = reader.schema
            yield from reader
        except pa.ArrowInvalid as error:
            found = re.search(r"In CSV column #(\d+)", str(error))
            name = chosen[int(found[1])] if found and int(found[1]) < len(chosen) else None
            if name is None or name in fixed:
                raise
            raise TextColumn(name) from None

    def _raw(self, batches: list[Any], first_row: int) -> RawTable:
        """Columns of batches. A label that begins with the word none (no payload) is not missing where it says so."""
        import pyarrow as pa

        dialect = self.dialect
        table = pa.Table.from_batches(batches, self.schema)
        raw = with_elements(from_arrow(table, str(self.path), self.lines, first_row, dialect.decimal))
        refuse_second_header(raw, dialect.names)
        raw.remarks[:0] = dialect.remarks if not first_row else []
        of_lists = [name for name in raw.columns if name not in dialect.names]
        raw.headless, raw.names = dialect.headless, (*dialect.names, *of_lists)
        for name, word in zip(dialect.names, dialect.first, strict=False):
            if word == "none" and wanted_kind(name) != "number" and (data := raw.columns.get(name)) is not None:
                if isinstance(data, Labels):
                    codes = np.where(data.codes < 0, len(data.names), data.codes)
                    raw.columns[name] = Labels(codes, (*data.names, word))
                elif np.isnan(data).all():
                    raw.columns[name] = Labels(np.zeros(len(data), dtype=np.int64), (word,))
        return raw

    def _check(self, rows: int) -> None:
        """ArrowInvalid where rows of the file are not in the table: an open quotation mark swallows what follows."""
        import pyarrow as pa

        counted = self.dialect.quoted and rows + len(self.skipped) != style.count_rows(self.path, self.dialect)
        if len(self.skipped) > 1 or counted:
            raise pa.ArrowInvalid(
                "rows are lost in it: a quotation mark that does not end, or rows of the wrong length"
            )


def _explain(path: Path, dialect: style.Dialect, typed: bool, reason: str) -> list[Fault]:
    """Find by a slow second reading what stopped the fast one: each bad cell with line and column."""
    if whole := of_the_whole(path, dialect):
        return whole
    file, rows, more = str(path), 0, 0
    faults: list[Fault] = []
    try:
        with open(path, encoding=dialect.encoding, newline="") as handle:
            for number, line in itertools.islice(enumerate(handle, start=1), dialect.header_line, None):
                row = bool(line.strip()) and not style.is_comment(line, dialect)
                rows += row
                found = list(_line_faults(line.rstrip("\r\n"), number, file, dialect, typed)) if row else []
                more += len(found[_MOST_FAULTS - len(faults) :])
                faults += found[: _MOST_FAULTS - len(faults)]
    except UnicodeError as error:
        data, start = path.read_bytes(), getattr(error, "start", 0)
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as exact:
            start = exact.start
        column, allowed = start - data.rfind(b"\n", 0, start), "UTF-8 (or UTF-16 with its mark)"
        told = "a byte that is not UTF-8 text"
        return [Fault(file, data.count(b"\n", 0, start) + 1, column, told, allowed=allowed)]
    if not rows:
        return [Fault(file, dialect.header_line, 1, "there is a header but no rows", allowed="at least two rows")]
    if more:
        faults.append(Fault(file, faults[-1].line + 1, 0, f"and {more} more such cells"))
    return faults or [Fault(file, 0, 0, f"the table cannot be read: {reason.splitlines()[0][:200]}")]


def _line_faults(line: str, number: int, file: str, dialect: style.Dialect, typed: bool) -> Iterator[Fault]:
    try:
        reader = csv.reader([line], delimiter=dialect.delimiter, strict=True)
        cells = next(reader) if dialect.quoted else line.split(dialect.delimiter)
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
        if wanted_kind(name) != "number" or word in style.MISSING_WORDS or (name == "time_s" and is_stamp(word)):
            continue
        if not style.is_number(word.replace(",", ".") if dialect.decimal == "," else word) or "_" in word:
            at, allowed = (
                style.field_position(line, dialect.delimiter, index),
                "a number, or nothing for a missing value",
            )
            yield Fault(file, number, at, "this is not a number", name, word[:40] or "''", allowed)


def _is_utf8(path: Path) -> bool:
    """Whether every byte of a file is; in bounded memory."""
    with open(path, "rb") as handle:
        try:
            deque(codecs.iterdecode(iter(lambda: handle.read(_BLOCK_BYTES), b""), "utf-8"), maxlen=0)
        except UnicodeDecodeError:
            return False
    return True


@contextlib.contextmanager
def _open(path: Path) -> Iterator[tuple[Any, list[str]]]:
    """A file and the names of its columns. Raises InputError: not a Parquet file, cut short, or with a column twice."""
    import pyarrow.parquet as parquet

    file = str(path)
    with (
        unreadable("the Parquet file cannot be read", file, "a whole Parquet file"),
        parquet.ParquetFile(file, memory_map=True) as handle,
    ):
        names: list[str] = flattened(handle.schema_arrow.empty_table()).schema.names
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError.single(f"the column '{twice[0]}' stands twice", file=file, path=twice[0])
        yield handle, names


def read_parquet(path: Path, options: Options) -> RawTable:
    """Read a whole Parquet file, or the columns that are wanted; the fields of nested ones as ``column.field``."""
    with _open(path) as (handle, names):
        raw = from_arrow(flattened(handle.read(columns=list(filter(options.wants, names)))), str(path))
        raw.names = tuple(names)
        return raw if options.mixed else leave_out_codes(raw)


def iter_parquet(path: Path, rows: int, columns: Sequence[str] | None = None) -> Iterator[RawTable]:
    """Read a Parquet file in blocks of at most `rows` rows, in bounded memory. With `columns`, the batteries' columns
    are read as well."""
    import pyarrow as pa

    with _open(path) as (handle, names):
        chosen = None if columns is None else [name for name in names if name in columns or measures(name)]

        def blocks() -> Iterator[RawTable]:
            first = 0
            for batch in handle.iter_batches(batch_size=rows, columns=chosen):
                yield from_arrow(flattened(pa.Table.from_batches([batch])), str(path), first_row=first)
                first += batch.num_rows

        yield from _judged_whole(blocks)


_LOOSE = (".txt", ".dat", ".log", ".gz", ".bz2", ".xz")

READERS = (
    Reader("csv", "text table", (".csv", ".tsv"), table=read_csv, blocks=iter_csv, loose=_LOOSE),
    Reader("parquet", "Parquet file", (".parquet",), (b"PAR1",), table=read_parquet, blocks=iter_parquet),
)
