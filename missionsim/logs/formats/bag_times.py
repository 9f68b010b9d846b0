"""One clock for all topics of a bag: headers, the times at which it received messages, and simulated time."""

from __future__ import annotations

import array
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.logs.raw import Remark
from missionsim.physics import Array

_CLOCKS_APART_S = 5.0
_STAMPS_APART_S = 0.5
"""Header and bag differ by transport and buffering, tenths of a second; a topic that differs by more from the others
has another clock, or another way, and far beyond (`_CLOCKS_APART_S`) no time of it can stand beside theirs."""
_RATES_APART = 0.02
"""Clocks of computers differ by less than a thousandth; one that runs so much faster or slower is a simulation's."""
_RATE_OVER_S = 10.0
"""Over a shorter time, late messages make a rate of their own."""
_BACK_S = 1.0
"""Late messages come a little out of order; a clock that goes back by more began anew."""

Stamps = NDArray[np.int64]
"""[ns] since 1970, or since the start of a simulation."""
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_FIELDS = ("clock.sec", "clock.nanosec")


@dataclass(frozen=True)
class _Simulated:
    """Simulated time over the times at which the bag received it."""

    topic: str
    received: Stamps
    time: Stamps

    @property
    def rate(self) -> float:
        """Simulated seconds in one of the bag's."""
        return float(self.time[-1] - self.time[0]) / float(self.received[-1] - self.received[0])

    def at(self, received: Stamps) -> Stamps:
        """The simulated time at which messages were received; before and after its first and last, at its mean rate."""
        since, grown = (received - self.received[0]).astype(float), (self.time - self.time[0]).astype(float)
        span = float(self.received[-1] - self.received[0])
        inside = np.interp(since, (self.received - self.received[0]).astype(float), grown)
        outside = (np.minimum(since, 0.0) + np.maximum(since - span, 0.0)) * self.rate
        return np.asarray(self.time[0] + np.round(inside + outside).astype(np.int64))


def _simulated(topic: str, received: Stamps, time: Stamps) -> _Simulated | None:
    """None where it is too short to tell a rate, or began anew."""
    order = np.argsort(received, kind="stable")
    received, time = received[order], time[order]
    if len(received) < 3 or received[-1] - received[0] < 1e9 or time[-1] <= time[0]:
        return None
    if np.min(np.diff(time)) < -_BACK_S * 1e9:
        return None
    return _Simulated(topic, received, np.maximum.accumulate(time))


def common_times(
    stamps: Mapping[str, tuple[array.array[int], array.array[int]]],
    clock: str,
    simulated: tuple[str, Stamps, Stamps] | None,
    remarks: list[Remark],
) -> tuple[dict[str, Array], float]:
    """Times of each topic's messages [s] from the first, all by the same clock, and that of the first.

    Messages without a header have the bag's time only. Where headers have simulated time, theirs is the simulated time
    at which the bag received them. Where headers are otherwise of another clock than these or than one another (a
    microcontroller that counts from its start), they cannot be mixed, and the bag's time is taken for all.

    `stamps`: topic → its messages' headers and times of the bag [ns]; `clock`: ``header`` or ``bag``; `simulated`: the
    topic of simulated time, when it was received, and the time [ns].
    """
    pairs = {name: np.array(pair, dtype=np.int64) for name, pair in stamps.items()}
    which = 0 if clock == "header" else 1
    fast = _by_headers(pairs)
    sim = _simulated(*simulated) if simulated is not None else fast
    if which == 0 and sim is not None and _goes_by(sim, pairs):
        _to_simulated(sim, pairs, simulated is None, remarks)
        fast = None
    else:
        sim = None
    # a message without a header has the bag's time, so that it lies nought off
    base = {name: received if sim is None else sim.at(received) for name, (_, received) in pairs.items()}
    off = {name: float(np.median(header - base[name])) * 1e-9 for name, (header, _) in pairs.items()}
    if which == 0 and off:
        usual = float(np.median(list(off.values())))
        strange = [name for name in off if abs(off[name] - usual) > _STAMPS_APART_S]
        if max(off.values()) - min(off.values()) > _CLOCKS_APART_S:
            which, action = 1, "the times at which the bag received the messages were taken"
        else:
            action = "left as it is; `stamp: bag` in a map takes the times at which the bag received the messages"
        if strange:
            told = ", ".join(f"{off[name]:+.4g} s in {name}" for name in strange)
            message = f"headers are not of one clock: off the bag's by {told}, by {usual:+.2g} s in most topics"
            remarks.append(Remark("clock", "", message, action))
    if which == 1 and fast is not None:
        message = f"headers of {fast.topic} run at {fast.rate:.3g} times the bag's clock, as simulated time does"
        action = f"left as it is: by the bag's clock times and energies are {1 / fast.rate:.3g} times as large"
        remarks.append(Remark("clock", "", message, action, "warning"))
    chosen = {name: pair[which] for name, pair in pairs.items()}
    start = min((int(times.min()) for times in chosen.values() if len(times)), default=0)
    return {name: (times - start).astype(np.float64) * 1e-9 for name, times in chosen.items()}, start * 1e-9


def _with_header(pair: NDArray[np.int64]) -> NDArray[np.int64]:
    """The messages that have a time in their header; before a simulation's clock comes, it is nought."""
    return pair[:, pair[0] != pair[1]]


def _by_headers(pairs: Mapping[str, NDArray[np.int64]]) -> _Simulated | None:
    """The headers of the topic with most messages, where they run at another rate than the bag's clock."""
    headed = {name: _with_header(pair) for name, pair in pairs.items()}
    name = max(headed, key=lambda name: headed[name].shape[1], default="")
    if not name or (found := _simulated(name, headed[name][1], headed[name][0])) is None:
        return None
    long = found.received[-1] - found.received[0] > _RATE_OVER_S * 1e9
    return found if long and abs(found.rate - 1.0) > _RATES_APART else None


def _apart_s(one: Stamps, other: Stamps) -> float:
    return abs(float(np.median(one - other))) * 1e-9


def _goes_by(sim: _Simulated, pairs: Mapping[str, NDArray[np.int64]]) -> bool:
    """Whether headers have this simulated time; or none has any."""
    headed = [pair for pair in map(_with_header, pairs.values()) if pair.size]
    return not headed or any(_apart_s(header, sim.at(received)) < _CLOCKS_APART_S for header, received in headed)


def _to_simulated(sim: _Simulated, pairs: dict[str, NDArray[np.int64]], guessed: bool, remarks: list[Remark]) -> None:
    """Bring what has the bag's time to simulated time, and tell it."""
    moved = []
    for name, pair in pairs.items():
        header, received = pair
        bare = header == received
        own, came = _with_header(pair)
        if len(own) and _apart_s(own, sim.at(came)) > _CLOCKS_APART_S > _apart_s(own, came):
            bare[:] = True  # headers with the time of day
        if bare.any():
            pairs[name] = np.array([np.where(bare, sim.at(header), header), received])
        if bare.all():
            moved.append(name)
    if moved:
        have = f"headers of {sim.topic} run" if guessed else f"simulated time ({sim.topic}) runs"
        message = f"{have} at {sim.rate:.3g} times the bag's clock, and {', '.join(moved)} has the bag's time only"
        action = "brought to simulated time, by when the bag received it"
        remarks.append(Remark("clock", "", message, action, "warning" if guessed else "note"))
