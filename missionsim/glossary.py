"""The one glossary: log columns and model covariates share names, units and ranges (contract, "Measured log")."""

from __future__ import annotations

import csv
import functools
import itertools
import re
from dataclasses import dataclass
from pathlib import Path

STILL_SPEED_M_S = 0.005
"""Below this speed (and `STILL_YAW_RATE_RAD_S`) a robot stands still (contract)."""
STILL_YAW_RATE_RAD_S = 0.02
GRAVITY_M_S2 = 9.80665
"""Standard gravity, CGPM 1901."""


@dataclass(frozen=True)
class Column:
    """A quantity of the glossary: name (or pattern with one ``<…>`` part), unit, kind, plausible range, meaning."""

    name: str
    unit: str
    kind: str
    """``number``, ``text`` or ``count``."""
    low: float
    high: float
    large: float
    perhaps: str
    """Both: a magnitude that its 95 % point hardly exceeds in a mobile robot, and what it then may be."""
    meaning: str


with open(Path(__file__).with_name("glossary.csv"), newline="", encoding="utf-8") as _table:
    COLUMNS = tuple(
        Column(name, unit, kind, float(low), float(high), float(large), perhaps, meaning)
        for name, unit, kind, low, high, large, perhaps, meaning in itertools.islice(csv.reader(_table), 1, None)
    )
_PATTERNS = [(re.compile(f"^{re.sub('<[a-z]+>', '(?P<of>[a-z0-9_]+?)', one.name)}$"), one) for one in COLUMNS]


@functools.lru_cache(maxsize=4096)
def column_of(name: str) -> tuple[Column, str] | None:
    """The glossary's column for a name, and the battery or component inside it (empty where there is none). Returns
    None for a name that the glossary does not hold (such columns are kept and may be named in a user's effect)."""
    for pattern, column in _PATTERNS:
        match = pattern.match(name)
        if match:
            return column, match.groupdict().get("of") or ""
    return None
