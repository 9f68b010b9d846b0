"""One clock for all topics of a bag: headers, the times at which it received messages, and simulated time."""

from __future__ import annotations

import array
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from missionsim.logs.raw import Remark
from missionsim.physics import Array, Int64s

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

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_FIELDS = ("clock.sec", "clock.nanosec")


@dataclass(frozen=True)
class _Simulated:
    """Simulated time over the times at which the bag received it."""

    topic: str
    received: Int64s
    time: Int64s

    @property
    def rate(self) -> float:
        """Simulated seconds in one of the bag's."""
        return float(self.time[-1] - self.time[0]) / float(self.received[-1] - self.received[0])

    def at(self, received: Int64s) -> Int64s:
        """The simulated time at which messages were received; before and after its first and last, at its mean rate."""
        since, grown = (received - self.received[0]).astype(float), (self.time - self.time[0]).astype(float)
        span = float(self.received[-1] - self.received[0])
        inside = np.interp(since, (self.received - self.received[0]).astype(float), grown)
        outside = (np.minimum(since, 0.0) + np.maximum(since - span, 0.0)) * self.rate
        return np.asarray(self.time[0] + np.round(inside + outside).astype(np.int64))


def _simulated(topic: str, received: Int64s, time: Int64s) -> _Simulated | None:
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
    simulated: tuple[str, Int64s, Int64s] | None,
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
    seconds = {name: (times - start).astype(np.float64) * 1e-9 for name, times in chosen.items()}
    _tell_set_back(seconds, remarks)
    return seconds, start * 1e-9


def _with_header(pair: Int64s) -> Int64s:
    """The messages that have a time in their header; before a simulation's clock comes, it is nought."""
    return pair[:, pair[0] != pair[1]]


def _by_headers(pairs: Mapping[str, Int64s]) -> _Simulated | None:
    """The headers of the topic with most messages, where they run at another rate than the bag's clock."""
    headed = {name: _with_header(pair) for name, pair in pairs.items()}
    name = max(headed, key=lambda name: headed[name].shape[1], default="")
    if not name or (found := _simulated(name, headed[name][1], headed[name][0])) is None:
        return None
    long = found.received[-1] - found.received[0] > _RATE_OVER_S * 1e9
    return found if long and abs(found.rate - 1.0) > _RATES_APART else None


def _apart_s(one: Int64s, other: Int64s) -> float:
    return abs(float(np.median(one - other))) * 1e-9


def _goes_by(sim: _Simulated, pairs: Mapping[str, Int64s]) -> bool:
    """Whether headers have this simulated time; or none has any."""
    headed = [pair for pair in map(_with_header, pairs.values()) if pair.size]
    return not headed or any(_apart_s(header, sim.at(received)) < _CLOCKS_APART_S for header, received in headed)


def _to_simulated(sim: _Simulated, pairs: dict[str, Int64s], guessed: bool, remarks: list[Remark]) -> None:
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


_STEPS, _DENSE, _EVEN = 6, (0.4, 0.65), 0.7
"""Over so many steps at such a part of the usual length, twice the messages come; part of a topic's steps that are the
usual one where it has a pace."""
_BACK_ROWS = 12
"""Messages of two stretches over one another below which they are late ones."""


def _dense(times: Array) -> tuple[float, float] | None:
    """When the longest stretch with twice the messages begins and ends [s]; None where there is none, or it makes up
    for a silence before it. Raises ValueError: a topic without a pace."""
    times = np.sort(times)
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) > 50 else 0.0
    if usual <= 0 or float(np.mean(np.abs(steps - usual) < 0.3 * usual)) < _EVEN:
        raise ValueError("no pace")
    part = (times[_STEPS:] - times[:-_STEPS]) / (_STEPS * usual)
    dense = (part > _DENSE[0]) & (part < _DENSE[1])
    edges = np.flatnonzero(np.diff(np.r_[False, dense, False]))
    if not len(edges):
        return None
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    first, last = int(edges[2 * longest]), int(edges[2 * longest + 1]) - 1 + _STEPS
    silence = float(steps[max(first - _STEPS, 0) : first + _STEPS].max())
    if last - first < _BACK_ROWS or silence > 3.0 * usual:
        return None
    return float(times[first]), float(times[last])


def _tell_set_back(seconds: Mapping[str, Array], remarks: list[Remark]) -> None:
    """Tell a clock that was set back: what came before and after lies over one another, in every topic."""
    found: list[tuple[float, float] | None] = []
    for times in seconds.values():
        with contextlib.suppress(ValueError):
            found.append(_dense(times))
    known = [one for one in found if one is not None]
    if len(known) < 2 or len(known) < len(found):
        return
    begin, end = (float(np.median(ends)) for ends in zip(*known, strict=True))
    if max(abs(one[0] - begin) + abs(one[1] - end) for one in known) > max(1.0, 0.3 * (end - begin)):
        return
    long = f"about {end - begin:.2g} s"
    message = f"from {begin:.4g} s on, {long} hold twice the messages of every topic: was the clock set back?"
    action = f"left as it is; `keep: time_s < {np.floor(begin):g} or time_s > {np.ceil(end):g}` leaves them out"
    remarks.append(Remark("clock", "", message, action, "warning"))
