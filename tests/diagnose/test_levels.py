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


def test_logs_that_are_all_too_short_are_named_with_what_they_hold(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.csv", "b.csv")]
    for path, rows in zip(paths, (5, 6), strict=True):
        write(path, 1.0)
        path.write_text("".join(path.read_text("utf-8").splitlines(keepends=True)[: rows + 1]), "utf-8")
    with pytest.raises(InputError, match="no run has at least 8 analysis intervals") as caught:
        diagnose_files("pioneer3dx", paths, holdout="none")
    told = [(fault.file, fault.got, fault.allowed) for fault in caught.value.faults]
    allowed = "8 intervals of 1 s or longer in a run"
    assert told == [(str(paths[0]), "5 rows in 4.5 s", allowed), (str(paths[1]), "6 rows in 5.5 s", allowed)]
