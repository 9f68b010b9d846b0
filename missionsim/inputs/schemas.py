"""JSON Schemas of the YAML kinds, for editors and other checkers."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from missionsim.errors import InputError, did_you_mean
from missionsim.inputs.loading import KINDS, model_of
from missionsim.inputs.schema_names import add_descriptions, add_models, add_names
from missionsim.inputs.segments import SEGMENT_KINDS

if TYPE_CHECKING:
    from missionsim.inputs.robot import RobotSpec

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCHEMA_FOLDER = Path(__file__).resolve().parent.parent / "schemas"


def schema_kinds() -> tuple[str, ...]:
    """Kinds of YAML files that have a schema."""
    return KINDS


def schema(kind: str, robot: RobotSpec | None = None) -> dict[str, Any]:
    """JSON Schema (2020-12) of a kind of file.

    Parameters
    ----------
    robot : RobotSpec, optional
        Whose batteries, components and schemes are the only ones.
    kind : str
        ``robot``, ``environment``, ``mission``, ``study``, ``map`` or ``task``.

    Raises
    ------
    InputError
        Unknown kind.
    """
    if kind not in schema_kinds():
        raise InputError.single(
            f"no schema '{kind}'", got=kind, allowed=", ".join(schema_kinds()), hint=did_you_mean(kind, schema_kinds())
        )
    raw = model_of(kind).model_json_schema(by_alias=True)
    shared: dict[str, Any] = {}
    body = _tidy(raw, shared)
    definitions = {**body.pop("$defs", {}), **shared}
    for definition in definitions.values():
        _unwrap_segment(definition)
    for name, definition in [("", body), *definitions.items()]:
        if not name.startswith("quantity"):
            add_descriptions(name, definition, definitions)
    add_models(definitions)
    if robot is not None:
        add_names(definitions, body, robot)
    head = {"$schema": DIALECT, "title": f"missionsim {kind} file"}
    return {**head, **body, "$defs": dict(sorted(definitions.items()))}


def schema_text(kind: str, robot: RobotSpec | None = None) -> str:
    """The schema as it is written to files."""
    return json.dumps(schema(kind, robot), indent=1, ensure_ascii=False) + "\n"


def _unwrap_segment(definition: dict[str, Any]) -> None:
    """A segment's kind is the key that it stands under, not a key inside it."""
    kind = definition.get("properties", {}).get("kind", {}).get("const")
    if kind in SEGMENT_KINDS:
        del definition["properties"]["kind"]
        definition["required"] = [key for key in definition.get("required", []) if key != "kind"]


def _tidy(node: Any, shared: dict[str, Any], properties: bool = False) -> Any:
    """Without automatic titles, and with each kind of quantity defined once."""
    if isinstance(node, list):
        return [_tidy(item, shared) for item in node]
    if not isinstance(node, dict):
        return node
    result = {}
    for key, value in node.items():
        if key == "title" and not properties:
            continue
        if key == "default":
            # what a default is worth is in its `value`
            value = value.get("value", value) if isinstance(value, dict) else value
            result[key] = value
            continue
        result[key] = _tidy(value, shared, properties=key in ("properties", "$defs") and not properties)
    label = result.pop("x-quantity", None) if not properties else None
    if isinstance(label, str):
        name = "quantity_" + re.sub(r"[^a-z0-9]+", "_", label.lower().replace("-", "minus ")).strip("_")
        shared[name] = {key: value for key, value in result.items() if key != "default"}
        result = {"$ref": f"#/$defs/{name}"} | ({"default": result["default"]} if "default" in result else {})
    return result
