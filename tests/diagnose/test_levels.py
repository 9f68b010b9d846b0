"""Logs whose level is wrong as a whole: told, never called fine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.diagnose import diagnose_files
from missionsim.errors import InputError


def write(path: Path, factor: float, sd: float = 0.1) -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(300.0)
    speed = np.where((time_s // 20) % 2 == 0, 0.5, 0.3)
    power = factor * (6.25 * speed**2 + 9.79 * speed + 3.66 + rng.normal(0.0, sd, 300))
    table = np.column_stack([time_s, power, speed])
    np.savetxt(path, table, "%.4f", ",", header="time_s,power_robot_w,speed_m_s", comments="")


@pytest.mark.parametrize("factor", [1000.0, 1.0 / 3.0])
def test_a_log_in_other_units_is_never_called_fine(tmp_path: Path, factor: float) -> None:
    write(tmp_path / "run.csv", factor)
    battery = diagnose_files("pioneer3dx", [tmp_path / "run.csv"]).batteries["robot"]
    assert battery.verdict != "nothing_missing"
    assert not [effect for effect in battery.effects if not effect.indistinguishable_from]


def test_a_log_at_the_right_level_is_not_alarming(tmp_path: Path) -> None:
    write(tmp_path / "run.csv", 1.0)
    assert diagnose_files("pioneer3dx", [tmp_path / "run.csv"]).batteries["robot"].verdict == "nothing_missing"


def test_a_frozen_meter_is_named(tmp_path: Path) -> None:
    lines = ["time_s,power_robot_w,speed_m_s", *(f"{i},9.0,0.5" for i in range(100))]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="never changes in any run"):
        diagnose_files("pioneer3dx", [tmp_path / "run.csv"])
