"""The three robots beside the Pioneer behave as robots do: distance, payload, slope, turning, up and down."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionsim.engine.simulate import simulate
from missionsim.inputs import load_mission

ROBOTS = {"khepera3": 0.1, "mecanum4": 0.8, "rover_tx2": 3.0}
"""Robot → a speed that it can drive, m/s."""


@pytest.fixture
def energy(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Energy (Wh) of a robot on segments given as YAML."""

    def run(robot: str, *segments: str, profile: str = "trapezoidal") -> float:
        text = f"kind: mission\nname: t\nrobot: {robot}\ndefaults: {{speed: {ROBOTS[robot]} m/s, profile: {profile}}}\n"
        text += "segments:\n" + "".join(f"  - {segment}\n" for segment in segments)
        path = tmp_path / "t.yaml"
        path.write_text(text, encoding="utf-8")
        result = simulate(load_mission(path))
        battery = result.batteries["robot"]
        assert battery.audit_relative_error < 1e-9
        return battery.energy_wh

    return run


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_longer_is_dearer(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    first, second = (energy(robot, f"drive: {{distance: {d} m}}") for d in (10, 20))
    assert second > first > 0.0
    steady = [energy(robot, f"drive: {{distance: {d} m}}", profile="constant_speed") for d in (10, 20)]
    assert steady[1] == pytest.approx(2.0 * steady[0], rel=1e-12)


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_payload_costs_on_the_flat_and_uphill(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    for slope in ("0 %", "5 %"):
        costs = [energy(robot, f"drive: {{distance: 10 m, slope: {slope}, payload: {p} kg}}") for p in (0, 0.2, 0.4)]
        assert costs[0] < costs[1] < costs[2]


@pytest.mark.parametrize("robot", list(ROBOTS))
@pytest.mark.parametrize("percent", [1, 5, 15, 40])
def test_up_and_down_never_gains(robot: str, percent: int, energy) -> None:  # type: ignore[no-untyped-def]
    up, flat, down = (energy(robot, f"drive: {{distance: 20 m, slope: {s} %}}") for s in (percent, 0, -percent))
    assert up > flat > 0.0
    assert 0.0 < down <= flat
    assert up + down >= 2.0 * flat * (1.0 - 1e-12)


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_steeper_is_dearer(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    costs = [energy(robot, f"drive: {{distance: 10 m, slope: {s} %}}") for s in (0, 2, 4, 8)]
    assert costs == sorted(costs)
    assert costs[0] < costs[-1]


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_turning_costs(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    straight = energy(robot, "drive: {distance: 10 m}")
    turn = "arc: {{radius: 2 m, angle: {} deg}}" if robot == "rover_tx2" else "turn: {{angle: {} deg}}"
    turns = [energy(robot, "drive: {distance: 10 m}", turn.format(a)) for a in (90, 180)]
    assert straight < turns[0] < turns[1]


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_splitting_changes_nothing(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    whole = energy(robot, "drive: {distance: 12 m}")
    parts = energy(robot, "drive: {distance: 5 m}", "drive: {distance: 7 m}")
    assert parts == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_a_stop_on_the_way_costs(robot: str, energy) -> None:  # type: ignore[no-untyped-def]
    whole = energy(robot, "drive: {distance: 12 m}")
    stopped = energy(robot, "drive: {distance: 6 m}", "wait: {duration: 1 s}", "drive: {distance: 6 m}")
    assert stopped > whole


def test_sideways_costs_more_than_ahead_and_diagonal_less(energy) -> None:  # type: ignore[no-untyped-def]
    costs = {a: energy("mecanum4", f"move: {{distance: 10 m, direction: {a} deg}}") for a in (0, 45, 90, 135, 180, -90)}
    assert costs[45] < costs[0] < costs[90]
    assert costs[180] == pytest.approx(costs[0], rel=1e-9)
    assert costs[135] == pytest.approx(costs[45], rel=1e-9)
    assert costs[-90] == pytest.approx(costs[90], rel=1e-9)


def test_kinetic_energy_is_paid_sideways_too(energy) -> None:  # type: ignore[no-untyped-def]
    """Starting costs ½ M v² more than steady driving in any direction, but for the copper loss."""
    for angle in (0, 90):
        ramp, steady = (
            energy("mecanum4", f"move: {{distance: 10 m, direction: {angle} deg}}", profile=profile)
            for profile in ("trapezoidal", "constant_speed")
        )
        assert ramp > steady


def test_complexity_and_clock_cost(tmp_path: Path, energy) -> None:  # type: ignore[no-untyped-def]
    def drive(complexity: float, clock: float) -> float:
        return float(
            energy(
                "rover_tx2",
                f"drive: {{distance: 100 m, scheme: perception, cpu_frequency: {clock} GHz, "
                f"conditions: {{complexity: {complexity}}}}}",
            )
        )

    assert drive(0.3, 1.2672) < drive(0.6, 1.2672) < drive(1.0, 1.2672)
    assert drive(0.3, 0.6528) < drive(0.3, 1.2672) < drive(0.3, 2.0352)
    # a computer that is fully busy cannot get busier
    assert drive(1.0, 0.4992) == pytest.approx(drive(2.0, 0.4992), rel=1e-12)


def test_radios_and_sensors_add_up(energy) -> None:  # type: ignore[no-untyped-def]
    base = "korebot: 1, infrared: 11, ultrasonic: 5"
    waits = [
        energy("khepera3", f"wait: {{duration: 1 h, sensors: {{{base}{radio}}}}}")
        for radio in ("", ", bluetooth: 1", ", wifi: 1", ", wifi: 1, bluetooth: 1")
    ]
    assert waits[0] < waits[1] < waits[2] < waits[3]
    assert waits[3] - waits[0] == pytest.approx((waits[1] - waits[0]) + (waits[2] - waits[0]), rel=1e-9)
