"""Power in a control loop: horizons, optima, fidelity levels."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.control import PowerPredictor
from missionsim.errors import InputError
from missionsim.fidelity import LEVELS, AutoFidelity, FidelityModel


@pytest.fixture(scope="module")
def rover() -> PowerPredictor:
    return PowerPredictor("rover_tx2")


def test_horizon_is_the_sum_of_its_steps(rover: PowerPredictor) -> None:
    speeds = np.random.default_rng(0).uniform(1.0, 5.0, (50, 20))
    energy = rover.horizon_energy(speeds, 0.1, 1.2672e9, complexity=0.6, start_speed_m_s=2.0)
    assert energy.shape == (50,)
    before, total = 2.0, 0.0
    for speed in speeds[7]:
        watts = rover.power(0.5 * (speed + before), 1.2672e9, 0.6, accel_m_s2=(speed - before) / 0.1)
        total += 0.1 * float(watts)
        before = speed
    assert energy[7] == pytest.approx(total, rel=1e-12)


def test_a_horizon_is_one_evaluation(rover: PowerPredictor, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many candidates and steps; the benchmarks hold what the points of an evaluation cost."""
    shapes: list[tuple[int, ...]] = []

    def counted(speed: np.ndarray, *more: object, **covariates: object) -> np.ndarray:
        shapes.append(speed.shape)
        return np.ones_like(speed)

    monkeypatch.setattr(rover, "power", counted)
    rover.horizon_energy(np.full((50, 20), 2.0), 0.1, np.full((50, 20), rover.clocks()[0]))
    assert shapes == [(50, 20)]


def test_optimum_keeps_the_service(rover: PowerPredictor) -> None:
    speeds, clocks = np.arange(0.25, 9.01, 0.25), rover.clocks()
    best = rover.best(speeds, clocks, 1.0)
    assert best.feasible
    assert rover.meets_service(best.speed_m_s, best.freq_hz, 1.0)
    free = rover.best(speeds, clocks, 1.0, service=False)
    assert free.energy_j_m <= best.energy_j_m
    grid_speed, grid_clock = np.meshgrid(speeds, clocks, indexing="ij")
    energy = rover.energy_per_metre(grid_speed, grid_clock, 1.0)
    allowed = rover.meets_service(grid_speed, grid_clock, 1.0)
    assert best.energy_j_m == pytest.approx(float(np.min(energy[allowed])))


def test_no_setting_that_keeps_the_service_is_said(rover: PowerPredictor) -> None:
    best = rover.best(np.array([8.0, 9.0]), rover.clocks(), 1.0)
    assert not best.feasible
    assert best.speed_m_s == 8.0


def test_a_robot_without_that_computer_is_refused() -> None:
    with pytest.raises(InputError, match="no computer whose load follows its speed"):
        PowerPredictor("khepera3").clocks()
    assert float(PowerPredictor("khepera3", on={}).power(0.1)) > 0.0


def test_finer_is_more_exact_and_dearer(rover: PowerPredictor) -> None:
    model = FidelityModel(rover, (0.5, 9.0))
    measured = model.measure(LEVELS)
    errors = [item.mean_error_pct for item in measured]
    assert errors == sorted(errors, reverse=True)
    assert len(set(errors)) == len(errors)
    assert np.all(np.diff([item.evaluations for item in measured]) > 0)
    assert all(item.mean_error_pct <= item.max_error_pct for item in measured)
    assert measured[-1].regret_pct == 0.0


def test_table_is_exact_on_its_grid(rover: PowerPredictor) -> None:
    model = FidelityModel(rover, (0.5, 9.0), 0.6)
    speeds, clocks = model.grid(LEVELS[2])
    exact = rover.energy_per_metre(speeds[:, None], clocks[None, :], 0.6)
    assert model.energy(LEVELS[2], speeds[:, None], clocks[None, :]) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("promised", [20.0, 6.0, 2.0, 0.5, 0.01])
def test_auto_keeps_its_promise_with_the_coarsest_level(rover: PowerPredictor, promised: float) -> None:
    auto = AutoFidelity(rover, (0.5, 9.0), promised, budget_s=1.0)
    level, kept = auto.choose(0.3)
    assert kept
    assert auto.error_of(level, 0.3) <= promised
    coarser = LEVELS[: LEVELS.index(level)]
    assert all(auto.error_of(other, 0.3) > promised for other in coarser)
    rng = np.random.default_rng(8)
    speed, clock = rng.uniform(0.5, 9.0, 2000), rng.choice(rover.clocks(), 2000)
    energy, used, _ = auto.predict(speed, clock, 0.3)
    exact = rover.energy_per_metre(speed, clock, 0.3)
    assert used == level
    assert 100.0 * float(np.mean(np.abs(energy / exact - 1.0))) < 1.3 * promised


def test_auto_changes_while_the_mission_runs(rover: PowerPredictor) -> None:
    auto = AutoFidelity(rover, (0.5, 9.0), 0.01, budget_s=1.0)
    first, kept = auto.choose(1.0)
    assert kept
    for _ in range(40):
        auto.observe(first, 5.0)  # the computer has become slow
    second, still_kept = auto.choose(1.0)
    assert second != first
    assert auto.error_of(second, 1.0) > auto.error_pct or not still_kept or second in LEVELS[LEVELS.index(first) :]
    auto.error_pct = 10.0
    third, kept = auto.choose(1.0)
    assert kept
    assert LEVELS.index(third) < LEVELS.index(first)


def test_no_budget_gives_the_coarsest_and_says_so(rover: PowerPredictor) -> None:
    auto = AutoFidelity(rover, (0.5, 9.0), 0.01, budget_s=0.0)
    level, kept = auto.choose()
    assert (level, kept) == (LEVELS[0], False)


def test_what_cannot_be_a_setting_is_refused(rover: PowerPredictor) -> None:
    clocks = rover.clocks()
    for speeds in ([], [0.0], [-1.0, 1.0], [np.nan, 1.0]):
        with pytest.raises(InputError, match="speeds or clocks"):
            rover.best(speeds, clocks)
    for complexity in (-1.0, float("nan")):
        with pytest.raises(InputError, match="complexity"):
            rover.best([1.0, 2.0], clocks, complexity)
    for step_s in (0.0, float("nan")):
        with pytest.raises(InputError, match="step of time"):
            rover.horizon_energy(np.ones((2, 3)), step_s)
