"""First-order lag, ``τ dy/dt + y = x``, in closed form: of rows of a log, of signals within intervals, of a meter."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from missionsim.physics import Array, Ints

FORGOTTEN = 1e-18
"""Part of what was that no longer changes a number."""
SETTLED, GOES_ON = np.inf, np.nan
"""Where an interval begins: as if the signal had always been what it is at its start, or as the one before it ends."""
_COUNT = 5
_NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_COUNT) + 0.5) / _COUNT)
_BETWEEN = np.concatenate([[1e-7], 0.5 * (_NODES[1:] + _NODES[:-1]), [1.0 - 1e-7]])
"""Where the polynomial through the nodes is compared with the signal; not at the very ends, where that may jump."""
_COEFFICIENTS = np.linalg.inv(np.vander(_NODES, increasing=True)).T
_TO_BETWEEN = _COEFFICIENTS @ np.vander(_BETWEEN, _COUNT, increasing=True).T
TOLERANCE = 1e-12
"""How far the polynomials may be from the signal, relative to its largest value."""
_MAX_DEPTH, _NOISE_DEPTH, _MOST_PIECES = 40, 9, 4096


def halving_helps(depth: int, pieces: int, intervals: int) -> bool:
    """Whether pieces of intervals may be halved once more: a jump needs one piece a level; where pieces go on
    multiplying, it is noise that no halving resolves."""
    return depth < _MAX_DEPTH and (depth < _NOISE_DEPTH or pieces <= max(_MOST_PIECES, 8 * intervals))


def carried(keep: Array, taken: Array) -> Array:
    """``y[n] = keep[n] y[n − 1] + taken[n]`` over the last axis of `taken`; `keep` (shape (n,)) begins with 0."""
    found, keep, reach = taken.copy(), keep.copy(), 1
    while keep.max() > FORGOTTEN:  # over 1, 2, 4, 8 … rows
        found[..., reach:] += keep[reach:] * found[..., :-reach]
        keep[reach:] *= keep[:-reach]
        reach *= 2
    return found


def rises(z: Array, count: int) -> Array:
    """``∫₀¹ uᵏ z exp(−z (1 − u)) du`` for k = 0 … count − 1, shape (count, \\*z.shape): what a signal uᵏ that lasts z
    time constants leaves in its lag."""
    found = np.empty((count, *z.shape))
    small = z < count  # by parts, ψ[k] = 1 − k/z ψ[k − 1]: stable downwards where z is small, upwards where it is large
    near, far = np.where(small, z, 1.0), np.where(small, 1.0, z)
    value = near / (near + count + 25)
    for k in range(count + 25, 0, -1):
        value = near * (1.0 - value) / k
        if k <= count:
            found[k - 1] = value
    value = -np.expm1(-z)
    for k in range(count):
        found[k] = np.where(small, found[k], value)
        value = 1.0 - (k + 1) / far * value
    return found


def lagged(values: Array, time_s: Array, tau_s: float, before: tuple[float, float, float] | None = None) -> Array:
    """The lag of a signal that goes straight from row to row.

    `values`, `time_s`: shape (n,); where the time does not go on, another run begins, settled at its first row.
    `tau_s`: time constant; none where it is not positive. `before`: time, signal and lag of the row before these.
    """
    if before is not None:
        time_s, values = np.append(before[0], time_s), np.append(before[1], values)
    step = np.diff(time_s)
    goes_on = step > 0.0
    z = np.where(goes_on, step, np.inf) / max(tau_s, 1e-300)
    whole, late = rises(z, 2)
    first = values[0] if before is None else before[2]
    taken = np.append(first, values[:-1] * (whole - late) + values[1:] * late)
    return carried(np.append(0.0, np.exp(-z)), taken)[before is not None :]


class Lagged:
    """The lag of a signal over intervals, at any time within them.

    The signal is taken as polynomials of degree 4 over pieces of each interval, which are halved until they agree with
    it; the lag of such a piece is known in closed form.
    """

    def __init__(self, signal: Callable[[Ints, Array], Array], length_s: Array, tau_s: Array, begin: Array) -> None:
        """`signal`: ``(intervals (k,), seconds after their starts (k, q)) → (k, q)``. `length_s`, `tau_s`, `begin`
        (shape (n,)): length of each interval, time constant, and the lag at its start (or `SETTLED`, `GOES_ON`)."""
        rows = np.arange(len(length_s))
        low, long, depth, largest = np.zeros(len(rows)), np.asarray(length_s, dtype=float), 0, 0.0
        made: list[tuple[Array, ...]] = []
        while rows.size:
            x = signal(rows, low[:, None] + long[:, None] * np.append(_NODES, _BETWEEN))
            inner, between = x[:, :_COUNT], x[:, _COUNT:]
            largest = largest or float(np.max(np.abs(x), initial=0.0, where=np.isfinite(x)))
            bad = np.abs(inner @ _TO_BETWEEN - between).max(axis=1) > TOLERANCE * largest
            if not halving_helps(depth, rows.size, len(length_s)):
                bad[:] = False
            made.append((rows[~bad], low[~bad], long[~bad], *(inner[~bad] @ _COEFFICIENTS).T))
            rows, low, long, depth = rows[bad], low[bad], 0.5 * long[bad], depth + 1
            rows, low, long = np.append(rows, rows), np.append(low, low + long), np.append(long, long)
        which, low, long, *series = (np.concatenate(part) for part in zip(*made, strict=True))
        order = np.lexsort((low, which))
        which, self._low, self._long = which[order].astype(np.intp), low[order], long[order]
        self._series = np.array(series)[:, order]
        self._tau = np.maximum(tau_s, 1e-300)[which]
        self._length = np.where(length_s > 0.0, length_s, 1.0)
        self._place = which + self._low / self._length[which]
        self._first = np.searchsorted(which, np.arange(len(length_s)))
        self._last = np.append(self._first[1:], len(which))[: len(length_s)] - 1
        z = self._long / self._tau
        gain = np.nan_to_num((self._series * rises(z, _COUNT)).sum(axis=0))  # what is no number stays in its interval
        keep, taken = np.append(0.0, np.exp(-z)), np.append(0.0, gain)
        anew = ~np.isnan(begin)
        at = self._first[anew]
        keep[at], taken[at] = 0.0, np.where(np.isinf(begin[anew]), self._series[0, at], begin[anew])
        self._start = carried(keep, taken)[:-1]

    @property
    def start(self) -> Array:
        """The lag at the start of each interval, shape (n,)."""
        return self._start[self._first]

    def __call__(self, rows: Ints, seconds: Array) -> Array:
        """The lag at times after the start of some intervals (shape (k,)), shape (k, q)."""
        of = np.searchsorted(self._place, rows[:, None] + seconds / self._length[rows][:, None], side="right") - 1
        of = np.clip(of, self._first[rows][:, None], self._last[rows][:, None])
        since = seconds - self._low[of]
        z, part = since / self._tau[of], since / np.where(self._long > 0.0, self._long, 1.0)[of]
        found = self._start[of] * np.exp(-z)
        for k, rise in enumerate(rises(z, _COUNT)):
            found += self._series[k][of] * part**k * rise
        return np.asarray(found)


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
