"""The library's declarations: complete, with a source of their own."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.library import effect_ids, get_effect
from missionsim.physics.electrical import sensor_power, sonar_power


@pytest.mark.parametrize(
    "id",
    [name for name in effect_ids() if "<" not in name]
    + ["component_power:lidar", "component_warmup:lidar", "surface_rolling_resistance:gravel"],
)
def test_every_effect_tells_equation_units_bounds_and_where_it_comes_from(id: str) -> None:
    effect = get_effect(id, ("gravel",))
    assert effect.equation
    assert effect.meaning
    assert "library of effects" not in effect.source
    assert any(word in effect.source for word in ("paper", "Jaiem", "Newton", "Coulomb", "Joule", "assumed"))
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.low < parameter.high
    assert effect.sign in (0, 1)


def test_friction_of_stiffer_grease_grows_below_its_reference_and_falls_above() -> None:
    effect = get_effect("temperature_friction")
    names = {parameter.name for parameter in effect.parameters}
    at = {"speed_m_s": 2.0, "moving_time_s": 100.0}
    given = {name: 20.0 if name != "k" else 0.5 for name in names}
    assert float(np.asarray(effect.power({**at, "temp_ambient_c": 10.0}, given))) == pytest.approx(10.0)
    assert float(np.asarray(effect.power({**at, "temp_ambient_c": 25.0}, given))) == pytest.approx(-5.0)


HALF_LIFE_S = 100.0 * np.log(2.0)


@pytest.mark.parametrize(
    ("id", "cov", "values", "watts"),
    [
        ("payload", {"speed_m_s": -2.0, "payload_kg": 5.0}, {"k": 0.3}, 3.0),
        ("turning_scrub", {"yaw_rate_rad_s": -1.5}, {"k": 4.0}, 6.0),
        ("rolling_friction", {"speed_m_s": -0.5}, {"k": 8.0}, 4.0),
        ("viscous_friction", {"speed_m_s": -0.5}, {"k": 8.0}, 2.0),
        ("aerodynamic_drag", {"speed_m_s": -0.5}, {"k": 8.0}, 1.0),
        ("cold_friction", {"speed_m_s": -0.5, "moving_time_s": HALF_LIFE_S}, {"k": 8.0, "tau": 100.0}, 2.0),
        ("start_surge", {"speed_m_s": 1.0, "starts_per_s": 0.25}, {"E": 12.0}, 3.0),
        ("conversion_loss", {"load_w": 30.0}, {"k": 0.001}, 0.9),
        ("battery_resistance", {"load_w": 20.0, "voltage_<battery>_v": 10.0}, {"k": 0.1}, 0.4),
        ("standby_load", {}, {"k": 3.0}, 3.0),
        ("cpu_load", {"cpu_load": 0.5}, {"k": 6.0}, 3.0),
        ("cpu_frequency", {"cpu_load": 0.5, "cpu_freq_hz": 2e9}, {"k": 1e-27}, 4.0),
        ("radio_range", {"access_point_distance_m": 20.0}, {"k": 0.002}, 0.8),
        ("component_power:lidar", {"on_lidar": 1.0}, {"k": 8.0}, 8.0),
        ("component_warmup:lidar", {"on_lidar": 1.0, "on_time_lidar_s": HALF_LIFE_S}, {"k": 8.0, "tau": 100.0}, 4.0),
        ("component_warmup:lidar", {"on_lidar": 0.0, "on_time_lidar_s": 0.0}, {"k": 8.0, "tau": 100.0}, 0.0),
    ],
)
def test_what_an_effect_draws_is_its_equation(
    id: str, cov: dict[str, float], values: dict[str, float], watts: float
) -> None:
    assert float(np.asarray(get_effect(id).power(cov, values))) == pytest.approx(watts, rel=1e-12)


def test_a_sonar_draws_more_than_in_proportion_to_its_rate() -> None:
    assert sonar_power(10.0, 0.0045, 0.2) == pytest.approx(2.45, rel=1e-12)


def test_a_sensor_draws_by_its_rate_and_nothing_without_samples() -> None:
    """Parasuraman 2012, Eq. 5: s₁ f + s₂."""
    assert sensor_power([0.0, 10.0], per_rate_w_s=0.2, constant_w=1.5) == pytest.approx([0.0, 3.5])
