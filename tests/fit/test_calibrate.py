"""`calibrate` from the command line and from Python: one reading of the logs, one answer; names that YAML reads so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import missionsim
from missionsim.cli.app import run_command
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.inputs.loading import load_robot
from missionsim.runs import run as run_module
from tests.diagnose.logs import drawing, drive

BASE = "c2*v**2 + c3*v + c4"


def write(folder: Path, seed: int, battery: str = "robot", step_s: float = 0.2, **columns: float) -> None:
    """One log of two minutes; `columns` have one value."""
    folder.mkdir(exist_ok=True)
    log = drive(seed, seconds=120.0, step_s=step_s)
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, len(log))  # a speed that repeats is a copy's
    own = {name.replace("_robot_", f"_{battery}_"): np.asarray(data) for name, data in log.columns.items()}
    own["speed_m_s"] = own["speed_m_s"] + noise * (own["speed_m_s"] > 0.0)
    own |= {name: np.full(len(log), value) for name, value in columns.items()}
    table = np.column_stack(list(own.values()))
    np.savetxt(folder / f"run_{seed}.csv", table, "%.5f", ",", header=",".join(own), comments="")


@pytest.mark.parametrize("most", [1000, 500_000])
def test_python_and_the_command_give_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """The command read all rows and Python averaged many, whose JSON told neither what was left out nor all remarks."""
    monkeypatch.setattr(run_module, "MOST_ROWS", most)
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2, 3):
        write(tmp_path / "logs", seed)
    (tmp_path / "logs" / "bad.csv").write_text("time_s,power_robot_w\n0,1\n1,x\n", encoding="utf-8")
    assert (
        run_command(["calibrate", "--robot", "pioneer3dx", "logs", "--out", "x.yaml", "--json", "x.json", "--quiet"])
        == 1
    )
    told = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    with pytest.warns(UserWarning, match="left out bad: "):
        answer = missionsim.calibrate("pioneer3dx", "logs")
    assert told.pop("robot_file") == "x.yaml"
    assert json.loads(json.dumps(answer.to_json())) == told
    assert answer.text == (tmp_path / "x.yaml").read_text(encoding="utf-8")
    (left,) = told["left_out"]
    assert left.startswith("bad: ")
    assert any("1,800 rows were averaged to 1 s" in remark for remark in told["remarks"]) is (most < 500_000)


def test_a_column_that_the_robot_file_judges_is_judged_by_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The top speed of the file sharpens the check of a log; the command read the logs without the file."""
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2, 3):
        write(tmp_path / "logs", seed)
    text = Path("logs/run_3.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in text[1:]]
    at = text[0].split(",").index("speed_m_s")
    fast = [",".join([*row[:at], f"{3.6 * float(row[at]):.5f}", *row[at + 1 :]]) for row in rows]
    Path("logs/run_3.csv").write_text("\n".join([text[0], *fast]) + "\n", encoding="utf-8")
    run_command(["calibrate", "--robot", "pioneer3dx", "logs", "--out", "x.yaml", "--json", "x.json", "--quiet"])
    told = json.loads(Path("x.json").read_text(encoding="utf-8"))
    with pytest.warns(UserWarning, match="left out run_3"):
        answer = missionsim.calibrate("pioneer3dx", "logs")
    assert answer.to_json()["left_out"] == told["left_out"]


@pytest.mark.parametrize("name", ["true", "null", "yes", "off", "y", "class"])
def test_a_name_stays_that_name_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """It was written without quotes, and read as what YAML makes of it: "must be text, got: true"."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "logs", 1, step_s=1.0)
    words = ["calibrate", "--new", name, "--base", BASE, "logs", "--out", "x.yaml", "--quiet"]
    assert run_command(words) == 0
    assert load_robot("x.yaml").name == name
    assert yaml.safe_load(Path("x.yaml").read_text(encoding="utf-8"))["name"] == name  # by YAML 1.1 too


@pytest.mark.parametrize("name", ["true", "null", "no", "on", "n"])
def test_so_do_batteries_components_and_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "logs", 1, battery=name, step_s=1.0)
    log = Path("logs/run_1.csv")
    log.write_text(log.read_text(encoding="utf-8").replace("on_kinect", f"on_{name}"), encoding="utf-8")
    base = "c2*v**2 + y*v + off"
    assert run_command(["calibrate", "--new", "x", "--base", base, "logs", "--out", "x.yaml", "--quiet"]) == 0
    robot = load_robot("x.yaml")
    assert list(robot.batteries) == [name]
    assert list(robot.components) == [name]
    assert {"y", "off"} <= set(robot.motion.parameters)


def test_a_parameter_within_a_maximum_is_found_though_the_first_step_goes_beyond_its_bend() -> None:
    """There it acts no more, and was called one that these logs cannot tell from the others."""
    rng, logs = np.random.default_rng(3), []
    for seed in range(3):
        log = drive(seed, seconds=300.0, noise=0.002)
        speed, slope = np.asarray(log.number("speed_m_s")), np.repeat(rng.uniform(-0.08, 0.08, 30), 10)
        accel = np.gradient(speed)
        ahead = 1.6 * 30.0 * np.maximum(accel + 9.81 * np.sin(slope) + 9.81 * 0.04, 0.0) * speed
        logs.append(drawing(log, 20.0 + ahead + rng.normal(0.0, 0.1, 300), slope_rad=slope, accel_m_s2=accel))
    base = "k*m*max(a*v + 9.81*v*sin(theta) + 9.81*cr*v, 0) + c0"
    found = calibrate_new(NewRobot("own", base, mass="30 kg"), logs).fit.parameters
    assert found["k"].value == pytest.approx(1.6, rel=0.03)
    assert found["cr"].value == pytest.approx(0.04, rel=0.05)
