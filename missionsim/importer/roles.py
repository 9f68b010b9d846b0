"""What a column or field of a logger perhaps is: by its name, the unit in it, its values, the type of its message."""

from __future__ import annotations

import functools
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.inputs.tree import read_document
from missionsim.inputs.units import DIMENSIONS, UnitError, any_unit, unit_factor
from missionsim.labels import Labels
from missionsim.logs.raw import TIME_STAMP, ColumnData
from missionsim.logs.readers import Options, Reader, reader_of, recorded
from missionsim.logs.times import Stamps, TimeError, is_stamp, numbers_as_times
from missionsim.physics import Array

WORDS: dict[str, dict[str, Any]] = read_document(Path(__file__).with_name("words.yaml")).data
"""How loggers call things: see the file."""


def _factor(unit: str, dimension: str) -> float:
    si = WORDS["factors"].get(unit) or unit_factor(unit, dimension)[0]
    return float(si / 3600.0 if dimension == "energy" else si)


UNITS: dict[str, tuple[str, float]] = {
    unit: (dimension, _factor(unit, dimension)) for dimension, units in WORDS["units"].items() for unit in units
}
"""Unit as a map writes it → dimension, factor to the glossary's unit; grows by those that pint knows."""

_PER = re.compile(
    r"[_ ]([ckm]?m|(?:kilo)?met(?:er|re)s?|deg(?:ree)?s?|rad(?:ian)?s?)[_ ]per[_ ](s|sec|seconds?|h|hours?)\Z", re.I
)


_TAILS = (
    r"[_ .]((?:k|m|mm|c)?m_s2?|km_h|rad_s|deg_s|ft_s)\Z",
    r"(?<=[A-Za-z0-9]),?[_ .]([A-Za-z°%/µ0-9]+)\Z",
    r"(?<=[A-Za-z])(%)\Z",
    r"\s*/\s*\(?([A-Za-z°%µ][\w/°%²^]*)\)?\Z",
)
"""A unit at the end of a name: ``v_m_s``, ``Voltage, V`` or ``battery_mA``, ``CPU%``, ``U/V``."""


def words_of(name: str) -> tuple[str, str]:
    """A name as small words with blanks between, and the unit in it (empty where there is none)."""
    unit = ""
    text = name.strip()
    if text in UNITS and text.lower() != text:
        return "", text  # a column that is called V, A or W
    if (own := known_unit(text)) and UNITS[own][0] == "speed":
        return "", own  # or km/h
    if re.match(r"(power )?(VDD|POM|VIN)_|Power TOT\Z", text, re.IGNORECASE) and not re.search(r"[\[(]|_m?W\Z", text):
        return f"power {text.split(' ')[-1].lower().replace('_', ' ')}", "mW"  # the rails of a Jetson
    if match := re.match(r"(ms|us|µs|ns|millis|micros|nanos|secs?)(?:[_ ](?=today|since|time)|\Z)", text, re.I):
        return f"time {text[match.end() :].lower()}".strip(), known_unit(match[1].lower())
    if match := re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*(?:#\d+)?\Z", text):
        index = re.search(r"\w\[\d+\]\Z", text)  # ``q[1]``
        unit = "" if index else known_unit(match[1]) or _by_pint(match[1])
        if unit or not re.fullmatch(r"\w+", match[1]):
            text = text[: match.start()]
    if not unit and (match := _PER.search(text)):  # meters_per_sec
        what = match[1][:3] if match[1][0] in "rdRD" else match[1][0] + "m" * (match[1][0] in "kK")
        what = match[1] if match[1].lower() in ("cm", "mm") else what
        unit, text = known_unit(f"{what}/{match[2][0]}".lower()), text[: match.start()]
    if not unit and not re.search(r"quat|orient|rotation|axis", text, re.IGNORECASE):
        for tail in _TAILS:
            match = re.search(tail, text)
            short = match and match[1] in ("min", "h", "d") and not re.match("time|elapsed", text, re.IGNORECASE)
            if match and not short and (unit := known_unit(match[1])):
                text = text[: match.start()]
                break
    if not unit and (match := re.search(str(WORDS["ends"]), text, re.IGNORECASE)):
        end = match[match.lastindex or 0]
        unit, text = {"k": "K", "f": "degF", "lb": "lb"}[end.lower()], text[: -len(end) - 1]
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text).lower().replace("ß", "ss")
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", " ", plain).strip(), unit


def known_unit(text: str) -> str:
    """The unit as a map writes it, or nothing."""
    unit = WORDS["spellings"].get(text, text)
    small = text.lower()
    plain = (
        small if small in UNITS and UNITS[small][0] in ("speed", "yaw rate") and small != "rpm" else ""
    )  # Mph, DEG/S
    return unit if unit in UNITS else str(WORDS["spellings"].get(small, plain))


@functools.cache
def _by_pint(text: str) -> str:
    """A unit that is rare (``ft/s``, ``knot``, ``hp``, ``0.1V``), as it is written; empty where it is none of what logs
    hold, or the name of a rail (``12V``)."""
    if re.match(r"\d", text) and not re.match(r"0?\.0*1(?!\d)|10 ?m[AVW]", text):
        return ""
    for dimension in WORDS["units"]:
        if dimension not in ("fraction", "charge"):
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


@dataclass(frozen=True)
class Field:
    """One column or field that a source offers, with the values that were looked at."""

    name: str
    count: int
    values: ColumnData
    time_s: Array | None = None
    title: str = ""
    joined: bool = False
    """Of a table among several: the name of its file stands before its own."""

    def range(self) -> str:
        """Lowest and highest value, or the first words."""
        if isinstance(self.values, Labels):
            return ", ".join(self.values.names[:4])[:60] + (", …" if len(self.values.names) > 4 else "")
        known = self.values[np.isfinite(self.values)]
        if not len(known):
            return ""
        low, high = float(known.min()), float(known.max())
        return f"{low:.6g}" if low == high else f"{low:.4g} … {high:.4g}"


def fields_of(path: Path, reader: Reader | None = None, most: int = 20_000) -> list[Field]:
    """What a source holds, for listings and suggestions: columns of a table, or fields of the topics of a recording. At
    most `most` rows or messages of a topic are looked at."""
    reader = reader or reader_of(path)
    if reader.table is not None:
        raw = reader.table(path, Options(most=most))
        titles = {remark.column: TIME_STAMP for remark in raw.remarks if remark.message == TIME_STAMP}
        return [Field(name, len(data), data, title=titles.get(name, "")) for name, data in raw.columns.items()]
    found = recorded(reader, path, Options(most=most))
    topics = sorted(found.topics, key=lambda topic: topic.name)
    return [Field(f"{one.name} ({one.title})", one.count, np.empty(0)) for one in topics if one.undefined] + [
        Field(f"{one.name}.{name}", one.count or len(data), data, one.time_s + found.start_s, one.title)
        for one in topics
        for name, data in one.columns.items()
    ]


@dataclass(frozen=True)
class Role:
    """Something that a log may hold, and how names say it."""

    name: str
    dimension: str
    """Of its unit."""
    words: str
    prefer: str = r"$^"
    avoid: str = r"$^"
    by_unit: str = r"$^"
    """All four: patterns over the words of the name: needed, better, worse, and enough beside a unit of it."""
    low: float = 0.0
    high: float = np.inf
    """Both: what the 95 % point of the magnitude lies between, in the glossary's unit."""
    _: KW_ONLY
    second: str = r"(?!)"
    """Pattern of what is good where there is no other."""


def _pattern(given: str | Sequence[str]) -> str:
    """A pattern as the file says it: it may be one of several, and some have names."""
    return "|".join(WORDS["patterns"].get(one, one) for one in ([given] if isinstance(given, str) else given))


PATTERNS = {name: _pattern(given) for name, given in WORDS["patterns"].items()}
_OF_ROLE = ("words", "prefer", "avoid", "second", "by_unit")
ROLES = {
    name: Role(name, **told | {key: _pattern(told[key]) for key in _OF_ROLE if key in told})
    for name, told in WORDS["roles"].items()
}


def says(pattern: str, words: str) -> bool:
    """Whether words have what one of the file's patterns stands for."""
    return re.search(PATTERNS[pattern], words) is not None


@dataclass(frozen=True)
class Guess:
    """What a field perhaps is."""

    role: str
    field: str
    unit: str
    """As a map writes it; empty where it is the glossary's."""
    score: float
    why: str
    sure: str
    """``sure``, ``likely`` or ``a guess``."""

    def words(self) -> str:
        """For a listing."""
        return f"{self.role}{f' in {self.unit}' if self.unit else ''} ({self.sure})"


def size_of(unit: str) -> float:
    """How much of the glossary's unit one of a map's units is; 1 where none is named."""
    return UNITS[unit][1] if unit else 1.0


def folded(field: Field) -> str | None:
    """Why a listing need not show a field, such as ``constant`` or ``empty``; None where it should."""
    if re.search(r"covariance|header\.(stamp|seq)|\.name\[\d+\]$", field.name):
        return "stamp or covariance"
    if not len(field.values) and field.count:
        return "of a type that is not defined in it"
    if isinstance(field.values, Labels):
        used = np.unique(field.values.codes)
        return "empty" if (used < 0).all() else "constant" if len(used) == 1 and len(field.values) > 1 else None
    known = field.values[np.isfinite(field.values)]
    if not len(known):
        return "empty"
    return "constant" if len(known) > 1 and float(np.ptp(known)) == 0.0 else None


def guess_all(fields: Sequence[Field]) -> dict[str, Guess]:
    """The best guess for every field that looks like something."""
    found: dict[str, Guess] = {}
    for field in fields:
        guesses = [guess for role in ROLES.values() if (guess := guess_role(field, role)) is not None]
        if guesses:
            found[field.name] = max(guesses, key=lambda guess: guess.score)
    return found


def _inner_name(field: Field) -> str:
    """The name without its topic or file, unless what is left says nothing (``/battery/voltage.data``) or is a letter
    that is a unit: of a message (``data.v``) but for those of motion, and of a file of a meter."""
    name = field.name
    if letter := re.fullmatch(r"(.+)\.([avw])", name):
        meter, moves = (says(one, words_of(letter[1])[0]) for one in ("meter", "motion"))
        return name if (meter if field.joined else not moves) else letter[2]
    topic = re.match(
        r"(/[^.\[]+(?:\[[^\]]+\])?|(?!linear\.|angular\.)[a-z_][A-Za-z0-9_]*(?:\[[^\]]*\])?)\.(?=\D)", name
    )
    inner = name[topic.end() :] if topic else name
    return name if inner in ("data", "value") else inner


def guess_role(field: Field, role: Role) -> Guess | None:
    """How well a field fits a role; None where it does not."""
    known, text = column_of(field.name), isinstance(field.values, Labels)
    if known is not None and text != (role.dimension == "text") and role.name != "time":
        return None
    if known is not None and not ("<" in known[0].name and re.search(role.avoid, known[1].replace("_", " "))):
        own = WORDS["columns"].get(known[0].name)
        return Guess(role.name, field.name, "", 3.0, "a name of the glossary", "sure") if own == role.name else None
    words = words_of(re.sub(r"status(?=[^.]*\.)", "", field.name, flags=re.I))[0]  # a file or topic may be called so
    inner = _inner_name(field)
    tail, unit = words_of(inner)
    typical, _, typical_unit = WORDS["messages"].get(field.title, {}).get(role.name, "").partition(" ")
    if not unit and role.name in ("left", "right") and re.search(r"\brpm\b", words):
        unit = "rpm"
    of_type = typical != "" and field.name.endswith(typical)
    unit = typical_unit if of_type and typical_unit else unit
    dimension = UNITS[unit][0] if unit else ""
    named = re.search(role.words, tail) is not None or (tail == "" and dimension == role.dimension != "")
    if role.name == "time":
        return _as_time(field, words, unit, named or field.title == TIME_STAMP)
    if text != (role.dimension == "text") or folded(field) not in (None, "constant"):
        return None
    if text:
        return Guess(role.name, field.name, "", 1.0, f"'{field.name}' holds words", "likely") if named else None
    own_dimension = dimension == role.dimension or (role.name in ("left", "right") and dimension == "yaw rate")
    named = named or (own_dimension and re.search(role.by_unit, tail) is not None)
    letter = re.fullmatch(r"[a-z]", tail) is not None
    if letter and not unit and folded(field) == "constant":
        return None  # a flag, or the number of a device
    short = letter and own_dimension
    if not (named or short or of_type) and not (
        own_dimension and role.name in ("power", "voltage", "current", "speed")
    ):
        return None
    if unit and not own_dimension and not (role.name == "slope" and unit == "%"):
        return None
    numbers = np.asarray(field.values)
    values = np.abs(numbers[np.isfinite(numbers)])
    large = float(np.quantile(values, 0.95)) if len(values) else 0.0
    if tail == "" and large * size_of(unit) > role.high:
        unit, own_dimension = "", False  # a column that is called V holds millivolts
    if role.name == "speed" and not unit and re.match(r"V(?![A-Za-z])", inner):
        return None  # volts
    score = 1.0 * named + 0.8 * own_dimension
    reasons = ["the name"] * named + [f"its unit {unit}"] * own_dimension
    score += 0.5 * (re.search(role.prefer, words) is not None)
    if re.search(role.avoid, words):
        score -= 1.0
    elif re.search(role.second, words):
        score -= 0.4
    strange = re.search(r"[\[(]\s*([^\[\]()\s]{1,12})\s*[\])]\s*\Z", field.name)
    if not unit and strange and re.search(r"[/^²³°%]|^[a-zA-Z]{1,3}\Z", strange[1]):
        score -= 0.5
        factor = 1.0
        reasons.append(f"its unit {strange[1]} is not known, so it was not converted")
    else:
        # without a unit the glossary's, unless the values are far too large for it
        sizes = WORDS["sizes"].get(role.dimension, {}) if not unit and role.name not in ("left", "right") else {}
        fits = (u for u, limit in sizes.items() if large <= limit and large * size_of(u) <= role.high)
        if by_size := next(fits, ""):
            unit = by_size
            reasons.append(f"{unit} by its size (up to {large:.4g})")
            score -= 0.2
        factor = size_of(unit)
    if not role.low <= large * factor <= role.high:
        score -= 0.7
        reasons.append(f"its values, up to {large:.4g}, do not fit well")
    if typical:
        score += 0.9 if of_type else -0.3
        reasons.append(f"its type {field.title}")
    if score <= 0.3:
        return None
    sure = "sure" if score >= 1.7 else "likely" if score >= 0.9 else "a guess"
    plain = "" if unit and UNITS[unit][1] == 1.0 and unit != "K" else unit
    return Guess(role.name, field.name, plain, score, ", ".join(reasons), sure)


def _as_time(field: Field, words: str, unit: str, named: bool) -> Guess | None:
    if isinstance(field.values, Labels):
        names = field.values.names[:20]
        if not names or not all(is_stamp(name) for name in names):
            return None
        dated = ":" in names[0]
        return Guess("time", field.name, "", 1.6 + 0.1 * dated, "time stamps", "sure")
    known = field.values[np.isfinite(field.values)]
    if not named or len(known) < 2 or (unit and UNITS[unit][0] != "duration"):
        return None
    step = np.diff(known)
    if (step < 0).mean() > 0.05 or (step > 0).mean() < 0.02:
        return None
    usual = float(np.median(step[step > 0]))
    score = 1.0 + 0.8 * bool(unit) + 0.3 * (re.fullmatch(r"t|time|times?tamps?|stamp", words) is not None)
    score -= 0.4 * (re.search(r"\b(ros|header|of|since|flight|up)\b", words) is not None)
    in_days = False
    try:
        stamps = numbers_as_times(known)
    except TimeError:  # days, or seconds of a clock
        stamps, in_days = Stamps(known, "own", "days or seconds", likely=False), True
    epoch = stamps.kind != "own" and not (unit and stamps.kind == "day")  # hours lie below one as well
    if not unit and in_days:
        return Guess("time", field.name, "d", score, "days, as spreadsheets count them", "likely")
    why = "grows from row to row" + (
        ", an epoch" if stamps.kind == "utc" else f", {stamps.form}" if epoch else f", {unit}" if unit else ""
    )
    if not unit and not epoch and usual >= 5.0 and (step == np.round(step)).all():
        # whole numbers that are no seconds: the unit in which a row lasts 1 ms to 10 s, and all of them 20 s or more
        span = float(known[-1] - known[0])
        scales = {name: UNITS[name][1] for name in ("ms", "us", "ns")}
        fits = (name for name, scale in scales.items() if 1e-3 <= usual * scale <= 10 and span * scale > 20)
        if fine := next(fits, ""):
            return Guess("time", field.name, fine, score - 0.3, f"{why}, {fine} by its steps of {usual:g}", "likely")
    sure = "a guess" if not stamps.likely else "sure" if score > 1.2 else "likely"
    return Guess("time", field.name, "" if unit == "s" or epoch else unit, score, why, sure)
