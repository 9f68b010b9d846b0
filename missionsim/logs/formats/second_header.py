"""Lines of a text table that are no rows of it: a second header, labels in each cell, rows of several kinds."""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.labels import Labels
from missionsim.logs.formats.dialect import MISSING_WORDS, UNITS, Dialect, cells_of, is_number
from missionsim.logs.raw import RawTable, Remark
from missionsim.logs.times import is_stamp
from missionsim.numerals import counted

_LABELLED = re.compile(r"\s*[A-Za-z_][\w ]*[:=]\s*[-+]?[\d.]\S*\s*")
_MANY = 20
"""Rows of another length from which they are told together."""


def refuse_second_header(raw: RawTable, names: Sequence[str]) -> None:
    """Raise InputError where a row holds the names of another recording: those of other columns, or new ones in every
    column of numbers. A header that stands again is told once."""
    plain = {name: re.sub(r" (\[[^]]*\]|#\d+)\Z", "", name) for name in names}
    words: dict[int, dict[str, str]] = {}
    for name, labels in raw.odd.items():
        for code, word in enumerate(map(str.strip, labels.names)):
            if not is_number(word) and word not in MISSING_WORDS:
                words.setdefault(int(np.argmax(labels.codes == code)), {})[name] = word
    first = next(iter(raw.columns.values()))
    if isinstance(first, Labels):  # `#datatype,long,…` above each table that Influx writes
        words = {row: of for row, of in words.items() if not (first[row : row + 1].texts()[0] or "").startswith("#")}
    numbers = [name for name, data in raw.columns.items() if isinstance(data, np.ndarray)]
    again: set[int] = set()
    for row, found in sorted(words.items()):
        other = [name for name, word in found.items() if word in plain.values() and word != plain[name]]
        new = len(set(found.values())) == len(found) == len(numbers) > 1 and not {*found.values()} & {*plain.values()}
        if other or (new and row - 1 not in again and not {*found.values()} <= UNITS):
            told = f"a second header, with {'its columns in another order' if other else 'other names'}"
            name, line = (other or numbers)[0], raw.line(row)
            hint = f"a file that begins at line {line}"
            raise InputError(Fault(raw.file, line, 0, told, name, found[name], "one recording a file", hint))
        if len(found) > 1 and all(word == plain[name] for name, word in found.items()):
            again.add(row)
    if again:
        columns = {name for row in again for name in words[row]}
        of_it = [one for one in raw.remarks if one.column in columns and one.message.endswith(f"'{plain[one.column]}'")]
        count = max((one.count for one in of_it), default=len(again))
        raw.remarks[:] = [one for one in raw.remarks if one not in of_it]
        line, message = raw.line(min(again)), "the header stands again among the rows"
        raw.remarks.append(Remark("format", "", message, "read as missing", "warning", line, count))


def of_the_whole(path: Path, dialect: Dialect) -> list[Fault]:
    """One fault for a table of which many lines are at fault for one reason; empty where there is none."""
    file, width = str(path), len(dialect.names)
    lengths: Counter[int] = Counter()
    labelled, wrong, first = 0, 0, (0, "")
    with open(path, encoding=dialect.encoding, errors="replace", newline="") as handle:
        for number, text in itertools.islice(enumerate(handle, start=1), dialect.header_line, None):
            try:
                cells = cells_of(text.rstrip("\r\n"), dialect.delimiter)
            except csv.Error:
                return []
            if not any(cells):
                continue
            lengths[len(cells)] += 1
            if not wrong and len(cells) != width and number > 1 and _names(cells):
                told = f"a second header, with {len(cells)} columns in place of {width}"
                hint = f"a file that begins at line {number}"
                return [Fault(file, number, 1, told, got=text.strip()[:60], allowed="one recording a file", hint=hint)]
            labelled += sum(map(bool, map(_LABELLED.fullmatch, cells))) == len(cells)
            if len(cells) != width:
                first = first if wrong else (number, text.strip()[:60])
                wrong += 1
    rows = lengths.total()
    if labelled > 0.5 * rows:
        told, allowed = "each cell is a label with its value", "the labels in a header, and values alone in the rows"
        return [Fault(file, max(first[0], 1), 1, told, got=first[1], allowed=allowed)]
    others = [length for length in lengths if length != width]
    if wrong > _MANY and (len(others) > 1 or wrong == rows):
        several = f"{min(others)} to {max(others)}" if len(others) > 1 else f"{others[0]}"
        told = f"{wrong} of {rows} rows have {several} values, where the header names {counted(width, 'column')}"
        allowed = "rows of one length: of messages of several kinds, one kind a file"
        return [Fault(file, first[0], 1, told, got=first[1], allowed=allowed)]
    return []


def _names(cells: Sequence[str]) -> bool:
    """Whether cells are words as a header has them: each another one, and no number, stamp or unit among them."""
    filled = [cell for cell in cells if cell]
    values = is_number, is_stamp, _LABELLED.fullmatch, MISSING_WORDS.__contains__, UNITS.__contains__
    words = all(re.match(r"[^\W\d]", cell) and not any(one(cell) for one in values) for cell in filled)
    return words and len({*filled}) == len(filled) > 1
