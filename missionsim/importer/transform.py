"""Numeric steps of a map: attitude to slope and heading, rates, averages, clock shifts, one row per refresh."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from missionsim.errors import InputError
from missionsim.glossary import STILL_SPEED_M_S
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.physics import Array, Bools, Int64s
from missionsim.runs.run import row_durations


def attitude(x: Array, y: Array, z: Array, w: Array, give: str) -> Array:
    """Slope, heading, roll or pitch of a body from its quaternion (body to world; x forward, y left, z up).

    `x`, `y`, `z`, `w` (shape (n,)): the quaternion; it is normalised, and rows of zeros give NaN. `give`: ``slope``:
    angle of the forward axis above the horizon; ``heading``: its angle about the vertical, unwrapped; ``roll`` and
    ``pitch``: rotations about the forward and the left axis (REP 103: nose up is negative). Gives an array of shape
    (n,): [rad].
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


def unwrap(angle: Array, period: float = 2 * np.pi) -> Array:
    """An angle without its jumps from one turn to the next, NaN left in place, same unit as `period`."""
    known = np.isfinite(angle)
    result = np.array(angle, dtype=np.float64)
    result[known] = np.unwrap(result[known], period=period)
    return result


def _in_order(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Values by increasing time: rows may be out of order, and of those with the same time (a message that was
    recorded twice) the mean counts."""
    if (np.diff(time_s) > 0).all():
        return time_s, values
    times, index, count = np.unique(time_s, return_inverse=True, return_counts=True)
    return times, np.bincount(index, values) / count


def moving_average(values: Array, time_s: Array, over_s: float) -> Array:
    """Mean over a window of `over_s` around each row, of the values joined by straight lines; cut at the ends.
    `values`, `time_s` (shape (n,)): time [s]; `over_s`: length of the window [s]."""
    known = np.isfinite(values) & np.isfinite(time_s)
    t, v = _in_order(time_s[known], values[known])
    if len(t) < 2:
        return values
    from scipy.interpolate import make_interp_spline

    integral = make_interp_spline(t, v, k=1).antiderivative()
    low, high = np.maximum(time_s - 0.5 * over_s, t[0]), np.minimum(time_s + 0.5 * over_s, t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (integral(high) - integral(low)) / (high - low)
    return np.where(known & (high > low), mean, values)


def rate_of_change(values: Array, time_s: Array, over_s: float | None = None) -> Array:
    """Derivative over time: of the moving average over `over_s`, or the difference of the neighbours.

    The derivative of a moving average is the difference of the values at both ends of its window over its length, so
    noise is divided by that length and not by the step of the log.
    """
    known = np.isfinite(values) & np.isfinite(time_s)
    t, v = _in_order(time_s[known], values[known])
    if len(t) < 2:
        return np.full(len(values), np.nan)
    if over_s is None:
        return np.asarray(np.interp(time_s, t, np.gradient(v, t)))
    low, high = np.maximum(time_s - 0.5 * over_s, t[0]), np.minimum(time_s + 0.5 * over_s, t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((np.interp(high, t, v) - np.interp(low, t, v)) / (high - low))


def goes_back(speed: Array) -> Bools:
    """Whether the robot goes backwards; at rest, where the speed's sign is that of its noise, as it went before.
    `speed` (shape (n,)): [m/s]."""
    moves = np.flatnonzero(np.abs(speed) > STILL_SPEED_M_S)
    if not len(moves):
        return np.zeros(len(speed), dtype=np.bool_)
    last = np.searchsorted(moves, np.arange(len(speed)), side="right") - 1
    return np.asarray(speed[moves[np.maximum(last, 0)]] < 0)


def shift_back(data: ColumnData, time_s: Array, lag_s: float) -> ColumnData:
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


def refresh_times(signals: list[ColumnData], time_s: Array) -> tuple[Array, Array, Int64s]:
    """Windows between the refreshes of slow signals.

    `signals` (shape (n,)): a change of any of them is a refresh; `time_s`: shape (n,). Gives `start_s`, `stop_s` (shape
    (m,)): each window reaches from a refresh to the next [s]; `row` (shape (m,)): row that holds the signals' values at
    the end of the window.

    Topics that come one shortly after the other count as one refresh, complete with the last of them. A refresh may
    bring the same value again (standing still): a window longer than 1.5 usual ones is cut in usual ones, all but the
    last with the value before.
    """
    found: list[Int64s] = [np.empty(0, dtype=np.int64)]
    for signal in signals:
        values = signal.codes if isinstance(signal, Labels) else signal
        same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        found.append(np.flatnonzero(~same) + 1)
    at = np.unique(np.concatenate(found))
    if len(at) < 2:
        return np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)
    usual = min(float(np.median(np.diff(time_s[rows]))) for rows in found if len(rows) > 1)
    whole: list[int] = []  # rows at which refreshes are complete: what comes within 0.4 of the usual time is one
    begin = -np.inf
    for row in at:
        if time_s[row] - begin <= 0.4 * usual:
            whole[-1] = int(row)
        else:
            begin = time_s[row]
            whole.append(int(row))
    edges, rows = [time_s[whole[0]]], []
    for before, now in itertools.pairwise(whole):
        took = time_s[now] - time_s[before]
        pieces = max(1, round(took / usual)) if took > 1.5 * usual else 1
        edges += list(np.linspace(time_s[before], time_s[now], pieces + 1)[1:])
        rows += [before] * (pieces - 1) + [now]
    return np.array(edges[:-1]), np.array(edges[1:]), np.array(rows, dtype=np.int64)


def average_windows(
    columns: Mapping[str, ColumnData], time_s: Array, start_s: Array, stop_s: Array, held: Mapping[str, Int64s]
) -> dict[str, ColumnData]:
    """Columns averaged over windows of time, weighted by the time each row stands for; text takes its last word.

    `columns`: shape (n,); `time_s`: shape (n,); `start_s`, `stop_s` (shape (m,)): windows ``(start, stop]`` that follow
    each other without overlap; `held`: column → row to take its value from, shape (m,), in place of a mean. Arrays of
    the result have shape (k,), k ≤ m: windows without any row are left out; ``time_s`` is the middle of the window.
    """
    window = np.searchsorted(stop_s, time_s, side="left")
    inside = window < len(stop_s)
    inside[inside] &= time_s[inside] > start_s[window[inside]]
    # times before zero, so that the first row keeps its full weight
    group, weight = window[inside], np.maximum(row_durations(time_s - time_s[-1] - 1.0)[inside], 1e-12)
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


_EVENTS = 0.05
"""A signal with a smaller share of the rows' number is one of events."""
_DENSER = 1.5
"""A signal with so many times the messages of the timeline is averaged over the time of each row."""


@dataclass
class Signal:
    """Values of one field with the time of each."""

    time_s: Array
    """[s], in the clock of the source. Shape (n,)."""
    values: ColumnData
    """Shape (n,)."""
    fill: str | None
    """``hold`` the last value, ``linear`` between two, ``mean`` over the time that a row stands for; None: the mean of
    numbers that come more often than the rows, else the last value (texts, switches and counts always)."""
    topic: str


def merge_signals(signals: dict[str, Signal], timeline: str | None, file: str) -> RawTable:
    """Bring all signals onto the times of one of them.

    `signals`: short name → signal, each with at least one message. `timeline`: the signal whose messages give the rows;
    by default the one with most messages. `file`: for messages. Gives ``time_s`` from the first row on. Rows begin when
    every signal has come at least once.
    """
    remarks = []
    for name, signal in signals.items():
        back = np.diff(signal.time_s) < 0
        if back.any():
            order = np.argsort(signal.time_s, kind="stable")
            signal.time_s, signal.values = signal.time_s[order], signal.values[order]
            message = f"{int(back.sum())} messages of {signal.topic} are out of order"
            action = "they were sorted by time"
            remarks.append(Remark("time_backwards", name, message, action, "warning", 0, int(back.sum())))
    leader = timeline or max(signals, key=lambda name: len(signals[name].time_s))
    time = signals[leader].time_s
    first = max(signals, key=lambda name: float(signals[name].time_s[0]))
    # what changes now and then stays as it is after its last message
    ends = {
        name: np.inf if len(signal.time_s) < _EVENTS * len(time) else signal.time_s[-1] + 5 * usual_step(signal.time_s)
        for name, signal in signals.items()
    }
    last = min(ends, key=lambda name: float(ends[name]))
    keep = (time >= signals[first].time_s[0]) & (time <= ends[last])
    if not keep.any():
        between = [signals[name].topic for name in (first, last, leader)]
        message = f"no message of {between[2]} lies between the first of {between[0]} and the last of {between[1]}"
        hint = "`stamp: bag`, where headers have another clock; or another timeline"
        raise InputError.single(message, file=file, allowed="signals of one run", hint=hint)
    for side, by in ((time < signals[first].time_s[0], first), (time > ends[last], last)):
        if keep.all() or not (cut := int((side & ~keep).sum())):
            continue
        where = "before the first" if by == first and time[0] < signals[first].time_s[0] else "after the last"
        message = f"{cut} rows of {signals[leader].topic} lie {where} message of {signals[by].topic}"
        remarks.append(Remark("gap", "", message, "these rows were left out", "note", 0, cut))
    time = time[keep]
    columns: dict[str, ColumnData] = {"time_s": time - time[0]}
    told: set[str] = set()
    for name, signal in signals.items():
        columns[name], remark = _onto(name, signal, time)
        if remark is not None and signal.topic not in told:
            remarks.append(remark)
            told.add(signal.topic)
    return RawTable(file, columns, remarks=remarks)


def _onto(name: str, signal: Signal, time: Array) -> tuple[ColumnData, Remark | None]:
    """A signal at the times of the rows, and what is said of a silence of its topic."""
    at, values, fill, usual = signal.time_s, signal.values, signal.fill, usual_step(signal.time_s)
    index = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 1)
    numbers = np.empty(0) if isinstance(values, Labels) else values
    known = np.isfinite(numbers)
    if fill is None:
        fill = "hold"
        if known.any() and len(at) >= 3 and len(time) >= 3 and usual_step(time) > _DENSER * usual:
            some = numbers[known]
            counts = bool((some == np.round(some)).all())
            wraps = len(some) > 1 and float(np.abs(np.diff(some)).max()) > 0.8 * float(np.ptp(some)) > 0
            fill = "hold" if counts or wraps else "mean"
    data = values[index]
    if len(numbers) and fill == "linear" and known.any():
        data = np.asarray(np.interp(time, at[known], numbers[known]))
    elif len(numbers) and fill != "hold":
        edges = np.asarray(np.searchsorted(at, np.r_[-np.inf, 0.5 * (time[1:] + time[:-1]), np.inf]))
        total = np.r_[0.0, np.cumsum(np.where(known, numbers, 0.0))]
        count: Int64s = np.concatenate([[0], np.cumsum(known)])
        rows = count[edges[1:]] - count[edges[:-1]]
        with np.errstate(invalid="ignore", divide="ignore"):
            data = np.where(rows > 0, (total[edges[1:]] - total[edges[:-1]]) / rows, numbers[index])
    inside = at[(at >= time[0]) & (at <= time[-1])]
    silent = float(np.max(np.diff(inside))) if len(inside) > 1 else 0.0
    # at an even pace a hole of a few messages is one
    even = len(at) > 20 and float(np.mean(np.abs(np.diff(at) - usual) < 0.2 * usual)) > 0.9
    long_s, near_s = max(1.0, 10.0 * usual), 2.5 * usual
    long = silent > long_s
    if not (long or (silent > near_s and even)):
        return data, None
    action = "interpolated" if fill == "linear" else "the value before was held"
    if long and even and len(numbers):
        # in a long silence of a topic that tells something all the time, and then tells something else, nothing is
        # known; what was nought or comes back as it was may have stayed so
        before = np.minimum(index, len(at) - 2)
        after = before + 1
        unknown = (at[after] - at[before] > long_s) & (time - at[before] > near_s) & (at[after] - time > near_s)
        unknown &= (numbers[before] != 0.0) & (numbers[after] != numbers[before])
        data = np.where(unknown, np.nan, np.asarray(data))
        action = "missing there" if unknown.any() else action
    message = f"no message of {signal.topic} for {silent:.3g} s"
    return data, Remark("gap", name, message, action, "warning" if long else "note")


def usual_step(time: Array) -> float:
    """Median step between times [s]; infinite where there is one."""
    return float(np.median(np.diff(time))) if len(time) > 1 else np.inf
