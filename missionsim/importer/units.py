"""Units that loggers write, and the words of a column's name without its unit."""

from __future__ import annotations

import functools
import re
import unicodedata

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.inputs.units import DIMENSIONS, UnitError, any_unit, unit_factor

_TABLE: dict[str, dict[str, float]] = {
    "power": {"W": 1.0, "kW": 1e3, "mW": 1e-3, "watts": 1.0},
    "voltage": {"V": 1.0, "mV": 1e-3, "volts": 1.0},
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6, "amps": 1.0},
    "energy": {"Wh": 1.0, "kWh": 1e3, "mWh": 1e-3, "J": 1 / 3600, "kJ": 1 / 3.6, "MJ": 1e3 / 3.6},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "cm/s": 1e-2, "mm/s": 1e-3, "mph": 0.44704},
    "yaw rate": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30},
    "acceleration": {"m/s^2": 1.0},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "duration": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "length": {"m": 1.0, "km": 1e3, "mm": 1e-3, "cm": 1e-2},
    "temperature": {"degC": 1.0, "K": 1.0},
    "fraction": {"%": 0.01},
    "mass": {"kg": 1.0, "g": 1e-3},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9},
}
UNITS: dict[str, tuple[str, str, float]] = {
    unit: (dimension, unit, factor) for dimension, units in _TABLE.items() for unit, factor in units.items()
}
"""Unit as a map writes it → dimension, unit, factor to the glossary's unit; grows by those that pint knows."""
_SPELLINGS = {
    "kmh": "km/h", "kph": "km/h", "km_h": "km/h", "m_s": "m/s", "mps": "m/s", "ms-1": "m/s", "m/s²": "m/s^2",
    "m/s2": "m/s^2", "m_s2": "m/s^2", "mps2": "m/s^2", "cm_s": "cm/s", "mm_s": "mm/s", "cms": "cm/s", "rad_s":
    "rad/s", "rads": "rad/s", "deg_s": "deg/s", "dps": "deg/s", "°/s": "deg/s", "°": "deg", "degrees": "deg", "°C":
    "degC", "degc": "degC", "celsius": "degC", "C": "degC", "sec": "s", "secs": "s", "seconds": "s", "msec": "ms",
    "millis": "ms", "µs": "us", "pct": "%", "percent": "%", "w": "W", "v": "V", "a": "A", "wh": "Wh", "kw": "kW",
    "mw": "mW", "ma": "mA", "mv": "mV", "kwh": "kWh", "volt": "V", "watt": "W", "amp": "A", "ampere": "A",
    "amperes": "A", "j": "J", "nsec": "ns", "micros": "us", "usec": "us", "nanos": "ns", "joules": "J",
    "milliseconds": "ms", "grad": "deg", "kj": "kJ", "minutes": "min", "hours": "h", "metres": "m", "meters": "m",
    "watthours": "Wh",
}  # fmt: skip
_PLAIN = {"watts": "W", "volts": "V", "amps": "A"}


_PER = re.compile(
    r"[_ ](m|met(?:er|re)s?|km|kilomet(?:er|re)s?|deg(?:ree)?s?|rad(?:ian)?s?)[_ ]per[_ ](s|sec|seconds?|h|hours?)\Z",
    re.I,
)


_TAILS = (
    r"[_ .]((?:k|m|mm|c)?m_s2?|km_h|rad_s|deg_s)\Z",
    r"(?<=[A-Za-z0-9]),?[_ .]([A-Za-z°%/µ0-9]+)\Z",
    r"\s*/\s*\(?([A-Za-z°%µ][\w/°%²^]*)\)?\Z",
)
"""A unit at the end of a name: ``v_m_s``, ``Voltage, V`` or ``battery_mA``, ``U/V``."""


def words_of(name: str) -> tuple[str, str]:
    """A name as small words with blanks between, and the unit in it (empty where there is none)."""
    unit = ""
    text = name.strip()
    if text in UNITS and text.lower() != text:
        return "", text  # a column that is called V, A or W
    if match := re.match(
        r"(ms|us|µs|ns|millis|micros|nanos|secs?)(?:[_ ](?=today|since|time)|\Z)", text, re.IGNORECASE
    ):
        return f"time {text[match.end() :].lower()}".strip(), known_unit(match[1].lower())
    if match := re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*(?:#\d+)?\Z", text):
        unit = known_unit(match[1]) or _by_pint(match[1])
        if unit or not re.fullmatch(r"\w+", match[1]):
            text = text[: match.start()]
    if not unit and (match := _PER.search(text)):  # meters_per_sec
        what = match[1][:3] if match[1][0] in "rdRD" else match[1][0] + "m" * (match[1][0] in "kK")
        unit, text = known_unit(f"{what}/{match[2][0]}".lower()), text[: match.start()]
    if not unit and not re.search(r"quat|orient|rotation|axis", text, re.IGNORECASE):
        for tail in _TAILS:
            match = re.search(tail, text)
            if match and match[1] not in ("min", "h", "d") and (unit := known_unit(match[1])):
                text = text[: match.start()]
                break
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text).lower().replace("ß", "ss")
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", " ", plain).strip(), unit


def known_unit(text: str) -> str:
    """The unit as a map writes it, or nothing."""
    unit = _SPELLINGS.get(text, text)
    unit = unit if unit in UNITS else _SPELLINGS.get(text.lower(), "")
    return _PLAIN.get(unit, unit) if unit in UNITS else ""


@functools.cache
def _by_pint(text: str) -> str:
    """A unit that is rare (``ft/s``, ``knot``, ``hp``), as it is written; empty where it is none of what logs hold."""
    for dimension in _TABLE:
        if dimension != "fraction":
            try:
                factor, _ = unit_factor(text, dimension)
            except UnitError:
                continue
            UNITS[text] = (dimension, text, factor / 3600.0 if dimension == "energy" else factor)
            return text
    return ""


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
