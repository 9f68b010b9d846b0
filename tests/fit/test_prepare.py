"""What a fit reads of its runs, each with its own floors and columns."""

from __future__ import annotations

import numpy as np

from missionsim.compare import compare
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.fit.prepare import prepare
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.power import build_power_model
from tests.diagnose.logs import drive

EFFECTS = """
effects:
  - name: floor
    battery: robot
    power: "(k_ice * (surface == 'ice') + k_mud * (surface == 'mud')) * abs(speed_m_s)"
    parameters: {k_ice: 3 N, k_mud: 7 N}
  - name: warm
    battery: robot
    power: k * lag(abs(speed_m_s), 40)
    parameters: {k: 2 N}
"""


def test_a_floor_that_a_run_does_not_have_has_no_power_there() -> None:
    floors = ["mud", "ice", "stone"]
    runs = [drive(i, seconds=100.0 + 20 * i, surface=[floor] * (100 + 20 * i)) for i, floor in enumerate(floors)]
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="9 kg"), runs)
    each = prepare(build_power_model(robot_from_text(made.text + EFFECTS)), runs, "robot").gradients
    assert all(one.keys() >= {"floor.k_ice", "floor.k_mud", "warm.k"} for one in each)
    assert [bool(np.any(one["floor.k_ice"])) for one in each] == [False, True, False]


def test_a_column_that_is_text_in_one_run_and_a_number_in_others_is_left_out() -> None:
    logs = [drive(seed, seconds=60.0, mode=["auto"] * 60 if seed == 1 else np.arange(60.0) % 7) for seed in range(3)]
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4"), logs)
    assert any("mode is text in some runs and a number in others" in remark for remark in made.remarks)
    assert len(compare(made.fit.model, logs).runs) == 3
    assert not any("mode" in run.covariates for run in prepare(made.fit.model, logs, "robot").runs)
