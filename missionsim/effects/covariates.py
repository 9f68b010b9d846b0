"""Covariates: what the power of a robot depends on, under glossary names, as scalars or arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels as Labels

Value = float | NDArray[np.float64]
"""A number or an array of numbers; arrays broadcast (scalar, ``(intervals,)``, ``(draws, intervals)``)."""
Truth = bool | NDArray[np.bool_]
"""Yes or no, or an array of them."""
Covariates = Mapping[str, Any]
"""Glossary name → `Value`, or a str / `Labels` for text columns."""


def is_text(value: object) -> bool:
    """Whether a covariate is text."""
    return isinstance(value, (str, Labels)) or (isinstance(value, np.ndarray) and value.dtype.kind in "OUS")


def label_equals(value: object, name: str) -> Truth:
    """Where a text covariate is `name`: bool for a str, array of bool for an array of texts or `Labels`."""
    if isinstance(value, Labels):
        return value.equals(name)
    if isinstance(value, str):
        return value == name
    return np.asarray(np.asarray(value) == name)


def number(cov: Covariates, name: str, default: float = 0.0) -> Any:
    """A numeric covariate, or `default` where it is not there."""
    value = cov.get(name)
    return default if value is None else value


def is_moving(cov: Covariates) -> Truth:
    """Whether the robot moves: it stands where |v| < 0.005 m/s and |ω| < 0.02 rad/s (contract); sideways counts as v.

    A plan says itself when the robot moves (column ``moving``), so that a ramp from rest is moving from its start.
    """
    if "moving" in cov:
        return np.asarray(cov["moving"]) > 0.0
    speed = np.abs(number(cov, "speed_m_s"))
    if "lateral_speed_m_s" in cov:
        speed = np.hypot(speed, cov["lateral_speed_m_s"])
    turning = np.abs(number(cov, "yaw_rate_rad_s"))
    return np.asarray((speed >= STILL_SPEED_M_S) | (turning >= STILL_YAW_RATE_RAD_S))
