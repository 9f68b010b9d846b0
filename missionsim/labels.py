"""Text columns as codes; shared by logs, effects and expressions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Labels:
    """A text column as integer codes, so that comparisons cost as much as for numbers."""

    codes: NDArray[np.int64]
    """Index into `names`; -1 where the text is missing. Shape (n,)."""
    names: tuple[str, ...]
    """The distinct texts."""

    @classmethod
    def of(cls, texts: Iterable[object]) -> Labels:
        """Labels of a sequence of texts; None, NaN and empty texts are missing."""
        known: dict[str, int] = {}
        codes = [
            -1 if text is None or text == "" or text != text else known.setdefault(str(text), len(known))
            for text in texts
        ]
        return cls(np.asarray(codes, dtype=np.int64), tuple(known))

    @classmethod
    def joined(cls, parts: Sequence[Labels]) -> Labels:
        """Labels of several columns, one behind the other."""
        names: dict[str, int] = {}
        tables = [[*(names.setdefault(name, len(names)) for name in part.names), -1] for part in parts]
        codes = [np.array(table, dtype=np.int64)[part.codes] for table, part in zip(tables, parts, strict=True)]
        return cls(np.concatenate(codes), tuple(names))

    def equals(self, name: str) -> NDArray[np.bool_]:
        """Where the text is `name`, shape (n,)."""
        if name not in self.names:
            return np.zeros(self.codes.shape, dtype=bool)
        return np.asarray(self.codes == self.names.index(name))

    def texts(self) -> NDArray[np.object_]:
        """The texts themselves, shape (n,); the missing ones are empty."""
        return np.array([*self.names, ""], dtype=object)[self.codes]

    def compact(self) -> Labels:
        """The same texts without names that no row has."""
        used = np.unique(self.codes[self.codes >= 0])
        if len(used) == len(self.names):
            return self
        table = np.full(len(self.names) + 1, -1, dtype=np.int64)
        table[used] = np.arange(len(used))
        return Labels(table[self.codes], tuple(self.names[code] for code in used))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, index: Any) -> Labels:
        return Labels(np.atleast_1d(self.codes[index]), self.names)


ColumnData = NDArray[np.float64] | Labels
"""A column of a run: numbers, or texts as codes."""
