"""Small real bags and ULogs for the tests, written with the formats' own writers."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

STEP_S = 0.1
Drive = Mapping[str, Callable[[float], float]]


def battery_volts(t: float) -> float:
    return 25.0 - 0.01 * t


def speed(t: float) -> float:
    return 0.5 + 0.3 * np.sin(0.5 * t)


def amps(t: float) -> float:
    return 1.0 + 2.0 * speed(t)


DRIVE: dict[str, Callable[[float], float]] = {
    "speed": speed,
    "amps": amps,
    "slope": lambda t: 0.05,
    "turn": lambda t: 0.2 * np.cos(t),
}
"""What a bag tells, over time: m/s, A, rad (uphill), rad/s."""


START_S = 1_700_000_000


def _header(types: Any, t: float, **more: int) -> Any:
    seconds = int(START_S + t)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=round((START_S + t - seconds) * 1e9))
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **more)


def write_bag(
    path: Path,
    kind: str,
    duration_s: float = 30.0,
    *,
    often: int = 1,
    picture_bytes: int = 0,
    drive: Drive = DRIVE,
    off_s: float = 0.0,
    batteries: Sequence[str] = ("/battery",),
) -> Path:
    """A ROS 1 bag (`kind` ros1), ROS 2 bag (sqlite3 or mcap): /battery at 2 Hz, /odom at 10 Hz, /imu at 20 Hz.

    `often` times as many of each, and /camera/compressed at 10 Hz where a picture has a size. `off_s`: how far the
    clock of the battery's headers is ahead.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    types = store.types
    header = partial(_header, types, **({"seq": 0} if kind == "ros1" else {}))
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    point, pose = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Pose"]
    twist = types["geometry_msgs/msg/Twist"]

    def attitude(t: float):  # type: ignore[no-untyped-def]
        return quaternion(x=0.0, y=-np.sin(drive["slope"](t) / 2), z=0.0, w=np.cos(drive["slope"](t) / 2))

    def battery(t: float):  # type: ignore[no-untyped-def]
        return types["sensor_msgs/msg/BatteryState"](
            header=header(t + off_s),
            voltage=battery_volts(t),
            current=-drive["amps"](t),
            charge=1.0,
            capacity=2.0,
            design_capacity=2.0,
            percentage=0.5,
            power_supply_status=2,
            power_supply_health=1,
            power_supply_technology=2,
            present=True,
            cell_voltage=np.array([4.1, 4.2], dtype=np.float32),
            temperature=20.0,
            cell_temperature=np.array([], dtype=np.float32),
            location="",
            serial_number="",
        )

    def odometry(t: float):  # type: ignore[no-untyped-def]
        zero = vector(x=0.0, y=0.0, z=0.0)
        return types["nav_msgs/msg/Odometry"](
            header=header(t),
            child_frame_id="base",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](
                pose=pose(position=point(x=t, y=0.0, z=0.0), orientation=attitude(t)), covariance=np.zeros(36)
            ),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=twist(linear=vector(x=drive["speed"](t), y=0.0, z=0.0), angular=zero), covariance=np.zeros(36)
            ),
        )

    def imu(t: float):  # type: ignore[no-untyped-def]
        return types["sensor_msgs/msg/Imu"](
            header=header(t),
            orientation=attitude(t),
            orientation_covariance=np.zeros(9),
            angular_velocity=vector(x=0.0, y=0.0, z=drive["turn"](t)),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=0.0, y=0.0, z=9.8),
            linear_acceleration_covariance=np.zeros(9),
        )

    pixels = np.frombuffer(np.random.default_rng(1).bytes(picture_bytes), dtype=np.uint8)

    def picture(t: float):  # type: ignore[no-untyped-def]
        return types["sensor_msgs/msg/CompressedImage"](header=header(t), format="jpeg", data=pixels)

    topics = [
        *((topic, "sensor_msgs/msg/BatteryState", battery, 0.5 / often) for topic in batteries),
        ("/odom", "nav_msgs/msg/Odometry", odometry, STEP_S / often),
        ("/imu", "sensor_msgs/msg/Imu", imu, 0.05 / often),
        *([("/camera/compressed", "sensor_msgs/msg/CompressedImage", picture, 0.1)] if picture_bytes else []),
    ]
    messages = sorted(
        (t, index) for index, (_, _, _, step) in enumerate(topics) for t in np.arange(0.0, duration_s, step).tolist()
    )
    if kind == "ros1":
        from rosbags.rosbag1 import Writer as Writer1

        writer = Writer1(path)
        serialise = store.serialize_ros1
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)  # type: ignore[assignment]
        serialise = store.serialize_cdr  # type: ignore[assignment]
    with writer:
        connections = [writer.add_connection(topic, kind_, typestore=store) for topic, kind_, _, _ in topics]
        for t, index in messages:
            _, name, make, _ = topics[index]
            writer.write(connections[index], int((START_S + t) * 1e9), bytes(serialise(make(t), name)))
    return path


def write_diagnostics_bag(path: Path, duration_s: float = 40.0) -> Path:
    """A ROS 2 bag whose battery speaks through /diagnostics in texts, with joints, and a lifecycle node."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = partial(_header, types)
    pair, status = types["diagnostic_msgs/msg/KeyValue"], types["diagnostic_msgs/msg/DiagnosticStatus"]
    state = types["lifecycle_msgs/msg/State"]

    def diagnostics(t: float):  # type: ignore[no-untyped-def]
        values = {
            "Charge": f"{90 - t / 10:.1f}%",
            "Battery voltage": f"{battery_volts(t):.3f} V",
            "Battery current": f"{amps(t):.4f}",
        }
        entries = [pair(key=key, value=value) for key, value in values.items()]
        motor = [pair(key="Temperature", value="31 C")]
        return types["diagnostic_msgs/msg/DiagnosticArray"](
            header=header(t),
            status=[
                status(level=0, name="Power System", message="OK", hardware_id="", values=entries),
                status(level=0, name="Motor left", message="OK", hardware_id="", values=motor),
            ],
        )

    def joints(t: float):  # type: ignore[no-untyped-def]
        return types["sensor_msgs/msg/JointState"](
            header=header(t),
            name=["wheel_left", "wheel_right"],
            position=np.array([t, t]),
            velocity=np.array([speed(t) / 0.1, speed(t) / 0.1]),
            effort=np.array([1.0 + speed(t), 2.0 + speed(t)]),
        )

    def lidar(t: float):  # type: ignore[no-untyped-def]
        before, after = state(id=2, label="inactive"), state(id=3, label="active")
        if t > 15:
            before, after = after, before
        return types["lifecycle_msgs/msg/TransitionEvent"](
            timestamp=0,
            transition=types["lifecycle_msgs/msg/Transition"](id=3, label="x"),
            start_state=before,
            goal_state=after,
        )

    def joystick(t: float):  # type: ignore[no-untyped-def]
        pressed = np.array([0, int(5 <= t < 12)], dtype=np.int32)
        return types["sensor_msgs/msg/Joy"](header=header(t), axes=np.zeros(2, dtype=np.float32), buttons=pressed)

    topics = [
        ("/joy", "sensor_msgs/msg/Joy", joystick, np.arange(0.0, duration_s, 0.1)),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", diagnostics, np.arange(0.0, duration_s, 0.5)),
        ("/joint_states", "sensor_msgs/msg/JointState", joints, np.arange(0.0, duration_s, 0.1)),
        ("/lidar/transition_event", "lifecycle_msgs/msg/TransitionEvent", lidar, np.array([10.0, 20.0])),
    ]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(topic, kind, typestore=store) for topic, kind, _, _ in topics]
        for t, index in sorted((t, index) for index, topic in enumerate(topics) for t in topic[3].tolist()):
            message = topics[index][2](t)
            writer.write(
                connections[index], int((START_S + t) * 1e9), bytes(store.serialize_cdr(message, topics[index][1]))
            )
    return path


def write_ulog(path: Path, duration_s: float = 20.0) -> Path:
    """A ULog by its specification: battery_status at 2 Hz, vehicle_local_position and vehicle_attitude at 10 Hz."""
    out = io.BytesIO()
    out.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def message(kind: bytes, payload: bytes) -> None:
        out.write(struct.pack("<HB", len(payload), kind[0]) + payload)

    message(b"B", bytes(16) + struct.pack("<QQQ", 0, 0, 0))
    formats = {
        "battery_status": "uint64_t timestamp;float voltage_v;float current_a;",
        "vehicle_local_position": "uint64_t timestamp;float x;float y;float vx;float vy;",
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    }
    for name, fields in formats.items():
        message(b"F", f"{name}:{fields}".encode())
    for number, name in enumerate(formats):
        message(b"A", struct.pack("<BH", 0, number) + name.encode())
    heading = 0.5
    rows = []
    for t in np.arange(0.0, duration_s, 0.1):
        stamp = int(1e6 * (5.0 + t))
        v = speed(t)
        rows.append((t, 1, struct.pack("<Qffff", stamp, t, 0.0, v * np.cos(heading), v * np.sin(heading))))
        slope = 0.04
        # heading about z (down), then nose up about y (right): positive pitch
        q = (
            np.cos(heading / 2) * np.cos(slope / 2),
            -np.sin(heading / 2) * np.sin(slope / 2),
            np.cos(heading / 2) * np.sin(slope / 2),
            np.sin(heading / 2) * np.cos(slope / 2),
        )
        rows.append((t, 2, struct.pack("<Qffff", stamp, *q)))
        if round(t * 10) % 5 == 0:
            rows.append((t, 0, struct.pack("<Qff", stamp, battery_volts(t), amps(t))))
    for _, number, payload in rows:
        message(b"D", struct.pack("<H", number) + payload)
    path.write_bytes(out.getvalue())
    return path


def write_ardupilot(path: Path, duration_s: float = 60.0) -> Path:
    """An ArduPilot rover's log by its specification: BAT (two batteries) and ATT at 10 Hz, GPS at 5 Hz, a mode."""
    out = io.BytesIO()

    def message(kind: int, payload: bytes) -> None:
        out.write(b"\xa3\x95" + bytes([kind]) + payload)

    codes = {"Q": 8, "f": 4, "B": 1, "h": 2, "c": 2, "I": 4, "H": 2, "n": 4, "N": 16, "Z": 64, "b": 1, "d": 8}
    formats = {
        128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
        200: ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        201: ("BAT", "QBff", "TimeUS,Inst,Volt,Curr"),
        202: ("ATT", "Qcc", "TimeUS,Pitch,Yaw"),
        203: ("GPS", "QBIHf", "TimeUS,I,GMS,GWk,Spd"),
        204: ("MODE", "QB", "TimeUS,Mode"),
        205: ("MSG", "QZ", "TimeUS,Message"),
    }
    for kind, (name, code, columns) in formats.items():
        length = 3 + sum(codes[letter] for letter in code)
        message(128, struct.pack("<BB4s16s64s", kind, length, name.encode(), code.encode(), columns.encode()))
    message(200, struct.pack("<QB16s16s", 0, 201, b"s#vA", b"F-00"))
    message(200, struct.pack("<QB16s16s", 0, 203, b"s#---n", b"F-----"))
    message(205, struct.pack("<Q64s", 1, b"ArduRover V4.5"))
    for index in range(round(10 * duration_s)):
        t = 0.1 * index
        stamp = int(1e6 * (3.0 + t))
        message(201, struct.pack("<QBff", stamp, 0, battery_volts(t), amps(t)))
        message(201, struct.pack("<QBff", stamp, 1, 5.0, 0.5))
        message(202, struct.pack("<Qhh", stamp, round(100 * 2.3), 100 * 40))
        if index % 2 == 0:
            message(203, struct.pack("<QBIHf", stamp, 0, 1000 * 3600 + 100 * index, 2300, speed(t)))
        if index % 100 == 0:
            message(204, struct.pack("<QB", stamp, 10))
    path.write_bytes(out.getvalue())
    return path
