"""Random small sites, and every plan of each by enumeration: nothing of the planner but its table of powers.

Each run from standstill to standstill is computed as a whole, with the profile of the engine over the whole run, for
every simple path and every combination of speeds and schemes on its edges; then every order and every way to charge.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import yaml

from missionsim.inputs.loading import load_task
from missionsim.inputs.task import SchemeChoice, TaskSpec
from missionsim.plan.build import legs_of
from missionsim.plan.kinematics import phases, ramp_phases
from missionsim.planner.physics import Physics
from missionsim.planner.pieces import drive
from missionsim.planner.tour import Charger, make_site

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


class Exhaustive:
    """All plans of a task with at most one stop at each dock level between visits."""

    def __init__(self, task: TaskSpec) -> None:
        self.task = task
        self.physics = Physics(task)
        self.site = make_site(task)
        self.runs: dict[tuple[str, str], np.ndarray] = {}

    def paths(self, begin: str, end: str) -> list[list[tuple[str, int]]]:
        """Simple paths, as places begun from and edges."""
        ways: dict[str, list[tuple[str, int]]] = {}
        for i, edge in enumerate(self.task.environment.edges):
            ways.setdefault(edge.from_, []).append((edge.to, i))
            ways.setdefault(edge.to, []).append((edge.from_, i))
        found: list[list[tuple[str, int]]] = []

        def go(here: str, seen: set[str], path: list[tuple[str, int]]) -> None:
            if here == end:
                found.append(path)
                return
            for there, i in ways.get(here, []):
                if there not in seen:
                    go(there, seen | {there}, [*path, (here, i)])

        go(begin, {begin}, [])
        return found

    def run(self, begin: str, end: str) -> np.ndarray:
        """Seconds and Wh of every way to drive from a stop to another, shape (n, 3)."""
        if begin == end:
            return np.zeros((1, 3))
        if (begin, end) not in self.runs:
            choices = [
                (SchemeChoice(scheme=choice.scheme), speed.value)
                for choice in self.task.choose.schemes
                for speed in self.task.choose.speeds
            ]
            tables = [self._path(path, choices) for path in self.paths(begin, end)]
            self.runs[begin, end] = _undominated(np.concatenate(tables))
        return self.runs[begin, end]

    def _path(self, path: list[tuple[str, int]], choices: list[tuple[SchemeChoice, float]]) -> np.ndarray:
        legs = []
        for here, edge in path:
            spec = self.task.environment.edges[edge]
            there = spec.to if spec.from_ == here else spec.from_
            segments = [
                (here, drive(there, scheme, min(speed, 0.8) if scheme.scheme == "slow" else speed, 0.0))
                for scheme, speed in choices
            ]
            legs.append([made[0] for made in legs_of(self.physics.mission, segments)])
        combos = np.array(list(itertools.product(range(len(choices)), repeat=len(path))))
        distance = np.array([[legs[k][c].distance_m for k, c in enumerate(combo)] for combo in combos])
        limit = np.array([[legs[k][c].speed_m_s for k, c in enumerate(combo)] for combo in combos])
        numbers = [[self.physics.settings_index(leg.settings) for leg in row] for row in legs]
        settings = np.array([[numbers[k][c] for k, c in enumerate(combo)] for combo in combos])
        limits = self.physics.limits
        if limits.accel_m_s2 is None:
            made = phases(distance, limit)
        else:
            made = ramp_phases(
                distance, limit, np.full(len(combos), limits.accel_m_s2), np.full(len(combos), limits.decel_m_s2)
            )
        shape = made.duration_s.shape
        lasting = made.duration_s.ravel() > 0.0
        first = (np.cumsum(made.duration_s.reshape(len(combos), -1) > 0.0, axis=1) == 1).ravel() & lasting
        wide = np.broadcast_to(settings[..., None], shape).ravel()
        wh = np.zeros((lasting.size, 2))
        wh[lasting] = self.physics.energy_wh(
            wide[lasting],
            made.duration_s.ravel()[lasting],
            made.speed_m_s.ravel()[lasting],
            made.accel_m_s2.ravel()[lasting],
            first[lasting],
        )
        return np.column_stack([made.duration_s.sum(axis=(-2, -1)), wh.reshape(len(combos), -1, 2).sum(axis=1)])

    def best(self) -> float:
        """Least objective of all plans; infinite where there is none."""
        task = self.task
        energy, per_second = task.weights()
        weights = np.array([per_second, *energy.values()])
        best = math.inf
        n = len(task.visits)
        dock = next((i for i, stop in enumerate(self.site.stops) if stop.charger is not None), None)
        slots = n + 1
        for order in itertools.permutations(range(n)):
            for docked in itertools.product([False, True], repeat=slots) if dock is not None else [(False,) * slots]:
                stops: list[int] = []
                for position in range(slots):
                    if docked[position]:
                        stops.append(dock)
                    stops.append(1 + order[position] if position < n else self.site.goal)
                best = min(best, self._sequence([0, *stops], weights))
        return best

    def _charged(self, states: np.ndarray, charger: Charger, level: float) -> np.ndarray:
        """States after charging to a level, of those where some battery is below it and all of these are charged."""
        goal = (1 - level) * self.physics.capacity_wh
        gain = charger.gain_w / 3600.0
        short = states[:, 3:] > goal
        states = states[short.any(axis=1) & ~(short & (gain <= 0.0)).any(axis=1)]
        need = np.maximum(states[:, 3:] - goal, 0.0)
        seconds = (need / np.where(gain > 0.0, gain, 1.0)).max(axis=1, initial=0.0)[:, None]
        left = np.where(need > 0.0, np.maximum(states[:, 3:] - gain * seconds, goal), states[:, 3:])
        return np.column_stack([states[:, :1] + seconds, states[:, 1:3] + charger.draw_w * seconds / 3600.0, left])

    def _sequence(self, stops: list[int], weights: np.ndarray) -> float:
        physics, site = self.physics, self.site
        states = np.array([[0.0, 0.0, 0.0, *(physics.capacity_wh - physics.initial_wh)]])  # s, Wh, Wh, missing
        for before, after in itertools.pairwise(stops):
            runs = self.run(site.stops[before].place, site.stops[after].place) + site.standing(after, 0.0)[0]
            states = (states[:, None, :] + np.concatenate([runs, runs[:, 1:]], axis=1)[None, :, :]).reshape(-1, 5)
            states = states[(states[:, 3:] <= physics.capacity_wh * (1 + 1e-10)).all(axis=1)]
            states = states[states[:, 0] <= self.task.within.deadline.value * (1 + 1e-10)]
            charger = site.stops[after].charger
            if charger is not None:
                states = np.concatenate([self._charged(states, charger, level) for level in charger.levels])
            states = _undominated(states)
            if not len(states):
                return math.inf
        fine = (states[:, 3:] <= (physics.capacity_wh - physics.reserve_wh) * (1 + 1e-10)).all(axis=1)
        return float((states[fine, :3] @ weights).min()) if fine.any() else math.inf


def _undominated(states: np.ndarray) -> np.ndarray:
    """Without states that another is not above in anything: of time, energies and charges."""
    left = np.unique(states, axis=0)
    left = left[np.argsort(left.sum(axis=1), kind="stable")]
    kept = []
    while len(left):  # the first of those left has the least sum, so that none dominates it
        kept.append(left[0])
        left = left[(left < left[0]).any(axis=1)]
    return np.array(kept).reshape(-1, states.shape[1])


def compare(seed: int, folder: Path) -> tuple[float, float, dict]:
    """Objective by enumeration and of the plan, and what the plan is, of one random site."""
    from missionsim.planner.solve import solve_site

    task = load_task(random_task(np.random.default_rng(seed), folder))
    answer = solve_site(make_site(task))
    return Exhaustive(task).best(), answer.objective, answer
