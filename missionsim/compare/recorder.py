"""A run's measured and modelled power in bounded memory: neighbouring rows are joined once there are too many."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MAX_BUCKETS = 4096
_ENERGIES = ("measured_j", "model_j")
_LOWS = ("measured_low_w", "error_low_w")
_HIGHS = ("measured_high_w", "error_high_w")


@dataclass
class Series:
    """Buckets of neighbouring rows, one row each for short logs.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        ``start_s`` (since the start of the run), ``seconds``, ``measured_j``, ``model_j`` and the lowest and highest
        measured power and power error (model minus measured) in each bucket [W].
    rows : int
        Rows in a bucket (except the last of a block).
    """

    columns: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    rows: int = 1

    def add(
        self,
        time_s: NDArray[np.float64],
        seconds: NDArray[np.float64],
        measured_w: NDArray[np.float64],
        model_w: NDArray[np.float64],
        segment: NDArray[np.int64] | None = None,
    ) -> None:
        """Append the rows of a block, arrays of shape (n,); `segment` is a code, -1 where there is none."""
        error = model_w - measured_w
        block = {
            "start_s": time_s,
            "seconds": seconds,
            "measured_j": measured_w * seconds,
            "model_j": model_w * seconds,
            "measured_low_w": measured_w,
            "measured_high_w": measured_w,
            "error_low_w": error,
            "error_high_w": error,
            "segment": np.full(len(time_s), -1.0) if segment is None else segment.astype(float),
        }
        while len(time_s) / self.rows > MAX_BUCKETS:
            self.rows *= 2
        block = _join(block, self.rows)
        if self.columns:
            block = {name: np.concatenate([self.columns[name], values]) for name, values in block.items()}
        while len(block["start_s"]) > MAX_BUCKETS:
            block = _join(block, 2)
            self.rows *= 2
        self.columns = block

    @property
    def middle_s(self) -> NDArray[np.float64]:
        """Middle of each bucket [s]."""
        return self.columns["start_s"] + 0.5 * self.columns["seconds"]

    @property
    def progress(self) -> NDArray[np.float64]:
        """Share of the run's time that is over at the end of each bucket."""
        spent = np.cumsum(self.columns["seconds"])
        return np.asarray(spent / spent[-1])

    def power_w(self, which: str) -> NDArray[np.float64]:
        """Mean power of each bucket, `which` of ``measured`` and ``model`` [W]."""
        return self.columns[f"{which}_j"] / np.maximum(self.columns["seconds"], 1e-12)


def _join(columns: dict[str, NDArray[np.float64]], rows: int) -> dict[str, NDArray[np.float64]]:
    if rows == 1:
        return {name: np.array(values, dtype=float) for name, values in columns.items()}
    starts = np.arange(0, len(columns["start_s"]), rows)
    joined = {name: columns[name][starts] for name in ("start_s", "segment")}
    joined |= {"seconds": np.add.reduceat(columns["seconds"], starts)}
    joined |= {name: np.add.reduceat(columns[name], starts) for name in _ENERGIES}
    joined |= {name: np.minimum.reduceat(columns[name], starts) for name in _LOWS}
    joined |= {name: np.maximum.reduceat(columns[name], starts) for name in _HIGHS}
    return joined
