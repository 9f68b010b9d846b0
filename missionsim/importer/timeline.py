"""Signals with times of their own onto one time axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable
from missionsim.logs.remarks import Remark

Floats = NDArray[np.float64]

_EVENTS = 0.05
"""A signal with a smaller share of the rows' number is one of events."""
_DENSER = 1.5
"""A signal with so many times the messages of the timeline is averaged over the time of each row."""


@dataclass
class Signal:
    """Values of one field with the time of each.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        [s], in the clock of the source.
    values : column, shape (n,)
    fill : str or None
        ``hold`` the last value, ``linear`` between two, ``mean`` over the time that a row stands for; None: the mean of
        numbers that come more often than the rows, else the last value (texts, switches and counts always).
    topic : str
    """

    time_s: Floats
    values: ColumnData
    fill: str | None
    topic: str


def merge_signals(signals: dict[str, Signal], timeline: str | None, file: str) -> RawTable:
    """Bring all signals onto the times of one of them.

    Parameters
    ----------
    signals : dict
        Short name → signal, each with at least one message.
    timeline : str or None
        The signal whose messages give the rows; by default the one with most messages.
    file : str
        For messages.

    Returns
    -------
    RawTable
        ``time_s`` from the first row on. Rows begin when every signal has come at least once.
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
        keep[:] = True
    for side, by in ((time < signals[first].time_s[0], first), (time > ends[last], last)):
        if keep.all() or not (cut := int((side & ~keep).sum())):
            continue
        where = "before the first" if by == first and time[0] < signals[first].time_s[0] else "after the last"
        message = f"{cut} rows of {signals[leader].topic} lie {where} message of {signals[by].topic}"
        remarks.append(Remark("gap", "", message, "these rows were left out", "note", 0, cut))
    time = time[keep]
    columns: dict[str, ColumnData] = {"time_s": time - time[0]}
    for name, signal in signals.items():
        fill = signal.fill or _fill(signal, time)
        columns[name] = _onto(signal, time, fill)
        silent = _longest_gap(signal.time_s, time)
        usual = usual_step(signal.time_s)
        long = silent > max(1.0, 10.0 * usual)
        if long or (silent > 2.5 * usual and _even(signal.time_s, usual)):
            action = {"hold": "the value before was held", "linear": "interpolated"}.get(fill, "averaged")
            message = f"no message of {signal.topic} for {silent:.3g} s"
            remarks.append(Remark("gap", name, message, action, "warning" if long else "note"))
    return RawTable(file, columns, remarks=remarks)


def _fill(signal: Signal, time: Floats) -> str:
    if isinstance(signal.values, Labels) or len(signal.time_s) < 3 or len(time) < 3:
        return "hold"
    denser = usual_step(time) > _DENSER * usual_step(signal.time_s)
    known = signal.values[np.isfinite(signal.values)]
    counts = len(known) > 0 and bool((known == np.round(known)).all())
    wraps = len(known) > 1 and float(np.abs(np.diff(known)).max()) > 0.8 * float(np.ptp(known)) > 0
    return "mean" if denser and not counts and not wraps else "hold"


def _onto(signal: Signal, time: Floats, fill: str) -> ColumnData:
    index = np.clip(np.searchsorted(signal.time_s, time, side="right") - 1, 0, len(signal.time_s) - 1)
    if isinstance(signal.values, Labels) or fill == "hold":
        return signal.values[index]
    known = np.isfinite(signal.values)
    if fill == "linear" and known.any():
        return np.asarray(np.interp(time, signal.time_s[known], signal.values[known]))
    middle = 0.5 * (time[1:] + time[:-1])
    edges = np.asarray(np.searchsorted(signal.time_s, np.r_[-np.inf, middle, np.inf]))
    total = np.r_[0.0, np.cumsum(np.where(known, signal.values, 0.0))]
    count: NDArray[np.int64] = np.concatenate([[0], np.cumsum(known)])
    rows = count[edges[1:]] - count[edges[:-1]]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (total[edges[1:]] - total[edges[:-1]]) / rows
    return np.where(rows > 0, mean, signal.values[index])


def _even(time: Floats, usual: float) -> bool:
    """Whether messages come at an even pace, so that a hole of a few is one."""
    return len(time) > 20 and float(np.mean(np.abs(np.diff(time) - usual) < 0.2 * usual)) > 0.9


def usual_step(time: Floats) -> float:
    """Median step between times [s]; infinite where there is one."""
    return float(np.median(np.diff(time))) if len(time) > 1 else np.inf


def _longest_gap(time: Floats, rows: Floats) -> float:
    inside = time[(time >= rows[0]) & (time <= rows[-1])]
    return float(np.max(np.diff(inside))) if len(inside) > 1 else 0.0
