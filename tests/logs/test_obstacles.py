"""What stands in the way of a diagnosis is told; logs that are fine are left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map, load_robot
from missionsim.logs import LogTable, read_log
from tests.logs.conftest import motion, write_csv


def obstacles(tmp_path: Path, columns: dict[str, np.ndarray], **more: object) -> dict[str, str]:
    log = read_log(write_csv(tmp_path / "run.csv", columns), **more)  # type: ignore[arg-type]
    return {remark.column: remark.message for remark in log.remarks if remark.kind == "obstacle"}


def measured(**changes: np.ndarray) -> dict[str, np.ndarray]:
    columns = motion(1200, 0.1)
    volts = np.full(1200, 24.0)
    return {**columns, "voltage_robot_v": volts, "current_robot_a": columns["power_robot_w"] / volts, **changes}


def test_a_good_log_has_none(tmp_path: Path) -> None:
    assert obstacles(tmp_path, measured()) == {}


def test_a_current_that_wraps(tmp_path: Path) -> None:
    true = 2.0 * np.sin(np.arange(1200) / 60.0) + 0.3
    columns = measured(current_robot_a=np.mod(true, 65.536))
    del columns["power_robot_w"]
    assert "65.536" in obstacles(tmp_path, columns)["current_robot_a"]
    columns["current_robot_a"] = np.where(np.arange(1200) // 100 % 2, 25.0, 1.0)  # a load that is switched
    assert obstacles(tmp_path, columns) == {}


def test_a_gauge(tmp_path: Path) -> None:
    columns = motion(1200, 1.0)
    energy = np.cumsum(columns.pop("power_robot_w")) / 3600
    columns["energy_robot_wh"] = np.floor(energy / 0.3) * 0.3
    assert "a gauge in steps" in obstacles(tmp_path, columns)["energy_robot_wh"]
    columns["energy_robot_wh"] = energy
    assert obstacles(tmp_path, columns) == {}


def test_a_meter_that_smooths(tmp_path: Path) -> None:
    columns = motion(1200, 0.25)
    power = columns["power_robot_w"].copy()
    for row in range(1, len(power)):
        power[row] = power[row - 1] + 0.25 / 2.5 * (power[row] - power[row - 1])
    assert "smoothed over about 2 s" in obstacles(tmp_path, {**columns, "power_robot_w": power})["power_robot_w"]


def test_hills_are_no_meter_that_smooths(tmp_path: Path) -> None:
    """The faster a robot drives the steeper it climbs, metres later."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0.125, 300.0, 0.25)
    speed = np.repeat(rng.choice([0.4, 0.5, 0.6], 60), rng.integers(24, 60, 60))[: len(time_s)]
    slope = np.zeros(len(time_s))
    for row in range(1, len(slope)):
        slope[row] = 0.94 * slope[row - 1] + 0.06 * 1.2 * (speed[row] - 0.5)
    power = 19.0 + 10.0 * speed + 300.0 * speed * np.sin(slope) + rng.normal(0.0, 0.1, len(time_s))
    columns = {"time_s": time_s, "power_robot_w": power, "speed_m_s": speed}
    assert "smoothed" in obstacles(tmp_path, columns)["power_robot_w"]
    assert obstacles(tmp_path, {**columns, "slope_rad": slope}) == {}


def test_a_speed_from_gnss(tmp_path: Path) -> None:
    columns = motion(1200, 0.1)
    columns["speed_m_s"] = np.repeat(columns["speed_m_s"][::10], 10)
    assert "changes every 1 s only" in obstacles(tmp_path, columns)["speed_m_s"]


def test_components_that_no_column_speaks_of(tmp_path: Path) -> None:
    robot = load_robot("pioneer3dx")
    first = next(iter(robot.components))
    assert first in obstacles(tmp_path, motion(), robot=robot)[""]
    switched = {f"on_{name}": np.arange(400) % 2 for name in robot.components}
    assert "" not in obstacles(tmp_path, {**motion(), **switched}, robot=robot)


@pytest.fixture(scope="module")
def good(shared: Path, root: Path) -> dict[str, list[LogTable]]:
    """Every measured log there is, and the little worlds' logs."""
    data, maps = shared / "data", root / "docs" / "maps"
    return {
        "car": [read_log(path) for path in sorted((data / "i3_trips").glob("*/trip*.csv"))],
        "floors": [read_log(path) for path in sorted((data / "husky_floors").glob("*/*.csv"))],
        "warthog": import_source(data / "warthog_drive", load_map(maps / "warthog.yaml")),
        "turtlebot": import_source(
            data / "turtlebot3_msr2021" / "tb3_power_2hz.csv", load_map(maps / "turtlebot3.yaml")
        ),
        "worlds": [read_log(path) for path in sorted((shared / "practice").glob("*-0/*/*.csv"))],
    }


def test_good_logs_raise_few_warnings(good: dict[str, list[LogTable]]) -> None:
    for logs in good.values():
        warned = [log.run for log in logs if any(remark.severity != "note" for remark in log.remarks)]
        assert len(warned) <= 0.06 * len(logs) + 1, warned
    total = [log for logs in good.values() for log in logs]
    told = sum(any(remark.severity != "note" for remark in log.remarks) for log in total)
    assert told < len(total) / 20


def test_no_clock_is_told_to_shift_where_clocks_agree(good: dict[str, list[LogTable]]) -> None:
    assert not [log.run for log in good["car"] + good["floors"] for r in log.remarks if r.kind == "clock"]
