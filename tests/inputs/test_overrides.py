"""`--set path=value` on the tree before it is checked."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionsim.errors import InputError
from missionsim.inputs import load_mission
from missionsim.inputs.overrides import split_assignment


@pytest.fixture
def patrol(root: Path) -> Path:
    return root / "missions" / "pioneer3dx" / "valve_patrol.yaml"


def faults(patrol: Path, *pairs: tuple[str, str]) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_mission(patrol, pairs)
    return [str(fault) for fault in caught.value.faults]


def test_by_index_by_name_and_without_the_kind(patrol: Path) -> None:
    for path in ("segments.3.drive.speed", "segments.H1_out.drive.speed", "segments.H1_out.speed", "segments.-7.speed"):
        assert load_mission(patrol, [(path, "0.7 m/s")]).segments[3].speed.value == 0.7


def test_new_key_of_a_missing_mapping(patrol: Path) -> None:
    mission = load_mission(patrol, [("behaviour.path_stretch", "1.1"), ("defaults.payload", "2500 g")])
    assert mission.behaviour.path_stretch.value == 1.1
    assert mission.defaults.payload.value == 2.5


def test_into_robot_and_environment(patrol: Path) -> None:
    mission = load_mission(
        patrol,
        [
            ("robot.batteries.laptop.capacity", "40 Wh"),
            ("environment.edges.H1.length", "20 m"),
            ("environment.places.corner.y", "44 m"),
            ("environment.places.H2_end.y", "44 m"),
            ("environment.places.V2.y", "39 m"),
        ],
    )
    assert mission.robot.batteries["laptop"].capacity_wh == pytest.approx(40.0)
    assert mission.environment.edges[2].length.value == 20.0
    assert mission.overrides[0] == ("robot.batteries.laptop.capacity", "40 Wh")


def test_sd_of_a_plain_number(patrol: Path) -> None:
    mission = load_mission(patrol, [("robot.links.usb.efficiency", "0.9"), ("robot.links.usb.efficiency.sd", "0.01")])
    assert mission.robot.links["usb"].efficiency.sd == 0.01


def test_whole_mapping_and_list(patrol: Path) -> None:
    mission = load_mission(
        patrol,
        [
            ("segments.H1_out.sensors", "{laser: 1, kinect: 1}"),
            ("activities", "[{component: screen, from: V1, until: V2}]"),
        ],
    )
    assert mission.segments[3].sensors == {"laser": 1, "kinect": 1}
    assert mission.activities[0].component == "screen"


def test_faults_name_the_command_line(patrol: Path) -> None:
    assert faults(patrol, ("segments.H1_out.speed", "3 kg")) == [
        "command line: error: wrong unit: kg is a unit of mass\n    at: segments.3.drive.speed\n    got: 3 kg\n"
        "    allowed: a speed such as 0.5 m/s"
    ]
    assert faults(patrol, ("segments.H1_ot.speed", "0.5"))[0].endswith("did you mean: H1_out")
    assert faults(patrol, ("defaults.sped", "0.5"))[0].startswith("command line: error: unknown key 'sped'")
    assert faults(patrol, ("robot.batteries.robot.capacity", "-5 Wh"))[0].splitlines()[:2] == [
        "command line: error: impossible value",
        "    at: robot.batteries.robot.capacity",
    ]
    assert "not YAML" in faults(patrol, ("defaults.speed", "[1"))[0]
    assert "impossible" in faults(patrol, ("segments.V1_stop.duration", "-1 s"))[0]


def test_the_file_on_disk_stays(patrol: Path) -> None:
    before = patrol.read_bytes()
    first = load_mission(patrol, [("defaults.payload", "1 kg")])
    assert patrol.read_bytes() == before
    assert first.sha256 == load_mission(patrol).sha256


@pytest.mark.parametrize("text", ["defaults.speed", "=3", "  =3"])
def test_not_an_assignment(text: str) -> None:
    with pytest.raises(InputError, match="not an assignment"):
        split_assignment(text)


def test_assignment_keeps_what_follows_the_first_sign() -> None:
    assert split_assignment("motion.power=a == b") == ("motion.power", "a == b")
