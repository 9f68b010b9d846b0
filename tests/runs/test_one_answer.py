"""One question, one number: compare, diagnose, improve, add-effect and calibrate agree in what they print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.effects.timeline import Timeline
from missionsim.engine.simulate import simulate
from missionsim.inputs import load_mission
from missionsim.logs import read_log
from missionsim.runs.motion import mean_ratio, motions, planned, still_of, tracking

pytestmark = pytest.mark.usefixtures("examined_once")

BASE = """kind: robot
name: skid
title: a skid-steered robot made for this test
body: {mass: 60 kg, drive: skid_steer, max_speed: 1.2 m/s}
batteries: {robot: {capacity: 400 Wh}}
motion:
  battery: robot
  model: expression
  power: "c2*v**2 + c3*v + c4"
  standing: standing
  parameters: {c2: {value: 40, sd: 2}, c3: {value: 55, sd: 3}, c4: {value: 30, sd: 1}, standing: {value: 28, sd: 1}}
schemes: {drive: {motion: true}}
"""


def run(*arguments: object) -> int:
    return run_command([str(argument) for argument in arguments])


def skid_logs(folder: Path, runs: int, count: int) -> None:
    """Drives of a skid-steered robot that scrubs in turns; formulas written here, nothing of the library."""
    folder.mkdir()
    for number in range(runs):
        rng = np.random.default_rng(100 + number)
        piece = np.arange(count) // 12
        speed = rng.choice([0.0, 0.3, 0.6, 0.9, 1.1], piece[-1] + 1)[piece]
        yaw = rng.choice([0.0, 0.0, 0.4, -0.7, 1.0], piece[-1] + 1)[np.roll(piece, 5)]
        moving = (speed > 0.0) | (yaw != 0.0)
        power = np.where(moving, 40.0 * speed**2 + 55.0 * speed + 30.0, 28.0) + 22.0 * np.abs(yaw)
        noise = np.zeros(count)
        for i in range(1, count):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.9)
        rows = np.column_stack([np.arange(count) + 0.5, power + noise, speed, yaw])
        header = "time_s,power_robot_w,speed_m_s,yaw_rate_rad_s"
        np.savetxt(folder / f"run_{number:02d}.csv", rows, "%.4f", ",", header=header, comments="")


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """JSON of all commands on the same logs; what a law would do to them is decided in `tests/laws`."""
    folder = tmp_path_factory.mktemp("skid")
    (folder / "skid.yaml").write_text(BASE, encoding="utf-8")
    skid_logs(folder / "logs", 6, 300)
    robot, logs = str(folder / "skid.yaml"), sorted((folder / "logs").iterdir())
    found: dict[str, Any] = {}

    def ask(name: str, *arguments: object) -> None:
        assert run(*arguments, "--quiet", "--json", folder / f"{name}.json") in (0, 1)
        found[name] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("missionsim.diagnose.examine.propose", lambda *_: None)
        ask("diagnose", "diagnose", "--robot", robot, *logs)
        first = found["diagnose"]["batteries"]["robot"]["effects"][0]["effect"]
        ask("add", "add-effect", "--robot", robot, "--effect", first, *logs, "--out", folder / "one.yaml")
        ask("improve", "improve", "--robot", robot, *logs, "--yes", "--out", folder / "all.yaml")
        held = logs[-max(1, len(logs) // 4) :]
        ask("before", "compare", "--robot", robot, *held)
        ask("after_one", "compare", "--robot", folder / "one.yaml", *held)
        ask("after_all", "compare", "--robot", folder / "all.yaml", *held)
        ask("train", "compare", "--robot", folder / "all.yaml", *logs[: -len(held)])
        ask("calibrate", "calibrate", "--robot", robot, *logs, "--out", folder / "calibrated.yaml")
        ask("calibrated", "compare", "--robot", folder / "calibrated.yaml", *logs)
        ask("uncalibrated", "compare", "--robot", robot, *logs)
    return {name: data["batteries"]["robot"] if "batteries" in data else data for name, data in found.items()}


def errors(compared: dict[str, Any]) -> tuple[float, float]:
    return compared["run_energy_error_pct"], compared["power_rmse_w"]


def told(heldout: dict[str, Any], kind: str) -> tuple[float, float]:
    return heldout["energy_error_pct"][kind], heldout["power_rmse_w"][kind]


def test_the_errors_that_a_diagnosis_promises_are_those_of_the_files(answers: dict[str, Any]) -> None:
    heldout = answers["diagnose"]["heldout"]
    assert told(heldout, "nominal") == pytest.approx(errors(answers["before"]), rel=1e-6)
    steps = {step["name"]: (step["energy_error_pct"], step["power_rmse_w"]) for step in answers["improve"]["steps"]}
    assert steps["before"] == pytest.approx(errors(answers["before"]), rel=1e-6)
    assert steps["recalibrated"] == pytest.approx(told(heldout, "recalibrated"), rel=1e-6)
    added = answers["improve"]["added"]
    assert steps[f"+ {added[-1]}"] == pytest.approx(errors(answers["after_all"]), rel=1e-4)
    assert told(answers["add"]["heldout"], "with_effects") == pytest.approx(errors(answers["after_one"]), rel=1e-4)


def test_names_and_sizes_agree(answers: dict[str, Any]) -> None:
    named = {one["effect"]: one["parameters"] for one in answers["diagnose"]["effects"]}
    assert answers["improve"]["added"][: len(named)] == list(named)
    first = next(iter(named))
    assert answers["add"]["parameters"]["k"]["value"] == pytest.approx(named[first]["k"]["value"], rel=1e-9)
    for end in ("low", "high"):
        assert answers["add"]["parameters"]["k"][end] == pytest.approx(named[first]["k"][end], rel=1e-9)


def test_what_is_written_agrees_in_energy_with_the_runs_it_was_fitted_to(answers: dict[str, Any]) -> None:
    assert abs(answers["train"]["energy_error_pct"]) < 0.01


def test_calibrate_tells_the_errors_that_compare_measures(answers: dict[str, Any]) -> None:
    fit = answers["calibrate"]
    assert (fit["run_energy_error_pct"], fit["rmse_w"]) == pytest.approx(errors(answers["calibrated"]), rel=1e-4)
    assert fit["rmse_before_w"] == pytest.approx(answers["uncalibrated"]["power_rmse_w"], rel=1e-6)


@pytest.mark.usefixtures("effects_alone")
def test_all_agree_on_what_a_log_may_lack(tmp_path: Path) -> None:
    """A robot with grade, logs without slope: level ground for all of them."""
    robot = BASE + (
        "effects: [{effect: grade, battery: robot, parameters: {k: {value: 1, sd: 0.1}}}, "
        "{effect: cpu_load, battery: robot, parameters: {k: {value: 3, sd: 0.3}}}]\n"
    )
    (tmp_path / "hilly.yaml").write_text(robot, encoding="utf-8")
    skid_logs(tmp_path / "logs", 3, 120)
    arguments = ("--robot", tmp_path / "hilly.yaml", tmp_path / "logs", "--quiet")
    assert run("compare", *arguments) == 0
    assert run("diagnose", *arguments) == 0
    assert run("calibrate", *arguments, "--out", tmp_path / "calibrated.yaml") == 0
    assert run("improve", *arguments, "--yes", "--out", tmp_path / "improved.yaml") in (0, 1)


@pytest.mark.usefixtures("effects_alone")
def test_one_log_of_a_few_rows_among_good_ones(tmp_path: Path) -> None:
    (tmp_path / "skid.yaml").write_text(BASE, encoding="utf-8")
    skid_logs(tmp_path / "logs", 4, 120)
    short = (tmp_path / "logs" / "run_02.csv").read_text(encoding="utf-8").splitlines()[:6]
    (tmp_path / "logs" / "run_02.csv").write_text("\n".join(short) + "\n", encoding="utf-8")
    arguments = ("--robot", tmp_path / "skid.yaml", tmp_path / "logs", "--quiet")
    assert run("calibrate", *arguments, "--out", tmp_path / "calibrated.yaml") == 0
    assert run("diagnose", *arguments) == 0
    assert run("improve", *arguments, "--yes", "--out", tmp_path / "improved.yaml") in (0, 1)


def test_speed_tracking_of_compare_and_of_the_diagnosis(root: Path, tmp_path: Path) -> None:
    plan, log = root / "missions/pioneer3dx/valve_patrol.yaml", root / "docs/examples/patrol_driven.csv"
    out = tmp_path / "patrol.json"
    run("compare", "--robot", "pioneer3dx", "--mission", plan, log, "--quiet", "--json", out)
    schemes = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]["mission"]["by_scheme"]
    timeline: Timeline = simulate(load_mission(plan)).timeline
    table = read_log(log)
    driven = motions(table.columns, table.dt_s, {}, still_of(timeline))
    for one in schemes:
        if one["speed_tracking"] is not None:
            name = one["scheme"]
            ratio = mean_ratio(tracking(planned(timeline)[name], [driven[name]]))
            assert one["speed_tracking"] == pytest.approx(ratio, rel=1e-6)


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_after_calibrate_improve_takes_its_step_also_with_collinear_parameters(tmp_path: Path) -> None:
    """drag_coefficient and frontal_area act as their product alone: one is fitted, and told."""
    skid_logs(tmp_path / "logs", 6, 500)
    text = """kind: robot
name: hauler
title: a robot with a traction model
body: {mass: 60 kg, drive: skid_steer, max_speed: 1.2 m/s}
batteries: {robot: {capacity: 400 Wh}}
motion:
  battery: robot
  model: traction
  parameters:
    rolling_coefficient: {value: 0.09, sd: 0.02}
    drag_coefficient: {value: 60, sd: 20}
    frontal_area: {value: 0.8, sd: 0.2}
components: {computer: {always_on: true, loads: [{battery: robot, power: {value: 29 W, sd: 2 W}}]}}
schemes: {drive: {motion: true}}
"""
    (tmp_path / "hauler.yaml").write_text(text, encoding="utf-8")
    logs, middle = tmp_path / "logs", tmp_path / "calibrated.yaml"
    told_to = tmp_path / "calibrated.json"
    robot = ("--robot", tmp_path / "hauler.yaml")
    assert run("calibrate", *robot, logs, "--out", middle, "--quiet", "--json", told_to) == 0
    found = json.loads(told_to.read_text(encoding="utf-8"))
    assert any("drag_coefficient" in remark and "frontal_area" in remark for remark in found["remarks"])
    out = tmp_path / "improved.yaml"
    assert run("improve", "--robot", middle, logs, "--yes", "--quiet", "--out", out) in (0, 1)
    assert out.exists()


@pytest.mark.study
def test_a_step_of_improve_is_the_file_that_add_effect_writes(shared: Path, tmp_path: Path) -> None:
    logs = shared / "practice" / "two-grade-payload"
    asked = ("--robot", "pioneer3dx", logs / "train", "--holdout", logs / "heldout", "--quiet")
    assert run("improve", *asked, "--yes", "--out", tmp_path / "all.yaml", "--json", tmp_path / "improve.json") == 0
    assert run("add-effect", *asked, "--effect", "grade", "--out", tmp_path / "one.yaml") == 0
    assert (
        run("compare", "--robot", tmp_path / "one.yaml", logs / "heldout", "--quiet", "--json", tmp_path / "c.json")
        == 0
    )
    steps = json.loads((tmp_path / "improve.json").read_text())["batteries"]["robot"]["steps"]
    one = {step["name"]: (step["energy_error_pct"], step["power_rmse_w"]) for step in steps}["+ grade"]
    compared = json.loads((tmp_path / "c.json").read_text())["batteries"]["robot"]
    assert one == pytest.approx(errors(compared), rel=1e-4)
