"""Axes along which the error is looked at: sums of time, energy gap and squared error per bin, in one pass.

Numbers are counted on a decimal grid that grows as the data come, so a log of any length is read once and in blocks;
the bins shown at the end are made of whole cells of that grid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from missionsim.effects.covariates import Covariates
from missionsim.labels import Labels
from missionsim.physics import Array, Int64s, f64

MAX_CELLS = 400
"""Cells of a numeric axis before the grid is made ten times coarser."""
WANTED_BINS = 8
THIN_SHARE = 0.005
"""Bins at the ends with less than this share of the time are joined to their neighbour."""


@dataclass(frozen=True)
class Bin:
    """Error within one value or range of a covariate."""

    value: str
    """Name of the value or range."""
    low: float | None
    high: float | None
    """Both: ends of a range, in the axis' unit."""
    seconds: float
    gap_j: float
    """Measured minus modelled energy [J]."""
    square_w2s: float
    """Integral of the squared power error [W² s]."""

    @property
    def bias_w(self) -> float:
        """Mean of model minus measured power [W]."""
        return -self.gap_j / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def spread_w(self) -> float:
        """Standard deviation of the power error within the bin [W]."""
        return math.sqrt(max(self.square_w2s / self.seconds - self.bias_w**2, 0.0)) if self.seconds > 0.0 else 0.0


class _Sums:
    """Sums of weights by cell, a whole number or two, as many as there are cells with rows."""

    def __init__(self, *shape: int) -> None:
        self._cells = np.zeros((0, *shape), dtype=np.int64)
        self._sums: dict[str, Array] = {}

    def _of(self, key: str) -> Array:
        """Sum of a weight in each cell."""
        return self._sums.get(key, np.zeros(len(self._cells)))

    def _counted(self, battery: str) -> dict[str, Array]:
        """Seconds, energy gap and squared error of one battery in each cell."""
        return {what: self._of(f"{battery}:{what}") for what in ("seconds", "gap", "square")}

    def _gather(self, cells: Int64s, sums: Mapping[str, Array]) -> None:
        """Add what lies in some cells."""
        new = np.zeros(len(cells))
        every = {key: np.append(self._of(key), sums.get(key, new)) for key in self._sums | dict(sums)}
        self._cells, self._sums = _joined(np.concatenate([self._cells, cells]), every)

    def _coarsen(self, factor: int) -> None:
        """Make one cell of so many."""
        self._cells, self._sums = _joined(self._cells // factor, self._sums)


class _Axis(_Sums):
    """A covariate whose values have cells."""

    _offset = 0

    def __init__(self, name: str, title: str, unit: str) -> None:
        super().__init__()
        self.name, self.title, self.unit = name, title, unit

    def add(self, cells: Int64s, weights: Mapping[str, Array]) -> None:
        """Add each of the `weights` to the sum of its key in the cells given by `place` for the same rows."""
        met, sums = _by_cell(cells, weights)
        self._gather(met + self._offset, sums)


class NumberAxis(_Axis):
    """A numeric covariate on a decimal grid.

    `name`: glossary name of the covariate; `title`, `unit`: for people; `factor`: from the glossary's unit to `unit`
    (180/π for angles); `magnitude`: whether its absolute value is taken.
    """

    def __init__(self, name: str, title: str, unit: str, factor: float = 1.0, magnitude: bool = False) -> None:
        super().__init__(name, title, unit)
        self._factor, self._magnitude = factor, magnitude
        self._exponent: int | None = None
        self._most = -math.inf

    def place(self, column: ArrayLike | Labels) -> Int64s | None:
        """Cell of each row, counted from the lowest of them, shape (n,); -1 for NaN. Returns None where no row has a
        number, such as where the column is text in this run and a number in others."""
        if isinstance(column, Labels):
            return None
        given: Array = np.asarray(column)
        values = np.abs(given) if self._magnitude else given
        if self._factor != 1.0:
            values = values * self._factor
        low, high = float(np.min(values)), float(np.max(values))
        known = None
        if not (math.isfinite(low) and math.isfinite(high)):
            known = np.isfinite(values)
            if not known.any():
                return None
            low, high = float(values[known].min()), float(values[known].max())
            values = np.where(known, values, low)
        self._most = max(self._most, high)
        if self._exponent is None:
            width = (high - low) / 20.0 if high > low else 0.1 * low
            # bounded, so that the inverse of ten to this power is a number
            self._exponent = max(math.floor(math.log10(abs(width))), -290) if width else 0
        while True:
            width, first, last = 10.0**self._exponent, low, high
            if len(self._cells):
                first, last = min(low, int(self._cells[0]) * width), max(high, (int(self._cells[-1]) + 1) * width)
            if (last - first) / width <= MAX_CELLS:
                break
            self._exponent += 1
            self._coarsen(10)
        scale = 10.0**-self._exponent if self._exponent <= 0 else 1.0 / width
        # a value on a cell's edge, such as 0.3, must not fall below it by rounding
        cells = np.floor(values * scale + 1e-9).astype(np.int64)
        self._offset = math.floor(low * scale + 1e-9)
        cells -= self._offset
        if known is not None:
            cells[~known] = -1
        return cells

    def bins(self, battery: str, wanted: int = WANTED_BINS, thin: float = THIN_SHARE) -> list[Bin]:
        """Bins of a round width, at most `wanted`, in increasing order; empty ones are left out. The first and the last
        end at what was measured, and with less than the share `thin` of the time are joined to their neighbour."""
        filled = self._cells[self._of(f"{battery}:seconds") > 0.0]
        if self._exponent is None or not filled.size:
            return []
        lowest, highest = int(filled[0]), int(filled[-1])
        round_numbers = (step * 10**power for power in range(20) for step in (1, 2, 5))
        multiple = next(m for m in round_numbers if highest // m - lowest // m + 1 <= wanted)
        cell = 10.0**self._exponent
        width, least, most = multiple * cell, lowest * cell, math.ceil(self._most / cell - 1e-9) * cell
        cells, sums = _joined(self._cells // multiple, self._counted(battery))
        cells, totals = cells[sums["seconds"] > 0.0], np.stack(list(sums.values()))[:, sums["seconds"] > 0.0]
        time, limit = totals[0], thin * float(totals[0].sum())
        first, last = 0, len(cells) - 1
        while first < last and time[: first + 1].sum() < limit:
            first += 1
        while last > first and time[last:].sum() < limit:
            last -= 1
        found = []
        for begin, end in itertools.pairwise([0, *range(first + 1, last + 1), len(cells)]):
            ends = max(int(cells[begin]) * width, least), min((int(cells[end - 1]) + 1) * width, most)
            low, high = (float(f"{edge:.10g}") + 0.0 for edge in ends)
            named = f"{low:.10g} to {high:.10g}" if low < high else f"{low:.10g}"
            found.append(Bin(named.replace("-", "−"), low, high, *totals[:, begin:end].sum(axis=1).tolist()))
        return found


class LabelAxis(_Axis):
    """A covariate with names or counts for values (surface, scheme, units switched on, run)."""

    def __init__(self, name: str, title: str) -> None:
        super().__init__(name, title, "")
        self._codes: dict[str, int] = {}

    def place(self, column: ArrayLike | Labels) -> Int64s | None:
        """Code of each row's value, shape (n,); -1 where it is missing."""
        if isinstance(column, Labels):
            table = np.array([self._code(name) for name in column.names] + [-1], dtype=np.int64)
            return table[column.codes]
        values = np.asarray(column, dtype=float)
        known = np.isfinite(values)
        whole = np.round(np.where(known, values, 0.0)).astype(np.int64)
        low, high = int(whole.min()), int(whole.max())
        if high - low > 1000:
            return None
        table = np.full(high - low + 1, -1, dtype=np.int64)
        for value in np.flatnonzero(np.bincount(whole - low)) + low:
            table[value - low] = self._code(str(value))
        return np.where(known, table[whole - low], -1)

    def bins(self, battery: str, *_: float) -> list[Bin]:
        """One bin per value, in order of appearance (numbers in increasing order)."""
        rows = np.stack(list(self._counted(battery).values()), axis=1).tolist()
        found = {self.names[code]: sums for code, sums in zip(self._cells.tolist(), rows, strict=True) if sums[0] > 0.0}
        return [Bin(name, None, None, *found[name]) for name in sorted(found, key=_natural)]

    @property
    def names(self) -> tuple[str, ...]:
        """The values seen, by code."""
        return tuple(self._codes)

    def _code(self, name: str) -> int:
        return self._codes.setdefault(name, len(self._codes))


Axis = NumberAxis | LabelAxis


def _by_cell(cells: Int64s, weights: Mapping[str, Array]) -> tuple[Int64s, dict[str, Array]]:
    """Cells with rows, in order, and the sum of each weight in them; rows with cell -1 are left out."""
    low, high = int(cells.min()), int(cells.max())
    if low == high:
        # one value in the whole block, as for most columns of a long log: no need to count
        return (
            (cells[:1], {key: values.sum()[None] for key, values in weights.items()}) if low >= 0 else (cells[:0], {})
        )
    met = np.flatnonzero(np.bincount(cells + 1)[1:])
    return met, {key: f64(np.bincount(cells + 1, values))[1 + met] for key, values in weights.items()}


def _natural(name: str) -> tuple[int, float, str]:
    try:
        return (0, float(name), name)
    except ValueError:
        return (1, 0.0, "")


MAX_SIDE = 60
"""Cells along the longer side of the map before they are made twice as wide."""
FIRST_CELL_M = 0.0625


@dataclass(frozen=True, kw_only=True)
class PlaceCell(Bin):
    """Error within one square of the floor, with its centre and width."""

    x_m: float
    y_m: float
    width_m: float


class PlaceGrid(_Sums):
    """Sums per cell of a grid that coarsens as the robot drives."""

    def __init__(self) -> None:
        super().__init__(2)
        self.width_m = FIRST_CELL_M

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
            self._coarsen(2)
        met, sums = _by_cell((cells[0] - low[0]) * sides[1] + (cells[1] - low[1]), weights)
        self._gather(np.stack(np.divmod(met, sides[1]), axis=1) + low, sums)

    def cells(self, battery: str, blocks: int = 1) -> list[PlaceCell]:
        """Visited cells of one battery; `blocks` by `blocks` cells of the grid make one."""
        cells, sums = _joined(self._cells // blocks, self._counted(battery))
        width = self.width_m * blocks
        found = []
        for at, *totals in zip(cells.tolist(), *(sum_of.tolist() for sum_of in sums.values()), strict=True):
            x, y = ((number + 0.5) * width for number in at)
            value = f"x {x:.4g} m, y {y:.4g} m".replace("-", "−")
            found.append(PlaceCell(value, None, None, *totals, x_m=x, y_m=y, width_m=width))
        return [cell for cell in found if cell.seconds > 0.0]

    def coarse_cells(self, battery: str) -> list[PlaceCell]:
        """Cells so wide that about eight by eight cover the map."""
        side = int(np.ptp(self._cells, axis=0).max()) + 1 if len(self._cells) else 0
        return self.cells(battery, max(1, -(-side // 8)))


def _joined(cells: Int64s, sums: Mapping[str, Array]) -> tuple[Int64s, dict[str, Array]]:
    """Each cell once, in order, with the sums of all that are the same."""
    found, which = np.unique(cells, axis=0, return_inverse=True)
    return found, {key: f64(np.bincount(which.ravel(), values)) for key, values in sums.items()}
