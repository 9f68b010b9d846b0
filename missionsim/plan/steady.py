"""Power of driving steadily on legs, and what a component needs to be on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from missionsim.effects.covariates import Columns, Labels
from missionsim.effects.model import PowerModel
from missionsim.inputs.robot import RobotSpec
from missionsim.physics import Array
from missionsim.plan.legs import Leg, Settings

LONG_AGO_S = 1e7
"""After which what fades has faded."""


class Requiring(Protocol):
    """A component as far as it is on by itself or by others."""

    @property
    def units(self) -> int: ...
    @property
    def always_on(self) -> bool: ...
    @property
    def requires(self) -> tuple[str, ...]: ...


def closure(infos: Mapping[str, Requiring], sensors: Sequence[tuple[str, int]]) -> dict[str, int]:
    """Components with everything that they require, one unit of each requirement at least."""
    known: dict[str, int] = {}
    waiting = [(name, units) for name, units in sensors if units > 0]
    while waiting:
        name, units = waiting.pop()
        if known.get(name, 0) >= units:
            continue
        known[name] = units
        waiting.extend((required, 1) for required in infos[name].requires)
    return known


def units_on(infos: Mapping[str, Requiring], sensors: Sequence[tuple[str, int]]) -> list[float]:
    """Units of each component that are on: those asked for, what they require, and what is always on."""
    always = ((name, info.units) for name, info in infos.items() if info.always_on)
    units = closure(infos, (*sensors, *always))
    return [float(units.get(name, 0)) for name in infos]


def table(numbers: Sequence[float | Array]) -> Array:
    """Numbers of intervals, each a float or an array of all runs. Gives an array of shape (intervals, runs), or
    (intervals,) where none of them is an array."""
    if not any(isinstance(number, np.ndarray) for number in numbers):
        return np.array(numbers, dtype=float)
    rows = np.empty((len(numbers), max(np.size(number) for number in numbers)))
    for row, number in zip(rows, numbers, strict=True):
        row[:] = number
    return rows


def covariates_of(settings: Sequence[Settings]) -> Columns:
    """What settings say under glossary names, shape (settings,), or as `table`; not a number where only others say
    it."""
    columns: Columns = {name: table([getattr(s, name) for s in settings]) for name in ("slope_rad", "payload_kg")}
    columns |= {name: Labels.of(getattr(s, name) for s in settings) for name in ("scheme", "navigation", "surface")}
    extras = [dict(s.extra) for s in settings]
    for name in sorted({name for extra in extras for name in extra}):
        given: list[Any] = [extra.get(name, np.nan) for extra in extras]
        text = any(isinstance(value, str) for value in given)
        columns[name] = Labels.of(given) if text else table(given)
    return columns


def steady_power_w(robot: RobotSpec, model: PowerModel, legs: Sequence[Leg]) -> dict[str, Array]:
    """Power of each battery while legs are driven at their speed, shape (legs,), W. Without accelerations, activities
    and what fades with time."""
    zero = np.zeros(len(legs))
    settings = [leg.settings for leg in legs]
    cov: dict[str, Any] = dict.fromkeys(("accel_m_s2", "lateral_speed_m_s", "lateral_accel_m_s2", "starts"), zero)
    cov |= {
        "speed_m_s": np.array([leg.speed_m_s for leg in legs]),
        "yaw_rate_rad_s": np.array([leg.speed_m_s * leg.curvature_1_m for leg in legs]),
        "moving": zero + 1.0,
        "moving_time_s": zero + LONG_AGO_S,
        "time_s": zero + LONG_AGO_S,
        **covariates_of(settings),
    }
    on = np.array([units_on(robot.components, s.sensors) for s in settings]).reshape(len(legs), -1)
    for name, units in zip(robot.components, on.T, strict=True):
        cov[f"on_{name}"] = units
        cov[f"starting_{name}"] = zero
        cov[f"on_time_{name}_s"] = zero + LONG_AGO_S
    powers = model.evaluate(cov)
    return {battery: np.asarray(sum(powers.get(battery, {}).values(), zero)) for battery in robot.batteries}
