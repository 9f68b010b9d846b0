"""A table as it stands in a file, its lines, remarks on what was wrong, and the power of each battery in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import Fault, did_you_mean
from missionsim.glossary import COLUMNS, column_of
from missionsim.labels import ColumnData as ColumnData
from missionsim.labels import Labels
from missionsim.logs.codes import Found, Tally, without
from missionsim.physics import Array, Bools

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


def damaged(message: str, count: int = 1, line: int = 0) -> Remark:
    """The remark on a recording of which a part is missing."""
    return Remark("damaged", "", message, "what could be read was read", "error", line, count)


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
TIME_STAMP = "a timestamp, not a number"
"""What is said of a column of numbers that was one of stamps."""


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
    _: KW_ONLY
    decimal: str = "."
    """Decimal mark of numbers that stand among texts."""
    odd: dict[str, Labels] = field(default_factory=dict)
    """Columns of numbers in which some cells are none, as they stand there."""

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
    table: pa.Table | pa.RecordBatch,
    file: str,
    lines: Callable[[int], int] = lambda _row: 0,
    first_row: int = 0,
    decimal: str = ".",
) -> RawTable:
    """Columns of a pyarrow table or record batch, numbers as float64 and text as codes. `file`: for messages; `lines`:
    see `RawTable`; `first_row`: row number of the first row in the file; `decimal`: mark in numbers among texts."""
    raw = RawTable(file, {}, lines, [], first_row, decimal=decimal)
    for name in table.schema.names:
        raw.columns[name] = _column(table.column(name), name, raw)
    return raw


def tallies_of(columns: Mapping[str, ColumnData], so_far: dict[str, Tally] | None = None) -> dict[str, Tally]:
    """What tells the codes for no value of each column of numbers; `so_far`: of the blocks before."""
    tallies = {} if so_far is None else so_far
    for name, data in columns.items():
        if not isinstance(data, Labels):
            tallies.setdefault(name, Tally()).add(data)
    return tallies


def leave_out_codes(raw: RawTable, tallies: Mapping[str, Tally] | None = None) -> RawTable:
    """The same table with codes for no value as NaN, told with the block in which each is first. `tallies`: of all
    blocks of the file, where the table is one of them."""
    tallies = tallies_of(raw.columns) if tallies is None else tallies
    for name, tally in tallies.items():
        data, found = raw.columns[name], tally.found()
        if not found or isinstance(data, Labels):
            continue
        raw.columns[name] = without(data, found)
        raw.remarks += codes_told(name, tally.rows, [x for x in found if 0 <= x[2] - raw.first_row < raw.rows], raw)
    return raw


def codes_told(name: str, rows: int, found: Found, raw: RawTable | None = None) -> list[Remark]:
    """What is said of the codes of a column of so many rows."""
    told = "{} of {} values are exactly {:g}, far from all others: a code for no value"
    return [
        Remark("missing", name, told.format(count, rows, code), "they count as missing", "warning",
               raw.lines(row) if raw is not None else 0, count)
        for code, count, row in found
    ]  # fmt: skip


def _column(data: Any, name: str, raw: RawTable) -> ColumnData:
    import pyarrow as pa

    kind = data.type
    if pa.types.is_null(kind):
        return np.full(len(data), np.nan)
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        stamps = _floats(data.cast(pa.int64()))
        raw.remarks.append(Remark("format", name, TIME_STAMP, f"read as seconds ({kind})", "note"))
        if pa.types.is_timestamp(kind) and kind.tz is None:
            raw.local.add(name)
        return np.asarray(stamps, dtype=np.float64) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
    if pa.types.is_boolean(kind):
        data = data.cast(pa.int8())
        kind = data.type
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if number and wanted_kind(name) != "text":
        return _floats(data)
    word = kind.value_type if pa.types.is_dictionary(kind) else kind
    text = pa.types.is_string(word) or pa.types.is_large_string(word)
    if not (number or text or pa.types.is_temporal(kind)):
        told = f"holds {kind}, neither numbers nor text"
        raw.remarks.append(Remark("format", name, told, "the column was left out", "error"))
        return np.full(len(data), np.nan)
    data = data if text else data.cast(pa.string())
    data = data.combine_chunks() if isinstance(data, pa.ChunkedArray) else data
    data = data if pa.types.is_dictionary(data.type) else data.dictionary_encode()
    floats = _floats(data.indices)
    codes = np.asarray(np.where(np.isnan(floats), -1.0, floats), dtype=np.int64)
    names = ["" if name is None else str(name) for name in data.dictionary.to_pylist()]
    if "" in names:
        empty = names.index("")
        codes = np.asarray(np.where(codes == empty, -1, codes - (codes > empty)), dtype=np.int64)
        names.pop(empty)
    labels = Labels(codes, tuple(names))
    return labels if wanted_kind(name) == "text" else _maybe_numbers(labels, name, raw)


def _floats(data: Any) -> Array:
    """Numbers of an Arrow column; missing ones NaN. Reads the buffers, because Arrow's own way imports pandas."""
    import pyarrow as pa

    data = data.cast(pa.float64(), safe=False)
    data = data.combine_chunks() if isinstance(data, pa.ChunkedArray) else data
    if not len(data):
        return np.empty(0)
    validity, values = data.buffers()
    rows = slice(data.offset, data.offset + len(data))
    if not data.null_count:
        return np.frombuffer(values, dtype=np.float64)[rows]
    known = np.unpackbits(np.frombuffer(validity, dtype=np.uint8), bitorder="little")[rows]
    return np.where(known == 1, np.frombuffer(values, dtype=np.float64)[rows], np.nan)


def numbers_of(labels: Labels, value: Callable[[str], float]) -> Array:
    """A number for each text, NaN where it is missing."""
    return np.asarray(np.array([*map(value, labels.names), np.nan])[labels.codes])


def _maybe_numbers(labels: Labels, name: str, raw: RawTable) -> ColumnData:
    """Text that is nearly always a number, or on and off, becomes numbers, and the odd cells are told."""
    if not labels.names:
        return np.full(len(labels), np.nan)
    if all(word.strip().lower() in _SWITCH_WORDS for word in labels.names):
        raw.remarks.append(Remark("format", name, "words on/off or true/false", "read as 1 and 0", "note"))
        return numbers_of(labels, lambda word: _SWITCH_WORDS[word.strip().lower()])
    dotted = labels
    if mark := _mark_of_thousands(labels.names, raw.decimal):
        told = f"marks of thousands ({mark if mark.strip() else 'spaces'}) in its numbers"
        raw.remarks.append(Remark("format", name, told, "read without them", "warning"))
        dotted = Labels(labels.codes, tuple(word.replace(mark, "") for word in labels.names))
    if raw.decimal != ".":
        dotted = Labels(labels.codes, tuple(word.replace(raw.decimal, ".") for word in dotted.names))
    numbers = numbers_of(dotted, number_of)
    written = labels.codes >= 0
    bad = written & np.isnan(numbers)
    if not bad.any():
        return numbers
    if bad.sum() > (1 - _MOSTLY_NUMBERS) * written.sum():
        units = {found[2] for word in dotted.names if (found := _WITH_UNIT.match(word))}
        known = column_of(name)
        fitting = _OF.get(known[0].unit, {}) if known else _SCALES
        if not units <= fitting.keys() or isinstance(read := numbers_in(dotted, name), Labels):
            return labels
        told = f"each cell has a unit behind its number ({', '.join(sorted(filter(None, units)))})"
        raw.remarks.append(Remark("format", name, told, "read without prefix, speeds in m/s", "note"))
        return read
    raw.odd[name] = labels
    row = int(np.argmax(bad))
    first, count = labels.names[labels.codes[row]][:40], int(bad.sum())
    told = f"{count} of {len(numbers)} cells are not numbers, first '{first}'"
    raw.remarks.append(Remark("format", name, told, "read as missing", "warning", raw.line(row), count))
    return numbers


_THOUSANDS = ".,'’ \N{NO-BREAK SPACE}\N{THIN SPACE}\N{NARROW NO-BREAK SPACE}"


def _mark_of_thousands(words: Sequence[str], decimal: str) -> str:
    """What stands before every third digit in the numbers of a column, and nowhere else; empty where nothing does.
    A number that begins with nought has its decimals behind the mark."""
    for mark in (mark for mark in _THOUSANDS if mark != decimal):
        marked = [word.strip() for word in words if re.search(rf"{re.escape(mark)}\d", word)]
        whole = rf"[+-]?[1-9]\d{{0,2}}(?:{re.escape(mark)}\d{{3}})+(?:{re.escape(decimal)}\d*)?(?:\s*[^\s\d]\S{{,5}})?"
        if marked and all(re.fullmatch(whole, word) for word in marked):
            return mark
    return ""


_WITH_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(%|[A-Za-zµ°/]{1,5}\d?)?\s*\Z")
_OF = {
    "W": {"W": 1.0, "mW": 1e-3, "uW": 1e-6, "kW": 1e3}, "Wh": {"Wh": 1.0, "mWh": 1e-3, "kWh": 1e3}, "1": {"%": 1.0},
    "V": {"V": 1.0, "mV": 1e-3, "kV": 1e3}, "A": {"A": 1.0, "mA": 1e-3, "uA": 1e-6, "µA": 1e-6},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "°/s": np.pi / 180},
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "min": 60.0, "hr": 3600.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704},
}  # fmt: skip
"""Unit of a column → units that its cells may have → what a number with one is multiplied by."""
_SCALES = {unit: size for units in _OF.values() for unit, size in units.items()}


def numbers_in(labels: Labels, name: str = "") -> ColumnData:
    """Texts that hold a number and perhaps its unit (``"28.2%"``, ``"24.1 V"``) as numbers, where most do: units with a
    prefix as those without, speeds in m/s, unless the column's `name` says the unit as well."""

    def value(word: str) -> float:
        found = _WITH_UNIT.match(word)
        if found is None:
            return float("nan")
        unit = found[2] or ""
        said = unit and re.search(rf"(?:\A|[^A-Za-z]){re.escape(unit)}[)\]]?\s*\Z", name, re.IGNORECASE)
        return float(found[1]) * (1.0 if said else _SCALES.get(unit, 1.0))

    numbers = numbers_of(labels, value)
    written = labels.codes >= 0
    few = not written.any() or np.isfinite(numbers[written]).mean() < _MOSTLY_NUMBERS
    return labels if few else numbers


def number_of(word: str) -> float:
    """The number of a cell, nan where it holds none: ``1_000`` and digits of other scripts are none."""
    try:
        return float(word) if word.isascii() and "_" not in word else float("nan")
    except ValueError:
        return float("nan")


MEASURED = "power_<battery>_w, or voltage_<battery>_v and current_<battery>_a, or energy_<battery>_wh"
"""Columns of which a log needs some."""


def measured_batteries(names: Iterable[str]) -> dict[str, str]:
    """Battery → what its power comes from: ``power``, ``voltage*current`` or ``energy``, in column order."""
    kinds: dict[str, set[str]] = {}
    for name in names:
        found = column_of(name)
        if found is not None and "<battery>" in found[0].name:
            kinds.setdefault(found[1], set()).add(found[0].name.split("_")[0])
    ways = (("power", {"power"}), ("voltage*current", {"voltage", "current"}), ("energy", {"energy"}))
    chosen = {battery: next((way for way, needs in ways if needs <= have), "") for battery, have in kinds.items()}
    return {battery: way for battery, way in chosen.items() if way}


def measures(name: str) -> bool:
    """Whether a column belongs to what is measured of a battery."""
    found = column_of(name)
    return found is not None and "<battery>" in found[0].name


def missing_columns(names: Iterable[str], file: str, header_line: Callable[[], int]) -> list[Fault]:
    """Faults for the columns that every log has to have (`header_line` is called only where there are any)."""
    names = list(names)
    faults = []
    known = [column.name.replace("<battery>", "robot") for column in COLUMNS if "<component>" not in column.name]
    if "time_s" not in names:
        near = did_you_mean("time_s", [name for name in names if column_of(name) is None], 0.4)
        allowed, hint = "time in seconds from the start of the run", f"rename '{near}' or use a map" if near else ""
        told, got = "the column 'time_s' is missing", ", ".join(names)[:200]
        faults.append(Fault(file, header_line(), 0, told, "time_s", got, allowed, hint))
    if not measured_batteries(names):
        half = {"voltage_<battery>_v": "current_{}_a", "current_<battery>_a": "voltage_{}_v"}
        of = {name: found for name in names if (found := column_of(name)) is not None}
        hints = [f"'{half[c.name].format(b)}' beside '{name}'" for name, (c, b) in of.items() if c.name in half]
        alike = ("power", "volt", "curr", "energy", "battery", "watt", "p_")
        if not hints and (name := next((name for name in names if name not in of and name.startswith(alike)), "")):
            near = did_you_mean(name, known, 0.5)
            hints = [f"'{name}' as {near or 'power_robot_w'} (rename it, or use a map)"]
        told, got = "no battery is measured", ", ".join(names)[:200]
        faults.append(Fault(file, header_line(), 0, told, "power_<battery>_w", got, MEASURED, *hints[:1]))
    return faults


def power_from_energy(energy_wh: Array, time_s: Array) -> tuple[Array, Bools | None]:
    """Mean power around each row from a cumulative energy.

    `energy_wh` (shape (n,)): cumulative energy at each row [Wh]; `time_s` (shape (n,)): [s]. Gives `power_w` (shape
    (n,)): [W]. Where the counter moves in most rows: the energy between the half-way points to the neighbours, over
    that time. Where it moves in fewer rows: its increment over the time since it moved before. `fresh`: rows in which
    the counter moved; None for the first case.
    """
    n = len(time_s)
    moved = np.flatnonzero(np.diff(energy_wh) != 0.0) + 1
    if n < 3 or len(moved) >= 0.8 * (n - 1):
        after, before = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - 1, 0)
        return (energy_wh[after] - energy_wh[before]) / (time_s[after] - time_s[before]) * 3600.0, None
    if not len(moved):
        return np.zeros(n), None
    edges = np.r_[0, moved]
    mean_w = np.diff(energy_wh[edges]) / np.diff(time_s[edges]) * 3600.0
    counts = np.diff(edges)
    power = np.empty(n)
    power[0] = mean_w[0]
    power[1 : edges[-1] + 1] = np.repeat(mean_w, counts)
    power[edges[-1] + 1 :] = mean_w[-1]
    fresh = np.zeros(n, dtype=bool)
    fresh[moved] = True
    return power, fresh


def battery_power(columns: Mapping[str, ColumnData], battery: str, kind: str) -> tuple[Array, Bools | None]:
    """Power of one battery [W], shape (n,), and its refresh mask where the kind of column gives one."""
    if kind == "power":
        return np.array(columns[f"power_{battery}_w"], dtype=np.float64), None
    if kind == "voltage*current":
        return np.asarray(columns[f"voltage_{battery}_v"]) * np.asarray(columns[f"current_{battery}_a"]), None
    return power_from_energy(np.asarray(columns[f"energy_{battery}_wh"]), np.asarray(columns["time_s"]))
