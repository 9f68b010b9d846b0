"""Tables that programs keep in forms of their own: Arrow's, MATLAB's, NumPy's; and cells that hold several values."""

from __future__ import annotations

import collections
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.files import unreadable
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark, from_arrow, leave_out_codes, number_of
from missionsim.logs.readers import Options, Reader

if TYPE_CHECKING:
    import pyarrow as pa


_LIST = re.compile(r"\s*\[[-+.\deE,\snaN]*\]\s*\Z")
MOST_ELEMENTS = 16


def flattened(table: pa.Table) -> pa.Table:
    """The same table, the fields of nested columns as ``column.field``."""
    import pyarrow as pa

    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def elements(name: str) -> list[str]:
    """What the elements of a list in the cells of a column are called."""
    return [f"{name}[{index}]" for index in range(MOST_ELEMENTS)]


def with_elements(raw: RawTable) -> RawTable:
    """The same table with the elements of lists of numbers that stand in cells (``"[0.3, 0.0]"``) as columns."""
    for name, data in list(raw.columns.items()):
        if not isinstance(data, Labels) or not data.names or not all(map(_LIST.match, data.names)):
            continue
        rows = [re.split(r"[,\s]+", word.strip()[1:-1].strip(" ,\n")) for word in data.names]
        least = min(map(len, rows))
        table = np.array([[number_of(cell) for cell in row[:least]] for row in rows] + [[np.nan] * least])
        del raw.columns[name]
        for column, values in zip(elements(name), table.T, strict=False):
            raw.columns[column] = values[data.codes]
    return raw


_ALONE = "np.savez(FILE, t=…, v=…, power=…), or np.savetxt(FILE, …, header='t v power')"


def read_feather(path: Path, options: Options) -> RawTable:
    """Read an Arrow file. Raises InputError: damaged."""
    import pyarrow as pa

    with unreadable("the Arrow file cannot be read", str(path), "a whole Feather (version 2) or Arrow file"):
        table = flattened(pa.ipc.open_file(pa.memory_map(str(path))).read_all())
    return _finished(from_arrow(table, str(path)), options)


def read_matlab(path: Path, options: Options) -> RawTable:
    """Read the vectors of one length in a MATLAB file, those of structures as ``name.field``. Raises InputError:
    damaged, or no vectors in it (timetables, objects)."""
    from scipy.io import loadmat

    allowed = "a whole file of version 7 (save(…, '-v7'))"
    with unreadable("the MATLAB file cannot be read", str(path), allowed):
        found = loadmat(str(path), simplify_cells=True)
    vectors = dict(_vectors({name: one for name, one in found.items() if not name.startswith("__")}, ""))
    allowed = "numbers or texts in vectors, or fields of structures; of a timetable writetimetable(…, 'run.csv')"
    return _table(path, vectors, options, allowed)


def read_numpy(path: Path, options: Options) -> RawTable:
    """Read arrays of one length that have names (``.npz``), or one of records. Raises InputError: damaged, without
    names, or with objects, which would run code."""
    with unreadable("the NumPy file cannot be read", str(path), "arrays of numbers or texts"):
        loaded = np.load(path, allow_pickle=False)
        arrays = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded.items())
    named: dict[str, object] = {}
    for name, one in arrays.items():
        named |= {field: one[field] for field in one.dtype.names} if one.dtype.names else {name: one}
    if "" in named:
        raise InputError.single("an array without names of its columns", file=str(path), allowed=_ALONE)
    return _table(path, dict(_vectors(named, "")), options, _ALONE)


def _vectors(values: Mapping[str, object], path: str) -> Iterator[tuple[str, ColumnData]]:
    """Vectors of numbers, times or texts by their paths; columns of a matrix as ``name[0]``."""
    for name, one in values.items():
        array = _plain(np.asarray(one)) if not isinstance(one, Mapping) else None
        if isinstance(one, Mapping):
            yield from _vectors(one, f"{path}{name}.")
        elif array is None or array.size < 2:
            continue
        elif array.ndim == 2 and array.dtype.kind in "biuf":
            for index in range(array.shape[1]):
                yield f"{path}{name}[{index}]", array[:, index].astype(np.float64)
        elif array.ndim == 1 and array.dtype.kind in "biuf":
            yield path + name, array.astype(np.float64)
        elif array.ndim == 1 and all(isinstance(text, str) for text in array.tolist()):
            yield path + name, Labels.of(array.tolist())
        else:
            yield path + name, np.empty(0)  # told as one of another length


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """An array as numbers or texts: dates by ISO 8601, durations in seconds; of one row or column as a vector."""
    if array.ndim == 2 and 1 in array.shape:
        array = array.ravel()
    if array.dtype.kind == "M":
        return np.where(np.isnat(array), "", np.datetime_as_string(array))
    if array.dtype.kind == "m":
        return np.asarray(array / np.timedelta64(1, "s"))
    return np.char.decode(array, "utf-8", "replace") if array.dtype.kind == "S" else array


def _table(path: Path, vectors: Mapping[str, ColumnData], options: Options, allowed: str) -> RawTable:
    """The vectors of the length that most have."""
    lengths = collections.Counter(len(one) for one in vectors.values() if len(one))
    if not lengths:
        raise InputError.single("there are no vectors in it", file=str(path), allowed=allowed)
    rows = max(lengths, key=lambda length: (lengths[length], length))
    raw = RawTable(str(path), {name: one for name, one in vectors.items() if len(one) == rows})
    if others := [name for name in vectors if name not in raw.columns]:
        told = f"{', '.join(others[:5])}: no vector of {rows} numbers or texts as the others are"
        raw.remarks.append(Remark("format", "", told, "they were left out", "warning", 0, len(others)))
    return _finished(raw, options)


def _finished(raw: RawTable, options: Options) -> RawTable:
    """With the columns that are wanted."""
    raw.names = tuple(raw.columns)
    raw.columns = {name: one for name, one in raw.columns.items() if options.wants is None or options.wants(name)}
    return raw if options.mixed else leave_out_codes(raw)


READERS = (
    Reader("feather", "Arrow file", (), (b"ARROW1",), table=read_feather, loose=(".feather", ".arrow")),
    Reader("matlab", "MATLAB file", (), (b"MATLAB 5.0",), table=read_matlab, loose=(".mat",)),
    Reader("numpy", "NumPy file", (), (b"\x93NUMPY",), table=read_numpy, loose=(".npz", ".npy"),
           like=re.compile(rb"PK\x03\x04.{26}[^\0/]{1,99}?\.npy", re.DOTALL)),
)  # fmt: skip
