"""Maps: a file of any layout, of one run or several, into logs in the columns of the glossary."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import Fault, InputError
from missionsim.files import sha256
from missionsim.importer import transform
from missionsim.importer.mapper import Mapper
from missionsim.importer.roles import Field
from missionsim.importer.sources import find_sources, identifier, read_source, table_options, with_names
from missionsim.inputs.log_map import MapSpec, RunsMap
from missionsim.labels import Labels
from missionsim.logs.blocks import LongRun, checked_blocks, write_blocks
from missionsim.logs.formats.delimited import iter_csv
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.logs.read import PathLike, make_log
from missionsim.logs.readers import reader_of
from missionsim.logs.times import close_jumps
from missionsim.physics import Array
from missionsim.runs.run import Run


@dataclass
class Part:
    """Rows of one run in the source, and its name."""

    name: str
    rows: NDArray[np.int64]
    remarks: list[Remark] = field(default_factory=list)


def split_runs(raw: RawTable, stem: str, spec: MapSpec, time_s: Array) -> list[Part]:
    """Rows of each run, in the order in which they begin.

    With ``by``, rows with the same values belong together wherever they stand (two files joined and sorted do not
    break); with ``restart``, a jump of time back by more than a second (or ten steps) begins another run.
    """
    groups = [Part(stem, np.arange(raw.rows))]
    if spec.runs.by:
        groups = _by_columns(raw, stem, spec.runs.by)
    if spec.runs.restart:
        groups = [piece for group in groups for piece in _restarts(group, time_s)]
    return groups


def _by_columns(raw: RawTable, stem: str, names: tuple[str, ...]) -> list[Part]:
    code = np.zeros(raw.rows, dtype=np.int64)
    for name in names:
        data: Any = raw.columns[name]
        _, inverse = np.unique(data.codes if isinstance(data, Labels) else data, return_inverse=True)
        code = code * (int(inverse.max(initial=0)) + 1) + inverse
    _, first, code = np.unique(code, return_index=True, return_inverse=True)
    rows = np.split(np.argsort(code, kind="stable"), np.cumsum(np.bincount(code))[:-1])
    parts = []
    for index in np.argsort(first):
        at = int(first[index])
        words = [_word(raw.columns[name], at) for name in names]
        parts.append(Part(file_name("_".join([stem, *words])), rows[index]))
    return parts


def _word(data: Any, row: int) -> str:
    if isinstance(data, Labels):
        return data.names[data.codes[row]] if data.codes[row] >= 0 else "none"
    return f"{data[row]:g}"


def file_name(text: str) -> str:
    """A text as a name of a file: letters, digits, dot, dash and underscore."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")[:120] or "run"


def _restarts(part: Part, time_s: Array) -> list[Part]:
    time = time_s[part.rows]
    step = np.diff(time)
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    at = np.flatnonzero(step < -max(1.0, 10 * usual)) + 1
    return _numbered(part, np.split(np.arange(len(time)), at)) if len(at) else [part]


def _numbered(part: Part, pieces: list[NDArray[np.int64]]) -> list[Part]:
    width = max(2, len(str(len(pieces) - 1)))
    return [
        Part(f"{part.name}_{index:0{width}d}", part.rows[piece], part.remarks) for index, piece in enumerate(pieces)
    ]


def split_at_gaps(name: str, time_s: Array, runs: RunsMap) -> list[tuple[str, NDArray[np.int64], list[Remark]]]:
    """Pieces of a run between gaps longer than ``runs.gap``; pieces under ``runs.shortest`` are left out and told. What
    was left out is told in the first piece."""
    pieces = [np.arange(len(time_s))]
    if runs.gap is not None:
        pieces = np.split(pieces[0], np.flatnonzero(np.diff(time_s) > float(runs.gap)) + 1)
    shortest = float(runs.shortest) if runs.shortest is not None else 0.0
    long = [piece for piece in pieces if len(piece) >= 2 and time_s[piece[-1]] - time_s[piece[0]] >= shortest]
    left = sum(len(piece) for piece in pieces) - sum(len(piece) for piece in long)
    told = f"{len(pieces) - len(long)} pieces of {name} ({left} rows) are too short"
    remarks = [Remark("gap", "", told, "left out", "note", 0, left)] if left else []
    whole = Part(name, np.arange(len(time_s)))
    named = _numbered(whole, long) if len(pieces) > 1 else [Part(name, piece) for piece in long]
    return [(part.name, part.rows, remarks if index == 0 else []) for index, part in enumerate(named)]


def recognised_runs(fields: Mapping[str, Field], time_s: Array | None, times: set[str]) -> dict[str, str]:
    """How several runs in one table are told apart, for a suggested map: by columns, where time restarts, at gaps.
    Gives ``runs`` → its value as YAML; empty for one run."""
    if time_s is None or len(time_s) < 4:
        return {}
    step = np.diff(time_s)
    usual = float(np.median(np.abs(step)))
    restarts = step < -max(1.0, 10 * usual)
    changes: dict[str, NDArray[np.bool_]] = {}
    for name, one in fields.items():
        values = one.values.codes if isinstance(one.values, Labels) else one.values
        whole = isinstance(one.values, Labels) or (np.isfinite(values).all() and (values == np.round(values)).all())
        if name in times or not whole:
            continue
        change = values[1:] != values[:-1]
        if change.any() and (not restarts.any() or not (change & ~restarts).any()):
            changes[name] = change
    if restarts.any():
        together = np.logical_or.reduce(list(changes.values())) if changes else np.zeros_like(restarts)
        if (together == restarts).all():
            return {"runs": f"{{by: [{', '.join(map(identifier, changes))}]}}  # time begins anew where these change"}
        return {"runs": "{restart: true}  # time begins anew"}
    named = [name for name in changes if re.search(r"run|trip|session|experiment|config|trial", name, re.IGNORECASE)]
    if named:
        return {"runs": f"{{by: [{', '.join(map(identifier, named))}]}}"}
    wide = step > max(60.0, 100 * usual)
    return {"runs": "{gap: 60 s}  # long holes in time"} if wide.any() else {}


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
    for one in find_sources([Path(path) for path in given], spec):
        try:
            raw = read_source(one, spec)
            mapper = Mapper(spec, raw, one.name)
            for part in split_runs(raw, one.name, spec, mapper.time(raw.columns)):
                logs += _logs(mapper, part)
        except InputError as error:
            if left_out is None:
                raise
            faults += error.faults
    if faults and not logs:
        raise InputError(faults)
    if left_out is not None:
        left_out += faults
    if not logs:
        raise InputError.single("no run is left after 'keep' and 'runs'", file=str(given[0]))
    return logs


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
        mapper = Mapper(spec, with_names(raw, spec), path.stem)
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


def _columns(
    mapper: Mapper, rows: NDArray[np.int64]
) -> tuple[dict[str, ColumnData], dict[str, Any], NDArray[np.int64], list[Remark]]:
    """Columns of the map and of the source in the rows that are kept, their numbers, and what is said of it."""
    chosen = _which(rows, mapper.raw.rows)
    source: dict[str, Any] = {name: data[chosen] for name, data in mapper.raw.columns.items()}
    result = mapper.evaluate(source)
    if mapper.spec.others:
        result |= {
            name: data for name, data in source.items() if name not in result and name not in mapper.spec.signals
        }
    remarks = _words_that_are_columns(mapper)
    if mapper.keep is not None:
        values = {**mapper.constants, **result, **mapper.helpers(source, result), **source}
        keep = np.nan_to_num(np.asarray(mapper.run(mapper.keep, values, len(rows)))) != 0
        if not keep.all():
            left = int((~keep).sum())
            told = f"{left} of {len(keep)} rows do not meet '{mapper.spec.keep}'"
            remarks.append(Remark("keep", "", told, "left out, as the map asks", "note", 0, left))
        result, rows = {name: data[keep] for name, data in result.items()}, rows[keep]
        source = {name: data[keep] for name, data in source.items()}
    return result, source, rows, remarks


def _logs(mapper: Mapper, part: Part) -> list[Run]:
    """Logs of one run of the source (several where gaps split it)."""
    result, source, number, remarks = _columns(mapper, part.rows)
    logs = []
    for name, rows, more in split_at_gaps(part.name, np.asarray(result["time_s"]), mapper.spec.runs):
        chosen = _which(rows, len(number))
        run = {key: data[chosen] for key, data in result.items()}
        signals = {key: data[chosen] for key, data in source.items()}
        every = [*mapper.raw.remarks, *mapper.remarks, *part.remarks, *remarks, *more]
        logs.append(_finish(mapper, name, run, signals, number[chosen], every))
    return logs


def _which(rows: NDArray[np.int64], count: int) -> NDArray[np.int64] | slice:
    """Rows to choose; all of them, in order, without a copy."""
    return slice(None) if len(rows) == count and bool((np.diff(rows) == 1).all()) else rows


def _words_that_are_columns(mapper: Mapper) -> list[Remark]:
    """Remarks on `text: name` where the source has a column of that name, which was perhaps meant."""
    told = "'{}' is this very word in every row, although the source has a column of that name"
    action = "as the map says; for the column write {}: {}"
    return [
        Remark("name", name, told.format(column.text), action.format(name, column.text))
        for name, column in mapper.spec.columns.items()
        if column.text is not None and column.text in mapper.raw.columns
    ]


def _finish(
    mapper: Mapper,
    name: str,
    run: dict[str, ColumnData],
    source: dict[str, Any],
    number: NDArray[np.int64],
    remarks: list[Remark],
) -> Run:
    time = np.asarray(run["time_s"])
    if len(time) > 1 and (np.diff(time) < 0).any():
        order = np.argsort(time, kind="stable")
        count = int((np.diff(time) < 0).sum())
        line = mapper.raw.line(int(number[int(np.argmax(np.diff(time) < 0)) + 1]))
        told, action = f"time runs backwards in {count} places", "the rows were sorted by time"
        remarks.append(Remark("time_backwards", "time_s", told, action, "warning", line, count))
        run = {key: data[order] for key, data in run.items()}
        source = {key: data[order] for key, data in source.items()}
        time, number = time[order], number[order]
    if len(time) > 1 and not 0.0 <= time[0] <= 1.01 * float(np.median(np.diff(time))):
        run["time_s"] = time = time - time[0]  # a start within a step of zero is the middle of the first interval
    run["time_s"] = time = close_jumps(time, remarks)
    lags = {key: float(column.lag) for key, column in mapper.spec.columns.items() if column.lag is not None}
    lines = mapper.raw.lines
    if mapper.spec.refresh:
        run = _one_row_a_refresh(mapper, run, source, lags, remarks)
        number, lines = np.empty(0, dtype=np.int64), lambda _row: 0
    else:
        for key, lag in lags.items():
            run[key] = transform.shift_back(run[key], time, lag)
            remarks.append(Remark("clock", key, f"comes {lag:g} s late", "shifted back, as the map asks", "note"))
    if mapper.spec.step is not None:
        run = _averaged(run, float(mapper.spec.step))
        number, lines = np.empty(0, dtype=np.int64), lambda _row: 0
    table = RawTable(mapper.raw.file, run, lambda row: lines(int(number[row])) if len(number) else 0, remarks)
    return make_log(table, name)


def _one_row_a_refresh(
    mapper: Mapper, run: dict[str, ColumnData], source: dict[str, Any], lags: dict[str, float], remarks: list[Remark]
) -> dict[str, ColumnData]:
    time = np.asarray(run["time_s"])
    values = {**source, **{k: v for k, v in mapper.helpers(source, run).items() if k in mapper.spec.refresh}}
    start, stop, row = transform.refresh_times([values[name] for name in mapper.spec.refresh], time)
    held = {name: row for name in run if name != "time_s" and mapper.is_held(name)}
    if not len(start):
        told = f"{' and '.join(mapper.spec.refresh)} never changes, so there is no refresh"
        raise InputError.single(told, file=mapper.raw.file)
    late = max((lags[name] for name in held if name in lags), default=0.0)
    short = transform.average_windows(run, time, start - late, stop - late, held)
    short["time_s"] = np.asarray(short["time_s"]) - (start[0] - late)
    usual = float(np.median(stop - start))
    count, names = len(short["time_s"]), ", ".join(mapper.spec.refresh)
    told = f"{len(time)} rows, {count} refreshes of {names} (every {usual:.3g} s)"
    action = "one row for each refresh, the rest averaged over the time before it"
    action += f", {late:g} s earlier (lag)" if late else ""
    remarks.append(Remark("repeated", "", told, action, "note", 0, len(time) - count))
    return short


def _averaged(run: dict[str, ColumnData], step_s: float) -> dict[str, ColumnData]:
    time = np.asarray(run["time_s"])
    edges = time[0] - 1e-9 + step_s * np.arange(int((time[-1] - time[0]) // step_s) + 2)
    short = transform.average_windows(run, time, edges[:-1], edges[1:], {})
    short["time_s"] = np.asarray(short["time_s"]) - edges[0]
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
