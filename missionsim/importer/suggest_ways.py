"""Suggestions for speeds of wheels, positions, degrees or counts, and for a turn rate of a heading."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from missionsim.importer.draft import Draft
from missionsim.importer.roles import ROLES, UNITS, Field, Guess, folded, says, size_of, words_of
from missionsim.labels import Labels
from missionsim.physics import Array


def stride(time_s: Array) -> int:
    """Rows of a second: positions are rough from row to row."""
    return max(1, round(1.0 / max(float(np.median(np.diff(time_s))), 1e-3)))


def path_of(draft: Draft) -> tuple[tuple[Guess, Guess], Array] | None:
    """Guesses for x and y, and the path so far [m], from positions a second apart; None where there are none."""
    x, y = draft.best("x", 0.5), draft.best("y", 0.5)
    time_s = draft.time_s if draft.direct or not x else draft.fields[x[0].field].time_s
    if not x or not y or time_s is None:
        return None
    px, py = draft.values(x[0].field, x[0].unit), draft.values(y[0].field, y[0].unit)
    if len(px) != len(py):
        return None  # of two topics
    known = np.isfinite(px) & np.isfinite(py) & np.isfinite(time_s)
    t = time_s[known]
    if len(t) < 20 or (np.diff(t) < 0).any():
        return None
    rows = stride(t)
    steps = np.hypot(np.diff(px[known][::rows]), np.diff(py[known][::rows]))
    return (x[0], y[0]), np.interp(time_s, t[::rows], np.r_[0.0, np.cumsum(steps)])


_TURNS = r"\b(wheel|encoder|axis|motor|feedback|drive) ?\d*\b(.*\b(vel\w*|speed|rpm)\b)?"
"""What a wheel, or the motor that drives it, is called whose pace is measured."""


def numbered_wheels(draft: Draft) -> list[Guess]:
    """The pace of wheels whose names differ in a number alone: of 2, 4 or 6; else nothing."""
    groups: dict[str, list[Guess]] = {}
    for name, one in draft.fields.items():
        words, unit = words_of(name)
        if folded(one) is not None or isinstance(one.values, Labels) or re.search(ROLES["left"].avoid, words):
            continue
        if not (found := re.search(_TURNS, words)):
            continue
        unit = unit or "rpm" * bool(re.search(r"\brpm\b", words))
        if unit in ("rpm", "rad/s", "deg/s", "" if found[2] else None) and re.search(r"\d", name):
            groups.setdefault(re.sub(r"\d+", "#", name), []).append(Guess("speed", name, unit, 0.9, words, "likely"))
    return next((wheels for wheels in groups.values() if len(wheels) in (2, 4, 6)), [])


def from_wheels(draft: Draft, *wheels: Guess) -> None:
    """The speed by that of all wheels, or of one, and their radius."""
    sides = ("left", "right") if len(wheels) == 2 else range(len(wheels))
    refs = [draft.ref(one.field, f"wheel_{side}") for one, side in zip(wheels, sides, strict=True)]
    turns = [draft.values(one.field, one.unit) for one in wheels]
    signs = [-1.0 if len(turn) == len(turns[0]) and float(np.nansum(turn * turns[0])) < 0.0 else 1.0 for turn in turns]
    mean = np.sum([sign * turn for sign, turn in zip(signs, turns, strict=True)], axis=0) / len(wheels)
    told = f"the mean of {'both' if len(wheels) == 2 else len(wheels)} wheels" if len(wheels) > 1 else "the wheel"
    unit = wheels[0].unit if len({one.unit for one in wheels}) == 1 else ""
    factor = size_of(unit) / len(wheels)
    more = "".join(f" {'-' if sign < 0.0 else '+'} {ref}" for sign, ref in zip(signs[1:], refs[1:], strict=True))
    formula = f"({refs[0]}{more})" if more else refs[0]
    if factor != 1.0:
        formula += f" * {factor:.10g}" if unit else f" / {len(wheels)}"
    guess = replace(wheels[0], role="speed", unit="", sure="likely")
    if len(wheels) == 2 and not draft.best("yaw_rate", 0.5) and not draft.best("heading", 0.5):
        how = "(right - left) / track, both in m/s, with `constants: {track: 0.4 m}` for their distance"
        draft.remarks.append(f"no turn rate was found: `yaw_rate_rad_s` is {how}")
    if all(UNITS.get(words_of(one.field)[1], ("",))[0] == "speed" for one in wheels):
        draft.column("speed_m_s", formula, replace(guess, why=told))
        return
    radius = _radius(draft, mean)
    if radius is None:
        draft.head["constants"] = "{wheel_radius: RADIUS m}"
        turns_s = "" if unit else " (6.283 times it where they count turns)"
        draft.missing.append(f"speeds of wheels and no path: put the wheels' radius in the place of RADIUS{turns_s}")
        guess = replace(guess, sure="a guess", why=f"{told} times the radius, which is not known")
    elif abs(radius - 1.0) > 0.03:
        draft.head["constants"] = (
            f"{{wheel_radius: {radius:.3g} m}}  # fitted: the path of the positions over that of the wheels"
        )
        guess = replace(guess, why=f"{told} times a radius that fits the positions")
    else:
        draft.column("speed_m_s", formula, replace(guess, why=f"{told}, which fits the positions"))
        return
    draft.column("speed_m_s", f"{formula} * wheel_radius", guess)


def _radius(draft: Draft, wheel: Array) -> float | None:
    """Metres of path for each radian (or metre) of the wheels, from positions; None where there are none."""
    if (found := path_of(draft)) is None or draft.time_s is None:
        return None
    known = np.isfinite(found[1]) & np.isfinite(wheel)
    t, path, wheel = draft.time_s[known], found[1][known], np.abs(wheel[known])
    if len(t) < 50:
        return None
    rows = stride(t)
    area = np.r_[0.0, np.cumsum(0.5 * (wheel[1:] + wheel[:-1]) * np.diff(t))]
    turned, way = np.diff(area[::rows]), np.diff(path[::rows])
    moving = turned > 0.2 * np.quantile(turned, 0.9)
    if moving.sum() < 20:
        return None
    low, middle, high = np.quantile(way[moving] / turned[moving], (0.25, 0.5, 0.75))
    return float(middle) if 0 < middle < 2.0 and high - low < 0.4 * middle else None


_METRES_A_DEGREE = 111_195.0
"""Of latitude, on a sphere with the Earth's mean radius."""
_MOVED_M = 2.0
"""A receiver whose positions reach farther has moved."""
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
        whole = _has_numbers(one) and says("counts", words) and not np.nan_to_num(draft.values(name) % 1.0).any()
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


_SHORTEST_S, _LONGEST_S = 0.3, 2.0
"""Windows of the mean over which a heading is differentiated (assumed; the first as in the map for PX4)."""
_ROUGH_RAD_S = 0.02
"""What the noise and the steps of a heading may make of its rate: beyond it rest would count as turning."""
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
    if not says("course", words_of(guess.field)[0]):
        draft.columns["yaw_rate_rad_s"] = (rate, told)
    elif "speed_m_s" in draft.columns:
        draft.columns["_yaw_rate_rad_s"] = (rate, replace(told, why="a helper, which is no column of the log"))
        why = "the rate of a course, which is noise at rest: none there, nor on the spot"
        formula = f'"where(abs(speed_m_s) > {_MOVES_M_S}, _yaw_rate_rad_s, 0)"'
        draft.columns["yaw_rate_rad_s"] = (formula, replace(told, sure="a guess", why=why))
