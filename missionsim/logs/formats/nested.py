"""Columns that hold several values in each cell, as columns of their own: fields of structures, elements of lists."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from missionsim.labels import Labels
from missionsim.logs.raw import RawTable, number_of

if TYPE_CHECKING:
    import pyarrow as pa

_LIST = re.compile(r"\s*\[[-+.\deE,\snaN]*\]\s*\Z")
_MOST_ELEMENTS = 16


def flattened(table: pa.Table) -> pa.Table:
    """The same table, the fields of nested columns as ``column.field``."""
    import pyarrow as pa

    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def elements(name: str) -> list[str]:
    """What the elements of a list in the cells of a column are called."""
    return [f"{name}[{index}]" for index in range(_MOST_ELEMENTS)]


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
