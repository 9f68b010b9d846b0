"""Legs into steps: which legs are driven in one go, and the phases of constant acceleration of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from missionsim.plan.kinematics import phases
from missionsim.plan.legs import Leg, Limits, Phase, Step

SHORTEST_PHASE_S = 1e-12
"""Phases below this are rounding residues of the profile and are dropped."""

Breaks = Callable[[Leg, Leg], bool]


def continues(before: Leg, after: Leg) -> bool:
    """Whether the robot keeps moving from one leg into the next.

    It does on straight pieces and arcs, and on sideways pieces in one direction, with the same payload (loading
    means standing) and the same kind of profile; but not where it goes back on the edge that it came by.
    """
    if before.kind != after.kind or before.kind not in ("roll", "slide"):
        return False
    if before.instant != after.instant or before.settings.payload_kg != after.settings.payload_kg:
        return False
    if before.edge is not None and after.edge is not None and (before.edge.end, before.edge.begin) == after.edge[:2]:
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
    spans: list[tuple[int, int]] = []
    begin = 0
    for i in range(1, len(legs) + 1):
        if i < len(legs) and continues(legs[i - 1], legs[i]) and not (breaks and breaks(legs[i - 1], legs[i])):
            continue
        spans.append((begin, i))
        begin = i
    profiles = _profiles(legs, spans, limits)
    return tuple(Step(legs[low].kind, _step_phases(legs, low, high, profiles.get(low))) for low, high in spans)


Profile = tuple[list[list[float]], list[list[float]], list[list[float]]]


def _profiles(legs: Sequence[Leg], spans: Sequence[tuple[int, int]], limits: Limits) -> dict[int, Profile]:
    """Durations, speeds and accelerations of the phases of each span that moves, by its first leg.

    Spans with the same number of pieces are computed in one call, since a call costs as much for one as for many.
    """
    batches: dict[tuple[int, bool], list[tuple[int, int]]] = {}
    for low, high in spans:
        if legs[low].kind in ("roll", "slide", "turn"):
            batches.setdefault((high - low, _is_instant(legs[low], limits)), []).append((low, high))
    found: dict[int, Profile] = {}
    for (_, instant), members in batches.items():
        distance = [[_size(leg) for leg in legs[low:high]] for low, high in members]
        limit = [[_limit(leg) for leg in legs[low:high]] for low, high in members]
        if instant:
            made = phases(distance, limit)
        else:
            rates = [_rates(legs[low], limits) for low, _ in members]
            made = phases(distance, limit, [rate[0] for rate in rates], [rate[1] for rate in rates])
        tables = zip(made.duration_s.tolist(), made.speed_m_s.tolist(), made.accel_m_s2.tolist(), strict=True)
        for (low, _), table in zip(members, tables, strict=True):
            found[low] = table
    return found


def _is_instant(leg: Leg, limits: Limits) -> bool:
    return leg.instant or (limits.yaw_accel_rad_s2 if leg.kind == "turn" else limits.accel_m_s2) is None


def _rates(leg: Leg, limits: Limits) -> tuple[float, float]:
    if leg.kind == "turn":
        return limits.yaw_accel_rad_s2 or 0.0, limits.yaw_accel_rad_s2 or 0.0
    accel = limits.accel_m_s2 or 0.0
    return accel, limits.decel_m_s2 or accel


def _size(leg: Leg) -> float:
    return abs(leg.angle_rad) if leg.kind == "turn" else leg.distance_m


def _limit(leg: Leg) -> float:
    return leg.yaw_rate_rad_s if leg.kind == "turn" else leg.speed_m_s


def _step_phases(legs: Sequence[Leg], low: int, high: int, profile: Profile | None) -> tuple[Phase, ...]:
    """Phases of legs that follow each other without a standstill; at least one for each leg."""
    if profile is None:
        return tuple(Phase(legs[i].duration_s, i) for i in range(low, high))
    duration, speed, rate = profile
    made: list[Phase] = []
    for row, i in enumerate(range(low, high)):
        leg = legs[i]
        before = len(made)
        for j in range(3):
            if duration[row][j] > SHORTEST_PHASE_S:
                made.append(_phase(leg, i, duration[row][j], speed[row][j], rate[row][j]))
        if len(made) == before:
            made.append(Phase(0.0, i))
    return tuple(made)


def _phase(leg: Leg, index: int, duration_s: float, speed: float, rate: float) -> Phase:
    if leg.kind == "turn":
        sign = math.copysign(1.0, leg.angle_rad)
        return Phase(duration_s, index, yaw_rad_s=sign * speed, yaw_rad_s2=sign * rate, moving=True)
    if leg.kind == "slide":
        ahead, aside = math.cos(leg.direction_rad), math.sin(leg.direction_rad)
        return Phase(duration_s, index, speed * ahead, rate * ahead, speed * aside, rate * aside, moving=True)
    bend = leg.curvature_1_m
    return Phase(duration_s, index, speed, rate, yaw_rad_s=speed * bend, yaw_rad_s2=rate * bend, moving=True)


def slow_components(robot: Any) -> frozenset[str]:
    """Components that are not on at once: they, or something they require, take time to start."""
    table = robot.components

    def slow(name: str) -> bool:
        spec = table[name]
        startup = spec.startup is not None and spec.startup.duration.value > 0.0
        return startup or any(slow(required) for required in spec.requires)

    return frozenset(name for name in table if slow(name))
