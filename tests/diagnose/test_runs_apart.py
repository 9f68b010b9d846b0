"""Runs that differ: what the same motion costs, or what the meters of the runs make of all power."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.interface import diagnose

ROBOT = """kind: robot
name: own
body: {drive: differential, mass: 30 kg, max_speed: 2 m/s}
batteries: {main: {capacity: 500 Wh}}
motion:
  battery: main
  model: polynomial
  parameters:
    c2: {value: 4 W s^2/m^2, sd: 0.12}
    c3: {value: 40 W s/m, sd: 1.2}
    c4: {value: 5 W, sd: 0.15}
    standing: {value: 24 W, sd: 0.7}
"""


def runs(folder: Path, meter_sd: float, motion_sd: float) -> list[Path]:
    """Twelve runs of a little world: stops and goes at steady speeds, rows of a second, noise with a memory of 5 s."""
    rng = np.random.default_rng(5)
    (folder / "own.yaml").write_text(ROBOT)
    paths = []
    for number in range(12):
        speed = np.repeat(rng.choice([0.0, 0.0, 0.4, 0.8, 1.2], 20), 15)
        noise = np.zeros(300)
        for i in range(1, 300):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.3)
        cost, meter = 1.0 + np.array([motion_sd, meter_sd]) * rng.choice([-1.0, 1.0], 2)
        power = meter * np.where(speed > 0.0, cost * (5.0 + 40.0 * speed + 4.0 * speed**2), 24.0)
        path = folder / f"run{number:02d}.csv"
        table = np.column_stack([np.arange(300) + 0.5, speed, power + noise])
        np.savetxt(path, table, delimiter=",", header="time_s,speed_m_s,power_main_w", comments="", fmt="%.4f")
        paths.append(path)
    return paths


@pytest.mark.parametrize(
    ("meter_sd", "motion_sd", "verdict"), [(0.04, 0.0, "nothing_missing"), (0.0, 0.09, "unexplained_structure")]
)
def test_meters_that_differ_are_no_missing_effect(
    tmp_path: Path, meter_sd: float, motion_sd: float, verdict: str
) -> None:
    logs = runs(tmp_path, meter_sd, motion_sd)
    found = diagnose(tmp_path / "own.yaml", logs, holdout="none").batteries["main"]
    assert found.verdict == verdict
    told = " ".join(found.remarks)
    assert ("in all that they draw, at rest too" in told) == (motion_sd == 0.0)
    assert ("what the same motion costs" in found.unexplained.shape) == (motion_sd > 0.0)
