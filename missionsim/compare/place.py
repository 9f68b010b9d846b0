"""Where on the map the error arises: sums per square cell of the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.compare.axes import sums_by
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
    """Sums per cell of a grid that coarsens as the robot drives."""

    def __init__(self) -> None:
        self.width_m = FIRST_CELL_M
        self._cells = np.zeros((0, 2), dtype=np.int64)
        self._sums: dict[str, Array] = {}

    def add(self, cov: Covariates, weights: Mapping[str, Array]) -> None:
        """Add the `weights` of rows, arrays of shape (n,), at their ``x_m`` and ``y_m``."""
        if "x_m" not in cov or "y_m" not in cov:
            return
        at = np.stack([np.asarray(cov["x_m"], dtype=float), np.asarray(cov["y_m"], dtype=float)])
        known = np.isfinite(at).all(axis=0)
        if not known.any():
            return
        if not known.all():
            at, weights = at[:, known], {key: values[known] for key, values in weights.items()}
        while True:
            cells = np.floor(at / self.width_m).astype(np.int64)
            ends = np.concatenate([self._cells, [cells.min(axis=1), cells.max(axis=1)]])
            low, sides = ends.min(axis=0), np.ptp(ends, axis=0) + 1
            if sides.max() <= MAX_SIDE:
                break
            self.width_m *= 2.0
            self._cells, self._sums = _joined(self._cells // 2, self._sums)
        flat = (cells[0] - low[0]) * sides[1] + (cells[1] - low[1])
        met = np.flatnonzero(np.bincount(flat))
        fresh = {key: sums_by(flat, values)[met] for key, values in weights.items()}
        before, new = np.zeros(len(self._cells)), np.zeros(len(met))
        sums = {k: np.append(self._sums.get(k, before), fresh.get(k, new)) for k in (self._sums | fresh)}
        met_cells = np.stack(np.divmod(met, sides[1]), axis=1) + low
        self._cells, self._sums = _joined(np.concatenate([self._cells, met_cells]), sums)

    def cells(self, battery: str, blocks: int = 1) -> list[PlaceCell]:
        """Visited cells of one battery; `blocks` by `blocks` cells of the grid make one."""
        keys = [f"{battery}:{what}" for what in ("seconds", "gap", "square")]
        if keys[0] not in self._sums:
            return []
        cells, sums = _joined(self._cells // blocks, {key: self._sums[key] for key in keys})
        width = self.width_m * blocks
        rows = zip(cells.tolist(), *(sums[key].tolist() for key in keys), strict=True)
        return [
            PlaceCell((i + 0.5) * width, (j + 0.5) * width, width, seconds, gap, square)
            for (i, j), seconds, gap, square in rows
            if seconds > 0.0
        ]

    def coarse_cells(self, battery: str, wanted: int = 8) -> list[PlaceCell]:
        """Cells so wide that about `wanted` by `wanted` cover the map."""
        side = int(np.ptp(self._cells, axis=0).max()) + 1 if len(self._cells) else 0
        return self.cells(battery, max(1, -(-side // wanted)))


def _joined(cells: NDArray[np.int64], sums: Mapping[str, Array]) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Each cell once, in order, with the sums of all that are the same."""
    found, which = np.unique(cells, axis=0, return_inverse=True)
    return found, {key: sums_by(which.ravel(), values) for key, values in sums.items()}
