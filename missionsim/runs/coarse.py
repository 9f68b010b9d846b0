"""Long logs in fewer rows: means over even steps, so that memory and time stay bounded however fast was logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import ColumnData, Labels
from missionsim.runs.run import Run

MOST_ROWS = 500_000
"""Rows of all runs together from which on they are averaged (an hour at 10 Hz has 36,000)."""
STEP_S = 1.0
_CYCLIC = frozenset({"heading_rad"})


class Bounded:
    """Averages runs as they come once all together have more than `MOST_ROWS` rows."""

    def __init__(self) -> None:
        self.rows = 0

    def __call__(self, run: Run) -> Run:
        """The run, averaged where it is one too many."""
        self.rows += run.rows
        return run if self.rows <= MOST_ROWS else coarser(run)

    def all(self, runs: Sequence[Run]) -> tuple[list[Run], str]:
        """Those that came before too, and in words what was done; nothing where the rows are few."""
        if self.rows <= MOST_ROWS:
            return list(runs), ""
        return [coarser(run) for run in runs], f"{self.rows:,} rows were averaged to {STEP_S:g} s"


def coarser(run: Run, step_s: float = STEP_S) -> Run:
    """A run in rows of about `step_s`, each the mean of its rows, weighted by time; texts are those of its middle.

    Rows that are longer already stay, and so does a run whose meter is slower than its rows, for the readings say when
    they were made.
    """
    if run.rows < 2 or float(np.median(run.dt_s)) > 0.5 * step_s or any(f is not None for f in run.fresh.values()):
        return run
    number = np.floor((run.time_s - run.time_s[0]) / step_s + 1e-6)
    begin = np.flatnonzero(np.diff(number, prepend=-1.0))
    middle = (begin + np.append(begin[1:], run.rows)) // 2

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        known = np.isfinite(values)
        weight = run.dt_s * known
        seconds = np.add.reduceat(weight, begin)
        total = np.add.reduceat(np.where(known, values, 0.0) * weight, begin)
        return np.asarray(np.where(seconds > 0.0, total / np.where(seconds > 0.0, seconds, 1.0), np.nan))

    def column(name: str, data: ColumnData) -> ColumnData:
        return data[middle] if isinstance(data, Labels) or name in _CYCLIC else mean(data)

    return replace(
        run,
        columns={name: column(name, data) for name, data in run.columns.items()},
        dt_s=np.add.reduceat(run.dt_s, begin),
        power_w={name: mean(power) for name, power in run.power_w.items()},
    )
