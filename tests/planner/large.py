"""A large random task: many places, visits, speeds, schemes and docks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from tests.planner.random_tasks import ROBOT


def large_task(folder: Path, *, seed: int = 1, places: int = 50, visits: int = 10, deadline: str = "25 min") -> Path:
    """Files of the task; its path."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 120.0, (places, 2))
    height = 6.0 * np.sin(points[:, 0] / 25.0) + 5.0 * np.cos(points[:, 1] / 20.0)
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    pairs = {tuple(sorted((i, int(j)))) for i in range(places) for j in np.argsort(apart[i])[1:4]}
    pairs |= {tuple(sorted((i, int(np.argmin(apart[i, :i]))))) for i in range(1, places)}
    site = {"kind": "environment", "name": "big", "places": {}, "edges": []}
    for i, (x, y) in enumerate(points):
        site["places"][f"p{i}"] = {"x": float(x), "y": float(y)}
    for i, j in sorted(pairs):
        slope = math.atan2(height[j] - height[i], apart[i, j])
        site["edges"].append({"name": f"e{i}_{j}", "from": f"p{i}", "to": f"p{j}", "slope": float(slope)})
    for dock in (0, 25):
        site["places"][f"p{dock}"]["charger"] = {"power": 60.0}
    robot = {**ROBOT, "body": {**ROBOT["body"], "max_acceleration": 0.4, "max_deceleration": 0.4}}
    robot["batteries"] = {
        "drive": {"capacity": 16.0, "max_charge_power": 80.0},
        "brain": {"capacity": 6.0, "max_charge_power": 60.0},
    }
    robot["schemes"] = {**robot["schemes"], "wary": {"sensors": {"required": {"lidar": 1, "eye": 1}}}}
    task = {
        "kind": "task",
        "name": "big",
        "robot": "robot.yaml",
        "environment": "site.yaml",
        "start": "p0",
        "visits": [{"place": f"p{i}", "inspect": "20 s"} for i in rng.choice(range(1, places), visits, replace=False)],
        "choose": {"speeds": [0.3, 0.5, 0.7, 0.9, 1.2], "schemes": ["quick", "slow", "wary"], "docks": "all"},
        "within": {"deadline": deadline, "reserve": "20 %"},
        "least": "energy",
    }
    for name, data in (("robot.yaml", robot), ("site.yaml", site), ("task.yaml", task)):
        (folder / name).write_text(yaml.safe_dump(data, sort_keys=False))
    return folder / "task.yaml"
