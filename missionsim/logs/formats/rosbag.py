"""ROS 1, ROS 2 and MCAP bags through rosbags: any numeric or text field of any topic, diagnostics by name and key."""

from __future__ import annotations

import contextlib
import re
import sqlite3
from collections.abc import Callable, Collection, Iterator
from functools import cache, reduce
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import InputError
from missionsim.files import first_line, needed, unreadable
from missionsim.logs.formats.arrays import MOST_ELEMENTS
from missionsim.logs.formats.bag_times import CLOCK_FIELDS, CLOCK_TYPE, common_times
from missionsim.logs.formats.jsonlines import read_json_mcap
from missionsim.logs.formats.packed import Batch, Held
from missionsim.logs.formats.salvage import whole_files
from missionsim.logs.raw import Remark, damaged
from missionsim.logs.readers import Options, Reader, Recording, Topic
from missionsim.physics import Int64s

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[^\]]+\])*)\Z")
_STATUS = re.compile(r"(/[^.\[]+)\[(.+?)\]\.(.+)\Z", re.DOTALL)
_Get = Callable[[Any], Any]


@contextlib.contextmanager
def _open(paths: list[Path], file: str) -> Iterator[AnyReader]:
    """A rosbags reader of a ROS 1 bag, a ROS 2 bag (its folder), or lone files of one. Raises InputError: rosbags is
    not installed, or it cannot read the bag."""
    bags, types = needed("rosbags.highlevel", "reading bags", file), needed("rosbags.typesys", "reading bags", file)
    # bags of older ROS 2 carry no message definitions; the common types have not changed since
    common, allowed = types.get_typestore(types.Stores.ROS2_HUMBLE), "a whole ROS 1, ROS 2 or MCAP bag"
    with unreadable("the bag cannot be read", file, allowed), bags.AnyReader(paths, default_typestore=common) as reader:
        yield reader


def read_bag(path: Path, options: Options) -> Recording:
    """Fields of a bag, each topic at its own times from the start of the bag.

    `options`: `fields` as ``/topic.field.sub[0]``, a joint by its name (``/joint_states.effort[left]``), a diagnostic
    value as ``/diagnostics[status name].key``, the state of a lifecycle node as ``/node/transition_event.state``;
    `most` messages of each topic; `clock`. Raises InputError: an unreadable bag.
    """
    remarks: list[Remark] = []
    inside = path.is_file() and path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").exists()
    _refuse_data_base(path)
    needed("rosbags.highlevel", "reading bags", str(path))
    with whole_files(path.parent if inside else path, remarks) as files:
        lone = path if not remarks else files[0]
        found = read_json_mcap(lone, options) if len(files) == 1 and lone.suffix == ".mcap" else None
        if found is not None:
            found.remarks[:0] = remarks
        return found or _read(files, str(path), options, remarks)


def _refuse_data_base(path: Path) -> None:
    """Raises InputError: an SQLite file that is no bag."""
    if not path.is_file() or path.open("rb").read(15) != b"SQLite format 3":
        return
    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as base,
    ):
        tables = [name for (name,) in base.execute("select name from sqlite_master where type = 'table'")]
        if tables and "topics" not in tables:
            told = f"an SQLite data base that is no bag, with the tables {', '.join(tables)[:200]}"
            allowed = f"a table as CSV: sqlite3 -header -csv {path.name} 'select * from {tables[0]}' > {path.stem}.csv"
            raise InputError.single(told, file=str(path), allowed=allowed)


def _read(files: list[Path], file: str, options: Options, remarks: list[Remark]) -> Recording:
    held: dict[str, Held] = {}
    broken: list[str] = []
    with _open(files, file) as reader:
        wanted = None if options.fields is None else _wanted(options.fields)
        asked = None if wanted is None else set(wanted)
        # simulated time puts messages without a header beside those with one
        clock = next((topic for topic, info in reader.topics.items() if info.msgtype == CLOCK_TYPE), "")
        if clock and wanted is not None and options.clock == "header":
            wanted[clock] = wanted.get(clock, {}) | {name: _getter(name) for name in CLOCK_FIELDS}
        infos = {topic: info for topic, info in reader.topics.items() if wanted is None or topic in wanted}
        # a topic without fields stands for one of a type that the bag does not define
        blank = [
            Topic(topic, np.empty(0), {}, info.msgtype, info.msgcount)
            for topic, info in infos.items()
            if info.msgtype is not None and info.msgtype not in reader.typestore.fielddefs
        ]
        infos = {topic: info for topic, info in infos.items() if topic not in {one.name for one in blank}}
        connections = [c for c in reader.connections if c.topic in infos]
        seen = dict.fromkeys(infos, 0)
        types = reader.typestore.fielddefs
        batches = {  # topics of one type, of which fields are wanted that have a path
            topic: Batch(types, info.msgtype, wanted[topic], reader.is2, Held(info.msgtype, info.msgcount))
            for topic, info in infos.items()
            if wanted is not None and info.msgtype is not None and None not in wanted[topic].values()
        }
        messages = reader.messages(connections=connections) if connections else iter(())
        while True:
            try:
                connection, received, data = next(messages)
                topic = connection.topic
                seen[topic] += 1
                if topic in batches and batches[topic].takes(data, received):
                    continue
                batches.pop(topic, None)
                if options.most is not None and seen[topic] > options.most:
                    if all(count > options.most or count >= infos[name].msgcount for name, count in seen.items()):
                        break
                    continue
                message: Any = reader.deserialize(data, connection.msgtype)
            except StopIteration:
                break
            except Exception as error:  # a damaged bag raises whatever its parsers meet
                broken.append(first_line(error, 120))
                continue  # a reader that failed itself is at its end; the next message may be whole
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            set_ns = 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
            for name, values in _values(topic, message, None if wanted is None else wanted[topic]):
                if name not in held:
                    held[name] = Held(infos[topic].msgtype or "", infos[topic].msgcount)
                    if hasattr(message, "goal_state"):  # what was before the first event is known as well
                        held[name].add(reader.start_time, reader.start_time, [("state", message.start_state.label)])
                held[name].add(set_ns or received, received, values)
        for topic, batch in batches.items():
            batch.flush()
            if len(batch.held.stamps):
                held[topic] = batch.held
            broken += [f"{batch.held.title} is not what its type says"] * batch.broken
        expected = {topic: info.msgcount for topic, info in infos.items()}
        found = reader.message_count
    if options.most is None:
        lost = {topic: count - seen[topic] for topic, count in expected.items() if count > seen[topic]}
        parts = [f"{count} of {expected[topic]} messages of {topic}" for topic, count in lost.items()]
        parts += [f"{len(broken)} messages cannot be read ({broken[0]})"] if broken else []
        if parts:
            told = f"part of the bag is missing: {', '.join(parts)}"
            remarks.append(damaged(told, sum(lost.values()) + len(broken)))
        if not remarks and files[0].suffix == ".mcap" and not _index_fits(files[0], found):
            message = "the index at its end does not fit the file: bytes are missing or were put in"
            remarks.append(damaged(message))
    simulated = _simulated_time(held[clock]) if clock in held else None
    held = {name: topic for name, topic in held.items() if asked is None or name != clock or clock in asked}
    stamps = {name: (topic.stamps, topic.received) for name, topic in held.items()}
    times, start_s = common_times(stamps, options.clock, simulated and (clock, *simulated), remarks)
    topics = [Topic(name, times[name], topic.columns(), topic.title, topic.count) for name, topic in held.items()]
    return Recording([*topics, *blank], remarks, start_s)


def _simulated_time(held: Held) -> tuple[Int64s, Int64s] | None:
    """When the messages of a clock were received, and the times in them [ns]."""
    columns = held.columns()
    if not set(CLOCK_FIELDS) <= columns.keys():
        return None
    whole, rest = (np.asarray(columns[name]).astype(np.int64) for name in CLOCK_FIELDS)
    return np.array(held.received, dtype=np.int64), whole * 10**9 + rest


def _wanted(fields: Collection[str]) -> dict[str, dict[str, _Get | None]]:
    """Topic → field → how to get it (None: a diagnostic value)."""
    wanted: dict[str, dict[str, _Get | None]] = {}
    for text in fields:
        if match := _STATUS.match(text.strip()):
            wanted.setdefault(match[1], {})[text.strip()] = None
            continue
        topic, _, rest = text.strip().partition(".")
        get = _getter(rest)
        if get is not None:
            wanted.setdefault(topic if topic.startswith("/") else f"/{topic}", {})[rest] = get
    return wanted


def _getter(rest: str) -> _Get | None:
    steps: list[_Get] = []
    names: list[str] = []
    for part in rest.split("."):
        match = _STEP.match(part)
        if match is None or part.startswith("__"):
            return None
        indices = re.findall(r"\[([^\]]+)\]", match[2])
        names += [index for index in indices if not index.isdigit()]
        steps += [attrgetter(match[1]), *(itemgetter(int(index)) for index in indices if index.isdigit())]
    if names:  # an element by the name that stands at its place in the message's ``name``
        return lambda message: steps[0](message)[list(message.name).index(names[0])]
    return lambda message: reduce(lambda value, step: step(value), steps, message)


def _values(topic: str, message: Any, wanted: dict[str, _Get | None] | None) -> list[tuple[str, list[tuple[str, Any]]]]:
    """(topic, [(field, value)]) of a message; each status of a diagnostic message is a topic of its own."""
    statuses = getattr(message, "status", None)
    if isinstance(statuses, list) and statuses and hasattr(statuses[0], "values"):
        told = []
        for status in statuses:
            name, level = f"{topic}[{status.name}]", status.level
            if wanted is None or any(field.startswith(f"{name}.") for field in wanted):
                number = float(level[0] if isinstance(level, (bytes, bytearray)) else level)
                told.append((name, [("level", number), *((one.key, one.value) for one in status.values if one.key)]))
        return told
    state = [("state", message.goal_state.label)] if hasattr(message, "goal_state") else []
    if wanted is None:
        return [(topic, [*state, *_leaves(message)])]
    found: list[tuple[str, Any]] = state
    for name, get in wanted.items():
        try:
            value = get(message) if get is not None else None
        except (AttributeError, IndexError, TypeError, ValueError):
            continue
        if isinstance(value, (str, bool, int, float, np.number, np.bool_)):
            found.append((name, value))
    return [(topic, found)]


_STATISTICS = 11
"""Type of the record that begins with the number of messages."""


def _index_fits(path: Path, messages: int) -> bool:
    """Whether the summary of an MCAP file stands where its footer says, counts the messages that a reader finds, and
    its records follow to the footer; without a summary, whether all records from the beginning do."""
    tail = 8 + 29  # magic, and the footer: type, length, start of summary, of its offsets, checksum
    size = path.stat().st_size
    with open(path, "rb") as handle:
        handle.seek(size - tail)
        footer = handle.read(tail)
        if footer[0] != 2:
            return False
        at = int.from_bytes(footer[9:17], "little") or len(b"\x89MCAP0\r\n")
        while at < size - tail:
            handle.seek(at)
            head = handle.read(9)
            if len(head) < 9 or not 1 <= head[0] <= 15:
                return False
            if head[0] == _STATISTICS and int.from_bytes(handle.read(8), "little") != messages:
                return False
            at += 9 + int.from_bytes(head[1:], "little")
    return at == size - tail


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values of the numeric and text fields inside a message, or inside a field of one."""
    if isinstance(value, (str, bool, int, float, np.number, np.bool_)):
        yield path, value
    elif isinstance(value, np.ndarray):
        yield from ((f"{path}[{index}]", number) for index, number in enumerate(value[:MOST_ELEMENTS].tolist()))
    elif isinstance(value, list):
        for index, item in enumerate(value[:MOST_ELEMENTS]):
            yield from _leaves(item, f"{path}[{index}]")
    elif hasattr(value, "__dataclass_fields__"):
        kind: Any = type(value)
        joints: Any = getattr(value, "name", None) if not path else None
        for name in _names(kind):
            inner = getattr(value, name)
            of_joints = name in ("position", "velocity", "effort") and isinstance(joints, list)
            if of_joints and len(joints) == len(inner):
                yield from ((f"{name}[{joint}]", float(item)) for joint, item in zip(joints, inner, strict=True))
            else:
                yield from _leaves(inner, f"{path}.{name}" if path else name)


@cache
def _names(kind: type) -> list[str]:
    """Fields of a message type, among which its constants stand."""
    return [name for name in getattr(kind, "__dataclass_fields__", ()) if not (name.startswith("__") or name.isupper())]


READERS = (
    Reader("rosbag1", "ROS 1 bag", (".bag", ".active"), (b"#ROSBAG",), recording=read_bag),
    Reader("rosbag2", "ROS 2 bag", (".db3",), (b"SQLite format 3",), recording=read_bag, folder="metadata.yaml"),
    Reader("mcap", "MCAP file", (".mcap",), (b"\x89MCAP",), recording=read_bag, folder="metadata.yaml"),
)
