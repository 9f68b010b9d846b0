"""PX4 ULog through pyulog: any field of any topic."""

from __future__ import annotations

import contextlib
import io
import mmap
import re
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.files import needed, unreadable
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
    return Recording(list(topics.values()), _remarks(log, path, said.getvalue()))


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


def _remarks(log: Any, path: Path, said: str) -> list[Remark]:
    remarks = []
    whole, size = _whole_bytes(path)
    if whole != size or log.file_corruption or said.strip():
        share = 100.0 * (size - whole) / size
        where = f"from byte {whole:,} of {size:,} on ({share:.2g} % of the file) its messages are cut or broken"
        message = where if whole != size else f"part of it is corrupt ({said.strip()[:80]})"
        remarks.append(damaged(message))
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        message = f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s together"
        remarks.append(Remark("gap", "", message, "the values before were held", "warning", 0, len(log.dropouts)))
    return remarks


READERS = (Reader("ulog", "ULog", (".ulg",), (b"ULog\x01",), recording=read_ulog),)
