"""The on-line predictor on records of simulated missions whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.inputs import load_mission
from missionsim.online import ExpectedRun, Forecast, OnlinePredictor


def record(
    result: RunResult, step_s: float = 0.05, factor: float = 1.0, noise: float = 0.0, seed: int = 0
) -> dict[str, np.ndarray]:
    """Samples of a run: mean power of the interval, speed as it changes within it."""
    line = result.timeline
    time_s = np.arange(0.0, result.duration_s, step_s)
    index = np.searchsorted(line.start_s, time_s, side="right") - 1
    since = time_s - line.start_s[index]
    speed = np.asarray(line.columns["speed_m_s"])[index] + np.asarray(line.rates["speed_m_s"])[index] * since
    power = factor * result.power_w("robot")[index]
    power = power * (1.0 + noise * np.random.default_rng(seed).normal(size=len(power)))
    return {"time_s": time_s, "power_robot_w": power, "speed_m_s": speed}


@pytest.fixture(scope="module")
def tunnel(root: Path) -> Path:
    return root / "missions" / "khepera3" / "tunnel_inspection.yaml"


@pytest.mark.parametrize("factor", [1.0, 1.05, 0.9])
def test_forecasts_hold_the_truth(tunnel: Path, factor: float) -> None:
    mission = load_mission(tunnel)
    result = simulate(mission)
    total = factor * result.batteries["robot"].energy_wh * 3600.0
    forecasts = list(OnlinePredictor.from_mission(mission).feed(record(result, 0.2, factor, 0.04), every_s=60.0))
    inside = 0
    for forecast in forecasts[2:-1]:
        truth = total - forecast.drawn_j
        inside += abs(forecast.to_finish_j - truth) <= 2.5 * np.hypot(forecast.to_finish_sd_j, 5.0)
    assert inside >= 0.95 * len(forecasts[2:-1])
    last = forecasts[-1]
    assert last.progress == pytest.approx(1.0, abs=1e-3)
    assert last.drawn_j == pytest.approx(total, rel=2e-3)
    assert last.to_finish_j == pytest.approx(0.0, abs=2e-3 * total)
    assert last.to_return_j == pytest.approx(0.0, abs=2e-3 * total)
    # what is learned is drawn towards 1 by the prior
    assert abs(last.correction - 1.0) <= abs(factor - 1.0) + 1e-3
    assert np.sign(round(last.correction - 1.0, 3)) == np.sign(round(factor - 1.0, 3))


def test_full_battery_never_turns_round(tunnel: Path) -> None:
    mission = load_mission(tunnel)
    for forecast in OnlinePredictor.from_mission(mission).feed(record(simulate(mission), 0.5), every_s=30.0):
        assert forecast.can_finish
        assert not forecast.turn_round
        assert forecast.turn_round_in_s is None
        assert forecast.p_finish > 0.99


def _weak(tunnel: Path) -> tuple[OnlinePredictor, list[Forecast]]:
    full = load_mission(tunnel)
    mission = load_mission(tunnel, overrides=(("initial_charge.robot", "23 %"),))
    predictor = OnlinePredictor.from_mission(mission)
    return predictor, list(predictor.feed(record(simulate(full), 0.2), every_s=1.0))


def test_weak_battery_turns_round_in_time_to_come_home(tunnel: Path) -> None:
    predictor, forecasts = _weak(tunnel)
    assert not forecasts[0].can_finish
    assert forecasts[0].p_finish < 0.01
    turning = next(f for f in forecasts if f.turn_round)
    # at the call to turn, the way home still fits into what is left less the reserve, with a margin of the uncertainty
    left = turning.left_j - predictor.reserve_j
    assert left >= turning.to_return_j
    assert left - turning.to_return_j < 0.1 * predictor.available_j
    # the time until then was foretold from the start
    foretold = forecasts[0].turn_round_in_s
    assert foretold is not None
    assert foretold == pytest.approx(turning.time_s, rel=0.15)
    counted = [f.time_s + (f.turn_round_in_s or 0.0) for f in forecasts if not f.turn_round and f.time_s > 300.0]
    assert np.std(counted) < 60.0


def test_waiting_on_the_way_is_energy_without_progress() -> None:
    expected = ExpectedRun(
        np.array([10.0, 5.0, 10.0]),
        np.array([5.0, 0.0, 5.0]),
        np.array([20.0, 5.0, 20.0]),
        np.array([0.0, 20.0, 20.0, 40.0]),
    )
    predictor = OnlinePredictor(expected, available_j=1000.0)
    times = np.arange(0.0, 5.01, 0.1)
    for t in times:
        predictor.update(float(t), 2.0, 0.5)
    before = predictor.forecast()
    for t in np.arange(5.1, 20.0, 0.1):
        predictor.update(float(t), 1.0, 0.0)  # halfway through the drive: an unplanned stop
    after = predictor.forecast()
    assert after.progress == pytest.approx(before.progress, abs=0.01)
    assert after.drawn_j > before.drawn_j + 14.0
    assert after.left_j == pytest.approx(1000.0 - after.drawn_j)


def test_arrival_is_noticed_although_the_path_was_longer() -> None:
    expected = ExpectedRun(
        np.array([10.0, 20.0, 10.0]),
        np.array([5.0, 0.0, 5.0]),
        np.array([20.0, 10.0, 20.0]),
        np.array([0.0, 20.0, 20.0, 40.0]),
    )
    predictor = OnlinePredictor(expected, available_j=1000.0)
    for t in np.arange(0.0, 12.0, 0.1):
        predictor.update(float(t), 2.0, 0.5)  # 6 m driven instead of 5
    assert predictor.forecast().progress == pytest.approx(0.4, abs=0.01)
    for t in np.arange(12.0, 22.0, 0.1):
        predictor.update(float(t), 0.5, 0.0)
    assert predictor.forecast().progress == pytest.approx(0.5, abs=0.01)


def test_way_home_without_an_environment_is_back_over_the_way(root: Path) -> None:
    mission = load_mission(root / "missions" / "khepera3" / "crossing.yaml")
    predictor = OnlinePredictor.from_mission(mission)
    result = simulate(mission)
    drive = result.by_segment_wh("robot")[0] * 3600.0
    assert predictor.expected.return_j[0] == 0.0
    assert predictor.expected.return_j[-1] == pytest.approx(drive, rel=1e-9)


def test_wrong_use_is_told(root: Path, tunnel: Path) -> None:
    mission = load_mission(tunnel)
    with pytest.raises(InputError, match="no battery 'robott'"):
        OnlinePredictor.from_mission(mission, "robott")
    predictor = OnlinePredictor.from_mission(mission)
    with pytest.raises(InputError, match="no column 'time_s'"):
        next(predictor.feed({"power_robot_w": [1.0]}))
    predictor.update(1.0, 2.0)
    with pytest.raises(InputError, match="order of time"):
        predictor.update(1.0, 2.0)
    with pytest.raises(InputError, match="without recharging"):
        OnlinePredictor.from_mission(load_mission(root / "missions" / "pioneer3dx" / "recharging_patrol.yaml"))
    with pytest.raises(ValueError, match="n ≥ 1"):
        ExpectedRun(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))


def test_voltage_and_current_serve_as_power(tunnel: Path) -> None:
    mission = load_mission(tunnel)
    columns = record(simulate(mission), 1.0)
    split = {
        "time_s": columns["time_s"],
        "speed_m_s": columns["speed_m_s"],
        "voltage_robot_v": np.full(len(columns["time_s"]), 7.4),
        "current_robot_a": columns["power_robot_w"] / 7.4,
    }
    ends = [list(OnlinePredictor.from_mission(mission).feed(c, every_s=600.0))[-1].drawn_j for c in (columns, split)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)


def test_samples_without_a_reading_count_as_the_one_before(tunnel: Path) -> None:
    mission = load_mission(tunnel)
    columns = record(simulate(mission), 0.5)
    holes = {name: values.copy() for name, values in columns.items()}
    holes["power_robot_w"][:2] = np.nan
    holes["power_robot_w"][300:304] = np.inf
    holes["speed_m_s"][500:503] = np.nan
    whole, holed = (list(OnlinePredictor.from_mission(mission).feed(c, every_s=1e9))[-1] for c in (columns, holes))
    assert holed.drawn_j == pytest.approx(whole.drawn_j, rel=2e-3)
    assert holed.progress == pytest.approx(whole.progress, abs=2e-3)
    with pytest.raises(InputError, match="different lengths"):
        next(OnlinePredictor.from_mission(mission).feed({**columns, "power_robot_w": [1.0]}))
