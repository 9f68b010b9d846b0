"""Legs into steps: which legs are driven in one go, and the phases of constant acceleration of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from missionsim.plan.kinematics import phases
from missionsim.plan.legs import Leg, Limits, Phase, Step

SHORTEST_PHASE_S = 1e-12
"""Phases below this are rounding residues of the profile and are dropped."""

Breaks = Callable[[Leg, Leg], bool]


def continues(before: Leg, after: Leg) -> bool:
    """Whether the robot keeps moving from one leg into the next.

    It does on straight pieces and arcs, and on sideways pieces in one direction, with the same payload (loading
    means standing) and the same kind of profile.
    """
    if before.kind != after.kind or before.kind not in ("roll", "slide"):
        return False
    if before.instant != after.instant or before.settings.payload_kg != after.settings.payload_kg:
        return False
    return before.kind == "roll" or before.direction_rad == after.direction_rad


def group(legs: Sequence[Leg], limits: Limits, breaks: Breaks | None = None) -> tuple[Step, ...]:
    """Steps of a sequence of legs.

    Parameters
    ----------
    legs : sequence of Leg
    limits : Limits
    breaks : callable, optional
        ``(before, after) -> bool``: further reasons to stop between two legs (a component with a start-up time).
    """
    steps: list[Step] = []
    begin = 0
    for i in range(1, len(legs) + 1):
        if i < len(legs) and continues(legs[i - 1], legs[i]) and not (breaks and breaks(legs[i - 1], legs[i])):
            continue
        steps.append(Step(legs[begin].kind, step_phases(legs[begin:i], begin, limits)))
        begin = i
    return tuple(steps)


def step_phases(legs: Sequence[Leg], begin: int, limits: Limits) -> tuple[Phase, ...]:
    """Phases of legs that follow each other without a standstill; at least one for each leg.

    Parameters
    ----------
    legs : sequence of Leg
        All `roll`, or all `slide`, or one of another kind.
    begin : int
        Index of the first of them in the plan.
    limits : Limits
    """
    kind = legs[0].kind
    if kind in ("stand", "dock"):
        return tuple(Phase(leg.duration_s, begin + i) for i, leg in enumerate(legs))
    if kind == "turn":
        leg = legs[0]
        size = abs(leg.angle_rad)
        sign = math.copysign(1.0, leg.angle_rad)
        accel = None if leg.instant else limits.yaw_accel_rad_s2
        profile = phases([size], [leg.yaw_rate_rad_s], accel)
    else:
        sign = 1.0
        accel = None if legs[0].instant else limits.accel_m_s2
        profile = phases([leg.distance_m for leg in legs], [leg.speed_m_s for leg in legs], accel, limits.decel_m_s2)
    duration = profile.duration_s.tolist()
    speed = profile.speed_m_s.tolist()
    rate = profile.accel_m_s2.tolist()
    made: list[Phase] = []
    for i, leg in enumerate(legs):
        lasting = [j for j in range(3) if duration[i][j] > SHORTEST_PHASE_S]
        for j in lasting:
            made.append(_phase(leg, begin + i, duration[i][j], sign * speed[i][j], sign * rate[i][j]))
        if not lasting:
            made.append(Phase(0.0, begin + i))
    return tuple(made)


def _phase(leg: Leg, index: int, duration_s: float, speed: float, rate: float) -> Phase:
    if leg.kind == "turn":
        return Phase(duration_s, index, yaw_rad_s=speed, yaw_rad_s2=rate, moving=True)
    if leg.kind == "slide":
        ahead, aside = float(np.cos(leg.direction_rad)), float(np.sin(leg.direction_rad))
        return Phase(duration_s, index, speed * ahead, rate * ahead, speed * aside, rate * aside, moving=True)
    bend = leg.curvature_1_m
    return Phase(duration_s, index, speed, rate, yaw_rad_s=speed * bend, yaw_rad_s2=rate * bend, moving=True)
