"""What to drive where several forms of a law fit: where they differ most, within what the robot can do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from missionsim.glossary import column_of
from missionsim.identify.noise import mean_variance
from missionsim.identify.proposed import Curve, Law, plain, state
from missionsim.laws.factors import evaluate
from missionsim.numerals import watts
from missionsim.physics import Array

MINUTES = (3, 6, 12)
"""Lengths of the two drives that are to tell forms apart."""
SEEN_SD = 2.0
"""Standard deviations of the difference of their means that the forms must differ by."""
POINTS = 41
SLOWEST = 0.1
"""Part of a robot's greatest speed below which it is not asked to hold a speed (assumed)."""
CURVATURE = "curvature_1_m"
"""Name of the limit of a robot that cannot turn on the spot: turn rate in times of its speed."""


def experiment(
    laws: Sequence[Law],
    curve: Curve | None,
    possible: Sequence[str],
    noise: Mapping[str, float],
    most: Mapping[str, float] | None = None,
) -> str:
    """Where the forms differ most, in words, and how long to drive there; or that no drive shows it.

    `most`: by column, what the robot can drive at most.
    """
    bounds = {name: limit if name == CURVATURE else _as_told(limit) for name, limit in (most or {}).items()}
    lead = plain(curve.variable) if curve is not None else "the rest"
    if possible:
        told = " and ".join(plain(name) for name in possible)
        return f"repeat one drive of 3 min with {told} changed and {lead} as it was: only some forms depend on it"
    if curve is None or len(laws) < 2:
        return ""
    column = column_of(curve.variable)
    last = min(np.inf if column is None else column[0].high, bounds.get(curve.variable, np.inf))
    turned = curve.variable == "yaw_rate_rad_s" and CURVATURE in bounds and "speed_m_s" not in curve.at
    reach = 1.0 if turned else 1.4  # without its speed nothing tells whether it can turn faster than it did
    x = np.linspace(min(curve.x[0], last), min(curve.x[0] + reach * (curve.x[-1] - curve.x[0]), last), 2 * POINTS)
    # the other quantities as they usually are, or at an end of what was driven
    ends = [[(name, usual)] for name, usual in curve.at.items()]
    for one in ends:
        name = one[0][0]
        furthest = bounds.get(name, np.inf)
        slowest = SLOWEST * bounds[name] if name == "speed_m_s" and name in bounds else 0.0
        one.extend((name, min(end, furthest)) for end in curve.spans.get(name, ()) if end == 0.0 or end >= slowest)
    best_w, at, beside = -np.inf, "", ""
    for others in product(*ends):
        can = _can(curve.variable, x, dict(others), bounds)
        if curve.variable == "speed_m_s":  # at half of it too
            can = np.logical_and(can, 0.5 * x >= SLOWEST * bounds.get("speed_m_s", 0.0) - 1e-9)
        if not can.any():
            continue
        curves = [law.k * evaluate(law.formula, {**dict(others), curve.variable: x}, len(x)) for law in laws]
        gap = np.where(can, np.ptp(np.vstack(curves), axis=0), -np.inf)
        if gap.max() > best_w:
            best_w, at = float(gap.max()), state(curve.variable, float(x[int(np.argmax(gap))]))
            moved = [state(name, value) for name, value in others if value != curve.at[name]]
            beside = f"{', '.join(moved)}, the rest as usual" if moved else "the rest as usual"
    if not at:
        return "no drive that this robot can do tells the forms apart; take any"
    for minutes in MINUTES:
        # the difference of two means has twice the variance of each
        shown_w = SEEN_SD * noise["sd_w"] * float(np.sqrt(2.0 * mean_variance(noise, 60.0 * minutes)))
        if best_w >= shown_w:
            drive = f"{minutes} min at {at} and {minutes} min at half of it"
            return f"{drive}, {beside}: there the forms differ by {watts(best_w, 2)}"
    return (
        f"no drive near the range of these logs tells the forms apart: they differ by {watts(best_w, 2)} at most ("
        f"{at}, {beside}), and {MINUTES[-1]} min each there and at half of it resolve {watts(shown_w, 2)}; take any"
    )


def _as_told(most: float) -> float:
    """A limit that numbers of two digits, as drives are told in, do not round beyond."""
    step = 10.0 ** min(np.floor(np.log10(most)) - 1.0, 0.0) if most > 0.0 else 1.0
    return float(np.floor(most / step + 1e-9) * step)


def _can(variable: str, x: Array, others: Mapping[str, float | str], most: Mapping[str, float]) -> Array:
    """Whether the robot can turn so at each x, and at half of it, with the other quantities as given."""
    at = {name: np.abs(np.asarray(value, dtype=float)) for name, value in others.items() if not isinstance(value, str)}
    at[variable] = np.abs(x)
    if CURVATURE not in most or not {"speed_m_s", "yaw_rate_rad_s"} <= at.keys():
        return np.full(len(x), True)
    speed = at["speed_m_s"] * (0.5 if variable == "speed_m_s" else 1.0)
    return np.broadcast_to(at["yaw_rate_rad_s"] <= most[CURVATURE] * speed + 1e-12, x.shape)
