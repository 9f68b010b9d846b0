"""What is wrong, where, what was allowed, what was perhaps meant: the texts word for word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import missionsim
from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.inputs import check_files, load_mission, load_robot
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.power import build_power_model
from missionsim.runs.drive import drive
from missionsim.runs.run import Run

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
SIDEWAYS = "model: expression, power: abs(v) + abs(u), standing: '1'"
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


def heads(*names: str) -> list[str]:
    return [text.splitlines()[0] for text in told(*names)]


def change(name: str, old: str, new: str) -> None:
    path = Path(f"{name}.yaml")
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def add_effect(effect: str) -> None:
    with open("robot.yaml", "a", encoding="utf-8") as handle:
        handle.write(f"effects:\n  - {{{effect}}}\n")


def test_the_three_files_are_valid(folder: Path) -> None:
    assert told("mission.yaml", "robot.yaml", "environment.yaml") == []


def fault(what: str, at: str = "", got: str = "", allowed: str = "", meant: str = "") -> str:
    """A fault as it is told, from its line on."""
    rest = {"at": at, "got": got, "allowed": allowed, "did you mean": meant}
    return what.replace(": ", ": error: ", 1) + "".join(f"\n    {key}: {text}" for key, text in rest.items() if text)


CASES = [
    ("robot", "max_speed: 1 m/s", "max_sped: 1 m/s", fault("3:29: unknown key 'max_sped'", "body.max_sped",
     "max_sped", "mass, drive, max_speed, max_lateral_speed, max_acceleration, max_deceleration, max_yaw_rate, "
     "max_yaw_acceleration, max_payload, track_width, regeneration", "max_speed")),
    ("robot", "max_speed: 1 m/s", "max_speed: 3 kg", fault("3:40: wrong unit: kg is a unit of mass",
     "body.max_speed", "3 kg", "a speed such as 0.5 m/s")),
    ("robot", "10 Wh", "-10 Wh", fault("4:30: impossible value", "batteries.main.capacity", "'-10 Wh'",
     "more than 0 J")),
    ("robot", "c3: 2", "c3: -2", fault("5:68: impossible value of c3", "motion.parameters.c3", "-2 W s/m",
     "at least 0")),
    ("robot", "c3: 2, c4: 3", "c4: 3", fault("5:44: parameter 'c3' of motion model 'polynomial' is missing",
     "motion.parameters", allowed="c3: rolling friction, W s/m")),
    ("robot", "[{battery: main, power: 2 W}]", "[]", fault("7:18: component 'lidar' is fed by no battery",
     "components.lidar.loads", "a list of 0", "loads: [{battery: …, power: …}]")),
    ("robot", "{loads: [{battery: main, power: 2 W}]}", "{units: 1}",
     fault("7:10: component 'lidar' is fed by no battery", "components.lidar", "a mapping with units",
     "loads: [{battery: …, power: …}]")),
    ("robot", "[{battery: main, power", "[{battery: mian, power", fault("7:29: no battery 'mian'",
     "components.lidar.loads.0.battery", "'mian'", "main", "main")),
    ("robot", "{optional: {lidar: 1}}", "{required: {gps: 1}}",
     fault("9:29: the scheme requires 'gps', which the robot does not have", "schemes.go.sensors.required.gps",
     "'gps'", "lidar")),
    ("robot", "drive: differential", "drive: diferential", fault("3:15: not one of the allowed words", "body.drive",
     "'diferential'", "differential, skid_steer, mecanum, omni, ackermann", "differential")),
    ("mission", "to: B", "to: Bee", fault("8:17: no place 'Bee'", "segments.0.drive.to", "'Bee'", "A, B, C")),
    ("mission", "to: B", "to: C", fault("8:17: no way from 'A' to 'C'", "segments.0.drive.to", "C", "A, B")),
    ("mission", "0.5 m/s", "2 m/s", fault("6:19: faster than the robot", "defaults.speed", "2 m/s",
     "at most 1 m/s (body.max_speed of r)")),
    ("mission", "scheme: go", "scheme: goo", fault("6:36: no control scheme 'goo'", "defaults.scheme", "'goo'",
     "go", "go")),
    ("mission", "- drive: {to: B}", "- drvie: {to: B}", fault("8:5: unknown kind of segment 'drvie'",
     "segments.0.drvie", "drvie", "one of drive, arc, turn, move, inspect, wait, dock, repeat", "drive")),
    ("mission", "{to: B}", "{to: B, sensors: {lidar: 2}}", fault("8:37: more units of 'lidar' than the robot has",
     "segments.0.drive.sensors.lidar", "2", "0 to 1")),
    ("mission", "robot: robot.yaml", "robot: pionear3dx", fault("3:8: no robot 'pionear3dx'", "robot",
     "'pionear3dx'", "khepera3, mecanum4, pioneer3dx, rover_tx2, or the path of a robot file", "pioneer3dx")),
    ("mission", "environment: environment.yaml", "environment: nowhere.yaml",
     fault("4:14: no such environment file", "environment", "'nowhere.yaml'", "a path relative to this file")),
    ("mission", "start: A", "start: A\nstart: B", fault("6:1: key 'start' given twice; the first is in line 5")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "old", "new", "faults"), [(*case[:3], case[3:]) for case in CASES])
def test_words_of_a_fault(folder: Path, name: str, old: str, new: str, faults: tuple[str, ...]) -> None:
    change(name, old, new)
    assert told(f"{name}.yaml") == [f"{name}.yaml:{fault}" for fault in faults]


CELL = "{capacity: 10 Wh, model: {kind: equivalent_circuit, resistance: 0.1 ohm, peukert: 1, open_circuit_voltage: "


@pytest.mark.parametrize(
    ("name", "old", "new", "head"),
    [
        ("mission", "start: A\n", "", "a drive to a place, but the mission has no start"),
        (
            "mission",
            "{to: B}",
            "{distance: 3 m}\n  - drive: {to: B}",
            "the place from which this drive starts is not known",
        ),
        ("mission", "environment: environment.yaml\nstart: A\n", "", "place 'B' without an environment"),
        (
            "mission",
            MISSION[MISSION.index("environment") :],
            "segments:\n  - dock: {recharge: {until: 90 %}}\n",
            "docking without an environment",
        ),
        ("mission", "{to: B}", "{to: B, conditions: {on_lidar: 1}}", "'on_lidar' is decided by the run"),
        ("mission", "segments:", "activities: [{component: lidar, every: 60 s}]\nsegments:", "bursts need a duration"),
        ("robot", "go: {sensors", "go: {motion: false, sensors", "control scheme 'go' stands still"),
        ("robot", "go: {sensors", "go: {image_analysis: true, sensors", "image analysis is done standing"),
        ("robot", "10 Wh", "10 Ah", "a capacity in Ah needs nominal_voltage"),
        ("robot", "10 Wh", "-10 Ah", "impossible value"),
        ("robot", "{capacity: 10 Wh}", CELL + "[[0, 10 V], [0.9, 12 V]]}}", "the curve must run from 0 to 1"),
        ("robot", "{capacity: 10 Wh}", CELL + "[[0, 12 V], [1, 10 V]]}}", "voltages must not fall with charge"),
        (
            "robot",
            "{capacity: 10 Wh}",
            CELL + "[[0, 10 V], [1, 12 V]], cut_off: 12 V}}",
            "cut-off above the full battery's voltage",
        ),
        (
            "robot",
            "10 Wh",
            "10 Wh, charge_taper: {from: 1, end_power: 0.1}",
            "a taper that begins when the battery is full",
        ),
        ("environment", "to: B}", "to: B, length: 3 m}", "shorter than the straight line between its places"),
        ("environment", "to: B}", "to: A}", "an edge from a place to itself"),
        ("environment", "B: {x: 10, y: 0}", "B: {x: 0, y: 0}", "edge of length 0"),
    ],
)
def test_what_cannot_be_is_told(folder: Path, name: str, old: str, new: str, head: str) -> None:
    change(name, old, new)
    assert any(head in text for text in heads("mission.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "meant"),
    [("10 Wh", '"10,5 Wh"', "10.5 Wh"), ("1 m/s", '"1,4"', "1.4"), ("c3: 2", 'c3: "2,4 W s/m"', "2.4 W s/m")],
)
def test_a_decimal_comma_is_told(folder: Path, old: str, new: str, meant: str) -> None:
    change("robot", old, new)
    (fault,) = told("robot.yaml")
    assert fault.endswith(f"\n    did you mean: {meant}")


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("name: r\n\ttitle: a", "tab"),
        ("body:\n\tmass: 3", "tab"),
        ("body:\n  mass: 3\n drive: omni", "column"),
        ("segments:\n  - a\n - b", "column"),
        ("body:\n  mass: 3\n   drive: omni", "column"),
        ("title: a: b", "quotation marks"),
        ("name r\nbody: 3", "key: value"),
    ],
)
def test_what_yaml_asks_for_is_told(folder: Path, text: str, hint: str) -> None:
    Path("robot.yaml").write_text(f"kind: robot\n{text}\n", encoding="utf-8")
    (fault,) = told("robot.yaml")
    assert "not YAML" in fault
    assert hint in fault.partition("\n    allowed: ")[2]


def test_a_mass_at_fault_is_not_called_missing_as_well(folder: Path) -> None:
    add_effect("effect: grade, battery: main, parameters: {k: 1}")
    change("robot", "body: {", "body: {mass: 32 W, ")
    assert heads("robot.yaml") == ["robot.yaml:3:14: error: wrong unit: W is a unit of power"]


def test_sideways_only_where_the_drive_can(folder: Path) -> None:
    change("mission", "- drive: {to: B}", "- move: {distance: 1 m, direction: 90 deg}")
    assert told("mission.yaml") == [
        "mission.yaml:8:5: error: a differential drive cannot move sideways\n    at: segments.0.move\n    got: move\n"
        "    allowed: mecanum or omni drive"
    ]


@pytest.mark.parametrize(
    ("direction", "speed", "most"),
    [("90 deg", "0.5 m/s", "0.2"), ("45 deg", "0.5 m/s", "0.282843"), ("0", "0.9 m/s", "")],
)
def test_a_speed_sideways_has_its_own_limit(folder: Path, direction: str, speed: str, most: str) -> None:
    """It was taken for a greatest speed only where it was above `max_speed`."""
    change("robot", "drive: differential", "drive: omni, max_lateral_speed: 0.2 m/s")
    change("robot", "model: polynomial, parameters: {c2: 1, c3: 2, c4: 3}", SIDEWAYS)
    change("mission", "- drive: {to: B}", f"- move: {{distance: 1 m, direction: {direction}, speed: {speed}}}")
    allowed = f"at most {most} m/s (body.max_speed and max_lateral_speed of r)"
    assert [text.splitlines()[1:] for text in told("mission.yaml")] == (
        [["    at: segments.0.move.speed", f"    got: {speed}", f"    allowed: {allowed}"]] if most else []
    )


def test_going_sideways_at_no_cost_is_told(folder: Path) -> None:
    change("robot", "drive: differential", "drive: omni")
    change(
        "mission",
        "- drive: {to: B}",
        "- move: {distance: 1 m, direction: 90 deg}\n  - move: {distance: 1 m, direction: 180 deg}",
    )
    assert told("mission.yaml") == [
        "mission.yaml:8:38: warning: going sideways costs nothing: no term of robot 'r' depends on it\n"
        "    at: segments.0.move.direction\n    got: 1.571 rad\n"
        "    allowed: u in a formula of motion, or the motion model mecanum"
    ]
    change("robot", "model: polynomial, parameters: {c2: 1, c3: 2, c4: 3}", SIDEWAYS)
    assert told("mission.yaml") == []


def test_all_faults_of_all_files_at_once(folder: Path) -> None:
    change("robot", "10 Wh", "10 V")
    change("environment", "to: B", "to: D")
    change("mission", "to: B}", "to: B, sped: 1}")
    assert heads("mission.yaml", "robot.yaml", "environment.yaml", "none.yaml") == [
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
    assert heads("mission.yaml") == [
        "mission.yaml:8:5: error: unknown kind of segment 'drvie'",
        "mission.yaml:9:22: error: wrong unit: kg is a unit of mass",
        "mission.yaml:10:17: error: no place 'Q'",
    ]


def test_components_that_require_each_other(folder: Path) -> None:
    hub = "  hub: {requires: [lidar], loads: [{battery: main, power: 1 W}]}\n  lidar: {requires: [hub], "
    change("robot", "  lidar: {", hub)
    assert heads("robot.yaml") == ["robot.yaml:8:22: error: components require each other in a circle"]


def test_a_knot_of_components_that_require_each_other_is_one_fault(folder: Path) -> None:
    others = "abcde"
    knot = "".join(
        f"  {name}: {{requires: [{', '.join(others.replace(name, ''))}], loads: [{{battery: main, power: 1 W}}]}}\n"
        for name in others
    )
    pair = "".join(f"  {a}: {{requires: [{b}], loads: [{{battery: main, power: 1 W}}]}}\n" for a, b in ("yz", "zy"))
    change("robot", "  lidar: {", f"{knot}{pair}  lidar: {{")
    assert [head.split("error: ")[1] for head in heads("robot.yaml")] == 2 * [
        "components require each other in a circle"
    ]


def test_what_hangs_on_a_faulty_block_is_no_fault_of_its_own(folder: Path) -> None:
    change("robot", "batteries: {main: {capacity: 10 Wh}}", "batteries: null")
    assert heads("robot.yaml") == ["robot.yaml:4:12: error: must be a mapping"]


def test_one_way_streets_and_along(folder: Path) -> None:
    change("environment", "{from: A, to: B}", "{from: A, to: B, both_ways: false}, {from: B, to: C}")
    change("mission", "- drive: {to: B}", "- drive: {along: [B, C]}\n  - drive: {to: A}")
    assert heads("mission.yaml") == ["mission.yaml:9:17: error: no way from 'C' to 'A'"]


def test_docking_needs_a_charger(folder: Path) -> None:
    change("mission", "- drive: {to: B}", "- drive: {to: B}\n  - dock: {recharge: {until: 90 %}}")
    assert heads("mission.yaml") == ["mission.yaml:9:5: error: no charger at 'B'"]


def test_formula_of_an_effect(folder: Path) -> None:
    add_effect("name: mine, battery: main, power: \"k * __import__('os')\", parameters: {k: 1}")
    faults = told("robot.yaml")
    assert faults[0].startswith("robot.yaml:11:")
    assert "__import__" in faults[0]
    change("robot", "k * __import__('os')", "k * yaw_rate_rads")
    assert told("robot.yaml")[0].splitlines()[-1] == "    did you mean: yaw_rate_rad_s"
    assert ": warning: formula names 'yaw_rate_rads'" in told("robot.yaml")[0]
    change("robot", "yaw_rate_rads", "fan_speed_hz")
    assert told("robot.yaml") == []


@pytest.mark.parametrize(
    ("power", "parameters", "told"),
    [
        ("k * v", "k: 3 kg", "the formula gives m kg s^-1, no power"),
        ("k * v", "k: 3 N", ""),
        ("k * v**2", "k: 3 W s/m", "the formula gives m^3 kg s^-4, no power"),
        ("k * abs(v)**0.5 * abs(w)", "k: {value: 3, unit: W s^1.5/m^0.5/rad}", ""),
        ("k * v + j", "k: 3 W s/m, j: 2 J", "the formula adds or compares k * v in W and j in J"),
        ("max(k * v, j)", "k: 3 W s/m, j: 2 W", ""),
        ("k * max(temp_ambient_c - 20, 0)", "k: 3 W/K", ""),
        ("k * max(lag(abs(v), tau) - abs(v), 0)", "k: 3 W s/m, tau: 8 s", ""),
        ("k * on_time_lidar * (surface == 'grass') * exp(-v)", "k: 3 W/s", ""),
        ("2 * k * v", "k: 3 kg", ""),  # the 2 may be two metres
        ("k * v * brush_rpm", "k: 3 kg", ""),
        ("k * v + j", "k: {value: 3, sd: 1}, j: 2 W", ""),
        ("k * (abs(v) + abs(w))", "k: 3", ""),
    ],
)
def test_a_formula_gives_watts_as_far_as_its_units_tell(power: str, parameters: str, told: str) -> None:
    text = (
        "kind: robot\nname: bot\nbody: {drive: differential, max_speed: 1 m/s, mass: 9 kg}\n"
        "batteries: {main: {capacity: 99 Wh}}\nmotion: {battery: main, model: none}\n"
        f'effects:\n  - {{name: own, battery: main, power: "{power}", parameters: {{{parameters}}}}}\n'
    )
    try:
        robot_from_text(text)
        faults = []
    except InputError as error:
        faults = [(fault.message, fault.line, fault.path) for fault in error.faults]
    assert faults == ([(told, 7, "effects.0.power")] if told else [])


@pytest.mark.parametrize(("name", "column"), [("v", "speed_m_s"), ("m", "mass_kg"), ("payload_kg", "payload_kg")])
def test_a_parameter_that_hides_a_column_is_told(folder: Path, name: str, column: str) -> None:
    text = (
        "kind: robot\nname: bot\nbody: {drive: differential, max_speed: 1 m/s}\nbatteries: {main: {capacity: 99 Wh}}\n"
        f"motion: {{battery: main, model: expression, power: c * {name}, parameters: {{c: 10, {name}: 3}}}}\n"
    )
    (folder / "bot.yaml").write_text(text)
    (fault,) = check_files([folder / "bot.yaml"])
    told = f"'{name}' in the formula is the parameter of that name, not what {column} is"
    assert (fault.message, fault.line, fault.path) == (told, 5, "motion.power")


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
    add_effect("effect: grade, battery: main, parameters: {k: 1 kg}")
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


def test_an_empty_key_is_an_unknown_one(folder: Path) -> None:
    change("robot", "max_speed: 1 m/s", '"": 1, max_speed: 1 m/s')
    (text,) = told("robot.yaml")
    assert "error: unknown key ''" in text


def test_keys_allowed_inside_a_repeat_block_are_listed(folder: Path) -> None:
    change("mission", "  - drive: {to: B}", "  - repeat: {times: 2, segments: [{wait: {durations: 3 s}}]}")
    fault = next(text for text in told("mission.yaml") if "unknown key 'durations'" in text)
    assert "did you mean: duration" in fault


def test_a_slope_that_no_term_reads_is_told(folder: Path) -> None:
    change("mission", "{to: B}", "{distance: 5 m, slope: 3 deg}\n  - drive: {distance: 5 m, slope: 2 deg}")
    assert told("mission.yaml") == [
        "mission.yaml:8:35: warning: this slope costs nothing: no term of robot 'r' depends on it\n"
        "    at: segments.0.drive.slope\n    got: 0.05236 rad\n"
        "    allowed: effects: [{effect: grade, battery: …, parameters: {k: …}}], or the motion model traction"
    ]
    assert [fault.path for fault in load_mission("mission.yaml").warnings] == ["segments.0.drive.slope"]
    add_effect("effect: grade, battery: main, parameters: {k: 1}")
    change("robot", "max_speed: 1 m/s", "max_speed: 1 m/s, mass: 5 kg")
    assert told("mission.yaml") == []
    assert load_mission("mission.yaml").warnings == ()


@pytest.mark.parametrize("setting", ["slope: 3 deg", "payload: 1 kg"])
def test_heat_in_the_windings_reads_slope_and_payload(folder: Path, setting: str) -> None:
    """Both were told to cost nothing, and the energy rose by half."""
    change("mission", "{to: B}", f"{{distance: 5 m, {setting}}}")
    add_effect("effect: copper_loss, battery: main, parameters: {k: 0.01 W/N^2, rolling: 0.05}")
    change("robot", "max_speed: 1 m/s", "max_speed: 1 m/s, mass: 5 kg")
    assert told("mission.yaml") == []


BY_FLOOR = (
    ROBOT
    + """effects:
  - {effect: surface_rolling_resistance, battery: main, parameters: {k_grass: 14 N}}
"""
)


def test_a_floor_that_nothing_names_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = Path("environment.yaml")
    site.write_text(ENVIRONMENT.replace("to: B}", "to: B, surface: gras}, {from: B, to: C, surface: gras}"))
    Path("robot.yaml").write_text(ROBOT)
    assert load_mission("mission.yaml").warnings == ()  # nothing is by floor: all floors are the base's
    Path("robot.yaml").write_text(BY_FLOOR)
    (warning,) = load_mission("mission.yaml").warnings
    assert (warning.file, warning.line, warning.hint) == ("environment.yaml", 4, "grass")
    assert warning.message.startswith("floor 'gras' costs no more than the base")
    for command in ("validate", "run"):
        assert run_command([command, "mission.yaml"]) == 0
        assert capsys.readouterr().err.count("did you mean: grass") == 1
    site.write_text(ENVIRONMENT.replace("to: B}", "to: B, surface: grass}"))
    assert load_mission("mission.yaml").warnings == ()
    Path("robot.yaml").write_text(BY_FLOOR.replace("k_grass", "k_gras"))
    assert [w.hint for w in load_mission("mission.yaml").warnings] == ["gras"]


@pytest.mark.parametrize(
    ("effect", "origin", "floor", "hint"),
    [
        ("effect: 'surface_rolling_resistance:grass', parameters: {k: 14 N}", "", "gras", "grass"),
        ("effect: 'surface_rolling_resistance:grass', parameters: {k: 14 N}", "", "grass", None),
        ("name: soft, power: \"k * v * (surface == 'grass')\", parameters: {k: 14}", "", "gras", "grass"),
        ("name: soft, power: \"k * v * ('grass' != surface)\", parameters: {k: 14}", "", "grass", None),
        ("effect: surface_rolling_resistance, parameters: {k_grass: 14 N}", "tiles", "tiles", None),
        ("effect: surface_rolling_resistance, parameters: {k_grass: 14 N}", "tiles", "tile", "tiles"),
        ("effect: surface_rolling_resistance, parameters: {k_grass: 14 N}", "tiles", "grass", None),
        ("effect: surface_rolling_resistance, candidate: true, parameters: {k_grass: 14 N}", "", "gras", None),
    ],
)
def test_floors_that_a_robot_names(folder: Path, effect: str, origin: str, floor: str, hint: str | None) -> None:
    known = f"origin: {{range: {{surface: [{origin}]}}}}\n" * bool(origin)
    Path("robot.yaml").write_text(f"{ROBOT}{known}effects: [{{battery: main, {effect}}}]\n")
    Path("mission.yaml").write_text(MISSION.replace("to: B}", f"to: B, surface: {floor}}}"))
    found = missionsim.simulate(load_mission("mission.yaml")).warnings
    assert [w.hint for w in (*load_mission("mission.yaml").warnings, *found)] == [hint] * (hint is not None)


@pytest.mark.parametrize(
    ("segment", "hint"),
    [
        ("turn: {angle: 180}", "180 deg"),
        ("turn: {angle: {value: -90, sd: 1}}", "-90 deg"),
        ("arc: {radius: 1 m, angle: 45}", "45 deg"),
        ("drive: {distance: 5 m, heading: 90}", "90 deg"),
        ("turn: {angle: 180 deg}", None),
        ("turn: {angle: 12.6 rad}", None),
        ("turn: {angle: 3.1416}", None),
    ],
)
def test_degrees_without_their_unit_are_told(folder: Path, segment: str, hint: str | None) -> None:
    Path("mission.yaml").write_text(MISSION.replace("drive: {to: B}", segment))
    assert [w.hint for w in load_mission("mission.yaml").warnings] == [hint] * (hint is not None)


@pytest.mark.parametrize(("slope", "hint"), [("4", "4 deg"), ("-4", "-4 deg"), ("{value: 4}", "4 deg"), ("80", "")])
def test_a_slope_in_degrees_without_its_unit(folder: Path, slope: str, hint: str) -> None:
    Path("environment.yaml").write_text(ENVIRONMENT.replace("to: B}", f"to: B, slope: {slope}}}"))
    (fault,) = check_files(["environment.yaml"])
    assert (fault.message, fault.hint) == ("impossible value", hint)


def test_a_load_that_no_term_reads_is_told_and_a_formula_can_read_it(folder: Path) -> None:
    change("mission", "defaults: {", "defaults: {payload: 2 kg, ")
    change("environment", "{from: A, to: B}", "{from: A, to: B, slope: 3 %}")
    assert [line.split(" ", 1)[0] for line in heads("mission.yaml")] == ["environment.yaml:4:33:", "mission.yaml:6:21:"]
    add_effect("name: own, battery: main, power: 'k * payload_kg * sin(slope_rad) * v', parameters: {k: 1}")
    assert told("mission.yaml") == []


def test_lifting_without_a_mass_is_told(folder: Path) -> None:
    add_effect("effect: grade, battery: main, parameters: {k: 1}")
    assert heads("robot.yaml") == [
        "robot.yaml:11:14: warning: 'grade' needs the robot's mass, which counts as 1 kg here"
    ]
    change("robot", "max_speed: 1 m/s", "max_speed: 1 m/s, mass: 5 kg")
    assert told("robot.yaml") == []


def test_how_long_without_how_often_is_a_fault(folder: Path) -> None:
    change("mission", "segments:", "behaviour: {obstacle_stop: 8 s}\nsegments:")
    change("mission", "drive: {to: B}", "drive: {to: B, behaviour: {relocalisation_time: 3 s}}")
    assert heads("mission.yaml") == [
        "mission.yaml:7:13: error: 'obstacle_stop' has no effect without 'obstacle_spacing'",
        "mission.yaml:9:32: error: 'relocalisation_time' has no effect without 'relocalisation_failure'",
    ]
    change("mission", "behaviour: {obstacle_stop: 8 s}", "behaviour: {obstacle_stop: 8 s, obstacle_spacing: 40 m}")
    change("robot", "go: {", "go: {behaviour: {relocalisation_failure: 10 %}, ")
    assert told("mission.yaml") == []


def test_a_condition_that_no_term_reads_is_told_once(folder: Path) -> None:
    add_effect("name: e, power: k * cpu_load, battery: main, parameters: {k: 1 W}")
    first, second = (f"{{distance: 5 m, conditions: {{cpu_lod: {load}, cpu_load: 1}}}}" for load in (1, 2))
    change("mission", "{to: B}", f"{first}\n  - drive: {second}")
    assert told("mission.yaml") == [
        "mission.yaml:8:41: warning: condition 'cpu_lod' costs nothing: no term of robot 'r' reads it\n"
        "    at: segments.0.drive.conditions.cpu_lod\n    got: cpu_lod\n    did you mean: cpu_load"
    ]


@pytest.mark.parametrize(
    ("formula", "mass"),
    [("(m + payload_kg) * cr * v", "m"), ("cr * v * mass_kg * payload_kg", "mass_kg"), ("cr*m*v", "")],
)
def test_a_payload_that_a_formula_counts_twice_is_told(folder: Path, formula: str, mass: str) -> None:
    text = "kind: robot\nname: r\nbody: {mass: 50 kg, drive: differential, max_speed: 1 m/s}\n"
    text += "batteries: {main: {capacity: 1 Ah, nominal_voltage: 12 V}}\n"
    text += f'motion: {{battery: main, model: expression, power: "{formula}", parameters: {{cr: {{value: 0.1}}}}}}\n'
    (folder / "twice.yaml").write_text(text, encoding="utf-8")
    told = [str(fault) for fault in check_files([folder / "twice.yaml"])]
    assert any(f"'{mass}' holds the payload already" in one for one in told) is bool(mass)


def test_the_mass_of_a_formula_holds_the_payload() -> None:
    """As docs/yaml.md says: 50 kg and 20 kg draw 70 W where a kg draws a watt."""
    text = "kind: robot\nname: r\nbody: {mass: 50 kg, drive: differential, max_speed: 1 m/s}\n"
    text += "batteries: {main: {capacity: 1 Ah, nominal_voltage: 12 V}}\n"
    text += 'motion: {battery: main, model: expression, power: "k*m*v", parameters: {k: {value: 1.0}}}\n'
    model = build_power_model(robot_from_text(text))
    count, one = 3, np.ones(3)
    for payload_kg in (0.0, 20.0):
        columns = {"time_s": np.arange(count) * 1.0, "speed_m_s": one, "payload_kg": payload_kg * one}
        run = Run("r", columns, one, {"main": one}, {"main": None}, {"main": "power"})
        assert drive(model, run, "main").row_w("main") == pytest.approx(50.0 + payload_kg)
