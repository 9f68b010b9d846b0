"""Bags as robots' owners record them: clocks, duplicates, what is left of a recording."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra 'logs' is not installed")

from missionsim.cli.app import run_command as main
from missionsim.importer import transform
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, read_logs
from missionsim.logs.readers import Options, reader_of
from tests.logs.bag_messages import Bag
from tests.logs.bag_writers import START_S, speed, write_bag

MAP = """\
kind: map
signals: {watts: /power.data, v: /odom.twist.twist.linear.x, x: /odom.pose.pose.position.x}
timeline: watts
columns: {time_s: time_s, power_robot_w: {value: watts, average: 1 s}, speed_m_s: v, x_m: x}
"""


def imported(tmp_path: Path, source: Path, text: str = MAP) -> LogTable:
    (tmp_path / "m.yaml").write_text(text)
    (log,) = import_source(source, load_map(tmp_path / "m.yaml"))
    return log


def command(tmp_path: Path, source: Path, text: str = MAP) -> int:
    (tmp_path / "m.yaml").write_text(text)
    return main(["import", str(source), "--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "out")])


# what a folder holds


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_bag_without_its_metadata_among_bags_is_read(tmp_path: Path, kind: str) -> None:
    for name in ("a", "b", "c"):
        write_bag(tmp_path / "train" / name, kind, 5.0)
    (tmp_path / "train" / "b" / "metadata.yaml").unlink()
    (tmp_path / "train" / "plots").mkdir()
    text = "kind: map\nsignals: {p: /battery.voltage}\ncolumns: {time_s: time_s, power_robot_w: p}\n"
    assert command(tmp_path, tmp_path / "train", text) == 0
    assert len(list((tmp_path / "out").iterdir())) == 3


# times


def test_averages_of_times_that_repeat_or_go_back() -> None:
    """A bag with the same message twice, and one that came late: the mean of those of one time, in order of time."""
    time = np.array([0.0, 1.0, 1.0, 3.0, 2.0, 4.0])
    values = np.array([0.0, 0.8, 1.2, 3.0, 2.0, 4.0])
    np.testing.assert_allclose(transform.moving_average(values, time, 1.0)[1:5], [1.0, 1.0, 3.0, 2.0])
    for over in (None, 1.0):
        np.testing.assert_allclose(transform.rate_of_change(values, time, over), 1.0)


def test_the_same_message_twice_is_one(tmp_path: Path) -> None:
    bag = Bag()
    for i in range(300):
        t = 0.2 * i
        bag.odometry("/odom", t, 0.5, x=0.5 * t)
        bag.number("/power", t, 20.0)
        if i % 50 == 7:
            bag.number("/power", t, 20.0)
    assert command(tmp_path, bag.write(tmp_path / "run")) == 0


def test_times_keep_their_nanoseconds(tmp_path: Path) -> None:
    """A recorder that received two seconds at once: a float since 1970 tells no two of its messages apart."""
    bag = Bag()
    for i in range(300):
        burst = (i // 10 + 1) * 2_000_000_000
        bag.odometry("/odom", 0.2 * i, 0.5, received=(burst + 40 * (i % 10)) * 1e-9)
        bag.number("/power", burst + 40 * (i % 10) + 20, 20.0)
    path = bag.write(tmp_path / "run")
    reader = reader_of(path)
    assert reader.recording is not None
    found = reader.recording(path, Options(fields={"/power.data"}))
    (topic,) = found.topics
    assert (np.diff(topic.time_s) > 0).all()
    assert found.start_s + topic.time_s[0] == pytest.approx(START_S + 2.0, abs=1e-6)
    assert command(tmp_path, path) == 0


# simulated time


def simulated(*, rate: float = 0.8, clock: bool = True, wall: bool = False) -> Bag:
    """240 s of simulated time at a real-time factor of `rate`; power without a header, odometry with a simulated one.

    `wall`: its clock is that of 1970 on, and not of the start of the simulation.
    """
    bag, start = Bag(), START_S if wall else 0
    for i in range(1200):
        t = 0.2 * i
        received = 3.0 + t / rate
        if clock:
            for step in (0.0, 0.1):
                bag.put("/clock", received + step / rate, "rosgraph_msgs/Clock", clock=bag.time(start + t + step))
        v = 0.5 * (i // 100 % 2)
        bag.odometry("/odom", t, v, x=0.1 * v * i, header=bag.header(t, start), received=received + 0.004)
        bag.number("/power", received + 0.006, 10.0 + 20.0 * v)
    return bag


@pytest.mark.parametrize("wall", [False, True])
@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("rate", [0.8, 1.6])
def test_topics_without_a_header_go_by_simulated_time(tmp_path: Path, rate: float, clock: bool, wall: bool) -> None:
    log = imported(tmp_path, simulated(rate=rate, clock=clock, wall=wall).write(tmp_path / "run"))
    assert log.duration_s == pytest.approx(240.0, rel=0.005)
    assert log.energy_wh("robot") == pytest.approx(15.0 * 240 / 3600, rel=0.01)
    (told,) = [remark for remark in log.remarks if remark.kind == "clock"]
    assert f"at {rate:.3g} times the bag's clock, and /power has the bag's time only" in told.message
    assert ("(/clock)" in told.message) == clock
    assert told.severity == ("note" if clock else "warning")


def test_the_bags_time_is_taken_where_a_map_asks_and_the_rate_is_told(tmp_path: Path) -> None:
    text = MAP.replace("timeline:", "stamp: bag\ntimeline:")
    log = imported(tmp_path, simulated().write(tmp_path / "run"), text)
    assert log.duration_s == pytest.approx(300.0, rel=0.005)
    (told,) = [remark for remark in log.remarks if remark.kind == "clock"]
    assert "headers of /odom run at 0.8 times the bag's clock" in told.message
    assert "1.25 times" in told.action


def test_a_clock_beside_headers_of_another_changes_nothing(tmp_path: Path) -> None:
    """Somebody else's simulation was in the network: the robot's own headers have the time of day."""
    bag = Bag()
    for i in range(600):
        t = 0.2 * i
        bag.put("/clock", t, "rosgraph_msgs/Clock", clock=bag.time(0.5 * t))
        bag.odometry("/odom", t, 0.5, x=0.5 * t, received=t + 0.004)
        bag.number("/power", t, 20.0)
    log = imported(tmp_path, bag.write(tmp_path / "run", "sqlite3"))
    assert log.duration_s == pytest.approx(120.0, rel=0.005)
    assert not [remark for remark in log.remarks if remark.kind == "clock"]


def test_headers_with_the_time_of_day_beside_simulated_ones(tmp_path: Path) -> None:
    """The battery's driver does not know of the simulation."""
    bag = simulated()
    for i in range(600):
        bag.battery("/battery", 0.5 * i, 24.0, 1.0, received=0.5 * i + 0.01)
    text = MAP.replace("/power.data", "/battery.voltage")
    log = imported(tmp_path, bag.write(tmp_path / "run"), text)
    assert log.duration_s == pytest.approx(240.0, rel=0.02)


# a clock that is set back


def ticking(*, back_s: float = 0.0, burst: bool = False) -> Bag:
    """Three topics at a steady pace; after 60 s the clock is set back, or messages wait for 3 s and come at once."""
    bag, rng = Bag(), np.random.default_rng(2)
    for i in range(2400):
        t = 0.05 * i
        off = -back_s if t >= 60 else 0.0
        late = max(0.0, 63.0 - t) * 0.9 if burst and 60 <= t < 63 else 0.0
        received = t + off + late + rng.uniform(0.001, 0.006)
        bag.odometry("/odom", t + off, speed(t), received=received)
        bag.imu("/imu", received, 0.1, header=bag.header(t + off))
        if i % 2 == 0:
            bag.number("/power", received, 20.0)
    return bag


@pytest.mark.parametrize("clock", ["header", "bag"])
def test_two_stretches_over_one_another_are_told(tmp_path: Path, clock: str) -> None:
    text = MAP.replace("timeline:", f"stamp: {clock}\ntimeline:")
    log = imported(tmp_path, ticking(back_s=2.5).write(tmp_path / "run", "sqlite3"), text)
    (told,) = [remark for remark in log.remarks if "twice" in remark.message]
    assert (told.kind, told.severity) == ("clock", "warning")
    found = re.fullmatch(
        r"from (.+) s on, about (.+) s hold twice the messages of every topic: was the clock set back\?", told.message
    )
    assert found is not None
    assert [float(found[1]), float(found[2])] == pytest.approx([57.5, 2.5], abs=0.2)
    assert "keep: time_s < 57 or time_s > 6" in told.action


@pytest.mark.parametrize("burst", [False, True])
def test_messages_that_wait_are_no_clock_that_is_set(tmp_path: Path, burst: bool) -> None:
    log = imported(tmp_path, ticking(burst=burst).write(tmp_path / "run", "sqlite3"))
    assert not [remark for remark in log.remarks if "twice" in remark.message]


# what cannot be read


def without_definition(path: Path) -> Path:
    """A lone MCAP whose recorder did not know the type of /status."""
    from mcap.writer import Writer

    bag = Bag(husky_msgs__HuskyStatus="float64 battery_voltage\nfloat64 current")
    for i in range(50):
        bag.odometry("/odom", 0.1 * i, 0.5)
        bag.put("/status", 0.1 * i, "husky_msgs/HuskyStatus", battery_voltage=24.0)
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        channels = {}
        for topic, kind in bag.kinds.items():
            text = "" if topic == "/status" else bag.store.generate_msgdef(kind, ros_version=2)[0]
            schema = writer.register_schema(kind, "ros2msg" if text else "", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for received, topic, data in bag.messages:
            writer.add_message(channels[topic], received, data, received)
        writer.finish()
    return path


def test_a_type_that_the_bag_does_not_define_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = without_definition(tmp_path / "run.mcap")
    assert main(["import", str(path)]) == 0
    assert "of a type that is not defined in it: /status (husky_msgs/msg/HuskyStatus)" in capsys.readouterr().out
    assert main(["import", str(path), "--suggest"]) == 1
    assert "the bag does not define husky_msgs/msg/HuskyStatus" in capsys.readouterr().out
    text = "kind: map\nsignals: {u: /status.battery_voltage, v: /odom.twist.twist.linear.x}\n"
    assert command(tmp_path, path, text + "columns: {time_s: time_s, power_robot_w: u, speed_m_s: v}\n") == 2
    told = capsys.readouterr().err
    assert "does not define husky_msgs/msg/HuskyStatus, the type of /status" in told


def test_the_bag_that_was_left_out_is_named_and_what_it_has_is_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "kind: map\nsignals: {u: /battery.voltage, c: /battery.current}\n"
    text += "columns: {time_s: time_s, voltage_robot_v: u, current_robot_a: c}\n"
    for name in ("a", "b", "c"):
        write_bag(tmp_path / "in" / name, "mcap", 5.0, batteries=("/batterie",) if name == "b" else ("/battery",))
    assert command(tmp_path, tmp_path / "in", text) == 1
    said = capsys.readouterr()
    assert f"left out: {tmp_path / 'in' / 'b'} (1 of 3 files)" in said.out.replace("\n", "")
    told = [line for line in said.err.splitlines() if "allowed" in line]
    assert len(told) == 2
    assert all("/batterie." in line and len(line) < 300 for line in told)
    assert "m.yaml:2" in said.err


@pytest.mark.parametrize("whole", [True, False])
def test_a_folder_of_bags_is_no_folder_of_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str], whole: bool) -> None:
    bag = write_bag(tmp_path / "in" / "a", "mcap", 5.0)
    if not whole:
        (bag / "metadata.yaml").unlink()
    assert main(["compare", "--robot", "pioneer3dx", str(tmp_path / "in")]) == 2
    told = capsys.readouterr().err
    assert "the folder holds recordings, no logs" in told
    assert f"missionsim import {tmp_path / 'in'} --suggest" in told


# recordings that broke off


def broken_off(tmp_path: Path, kind: str) -> Path:
    """A recording of 300 s of which the last part is not there."""
    bag = Bag(ros1=kind.startswith("ros1"))
    for i in range(6000):
        t = 0.05 * i
        bag.odometry("/odom", t, speed(t), x=0.1)
        if i % 4 == 0:
            bag.number("/power", t, 20.0)
    if kind.startswith("ros1"):
        path = bag.write(tmp_path / "run.bag")
        whole = path.read_bytes()
        if kind == "ros1":
            path.write_bytes(whole[: int(0.8 * len(whole))])
            return path
        # as a recorder leaves it that was killed: no index, and none announced
        at = whole.index(b"index_pos=") + len("index_pos=")
        index = int.from_bytes(whole[at : at + 8], "little")
        active = tmp_path / "run.bag.active"
        active.write_bytes(whole[:at] + bytes(8) + whole[at + 8 : index])
        return active
    folder = bag.write(tmp_path / "run", kind)
    path = next(p for p in folder.iterdir() if p.suffix != ".yaml")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.8 * len(whole))])
    return folder


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1", "ros1_active"])
def test_what_is_whole_of_a_recording_that_broke_off_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = broken_off(tmp_path, kind)
    assert command(tmp_path, path) == 1
    assert "was never closed, or is cut" in capsys.readouterr().out.replace("\n", " ")
    log = read_logs(tmp_path / "out")[0]
    assert log.duration_s > (290 if kind == "ros1_active" else 150)
    np.testing.assert_allclose(log.number("speed_m_s"), speed(log.time_s), atol=0.02)
    given = ["import", str(path), "--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "strict"), "--strict"]
    assert main(given) == 2


def test_a_recording_of_which_nothing_is_whole_says_what_may_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = next(write_bag(tmp_path / "run", "mcap", 3.0).glob("*.mcap"))
    path.write_bytes(path.read_bytes()[:3000])
    (tmp_path / "run" / "metadata.yaml").unlink()
    assert command(tmp_path, path) == 2
    told = capsys.readouterr().err
    assert "the bag cannot be read: it was never closed, or is cut" in told
    assert "mcap recover" in told


def test_a_part_of_a_split_bag_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "run", "mcap", 20.0)
    (there,) = (path.name for path in bag.glob("*.mcap"))
    told = (bag / "metadata.yaml").read_text()
    assert f"- {there}" in told
    (bag / "metadata.yaml").write_text(told.replace(f"- {there}", f"- {there}\n  - run_1.mcap"))
    text = "kind: map\nsignals: {p: /battery.voltage}\ncolumns: {time_s: time_s, power_robot_w: p}\n"
    assert command(tmp_path, bag, text) == 1
    assert "run_1.mcap is missing" in capsys.readouterr().out
