"""More distance, payload, slope, turning or waiting never costs less; a hill up and down never costs less than flat."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.engine.making import energy, robot, run
from tests.engine.test_invariance import segments

SOME = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
SLACK = 1.0 - 1e-12


def body_of(item: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    ((kind, body),) = item.items()
    return kind, body


def changed(mission: list[dict[str, Any]], kinds: tuple[str, ...], key: str, change: Any) -> list[dict[str, Any]]:
    made = copy.deepcopy(mission)
    for item in made:
        kind, body = body_of(item)
        if kind in kinds:
            body[key] = change(body.get(key, 0.0))
    return made


@given(segments, st.floats(1.0, 3.0))
@SOME
def test_longer_never_costs_less(mission: list[dict[str, Any]], factor: float) -> None:
    flat = changed(mission, ("drive",), "slope", lambda _: 0.0)
    longer = changed(flat, ("drive", "move"), "distance", lambda x: x * factor)
    assert energy(run(longer)) >= energy(run(flat)) * SLACK


@given(segments, st.floats(0.0, 10.0))
@SOME
def test_payload_never_makes_it_cheaper(mission: list[dict[str, Any]], more: float) -> None:
    flat = changed(mission, ("drive",), "slope", abs)
    alike = changed(flat, ("drive", "arc", "turn", "move", "wait"), "payload", lambda _: 1.0)
    loaded = changed(alike, ("drive", "arc", "turn", "move", "wait"), "payload", lambda x: x + more)
    assert energy(run(loaded)) >= energy(run(alike)) * SLACK


@given(segments, st.floats(0.0, 0.2))
@SOME
def test_steeper_uphill_never_costs_less(mission: list[dict[str, Any]], more: float) -> None:
    uphill = changed(mission, ("drive",), "slope", abs)
    steeper = changed(uphill, ("drive",), "slope", lambda x: x + more)
    assert energy(run(steeper)) >= energy(run(uphill)) * SLACK


@given(
    st.floats(1.0, 100.0),
    st.floats(0.1, 1.5),
    st.floats(0.0, 0.4),
    st.floats(0.0, 1.0),
    st.sampled_from(["trapezoidal", "constant_speed"]),
)
@SOME
def test_up_and_down_costs_at_least_flat(
    distance: float, speed: float, slope: float, back: float, profile: str
) -> None:
    machine = robot(body__regeneration=back)
    # cold friction depends on when, not only where: it is the same drive, there and back
    ways = [
        [{"drive": {"distance": distance, "speed": speed, "slope": s, "profile": profile}} for s in pair]
        for pair in ((slope, -slope), (0.0, 0.0))
    ]
    hill, flat = (energy(run(way, machine)) for way in ways)
    assert hill >= flat * SLACK


@given(segments, st.floats(0.0, 3.0))
@SOME
def test_turning_more_never_costs_less(mission: list[dict[str, Any]], more: float) -> None:
    turning = changed(mission, ("turn",), "angle", abs)
    further = changed(turning, ("turn",), "angle", lambda x: x + more)
    assert energy(run(further)) >= energy(run(turning)) * SLACK
    detour = [*mission, {"turn": {"angle": 0.5 + more}}]
    assert energy(run(detour)) > energy(run(mission))


@given(segments, st.floats(0.0, 1000.0))
@SOME
def test_waiting_longer_never_costs_less(mission: list[dict[str, Any]], more: float) -> None:
    waits = [*mission, {"wait": {"duration": 1.0}}]
    longer = changed(waits, ("wait",), "duration", lambda x: x + more)
    assert energy(run(longer)) >= energy(run(waits)) * SLACK


@given(segments, st.sampled_from(["camera", "lidar", "radio"]))
@SOME
def test_a_sensor_more_never_costs_less(mission: list[dict[str, Any]], name: str) -> None:
    fewer, more = copy.deepcopy(mission), copy.deepcopy(mission)
    for a, b in zip(fewer, more, strict=True):
        body_of(a)[1]["sensors"].pop(name, None)
        body_of(b)[1]["sensors"][name] = 1
    assert energy(run(more)) > energy(run(fewer)) or run(fewer).duration_s == 0.0


def test_braking_is_not_charged_as_consumption() -> None:
    drive = [{"drive": {"distance": 20, "speed": 1.0}}]
    terms = run(drive).by_term_wh("main")
    gentle = run([{"drive": {"distance": 20, "speed": 1.0, "profile": "constant_speed"}}]).by_term_wh("main")
    # ½ m v² of the term c6·a·v is paid once when speeding up; braking gives nothing back and takes nothing more
    assert terms["kinetic"] * 3600.0 <= 0.5 * 8.0 * 1.0**2 * (1 + 1e-12)
    assert gentle["kinetic"] == 0.0


def test_braking_uphill_pays_for_the_lifting() -> None:
    """Friction, inertia and weight add up at the wheels before anything is braked away (c6 is the kinetic mass)."""
    machine = robot(
        motion__parameters={"c2": 0.0, "c3": 9.0, "c4": 0.0, "c6": 20.0},
        effects=[{"effect": "grade", "battery": "main", "parameters": {"k": 1.0}}],
        components={},
    )
    slope, speed, braking = 0.05, 1.0, 0.6
    drive = [{"drive": {"distance": 20, "speed": speed, "slope": slope}}]
    # 20 kg at 0.6 m/s² brake with 12 N, more than the friction of 9 N, but less than friction and weight together
    lift_n = 20.0 * 9.80665 * math.sin(slope)
    assert 9.0 < 20.0 * braking < 9.0 + lift_n
    # so that the wheels are never braked, and the kinetic energy comes back whole
    assert energy(run(drive, machine)) == pytest.approx((9.0 + lift_n) * 20.0, rel=1e-12)


@given(st.floats(1.0, 50.0), st.floats(0.1, 1.5), st.floats(0.0, 0.4), st.floats(0.0, 1.0), st.floats(0.0, 40.0))
@SOME
def test_up_and_down_costs_at_least_flat_whatever_the_kinetic_mass(
    distance: float, speed: float, slope: float, back: float, kinetic: float
) -> None:
    machine = robot(body__regeneration=back, motion__parameters__c6=kinetic)
    hill, flat = (
        energy(run([{"drive": {"distance": distance, "speed": speed, "slope": s}} for s in pair], machine))
        for pair in ((slope, -slope), (0.0, 0.0))
    )
    assert hill >= flat * SLACK


def test_battery_size_changes_the_charge_left_not_the_energy() -> None:
    drive = [{"drive": {"distance": 20, "speed": 1.0}}]
    small, large = (run(drive, robot(batteries__main__capacity=f"{wh} Wh")) for wh in (50, 500))
    assert small.batteries["main"].energy_wh == large.batteries["main"].energy_wh
    assert large.batteries["main"].charge_left_wh - small.batteries["main"].charge_left_wh == pytest.approx(450.0)
