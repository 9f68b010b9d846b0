"""The rate of a noisy speed: cruises are smoothed, jolts are not, and two logs of one robot are read alike."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.covariates import acceleration, between_refreshes, is_moving, speed_noise

STEP_S = 0.2


def ride(seed: int, noise_m_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, logged speed and true acceleration: cruises of half a minute and changes of speed within a second."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 600.0, STEP_S)
    rate = np.zeros(len(time_s))
    going = False
    for start in range(100, len(time_s) - 200, 150):
        rate[start : start + 5] = -2.0 if going else 2.0
        going = not going
    speed = np.cumsum(rate) * STEP_S + 3.0
    return time_s, speed + rng.normal(0.0, noise_m_s, len(time_s)), np.gradient(speed, time_s)


def over_rows(speed: np.ndarray, rows: int) -> np.ndarray:
    """Slope over a fixed number of rows."""
    x = (np.arange(rows) - rows // 2) * STEP_S
    return np.convolve(speed, x[::-1] / (x @ x), mode="same")


@pytest.mark.parametrize("noise_m_s", [0.01, 0.02, 0.04])
def test_it_follows_jolts_and_smooths_cruises(noise_m_s: float) -> None:
    time_s, speed, truth = ride(1, noise_m_s)
    inner = slice(20, -20)
    found = acceleration(speed, time_s)[inner]
    jolt = truth[inner] != 0.0

    def error(one: np.ndarray, rows: np.ndarray) -> float:
        return float(np.sqrt(np.mean((one - truth[inner])[rows] ** 2)))

    narrow, wide = over_rows(speed, 3)[inner], over_rows(speed, 11)[inner]
    assert error(found, ~jolt) < 0.7 * error(narrow, ~jolt)
    assert error(found, jolt) < 0.5 * error(wide, jolt)


def test_noisier_logs_of_one_robot_keep_the_size_of_a_jolt() -> None:
    sizes = []
    for seed, noise_m_s in enumerate((0.005, 0.014, 0.022)):
        time_s, speed, truth = ride(seed, noise_m_s)
        found = acceleration(speed, time_s)
        sizes.append(float(found @ truth / (truth @ truth)))
    assert np.ptp(sizes) < 0.05 * np.mean(sizes)


@pytest.mark.parametrize("step_m_s", [1e-6, 0.1 / 3.6])
def test_the_noise_is_that_of_the_speed_and_not_of_its_changes(step_m_s: float) -> None:
    _, speed, _ = ride(2, 0.02)
    rounded = np.round(speed / step_m_s) * step_m_s  # a logger's tenths of a km/h
    assert speed_noise(rounded) == pytest.approx(np.hypot(0.02, step_m_s / np.sqrt(12.0)), rel=0.1)


def test_slow_changes_of_a_rounded_speed_are_smoothed() -> None:
    """A wheel that speeds up and slows down for half a minute: rarely is a line over 2 s refuted by chance."""
    time_s = np.arange(0.0, 900.0, STEP_S)
    speed = 5.0 - 2.0 * np.cos(0.07 * time_s) + np.random.default_rng(3).normal(0.0, 0.02, len(time_s))
    found = acceleration(np.round(speed * 36.0) / 36.0, time_s) - 0.14 * np.sin(0.07 * time_s)
    assert np.sqrt(np.mean(found**2)) < 0.02


@pytest.mark.parametrize("rows", [2, 5])
def test_a_speed_of_a_slower_topic_has_no_jolts(rows: int) -> None:
    """Once a second or every 0.4 s in rows every 0.2 s, rounded, so that a cruise repeats it for long."""
    time_s = np.arange(0.0, 400.0, STEP_S)
    truth = 0.6 * np.sin(0.2 * time_s)
    speed = 6.0 - 3.0 * np.cos(0.2 * time_s)
    held = np.round(speed[np.arange(len(time_s)) // rows * rows], 1)
    found = acceleration(held, time_s)
    behind = acceleration(speed, time_s - 0.5 * rows * STEP_S)
    error, jolting = (float(np.sqrt(np.mean((one - behind) ** 2))) for one in (found, np.gradient(held, time_s)))
    assert error < 0.12
    assert error < 0.8 * jolting
    assert found @ truth / (truth @ truth) > 0.9


def test_a_speed_that_jumps_between_long_cruises_is_no_slower_topic() -> None:
    time_s = np.arange(0.0, 400.0, STEP_S)
    speed = np.where(time_s // 20.0 % 2.0, 1.0, 0.5)
    assert between_refreshes(speed, time_s) is speed


@pytest.mark.parametrize(("wheel_m_s", "moves"), [(0.012, False), (0.06, True)])
def test_noise_of_a_wheel_is_no_drive(wheel_m_s: float, moves: bool) -> None:
    """3 mm/s of it made a tenth of the rows at rest a drive, and a law of moving of 10 % of the energy."""
    cov = {"speed_m_s": np.zeros(3), "yaw_rate_rad_s": np.zeros(3), "wheel_speed_m_s": np.full(3, wheel_m_s)}
    assert np.asarray(is_moving(cov)).tolist() == [moves] * 3
