"""Wrong units or another robot's file are not taken for effects."""

from __future__ import annotations

from dataclasses import replace

import pytest

from missionsim.diagnose import Subject, diagnose, words
from missionsim.diagnose.diagnosis import examine
from missionsim.diagnose.factor import common_factor
from missionsim.diagnose.split import Split
from missionsim.identify.data import Settings
from missionsim.logs import LogTable
from missionsim.spec.loading import load_robot

from .logs import drive

ROBOT = "pioneer3dx"


def scaled(log: LogTable, factor: float) -> LogTable:
    power = factor * log.power_w["robot"]
    return replace(log, columns={**log.columns, "power_robot_w": power}, power_w={"robot": power})


def test_one_factor_on_everything_names_no_effect() -> None:
    logs = [scaled(drive(seed, seconds=240.0), 1.5) for seed in range(4)]
    found = diagnose(Subject.of(load_robot(ROBOT)), logs, holdout="none").batteries["robot"]
    assert found.verdict == "unexplained_structure"
    assert found.effects == ()
    assert not any(c.accepted for c in found.candidates)
    told = words.headline(found)
    assert told.startswith("Battery robot: the meter reads 1.5")
    assert told.count("times what the model gives") == 1
    assert "check the units of the log" in told
    reasons = {c.effect: c.reason for c in found.candidates}  # those that add-effect refuses with
    assert "on the whole model explains as much" in reasons["rolling_friction"]


@pytest.mark.parametrize("scrub_w_s_rad", [3.0, 12.0])
def test_an_effect_is_no_factor(scrub_w_s_rad: float) -> None:
    logs = tuple(drive(seed, seconds=240.0, scrub_w_s_rad=scrub_w_s_rad) for seed in range(4))
    seen = examine(Subject.of(load_robot(ROBOT)), Split(logs, (), ""), "robot", Settings())
    assert [e.effect for e in seen.found.effects] == ["turning_scrub"]
    assert not seen.factor
    assert common_factor(seen.found)[1] < 0.3
