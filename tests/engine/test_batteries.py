"""Batteries: equivalent circuit, cut-off, thresholds, the way home, chargers; against closed forms where there are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from missionsim.engine.batteries import EquivalentCircuit
from missionsim.engine.curves import adaptive_runge_kutta, interpolants, root
from tests.engine.making import changed, robot, run

FLAT = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 12.0], [1, 12.0]], "resistance": 0.1}
PLACES = {
    "places": {
        "dock": {"x": 0, "y": 0, "charger": {"power": 40, "batteries": ["main"]}},
        "middle": {"x": 50, "y": 0},
        "end": {"x": 100, "y": 0},
        "aside": {"x": 50, "y": 30},
    },
    "edges": [{"from": "dock", "to": "middle"}, {"from": "middle", "to": "end"}, {"from": "middle", "to": "aside"}],
}


def simple(**changes: Any) -> dict[str, Any]:
    """A robot of one battery: 10 W standing, 30 W driving at any speed."""
    parameters = {"c2": 0, "c3": 0, "c4": 30.0, "standing": 10.0}
    made = {
        **{"kind": "robot", "name": "simple", "body": {"drive": "differential", "max_speed": 2.0}},
        "batteries": {"main": {"capacity": "20 Wh", "nominal_voltage": "12 V"}},
        "motion": {"battery": "main", "model": "polynomial", "parameters": parameters},
    }
    return changed(made, changes)


def test_constant_power_from_a_flat_curve_by_hand() -> None:
    machine = simple(batteries__main={"capacity": "2 Ah", "nominal_voltage": "12 V", "model": FLAT})
    result = run([{"wait": {"duration": 1800}}], machine)
    current = (12.0 - math.sqrt(144.0 - 4 * 0.1 * 10.0)) / 0.2
    battery = result.batteries["main"]
    assert battery.energy_wh == pytest.approx(5.0, rel=1e-12)
    assert battery.charge_left_fraction == pytest.approx(1.0 - current * 0.5 / 2.0, rel=1e-10)
    # what left the store is what was delivered and what was lost in the resistance
    assert battery.internal_loss_wh == pytest.approx(0.1 * current**2 * 0.5, rel=1e-8)
    assert battery.audit_relative_error < 1e-9


def test_charging_a_cell_with_resistance_by_hand() -> None:
    machine = simple(batteries__main={"capacity": "2 Ah", "nominal_voltage": "12 V", "model": FLAT})
    segments = [{"dock": {"recharge": {"duration": 360}}}]
    result = run(segments, machine, PLACES, start="dock", initial_charge={"main": 0.5})
    # 40 W from the charger less 10 W standing, at terminals above the open-circuit voltage
    current = (math.sqrt(144.0 + 4 * 0.1 * 30.0) - 12.0) / 0.2
    assert result.batteries["main"].charge_left_fraction == pytest.approx(0.5 + current * 0.1 / 2.0, rel=1e-10)


def test_peukert_and_ageing_by_hand() -> None:
    model = {**FLAT, "peukert": 1.2, "rated_time": "20 h", "ageing": 0.8}
    machine = simple(batteries__main={"capacity": "10 Ah", "nominal_voltage": "12 V", "model": model})
    result = run([{"wait": {"duration": 3600}}], machine)
    current = (12.0 - math.sqrt(144.0 - 4 * 0.1 * 10.0)) / 0.2
    rated = 8.0 / 20.0
    expected = current * (current / rated) ** 0.2 / 8.0
    assert result.batteries["main"].charge_left_fraction == pytest.approx(1.0 - expected, rel=1e-10)


def test_sloping_curve_against_the_analytic_solution() -> None:
    # without resistance and with U = 10 + 2 s: (10 + 2 s) ds = −P/Q dt, a quadratic in s
    model = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 10], [1, 12]], "resistance": 0}
    machine = simple(batteries__main={"capacity": "3 Ah", "nominal_voltage": "11 V", "model": model})
    result = run([{"wait": {"duration": 3600}}], machine)
    left = 11.0 - 10.0 / 3.0
    assert result.batteries["main"].charge_left_fraction == pytest.approx(-5 + math.sqrt(25 + left), rel=1e-10)
    assert result.batteries["main"].internal_loss_wh == pytest.approx(0.0, abs=1e-6)


def test_cut_off_voltage_stops_before_the_charge_ends() -> None:
    model = {
        "kind": "equivalent_circuit",
        "open_circuit_voltage": [[0, 10], [1, 12]],
        "resistance": 0.2,
        "cut_off": 10.5,
    }
    machine = simple(batteries__main={"capacity": "3 Ah", "nominal_voltage": "11 V", "model": model})
    result = run([{"wait": {"duration": 36000}}], machine)
    battery = result.batteries["main"]
    # terminal voltage U − R I with I = P / terminal voltage
    volts = 10.5 + 0.2 * 10.0 / 10.5
    assert battery.charge_left_fraction == pytest.approx((volts - 10.0) / 2.0, rel=1e-7)
    assert battery.empty_at_s == pytest.approx(result.duration_s)
    assert not result.feasible


def test_power_beyond_what_the_cell_can_give() -> None:
    model = {**FLAT, "resistance": 2.0}
    machine = simple(batteries__main={"capacity": "3 Ah", "nominal_voltage": "12 V", "model": model})
    result = run([{"wait": {"duration": 60}}, {"drive": {"distance": 10, "speed": 1}}], machine)
    # U²/4R = 18 W: enough to stand (10 W), not to drive (30 W)
    assert result.batteries["main"].empty_at_s == pytest.approx(60.0)
    assert "drive" in result.batteries["main"].empty_in_segment


def test_changing_power_within_a_ramp_drains_like_small_steps() -> None:
    model = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 10], [1, 12]], "resistance": 0.3}
    machine = simple(
        body={"drive": "differential", "max_speed": 2.0, "max_acceleration": 0.05},
        batteries__main={"capacity": "1 Ah", "nominal_voltage": "11 V", "model": model},
        motion__parameters={"c2": 10.0, "c3": 5.0, "c4": 3.0, "standing": 2.0},
    )
    result = run([{"drive": {"distance": 80, "speed": 2.0}}], machine)
    cell = EquivalentCircuit("x", 1.0, 1.0, 3600.0, (np.array([0.0, 1.0]), np.array([10.0, 12.0])), 0.3)

    def power(t: float) -> float:
        v = 0.05 * min(t, 40.0) if t < 40.0 else max(0.0, 2.0 - 0.05 * (t - 40.0))
        return 10.0 * v * v + 5.0 * v + 3.0

    first = adaptive_runge_kutta(lambda t, s: cell.rate(s, power(t)), 1.0, 40.0)[-1][1]
    last = adaptive_runge_kutta(lambda t, s: cell.rate(s, power(40.0 + t)), first, 40.0)[-1][1]
    assert result.duration_s == pytest.approx(80.0)
    assert result.batteries["main"].charge_left_fraction == pytest.approx(last, rel=1e-9)


def test_exhaustion_within_a_ramp_is_found_to_the_instant() -> None:
    # power 8 c t² of a ramp v = a t: energy 8 a² t³ / 3 + 2 t
    machine = simple(
        body={"drive": "differential", "max_speed": 2.0, "max_acceleration": 0.02},
        batteries__main={"capacity": "0.05 Wh"},
        motion__parameters={"c2": 8.0, "c3": 0.0, "c4": 2.0, "standing": 2.0},
    )
    result = run([{"drive": {"distance": 150, "speed": 2.0}}], machine)
    time = result.batteries["main"].empty_at_s
    assert time is not None
    assert 8.0 * 0.02**2 * time**3 / 3.0 + 2.0 * time == pytest.approx(0.05 * 3600.0, rel=1e-9)
    assert result.distance_m == pytest.approx(0.01 * time**2, rel=1e-9)
    assert result.batteries["main"].charge_left_wh == pytest.approx(0.0, abs=1e-9)


def test_return_to_dock_from_the_middle_of_an_edge() -> None:
    machine = simple(batteries__main={"capacity": "20 Wh", "reserve": 0.4})
    segments = [{"drive": {"to": "end", "speed": 1.0}}, {"wait": {"duration": "10 h"}}]
    result = run(
        segments,
        machine,
        PLACES,
        start="dock",
        initial_charge={"main": 0.43},
        policy={"on_empty": "return_to_dock", "dock": "dock"},
    )
    # 0.6 Wh above the reserve last 72 s at 30 W: 72 m on the way, 22 m past the middle
    assert [s.name for s in result.segments][-1] == "return to dock"
    assert result.segment_end_s[2] == pytest.approx(144.0)
    assert result.distance_m == pytest.approx(144.0)
    assert not result.completed
    assert not result.feasible
    assert result.batteries["main"].empty_at_s is None
    assert result.batteries["main"].charge_left_wh == pytest.approx(0.43 * 20.0 - 144.0 * 30.0 / 3600.0)
    assert "reserve" in result.reason


def test_return_home_goes_on_where_that_is_shorter() -> None:
    ring = {
        "places": {"dock": {"charger": {"power": 40}}, "far": {}},
        "edges": [
            {"from": "dock", "to": "far", "length": 100, "both_ways": True},
            {"from": "far", "to": "dock", "length": 5, "both_ways": False},
        ],
    }
    machine = simple(batteries__main={"capacity": "20 Wh", "reserve": 0.4})
    result = run(
        [{"drive": {"to": "far", "via": [], "speed": 1.0}}],
        machine,
        ring,
        start="dock",
        initial_charge={"main": 0.43},
        policy={"on_empty": "return_to_dock", "dock": "dock"},
    )
    # after 72 m: 28 m on and 5 m home beat 72 m back
    assert result.distance_m == pytest.approx(72.0 + 28.0 + 5.0)


def test_return_brakes_before_it_turns_back() -> None:
    machine = simple(
        batteries__main={"capacity": "20 Wh", "reserve": 0.4},
        body={"drive": "differential", "max_speed": 2.0, "max_acceleration": 0.5},
    )
    result = run(
        [{"drive": {"to": "end", "speed": 1.0}}],
        machine,
        PLACES,
        start="dock",
        initial_charge={"main": 0.43},
        policy={"on_empty": "return_to_dock", "dock": "dock"},
    )
    # 72 s in: 1 m short of 72 m for the start; 1 m to brake; as far back
    assert result.distance_m == pytest.approx(2.0 * 72.0)
    speed = result.timeline.columns["speed_m_s"]
    rate = result.timeline.rates["speed_m_s"]
    end = speed + rate * result.timeline.duration_s
    assert end[:-1] == pytest.approx(speed[1:], abs=1e-9)
    assert end[-1] == pytest.approx(0.0, abs=1e-9)


def test_empty_on_the_way_home_is_told() -> None:
    machine = simple(batteries__main={"capacity": "20 Wh", "reserve": 0.01})
    result = run(
        [{"drive": {"to": "end", "speed": 1.0}}, {"wait": {"duration": 60}}],
        machine,
        PLACES,
        start="dock",
        initial_charge={"main": 0.03},
        policy={"on_empty": "return_to_dock", "dock": "dock"},
    )
    battery = result.batteries["main"]
    assert battery.empty_at_s == pytest.approx(72.0)
    assert battery.empty_in_segment == "return to dock"
    assert result.reason == "battery 'main' empty"
    assert battery.deficit_wh == pytest.approx((100.0 * 30.0 + 60.0 * 10.0) / 3600.0 - 0.6)


def test_charging_for_a_time_stops_at_full_and_holds() -> None:
    machine = simple(batteries__main={"capacity": "20 Wh", "charge_efficiency": 0.9, "max_charge_power": 30})
    result = run(
        [{"dock": {"recharge": {"duration": "1 h"}}}], machine, PLACES, start="dock", initial_charge={"main": 0.5}
    )
    battery = result.batteries["main"]
    # 27 W stored less 10 W drawn fill 10 Wh in 35.3 min; then the charger holds the level
    assert result.duration_s == pytest.approx(3600.0)
    assert battery.charge_left_wh == pytest.approx(20.0)
    assert battery.energy_wh == pytest.approx(10.0)
    assert battery.charged_wh == pytest.approx(20.0)
    charge = result.charge_wh["main"]
    assert float(charge.max()) <= 20.0 * (1 + 1e-9)
    assert len(result.timeline) == 2
    assert result.timeline.duration_s[0] == pytest.approx(10.0 / 17.0 * 3600.0)


def test_a_charger_that_is_too_weak_is_told() -> None:
    weak = {"places": {"dock": {"x": 0, "y": 0, "charger": {"power": 5}}}, "edges": []}
    result = run(
        [{"wait": {"duration": 60}}, {"dock": {"recharge": {"until": 0.99}}}],
        simple(),
        weak,
        start="dock",
        initial_charge={"main": 0.5},
    )
    assert not result.feasible
    assert "charger at 'dock' gives less" in result.reason
    assert result.duration_s == pytest.approx(60.0)


def test_what_an_edge_has_of_its_own_ends_with_it_on_the_way_home() -> None:
    """The way home from a cold, muddy edge was taken as cold and muddy to the dock."""
    cold = {"from": "middle", "to": "aside", "surface": "mud", "temperature": "5 degC"}
    site = {**PLACES, "edges": [*PLACES["edges"][:2], cold], "ambient": {"temperature": "20 degC"}}
    sizes = {"surface_rolling_resistance": {"k_mud": "40 N"}, "temperature_friction": {"k": "2 N/K", "T0": "20 degC"}}
    effects = [{"effect": name, "battery": "main", "parameters": own} for name, own in sizes.items()]
    result = run([{"drive": {"to": "aside", "speed": 1.0}}], simple(effects=effects), site, start="dock")
    # 30 m of mud at 30 + 40 + 30 W, 50 m of floor at 30 W
    assert result.batteries["main"].home_wh == pytest.approx((30.0 * 100.0 + 50.0 * 30.0) / 3600.0)


@pytest.mark.parametrize(
    ("edge", "behaviour", "home_j"),
    [
        ({"max_speed": 0.5}, {}, 60.0 * 30.0 + 50.0 * 30.0),  # its limit held to the dock: 160 s in place of 110 s
        ({}, {"path_stretch": 1.2}, 1.2 * 80.0 * 30.0),  # the way home was not stretched
        ({}, {"speed_tracking": 0.8}, 100.0 * 30.0),
    ],
)
def test_the_way_home_is_driven_as_a_drive_to_the_dock_is(
    edge: dict[str, Any], behaviour: dict[str, float], home_j: float
) -> None:
    site = {**PLACES, "edges": [*PLACES["edges"][:2], {**PLACES["edges"][2], **edge}]}
    there = {"drive": {"to": "aside", "speed": 1.0}}
    result = run([there], simple(), site, start="dock", behaviour=behaviour)
    again = run([there, {"drive": {"to": "dock", "speed": 1.0}}], simple(), site, start="dock", behaviour=behaviour)
    assert result.batteries["main"].home_wh == pytest.approx(home_j / 3600.0)
    back_wh = again.batteries["main"].energy_wh - result.batteries["main"].energy_wh
    assert back_wh == pytest.approx(home_j / 3600.0)


def test_reserve_for_the_way_home_at_each_place() -> None:
    result = run(
        [{"drive": {"to": "end", "speed": 1.0}}, {"drive": {"to": "aside", "speed": 0.5}}, {"wait": {"duration": 60}}],
        simple(),
        PLACES,
        start="dock",
    )
    # Eq. 12: power times the time of the shortest way, with the settings of the last drive
    wh = 30.0 / 3600.0
    homes = [entry["main"] for entry in result.home_energy()]
    assert homes == pytest.approx([100.0 * wh, 160.0 * wh, 160.0 * wh])
    battery = result.batteries["main"]
    assert battery.home_wh == pytest.approx(160.0 * wh)
    assert battery.reserve_wh == pytest.approx(battery.charge_left_wh - 160.0 * wh)


def test_a_mission_that_ends_where_home_is_out_of_reach_is_not_feasible() -> None:
    machine = simple(batteries__main={"capacity": "20 Wh"})
    result = run([{"drive": {"to": "end", "speed": 1.0}}], machine, PLACES, start="dock", initial_charge={"main": 0.06})
    assert result.completed
    assert not result.feasible
    assert "cannot bring the robot home" in result.reason


@pytest.mark.parametrize("inside", [{"resistance": 0.4}, {"resistance": 0.1, "peukert": 1.3, "rated_time": "20 h"}])
def test_what_is_lost_inside_counts_on_the_way_home(inside: dict[str, Any]) -> None:
    """The reserve after coming home was what the terminals deliver on it: too much by what the battery loses."""
    battery = {"capacity": "2 Ah", "nominal_voltage": "12 V", "model": {**FLAT, **inside}}
    machine, out = simple(batteries__main=battery), {"drive": {"to": "end", "speed": 1}}
    away = run([out], machine, PLACES, start="dock").batteries["main"]
    back = run([out, {"drive": {"to": "dock", "speed": 1}}], machine, PLACES, start="dock").batteries["main"]
    assert away.reserve_wh == pytest.approx(back.charge_left_wh)
    assert away.charge_left_wh - (away.home_wh or 0.0) == pytest.approx(away.reserve_wh)


def test_a_voltage_that_falls_below_the_cut_off_on_the_way_home_is_told() -> None:
    model = {**FLAT, "open_circuit_voltage": [[0, 10], [1, 12]], "resistance": 0.2, "cut_off": 10.9}
    machine = simple(batteries__main={"capacity": "0.2 Ah", "nominal_voltage": "11 V", "model": model})
    result = run([{"drive": {"to": "middle", "speed": 1}}], machine, PLACES, start="dock")
    assert result.batteries["main"].reserve_wh > 0.5
    assert "cannot bring the robot home" in result.reason


def test_conversion_loss_and_reserve_below_policy() -> None:
    result = run(
        [{"wait": {"duration": 3600}}],
        robot(),
        initial_charge={"main": 0.2},
        policy={"on_empty": "stop", "reserve": 0.199},
    )
    assert not result.feasible
    assert "below its reserve" in result.reason
    terms = result.by_term_wh("aux")
    assert terms["conversion_loss"] == pytest.approx(0.01 * 3.0**2)


def test_solvers() -> None:
    assert root(lambda x: x**3 - 2.0, 0.0, 2.0, -2.0, 6.0) == pytest.approx(2.0 ** (1 / 3), abs=1e-9)
    assert root(lambda x: math.exp(-x) - 1e-6, 0.0, 100.0, 1.0, -1e-6) == pytest.approx(math.log(1e6), abs=2e-9)
    path = adaptive_runge_kutta(lambda t, y: -y + math.sin(t), 1.0, 5.0)
    exact = 1.5 * math.exp(-5.0) + 0.5 * (math.sin(5.0) - math.cos(5.0))
    assert path[-1] == pytest.approx((5.0, exact), abs=1e-9)
    bent = interpolants(lambda _, t: np.exp(-t / 50.0) + np.maximum(t - 300.0, 0.0), np.array([4]), np.array([3000.0]))
    borders, parts = bent[4]
    assert borders[0] == 0.0
    assert borders[-1] == 3000.0
    assert len(parts) == len(borders) - 1


@pytest.mark.parametrize(
    ("cut_off", "resistance", "surge"), [(10.5, 0.2, 0.0), (1.0, 0.2, 400.0), (1.0, 2.5, 0.0), (10.9, 0.05, 0.0)]
)
def test_intervals_left_out_by_bounds_never_empty_a_battery(
    monkeypatch: pytest.MonkeyPatch, cut_off: float, resistance: float, surge: float
) -> None:
    curve = [[0, 10], [0.3, 11.2], [0.6, 11.2], [1, 12]]
    model = {
        "kind": "equivalent_circuit",
        "open_circuit_voltage": curve,
        "resistance": resistance,
        "cut_off": cut_off,
        "peukert": 1.1,
    }
    machine = simple(
        body={"drive": "differential", "max_speed": 2.0, "max_acceleration": 0.3},
        batteries__main={"capacity": "0.6 Ah", "nominal_voltage": "11 V", "model": model},
        motion__parameters={"c2": 4.0, "c3": 1.0, "c4": 3.0, "standing": 2.0},
        effects=[{"effect": "start_surge", "battery": "main", "parameters": {"E": surge}}] if surge else [],
    )
    segments = [{"drive": {"distance": 20 + i % 7, "speed": 0.5 + 0.2 * (i % 6)}} for i in range(200)]
    found = run(segments, machine).batteries["main"]
    looked: list[int] = []
    suspects = EquivalentCircuit.suspects
    monkeypatch.setattr(
        EquivalentCircuit,
        "suspects",
        lambda cell, before, after, loads: (
            looked.extend([len(suspects(cell, before, after, loads)), len(before)]),
            np.arange(len(before)),
        )[1],
    )
    assert run(segments, machine).batteries["main"] == found
    assert found.empty_at_s is not None
    assert looked[0] < looked[1]
