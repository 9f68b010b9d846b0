"""Statistics of the energy error over the progress of a run (peak, final, mean, standard deviation)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FIRST_PROGRESS = 0.01
"""Progress at which the error curve begins: before it a few joules stand above and below the fraction bar."""
PROGRESS_POINTS = 397


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the magnitude of a relative error over progress, as robot papers print them [%].

    Attributes
    ----------
    peak_pct, final_pct, mean_pct, std_pct : float
        Largest, last, mean and standard deviation of ``|error|``.
    relative_to : str
        ``measured`` or ``predicted``.
    """

    peak_pct: float
    final_pct: float
    mean_pct: float
    std_pct: float
    relative_to: str = "measured"

    def to_json(self) -> dict[str, float]:
        """The four numbers."""
        return {
            "peak_pct": self.peak_pct,
            "final_pct": self.final_pct,
            "mean_pct": self.mean_pct,
            "std_pct": self.std_pct,
        }


def progress_grid() -> NDArray[np.float64]:
    """Equally spaced progress from `FIRST_PROGRESS` to 1, shape (`PROGRESS_POINTS`,)."""
    return np.linspace(FIRST_PROGRESS, 1.0, PROGRESS_POINTS)


def cumulative_at(
    progress: NDArray[np.float64], energy: NDArray[np.float64], grid: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Cumulative energy at the progress values `grid`.

    Parameters
    ----------
    progress : ndarray, shape (n,)
        Progress at the *end* of each interval, from above 0 to 1, not decreasing.
    energy : ndarray, shape (n,)
        Energy of each interval, any unit.
    grid : ndarray, shape (m,)

    Returns
    -------
    ndarray, shape (m,)
    """
    total = np.interp(grid, np.concatenate([[0.0], progress]), np.concatenate([[0.0], np.cumsum(energy)]))
    return np.asarray(total, dtype=np.float64)


def error_curve(
    measured: NDArray[np.float64], predicted: NDArray[np.float64], relative_to: str = "measured"
) -> NDArray[np.float64]:
    """Relative error ``100 (predicted − measured) / reference`` of two cumulative energies [%], shape (n,).

    NaN where the reference is not positive.
    """
    reference = measured if relative_to == "measured" else predicted
    positive = reference > 0.0
    safe = np.where(positive, reference, 1.0)
    return np.asarray(np.where(positive, 100.0 * (predicted - measured) / safe, np.nan))


def error_statistics(curve: NDArray[np.float64], relative_to: str = "measured") -> ErrorStatistics:
    """Peak, final, mean and standard deviation (of the population) of the magnitude of an error curve.

    Parameters
    ----------
    curve : ndarray, shape (n,)
        Signed error over equally spaced progress [%]; NaN are left out.

    Notes
    -----
    Jaiem et al. 2021, section 3.4.2, print these four for an underestimate as positive numbers, hence the magnitude.
    """
    known = np.abs(curve[np.isfinite(curve)])
    if known.size == 0:
        return ErrorStatistics(float("nan"), float("nan"), float("nan"), float("nan"), relative_to)
    return ErrorStatistics(float(known.max()), float(known[-1]), float(known.mean()), float(known.std()), relative_to)


def relative_error_pct(model: float, measured: float) -> float:
    """``100 (model − measured) / measured`` [%]; NaN where nothing was measured."""
    return 100.0 * (model - measured) / measured if measured != 0.0 else float("nan")
