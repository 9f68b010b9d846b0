"""Small robots and missions for tests, written as files and loaded as users' files are."""

from __future__ import annotations

import copy
import functools
import json
import tempfile
from pathlib import Path
from typing import Any

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission, load_robot
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.robot import RobotSpec

ROBOT: dict[str, Any] = {
    "kind": "robot",
    "name": "tester",
    "body": {
        "mass": 20,
        "drive": "omni",
        "max_speed": 1.5,
        "max_lateral_speed": 1.5,
        "max_acceleration": 0.4,
        "max_deceleration": 0.6,
        "max_yaw_rate": 1.0,
        "max_yaw_acceleration": 2.0,
    },
    "batteries": {"main": {"capacity": "200 Wh"}, "aux": {"capacity": "100 Wh"}},
    "motion": {
        "battery": "main",
        "model": "polynomial",
        "parameters": {"c1": 2.0, "c2": 6.0, "c3": 9.0, "c4": 3.5, "c6": 8.0, "standing": 2.5},
    },
    "components": {
        "camera": {"units": 2, "loads": [{"battery": "main", "power": 2.5}, {"battery": "aux", "power": 1.0}]},
        "lidar": {"loads": [{"battery": "main", "power": 6.0}]},
        "radio": {"loads": [{"battery": "aux", "power": 1.5}]},
        "boards": {"always_on": True, "loads": [{"battery": "aux", "power": 3.0}]},
    },
    "effects": [
        {"effect": "grade", "battery": "main", "parameters": {"k": 1.0}},
        {"effect": "payload", "battery": "main", "parameters": {"k": 0.5}},
        {"effect": "turning_scrub", "battery": "main", "parameters": {"k": 3.0}},
        {"effect": "cold_friction", "battery": "main", "parameters": {"k": 4.0, "tau": 60.0}},
        {"effect": "conversion_loss", "battery": "aux", "parameters": {"k": 0.01}},
        {"effect": "start_surge", "battery": "main", "parameters": {"E": 5.0}},
    ],
}


def robot(**changes: Any) -> dict[str, Any]:
    """The test robot; see `changed`."""
    return changed(copy.deepcopy(ROBOT), changes)


def changed(made: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A mapping with what dotted keys (``batteries__main__capacity``) change in it."""
    for path, value in changes.items():
        *parents, last = path.split("__")
        here = made
        for key in parents:
            here = here.setdefault(key, {})
        here[last] = value
    return made


def load(
    mission: dict[str, Any], robot_data: dict[str, Any] | None = None, environment: dict[str, Any] | None = None
) -> MissionSpec:
    """Load a mission from mappings, through files (JSON is YAML)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data = {"kind": "mission", "name": "test", "robot": "robot.yaml", **mission}
        if environment is not None:
            (folder / "world.yaml").write_text(json.dumps({"kind": "environment", "name": "world", **environment}))
            data["environment"] = "world.yaml"
        (folder / "mission.yaml").write_text(json.dumps(data))
        return load_mission(
            folder / "mission.yaml", robot=_robot(json.dumps(ROBOT if robot_data is None else robot_data))
        )


@functools.lru_cache(maxsize=16)
def _robot(text: str) -> RobotSpec:
    """Read once for all missions of a test."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "robot.yaml"
        path.write_text(text)
        return load_robot(path)


def run(
    segments: list[dict[str, Any]],
    robot_data: dict[str, Any] | None = None,
    environment: dict[str, Any] | None = None,
    **mission: Any,
) -> RunResult:
    """Load and simulate."""
    return simulate(load({"segments": segments, **mission}, robot_data, environment))


def energy(result: RunResult) -> float:
    """Energy of all batteries [J]."""
    return sum(b.energy_wh for b in result.batteries.values()) * 3600.0
