"""`missionsim plan` as a user calls it: answers, refusals, and what more choice and tighter limits do."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from missionsim.cli.app import run_command

TWO = "visits=[{place: pump, inspect: 20 s}, {place: shed, wait: 10 s}]"


def plan(root: Path, tmp_path: Path, *settings: str, task: str = "inspection", code: int = 0) -> dict:
    """JSON of a plan."""
    chosen = [part for text in settings for part in ("--set", text)]
    target = tmp_path / "plan.json"
    words = ["plan", str(root / f"missions/planning/{task}.yaml"), *chosen, "--json", str(target), "--quiet"]
    assert run_command([*words, "--out", str(tmp_path / "mission.yaml")]) == code
    return json.loads(target.read_text())


def test_one_more_choice_is_never_worse_and_a_tighter_limit_never_better(root: Path, tmp_path: Path) -> None:
    few = plan(root, tmp_path, TWO, "choose.speeds=[0.6, 0.8]")
    more = plan(root, tmp_path, TWO, "choose.speeds=[0.6, 0.8, 1.0]")
    tight = plan(root, tmp_path, TWO, "choose.speeds=[0.6, 0.8, 1.0]", "within.deadline=400 s")
    assert more["objective"] <= few["objective"] * (1 + 1e-9)
    assert tight["objective"] > more["objective"] * (1 + 1e-6)
    assert tight["duration_s"] <= 400.0 * (1 + 1e-9) < more["duration_s"]


def test_no_plan_names_what_would_do_and_it_does(root: Path, tmp_path: Path) -> None:
    none = plan(root, tmp_path, TWO, "within.deadline=4 min", code=1)
    assert not none["feasible"]
    assert [item["what"] for item in none["why"]["short"]] == ["time"]
    change = next(item for item in none["why"]["would_do"] if item["change"] == "within.deadline")
    assert plan(root, tmp_path, TWO, f"within.deadline={change['to'] * (1 + 1e-9)} s")["feasible"]
    small = "robot.batteries.drive.capacity=5 Wh"
    none = plan(root, tmp_path, TWO, small, code=1)
    change = next(item for item in none["why"]["would_do"] if item["change"].endswith("drive.capacity"))
    assert none["why"]["short"][0]["what"] == "drive"
    assert plan(root, tmp_path, TWO, f"{change['change']}={change['to'] * (1 + 1e-9)} Wh")["feasible"]


def test_a_dock_is_used_where_the_charge_does_not_suffice(root: Path, tmp_path: Path) -> None:
    settings = (TWO, "robot.batteries.drive.capacity=5 Wh", "choose.docks=all")
    charged = plan(root, tmp_path, *settings)
    assert any(leg["kind"] == "charge" for leg in charged["legs"])
    target = tmp_path / "run.json"
    words = ["run", str(tmp_path / "mission.yaml"), "--set", "robot.batteries.drive.capacity=5 Wh"]
    assert run_command([*words, "--json", str(target), "--quiet"]) == 0
    run = json.loads(target.read_text())
    for name, battery in charged["batteries"].items():
        assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)
        assert battery["charge_left_wh"] == pytest.approx(run["batteries"][name]["charge_left_wh"], rel=1e-9)


def test_windows_and_order_are_kept(root: Path, tmp_path: Path) -> None:
    visits = "visits=[{place: pump, inspect: 20 s, window: {from: 9 min}}, {place: shed, wait: 10 s, before: pump}]"
    found = plan(root, tmp_path, visits)
    assert found["order"] == ["shed", "pump"]
    before = 0.0
    for leg in found["legs"]:
        if leg.get("visit") == "pump":
            break
        before += leg["duration_s"]
    assert before == pytest.approx(540.0, abs=1e-6)


def test_a_shift_runs_as_planned(root: Path, tmp_path: Path) -> None:
    shift = plan(root, tmp_path, "repeat.until=2 h", "choose.speeds=[0.7, 1.1]", task="shift")
    assert shift["rounds"] <= shift["rounds_at_most"]
    target = tmp_path / "run.json"
    assert run_command(["run", str(tmp_path / "mission.yaml"), "--json", str(target), "--quiet"]) == 0
    run = json.loads(target.read_text())
    assert shift["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
    assert shift["duration_s"] <= 7200.0
    for name, battery in shift["batteries"].items():
        assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("visits=[{place: pomp}]", "no place 'pomp'"),
        ("visits=[{place: pump, after: shed}, {place: shed, after: pump}]", "before another of them"),
        ("within.deadline=-5 min", "impossible value"),
        ("choose.docks=[gate]", "no charger at 'gate'"),
        ("choose.schemes=[look]", "stands still"),
        ("choose.speeds=[9 m/s]", "faster than the robot"),
        ("defaults={turn_at_places: true}", "turning at places is not planned"),
        ("edges={pump_road: {closed: true}, tank_road: {closed: true}}", "cannot be visited"),
    ],
)
def test_bad_tasks_are_told_where_they_are(
    root: Path, capsys: pytest.CaptureFixture[str], setting: str, told: str
) -> None:
    task = root / "missions/planning/inspection.yaml"
    assert run_command(["plan", str(task), "--set", setting, "--quiet"]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("charge", ["any", "[80 %, 100 %]"])
def test_a_plan_charges_along_the_taper_that_the_run_has(root: Path, tmp_path: Path, charge: str) -> None:
    robot = ["robot.batteries.drive.capacity=5 Wh"]
    robot += [f"robot.batteries.{name}.charge_taper={{from: 70 %, end_power: 10 %}}" for name in ("drive", "computer")]
    choose = ("choose.docks=all", f"choose.charge={charge}", "choose.speeds=[0.7]", "choose.schemes=[seen]")
    free = plan(root, tmp_path, TWO, robot[0], *choose)
    slow = plan(root, tmp_path, TWO, *robot, *choose)
    assert slow["objective"] >= free["objective"] * (1 - 1e-12)
    target = tmp_path / "run.json"
    chosen = [part for text in robot for part in ("--set", text)]
    assert run_command(["run", str(tmp_path / "mission.yaml"), *chosen, "--json", str(target), "--quiet"]) == 0
    run = json.loads(target.read_text())
    assert slow["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
    for name, battery in slow["batteries"].items():
        assert battery["charge_left_wh"] == pytest.approx(run["batteries"][name]["charge_left_wh"], rel=1e-9)
