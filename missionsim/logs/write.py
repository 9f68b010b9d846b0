"""Logs to files: Parquet or CSV, whole or not at all."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.errors import InputError
from missionsim.files import atomic_write, csv_cell
from missionsim.labels import Labels

if TYPE_CHECKING:
    from missionsim.runs.run import Run


def write_log(log: Run, path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a log; the suffix decides between ``.parquet`` and ``.csv``.

    Parameters
    ----------
    log : Run
    path : Path
        Replaced if it exists.
    metadata : mapping, optional
        Goes into the schema of a Parquet file.

    Raises
    ------
    missionsim.errors.InputError
        Another suffix.
    """
    if path.suffix not in (".csv", ".parquet"):
        got, told = path.suffix or "no suffix", "a log is written as CSV or Parquet"
        raise InputError.single(told, file=str(path), got=got, allowed=".csv, .parquet")
    with atomic_write(path) as temporary:
        if path.suffix == ".parquet":
            _parquet(log, temporary, metadata or {})
        else:
            _csv(log, temporary)


def _parquet(log: Run, path: Path, metadata: Mapping[str, str]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    arrays = {
        name: pa.DictionaryArray.from_arrays(
            pa.array(data.codes, mask=data.codes < 0), pa.array(list(data.names), pa.string())
        )
        if isinstance(data, Labels)
        else pa.array(data)
        for name, data in log.columns.items()
    }
    table = pa.table(arrays).replace_schema_metadata({key.encode(): value.encode() for key, value in metadata.items()})
    parquet.write_table(table, path)


def _csv(log: Run, path: Path) -> None:
    columns = [
        Labels(data.codes, tuple(map(csv_cell, data.names))).texts() if isinstance(data, Labels) else data.tolist()
        for data in log.columns.values()
    ]
    with open(path, "w", encoding="utf-8", newline="") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(map(csv_cell, log.columns))
        writer.writerows(zip(*columns, strict=True))
