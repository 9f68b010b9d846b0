"""A plan's numbers at draws of the uncertain values, and interpolation over many runs at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.simulate import RunSetup
from missionsim.plan.legs import Plan
from missionsim.uncertainty.draws import Draws
from missionsim.uncertainty.probe import Dependence

Array = NDArray[np.float64]
_LEG = ("distance_m", "speed_m_s", "curvature_1_m", "angle_rad", "yaw_rate_rad_s", "duration_s")
SETTINGS = ("payload_kg", "slope_rad")
_LIMITS = ("accel_m_s2", "decel_m_s2", "yaw_accel_rad_s2")


class Entries:
    """The plan's numbers at draws, each of shape (n, 1) or a number."""

    def __init__(self, plan: Plan, dependence: Dependence, draws: Draws) -> None:
        self.plan, self.dependence, self.draws = plan, dependence, draws
        self.varying = set(dependence.varying.tolist())
        self.width = len(_LEG) + len(SETTINGS)

    def entry(self, index: int) -> Any:
        return self.dependence.at(self.draws, index) if index in self.varying else float(self.dependence.base[index])

    def leg(self, leg: int, name: str) -> Any:
        return self.entry(leg * self.width + _LEG.index(name))

    def varies(self, name: str) -> bool:
        place = _LEG.index(name)
        return any(index % self.width == place for index in self.varying if index < self.width * len(self.plan.legs))

    def setting(self, name: str, legs: list[int], count: int) -> Array:
        place = len(_LEG) + SETTINGS.index(name)
        indices = [leg * self.width + place for leg in legs]
        if not self.varying.intersection(indices):
            return np.asarray(self.dependence.base[indices])
        return np.concatenate([np.zeros((count, 1)) + self.entry(index) for index in indices], axis=1)

    def limit(self, name: str) -> Any:
        return self.entry(self.width * len(self.plan.legs) + _LIMITS.index(name))

    def battery(self, battery: int, which: int) -> Any:
        return self.entry(self.width * len(self.plan.legs) + len(_LIMITS) + 3 * battery + which)


def numbers_of_plan(plan: Plan, setup: RunSetup) -> Array:
    """Every number that a run's arrays need, in the order of `Entries`."""
    values: list[float] = []
    for leg in plan.legs:
        values += [getattr(leg, name) for name in _LEG]
        values += [getattr(leg.settings, name) for name in SETTINGS]
    limits = plan.limits
    decel = limits.decel_m_s2 or limits.accel_m_s2
    values += [np.nan if v is None else v for v in (limits.accel_m_s2, decel, limits.yaw_accel_rad_s2)]
    for name, battery in setup.batteries.items():
        values += [battery.capacity_j, float(battery.charge_j(battery.initial)), setup.required[name]]
    return np.asarray(values, dtype=float)


class Interpolation:
    """Linear interpolation of each row, of times (n, points) among knots (n, knots) that increase along a row."""

    def __init__(self, grid: Array, times: Array) -> None:
        count, knots = times.shape
        # one search over all rows: each row's times, as parts of its last, get a range of their own
        row = 2.0 * np.arange(count)[:, None]
        scale = np.where(times[:, -1:] > 0.0, times[:, -1:], 1.0)
        found = np.searchsorted((times / scale + row).ravel(), (grid / scale + row).ravel(), side="right").reshape(
            grid.shape
        )
        first = knots * np.arange(count)[:, None]
        self.right = np.clip(found - first, 1, knots - 1) + first
        t0, t1 = times.ravel()[self.right - 1], times.ravel()[self.right]
        longer = t1 > t0
        self.part = np.clip(np.where(longer, (grid - t0) / np.where(longer, t1 - t0, 1.0), 1.0), 0.0, 1.0)

    def __call__(self, values: Array) -> Array:
        """Values at the grid, from values (n, knots) at the knots."""
        flat = values.ravel()
        v0, v1 = flat[self.right - 1], flat[self.right]
        return np.asarray(v0 + (v1 - v0) * self.part)
