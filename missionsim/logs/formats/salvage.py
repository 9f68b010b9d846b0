"""Recordings that broke off: what is whole in a file that was never closed, or is cut, as a file that can be read."""

from __future__ import annotations

import contextlib
import re
import shutil
import sqlite3
import struct
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from missionsim.errors import InputError
from missionsim.files import unreadable
from missionsim.logs.raw import Remark, damaged

_MCAP, _ROSBAG = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"
_HINTS = {
    ".mcap": "mcap recover FILE -o NEW.mcap",
    ".db3": "ros2 bag reindex FOLDER",
    ".bag": "rosbag reindex FILE",
    ".active": "rosbag reindex FILE",
}
"""The tools of the formats themselves, which may find more."""


@contextlib.contextmanager
def whole_files(path: Path, remarks: list[Remark]) -> Iterator[list[Path]]:
    """The files of a recording: itself; where one of its files broke off, all of them, with a copy of what is whole in
    that one, and a remark. Raises InputError: nothing in it is whole."""
    files = sorted(p for p in path.iterdir() if p.suffix in (".mcap", ".db3")) if path.is_dir() else [path]
    missing = _missing(path) if files else []
    cut = [file for file in files if _breaks_off(file)]
    named = [file for file in files if file.suffix == ".active"]  # rosbags knows a bag by its name
    if not (cut or missing or named):
        yield [path]
        return
    if missing:
        remarks.append(damaged(f"{', '.join(missing)} is missing, {len(files)} of the bag's files are there"))
    with TemporaryDirectory() as folder:
        found = []
        for file in files:
            copy = Path(folder) / file.name.removesuffix(".active")
            if file in cut:
                with unreadable("the bag cannot be read", str(file), "a bag that was closed"):
                    found += [copy] if _salvage(file, copy) else []
            elif file in named:
                copy.symlink_to(file.resolve())
                found.append(copy)
            else:
                found.append(file)
        hint = _HINTS.get(cut[0].suffix, "") if cut else ""
        if not found:
            told = "the bag cannot be read: it was never closed, or is cut, and no part of it is whole"
            raise InputError.single(told, file=str(path), hint=hint)
        if cut:
            names = ", ".join(file.name for file in cut)
            told = f"{names} was never closed, or is cut: what came after its last whole part is lost"
            remarks.append(damaged(f"{told} (`{hint}` may find more)"))
        yield found


def _missing(path: Path) -> list[str]:
    """The files that the description of a bag names and that are not there."""
    if not path.is_dir() or not (path / "metadata.yaml").is_file():
        return []
    text = (path / "metadata.yaml").read_text(errors="replace")
    named = re.findall(r"^ *- *['\"]?([^'\"\s:]+\.(?:mcap|db3))['\"]? *$", text, re.MULTILINE)
    return [name for name in dict.fromkeys(named) if not (path / name).exists()]


def _breaks_off(file: Path) -> bool:
    """Whether a recording has no end, or has it behind the end of the file."""
    size = file.stat().st_size
    with file.open("rb") as handle:
        head = handle.read(4096)
        if head.startswith(_MCAP):
            handle.seek(max(size - len(_MCAP), 0))
            return size > 2 * len(_MCAP) and handle.read() != _MCAP
        if head.startswith(b"SQLite format 3\0"):
            page = int.from_bytes(head[16:18], "big")
            return (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big") > size
        if head.startswith(_ROSBAG):
            handle.seek(len(_ROSBAG))
            found = _record(handle)
            at = int.from_bytes(found[0].get(b"index_pos", b""), "little") if found else size
            return size > 4096 and (at == 0 or at > size)
    return False


def _salvage(file: Path, copy: Path) -> bool:
    """Write what is whole in a file to a copy; False where nothing is."""
    with file.open("rb") as handle:
        head = handle.read(len(_ROSBAG))
        if head.startswith(_MCAP):
            return _salvage_mcap(handle, copy)
        if head == _ROSBAG:
            return _salvage_ros1(handle, copy)
    return _salvage_sqlite(file, copy)


def _salvage_mcap(handle: BinaryIO, copy: Path) -> bool:
    """The records up to the first that is not whole, with an end of their own."""
    size, at, kinds = handle.seek(0, 2), len(_MCAP), set[int]()
    while at + 9 <= size:
        handle.seek(at)
        head = handle.read(9)
        after = at + 9 + int.from_bytes(head[1:], "little")
        if after > size or not 1 <= head[0] <= 14:  # 15 and 2 would be its end
            break
        kinds.add(head[0])
        at = after
    with copy.open("wb") as out:
        handle.seek(0)
        left = at
        while left > 0:
            left -= out.write(handle.read(min(left, 1 << 20)))
        out.write(struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + _MCAP)
    return bool(kinds & {5, 6})  # messages, chunks


def _salvage_sqlite(file: Path, copy: Path) -> bool:
    """The rows of each table up to the first that cannot be read."""
    short = copy.with_suffix(".short")
    shutil.copyfile(file, short)
    with short.open("r+b") as handle:
        head = handle.read(32)
        page = int.from_bytes(head[16:18], "big")
        handle.seek(28)
        handle.write((short.stat().st_size // (65536 if page == 1 else page)).to_bytes(4, "big"))
    source, target = sqlite3.connect(short), sqlite3.connect(copy)
    with contextlib.closing(source), contextlib.closing(target), target:
        try:
            tables = source.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
            for name, made in tables:
                target.execute(made)
                places = ", ".join("?" * len(source.execute(f'PRAGMA table_info("{name}")').fetchall()))
                with contextlib.suppress(sqlite3.DatabaseError):
                    for row in source.execute(f'SELECT * FROM "{name}" ORDER BY rowid'):
                        target.execute(f'INSERT INTO "{name}" VALUES ({places})', row)
            return bool(target.execute("SELECT count(*) FROM messages").fetchone()[0])
        except sqlite3.DatabaseError:
            return False


_Fields = dict[bytes, bytes]


def _record(handle: BinaryIO) -> tuple[_Fields, bytes] | None:
    """Header and data of the next record of a ROS 1 bag; None where it is not whole."""
    parts = []
    for _ in range(2):
        length = handle.read(4)
        parts.append(handle.read(int.from_bytes(length, "little")) if len(length) == 4 else b"")
        if len(length) < 4 or len(parts[-1]) < int.from_bytes(length, "little"):
            return None
    fields: _Fields = {}
    at = 0
    while at + 4 <= len(parts[0]):
        size = int.from_bytes(parts[0][at : at + 4], "little")
        name, _, value = parts[0][at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields, parts[1]


def _packed(data: bytes, **fields: bytes) -> bytes:
    """A record of a ROS 1 bag."""
    parts = (name.encode() + b"=" + value for name, value in fields.items())
    head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def _salvage_ros1(handle: BinaryIO, copy: Path) -> bool:
    """The whole chunks of a ROS 1 bag, with an index of them."""
    from io import BytesIO

    from rosbags.rosbag1.reader import decompressors

    connections: dict[bytes, bytes] = {}
    infos: list[bytes] = []
    with copy.open("wb") as out:
        out.write(_ROSBAG.ljust(len(_ROSBAG) + 4096, b"\0"))
        while (found := _record(handle)) is not None:
            fields, data = found
            if fields.get(b"op") != b"\5":
                continue
            seen: dict[bytes, list[bytes]] = defaultdict(list)
            try:
                inside = BytesIO(decompressors[fields[b"compression"].decode()](data))
            except Exception:  # a chunk that is not whole
                break
            while (record := (inside.tell(), _record(inside)))[1] is not None:
                at, (inner, content) = record[0], record[1]
                if inner.get(b"op") == b"\7":
                    connections[inner[b"conn"]] = _packed(content, **{k.decode(): v for k, v in inner.items()})
                elif inner.get(b"op") == b"\2":
                    seen[inner[b"conn"]].append(inner[b"time"] + struct.pack("<I", at))
            if not seen:
                continue
            place, one = out.tell(), struct.pack("<I", 1)
            out.write(_packed(data, **{k.decode(): v for k, v in fields.items()}))
            for conn, places in seen.items():
                count = struct.pack("<I", len(places))
                out.write(_packed(b"".join(places), op=b"\4", ver=one, conn=conn, count=count))
            times = sorted(
                (time[:8] for places in seen.values() for time in places), key=lambda t: struct.unpack("<II", t)
            )
            counts = b"".join(conn + struct.pack("<I", len(places)) for conn, places in seen.items())
            ends = {"start_time": times[0], "end_time": times[-1], "count": struct.pack("<I", len(seen))}
            infos.append(_packed(counts, op=b"\6", ver=one, chunk_pos=struct.pack("<Q", place), **ends))
        index = out.tell()
        out.write(b"".join([*connections.values(), *infos]))
        sizes = {"conn_count": struct.pack("<I", len(connections)), "chunk_count": struct.pack("<I", len(infos))}
        head = _packed(b"", op=b"\3", index_pos=struct.pack("<Q", index), **sizes)
        out.seek(len(_ROSBAG))
        padding = b" " * (4096 - len(head))
        out.write(head[:-4] + struct.pack("<I", len(padding)) + padding)
    return bool(infos)
