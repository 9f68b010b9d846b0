"""Results as files: CSV or Parquet tables, JSON summary and provenance; each written whole or not at all."""

from __future__ import annotations

import csv
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from missionsim.engine.outcome import RunResult
from missionsim.files import atomic_write, csv_cell, write_text
from missionsim.results.tables import Table, tables

if TYPE_CHECKING:
    from missionsim.inputs.mission import MissionSpec

Format = Literal["csv", "parquet"]


def write_results(result: RunResult, folder: str | Path, format: Format = "csv") -> list[Path]:
    """Write all tables of a run, ``run.json`` and ``provenance.json`` into a folder.

    Parameters
    ----------
    result : RunResult
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
        write_text(path, json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n")
        written.append(path)
    return written


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


def provenance(mission: MissionSpec, command: Sequence[str] = ()) -> dict[str, Any]:
    """Where a result comes from: files with their hashes, what the command line set, versions, command line.

    Parameters
    ----------
    mission : MissionSpec
    command : sequence of str
        The command line, if there was one.
    """
    from missionsim import __version__

    files = {"mission": mission, "robot": mission.robot, "environment": mission.environment}
    versions = {"missionsim": __version__, "python": ".".join(map(str, sys.version_info[:3]))}
    for name in ("simpy", "numpy"):
        module = sys.modules.get(name)
        versions[name] = str(getattr(module, "__version__", "")) if module else ""
    return {
        "files": {
            kind: {"name": spec.name, "path": _tidy(spec.path), "sha256": spec.sha256}
            for kind, spec in files.items() if spec is not None
        },
        "set": dict(mission.overrides),
        "versions": versions,
        "command": list(command),
    }


def _tidy(path: Path) -> str:
    """A path without ``..``, where that is the same file (a link may make it another)."""
    short = os.path.normpath(path)
    return short if os.path.exists(short) and os.path.samefile(short, path) else str(path)


def _cells(values: Sequence[Any]) -> list[Any]:
    return ["" if value is None or value != value else csv_cell(value) for value in values]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.tolist() if hasattr(value, "tolist") else value
