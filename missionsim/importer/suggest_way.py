"""Suggestions for a speed where only degrees of a receiver, or counts of wheels, are logged."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.roles import Field, Guess, folded, words_of
from missionsim.labels import Labels

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft

_METRES_A_DEGREE = 111_195.0
"""Of latitude, on a sphere with the Earth's mean radius."""
_MOVED_M = 2.0
"""A receiver whose positions reach farther has moved."""
_COUNTS = r"\b(ticks?|counts?|enc(oders?)?|pulses?)\b"
_SIDES = {"left": r"\b(left|l)\b", "right": r"\b(right|r)\b"}


def from_degrees(draft: Draft) -> bool:
    """Add the speed as the rate of latitude and longitude; whether they were found and move."""
    numbers = {words_of(name)[0]: name for name, one in draft.fields.items() if _has_numbers(one)}
    lat, lon = (
        next((name for words, name in numbers.items() if re.search(rf"\b{axis}\Z", words)), "")
        for axis in ("lat(itude)?", "lon(gitude)?|lng")
    )
    if not lat or not lon:
        return False
    degrees = [draft.values(name) for name in (lat, lon)]
    middle = float(np.nanmedian(degrees[0]))
    scales = (_METRES_A_DEGREE, _METRES_A_DEGREE * float(np.cos(np.radians(middle))))
    reach = max(float(np.nanmax(one) - np.nanmin(one)) * scale for one, scale in zip(degrees, scales, strict=True))
    if not (abs(middle) < 90 and _MOVED_M < reach < 1e6):
        return False
    time_s = draft.time_s if draft.direct else draft.fields[lat].time_s
    step = float(np.nanmedian(np.diff(time_s))) if time_s is not None and len(time_s) > 1 else 0.0
    told = Guess("speed", f"{lat}\n{lon}", "", 0.6, "rate of latitude and longitude, without its sign", "a guess")
    for axis, name, scale in zip("yx", (lat, lon), scales, strict=True):
        ref = draft.ref(name, f"degrees_{axis}")
        draft.fills |= {} if draft.direct else {ref: "linear"}
        draft.columns[f"_v{axis}_m_s"] = (
            f"{{differentiate: {ref} * {scale:.0f}, average: {max(1.0, 2.0 * step):.3g} s}}",
            told,
        )
    draft.column("speed_m_s", "hypot(_vx_m_s, _vy_m_s)", told)
    return True


def from_counts(draft: Draft) -> bool:
    """Add the speed as the rate of the counts of both wheels' encoders, with a question; whether they are there."""
    found: dict[str, str] = {}
    for name, one in draft.fields.items():
        words = words_of(name)[0]
        whole = _has_numbers(one) and re.search(_COUNTS, words) and not np.nan_to_num(draft.values(name) % 1.0).any()
        for side in [side for side, pattern in _SIDES.items() if whole and re.search(pattern, words)]:
            found.setdefault(side, name)
    if len(found) < 2:
        return False
    message = "counts of wheels: put the way of one count in the place of METRES (the turn rate is the difference "
    draft.missing.append(f"{message}of both rates by the track)")
    draft.head["constants"] = "{count_m: METRES m}"
    refs = " + ".join(draft.ref(name, f"count_{side}") for side, name in sorted(found.items()))
    told = Guess("speed", "\n".join(found.values()), "", 0.6, "rate of the counts of both wheels", "a guess")
    draft.columns["speed_m_s"] = (f"{{differentiate: ({refs}) / 2 * count_m, average: 0.5 s}}", told)
    return True


def _has_numbers(one: Field) -> bool:
    return not isinstance(one.values, Labels) and folded(one) in (None, "constant")
