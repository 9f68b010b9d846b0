"""What a column or field of a logger perhaps is: by its name, the unit in it, its values, the type of its message."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.glossary import column_of
from missionsim.importer.fields import Field
from missionsim.importer.units import UNITS, words_of
from missionsim.labels import Labels
from missionsim.logs.times import is_stamp

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Role:
    """Something that a log may hold, and how names say it.

    Attributes
    ----------
    name : str
    dimension : str
        Of its unit.
    words, prefer, avoid : str
        Patterns over the words of the name: needed, better, worse.
    low, high : float
        What the 95 % point of the magnitude lies between, in the glossary's unit.
    """

    name: str
    dimension: str
    words: str
    prefer: str = r"$^"
    avoid: str = r"$^"
    low: float = 0.0
    high: float = np.inf


_COMMAND = (
    r"\b(cmd\w*|command\w*|target|desired|set ?point|requested|reference|ref|goal|limit|max|min|diff|status|level)\b"
)
_PART = r"\b(cell\w*|motors?|heat\w*|air ?con\w*|cpu|shunt|load|charger|solar|cabin|servo\w*|pwm|factor)\b"
_WHOLE = r"\b(battery|batt?|bus|pack|system|total|robot|main|input|vbat|ibat)\b"
_SIDES = r"\b(left|right|front|rear|l|r|fl|fr|rl|rr|wheel|joint\w*|motor\w*)\b"

_NO_SPEED = r"\b(current|voltage|effort|torque|temp\w*|position|angle)\b"
_PLACE = r"\b(position|pos|pose|odom\w*|location|loc)\b"
_NO_PLACE = f"{_COMMAND}|\\b(orient\\w*|quat|covariance|twist|linear|angular|acc\\w*)\\b"


def _side(side: str) -> str:
    moving = r"\b(speed|velocity|vel|rpm|wheel|v)\b"
    return rf"\b({side})\b.*{moving}|{moving}.*\b({side})\b"


ROLES: tuple[Role, ...] = (
    Role(
        "time",
        "duration",
        r"\b(time|times?tamp|stamp|t|clock|secs?|seconds|elapsed|epoch|utc|date ?time|date"
        r"|ts|ms|us|zeit\w*|datum|uhrzeit|temps|tiempo|heure|horodatage|fecha|hora|tempo|data|ora|tijd\w*|czas)\b",
        r"\b(t|time|times?tamp|stamp|elapsed)\b",
        r"\b(of|since|remaining|duration|charge|left|ros|header|flight|up)\b",
    ),
    Role(
        "power",
        "power",
        r"\b(power|watts?|pwr|p|pbatt?|pdc|p batt?|\w*leistung|puissance|potencia|potenza|vermogen|moc)\b",
        _WHOLE,
        f"{_PART}|{_COMMAND}|\\bsupply\\b",
        0.05,
        2e5,
    ),
    Role(
        "voltage",
        "voltage",
        r"\b(voltage|volts?|[vu]batt?|[uv]dc|[vu]bus|vin|u|[vu] (?:batt?|battery|bus|in|dc|pack)"
        r"|\w*spannung|tension|voltaje|tensao|tensione|spanning|napiecie)\b",
        _WHOLE,
        f"{_PART}|{_COMMAND}|{_SIDES}",
        1.0,
        1000.0,
    ),
    Role(
        "current",
        "current",
        r"\b(current|amps?|amperes?|ibatt?|idc|ibus|iin|i|i (?:batt?|battery|bus|in|dc|pack)"
        r"|\w*strom|courant|corriente|corrente|stroom|prad)\b",
        _WHOLE,
        f"{_PART}|{_COMMAND}|{_SIDES}",
        0.005,
        1000.0,
    ),
    Role(
        "energy",
        "energy",
        r"\b(energy|wh|kwh|consumed|joules?|\w*energie|energia)\b",
        _WHOLE,
        f"{_PART}|\\b(remaining|left)\\b",
        0.01,
        1e6,
    ),
    Role(
        "speed",
        "speed",
        r"\b(speed|velocity|vel|v|linear x|vx|ground ?speed|kmh|(?!dreh|winkel)\w*geschwindigkeit"
        r"|vitesse|velocidade?|velocita|snelheid|predkosc"
        r"|(?:odom\w*|twist|robot|base) linear|linear|lin vel)\b",
        r"\b(linear x|vehicle|robot|odom\w*|speed)\b",
        f"{_COMMAND}|{_SIDES}|\\b(angular|omega|vy|vz|wind|y|z|fan|gps|rotational|imu|covariance|acc\\w*)\\b",
        0.01,
        60.0,
    ),
    Role("left", "speed", _side("left|l"), r"\bmeas\w*\b", f"{_COMMAND}|{_NO_SPEED}", 0.01, 500.0),
    Role("right", "speed", _side("right|r"), r"\bmeas\w*\b", f"{_COMMAND}|{_NO_SPEED}", 0.01, 500.0),
    Role(
        "yaw_rate",
        "yaw rate",
        r"\b(yaw ?rate|yawrate|angular( velocity)? z|omega|gyro z|imu z|wz|turn rate|rotational|angular"
        r"|drehrate|gierrate|(?:dreh|winkel)geschwindigkeit|lacet|ang vel)\b",
        r"\b(imu|gyro)\b",
        _COMMAND,
        0.001,
        20.0,
    ),
    Role(
        "slope",
        "angle",
        r"\b(slope|grade|incline|inclination|gradient|steigung|neigung|pente|pendiente|hangneigung)\b",
        avoid=_COMMAND,
        high=1.0,
    ),
    Role("elevation", "length", r"\b(elevation|altitude|alt|hohe)\b", avoid=f"{_COMMAND}|\\b(rel\\w*|baro)\\b"),
    Role("heading", "angle", r"\b(heading|yaw|theta|bearing)\b", avoid=f"{_COMMAND}|\\b(rate|speed|vel\\w*)\\b"),
    Role("x", "length", rf"{_PLACE}.*\bx\b|^ ?x ?$", avoid=_NO_PLACE),
    Role("y", "length", rf"{_PLACE}.*\by\b|^ ?y ?$", avoid=_NO_PLACE),
    Role(
        "distance",
        "length",
        r"\b(distance|odometer|mileage|total ?distance|trip|travelled)\b",
        r"\btotal ?distance\b",
        r"\bpoint\b",
    ),
    Role(
        "temp_ambient",
        "temperature",
        r"\b(ambient|outside|outdoor|environment|aussentemperatur|umgebung\w*|exterieure?)\b",
        avoid=r"\bsensor\b",
        high=70.0,
    ),
    Role("temp_motor", "temperature", r"\bmotors?\b.*\btemp\w*\b|\btemp\w*\b.*\bmotors?\b", high=200.0),
    Role("payload", "mass", r"\b(payload|load mass|cargo|nutzlast|zuladung|charge utile)\b", high=5000.0),
    Role(
        "cpu_load",
        "fraction",
        r"\bcpu\b.*\b(load|usage|percent|util\w*)\b|\b(load|usage|util\w*)\b.*\bcpu\b",
        avoid=r"\btemp\w*\b",
        high=1.01,
    ),
    Role("cpu_freq", "frequency", r"\bcpu\b.*\b(freq\w*|clock)\b"),
    Role("surface", "text", r"\b(surface|floor|terrain|ground|untergrund|boden|sol)\b", avoid=r"\bspeed\b"),
    Role("scheme", "text", r"\b(scheme|tactic|governor)\b"),
)


@dataclass(frozen=True)
class Guess:
    """What a field perhaps is.

    Attributes
    ----------
    role, field : str
    unit : str
        As a map writes it; empty where it is the glossary's.
    score : float
    why : str
    sure : str
        ``sure``, ``likely`` or ``a guess``.
    """

    role: str
    field: str
    unit: str
    score: float
    why: str
    sure: str

    @property
    def rank(self) -> float:
        """The smaller, the earlier in a listing."""
        return 3.0 - self.score

    def words(self) -> str:
        """For a listing."""
        return f"{self.role}{f' in {self.unit}' if self.unit else ''} ({self.sure})"

    def as_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"role": self.role, "field": self.field, "unit": self.unit, "sure": self.sure, "why": self.why}


def _inner(name: str) -> str:
    """A field without its topic or file, unless all that is left says nothing (``/battery/voltage.data``)."""
    topic = re.match(r"(/[^.\[]+(?:\[[^\]]+\])?|[a-z_][A-Za-z0-9_]*(?:\[[^\]]*\])?)\.(?=\D)", name)
    inner = name[topic.end() :] if topic else name
    return name if inner in ("data", "value") else inner


def folded(field: Field) -> str | None:
    """Why a listing need not show a field: ``constant``, ``stamp or covariance``, ``empty``; None where it should."""
    if re.search(r"covariance|header\.(stamp|seq)|\.name\[\d+\]$", field.name):
        return "stamp or covariance"
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
        guesses = [guess for role in ROLES if (guess := guess_role(field, role)) is not None]
        if guesses:
            found[field.name] = max(guesses, key=lambda guess: guess.score)
    return found


def guess_role(field: Field, role: Role) -> Guess | None:
    """How well a field fits a role; None where it does not."""
    known = column_of(field.name)
    if known is not None:
        own = _GLOSSARY.get(known[0].name)
        return Guess(role.name, field.name, "", 3.0, "a name of the glossary", "sure") if own == role.name else None
    text = isinstance(field.values, Labels)
    words, unit = words_of(field.name)
    dimension = UNITS[unit][0] if unit else ""
    tail = words_of(_inner(field.name))[0]
    named = re.search(role.words, tail) is not None or (words == "" and dimension == role.dimension != "")
    if role.name == "time":
        return _as_time(field, words, unit, named)
    if text != (role.dimension == "text") or folded(field) in ("empty", "stamp or covariance"):
        return None
    if text:
        return Guess(role.name, field.name, "", 1.0, f"'{field.name}' holds words", "likely") if named else None
    own_dimension = dimension == role.dimension or (role.name in ("left", "right") and dimension == "yaw rate")
    short = bool(re.fullmatch(r"[a-z]", tail)) and own_dimension
    if not (named or short) and not (own_dimension and role.name in ("power", "voltage", "current")):
        return None
    if unit and not own_dimension and not (role.name == "slope" and unit == "%"):
        return None
    numbers = np.asarray(field.values)
    values = np.abs(numbers[np.isfinite(numbers)])
    large = float(np.quantile(values, 0.95)) if len(values) else 0.0
    if role.name == "speed" and not unit and re.match(r"V(?![a-z])", field.name):
        return None  # volts
    score = 1.0 * named + 0.8 * own_dimension
    reasons = ["the name"] * named + [f"its unit {unit}"] * own_dimension
    score += 0.5 * (re.search(role.prefer, words) is not None)
    if re.search(role.avoid, words):
        score -= 1.0
    strange = re.search(r"[\[(]\s*([^\[\]()\s]{1,12})\s*[\])]\s*\Z", field.name)
    if not unit and strange and re.search(r"[/^²³°%]|^[a-zA-Z]{1,3}\Z", strange[1]):
        score -= 0.5
        factor = 1.0
        reasons.append(f"its unit {strange[1]} is not known, so it was not converted")
    elif not unit:
        unit, factor, told = _by_size(role, large)
        reasons += [told] * bool(told)
        score -= 0.2 * bool(told)
    else:
        factor = UNITS[unit][2]
    if not role.low <= large * factor <= role.high:
        score -= 0.7
        reasons.append(f"its values, up to {large:.4g}, do not fit well")
    if field.title in _TYPES and role.name in _TYPES[field.title]:
        score += 0.9 if field.name.endswith(_TYPES[field.title][role.name]) else -0.3
        reasons.append(f"its type {field.title}")
    if score <= 0.3:
        return None
    sure = "sure" if score >= 1.7 else "likely" if score >= 0.9 else "a guess"
    plain = "" if unit and UNITS[unit][2] == 1.0 and unit != "K" else unit
    return Guess(role.name, field.name, plain, score, ", ".join(reasons), sure)


_GLOSSARY = {
    "time_s": "time", "power_<battery>_w": "power", "voltage_<battery>_v": "voltage", "current_<battery>_a": "current",
    "energy_<battery>_wh": "energy", "speed_m_s": "speed", "yaw_rate_rad_s": "yaw_rate", "slope_rad": "slope",
    "heading_rad": "heading", "x_m": "x", "y_m": "y", "temp_ambient_c": "temp_ambient", "temp_motor_c": "temp_motor",
    "payload_kg": "payload", "cpu_load": "cpu_load", "cpu_freq_hz": "cpu_freq", "surface": "surface",
    "scheme": "scheme",
}  # fmt: skip
_ODOMETRY = {
    "speed": "twist.twist.linear.x",
    "yaw_rate": "twist.twist.angular.z",
    "x": "pose.pose.position.x",
    "y": "pose.pose.position.y",
}
_TYPES: dict[str, dict[str, str]] = {
    "sensor_msgs/msg/BatteryState": {"voltage": ".voltage", "current": ".current"},
    "nav_msgs/msg/Odometry": _ODOMETRY,
    "sensor_msgs/msg/Imu": {"yaw_rate": ".angular_velocity.z", "speed": "$", "x": "$", "y": "$"},
    "battery_status": {"voltage": ".voltage_v", "current": ".current_a"},
}
"""Type of a message → role → the field of it; ``$`` for roles that it does not have."""


def _by_size(role: Role, large: float) -> tuple[str, float, str]:
    """Unit of a column without one, its factor, and why: the glossary's, unless the values are far too large."""
    ladder = {
        "speed": (("", 1.0, 12.0), ("km/h", 1 / 3.6, 200.0), ("mm/s", 1e-3, 1e5)),
        "yaw rate": (("", 1.0, 8.0), ("deg/s", np.pi / 180, 2000.0)),
        "voltage": (("", 1.0, 1000.0), ("mV", 1e-3, 1e6)),
        "current": (("", 1.0, 600.0), ("mA", 1e-3, 1e6)),
        "fraction": (("", 1.0, 1.01), ("%", 0.01, 100.5)),
        "angle": (("", 1.0, 7.0), ("deg", np.pi / 180, 400.0)),
    }.get(role.dimension, ())
    if role.name in ("left", "right"):
        return "", 1.0, ""
    for unit, factor, limit in ladder:
        if large <= limit:
            return unit, factor, f"{unit} by its size (up to {large:.4g})" if unit else ""
    return "", 1.0, ""


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
    score = 1.0 + 0.8 * bool(unit) + 0.3 * (re.fullmatch(r"t|time|times?tamp|stamp", words) is not None)
    score -= 0.4 * (re.search(r"\b(ros|header|of|since|flight|up)\b", words) is not None)
    epoch = float(np.median(known)) > 1e8
    if (
        not unit
        and (2e4 < known[0] < 8e4 or 6e5 < known[0] < 8e5)
        and known[-1] - known[0] < 3
        and 0 < np.median(step) < 1e-3
    ):
        return Guess("time", field.name, "d", score, "days, as spreadsheets count them", "likely")
    why = "grows from row to row" + (", an epoch" if epoch else f", {unit}" if unit else "")
    usual = float(np.median(step[step > 0]))
    if not unit and not epoch and usual >= 5.0 and (step == np.round(step)).all():
        # whole numbers that are no seconds: the unit in which a row lasts 1 ms to 10 s, and all of them 20 s or more
        span = float(known[-1] - known[0])
        fits = (
            name for name in ("ms", "us", "ns") if 1e-3 <= usual * UNITS[name][2] <= 10 and span * UNITS[name][2] > 20
        )
        if fine := next(fits, ""):
            return Guess("time", field.name, fine, score - 0.3, f"{why}, {fine} by its steps of {usual:g}", "likely")
    return Guess(
        "time", field.name, "" if unit == "s" or epoch else unit, score, why, "sure" if score > 1.2 else "likely"
    )
