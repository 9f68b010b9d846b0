"""What is kept of each run, row by row, while many runs are evaluated as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.outcome import J_PER_WH
from missionsim.uncertainty.single import PROGRESS_POINTS

Array = NDArray[np.float64]
_OF_BATTERY = ("energy", "charge_left", "margin", "needed")


class RunTable:
    """Results of `count` runs.

    Parameters
    ----------
    batteries : tuple of str
    components : tuple of (battery, component)
    count : int

    Attributes
    ----------
    numbers : ndarray, shape (rows, count)
        Duration [s], distance [m], then energies [J]: see `row` and `part`.
    charge : ndarray, shape (batteries, instants, count)
        In J.
    below : ndarray of bool, shape (batteries, count)
        Whether a battery ends below its reserve.
    again : ndarray of bool, shape (count,)
        Whether a battery comes to a threshold on the way, so that the run needs SimPy.
    limited : ndarray of bool, shape (count,)
        Whether a drawn speed is above what the robot can do.
    """

    def __init__(self, batteries: tuple[str, ...], components: tuple[tuple[str, str], ...], count: int) -> None:
        self.batteries, self.count = batteries, count
        first = 2 + len(_OF_BATTERY) * len(batteries)
        self._part = {key: first + i for i, key in enumerate(components)}
        self.numbers = np.zeros((first + len(components), count))
        self.charge = np.empty((len(batteries), PROGRESS_POINTS, count))
        self.below = np.zeros((len(batteries), count), dtype=bool)
        self.again = np.zeros(count, dtype=bool)
        self.limited = np.zeros(count, dtype=bool)

    def row(self, battery: int, quantity: str) -> int:
        """Row of ``energy``, ``charge_left``, ``margin`` or ``needed`` of a battery."""
        return 2 + len(_OF_BATTERY) * battery + _OF_BATTERY.index(quantity)

    @property
    def part(self) -> Mapping[tuple[str, str], int]:
        """Row of the energy of each component of each battery."""
        return self._part

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of a block, as `missionsim.uncertainty.single` has them; ends the table."""
        self.numbers[2:] *= 1.0 / J_PER_WH
        self.charge *= 1.0 / J_PER_WH
        found: dict[str, NDArray[Any]] = {
            "feasible": np.asarray(~self.below.any(axis=0)),
            "speed_limited": self.limited,
            "duration_s": self.numbers[0],
            "distance_m": self.numbers[1],
            "failed_at_s": np.full(self.count, np.nan),
        }
        for b, name in enumerate(self.batteries):
            for quantity in _OF_BATTERY:
                found[f"{quantity}_{name}_wh"] = self.numbers[self.row(b, quantity)]
        for (battery, component), row in self._part.items():
            found[f"component_{battery}_{component}_wh"] = self.numbers[row]
        for key in ("failed_segment", "failed_battery"):
            found[key] = np.full(self.count, "", dtype=object)
        found["message"] = self._messages()
        for b, name in enumerate(self.batteries):
            found[f"charge_{name}_wh"] = self.charge[b].T
        return found

    def _messages(self) -> NDArray[np.object_]:
        messages = np.full(self.count, "", dtype=object)
        for b, name in enumerate(self.batteries):
            text = f"battery '{name}' ends below its reserve"
            for i in np.flatnonzero(self.below[b]).tolist():
                messages[i] = f"{messages[i]}; {text}" if messages[i] else text
        return messages
