"""Units of a map: the source's unit to the glossary's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.inputs.units import DIMENSIONS, UnitError, any_unit, unit_factor

Floats = NDArray[np.float64]

_DIMENSION = {
    "s": "duration",
    "W": "power",
    "V": "voltage",
    "A": "current",
    "Wh": "energy",
    "m/s": "speed",
    "m/s^2": "acceleration",
    "rad/s": "yaw rate",
    "m": "length",
    "rad": "angle",
    "kg": "mass",
    "degC": "temperature",
    "1": "fraction",
    "Hz": "frequency",
}
_MORE = {
    "ns": 1e-9,
    "us": 1e-6,
    "µs": 1e-6,
    "uA": 1e-6,
    "uV": 1e-6,
    "m/h": 1 / 3600.0,
    "uWh": 1e-6 * 3600.0,
    "mJ": 1e-3,
    "Ws": 1.0,
}
"""Units of loggers, factor to SI, that are not worth loading a units library for."""


def to_glossary(values: Floats, unit: str, name: str) -> Floats:
    """Values in `unit` as the glossary wants the column `name`; other columns go to coherent SI units.

    Parameters
    ----------
    values : ndarray
    unit : str
        ``mW``, ``km/h``, ``deg``, ``ns``, ``%`` (of a slope: its tangent), …
    name : str
        Name of the log's column.

    Raises
    ------
    missionsim.errors.InputError
        An unknown unit, or one of another dimension.
    """
    found = column_of(name)
    try:
        if found is None or found[0].unit not in _DIMENSION:
            return values * any_unit(unit)[0]
        if name == "slope_rad" and unit == "%":
            return np.asarray(np.arctan(values / 100.0))
        dimension = _DIMENSION[found[0].unit]
        if dimension == "temperature" and unit in ("K", "kelvin"):
            return values - 273.15
        factor, offset = (_MORE[unit], 0.0) if _fits(unit, dimension) else unit_factor(unit, dimension)
    except UnitError as problem:
        raise InputError.single(problem.message, got=problem.got, allowed=problem.allowed, hint=problem.hint) from None
    si = values * factor + offset
    return si / 3600.0 if dimension == "energy" else si


def _fits(unit: str, dimension: str) -> bool:
    if unit not in _MORE:
        return False
    base = unit[1:] if unit[0] in "nuµm" and len(unit) > 1 else unit
    like = {
        "s": "duration",
        "A": "current",
        "V": "voltage",
        "/h": "speed",
        "Wh": "energy",
        "J": "energy",
        "Ws": "energy",
    }.get(base)
    return like == dimension and dimension in DIMENSIONS
