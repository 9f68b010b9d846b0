"""Covariates, one line each: what power may depend on, how it is shown, what is assumed where a log lacks it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np

from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.physics import Array


@dataclass(frozen=True)
class Covariate:
    """What compare, fit and diagnosis know of one covariate; its unit and range stand in the glossary."""

    name: str
    title: str
    """Both: glossary name, and how people read it."""
    unit: str = ""
    """Unit that is shown, and `factor` the way there from the glossary's unit."""
    factor: float = 1.0
    magnitude: bool = False
    """Whether power depends on its size and not on its sign."""
    multiplies_speed: bool = False
    """Whether its power is a force, so that an error grows with the speed."""
    noisy_form: bool = False
    """Whether its noise bends the curve of a right effect, as that of an inclinometer on level floors does."""
    ramps: bool = False
    """Whether it acts beside changes of speed, which clocks and averaging blur."""
    _: KW_ONLY
    follows: str = ""
    """Logged column that it is derived from."""
    assumed: str = ""
    """What it means that a log lacks it: it counts as nought. Empty where nothing may be assumed."""
    text: bool = False
    shown: bool = True
    """Whether the error is looked at along it."""
    word: str = ""
    """In a sentence, where that is not its title."""
    symbol: str = ""
    """In a law."""


_ALL = (
    Covariate("speed_m_s", "speed", "m/s", symbol="v"),
    Covariate("yaw_rate_rad_s", "yaw rate (magnitude)", "rad/s", magnitude=True, assumed="the robot drives straight",
              word="turn rate", symbol="ω"),
    Covariate("accel_m_s2", "acceleration", "m/s²", ramps=True, follows="speed_m_s", symbol="a"),
    Covariate("lateral_speed_m_s", "sideways speed (magnitude)", "m/s", magnitude=True, word="sideways speed",
              symbol="u", assumed="the robot does not move sideways"),
    Covariate("slope_rad", "slope", "°", 180.0 / math.pi, multiplies_speed=True, noisy_form=True,
              assumed="the ground is level", symbol="θ"),
    Covariate("payload_kg", "payload", "kg", multiplies_speed=True, assumed="nothing is carried", symbol="payload"),
    Covariate("temp_ambient_c", "ambient temperature", "°C", multiplies_speed=True, symbol="T"),
    Covariate("temp_motor_c", "motor temperature", "°C", multiplies_speed=True, symbol="T_motor"),
    Covariate("cpu_load", "processor load", symbol="load"),
    Covariate("cpu_freq_hz", "processor clock", "GHz", 1e-9, symbol="f"),
    Covariate("access_point_distance_m", "distance to the access point", "m", symbol="d"),
    Covariate("surface", "surface", text=True, word="floor"),
    Covariate("scheme", "control scheme", text=True),
    Covariate("navigation", "navigation", text=True),
    Covariate("segment", "segment", text=True),
    Covariate("heading_rad", "heading", "rad", shown=False),
    Covariate("moving_time_s", "time driven", "s", follows="speed_m_s", shown=False, word="time spent moving",
              symbol="t_moving"),
    Covariate("starts", "starts from rest", follows="speed_m_s", shown=False),
)  # fmt: skip
COVARIATES = {one.name: one for one in _ALL}
MOTION = frozenset(("speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s", "accel_m_s2"))
"""How the robot itself moves, whatever the ground."""


def known(name: str) -> Covariate:
    """What is known of a column; of one that is not listed, its name alone."""
    return COVARIATES.get(name) or Covariate(name, name)


ASSUMED = {one.name: one.assumed for one in _ALL if one.assumed}
"""Columns that count as nought where a log lacks them, and what that means."""
# what is measured of the load follows it, so it can never be its cause; places and clocks of memory are no physics
_NO_CAUSE = re.compile(
    r"(^|_)(voltage|volts?|energy|soc|charge|charging)(_|$)|^power_.+_w$|^current_.+_a$"
    r"|^(x_m|y_m|segment|starts|starts_per_s|body_mass_kg|mass_kg|regeneration|drive_w|traction_w|load_w|moving)$"
    r"|^on_time_"
    r"|(^|_)(latitude|longitude|lat|lon|altitude|[hvp]dop|satellites|sats|covariance|seq|stamp)(_|$)"
)
_ORDER = frozenset(
    ("cmd", "command", "commanded", "setpoint", "target", "desired", "goal", "requested", "reference", "ref")
)
_MOVES = frozenset(
    (
        *("speed", "velocity", "vel", "linear", "angular", "yaw", "omega", "turn", "twist", "steer", "steering"),
        *("accel", "acceleration", "throttle", "rpm", "wheel", "heading", "v", "x", "y", "z"),
    )
)
"""Both: words of a motion that was asked for. It costs what the motion costs that follows."""
_ELECTRICAL = frozenset(("power", "pwr", "watt", "watts", "current", "currents", "amp", "amps"))
_NO_PART = frozenset(
    (
        *("w", "kw", "mw", "a", "ma", "mean", "avg", "average", "raw", "filtered", "max", "min", "peak", "rms"),
        *("limit", "measured", "meter", "predicted", "model", "reference", "demand", "consumed", "consumption"),
        *("used", "usage"),
    )
)
"""Words that name no part of a robot."""
_WHOLE = frozenset(
    (
        *("battery", "batt", "bat", "pack", "cell", "main", "robot", "base", "platform", "vehicle", "car", "system"),
        *("charger", "dock", "regen", "brake", "mech", "mechanical", "motor", "motors", "drive", "driver", "wheel"),
        *("wheels", "traction", "propulsion", "engine", "inverter", "esc", "left", "right", "front", "rear", "total"),
        *("sum", "net", "gross", "whole", "input", "output", "supply", "electric", "electrical", "dc", "bus"),
    )
)
"""Words of what is the whole, or follows it."""
TWIN, TWIN_OF_RUNS = 0.999, 0.99995
"""Correlation from which on a column is another one in other units; of one that is constant in every run, which a few
points make: rain that fell on the cold days is no temperature."""
_ROWS = 20_000


def may_be_cause(name: str) -> bool:
    """Whether power may depend on a column; what is measured of the load follows it and is never its cause, and what is
    asked for (``cmd_speed_m_s``) is none beside what is driven. Power and current of a part that is none of battery and
    drive (``arm_power``, ``gripper_current_a``) may be one."""
    words = re.sub(r"\d+", "", name).split("_")
    if not (_ORDER.isdisjoint(words) or _MOVES.isdisjoint(words)):
        return False
    if not _ELECTRICAL.intersection(words):
        return not _NO_CAUSE.search(name)
    part = {*words} - _ELECTRICAL - _NO_PART - {""}
    return bool(part) and _WHOLE.isdisjoint(words) and not _NO_CAUSE.search(name)


def repeated(runs: Sequence[Mapping[str, object]]) -> dict[str, str]:
    """Columns beyond the glossary that are a straight line of one in it over all runs (km/h, rpm), and of which.
    `runs`: covariates of each run, arrays of shape (n,)."""
    every = 1 + sum(np.asarray(run["time_s"]).size for run in runs) // _ROWS
    theirs: dict[str, Array] = {}
    others: dict[str, Array] = {}
    for name in sorted(set.intersection(*(set(run) for run in runs))):
        data = [np.asarray(run[name]) for run in runs if not isinstance(run[name], Labels)]
        shapes = [np.asarray(run["time_s"]).shape for run in runs]
        if [one.shape for one in data] != shapes or any(one.dtype.kind not in "fiub" for one in data):
            continue
        column = column_of(name)
        if name in COVARIATES or name == "time_s" or (column is not None and column[0].kind == "number"):
            theirs[name] = np.concatenate([one.astype(float) for one in data])[::every]
        elif may_be_cause(name) and not is_switch(name):
            others[name] = np.concatenate([one.astype(float) for one in data])[::every]
    found = {}
    for name, own in others.items():
        constant = all(np.ptp(np.asarray(run[name], dtype=float)) == 0.0 for run in runs)
        least = TWIN_OF_RUNS if constant else TWIN
        for other, known in theirs.items():
            if any(abs(_correlation(own, one)) > least for one in (known, np.abs(known))):
                found[name] = other
                break
    return found


def _correlation(a: Array, b: Array) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if not (both.any() and np.ptp(a[both]) > 0.0 and np.ptp(b[both]) > 0.0):
        return 0.0
    return float(np.corrcoef(a[both], b[both])[0, 1])


def remarks_on(runs: Sequence[Mapping[str, object]]) -> list[str]:
    """What to know of columns beyond the glossary: which are left out, and which should have another name."""
    told = [f"{name} is a straight line of {other}: no law reads it" for name, other in repeated(runs).items()]
    for name in sorted(set.intersection(*(set(run) for run in runs))):
        if "power" in name.split("_") and may_be_cause(name) and not name.endswith(("_w", "_kw")):
            told.append(f"{name} names no unit: if it is in watts, log it as {name}_w, and it is passed through")
    return told


def is_switch(name: str) -> bool:
    """Whether a column says how many units of a component are switched on."""
    return name.startswith("on_") and not name.startswith("on_time_")


def clock_of(switch: str) -> str:
    """The clock of memory that follows from a switch: time since the component was switched on."""
    return f"on_time_{switch[3:]}_s"


def logged_name(name: str) -> str:
    """The column of a log that a covariate comes from."""
    if name.startswith("on_time_"):
        return f"on_{name.removeprefix('on_time_').removesuffix('_s')}"
    return known(name).follows or name
