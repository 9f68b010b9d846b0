"""What the plan says is what SimPy does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from missionsim.cli.app import run_command


def planned(root: Path, tmp_path: Path, *settings: str) -> tuple[dict, dict]:
    """JSON of a plan of the shipped task and of the run of its mission."""
    chosen = [part for text in settings for part in ("--set", text)]
    task = str(root / "missions/planning/inspection.yaml")
    files = [str(tmp_path / name) for name in ("plan.json", "mission.yaml", "run.json")]
    assert run_command(["plan", task, *chosen, "--json", files[0], "--out", files[1], "--quiet"]) == 0
    assert run_command(["run", files[1], "--json", files[2], "--quiet"]) == 0
    return json.loads(Path(files[0]).read_text()), json.loads(Path(files[2]).read_text())


TWO = "visits=[{place: pump, inspect: 20 s}, {place: shed, wait: 10 s}]"


@pytest.mark.parametrize("least", ["energy", "time", "{energy: {drive: 1, computer: 3}, time: 0.002}"])
@pytest.mark.parametrize("profile", ["trapezoidal", "constant_speed"])
def test_energies_times_and_charges_agree(root: Path, tmp_path: Path, least: str, profile: str) -> None:
    plan, run = planned(root, tmp_path, TWO, f"least={least}", f"defaults={{profile: {profile}}}")
    assert plan["feasible"]
    assert run["feasible"]
    assert plan["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
    for name, battery in plan["batteries"].items():
        assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)
        assert battery["charge_left_wh"] == pytest.approx(run["batteries"][name]["charge_left_wh"], rel=1e-9)
    by_leg = [leg["energy_wh"]["drive"] for leg in plan["legs"]]
    assert by_leg == pytest.approx(run["batteries"]["drive"]["by_segment_wh"], rel=1e-9)


def test_a_robot_that_stands_at_the_end_of_each_drive_is_planned_so(root: Path, tmp_path: Path) -> None:
    dwelling, usual = (planned(root, tmp_path, TWO, *more) for more in (["defaults.behaviour={dwell: 3 s}"], []))
    for plan, run in (dwelling, usual):
        assert plan["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
        for name, battery in plan["batteries"].items():
            assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)
    assert dwelling[0]["duration_s"] > usual[0]["duration_s"] + 6.0
