"""``missionsim import``: bags, MCAP, ULog, ArduPilot logs and tables of any layout into logs."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from missionsim.cli.options import TERMINAL, OutPath, Output
from missionsim.errors import Fault, InputError, visible
from missionsim.files import fields_of, write_text
from missionsim.importer import roles
from missionsim.importer.mapping import import_long, import_source, provenance
from missionsim.importer.roles import folded, guess_all
from missionsim.importer.run_table import table_path
from missionsim.importer.sources import find_files
from missionsim.importer.suggest import suggest_map
from missionsim.inputs import load_robot
from missionsim.inputs.loading import load_map
from missionsim.inputs.log_map import MapSpec
from missionsim.labels import Labels
from missionsim.logs import LogTable, describe
from missionsim.logs.blocks import LongRun, write_log
from missionsim.logs.raw import Remark
from missionsim.numerals import in_wh
from missionsim.report.terminal import console, show_table


def import_(
    *sources: Path,
    map_: Path | None = None,
    out: OutPath | None = None,
    suggest: bool = False,
    robot: str | None = None,
    strict: bool = False,
    to: Output = TERMINAL,
) -> int:
    """Turn bags, MCAP, ULog, ArduPilot logs or tables of any layout into logs with the columns that missionsim reads.

    Without --map, the columns and fields of the source are listed; with --suggest, a first map is written for it.

    Parameters
    ----------
    sources
        CSV, Parquet or other text tables, JSON lines, ROS 1 and ROS 2 bags, MCAP, ULog, ArduPilot logs; a folder of
        such files, or a pattern of names. Several files are joined by time where the map says so (files);
        tables with one row for each value are read by its `long`.
    map_
        The map (YAML, kind: map): which columns the log gets and how.
    out
        LOG.parquet or LOG.csv; a folder where the source holds several runs. With --suggest the map's file.
    suggest
        Write a first map: names, units in them, ranges of values and types of messages are read, and each guess says
        how sure it is.
    robot
        With --suggest: the robot (a shipped name, or a file) whose battery was measured, for the names of the columns
        of battery and components.
    strict
        Refuse everything where a file cannot be read, a recording is damaged or its times are no times, in place of
        leaving it out or mending it.

    Returns
    -------
    int
        0 when everything was read, 1 when a file was left out or has an error that is told (it is damaged, times are
        wrong, units contradict each other), or a suggestion has no power or no time.
    """
    if not sources:
        raise InputError.single("no file was given", allowed="missionsim import FILE…")
    if suggest:
        if map_ is not None:
            raise InputError.single("--suggest writes a map, --map reads one", allowed="one of them")
        return _suggest(sources, out, robot, to)
    if robot is not None:
        raise InputError.single("--robot names the battery of a suggested map", allowed="--suggest --robot ROBOT")
    if map_ is None:
        if out is not None:
            raise InputError.single("--out needs --map", allowed="--map MAP.yaml --out LOG.parquet, or --suggest")
        return _list(sources, to)
    if out is None:
        raise InputError.single("--out is missing", allowed="--out LOG.parquet, or a folder for several runs")

    spec = load_map(map_)
    left_out: list[Fault] = []
    target = out if out.suffix else out / f"{sources[0].stem}.parquet"
    alone = len(sources) == 1 and target.suffix == ".parquet" and not target.is_dir()
    other = alone and target.resolve() != sources[0].resolve()
    if other and (long := import_long(sources[0], spec, target)) is not None:
        return _told([long], [target], (), sources, map_, to)
    logs = import_source(sources, spec, None if strict else left_out)
    if strict and (faulty := [r.fault(log.source) for log in logs for r in log.remarks if _lost(r)]):
        raise InputError(faulty)
    targets = _targets(logs, out)
    _protect(targets, {Path(log.source) for log in logs if log.source}, spec, to)
    for log, target in zip(logs, targets, strict=True):
        write_log(log, target, provenance(log, spec))
    return _told(logs, targets, left_out, sources, map_, to)


def _protect(targets: Sequence[Path], read: set[Path], spec: MapSpec, to: Output) -> None:
    """Refuse to write over a log that was read, as in a folder that is read into itself, or over the table of its runs.
    Raises InputError: with every such path."""
    tables = {table for path in read if (table := table_path(spec, path)) is not None}
    outputs = [("--out", target) for target in targets]
    outputs += [("--json", Path(to.json))] if to.json not in (None, "-") else []
    faults = []
    for name, path in outputs:
        if path.exists() and any(path.samefile(one) for one in read | tables if one.exists()):
            told = f"{name} would overwrite a file that is imported"
            faults.append(Fault("", 0, 0, told, "", str(path), "another folder or name"))
    if faults:
        raise InputError(faults)


def _told(
    logs: Sequence[LogTable | LongRun],
    targets: Sequence[Path],
    left_out: Sequence[Fault],
    sources: Sequence[Path],
    map_: Path,
    to: Output,
) -> int:
    runs = []
    for log, target in zip(logs, targets, strict=True):
        batteries = {n: {"energy_wh": log.energy_wh(n), "power_from": log.power_from[n]} for n in log.batteries}
        remarks = [fields_of(r, "kind column message action severity line") | {"rows": r.count} for r in log.remarks]
        told = {"run": log.run, "file": str(target), **fields_of(log, "rows duration_s"), "batteries": batteries}
        runs.append({**told, "columns": list(log.columns), "remarks": remarks})
    named = {"source": str(sources[0]), "sources": [str(source) for source in sources], "map": str(map_)}
    faults = [dataclasses.asdict(fault) for fault in left_out]
    to.emit({"schema": "missionsim.import/1", **named, "runs": runs, "left_out": faults})
    if to.text:
        rows = []
        for log in logs[:20]:
            energies = ", ".join(f"{name} {in_wh(log.energy_wh(name))}" for name in log.batteries)
            rows.append([log.run, log.rows, f"{log.duration_s:.1f}", energies])
        terminal = console()
        show_table("Runs", ["run", ">rows", ">time s", "energy Wh"], rows)
        if len(logs) > len(rows):
            terminal.print(f"… and {len(logs) - len(rows)} more runs")
        for line in describe(logs, notes=True):
            terminal.print(line)
        where = targets[0] if len(targets) == 1 else targets[0].parent
        terminal.print(f"Written: {where}" + (f" ({len(targets)} files)" if len(targets) > 1 else ""))
    for fault in left_out if to.json != "-" else []:
        print(fault, file=sys.stderr)
    if left_out and to.text:
        names = sorted({fault.file for fault in left_out})
        print(f"left out: {', '.join(names)} ({len(names)} of {len(names) + len({log.source for log in logs})} files)")
    return 1 if left_out or any(remark.severity == "error" for log in logs for remark in log.remarks) else 0


def _lost(remark: Remark) -> bool:
    """Whether an error cannot be seen in the file that is written, so that no later command tells it."""
    return remark.severity == "error" and (remark.kind == "damaged" or remark.column == "time_s")


def _targets(logs: list[LogTable], out: Path) -> list[Path]:
    """One file a run: `out` itself for a single run, files in it for several or where it is a folder."""
    is_file = out.suffix in (".csv", ".parquet") and not out.is_dir()
    if is_file and len(logs) > 1:
        told = f"the source holds {len(logs)} runs, and --out is one file"
        raise InputError.single(told, got=str(out), allowed="a folder")
    if is_file:
        return [out]
    if out.suffix and not out.is_dir():
        allowed = "LOG.parquet, LOG.csv or a folder"
        raise InputError.single("a log is written as CSV or Parquet", got=str(out), allowed=allowed)
    names: dict[str, int] = {}
    targets = []
    for log in logs:
        names[log.run] = names.get(log.run, 0) + 1
        targets.append(out / (f"{log.run}.parquet" if names[log.run] == 1 else f"{log.run}_{names[log.run]}.parquet"))
    return targets


def _list(sources: Sequence[Path], to: Output) -> int:
    paths = find_files(sources)
    listed = []
    for path in paths[:1] if len(sources) == 1 else paths:
        fields = roles.fields_of(path)
        guesses = guess_all(fields)
        shown = sorted(
            (field for field in fields if folded(field) is None),
            key=lambda field: (-guesses[field.name].score if field.name in guesses else 9.0, len(field.name)),
        )
        listed.append((path, fields, shown, guesses))
    kinds = [(one, "text" if isinstance(one.values, Labels) else "number") for one in listed[0][1]]
    told = [{"name": one.name, "kind": kind, "count": one.count} for one, kind in kinds]
    to.emit({"schema": "missionsim.source/1", "source": str(listed[0][0]), "fields": told})
    if not to.text:
        return 0
    terminal = console()
    for path, fields, shown, guesses in listed:
        rows = [
            (field.name, field.count, field.range(), guesses[field.name].words() if field.name in guesses else "")
            for field in shown
        ]
        show_table(f"{path}: what a map can read", ["column or field", ">values", "range", "perhaps"], rows)
        for why in ("constant", "stamp or covariance", "empty", "of a type that is not defined in it"):
            hidden = [field for field in fields if folded(field) == why]
            names = ", ".join(f"{f.name} = {f.range()}" if why == "constant" else f.name for f in hidden[:12])
            if hidden:
                more = f", … ({len(hidden)} in all)" if len(hidden) > 12 else ""
                terminal.print(f"{why}: {names}{more}")
    if len(sources) == 1 and len(paths) > 1:
        more = f", … ({len(paths)} in all)" if len(paths) > 20 else ""
        terminal.print(f"the first of {len(paths)} files; all: {', '.join(p.name for p in paths[:20])}{more}")
    return 0


def _suggest(sources: Sequence[Path], out: Path | None, robot: str | None, to: Output) -> int:
    if out is not None and out.suffix not in (".yaml", ".yml"):
        raise InputError.single("--suggest writes a map", got=str(out), allowed="--out MAP.yaml")
    battery, components = "robot", list[str]()
    if robot is not None:
        spec = load_robot(robot)
        components = [name for name, one in spec.components.items() if not one.always_on]
        battery = spec.motion.battery if spec.motion is not None else next(iter(spec.batteries))
    found = suggest_map(find_files(sources), battery, components)
    if out is not None:
        write_text(out, found.text)
    columns = {name: fields_of(guess, "role field unit sure why") for name, guess in found.columns.items()}
    made = {"map": found.text, "columns": columns, "missing": list(found.missing)}
    to.emit({"schema": "missionsim.suggestion/1", **made, "remarks": list(found.remarks)})
    if to.text and out is None:
        sys.stdout.write(visible(found.text))
    elif to.text:
        for name, guess in found.columns.items():
            print(visible(f"{name:22} {guess.sure:8} {guess.why}"))
        for line in found.remarks:
            print(visible(line))
        to.written(out)
    for line in found.missing:
        print(visible(line), file=sys.stderr)
    return 1 if found.missing else 0
