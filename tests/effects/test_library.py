"""The library's declarations: complete, with a source of their own."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.effects.library import effect_ids, get_effect


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
