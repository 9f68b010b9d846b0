"""Bags and ULogs written with the formats' own writers, read through maps."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.importer import transform
from missionsim.importer.mapping import import_source
from missionsim.importer.roles import fields_of
from missionsim.importer.transform import Signal, merge_signals
from missionsim.inputs.loading import load_map
from missionsim.labels import Labels
from missionsim.logs import LogTable
from tests.logs.bag_writers import START_S, amps, battery_volts, speed, write_ardupilot, write_bag, write_ulog

pytest.importorskip("rosbags", reason="the extra 'logs' is not installed")
pytest.importorskip("pyulog", reason="the extra 'logs' is not installed")

BAG_MAP = """\
kind: map
signals:
  volts: /battery.voltage
  amps: /battery.current
  cell: /battery.cell_voltage[1]
  frame: /odom.child_frame_id
  v: /odom.twist.twist.linear.x
  yaw_rate: {field: /imu.angular_velocity.z, fill: linear}
  qx: /imu.orientation.x
  qy: /imu.orientation.y
  qz: /imu.orientation.z
  qw: /imu.orientation.w
timeline: v
columns:
  time_s: time_s
  voltage_robot_v: volts
  current_robot_a: -amps
  speed_m_s: v
  yaw_rate_rad_s: yaw_rate
  slope_rad: {quaternion: [qx, qy, qz, qw], give: slope}
  cell_v: cell
  frame: frame
"""


def run(tmp_path: Path, source: Path, text: str) -> LogTable:
    (tmp_path / "m.yaml").write_text(text)
    (log,) = import_source(source, load_map(tmp_path / "m.yaml"))
    return log


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind)
    log = run(tmp_path, bag, BAG_MAP)
    time = np.arange(300) * 0.1
    np.testing.assert_allclose(log.time_s, time, atol=2e-6)
    np.testing.assert_allclose(log.number("speed_m_s"), speed(time), rtol=1e-12)
    np.testing.assert_allclose(log.number("yaw_rate_rad_s"), 0.2 * np.cos(time), atol=1e-6)
    np.testing.assert_allclose(log.number("slope_rad"), 0.05, atol=1e-12)
    seen = np.floor(time / 0.5 + 1e-6) * 0.5
    np.testing.assert_allclose(log.power_w["robot"], battery_volts(seen) * amps(seen), rtol=1e-6)
    fresh = log.fresh["robot"]
    assert fresh is not None
    assert np.flatnonzero(fresh).tolist() == list(range(0, 300, 5))
    assert set(log.number("cell_v").round(3)) == {4.2}
    assert log.columns["frame"].names == ("base",)  # type: ignore[union-attr]


@pytest.mark.parametrize(("off_s", "late"), [(1.0, 10), (-START_S, 0)])
def test_headers_of_another_clock_are_told(tmp_path: Path, off_s: float, late: int) -> None:
    """Of a second, they are read on; of a clock that counts from the start of a board, no row would meet another's."""
    bag = write_bag(tmp_path / "run", "mcap", off_s=off_s)
    log = run(tmp_path, bag, BAG_MAP)
    seen = np.floor((log.time_s) / 0.5 + 1e-6) * 0.5
    np.testing.assert_allclose(
        log.power_w["robot"][: 280 - late], (battery_volts(seen) * amps(seen))[: 280 - late], rtol=1e-6
    )
    (told,) = [str(remark) for remark in log.remarks if remark.kind == "clock" and "headers" in remark.message]
    assert f"{off_s:+.4g} s in /battery" in told
    assert ("were taken" in told) == (late == 0)


def test_lone_mcap_and_file_inside_a_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", "mcap", 10.0)
    inside = next(bag.glob("*.mcap"))
    lone = shutil.copy(inside, tmp_path / "lone.mcap")
    for source in (inside, Path(lone)):
        assert run(tmp_path, source, BAG_MAP).rows == 100


def test_fields_are_listed(tmp_path: Path) -> None:
    fields = {field.name: field for field in fields_of(write_bag(tmp_path / "run", "sqlite3", 2.0))}
    assert fields["/battery.voltage"].count == 4
    assert isinstance(fields["/odom.child_frame_id"].values, Labels)
    assert {"/imu.orientation.w", "/odom.twist.twist.linear.x", "/battery.cell_voltage[0]"} <= fields.keys()
    names = {field.name for field in fields_of(write_ulog(tmp_path / "a.ulg"))}
    assert {"battery_status.voltage_v", "vehicle_attitude.q[3]"} <= names


@pytest.mark.parametrize(
    ("old", "new", "message", "hint"),
    [
        ("/battery.voltage", "/batery.voltage", "'/batery.voltage' is not in", "/battery.voltage"),
        ("/battery.voltage", "/battery.volts", "'/battery.volts' is not in", "/battery.voltage"),
        (
            "/battery.voltage",
            "/battery.cell_voltage[9]",
            "'/battery.cell_voltage[9]' is not in",
            "/battery.cell_voltage[1]",
        ),
        ("/battery.voltage", "/battery.header", "'/battery.header' is not in", "/battery.charge"),
        ("/battery.voltage", "voltage", "'voltage' is not in", ""),
        ("/battery.voltage", "/battery.__class__", "'/battery.__class__' is not in", ""),
        ("timeline: v", "timeline: vv", "timeline 'vv' is not a signal", ""),
    ],
)
def test_faults_in_signals(tmp_path: Path, old: str, new: str, message: str, hint: str) -> None:
    bag = write_bag(tmp_path / "run", "sqlite3", 3.0)
    with pytest.raises(InputError) as caught:
        run(tmp_path, bag, BAG_MAP.replace(old, new))
    fault = caught.value.faults[0]
    assert message in fault.message
    if hint:
        assert fault.hint == hint
        assert fault.line == 3


@pytest.mark.parametrize("kind", ["ros1", "mcap", "sqlite3", "ulog"])
def test_broken_files_are_told(tmp_path: Path, kind: str) -> None:
    if kind == "ulog":
        path = write_ulog(tmp_path / "a.ulg")
    else:
        bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, 3.0)
        path = bag if kind == "ros1" else next(p for p in bag.iterdir() if p.suffix in (".mcap", ".db3"))
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    (tmp_path / "m.yaml").write_text(ULOG_MAP if kind == "ulog" else BAG_MAP)
    spec = load_map(tmp_path / "m.yaml")
    told = 0
    for trial in range(40):
        data = bytearray(whole)
        if trial % 2:
            data = data[: int(rng.integers(16, len(whole)))]
        for at in rng.integers(16, len(data), size=20):
            data[at] = int(rng.integers(0, 256))
        path.write_bytes(data)
        try:
            import_source(path, spec)
        except InputError as error:
            told += bool(str(error))
    assert told > 0


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("part", ["messages", "metadata"])
def test_half_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, part: str) -> None:
    """The messages, or what describes them, are gone, empty or cut: a message, and nothing is written."""
    bag, out = write_bag(tmp_path / "run", kind, 3.0), tmp_path / "log.parquet"
    (tmp_path / "m.yaml").write_text(BAG_MAP)
    path = next(p for p in bag.iterdir() if (p.name == "metadata.yaml") == (part == "metadata"))
    whole = path.read_bytes()
    for data in (None, b"", whole[: len(whole) // 2]):
        if data is None and part == "metadata":
            continue  # a folder with a lone file of messages is read as such
        if data and kind == "sqlite3" and part == "messages":
            continue  # what is whole of it is read: test_own_bags.py
        path.unlink() if data is None else path.write_bytes(data)
        for more in ([], ["--strict"]):
            assert run_command(["import", str(bag), "--map", str(tmp_path / "m.yaml"), "--out", str(out), *more]) == 2
            assert "error: the bag cannot be read" in capsys.readouterr().err
        assert not out.exists()


def test_a_cut_mcap_whose_summary_seems_to_fit_is_told(tmp_path: Path) -> None:
    """So many bytes are missing that its footer points behind the names of the topics, and readers scan."""
    path = next(write_bag(tmp_path / "run", "mcap", 8.0).glob("*.mcap"))
    whole = path.read_bytes()
    begins = at = int.from_bytes(whole[-28:-20], "little")
    while whole[at] != 8:  # index of chunks
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    (tmp_path / "m.yaml").write_text(BAG_MAP)
    spec, read = load_map(tmp_path / "m.yaml"), 0
    for cut in range(15000, 27000, 1003):
        path.write_bytes(whole[:cut] + whole[cut + at - begins :])
        try:
            (log,) = import_source(path, spec)
        except InputError:
            continue
        read += 1
        assert any(remark.kind == "damaged" and remark.severity == "error" for remark in log.remarks)
    assert read > 4


@pytest.mark.parametrize("content", [b"", b"\x00\x01garbage, not a log" * 9, b"time_s,power_robot_w\n0,1\n1,2\n"])
@pytest.mark.parametrize(
    ("suffix", "kind"),
    [("bin", "ArduPilot log"), ("ulg", "ULog"), ("mcap", "MCAP"), ("bag", "ROS 1 bag"), ("db3", "ROS 2")],
)
def test_a_file_that_is_not_what_its_suffix_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, kind: str, content: bytes
) -> None:
    path = tmp_path / f"drive.{suffix}"
    path.write_bytes(content)
    (tmp_path / "m.yaml").write_text(ULOG_MAP)
    for more in ([], ["--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "log.parquet")]):
        assert run_command(["import", str(path), *more]) == 2
        err = capsys.readouterr().err
        assert f"drive.{suffix}: error: this is no {kind}" in err
        assert "CSV" not in err
        assert "Parquet" not in err


ULOG_MAP = """\
kind: map
signals:
  volts: battery_status.voltage_v
  amps: battery_status.current_a
  vx: vehicle_local_position.vx
  vy: vehicle_local_position.vy
  q0: vehicle_attitude.q[0]
timeline: vx
columns:
  time_s: time_s
  voltage_robot_v: volts
  current_robot_a: amps
  speed_m_s: hypot(vx, vy)
"""


def test_ulog(tmp_path: Path) -> None:
    log = run(tmp_path, write_ulog(tmp_path / "a.ulg"), ULOG_MAP)
    time = np.arange(200) * 0.1
    np.testing.assert_allclose(log.time_s, time, atol=2e-6)
    np.testing.assert_allclose(log.number("speed_m_s"), speed(time), rtol=1e-6)
    seen = np.floor(time / 0.5 + 1e-6) * 0.5
    np.testing.assert_allclose(log.power_w["robot"], battery_volts(seen) * amps(seen), rtol=1e-6)


def test_shipped_ulog_map(tmp_path: Path, root: Path) -> None:
    (log,) = import_source(write_ulog(tmp_path / "a.ulg"), load_map(root / "docs" / "maps" / "px4_rover.yaml"))
    np.testing.assert_allclose(log.number("slope_rad"), 0.04, atol=1e-6)
    np.testing.assert_allclose(log.number("heading_rad"), -0.5, atol=1e-6)
    np.testing.assert_allclose(log.number("speed_m_s"), speed(np.arange(200) * 0.1), rtol=1e-5)


def test_unknown_ulog_field(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"vehicle_attitude\.q\[3\]"):
        run(tmp_path, write_ulog(tmp_path / "a.ulg"), ULOG_MAP.replace("q[0]", "q[7]"))


def test_ardupilot(tmp_path: Path) -> None:
    path = write_ardupilot(tmp_path / "a.bin")
    assert run_command(["import", str(path), "--suggest", "--out", str(tmp_path / "m.yaml"), "--quiet"]) == 0
    spec = load_map(tmp_path / "m.yaml")
    (log,) = import_source(path, spec)
    time = np.arange(599) * 0.1
    np.testing.assert_allclose(log.time_s[:599], time, atol=2e-6)
    np.testing.assert_allclose(log.power_w["robot"][:599], battery_volts(time) * amps(time), rtol=1e-6)
    np.testing.assert_allclose(log.number("speed_m_s")[:599:2], speed(time[::2]), rtol=1e-5)
    np.testing.assert_allclose(log.number("slope_rad")[:599], np.radians(2.3), rtol=1e-6)
    names = {field.name for field in fields_of(path)}
    assert {"BAT[1].Volt", "GPS.GWk", "MODE.Mode"} <= names
    assert not [remark for remark in log.remarks if remark.severity != "note"]
    for data in (path.read_bytes()[:20_000], path.read_bytes()[:9000] + b"\1" * 700 + path.read_bytes()[9000:]):
        path.write_bytes(data)
        (log,) = import_source(path, spec)
        assert any(remark.kind == "damaged" and "whole message" in remark.message for remark in log.remarks)


@pytest.mark.parametrize("package", ["rosbags", "pyulog", "pymavlink"])
def test_the_extra_is_named_when_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    if package == "rosbags":
        path = write_bag(tmp_path / "run", "sqlite3", 2.0)
    else:
        path = write_ulog(tmp_path / "a.ulg") if package == "pyulog" else write_ardupilot(tmp_path / "a.bin")
    for name in {package, *(name for name in sys.modules if name.split(".")[0] == package)}:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"pip install .*\[logs\]'"):
        fields_of(path)


def test_signals_out_of_order_silent_and_late() -> None:
    time = np.arange(100) * 0.1
    shuffled = time.copy()
    shuffled[[10, 11]] = shuffled[[11, 10]]
    raw = merge_signals(
        {
            "v": Signal(time, np.arange(100.0), "hold", "/odom"),
            "p": Signal(shuffled[5:90], shuffled[5:90], "linear", "/power"),
            "q": Signal(np.r_[time[:20], time[60:]], np.ones(60), "hold", "/quiet"),
        },
        None,
        "x",
    )
    assert raw.rows == 90
    np.testing.assert_allclose(raw.columns["time_s"], time[:90], atol=1e-12)
    np.testing.assert_allclose(np.asarray(raw.columns["p"])[:85], time[5:90])
    assert sorted((r.kind, r.column) for r in raw.remarks) == [
        ("gap", ""),
        ("gap", ""),
        ("gap", "q"),
        ("time_backwards", "p"),
    ]


@pytest.mark.parametrize("fill", ["hold", "linear", "mean", None])
def test_a_topic_that_falls_silent_says_nothing_meanwhile(fill: str | None) -> None:
    """Odometry that stops while the robot drives, a command that stays nought, a weight that stays."""
    time = np.arange(1000) * 0.1
    there = (time < 40) | (time > 70)
    speed = 0.5 + 0.3 * np.sin(time)
    signals = {
        "p": Signal(time[::5], speed[::5], None, "/power"),
        "v": Signal(time[there], speed[there], fill, "/odom"),
        "x": Signal(time[there], time[there], fill, "/odom"),
        "command": Signal(time[there], np.where(time < 39, speed, 0.0)[there], fill, "/cmd_vel"),
        "kg": Signal(time[there], np.full(there.sum(), 5.0), fill, "/payload"),
    }
    raw = merge_signals(signals, "p", "x")
    silent = (raw.columns["time_s"] > 40.5) & (raw.columns["time_s"] < 69.5)
    for name in ("v", "x"):
        assert np.isnan(raw.columns[name])[silent].all(), name
        assert np.isfinite(raw.columns[name])[(raw.columns["time_s"] < 40) | (raw.columns["time_s"] > 70.1)].all(), name
    assert set(np.asarray(raw.columns["command"])[silent]) == {0.0}
    assert set(np.asarray(raw.columns["kg"])) == {5.0}
    assert [(r.message, r.action) for r in raw.remarks if "/odom" in r.message] == [
        ("no message of /odom for 30.2 s", "missing there")
    ]


def test_signals_that_do_not_meet_are_refused() -> None:
    time = np.arange(100) * 0.1
    signals = {"v": Signal(time, time, None, "/odom"), "p": Signal(time + 1e9, time, None, "/battery")}
    with pytest.raises(
        InputError, match="no message of /odom lies between the first of /battery and the last of /odom"
    ):
        merge_signals(signals, "v", "x")


def test_unwrap_keeps_missing_values() -> None:
    angle = np.array([3.0, np.nan, -3.0, -2.9])
    result = transform.unwrap(angle)
    assert np.isnan(result[1])
    np.testing.assert_allclose(result[[0, 2, 3]], [3.0, -3.0 + 2 * np.pi, -2.9 + 2 * np.pi])


@pytest.mark.parametrize(("kind", "what"), [("mcap", "MCAP file"), ("sqlite3", "ROS 2 bag"), ("folder", "ROS 2 bag")])
def test_validate_says_how_a_bag_becomes_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, what: str
) -> None:
    bag = write_bag(tmp_path / "bag", "mcap" if kind == "mcap" else "sqlite3", 3.0)
    given = bag if kind == "folder" else next(path for path in bag.iterdir() if path.suffix != ".yaml")
    assert run_command(["validate", str(given)]) == 2
    out, err = capsys.readouterr()
    assert out == "1 file: 1 error\n"
    assert f"{given}: error: this is a {what}, not a table" in err
    assert "did you mean: missionsim import FILE --suggest" in err
