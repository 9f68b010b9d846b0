"""The clocks of the files of a run, brought to one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from missionsim.errors import InputError
from missionsim.logs.raw import Remark
from missionsim.logs.readers import Topic

_DAY_S = 86400.0
_DATED_S = 1e8
"""Times beyond it are seconds since 1970 (assumed: from 1973 on)."""


def one_clock(topics: Sequence[Topic], clocks: dict[str, str], path: Path, remarks: list[Remark]) -> None:
    """Bring the files of a run to one clock, and see that they overlap.

    `topics`: of all files, their times are changed; `clocks`: short name of each file → kind of its times; `path`: the
    first file, for messages; `remarks`: what is said is added. Raises InputError: no clock in common, no overlap, or no
    row with a time.
    """
    topics = [topic for topic in topics if len(topic.time_s)]
    if not topics:
        allowed = "rows with a time and a value"
        raise InputError.single("these files hold no row with a time and a value", file=str(path), allowed=allowed)
    starts = {topic.name.partition(".")[0]: np.inf for topic in topics}
    for topic in topics:
        alias = topic.name.partition(".")[0]
        starts[alias] = min(starts[alias], float(topic.time_s.min()))
    for alias in starts:
        if clocks[alias] in ("utc", "own"):  # a recording may count from its start, and a lag lead to a date
            clocks[alias] = "utc" if starts[alias] > _DATED_S else "own"
    kinds = {clocks[alias] for alias in starts}
    early, late = min(starts, key=starts.__getitem__), max(starts, key=starts.__getitem__)
    lag = f"`lag: {starts[early] - starts[late]:.3f} s` for {early} lets it begin with {late}"
    hint = f"{lag}: correct it by what you know of both"
    if kinds & {"utc", "local"} and "day" in kinds:
        kind = {topic.name: clocks[topic.name.partition(".")[0]] for topic in topics}
        dated = [topic.time_s.min() for topic in topics if kind[topic.name] in ("utc", "local")]
        for topic in topics:
            if kind[topic.name] == "day":
                topic.time_s = topic.time_s + np.floor(min(dated) / _DAY_S) * _DAY_S
        kinds.discard("day")
        remarks.append(Remark("clock", "", "a file has times of day only", "the day is that of the other file", "note"))
    spans: dict[str, tuple[float, float]] = {}
    for one in topics:  # the signals of a table are one file
        name = one.name if one.title else one.name.partition(".")[0]
        first, last = spans.get(name, (np.inf, -np.inf))
        spans[name] = min(first, float(one.time_s.min())), max(last, float(one.time_s.max()))
    words = {"utc": "UTC", "local": "local time", "day": "time of day", "own": "seconds of its own"}
    told = ", ".join(f"{alias}: {words[kind]}" for alias, kind in clocks.items())
    if "own" in kinds and len(kinds) > 1:
        allowed = "times of day or dates in all of them, or seconds from one start in all"
        message = "these files have no clock in common"
        raise InputError.single(message, file=str(path), got=told, allowed=allowed, hint=hint)
    if kinds == {"own"} and len(clocks) > 1:
        action = "taken as counted from one start"
        remarks.append(Remark("clock", "", "the files have no clock but seconds of their own", action, "warning"))
    begin, end = max(span[0] for span in spans.values()), min(span[1] for span in spans.values())
    if begin >= end:
        late = max(spans, key=lambda name: spans[name][0])
        apart = begin - end
        zone = "a zone (zone: Europe/Berlin) for the file with local time" if {"utc", "local"} <= kinds else hint
        message = f"the files do not overlap: {late} begins {apart:.6g} s after another one ends"
        raise InputError.single(message, file=str(path), got=told, allowed="files of one run", hint=zone)
    if {"utc", "local"} <= kinds:
        action = "taken as UTC, as they overlap so; zone: says otherwise"
        remarks.append(Remark("clock", "", f"local times without a zone beside UTC ({told})", action, "warning"))
    for name, (first, last) in spans.items():
        if (outside := max(0.0, begin - first) + max(0.0, last - end)) > 1.0:
            message = f"{outside:.4g} s of {name} lie outside the other files"
            remarks.append(Remark("gap", "", message, "these were left out", "note"))
