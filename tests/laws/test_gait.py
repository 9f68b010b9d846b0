"""A load that begins at a speed, as of a gait or a gear, is that step: no effect, and no bump beside one."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from missionsim.diagnose import Subject
from missionsim.diagnose.diagnosis import diagnose
from missionsim.inputs.loading import load_robot
from missionsim.laws.factors import make_grammar
from tests.diagnose.logs import drawing, drive
from tests.laws.found import law_of, run_of


@pytest.mark.long
def test_a_load_that_begins_at_a_speed_is_a_step_and_no_friction() -> None:
    """It was viscous friction, surely, and a bump beside it."""
    logs = []
    for seed in range(4):
        rng, rows = np.random.default_rng(50 + seed), 300
        speed = np.repeat(rng.uniform(0.1, 0.8, rows // 10), 10)
        log = drive(seed, seconds=float(rows))
        motion = 6.25 * speed**2 + 9.79 * speed + 3.66 + 3.0 * (speed > 0.52)
        power = motion + 2.34 + 2.82 * log.columns["on_kinect"] + rng.normal(0.0, 0.1, rows)
        columns = log.columns | {"speed_m_s": speed, "yaw_rate_rad_s": np.zeros(rows)}
        logs.append(drawing(replace(log, columns=columns), power))
    found = diagnose(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"]
    assert found.effects == ()
    law = found.proposed_laws[0]
    assert law.instead_of == ("viscous_friction",)
    begins = re.fullmatch(r"k \* \(abs\(speed_m_s\) > ([\d.]+)\)", law.first.formula)
    assert begins is not None
    assert float(begins[1]) == pytest.approx(0.52, abs=0.02)
    assert law.first.k == pytest.approx(3.0, abs=0.3)


@pytest.mark.usefixtures("laws_at_once")
def test_a_step_is_found_where_a_bump_leads() -> None:
    """A legged robot that trots from 0.9 m/s on: no step is among the forms that are asked first, and a resonance came
    nearer to it than what rises from a speed on."""
    rng, runs = np.random.default_rng(3), []
    for number in range(6):
        speed = np.repeat(np.where(rng.random(60) < 0.2, 0.0, np.clip(rng.normal(0.95, 0.3, 60), 0.1, 1.5)), 10)
        gradient = {"c3": 60.0 * speed, "c4": 40.0 * (speed > 0.0), "standing": 50.0 * (speed == 0.0)}
        more = 11.0 * (speed > 0.9) + 1.5 * rng.standard_normal(600)
        runs.append(run_of(number, gradient, more, speed_m_s=speed, yaw_rate_rad_s=0.1 * rng.standard_normal(600)))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05)
    begins = re.fullmatch(r"k \* \(abs\(speed_m_s\) > ([\d.]+)\)", made.first.formula)
    assert begins is not None
    assert float(begins[1]) == pytest.approx(0.9, abs=0.01)
    assert made.first.k == pytest.approx(11.0, rel=0.05)


def test_sideways_speed_has_powers_between_whole_ones() -> None:
    run = {"time_s": np.arange(100.0), "lateral_speed_m_s": np.linspace(-0.4, 0.4, 100)}
    assert "abs(lateral_speed_m_s)**1.5" in {factor.text for factor in make_grammar([run]).factors}
