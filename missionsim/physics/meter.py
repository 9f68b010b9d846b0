"""A power meter that shows changes late and sluggishly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from missionsim.physics import Array
from missionsim.physics.lag import carried


class Meter(NamedTuple):
    """How far a meter is behind the motion in the same log [s]: its delay (negative: ahead) and first-order lag."""

    delay_s: float = 0.0
    lag_s: float = 0.0


def metered(power_w: Array, time_s: Array, meter: Meter) -> Array:
    """Mean over each row of what a meter shows of a power.

    Parameters
    ----------
    power_w : ndarray, shape (..., n)
        Held from half-way between the rows to half-way [W]; before the first and after the last row as in them.
    time_s : ndarray, shape (n,)
        Increasing [s].
    meter : Meter

    Returns
    -------
    ndarray, shape (..., n)
        ``lag dy/dt + y = p(t − delay)`` in closed form [W]; what began and ended within the rows keeps its energy.
    """
    if len(time_s) < 2 or meter == Meter():
        return power_w
    lag_s = meter.lag_s
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    edges = np.concatenate([[2.0 * time_s[0] - middle[0]], middle, [2.0 * time_s[-1] - middle[-1]]])
    length = np.diff(edges)
    late = edges - meter.delay_s
    row = np.clip(np.searchsorted(edges, late, side="right") - 1, 0, len(time_s) - 1)
    inside = late - edges[row]
    energy, behind = power_w * length, np.zeros_like(power_w)
    if lag_s > 0.0:
        keep = np.exp(-length / lag_s)
        at_edge = carried(np.append(0.0, keep), np.append(power_w[..., :1], power_w * (1.0 - keep), axis=-1))
        behind = (at_edge[..., :-1] - power_w) * lag_s
        energy += behind * (1.0 - keep)
    whole = np.append(np.zeros_like(energy[..., :1]), np.cumsum(energy, axis=-1), axis=-1).take(row, axis=-1)
    whole += power_w.take(row, axis=-1) * inside
    if lag_s > 0.0:
        whole -= behind.take(row, axis=-1) * np.expm1(-np.maximum(inside, 0.0) / lag_s)
    return np.asarray(np.diff(whole) / length)
