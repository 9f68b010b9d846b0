"""Units that loggers write, and the words of a column's name without its unit."""

from __future__ import annotations

import functools
import re
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.inputs.tree import read_document
from missionsim.inputs.units import DIMENSIONS, UnitError, any_unit, unit_factor
from missionsim.physics import Array

WORDS: dict[str, dict[str, Any]] = read_document(Path(__file__).with_name("words.yaml")).data
"""How loggers call things: see the file."""


def _factor(unit: str, dimension: str) -> float:
    si = 1.0 if unit == "K" else unit_factor(unit, dimension)[0]
    return si / 3600.0 if dimension == "energy" else si


UNITS: dict[str, tuple[str, float]] = {
    unit: (dimension, _factor(unit, dimension)) for dimension, units in WORDS["units"].items() for unit in units
}
"""Unit as a map writes it → dimension, factor to the glossary's unit; grows by those that pint knows."""

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
    unit = WORDS["spellings"].get(text, text)
    return unit if unit in UNITS else str(WORDS["spellings"].get(text.lower(), ""))


@functools.cache
def _by_pint(text: str) -> str:
    """A unit that is rare (``ft/s``, ``knot``, ``hp``), as it is written; empty where it is none of what logs hold."""
    for dimension in WORDS["units"]:
        if dimension != "fraction":
            try:
                UNITS[text] = (dimension, _factor(text, dimension))
            except UnitError:
                continue
            return text
    return ""


_DIMENSION = {item.plain: name for name, item in reversed(DIMENSIONS.items())}
"""Unit of the glossary → its dimension."""


def to_glossary(values: Array, unit: str, name: str) -> Array:
    """Values in `unit` as the glossary wants the column `name`; other columns go to coherent SI units.

    `unit`: ``mW``, ``km/h``, ``deg``, ``ns``, ``%`` (of a slope: its tangent), …; `name`: name of the log's column.
    Raises InputError: an unknown unit, or one of another dimension.
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
        factor, offset = unit_factor("W s" if unit == "Ws" else unit, dimension)
    except UnitError as problem:
        raise InputError.single(problem.message, got=problem.got, allowed=problem.allowed, hint=problem.hint) from None
    si = values * factor + offset
    return si / 3600.0 if dimension == "energy" else si
