"""`import --suggest` on what loggers and ground stations export: headers as they are, several meters, files to join."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
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


@pytest.mark.parametrize("under", [("s,mph,kW,deg/s",), ("s,mph,kW,deg/s", ""), ("", "s,mph,kW,deg/s", "", "")])
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


def test_a_turn_rate_is_no_power(tmp_path: Path) -> None:
    words = tmp_path / "run" / "serial.txt"
    files = [write(tmp_path / "run" / "odom.csv", {"time": T, "v": V, "w": YAW}), words]
    words.write_text("".join(f"{t} -> Bus Voltage: {v:.2f} V\n" for t, v in zip(T, VOLTS, strict=True)))
    made = tmp_path / "made.yaml"
    assert main(["import", *map(str, files), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert "power_robot_w: POWER" in made.read_text()
