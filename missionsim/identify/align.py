"""The clock between meter and motion: where the profile likelihood of a prewhitened regression has its best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256

import numpy as np

from missionsim.identify.averaging import Intervals, RunColumns, integral_curves
from missionsim.identify.settings import CLOCK_RUNS
from missionsim.physics import Array

CONSTANT = 1e-16
"""What is left of a column's square without its mean, when it is rounding only: scaled up it would be pure chance."""
STILL = 1e-9
"""Relative change of a column from which on it changes at all."""
Place = tuple[float, float]
"""Delay and lag [s]."""
MOST_FOUND = 8
_FOUND: dict[bytes, Place] = {}
"""Clocks by what the runs hold: a search with other priors, and a fit of given effects, begin with the same columns."""


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


CLOCK_STEPS = (*((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)), (-1, 2), (1, -2))
"""Of delay and lag, which nearly trade against each other."""


def uphill(
    score: Callable[[float, float], float],
    centre: Place,
    reach: float,
    steps: Sequence[tuple[int, int]],
    turns: int,
    digits: int,
    least: float = 0.0,
) -> Place:
    """The best delay and lag by a pattern search, first with steps of a tenth of `reach`, then with half of that; it
    ends after so many turns, or where a step gains less than the `least`."""
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


def still(runs: Sequence[RunColumns]) -> bool:
    """Whether no column changes within any run: such a power is neither late nor early."""
    return all(np.ptp(row) <= STILL * np.max(np.abs(row), initial=0.0) for run in runs for row in run.values)


def find_clock(runs: Sequence[RunColumns], step_s: float) -> Place:
    """Common delay and lag [s] by profile likelihood of a prewhitened regression with all columns in.

    Row 0 of each run's columns is the base model; keeping every candidate in leaves a real inertia effect alone.
    """
    # a start is all that is wanted; the model refines it with every run
    runs = runs[:: -(-len(runs) // 4)] if len(runs) > CLOCK_RUNS else runs
    told = sha256(repr((step_s, [run.values.shape for run in runs])).encode())
    for run in runs:
        for numbers in (run.bins.low_s, run.bins.high_s, run.bins.measured_w, run.bins.starts, run.rows.edges_s):
            told.update(np.ascontiguousarray(numbers).data)
        told.update(np.ascontiguousarray(run.values).data)
    found = _FOUND.pop(told.digest(), None) or _best_clock(runs, step_s)
    _FOUND[told.digest()] = found
    if len(_FOUND) > MOST_FOUND:  # those that were asked for last are kept
        del _FOUND[next(iter(_FOUND))]
    return found


def _best_clock(runs: Sequence[RunColumns], step_s: float) -> Place:
    reach = max(1.0, step_s)
    score = cache(alignment(runs, step_s))
    grid = [(round(0.2 * d * reach, 4), round(lag * reach, 4)) for lag in (0.0, 0.2, 0.45, 0.8) for d in range(-4, 5)]
    centre = max(grid, key=lambda place: score(*place))
    return uphill(score, centre, reach, CLOCK_STEPS, 4, 4)


def alignment(runs: Sequence[RunColumns], step_s: float) -> Callable[[float, float], float]:
    """Log-likelihood of differenced rows, every column in, for a delay and a lag."""
    intervals = Intervals.of(runs)
    curves = integral_curves([run.values for run in runs], [run.rows for run in runs])
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
