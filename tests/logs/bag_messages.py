"""Bags of any messages for the tests: each with the time of its header and the time at which the bag received it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.logs.bag_writers import START_S


class Bag:
    """Messages, and the bag that they are written to. Times are in seconds from `START_S`."""

    def __init__(self, *, ros1: bool = False, **own: str) -> None:
        """`own`: definitions of types of its own, ``pkg__Name="float64 x"``."""
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        for name, text in own.items():
            self.store.register(get_types_from_msg(text, name.replace("__", "/msg/")))
        self.kinds: dict[str, str] = {}
        self.messages: list[tuple[int, str, bytes]] = []

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a type (``sensor_msgs/Imu``); what is not given is nought, empty or made likewise."""
        name = kind.replace("/", "/msg/") if "/msg/" not in kind else kind
        values = {}
        for field, description in self.store.fielddefs[name][1]:
            values[field] = fields.pop(field) if field in fields else self._empty(description)
        assert not fields, fields
        return self.store.types[name](**values)

    def _empty(self, description: Any) -> Any:
        node, inner = description
        if node == 1:
            return "" if inner[0] == "string" else False if inner[0] == "bool" else 0 if "int" in inner[0] else 0.0
        if node == 2:
            return self.make(inner)
        (base, kind), count = inner
        listed = base != 1 or kind[0] == "string"
        return [] if listed else np.zeros(count if node == 3 else 0, dtype=kind[0])

    def time(self, seconds: float) -> Any:
        """`seconds` since 1970."""
        ns = round(seconds * 1e9)
        return self.store.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)

    def header(self, t: float | None, start_s: float = START_S) -> Any:
        """A header at `t`; without a time where it is None."""
        return self.make("std_msgs/Header", stamp=self.time(0.0 if t is None else start_s + t), frame_id="base")

    def put(self, topic: str, received: float | int, kind: str, **fields: Any) -> None:
        """Add a message; `received`: seconds from the start, or an int of nanoseconds from it."""
        name = kind.replace("/", "/msg/")
        self.kinds[topic] = name
        ns = received if isinstance(received, int) else round(received * 1e9)
        write = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.messages.append((START_S * 10**9 + ns, topic, bytes(write(self.make(kind, **fields), name))))

    def number(self, topic: str, t: float | int, value: float, kind: str = "std_msgs/Float32") -> None:
        self.put(topic, t, kind, data=value)

    def battery(
        self, topic: str, t: float, volts: float, amps: float, header: Any = None, received: float | None = None
    ) -> None:
        head = self.header(t) if header is None else header
        self.put(
            topic,
            t if received is None else received,
            "sensor_msgs/BatteryState",
            header=head,
            voltage=volts,
            current=amps,
        )

    def odometry(
        self,
        topic: str,
        t: float,
        v: float,
        *,
        x: float = 0.0,
        vy: float = 0.0,
        turn: float = 0.0,
        header: Any = None,
        received: float | None = None,
    ) -> None:
        vector, point = "geometry_msgs/Vector3", "geometry_msgs/Point"
        unit = self.make("geometry_msgs/Quaternion", w=1.0)
        pose = self.make("geometry_msgs/Pose", position=self.make(point, x=x), orientation=unit)
        twist = self.make("geometry_msgs/Twist", linear=self.make(vector, x=v, y=vy), angular=self.make(vector, z=turn))
        self.put(
            topic,
            t if received is None else received,
            "nav_msgs/Odometry",
            header=self.header(t) if header is None else header,
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=pose),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist),
        )

    def imu(self, topic: str, t: float, turn: float, pitch: float | None = 0.0, header: Any = None) -> None:
        """`pitch`: nose up [rad]; None: the attitude is not known, as a quaternion of noughts says."""
        half = 0.5 * (pitch or 0.0)
        given = {} if pitch is None else {"y": -math.sin(half), "w": math.cos(half)}
        self.put(
            topic,
            t,
            "sensor_msgs/Imu",
            header=self.header(t) if header is None else header,
            orientation=self.make("geometry_msgs/Quaternion", **given),
            angular_velocity=self.make("geometry_msgs/Vector3", z=turn),
        )

    def write(self, path: Path, kind: str = "mcap") -> Path:
        """A ROS 1 bag (ros1), or the folder of a ROS 2 bag (mcap, sqlite3)."""
        messages = sorted(self.messages, key=lambda message: message[0])
        if self.ros1:
            writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer(path, version=9, storage_plugin=plugin)
        with writer:
            to = {topic: writer.add_connection(topic, name, typestore=self.store) for topic, name in self.kinds.items()}
            for received, topic, data in messages:
                writer.write(to[topic], received, data)
        return path
