"""Text with a message a line: JSON lines, as loggers and message brokers write them, VDA 5050 ``state`` messages among
them; dicts that Python prints."""

from __future__ import annotations

import ast
import contextlib
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import first_line
from missionsim.labels import Labels
from missionsim.logs.formats.arrays import MOST_ELEMENTS
from missionsim.logs.raw import ColumnData, Remark, damaged, numbers_in
from missionsim.logs.readers import Options, Reader, Recording, Topic
from missionsim.logs.times import TimeError, is_stamp, read_stamps

_TIMES = ("timestamp", "time", "stamp", "ts", "t", "time_s", "datetime", "date", "@timestamp")
_INSIDE = ("payload", "data", "msg", "message")
"""Where a broker's log keeps the message itself, beside its topic and time."""
_BEFORE = re.compile(r"(?:([^\s{\[\",;]+)\s+)?([^\s{\[\",;]+\s+)(?=\{\")")
"""What a client of a broker prints before a message: perhaps a time, and the topic."""
_PLAIN = re.compile(r"(\S+)[ \t]+((?!N/A)[\w.-]+(?:/[\w.-]+)+)[ \t]+([^\s{\[][^\n]*)")
"""A time, a topic and a value that is no object, as such a client prints them."""
_KIND = re.compile(r"(\w+\.)?(mavpackettype|(msg|message|packet)_?(type|name)?|type)", re.IGNORECASE)
"""What a field is called that says what a message is."""
_MOST_KINDS = 100
_EPOCH = re.compile(r"\d{9,19}(\.\d+)?\Z")
_MOST_FAULTS = 20
_LEAST_ROWS = 20
"""Values from which on a list in a lone object is a column, where none is called a time."""
_WHOLE_AND_FINE = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"))


def read_json(path: Path, options: Options) -> Recording:
    """Fields of JSON messages as ``topic.key.inner[0]``, each topic at its own times.

    The topic is what the message says (``topic``), ``state`` for VDA 5050, else ``json``; where several vehicles write
    into one file, ``state[serial number]``. Lists of objects give their length as ``.count``. Raises InputError: no
    JSON, or messages without a time.
    """
    held: dict[tuple[str, str], list[dict[str, Any]]] = {}
    remarks: list[Remark] = []
    faults: list[Fault] = []
    lines = 0
    for record in _records(path, faults):
        lines += 1
        named, vehicle = record.get("topic"), "serialNumber" in record
        topic = named if isinstance(named, str) else ""
        inner = next((record[key] for key in _INSIDE if isinstance(record.get(key), dict)), None)
        if inner is not None and topic:
            stamps = (key for key in record if key.lower() in _TIMES and not isinstance(record[key], (dict, list)))
            record = {**{key: record[key] for key in stamps}, **inner}
            vehicle = "serialNumber" in record
        if not topic and vehicle and "headerId" in record:
            topic = "state"
        topic = (topic.strip("/").rpartition("/")[2] if vehicle else topic.strip("/")) or "json"
        held.setdefault((topic, str(record.get("serialNumber", ""))), []).append(dict(flat(record, "")))
        if options.most is not None and lines >= 4 * options.most:
            break
    if not held:
        raise InputError(faults or [Fault(str(path), 1, 1, "no JSON message in it", allowed="one JSON object a line")])
    if faults:
        message = f"{len(faults)} of {lines + len(faults)} lines are no JSON, first line {faults[0].line}"
        remarks.append(damaged(message, len(faults), faults[0].line))
    several = {topic for topic, _ in held if sum(topic == other for other, _ in held) > 1}
    topics = []
    for (topic, serial), messages in held.items():
        name = f"{topic}[{serial}]" if topic in several else topic
        kinds = _kinds(messages) if topic == "json" else {}
        if not kinds:
            topics.append(_topic(name, messages, path, options, remarks))
        for kind, some in kinds.items():
            try:
                topics.append(_topic(kind, some, path, options, remarks))
            except InputError as error:
                told = error.faults[0].message
                remarks.append(Remark("missing", "", told, "they were left out", "warning", 0, len(some)))
    return Recording(topics, remarks)


def _kinds(messages: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The messages of each kind, where a field of all names it and two kinds share less than half of their fields, so
    that what has one name in both may be another thing; else empty."""
    for key in filter(_KIND.fullmatch, messages[0]):
        kinds: dict[str, list[dict[str, Any]]] = {}
        for message in messages:
            kinds.setdefault(str(message.get(key, "")), []).append(message)
        fields = [{name for message in some for name in message} - {key} for some in kinds.values()]
        fields = [{name for name in one if name.rpartition(".")[2].lower() not in _TIMES} for one in fields]
        apart = any(2 * len(one & other) < len(one | other) for one, other in itertools.combinations(fields, 2))
        if (
            len(kinds) <= _MOST_KINDS
            and all(kinds)
            and all(isinstance(one.get(key), str) for one in messages)
            and apart
        ):
            return kinds
    return {}


def _records(path: Path, faults: list[Fault]) -> Iterator[dict[str, Any]]:
    """Objects of a file: one a line, or what one value holds: a list of them, alone or in an object, or columns."""
    with open(path, encoding="utf-8-sig", errors="replace") as handle:
        opening = handle.readline().strip()
        if opening[:1] == "[" or opening == "{" or (opening[:1] == "{" and not any(line[0] == "{" for line in handle)):
            handle.seek(0)
            try:
                found = json.load(handle)
            except (ValueError, RecursionError) as error:
                line = getattr(error, "lineno", 1)
                faults.append(Fault(str(path), line, getattr(error, "colno", 1), f"this is no JSON: {error}"[:120]))
                return
            yield from _rows_in(found)
            return
        handle.seek(0)
        for number, line in enumerate(handle, start=1):
            if not line.strip():
                continue
            before, plain = _BEFORE.match(line), _PLAIN.match(line)
            if plain and not before and (is_stamp(plain[1]) or _EPOCH.match(plain[1])):
                yield {"topic": plain[2], "time": plain[1], plain[2].rpartition("/")[2]: plain[3].strip()}
                continue
            try:
                record = _parsed(line[before.end(2) :] if before else line)
                if not isinstance(record, dict):
                    raise ValueError("not an object")
            except (ValueError, RecursionError) as error:
                if len(faults) < _MOST_FAULTS or number % 1000 == 0:
                    faults.append(Fault(str(path), number, 1, f"this line is no JSON: {error}"[:120], got=line[:60]))
                continue
            if before:
                stamp = before[1] or ""
                timed = {"time": stamp} if is_stamp(stamp) or _EPOCH.match(stamp) else {}
                record = {"topic": before[2].strip(), **timed, **record}
            yield record


def _parsed(line: str) -> Any:
    """The value of a line: JSON, or what Python prints of a dict (also with NumPy's numbers and ``nan``)."""
    if not line.startswith("{'"):
        return json.loads(line)
    plain = re.sub(r"\bnan\b", "None", re.sub(r"\bnp\.\w+\(([^()]*)\)", r"\1", line))
    try:
        return ast.literal_eval(plain)
    except (SyntaxError, MemoryError):
        raise ValueError("nor a dict that Python printed") from None


def _rows_in(found: Any) -> Iterator[dict[str, Any]]:
    """Rows of one JSON value: a list of objects, an object with such a list, or columns of one length (lists, or
    objects of numbered cells, as pandas writes them); else the object itself."""
    if isinstance(found, list):
        yield from (record for record in found if isinstance(record, dict))
        return
    if not isinstance(found, dict):
        return
    lists = [one for one in found.values() if isinstance(one, list) and len(one) > 1]
    if isinstance(found.get("data"), dict) and found["data"].get("resultType") == "matrix":
        with contextlib.suppress(AttributeError, TypeError, ValueError):  # of another shape: no rows
            yield from list(_series(found["data"].get("result", [])))
        return
    columns = {
        name: list(one.values()) if isinstance(one, dict) else one
        for name, one in found.items()
        if isinstance(one, list) or (isinstance(one, dict) and all(map(str.isdigit, one)))
    }
    # as long as the times, where there are such
    length = max((len(one) for name, one in columns.items() if name.lower() in _TIMES and len(one) > 1), default=0)
    length = length or max((len(one) for one in columns.values() if len(one) >= _LEAST_ROWS), default=0)
    inner = [one for one in found.values() if isinstance(one, dict) and any(isinstance(x, list) for x in one.values())]
    objects = max((one for one in lists if all(isinstance(item, dict) for item in one)), key=len, default=[])
    if len(objects) > length:
        yield from objects
    elif length:
        names = [name for name, one in columns.items() if len(one) == length]
        yield from (dict(zip(names, row, strict=True)) for row in zip(*(columns[name] for name in names), strict=True))
    elif len(inner) == 1 and not any(name.lower() in _TIMES for name in found):
        yield from _rows_in(inner[0])
    else:
        yield found


def _series(result: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Rows of the series that Prometheus gives for a range: a topic each, with those labels that tell them apart."""
    labels = [one.get("metric", {}) for one in result]
    names = dict.fromkeys(itertools.chain.from_iterable(labels))
    differ = [key for key in names if len({one.get(key) for one in labels}) > 1 and key != "__name__"]
    for one, own in zip(result, labels, strict=True):
        name = own.get("__name__", "value")
        topic = ".".join([name, *(str(own[key]) for key in differ if key in own)])
        yield from ({"topic": topic, "time": time, name: value} for time, value in one.get("values", []))


def flat(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Leaves of a JSON value by their paths: ``key.inner[0]``."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from flat(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        if not value or any(isinstance(item, dict) for item in value):
            yield f"{path}.count", float(len(value))
        for index, item in enumerate(value[:MOST_ELEMENTS]):
            yield from flat(item, f"{path}[{index}]")
    elif isinstance(value, bool):
        yield path, float(value)
    elif isinstance(value, (int, float, str)) and path:
        yield path, value


def _topic(name: str, messages: list[dict[str, Any]], path: Path, options: Options, remarks: list[Remark]) -> Topic:
    names = {one.lower(): one for one in reversed(messages[0])}
    key = next((names[one] for one in _TIMES if one in names), None) or _inner_time(messages, list(names.values()))
    if key is None:
        allowed = ", ".join(_TIMES)
        raise InputError(Fault(str(path), 1, 1, f"the messages of {name} have no time", allowed=f"one of {allowed}"))
    numbers = [number for message in messages if isinstance(number := message.get("headerId"), (int, float))]
    if len(numbers) == len(messages):
        lost = sum(int(now - before) - 1 for before, now in itertools.pairwise(numbers) if 1 < now - before < 1_000_000)
        if lost:
            message = f"{lost} messages of {name} are missing: their numbers (headerId) jump"
            remarks.append(damaged(message, lost))
    columns = columns_of(messages, None if options.fields is None else {f"{name}.{key}", *options.fields}, name)
    try:
        stamps = read_stamps([columns.pop(key)], f"{name}.{key}")
    except TimeError as error:
        raise InputError(Fault(str(path), 1, 1, str(error), f"{name}.{key}")) from None
    remarks += stamps.remarks
    known = np.isfinite(stamps.seconds)
    title = "VDA 5050 state" if "serialNumber" in messages[0] and "headerId" in messages[0] else ""
    return Topic(name, stamps.seconds[known], {f: data[known] for f, data in columns.items()}, title, len(messages))


def _inner_time(messages: list[dict[str, Any]], names: Sequence[str]) -> str | None:
    """The time that lies deepest in no other: ``header.stamp``, whose seconds and nanoseconds are joined."""
    for name in sorted(names, key=lambda name: name.count(".")):
        above, _, last = name.rpartition(".")
        if last.lower() in _TIMES:
            return name
        fine = next((f"{above}.{fine}" for whole, fine in _WHOLE_AND_FINE if last == whole), "")
        if fine in names and above.rpartition(".")[2].lower() in _TIMES:
            for message in messages:
                with suppress(TypeError, ValueError):  # of a message without a stamp
                    message[above] = float(message.pop(name, None)) + 1e-9 * float(message.pop(fine, None))
            return above if any(above in message for message in messages) else None
    return None


def columns_of(
    messages: Sequence[Mapping[str, object]], wanted: Collection[str] | None = None, topic: str = ""
) -> dict[str, ColumnData]:
    """Each field of the messages of a topic as a column: numbers, NaN where missing, or texts. `wanted`: fields, as
    ``topic.field``; all by default."""
    columns: dict[str, ColumnData] = {}
    for field in dict.fromkeys(itertools.chain.from_iterable(messages)):
        if wanted is not None and f"{topic}.{field}" not in wanted:
            continue
        values = [message.get(field) for message in messages]
        if any(isinstance(value, str) for value in values):
            texts = (f"{value:g}" if isinstance(value, (int, float)) else value for value in values)
            columns[field] = numbers_in(Labels.of(texts), field)
        else:
            columns[field] = np.array([np.nan if value is None else _finite(value) for value in values])
    return columns


def _finite(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def read_json_mcap(path: Path, options: Options) -> Recording | None:
    """Fields of JSON messages as ``/topic.key.inner[0]``, at the times of the log; None where messages are no JSON.
    Raises InputError: a damaged file."""
    try:
        from mcap.reader import make_reader
    except ImportError:
        return None
    wanted = None if options.fields is None else {field.strip().partition(".")[0] for field in options.fields}
    held: dict[str, tuple[str, list[int], list[dict[str, Any]]]] = {}
    counts = Counter[str]()
    try:
        with open(path, "rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                if channel.message_encoding != "json":
                    return None
                topic = channel.topic
                counts[topic] += 1
                if (wanted is not None and topic not in wanted) or counts[topic] > (options.most or math.inf):
                    continue
                _, times, messages = held.setdefault(topic, (schema.name if schema else "", [], []))
                messages.append(dict(flat(json.loads(message.data), "")))
                times.append(message.log_time)
    except Exception as error:  # a damaged file raises whatever its parser meets
        if not counts:
            return None
        told, got = "the MCAP file cannot be read", first_line(error)
        raise InputError.single(told, file=str(path), got=got, allowed="a whole file") from None
    start = min((min(times) for _, times, _ in held.values()), default=0)
    topics = [
        Topic(name, (np.array(times) - start) * 1e-9, columns_of(messages, options.fields, name), title, counts[name])
        for name, (title, times, messages) in held.items()
    ]
    return Recording(topics, [], start * 1e-9) if counts else None


_LIST_BEGIN = re.compile(rb"\[(?!\d[^\n\][{\"]*\] )")  # what is no time in brackets, `[12:00:01] U: 25.1 V`
_PRINTED_BEGIN = re.compile(rb"(?:[^\n{]{0,200}\n){0,9}\{[\"']\w+[\"']: ")
_BROKER_BEGIN = re.compile(rf"{_BEFORE.pattern}|(?=\d{{4}}-|\d{{9,19}}[ .]){_PLAIN.pattern}\n".encode())


_OBJECT = (b"{", b"\xef\xbb\xbf{")
READERS = (
    Reader("jsonlines", "JSON lines file", (".jsonl", ".ndjson"), _OBJECT, recording=read_json, like=_LIST_BEGIN),
    Reader("printed", "file of printed dicts", (), recording=read_json, like=_PRINTED_BEGIN),
    Reader("broker", "file of a broker's messages", (), recording=read_json, like=_BROKER_BEGIN),
)
