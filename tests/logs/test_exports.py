"""`import --suggest` on what loggers and ground stations export: headers as they are, several meters, files to join."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.importer.roles import UNITS, words_of
from missionsim.logs import LogTable, read_log
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.1).round(1)
W, V, YAW = loggers.power(T), loggers.speed(T), loggers.turn(T)
WH = float(W.sum() * 0.1 / 3600)


def write(path: Path, columns: Mapping[str, object], under: tuple[str, ...] = ()) -> Path:
    """A table; `under`: lines beneath the names."""
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="") as handle:
        lines = csv.writer(handle, lineterminator="\n")
        lines.writerow(columns)
        handle.writelines(f"{line}\n" for line in under)
        lines.writerows(zip(*(np.broadcast_to(one, T.shape) for one in columns.values()), strict=True))  # type: ignore[call-overload]
    return path


def suggested(*paths: Path, code: int = 0) -> tuple[LogTable, str]:
    """The log that the suggested map makes of files, as it was suggested, and that map."""
    made, out = paths[0].parent.parent / "made.yaml", paths[0].parent.parent / "out.parquet"
    assert main(["import", *map(str, paths), "--suggest", "--out", str(made), "--quiet"]) == code
    assert main(["import", *map(str, paths), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return read_log(out), made.read_text()


@pytest.mark.parametrize(
    "under", [("s,mph,kW,deg/s",), ("s,mph,kW,deg/s", ""), ("", "made by hand", "s,mph,kW,deg/s", "", "")]
)
def test_a_line_of_units_with_empty_lines_about_it(tmp_path: Path, under: tuple[str, ...]) -> None:
    columns = {"Time": T, "Ground Speed": V / 0.44704, "Battery Power": W / 1e3, "Gyro Yaw Rate": np.degrees(YAW)}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns, under))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)


VOLTS = 25.0 - W / 50


def test_the_battery_of_another_device_is_not_the_packs(tmp_path: Path) -> None:
    columns = {"Time": T, "GSpd(kmh)": 3.6 * V, "RxBt(V)": VOLTS, "Curr(A)": W / VOLTS, "TxBat(V)": 8.4 - T / 1e3}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


@pytest.mark.parametrize("other", ["Remote Battery [V]", "watch_battery_V", "RTC Voltage", "coin cell (V)", "vbus_V"])
def test_a_voltage_of_something_else_or_that_never_changes(tmp_path: Path, other: str) -> None:
    columns = {"t": T, "speed": V, other: 3.0, "pack_V": VOLTS, "I [A]": W / VOLTS}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


ODOMETRY = {"time": T, "linear.x": V, "angular.z": YAW}


def test_rails_of_a_computer_beside_an_odometry(tmp_path: Path) -> None:
    milli = (1000 * W).round()
    columns = {"time": T, "Power SOC": (milli / 5).round(), "Power CPU": (milli / 4).round(), "Power TOT": milli}
    files = [write(tmp_path / "run" / "jtop.csv", columns), write(tmp_path / "run" / "odom.csv", ODOMETRY)]
    assert suggested(*files)[0].energy_wh("robot") == pytest.approx(WH, rel=0.01)


@pytest.mark.parametrize("meter", [{"V": VOLTS, "A": W / VOLTS}, {"pack_mV": 1e3 * VOLTS, "pack_mA": 1e3 * W / VOLTS}])
@pytest.mark.parametrize("joined", [True, False])
def test_v_and_w_are_speed_and_turn_rate(tmp_path: Path, meter: dict[str, np.ndarray], joined: bool) -> None:
    moves, folder = {"v": V, "w": YAW}, tmp_path / "run"
    if joined:
        files = [write(folder / "meter.csv", {"time": T, **meter}), write(folder / "odom.csv", {"time": T, **moves})]
    else:
        files = [write(folder / "a.csv", {"time": T, **meter, **moves})]
    log, text = suggested(*files)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)
    assert "a guess: w beside v" in text


def test_letters_in_messages_are_units_but_for_those_of_motion(tmp_path: Path) -> None:
    rows = zip(T.tolist(), VOLTS.tolist(), (W / VOLTS).tolist(), V.tolist(), YAW.tolist(), strict=True)
    lines = [{"ts": 1.7e9 + t, "data": {"v": u, "a": i}, "odom": {"v": v, "w": w}} for t, u, i, v, w in rows]
    path = tmp_path / "run" / "a.jsonl"
    path.parent.mkdir()
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    log, _ = suggested(path)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)


def test_a_turn_rate_is_no_power(tmp_path: Path) -> None:
    words = tmp_path / "run" / "serial.txt"
    files = [write(tmp_path / "run" / "odom.csv", {"time": T, "v": V, "w": YAW}), words]
    words.write_text("".join(f"{t} -> Bus Voltage: {v:.2f} V\n" for t, v in zip(T, VOLTS, strict=True)))
    made = tmp_path / "made.yaml"
    assert main(["import", *map(str, files), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert "power_robot_w: POWER" in made.read_text()


def test_the_power_of_a_motor_that_the_battery_feeds_is_no_consumer_of_its_own(tmp_path: Path) -> None:
    heat = np.where(T % 20 < 10, 3.0, 0.0)
    columns = {"t": T, "Speed": V, "Pack Volts": VOLTS, "Pack Amps": (W + heat) / VOLTS}
    columns |= {"Motor Pwr(w)": 0.9 * W + T % 3 / 9, "Heater Pwr(w)": heat}
    _, text = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert "motor_pwr_w:" not in text
    assert "heater_pwr_w: " in text


PITCH = 0.1 * np.sin(T / 9.0)
YAWS = np.cumsum(YAW) * 0.1


@pytest.mark.parametrize("name", ["q[{}]", "q{}", "q_{}"])
def test_parts_of_a_quaternion_are_no_slope(tmp_path: Path, name: str) -> None:
    half, turned = PITCH / 2, -YAWS / 2  # down is positive: nose up turns about y, right turns about z
    parts = (
        np.cos(half) * np.cos(turned),
        -np.sin(half) * np.sin(turned),
        np.sin(half) * np.cos(turned),
        np.cos(half) * np.sin(turned),
    )
    columns = {name.format(index): part for index, part in enumerate(parts)}
    stamp, run = {"timestamp": (1e6 * (T + 35)).astype(int)}, tmp_path / "run"
    files = [
        write(run / "log_1_battery_status_0.csv", {**stamp, "voltage_v": VOLTS, "current_a": W / VOLTS}),
        write(run / f"log_1_{'vehicle_' * ('[' in name)}attitude_0.csv", {**stamp, **columns}),
        write(run / "log_1_vehicle_local_position_0.csv", {**stamp, "vx": V, "vy": 0 * V, "heading": -YAWS}),
    ]
    log, text = suggested(*files)
    if "[" in name:  # PX4, which says what they are
        assert np.abs(log.number("slope_rad") - np.interp(log.time_s, T, PITCH)).max() < 0.02
        return
    assert "\n  slope_rad:" not in text
    assert "are a quaternion, perhaps" in text


@pytest.mark.parametrize("steady", [True, False])
def test_a_speed_that_is_commanded_beside_velocities(tmp_path: Path, steady: bool) -> None:
    speed = np.where(T < 60, 4.0, 4.0 if steady else 6.0)
    columns = {"time": T, "power": W, "velocity_x": 0.6 * V, "velocity_y": 0.8 * V, "velocity_z": 0.0, "speed": speed}
    columns |= {"angular_x": YAW / 50, "angular_y": YAW / 40, "angular_z": YAW}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)


@pytest.mark.parametrize(
    ("name", "factor"), [("axis{}.encoder.vel_estimate", 1.0), ("Feedback {} (RPM)", 60.0), ("motor_{}_velocity", 6.28)]
)
def test_turns_of_two_wheels_ask_for_their_radius(tmp_path: Path, name: str, factor: float) -> None:
    columns = {"time": T, "power": W, name.format(0): factor * (V - YAW / 9), name.format(1): -factor * (V + YAW / 9)}
    made = tmp_path / "made.yaml"
    path = write(tmp_path / "a.csv", columns)
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert "constants: {wheel_radius: RADIUS m}" in made.read_text()
    made.write_text(made.read_text().replace("RADIUS", "0.1"))
    assert main(["import", str(path), "--map", str(made), "--out", str(tmp_path / "a.parquet"), "--quiet"]) == 0
    factor = factor if "RPM" not in name else 2 * np.pi
    assert read_log(tmp_path / "a.parquet").number("speed_m_s").max() == pytest.approx(0.1 * factor * V.max(), rel=0.01)


def test_two_currents_of_one_voltage_are_added_with_a_question(tmp_path: Path) -> None:
    columns = {"t": T, "v": V, "Battery Amps 1 (A)": 0.4 * W / VOLTS, "Battery Amps 2 (A)": 0.6 * W / VOLTS}
    log, text = suggested(write(tmp_path / "run" / "a.csv", columns | {"Battery Volts (V)": VOLTS}), code=1)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert "TO DO: 2 currents were added up" in text


@pytest.mark.parametrize("unit", [1.0, 180 / np.pi])
def test_a_heading_of_several_turns_is_told_by_the_turn_rate(tmp_path: Path, unit: float) -> None:
    theta = unit * np.cumsum(YAW + 0.2) * 0.1
    columns = {"time": T, "power": W, "v": V, "yaw_rate": YAW + 0.2, "theta": theta}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert np.ptp(log.number("heading_rad")) == pytest.approx(np.ptp(theta) / unit, rel=0.01)


def test_an_error_does_not_end_with_nought(tmp_path: Path) -> None:
    way = 1e-6 * np.cumsum(V) * 0.1
    path = write(tmp_path / "a.csv", {"time_s": T, "power_robot_w": W, "speed_m_s": V, "x_m": way, "y_m": 0.0})
    names = ", ".join(f"{name}: {name}" for name in ("time_s", "power_robot_w", "speed_m_s", "x_m", "y_m"))
    made, out = tmp_path / "made.yaml", str(tmp_path / "a.parquet")
    made.write_text(f"kind: map\nname: a\ncolumns: {{{names}}}\n")
    assert main(["import", str(path), "--map", str(made), "--out", out, "--quiet"]) == 1
    made.write_text(made.read_text().partition(", x_m")[0] + "}\n")
    assert main(["import", str(path), "--map", str(made), "--out", out, "--quiet"]) == 0


def test_degrees_are_no_positions(tmp_path: Path) -> None:
    way = np.cumsum(V) * 0.1
    columns = {"t": T, "power": W, "speed": V, "position_x": -79.78 + way / 85e3, "position_y": 40.45 + way / 999e3}
    _, text = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert "x_m:" not in text


@pytest.mark.parametrize("better", [False, True])
def test_the_speed_of_a_receiver_where_there_is_no_better_one(tmp_path: Path, better: bool) -> None:
    run = tmp_path / "run"
    files = [
        write(run / "BAT.csv", {"timestamp": 1.7e9 + T, "Volt": VOLTS, "Curr": W / VOLTS}),
        write(run / "GPS.csv", {"timestamp": 1.7e9 + T, "Spd": V if not better else V / 2, "NSats": T % 3 + 9}),
    ]
    if better:
        files.append(write(run / "odom.csv", {"timestamp": 1.7e9 + T, "Spd": V}))
    log, _ = suggested(*files)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)


def test_a_power_that_is_less_than_a_part_is_not_all(tmp_path: Path) -> None:
    columns = {"t": T, "v": V, "motor_power": W - 3.0, "electronics_power": 3.0 + 0.1 * np.sin(T)}
    log, text = suggested(write(tmp_path / "run" / "a.csv", columns), code=1)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert "TO DO: 'electronics_power' is less than 'motor_power'" in text


def test_channels_of_a_meter_are_asked_for(tmp_path: Path) -> None:
    columns = {"ms": 1e3 * T, "CH1_V": VOLTS, "CH1_mA": 400 * W / VOLTS, "CH2_V": 5 + 0 * T, "CH2_mA": 120 * W}
    _, text = suggested(write(tmp_path / "run" / "a.csv", columns | {"speed_m_s": V}), code=1)
    assert "TO DO: there are more currents, which were not added: CH2_mA" in text


COUNTS = np.round(np.cumsum(V) * 0.1 / 0.004)


@pytest.mark.parametrize(
    ("moves", "within"),
    [
        ({"velocity": V, "yawSpeed": YAW}, 0.001),
        ({"monotonic": 8e4 + T, "v": V, "Gierrate (U/min)": YAW * 30 / np.pi}, 0.001),
        ({"speed_m_s": V, "Gyro Z (mdps)": np.degrees(YAW) * 1e3}, 0.001),
        ({"TX (mm)": 100 * np.cumsum(V), "TY (mm)": 0.0 * T}, 0.05),
        ({"lat": 48 + 0.1 * np.cumsum(V) / 111_195, "lon": 11 + 0 * T, "heading": 0.1 * np.cumsum(YAW)}, 0.05),
        ({"lat": 48 + 0 * T, "Longitude": 11 + 0.1 * np.cumsum(V) / 111_195 / np.cos(np.radians(48))}, 0.05),
    ],
)
def test_speeds_and_turns_by_other_names(tmp_path: Path, moves: dict[str, np.ndarray], within: float) -> None:
    time = {} if "monotonic" in moves else {"t": T}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", time | {"power_w": W} | moves))
    assert log.number("speed_m_s").mean() == pytest.approx(V.mean(), abs=within)
    if any("aw" in name or "yro" in name or "Gier" in name for name in moves):
        assert np.abs(log.number("yaw_rate_rad_s")).max() == pytest.approx(np.abs(YAW).max(), rel=0.01)


@pytest.mark.parametrize("names", [("left_ticks", "right_ticks"), ("encL", "encR"), ("Encoder Left", "Encoder Right")])
def test_counts_of_encoders_ask_for_their_way(tmp_path: Path, names: tuple[str, str]) -> None:
    counts = np.where(np.arange(len(T)) == 7, np.nan, COUNTS)  # one was lost
    columns = {"t": T, "power_w": W} | dict.fromkeys(names, counts)
    made = tmp_path / "made.yaml"
    path = write(tmp_path / "run" / "a.csv", columns)
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert "TO DO: counts of wheels" in made.read_text()
    made.write_text(made.read_text().replace("METRES", "0.004"))
    assert main(["import", str(path), "--map", str(made), "--out", str(tmp_path / "a.parquet"), "--quiet"]) == 0
    assert read_log(tmp_path / "a.parquet").number("speed_m_s").mean() == pytest.approx(V.mean(), abs=0.02)


def test_parts_beside_volts_and_amperes_are_not_added_up(tmp_path: Path) -> None:
    columns = {"t": T, "v": V, "Pack Volts": VOLTS, "Pack Amps": W / VOLTS, "Motor Pwr(w)": 1.1 * W, "Aux Pwr": 2 + V}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_voltages_and_currents_in_arrays_are_asked_for(tmp_path: Path) -> None:
    columns = {"measured_voltages_0": VOLTS, "measured_voltages_1": 12.0 + 0 * T, "measured_currents_0": W / VOLTS}
    path = write(tmp_path / "run" / "a.csv", {"time": T, "v": V, **columns, "measured_currents_1": 0.8 + V})
    log, text = suggested(path, code=1)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert "more currents, which were not added: measured_currents_1" in text


def test_names_under_lines_of_devices_and_their_numbers(tmp_path: Path) -> None:
    path = write(tmp_path / "run" / "a.csv", {"Frame": 10 * T, "Time (Seconds)": T, "power_w": W, "Speed (m/s)": V})
    above = 'Format Version,1.23,Take Name,run\n\n,,Rigid Body,Rigid Body\n,,robot,robot\n,,"1","1"\n,,Power,Pace\n'
    path.write_text(above + path.read_text())
    assert suggested(path)[0].energy_wh("robot") == pytest.approx(WH, rel=0.01)


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("Speed (kmph)", "km/h", 1 / 3.6), ("speed_kmph", "km/h", 1 / 3.6), ("Speed [Mph]", "mph", 0.44704),
        ("Speed (KM/H)", "km/h", 1 / 3.6), ("speed_cmps", "cm/s", 0.01), ("vel_mm_per_s", "mm/s", 1e-3),
        ("gyro_z_degps", "deg/s", np.pi / 180), ("Yaw rate [DEG/S]", "deg/s", np.pi / 180), ("P_uW", "uW", 1e-6),
        ("energy_mwh", "mWh", 1e-3), ("Current (Milliamps)", "mA", 1e-3), ("Power (MW)", "mW", 1e-3),
    ],
)  # fmt: skip
def test_units_as_people_write_them(name: str, unit: str, factor: float) -> None:
    assert words_of(name)[1] == unit
    assert UNITS[unit][1] == pytest.approx(factor)


def test_the_w_of_a_quaternion_is_no_power(tmp_path: Path) -> None:
    half = 0.05 * np.cumsum(YAW)
    pose = {"Time (Seconds)": T, "X": 0 * T, "Y": 0 * T, "Z": np.sin(half), "W": np.cos(half)}
    files = {"take": pose, "meter": {"t": T, "V": VOLTS, "I": W / VOLTS}}
    log, _ = suggested(*(write(tmp_path / "run" / f"{name}.csv", one) for name, one in files.items()))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_a_meter_in_a_file_of_a_status(tmp_path: Path) -> None:
    meter = {"time": T, "measured_voltages_0": VOLTS, "measured_currents_0": W / VOLTS}
    files = {"mcu_status_power": meter, "odom": {"time": T, "linear_x": V, "angular_z": YAW}}
    log, _ = suggested(*(write(tmp_path / "run" / f"{name}.csv", one) for name, one in files.items()))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_the_name_of_a_file_makes_no_current_that_of_the_whole_robot(tmp_path: Path) -> None:
    amps = W / VOLTS / 2 - 0.1
    meter = {
        "Time": T,
        "mcu_and_user_port_current": 0.2 + 0 * T,
        "left_driver_current": amps,
        "right_driver_current": amps,
    }
    meter |= {"battery_voltage": VOLTS, "left_driver_voltage": VOLTS, "right_driver_voltage": VOLTS}
    files = {"husky_robot-status": meter, "odometry": {"Time": T, "linear_x": V, "angular_z": YAW}}
    log, _ = suggested(*(write(tmp_path / "run" / f"{name}.csv", one) for name, one in files.items()))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_meters_of_parts_are_added_up_with_a_question(tmp_path: Path) -> None:
    """Only what the computer took had been the robot's."""
    watts = loggers.power(T)
    parts = {"logic_voltage": 0 * T + 12.0, "logic_current": 0 * T + 0.5}
    parts |= {"motor_voltage": 0 * T + 24.0, "motor_current": (watts - 6.0) / 24.0}
    log, _ = suggested(write(tmp_path / "a.csv", {"t": T} | parts), code=1)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    sides = {
        f"{side}_{what}": 0 * T + 5.0 for side in ("in", "out") for what in ("voltage", "current")
    }  # of a converter
    log, _ = suggested(write(tmp_path / "c.csv", {"t": T} | sides))
    assert log.energy_wh("robot") == pytest.approx(25.0 * loggers.LENGTH_S / 3600.0, rel=0.01)
    whole = {"battery_voltage": 0 * T + 24.0, "battery_current": watts / 24.0}
    log, _ = suggested(write(tmp_path / "b.csv", {"t": T} | parts | whole))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_drivers_whose_names_end_in_units(tmp_path: Path) -> None:
    watts, columns = loggers.power(T), {"t": T}
    for side in ("left", "right"):
        columns |= {f"{side}_voltage_mV": 0 * T + 24e3, f"{side}_current_mA": 1e3 * watts / 48.0}
    log, _ = suggested(write(tmp_path / "a.csv", columns))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_units_of_registers(tmp_path: Path) -> None:
    """Tenths of volts were volts; what stands in brackets may also be a rail."""
    head = {"t": T, "Voltage(0.1V)": 0 * T + 240.0, "Current(10mA)": 100 * loggers.power(T) / 24.0}
    log, _ = suggested(write(tmp_path / "a.csv", head))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert words_of("Current (12V)")[1] == ""


@pytest.mark.parametrize("units", ["V A Ws", "uV uA J"])
def test_decimal_commas_in_quotes_and_small_units(tmp_path: Path, units: str) -> None:
    volt, ampere, energy = units.split()
    size = 1e6 if volt == "uV" else 1.0
    columns = {"t [s]": T, f"U [{volt}]": VOLTS * size, f"I [{ampere}]": W / VOLTS * size}
    rows = zip(*columns.values(), strict=True)
    text = "\n".join(",".join(f'"{x:.3f}"'.replace(".", ",") for x in row) for row in rows)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "a.csv").write_text(",".join(columns) + "\n" + text + "\n")
    log, _ = suggested(tmp_path / "run" / "a.csv")
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    log, _ = suggested(write(tmp_path / "run" / "b.csv", {"t": T, f"Energy ({energy})": np.cumsum(W) * 0.1}))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
