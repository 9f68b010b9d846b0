"""Every error that is printed: energy, power, statistics over progress.

One definition for all commands: rows as logged, each weighing the time that it stands for, and the model as the meter
shows it (`missionsim.runs.drive.drive`): as late and sluggish as the robot file says, and averaged over each reading
where the meter is slower than the rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.files import Json, fields_of
from missionsim.physics import Array
from missionsim.runs.drive import drive
from missionsim.runs.run import Run

FIRST_PROGRESS = 0.01
"""Part of the time and of the energy of a run at which the error curve begins: before it a few joules stand above and
below the fraction bar, and a robot that stands at first errs by any number of per cent."""
PROGRESS_POINTS = 397
_SUMS = ("seconds", "measured_j", "model_j", "square_w2s")


@dataclass(frozen=True)
class RunError:
    """Model against meter over one run."""

    run: str
    seconds: float
    measured_j: float
    model_j: float
    square_w2s: float
    """These: time, measured and modelled energy, integral of the squared power error."""

    @classmethod
    def of(cls, run: str, measured_w: Array, model_w: Array, dt_s: Array) -> RunError:
        """The error of rows, arrays of shape (n,)."""
        gap = (measured_w - model_w) * dt_s
        square = float(((measured_w - model_w) * gap).sum())
        measured = float(np.einsum("i,i->", measured_w, dt_s))
        return cls(run, float(dt_s.sum()), measured, measured - float(gap.sum()), square)

    def __add__(self, other: RunError) -> RunError:
        return RunError(self.run, *(getattr(self, name) + getattr(other, name) for name in _SUMS))

    @property
    def energy_measured_wh(self) -> float:
        """Energy that the battery delivered [Wh]."""
        return self.measured_j / 3600.0

    @property
    def energy_model_wh(self) -> float:
        """Energy of the model driven by the log [Wh]."""
        return self.model_j / 3600.0

    @property
    def energy_error_pct(self) -> float:
        """``100 (model − measured) / measured`` [%]; NaN where nothing was measured."""
        return 100.0 * (self.model_j - self.measured_j) / self.measured_j if self.measured_j != 0.0 else math.nan

    @property
    def power_rmse_w(self) -> float:
        """Root mean square of the power error, weighted by time [W]."""
        return math.sqrt(max(self.square_w2s, 0.0) / self.seconds)

    @property
    def power_bias_w(self) -> float:
        """Mean of model minus measured power [W]."""
        return (self.model_j - self.measured_j) / self.seconds

    @property
    def shown_bias_w(self) -> float:
        """The same for tables and words, in which a thousandth of the error is none [W]."""
        return self.power_bias_w if abs(self.power_bias_w) > 1e-3 * self.power_rmse_w else 0.0


@dataclass(frozen=True)
class Errors:
    """Model against meter over several runs."""

    runs: tuple[RunError, ...]

    @property
    def total(self) -> RunError:
        """All runs as one."""
        return sum(self.runs, start=RunError("", 0.0, 0.0, 0.0, 0.0))

    @property
    def run_energy_error_pct(self) -> float:
        """Mean over runs of the magnitude of each run's energy error [%]."""
        return float(np.mean([abs(run.energy_error_pct) for run in self.runs]))

    @property
    def power_rmse_w(self) -> float:
        """Root mean square of the power error over all rows, weighted by time [W]."""
        return self.total.power_rmse_w


def errors_of(model: PowerModel, runs: Iterable[Run], battery: str) -> Errors:
    """Errors of a model on runs that measured a battery; what a run lacks is assumed as `missionsim.runs.drive` says.
    Raises InputError: where a run cannot drive the base model."""
    found = []
    for run in runs:
        driven = drive(model, run, battery)
        found.append(RunError.of(run.run, driven.measured_w[battery], driven.model_w[battery], run.dt_s))
    return Errors(tuple(found))


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the magnitude of a relative error over progress, as robot papers print them [%]."""

    peak_pct: float
    final_pct: float
    mean_pct: float
    std_pct: float
    """These: largest, last, mean and standard deviation of ``|error|``."""

    def to_json(self) -> Json:
        """The four numbers."""
        return fields_of(self, "peak_pct final_pct mean_pct std_pct")


def progress_grid() -> Array:
    """Equally spaced progress from `FIRST_PROGRESS` to 1, shape (`PROGRESS_POINTS`,)."""
    return np.linspace(FIRST_PROGRESS, 1.0, PROGRESS_POINTS)


def cumulative_at(progress: Array, energy: Array, grid: Array) -> Array:
    """Cumulative energy at the progress values `grid`.

    `progress` (shape (n,)): progress at the *end* of each interval, from above 0 to 1, not decreasing; `energy` (shape
    (n,)): energy of each interval, any unit; `grid`: shape (m,). Gives an array of shape (m,).
    """
    total = np.interp(grid, np.concatenate([[0.0], progress]), np.concatenate([[0.0], np.cumsum(energy)]))
    return np.asarray(total, dtype=np.float64)


def error_curve(
    measured: Array, predicted: Array, relative_to: str = "measured", begins: float = FIRST_PROGRESS
) -> Array:
    """Relative error ``100 (predicted − measured) / reference`` of two cumulative energies [%], shape (n,). NaN where
    the reference is not positive, or below the part `begins` of what it is at the end."""
    reference = measured if relative_to == "measured" else predicted
    known = (reference > 0.0) & (reference >= begins * reference[-1])
    return np.asarray(np.where(known, 100.0 * (predicted - measured) / np.where(known, reference, 1.0), np.nan))


def error_statistics(curve: Array) -> ErrorStatistics:
    """Peak, final, mean and standard deviation (of the population) of the magnitude of an error curve.

    `curve` (shape (n,)): signed error over equally spaced progress [%]; NaN are left out.

    Jaiem et al. 2021, section 3.4.2, print these four for an underestimate as positive numbers, hence the magnitude.
    """
    known = np.abs(curve[np.isfinite(curve)])
    if known.size == 0:
        known = np.full(1, np.nan)
    return ErrorStatistics(float(known.max()), float(known[-1]), float(known.mean()), float(known.std()))
