"""Results as tidy tables and as files: tables, summary, provenance."""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from missionsim.effects.covariates import Labels
from missionsim.engine.outcome import RunResult
from missionsim.files import Json, atomic_write, csv_cell, fields_of, to_json, write_text
from missionsim.inputs.mission import MissionSpec

Table = Mapping[str, Sequence[Any]]
"""Column name → values."""


def tables(result: RunResult) -> dict[str, Table]:
    """All tables of a run.

    Returns
    -------
    dict
        ``intervals`` (time, covariates, mean power of each term and charge), ``segments``, ``energy`` (segment ×
        component × term, cells that add up to the drain), ``summary`` (one row a battery), ``edges`` (one row an edge
        of the map driven).
    """
    made: dict[str, Table] = {
        "intervals": intervals_table(result),
        "segments": segments_table(result),
        "energy": energy_table(result),
        "summary": summary_table(result),
    }
    return made | {"edges": edges_table(result)} if result.edges_driven() else made


def intervals_table(result: RunResult) -> dict[str, Sequence[object]]:
    """One row an interval: start, length, segment, covariates at its start, mean powers [W], charge at its end [Wh]."""
    line = result.timeline
    names = np.array([segment.name for segment in result.segments] or [""], dtype=object)
    table: dict[str, Sequence[object]] = {
        **{name: getattr(line, name).tolist() for name in ("start_s", "duration_s", "segment")},
        "segment_name": names[line.segment].tolist() if len(line) else [],
    }
    for name, column in line.columns.items():
        if name.startswith("starting_") and not np.any(column):
            continue
        table[name] = column.texts().tolist() if isinstance(column, Labels) else np.asarray(column).tolist()
    for battery, components in result.energy_j.items():
        table[f"power_{battery}_w"] = result.power_w(battery).tolist()
        for component, terms in components.items():
            for term, joules in terms.items():
                label = component if term == component else f"{component}_{term}"
                table[f"power_{battery}_{label}_w"] = (joules / line.duration_s).tolist()
        table[f"charge_{battery}_wh"] = np.asarray(result.charge_wh[battery]).tolist()
    return table


def segments_table(result: RunResult) -> dict[str, Sequence[object]]:
    """One row a segment: time, distance, energy and charge of each battery, and what coming home from its end takes.

    `reserve_<battery>_wh` is the charge at the end less the energy home (Parasuraman 2012, Eq. 13); energy home and
    reserve are None where no way home is known.
    """
    line = result.timeline
    count = len(result.segments)
    duration = np.bincount(line.segment, weights=line.duration_s, minlength=count)
    distance = np.bincount(line.segment, weights=line.ways_m(), minlength=count)
    passed = result.places_passed()
    end = [result.segment_end_s.get(i) for i in range(count)]
    table: dict[str, Sequence[object]] = {
        "segment": list(range(count)),
        "segment_name": [segment.name for segment in result.segments],
        "kind": [segment.kind for segment in result.segments],
        "line": [segment.line for segment in result.segments],
        "way": [" → ".join(passed.get(i, ())) for i in range(count)],
        "end_s": end,
        "duration_s": duration.tolist(),
        "distance_m": distance.tolist(),
    }
    home = result.home_energy()
    times = np.array([0.0 if t is None else t + 1e-9 * max(1.0, abs(t)) for t in end])
    ended = np.searchsorted(line.start_s + line.duration_s, times, side="right")
    for battery in result.batteries:
        charge = [result.batteries[battery].initial_wh, *np.asarray(result.charge_wh[battery]).tolist()]
        known = len(charge) == len(line) + 1
        left = [None if t is None or not known else charge[i] for t, i in zip(end, ended, strict=True)]
        homes = [entry.get(battery) for entry in home]
        table[f"energy_{battery}_wh"] = result.by_segment_wh(battery).tolist()
        table[f"charge_{battery}_wh"] = left
        table[f"home_{battery}_wh"] = homes
        table[f"reserve_{battery}_wh"] = [
            None if wh is None or way is None else wh - way for wh, way in zip(left, homes, strict=True)
        ]
    return table


def energy_table(result: RunResult) -> dict[str, Sequence[object]]:
    """One row a cell: segment × battery × component × term, with its energy [Wh]; the cells add up to the drain."""
    names = ("segment", "segment_name", "battery", "component", "term", "energy_wh")
    columns: list[list[Any]] = [[] for _ in names]
    segments = [segment.name for segment in result.segments]
    rows = len(segments)
    for battery in result.batteries:
        for key, cells in result.cells_wh(battery).items():
            same = ([text] * rows for text in (battery, key.component, key.name))
            for column, values in zip(columns, (range(rows), segments, *same, cells.tolist()), strict=True):
                column.extend(values)
    return dict(zip(names, columns, strict=True))


def summary_table(result: RunResult) -> dict[str, Sequence[object]]:
    """One row a battery."""
    rows = [vars(battery) for battery in result.batteries.values()]
    same = fields_of(result, "mission robot feasible duration_s distance_m")
    table: dict[str, Sequence[object]] = {name: [value] * len(rows) for name, value in same.items()}
    for name in rows[0] if rows else ():
        table["battery" if name == "name" else name] = [row[name] for row in rows]
    return table


def edges_table(result: RunResult) -> dict[str, Sequence[object]]:
    """One row an edge of the map driven: from where to where, when, energy and charge at its end of each battery."""
    edges = result.edges_driven()
    keys = ("segment", "name", "edge", "begin", "end", "length_m", "begin_s", "end_s")
    table: dict[str, Sequence[object]] = {key: [getattr(edge, key) for edge in edges] for key in keys}
    for battery in result.batteries:
        table[f"energy_{battery}_wh"] = [edge.energy_wh[battery] for edge in edges]
        table[f"charge_{battery}_wh"] = [edge.charge_wh[battery] for edge in edges]
    return table


def largest_consumers(result: RunResult) -> list[tuple[str, str, float, float]]:
    """The three largest consumers of all batteries: battery, component, energy [Wh] and share of all energy."""
    rows = [(battery, *row) for battery in result.batteries for row in result.by_component_wh(battery).items()]
    total = sum(battery.energy_wh for battery in result.batteries.values())
    largest = sorted(rows, key=lambda row: -row[2])[:3]
    return [(b, c, energy, energy / total if total else 0.0) for b, c, energy in largest]


Format = Literal["csv", "parquet"]


def write_results(result: RunResult, folder: str | Path, format: Format = "csv") -> list[Path]:
    """Write all tables of a run, ``run.json`` and ``provenance.json`` into a folder.

    Parameters
    ----------
    folder : path-like
        Made if it is not there.
    format : str
        ``csv`` or ``parquet``.

    Returns
    -------
    list of Path
        What was written.
    """
    folder = Path(folder)
    written = [write_table(table, folder / f"{name}.{format}") for name, table in tables(result).items()]
    for name, data in (("run", result.summary()), ("provenance", dict(result.provenance))):
        path = folder / f"{name}.json"
        write_text(path, to_json(data))
        written.append(path)
    return written


TABLES = (".csv", ".parquet")
"""How the name of a table may end."""


def write_table(table: Table, path: str | Path) -> Path:
    """Write a table as CSV or Parquet by the suffix of its name; None becomes an empty cell (CSV) or null."""
    path = Path(path)
    with atomic_write(path) as temporary:
        if path.suffix == ".parquet":
            import pyarrow
            import pyarrow.parquet

            columns = {name: pyarrow.array(list(values)) for name, values in table.items()}
            pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
        else:
            with temporary.open("w", newline="", encoding="utf-8") as handle:
                writer = csv.writer(handle, lineterminator="\n")
                writer.writerow(map(csv_cell, table))
                writer.writerows(zip(*(_cells(values) for values in table.values()), strict=True))
    return path


def provenance(mission: MissionSpec, command: Sequence[str] = ()) -> Json:
    """Where a result comes from: files with their hashes, what the command line set, versions, command line. `command`:
    the command line, if there was one."""
    from missionsim import __version__

    files = {"mission": mission, "robot": mission.robot, "environment": mission.environment}
    versions = {"missionsim": __version__, "python": ".".join(map(str, sys.version_info[:3]))}
    for name in ("simpy", "numpy"):
        module = sys.modules.get(name)
        versions[name] = str(getattr(module, "__version__", "")) if module else ""
    return {
        "files": {
            kind: {"name": spec.name, "path": _tidy(spec.path), "sha256": spec.sha256}
            for kind, spec in files.items()
            if spec is not None
        },
        "set": dict(mission.overrides),
        "versions": versions,
        "command": list(command),
    }


def _tidy(path: Path) -> str:
    """A path without ``..``, where that is the same file (a link may make it another)."""
    short = os.path.normpath(path)
    return short if os.path.exists(short) and os.path.samefile(short, path) else str(path)


def _cells(values: Sequence[Any]) -> Sequence[Any]:
    kinds = set(map(type, values))
    if kinds <= {float, int, bool} and not np.isnan(values).any():
        return values
    if kinds == {str}:
        texts = {value: csv_cell(value) for value in set(values)}
        return list(map(texts.__getitem__, values))
    return ["" if value is None or value != value else csv_cell(value) for value in values]
