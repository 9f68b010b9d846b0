"""Random small tasks: a few places with hills, two visits, two batteries, schemes and speeds to choose from."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

ROBOT = {
    "kind": "robot",
    "name": "tester",
    "body": {"drive": "differential", "mass": 20.0, "max_speed": 1.5, "regeneration": 0.3},
    "batteries": {
        "drive": {"capacity": 10.0, "max_charge_power": 80.0},
        "brain": {"capacity": 8.0, "max_charge_power": 50.0},
    },
    "motion": {"battery": "drive", "model": "polynomial", "parameters": {"c2": 30, "c3": 15, "c4": 5, "standing": 3}},
    "components": {
        "lidar": {"loads": [{"battery": "brain", "power": 10.0}]},
        "eye": {"loads": [{"battery": "brain", "power": 3.0}]},
        "cpu": {"always_on": True, "loads": [{"battery": "brain", "power": 6.0}]},
    },
    "schemes": {
        "quick": {"sensors": {"required": {"lidar": 1}}},
        "slow": {"sensors": {"required": {"eye": 1}}, "max_speed": 0.8},
        "look": {"motion": False, "image_analysis": True, "sensors": {"required": {"eye": 1}}},
    },
    "effects": [
        {"effect": "grade", "battery": "drive", "parameters": {"k": 1.2}},
        {"effect": "start_surge", "battery": "drive", "parameters": {"E": 40.0}},
    ],
}


def random_task(rng: np.random.Generator, folder: Path) -> Path:
    """Files of a random task; the path of the task."""
    count = int(rng.integers(4, 6))
    places = {f"p{i}": {"x": float(rng.uniform(0, 40)), "y": float(rng.uniform(0, 40))} for i in range(count)}
    names = list(places)
    pairs = {tuple(sorted((names[i], names[int(rng.integers(0, i))]))) for i in range(1, count)}
    while len(pairs) < count + int(rng.integers(0, 2)):
        a, b = rng.choice(count, 2, replace=False)
        pairs.add(tuple(sorted((names[a], names[b]))))
    edges = []
    for a, b in sorted(pairs):
        straight = math.dist(tuple(places[a].values()), tuple(places[b].values()))
        edge = {
            "from": a,
            "to": b,
            "length": straight * float(rng.uniform(1.0, 1.4)),
            "slope": float(rng.uniform(-0.12, 0.12)),
        }
        if rng.random() < 0.25:
            edge["max_speed"] = float(rng.uniform(0.5, 1.4))
        if rng.random() < 0.2:
            edge["length"] = max(straight, float(rng.uniform(0.4, 2.0)))
        edges.append(edge)
    dock = bool(rng.random() < 0.6)
    home = names[int(rng.integers(0, count))]
    if dock:
        places[home] = {**places[home], "charger": {"power": float(rng.uniform(30, 100))}}
    robot = {**ROBOT, "body": {**ROBOT["body"]}}
    if rng.random() < 0.8:
        robot["body"] |= {
            "max_acceleration": float(rng.uniform(0.2, 1.0)),
            "max_deceleration": float(rng.uniform(0.2, 1.0)),
        }
    visits = [
        {"place": str(name), "inspect": float(rng.choice([5.0, 20.0]))} for name in rng.choice(names, 2, replace=False)
    ]
    scale = float(rng.uniform(0.3, 3.0))
    task = {
        "kind": "task",
        "name": "random",
        "robot": "robot.yaml",
        "environment": "site.yaml",
        "start": names[int(rng.integers(0, count))],
        "initial_charge": {"drive": min(1.0, 0.2 * scale), "brain": min(1.0, 0.15 * scale)},
        "visits": visits,
        "choose": {
            "speeds": sorted(float(v) for v in rng.uniform(0.3, 1.5, 2)),
            "schemes": ["quick", "slow"],
            "docks": [home] if dock else "none",
            "charge": [0.3, 0.6] if dock else "any",
        },
        "within": {"deadline": float(rng.uniform(60, 500)), "reserve": 0.1},
        "least": {
            "energy": {"drive": 1.0, "brain": float(rng.choice([0.0, 0.5, 1.0, 3.0]))},
            "time": float(rng.choice([0.0, 0.001, 0.02])),
        },
    }
    for name, data in (
        ("robot.yaml", robot),
        ("site.yaml", {"kind": "environment", "name": "site", "places": places, "edges": edges}),
        ("task.yaml", task),
    ):
        (folder / name).write_text(yaml.safe_dump(data, sort_keys=False))
    return folder / "task.yaml"
