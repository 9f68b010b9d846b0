"""Maps: a file of any layout, of one run or several, into logs in the columns of the glossary."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import PathLike, sha256
from missionsim.importer import transform
from missionsim.importer.mapper import Mapper
from missionsim.importer.run_table import Piece, RunTables, table_path, word_in
from missionsim.importer.sources import Source, find_sources, read_source, table_options, with_names
from missionsim.inputs.log_map import MapSpec, RunsMap
from missionsim.labels import Labels
from missionsim.logs.blocks import LongRun, checked_blocks, write_blocks
from missionsim.logs.clean import count_on, out_of_order, refuse_turns
from missionsim.logs.formats.delimited import iter_csv
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.logs.read import make_log
from missionsim.logs.readers import reader_of, run_of
from missionsim.logs.times import close_jumps
from missionsim.physics import Array, Int64s
from missionsim.runs.run import Run


def split_runs(raw: RawTable, stem: str, spec: MapSpec, time_s: Array) -> list[Piece]:
    """Name and rows of each run, in the order in which they begin.

    With ``by``, rows with the same values belong together wherever they stand (two files joined and sorted do not
    break); with ``restart``, a jump of time back by more than a second (or ten steps) begins another run.
    """
    pieces: list[Piece] = [(stem, np.arange(raw.rows))]
    if names := spec.runs.by:
        code = np.zeros(raw.rows, dtype=np.int64)
        for name in names:
            data: Any = raw.columns[name]
            _, inverse = np.unique(data.codes if isinstance(data, Labels) else data, return_inverse=True)
            code = code * (int(inverse.max(initial=0)) + 1) + inverse
        _, first, code = np.unique(code, return_index=True, return_inverse=True)
        rows = np.split(np.argsort(code, kind="stable"), np.cumsum(np.bincount(code))[:-1])
        pieces = []
        for index in np.argsort(first):
            words = [word_in(raw.columns[name], int(first[index])) for name in names]
            pieces.append((file_name("_".join([stem, *words])), rows[index]))
    if not spec.runs.restart:
        return pieces
    parted = []
    for name, inside in pieces:
        known = np.flatnonzero(np.isfinite(time_s[inside]))  # a header that stands again has no time
        step = np.diff(time_s[inside[known]])
        usual = float(np.median(np.abs(step))) if len(step) else 0.0
        at = known[1:][step < -max(1.0, 10 * usual)]
        parted += _numbered(name, np.split(inside, at)) if len(at) else [(name, inside)]
    return parted


def file_name(text: str) -> str:
    """A text as a name of a file: letters, digits, dot, dash and underscore."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")[:120] or "run"


def _numbered(name: str, pieces: list[Int64s]) -> list[Piece]:
    width = max(2, len(str(len(pieces) - 1)))
    return [(f"{name}_{index:0{width}d}", rows) for index, rows in enumerate(pieces)]


def split_at_gaps(name: str, time_s: Array, runs: RunsMap, remarks: list[Remark]) -> list[Piece]:
    """Pieces of a run between gaps longer than ``runs.gap``; pieces under ``runs.shortest`` are left out and told."""
    pieces = [np.arange(len(time_s))]
    if runs.gap is not None:
        known = np.flatnonzero(np.isfinite(time_s))
        pieces = np.split(pieces[0], known[1:][np.diff(time_s[known]) > float(runs.gap)])
    shortest = float(runs.shortest) if runs.shortest is not None else 0.0
    spans = [time_s[piece][np.isfinite(time_s[piece])] for piece in pieces]
    long = [piece for piece, t in zip(pieces, spans, strict=True) if len(t) > 1 and t[-1] - t[0] >= shortest]
    if left := sum(map(len, pieces)) - sum(map(len, long)):
        told = f"{len(pieces) - len(long)} pieces of {name} ({left} rows) are too short"
        remarks.append(Remark("gap", "", told, "left out", "note", 0, left))
    return _numbered(name, long) if len(pieces) > 1 else [(name, piece) for piece in long]


def import_source(
    source: PathLike | Sequence[PathLike], spec: MapSpec, left_out: list[Fault] | None = None
) -> list[Run]:
    """Turn sources into checked logs, by a map.

    `source`: tables, recordings, folders or patterns of names. `spec`: from `missionsim.inputs.loading.load_map`.
    `left_out`: where it is given, a file that cannot be read is left out and its faults are added here; else it refuses
    all. Gives runs, with remarks that say what was done. Raises InputError: all faults of the first source that
    has any; or of all, where none can be read.
    """
    given = [source] if isinstance(source, (str, os.PathLike)) else list(source)
    logs: list[Run] = []
    faults: list[Fault] = []
    omitted: list[Fault] = []
    tables = RunTables(spec)
    found = find_sources([Path(path) for path in given], spec)
    alike = [one for one in found if (table := table_path(spec, one.path)) is None or not table.samefile(one.path)]
    for one in alike:
        try:
            raw = read_source(one, spec)
            mapper = Mapper(spec, raw, one.name)
            pieces = split_runs(raw, one.name, spec, mapper.time(raw.columns))
            tables.join(raw, one, pieces)
            for run, inside in pieces:
                result, signals, number, remarks = _columns(mapper, inside)
                told: list[Remark] = []
                for name, rows in split_at_gaps(run, np.asarray(result["time_s"]), spec.runs, told):
                    every = [*raw.remarks, *mapper.remarks, *remarks, *told]
                    logs.append(_finish(mapper, name, _taken(result, rows), _taken(signals, rows), number[rows], every))
                    told = []  # what was left out is told once
        except InputError as error:
            if left_out is None:
                raise
            faults += error.faults
            omitted += [_of_source(fault, one, (str(spec.path), *tables.files)) for fault in error.faults]
    if faults and not logs:
        raise InputError(faults)
    if left_out is not None:
        left_out += omitted
    tables.tell(logs)
    if not logs:
        split = spec.keep or spec.runs.by
        message = (
            "no run is left after 'keep' and 'runs'" if split else "no run of two rows or more, in which time goes on"
        )
        raise InputError.single(message, file=str(given[0]))
    return logs


def _of_source(fault: Fault, source: Source, others: Sequence[str]) -> Fault:
    """A fault of the map, or of a table of runs, as one of the file that does not fit it: it is the file that is left
    out."""
    if fault.file not in others:
        return fault
    at = f"({fault.file}:{fault.line})"
    return replace(fault, file=str(source.path), line=0, column=0, message=f"{fault.message} {at}")


class NotByBlocks(Exception):
    """A table whose rows, or whose times, need others than those near them: it has to be read as a whole."""


_LONG_BYTES, _BLOCK_ROWS = 64_000_000, 200_000


def import_long(path: Path, spec: MapSpec, out: Path) -> LongRun | None:
    """Import a long text table of one run block by block, in bounded memory.

    `out`: parquet file to write. Gives None where the file is short, or has to be imported as a whole: by
    `import_source`. Checks of units and clocks look at the first block only.
    """
    alone = all(c.lag is None and c.average is None and c.differentiate is None for c in spec.columns.values())
    turns = any(c.quaternion is not None and c.give == "heading" for c in spec.columns.values())
    if not alone or turns or spec.files or spec.refresh or spec.step is not None or spec.runs != RunsMap():
        return None
    if not path.is_file() or path.stat().st_size < _LONG_BYTES or reader_of(path).name != "csv":
        return None
    try:
        return write_blocks(checked_blocks(_mapped(path, spec), path), out, lambda run: provenance(run, spec))
    except (NotByBlocks, ValueError):  # Arrow says so where a later block has other columns
        return None


def _mapped(path: Path, spec: MapSpec) -> Iterator[RawTable]:
    """Blocks of a text table in the columns of a map."""
    zero = last = None
    for raw in iter_csv(path, _BLOCK_ROWS, options=table_options(spec)):
        mapper = Mapper(spec, with_names(raw, spec), run_of(path))
        columns, _, number, remarks = _columns(mapper, np.arange(raw.rows))
        time = np.asarray(columns["time_s"])
        if mapper.clock not in ("utc", "own") or not np.isfinite(time).all():
            raise NotByBlocks
        if not len(time):
            continue
        if (np.diff(time) < 0).any() or (last is not None and time[0] < last):
            raise NotByBlocks
        last = float(time[-1])
        told = [*raw.remarks, *(remarks if zero is None or mapper.keep is not None else [])]
        if zero is None:
            told += mapper.remarks
            early = len(time) > 1 and 0.0 <= time[0] <= 1.01 * float(np.median(np.diff(time)))
            zero = 0.0 if early else float(time[0])
        columns["time_s"] = time - zero
        lines = raw.lines if len(number) == raw.rows else lambda _row: 0
        yield RawTable(raw.file, columns, lines, told, raw.first_row)


def _columns(mapper: Mapper, rows: Int64s) -> tuple[dict[str, ColumnData], dict[str, ColumnData], Int64s, list[Remark]]:
    """Columns of the map in the rows that are kept, of the source with the helpers, their rows, and what is said."""
    spec, raw = mapper.spec, mapper.raw
    source = _taken(raw.columns, rows)
    result, helpers = mapper.evaluate(source)
    helpers |= {name: data for name, data in result.items() if name.startswith("_")}
    result = {name: data for name, data in result.items() if name not in helpers}
    if spec.others:
        result |= {name: data for name, data in source.items() if name not in result and name not in spec.signals}
    told = "'{}' is this very word in every row, although the source has a column of that name"
    remarks = [
        Remark("name", name, told.format(column.text), f"as the map says; for the column write {name}: {column.text}")
        for name, column in spec.columns.items()
        if column.text is not None and column.text in raw.columns
    ]
    source |= helpers
    if mapper.keep is not None:
        met = mapper.run(mapper.keep, {**mapper.constants, **result, **source}, len(rows))
        keep = np.nan_to_num(np.asarray(met)) != 0
        if not keep.all():
            left = int((~keep).sum())
            message = f"{left} of {len(keep)} rows do not meet '{spec.keep}'"
            remarks.append(Remark("keep", "", message, "left out, as the map asks", "note", 0, left))
        rows = rows[keep]
        result, source = ({name: data[keep] for name, data in columns.items()} for columns in (result, source))
    return result, source, rows, remarks


def _taken(columns: Mapping[str, ColumnData], rows: Int64s) -> dict[str, ColumnData]:
    """These rows of columns; all of them, in order, without a copy."""
    count = len(next(iter(columns.values()), ()))
    chosen = slice(None) if len(rows) == count and bool((np.diff(rows) == 1).all()) else rows
    return {name: data[chosen] for name, data in columns.items()}


def _finish(
    mapper: Mapper,
    name: str,
    run: dict[str, ColumnData],
    source: dict[str, ColumnData],
    number: Int64s,
    remarks: list[Remark],
) -> Run:
    time = np.asarray(run["time_s"])
    finite = np.flatnonzero(np.isfinite(time))
    late = out_of_order(time[finite], mapper.raw.file, lambda row: mapper.raw.line(int(number[finite[row]])))
    if late is not None:  # before windows and shifts are counted from these times
        remarks.append(late)
        order = np.argsort(time, kind="stable")
        run, source = ({key: data[order] for key, data in columns.items()} for columns in (run, source))
        time, number = time[order], number[order]
    known = time[np.isfinite(time)]
    if len(known) > 1 and not 0.0 <= known[0] <= 1.01 * float(np.median(np.diff(known))):
        run["time_s"] = time = time - known[0]  # a start within a step of zero is the middle of the first interval
    rows = np.diff(number)
    away = rows > 1 if mapper.spec.runs.by and len(rows) and np.median(rows) == 1 else None
    run["time_s"] = time = close_jumps(time, remarks, away=away)
    lines = mapper.raw.lines
    if mapper.spec.refresh or mapper.spec.step is not None:  # before means are taken over the rows of a reset
        remarks += count_on(run, lambda row: mapper.raw.line(int(number[row])))
        if late is None:
            refuse_turns(run, mapper.raw.file, mapper.raw.line(int(number[0])))
    if mapper.spec.refresh:
        run = _one_row_a_refresh(mapper, run, source, remarks)
        number, lines = np.empty(0, dtype=np.int64), lambda _row: 0
    else:
        for key, column in mapper.spec.columns.items():
            if column.lag is not None:
                lag = float(column.lag)
                run[key] = transform.shift_back(run[key], time, lag)
                remarks.append(Remark("clock", key, f"comes {lag:g} s late", "shifted back, as the map asks", "note"))
    if mapper.spec.step is not None:
        step_s, time = float(mapper.spec.step), np.asarray(run["time_s"])
        if (windows := (time[-1] - time[0]) / step_s) > 1000 * len(time):
            told = f"'step' would make {windows:.3g} rows of {len(time)}"
            raise InputError.single(told, file=str(mapper.spec.path), path="step", got=f"{step_s:g} s")
        edges = time[0] - 1e-9 + step_s * np.arange(int((time[-1] - time[0]) // step_s) + 2)
        run = transform.average_windows(run, time, edges[:-1], edges[1:], {})
        run["time_s"] = np.asarray(run["time_s"]) - edges[0]
        number, lines = np.empty(0, dtype=np.int64), lambda _row: 0
    table = RawTable(mapper.raw.file, run, lambda row: lines(int(number[row])) if len(number) else 0, remarks)
    return make_log(table, name)


def _one_row_a_refresh(
    mapper: Mapper, run: dict[str, ColumnData], source: dict[str, ColumnData], remarks: list[Remark]
) -> dict[str, ColumnData]:
    time = np.asarray(run["time_s"])
    start, stop, row = transform.refresh_times([source[name] for name in mapper.spec.refresh], time)
    held = {name: row for name in run if name != "time_s" and mapper.is_held(name)}
    if not len(start):
        told = f"{' and '.join(mapper.spec.refresh)} never changes, so there is no refresh"
        raise InputError.single(told, file=mapper.raw.file)
    columns = mapper.spec.columns
    late = max((float(lag) for name in held if name in columns and (lag := columns[name].lag) is not None), default=0.0)
    short = transform.average_windows(run, time, start - late, stop - late, held)
    short["time_s"] = np.asarray(short["time_s"]) - (start[0] - late)
    usual = float(np.median(stop - start))
    count, names = len(short["time_s"]), ", ".join(mapper.spec.refresh)
    told = f"{len(time)} rows, {count} refreshes of {names} (every {usual:.3g} s)"
    action = "one row for each refresh, the rest averaged over the time before it"
    action += f", {late:g} s earlier (lag)" if late else ""
    remarks.append(Remark("repeated", "", told, action, "note", 0, len(time) - count))
    return short


_HASHED_BYTES = 100_000_000
"""Larger sources are known by their size: their hash would take as long as their import."""


def provenance(log: Run, spec: MapSpec) -> dict[str, str]:
    """Where a log comes from, for the metadata of its file: source and map with their hashes."""
    path = Path(log.source)
    status = path.stat() if path.is_file() else None
    return {
        "missionsim.source": path.name,
        "missionsim.source_bytes": str(status.st_size) if status else "",
        "missionsim.source_sha256": _hash(path, status.st_size, status.st_mtime_ns) if status else "",
        "missionsim.map": spec.path.name,
        "missionsim.map_sha256": spec.sha256,
        "missionsim.run": log.run,
    }


@functools.lru_cache(maxsize=4)
def _hash(path: Path, size: int, _changed_ns: int) -> str:
    """Hash of a source, once for all runs in it."""
    return sha256(path) if size <= _HASHED_BYTES else ""
