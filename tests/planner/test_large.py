"""Tasks of 50 places, 10 visits, 5 speeds, 3 schemes, 2 docks: within ten seconds, charging or not; Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.inputs.loading import load_task
from missionsim.planner.site import make_site
from missionsim.planner.solve import solve_site
from tests.planner.large import large_task

SIZES = [("16 Wh", "6 Wh", "25 min", 0.0), ("6 Wh", "4 Wh", "40 min", 0.01), ("5 Wh", "3 Wh", "60 min", 0.05)]


@pytest.mark.study
@pytest.mark.parametrize(("drive", "brain", "deadline", "gap"), SIZES)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_large_task_takes_ten_seconds_at_most(
    tmp_path: Path, seed: int, drive: str, brain: str, deadline: str, gap: float
) -> None:
    path = large_task(tmp_path, seed=seed, deadline=deadline)
    capacity = [("robot.batteries.drive.capacity", drive), ("robot.batteries.brain.capacity", brain)]
    began = time.process_time()
    answer = solve_site(make_site(load_task(path, capacity)))
    seconds = time.process_time() - began
    charges = sum(leg.kind == "charge" for leg in answer.legs)
    print(f"{drive} and {brain}, seed {seed}: {seconds:.1f} s, {charges} charges, gap {100 * answer.gap:.2f} %")
    assert seconds < 10.0
    assert answer.feasible
    assert answer.gap <= gap


@pytest.mark.study
def test_ctrl_c_gives_the_best_plan_so_far_with_its_gap(tmp_path: Path) -> None:
    path = large_task(tmp_path, seed=2, deadline="60 min")
    small = ["--set", "robot.batteries.drive.capacity=5 Wh", "--set", "robot.batteries.brain.capacity=3 Wh"]
    words = [sys.executable, "-m", "missionsim", "plan", str(path), *small, "--json", str(tmp_path / "plan.json")]
    process = subprocess.Popen([*words, "--out", str(tmp_path / "mission.yaml"), "--quiet"])
    # a first plan comes after some 4 s of computing, the end after twice that
    while process.poll() is None and sum(map(int, Path(f"/proc/{process.pid}/stat").read_text().split()[13:15])) < 500:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0
    found = json.loads((tmp_path / "plan.json").read_text())
    assert found["feasible"]
    assert "was stopped" in found["claim"]
    assert 0.0 < found["bound"] < found["objective"]
    assert run_command(["run", str(tmp_path / "mission.yaml"), *small, "--quiet"]) == 0
