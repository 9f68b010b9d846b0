"""Motion of a robot with limited acceleration: exact phases of constant acceleration, for scalars or arrays of draws.

A *run* is a chain of pieces between two standstills; each piece has a length and a speed limit. The fastest profile
under the limits is the lowest of three curves over the path (limit, speeding up from behind, braking from ahead), so
it depends on the limits along the path only, not on how the path is cut into pieces. Legs driven in one go are a step.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array
from missionsim.plan.legs import Leg, Limits, Odd, Phase, Step, sign


@dataclass(frozen=True)
class Phases:
    """Phases of constant acceleration of a run: speeding up, cruising, slowing down, for each piece."""

    duration_s: Array
    speed_m_s: Array
    accel_m_s2: Array
    """All three: length, speed at its start and acceleration of each phase; phases that do not occur last 0 s. Shape
    (..., pieces, 3)."""


def ramp_phases(
    distance_m: ArrayLike,
    limit_m_s: ArrayLike,
    accel_m_s2: ArrayLike,
    decel_m_s2: ArrayLike,
    begin_m_s: ArrayLike = 0.0,
    end_m_s: ArrayLike = 0.0,
) -> Phases:
    """Trapezoids and triangles of a run, from rest to rest or between given speeds.

    `distance_m`, `limit_m_s` (shape (..., pieces)): length and speed limit of each piece. `accel_m_s2`, `decel_m_s2`
    (shape (...)): limits of speeding up and of braking, positive and finite. `begin_m_s`, `end_m_s` (shape (...)):
    speeds at both ends; at rest by default. They must be reachable from each other. Gives three phases a piece.

    Inside a piece of length d from v0 to v1 the peak is ``v_p² = (2 a b d + b v0² + a v1²) / (a + b)``, cut at the
    limit; also for angles (rad, rad/s, rad/s²) of a turn on the spot.
    """
    distance, limit = np.broadcast_arrays(np.asarray(distance_m, float), np.asarray(limit_m_s, float))
    accel, decel = (np.asarray(rate, float)[..., None] for rate in (accel_m_s2, decel_m_s2))
    # highest squared speeds at the borders of the pieces: a pass forwards and one backwards with v² + 2 a d
    pieces, shape = distance.shape[-1], np.broadcast_shapes(distance.shape[:-1], accel.shape[:-1], decel.shape[:-1])
    squares, ceiling = np.zeros((*shape, pieces + 1)), np.square(limit)
    squares[..., 0], squares[..., -1] = np.square(begin_m_s), np.square(end_m_s)
    squares[..., 1:-1] = np.minimum(ceiling[..., :-1], ceiling[..., 1:])
    up, down = 2.0 * accel * distance, 2.0 * decel * distance
    for i in range(1, pieces):
        squares[..., i] = np.minimum(squares[..., i], squares[..., i - 1] + up[..., i - 1])
    for i in range(pieces - 1, 0, -1):
        squares[..., i] = np.minimum(squares[..., i], squares[..., i + 1] + down[..., i])
    border = np.sqrt(squares)
    before, after = border[..., :-1], border[..., 1:]
    free = np.sqrt(
        (2.0 * accel * decel * distance + decel * np.square(before) + accel * np.square(after)) / (accel + decel)
    )
    peak = np.maximum(np.minimum(free, limit), np.maximum(before, after))
    rising = (peak - before) / accel
    falling = (peak - after) / decel
    cruise_m = distance - (np.square(peak) - np.square(before)) / (2 * accel)
    cruise_m = cruise_m - (np.square(peak) - np.square(after)) / (2 * decel)
    cruising = np.where(free > limit, np.maximum(cruise_m, 0.0) / np.where(peak > 0, peak, 1.0), 0.0)
    zero = np.zeros_like(peak)
    return Phases(
        np.stack([rising, cruising, falling], axis=-1),
        np.stack([before + zero, peak, peak], axis=-1),
        np.stack([accel + zero, zero, -decel + zero], axis=-1),
    )


SHORTEST_PHASE_S = 1e-12
"""Phases below this are rounding residues of the profile and are dropped."""

Breaks = Callable[[Leg, Leg], bool]


def continues(before: Leg, after: Leg, odd: Odd) -> bool:
    """Whether the robot keeps moving from one leg into the next.

    It does on straight pieces and arcs, and on sideways pieces in one direction, with the same payload (loading
    means standing) and the same kind of profile; but not where it goes back on the edge that it came by.
    """
    if before.kind != after.kind or before.kind not in ("roll", "slide"):
        return False
    payloads = before.settings.payload_kg, after.settings.payload_kg
    if before.instant != after.instant or (payloads[0] is not payloads[1] and odd.most(payloads[0] != payloads[1])):
        return False
    if before.edge is not None and after.edge is not None and (before.edge.end, before.edge.begin) == after.edge[:2]:
        return False
    return before.kind == "roll" or odd.most(before.direction_rad == after.direction_rad)


def group(
    legs: Sequence[Leg], limits: Limits, breaks: Breaks | None = None, odd: Odd | None = None
) -> tuple[Step, ...]:
    """Steps of a sequence of legs. `breaks`: ``(before, after) -> bool``: further reasons to stop between two legs (a
    component with a start-up time); `odd`: of a plan of many runs."""
    odd = Odd() if odd is None else odd
    spans: list[tuple[int, int]] = []
    begin = 0
    for i in range(1, len(legs) + 1):
        if i < len(legs) and continues(legs[i - 1], legs[i], odd) and not (breaks and breaks(legs[i - 1], legs[i])):
            continue
        spans.append((begin, i))
        begin = i
    profiles = _profiles(legs, spans, limits)
    steps: list[Step] = []
    for low, high in spans:
        made: list[Phase] = []
        for i, rows in zip(range(low, high), profiles.get(low, itertools.repeat(())), strict=False):
            before = len(made)
            for duration, speed, rate in rows:
                if duration > SHORTEST_PHASE_S if isinstance(duration, float) else np.any(duration > SHORTEST_PHASE_S):
                    made.append(_phase(legs[i], i, duration, speed, rate))
            if len(made) == before:  # at least one for each leg
                made.append(Phase(0.0 if low in profiles else legs[i].duration_s, i))
        steps.append(Step(legs[low].kind, tuple(made)))
    return tuple(steps)


Profile = list[list[tuple[float, float, float]]]
"""Of each leg of a span: duration, speed at the start and acceleration of its phases."""


def _profiles(legs: Sequence[Leg], spans: Sequence[tuple[int, int]], limits: Limits) -> dict[int, Profile]:
    """Profiles of the spans that move, by their first leg. Spans with the same number of pieces are computed in one
    call, since a call costs as much for one as for many."""
    batches: dict[int, list[tuple[int, int]]] = {}
    found: dict[int, Profile] = {}
    for low, high in spans:
        leg = legs[low]
        if leg.kind not in ("roll", "slide", "turn"):
            continue
        if leg.instant or _rates(leg, limits) is None:
            found[low] = [[(size / top, top, 0.0)] for size, top in map(_driven, legs[low:high])]
        else:
            batches.setdefault(high - low, []).append((low, high))
    for members in batches.values():
        driven = [list(zip(*map(_driven, legs[low:high]), strict=True)) for low, high in members]
        sizes, tops = zip(*driven, strict=True)
        distance, limit, rates = _stacked(sizes, tops, [_rates(legs[low], limits) or () for low, _ in members])
        made = ramp_phases(distance, limit, rates[..., 0], rates[..., 1])
        parts = [made.duration_s, made.speed_m_s, made.accel_m_s2]
        if made.duration_s.ndim == 3:
            tables: Any = zip(*(part.tolist() for part in parts), strict=True)
        else:  # runs last, so that each number becomes an array of runs
            tables = zip(*(np.ascontiguousarray(np.moveaxis(part, 1, -1)) for part in parts), strict=True)
        for (low, _), table in zip(members, tables, strict=True):
            found[low] = [list(zip(*rows, strict=True)) for rows in zip(*table, strict=True)]
    return found


def _stacked(*tables: Sequence[Sequence[float]]) -> list[Array]:
    """Tables of members × numbers as arrays; of many runs, members × runs × numbers."""
    lengths = [np.size(x) for table in tables for row in table for x in row if isinstance(x, np.ndarray)]
    if not lengths:
        return [np.array(table) for table in tables]
    return [
        np.stack([np.stack([np.broadcast_to(x, lengths[:1]) for x in row], axis=-1) for row in table])
        if any(isinstance(x, np.ndarray) for row in table for x in row)
        else np.array(table)[:, None]
        for table in tables
    ]


def _rates(leg: Leg, limits: Limits) -> tuple[float, float] | None:
    """Limits of speeding up and of braking; None where speeds are reached at once."""
    accel = limits.yaw_accel_rad_s2 if leg.kind == "turn" else limits.accel_m_s2
    if accel is None:
        return None
    return accel, accel if leg.kind == "turn" or limits.decel_m_s2 is None else limits.decel_m_s2


def _driven(leg: Leg) -> tuple[float, float]:
    """Length and speed limit; of a turn, angle and limit of the yaw rate."""
    return (abs(leg.angle_rad), leg.yaw_rate_rad_s) if leg.kind == "turn" else (leg.distance_m, leg.speed_m_s)


def _phase(leg: Leg, index: int, duration_s: float, speed: float, rate: float) -> Phase:
    if leg.kind == "turn":
        left = sign(leg.angle_rad)
        return Phase(duration_s, index, yaw_rad_s=left * speed, yaw_rad_s2=left * rate, moving=True)
    if leg.kind == "slide":
        ahead, aside = np.cos(leg.direction_rad), np.sin(leg.direction_rad)
        if isinstance(leg.direction_rad, float):
            ahead, aside = float(ahead), float(aside)
        return Phase(duration_s, index, speed * ahead, rate * ahead, speed * aside, rate * aside, moving=True)
    bend = leg.curvature_1_m
    if isinstance(bend, float) and bend == 0.0:
        return Phase(duration_s, index, speed, rate, moving=True)
    return Phase(duration_s, index, speed, rate, yaw_rad_s=speed * bend, yaw_rad_s2=rate * bend, moving=True)
