"""JSON Schemas of the YAML kinds, for editors and other checkers."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from missionsim.effects.base import ParameterSpec
from missionsim.effects.library import FLOORS, effect_ids, get_effect
from missionsim.effects.named_models import get_motion_model, law_models, motion_model_ids
from missionsim.errors import InputError
from missionsim.inputs import units
from missionsim.inputs.loading import KINDS, model_of
from missionsim.inputs.parameter import STATUSES
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import SEGMENT_KINDS
from missionsim.inputs.tree import read_document
from missionsim.inputs.values import DRAWN, QuantityOf

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema(kind: str, robot: RobotSpec | None = None) -> Schema:
    """JSON Schema (2020-12) of a kind of file. `robot`: whose batteries, components and schemes are the only ones;
    `kind`: ``robot``, ``environment``, ``mission``, ``study``, ``map`` or ``task``. Raises InputError: unknown kind."""
    if kind not in KINDS:
        raise InputError.unknown(f"no schema '{kind}'", kind, KINDS)
    shared: dict[str, Any] = {}
    body = _tidy(model_of(kind).model_json_schema(by_alias=True), shared)
    definitions = {**body.pop("$defs", {}), **shared}
    for definition in definitions.values():
        # a segment's kind is the key that it stands under, not a key inside it
        if definition.get("properties", {}).get("kind", {}).get("const") in SEGMENT_KINDS:
            del definition["properties"]["kind"]
            definition["required"] = [key for key in definition.get("required", []) if key != "kind"]
    for name, definition in [("", body), *definitions.items()]:
        if not name.startswith("quantity"):
            add_descriptions(name, definition, definitions)
    # models, laws and effects are enumerated, and the parameters that each has
    if motion := definitions.get("MotionSpec"):
        ids = motion_model_ids()
        _enumerate(motion["properties"]["model"], [*ids, "expression", "none"])
        motion["allOf"] = [_rule("model", name, get_motion_model(name).parameters) for name in ids]
        # the model that holds where none is named
        motion["allOf"][ids.index("polynomial")]["if"].pop("required", None)
    if law := definitions.get("LawSpec"):
        _enumerate(law["properties"]["model"], list(law_models()))
        law["allOf"] = [_rule("model", name, model.parameters) for name, model in law_models().items()]
    if effect := definitions.get("EffectSpec"):
        plain = [name for name in effect_ids() if "<" not in name]
        families = sorted({name.partition(":")[0] for name in effect_ids() if "<" in name} | set(FLOORS))
        pattern = rf"^({'|'.join(families)}):[A-Za-z_][A-Za-z0-9_ -]*$"
        effect["properties"]["effect"] = {
            "anyOf": [{"enum": plain}, {"type": "string", "pattern": pattern}, {"type": "null"}],
            "default": None,
            "description": effect["properties"]["effect"]["description"],
        }
        effect["allOf"] = [_rule("effect", one, get_effect(one).parameters, "^k_" * (one in FLOORS)) for one in plain]
    if battery := definitions.get("BatterySpec"):
        options = battery["properties"]["model"]["anyOf"]
        battery["properties"]["model"]["anyOf"] = [
            {"enum": ["constant_energy"]} if option == {"type": "string"} else option for option in options
        ]
    if robot is not None:
        add_names(definitions, body, robot)
    head = {"$schema": DIALECT, "title": f"missionsim {kind} file"}
    return {**head, **body, "$defs": dict(sorted(definitions.items()))}


def schema_text(kind: str, robot: RobotSpec | None = None) -> str:
    """The schema as it is written to files."""
    return json.dumps(schema(kind, robot), indent=1, ensure_ascii=False) + "\n"


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


_NUMBER = r"^\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?"
_ANY = {"$ref": "#/$defs/quantity_any_number"}
Schema = dict[str, Any]


def unit_pattern(dimension: str, percent: bool = False) -> str:
    """Text of a number with a unit of one dimension; what is composed (``kg m/s^2``) is left to the loader.
    `dimension`: key of `units.DIMENSIONS`; empty for any unit. `percent`: whether ``%`` is a unit of it (slopes)."""
    if not dimension:
        return _NUMBER + r"\s*\S*.*$"
    names = [unit for unit in units.DIMENSIONS[dimension].units if unit]
    names += units.DIMENSIONS["charge"].units if dimension == "energy" else []
    names += ["%"] if percent else []
    every = {unit for one in units.DIMENSIONS.values() for unit in one.units if unit}
    listed, others = (
        "|".join(re.escape(name).replace("\\ ", " ") for name in sorted(some, key=lambda name: (-len(name), name)))
        for some in (names, every - set(names))
    )
    composed = rf"(?!(?:{others})\s*$)[A-Za-zµΩ°%][^\s*/^·]*\s*[*/^· ]\s*\S.*"
    return rf"{_NUMBER}\s*({listed}|{composed})?\s*$"


def quantity_schema(of: QuantityOf) -> Schema:
    """The forms in which a number of this kind may stand in a file."""
    text = {"type": "string", "pattern": unit_pattern(of.dimension, of.percent_slope)}
    number: dict[str, Any] = {"type": "number", "description": "in SI"}
    if of.dimension:
        dimension = units.DIMENSIONS[of.dimension]
        number["description"] = f"in {dimension.plain}"
        factor = dimension.plain_to_si(1.0)
        if math.isfinite(of.low) and not of.percent_slope:
            number["exclusiveMinimum" if of.strict_low else "minimum"] = of.low / factor
        if math.isfinite(of.high) and not of.percent_slope:
            number["exclusiveMaximum" if of.strict_high else "maximum"] = of.high / factor
    part: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string", "pattern": unit_pattern("")}]}
    word, only = {"type": "string"}, {"type": "object", "additionalProperties": False}
    drawn: dict[str, Any] = {"kind": {"enum": list(DRAWN)}}
    drawn |= dict.fromkeys(("mean", "sd", "low", "high", "mode"), part)
    drawn |= {"values": {"type": "array", "items": part}}
    drawn |= {"weights": {"type": "array", "items": {"type": "number", "minimum": 0}}, "file": word, "column": word}
    given: dict[str, Any] = dict.fromkeys(("value", "sd", "low", "high"), part)
    given |= {"distribution": {**only, "required": ["kind"], "properties": drawn}, "unit": word}
    given |= {"status": {"enum": list(STATUSES)}, "source": word, "note": word}
    told = "an uncertain number, or one with its status and source"
    mapping = {"x-quantity": "mapping", "description": told, **only, "properties": given}
    kind = "slope" if of.percent_slope else of.dimension or "any number"
    last = f"{'below' if of.strict_high else 'to'} {of.high:g}"
    ends = [f"from {of.low:g}"] * math.isfinite(of.low) + [last] * math.isfinite(of.high)
    label = " ".join([kind, *(["above"] if of.strict_low else []), *ends])
    return {"x-quantity": label, "description": of.allowed(), "anyOf": [number, text, mapping]}


def add_descriptions(name: str, definition: Schema, definitions: dict[str, Schema]) -> None:
    """What each property means, its unit and its default."""
    for key, node in definition.get("properties", {}).items():
        if not isinstance(node, dict):
            continue
        if "description" not in node or "$ref" in node:
            words = key_words()
            told = words.get(f"{name}.{key}") or words.get(key) or words.get(key.rstrip("s")) or key.replace("_", " ")
            targets = (str(part.get("$ref", "")).rpartition("/")[2] for part in (node, *node.get("anyOf", ())))
            options = (option for target in targets for option in definitions.get(target, {}).get("anyOf", ()))
            plain = (str(option.get("description", "")) for option in options)
            unit = next((text[3:] for text in plain if text.startswith("in ") and text not in ("in SI", "in 1")), "")
            node["description"] = told + (f" [{unit}]" if unit else "")
        if key not in definition.get("required", ()) and "default" not in node and "const" not in node:
            node["default"] = [] if node.get("type") == "array" else {} if node.get("type") == "object" else None


@functools.cache
def key_words() -> dict[str, str]:
    """What each key means, and ``Model.key`` where it means another thing in one place."""
    words: dict[str, str] = read_document(Path(__file__).with_name("schema_words.yaml")).data
    return words


def _enumerate(node: Schema, names: list[str]) -> None:
    null = any(option.get("type") == "null" for option in node.pop("anyOf", ()))
    for key in ("pattern", "type", "maxLength"):
        node.pop(key, None)
    node["enum"] = [*names, None] if null else names


def _rule(key: str, name: str, parameters: Iterable[ParameterSpec], more: str = "") -> Schema:
    """Where `key` is `name`, only its parameters, and those that match the pattern `more`."""
    known: Schema = {p.name: {**_ANY, "description": f"[{p.unit}]"} for p in parameters}
    inside: Schema = {"properties": known, "additionalProperties": False}
    if more:
        inside["patternProperties"] = {more: _ANY}
    return {
        "if": {"properties": {key: {"const": name}}, "required": [key]},
        "then": {"properties": {"parameters": inside}},
    }


def add_names(definitions: dict[str, Schema], body: Schema, robot: RobotSpec) -> None:
    """Enumerate the batteries, components, schemes, links and boards of one robot wherever a file names one."""
    batteries, components, schemes = (list(part) for part in (robot.batteries, robot.components, robot.schemes))
    names = {"battery": batteries, "component": components, "scheme": schemes, "idle_scheme": schemes}
    names |= {"relay": list(robot.switchboards), "through": list(robot.links)}
    lists = {"batteries": batteries, "requires": components}
    keyed = {"initial_charge": batteries}
    keyed |= dict.fromkeys(("sensors", "default_sensors", "required", "optional"), components)
    for definition in (body, *definitions.values()):
        for key, node in definition.get("properties", {}).items():
            options = [node, *node.get("anyOf", ())] if isinstance(node, dict) else []
            for option in options:
                if key in names and option.get("type") == "string":
                    option["enum"] = names[key]
                elif key in lists and option.get("type") == "array":
                    option["items"] = {"enum": lists[key]}
                elif key in keyed and option.get("type") == "object":
                    option["propertyNames"] = {"enum": keyed[key]}
