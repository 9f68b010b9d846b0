"""A plan's numbers at draws of the uncertain values, and interpolation over many runs at once.

Matrices of draws × intervals are kept in Fortran order here and in `arrays`: the runs of one interval lie side by side,
so that what holds for an interval meets them as one number, and sums over intervals add whole rows.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import NODES
from missionsim.engine.simulate import RunSetup
from missionsim.plan.legs import Plan
from missionsim.plan.pace import ROUNDING, Pace
from missionsim.uncertainty.probe import Dependence

Array = NDArray[np.float64]
_LEG = ("distance_m", "curvature_1_m", "angle_rad", "yaw_rate_rad_s", "duration_s")
PACE = Pace._fields
SETTINGS = ("payload_kg", "slope_rad")
_LIMITS = ("accel_m_s2", "decel_m_s2", "yaw_accel_rad_s2")


def entry_names(plan: Plan) -> tuple[str, ...]:
    """Names of each leg's numbers: its own, its pace's, its settings', and conditions such as ``temp_ambient_c``."""
    return (*_LEG, *PACE, *SETTINGS, *condition_names(plan))


def condition_names(plan: Plan) -> tuple[str, ...]:
    """Further covariates of a plan that are numbers on some leg."""
    return tuple(
        sorted({name for leg in plan.legs for name, value in leg.settings.extra if not isinstance(value, str)})
    )


class Entries:
    """The plan's numbers at draws, as matrices of shape (runs, asked) or, where none of them varies, (1, asked).

    Parameters
    ----------
    plan : Plan
    dependence : Dependence
    changes : ndarray, shape (values, runs)
        See `Dependence.changes`.
    """

    def __init__(self, plan: Plan, dependence: Dependence, changes: Array) -> None:
        self.dependence, self.changes = dependence, changes
        self.names = entry_names(plan)
        self.after_legs = len(self.names) * len(plan.legs)

    def legs(self, legs: tuple[int, ...], name: str) -> Array:
        """A number of each of these legs, of its pace, or a setting of theirs such as ``payload_kg``."""
        return self.dependence.at(self.changes, _places(self.names, legs, name))

    def limits(self, legs: tuple[int, ...], turn: bool) -> tuple[Array, NDArray[np.bool_]]:
        """Speed (or yaw rate) of each of these legs, and the runs, shape (runs,) or (1,), in which a drawn one is cut.

        A way's own limit does not count as a cut.
        """
        limited = np.zeros(1, dtype=bool)
        if turn:
            return self.legs(legs, "yaw_rate_rad_s"), limited
        speed = self.legs(legs, "asked")
        for name in PACE[1:]:
            if not np.isfinite(self.dependence.base[list(_places(self.names, legs, name))]).any():
                continue
            limit = self.legs(legs, name)
            if (speed > limit).any():
                if name != "way":
                    limited = limited | (speed > limit * ROUNDING).any(axis=1)
                speed = np.minimum(speed, limit)
        return speed, limited

    def limit(self, name: str) -> Array:
        """A limit of the robot's motion, shape (runs,) or (1,)."""
        return self._alone(self.after_legs + _LIMITS.index(name))

    def battery(self, battery: int, which: int) -> Array:
        """Capacity [J], initial charge [J] or reserve (a part of the capacity) of a battery, shape (runs,) or (1,)."""
        return self._alone(self.after_legs + len(_LIMITS) + 3 * battery + which)

    def _alone(self, index: int) -> Array:
        return self.dependence.at(self.changes, (index,))[:, 0]


@functools.lru_cache(maxsize=1024)
def _places(names: tuple[str, ...], legs: tuple[int, ...], name: str) -> tuple[int, ...]:
    """Where a number of these legs stands among all numbers of a plan."""
    place = names.index(name)
    return tuple(leg * len(names) + place for leg in legs)


def drawn_conditions(plan: Plan, dependence: Dependence, legs: tuple[int, ...]) -> tuple[str, ...]:
    """Conditions of these legs that some draw changes."""
    names, varying = entry_names(plan), set(dependence.varying.tolist())
    return tuple(name for name in condition_names(plan) if varying.intersection(_places(names, legs, name)))


def numbers_of_plan(plan: Plan, setup: RunSetup) -> Array:
    """Every number that a run's arrays need, in the order of `Entries`."""
    values: list[Any] = []
    conditions = condition_names(plan)
    for leg in plan.legs:
        values += [getattr(leg, name) for name in _LEG]
        values += leg.pace
        values += [getattr(leg.settings, name) for name in SETTINGS]
        extra = dict(leg.settings.extra)
        values += [extra[name] if isinstance(extra.get(name), float | int) else np.nan for name in conditions]
    limits = plan.limits
    decel = limits.decel_m_s2 or limits.accel_m_s2
    values += [np.nan if v is None else v for v in (limits.accel_m_s2, decel, limits.yaw_accel_rad_s2)]
    for name, battery in setup.batteries.items():
        values += [battery.capacity_j, float(battery.charge_j(battery.initial)), setup.required[name]]
    return np.asarray(values, dtype=float)


@dataclass(frozen=True)
class Interval:
    """One interval of every run: which leg, which of its three phases (or standing)."""

    leg: int
    phase: int
    moving: bool
    begins: bool
    """Whether the robot starts from rest in it."""


@dataclass(frozen=True)
class Motion:
    """Duration, speed at the start and acceleration of each interval, shape (runs, intervals) in Fortran order."""

    duration_s: Array
    speed_m_s: Array
    accel_m_s2: Array
    """One row where no speed changes within an interval."""
    limited: NDArray[np.bool_]
    """The runs, shape (runs,) or (1,), in which a drawn speed is above what the robot can do."""


def distance(cov: Mapping[str, Any], motion: Motion) -> Array:
    """Distance driven [m], shape (runs,)."""
    duration = motion.duration_s
    if not motion.accel_m_s2.any() and not np.any(cov["lateral_speed_m_s"]):
        speed = np.broadcast_to(np.abs(cov["speed_m_s"]), duration.shape)
        return np.asarray(np.einsum("ij,ij->i", speed, duration))
    ahead = cov["speed_m_s"] * duration + 0.5 * cov["accel_m_s2"] * duration**2
    aside = cov["lateral_speed_m_s"] * duration + 0.5 * cov["lateral_accel_m_s2"] * duration**2
    return np.asarray(np.hypot(ahead, aside).sum(axis=1))


def running_sum(rows: Array) -> Array:
    """Sums of the rows before each row, and of all: shape (k, n) → (k + 1, n)."""
    sums = np.empty((len(rows) + 1, rows.shape[1]))
    sums[0] = 0.0
    for i, row in enumerate(rows):
        np.add(sums[i], row, out=sums[i + 1])
    return sums


class Progress:
    """Linear interpolation at even parts of each run's duration.

    Parameters
    ----------
    knots : ndarray, shape (k, runs)
        Instants from 0 that do not decrease along a run, the last one its duration.
    points : int
        How many parts, with both ends.
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


def at_nodes(
    cov: Mapping[str, Any], rates: Mapping[str, Any], curved: NDArray[np.intp], times: Array
) -> dict[str, Any]:
    """Covariates at the nodes of the intervals in which power changes, in their last axis interval by interval."""
    repeated = np.repeat(curved, len(NODES))
    nodes = take(cov, repeated)
    for name, change in rates.items():
        if np.any(change):
            nodes[name] = nodes[name] + times * np.asarray(change)[..., repeated]
    return nodes


def take(cov: Mapping[str, Any], index: NDArray[np.intp]) -> dict[str, Any]:
    """Covariates of some intervals."""
    return {
        name: value[index] if hasattr(value, "codes") else np.asarray(value)[..., index] for name, value in cov.items()
    }
