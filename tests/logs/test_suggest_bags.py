"""`import --suggest` of bags as robots' owners record them: several robots, odd messages, numbers without units."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra 'logs' is not installed")

from missionsim.cli.app import run_command as main
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable
from tests.logs.bag_messages import Bag
from tests.logs.bag_writers import amps, battery_volts, speed


def suggested(tmp_path: Path, bag: Bag, *, exit_code: int = 0) -> tuple[LogTable, str]:
    """The log by nothing but the suggested map, and the map."""
    path, made = bag.write(tmp_path / "run"), tmp_path / "m.yaml"
    assert main(["import", str(path), "--suggest", "--out", str(made)]) == exit_code
    (log,) = import_source(path, load_map(made))
    return log, made.read_text()


def near(found: np.ndarray, truth: np.ndarray, within: float) -> None:
    assert float(np.sqrt(np.mean((found - truth) ** 2))) < within


# several robots


def two_robots() -> Bag:
    """The first has odometry and an IMU, the second a battery as well."""
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        bag.odometry("/robot1/odom", t, 0.3)
        bag.imu("/robot1/imu", t, 0.1)
        bag.odometry("/robot2/odom", t, speed(t), turn=0.2)
        bag.imu("/robot2/imu", t, 0.2)
        if i % 4 == 0:
            bag.battery("/robot2/battery_state", t, battery_volts(t), -amps(t))
    return bag


def test_columns_of_one_robot_belong_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, text = suggested(tmp_path, two_robots())
    assert "/robot1/" not in "".join(line for line in text.splitlines() if not line.startswith("#"))
    near(log.number("speed_m_s"), speed(log.time_s), 0.02)
    near(log.number("yaw_rate_rad_s"), np.full(log.rows, 0.2), 1e-6)
    (told,) = [line for line in text.splitlines() if "several robots" in line]
    assert "robot1, robot2" in told
    assert "this map is of robot2" in told
    assert "several robots" in capsys.readouterr().out


def test_two_odometries_of_one_robot_are_no_two_robots(tmp_path: Path) -> None:
    bag = Bag()
    for i in range(600):
        t = 0.05 * i
        bag.odometry("/wheel/odom", t, speed(t))
        bag.odometry("/visual/odom", t, speed(t))
        bag.battery("/battery", t, battery_volts(t), -amps(t))
    assert "several robots" not in suggested(tmp_path, bag)[1]


# speed


def test_a_twist_that_nobody_fills(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The pose moves, the twist beside it stays nought: the speed is that of the positions, and the import tells."""
    bag, x = Bag(), 0.0
    for i in range(1200):
        t = 0.1 * i
        x += 0.1 * speed(t)
        bag.odometry("/odom", t, 0.0, x=x)
        bag.battery("/battery", t, battery_volts(t), -amps(t))
    log, text = suggested(tmp_path, bag)
    near(log.number("speed_m_s"), speed(log.time_s), 0.03)
    assert "the twist of /odom stays nought" in text
    (tmp_path / "zero.yaml").write_text(
        "kind: map\nsignals: {u: /battery.voltage, v: /odom.twist.twist.linear.x, x: /odom.pose.pose.position.x,\n"
        "  yy: /odom.pose.pose.position.y}\n"
        "columns: {time_s: time_s, power_robot_w: u, speed_m_s: v, x_m: x, y_m: yy}\n"
    )
    (log,) = import_source(tmp_path / "run", load_map(tmp_path / "zero.yaml"))
    (told,) = [remark for remark in log.remarks if remark.column == "speed_m_s" and remark.kind == "disagreement"]
    assert "while x_m, y_m reach" in told.message


# power


@pytest.mark.parametrize(
    "meters", [("power", "current", "bus_voltage"), ("power", "battery"), ("current", "bus_voltage")]
)
def test_watts_and_amperes_without_units(tmp_path: Path, meters: tuple[str, ...]) -> None:
    """An INA219 that publishes bare numbers, in mW and mA; a voltage beside them tells."""
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        bag.odometry("/odom", t, speed(t))
        volts, current = battery_volts(t), amps(t)
        values = {"power": 1000 * volts * current, "current": 1000 * current, "bus_voltage": volts}
        for name in meters:
            if name == "battery" and i % 20 == 0:
                bag.battery("/battery_state", t, volts, math.nan)
            elif name != "battery":
                bag.number(f"/ina219/{name}", t, values[name])
    log, text = suggested(tmp_path, bag)
    near(log.power_w["robot"], battery_volts(log.time_s) * amps(log.time_s), 1.0)
    assert ("mW" in text) == ("power" in meters)


HUSKY = "\n".join(
    ["std_msgs/Header header", "float64 ros_control_loop_freq"]
    + [f"float64 {name}" for name in ("mcu_and_user_port_current", "left_driver_current", "right_driver_current")]
    + [f"float64 {name}" for name in ("battery_voltage", "left_driver_voltage", "right_driver_voltage")]
    + ["float64 left_driver_temp", "bool current_limit"]
)


@pytest.mark.parametrize("topic", ["/status", "/husky/state"])
def test_currents_of_drivers_and_of_the_rest(tmp_path: Path, topic: str) -> None:
    bag = Bag(husky_msgs__HuskyStatus=HUSKY)
    for i in range(600):
        t = 0.1 * i
        half = {"left_driver_current": amps(t), "right_driver_current": amps(t) + 0.1}
        volts = {f"{name}_voltage": 24.0 for name in ("battery", "left_driver", "right_driver")}
        bag.put(
            topic, t, "husky_msgs/HuskyStatus", header=bag.header(t), mcu_and_user_port_current=2.5, **half, **volts
        )
        bag.odometry("/odom", t, speed(t))
    log, text = suggested(tmp_path, bag)
    near(log.power_w["robot"], 24.0 * (2 * amps(log.time_s) + 2.6), 0.5)
    assert "mcu_and_user_port_current" in text.split("columns:")[1]


def test_numbers_in_an_array(tmp_path: Path) -> None:
    """Volts, milliamperes and milliwatts without a name: the one is the product of the others."""
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        volts, current = battery_volts(t), amps(t)
        data = np.array([volts, 1000 * current, 1000 * volts * current, i % 7], dtype=np.float32)
        bag.put("/power_monitor", t, "std_msgs/Float32MultiArray", data=data)
        bag.odometry("/odom", t, speed(t))
    log, text = suggested(tmp_path, bag)
    near(log.power_w["robot"], battery_volts(log.time_s) * amps(log.time_s), 0.5)
    near(log.number("voltage_robot_v"), battery_volts(log.time_s), 0.1)
    assert "data[0] × data[1] gives data[2]" in text


# further numbers


def further(bag: Bag, begin_s: float = 0.0) -> Bag:
    """A brush that turns with a period of 7 s: a number without a unit, and a field of a message of its own."""
    for i in range(1200):
        t = 0.05 * i
        bag.battery("/battery", t, battery_volts(t), -amps(t))
        bag.odometry("/odom", t, speed(t))
        if t >= begin_s:
            bag.number("/brush_rpm", t, 1200.0 + 300.0 * math.sin(2 * math.pi * t / 7), "std_msgs/Float64")
            fields = {"flow": 2.0 + math.sin(t / 3), "demand": battery_volts(t) * amps(t), "errors": i % 3}
            bag.put("/cleaner/pump", t, "acme_msgs/Pump", header=bag.header(t), **fields)
    return bag


PUMP = "std_msgs/Header header\nfloat64 flow\nfloat64 demand\nint32 errors\nbool low\n"


def test_a_further_number_is_kept_under_its_own_name(tmp_path: Path) -> None:
    log, text = suggested(tmp_path, further(Bag(acme_msgs__Pump=PUMP)))
    near(log.number("brush_rpm"), 1200.0 + 300.0 * np.sin(2 * np.pi * log.time_s / 7), 20.0)
    near(log.number("pump_flow"), 2.0 + np.sin(log.time_s / 3), 0.1)
    kept = text.split("# not used")[0]
    assert "demand" not in kept  # the battery's power again
    assert "header" not in kept


def test_a_number_that_begins_late_takes_no_rows(tmp_path: Path) -> None:
    log, text = suggested(tmp_path, further(Bag(acme_msgs__Pump=PUMP), begin_s=20.0))
    assert log.duration_s == pytest.approx(60.0, abs=0.2)
    assert "/brush_rpm.data" in text.split("# not used")[1]


# motion


def test_a_robot_that_moves_sideways(tmp_path: Path) -> None:
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        bag.odometry("/odom", t, -speed(t), vy=0.3 * math.sin(t))
        bag.battery("/battery", t, battery_volts(t), -amps(t))
    log, _ = suggested(tmp_path, bag)
    near(log.number("speed_m_s"), -speed(log.time_s), 0.02)
    near(log.number("lateral_speed_m_s"), 0.3 * np.sin(log.time_s), 0.02)


def test_an_imu_that_does_not_know_its_attitude(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        bag.odometry("/odom", t, speed(t))
        bag.imu("/imu", t, 0.2, pitch=None)
        bag.battery("/battery", t, battery_volts(t), -amps(t))
    log, text = suggested(tmp_path, bag)
    assert "/imu.orientation" not in text.split("# not used")[0]
    assert log.number("heading_rad") == pytest.approx(0.0)


def test_the_slope_keeps_its_sign_at_rest(tmp_path: Path) -> None:
    """Odometry trembles at rest; the slope is that of the travel before, and before the first that of the first."""
    rng = np.random.default_rng(3)
    bag = Bag()
    for i in range(1200):
        t = 0.05 * i
        drives = -0.5 if 10 < t < 20 else 0.5 if 30 < t < 40 else 0.0
        bag.odometry("/odom", t, drives + rng.normal(0.0, 0.001))
        bag.imu("/imu", t, 0.0, pitch=0.1)
        bag.battery("/battery", t, 24.0, -1.0)
    log, _ = suggested(tmp_path, bag)
    slope, t = log.number("slope_rad"), log.time_s
    np.testing.assert_allclose(slope[t < 29.5], -0.1, atol=1e-3)
    np.testing.assert_allclose(slope[t > 30.5], 0.1, atol=1e-3)


@pytest.mark.parametrize(
    ("topic", "found"), [("/temperature", True), ("/ambient", True), ("/motor/temperature", False)]
)
def test_the_temperature_of_the_air(tmp_path: Path, topic: str, found: bool) -> None:
    bag = Bag()
    for i in range(600):
        t = 0.1 * i
        bag.odometry("/odom", t, speed(t))
        bag.battery("/battery", t, battery_volts(t), -amps(t))
        bag.put(topic, t, "sensor_msgs/Temperature", header=bag.header(t), temperature=21.0 + 0.01 * t)
    log, text = suggested(tmp_path, bag)
    assert ("temp_ambient_c" in log.columns) == found
    if topic == "/temperature":
        assert "temp_ambient_c: temp_ambient  # a guess: its type sensor_msgs/msg/Temperature; of the air?" in text
