"""Matrices of runs × intervals: sums along a run, interpolation at even instants, covariates.

They are kept in Fortran order here and in `arrays`: the runs of one interval lie side by side, so that what holds for
an interval meets them as one number, and sums over intervals add whole rows.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Columns, Covariates, Labels
from missionsim.effects.timeline import Timeline
from missionsim.physics import Array
from missionsim.plan.legs import Leg, Phase, Plan
from missionsim.plan.steady import covariates_of, table

_RATE = "d/dt "
PROGRESS_POINTS = 21
"""Charge of each battery is kept at so many instants, evenly over a run's duration."""


def running_sum(rows: Array) -> Array:
    """Sums of the rows before each row, and of all: shape (k, n) → (k + 1, n)."""
    sums = np.empty((len(rows) + 1, rows.shape[1]))
    sums[0] = 0.0
    for i, row in enumerate(rows):
        np.add(sums[i], row, out=sums[i + 1])
    return sums


class Progress:
    """Linear interpolation at even parts of each run's duration.

    `knots` (shape (k, runs)): instants from 0 that do not decrease along a run, the last one its duration; `points`:
    how many parts, with both ends.
    """

    def __init__(self, knots: Array, points: int) -> None:
        last, count = len(knots) - 1, knots.shape[1]
        total = knots[-1]
        column = np.arange(count)
        # the first of the even instants that a knot does not come after, counted, tells the knots before each of them
        place = knots[1:] * ((points - 1) / np.where(total > 0.0, total, 1.0))
        np.ceil(place, out=place)
        place *= count
        place += column
        passed = np.bincount(place.astype(np.intp).ravel(), minlength=points * count)
        at = np.empty((points - 2, count), dtype=np.intp)
        before = passed[:count].copy()
        for g in range(1, points - 1):
            before += passed[g * count : (g + 1) * count]
            np.minimum(before, last - 1, out=at[g - 1])
        at *= count
        at += column
        self.at, self.after, self.points = at, at + count, points
        flat = knots.ravel()
        begin, length = flat.take(at), flat.take(self.after)
        length -= begin
        part = np.multiply.outer(np.arange(1, points - 1) / (points - 1), total)
        part -= begin
        if not length.all():
            part = np.where(length > 0.0, part, 1.0)
            length = np.where(length > 0.0, length, 1.0)
        part /= length
        self.part = np.clip(part, 0.0, 1.0, out=part)

    def __call__(self, values: Array) -> Array:
        """Values at the even instants, shape (points, runs), from values at the knots, shape (k, runs)."""
        flat = values.ravel()
        found = np.empty((self.points, values.shape[1]))
        found[0], found[-1] = values[0], values[-1]
        before, inner = flat.take(self.at), found[1:-1]
        np.subtract(flat.take(self.after), before, out=inner)
        inner *= self.part
        inner += before
        return found


def one_after_the_other(
    cov: Covariates, rates: Covariates, duration: Array, knots: Array, which: NDArray[np.intp]
) -> Timeline:
    """Some of the intervals of all runs, run by run. `cov`, `rates`, `duration`: shape (runs, intervals) or
    (intervals,); `knots` (shape (intervals + 1, runs)): instants between them; `which`: intervals."""

    def flat(value: Any) -> Any:
        if isinstance(value, Labels):
            return Labels(np.tile(value.codes[which], len(duration)), value.names)
        return np.broadcast_to(value, duration.shape)[:, which].ravel()

    columns, changes = ({name: flat(value) for name, value in given.items()} for given in (cov, rates))
    return Timeline(flat(knots[:-1].T), flat(duration), columns, changes)


@dataclass(frozen=True)
class Intervals:
    """The phases of a plan of many runs, the legs that they belong to, and what of a run nothing but draws changes in:
    its leg, or its part (`missionsim.uncertainty.events`)."""

    plan: Plan
    phases: tuple[Phase, ...]
    leg_of: NDArray[np.intp]
    part_of: NDArray[np.intp]

    @classmethod
    def of(cls, plan: Plan, phases: Sequence[Phase] | None = None, parts: Sequence[int] | None = None) -> Intervals:
        """Those of a plan, or others with their parts."""
        if phases is None:
            phases = [phase for step in plan.steps for phase in step.phases]
        legs = np.array([phase.leg for phase in phases], dtype=np.intp)
        return cls(plan, tuple(phases), legs, legs if parts is None else np.array(parts, dtype=np.intp))

    @functools.cached_property
    def legs(self) -> list[Leg]:
        """The leg of each interval."""
        return [self.plan.legs[i] for i in self.leg_of.tolist()]

    def duration(self, part: slice) -> Array:
        """Of each interval [s], shape (runs, intervals)."""
        lasting: Array = self._tables[""]
        if lasting.ndim > 1:
            return lasting[:, part].T
        return np.repeat(lasting[:, None], part.stop - part.start, axis=1).T

    @functools.cached_property
    def _tables(self) -> Columns:
        """Covariates of each interval at its start and, with a prefix, their rates; see `table`."""
        settings = covariates_of([leg.settings for leg in self.plan.legs])
        found = {"": table([phase.duration_s for phase in self.phases])}
        found |= {name: values[self.leg_of] for name, values in settings.items()}
        for name, level, rate in (
            ("speed_m_s", "speed_m_s", "accel_m_s2"),
            ("lateral_speed_m_s", "lateral_m_s", "lateral_m_s2"),
            ("yaw_rate_rad_s", "yaw_rad_s", "yaw_rad_s2"),
        ):
            found[name] = table([getattr(phase, level) for phase in self.phases])
            found[_RATE + name] = table([getattr(phase, rate) for phase in self.phases])
        moving = np.array([phase.moving for phase in self.phases])
        # a leg that takes no time in any run is planned as standing
        before = np.concatenate([[False], moving[:-1]])
        found["moving"], found["starts"] = moving.astype(float), (moving & ~before).astype(float)
        return found

    def covariates(self, part: slice) -> tuple[Columns, Columns]:
        """Covariates at the start of each interval, shape (runs, intervals) or (intervals,), and their rates."""
        cov: Columns = {}
        rates: Columns = {}
        for name, rows in self._tables.items():
            one = rows if isinstance(rows, Labels) or rows.ndim == 1 else rows[:, part].T
            (rates if name.startswith(_RATE) else cov)[name.removeprefix(_RATE)] = one
        del cov[""]
        cov["accel_m_s2"], cov["lateral_accel_m_s2"] = rates["speed_m_s"], rates["lateral_speed_m_s"]
        return cov, rates


def distance_of(cov: Covariates, duration: Array) -> Array:
    """Distance driven [m], shape (runs,)."""
    if not np.any(cov["accel_m_s2"]) and not np.any(cov["lateral_speed_m_s"]):
        speed = np.broadcast_to(np.abs(cov["speed_m_s"]), duration.shape)
        return np.asarray(np.einsum("ij,ij->i", speed, duration))
    ahead = cov["speed_m_s"] * duration + 0.5 * cov["accel_m_s2"] * duration**2
    aside = cov["lateral_speed_m_s"] * duration + 0.5 * cov["lateral_accel_m_s2"] * duration**2
    return np.asarray(np.hypot(ahead, aside).sum(axis=1))
