"""Parquet into columns, whole or in blocks of row groups."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.logs.raw import RawTable, from_arrow

MAGIC = b"PAR1"


@contextlib.contextmanager
def _open(path: Path, file: str) -> Iterator[Any]:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(str(path), memory_map=True) as handle:
            yield handle
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError, OSError) as error:
        raise InputError.single(
            "the Parquet file cannot be read",
            file=file,
            got=str(error).splitlines()[0][:160],
            allowed="a whole Parquet file",
        ) from None


def parquet_names(path: Path, file: str) -> tuple[str, ...]:
    """Column names of a Parquet file, without reading its rows."""
    with _open(path, file) as handle:
        return tuple(handle.schema_arrow.names)


def read_parquet(path: Path, file: str) -> RawTable:
    """Read a whole Parquet file.

    Raises
    ------
    missionsim.errors.InputError
        Not a Parquet file, cut short, or with a column twice.
    """
    with _open(path, file) as handle:
        _check_names(handle.schema_arrow.names, file)
        return from_arrow(handle.read(), file, lambda _row: 0)


def iter_parquet(path: Path, file: str, rows: int, columns: Sequence[str] | None = None) -> Iterator[RawTable]:
    """Read a Parquet file in blocks of at most `rows` rows, in bounded memory."""
    with _open(path, file) as handle:
        names = handle.schema_arrow.names
        _check_names(names, file)
        chosen = None if columns is None else [name for name in names if name in columns]
        first = 0
        for batch in handle.iter_batches(batch_size=rows, columns=chosen):
            yield from_arrow(batch, file, lambda _row: 0, first)
            first += batch.num_rows


def _check_names(names: Sequence[str], file: str) -> None:
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise InputError.single(f"the column '{twice[0]}' stands twice", file=file, path=twice[0])
