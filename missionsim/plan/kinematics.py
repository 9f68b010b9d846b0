"""Motion of a robot with limited acceleration: exact phases of constant acceleration, for scalars or arrays of draws.

A *run* is a chain of pieces between two standstills; each piece has a length and a speed limit. The fastest profile
under the limits is the lowest of three curves over the path (limit, speeding up from behind, braking from ahead), so
it depends on the limits along the path only, not on how the path is cut into pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array


@dataclass(frozen=True)
class Phases:
    """Phases of constant acceleration of a run: speeding up, cruising, slowing down, for each piece."""

    duration_s: Array
    speed_m_s: Array
    accel_m_s2: Array
    """All three: length, speed at its start and acceleration of each phase; phases that do not occur last 0 s. Shape
    (..., pieces, 3)."""


def junction_speeds(
    distance_m: ArrayLike,
    limit_m_s: ArrayLike,
    accel_m_s2: ArrayLike,
    decel_m_s2: ArrayLike,
    begin_m_s: ArrayLike = 0.0,
    end_m_s: ArrayLike = 0.0,
) -> Array:
    """Highest speeds at the borders of the pieces of a run.

    `distance_m`, `limit_m_s` (shape (..., pieces)): length and speed limit of each piece. `accel_m_s2`, `decel_m_s2`
    (shape (...)): limits of speeding up and of braking, both positive. `begin_m_s`, `end_m_s` (shape (...)): speeds at
    both ends; at rest by default. They must be reachable from each other. Gives an array of shape (..., pieces + 1):
    speeds in m/s (forward and backward pass with ``v² + 2 a d``).
    """
    distance, limit = np.broadcast_arrays(np.asarray(distance_m, float), np.asarray(limit_m_s, float))
    accel, decel = np.asarray(accel_m_s2, float), np.asarray(decel_m_s2, float)
    pieces = distance.shape[-1]
    squares = np.zeros((*np.broadcast_shapes(distance.shape[:-1], accel.shape, decel.shape), pieces + 1))
    ceiling = np.square(limit)
    squares[..., 0], squares[..., -1] = np.square(begin_m_s), np.square(end_m_s)
    squares[..., 1:-1] = np.minimum(ceiling[..., :-1], ceiling[..., 1:])
    up = 2.0 * accel[..., None] * distance
    down = 2.0 * decel[..., None] * distance
    for i in range(1, pieces):
        squares[..., i] = np.minimum(squares[..., i], squares[..., i - 1] + up[..., i - 1])
    for i in range(pieces - 1, 0, -1):
        squares[..., i] = np.minimum(squares[..., i], squares[..., i + 1] + down[..., i])
    return np.asarray(np.sqrt(squares))


def ramp_phases(
    distance_m: ArrayLike,
    limit_m_s: ArrayLike,
    accel_m_s2: ArrayLike,
    decel_m_s2: ArrayLike,
    begin_m_s: ArrayLike = 0.0,
    end_m_s: ArrayLike = 0.0,
) -> Phases:
    """Trapezoids and triangles of a run, from rest to rest or between given speeds.

    `distance_m`, `limit_m_s`: shape (..., pieces); `accel_m_s2`, `decel_m_s2` (shape (...)): positive and finite;
    `begin_m_s`, `end_m_s` (shape (...)): as for `junction_speeds`. Gives three phases a piece.

    Inside a piece of length d from v0 to v1 the peak is ``v_p² = (2 a b d + b v0² + a v1²) / (a + b)``, cut at the
    limit; also for angles (rad, rad/s, rad/s²) of a turn on the spot.
    """
    distance, limit = np.broadcast_arrays(np.asarray(distance_m, float), np.asarray(limit_m_s, float))
    border = junction_speeds(distance, limit, accel_m_s2, decel_m_s2, begin_m_s, end_m_s)
    accel = np.asarray(accel_m_s2, float)[..., None]
    decel = np.asarray(decel_m_s2, float)[..., None]
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


def phases(distance_m: ArrayLike, limit_m_s: ArrayLike) -> Phases:
    """Phases of a run without a limit of the acceleration, the papers' assumption; shaped as those of `ramp_phases`.

    Each piece at its speed from its first metre to its last, so that only its cruising phase lasts.
    """
    distance, limit = np.broadcast_arrays(np.asarray(distance_m, float), np.asarray(limit_m_s, float))
    zero = np.zeros_like(limit)
    return Phases(
        np.stack([zero, distance / limit, zero], axis=-1),
        np.stack([limit, limit, limit], axis=-1),
        np.stack([zero, zero, zero], axis=-1),
    )
