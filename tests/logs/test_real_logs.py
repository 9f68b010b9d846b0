"""Measured logs of real robots through the shipped maps; their traps are handled and told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, iter_blocks, read_log, read_logs


@pytest.fixture(scope="module")
def warthog(shared: Path, root: Path) -> list[LogTable]:
    return import_source(shared / "data" / "warthog_drive", load_map(root / "docs" / "maps" / "warthog.yaml"))


def test_warthog_has_one_row_a_refresh(warthog: list[LogTable]) -> None:
    assert len(warthog) == 7
    for log in warthog:
        assert np.median(log.dt_s) == pytest.approx(1.0, abs=0.03)
        assert log.number("bus_voltage_v").min() > 30
        assert any("refreshes of left_wheel_current" in r.message for r in log.remarks)
        assert any("do not meet" in r.message for r in log.remarks)
        assert log.columns["surface"].names == (("asphalt",) if "asphalt" in log.run else ("grass",))  # type: ignore[union-attr]
        # pitch of 1 to 99 % lies in −6.8 … +3.6 degrees (README of the data)
        low, high = np.quantile(np.degrees(log.number("slope_rad")), [0.01, 0.99])
        assert -8 < low < high < 8


def test_warthog_turning_is_what_speed_cannot_explain(warthog: list[LogTable]) -> None:
    power = np.concatenate([log.power_w["robot"] for log in warthog])
    speed = np.concatenate([log.number("speed_m_s") for log in warthog])
    yaw = np.concatenate([log.number("yaw_rate_rad_s") for log in warthog])
    moving = (np.abs(speed) > 0.005) | (np.abs(yaw) > 0.02)

    def fit(*columns: np.ndarray) -> tuple[np.ndarray, float]:
        matrix = np.array(columns).T[moving]
        found, *_ = np.linalg.lstsq(matrix, power[moving], rcond=None)
        return found, float(1 - (power[moving] - matrix @ found).var() / power[moving].var())

    base = (speed**2, speed, np.ones_like(speed))
    assert fit(*base)[1] < 0.2
    with_turning, explained = fit(*base, np.abs(yaw))
    assert explained > 0.7
    assert 3000 < with_turning[3] < 4100


def test_warthog_slow_topics_are_seen_without_a_map(shared: Path) -> None:
    from missionsim.logs.codes import refreshes
    from missionsim.logs.read import read_raw

    raw = read_raw(shared / "data" / "warthog_drive" / "grass_2024_8_8_16h19s23.csv")
    current = refreshes(np.asarray(raw.columns["left_wheel_current"]), np.asarray(raw.columns["t_s"]))
    assert current is not None
    assert current.period_s == pytest.approx(1.0, abs=0.05)
    assert refreshes(np.asarray(raw.columns["imu_z"]), np.asarray(raw.columns["t_s"])) is None


def test_turtlebot_energies_agree_with_the_published_ones(shared: Path, root: Path) -> None:
    from missionsim.logs.read import read_raw

    folder = shared / "data" / "turtlebot3_msr2021"
    logs = import_source(folder / "tb3_power_2hz.csv", load_map(root / "docs" / "maps" / "turtlebot3.yaml"))
    table = read_raw(folder / "tb3_runs.csv").columns
    keys = zip(*(table[name].texts() for name in ("movement", "environment", "tactic")), table["run"], strict=True)  # type: ignore[union-attr]
    published = {
        f"tb3_power_2hz_{m}_{e}_{t}_{run:g}": joule
        for (m, e, t, run), joule in zip(keys, table["energy_J"], strict=True)
    }  # type: ignore[arg-type]
    assert len(logs) == 300
    # the last half second is not whole: at most one row is missing or too much
    for log in logs:
        joule = 3600 * log.energy_wh("robot")
        assert abs(joule - published[log.run]) < 0.5 * log.power_w["robot"].max(), log.run


def test_turtlebot_raw_lines(shared: Path, root: Path) -> None:
    path = shared / "data" / "turtlebot3_msr2021" / "raw_examples" / "A_movement_empty_1_baseline_run1_DATA.TXT"
    (log,) = import_source(path, load_map(root / "docs" / "maps" / "turtlebot3_raw.yaml"))
    assert log.duration_s == pytest.approx(26459 / 200, abs=0.25)
    assert abs(3600 * log.energy_wh("robot") - 1458.63) < 0.25 * log.power_w["robot"].max()


def test_rover_runs(shared: Path, root: Path) -> None:
    logs = import_source(
        shared / "data" / "ase_rover" / "ase_rover_10hz.csv", load_map(root / "docs" / "maps" / "ase_rover.yaml")
    )
    assert len(logs) == 300
    assert {float(value) for log in logs for value in np.unique(log.number("on_camera"))} == {0.0, 1.0}
    assert all(log.columns["governor"].names for log in logs)  # type: ignore[union-attr]


def test_practice_logs_are_healthy(shared: Path) -> None:
    for case in sorted((shared / "practice").iterdir())[::6]:
        logs = read_logs(case / "train")
        assert [r for log in logs for r in log.remarks if r.severity != "note"] == []
        assert all(log.duration_s == pytest.approx(420, abs=3) for log in logs)
    path = shared / "practice" / "nothing-0" / "train" / "run_00.csv"
    whole = read_log(path)
    assert sum(b.energy_wh("robot") for b in iter_blocks(path, rows=100)) == pytest.approx(
        whole.energy_wh("robot"), rel=1e-12
    )
