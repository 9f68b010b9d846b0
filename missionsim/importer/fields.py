"""What a source offers: columns of a table, or fields of the topics of a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData
from missionsim.logs.readers import Options, Reader, Recording, reader_of


@dataclass(frozen=True)
class Field:
    """One column or field that a source offers, with the values that were looked at."""

    name: str
    kind: str
    count: int
    values: ColumnData
    time_s: NDArray[np.float64] | None = None
    title: str = ""

    def range(self) -> str:
        """Lowest and highest value, or the first words."""
        if isinstance(self.values, Labels):
            names = self.values.names[:4]
            return ", ".join(names)[:60] + (", …" if len(self.values.names) > 4 else "")
        known = self.values[np.isfinite(self.values)]
        if not len(known):
            return ""
        low, high = float(known.min()), float(known.max())
        return f"{low:.6g}" if low == high else f"{low:.4g} … {high:.4g}"


def fields_of(path: Path, reader: Reader | None = None, most: int = 20_000) -> list[Field]:
    """What a source holds, for listings and suggestions: columns of a table, or fields of the topics of a recording.

    At most `most` rows or messages of a topic are looked at.
    """
    return list(_fields(path, reader or reader_of(path), most))


def _fields(path: Path, reader: Reader, most: int) -> Iterator[Field]:
    if reader.table is not None:
        raw = reader.table(path, Options(most=most))
        for name, data in raw.columns.items():
            yield Field(name, "number" if isinstance(data, np.ndarray) else "text", len(data), data)
        return
    assert reader.recording is not None
    found: Recording = reader.recording(path, Options(most=most))
    for topic in sorted(found.topics, key=lambda topic: topic.name):
        for name, data in topic.columns.items():
            kind = "number" if isinstance(data, np.ndarray) else "text"
            yield Field(f"{topic.name}.{name}", kind, topic.count or len(data), data, topic.time_s, topic.title)
