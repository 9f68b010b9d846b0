"""Missions that a battery cuts short: what was driven, when and where it ended, and what the whole would have taken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from missionsim.engine.meter import Meter
from missionsim.engine.simulate import AuditError, simulate
from tests.engine.making import load, run
from tests.engine.test_batteries import FLAT, PLACES, simple

WH = 1.0 / 3600.0
HOME = {"on_empty": "return_to_dock", "dock": "dock"}
OUT, IN = {"drive": {"name": "out", "to": "end"}}, {"drive": {"name": "in", "to": "dock"}}
THERE_AND_BACK = [{"repeat": {"times": 8, "segments": [OUT, IN]}}]


def cut(policy: dict[str, Any], charge: float = 0.42) -> Any:
    """8 times 200 m at 1 m/s and 30 W: 13.33 Wh; 8.4 Wh are there, of which 8 Wh are the reserve."""
    return run(
        THERE_AND_BACK,
        simple(batteries__main={"capacity": "20 Wh", "reserve": 0.4}),
        PLACES,
        start="dock",
        defaults={"speed": 1.0},
        initial_charge={"main": charge},
        policy=policy,
    )


def test_what_was_driven_and_where_it_turned_back() -> None:
    result = cut(HOME)
    # 0.4 Wh last 48 s: 48 m out, and 48 m back
    assert result.distance_m == pytest.approx(96.0)
    assert result.segments_driven == 1
    assert len(result.segments) == 17
    stop = result.interrupted
    assert stop is not None
    assert (stop.battery, stop.kind, stop.time_s) == ("main", "reserve", pytest.approx(48.0))
    assert result.segments[stop.segment].name == "out"
    told = result.summary()
    assert told["segments_driven"] == 1
    assert told["interrupted"] == {
        "at_s": pytest.approx(48.0),
        "segment": "out",
        "battery": "main",
        "kind": "reserve",
        "returned_to_dock": True,
    }


def test_a_mission_that_was_not_cut_drove_all_its_segments() -> None:
    result = cut({"on_empty": "stop"}, charge=1.0)
    assert result.segments_driven == len(result.segments) == 16
    assert result.interrupted is None
    assert result.summary()["interrupted"] is None


@pytest.mark.parametrize("policy", [HOME, {"on_empty": "stop"}])
def test_the_need_is_that_of_the_whole_mission(policy: dict[str, Any]) -> None:
    for charge in (0.42, 0.1):
        assert cut(policy, charge).batteries["main"].needed_wh == pytest.approx(1600.0 * 30.0 * WH)


def test_the_need_is_what_is_taken_out_after_a_charging_too() -> None:
    """It was counted below what the mission began with: none where it charges first."""
    segments = [{"dock": {}}, {"drive": {"to": "end", "speed": 1}}, {"drive": {"to": "dock", "speed": 1}}]
    result = run(segments, simple(), PLACES, start="dock", initial_charge={"main": 0.2})
    assert result.batteries["main"].needed_wh == pytest.approx(200.0 * 30.0 * WH)


def test_the_need_of_the_battery_that_lasts_counts_the_whole_mission_too() -> None:
    """The small battery ends the mission after 6 minutes of an hour; the large one is asked for the hour's energy."""
    machine = simple(
        batteries={"main": {"capacity": "20 Wh"}, "aux": {"capacity": "1 Wh"}},
        components={"boards": {"always_on": True, "loads": [{"battery": "aux", "power": 10.0}]}},
    )
    result = run([{"wait": {"duration": 3600}}], machine)
    assert result.duration_s == pytest.approx(360.0)
    assert result.batteries["aux"].needed_wh == pytest.approx(10.0)
    assert result.batteries["main"].needed_wh == pytest.approx(10.0)
    assert result.batteries["main"].energy_wh == pytest.approx(1.0)


def test_no_need_where_even_bottomless_batteries_do_not_end_the_mission() -> None:
    weak = {"places": {"dock": {"charger": {"power": 5}}}, "edges": []}
    result = run([{"dock": {"recharge": {"until": 0.99}}}], simple(), weak, start="dock", initial_charge={"main": 0.5})
    assert result.batteries["main"].needed_wh is None


def test_a_battery_that_starts_below_its_reserve_goes_home_at_once() -> None:
    result = cut(HOME, charge=0.39)
    assert result.interrupted is not None
    assert result.interrupted.time_s == 0.0
    assert result.distance_m == 0.0
    assert result.segments[-1].name == "return to dock"
    assert not result.feasible


SURGE = [{"effect": "start_surge", "battery": "main", "parameters": {"E": 90.0}}]


def surging(capacity_wh: float) -> Any:
    """A start takes 90 J at once, driving 30 W, standing 10 W."""
    machine = simple(batteries__main={"capacity": f"{capacity_wh} Wh"})
    machine["effects"] = SURGE
    return run([{"wait": {"duration": 6}}, {"drive": {"distance": 10, "speed": 1.0}}], machine)


def test_emptied_in_the_interval_that_a_start_surge_begins() -> None:
    # 60 J standing, 90 J the surge, 30 W for the rest of 240 J: 3 s into the drive
    assert surging(240.0 * WH).batteries["main"].empty_at_s == pytest.approx(9.0)
    # the surge itself takes more than is left
    result = surging(100.0 * WH)
    assert result.batteries["main"].empty_at_s == pytest.approx(6.0)
    assert result.batteries["main"].empty_in_segment.startswith("drive")
    # a reserve that the surge leads past is reached there, by either battery
    for model in ({}, {"model": FLAT, "nominal_voltage": "12 V"}):
        machine = simple(batteries__main={"capacity": f"{240 * WH} Wh", "reserve": 0.5, **model})
        machine["effects"] = SURGE
        segments = [{"wait": {"duration": 6}}, {"drive": {"to": "end", "speed": 1.0}}]
        home = run(segments, machine, PLACES, start="dock", policy=HOME)
        assert home.interrupted is not None
        assert (home.interrupted.kind, home.interrupted.time_s) == ("reserve", 6.0)
    # and just enough for all
    assert surging(450.0 * WH * (1 + 1e-9)).batteries["main"].empty_at_s is None


def test_a_battery_that_is_not_charged_ends_the_mission_at_the_dock() -> None:
    """Main is charged for an hour; aux, which the charger does not serve, is empty after 6 minutes of it."""
    machine = simple(
        batteries={"main": {"capacity": "20 Wh"}, "aux": {"capacity": "1 Wh", "reserve": 0.25}},
        components={"boards": {"always_on": True, "loads": [{"battery": "aux", "power": 10.0}]}},
    )
    charging: list[dict[str, Any]] = [{"dock": {"recharge": {"duration": "1 h"}}}]
    made = {"start": "dock", "initial_charge": {"main": 0.5}}
    stopped = run(charging, machine, PLACES, **made)
    assert stopped.batteries["aux"].empty_at_s == pytest.approx(360.0)
    assert stopped.duration_s == pytest.approx(360.0)
    assert stopped.batteries["main"].charged_wh == pytest.approx(40.0 / 10.0)
    # with the other policy it is at the dock already, once the reserve is reached
    home = run(charging, machine, PLACES, **made, policy=HOME)
    assert home.interrupted is not None
    assert home.interrupted.time_s == pytest.approx(270.0)
    assert home.batteries["main"].charged_wh == pytest.approx(40.0 * 270.0 * WH)


def test_below_its_reserve_a_battery_that_is_charged_calls_nobody_home() -> None:
    machine = simple(batteries__main={"capacity": "20 Wh", "reserve": 0.4})
    segments = [{"dock": {"recharge": {"duration": "3 min"}}}, {"wait": {"duration": "1 min"}}]
    result = run(segments, machine, PLACES, start="dock", initial_charge={"main": 0.3}, policy=HOME)
    # 1.5 Wh on top of 6 Wh do not reach the reserve of 8 Wh: that counts once the charger is left
    assert result.interrupted is not None
    assert (result.interrupted.kind, result.interrupted.time_s) == ("reserve", pytest.approx(180.0))
    assert result.batteries["main"].charged_wh == pytest.approx(2.0)


def test_an_audit_that_fails_ends_the_run_and_names_the_term(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = load({"segments": [{"wait": {"duration": 60}}, {"drive": {"distance": 10, "speed": 1.0}}]})
    assert max(b.audit_relative_error for b in simulate(mission).batteries.values()) <= 1e-9
    original = Meter.table

    def broken(*given: Any) -> Any:
        line, energies, charge = original(*given)
        key = next(key for key in energies["aux"] if key.component == "boards")
        wrong = {**energies["aux"], key: energies["aux"][key] * (1.0 + 1e-6)}
        return line, {**energies, "aux": wrong}, charge

    monkeypatch.setattr(Meter, "table", broken)
    with pytest.raises(AuditError, match=r"battery 'aux'.*boards"):
        simulate(mission)


def test_the_command_ends_with_code_3_where_the_audit_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], root: Any
) -> None:
    from missionsim.cli.app import run_command

    original = Meter.table

    def broken(*given: Any) -> Any:
        line, energies, charge = original(*given)
        lost = {name: {key: np.zeros_like(j) for key, j in terms.items()} for name, terms in energies.items()}
        return line, lost, charge

    monkeypatch.setattr(Meter, "table", broken)
    assert run_command(["run", str(root / "missions/pioneer3dx/valve_patrol.yaml"), "--quiet"]) == 3
    assert "does not add up" in capsys.readouterr().err
