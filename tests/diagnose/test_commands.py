"""diagnose, add-effect, improve and calibrate as a user calls them, on a robot whose turning is not modelled."""

from __future__ import annotations

import io
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.files import sha256
from missionsim.labels import Labels
from missionsim.logs import LogTable

from .logs import drive

pytestmark = pytest.mark.usefixtures("examined_once", "laws_at_once")

SCRUB = 3.0
"""Watts per rad/s that the robot draws and its file does not know."""


def run(line: str) -> int:
    return run_command(shlex.split(line))


def write(log: LogTable, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    names = list(log.columns)
    cells = [c.texts() if isinstance(c, Labels) else [f"{x:.5f}" for x in c] for c in log.columns.values()]
    rows = [",".join(names), *(",".join(map(str, row)) for row in zip(*cells, strict=True))]
    (folder / f"{log.run}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("logs")
    for seed in range(6):
        write(drive(seed, seconds=300.0, scrub_w_s_rad=SCRUB), root / "train")
        write(drive(50 + seed, seconds=300.0), root / "clean")
    for seed in range(20, 23):
        write(drive(seed, seconds=300.0, scrub_w_s_rad=SCRUB), root / "held")
    return {name: root / name for name in ("train", "held", "clean")}


@pytest.fixture(scope="module")
def diagnosis(folders: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("out") / "diagnosis.json"
    page = out.with_suffix(".html")
    assert (
        run(
            f"diagnose --robot pioneer3dx {folders['train']} --holdout {folders['held']} --json {out} "
            f"--report {page} --quiet"
        )
        == 0
    )
    assert "<script" in page.read_text(encoding="utf-8")
    assert "turning_scrub" in page.read_text(encoding="utf-8")
    return dict(json.loads(out.read_text(encoding="utf-8")))


def test_held_out_files_are_read_as_those_that_are_fitted(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the checks against the robot find in them is told, and a switch that they alone log."""
    log = drive(30, seconds=300.0, scrub_w_s_rad=SCRUB, on_kinnect=np.ones(300))
    write(replace(log, columns={n: data for n, data in log.columns.items() if n != "on_kinect"}), tmp_path / "held")
    told = "the robot has no component 'kinnect'; did you mean kinect?", "on_kinect is not logged in the runs not used"
    words = f"--robot pioneer3dx {folders['train']} --holdout {tmp_path / 'held'}"
    assert run(f"diagnose {words}") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert all(one in said for one in told)
    assert run(f"add-effect {words} --effect turning_scrub --out {tmp_path / 'r.yaml'}") == 0
    said = " ".join(capsys.readouterr().err.split())
    assert all(one in said for one in told)


def test_diagnosis_has_the_contract_s_shape(diagnosis: dict[str, Any]) -> None:
    assert diagnosis["schema"] == "missionsim.diagnosis/1"
    battery = diagnosis["batteries"]["robot"]
    assert set(battery) >= {
        "verdict",
        "effects",
        "candidates",
        "recalibration",
        "clock",
        "untestable",
        "unexplained",
        "next_experiment",
    }
    assert set(battery["clock"]) >= {"delay_s", "lag_s"}
    assert set(battery["unexplained"]) == {"share_of_residual", "depends_on", "shape"}
    for candidate in battery["candidates"]:
        assert set(candidate) == {"effect", "accepted", "reason", "smallest_detectable_share"}
    for shift in battery["recalibration"]:
        assert set(shift) >= {"parameter", "shift_pct", "shift_in_prior_sd"}
    assert {"effect": "grade", "needs": ["slope_rad"]} in battery["untestable"]


def test_the_missing_effect_is_named_first_with_its_size(diagnosis: dict[str, Any]) -> None:
    battery = diagnosis["batteries"]["robot"]
    assert battery["verdict"] == "effects_found"
    first = battery["effects"][0]
    assert first["effect"] == "turning_scrub"
    assert first["indistinguishable_from"] == []
    k = first["parameters"]["k"]
    assert k["low"] < SCRUB < k["high"]
    assert k["unit"] == "W s/rad"
    assert first["p_value"] < 1e-6
    assert [c["accepted"] for c in battery["candidates"] if c["effect"] == "turning_scrub"] == [True]


def test_heldout_error_falls(diagnosis: dict[str, Any]) -> None:
    battery = diagnosis["batteries"]["robot"]
    first = battery["effects"][0]
    assert first["heldout_rmse_after_w"] < 0.8 * first["heldout_rmse_before_w"]
    energy = battery["heldout"]["energy_error_pct"]
    assert energy["with_effects"] < energy["nominal"]
    # names that the fitted runs have as well are told apart
    assert set(battery["heldout"]["runs"]) == {"run_20", "run_21", "run_22"}


def test_nothing_hidden_nothing_named(folders: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"diagnose --robot pioneer3dx {folders['clean']}") == 0
    told = capsys.readouterr().out
    assert "No evidence of anything missing above the detection limits" in " ".join(told.split())
    for heading in ("CLOCK", "NOISE", "NOT SEEN", "REMAINS", "HELD-OUT"):
        assert heading in told


def compare(robot: str, logs: Path, tmp_path: Path) -> dict[str, Any]:
    out = tmp_path / "compare.json"
    assert run(f"compare --robot {robot} {logs} --json {out} --quiet") == 0
    return dict(json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"])


def test_add_effect_lowers_the_error_on_runs_that_were_not_used(folders: dict[str, Path], tmp_path: Path) -> None:
    robot = tmp_path / "better.yaml"
    assert run(f"add-effect --robot pioneer3dx --effect turning_scrub {folders['train']} --out {robot} --quiet") == 0
    text = robot.read_text(encoding="utf-8")
    assert "# Pioneer 3DX with a laptop" in text  # comments are kept
    assert "effect: turning_scrub" in text
    # which logs it was fitted to, and what they covered, stands once
    logs = sorted(folders["train"].glob("*.csv"))
    assert [text.count(sha256(log)[:8]) for log in logs] == [*[1] * (len(logs) - 1), 0]  # the last is held out
    assert text.count("range:") == 1
    assert "p_value" in text
    before = compare("pioneer3dx", folders["held"], tmp_path)
    after = compare(str(robot), folders["held"], tmp_path)
    assert after["power_rmse_w"] < 0.8 * before["power_rmse_w"]
    assert run(f"validate {robot} --quiet") == 0
    # what the file holds is not proposed again, and not added twice
    out = tmp_path / "again.json"
    assert run(f"diagnose --robot {robot} {folders['held']} --holdout none --json {out} --quiet") == 0
    again = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    assert "turning_scrub" not in {c["effect"] for c in again["candidates"]}
    assert again["effects"] == []
    assert (
        run(f"add-effect --robot {robot} --effect turning_scrub {folders['train']} --out {tmp_path / 'twice.yaml'}")
        == 2
    )
    assert not (tmp_path / "twice.yaml").exists()


def test_add_effect_refuses_what_the_data_do_not_support(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "no.yaml"
    command = f"add-effect --robot pioneer3dx --effect aerodynamic_drag {folders['clean']} --out {robot}"
    assert run(command) == 1
    assert "aerodynamic_drag is not supported by these logs" in capsys.readouterr().err
    assert not robot.exists()
    assert run(f"{command} --force --quiet") in (0, 2)  # 2 where the sign came out as physics forbids
    if robot.exists():
        assert "forced: true" in robot.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ("grade", "these logs cannot test 'grade'"),
        ("turning_scrubb", "did you mean: turning_scrub"),
        ("dwell", "how the robot drives"),
    ],
)
def test_add_effect_faults(
    folders: dict[str, Path], tmp_path: Path, effect: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(f"add-effect --robot pioneer3dx --effect {effect} {folders['train']} --out {tmp_path / 'x.yaml'}") == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x.yaml").exists()


def test_improve_goes_to_the_noise_floor(folders: dict[str, Path], tmp_path: Path) -> None:
    robot, out, page = (tmp_path / name for name in ("i.yaml", "i.json", "i.html"))
    assert (
        run(
            f"improve --robot pioneer3dx {folders['train']} --holdout {folders['held']} --yes --out {robot} "
            f"--json {out} --report {page} --quiet"
        )
        == 0
    )
    battery = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    assert battery["added"] == ["turning_scrub"]
    steps = {step["name"]: step["power_rmse_w"] for step in battery["steps"]}
    assert list(steps) == ["before", "recalibrated", "+ turning_scrub", "noise floor"]
    assert steps["+ turning_scrub"] < 0.8 * steps["recalibrated"]
    assert steps["+ turning_scrub"] < 1.5 * steps["noise floor"]
    assert battery["stopped"] == "nothing is left above the detection limits."
    assert "noise floor" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(("answer", "added"), [("y", ["turning_scrub"]), ("n", [])])
def test_improve_asks_before_it_adds(
    folders: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answer: str,
    added: list[str],
) -> None:
    asked = io.StringIO(f"perhaps\n{answer}\n")
    monkeypatch.setattr(asked, "isatty", lambda: True)
    monkeypatch.setattr("sys.stdin", asked)
    robot, out = tmp_path / "a.yaml", tmp_path / "a.json"
    given = f"{folders['train']} --holdout {folders['held']} --out {robot} --json {out} --quiet"
    assert run(f"improve --robot pioneer3dx {given}") == 0
    battery = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    assert battery["added"] == added
    assert battery["declined"] == ([] if added else ["turning_scrub"])
    said = " ".join("".join(capsys.readouterr()).split())
    assert "turning_scrub" in said
    assert "power error on held-out runs: with all that was found" in said
    assert "add turning_scrub to battery robot? [y/n] (y)" in said
    assert "Please enter Y or N" in said


def test_improve_adds_nothing_where_nothing_is_missing(folders: dict[str, Path], tmp_path: Path) -> None:
    robot, out, page = (tmp_path / name for name in ("n.yaml", "n.json", "n.html"))
    given = f"--yes --out {robot} --json {out} --report {page} --quiet"
    assert run(f"improve --robot pioneer3dx {folders['clean']} {given}") == 0
    battery = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    assert battery["added"] == []
    assert battery["worse"] is None
    assert [step["name"] for step in battery["steps"]] == ["before", "recalibrated", "noise floor"]
    assert robot.exists()
    assert page.exists()


def test_improve_leaves_out_what_it_is_told_to(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = f"--yes --without turning_scrub --without grade --out {tmp_path}/w.yaml --json {tmp_path}/w.json"
    run(f"improve --robot pioneer3dx {folders['train']} {given}")
    battery = json.loads((tmp_path / "w.json").read_text(encoding="utf-8"))["batteries"]["robot"]
    assert "turning_scrub" not in battery["added"]
    assert "turning_scrub" in battery["declined"]
    said = capsys.readouterr().err
    assert "--without grade: nothing of that name was about to be added" in said
    assert "--without turning_scrub: " not in said


def test_improve_asks_on_a_terminal_only(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Silent:
        def isatty(self) -> bool:
            return False

    monkeypatch.setattr("sys.stdin", Silent())
    assert run(f"improve --robot pioneer3dx {folders['train']} --out {tmp_path / 'i.yaml'}") == 2
    assert "--yes" in capsys.readouterr().err
    assert not (tmp_path / "i.yaml").exists()


def test_calibrate_finds_the_base_of_a_new_robot(folders: dict[str, Path], tmp_path: Path) -> None:
    robot, out = tmp_path / "new.yaml", tmp_path / "new.json"
    assert (
        run(
            f"calibrate --new rover --base 'c2*v**2 + c3*v + c4' {folders['clean']} --out {robot} --json "
            f"{out} --mass '25 kg' --quiet"
        )
        == 0
    )
    fitted = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    p = fitted["parameters"]
    # the laser is never switched in these logs, so its 2.34 W are part of the base
    truth = {"c3": 9.79, "c4": 3.66 + 2.34, "standing": 2.67 + 2.34, "kinect.power": 2.82}
    for name, value in truth.items():
        assert abs(p[name]["value"] - value) < 4.0 * p[name]["sd"], name
        assert p[name]["sd"] < 0.12 * value
    assert fitted["explained_variance"] > 0.95
    assert compare(str(robot), folders["clean"], tmp_path)["energy_error_pct"] == pytest.approx(0.0, abs=0.5)
    assert run(f"validate {robot} --quiet") == 0


def test_calibrate_takes_the_only_battery_that_is_measured(tmp_path: Path) -> None:
    log = drive(3, seconds=200.0)
    columns = {("power_main_w" if n == "power_robot_w" else n): c for n, c in log.columns.items()}
    write(replace(log, columns=columns), tmp_path / "logs")
    robot = tmp_path / "new.yaml"
    base = "c2*v**2 + c3*v + c4"
    assert run(f"calibrate --new rover --base '{base}' {tmp_path}/logs --out {robot} --quiet") == 0
    assert "battery: main" in robot.read_text(encoding="utf-8")


def test_calibrate_refits_a_robot_and_keeps_its_comments(folders: dict[str, Path], tmp_path: Path) -> None:
    robot = tmp_path / "again.yaml"
    assert run(f"calibrate --robot pioneer3dx {folders['clean']} --out {robot} --quiet") == 0
    text = robot.read_text(encoding="utf-8")
    assert "# Pioneer 3DX with a laptop" in text
    assert "source: calibration" in text
    assert "9.79 W s/m before" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--new a", "--new needs --base"),
        ("--base c*v", "give either --new NAME with --base, or --robot R"),
        ("--new a --base 'c*q(v)'", "unknown function 'q'"),
        ("--new a --base 'c*theta + d'", "which not every log has"),
        ("--new a --base 'c*v + d*v'", "cannot tell some parameters of --base apart"),
    ],
)
def test_calibrate_faults(
    folders: dict[str, Path], tmp_path: Path, arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.yaml"
    assert run(f"calibrate {arguments} {folders['clean']} --out {out}") == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_user_s_own_candidate_is_tested_and_adopted(folders: dict[str, Path], tmp_path: Path, root: Path) -> None:
    text = (root / "missionsim" / "robots" / "pioneer3dx.yaml").read_text(encoding="utf-8")
    text = text.split("\n", 1)[1] + (
        '\neffects:\n  - {name: my_turning, battery: robot, candidate: true, power: "k * abs(yaw_rate_rad_s) * 1",'
        " parameters: {k: {value: 1, low: 0, high: 100, unit: W s/rad}}}\n"
    )
    mine = tmp_path / "mine.yaml"
    mine.write_text(text, encoding="utf-8")
    out = tmp_path / "d.json"
    assert run(f"diagnose --robot {mine} {folders['train']} --json {out} --quiet") == 0
    battery = json.loads(out.read_text(encoding="utf-8"))["batteries"]["robot"]
    first = battery["effects"][0]
    assert {first["effect"], *first["indistinguishable_from"]} >= {"my_turning", "turning_scrub"}
    assert battery["verdict"] == "ambiguous"
    better = tmp_path / "better.yaml"
    assert run(f"add-effect --robot {mine} --effect my_turning {folders['train']} --out {better} --quiet") == 0
    written = better.read_text(encoding="utf-8")
    assert "candidate" not in written
    assert "cannot_be_told_from: [turning_scrub]" in written
    value = np.array(compare(str(better), folders["held"], tmp_path)["power_rmse_w"])
    assert value < 0.8 * compare("pioneer3dx", folders["held"], tmp_path)["power_rmse_w"]


def test_a_rate_of_false_alarms_that_is_none_is_refused(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs, out = str(folders["clean"]), tmp_path / "robot.yaml"
    assert run(f"diagnose --robot pioneer3dx {logs} --alpha 2") == 2
    assert run(f"improve --robot pioneer3dx {logs} --out {out} --yes --alpha 0") == 2
    assert capsys.readouterr().err.count("--alpha is a probability") == 2
    assert not out.exists()
