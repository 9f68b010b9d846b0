"""Physics of Mecanum wheels, processors and path following, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionsim.physics import electrical, mecanum, motion
from missionsim.published import parasuraman2012

speeds = st.floats(-3.0, 3.0)
angles = st.floats(-3.1, 3.1)


def test_speed_of_least_energy_of_a_parabola() -> None:
    speeds_m_s = np.linspace(0.1, 2.0, 400)
    best = motion.speed_of_least_energy(3.66, speeds_m_s, 6.25 * speeds_m_s**2 + 9.79 * speeds_m_s)
    assert best == pytest.approx(np.sqrt(3.66 / 6.25), abs=1e-4)
    assert motion.speed_of_least_energy(0.0, speeds_m_s, speeds_m_s**2) == pytest.approx(0.1)


@given(speeds, speeds, st.floats(-2.0, 2.0))
def test_wheels_give_the_motion_back(ahead: float, left: float, turning: float) -> None:
    half = 0.35
    front_left, front_right, rear_left, rear_right = (
        float(u) for u in mecanum.wheel_speeds(ahead, left, turning, half_sum_m=half)
    )
    assert (front_left + front_right + rear_left + rear_right) / 4 == pytest.approx(ahead, abs=1e-12)
    assert (-front_left + front_right + rear_left - rear_right) / 4 == pytest.approx(left, abs=1e-12)
    assert (-front_left + front_right - rear_left + rear_right) / (4 * half) == pytest.approx(turning, abs=1e-12)


@given(st.floats(0.1, 2.0), angles, speeds, speeds)
def test_forces_do_the_work(speed: float, angle: float, along: float, across: float) -> None:
    """Virtual work: forces at the rims times wheel speeds are friction plus kinetic power."""
    ahead, left = speed * np.cos(angle), speed * np.sin(angle)
    parts = {"mass_kg": 9.0, "wheel_friction_n": 20.0, "roller_friction_n": 3.0}
    forces = mecanum.wheel_forces(ahead, left, along, across, **parts)
    wheels = mecanum.wheel_speeds(ahead, left)
    work = sum(float(f * u) for f, u in zip(forces, wheels, strict=True))
    balance = (
        mecanum.wheels_power(ahead, left, 0.0, 9.0, 0.0, 20.0, 0.0)
        + mecanum.rollers_power(left, 0.0, 9.0, 0.0, 3.0, 0.0)
        + mecanum.planar_kinetic_power(ahead, along, left, across, 9.0)
    )
    assert work == pytest.approx(float(balance), rel=1e-9, abs=1e-9)


def test_copper_loss_straight_ahead() -> None:
    loss = mecanum.windings_power(1.0, 0.0, 2.0, 0.0, 0.0, 9.0, 0.0, 20.0, 0.0, 0.01)
    assert float(loss) == pytest.approx(0.01 * (20.0 + 18.0) ** 2)


def test_starts_reach_their_speed() -> None:
    time = np.linspace(0.0, 0.5, 100001)
    for profile in (mecanum.minimum_jerk, mecanum.linear_ramp):
        speed, accel = profile(time, speed_m_s=1.2, duration_s=0.3)
        assert speed[-1] == pytest.approx(1.2)
        assert np.trapezoid(accel, time) == pytest.approx(1.2, rel=1e-4)


BOARD = {
    **{"board_idle_w": 3.0, "core_work_w": 1.2, "core_idle_w": 0.06, "core_idle_floor_w": 0.02},
    **{"cores": 6, "cores_busy": 4, "low_v": 0.7, "high_v": 1.1},
}


@given(st.floats(0.35e9, 2.0e9), st.floats(1e6, 1e8))
def test_clock_up_time_down_power_up(clock: float, more: float) -> None:
    work = {"fixed_s": 0.003, "cycles": 3e7, "cycles_per_speed": 4e6}
    assert electrical.loop_time(clock + more, 2.0, 1.0, **work) < electrical.loop_time(clock, 2.0, 1.0, **work)
    board = BOARD | {"low_hz": 0.3456e9, "high_hz": 2.0352e9}
    assert electrical.multicore_power(clock + more, 0.5, **board) > electrical.multicore_power(clock, 0.5, **board)


def test_multicore_power_by_hand() -> None:
    watts = electrical.multicore_power(2e9, 0.5, **BOARD, low_hz=0.5e9, high_hz=2e9)
    assert float(watts) == pytest.approx(3.0 + 6 * 0.06 + 4 * 1.2 * 0.5)


def test_throughput_saturates() -> None:
    assert electrical.throughput([0.01, 0.05], batch_rate_hz=30.0) == pytest.approx([30.0, 20.0])
    assert electrical.utilisation([0.01, 0.05], batch_rate_hz=30.0) == pytest.approx([0.3, 1.0])


def test_components_that_are_never_apart_are_refused() -> None:
    on = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    with pytest.raises(ValueError, match="switch them one by one"):
        parasuraman2012.component_powers([3.0, 1.0, 3.0], on)


def test_relocalisation_stretch_against_the_drawn_path() -> None:
    """Drift for L metres, then back over s metres: the length of that zigzag, to second order."""
    spacing, drift, settle = 10.0, 0.02, 1.0
    offset = drift * spacing
    drawn = (spacing - settle + np.hypot(settle, offset)) / spacing
    formula = float(motion.relocalisation_stretch(spacing, drift=drift, settle_m=settle))
    assert formula == pytest.approx(drawn, abs=1e-4)


def test_centring_stretch_against_the_length_of_a_sine() -> None:
    x = np.linspace(0.0, 4.0, 200001)
    y = 0.05 * np.sin(2 * np.pi * x / 4.0)
    length = np.sum(np.hypot(np.diff(x), np.diff(y))) / 4.0
    assert float(motion.centring_stretch(0.05, 4.0)) == pytest.approx(length, abs=1e-5)
    assert float(motion.settling_stretch(0, 10.0, heading_error_rad=0.5, settle_m=1.0)) == 1.0
