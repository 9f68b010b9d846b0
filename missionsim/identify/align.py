"""The clock: delay of the power meter behind the motion and its first-order lag, and where to begin with both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from missionsim.identify.averaging import Intervals, RunColumns, integral_curves
from missionsim.identify.settings import CLOCK_RUNS
from missionsim.physics import Array

CONSTANT = 1e-16
"""What is left of a column's square without its mean, when it is rounding only: scaled up it would be pure chance."""
Place = tuple[float, float]
"""Delay and lag [s]."""


@dataclass(frozen=True)
class Clock:
    """Delay of the power meter behind the motion [s] (common, and of each run) and its first-order lag [s]."""

    delay_s: float
    lag_s: float
    run_delay_s: tuple[float, ...]
    at_edge: bool = False

    @classmethod
    def as_logged(cls, runs: int) -> Clock:
        """No delay and no lag."""
        return cls(0.0, 0.0, (0.0,) * runs)

    def in_all(self, runs: int) -> Clock:
        """The common delay and lag, with no delay of a run's own."""
        return replace(self, run_delay_s=(0.0,) * runs)

    def of_runs(self, numbers: Sequence[int]) -> Clock:
        """The clock of some of the runs."""
        return replace(self, run_delay_s=tuple(self.run_delay_s[j] for j in numbers))


def uphill(
    score: Callable[[float, float], float],
    centre: Place,
    reach: float,
    steps: Sequence[tuple[int, int]],
    turns: int,
    digits: int,
    least: float = 0.0,
) -> Place:
    """The best delay and lag by a pattern search, first with steps of a tenth of `reach`, then with half of that.

    A search ends after so many turns, or where a step gains less than the `least`.
    """
    for width in (0.1 * reach, 0.05 * reach):
        for _ in range(turns):
            around = [
                (round(centre[0] + i * width, digits), round(max(0.0, centre[1] + j * width), digits)) for i, j in steps
            ]
            top = max(around, key=lambda place: score(*place))
            if top == centre or score(*top) < score(*centre) + least:
                break
            centre = top
    return centre


def find_clock(runs: Sequence[RunColumns], step_s: float) -> Place:
    """Common delay and lag [s] by profile likelihood of a prewhitened regression with all columns in.

    Row 0 of each run's columns is the base model; keeping every candidate in leaves a real inertia effect alone.
    """
    reach = max(1.0, 1.0 * step_s)
    if len(runs) > CLOCK_RUNS:
        runs = runs[:: -(-len(runs) // 4)]  # a start is all that is wanted; the model refines it with every run
    score = cache(alignment(runs, step_s))
    delays = [round(float(d), 4) for d in np.arange(-0.8, 0.81, 0.2) * reach]
    lags = [round(float(t), 4) for t in np.array([0.0, 0.2, 0.45, 0.8]) * reach]
    # the two nearly trade against each other, so each lag is searched along its own ridge
    centre = max(((delay, lag) for lag in lags for delay in delays), key=lambda place: score(*place))
    steps = [*((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)), (-1, 2), (1, -2)]
    return uphill(score, centre, reach, steps, 4, 4)


def alignment(runs: Sequence[RunColumns], step_s: float) -> Callable[[float, float], float]:
    """Log-likelihood of differenced rows, every column in, for a delay and a lag."""
    intervals = Intervals.of(runs)
    curves = integral_curves([run.values for run in runs])
    measured_w = np.concatenate([run.bins.measured_w for run in runs])
    # first bin of each run, and 1 where a bin has one before it in the same stretch, but for the first bin of all
    firsts = np.cumsum([0, *(len(run.bins.measured_w) for run in runs[:-1])])
    known = np.ones(len(measured_w))
    known[np.concatenate([first + run.bins.starts for run, first in zip(runs, firsts, strict=True)])] = 0.0
    known, begins, keep = known[1:], np.maximum(firsts - 1, 0), 0.85**step_s
    counts = np.add.reduceat(known, begins)

    def score(delay_s: float, lag_s: float) -> float:
        rows = intervals.means(curves, intervals.weights(np.full(len(runs), delay_s), lag_s))
        white: Array = np.empty((len(rows) - 1, rows.shape[1] + 1))
        np.subtract(rows[1:], keep * rows[:-1], out=white[:, 1:])
        residual = measured_w - rows[:, 0]
        white[:, 0] = residual[1:] - keep * residual[:-1]
        white *= known[:, None]
        least = CONSTANT * np.einsum("ij,ij->j", white, white)
        own = np.add.reduceat(white, begins, axis=0) / counts[:, None]
        white -= np.repeat(own, np.diff(begins, append=len(white)), axis=0) * known[:, None]
        full = white.T @ white
        constant = np.diag(full) < least
        full[constant] = 0.0
        full[:, constant] = 0.0
        size = np.sqrt(np.maximum(np.diag(full), 1e-300))
        normal = full / size[:, None] / size[None, :]
        inner = normal[1:, 1:] + 1e-6 * np.eye(len(normal) - 1)
        rss = normal[0, 0] - normal[0, 1:] @ np.linalg.solve(inner, normal[0, 1:])
        return float(-0.5 * (known.sum() - len(counts)) * np.log(max(rss, 1e-12) * full[0, 0]))

    return score
