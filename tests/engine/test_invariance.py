"""What must not matter does not: cuts, names, the order of simultaneous events; and the audit holds on any mission."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from tests.engine.making import ROBOT, energy, load, robot, run

EXACT = 1e-12
SOME = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])

sensors = st.fixed_dictionaries(
    {}, optional={"camera": st.integers(0, 2), "lidar": st.integers(0, 1), "radio": st.integers(0, 1)}
)
common = {"sensors": sensors, "payload": st.sampled_from([0.0, 0.0, 2.0, 5.0])}


def _segment(kind: str, **fields: Any) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({kind: st.fixed_dictionaries({**fields, **common})})


profile = st.sampled_from(["trapezoidal", "constant_speed"])
drives = _segment(
    "drive", distance=st.floats(0.05, 60.0), speed=st.floats(0.05, 1.5), slope=st.floats(-0.2, 0.2), profile=profile
)
arcs = _segment(
    "arc",
    radius=st.floats(0.3, 5.0),
    angle=st.floats(-3.0, 3.0).filter(lambda x: abs(x) > 0.05),
    speed=st.floats(0.05, 1.0),
    profile=profile,
)
turns = _segment("turn", angle=st.floats(-3.0, 3.0), yaw_rate=st.floats(0.1, 1.0), profile=profile)
moves = _segment("move", distance=st.floats(0.05, 20.0), direction=st.floats(-3.0, 3.0), speed=st.floats(0.05, 1.0))
waits = _segment("wait", duration=st.floats(0.0, 300.0))
segments = st.lists(st.one_of(drives, drives, arcs, turns, moves, waits), min_size=1, max_size=8)
activities = st.lists(
    st.one_of(
        st.fixed_dictionaries(
            {
                "component": st.sampled_from(["camera", "radio"]),
                "from": st.fixed_dictionaries({"time": st.floats(0.0, 100.0)}),
                "duration": st.floats(0.1, 50.0),
            }
        ),
        st.fixed_dictionaries(
            {"component": st.just("radio"), "every": st.floats(5.0, 60.0), "duration": st.floats(0.1, 4.0)}
        ),
    ),
    max_size=3,
)


def sums(result: RunResult, battery: str) -> dict[str, float]:
    return {f"{key.component}/{key.name}": float(joules.sum()) for key, joules in result.energies[battery].items()}


@given(segments, activities)
@SOME
def test_audit_on_random_missions(mission: list[dict[str, Any]], beside: list[dict[str, Any]]) -> None:
    result = run(mission, activities=beside)
    line = result.timeline
    assert np.all(line.duration_s > 0.0)
    assert line.start_s[1:] == pytest.approx((line.start_s + line.duration_s)[:-1], abs=1e-9)
    assert result.duration_s == pytest.approx(float(line.duration_s.sum()), rel=1e-12)
    for name, battery in result.batteries.items():
        assert battery.audit_relative_error < 1e-9
        # cells by segment, components and terms are three ways to the same drain, and so is the charge
        drain = battery.initial_wh - battery.charge_left_wh
        assert float(result.by_segment_wh(name).sum()) == pytest.approx(battery.energy_wh, rel=1e-9)
        assert sum(result.by_component_wh(name).values()) == pytest.approx(battery.energy_wh, rel=1e-9)
        assert sum(result.by_term_wh(name).values()) == pytest.approx(battery.energy_wh, rel=1e-9)
        assert drain == pytest.approx(battery.energy_wh, rel=1e-9, abs=1e-12 * battery.capacity_wh)


@given(segments, st.data())
@SOME
def test_cutting_a_segment_in_two_changes_nothing(mission: list[dict[str, Any]], data: st.DataObject) -> None:
    index = data.draw(st.integers(0, len(mission) - 1))
    share = data.draw(st.floats(0.05, 0.95))
    ((kind, body),) = mission[index].items()
    key = {"drive": "distance", "arc": "angle", "move": "distance", "wait": "duration"}.get(kind)
    if key is None:
        return
    first, second = copy.deepcopy(body), copy.deepcopy(body)
    first[key] = body[key] * share
    second[key] = body[key] * (1.0 - share)
    cut = [*mission[:index], {kind: first}, {kind: second}, *mission[index + 1 :]]
    whole, parts = run(mission), run(cut)
    assert parts.duration_s == pytest.approx(whole.duration_s, rel=EXACT)
    assert parts.distance_m == pytest.approx(whole.distance_m, rel=EXACT)
    for battery in whole.batteries:
        before, after = sums(whole, battery), sums(parts, battery)
        scale = sum(abs(value) for value in before.values())
        for term, joules in before.items():
            assert after[term] == pytest.approx(joules, rel=1e-11, abs=EXACT * scale), term


@given(segments)
@SOME
def test_names_do_not_matter(mission: list[dict[str, Any]]) -> None:
    plain = run(mission)
    named = [{kind: {**body, "name": f"zz {9 - i}"}} for i, item in enumerate(mission) for kind, body in item.items()]
    other = copy.deepcopy(ROBOT)
    # components in another order and under other names, batteries too
    rename = {"camera": "z_eye", "lidar": "a_lidar", "radio": "m_radio", "boards": "b_boards"}
    other["components"] = {rename[key]: other["components"][key] for key in reversed(list(other["components"]))}
    other["batteries"] = {"second": other["batteries"]["aux"], "first": other["batteries"]["main"]}
    battery = {"main": "first", "aux": "second"}
    for component in other["components"].values():
        for load_ in component["loads"]:
            load_["battery"] = battery[load_["battery"]]
    for effect in other["effects"]:
        effect["battery"] = battery[effect["battery"]]
    other["motion"]["battery"] = "first"
    for item in named:
        for body in item.values():
            body["sensors"] = {rename[key]: count for key, count in body["sensors"].items()}
    result = run(named, other)
    assert result.duration_s == plain.duration_s
    for old, new in battery.items():
        assert result.batteries[new].energy_wh == pytest.approx(plain.batteries[old].energy_wh, rel=EXACT)


@given(segments, st.permutations(range(4)))
@SOME
def test_order_of_simultaneous_events_does_not_matter(mission: list[dict[str, Any]], order: list[int]) -> None:
    beside = [
        {"component": "camera", "units": 2, "from": {"time": 10.0}, "duration": 20.0},
        {"component": "camera", "from": {"time": 30.0}, "duration": 10.0},
        {"component": "radio", "from": {"time": 10.0}, "duration": 20.0},
        {"component": "radio", "from": {"time": 30.0}, "duration": 5.0},
    ]
    slow = robot(components__camera__startup={"duration": 3.0, "power": 1.0})
    one = run(mission, slow, activities=beside)
    two = run(mission, slow, activities=[beside[i] for i in order])
    assert two.duration_s == one.duration_s
    assert energy(two) == pytest.approx(energy(one), rel=EXACT)
    assert sums(two, "main") == pytest.approx(sums(one, "main"), rel=EXACT)


@given(segments)
@SOME
def test_the_same_mission_gives_the_same_bits(mission: list[dict[str, Any]]) -> None:
    spec = load({"segments": mission})
    one, two = simulate(spec), simulate(spec)
    assert one.summary() == two.summary()
    totals = simulate(spec, trace=False)
    for name in one.batteries:
        assert totals.batteries[name].energy_wh == one.batteries[name].energy_wh
        assert totals.by_segment_wh(name) == pytest.approx(one.by_segment_wh(name), rel=1e-12)
    assert totals.distance_m == one.distance_m
