"""The Gymnasium environment passes Gymnasium's own checker and has the physics of the robot."""

from __future__ import annotations

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="the extra 'gym' is not installed")


@pytest.fixture
def env():  # type: ignore[no-untyped-def]
    from missionsim.gym_env import RoverEnv

    return RoverEnv()


@pytest.mark.filterwarnings("error")
def test_gymnasiums_checker(env) -> None:  # type: ignore[no-untyped-def]
    from gymnasium.utils.env_checker import check_env

    check_env(env, skip_render_check=True)


def test_registered() -> None:
    import missionsim.gym_env  # noqa: F401

    made = gymnasium.make("missionsim/Rover-v0")
    observation, _ = made.reset(seed=4)
    assert made.observation_space.contains(observation)


def _drive(env, action: list[float], seed: int = 1) -> tuple[float, dict[str, float], bool]:  # type: ignore[no-untyped-def]
    env.reset(seed=seed)
    total, missed = 0.0, 0.0
    while True:
        _, reward, terminated, truncated, info = env.step(np.array(action, dtype=np.float32))
        total, missed = total + reward, missed + info["missed_batches"]
        if terminated or truncated:
            return total, {**info, "missed": missed}, terminated


def test_driving_ends_the_track(env) -> None:  # type: ignore[no-untyped-def]
    _, info, terminated = _drive(env, [-0.3, 0.0])
    assert terminated
    assert info["position_m"] == env.length_m
    assert info["drawn_j"] > 0.0


def test_standing_is_cut_off(env) -> None:  # type: ignore[no-untyped-def]
    _, info, terminated = _drive(env, [-1.0, -1.0])
    assert not terminated
    assert info["position_m"] == 0.0
    assert info["drawn_j"] > 0.0


def test_racing_costs_energy_and_slow_clocks_miss_batches(env) -> None:  # type: ignore[no-untyped-def]
    calm, fast = (_drive(env, [speed, 1.0]) for speed in (-0.4, 1.0))
    assert fast[1]["drawn_j"] > calm[1]["drawn_j"]
    assert _drive(env, [-0.4, -1.0])[1]["missed"] > calm[1]["missed"]


def test_same_seed_same_track(env) -> None:  # type: ignore[no-untyped-def]
    assert _drive(env, [-0.3, 0.2], seed=9)[0] == _drive(env, [-0.3, 0.2], seed=9)[0]
    assert _drive(env, [-0.3, 0.2], seed=9)[0] != _drive(env, [-0.3, 0.2], seed=10)[0]
