"""Logs to files: Parquet or CSV, whole or not at all."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.errors import InputError
from missionsim.files import atomic_write, csv_cell
from missionsim.labels import Labels
from missionsim.logs.raw import Remark, merge

if TYPE_CHECKING:
    import pyarrow as pa

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
            import pyarrow.parquet as parquet

            parquet.write_table(_table(log, metadata or {}), temporary, use_dictionary=_words(log))
        else:
            _csv(log, temporary)


@dataclass
class LongRun:
    """What is known of a run that was written block by block; as in `missionsim.runs.run.Run`."""

    run: str
    source: str
    power_from: Mapping[str, str]
    columns: tuple[str, ...]
    rows: int = 0
    duration_s: float = 0.0
    energies: dict[str, float] = field(default_factory=dict)
    remarks: tuple[Remark, ...] = ()

    @property
    def batteries(self) -> tuple[str, ...]:
        """Names of the batteries that were measured."""
        return tuple(self.power_from)

    def energy_wh(self, battery: str) -> float:
        """What a battery delivered [Wh]."""
        return self.energies[battery]

    def add(self, block: Run) -> None:
        """Count one more block."""
        self.rows += block.rows
        self.duration_s += block.duration_s
        for battery in block.batteries:
            self.energies[battery] = self.energies.get(battery, 0.0) + block.energy_wh(battery)
        self.remarks = tuple(merge([*self.remarks, *block.remarks]))


def write_blocks(blocks: Iterable[Run], path: Path, metadata: Callable[[Run], Mapping[str, str]]) -> LongRun:
    """Write blocks of one run as a Parquet file, whole or not at all; ValueError where their columns differ."""
    import pyarrow.parquet as parquet

    each = iter(blocks)
    first = next(each)
    long = LongRun(first.run, first.source, first.power_from, tuple(first.columns))
    told = metadata(first)
    schema = _table(first, told).schema
    with (
        atomic_write(path) as temporary,
        parquet.ParquetWriter(temporary, schema, use_dictionary=_words(first)) as writer,
    ):
        for block in itertools.chain([first], each):
            writer.write_table(_table(block, told))
            long.add(block)
    return long


def _words(log: Run) -> list[str]:
    """Columns that are worth a dictionary: one of measured numbers takes three times as long to write."""
    return [name for name, data in log.columns.items() if isinstance(data, Labels)]


def _table(log: Run, metadata: Mapping[str, str]) -> pa.Table:
    import pyarrow as pa

    arrays = {
        name: pa.DictionaryArray.from_arrays(
            pa.array(data.codes, mask=data.codes < 0), pa.array(list(data.names), pa.string())
        )
        if isinstance(data, Labels)
        else pa.array(data)
        for name, data in log.columns.items()
    }
    return pa.table(arrays).replace_schema_metadata({key.encode(): value.encode() for key, value in metadata.items()})


def _csv(log: Run, path: Path) -> None:
    columns = [
        Labels(data.codes, tuple(map(csv_cell, data.names))).texts() if isinstance(data, Labels) else data.tolist()
        for data in log.columns.values()
    ]
    with open(path, "w", encoding="utf-8", newline="") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(map(csv_cell, log.columns))
        writer.writerows(zip(*columns, strict=True))
