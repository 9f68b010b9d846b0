"""ArduPilot dataflash logs (``.bin``) through pymavlink: any field of any message."""

from __future__ import annotations

import contextlib
import io
import mmap
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.files import needed, unreadable
from missionsim.logs.formats.jsonlines import column
from missionsim.logs.raw import Remark, damaged
from missionsim.logs.readers import Options, Reader, Recording, Topic

_ENDLESS = re.compile(rb"\xa3\x95\x80.[\x00-\x02]", re.DOTALL)
"""A format whose messages are shorter than their own header: pymavlink would never come to the end."""
_OTHERS = frozenset(("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG"))
_CLOCKS = (("TimeUS", 1e-6), ("TimeMS", 1e-3))


def read_ardupilot(path: Path, options: Options) -> Recording:
    """Fields of a dataflash log (``BAT.Volt``, of a second instance ``BAT[1].Volt``), at the times since the boot.
    Raises InputError: pymavlink is not installed, or an unreadable file."""
    file, said = str(path), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):  # it prints what it finds corrupt
        reader = needed("pymavlink.DFReader", "reading ArduPilot logs", file)
    wanted = None
    if options.fields is not None:
        wanted = defaultdict[str, set[str]](set)
        for field in options.fields:
            name, _, inner = field.strip().removeprefix("/").rpartition(".")
            wanted[name].add(inner)
    # pymavlink lets struct and index errors of a broken file through
    with unreadable("the log cannot be read", file, "a whole ArduPilot log"):
        with open(path, "rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if _ENDLESS.search(data):
                raise ValueError("a message has no length")
        with (
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            contextlib.closing(reader.DFReader_binary(file, zero_time_base=True)) as log,
        ):
            held, counts = _messages(log, wanted, options.most)
            lost = _lost(log)
    topics = []
    for name, (times, rows) in sorted(held.items()):
        fields = dict.fromkeys(field for row in rows for field in row)
        columns = {field: column([row.get(field) for row in rows]) for field in fields}
        topics.append(Topic(name, np.array(times), columns, name.partition("[")[0], counts[name]))
    return Recording(topics, _remarks(lost, said.getvalue()))


def _messages(
    log: Any, wanted: dict[str, set[str]] | None, most: int | None
) -> tuple[dict[str, tuple[list[float], list[dict[str, Any]]]], dict[str, int]]:
    """Times and fields of the messages of each kind, and how many there are."""
    held: dict[str, tuple[list[float], list[dict[str, Any]]]] = {}
    counts: dict[str, int] = defaultdict(int)
    kinds = None if wanted is None else sorted({name.partition("[")[0] for name in wanted})
    while (message := log.recv_match(type=kinds) if kinds is not None else log.recv_msg()) is not None:
        kind = message.get_type()
        clock = next(((name, unit) for name, unit in _CLOCKS if name in message._fieldnames), None)
        if kind in _OTHERS or clock is None:
            continue
        instance = message.fmt.instance_field
        number = getattr(message, instance) if instance else 0
        name = f"{kind}[{number}]" if number else kind
        counts[name] += 1
        if (wanted is not None and name not in wanted) or (most is not None and counts[name] > most):
            continue
        times, rows = held.setdefault(name, ([], []))
        times.append(float(getattr(message, clock[0])) * clock[1])
        fields = [field for field in message._fieldnames if field not in (clock[0], instance)]
        values = {field: getattr(message, field) for field in fields if wanted is None or field in wanted[name]}
        rows.append({field: value for field, value in values.items() if isinstance(value, (int, float, str))})
    return held, counts


def _lost(log: Any) -> tuple[int, int]:
    """Bytes that belong to no message, and all bytes; what fills the last page does not count."""
    size = log.data_len
    tail = log.data_map[max(0, size - 4096) : size]
    filled = len(tail) - len(tail.rstrip(tail[-1:])) if tail[-1:] in (b"\0", b"\xff") else 0
    used = sum(count * log.formats[kind].len for kind, count in enumerate(log.counts) if count and kind in log.formats)
    lost = size - used
    return (0 if 0 <= lost <= filled else abs(lost)), size


def _remarks(lost: tuple[int, int], said: str) -> list[Remark]:
    if not lost[0] and not said.strip():
        return []
    message = f"{lost[0]:,} of {lost[1]:,} bytes belong to no whole message"
    first = said.strip().partition("\n")[0][:80]
    return [damaged(message + (f" ({first})" if first else ""))]


READERS = (Reader("ardupilot", "ArduPilot log", (".bin",), (b"\xa3\x95\x80",), recording=read_ardupilot),)
