"""Damaged files of every kind: read and told, or refused; never a traceback, a hang, or rows missing unsaid."""

from __future__ import annotations

import collections
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.importer.mapping import import_source
from missionsim.importer.suggest import suggest_map
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, read_log
from tests.logs import loggers
from tests.logs.bag_writers import write_ardupilot, write_bag, write_ulog
from tests.logs.conftest import motion, write_csv

KINDS = ("csv", "parquet", "jsonl", "ulog", "ardupilot", "ros1", "sqlite3", "mcap", "lone mcap")


def make(kind: str, folder: Path) -> Path:
    """A whole file of a kind."""
    folder.mkdir(parents=True)
    if kind == "csv":
        return write_csv(folder / "a.csv", motion(400))
    if kind == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as parquet

        parquet.write_table(pa.table(motion(400)), folder / "a.parquet", row_group_size=100)
        return folder / "a.parquet"
    if kind == "jsonl":
        return loggers.write_states(folder / "a.jsonl")
    if kind == "ulog":
        return write_ulog(folder / "a.ulg")
    if kind == "ardupilot":
        return write_ardupilot(folder / "a.bin")
    bag = write_bag(folder / ("a.bag" if kind == "ros1" else "bag"), kind.removeprefix("lone "), 30.0)
    if kind == "lone mcap":
        return Path(shutil.copy(next(bag.glob("*.mcap")), folder / "a.mcap"))
    return bag if kind == "ros1" else next(p for p in bag.iterdir() if p.suffix in (".db3", ".mcap"))


def mutated(whole: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """One way to damage a file."""
    way = ["cut", "flip", "insert", "zero", "remove", "twice"][int(rng.integers(6))]
    data = bytearray(whole)
    at = int(rng.integers(8, len(data)))
    length = int(rng.integers(1, 4096))
    if way == "cut":
        del data[at:]
    elif way == "flip":
        for place in rng.integers(8, len(data), int(rng.integers(1, 8))):
            data[place] ^= 1 << int(rng.integers(8))
    elif way == "insert":
        data[at:at] = rng.bytes(length)
    elif way == "zero":
        data[at : at + length] = bytes(len(data[at : at + length]))
    elif way == "remove":
        del data[at : at + length]
    else:
        data[at:at] = data[at : at + length]
    return way, bytes(data)


def remarks_of(logs: list[LogTable]) -> set[str]:
    """What is told of logs: all but notes, and a file that ends within a line."""
    return {
        str(remark)
        for log in logs
        for remark in log.remarks
        if remark.severity != "note" or remark.kind == "gap" or "no end of line" in remark.message
    }


def outcome(path: Path, map_path: Path | None, rows: int, before: set[str]) -> str:
    """What becomes of a damaged file."""
    try:
        logs = [read_log(path)] if map_path is None else import_source(path, load_map(map_path))
    except InputError as error:
        return "refused" if str(error) else "refused without a word"
    if remarks_of(logs) - before:
        return "told"
    lost = rows - sum(log.rows for log in logs)
    return "as before" if lost <= max(1, 0.005 * rows) else "SHORT"


def message_ends(ulog: bytes) -> set[int]:
    """Where the messages of a ULog end."""
    at, ends = 16, {16}
    while at + 3 <= len(ulog):
        at += 3 + int.from_bytes(ulog[at : at + 2], "little")
        ends.add(at)
    return ends


def trials(kind: str, folder: Path, count: int, seed: int) -> Iterator[tuple[str, str]]:
    path = make(kind, folder)
    map_path = None
    if kind not in ("csv", "parquet"):
        map_path = folder / "map.yaml"
        map_path.write_text(suggest_map([path]).text)
        logs = import_source(path, load_map(map_path))
    else:
        logs = [read_log(path)]
    rows, before = sum(log.rows for log in logs), remarks_of(logs)
    whole = path.read_bytes()
    starts = re.finditer(rb"\xa3\x95[\x80\xc8-\xcd]", whole)
    boundaries = {found.start() for found in starts} if kind == "ardupilot" else message_ends(whole)
    rng = np.random.default_rng(seed)
    for _ in range(count):
        way, data = mutated(whole, rng)
        if kind in ("csv", "jsonl") and data in whole and data.endswith(b"\n"):
            continue  # whole lines are gone at the end: nothing in such a file can tell
        if kind in ("ulog", "ardupilot") and len(data) in boundaries and data == whole[: len(data)]:
            continue  # cut between two messages: neither
        path.write_bytes(data)
        yield way, outcome(path, map_path, rows, before)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.long) if kind in ("ros1", "sqlite3") else kind for kind in KINDS]
)
def test_damaged_files(tmp_path: Path, kind: str) -> None:
    found = collections.Counter(trials(kind, tmp_path / "here", 16, 1))
    print(kind, dict(found))
    assert not [key for key in found if key[1] == "SHORT"], found
    assert sum(count for (_, what), count in found.items() if what in ("refused", "told")) > 3


@pytest.mark.study
def test_two_thousand_mutations(tmp_path: Path) -> None:
    table: dict[str, collections.Counter[str]] = {}
    for kind in KINDS:
        for _, what in trials(kind, tmp_path / kind, 250, 2):
            table.setdefault(kind, collections.Counter())[what] += 1
        print(f"{kind:10}", dict(table[kind]))
    assert sum(counter["SHORT"] for counter in table.values()) == 0
