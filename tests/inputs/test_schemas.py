"""JSON Schemas: fresh, and in agreement with the checks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from missionsim.errors import InputError
from missionsim.inputs.schemas import SCHEMA_FOLDER, schema, schema_kinds, schema_text
from missionsim.inputs.tree import parse_document

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(
    path
    for folder in ("missionsim/robots", "environments", "missions", "docs/maps")
    for path in (ROOT / folder).rglob("*.yaml")
)


@pytest.mark.parametrize("kind", schema_kinds())
def test_committed_schemas_are_fresh(kind: str) -> None:
    path = SCHEMA_FOLDER / f"{kind}.schema.json"
    assert path.read_text(encoding="utf-8") == schema_text(kind), "run: missionsim schema --out missionsim/schemas"


@pytest.mark.parametrize("kind", schema_kinds())
def test_schemas_are_schemas(kind: str) -> None:
    jsonschema.Draft202012Validator.check_schema(schema(kind))


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
    validator = jsonschema.Draft202012Validator(schema("mission"))
    assert validator.is_valid(MISSION)
    assert not validator.is_valid(MISSION | change)


def test_unknown_kind() -> None:
    with pytest.raises(InputError, match="no schema 'robots'"):
        schema("robots")
