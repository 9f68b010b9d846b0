"""Exact integration: closed forms, brute force, memory, and the sense of each term."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionsim.effects.library import get_effect
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.effects.named_models import get_motion_model
from missionsim.effects.timeline import Timeline, integrate


def value(number: float) -> ModelParameter:
    return ModelParameter(number)


def model(*extra: tuple[str, dict[str, float]], **parameters: float) -> PowerModel:
    base = {"c2": 6.25, "c3": 9.79, "c4": 3.66, "standing": 2.67} | parameters
    result = PowerModel(
        tuple(get_motion_model("polynomial").build("robot", {name: value(v) for name, v in base.items()})),
        ("robot",),
        {"body_mass_kg": 25.0, "regeneration": 0.0},
    )
    for id, values in extra:
        effect = get_effect(id)
        named = {n: value(v) for n, v in values.items()}
        term = Term(TermKey("robot", effect.component, id), effect, named, base=False)
        result = replace(result, terms=(*result.terms, term))
    return result


def ramp_timeline(accel: float, cruise_s: float) -> Timeline:
    """From rest to speed in 2 s, cruise, to rest in 2 s."""
    speed = 2.0 * accel
    starts = np.array([0.0, 2.0, 2.0 + cruise_s])
    return Timeline(
        starts,
        np.array([2.0, cruise_s, 2.0]),
        {
            "speed_m_s": np.array([0.0, speed, speed]),
            "accel_m_s2": np.array([accel, 0.0, -accel]),
            "moving": np.ones(3),
            "moving_time_s": starts,
            "starts": np.array([1.0, 0.0, 0.0]),
            "slope_rad": np.zeros(3),
        },
        {"speed_m_s": np.array([accel, 0.0, -accel]), "moving_time_s": np.ones(3)},
    )


def energy(power_model: PowerModel, timeline: Timeline, name: str) -> np.ndarray:
    return {key.name: joules for key, joules in integrate(power_model, timeline)["robot"].items()}[name]


@given(st.floats(0.01, 2.0), st.floats(0.1, 1e5))
def test_ramps_match_closed_forms(accel: float, cruise_s: float) -> None:
    timeline = ramp_timeline(accel, cruise_s)
    speed = 2.0 * accel
    viscous = energy(model(), timeline, "viscous")
    rolling = energy(model(), timeline, "rolling")
    assert viscous == pytest.approx(6.25 * speed**2 * np.array([2 / 3, cruise_s, 2 / 3]), rel=1e-12)
    assert rolling == pytest.approx(9.79 * speed * np.array([1.0, cruise_s, 1.0]), rel=1e-12)


@given(st.floats(5.0, 2000.0), st.floats(1.0, 1e5))
def test_cold_friction_over_a_long_interval_is_exact(tau: float, cruise_s: float) -> None:
    timeline = ramp_timeline(0.25, cruise_s)
    got = energy(model(("cold_friction", {"k": 3.0, "tau": tau})), timeline, "cold_friction")
    want = 3.0 * 0.5 * tau * (math.exp(-2.0 / tau) - math.exp(-(2.0 + cruise_s) / tau))
    assert got[1] == pytest.approx(want, rel=1e-9)


def test_every_effect_against_brute_force() -> None:
    """A fine Riemann sum of instantaneous power agrees for all terms that change within an interval."""
    terms = (
        ("aerodynamic_drag", {"k": 2.0}),
        ("acceleration", {"k": 1.2}),
        ("cold_friction", {"k": 3.0, "tau": 40.0}),
        ("conversion_loss", {"k": 0.01}),
        ("grade", {"k": 1.0}),
    )
    power_model = model(*terms, c6=25.0)
    timeline = ramp_timeline(0.3, 30.0)
    exact = integrate(power_model, timeline)["robot"]
    count = 40_000
    index = np.arange(3)
    middle = (np.arange(count) + 0.5) / count
    cov = timeline.at(index, timeline.duration_s[:, None] * middle)
    brute = power_model.evaluate(cov)["robot"]
    for key, joules in exact.items():
        mean = np.broadcast_to(brute[key], (3, count)).mean(axis=1)
        assert joules == pytest.approx(mean * timeline.duration_s, rel=1e-6, abs=1e-6), key


def test_start_surge_is_booked_once_at_each_start() -> None:
    got = energy(model(("start_surge", {"E": 12.0})), ramp_timeline(0.3, 10.0), "start_surge")
    assert got.tolist() == [12.0, 0.0, 0.0]


def test_braking_gives_nothing_back_without_regeneration() -> None:
    timeline = ramp_timeline(0.3, 5.0)
    total = sum(integrate(model(c6=200.0), timeline)["robot"].values())
    standing = 3.66 * timeline.duration_s
    assert np.all(total >= standing - 1e-12)
    assert total[2] == pytest.approx(standing[2])


@given(st.floats(0.0, 0.4), st.floats(0.05, 2.0), st.floats(0.0, 1.0))
def test_up_and_down_never_costs_less_than_flat(slope: float, speed: float, regeneration: float) -> None:
    power_model = model(("grade", {"k": 1.0}))
    power_model = PowerModel(power_model.terms, ("robot",), {"body_mass_kg": 25.0, "regeneration": regeneration})
    cov = {"speed_m_s": np.full(3, speed), "slope_rad": np.array([slope, -slope, 0.0])}
    up, down, flat = power_model.total(cov, "robot")
    assert up + down >= 2.0 * flat - 1e-9


def test_three_shapes_give_the_same_numbers() -> None:
    power_model = model(("grade", {"k": 1.0}), ("conversion_loss", {"k": 0.01}))
    speeds = np.array([0.1, 0.4, 0.7])
    many = power_model.total({"speed_m_s": speeds, "slope_rad": 0.02 * np.ones(3)}, "robot")
    one = [float(power_model.total({"speed_m_s": v, "slope_rad": 0.02}, "robot")) for v in speeds]
    draws = power_model.total(
        {"speed_m_s": speeds, "slope_rad": 0.02 * np.ones(3)}, "robot", {"robot/c3": np.array([[9.79], [10.0]])}
    )
    assert many == pytest.approx(one, rel=1e-15)
    assert draws.shape == (2, 3)
    assert draws[0] == pytest.approx(many, rel=1e-15)
    assert np.all(draws[1] > draws[0])


def test_gradient_is_the_change_with_the_logarithm() -> None:
    cov = {"time_s": np.arange(2.0), "speed_m_s": np.array([0.0, 0.5]), "moving": np.array([0.0, 1.0])}
    gradient = model().gradient(cov, "robot")
    assert gradient["c3"] == pytest.approx([0.0, 9.79 * 0.5])
    assert gradient["c2"] == pytest.approx([0.0, 6.25 * 0.25])
    assert gradient["c4"] == pytest.approx([0.0, 3.66])
    assert gradient["standing"] == pytest.approx([2.67, 0.0])
