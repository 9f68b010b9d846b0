"""Columns that repeat the values of a slower topic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.physics import Array, Bools

_SLOW_SHARE = 0.3
"""Share of repeated neighbours above which a column may come from a slower topic."""
_SLOWEST_S = 15.0
"""A refresh slower than this is not a topic's rate but a value that stays."""
_EVEN = 0.5
"""Part of the time that rows about a usual step apart must make: else a row is written when something happens, such as
the two ends of each interval of a simulation, which say nothing of a rate."""
_PLATEAUS = 8
"""Of no more distinct values, equal ones are plateaus."""
_SHORT = 0.05
"""Part of the readings of a rounded topic that may be shorter than its period."""
_OF_ALL = 0.9
"""Part of the time of all runs of a meter in which a slower topic must be seen to be one (in worlds with coarse meters
that few runs showed, rows as they are predicted others better: 2.2 W in place of 2.9)."""
_ROUNDED = 10.0
"""A meter that usually moves by fewer of its steps reads the same again now and then."""


@dataclass(frozen=True)
class Refresh:
    """How often a column really changes."""

    fresh: Bools
    """Rows with a new value. Shape (n,)."""
    period_s: float
    """Typical time between them [s]."""


def refreshes(values: Array, time_s: Array, period_s: float | None = None) -> Refresh | None:
    """Find out whether a column repeats the values of a slower topic.

    `values`, `time_s`: shape (n,). `period_s`: how often it is refreshed, where that is known. Gives None where the
    column changes in most rows, or stays for other reasons: at a plateau, or standing still.

    A slower topic shows as runs of equal values of nearly equal length whose values hardly ever come back; a coarse
    meter or a robot that stands still gives runs of every length, or few distinct values. A slower topic that is
    rounded reads the same again as well, at once or later: it was refreshed all the same, and hardly any reading of it
    is shorter than its period.
    """
    n = len(values)
    if n < 20:
        return None
    if float(np.ptp(values)) <= 1e-6 * float(np.abs(values).max()):
        return None  # a constant with rounding noise
    change = np.r_[True, values[1:] != values[:-1]]
    starts = np.flatnonzero(change)
    if len(starts) < 5 or len(starts) > (1 - _SLOW_SHARE) * n:
        return None
    every = np.diff(np.r_[starts, n])
    lengths = every[1:-1]
    alive = values[starts][1:-1] != 0.0
    if alive.sum() < 4:
        return None
    lengths = lengths[alive]
    steps_s = np.diff(time_s[: min(n, 20000)])
    step_s = float(np.median(steps_s))
    if steps_s[steps_s < 2.0 * step_s].sum() < _EVEN * steps_s.sum():
        return None
    typical = float(np.median(lengths)) if period_s is None else period_s / step_s
    distinct = len(np.unique(values[starts[:2000]]))
    regular = np.abs(lengths - typical) <= max(1.0, 0.35 * typical)
    if period_s is None and (distinct < 0.25 * min(len(starts), 2000) or np.mean(regular) < 0.6):
        typical = float(np.median(lengths[lengths <= 1.5 * np.quantile(lengths, 0.25)]))
        whole = np.abs(lengths - np.round(lengths / typical) * typical) <= max(1.0, 0.15 * typical)
        if distinct <= _PLATEAUS or np.mean(lengths < 0.65 * typical) > _SHORT or np.mean(whole) < 0.6:
            return None
    if typical < 2 or typical * step_s > _SLOWEST_S:
        return None
    grain = float(np.min(np.diff(np.unique(values))))  # the least difference between two readings
    rounded = float(np.median(np.abs(np.diff(values[starts])))) < _ROUNDED * grain
    if period_s is None:  # half a second is two rows and three by turns in rows of a fifth
        typical = float(np.mean(lengths[np.abs(lengths - typical) <= max(1.0, 0.35 * typical)]))
        few = lengths[lengths < 4.5 * typical]
        for _ in range(3):
            typical = float(few.sum() / np.maximum(np.round(few / typical), 1.0).sum())
    for start, length in zip(starts, every, strict=True) if rounded else ():
        if length * step_s < _SLOWEST_S:
            again = start + np.round(np.arange(1, round(length / typical)) * typical).astype(int)
            change[again] = True
    return Refresh(change, typical * step_s)


def of_one_meter(
    masks: Sequence[Bools | None], values: Sequence[Array], times_s: Sequence[Array]
) -> list[Bools | None]:
    """Rows of each run in which a meter was really refreshed; None where every row is.

    Where some runs of one meter show a slower topic and others do not, as most of the time says: the readings of a
    coarse one come back by chance, and half a refresh between runs is taken for their clocks.
    `masks`: what each run shows alone; `values`, `times_s`: its power [W] and time [s], shape (n,).
    """
    seconds = [float(time_s[-1] - time_s[0]) for time_s in times_s]
    held = [(mask, time_s) for mask, time_s in zip(masks, times_s, strict=True) if mask is not None and mask.sum() > 1]
    seen_s = sum(s for s, mask in zip(seconds, masks, strict=True) if mask is not None)
    if seen_s < _OF_ALL * sum(seconds) or not held:
        return [None] * len(masks)
    every_s = [np.diff(time_s[mask]) for mask, time_s in held]
    period_s = float(np.median([np.mean(one[one < 1.6 * np.median(one)]) for one in every_s]))
    found: list[Bools | None] = []
    for mask, value, time_s in zip(masks, values, times_s, strict=True):
        seen = refreshes(value, time_s, period_s) if mask is None else None
        found.append(mask if seen is None else seen.fresh)
    return found
