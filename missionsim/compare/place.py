"""Where on the map the error arises: sums per square cell of the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Covariates
from missionsim.physics import Array

MAX_SIDE = 60
"""Cells along the longer side of the map before they are made twice as wide."""
FIRST_CELL_M = 0.0625


@dataclass(frozen=True)
class PlaceCell:
    """Error within one square of the floor: its centre, width and sums."""

    x_m: float
    y_m: float
    width_m: float
    seconds: float
    gap_j: float
    square_w2s: float

    @property
    def value(self) -> str:
        """Name of the cell, by its centre."""
        return f"x {self.x_m:.4g} m, y {self.y_m:.4g} m".replace("-", "−")


class PlaceGrid:
    """Sums per cell of a grid that widens and coarsens as the robot drives."""

    def __init__(self) -> None:
        self.width_m = FIRST_CELL_M
        self._origin: NDArray[np.int64] | None = None
        self._sums: dict[str, Array] = {}
        self._shape = (0, 0)

    def add(self, cov: Covariates, weights: Mapping[str, Array]) -> None:
        """Add the `weights` of rows, arrays of shape (n,), at their ``x_m`` and ``y_m``."""
        if "x_m" not in cov or "y_m" not in cov:
            return
        x, y = np.asarray(cov["x_m"], dtype=float), np.asarray(cov["y_m"], dtype=float)
        known = np.isfinite(x) & np.isfinite(y)
        if not known.any():
            return
        if not known.all():
            x, y = x[known], y[known]
            weights = {key: values[known] for key, values in weights.items()}
        while True:
            cells = np.stack([np.floor(x / self.width_m), np.floor(y / self.width_m)]).astype(np.int64)
            low, high = cells.min(axis=1), cells.max(axis=1)
            if self._origin is not None:
                low = np.minimum(low, self._origin)
                high = np.maximum(high, self._origin + np.array(self._shape) - 1)
            if np.all(high - low < MAX_SIDE):
                break
            self._coarsen()
        self._widen(low, high)
        flat = (cells[0] - low[0]) * self._shape[1] + (cells[1] - low[1])
        size = self._shape[0] * self._shape[1]
        for key, values in weights.items():
            sums = self._sums.setdefault(key, np.zeros(self._shape))
            sums += np.bincount(flat, values, minlength=size).reshape(self._shape)

    def cells(self, battery: str, blocks: int = 1) -> list[PlaceCell]:
        """Visited cells of one battery; `blocks` by `blocks` cells of the grid make one."""
        if self._origin is None or f"{battery}:seconds" not in self._sums:
            return []
        width = self.width_m * blocks
        keys = [f"{battery}:{what}" for what in ("seconds", "gap", "square")]
        index = [(np.arange(n) + o) // blocks for n, o in zip(self._shape, self._origin, strict=True)]
        totals: dict[tuple[int, int], Array] = {}
        seconds = self._sums[keys[0]]
        for i, j in np.argwhere(seconds > 0.0):
            place = (int(index[0][i]), int(index[1][j]))
            totals[place] = totals.get(place, np.zeros(3)) + [self._sums[key][i, j] for key in keys]
        return [
            PlaceCell((i + 0.5) * width, (j + 0.5) * width, width, *(float(v) for v in sums))
            for (i, j), sums in sorted(totals.items())
        ]

    def coarse_cells(self, battery: str, wanted: int = 8) -> list[PlaceCell]:
        """Cells so wide that about `wanted` by `wanted` cover the map."""
        blocks = max(1, -(-max(self._shape) // wanted))
        return self.cells(battery, blocks)

    def _coarsen(self) -> None:
        self.width_m *= 2.0
        if self._origin is None:
            return
        origin = self._origin // 2
        pads = [(int(o % 2), int((n + o) % 2)) for n, o in zip(self._shape, self._origin, strict=True)]
        for key, sums in self._sums.items():
            even = np.pad(sums, pads)
            self._sums[key] = even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2]
        self._shape = tuple((n + a + b) // 2 for n, (a, b) in zip(self._shape, pads, strict=True))  # type: ignore[assignment]
        self._origin = origin

    def _widen(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        shape = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
        if self._origin is not None:
            before = self._origin - low
            after = np.array(shape) - before - np.array(self._shape)
            pads = [(int(a), int(b)) for a, b in zip(before, after, strict=True)]
            self._sums = {key: np.pad(sums, pads) for key, sums in self._sums.items()}
        self._origin, self._shape = low, shape
