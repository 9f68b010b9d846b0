"""The library's declarations: complete, with a source of their own."""

from __future__ import annotations

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
