"""A load that saturates with the turn rate and differs from floor to floor is one law with a level for each."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from missionsim.diagnose import Subject
from missionsim.diagnose.diagnosis import diagnose
from missionsim.identify.findings import BatteryDiagnosis
from missionsim.inputs.loading import load_robot
from missionsim.runs.run import Run
from tests.diagnose.logs import drive

FLOORS = {"snow": 9.0, "carpet": 5.0, "tile": 1.5}


def diagnosed(levels: dict[str, float]) -> BatteryDiagnosis:
    """Nine runs, three on each floor, with a load of so many W at full turn, and one on ice without a turn."""
    logs: list[Run] = []
    for seed in range(9):
        floor = list(levels)[seed % len(levels)]
        log = drive(seed, noise=0.02, surface=[floor] * 420)
        power = log.power_w["robot"] + levels[floor] * np.tanh(np.abs(log.columns["yaw_rate_rad_s"]) / 0.25)
        logs.append(replace(log, columns={**log.columns, "power_robot_w": power}, power_w={"robot": power}))
    logs.append(drive(9, surface=["ice"] * 420, yaw_rate_rad_s=np.zeros(420)))
    return diagnose(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"]


def test_each_floor_has_its_part_of_the_highest() -> None:
    first = diagnosed(FLOORS).proposed_laws[0].first
    parts = {floor: float(part) for part, floor in re.findall(r"([\d.]+) \* \(surface == '(\w+)'\)", first.formula)}
    assert first.variables == ("yaw_rate_rad_s", "surface")
    assert parts.keys() == FLOORS.keys()
    for floor, part in parts.items():
        assert abs(part - FLOORS[floor] / 9.0) < 0.08
    assert abs(first.k / 9.0 - 1.0) < 0.15


def test_floors_that_are_alike_have_no_levels() -> None:
    laws = diagnosed(dict.fromkeys(FLOORS, 5.0)).proposed_laws
    assert not [law for law in laws if "surface" in law.first.formula]
