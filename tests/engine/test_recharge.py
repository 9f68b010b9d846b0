"""Recharging while a mission goes on: at the reserve, below a level, and rounds until a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.results.write import edges_table
from tests.engine.making import load, robot, run

SITE: dict[str, Any] = {
    "places": {"home": {"charger": {"power": "80 W"}}, "mid": {}, "far": {}, "dock": {"charger": {"power": "60 W"}}},
    "edges": [
        {"name": "one", "from": "home", "to": "mid", "length": "60 m"},
        {"name": "two", "from": "mid", "to": "far", "length": "60 m", "slope": "3 %"},
        {"name": "side", "from": "mid", "to": "dock", "length": "20 m"},
    ],
}
ROUND = [
    {"drive": {"to": "far", "speed": 1.0}},
    {"inspect": {"duration": "30 s"}},
    {"drive": {"to": "home", "speed": 1.0}},
]
SMALL = robot(batteries={"main": {"capacity": "6 Wh", "reserve": "20 %"}, "aux": {"capacity": "100 Wh"}})


def continuing(segments: list[dict[str, Any]], **policy: Any) -> Any:
    """Run of a robot that recharges at its reserve and goes on."""
    return run(segments, SMALL, SITE, start="home", policy={"on_empty": "recharge_and_continue", **policy})


def test_it_goes_on_where_it_stopped_and_nothing_is_lost() -> None:
    result = continuing([{"repeat": {"times": 8, "segments": ROUND}}])
    assert result.feasible
    recharges = [segment for segment in result.segments if segment.kind == "recharge"]
    assert recharges
    battery = result.batteries["main"]
    assert battery.initial_wh + battery.charged_wh - battery.energy_wh == pytest.approx(
        battery.charge_left_wh, rel=1e-9
    )
    assert sum(result.by_segment_wh("main")) == pytest.approx(battery.energy_wh, rel=1e-9)
    # every edge of every round is passed to its end, in order and joined to the one before
    table = edges_table(result)
    places = ["home", *table["end"]]
    whole = [i for i, length in enumerate(table["length_m"]) if length > 59.9 and table["segment"][i] < 24]
    assert len(whole) >= 8 * 4 - len(recharges)
    assert all(begin in (place, end) for place, begin, end in zip(places, table["begin"], table["end"], strict=False))
    # below the reserve only on the way to a dock
    charge, line = result.charge_wh["main"], result.timeline
    low = {int(segment) for segment in line.segment[np.asarray(charge) < battery.reserve_required_wh - 1e-9]}
    assert low <= {i for i, segment in enumerate(result.segments) if segment.kind == "recharge"} | {
        i for i in low if charge[np.flatnonzero(line.segment == i)].min() > battery.reserve_required_wh - 0.02
    }
    assert result.dock_s > 0.0


def test_it_charges_to_the_level_asked_and_at_the_dock_named() -> None:
    result = continuing([{"repeat": {"times": 8, "segments": ROUND}}], dock="home", recharge_until="60 %")
    docks = np.flatnonzero(np.diff(np.asarray(result.charge_wh["main"])) > 0.1) + 1
    assert len(docks)
    assert np.asarray(result.charge_wh["main"])[docks] == pytest.approx(3.6, rel=1e-9)
    assert "side" not in edges_table(result)["name"]


def test_a_battery_that_cannot_do_it_is_told_and_no_loop() -> None:
    tiny = robot(batteries={"main": {"capacity": "1 Wh", "reserve": "60 %"}, "aux": {"capacity": "100 Wh"}})
    policy = {"on_empty": "recharge_and_continue"}
    result = run(ROUND, tiny, SITE, start="home", policy=policy)
    assert not result.feasible
    assert "main" in result.reason


def test_a_dock_is_used_only_below_its_level() -> None:
    segments = [*ROUND, {"dock": {"if_below": "70 %"}}]
    few = run(segments, robot(batteries__main__capacity="40 Wh"), SITE, start="home")
    assert few.batteries["main"].charged_wh == 0.0
    assert few.dock_s == 0.0
    many = run([{"repeat": {"times": 6, "segments": segments}}], SMALL, SITE, start="home")
    assert many.batteries["main"].charged_wh > 0.0
    assert many.batteries["main"].charge_left_wh == pytest.approx(6.0, rel=0.4)
    docks = [i for i, segment in enumerate(many.segments) if segment.kind == "dock"]
    done = [many.was_done(i) for i in docks]
    assert [many.segment_end_s[i] > many.segment_end_s[i - 1] for i in docks] == done
    assert not few.was_done(len(few.segments) - 1)
    assert any(done)


def test_rounds_until_a_time_are_those_that_end_by_then() -> None:
    one = run(ROUND, environment=SITE, start="home").duration_s
    until = run([{"repeat": {"until": f"{3.5 * one} s", "segments": ROUND}}], environment=SITE, start="home")
    times = run([{"repeat": {"times": 3, "segments": ROUND}}], environment=SITE, start="home")
    assert [segment.name for segment in until.segments] == [segment.name for segment in times.segments]
    assert until.duration_s == pytest.approx(times.duration_s, rel=1e-12)
    assert until.batteries["main"].energy_wh == pytest.approx(times.batteries["main"].energy_wh, rel=1e-12)


def test_charging_takes_rounds_away() -> None:
    segments = [*ROUND, {"dock": {"if_below": "70 %"}}]
    made = run([{"repeat": {"until": "40 min", "segments": segments}}], SMALL, SITE, start="home")
    free = run([{"repeat": {"until": "40 min", "segments": ROUND}}], environment=SITE, start="home")
    rounds = [sum(segment.kind == "inspect" for segment in result.segments) for result in (made, free)]
    assert 0 < rounds[0] < rounds[1]
    assert made.segments_driven == len(made.segments)


@pytest.mark.parametrize(
    ("segment", "told"),
    [
        ({"repeat": {"until": "10 s", "segments": ROUND}}, "not even one round"),
        ({"repeat": {"until": "1 h", "times": 2, "segments": ROUND}}, "some times or until"),
        ({"repeat": {"segments": ROUND}}, "some times or until"),
        ({"repeat": {"until": "1 h", "segments": [{"wait": {"duration": "0 s"}}]}}, "takes no time"),
        ({"dock": {"if_below": "90 %", "recharge": {"until": "50 %"}}}, "less than what it asks for"),
    ],
)
def test_what_cannot_be_is_told(segment: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        simulate(load({"segments": [segment], "start": "home"}, None, SITE))


@pytest.mark.parametrize("end", [0.05, 0.3])
def test_a_taper_takes_as_long_as_constant_voltage_does(end: float) -> None:
    """A charge whose power falls in proportion to what is missing: (1 - s0) C / (P (1 - r)) ln(1 / r)."""
    taper = {"charge_taper": {"from": 0.75, "end_power": end}, "initial_charge": 0.5}
    made = robot(batteries={"main": {"capacity": "10 Wh", **taper}, "aux": {"capacity": "100 Wh"}})
    made["motion"]["parameters"]["standing"] = 0.0
    made["components"] = {"boards": {"always_on": True, "loads": [{"battery": "aux", "power": 3.0}]}}
    made["effects"] = []
    result = run([{"dock": {"recharge": {"until": 1.0, "batteries": ["main"]}}}], made, SITE, start="home")
    slow = 2.5 / (80.0 * (1.0 - end)) * np.log(1.0 / end)
    assert result.dock_s / 3600.0 == pytest.approx(2.5 / 80.0 + slow, rel=1e-9)
    assert result.batteries["main"].charge_left_wh == pytest.approx(10.0, rel=1e-9)


def test_a_taper_charges_although_its_end_is_less_than_the_robot_draws() -> None:
    batteries = {"main": {"capacity": "6 Wh", "charge_taper": {"from": 0.5, "end_power": 0.01}, "initial_charge": 0.2}}
    made = robot(batteries=batteries | {"aux": {"capacity": "100 Wh"}})
    result = run([{"dock": {}}], made, SITE, start="home")
    main = result.batteries["main"]
    assert main.charge_left_wh == pytest.approx(6.0, rel=1e-9)
    assert main.initial_wh + main.charged_wh - main.energy_wh == pytest.approx(6.0, rel=1e-9)


def test_capacity_and_resistance_over_temperature() -> None:
    over = {"capacity": [["0 degC", 0.5], ["20 degC", 1.0]], "resistance": [["0 degC", 3.0], ["20 degC", 1.0]]}
    made = robot(batteries__main__over_temperature=over)
    wait = [{"wait": {"duration": "60 s"}}]
    for degrees, part in ((-10.0, 0.5), (10.0, 0.75), (20.0, 1.0), (35.0, 1.0)):
        result = run(wait, made, defaults={"temperature": degrees})
        assert result.batteries["main"].capacity_wh == pytest.approx(200.0 * part, rel=1e-12)
    with pytest.raises(InputError, match="depends on the temperature") as told:
        run(wait, made)
    assert told.value.faults[0].line
    circuit = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 12.0], [1, 12.0]], "resistance": 0.5}
    made["batteries"]["main"] |= {"model": circuit, "nominal_voltage": 12.0}
    losses = [
        run(wait, made, defaults={"temperature": degrees}).batteries["main"].internal_loss_wh for degrees in (0.0, 20.0)
    ]
    assert losses[0] == pytest.approx(3.0 * losses[1], rel=0.2)


def test_from_where_it_stands_at_its_reserve() -> None:
    """The last segment is standing at 'far': out from there and back there, the inspection to its end."""
    result = continuing([{"drive": {"to": "far", "speed": 1.0}}, {"inspect": {"duration": "2 h"}}])
    assert result.feasible
    edges = edges_table(result)
    begins, ends = list(edges["begin"]), list(edges["end"])
    assert begins[1:] == ends[:-1]  # no way begins elsewhere than the last one ended
    away = [i for i, segment in enumerate(result.segments) if segment.kind == "recharge"]
    assert away
    for i in away:
        own = [row for row, segment in enumerate(edges["segment"]) if segment == i]
        assert (begins[own[0]], ends[own[-1]]) == ("far", "far")
    line = result.timeline
    assert line.duration_s[line.segment == 1].sum() == pytest.approx(7200.0, rel=1e-9)
