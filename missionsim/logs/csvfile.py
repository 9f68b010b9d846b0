"""CSV into columns, whole or in blocks, through Arrow's reader."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.logs.csvdialect import MISSING_WORDS, Dialect, count_rows, has_cut_end, line_finder, sniff
from missionsim.logs.csvfaults import explain, text_faults
from missionsim.logs.raw import RawTable, from_arrow, wanted_kind
from missionsim.logs.remarks import Remark


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
    cut = _checked_end(path, file, dialect)
    skipped: list[int] = []
    options = _options(dialect, typed, skipped if cut else None)
    try:
        table = arrow_csv.read_csv(str(path), **options)
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
        raise InputError(explain(path, file, dialect, typed, str(error))) from None
    if _lost_rows(path, dialect, table.num_rows, skipped):
        raise InputError(explain(path, file, dialect, typed, _LOST))
    raw = from_arrow(table, file, line_finder(path, dialect))
    raw.remarks[:0] = dialect.remarks
    if cut:
        raw.remarks.append(_cut_end(raw, raw.rows))
    return raw


def iter_csv(path: Path, file: str, rows: int) -> Iterator[RawTable]:
    """Read a CSV file in blocks of at least `rows` rows (the last may be shorter), in bounded memory."""
    import pyarrow as pa
    import pyarrow.csv as arrow_csv

    dialect = sniff(path, file)
    cut = _checked_end(path, file, dialect)
    skipped: list[int] = []
    options = _options(dialect, True, skipped if cut else None)
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
        if _lost_rows(path, dialect, first + count, skipped):
            raise InputError(explain(path, file, dialect, True, _LOST))
        if count:
            raw = from_arrow(pa.Table.from_batches(held), file, lines, first)
            if cut:
                raw.remarks.append(_cut_end(raw, count))
            yield raw
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as error:
        raise InputError(explain(path, file, dialect, True, str(error))) from None


def _types(dialect: Dialect, typed: bool) -> dict[str, Any]:
    import pyarrow as pa

    kinds = {"number": pa.float64(), "text": pa.dictionary(pa.int32(), pa.string())}
    return {name: kinds[wanted_kind(name)] for name in dialect.names if wanted_kind(name) in kinds} if typed else {}


def _checked_end(path: Path, file: str, dialect: Dialect) -> bool:
    """Whether the last line is cut short; then its text is checked first, as Arrow cannot tell bad text then."""
    cut = has_cut_end(path, dialect)
    if cut and (faults := text_faults(path, file)):
        raise InputError(faults)
    return cut


_LOST = "rows are lost in it: a quotation mark that does not end, or rows of the wrong length"


def _lost_rows(path: Path, dialect: Dialect, rows: int, skipped: list[int]) -> bool:
    """Whether rows of the file are not in the table: an open quotation mark swallows the lines that follow."""
    return len(skipped) > 1 or (dialect.quoted and rows + len(skipped) != count_rows(path, dialect))


def _cut_end(raw: RawTable, row: int) -> Remark:
    return Remark("format", "", "the last line is cut short", "it was left out", "warning", raw.line(row), 1)


def _options(dialect: Dialect, typed: bool, skipped: list[int] | None) -> dict[str, Any]:
    """Options of Arrow's readers; with a list, rows of the wrong length are left out and noted in it."""
    import pyarrow.csv as arrow_csv

    def on_ragged(row: Any) -> str:
        assert skipped is not None
        skipped.append(row.actual_columns)
        return "skip"

    encoding = "utf-16" if dialect.encoding == "utf-16" else "utf8"
    return {
        "read_options": arrow_csv.ReadOptions(
            column_names=list(dialect.names), skip_rows=dialect.header_line, encoding=encoding, block_size=1 << 22
        ),
        "parse_options": arrow_csv.ParseOptions(
            delimiter=dialect.delimiter,
            quote_char='"' if dialect.quoted else False,
            invalid_row_handler=None if skipped is None else on_ragged,
        ),
        "convert_options": arrow_csv.ConvertOptions(
            column_types=_types(dialect, typed),
            null_values=list(MISSING_WORDS),
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
            true_values=["true", "True", "TRUE"],
            false_values=["false", "False", "FALSE"],
        ),
    }
