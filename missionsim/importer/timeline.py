"""Signals with times of their own onto one time axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable
from missionsim.logs.remarks import Remark

Floats = NDArray[np.float64]


@dataclass
class Signal:
    """Values of one field with the time of each.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        [s], in the clock of the source.
    values : column, shape (n,)
    fill : str
        ``hold`` or ``linear`` between the messages.
    topic : str
    """

    time_s: Floats
    values: ColumnData
    fill: str
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
        if (np.diff(signal.time_s) < 0).any():
            order = np.argsort(signal.time_s, kind="stable")
            count = int((np.diff(signal.time_s) < 0).sum())
            signal.time_s, signal.values = signal.time_s[order], signal.values[order]
            remarks.append(
                Remark(
                    "time_backwards",
                    name,
                    f"{count} messages of {signal.topic} are out of order",
                    "they were sorted by time",
                    "warning",
                    0,
                    count,
                )
            )
    leader = timeline or max(signals, key=lambda name: len(signals[name].time_s))
    time = signals[leader].time_s
    first = max(signal.time_s[0] for signal in signals.values())
    last = min(signal.time_s[-1] + 5.0 * _usual(signal.time_s) for signal in signals.values())
    keep = (time >= first) & (time <= last)
    if not keep.any():
        keep[:] = True
    if not keep.all():
        cut = int((~keep).sum())
        remarks.append(
            Remark(
                "gap",
                "",
                f"{cut} rows of {signals[leader].topic} lie before the first or after the last message of "
                "another topic",
                "these rows were left out",
                "note",
                0,
                cut,
            )
        )
    time = time[keep]
    columns: dict[str, ColumnData] = {"time_s": time - time[0]}
    for name, signal in signals.items():
        columns[name] = _onto(signal, time)
        silent = _longest_gap(signal.time_s, time)
        if silent > max(1.0, 10.0 * _usual(signal.time_s)):
            remarks.append(
                Remark(
                    "gap",
                    name,
                    f"no message of {signal.topic} for {silent:.3g} s",
                    "the value before was held" if signal.fill == "hold" else "interpolated",
                )
            )
    return RawTable(file, columns, remarks=remarks)


def _onto(signal: Signal, time: Floats) -> ColumnData:
    if isinstance(signal.values, Labels) or signal.fill == "hold":
        index = np.clip(np.searchsorted(signal.time_s, time, side="right") - 1, 0, len(signal.time_s) - 1)
        return signal.values[index]
    return np.asarray(np.interp(time, signal.time_s, signal.values))


def _usual(time: Floats) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else np.inf


def _longest_gap(time: Floats, rows: Floats) -> float:
    inside = time[(time >= rows[0]) & (time <= rows[-1])]
    return float(np.max(np.diff(inside))) if len(inside) > 1 else 0.0
