"""What is wrong, where, what was allowed, what was perhaps meant: the texts word for word."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from missionsim.errors import InputError
from missionsim.inputs import check_files, load_mission, load_robot

ROBOT = """\
kind: robot
name: r
body: {drive: differential, max_speed: 1 m/s}
batteries: {main: {capacity: 10 Wh}}
motion: {battery: main, model: polynomial, parameters: {c2: 1, c3: 2, c4: 3}}
components:
  lidar: {loads: [{battery: main, power: 2 W}]}
schemes:
  go: {sensors: {optional: {lidar: 1}}}
"""
ENVIRONMENT = """\
kind: environment
name: e
places: {A: {x: 0, y: 0}, B: {x: 10, y: 0}, C: {x: 0, y: 5}}
edges: [{from: A, to: B}]
"""
MISSION = """\
kind: mission
name: m
robot: robot.yaml
environment: environment.yaml
start: A
defaults: {speed: 0.5 m/s, scheme: go}
segments:
  - drive: {to: B}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in (("robot", ROBOT), ("environment", ENVIRONMENT), ("mission", MISSION)):
        Path(f"{name}.yaml").write_text(text, encoding="utf-8")
    return tmp_path


def told(*names: str) -> list[str]:
    return [str(fault) for fault in check_files(names)]


def change(name: str, old: str, new: str) -> None:
    path = Path(f"{name}.yaml")
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_three_files_are_valid(folder: Path) -> None:
    assert told("mission.yaml", "robot.yaml", "environment.yaml") == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "max_speed: 1 m/s",
            "max_sped: 1 m/s",
            [
                "robot.yaml:3:7: error: 'max_speed' is missing\n    at: body\n    got: a mapping with drive, max_sped\n"
                "    allowed: max_speed: …",
                "robot.yaml:3:29: error: unknown key 'max_sped'\n    at: body.max_sped\n    got: max_sped\n"
                "    allowed: mass, drive, max_speed, max_lateral_speed, max_acceleration, max_deceleration,"
                " max_yaw_rate, "
                "max_yaw_acceleration, max_payload, track_width, regeneration\n    did you mean: max_speed",
            ],
        ),
        (
            "max_speed: 1 m/s",
            "max_speed: 3 kg",
            [
                "robot.yaml:3:40: error: wrong unit: kg is a unit of mass\n    at: body.max_speed\n    got: 3 kg\n"
                "    allowed: a speed such as 0.5 m/s"
            ],
        ),
        (
            "10 Wh",
            "-10 Wh",
            [
                "robot.yaml:4:30: error: impossible value\n    at: batteries.main.capacity\n    got: '-10 Wh'\n"
                "    allowed: more than 0 J"
            ],
        ),
        (
            "c3: 2",
            "c3: -2",
            [
                "robot.yaml:5:68: error: impossible value of c3\n    at: motion.parameters.c3\n    got: -2 W s/m\n"
                "    allowed: at least 0"
            ],
        ),
        (
            "c3: 2, c4: 3",
            "c4: 3",
            [
                "robot.yaml:5:44: error: parameter 'c3' of motion model 'polynomial' is missing"
                "\n    at: motion.parameters\n"
                "    allowed: c3: rolling friction, W s/m"
            ],
        ),
        (
            "[{battery: main, power: 2 W}]",
            "[]",
            [
                "robot.yaml:7:18: error: component 'lidar' is fed by no battery\n    at: components.lidar.loads\n"
                "    got: a list of 0\n    allowed: loads: [{battery: …, power: …}]"
            ],
        ),
        (
            "{loads: [{battery: main, power: 2 W}]}",
            "{units: 1}",
            [
                "robot.yaml:7:10: error: component 'lidar' is fed by no battery\n    at: components.lidar\n"
                "    got: a mapping with units\n    allowed: loads: [{battery: …, power: …}]"
            ],
        ),
        (
            "[{battery: main, power",
            "[{battery: mian, power",
            [
                "robot.yaml:7:29: error: no battery 'mian'\n    at: components.lidar.loads.0.battery\n    got: 'mian'\n"
                "    allowed: main\n    did you mean: main"
            ],
        ),
        (
            "{optional: {lidar: 1}}",
            "{required: {gps: 1}}",
            [
                "robot.yaml:9:29: error: the scheme requires 'gps', which the robot does not have\n"
                "    at: schemes.go.sensors.required.gps\n    got: 'gps'\n    allowed: lidar"
            ],
        ),
        (
            "drive: differential",
            "drive: diferential",
            [
                "robot.yaml:3:15: error: not one of the allowed words\n    at: body.drive\n    got: 'diferential'\n"
                "    allowed: differential, skid_steer, mecanum, omni, ackermann\n    did you mean: differential"
            ],
        ),
    ],
)
def test_robot(folder: Path, old: str, new: str, expected: list[str]) -> None:
    change("robot", old, new)
    assert told("robot.yaml") == expected


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "to: B",
            "to: Bee",
            [
                "mission.yaml:8:17: error: no place 'Bee'\n    at: segments.0.drive.to\n    got: 'Bee'"
                "\n    allowed: A, B, C"
            ],
        ),
        (
            "to: B",
            "to: C",
            [
                "mission.yaml:8:17: error: no way from 'A' to 'C'\n    at: segments.0.drive.to\n    got: C"
                "\n    allowed: A, B"
            ],
        ),
        (
            "0.5 m/s",
            "2 m/s",
            [
                "mission.yaml:6:19: error: faster than the robot\n    at: defaults.speed\n    got: 2 m/s\n"
                "    allowed: at most 1 m/s (body.max_speed of r)"
            ],
        ),
        (
            "scheme: go",
            "scheme: goo",
            [
                "mission.yaml:6:36: error: no control scheme 'goo'\n    at: defaults.scheme"
                "\n    got: 'goo'\n    allowed: go\n"
                "    did you mean: go"
            ],
        ),
        (
            "- drive: {to: B}",
            "- drvie: {to: B}",
            [
                "mission.yaml:8:5: error: unknown kind of segment 'drvie'\n    at: segments.0.drvie\n    got: drvie\n"
                "    allowed: one of drive, arc, turn, move, inspect, wait, dock, repeat\n    did you mean: drive"
            ],
        ),
        (
            "{to: B}",
            "{to: B, sensors: {lidar: 2}}",
            [
                "mission.yaml:8:37: error: more units of 'lidar' than the robot has"
                "\n    at: segments.0.drive.sensors.lidar\n"
                "    got: 2\n    allowed: 0 to 1"
            ],
        ),
        (
            "robot: robot.yaml",
            "robot: pionear3dx",
            [
                "mission.yaml:3:8: error: no robot 'pionear3dx'\n    at: robot\n    got: 'pionear3dx'\n"
                "    allowed: khepera3, mecanum4, pioneer3dx, rover_tx2, or the path of a robot file"
                "\n    did you mean: pioneer3dx"
            ],
        ),
        (
            "environment: environment.yaml",
            "environment: nowhere.yaml",
            [
                "mission.yaml:4:14: error: no such environment file\n    at: environment\n    got: 'nowhere.yaml'\n"
                "    allowed: a path relative to this file"
            ],
        ),
        (
            "start: A",
            "start: A\nstart: B",
            ["mission.yaml:6:1: error: key 'start' given twice; the first is in line 5"],
        ),
    ],
)
def test_mission(folder: Path, old: str, new: str, expected: list[str]) -> None:
    change("mission", old, new)
    assert told("mission.yaml") == expected


def test_sideways_only_where_the_drive_can(folder: Path) -> None:
    change("mission", "- drive: {to: B}", "- move: {distance: 1 m, direction: 90 deg}")
    assert told("mission.yaml") == [
        "mission.yaml:8:5: error: a differential drive cannot move sideways\n    at: segments.0.move\n    got: move\n"
        "    allowed: mecanum or omni drive"
    ]


def test_all_faults_of_all_files_at_once(folder: Path) -> None:
    change("robot", "10 Wh", "10 V")
    change("environment", "to: B", "to: D")
    change("mission", "to: B}", "to: B, sped: 1}")
    assert [fault.splitlines()[0] for fault in told("mission.yaml", "robot.yaml", "environment.yaml", "none.yaml")] == [
        "environment.yaml:4:23: error: no place 'D'",
        "mission.yaml:8:20: error: unknown key 'sped'",
        "none.yaml: error: cannot read this file: no such file or directory",
        "robot.yaml:4:30: error: wrong unit: V is a unit of voltage",
    ]
    with pytest.raises(InputError) as caught:
        load_mission("mission.yaml")
    assert len(caught.value.faults) == 3


def test_positions_after_a_faulty_list_item_stay_those_of_the_file(folder: Path) -> None:
    change("mission", "  - drive: {to: B}\n", "  - drvie: {to: B}\n  - wait: {duration: 1 kg}\n  - drive: {to: Q}\n")
    assert [fault.splitlines()[0] for fault in told("mission.yaml")] == [
        "mission.yaml:8:5: error: unknown kind of segment 'drvie'",
        "mission.yaml:9:22: error: wrong unit: kg is a unit of mass",
        "mission.yaml:10:17: error: no place 'Q'",
    ]


def test_components_that_require_each_other(folder: Path) -> None:
    change(
        "robot",
        "  lidar: {",
        "  hub: {requires: [lidar], loads: [{battery: main, power: 1 W}]}\n  lidar: {requires: [hub], ",
    )
    assert [fault.splitlines()[0] for fault in told("robot.yaml")] == [
        "robot.yaml:8:22: error: components require each other in a circle"
    ]


def test_one_way_streets_and_along(folder: Path) -> None:
    change("environment", "{from: A, to: B}", "{from: A, to: B, both_ways: false}, {from: B, to: C}")
    change("mission", "- drive: {to: B}", "- drive: {along: [B, C]}\n  - drive: {to: A}")
    assert [fault.splitlines()[0] for fault in told("mission.yaml")] == [
        "mission.yaml:9:17: error: no way from 'C' to 'A'"
    ]


def test_docking_needs_a_charger(folder: Path) -> None:
    change("mission", "- drive: {to: B}", "- drive: {to: B}\n  - dock: {recharge: {until: 90 %}}")
    assert [fault.splitlines()[0] for fault in told("mission.yaml")] == ["mission.yaml:9:5: error: no charger at 'B'"]


def test_formula_of_an_effect(folder: Path) -> None:
    with open("robot.yaml", "a", encoding="utf-8") as handle:
        handle.write("effects:\n  - {name: mine, battery: main, power: \"k * __import__('os')\", parameters: {k: 1}}\n")
    faults = told("robot.yaml")
    assert faults[0].startswith("robot.yaml:11:")
    assert "__import__" in faults[0]
    change("robot", "k * __import__('os')", "k * yaw_rate_rads")
    assert told("robot.yaml")[0].splitlines()[-1] == "    did you mean: yaw_rate_rad_s"
    assert ": warning: formula names 'yaw_rate_rads'" in told("robot.yaml")[0]
    change("robot", "yaw_rate_rads", "fan_speed_hz")
    assert told("robot.yaml") == []


def test_unknown_robot_by_name() -> None:
    with pytest.raises(InputError) as caught:
        load_robot("pioner3dx")
    assert caught.value.faults[0].hint == "pioneer3dx"


def test_names_that_yaml_1_1_would_spoil(folder: Path) -> None:
    change("environment", "places: {A: {x: 0, y: 0}, B: {x: 10, y: 0}", "places: {on: {x: 0, y: 0}, no: {x: 10, y: 0}")
    change("environment", "{from: A, to: B}", "{from: on, to: no}")
    change("mission", "start: A", "start: on")
    change("mission", "to: B", "to: no")
    assert told("mission.yaml") == []
    change("mission", "{to: no}", "{to: no, speed: 1e-1, surface: yes}")
    assert told("mission.yaml") == []
    segment = load_mission("mission.yaml").segments[0]
    assert (segment.to, segment.speed.value, segment.surface) == ("no", 0.1, "yes")


def test_wrong_units_of_motion_and_effect_parameters(folder: Path) -> None:
    change("robot", "c2: 1, c3: 2, c4: 3}", "c2: 1 W s^2/m^2, c3: 2 W, c4: {value: 3 kg, sd: 5 %}}")
    change("robot", "drive: differential", "drive: differential, mass: 5 kg")
    with Path("robot.yaml").open("a", encoding="utf-8") as file:
        file.write("effects:\n  - {effect: grade, battery: main, parameters: {k: 1 kg}}\n")
    assert told("robot.yaml") == [
        "robot.yaml:5:78: error: wrong unit of c3\n    at: motion.parameters.c3\n"
        "    got: a number in W\n    allowed: a number in W s/m",
        "robot.yaml:5:87: error: wrong unit of c4\n    at: motion.parameters.c4\n"
        "    got: a number in kg\n    allowed: a number in W",
        "robot.yaml:11:52: error: wrong unit of k\n    at: effects.0.parameters.k\n"
        "    got: a number in kg\n    allowed: a plain number",
    ]


def test_the_same_quantity_in_another_unit_is_fine(folder: Path) -> None:
    change("robot", "c2: 1, c3: 2, c4: 3}", "c2: 1, c3: 2 N, c4: 3000 mW}")
    assert told("robot.yaml") == []
    assert load_robot("robot.yaml").motion.parameters["c4"].value == pytest.approx(3.0)  # type: ignore[union-attr]


def test_keys_allowed_inside_a_repeat_block_are_listed(folder: Path) -> None:
    change("mission", "  - drive: {to: B}", "  - repeat: {times: 2, segments: [{wait: {durations: 3 s}}]}")
    fault = next(text for text in told("mission.yaml") if "unknown key 'durations'" in text)
    assert "did you mean: duration" in fault


def test_a_slope_that_no_term_reads_is_told(folder: Path) -> None:
    change(
        "mission",
        "  - drive: {to: B}",
        "  - drive: {distance: 5 m, slope: 3 deg}\n  - drive: {distance: 5 m, slope: 2 deg}",
    )
    assert told("mission.yaml") == [
        "mission.yaml:8:35: warning: this slope costs nothing: no term of robot 'r' depends on it\n"
        "    at: segments.0.drive.slope\n    got: 0.05236 rad\n"
        "    allowed: effects: [{effect: grade, battery: …, parameters: {k: …}}], or the motion model traction"
    ]
    assert [fault.path for fault in load_mission("mission.yaml").warnings] == ["segments.0.drive.slope"]
    with Path("robot.yaml").open("a", encoding="utf-8") as file:
        file.write("effects:\n  - {effect: grade, battery: main, parameters: {k: 1}}\n")
    change("robot", "max_speed: 1 m/s", "max_speed: 1 m/s, mass: 5 kg")
    assert told("mission.yaml") == []
    assert load_mission("mission.yaml").warnings == ()


def test_a_load_that_no_term_reads_is_told_and_a_formula_can_read_it(folder: Path) -> None:
    change("mission", "defaults: {", "defaults: {payload: 2 kg, ")
    change("environment", "{from: A, to: B}", "{from: A, to: B, slope: 3 %}")
    lines = [text.splitlines()[0] for text in told("mission.yaml")]
    assert [line.split(" ", 1)[0] for line in lines] == ["environment.yaml:4:33:", "mission.yaml:6:21:"]
    with Path("robot.yaml").open("a", encoding="utf-8") as file:
        file.write(
            "effects:\n"
            "  - {name: own, battery: main, power: 'k * payload_kg * sin(slope_rad) * v', parameters: {k: 1}}\n"
        )
    assert told("mission.yaml") == []


def test_lifting_without_a_mass_is_told(folder: Path) -> None:
    with Path("robot.yaml").open("a", encoding="utf-8") as file:
        file.write("effects:\n  - {effect: grade, battery: main, parameters: {k: 1}}\n")
    assert [text.splitlines()[0] for text in told("robot.yaml")] == [
        "robot.yaml:11:14: warning: 'grade' needs the robot's mass, which counts as 1 kg here"
    ]
    change("robot", "max_speed: 1 m/s", "max_speed: 1 m/s, mass: 5 kg")
    assert told("robot.yaml") == []


def test_how_long_without_how_often_is_a_fault(folder: Path) -> None:
    change("mission", "segments:", "behaviour: {obstacle_stop: 8 s}\nsegments:")
    change("mission", "drive: {to: B}", "drive: {to: B, behaviour: {relocalisation_time: 3 s}}")
    assert [text.splitlines()[0] for text in told("mission.yaml")] == [
        "mission.yaml:7:13: error: 'obstacle_stop' has no effect without 'obstacle_spacing'",
        "mission.yaml:9:32: error: 'relocalisation_time' has no effect without 'relocalisation_failure'",
    ]
    change("mission", "behaviour: {obstacle_stop: 8 s}", "behaviour: {obstacle_stop: 8 s, obstacle_spacing: 40 m}")
    change("robot", "go: {", "go: {behaviour: {relocalisation_failure: 10 %}, ")
    assert told("mission.yaml") == []


def test_many_faults_take_time_in_proportion(tmp_path: Path) -> None:
    """Eight times the faults: 64 times the work would be quadratic."""
    took = []
    for count in (400, 3200):
        path = tmp_path / f"{count}.yaml"
        lines = "  - drvie: {distance: 3 m}\n  - wait: {duration: 3 m}\n" * (count // 2)
        path.write_text(f"kind: mission\nname: long\nrobot: pioneer3dx\nsegments:\n{lines}", encoding="utf-8")
        begun = time.process_time()
        with pytest.raises(InputError) as told:
            load_mission(path)
        took.append(time.process_time() - begun)
        assert len(told.value.faults) == count
    assert took[1] < 24.0 * took[0]
