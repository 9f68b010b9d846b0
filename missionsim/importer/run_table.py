"""A table of runs, one row a run: what held for the whole of a run, joined to its rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.importer.sources import Source, column_name, identifier
from missionsim.inputs.log_map import MapSpec
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.logs.readers import Options, reader_of, source_suffixes, unpacked_name
from missionsim.physics import Int64s
from missionsim.runs.run import Run

Piece = tuple[str, Int64s]
"""Name of a run, and its rows in the source."""
_LISTED = 10
"""Keys that a message names."""


def written(number: float) -> str:
    """A number that names a run, with all its digits."""
    return f"{number:.15g}"


def word_in(data: ColumnData, row: int) -> str:
    """What a cell calls a run, ``none`` where it is empty."""
    if isinstance(data, Labels):
        return data.names[data.codes[row]] if data.codes[row] >= 0 else "none"
    return written(data[row])


def keys_of(data: ColumnData) -> list[str]:
    """What each row of a column calls its run: a path without the suffix of a log; empty where a cell is."""
    if isinstance(data, Labels):
        return [_plain(text) for text in data.texts()]
    return ["" if np.isnan(number) else written(number) for number in data]


def _plain(text: str) -> str:
    path = unpacked_name(text.strip().replace("\\", "/"))
    return next((path[: -len(end)] for end in source_suffixes() if path.lower().endswith(end)), path)


def rows_called(keys: Sequence[str], names: Sequence[str]) -> list[int]:
    """The rows of a table that are of a run: those of the first of its names that any has. A path may be of another
    machine, so that its end counts; a number is that of a name with one number at its end (``run_07``)."""
    for name in names:
        if rows := [row for row, key in enumerate(keys) if key == name]:
            return rows
    tails = [key.rpartition("/")[2] for key in keys]
    for name in names:
        if rows := [row for row, tail in enumerate(tails) if tail == name and tails.count(tail) == 1]:
            return rows
    for name in names:
        number = re.fullmatch(r"\D*?0*(\d+)", name)
        if number and (rows := [row for row, key in enumerate(keys) if re.fullmatch(rf"0*{number[1]}", key)]):
            return rows
    return []


def names_of_file(path: Path) -> list[str]:
    """What a table may call a file: the ends of its path, the longest first."""
    parts = [*path.resolve().parent.parts[1:], _plain(path.name)]
    return ["/".join(parts[-count:]) for count in range(len(parts), 0, -1)]


@dataclass
class RunTables:
    """The tables of runs that a map names, each read once."""

    spec: MapSpec
    read: dict[Path, tuple[RawTable, list[str], dict[int, Path | None]]] = field(default_factory=dict)
    """Table, what each row calls its run, and the rows that were of one, with its file where that was named."""

    def join(self, raw: RawTable, source: Source, pieces: Sequence[Piece]) -> None:
        """Add the columns that the map takes of the table, in each run those of its row. Raises InputError: no such
        table, key or column; a run without a row, or with two."""
        if self.spec.runs.table is None:
            return
        table, keys, used = self._table(source)
        row_of, faults = np.zeros(raw.rows, dtype=np.int64), list[Fault]()
        for run, inside in pieces:
            own, file = rows_called(keys, self._names(raw, source, run, inside)), source.path.resolve()
            rows = own or rows_called(keys, [file.parent.name])
            row_of[inside] = rows[0] if rows else 0
            other = used.get(rows[0]) if own else None
            used |= dict.fromkeys(rows, file if own else None)
            if not rows:
                faults.append(self._without_row(table, keys, run))
            elif other not in (None, file):
                told = f"one row for two runs, {other} and {file}"
                got, hint = keys[rows[0]], f"the folder in it: {file.parent.name}/{keys[rows[0]]}"
                faults.append(Fault(table.file, table.line(rows[0]), 0, told, self._key, got, "one row a run", hint))
            elif len(rows) > 1:
                told = f"a second row of one run, the first is line {table.line(rows[0])}"
                cell = word_in(table.columns[str(column_name(self._key, table.names))], rows[1])
                faults.append(Fault(table.file, table.line(rows[1]), 0, told, self._key, cell, "one row a run"))
        if faults:
            raise InputError(faults)
        for alias, name in self.spec.of_runs.items():
            raw.columns[alias] = table.columns[str(column_name(name, table.names))][row_of]

    @property
    def files(self) -> list[str]:
        """Paths of the tables, for messages."""
        return [table.file for table, _, _ in self.read.values()]

    @property
    def _key(self) -> str:
        return self.spec.runs.key or ""

    def _table(self, source: Source) -> tuple[RawTable, list[str], dict[int, Path | None]]:
        path = table_path(self.spec, source.path)
        document, spec = self.spec.document, self.spec
        if path is None:
            told = "there is no such table beside the logs or the map"
            places = [place for one in _places(spec, source.path) for place in one.glob("*") if place.is_file()]
            hint = did_you_mean(str(spec.runs.table), [place.name for place in places])
            raise InputError(document.fault(("runs", "table"), told, str(spec.runs.table), hint=hint))
        if path.resolve() in self.read:
            return self.read[path.resolve()]
        reader = reader_of(path)
        if reader.table is None:
            allowed = "CSV or Parquet"
            raise InputError(document.fault(("runs", "table"), f"this is a {reader.title}", path.name, allowed))
        table = reader.table(path, Options())
        names = table.names or tuple(table.columns)
        table.names = names
        faults = []
        asked = [(("runs", "key"), "", self._key)]
        asked += [(("signals", alias), "runs.", name) for alias, name in spec.of_runs.items()]
        for place, start, name in asked:
            if column_name(name, names) is None:
                told, known = f"'{start}{name}' is not in {path.name}", [f"{start}{one}" for one in names]
                hint = did_you_mean(f"{start}{name}", known)
                faults.append(document.fault(place, told, f"{start}{name}", ", ".join(known), hint))
        if faults:
            raise InputError(faults)
        keys = keys_of(table.columns[str(column_name(self._key, names))])
        return self.read.setdefault(path.resolve(), (table, keys, {}))

    def _names(self, raw: RawTable, source: Source, run: str, inside: Int64s) -> list[str]:
        """What the table may call a run, the closest first."""
        by = [(name, word_in(raw.columns[name], int(inside[0]))) for name in self.spec.runs.by if len(inside)]
        key = [word for name, word in by if name == identifier(self._key)]
        joined = ["_".join(word for _, word in by)] if by else []
        return [run, *key, *joined, source.name, *(name for p in source.files.values() for name in names_of_file(p))]

    def _without_row(self, table: RawTable, keys: list[str], run: str) -> Fault:
        """A run that the table does not have: perhaps under another name, perhaps by another column."""
        name = Path(table.file).name
        others = (one for one, data in table.columns.items() if rows_called(keys_of(data), [run]))
        other = next(others, "")
        known = list(dict.fromkeys(filter(None, keys)))
        more = f", … ({len(known)} in all)" if len(known) > _LISTED else ""
        hint = f"key: {other}" if other else did_you_mean(run, known)
        told = f"no row of {name} is of the run '{run}'"
        return self.spec.document.fault(("runs", "key"), told, run, ", ".join(known[:_LISTED]) + more, hint)

    def tell(self, logs: list[Run]) -> None:
        """Tell the rows that are of no run, with the first of the logs."""
        for table, keys, used in self.read.values():
            left = [row for row in range(len(keys)) if row not in used]
            if left and logs:
                named = ", ".join(keys[row] or "without a name" for row in left[:5]) + (", …" if len(left) > 5 else "")
                told = f"{len(left)} of {len(keys)} rows of {table.file} are of no run that was read: {named}"
                told += f", first line {table.line(left[0])}" if table.line(left[0]) else ""
                remark = Remark("name", "", told, "not used", "note", 0, len(left))
                logs[0] = replace(logs[0], remarks=(*logs[0].remarks, remark))


def _places(spec: MapSpec, source: Path) -> Iterator[Path]:
    """Folders in which a table is looked for: that of the logs, the one above it, that of the map."""
    yield from (source.resolve().parent, source.resolve().parent.parent, spec.path.resolve().parent)


def table_path(spec: MapSpec, source: Path) -> Path | None:
    """The table of runs that belongs to a source; None where there is none."""
    name = spec.runs.table or ""
    return next((place / name for place in _places(spec, source) if name and (place / name).is_file()), None)
