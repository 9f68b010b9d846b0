"""From a file that nobody described to `compare` by `import --suggest` alone; times, watts and speeds as they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.logs import read_log
from tests.logs.kinds import KINDS
from tests.logs.loggers import LENGTH_S, power, speed


@pytest.mark.parametrize("name", KINDS)
def test_suggested_map_gives_the_truth(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(path) for path in KINDS[name](tmp_path)]
    made, out = tmp_path / "map.yaml", tmp_path / "log.parquet"
    assert main(["import", *files, "--suggest", "--out", str(made), "--quiet"]) == 0, capsys.readouterr().err
    assert main(["import", *files, "--map", str(made), "--out", str(out), "--quiet"]) == 0, capsys.readouterr().err
    log = read_log(out)
    text = made.read_text(encoding="utf-8")
    assert log.duration_s == pytest.approx(LENGTH_S, rel=0.01), text
    # energy over the run and power at its time, whatever the rows
    truth = power(log.time_s)
    assert np.median(np.abs(log.power_w["robot"] / truth - 1.0)) < 0.02, text
    assert log.energy_wh("robot") == pytest.approx(
        power(np.arange(0.0, LENGTH_S, 0.01)).mean() * LENGTH_S / 3600, rel=0.02
    )
    assert np.sqrt(np.mean((log.number("speed_m_s") - speed(log.time_s)) ** 2)) < 0.03, text
    if "yaw_rate_rad_s" in log.columns:
        assert np.abs(log.number("yaw_rate_rad_s")).max() == pytest.approx(0.3, abs=0.02), text
    assert main(["compare", "--robot", "pioneer3dx", str(out), "--quiet"]) == 0
