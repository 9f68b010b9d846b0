"""A table as it stands in a file: numbers as float64, text as `Labels`, its lines, and remarks on what was wrong."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import Fault
from missionsim.glossary import column_of
from missionsim.labels import ColumnData as ColumnData
from missionsim.labels import Labels
from missionsim.physics import Array

if TYPE_CHECKING:
    import pyarrow as pa


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


_SWITCH_WORDS = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0}
_MOSTLY_NUMBERS = 0.9


@dataclass
class RawTable:
    """Columns of one file before any check of their values."""

    file: str
    """The path as the user gave it."""
    columns: dict[str, ColumnData]
    """Name → array of float64 of shape (n,), missing values NaN; or `Labels`."""
    lines: Callable[[int], int] = lambda _row: 0
    """Row number (0-based; -1 for the header) → line of a text file (1-based); 0 for formats without lines."""
    remarks: list[Remark] = field(default_factory=list)
    """What the reader of the format found."""
    first_row: int = 0
    """Row number in the file of the first row of this table (blocks of a long file)."""
    headless: bool = False
    """Whether the names were made up, because the file has no header."""
    local: set[str] = field(default_factory=set)
    """Columns of times that a reader of the format made seconds of, whose zone is not known."""
    names: tuple[str, ...] = ()
    """Every column of the file, also those that were not asked for."""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def line(self, row: int) -> int:
        """Line of a row of this table in its file, 0 where the format has no lines."""
        return self.lines(self.first_row + int(row))


def wanted_kind(name: str) -> str:
    """``number``, ``text`` or ``any``: what a column of this name has to be."""
    found = column_of(name)
    if found is None:
        return "any"
    return {"number": "number", "text": "text"}.get(found[0].kind, "any")


def from_arrow(
    table: pa.Table | pa.RecordBatch, file: str, lines: Callable[[int], int], first_row: int = 0
) -> RawTable:
    """Columns of a pyarrow table or record batch, numbers as float64 and text as codes.

    `file`: for messages; `lines`: see `RawTable`; `first_row`: row number of the first row in the file.
    """
    raw = RawTable(file, {}, lines, [], first_row)
    for name in table.schema.names:
        raw.columns[name] = _column(table.column(name), name, raw)
    return raw


def _column(data: Any, name: str, raw: RawTable) -> ColumnData:
    import pyarrow as pa

    kind = data.type
    if pa.types.is_null(kind):
        return np.full(len(data), np.nan)
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        stamps = _floats(data.cast(pa.int64()))
        raw.remarks.append(Remark("format", name, "a timestamp, not a number", f"read as seconds ({kind})", "note"))
        if pa.types.is_timestamp(kind) and kind.tz is None:
            raw.local.add(name)
        return np.asarray(stamps, dtype=np.float64) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
    if pa.types.is_boolean(kind):
        data = data.cast(pa.int8())
        kind = data.type
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if number and wanted_kind(name) != "text":
        return _floats(data)
    if not (number or _is_text(kind)) and not pa.types.is_temporal(kind):
        told = f"holds {kind}, neither numbers nor text"
        raw.remarks.append(Remark("format", name, told, "the column was left out", "error"))
        return np.full(len(data), np.nan)
    labels = _labels(data)
    return labels if wanted_kind(name) == "text" else _maybe_numbers(labels, name, raw)


def _floats(data: Any) -> Array:
    """Numbers of an Arrow column; missing ones NaN. Reads the buffers, because Arrow's own way imports pandas."""
    import pyarrow as pa

    data = data.cast(pa.float64(), safe=False)
    parts = []
    for chunk in data.chunks if isinstance(data, pa.ChunkedArray) else [data]:
        validity, values = chunk.buffers()
        if not len(chunk):
            continue
        part = np.frombuffer(values, dtype=np.float64)[chunk.offset : chunk.offset + len(chunk)]
        if chunk.null_count:
            known = np.unpackbits(np.frombuffer(validity, dtype=np.uint8), bitorder="little")
            part = np.where(known[chunk.offset : chunk.offset + len(chunk)] == 1, part, np.nan)
        parts.append(part)
    return np.concatenate(parts) if len(parts) > 1 else (parts[0] if parts else np.empty(0))


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _labels(data: Any) -> Labels:
    import pyarrow as pa

    if not _is_text(data.type):
        data = data.cast(pa.string())
    if isinstance(data, pa.ChunkedArray):
        data = data.combine_chunks()
    if not pa.types.is_dictionary(data.type):
        data = data.dictionary_encode()
    floats = _floats(data.indices)
    names = ["" if name is None else str(name) for name in data.dictionary.to_pylist()]
    codes = np.asarray(np.where(np.isnan(floats), -1.0, floats), dtype=np.int64)
    if "" in names:
        empty = names.index("")
        codes = np.asarray(np.where(codes == empty, -1, codes - (codes > empty)), dtype=np.int64)
        names.pop(empty)
    return Labels(codes, tuple(names))


def _maybe_numbers(labels: Labels, name: str, raw: RawTable) -> ColumnData:
    """Text that is nearly always a number, or on and off, becomes numbers, and the odd cells are told."""
    if not labels.names:
        return np.full(len(labels), np.nan)
    if all(word.strip().lower() in _SWITCH_WORDS for word in labels.names):
        values = np.array([*(_SWITCH_WORDS[word.strip().lower()] for word in labels.names), np.nan])
        raw.remarks.append(Remark("format", name, "words on/off or true/false", "read as 1 and 0", "note"))
        return np.asarray(values[labels.codes])
    values = np.array([*(_number(word) for word in labels.names), np.nan])
    numbers = np.asarray(values[labels.codes])
    written = labels.codes >= 0
    bad = written & np.isnan(numbers)
    if not bad.any():
        return numbers
    if bad.sum() > (1 - _MOSTLY_NUMBERS) * written.sum():
        return labels
    row = int(np.argmax(bad))
    first, count = labels.names[labels.codes[row]][:40], int(bad.sum())
    told = f"{count} of {len(numbers)} cells are not numbers, first '{first}'"
    raw.remarks.append(Remark("format", name, told, "read as missing", "warning", raw.line(row), count))
    return numbers


_WITH_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:%|[A-Za-zµ°/]{1,5}\d?)?\s*\Z")


def numbers_in(labels: Labels) -> ColumnData:
    """Texts that hold a number and perhaps its unit (``"28.2%"``, ``"24.1 V"``) as numbers, where most do."""
    values = np.array([*(float(m[1]) if (m := _WITH_UNIT.match(word)) else np.nan for word in labels.names), np.nan])
    numbers = np.asarray(values[labels.codes])
    written = labels.codes >= 0
    few = not written.any() or np.isfinite(numbers[written]).mean() < _MOSTLY_NUMBERS
    return labels if few else numbers


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")
