"""`import --suggest` on what loggers and ground stations export: headers as they are, several meters, files to join."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.logs import LogTable, read_log
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.1).round(1)
W, V, YAW = loggers.power(T), loggers.speed(T), loggers.turn(T)
WH = float(W.sum() * 0.1 / 3600)


def write(path: Path, columns: Mapping[str, object], under: tuple[str, ...] = ()) -> Path:
    """A table; `under`: lines beneath the names."""
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="") as handle:
        lines = csv.writer(handle, lineterminator="\n")
        lines.writerow(columns)
        handle.writelines(f"{line}\n" for line in under)
        lines.writerows(zip(*(np.broadcast_to(one, T.shape) for one in columns.values()), strict=True))  # type: ignore[call-overload]
    return path


def suggested(*paths: Path, code: int = 0) -> tuple[LogTable, str]:
    """The log that the suggested map makes of files, as it was suggested, and that map."""
    made, out = paths[0].parent.parent / "made.yaml", paths[0].parent.parent / "out.parquet"
    assert main(["import", *map(str, paths), "--suggest", "--out", str(made), "--quiet"]) == code
    assert main(["import", *map(str, paths), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return read_log(out), made.read_text()


@pytest.mark.parametrize("under", [("s,mph,kW,deg/s",), ("s,mph,kW,deg/s", ""), ("", "s,mph,kW,deg/s", "", "")])
def test_a_line_of_units_with_empty_lines_about_it(tmp_path: Path, under: tuple[str, ...]) -> None:
    columns = {"Time": T, "Ground Speed": V / 0.44704, "Battery Power": W / 1e3, "Gyro Yaw Rate": np.degrees(YAW)}
    log, _ = suggested(write(tmp_path / "run" / "a.csv", columns, under))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)
