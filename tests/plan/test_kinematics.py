"""Profiles with limited acceleration: distances, limits, cutting into pieces, arrays of draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionsim.plan.kinematics import Phases, ramp_phases

lengths = st.lists(st.floats(0.01, 200.0), min_size=1, max_size=6)
rates = st.floats(0.05, 5.0)


def driven(made: Phases) -> np.ndarray:
    return np.sum(made.speed_m_s * made.duration_s + 0.5 * made.accel_m_s2 * made.duration_s**2, axis=-1)


def squares(made: Phases) -> float:
    """∫ v² dt over a run, exactly."""
    v, a, t = made.speed_m_s, made.accel_m_s2, made.duration_s
    return float(np.sum(v**2 * t + v * a * t**2 + a**2 * t**3 / 3.0))


@given(lengths, st.data(), rates, rates)
@settings(max_examples=300, deadline=None)
def test_distances_limits_and_continuity(distance: list[float], data: st.DataObject, up: float, down: float) -> None:
    limit = data.draw(st.lists(st.floats(0.05, 3.0), min_size=len(distance), max_size=len(distance)))
    made = ramp_phases(distance, limit, up, down)
    assert driven(made) == pytest.approx(distance, rel=1e-9)
    end = made.speed_m_s + made.accel_m_s2 * made.duration_s
    assert np.all(made.duration_s >= 0.0)
    assert np.all(made.speed_m_s <= np.asarray(limit)[:, None] * (1 + 1e-12))
    assert np.all(end <= np.asarray(limit)[:, None] * (1 + 1e-9) + 1e-12)
    flat_start, flat_end = made.speed_m_s.reshape(-1), end.reshape(-1)
    lasting = made.duration_s.reshape(-1) > 0.0
    assert flat_start[lasting][1:] == pytest.approx(flat_end[lasting][:-1], abs=1e-6)
    assert flat_start[lasting][0] == 0.0
    assert flat_end[lasting][-1] == pytest.approx(0.0, abs=1e-6)


@given(st.floats(0.1, 300.0), st.floats(0.05, 3.0), rates, rates, st.lists(st.floats(0.01, 0.99), max_size=5))
@settings(max_examples=300, deadline=None)
def test_cutting_a_piece_changes_nothing(
    distance: float, limit: float, up: float, down: float, cuts: list[float]
) -> None:
    whole = ramp_phases([distance], [limit], up, down)
    borders = np.array([0.0, *sorted(cuts), 1.0]) * distance
    parts = np.diff(borders)
    parts = parts[parts > 0.0]
    cut = ramp_phases(parts, np.full(len(parts), limit), up, down)
    assert cut.duration_s.sum() == pytest.approx(float(whole.duration_s.sum()), rel=1e-12)
    assert squares(cut) == pytest.approx(squares(whole), rel=1e-11)


def test_trapezoid_and_triangle_by_hand() -> None:
    made = ramp_phases([10.0], [0.5], 0.25, 0.5)
    assert made.duration_s[0] == pytest.approx([2.0, (10.0 - 0.5 - 0.25) / 0.5, 1.0])
    short = ramp_phases([0.3], [2.0], 1.0, 1.0)
    assert short.duration_s[0] == pytest.approx([0.3**0.5, 0.0, 0.3**0.5])


def test_braking_for_a_slow_zone_begins_before_it() -> None:
    def begins(distance_m: list[float], limit_m_s: list[float]) -> list[float]:
        made = ramp_phases(distance_m, limit_m_s, 0.5, 0.25)
        return [float(speed) for speed in made.speed_m_s[:, 0]]

    assert begins([10.0, 5.0, 10.0], [1.0, 0.2, 1.0]) == pytest.approx([0.0, 0.2, 0.2])
    # the next piece is too short to brake in: the limit reaches back over it
    short = begins([10.0, 0.01, 5.0], [1.0, 1.0, 0.1])
    assert short == pytest.approx([0.0, (0.1**2 + 2 * 0.25 * 0.01) ** 0.5, 0.1])


def test_draws_broadcast_to_the_same_numbers_as_scalars() -> None:
    rng = np.random.default_rng(3)
    distance, limit = rng.uniform(0.5, 30.0, (50, 4)), rng.uniform(0.1, 1.5, (50, 4))
    up, down = rng.uniform(0.1, 1.0, 50), rng.uniform(0.1, 1.0, 50)
    together = ramp_phases(distance, limit, up, down)
    assert together.duration_s.shape == (50, 4, 3)
    for i in range(50):
        alone = ramp_phases(distance[i], limit[i], up[i], down[i])
        assert np.array_equal(alone.duration_s, together.duration_s[i])
