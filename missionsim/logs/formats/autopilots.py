"""Logs of flight controllers: PX4 ULog through pyulog, ArduPilot dataflash (``.bin``) through pymavlink; any field."""

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
from missionsim.logs.formats.jsonlines import columns_of
from missionsim.logs.raw import ColumnData, Remark, damaged
from missionsim.logs.readers import Options, Reader, Recording, Topic

_HEADER_BYTES = 16
_KINDS = frozenset(b"BFIMPQARDLCSO")
"""Types of message of the ULog specification."""
_FIELD = re.compile(r"(?P<topic>[A-Za-z0-9_]+(?:\[\d+\])?)\.(?P<field>[A-Za-z0-9_.\[\]]+)\Z")


def read_ulog(path: Path, options: Options) -> Recording:
    """Fields of a ULog (``topic.field``, ``topic[1].field[0]``), each topic at its ``timestamp`` (microseconds). Raises
    InputError: pyulog is not installed, or an unreadable file."""
    file = str(path)
    pyulog = needed("pyulog", "reading ULog", file)
    matches = [match for field in options.fields or () if (match := _FIELD.match(field.strip()))]
    names = None if options.fields is None else sorted({match["topic"].split("[")[0] for match in matches})
    said = io.StringIO()
    # it prints what it finds corrupt, and lets struct, index and type errors of a broken file through
    with unreadable("the ULog cannot be read", file, "a whole PX4 ULog"), contextlib.redirect_stdout(said):
        log = pyulog.ULog(file, names)
    wanted = {(match["topic"].removesuffix("[0]"), match["field"]) for match in matches}
    topics: dict[str, Topic] = {}
    for data in sorted(log.data_list, key=lambda item: (item.name, item.multi_id)):
        name = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
        stamps = data.data.get("timestamp")
        if stamps is None or not len(stamps) or name in topics:
            continue
        columns: dict[str, ColumnData] = {
            key: np.asarray(values, dtype=np.float64)
            for key, values in data.data.items()
            if key != "timestamp" and (names is None or (name, key) in wanted)
        }
        topics[name] = Topic(name, np.asarray(stamps, dtype=np.float64) * 1e-6, columns, data.name, len(stamps))
    remarks = []
    whole, size = _whole_bytes(path)
    if whole != size:
        share = 100.0 * (size - whole) / size
        told = f"from byte {whole:,} of {size:,} on ({share:.2g} % of the file) its messages are cut or broken"
        remarks.append(damaged(told))
    elif log.file_corruption or said.getvalue().strip():
        remarks.append(damaged(f"part of it is corrupt ({said.getvalue().strip()[:80]})"))
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        message = f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s together"
        remarks.append(Remark("gap", "", message, "the values before were held", "warning", 0, len(log.dropouts)))
    return Recording(list(topics.values()), remarks)


def _whole_bytes(path: Path) -> tuple[int, int]:
    """Bytes up to which the messages of a file follow each other without a break, and all its bytes."""
    size = path.stat().st_size
    with open(path, "rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = _HEADER_BYTES
        while at + 3 <= size:
            length = data[at] | data[at + 1] << 8
            if data[at + 2] not in _KINDS or at + 3 + length > size:
                break
            at += 3 + length
    return at, size


_ENDLESS = re.compile(rb"\xa3\x95\x80.[\x00-\x02]", re.DOTALL)
"""A format whose messages are shorter than their own header: pymavlink would never come to the end."""
_TEXT = b"FMT, 128, "
"""How a dataflash log begins that a ground station wrote as text."""
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
            text = data[:3] == _TEXT[:3]
            opened = reader.DFReader_text if text else reader.DFReader_binary
            if not text and _ENDLESS.search(data):
                raise ValueError("a message has no length")
        with (
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            contextlib.closing(opened(file, zero_time_base=True)) as log,
        ):
            held, counts = _messages(log, wanted, options.most)
            lost, size = (0, log.data_len) if text else _lost_bytes(log)
    remarks, first = [], said.getvalue().strip().partition("\n")[0][:80]
    if lost or first:
        told = f"{lost:,} of {size:,} bytes belong to no whole message"
        remarks.append(damaged(told + (f" ({first})" if first else "")))
    topics = [
        Topic(name, np.array(times), columns_of(rows), name.partition("[")[0], counts[name])
        for name, (times, rows) in sorted(held.items())
    ]
    return Recording(topics, remarks)


def _lost_bytes(log: Any) -> tuple[int, int]:
    """Bytes of a binary log that belong to no message, and all of them."""
    size = log.data_len
    tail = log.data_map[max(0, size - 4096) : size]
    filled = len(tail) - len(tail.rstrip(tail[-1:])) if tail[-1:] in (b"\0", b"\xff") else 0  # the last page
    used = sum(count * log.formats[kind].len for kind, count in enumerate(log.counts) if kind in log.formats)
    return (0 if 0 <= size - used <= filled else abs(size - used)), size


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


READERS = (
    Reader("ardupilot", "ArduPilot log", (".bin",), (b"\xa3\x95\x80", _TEXT), recording=read_ardupilot),
    Reader("ulog", "ULog", (".ulg",), (b"ULog\x01",), recording=read_ulog),
)
