"""A mission outside the logs that an effect was fitted to is told; inside them nothing is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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


def test_a_slope_beyond_the_logs_is_told(tmp_path: Path) -> None:
    logs = str(ROOT / "docs" / "examples" / "ramp_runs")
    robot = tmp_path / "graded.yaml"
    command = ["add-effect", "--robot", "pioneer3dx", "--effect", "grade", logs, "--out", str(robot), "--quiet"]
    assert run_command(command) == 0
    low, high = next(e for e in load_robot(robot).effects if e.effect == "grade").origin["range"]["slope_rad"]
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
