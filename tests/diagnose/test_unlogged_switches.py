"""Logs without `on_<component>` columns or with stuck ones: schemes are used, what is unknown is named by nobody."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from missionsim.diagnose import diagnose_files
from missionsim.fit.prepare import prepare
from missionsim.inputs.loading import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.logs import read_logs
from missionsim.runs.error import errors_of

ROBOT = """kind: robot
name: trolley
body: {{mass: 20 kg, drive: differential, max_speed: 1.5 m/s}}
batteries: {{main: {{capacity: 200 Wh}}}}
motion: {{battery: main, model: expression, power: "c*v", parameters: {{c: {{value: 30, sd: 1}}}}}}
components:
  electronics: {{loads: [{{battery: main, power: {{value: 10 W, sd: 0.3 W}}}}], always_on: true}}
  lidar: {{loads: [{{battery: main, power: 8 W}}]}}
  camera: {{loads: [{{battery: main, power: 6 W}}]}}
schemes:
  drive: {{sensors: {{required: {{lidar: 1}}{optional}}}}}
  look: {{sensors: {{required: {{{look}camera: 1}}}}}}
"""


def robot_file(folder: Path, *, always: bool, optional: bool = False) -> Path:
    path = folder / "trolley.yaml"
    look, more = ("lidar: 1, " if always else ""), (", optional: {camera: 1}" if optional else "")
    path.write_text(ROBOT.format(look=look, optional=more), encoding="utf-8")
    return path


def logs(folder: Path, *, scheme: bool, always: bool) -> list[Path]:
    """Runs of a robot whose lidar (8 W) and camera (6 W) follow the scheme, which nobody logs as columns."""
    paths = []
    for run in range(6):
        rng = np.random.default_rng(run)
        rows = 600
        speed = np.repeat(rng.choice([0.0, 0.4, 0.8, 1.2], rows // 20), 20)
        look = np.repeat(rng.random(rows // 60) < 0.4, 60)
        noise = np.zeros(rows)
        for i in range(1, rows):
            noise[i] = 0.8 * noise[i - 1] + 0.3 * rng.standard_normal()
        power = 10 + 30 * speed + 8.0 * (~look | always) + 6.0 * look + noise
        table = {"time_s": np.arange(rows), "power_main_w": power.round(2), "speed_m_s": speed}
        table["cpu_load"] = np.clip(0.3 + 0.4 * look + 0.05 * rng.standard_normal(rows), 0, 1).round(3)
        if scheme:
            table["scheme"] = np.where(look, "look", "drive")
        paths.append(folder / f"run_{run}.csv")
        pd.DataFrame(table).to_csv(paths[-1], index=False)
    return paths


def test_switches_follow_the_logged_scheme(tmp_path: Path) -> None:
    robot, files = robot_file(tmp_path, always=False), logs(tmp_path, scheme=True, always=False)
    found = diagnose_files(robot, files).batteries["main"]
    assert found.verdict == "nothing_missing"
    assert any("lidar" in note and "control scheme" in note for note in found.remarks)
    assert found.heldout is None or found.heldout.energy_error_pct["nominal"] < 1.0
    errors = errors_of(build_power_model(load_robot(robot)), read_logs(files), "main")
    assert errors.run_energy_error_pct < 1.0


def test_what_every_scheme_requires_is_on_and_nothing_else(tmp_path: Path) -> None:
    robot, files = robot_file(tmp_path, always=True), logs(tmp_path, scheme=False, always=True)
    ready = prepare(build_power_model(load_robot(robot)), read_logs(files), "main")
    assert np.all(ready.runs[0].covariates["on_lidar"] == 1.0)
    assert ready.unknown == {"camera": pytest.approx(6.0)}


def test_what_an_unlogged_load_imitates_is_not_named(tmp_path: Path) -> None:
    robot, files = robot_file(tmp_path, always=False, optional=True), logs(tmp_path, scheme=False, always=True)
    for path in files:
        table = pd.read_csv(path)
        table["cpu_load"] = np.where(table["cpu_load"] > 0.5, 0.7, 0.3)
        table.to_csv(path, index=False)
    found = diagnose_files(robot, files).batteries["main"]
    # the camera draws with the processor load: cpu_load alone would be a confident wrong name
    (effect,) = found.effects
    assert effect.effect == "cpu_load"
    assert "component_power:camera" in effect.indistinguishable_from
    assert "on_camera in the log" in found.next_experiments[0].do
    assert not found.proposed_laws
    assert any("camera" in note and "on_<component>" in note for note in found.remarks)


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_a_law_of_motion_is_proposed_beside_an_unlogged_load(tmp_path: Path) -> None:
    """Driving in curves with payload costs what no effect has; turning_scrub and payload would only stand in for it."""
    robot, rng = robot_file(tmp_path, always=False), np.random.default_rng(7)
    for path in logs(tmp_path, scheme=False, always=True):
        table = pd.read_csv(path)
        yaw = np.repeat(rng.choice([0.0, 0.0, 0.4, 0.9], len(table) // 15), 15) * (table["speed_m_s"] > 0)
        payload = rng.choice([0.0, 2.0, 4.0, 6.0])
        table["power_main_w"] += 2.0 * table["speed_m_s"] * yaw * payload
        table["yaw_rate_rad_s"], table["payload_kg"] = yaw, payload
        table.drop(columns="cpu_load").to_csv(path, index=False)
    found = diagnose_files(robot, sorted(tmp_path.glob("run_*.csv"))).batteries["main"]
    assert found.remarks
    (law,) = found.proposed_laws
    assert {"speed_m_s", "yaw_rate_rad_s", "payload_kg"} == set(law.certain)
    assert not {"turning_scrub", "payload"} & {effect.effect for effect in found.effects}


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_a_column_stuck_at_zero_makes_nobody_sure(shared: Path, tmp_path: Path) -> None:
    """The camera makes the processor work; with its column stuck at 0 the processor alone must not be named."""
    for path in sorted((shared / "practice" / "nothing-0" / "train").glob("*.csv")):
        table = pd.read_csv(path)
        table["on_kinect"] = 0
        table.to_csv(tmp_path / path.name, index=False)
    found = diagnose_files("pioneer3dx", [tmp_path]).batteries["robot"]
    assert found.verdict == "ambiguous"
    assert found.effects[0].indistinguishable_from == ("component_power:kinect",)
    assert "on_kinect" in found.next_experiments[0].do
    assert "on_kinect changes: it is 0 in every row here" in found.next_experiments[0].do
