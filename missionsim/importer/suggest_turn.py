"""A suggestion for the rate of turning where only a heading is logged."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.roles import words_of
from missionsim.labels import Labels

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft

_SHORTEST_S, _LONGEST_S = 0.3, 2.0
"""Windows of the mean over which a heading is differentiated (assumed; the first as in the map for PX4)."""
_ROUGH_RAD_S = 0.02
"""What the noise and the steps of a heading may make of its rate: beyond it rest would count as turning."""
_COURSE = r"\b(course|cog|g ?crs|crs|gps|hdg|track|bearing)\b"
"""A heading that is the way a receiver moves: at rest, and on the spot, it is noise."""
_MOVES_M_S = 0.3
"""Speed from which a course is told (assumed)."""


def from_heading(draft: Draft) -> None:
    """Add the rate of turning as that of the heading, where a draft has no other; of a course only where it moves."""
    if "yaw_rate_rad_s" in draft.columns or "heading_rad" not in draft.columns:
        return
    guess = draft.columns["heading_rad"][1]
    one = draft.fields[guess.field]
    time_s = draft.time_s if draft.direct else one.time_s
    if isinstance(one.values, Labels) or time_s is None or len(time_s) < 3:
        return
    known = np.isfinite(time_s) & np.isfinite(one.values)
    step = np.diff(time_s[known])
    if not (step > 0).any():
        return
    window = max(_SHORTEST_S, 2.0 * float(np.median(step[step > 0])))
    if guess.why != "attitude":  # of a quaternion there is no angle here
        turned = np.diff(np.unwrap(draft.values(guess.field, guess.unit)[known]))
        moved = np.abs(turned[turned != 0])
        if not len(moved):
            return
        rough = max(float(np.quantile(moved, 0.01)), float(np.median(np.abs(np.diff(turned)))))
        window = max(window, min(rough / _ROUGH_RAD_S, _LONGEST_S))
    rate = f"{{differentiate: heading_rad, average: {window:.1f} s}}"
    told = replace(guess, role="yaw_rate", unit="", sure="likely", why="the rate of the heading: no other is logged")
    if re.search(_COURSE, words_of(guess.field)[0]) is None:
        draft.columns["yaw_rate_rad_s"] = (rate, told)
    elif "speed_m_s" in draft.columns:
        draft.columns["_yaw_rate_rad_s"] = (rate, replace(told, why="a helper, which is no column of the log"))
        why = "the rate of a course, which is noise at rest: none there, nor on the spot"
        formula = f'"where(abs(speed_m_s) > {_MOVES_M_S}, _yaw_rate_rad_s, 0)"'
        draft.columns["yaw_rate_rad_s"] = (formula, replace(told, sure="a guess", why=why))
