"""What a descent takes from the drive: the same part of its power as of the lifting, never more than all of it."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.library import get_effect
from missionsim.inputs.loading import robot_from_text, shipped_robots
from missionsim.inputs.power import build_power_model
from missionsim.physics.motion import relieved_powers

MASS_KG, DRIVE_W = 30.0, 6.0
SLOPES = np.array([0.1, 0.02, -0.02, -0.1])


@pytest.mark.parametrize(("k", "floor_w"), [(0.5, -3.0), (1.0, -6.0), (1.6, -6.0)])
def test_grade_takes_its_part_of_the_drive(k: float, floor_w: float) -> None:
    cov = {"speed_m_s": np.full(4, 0.5), "slope_rad": SLOPES, "mass_kg": MASS_KG, "drive_w": np.full(4, DRIVE_W)}
    lifting = k * MASS_KG * 9.81 * 0.5 * np.sin(SLOPES)
    power = get_effect("grade").alone(cov, {"k": k})
    assert power[:3] == pytest.approx(lifting[:3], rel=1e-3)
    assert lifting[3] < floor_w
    assert power[3] == pytest.approx(floor_w)


@pytest.mark.parametrize(("ahead", "saved_w"), [(None, 30.0), (0.0, 30.0), (0.5, 20.0), (1.0, 10.0)])
def test_a_descent_may_relieve_what_driving_straight_ahead_needs(ahead: float | None, saved_w: float) -> None:
    """10 W of driving and 20 W of tyres that slide sideways, on a slope that is steep enough for both."""
    grade = "k: 1.4" if ahead is None else f"k: 1.4, ahead: {ahead}"
    own = build_power_model(
        robot_from_text(
            "kind: robot\nname: cart\nbody: {mass: 30 kg, drive: skid_steer, max_speed: 2 m/s}\n"
            "batteries: {robot: {capacity: 100 Wh}}\n"
            "motion: {battery: robot, model: expression, power: 'c3*v + kw*abs(w)', parameters: {c3: 10, kw: 20}}\n"
            f"effects:\n  - {{effect: grade, battery: robot, parameters: {{{grade}}}}}\n"
        )
    )
    level, steep = ({"speed_m_s": 1.0, "yaw_rate_rad_s": 1.0, "slope_rad": slope} for slope in (0.0, -0.3))
    saved = np.asarray(own.total(level, "robot")) - np.asarray(own.total(steep, "robot"))
    assert saved == pytest.approx(saved_w)
    alone = {"mass_kg": 30.0, "drive_w": 30.0, "traction_w": 10.0, **steep}
    values = {"k": 1.4} | ({} if ahead is None else {"ahead": ahead})
    assert get_effect("grade").alone(alone, values) == pytest.approx(-saved_w)


def test_parts_of_several_terms() -> None:
    # both together would take 12 W; half of the help may take all of the drive, half a half of it
    assert relieved_powers([-6.0, -6.0], 8.0, 0.0, [1.0, 0.5]) == pytest.approx([-3.0, -3.0])
    assert relieved_powers([-1.0, -2.0], 8.0, 0.0, [1.0, 0.5]) == pytest.approx([-1.0, -2.0])
    # what speeding up takes is paid by the descent first, whatever its part of the drive
    assert sum(relieved_powers([5.0, -20.0], 8.0, 0.0, [1.0, 0.5])) == pytest.approx(-4.0)


def test_the_model_limits_grade_as_the_effect_does() -> None:
    text = shipped_robots()["pioneer3dx"].read_text(encoding="utf-8") + (
        "effects:\n  - {effect: grade, battery: robot, parameters: {k: 0.6}}\n"
    )
    model = build_power_model(robot_from_text(text))
    flat, steep = (
        {"speed_m_s": np.array([0.5]), "slope_rad": np.array([slope]), "accel_m_s2": np.zeros(1)}
        for slope in (0.0, -0.3)
    )
    drive = 6.25 * 0.5**2 + 9.79 * 0.5  # what does not depend on driving (C4, electronics) is not relieved
    fallen = model.total(flat, "robot") - model.total(steep, "robot")
    assert fallen[0] == pytest.approx(0.6 * drive)
