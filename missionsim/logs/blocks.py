"""Logs of any length in bounded memory, block by block and each checked like a whole log; and logs to files."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import PathLike, atomic_write, csv_cell
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark, merge
from missionsim.logs.read import make_log, read_log
from missionsim.logs.readers import table_reader
from missionsim.logs.times import TimeAxis
from missionsim.runs.run import Run

if TYPE_CHECKING:
    import pyarrow as pa

    from missionsim.inputs.robot import RobotSpec


def iter_blocks(
    path: PathLike, *, rows: int = 500_000, columns: Sequence[str] | None = None, robot: RobotSpec | None = None
) -> Iterator[Run]:
    """Read a long log in blocks, in bounded memory: each block is a `Run`, together they are the whole log.

    Parameters
    ----------
    rows : int
        Rows of a block (CSV: at least; the last block may be shorter).
    columns : sequence of str, optional
        Parquet columns to read; all by default. `time_s` and the batteries' columns are always read.
    robot : RobotSpec, optional
        See `read_log`.

    Yields
    ------
    Run
        Time, durations and energy differences at the edges take the neighbouring rows into account. Checks of units
        and clocks look at the first block only.

    Raises
    ------
    missionsim.errors.InputError
        As `read_log`; time that runs backwards from one block to the next.
    """
    path = Path(path)
    reader = table_reader(path)
    if reader.blocks is None:
        yield read_log(path, robot=robot)
        return
    wanted = None if columns is None else sorted({"time_s", *columns})
    yield from checked_blocks(reader.blocks(path, rows, wanted), path, robot)


_EDGE = 64
"""Rows taken from the neighbouring blocks: enough to see a refresh and the step of time."""


def checked_blocks(blocks: Iterator[RawTable], path: Path, robot: RobotSpec | None = None) -> Iterator[Run]:
    """Check tables that follow each other like one log; see `iter_blocks`."""
    axis = TimeAxis()
    before: RawTable | None = None
    current: RawTable | None = None
    for after in itertools.chain(blocks, (None,)):
        if after is not None:
            axis.apply(after)
        if current is not None:
            lead = min(_EDGE, before.rows) if before is not None else 0
            if before is not None and "time_s" in before.columns and "time_s" in current.columns:
                end, times = np.nanmax(np.asarray(before.columns["time_s"])), np.asarray(current.columns["time_s"])
                if end > np.nanmax(times):
                    told = f"time runs backwards, from {end:.6g} s to {times[0]:.6g} s"
                    allowed = "increasing times, one run a file"
                    raise InputError(Fault(current.file, current.line(0), 0, told, "time_s", allowed=allowed))
            edges = ((before, slice(-lead, None)), (current, slice(None)), (after, slice(_EDGE)))
            own = (lead, lead + current.rows)
            # without a name, so that it does not stay while the block is used
            yield make_log(_beside(current, edges, lead), path.stem, robot=robot, own=own, statistics=before is None)
            before = current
        current = after
    if before is None:
        raise InputError(Fault(str(path), 0, 0, "there is a header but no rows", allowed="at least two rows"))


def _beside(table: RawTable, edges: Sequence[tuple[RawTable | None, slice]], lead: int) -> RawTable:
    """A block with the rows of its neighbours, so many before it."""
    parts = [(one.columns, rows) for one, rows in edges if one is not None]
    columns = {name: _join([given[name][rows] for given, rows in parts]) for name in table.columns}
    return RawTable(table.file, columns, table.lines, table.remarks, table.first_row - lead)


def _join(parts: list[ColumnData]) -> ColumnData:
    if not any(isinstance(part, Labels) for part in parts):
        return np.concatenate([np.asarray(part) for part in parts])
    return Labels.joined([part if isinstance(part, Labels) else Labels.of([None] * len(part)) for part in parts])


def write_log(log: Run, path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a log, with the rows that were left out within it; the suffix decides between ``.parquet`` and ``.csv``.

    Parameters
    ----------
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
            return
        columns = [
            Labels(data.codes, tuple(map(csv_cell, data.names))).texts() if isinstance(data, Labels) else data.tolist()
            for data in (log.whole or log.columns).values()
        ]
        with open(temporary, "w", encoding="utf-8", newline="") as handle:
            writer = csv.writer(handle, lineterminator="\n")
            writer.writerow(map(csv_cell, log.columns))
            writer.writerows(zip(*columns, strict=True))


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
            long.rows += block.rows
            long.duration_s += block.duration_s
            for battery in block.batteries:
                long.energies[battery] = long.energies.get(battery, 0.0) + block.energy_wh(battery)
            long.remarks = tuple(merge([*long.remarks, *block.remarks]))
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
        for name, data in (log.whole or log.columns).items()
    }
    return pa.table(arrays).replace_schema_metadata({key.encode(): value.encode() for key, value in metadata.items()})
