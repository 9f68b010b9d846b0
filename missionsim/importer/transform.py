"""Numeric steps of a map: attitude to slope and heading, rates, averages, clock shifts, one row per refresh."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData
from missionsim.logs.table import row_durations

Floats = NDArray[np.float64]


def attitude(x: Floats, y: Floats, z: Floats, w: Floats, give: str) -> Floats:
    """Slope, heading, roll or pitch of a body from its quaternion (body to world; x forward, y left, z up).

    Parameters
    ----------
    x, y, z, w : ndarray, shape (n,)
        The quaternion; it is normalised, and rows of zeros give NaN.
    give : str
        ``slope``: angle of the forward axis above the horizon; ``heading``: its angle about the
        vertical, unwrapped; ``roll`` and ``pitch``: rotations about the forward and the
        left axis (REP 103: nose up is negative).

    Returns
    -------
    ndarray, shape (n,)
        [rad].
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
        up = np.clip(2.0 * (x * z - w * y), -1.0, 1.0)
        if give == "slope":
            return np.asarray(np.arcsin(up))
        if give == "pitch":
            return np.asarray(-np.arcsin(up))
        if give == "roll":
            return np.asarray(np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
        return unwrap(np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)))


def unwrap(angle: Floats, period: float = 2 * np.pi) -> Floats:
    """An angle without its jumps from one turn to the next, NaN left in place, same unit as `period`."""
    known = np.isfinite(angle)
    result = np.array(angle, dtype=np.float64)
    result[known] = np.unwrap(result[known], period=period)
    return result


def moving_average(values: Floats, time_s: Floats, over_s: float) -> Floats:
    """Mean over a window of `over_s` around each row, of the values joined by straight lines; cut at the ends.

    Parameters
    ----------
    values, time_s : ndarray, shape (n,)
        Time increasing [s].
    over_s : float
        Length of the window [s].
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return values
    t, v = time_s[known], values[known]
    area = np.r_[0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))]

    def integral(at: Floats) -> Floats:
        left = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
        part = at - t[left]
        slope = (v[left + 1] - v[left]) / (t[left + 1] - t[left])
        return np.asarray(area[left] + part * (v[left] + 0.5 * slope * part))

    low, high = np.maximum(time_s - 0.5 * over_s, t[0]), np.minimum(time_s + 0.5 * over_s, t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (integral(high) - integral(low)) / (high - low)
    return np.where(known & (high > low), mean, values)


def rate_of_change(values: Floats, time_s: Floats, over_s: float | None = None) -> Floats:
    """Derivative over time: of the moving average over `over_s`, or the difference of the neighbours.

    The derivative of a moving average is the difference of the values at both ends of its window over its length, so
    noise is divided by that length and not by the step of the log.
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(len(values), np.nan)
    t, v = time_s[known], values[known]
    if over_s is None:
        slope = np.gradient(v, t)
        return np.asarray(np.interp(time_s, t, slope))
    low, high = np.maximum(time_s - 0.5 * over_s, t[0]), np.minimum(time_s + 0.5 * over_s, t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((np.interp(high, t, v) - np.interp(low, t, v)) / (high - low))


def shift_back(data: ColumnData, time_s: Floats, lag_s: float) -> ColumnData:
    """A column that comes `lag_s` too late, moved back: each row takes what stands `lag_s` later.

    Text and values repeated from a slower topic take the row at or before that time, others are interpolated. Rows
    whose value would lie outside the run are missing (NaN).
    """
    at = time_s + lag_s
    index = np.clip(np.searchsorted(time_s, at, side="right") - 1, 0, len(time_s) - 1)
    if isinstance(data, Labels):
        return data[index]
    inside = (at >= time_s[0]) & (at <= time_s[-1])
    steps = np.mean(data[1:] == data[:-1]) > 0.3 if len(data) > 1 else False
    return np.where(inside, data[index] if steps else np.interp(at, time_s, data), np.nan)


def refresh_times(signals: list[ColumnData], time_s: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Windows between the refreshes of slow signals.

    Parameters
    ----------
    signals : list of columns, shape (n,)
        A change of any of them is a refresh.
    time_s : ndarray, shape (n,)

    Returns
    -------
    start_s, stop_s : ndarray, shape (m,)
        Each window reaches from a refresh to the next [s].
    row : ndarray of int, shape (m,)
        Row that holds the signals' values at the end of the window.

    Notes
    -----
    Topics that come one shortly after the other count as one refresh, complete with the last of them. A refresh may
    bring the same value again (standing still): a window longer than 1.5 usual ones is cut in usual ones,
    all but the last with the value before.
    """
    found = [_changes(signal) for signal in signals]
    at = np.unique(np.concatenate(found)) if found else np.empty(0, dtype=np.int64)
    if len(at) < 2:
        return np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)
    usual = min(float(np.median(np.diff(time_s[rows]))) for rows in found if len(rows) > 1)
    at = _bursts(at, time_s, usual)
    edges, rows = [time_s[at[0]]], []
    for before, now in itertools.pairwise(at):
        pieces = (
            max(1, round((time_s[now] - time_s[before]) / usual)) if time_s[now] - time_s[before] > 1.5 * usual else 1
        )
        edges += list(np.linspace(time_s[before], time_s[now], pieces + 1)[1:])
        rows += [before] * (pieces - 1) + [now]
    return np.array(edges[:-1]), np.array(edges[1:]), np.array(rows, dtype=np.int64)


def _changes(signal: ColumnData) -> NDArray[np.int64]:
    values = signal.codes if isinstance(signal, Labels) else signal
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return np.asarray(np.flatnonzero(~same) + 1)


def _bursts(at: NDArray[np.int64], time_s: Floats, usual_s: float) -> NDArray[np.int64]:
    """Rows at which refreshes are complete: changes within 0.4 of the usual time are one refresh of several topics."""
    result: list[int] = []
    begin = -np.inf
    for row in at:
        if time_s[row] - begin <= 0.4 * usual_s:
            result[-1] = int(row)
        else:
            begin = time_s[row]
            result.append(int(row))
    return np.array(result, dtype=np.int64)


def average_windows(
    columns: Mapping[str, ColumnData],
    time_s: Floats,
    start_s: Floats,
    stop_s: Floats,
    held: Mapping[str, NDArray[np.int64]],
) -> dict[str, ColumnData]:
    """Columns averaged over windows of time, weighted by the time each row stands for; text takes its last word.

    Parameters
    ----------
    columns : mapping of columns, shape (n,)
    time_s : ndarray, shape (n,)
    start_s, stop_s : ndarray, shape (m,)
        Windows ``(start, stop]`` that follow each other without overlap.
    held : mapping
        Column → row to take its value from, shape (m,), in place of a mean.

    Returns
    -------
    dict
        Shape (k,), k ≤ m: windows without any row are left out; ``time_s`` is the middle of the window.
    """
    window = np.searchsorted(stop_s, time_s, side="left")
    inside = window < len(stop_s)
    inside[inside] &= time_s[inside] > start_s[window[inside]]
    # times before zero, so that the first row keeps its full weight
    durations = row_durations(time_s - time_s[-1] - 1.0)
    group, weight = window[inside], np.maximum(durations[inside], 1e-12)
    last = np.full(len(stop_s), -1)
    last[group] = np.flatnonzero(inside)
    full = last >= 0
    result: dict[str, ColumnData] = {}
    for name, data in columns.items():
        if name == "time_s":
            result[name] = (0.5 * (start_s + stop_s))[full]
        elif name in held:
            result[name] = data[held[name][full]]
        elif isinstance(data, Labels):
            result[name] = data[last[full]]
        else:
            values = data[inside]
            known = np.isfinite(values)
            total = np.bincount(group[known], weight[known], len(stop_s))
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = np.bincount(group[known], weight[known] * values[known], len(stop_s)) / total
            result[name] = mean[full]
    return result
