"""Parquet into columns, whole or in blocks of row groups."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.logs.raw import RawTable, from_arrow, measures
from missionsim.logs.readers import Options, Reader


@contextlib.contextmanager
def _open(path: Path, file: str) -> Iterator[Any]:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(str(path), memory_map=True) as handle:
            yield handle
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError, OSError) as error:
        got, allowed = str(error).splitlines()[0][:160], "a whole Parquet file"
        raise InputError.single("the Parquet file cannot be read", file=file, got=got, allowed=allowed) from None


def read_parquet(path: Path, options: Options) -> RawTable:
    """Read a whole Parquet file, or the columns that are wanted. Raises InputError: not a Parquet file, cut short, or
    with a column twice."""
    file = str(path)
    with _open(path, file) as handle:
        names = handle.schema_arrow.names
        _check_names(names, file)
        raw = from_arrow(handle.read(columns=list(filter(options.wants, names))), file, lambda _row: 0)
        raw.names = tuple(names)
        return raw


def iter_parquet(path: Path, rows: int, columns: Sequence[str] | None = None) -> Iterator[RawTable]:
    """Read a Parquet file in blocks of at most `rows` rows, in bounded memory. With `columns`, the batteries' columns
    are read as well."""
    file = str(path)
    with _open(path, file) as handle:
        names = handle.schema_arrow.names
        _check_names(names, file)
        chosen = None if columns is None else [name for name in names if name in columns or measures(name)]
        first = 0
        for batch in handle.iter_batches(batch_size=rows, columns=chosen):
            yield from_arrow(batch, file, lambda _row: 0, first)
            first += batch.num_rows


def _check_names(names: Sequence[str], file: str) -> None:
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise InputError.single(f"the column '{twice[0]}' stands twice", file=file, path=twice[0])


READERS = (Reader("parquet", "Parquet file", (".parquet",), (b"PAR1",), table=read_parquet, blocks=iter_parquet),)
