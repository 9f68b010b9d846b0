"""Formulas mean the magnitude of the speed: a robot that reverses draws power as well."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.base_terms import aliased
from missionsim.physics import motion


def test_reversing_draws_what_driving_draws() -> None:
    speed, rate = np.array([0.5, -0.5, 0.0]), np.array([0.2, -0.2, 0.1])
    short = aliased({"speed_m_s": speed, "accel_m_s2": rate})
    assert short["v"].tolist() == [0.5, 0.5, 0.0]
    assert short["a"].tolist() == [0.2, 0.2, 0.1]  # both speed up
    assert short["a"] * short["v"] == pytest.approx(rate * speed)
    assert short["speed_m_s"] is speed


def test_friction_and_drag_of_a_robot_that_reverses_cost_as_much() -> None:
    for power, squared in ((motion.coulomb_power, 2.0), (motion.quadratic_power, 4.0), (motion.drag_power, 8.0)):
        assert power(2.0, 1.0) == squared
        assert power(-2.0, 1.0) == squared
    assert motion.coulomb_power(-0.5, 3.0) == 1.5
    assert motion.payload_power(-2.0, 5.0, 0.3) == pytest.approx(3.0)
