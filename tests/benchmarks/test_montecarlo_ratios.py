"""Speed of the Monte Carlo as ratios of two things measured in one run."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from missionsim.uncertainty.batch import Prepared, Task, prepare
from missionsim.uncertainty.single import simulate_block

SEGMENTS = 40
RUNS = 4096
SEED = 4


@pytest.fixture(scope="module")
def patrol(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    """Forty segments of the Pioneer, each with noise in its length and speed."""
    folder = tmp_path_factory.mktemp("patrol")
    lines = [
        "kind: mission",
        "name: forty",
        "robot: pioneer3dx",
        "defaults: {scheme: forward_motion, sensors: {laser: 2, kinect: 1}, profile: constant_speed}",
        "segments:",
    ]
    for i in range(SEGMENTS):
        lines.append(
            f"  - drive: {{distance: {5 + i % 7} m, speed: {0.3 + 0.01 * (i % 20):.2f} m/s, behaviour: "
            "{path_stretch: {value: 1.1, sd: 0.03}, speed_tracking: {value: 0.9, sd: 0.02}}}"
        )
    path = folder / "forty.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    prepared = prepare(Task(str(path), (), None, SEED, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    return prepared


def least(work: Callable[[], object], times: int) -> float:
    spent = []
    for _ in range(times):
        begun = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begun)
    return min(spent)


def by_hand(prepared: Prepared, rng: np.random.Generator) -> np.ndarray:
    """What somebody would write for this one mission: draws and arithmetic of one battery's energy, nothing kept."""
    length = np.array([5.0 + i % 7 for i in range(SEGMENTS)])
    asked = np.array([round(0.3 + 0.01 * (i % 20), 2) for i in range(SEGMENTS)])
    way = length * (1.1 + 0.03 * rng.standard_normal((RUNS, SEGMENTS)))
    speed = asked * (0.9 + 0.02 * rng.standard_normal((RUNS, SEGMENTS)))
    c2, c3, c4 = (v * (1 + 0.03 * rng.standard_normal((RUNS, 1))) for v in (6.25, 9.79, 3.66))
    return ((c2 * speed + c3 + (c4 + 2 * 2.34 + 2.82) / speed) * way).sum(axis=1) / 3600.0


def test_arrays_against_simpy_and_bare_arithmetic(patrol: Prepared) -> None:
    arrays = patrol.arrays
    assert arrays is not None
    rng = np.random.default_rng(1)
    ours = least(lambda: arrays.block(SEED, 0, RUNS), 3) / RUNS
    simpy = least(lambda: simulate_block(patrol.mission, patrol.model, patrol.sampler, SEED, 0, 12), 3) / 12
    bare = least(lambda: by_hand(patrol, rng), 3) / RUNS
    mean_ours = float(np.mean(arrays.block(SEED, 0, RUNS)["energy_robot_wh"]))
    mean_bare = float(np.mean(by_hand(patrol, rng)))
    print(
        f"\narrays {1 / ours:,.0f} missions/s, SimPy {1 / simpy:,.0f}, bare NumPy {1 / bare:,.0f}: "
        f"{simpy / ours:.0f} times SimPy, {ours / bare:.1f} times the time of the bare arithmetic"
    )
    assert mean_ours == pytest.approx(mean_bare, rel=5e-3)
    assert simpy / ours >= 150.0


def test_cost_is_linear_in_runs(patrol: Prepared) -> None:
    arrays = patrol.arrays
    assert arrays is not None
    few = least(lambda: arrays.block(SEED, 0, 1024), 5)
    many = least(lambda: [arrays.block(SEED, first, 1024) for first in range(0, 8192, 1024)], 2)
    assert many / few < 8 * 1.6


@pytest.mark.study
def test_a_million_runs_in_less_than_a_gigabyte(tmp_path: Path) -> None:
    import resource
    import subprocess
    import sys

    root = Path(__file__).resolve().parents[2]
    command = [
        sys.executable,
        "-m",
        "missionsim",
        "montecarlo",
        str(root / "missions/pioneer3dx/valve_patrol_as_driven.yaml"),
        "--runs",
        "1000000",
        "--seed",
        "1",
        "--quiet",
        "--out",
        str(tmp_path / "million"),
    ]
    subprocess.run(command, check=True)
    peak_gb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024**2
    print(f"\npeak memory {peak_gb:.2f} GB")
    assert peak_gb < 1.0


@pytest.mark.study
def test_two_processes_are_faster_than_one(tmp_path: Path) -> None:
    """On an idle machine with two cores."""
    from missionsim.cli.app import run_command

    root = Path(__file__).resolve().parents[2]
    path = str(root / "missions/pioneer3dx/valve_patrol_as_driven.yaml")
    spent = {}
    for workers in (1, 2):
        begun = time.perf_counter()
        out = str(tmp_path / str(workers))
        assert (
            run_command(
                [
                    "montecarlo",
                    path,
                    "--runs",
                    "12000",
                    "--engine",
                    "simpy",
                    "--quiet",
                    "--workers",
                    str(workers),
                    "--out",
                    out,
                ]
            )
            == 0
        )
        spent[workers] = time.perf_counter() - begun
    print(f"\none process {spent[1]:.1f} s, two {spent[2]:.1f} s: {spent[1] / spent[2]:.2f} times faster")
    assert spent[1] / spent[2] >= 1.7
