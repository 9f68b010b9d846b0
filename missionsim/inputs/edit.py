"""Change a robot file and keep its comments, order and quotes (ruamel.yaml round trip)."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.files import PathLike
from missionsim.inputs import units
from missionsim.inputs.loading import robot_file, robot_from_text
from missionsim.inputs.overrides import resolve
from missionsim.inputs.parameter import Parameter, parameters
from missionsim.physics.lag import Meter

SCHEMA_FOLDER = Path(__file__).resolve().parent.parent / "schemas"
_SCHEMA_LINE = re.compile(r"^(# yaml-language-server: \$schema=)(\S+)[ \t]*$", re.MULTILINE)
_NUMBERS = ("value", "sd", "low", "high")
_DIGITS = 7
"""Significant digits of fitted numbers in files; their uncertainty is far larger."""


def robot_text(name_or_path: PathLike) -> str:
    """Text of a shipped robot's file, or of the file at a path. Raises InputError: no such robot."""
    return robot_file(name_or_path).read_text(encoding="utf-8")


class Editing:
    """A robot file under change; it is opened once, and checked when its text is asked for.

    `text`: robot file. Raises InputError: by each change for a path that leads nowhere; by `text` where the result
    would not be a valid robot (unknown effect, battery, parameter, an impossible value).
    """

    def __init__(self, text: str) -> None:
        from ruamel.yaml.error import YAMLError

        self.robot = robot_from_text(text)
        self._yaml = _round_trip()
        # how far the file indents the dashes of a list below its key: 0 or 2
        match = re.search(r"^( *)[\w-]+:[ \t]*(?:#[^\n]*)?\n(?:[ \t]*(?:#[^\n]*)?\n)*( *)- ", text, re.MULTILINE)
        offset = 0 if match is not None and len(match.group(2)) <= len(match.group(1)) else 2
        self._yaml.indent(mapping=2, sequence=offset + 2, offset=offset)
        try:
            self._data: Any = deepcopy(_parsed(text))
        except YAMLError as problem:
            raise InputError.single(f"not YAML: {str(problem).splitlines()[0]}") from None

    def add_effect(self, effect: Mapping[str, object]) -> Editing:
        """One more entry under ``effects:``.

        `effect`: as in the file: ``{"effect": "grade", "battery": "robot", "parameters": {"k": {"value": 1.1, "sd":
        0.02}}, "origin": {...}}``; numbers in SI.
        """
        entry = _plain(effect)
        if self._data.get("effects"):
            self._data["effects"].append(entry)
        else:
            self._data["effects"] = _node([entry])
        return self

    def add_component(self, name: str, battery: str) -> Editing:
        """A component that logs switch and the file lacks, so that effects can speak of it; it draws nothing itself."""
        load = _node([_node({"battery": battery, "power": "0 W"}, flow=True)])
        entry = _node({"title": f"switched by on_{name} of the logs", "loads": load})
        if self._data.get("components"):
            self._data["components"][name] = entry
        else:
            self._data["components"] = _node({name: entry})
        return self

    def remove_effect(self, index: int) -> Editing:
        """Without one entry of ``effects:``."""
        del self._data["effects"][index]
        if not self._data["effects"]:
            del self._data["effects"]
        return self

    def set_values(self, updates: Mapping[str, float | Mapping[str, object]]) -> Editing:
        """Other numbers.

        `updates`: path such as ``motion.parameters.c3`` (`Parameter.path`) to a number in SI, or to a mapping with
        ``value`` and perhaps ``sd`` (SI), ``status``, ``source``, ``note``. A new ``value`` takes out the old status,
        source and note, since they spoke of the old value, and the old spread where no new one is given.
        """
        known = dict(parameters(self.robot))
        for path, update in updates.items():
            found = resolve(self._data, path)
            if not isinstance(found, tuple):
                raise InputError(found)
            parent = self._data
            for key in found[:-1]:
                parent = parent[key]
            last: Any = found[-1]
            old = parent.get(last) if isinstance(parent, dict) else parent[last]
            new = dict(update) if isinstance(update, Mapping) else {"value": update}
            parent[last] = _updated(old, new, known.get(".".join(map(str, found))))
        return self

    def set_source(self, key: str, told: str, ranges: Mapping[str, object]) -> Editing:
        """One entry of ``sources:`` added or replaced, and the ranges of the logs in ``origin:``."""
        data = self._data
        if data.get("sources"):
            data["sources"][key] = told
        else:
            position = next((i for i, name in enumerate(data) if name not in ("kind", "name", "title")), len(data))
            data.insert(position, "sources", _node({key: told}))
        origin = _plain({**data.get("origin", {}), "range": dict(ranges)})
        if "origin" in data:
            data["origin"] = origin
        else:
            data.insert(list(data).index("sources") + 1, "origin", origin)
        return self

    def set_meter(self, battery: str, meter: Meter) -> Editing:
        """How far the power of a battery in logs is behind the motion in them; one without is taken out."""
        own = self._data["batteries"][battery]
        if meter != Meter():
            own["meter"] = _plain({"delay": meter.delay_s, "lag": meter.lag_s}, 2)
        elif "meter" in own:
            del own["meter"]
        return self

    @property
    def text(self) -> str:
        """The new file."""
        buffer = io.StringIO()
        self._yaml.dump(self._data, buffer)
        robot_from_text(buffer.getvalue())
        return buffer.getvalue()


def _round_trip() -> Any:
    from ruamel.yaml import YAML

    yaml = YAML(typ="rt")
    yaml.preserve_quotes = True
    yaml.width = 4096
    return yaml


@lru_cache(maxsize=4)
def _parsed(text: str) -> Any:
    """The file as nodes, to be copied before a change: each round of `improve` begins with the file as it was given,
    and reading takes eight times as long as a copy."""
    return _round_trip().load(text)


def for_folder(text: str, folder: PathLike) -> str:
    """The text of a robot file with its editor line leading from `folder` to the installed schema."""
    target = SCHEMA_FOLDER / "robot.schema.json"
    try:
        relative = os.path.relpath(target, Path(folder).resolve())
    except ValueError:  # another drive
        relative = target.as_uri()
    reference = Path(relative).as_posix() if "://" not in relative else relative
    return _SCHEMA_LINE.sub(lambda match: match.group(1) + reference, text, count=1)


def _updated(old: Any, new: Mapping[str, Any], parameter: Parameter | None) -> Any:
    """What stands at a number's place after an update."""
    former = old.get("value") if isinstance(old, dict) else old
    if isinstance(old, dict) and old.get("unit") and "unit" not in new:
        # plain numbers are in the unit beside them, which may hold for low and high that stay: a text brings its own
        factor = units.si_factor(str(old["unit"])) or 1.0
        new = {key: value / factor if key in _NUMBERS else value for key, value in new.items()}
        former = parameter = None
    told = {key: _written(value, former, parameter) if key in _NUMBERS else value for key, value in new.items()}
    if not isinstance(old, dict):
        return told["value"] if set(told) == {"value"} else _node(told, flow=True)
    spread = {"sd", "low", "high", "distribution"}
    outdated = {"status", "source", "note"} | (set() if spread & set(new) else spread)
    for key in outdated & set(old) - set(new) if "value" in new else ():
        del old[key]
    for key, value in told.items():
        old[key] = value
    return old


def _written(value: Any, old: Any, parameter: Parameter | None) -> Any:
    """A SI number as the file writes numbers of this field: in the unit that stood there, plain where none did."""
    if not isinstance(value, (int, float)):
        return value
    rounded = float(f"{value:.{_DIGITS}g}")
    if isinstance(old, str) and (parts := units.split(old)) and (factor := units.si_factor(parts[1])) is not None:
        return f"{value / factor:.{_DIGITS}g} {parts[1]}"
    unit = parameter.unit if parameter is not None else ""
    if unit == "J":
        return f"{rounded:.{_DIGITS}g} J"
    return rounded


def _plain(value: Any, depth: int = 0) -> Any:
    """Plain Python data as ruamel nodes, small inner mappings in one line."""
    if isinstance(value, Mapping):
        return _node({str(key): _plain(item, depth + 1) for key, item in value.items()}, flow=depth >= 2)
    if isinstance(value, (list, tuple)):
        return _node([_plain(item, depth + 1) for item in value], flow=True)
    if isinstance(value, bool) or value is None or isinstance(value, (int, str)):
        return value
    if isinstance(value, float) or hasattr(value, "__float__"):
        return float(f"{float(value):.{_DIGITS}g}")
    return str(value)


def _node(items: Mapping[str, Any] | Sequence[Any], flow: bool = False) -> Any:
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    result = CommentedMap(items) if isinstance(items, Mapping) else CommentedSeq(items)
    if flow:
        result.fa.set_flow_style()
    return result
