"""The one glossary: log columns and model covariates share names, units and ranges (contract, "Measured log")."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

STILL_SPEED_M_S = 0.005
"""Below this speed (and `STILL_YAW_RATE_RAD_S`) a robot stands still (contract)."""
STILL_YAW_RATE_RAD_S = 0.02
GRAVITY_M_S2 = 9.80665
"""Standard gravity, CGPM 1901."""


@dataclass(frozen=True)
class Column:
    """A quantity of the glossary: name (or pattern with one ``<…>`` part), unit, plausible range, meaning, kind."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    kind: str = "number"
    """``number``, ``text`` or ``count``."""


COLUMNS: tuple[Column, ...] = (
    Column("time_s", "s", 0.0, 1e9, "time from the start of the run, increasing"),
    Column("power_<battery>_w", "W", -1e6, 1e6, "power that the battery delivers"),
    Column("voltage_<battery>_v", "V", 0.0, 2000.0, "battery voltage"),
    Column("current_<battery>_a", "A", -1e4, 1e4, "current that the battery delivers"),
    Column("energy_<battery>_wh", "Wh", -1e6, 1e7, "cumulative energy that the battery delivered"),
    Column("speed_m_s", "m/s", -60.0, 60.0, "forward speed"),
    Column("accel_m_s2", "m/s^2", -50.0, 50.0, "rate of the forward speed"),
    Column("yaw_rate_rad_s", "rad/s", -30.0, 30.0, "turn rate"),
    Column("lateral_speed_m_s", "m/s", -60.0, 60.0, "sideways speed, of robots that move sideways"),
    Column("x_m", "m", -1e7, 1e7, "position"),
    Column("y_m", "m", -1e7, 1e7, "position"),
    Column("heading_rad", "rad", -1e4, 1e4, "heading"),
    Column("slope_rad", "rad", -1.3, 1.3, "road grade in the direction of travel, uphill positive"),
    Column("payload_kg", "kg", 0.0, 1e5, "load carried"),
    Column("surface", "", 0.0, 0.0, "name of the floor", "text"),
    Column("temp_ambient_c", "degC", -90.0, 90.0, "ambient temperature"),
    Column("temp_motor_c", "degC", -90.0, 300.0, "motor temperature"),
    Column("on_<component>", "1", 0.0, 1000.0, "how many units are switched on", "count"),
    Column("cpu_load", "1", 0.0, 1.0, "processor load, 0 to 1"),
    Column("cpu_freq_hz", "Hz", 0.0, 1e11, "processor clock"),
    Column("access_point_distance_m", "m", 0.0, 1e6, "distance to the radio access point"),
    Column("scheme", "", 0.0, 0.0, "control scheme", "text"),
    Column("navigation", "", 0.0, 0.0, "navigation of the control scheme", "text"),
    Column("segment", "", 0.0, 0.0, "number or name of the mission's segment", "text"),
)

_PATTERNS = tuple(
    (
        re.compile(
            "^"
            + re.escape(column.name)
            .replace("<battery>", "(?P<of>[a-z0-9_]+?)")
            .replace("<component>", "(?P<of>[a-z0-9_]+?)")
            + "$"
        ),
        column,
    )
    for column in COLUMNS
)


@functools.lru_cache(maxsize=4096)
def column_of(name: str) -> tuple[Column, str] | None:
    """The glossary's column for a name, and the battery or component inside it (empty where there is none).

    Returns None for a name that the glossary does not hold (such columns are kept and may be named in a user's effect).
    """
    for pattern, column in _PATTERNS:
        match = pattern.match(name)
        if match:
            return column, match.groupdict().get("of") or ""
    return None
