"""``missionsim import``: bags, MCAP, ULog and tables of any layout into logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from missionsim.cli.options import JsonOption, QuietOption

if TYPE_CHECKING:
    from missionsim.logs import LogTable


def import_(
    source: Path,
    /,
    *,
    map_: Annotated[Path | None, Parameter(name="--map")] = None,
    out: Path | None = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
) -> int:
    """Turn a bag, MCAP, ULog or table of any layout into a log with the columns that missionsim reads.

    Without --map, the columns and fields of the source are listed, for writing a map; nothing is written.

    Parameters
    ----------
    source
        A CSV, Parquet or other text table, a ROS 1 bag, a ROS 2 bag (its folder), an MCAP file, a ULog, or a folder of
        such files.
    map_
        The map (YAML, kind: map): which columns the log gets and how.
    out
        LOG.parquet or LOG.csv; a folder where the source holds several runs.
    json
        Write what was read and what was found as JSON to this file, or - for standard output.
    quiet
        Print nothing but what was asked for.
    """
    from missionsim.cli.common import emit_json, shows_text
    from missionsim.errors import InputError

    text = shows_text(json, quiet)
    if map_ is None:
        if out is not None:
            raise InputError.single("--out needs --map", allowed="--map MAP.yaml --out LOG.parquet")
        return _list(source, json, text)
    if out is None:
        raise InputError.single("--out is missing", allowed="--out LOG.parquet, or a folder for several runs")
    from missionsim.importer.mapping import import_source, provenance
    from missionsim.inputs.loading import load_map
    from missionsim.logs.write import write_log

    spec = load_map(map_)
    logs = import_source(source, spec)
    targets = _targets(logs, out)
    _spare_sources(logs, targets)
    for log, target in zip(logs, targets, strict=True):
        write_log(log, target, provenance(log, spec))
    emit_json(
        {
            "schema": "missionsim.import/1",
            "source": str(source),
            "map": str(map_),
            "runs": [_summary(log, target) for log, target in zip(logs, targets, strict=True)],
        },
        json,
    )
    if text:
        _print(logs, targets)
    return 0


def _targets(logs: list[LogTable], out: Path) -> list[Path]:
    """One file a run: `out` itself for a single run, files in it for several or where it is a folder."""
    from missionsim.errors import InputError

    is_file = out.suffix in (".csv", ".parquet") and not out.is_dir()
    if is_file and len(logs) > 1:
        raise InputError.single(
            f"the source holds {len(logs)} runs, and --out is one file", got=str(out), allowed="a folder"
        )
    if is_file:
        return [out]
    if out.suffix and not out.is_dir():
        raise InputError.single(
            "a log is written as CSV or Parquet", got=str(out), allowed="LOG.parquet, LOG.csv or a folder"
        )
    names: dict[str, int] = {}
    targets = []
    for log in logs:
        names[log.run] = names.get(log.run, 0) + 1
        targets.append(out / (f"{log.run}.parquet" if names[log.run] == 1 else f"{log.run}_{names[log.run]}.parquet"))
    return targets


def _spare_sources(logs: list[LogTable], targets: list[Path]) -> None:
    """Refuse to write over what was read: a folder of Parquet files that is read into itself."""
    from missionsim.errors import Fault, InputError

    sources = {Path(log.source).resolve() for log in logs if log.source}
    if faults := [
        Fault("", 0, 0, "--out would overwrite a file that is imported", "", str(target), "another folder")
        for target in targets
        if target.resolve() in sources
    ]:
        raise InputError(faults)


def _summary(log: LogTable, target: Path) -> dict[str, Any]:
    return {
        "run": log.run,
        "file": str(target),
        "rows": log.rows,
        "duration_s": log.duration_s,
        "batteries": {
            name: {"energy_wh": log.energy_wh(name), "power_from": log.power_from[name]} for name in log.batteries
        },
        "columns": list(log.columns),
        "remarks": [
            {
                "kind": r.kind,
                "column": r.column,
                "message": r.message,
                "action": r.action,
                "severity": r.severity,
                "line": r.line,
                "rows": r.count,
            }
            for r in log.remarks
        ],
    }


def _print(logs: list[LogTable], targets: list[Path]) -> None:
    from missionsim.cli.common import console, simple_table
    from missionsim.logs import describe

    rows = [
        (
            log.run,
            log.rows,
            f"{log.duration_s:.1f}",
            ", ".join(f"{name} {log.energy_wh(name):.4g}" for name in log.batteries),
        )
        for log in logs[:20]
    ]
    terminal = console()
    terminal.print(simple_table("Runs", ["run", ("rows", "right"), ("time s", "right"), "energy Wh"], rows))
    if len(logs) > len(rows):
        terminal.print(f"… and {len(logs) - len(rows)} more runs")
    for line in describe(logs, notes=True):
        terminal.print(line, markup=False)
    where = targets[0] if len(targets) == 1 else targets[0].parent
    terminal.print(f"written: {where}" + (f" ({len(targets)} files)" if len(targets) > 1 else ""), markup=False)


def _list(source: Path, json: str | None, text: bool) -> int:
    from missionsim.cli.common import console, emit_json, simple_table
    from missionsim.importer.sources import find_sources, list_fields

    path = find_sources(source)[0]
    fields = list_fields(path)
    emit_json(
        {
            "schema": "missionsim.source/1",
            "source": str(path),
            "fields": [{"name": field.name, "kind": field.kind, "count": field.count} for field in fields],
        },
        json,
    )
    if text:
        rows = [(field.name, field.kind, field.count) for field in fields]
        console().print(
            simple_table(f"{path}: what a map can read", ["column or field", "kind", ("values", "right")], rows)
        )
    return 0
