"""Formulas mean the magnitude of the speed: a robot that reverses draws power as well."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.base_terms import aliased


def test_reversing_draws_what_driving_draws() -> None:
    speed, rate = np.array([0.5, -0.5, 0.0]), np.array([0.2, -0.2, 0.1])
    short = aliased({"speed_m_s": speed, "accel_m_s2": rate})
    assert short["v"].tolist() == [0.5, 0.5, 0.0]
    assert short["a"].tolist() == [0.2, 0.2, 0.1]  # both speed up
    assert short["a"] * short["v"] == pytest.approx(rate * speed)
    assert short["speed_m_s"] is speed
