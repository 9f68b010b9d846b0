"""Where the names of a text table stand: under a preamble, above a line of units, in a comment."""

from __future__ import annotations

import collections
import csv
from collections.abc import Sequence

from missionsim.logs.times import is_stamp

MISSING_WORDS = (
    "", "#N/A", "#NA", "-NaN", "-nan", "N/A", "NA", "NULL", "NaN", "n/a", "nan", "null", "None", "none", "NAN",
)  # fmt: skip
_UNITS = {
    "s", "ms", "us", "µs", "ns", "sec", "min", "h", "V", "mV", "A", "mA", "uA", "W", "kW", "mW", "Wh", "kWh", "J",
    "kJ", "m", "mm", "cm", "km", "m/s", "km/h", "kmh", "kph", "mph", "mm/s", "cm/s", "rad", "rad/s", "deg", "°",
    "deg/s", "°/s", "rpm", "1/min", "°C", "C", "degC", "K", "%", "Hz", "kg", "g", "N", "Nm", "m/s²", "m/s^2", "-",
    "1",
}  # fmt: skip


def is_number(word: str) -> bool:
    """Whether a text is a number as `float` reads it."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def cells_of(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


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
        rows = [
            i for i, shape in shapes.items() if len(shape) == width and {"1"} <= {shape[k] for k in value} <= {"0", "1"}
        ]
        if width < 2 or not value or len(rows) < 0.5 * len(shapes) or rows[0] == start:
            continue
        above = [i for i in shapes if i < rows[0] and len(shapes[i]) == width and "1" not in shapes[i]]
        if not above or above[-1] != max(i for i in shapes if i < rows[0]):
            continue
        last = above[-1]
        units = len(above) > 1 and _are_units(cells_of(lines[last], mark))
        names = above[-2] if units else last
        return None if (names, rows[0]) == (start, start + 1) else (names, rows[0], mark)
    return None


def _shape(cells: Sequence[str]) -> str:
    """One letter a cell: ``1`` a number or a time, ``0`` nothing, ``a`` a text."""
    return "".join(
        "0" if cell in MISSING_WORDS else "1" if is_number(cell.replace(",", ".")) or is_stamp(cell) else "a"
        for cell in cells
    )


def _are_units(texts: Sequence[str]) -> bool:
    """Whether the cells of a line are units: in brackets, or mostly ones that loggers write."""
    told = [text for text in texts if text]
    return bool(told) and (
        all(text[0] in "[(" and text[-1] in "])" for text in told)
        or sum(text in _UNITS for text in told) >= 0.5 * len(told)
    )


def named_in_comment(line: str, delimiter: str, count: int) -> tuple[str, ...]:
    """Names of the columns in the comment above the rows (``# t[s] v[m/s]``); empty where there are none."""
    text = line.strip().lstrip("#").strip()
    for cells in (cells_of(text, delimiter), text.split()):
        if len(cells) == count and not any(map(is_number, cells)) and all(cells):
            return tuple(cells)
    return ()
