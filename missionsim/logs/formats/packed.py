"""Values of ROS messages, kept as they come; numbers are taken out of the bytes of many messages at once.

Where a number stands in a message depends on its type and on the lengths of the texts and lists before it. Messages of
the same lengths are an array of records, of which numpy takes columns: ten times as fast as an object for each.
"""

from __future__ import annotations

import array
import functools
import re
from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, numbers_in
from missionsim.physics import Array, Int64s

Types = Mapping[str, tuple[Any, Any]]
"""Type of a message → its constants and fields, as rosbags has them."""
Place = tuple[int, np.dtype[Any]]
"""Offset in a message [bytes], and kind of number."""

_SIZES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_BASE, _MESSAGE, _ARRAY = 1, 2, 3
"""Kinds of field as rosbags numbers them; 4 is a list of any length."""
_ELEMENT = re.compile(r"(.+)\[([^\[\]]+)\]\Z")
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")


_BATCH_BYTES = 2_000_000
"""Messages that are held before their numbers are taken."""


class Unfit(ValueError):
    """A message that is not what its type says, or a type that is left to rosbags."""


class Layout:
    """Where the numbers of one message stand.

    `types`: type → (constants, fields), as rosbags has them. `kind`: type of the message. `cdr`: ROS 2's encapsulation
    with alignment; else ROS 1's. The attribute `same`: bytes that another message of the same size has to share, to
    have this layout.
    """

    def __init__(self, types: Types, kind: str, cdr: bool, data: bytes) -> None:
        if cdr and data[:2] not in (b"\0\0", b"\0\1"):
            raise Unfit
        self._types, self._data, self._cdr = types, data, cdr
        self._order = ">" if cdr and data[:2] == b"\0\0" else "<"
        self._at = 4 if cdr else 0
        self._found: dict[str, tuple[int, np.dtype[Any], int]] = {}
        self._names: list[str] = []
        self.same = [(0, self._at)] if cdr else []
        try:
            self._message(kind, "")
        except KeyError:  # a type that the bag does not define
            raise Unfit from None
        if not 0 <= len(data) - self._at <= (3 if cdr else 0):
            raise Unfit

    def find(self, field: str) -> Place | None:
        """Offset and type of a number: ``a.b``, ``a.b[3]`` or ``velocity[joint]``; None where there is none."""
        match = _ELEMENT.match(field)
        offset, number, count = self._found.get(f"{match[1]}[]" if match else field, (0, np.dtype("u1"), 0))
        index = 0
        if match:
            index = int(match[2]) if match[2].isdigit() else [*self._names, match[2]].index(match[2])
        return (offset + index * number.itemsize, number) if index < count else None

    def _message(self, kind: str, path: str) -> None:
        for name, description in self._types[kind][1]:
            self._field(description, f"{path}{name}")

    def _field(self, description: tuple[Any, Any], path: str) -> None:
        node, inner = description
        if node == _BASE and inner[0] == "string":
            length = self._length()
            begin, self._at = self._at, self._at + length
            if self._at > len(self._data):
                raise Unfit
            if path.startswith("name["):  # joints may change places
                self.same.append((begin, self._at))
                self._names.append(self._data[begin : self._at].rstrip(b"\0").decode(errors="replace"))
        elif node == _BASE:
            self._numbers(inner[0], 1, path)
        elif node == _MESSAGE:
            self._message(inner, f"{path}.")
        else:
            element, count = inner
            count = count if node == _ARRAY else self._length()
            if element[0] == _BASE and element[1][0] != "string":
                self._numbers(element[1][0], count, f"{path}[]")
            elif node == _ARRAY or element[0] == _BASE:
                for index in range(count):
                    self._field(element, f"{path}[{index}]")
            else:
                raise Unfit  # messages in a list: hardly two are alike

    def _numbers(self, kind: str, count: int, path: str) -> None:
        if kind not in _SIZES:
            raise Unfit
        number = np.dtype(self._order + _SIZES[kind])
        if count:
            self._align(number.itemsize)
        self._found[path] = (self._at, number, count)
        self._at += count * number.itemsize
        if self._at > len(self._data):
            raise Unfit

    def _length(self) -> int:
        self._align(4)
        self._at += 4
        self.same.append((self._at - 4, self._at))
        return int.from_bytes(self._data[self._at - 4 : self._at], "big" if self._order == ">" else "little")

    def _align(self, size: int) -> None:
        if self._cdr:
            self._at += -(self._at - 4) % size


def _take(block: NDArray[np.uint8], offset: int, number: np.dtype[Any]) -> NDArray[Any]:
    """A column of the records in a block."""
    return np.ascontiguousarray(block[:, offset : offset + number.itemsize]).view(number)[:, 0]


class Held:
    """What was read of one topic."""

    def __init__(self, title: str, count: int) -> None:
        self.title, self.count = title, count
        self.stamps, self.received = array.array("q"), array.array("q")
        self.values: dict[str, list[Any] | array.array[float]] = {}

    def add(self, stamp: int, received: int, values: list[tuple[str, float | str]]) -> None:
        before = len(self.stamps)
        self.stamps.append(stamp)
        self.received.append(received)
        for name, value in values:
            column = self.values.get(name)
            if column is None:
                text = isinstance(value, str)
                column = [""] * before if text else array.array("d", [np.nan] * before)
                self.values[name] = column
            column.append(value)  # type: ignore[arg-type]
        for column in self.values.values():
            if len(column) <= before:  # an element that this message does not have
                column.append("" if isinstance(column, list) else np.nan)  # type: ignore[arg-type]

    def add_many(self, stamps: Int64s, received: Int64s, columns: dict[str, Array]) -> None:
        self.stamps.frombytes(stamps.tobytes())
        self.received.frombytes(received.tobytes())
        for name, values in columns.items():
            self.values.setdefault(name, array.array("d")).frombytes(values.tobytes())  # type: ignore[union-attr]

    def columns(self) -> dict[str, ColumnData]:
        given = self.values.items()
        return {n: numbers_in(Labels.of(c), n) if isinstance(c, list) else np.array(c, float) for n, c in given}


class Batch:
    """The messages of a topic of which only numbers are wanted.

    `types`, `kind`, `cdr`: see `Layout`; `held`: where the numbers go to.
    """

    def __init__(self, types: Types, kind: str, fields: Collection[str], cdr: bool, held: Held) -> None:
        self.held, self.broken = held, 0
        self._layout = functools.partial(Layout, types, kind, cdr)
        self._fields = tuple(fields)
        self._first = True
        self._data: list[bytes] = []
        self._received: list[int] = []
        self._bytes = 0

    def takes(self, data: bytes, received: int) -> bool:
        """Keep a message; False where the first one shows that its topic has to be read one by one."""
        if self._first:
            try:
                layout = self._layout(data)
            except Unfit:
                return False
            if any(layout.find(field) is None for field in self._fields):
                return False
            self._first = False
        self._data.append(data)
        self._received.append(received)
        self._bytes += len(data)
        if self._bytes > _BATCH_BYTES:
            self.flush()
        return True

    def flush(self) -> None:
        """Take the numbers of the messages that came since the last time."""
        count = len(self._data)
        stamps = np.zeros(count, dtype=np.int64)
        columns = {field: np.full(count, np.nan) for field in self._fields}
        whole = np.ones(count, dtype=np.bool_)
        sizes: dict[int, list[int]] = defaultdict(list)
        for index, data in enumerate(self._data):
            sizes[len(data)].append(index)
        for size, indices in sizes.items():
            rows = np.array(indices)
            block = np.frombuffer(b"".join([self._data[i] for i in indices]), dtype=np.uint8).reshape(len(rows), size)
            while len(rows):
                try:
                    layout = self._layout(block[0].tobytes())
                except Unfit:
                    whole[rows[0]] = False
                    rows, block = rows[1:], block[1:]
                    continue
                alike = np.ones(len(rows), dtype=np.bool_)
                for begin, end in layout.same:
                    alike &= (block[:, begin:end] == block[0, begin:end]).all(axis=1)
                chosen = block if alike.all() else block[alike]
                for field, column in columns.items():
                    if (place := layout.find(field)) is not None:
                        column[rows[alike]] = _take(chosen, *place)
                places = [place for part in _STAMP if (place := layout.find(part)) is not None]
                if len(places) == len(_STAMP):
                    seconds, rest = (_take(chosen, *place).astype(np.int64) for place in places)
                    stamps[rows[alike]] = seconds * 10**9 + rest
                rows, block = rows[~alike], block[~alike]
        received = np.array(self._received, dtype=np.int64)
        known = {name: values[whole] for name, values in columns.items()}
        self.held.add_many(np.where(stamps == 0, received, stamps)[whole], received[whole], known)
        self.broken += int((~whole).sum())
        self._data, self._received, self._bytes = [], [], 0
