"""Covariates, one line each: what power may depend on, how it is shown, what is assumed where a log lacks it."""

from __future__ import annotations

import math
import re
from dataclasses import KW_ONLY, dataclass


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


_ALL = (
    Covariate("speed_m_s", "speed", "m/s"),
    Covariate("yaw_rate_rad_s", "yaw rate (magnitude)", "rad/s", magnitude=True, assumed="the robot drives straight"),
    Covariate("accel_m_s2", "acceleration", "m/s²", ramps=True, follows="speed_m_s"),
    Covariate(
        "lateral_speed_m_s",
        "sideways speed (magnitude)",
        "m/s",
        magnitude=True,
        assumed="the robot does not move sideways",
    ),
    Covariate(
        "slope_rad",
        "slope",
        "°",
        180.0 / math.pi,
        multiplies_speed=True,
        noisy_form=True,
        assumed="the ground is level",
    ),
    Covariate("payload_kg", "payload", "kg", multiplies_speed=True, assumed="nothing is carried"),
    Covariate("temp_ambient_c", "ambient temperature", "°C", multiplies_speed=True),
    Covariate("temp_motor_c", "motor temperature", "°C", multiplies_speed=True),
    Covariate("cpu_load", "processor load"),
    Covariate("cpu_freq_hz", "processor clock", "GHz", 1e-9),
    Covariate("access_point_distance_m", "distance to the access point", "m"),
    Covariate("surface", "surface", text=True),
    Covariate("scheme", "control scheme", text=True),
    Covariate("navigation", "navigation", text=True),
    Covariate("segment", "segment", text=True),
    Covariate("heading_rad", "heading", "rad", shown=False),
    Covariate("moving_time_s", "time driven", "s", follows="speed_m_s", shown=False),
    Covariate("starts", "starts from rest", follows="speed_m_s", shown=False),
)
COVARIATES = {one.name: one for one in _ALL}


def known(name: str) -> Covariate:
    """What is known of a column; of one that is not listed, its name alone."""
    return COVARIATES.get(name) or Covariate(name, name)


ASSUMED = {one.name: one.assumed for one in _ALL if one.assumed}
"""Columns that count as nought where a log lacks them, and what that means."""
# electrical quantities follow the load, so they can never be its cause; places and clocks of memory are no physics
_NO_CAUSE = re.compile(
    r"(^|_)(power|voltage|volts?|current|amps?|energy|soc|charge)(_|$)"
    r"|^(x_m|y_m|segment|starts|starts_per_s|body_mass_kg|mass_kg|regeneration|drive_w|load_w|moving)$"
    r"|^on_time_"
)


def may_be_cause(name: str) -> bool:
    """Whether power may depend on a column; what is measured of the load follows it and is never its cause."""
    return not _NO_CAUSE.search(name)


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
