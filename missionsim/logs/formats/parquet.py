"""Parquet into columns, whole or in blocks of row groups."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.files import unreadable
from missionsim.logs.raw import RawTable, from_arrow, measures
from missionsim.logs.readers import Options, Reader


@contextlib.contextmanager
def _open(path: Path) -> Iterator[tuple[Any, list[str]]]:
    """A file and the names of its columns. Raises InputError: not a Parquet file, cut short, or with a column twice."""
    import pyarrow.parquet as parquet

    file = str(path)
    with (
        unreadable("the Parquet file cannot be read", file, "a whole Parquet file"),
        parquet.ParquetFile(file, memory_map=True) as handle,
    ):
        names: list[str] = handle.schema_arrow.names
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError.single(f"the column '{twice[0]}' stands twice", file=file, path=twice[0])
        yield handle, names


def read_parquet(path: Path, options: Options) -> RawTable:
    """Read a whole Parquet file, or the columns that are wanted."""
    with _open(path) as (handle, names):
        raw = from_arrow(handle.read(columns=list(filter(options.wants, names))), str(path))
        raw.names = tuple(names)
        return raw


def iter_parquet(path: Path, rows: int, columns: Sequence[str] | None = None) -> Iterator[RawTable]:
    """Read a Parquet file in blocks of at most `rows` rows, in bounded memory. With `columns`, the batteries' columns
    are read as well."""
    with _open(path) as (handle, names):
        chosen = None if columns is None else [name for name in names if name in columns or measures(name)]
        first = 0
        for batch in handle.iter_batches(batch_size=rows, columns=chosen):
            yield from_arrow(batch, str(path), first_row=first)
            first += batch.num_rows


READERS = (Reader("parquet", "Parquet file", (".parquet",), (b"PAR1",), table=read_parquet, blocks=iter_parquet),)
