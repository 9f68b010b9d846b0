"""Suggestions for a speed by the wheels that turn, and for the way by positions."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.roles import ROLES, Guess, folded, size_of, words_of
from missionsim.labels import Labels
from missionsim.physics import Array

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft


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
