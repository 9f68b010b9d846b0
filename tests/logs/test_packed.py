"""Numbers taken from the bytes of many messages are those of rosbags' own objects, for messages of many types."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra 'logs' is not installed")

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from missionsim.logs.formats.packed import Batch, Held
from missionsim.logs.formats.rosbag import _getter

PACKAGES = ("sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs", "diagnostic_msgs", "lifecycle_msgs", "stereo_msgs")


def drawn(store: Any, description: Any, rng: np.random.Generator, most: int) -> Any:
    """A value of any field: numbers, texts and lists of drawn lengths."""
    node, inner = description
    if node == Nodetype.NAME:
        return message(store, inner, rng, most)
    if node == Nodetype.BASE:
        if inner[0] == "string":
            return "ä" * int(rng.integers(2)) + "n" * int(rng.integers(most))
        if inner[0] == "bool":
            return bool(rng.integers(2))
        number = np.dtype(inner[0] if inner[0] not in ("byte", "char") else "uint8").type
        return number(rng.integers(0, 100)).item()
    element, count = inner
    count = count if node == Nodetype.ARRAY else int(rng.integers(most))
    values = [drawn(store, element, rng, most) for _ in range(count)]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.array(
            values, dtype={"bool": "bool_", "byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        )
    return values


def message(store: Any, kind: str, rng: np.random.Generator, most: int = 3) -> Any:
    return store.types[kind](**{name: drawn(store, desc, rng, most) for name, desc in store.fielddefs[kind][1]})


def leaves(value: Any, path: str = "") -> dict[str, float]:
    """Paths and values of the numbers of a message."""
    if isinstance(value, np.ndarray) or (isinstance(value, list) and not path.endswith("name")):
        found: dict[str, float] = {}
        for index, item in enumerate(value):
            found |= leaves(item, f"{path}[{index}]")
        return found
    if dataclasses.is_dataclass(value):
        found = {}
        for field in dataclasses.fields(value):
            if not field.name.startswith("__") and not field.name.isupper():
                found |= leaves(getattr(value, field.name), f"{path}.{field.name}" if path else field.name)
        return found
    return {path: float(value)} if isinstance(value, (bool, int, float, np.number, np.bool_)) else {}


@pytest.mark.parametrize("cdr", [True, False], ids=["ros2", "ros1"])
def test_numbers_of_every_type(cdr: bool) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE if cdr else Stores.ROS1_NOETIC)
    rng, read = np.random.default_rng(1), 0
    for kind in sorted(store.fielddefs):
        if not kind.startswith(PACKAGES):
            continue
        made = [message(store, kind, rng) for _ in range(12)]
        write = store.serialize_cdr if cdr else store.serialize_ros1
        data = [bytes(write(one, kind)) for one in made]
        fields = [name for name in leaves(made[0]) if _getter(name) is not None]
        batch = Batch(store.fielddefs, kind, fields, cdr, Held(kind, 12))
        if not fields or not batch.takes(data[0], 1):
            continue
        assert all(batch.takes(one, 1) for one in data[1:])
        batch.flush()
        read += 1
        assert batch.broken == 0
        columns = batch.held.columns()
        for name in fields:
            wanted = np.array([leaves(one).get(name, np.nan) for one in made])
            np.testing.assert_array_equal(columns[name], wanted, err_msg=f"{kind} {name}")
        if hasattr(made[0], "header"):
            stamps = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in made]
            assert list(batch.held.stamps) == stamps
    assert read > 60


def test_big_endian_joints_by_name_and_broken_messages() -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, types = "sensor_msgs/msg/JointState", store.types
    stamp = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="")
    data = []
    for index in range(6):
        names = ["left", "right"] if index % 2 else ["right", "left"]
        speeds = np.array([float(index) if name == "left" else -1.0 for name in names])
        joints = types[kind](header=stamp, name=names, position=np.empty(0), velocity=speeds, effort=np.empty(0))
        data.append(bytes(store.serialize_cdr(joints, kind, little_endian=index < 3)))
    data.append(data[0][:-5])
    data.append(data[0].replace(b"right", b"roght"))
    batch = Batch(store.fielddefs, kind, ["velocity[left]", "velocity[right]"], True, Held(kind, 8))
    assert all(batch.takes(one, 100 + index) for index, one in enumerate(data))
    batch.flush()
    columns = batch.held.columns()
    assert columns["velocity[left]"].tolist() == [0, 1, 2, 3, 4, 5, 0]
    np.testing.assert_array_equal(columns["velocity[right]"], [-1, -1, -1, -1, -1, -1, np.nan])
    assert list(batch.held.stamps) == [100, 101, 102, 103, 104, 105, 107]  # no stamp was set: when the bag received it
    assert batch.broken == 1
    for text in (["name[0]"], ["header.frame_id"], ["velocity[middle]"]):  # left to rosbags
        assert not Batch(store.fielddefs, kind, text, True, Held(kind, 1)).takes(data[0], 0)
