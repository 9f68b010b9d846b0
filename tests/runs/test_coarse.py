"""Long logs in fewer rows: what is kept, and what is left as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missionsim.labels import Labels
from missionsim.runs import run as run_module
from missionsim.runs.run import Bounded, Run, coarser, row_durations


def run_of(rows: int = 6000, step_s: float = 0.1) -> Run:
    rng = np.random.default_rng(3)
    time_s = step_s * (np.arange(rows) + 0.5)
    speed = np.abs(np.sin(0.02 * time_s)) + 0.01 * rng.normal(size=rows)
    floor = Labels((time_s > 200.0).astype(np.int64), ("a", "b"))
    columns = {"time_s": time_s, "speed_m_s": speed, "surface": floor, "heading_rad": np.mod(time_s, 6.0)}
    power = 20.0 + 5.0 * speed + rng.normal(size=rows)
    return Run("r", columns, row_durations(time_s), {"robot": power}, {"robot": None}, {"robot": "power"})


def test_time_and_energy_stay_and_gaps_stay_gaps() -> None:
    whole = run_of()
    holed = whole.rows_where((whole.time_s < 100.0) | (whole.time_s > 130.0))
    mean = coarser(holed)
    assert mean.rows == pytest.approx(570, abs=2)
    assert mean.duration_s == pytest.approx(holed.duration_s)
    assert mean.energy_wh("robot") == pytest.approx(holed.energy_wh("robot"))
    assert float(np.max(np.diff(mean.time_s))) > 29.0
    assert set(np.unique(mean.columns["surface"].texts())) == {"a", "b"}
    # an angle has no mean across its end
    assert set(mean.number("heading_rad")) <= set(holed.number("heading_rad"))


def test_missing_values_do_not_count_and_slow_meters_stay() -> None:
    run = run_of(100)
    speed = run.number("speed_m_s").copy()
    speed[:15] = np.nan
    mean = coarser(replace(run, columns={**run.columns, "speed_m_s": speed}))
    assert np.isnan(mean.number("speed_m_s")[0])
    assert mean.number("speed_m_s")[1] == pytest.approx(float(np.mean(speed[15:20])))
    slow = replace(run, fresh={"robot": np.arange(100) % 20 == 0})
    assert coarser(slow) is slow
    rare = run_of(100, 1.0)
    assert coarser(rare) is rare


def test_few_rows_stay_and_many_are_averaged_in_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "MOST_ROWS", 1500)
    few = Bounded()
    same, told = few.all([few(run_of(1000))])
    assert same[0].rows == 1000
    assert not told
    many = Bounded()
    read = [many(run_of(1000)) for _ in range(3)]
    assert [run.rows for run in read] == [1000, 100, 100]
    every, told = many.all(read)
    assert [run.rows for run in every] == [100, 100, 100]
    assert "3,000 rows" in told
