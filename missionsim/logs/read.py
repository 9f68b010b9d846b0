"""Logs in: find the format, read, check, repair what is safe, and freeze as `Run`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import PathLike, grouped, sha256
from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.logs import suspect
from missionsim.logs.clean import ELECTRIC, Rows, count_on, fill_missing, order_time
from missionsim.logs.codes import of_one_meter
from missionsim.logs.obstacles import charged_at_rest, check_clock, check_obstacles
from missionsim.logs.raw import RawTable, Remark, battery_power, measured_batteries, merge, missing_columns
from missionsim.logs.readers import Options, is_recording, log_suffixes, not_there, run_of, table_reader
from missionsim.logs.times import TimeAxis
from missionsim.numerals import counted
from missionsim.physics import Bools
from missionsim.runs.run import Run, row_durations

if TYPE_CHECKING:
    from missionsim.inputs.robot import RobotSpec
    from missionsim.logs.blocks import LongRun

_SOURCES = {"power": "power_{}_w", "voltage*current": "current_{}_a", "energy": "energy_{}_wh"}


def read_log(path: PathLike, *, robot: RobotSpec | None = None) -> Run:
    """Read one measured log (CSV or Parquet) and check it.

    Parameters
    ----------
    path : path-like
        A CSV file with a header, or a Parquet file, with the columns of the glossary.
    robot : RobotSpec, optional
        The robot that drove; its batteries, components and top speed sharpen the checks.

    Returns
    -------
    Run
        With `remarks` that say what was wrong and what was done.

    Raises
    ------
    missionsim.errors.InputError
        The file cannot be read, a required column is missing, a cell is not a number, or time restarts.
    """
    raw = read_raw(path)
    axis = TimeAxis()
    axis.apply(raw)
    return replace(make_log(raw, run_of(Path(path)), robot=robot), begin_s=axis.begin_s)


def read_logs(
    paths: Iterable[PathLike] | PathLike,
    *,
    robot: RobotSpec | None = None,
    each: Callable[[Run], Run] | None = None,
    left_out: list[str] | None = None,
) -> list[Run]:
    """Read several logs; a folder stands for every ``.csv``, ``.tsv`` and ``.parquet`` in it, by name.

    Runs of the same name (from two folders) get the folder's name in front. Files of the same content are one run, and
    a remark of it names them. What `each` makes of a log is kept in its place.

    Raises
    ------
    missionsim.errors.InputError
        With the faults of all files at once; where `left_out` is given and some file is good, they are told there, a
        line a file.
    """
    logs: list[Run] = []
    faults: list[Fault] = []
    for path, twins in distinct_logs(paths).items():
        try:
            log = read_log(path, robot=robot)
            log = log if each is None else each(log)
            logs.append(replace(log, remarks=(*log.remarks, same_content(twins))) if twins else log)
        except InputError as error:
            faults.extend(error.faults)
    if faults and (left_out is None or not logs):
        raise InputError(faults)
    if left_out is not None:
        for file, (first, *more) in grouped(faults, lambda fault: fault.file).items():
            told = f" (line {first.line})" * bool(first.line) + f", and {len(more)} faults more" * bool(more)
            left_out.append(f"{run_of(Path(file))}: {first.message}{told}")
    logs = _with_texts(meters_alike(logs))
    names = [log.run for log in logs]
    return [
        replace(log, run=f"{Path(log.source).resolve().parent.name}/{log.run}") if names.count(log.run) > 1 else log
        for log in logs
    ]


def _with_texts(logs: Sequence[Run]) -> list[Run]:
    """The same runs without labels of which none of them has a text; in some, no text counts as a name of its own."""
    labels = [(name, data) for log in logs for name, data in log.columns.items() if isinstance(data, Labels)]
    empty = {name for name, _ in labels} - {name for name, data in labels if data.names}
    return [
        replace(log, columns={name: log.columns[name] for name in log.columns if name not in empty}) if empty else log
        for log in logs
    ]


def meters_alike(logs: Sequence[Run]) -> list[Run]:
    """The same runs, a meter refreshed in each as it is in the others (see `missionsim.logs.codes.of_one_meter`)."""
    found = list(logs)
    for battery in dict.fromkeys(battery for log in logs for battery in log.power_w):
        for kind, source in _SOURCES.items():
            own = [i for i, log in enumerate(found) if log.power_from.get(battery) == kind]
            masks = [found[i].fresh[battery] for i in own]
            if kind == "energy" or len({mask is None for mask in masks}) < 2:
                continue
            column = source.format(battery)
            rows = [(found[i].power_w[battery], found[i].time_s) for i in own]
            for i, mask, was in zip(own, of_one_meter(masks, *zip(*rows, strict=True)), masks, strict=True):
                if mask is was:
                    continue
                told = [one for one in found[i].remarks if (one.kind, one.column) != ("repeated", column)]
                if mask is not None:
                    message = "refreshed as in the other runs, slower than its rows"
                    told.append(Remark("repeated", column, message, "kept; each refresh counts once", "note"))
                found[i] = replace(found[i], fresh={**found[i].fresh, battery: mask}, remarks=tuple(told))
    return found


def find_logs(paths: Iterable[PathLike] | PathLike) -> list[Path]:
    """The files that a list of files and folders stands for, each once, also where its content has several names.
    Raises InputError: a path that does not exist, or a folder without logs."""
    return list(distinct_logs(paths))


def distinct_logs(paths: Iterable[PathLike] | PathLike) -> dict[Path, list[Path]]:
    """As `find_logs`: the first file of each content, with the further files that have the same."""
    given = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    files: dict[Path, None] = {}
    faults = []
    for item in map(Path, given):
        if item.is_dir():
            inside = sorted(
                p for p in item.iterdir() if p.suffix.lower() in log_suffixes() and not p.name.startswith(".")
            )
            if not inside:
                allowed = "files named " + ", ".join(f"*{suffix}" for suffix in log_suffixes())
                told, hint = "the folder holds no log", ""
                if any(is_recording(path) for path in (*item.iterdir(), *item.glob("*/*"))):
                    told = "the folder holds recordings, no logs"
                    hint = f"missionsim import {item} --suggest --out MAP.yaml; then --map MAP.yaml --out LOGS"
                faults.append(Fault(str(item), 0, 0, told, allowed=allowed, hint=hint))
            files.update(dict.fromkeys(inside))
        elif item.exists():
            files[item] = None
        else:
            faults.append(not_there(item))
    if not given:
        faults.append(Fault("", 0, 0, "no log was given", allowed="files or folders"))
    if faults:
        raise InputError(faults)
    sizes = grouped(list(files), lambda path: path.stat().st_size if path.is_file() else -1)
    # only files of one size can be the same, so most are never hashed
    alike = [p for size, same in sizes.items() if size > 0 and len(same) > 1 for p in same]
    content = {p: sha256(p) for p in alike if os.access(p, os.R_OK)}
    groups = grouped(list(files), lambda path: content.get(path, str(path)))
    return {same[0]: same[1:] for same in groups.values()}


def same_content(twins: Sequence[Path]) -> Remark:
    """The remark of a log of which there were copies."""
    names = ", ".join(map(str, twins[:5])) + (f" and {len(twins) - 5} more" if len(twins) > 5 else "")
    # the names stand in what was done, which is told for each log on its own
    return Remark("duplicate", "", "the log was given under several names", f"one measurement, left out: {names}")


def read_raw(path: PathLike) -> RawTable:
    """A table as it stands in its file, without checks of its values; the content decides, not the name. Raises
    InputError: the file cannot be read as a table."""
    reader = table_reader(Path(path))
    assert reader.table is not None
    return reader.table(Path(path), Options(typed=True))


def make_log(
    raw: RawTable,
    run: str,
    *,
    robot: RobotSpec | None = None,
    own: tuple[int, int] | None = None,
    statistics: bool = True,
) -> Run:
    """Check, repair and freeze a table whose columns already have glossary names.

    `run`: name of the run. `robot`: see `read_log`. `own`: rows of `raw` that belong to the result; the others are
    neighbours (blocks of a long file). `statistics`: whether to run the checks that look at the values as a whole
    (units, frozen sensors, clock).
    """
    faults = missing_columns(raw.columns, raw.file, lambda: raw.lines(-1))
    faults += [
        Fault(raw.file, raw.line(0), 0, "this column holds text, not numbers", name)
        for name, data in raw.columns.items()
        if isinstance(data, Labels) and (found := column_of(name)) is not None and found[0].kind != "text"
    ]
    if raw.rows == 0:
        faults.append(Fault(raw.file, raw.lines(-1), 0, "there is a header but no rows", allowed="at least two rows"))
    if faults:
        raise InputError(faults)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers beside all reason are told, not warned of
        rows = Rows(raw, dict(raw.columns), np.arange(raw.rows), list(raw.remarks))
        order_time(rows)
        rows.remarks += count_on(rows.columns, lambda row: raw.line(int(rows.row[row])))
        rows.dt = row_durations(rows.time)
        held = fill_missing(rows, {name for name in rows.columns if name.startswith(ELECTRIC)})
        kinds = measured_batteries(rows.columns)
        if not kinds or len(rows.row) < 2:
            got = "; ".join(f"{r.column}: {r.message}" for r in rows.remarks if r.column.startswith(ELECTRIC))
            message, allowed = "no battery has values in two rows or more", "numbers in watts, or in volts and amperes"
            raise InputError(Fault(raw.file, 0, 0, message, "power_<battery>_w", got, f"{allowed}, or in watt-hours"))
        return _freeze(rows, run, kinds, held, robot, own, statistics)


def _freeze(
    rows: Rows,
    run: str,
    kinds: dict[str, str],
    held: dict[str, Bools],
    robot: RobotSpec | None,
    own: tuple[int, int] | None,
    statistics: bool,
) -> Run:
    batteries, components = (tuple(robot.batteries), tuple(robot.components)) if robot is not None else ((), ())
    measured = {battery: battery_power(rows.columns, battery, kind) for battery, kind in kinds.items()}
    power = {battery: watt for battery, (watt, _) in measured.items()}
    if statistics:
        suspect.check_names(rows, batteries, components)
        limit = robot.body.max_speed if robot is not None else None
        suspect.check_magnitudes(rows, None if limit is None else float(limit), power)
        suspect.check_agreement(rows, kinds)
        suspect.check_order(rows)
        switchable = [name for name in components if robot is not None and not robot.components[name].always_on]
        check_obstacles(rows, switchable)
    repeated = suspect.check_frozen(rows, held)
    fresh = {}
    for battery, kind in kinds.items():
        mask = measured[battery][1]
        if kind == "energy" and mask is not None:
            told = f"the counter moves in {int(mask.sum())} of {len(mask)} rows"
            action = "power is its increment over the time since it moved before"
            rows.remark("repeated", f"energy_{battery}_wh", told, action, "note", count=int((~mask).sum()))
        # of a product the current tells: a voltage drifts between readings, or is too coarse to show them
        fresh[battery] = repeated.get(_SOURCES[kind].format(battery), mask)
    if statistics:
        # a part that is off, or at its full power, is no dead meter and none that is cut off
        most = max(power, key=lambda name: abs(float(power[name].mean())))
        for battery in [name for name in batteries if name in power] or [most]:
            suspect.check_meter(rows, battery, power[battery])
            suspect.check_spikes(rows, battery, power[battery])
    if statistics and "speed_m_s" in rows.columns:
        suspect.check_standstill(rows, next(iter(power.values())) if len(power) == 1 else None)
        check_clock(rows, power)
    assert rows.dt is not None
    for name, data in rows.columns.items():
        if isinstance(data, Labels):
            rows.columns[name] = data.compact()
    driven = ~charged_at_rest(rows, power)
    log = Run(run, rows.columns, rows.dt, power, fresh, kinds, rows.raw.file, tuple(rows.remarks))
    if own is not None:
        driven &= (rows.row >= own[0]) & (rows.row < own[1])
    inside = np.flatnonzero(driven)
    together = len(inside) > 0 and inside[-1] - inside[0] == len(inside) - 1
    if not driven.all():
        log = log.rows_where(slice(inside[0], inside[-1] + 1) if together else driven)
    if rows.whole is None and together:
        return log
    columns, row = rows.whole or (rows.columns, rows.row)
    kept = np.flatnonzero(np.isin(row, rows.row[driven]))
    within = slice(kept[0], kept[-1] + 1) if len(kept) else slice(0)
    return replace(log, whole={name: data[within] for name, data in columns.items()})


def check_log(path: PathLike, *, robot: RobotSpec | None = None) -> list[Fault]:
    """All faults of a log, for ``missionsim validate``: what stops a reading, and what the checks find. Their severity
    is ``error`` where the log is against the contract of the columns, ``warning`` where it is doubtful."""
    path = Path(path)
    try:
        remarks = read_log(path, robot=robot).remarks
    except InputError as error:
        return list(error.faults)
    return [remark.fault(str(path)) for remark in merge(remarks) if remark.severity != "note"]


def describe(logs: Sequence[Run | LongRun], *, notes: bool = False) -> list[str]:
    """The remarks of several logs in words, one line each, the same remark of many runs joined.

    `notes`: whether to tell the harmless ones too.
    """
    found: dict[tuple[str, str, str], list[tuple[str, Remark]]] = {}
    for log in logs:
        for remark in merge(log.remarks):
            if notes or remark.severity != "note":
                found.setdefault((remark.kind, remark.column, remark.action), []).append((log.run, remark))
    lines = []
    for group in found.values():
        run, remark = group[0]
        others = f" (and {counted(len(group) - 1, 'more run')})" if len(group) > 1 else ""
        lines.append(f"{remark.severity}: {run}: {remark}{others}")
    return lines
