"""Progress of a mission: the common axis on which a plan and a run that took longer are compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from missionsim.compare.recorder import Series
from missionsim.effects.integrate import integrate
from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline


def simulated_energy(model: PowerModel, plan: Timeline, battery: str) -> NDArray[np.float64]:
    """Energy of a battery in each interval of a plan [J], shape (n,)."""
    energies = integrate(model, plan)[battery]
    return np.asarray(sum(energies.values(), start=np.zeros(len(plan))))


def mission_progress(
    series: Series, names: Sequence[str], plan: Timeline, segments: Sequence[str]
) -> NDArray[np.float64]:
    """Progress of a run along a plan at the end of each bucket, 0 to 1, shape (n,).

    Where the log names its segments, a segment takes the share of the progress that it has of the planned time, and
    progress within it runs with the time driven in it. Without them progress is the share of the run's time.

    Parameters
    ----------
    series : Series
        The run; its ``segment`` column holds indices into `names`.
    names : sequence of str
        Segments as the logs name them: numbers counted from 0 as in the plan, or names.
    plan : Timeline
    segments : sequence of str
        Names of the plan's segments by number.
    """
    if not names or not len(plan.segment):
        return series.progress
    number = {name: i for i, name in enumerate(segments)}
    planned = {int(i) for i in plan.segment}
    table = np.array([number.get(name, _whole(name)) for name in names] + [-1])
    own = table[series.columns["segment"].astype(int)]
    if not set(own.tolist()) <= planned or np.any(np.diff(own) < 0):
        return series.progress
    seconds = series.columns["seconds"]
    share = {i: float(plan.duration_s[plan.segment == i].sum()) for i in sorted(planned)}
    total = sum(share.values())
    progress = np.zeros(len(own))
    done = 0.0
    for i, planned_s in share.items():
        rows = own == i
        if rows.any() and seconds[rows].sum() > 0.0:
            progress[rows] = done + planned_s * np.cumsum(seconds[rows]) / seconds[rows].sum()
        done += planned_s
    return np.asarray(np.maximum.accumulate(progress) / total)


def _whole(name: str) -> int:
    try:
        return int(float(name))
    except (ValueError, OverflowError):
        return -1
