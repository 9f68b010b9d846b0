"""JSON Schemas: fresh, and in agreement with the checks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from missionsim.errors import InputError
from missionsim.inputs import units
from missionsim.inputs.edit import SCHEMA_FOLDER
from missionsim.inputs.loading import KINDS, load_robot
from missionsim.inputs.schemas import key_words, schema, schema_text, unit_pattern
from missionsim.inputs.tree import parse_document

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(
    path
    for folder in ("missionsim/robots", "environments", "missions", "docs/maps")
    for path in (ROOT / folder).rglob("*.yaml")
)


def committed(kind: str) -> dict[str, Any]:
    """The schema as it is shipped, which is the one that is made, as the first test says."""
    return dict(json.loads((SCHEMA_FOLDER / f"{kind}.schema.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("kind", KINDS)
def test_committed_schemas_are_fresh(kind: str) -> None:
    path = SCHEMA_FOLDER / f"{kind}.schema.json"
    assert path.read_text(encoding="utf-8") == schema_text(kind), "run: missionsim schema --out missionsim/schemas"


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_are_schemas(kind: str) -> None:
    jsonschema.Draft202012Validator.check_schema(committed(kind))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_files_agree_and_point_to_their_schema(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    data = parse_document(text).data
    match = re.match(r"# yaml-language-server: \$schema=(\S+)\n", text)
    assert match is not None, "first line must lead the editor to the schema"
    target = (path.parent / match.group(1)).resolve()
    assert target == (SCHEMA_FOLDER / f"{data['kind']}.schema.json").resolve()
    jsonschema.Draft202012Validator(json.loads(target.read_text(encoding="utf-8"))).validate(data)


MISSION: dict[str, Any] = {"kind": "mission", "name": "m", "robot": "r", "segments": [{"wait": {"duration": "10 min"}}]}


@pytest.mark.parametrize(
    "change",
    [
        {"segments": []},
        {"segments": [{"drvie": {"to": "A"}}]},
        {"segments": [{"wait": {"duration": "10 min"}, "drive": {"to": "A"}}]},
        {"segments": [{"wait": {"duration": True}}]},
        {"segments": [{"wait": {"duration": {"value": 1, "sdd": 2}}}]},
        {"segments": [{"wait": {"duration": -1}}]},
        {"segmnets": []},
        {"defaults": {"profile": "smooth"}},
        {"robot": None},
    ],
)
def test_schema_refuses_what_the_checks_refuse(change: dict[str, Any]) -> None:
    validator = jsonschema.Draft202012Validator(committed("mission"))
    assert validator.is_valid(MISSION)
    assert not validator.is_valid(MISSION | change)


def test_unknown_kind() -> None:
    with pytest.raises(InputError, match="no schema 'robots'"):
        schema("robots")


ROBOT = """kind: robot
name: courier
body: {drive: differential, max_speed: 1.2 m/s, mass: 30 kg}
batteries:
  main: {capacity: 12 Ah, nominal_voltage: 24 V}
motion: {battery: main, model: polynomial, parameters: {c2: 4, c3: 12, c4: 8, standing: 6}}
components:
  lidar: {loads: [{battery: main, power: 8 W}]}
effects:
  - {effect: grade, battery: main, parameters: {k: 1.4}}
"""
MISTAKES = {
    "model name": ("model: polynomial", "model: polynom"),
    "parameter of a model": ("c3: 12", "c33: 12"),
    "parameter of an effect": ("{k: 1.4}", "{kk: 1.4}"),
    "unit of a speed": ("1.2 m/s", "1.2 m"),
    "unit of a power": ("power: 8 W", "power: 8 Wh"),
    "unit of a capacity": ("12 Ah", "12 A"),
    "battery's spelling": ("battery: main, power", "battery: Main battery, power"),
    "effect's name": ("effect: grade", "effect: slope"),
    "key": ("nominal_voltage", "nominal_voltages"),
}


def own_schema(tmp_path: Path) -> dict[str, Any]:
    (tmp_path / "courier.yaml").write_text(ROBOT)
    return schema("robot", load_robot(tmp_path / "courier.yaml"))


@pytest.mark.parametrize("what", MISTAKES)
def test_an_editor_catches_usual_mistakes(what: str, tmp_path: Path) -> None:
    validator = jsonschema.Draft202012Validator(committed("robot"))
    validator.validate(parse_document(ROBOT).data)
    old, new = MISTAKES[what]
    assert old in ROBOT
    assert not validator.is_valid(parse_document(ROBOT.replace(old, new, 1)).data)


def test_schema_of_one_robot_knows_its_batteries_and_components(tmp_path: Path) -> None:
    validator = jsonschema.Draft202012Validator(own_schema(tmp_path))
    validator.validate(parse_document(ROBOT).data)
    assert not validator.is_valid(parse_document(ROBOT.replace("battery: main, power", "battery: mian, power")).data)
    robot = load_robot("pioneer3dx")
    mission = jsonschema.Draft202012Validator(schema("mission", robot))
    assert mission.is_valid(MISSION | {"initial_charge": {"robot": "50 %"}, "defaults": {"scheme": "path_following"}})
    assert not mission.is_valid(MISSION | {"initial_charge": {"main": "50 %"}})
    assert not mission.is_valid(MISSION | {"defaults": {"scheme": "path_folowing"}})
    assert not mission.is_valid(MISSION | {"defaults": {"sensors": {"lasr": 1}}})


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_has_a_description_and_a_default(kind: str) -> None:
    made = committed(kind)
    for name, definition in [(kind, made), *made["$defs"].items()]:
        if name.startswith("quantity"):
            continue
        for key, node in definition.get("properties", {}).items():
            assert node.get("description"), f"{name}.{key}"
            needed = key in definition.get("required", ()) or "const" in node
            assert needed or "default" in node, f"{name}.{key}"
    # a key in no table would be described by its own name
    quantity = {"value", "sd", "low", "high", "distribution", "note"}  # of a number that is a mapping
    own = {key for d in [made, *made["$defs"].values()] for key in d.get("properties", {})} - quantity
    assert not [key for key in own if key not in key_words() and key.rstrip("s") not in key_words()]


@pytest.mark.parametrize("dimension", units.DIMENSIONS)
def test_units_of_the_schemas_are_units_of_the_loader(dimension: str) -> None:
    pattern = re.compile(unit_pattern(dimension))
    for unit in units.DIMENSIONS[dimension].units:
        assert pattern.match(f"2.5 {unit}")
        assert isinstance(units.parse(f"2.5 {unit}", dimension)[0], float)
    wrong = "kg" if dimension != "mass" else "m"
    assert not pattern.match(f"2.5 {wrong}")
