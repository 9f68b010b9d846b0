"""Matrices of runs × intervals: sums along a run, interpolation at even instants, covariates within intervals.

They are kept in Fortran order here and in `arrays`: the runs of one interval lie side by side, so that what holds for
an interval meets them as one number, and sums over intervals add whole rows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Columns, Covariates, Labels, Value
from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import RELATIVE_TOLERANCE, SAMPLES, averaged, lags_of
from missionsim.physics import Array
from missionsim.physics.lag import GOES_ON, SETTLED, Lagged
from missionsim.plan.legs import Leg, Phase, Plan

_RATE = "d/dt "
HALVINGS = 34
"""Until where a power has its kink is known: what is left of it is beyond its tenth digit."""
PROGRESS_POINTS = 21
"""Charge of each battery is kept at so many instants, evenly over a run's duration."""


def table(numbers: Sequence[float | Array]) -> Array:
    """Numbers of intervals, each a float or an array of all runs. Gives an array of shape (intervals, runs), or
    (intervals,) where none of them is an array."""
    if not any(isinstance(number, np.ndarray) for number in numbers):
        return np.array(numbers, dtype=float)
    rows = np.empty((len(numbers), max(np.size(number) for number in numbers)))
    for row, number in zip(rows, numbers, strict=True):
        row[:] = number
    return rows


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


def at_times(
    cov: Covariates, rates: Covariates, rows: NDArray[np.intp], columns: NDArray[np.intp], times: Array
) -> Columns:
    """Covariates within some intervals (`columns`) of some runs (`rows`), `times` after their start; shape (n,)."""

    def of(value: Any) -> Any:
        if hasattr(value, "codes") or np.ndim(value) < 2:
            return value[columns]
        return value[rows, columns] if len(value) > 1 else value[0, columns]

    found = {name: of(value) for name, value in cov.items()}
    for name, change in rates.items():
        if np.any(change):
            found[name] = found[name] + times * of(np.asarray(change))
    return found


def lags_within(
    model: PowerModel, cov: Covariates, rates: Covariates, duration: Array, values: Mapping[str, Array]
) -> dict[str, Lagged]:
    """The lags that a model reads, within the intervals of all runs, which follow each other run by run."""
    count = duration.shape[1]

    def at(index: NDArray[np.intp], seconds: Array) -> Columns:
        rows, columns = np.divmod(np.repeat(index, seconds.shape[1]), count)
        found = at_times(cov, rates, rows, columns, seconds.ravel())
        return {
            name: Labels(value.codes.reshape(seconds.shape), value.names)
            if isinstance(value, Labels)
            else np.reshape(value, seconds.shape)
            for name, value in found.items()
        }

    def own(index: NDArray[np.intp]) -> dict[str, Array]:
        return {name: value[index // count] for name, value in values.items()}

    begin = np.where(np.arange(duration.size) % count == 0, SETTLED, GOES_ON)
    return lags_of(model, at, own, duration.ravel(), dict.fromkeys(model.lags, begin))


def take(cov: Covariates, index: NDArray[np.intp]) -> Columns:
    """Covariates of some intervals."""
    return {
        name: value[index] if hasattr(value, "codes") else np.asarray(value)[..., index] for name, value in cov.items()
    }


def mean_powers(
    terms: Mapping[TermKey, Value],
    length: Array,
    inside: Callable[[NDArray[np.intp], NDArray[np.intp], Array], Mapping[TermKey, Value]],
    driving: Sequence[TermKey],
) -> tuple[dict[TermKey, Array], Array]:
    """Mean power of each term in each interval, shape (runs, intervals) or (1, intervals), and how far their sum may
    be off.

    `terms`: powers at the samples of the intervals, in their last axis interval by interval; `length` (shape (runs,
    intervals)); `inside`: ``(runs, intervals, times)`` → powers there, shape (n,); `driving`: terms whose sum has a
    kink where it is zero. An interval with such a kink is averaged in two parts.
    """
    means: dict[TermKey, Array] = {}
    off, size = np.zeros(length.shape), np.zeros(length.shape)
    for key, given in terms.items():
        powers = np.asarray(given, dtype=float)
        powers = np.broadcast_to(powers, (*powers.shape[:-1], length.shape[1] * len(SAMPLES)))
        means[key], spread, bent = averaged(powers.reshape(-1, length.shape[1], len(SAMPLES)))
        off, size = off + np.maximum(spread, bent), size + np.abs(means[key])
    rows, columns = np.nonzero((off > RELATIVE_TOLERANCE * size) & (length > 0.0))
    if driving and rows.size:
        whole = length[rows, columns]
        # not from the very ends, where a power may jump
        low, high = 1e-7 * whole, (1.0 - 1e-7) * whole

        def gives(times: Array) -> NDArray[np.bool_]:
            powers = inside(rows, columns, times)
            return np.asarray(sum(powers[key] for key in driving) > 0.0)

        first = gives(low)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            before = gives(middle) == first
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        lengths = np.stack([low, whole - low], axis=1)
        times = np.stack([np.zeros_like(low), low], axis=1)[..., None] + 0.5 * lengths[..., None] * (SAMPLES + 1.0)
        each = times[0].size
        anew = np.zeros(len(whole))
        for key, watts in inside(np.repeat(rows, each), np.repeat(columns, each), times.ravel()).items():
            mean, spread, bent = averaged(np.broadcast_to(watts, times.size).reshape(times.shape))
            means[key] = np.broadcast_to(means[key], length.shape).copy()
            means[key][rows, columns] = (mean * lengths).sum(axis=1) / whole
            anew += (np.maximum(spread, bent) * lengths).sum(axis=1) / whole
        off[rows, columns] = anew
    return means, off


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
        lasting = self._tables[""]
        if lasting.ndim > 1:
            return lasting[:, part].T
        return np.repeat(lasting[:, None], part.stop - part.start, axis=1).T

    @functools.cached_property
    def _tables(self) -> dict[str, Array]:
        """Covariates of each interval at its start and, with a prefix, their rates; see `table`."""
        phases = self.phases
        found = {"": table([phase.duration_s for phase in phases])}
        for name, level, rate in (
            ("speed_m_s", "speed_m_s", "accel_m_s2"),
            ("lateral_speed_m_s", "lateral_m_s", "lateral_m_s2"),
            ("yaw_rate_rad_s", "yaw_rad_s", "yaw_rad_s2"),
        ):
            found[name] = table([getattr(phase, level) for phase in phases])
            found[_RATE + name] = table([getattr(phase, rate) for phase in phases])
        for name in ("payload_kg", "slope_rad"):
            found[name] = table([getattr(leg.settings, name) for leg in self.legs])
        extra = [dict(leg.settings.extra) for leg in self.plan.legs]
        for name in sorted({name for item in extra for name in item} - self._of_legs.keys()):
            given = [item.get(name, np.nan) for item in extra]
            found[name] = table([given[i] for i in self.leg_of.tolist()])
        return found

    @functools.cached_property
    def _of_legs(self) -> dict[str, Any]:
        """Covariates that no draw changes, of each interval."""
        settings = [leg.settings for leg in self.plan.legs]
        found: dict[str, Any] = {
            name: Labels.of([getattr(item, name) for item in settings])[self.leg_of]
            for name in ("scheme", "navigation", "surface")
        }
        moving = np.array([phase.moving for phase in self.phases])
        # a leg that takes no time in any run is planned as standing
        before = np.concatenate([[False], moving[:-1]])
        found["moving"], found["starts"] = moving.astype(float), (moving & ~before).astype(float)
        for name in sorted({name for item in settings for name, value in item.extra if isinstance(value, str)}):
            found[name] = Labels.of([dict(item.extra).get(name, np.nan) for item in settings])[self.leg_of]
        return found

    def covariates(self, part: slice) -> tuple[Columns, Columns]:
        """Covariates at the start of each interval, shape (runs, intervals) or (intervals,), and their rates."""
        cov: dict[str, Any] = dict(self._of_legs)
        rates: dict[str, Any] = {}
        for name, rows in self._tables.items():
            (rates if name.startswith(_RATE) else cov)[name.removeprefix(_RATE)] = (
                rows[:, part].T if rows.ndim > 1 else rows
            )
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
