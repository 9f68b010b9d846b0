"""Intervals of real batches against known truth: over many repetitions, 95 % of them hold it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionsim.uncertainty.answers import (
    CHANCE,
    LEVEL,
    capacity_needed,
    describe,
    proportion_interval,
    sobol_importance,
)
from missionsim.uncertainty.batch import Prepared, Task, paired_difference, prepare

REPETITIONS, RUNS = 250, 500
LEAST, MOST = 0.92, 0.98
MISSION = """kind: mission
name: calibration
robot: pioneer3dx
defaults: {scheme: forward_motion, sensors: {laser: 1}, profile: constant_speed}
initial_charge: {robot: {value: 15.44 %, sd: 0.2 %}}
segments:
  - drive:
      distance: 100 m
      speed: 0.4 m/s
      behaviour: {path_stretch: {value: 1.15, sd: 0.05}, speed_tracking: {value: 0.9, low: 0.8, high: 1.0}}
  - wait: {duration: {value: 60 s, distribution: {kind: triangular, low: 30 s, mode: 50 s, high: 100 s}}}
"""


def task_of(folder: Path, *overrides: tuple[str, str], seed: int = 0) -> Task:
    path = folder / "mission.yaml"
    path.write_text(MISSION, encoding="utf-8")
    return Task(str(path), overrides, None, seed, "arrays")


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    return prepare(task_of(tmp_path_factory.mktemp("calibration")))


def blocks(prepared: Prepared, seed: int, runs: int, *names: str) -> dict[str, np.ndarray]:
    assert prepared.arrays is not None
    made = [prepared.arrays.block(seed, first, min(4096, runs - first)) for first in range(0, runs, 4096)]
    return {name: np.concatenate([block[name] for block in made]) for name in names}


@pytest.mark.long
def test_intervals_of_batches_hold_the_truth(prepared: Prepared) -> None:
    columns = ("energy_robot_wh", "needed_robot_wh", "feasible")
    # the truth: a batch so large that its own error is a thirtieth of the intervals that are judged
    large = blocks(prepared, 10**6, 400_000, *columns)
    truth = describe(large["energy_robot_wh"])
    capacity, chance = capacity_needed(large["needed_robot_wh"])["value"], float(large["feasible"].mean())
    assert 0.5 < chance < 0.99
    held: dict[str, list[bool]] = {}
    for seed in range(REPETITIONS):
        found = blocks(prepared, seed, RUNS, *columns)
        energy = describe(found["energy_robot_wh"])
        needed = capacity_needed(found["needed_robot_wh"])
        intervals = {
            "probability": (*proportion_interval(int(found["feasible"].sum()), RUNS), chance),
            "mean": (*energy["mean_interval"], truth["mean"]),
            "capacity for 99 %": (needed["low"], needed["high"], capacity),
            **{name: (*energy["intervals"][name], truth[name]) for name in ("q05", "q25", "q50", "q75", "q95")},
        }
        for name, (low, high, true) in intervals.items():
            held.setdefault(name, []).append(low <= true and (high is None or true <= high))
    shares = {name: float(np.mean(values)) for name, values in held.items()}
    print(shares)
    assert all(LEAST <= share <= MOST for share in shares.values()), shares


@pytest.mark.long
def test_intervals_of_differences_hold_the_truth(prepared: Prepared, tmp_path: Path) -> None:
    other = prepare(task_of(tmp_path, ("segments.0.drive.speed", "0.45 m/s")))
    column = "energy_robot_wh"
    large = paired_difference(column, *(blocks(each, 10**6, 200_000, column)[column] for each in (prepared, other)))
    assert large is not None
    held = []
    for seed in range(REPETITIONS):
        found = paired_difference(column, *(blocks(each, seed, 100, column)[column] for each in (prepared, other)))
        assert found is not None
        held.append(found["low"] <= large["mean"] <= found["high"])
    assert LEAST <= np.mean(held) <= MOST, np.mean(held)


@pytest.mark.study
def test_intervals_of_sobol_indices_hold_the_truth(prepared: Prepared) -> None:
    def indices(seed: int, samples: int) -> dict[str, dict[str, Any]]:
        rows = sobol_importance(prepared, seed, samples, [])
        return {row["parameter"]: row for row in rows if row["battery"] == "robot"}

    truth = indices(10**6, 1 << 15)
    assert sum(row["first"] for row in truth.values()) == pytest.approx(1.0, abs=0.02)
    important = [name for name, row in truth.items() if row["total"] > 0.02]
    assert len(important) >= 3
    held: dict[str, list[bool]] = {}
    for seed in range(200):
        rows = indices(seed, 512)
        for name in important:
            for index in ("first", "total"):
                low, high = rows[name][f"{index}_interval"]
                held.setdefault(f"{name} {index}", []).append(low <= truth[name][index] <= high)
    shares = {name: float(np.mean(values)) for name, values in held.items()}
    print(shares)
    assert float(np.mean(list(shares.values()))) == pytest.approx(LEVEL, abs=0.03)
    assert all(share >= LEAST - 0.02 for share in shares.values()), shares


def test_chance_is_one_value_of_the_sobol_indices(tmp_path: Path) -> None:
    path = tmp_path / "mission.yaml"
    path.write_text(
        "kind: mission\nname: chance\nrobot: pioneer3dx\n"
        "defaults: {scheme: forward_motion, speed: 0.5 m/s, behaviour: {obstacle_spacing: 20 m, obstacle_stop: 30 s}}\n"
        "segments:\n  - drive: {distance: {value: 100 m, sd: 0.1 m}}\n",
        encoding="utf-8",
    )
    prepared = prepare(Task(str(path), (), None, 0, "simpy"))
    rows = [row for row in sobol_importance(prepared, 1, 64, []) if row["battery"] == "robot"]
    assert rows[0]["parameter"] == CHANCE
    assert rows[0]["total"] > 0.8
