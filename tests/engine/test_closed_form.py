"""The shipped missions against calculations by hand (`closed_form`), to 1e-9."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from tests.engine import closed_form as hand

EXACT = 1e-9


def run(root: Path, name: str) -> RunResult:
    return simulate(load_mission(root / "missions" / f"{name}.yaml"))


def agree(result: RunResult, pieces: list[hand.Piece]) -> None:
    expected = hand.energies_wh(pieces)
    for battery, energy in expected.items():
        assert result.batteries[battery].energy_wh == pytest.approx(energy, rel=EXACT), battery
        assert result.batteries[battery].audit_relative_error < 1e-9
    assert result.duration_s == pytest.approx(sum(p.duration_s for p in pieces), rel=EXACT)
    assert result.distance_m == pytest.approx(sum(p.distance_m for p in pieces), rel=EXACT)


def test_valve_patrol(root: Path) -> None:
    result = run(root, "pioneer3dx/valve_patrol")
    pieces = hand.valve_patrol()
    agree(result, pieces)
    assert result.feasible
    assert result.distance_m == pytest.approx(180.0)
    # segment by segment: each cell, not only the sum
    for battery, cells in (
        ("robot", [p.robot_j / 3600 for p in pieces]),
        ("laptop", [p.laptop_w * p.duration_s / 3600 for p in pieces]),
    ):
        assert result.by_segment_wh(battery) == pytest.approx(cells, rel=EXACT)


def test_valve_patrol_by_component(root: Path) -> None:
    result = run(root, "pioneer3dx/valve_patrol")
    pieces = hand.valve_patrol()
    with_kinect, with_two_lasers = [1, 2, 3, 4, 5, 6, 7, 8], [0, 3, 4, 7, 8, 9]
    robot, laptop = result.by_component_wh("robot"), result.by_component_wh("laptop")
    kinect_s = sum(pieces[i].duration_s for i in with_kinect)
    laser_s = sum(pieces[i].duration_s for i in with_two_lasers)
    total_s = sum(p.duration_s for p in pieces)
    assert robot["kinect"] * 3600 == pytest.approx(2.82 * kinect_s, rel=EXACT)
    assert robot["laser"] * 3600 == pytest.approx(2 * 2.34 * laser_s, rel=EXACT)
    assert laptop["laser"] * 3600 == pytest.approx(2 * 0.4 * laser_s, rel=EXACT)
    assert laptop["switchboard1"] * 3600 == pytest.approx(0.72 * laser_s + 0.087 * (total_s - laser_s), rel=EXACT)
    assert robot["controller"] * 3600 == pytest.approx(3.66 * (total_s - 76.0) + 2.67 * 76.0, rel=EXACT)


def test_valve_patrol_as_driven(root: Path) -> None:
    stretch = (1.12, 1.12, 1.0, 1.0, 1.12, 1.0, 1.26, 1.12)
    gaps = (0.174, 0.174, 0.027, 0.027, 0.1, 0.027, 0.027, 0.1)
    agree(run(root, "pioneer3dx/valve_patrol_as_driven"), hand.valve_patrol(stretch, tuple(1.0 - gap for gap in gaps)))


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
@pytest.mark.parametrize(
    ("name", "configuration"),
    [
        ("forward_motion", ("FM", 0, 2, 0)),
        ("centring_motion", ("CM", 0, 2, 0)),
        ("qr_code_4_markers", ("QR", 0, 2, 1)),
        ("qr_code_8_markers", ("QR", 0, 2, 1)),
    ],
)
def test_corridors_of_table_5(root: Path, name: str, configuration: tuple[str, int, int, int], speed: float) -> None:
    result = run(root, f"pioneer3dx/corridor_{name}_{round(100 * speed)}cm_s")
    agree(result, [hand.cruise(50.0, speed, *configuration)])


def test_hour_of_inspections(root: Path) -> None:
    agree(run(root, "pioneer3dx/hour_inspection"), hand.hour_inspection())


def test_recharging_patrol(root: Path) -> None:
    result = run(root, "pioneer3dx/recharging_patrol")
    used, left, duration = hand.recharging_patrol()
    assert result.feasible
    assert result.duration_s == pytest.approx(duration, rel=EXACT)
    for name in used:
        battery = result.batteries[name]
        assert battery.energy_wh == pytest.approx(used[name], rel=EXACT)
        assert battery.charge_left_wh == pytest.approx(left[name], rel=EXACT)
        assert battery.charged_wh == pytest.approx(left[name] - battery.initial_wh + used[name], rel=1e-8)


def test_infeasible_round_stops_at_the_instant_of_exhaustion(root: Path) -> None:
    result = run(root, "pioneer3dx/infeasible")
    pieces = hand.guard_round()
    stored = 31.0 * 3600.0
    time = 0.0
    for piece in pieces:
        need = piece.laptop_w * piece.duration_s
        if need > stored:
            break
        stored -= need
        time += piece.duration_s
    time += stored / piece.laptop_w
    laptop = result.batteries["laptop"]
    assert not result.feasible
    assert not result.completed
    assert laptop.empty_at_s == pytest.approx(time, rel=EXACT)
    assert result.duration_s == pytest.approx(time, rel=EXACT)
    assert laptop.empty_in_segment == "watch_V2"
    assert laptop.energy_wh == pytest.approx(31.0, rel=EXACT)
    assert laptop.charge_left_wh == pytest.approx(0.0, abs=1e-9)
    # the deficit is that of the whole mission, not clamped at the stop
    assert laptop.deficit_wh == pytest.approx(hand.energies_wh(pieces)["laptop"] - 31.0, rel=EXACT)


def test_khepera(root: Path) -> None:
    for name, joules, seconds in (
        ("task_a_wifi", hand.khepera_task_a(hand.WIFI), 125.0),
        ("task_a_bluetooth", hand.khepera_task_a(hand.BLUETOOTH), 125.0),
        ("task_b", hand.khepera_task_b(), sum(4.0 / v for v in (0.028, 0.056, 0.083, 0.110, 0.138))),
        (
            "crossing",
            hand.khepera_static(hand.WIFI) * (200.0 + 15.067818) + hand.khepera_motion(5.6, 0.028),
            200.0 + 15.067818,
        ),
    ):
        result = run(root, f"khepera3/{name}")
        assert result.batteries["robot"].energy_wh * 3600.0 == pytest.approx(joules, rel=EXACT), name
        assert result.duration_s == pytest.approx(seconds, rel=EXACT), name
