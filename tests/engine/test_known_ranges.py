"""A mission outside the logs that an effect was fitted to is told; inside them nothing is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import missionsim
from missionsim.cli.app import run_command
from missionsim.inputs.loading import load_robot

ROOT = Path(__file__).parents[2]
SITE = """kind: environment
name: yard
places: {{a: {{}}, b: {{}}}}
edges: [{{name: ramp_2, from: a, to: b, length: 20 m, slope: {slope}}}]
"""
MISSION = """kind: mission
name: up
robot: graded.yaml
environment: yard.yaml
start: a
segments: [{drive: {to: b, speed: 0.4 m/s}}]
"""
ROBOT = """kind: robot
name: graded
body: {{mass: 20 kg, drive: differential, max_speed: 1 m/s}}
origin: {{range: {range}}}
batteries:
  robot: {{capacity: 100 Wh}}
motion:
  battery: robot
  model: polynomial
  parameters: {{c2: 6, c3: 10, c4: 4, standing: 3}}
schemes:
  drive: {{motion: true}}
"""


@pytest.mark.usefixtures("effects_alone")
def test_a_slope_beyond_the_logs_is_told(tmp_path: Path) -> None:
    logs = [str(path) for path in sorted((ROOT / "docs" / "examples" / "ramp_runs").glob("*.csv"))[:5]]
    robot = tmp_path / "graded.yaml"
    command = ["add-effect", "--robot", "pioneer3dx", "--effect", "grade", *logs, "--holdout", "none", "--quiet"]
    assert run_command([*command, "--out", str(robot)]) == 0
    low, high = load_robot(robot).origin["range"]["slope_rad"]
    assert -0.2 < low < 0.0 < high < 0.2
    (tmp_path / "up.yaml").write_text(MISSION, encoding="utf-8")
    told = {}
    for slope in ("3 deg", "9 deg"):
        (tmp_path / "yard.yaml").write_text(SITE.format(slope=slope), encoding="utf-8")
        result = missionsim.simulate(missionsim.load_mission(tmp_path / "up.yaml"))
        told[slope] = [fault.message for fault in result.warnings]
    assert not told["3 deg"]
    (message,) = told["9 deg"]
    assert message.startswith("slope 9 °")
    assert f"{np.degrees(low):.3g} to {np.degrees(high):.3g} °" in message


def test_the_segment_that_is_named_is_the_one_of_the_value(tmp_path: Path) -> None:
    (tmp_path / "graded.yaml").write_text(ROBOT.format(range="{slope_rad: [-0.03, 0.03]}"), encoding="utf-8")
    steep = "edges: [{name: steep, from: b, to: c, length: 20 m, slope: 9 deg}, "
    site = SITE.format(slope="5 deg").replace("b: {}}", "b: {}, c: {}}").replace("edges: [", steep)
    (tmp_path / "yard.yaml").write_text(site, encoding="utf-8")
    (tmp_path / "up.yaml").write_text(MISSION.replace("}]", "}, {drive: {to: c}}]"), encoding="utf-8")
    result = missionsim.simulate(missionsim.load_mission(tmp_path / "up.yaml"))
    (message,) = [fault.message for fault in result.warnings]
    assert message.startswith("slope 9 ° in segment 'drive c' and 1 more")


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("[1, 2]", "4:17: error: must be a mapping"),
        ("{slope_rad: steep}", "4:29: error: must be the least and the greatest value"),
        ("{slope_rad: [0.2, -0.2]}", "4:29: error: must be the least and the greatest value"),
        ("{slope_rad: [0 deg, 2 deg], surface: tiles}", "4:54: error: must be the names of floors"),
        ("{slop_rad: [0, 1]}", "did you mean: slope_rad"),
    ],
)
def test_a_range_that_says_nothing_is_refused(
    tmp_path: Path, written: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "graded.yaml"
    path.write_text(ROBOT.format(range=written), encoding="utf-8")
    assert run_command(["validate", str(path)]) == 2
    assert told in capsys.readouterr().err


def test_calibrate_writes_the_ranges_and_other_floors_are_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 120.0, 0.5)
    speed = np.where(time < 20.0, 0.0, 0.4 + 0.2 * np.sin(time / 9.0))
    power = np.where(speed > 0.0, 12.0 + 20.0 * speed, 5.0) + 0.1 * rng.normal(size=time.size)
    rows = ["time_s,speed_m_s,slope_rad,surface,power_main_w"]
    rows += [f"{t},{v:.4f},0.0,paved,{p:.4f}" for t, v, p in zip(time, speed, power, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    robot, again = tmp_path / "graded.yaml", tmp_path / "again.yaml"
    new = ["calibrate", str(tmp_path / "log.csv"), "--new", "hauler", "--base", "a*v + b", "--capacity", "50 Wh"]
    assert run_command([*new, "--max-speed", "1 m/s", "--out", str(robot), "--quiet"]) == 0
    refit = ["calibrate", str(tmp_path / "log.csv"), "--robot", str(robot), "--out", str(again), "--quiet"]
    assert run_command(refit) == 0
    for path in (robot, again):
        found = load_robot(path).origin["range"]
        assert found["speed_m_s"] == [0.0, float(f"{speed.max():.4g}")]
        assert found["surface"] == ["paved"]
    site = SITE.replace("slope: {slope}", "slope: 4 deg, surface: gravel").replace("{{", "{").replace("}}", "}")
    (tmp_path / "yard.yaml").write_text(site, encoding="utf-8")
    (tmp_path / "up.yaml").write_text(MISSION.replace("0.4 m/s", "0.9 m/s"), encoding="utf-8")
    told = " ".join(w.message for w in missionsim.simulate(missionsim.load_mission(tmp_path / "up.yaml")).warnings)
    assert "speed 0.9 m/s" in told
    assert "slope 4 °" in told
    assert "floor 'gravel'" in told
