"""Random small tasks, and the best plan of each by brute force: nothing of the planner is used.

What an edge, a visit or charging takes is measured in one long mission that SimPy runs; all simple paths with all
speeds and schemes, all orders, all docks and levels are gone through, and of states of the same visits and place only
those that are better in nothing are left out.
"""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission

BATTERIES = ("drive", "brain")
MOST_STATES = 1500
TOP, SLOW = 1.5, 0.8


class TooMany(Exception):
    """More states than are worth the time."""


def write(folder: Path, **files: dict) -> None:
    """Write data as YAML files."""
    for name, data in files.items():
        (folder / f"{name}.yaml").write_text(json.dumps(data))


def _site(rng: np.random.Generator, count: int, more: int) -> tuple[dict, list[dict]]:
    places = {f"p{i}": {"x": float(rng.uniform(0, 60)), "y": float(rng.uniform(0, 60))} for i in range(count)}
    height = rng.uniform(0, 4, count) * (rng.random() < 0.7)
    edges: list[dict] = []

    def add(a: int, b: int, *, extra: bool = False) -> None:
        straight = math.dist(tuple(places[f"p{a}"].values()), tuple(places[f"p{b}"].values()))
        length = straight * float(rng.uniform(1.0, 1.5))
        slope = math.asin(max(-0.3, min(0.3, float(height[b] - height[a]) / length)))
        edge = {"name": f"e{len(edges)}", "from": f"p{a}", "to": f"p{b}", "length": length, "slope": slope}
        if rng.random() < 0.25:
            edge["max_speed"] = float(rng.uniform(0.4, 1.2))
        if rng.random() < 0.3:
            edge["surface"] = str(rng.choice(["gravel", "mud"]))
        if rng.random() < 0.25:
            edge["temperature"] = float(rng.uniform(-10, 15))
        if extra and rng.random() < 0.3:
            edge["both_ways"] = False
        if extra and rng.random() < 0.15:
            edge["closed"] = True
        edges.append(edge)

    for i in range(1, count):
        add(int(rng.integers(0, i)), i)
    for _ in range(more):
        a, b = rng.choice(count, 2, replace=False)
        add(int(a), int(b), extra=True)
    if rng.random() < 0.3:  # a parallel edge
        edge = edges[int(rng.integers(0, count - 1))]
        add(int(edge["from"][1:]), int(edge["to"][1:]), extra=True)
    return places, edges


def _robot(rng: np.random.Generator, *, ramps: bool) -> dict:
    u = rng.uniform
    parameters = {"c2": u(10, 60), "c3": u(5, 30), "c4": u(1, 10), "standing": u(0, 8)}
    capacity = float(u(0.8, 6.0))
    effects = [("grade", {"k": 1.2}), ("surface_rolling_resistance:gravel", {"k": 15.0})]
    effects.append(("surface_rolling_resistance:mud", {"k": 40.0}))
    effects += [("payload", {"k": float(u(1, 6))})] if rng.random() < 0.7 else []
    effects += [("temperature_friction", {"k": 0.5, "T0": 20.0})] if rng.random() < 0.5 else []
    effects += [("start_surge", {"E": 60.0})] if ramps and rng.random() < 0.5 else []
    body = {"drive": "differential", "mass": 20.0, "max_speed": TOP, "max_payload": 8.0}
    body |= {"regeneration": float(u(0, 0.8))} if rng.random() < 0.5 else {}
    body |= {"max_acceleration": float(u(0.2, 1.0)), "max_deceleration": float(u(0.2, 1.0))} if ramps else {}
    powers = {"lidar": u(4, 20), "eye": u(1, 6), "cpu": u(2, 10)}
    parts = {name: {"loads": [{"battery": "brain", "power": float(power)}]} for name, power in powers.items()}
    parts["cpu"]["always_on"] = True
    looking = {"motion": False, "image_analysis": True}
    return {
        "kind": "robot",
        "name": "fuzz",
        "body": body,
        "batteries": {
            "drive": {"capacity": capacity, "max_charge_power": 80.0},
            "brain": {"capacity": capacity * float(u(0.3, 1.0)), "max_charge_power": 50.0},
        },
        "motion": {
            "battery": "drive",
            "model": "polynomial",
            "parameters": {name: float(value) for name, value in parameters.items()},
        },
        "components": parts,
        "schemes": {
            "quick": {"sensors": {"required": {"lidar": 1}}},
            "slow": {"sensors": {"required": {"eye": 1}}, "max_speed": SLOW},
            "look": {**looking, "sensors": {"required": {"eye": 1}}},
            "stare": {**looking, "sensors": {"required": {"lidar": 1}}},
        },
        "effects": [{"effect": name, "battery": "drive", "parameters": values} for name, values in effects],
    }


def _visits(rng: np.random.Generator, names: list[str], count: int, *, loads: bool) -> list[dict]:
    visits = []
    for i in range(count):
        visit: dict[str, Any] = {"name": f"v{i}", "place": str(rng.choice(names))}
        inspects = bool(rng.random() < 0.55)
        visit["inspect" if inspects else "wait"] = float(rng.integers(1, 40))
        if inspects and rng.random() < 0.4:
            visit["schemes"] = ["look", "stare"]
        elif inspects and rng.random() < 0.4:
            visit["scheme"] = str(rng.choice(["look", "stare"]))
        if rng.random() < 0.3:
            visit["value"] = float(rng.choice([0.0, 1.0, 2.0, 2.5, 7.0]))
        if rng.random() < 0.3:
            visit["window"] = {"from": float(rng.uniform(0, 250))}
            if rng.random() < 0.7:
                visit["window"]["until"] = visit["window"]["from"] + float(rng.uniform(20, 300))
        if i and rng.random() < 0.2:
            visit[str(rng.choice(["before", "after"]))] = f"v{int(rng.integers(0, i))}"
        if loads and rng.random() < 0.5:
            visit["take_up"] = float(rng.integers(1, 5))
        elif loads and rng.random() < 0.6:
            visit["set_down"] = float(rng.integers(1, 3))
        visits.append(visit)
    return visits


def random_files(rng: np.random.Generator, folder: Path) -> tuple[dict, dict, dict]:
    """Robot, environment and task, written to ``robot.yaml``, ``site.yaml`` and ``task.yaml``."""
    ramps = bool(rng.random() < 0.35)  # then whole drives are measured, and there must be fewer of them
    count = int(rng.integers(4, 5 if ramps else 7))
    places, edges = _site(rng, count, int(rng.integers(1, 3 if ramps else 5)))
    robot, names = _robot(rng, ramps=ramps), list(places)
    docks = [str(name) for name in rng.choice(names, int(rng.integers(0, 3)), replace=False)]
    for name in docks:
        charger: dict[str, Any] = {"power": float(rng.uniform(20, 120))}
        if rng.random() < 0.5:
            charger["batteries"] = [str(rng.choice(BATTERIES))]
        if rng.random() < 0.3:
            charger["slots"] = round(2.0 * rng.uniform(0.7, 1.0))
        places[name]["charger"] = charger
    loads = bool(rng.random() < 0.4)
    speeds = sorted({round(float(s), 3) for s in rng.uniform(0.3, TOP, int(rng.integers(1, 3 if ramps else 4)))})
    weights = {"drive": 1.0, "brain": float(rng.choice([0.0, 0.5, 3.0]))}
    task: dict[str, Any] = {
        "kind": "task",
        "name": "fuzz",
        "robot": "robot.yaml",
        "environment": "site.yaml",
        "start": str(rng.choice(names)),
        "end": str(rng.choice(names)),
        "initial_charge": {name: float(rng.uniform(0.3, 1.0)) for name in BATTERIES},
        "visits": _visits(rng, names, int(rng.integers(1, 3 if ramps else 5)), loads=loads),
        "choose": {"speeds": speeds, "schemes": ["quick", "slow"], "docks": docks or "none"},
        "within": {"reserve": float(rng.choice([0.0, 0.1, 0.2])), "reserve_throughout": bool(rng.random() < 0.25)},
        "order": "given" if rng.random() < 0.3 else "any",
        "least": {"energy": weights, "time": float(rng.choice([0.0, 0.001, 0.02]))},
        "defaults": {"payload": float(rng.integers(1, 4)) if loads and rng.random() < 0.5 else 0.0},
        "edges": {},
    }
    if docks:
        task["choose"]["charge"] = [0.5, 1.0] if rng.random() < 0.6 else [float(rng.uniform(0.3, 1.0))]
    if rng.random() < 0.7:
        task["within"]["deadline"] = float(rng.uniform(150, 1500))
    if rng.random() < 0.2:
        task["within"]["max_payload"] = float(rng.integers(1, 6))
    if ramps and rng.random() < 0.8:
        task["defaults"]["profile"] = "trapezoidal"
    for edge in edges:
        lot = rng.random()
        if lot < 0.1:
            task["edges"][edge["name"]] = {"schemes": [str(rng.choice(["quick", "slow"]))]}
        elif lot < 0.15:
            task["edges"][edge["name"]] = {"speeds": [round(float(rng.uniform(0.3, 1.0)), 3)]}
        elif lot < 0.18:
            task["edges"][edge["name"]] = {"closed": True}
    site = {"kind": "environment", "name": "site", "places": places, "edges": edges, "ambient": {"temperature": 20.0}}
    write(folder, robot=robot, site=site, task=task)
    return robot, site, task


class Brute:
    """The best plan of a task by brute force; a row of a state is seconds, objective, Wh missing of each battery."""

    def __init__(self, folder: Path, robot: dict, site: dict, task: dict) -> None:
        self.folder, self.robot, self.site, self.task = folder, robot, site, task
        self.asked: dict[Any, tuple[str, list[dict], str]] = {}
        self.cost: dict[Any, np.ndarray] = {}
        self.whole = "max_acceleration" in robot["body"]
        visits = self.visits = task["visits"]
        self.windows = any("window" in visit for visit in visits)
        within, weight = task["within"], task["least"]
        self.capacity = np.array([robot["batteries"][name]["capacity"] for name in BATTERIES])
        self.reserve = within["reserve"] * self.capacity
        self.kept = self.reserve * within["reserve_throughout"]
        self.deadline = within.get("deadline", math.inf)
        self.most_kg = min(8.0, within.get("max_payload", 8.0))
        self.weights = np.array([weight["time"], *(weight["energy"][name] for name in BATTERIES)])
        self.docks = [] if task["choose"]["docks"] == "none" else task["choose"]["docks"]

    # ---- what things take

    def measure(self) -> None:
        """One long mission with all that was asked, on batteries without end, with ways back to where each begins."""
        big = {
            **self.robot,
            "batteries": {name: {**self.robot["batteries"][name], "capacity": 1e5} for name in BATTERIES},
        }
        names = list(self.site["places"])
        back = [
            {"name": f"{a}_{b}", "from": a, "to": b, "length": 500.0, "both_ways": False}
            for a, b in itertools.permutations(names, 2)
        ]
        edges = [{**edge, "closed": False} for edge in self.site["edges"]]
        segments: list[dict] = []
        spans, here, rest = [], names[0], {"wait": {"duration": 1.0}}
        for key, (begin, chain, end) in self.asked.items():
            segments += [rest] if here == begin else [rest, {"drive": {"along": [f"{here}_{begin}"]}}]
            segments.append(rest)
            spans.append((key, len(segments), len(segments) + len(chain)))
            segments += chain
            here = end
        mission = {"kind": "mission", "name": "measure", "robot": "big.yaml", "environment": "ways.yaml"}
        mission |= {"start": names[0], "initial_charge": dict.fromkeys(BATTERIES, 0.5)}
        mission |= {"defaults": self.task["defaults"], "segments": [*segments, rest]}
        write(self.folder, big=big, ways={**self.site, "edges": [*edges, *back]}, measure=mission)
        run = simulate(load_mission(self.folder / "measure.yaml"))
        assert run.completed, run.reason
        used = np.array([run.by_segment_wh(name) for name in BATTERIES])
        ends = np.array([0.0, *(run.segment_end_s[i] for i in range(len(segments)))])
        first = np.searchsorted(run.timeline.segment, np.arange(len(segments) + 1))
        left = np.array([run.charge_wh[name] for name in BATTERIES])
        for key, a, b in spans:
            lowest = left[:, first[a] : first[b]].min(axis=1) if first[b] > first[a] and key[0] == "drive" else np.inf
            peak = np.maximum(left[:, first[a] - 1] - lowest, 0.0)
            self.cost[key] = np.array([ends[b] - ends[a], *used[:, a:b].sum(axis=1), *peak])
        self.asked.clear()

    def taken(self, key: Any, begin: str, chain: list[dict], end: str) -> np.ndarray:
        """Seconds, Wh, the most Wh drawn on the way; nothing yet where it is still to be measured."""
        if key not in self.cost:
            self.asked.setdefault(key, (begin, chain, end))
        return self.cost.get(key, np.zeros(5))

    def choices(self, edge: dict) -> list[tuple[str, float]]:
        own = self.task["edges"].get(edge["name"], {})
        if own.get("closed") or edge.get("closed"):
            return []
        schemes, speeds = own.get("schemes", ["quick", "slow"]), own.get("speeds", self.task["choose"]["speeds"])
        return list({(s, min(v, SLOW if s == "slow" else TOP)) for s, v in itertools.product(schemes, speeds)})

    def paths(self, begin: str, end: str) -> list[list[tuple[dict, str, str]]]:
        found = []

        def go(here: str, seen: set[str], path: list[tuple[dict, str, str]]) -> None:
            if here == end:
                found.append(path)
                return
            for edge in self.site["edges"]:
                for a, b in ((edge["from"], edge["to"]), (edge["to"], edge["from"])):
                    if a == here and b not in seen and (a == edge["from"] or edge.get("both_ways", True)):
                        go(b, seen | {b}, [*path, (edge, a, b)])

        go(begin, {begin}, [])
        return found

    def drives(self, begin: str, end: str, load: float) -> np.ndarray:
        """All ways from stop to stop: seconds, Wh, most Wh drawn, shape (ways, 5)."""
        if begin == end:
            return np.zeros((1, 5))
        found = []
        for path in self.paths(begin, end):
            for combo in itertools.product(*(self.choices(edge) for edge, _, _ in path)):
                chain = [
                    (edge["name"], a, b, {"along": [edge["name"]], "scheme": s, "speed": v, "payload": load})
                    for (edge, a, b), (s, v) in zip(path, combo, strict=True)
                ]
                # where the robot accelerates, what an edge takes depends on those before and after
                parts = [chain] if self.whole else [[one] for one in chain]
                total = np.zeros(5)
                for part in parts:
                    key = ("drive", part[0][1], *((name, d["scheme"], d["speed"]) for name, _, _, d in part), load)
                    take = self.taken(key, part[0][1], [{"drive": d} for *_, d in part], part[-1][2])
                    total[3:] = np.maximum(total[3:], total[1:3] + take[3:])
                    total[:3] += take[:3]
                found.append(total)
        return np.array(found).reshape(-1, 5)

    def stays(self, i: int, load: float) -> np.ndarray:
        visit = self.visits[i]
        kind = "inspect" if "inspect" in visit else "wait"
        found = []
        for scheme in visit.get("schemes", [visit.get("scheme")]):
            body = {"duration": visit[kind], "payload": load} | ({"scheme": scheme} if scheme else {})
            found.append(self.taken(("stay", i, scheme, load), visit["place"], [{kind: body}], visit["place"]))
        return np.array(found)

    # ---- states

    def fine(self, rows: np.ndarray) -> np.ndarray:
        low = (self.capacity - rows[:, 2:] >= self.kept - 1e-11).all(axis=1)
        return rows[low & (rows[:, 0] <= self.deadline * (1 + 1e-12))]

    def moved(self, rows: np.ndarray, use: np.ndarray) -> np.ndarray:
        more = np.column_stack([use[:, 0], use[:, :3] @ self.weights, use[:, 1:3]])
        made = rows[:, None, :] + more
        deepest = rows[:, None, 2:] + use[:, 3:]
        return self.fine(made[(self.capacity - deepest >= self.kept - 1e-11).all(axis=2)])

    def best_of(self, rows: np.ndarray) -> np.ndarray:
        """Without rows that another is no worse than, even if it has to wait until then."""
        if len(rows) > MOST_STATES:
            raise TooMany
        rows = np.unique(np.round(rows, 13), axis=0)
        seen = rows.copy()
        if self.windows:
            seen[:, 1:] -= rows[:, :1] * self.idle[1:]
        kept: list[int] = []
        for i in np.argsort(seen.sum(axis=1), kind="stable").tolist():
            if not (seen[kept] <= seen[i] + 1e-14).all(axis=1).any():
                kept.append(i)
        return rows[kept]

    def charged(self, rows: np.ndarray, dock: str) -> np.ndarray:
        charger = self.site["places"][dock]["charger"]
        served = np.array([name in charger.get("batteries", BATTERIES) for name in BATTERIES])
        most = [self.robot["batteries"][name]["max_charge_power"] for name in BATTERIES]
        draw = self.cost["dock", dock][1:3] / 100.0
        gain = np.minimum(charger["power"], most) / 3600.0 - draw
        found = []
        for level, row in itertools.product(self.task["choose"]["charge"], rows):
            goal = (1.0 - level) * self.capacity
            need = np.where(served, np.maximum(row[2:] - goal, 0.0), 0.0)
            short = need > 1e-15
            if not short.any() or (short & (gain <= 0.0)).any():
                continue
            seconds = float((need[short] / gain[short]).max())
            left = np.where(short, np.maximum(row[2:] - gain * seconds, goal), row[2:])
            left = np.where(served, left, row[2:] + draw * seconds)
            cost = float(self.weights @ [seconds, *(draw * seconds)])
            found.append([row[0] + seconds, row[1] + cost, *left])
        return self.fine(np.array(found).reshape(-1, 4))

    def with_docks(self, states: dict[str, np.ndarray], load: float) -> dict[str, np.ndarray]:
        """States by place, and those after up to four charges."""
        known, fresh = dict(states), states
        for _ in range(4):
            new: dict[str, np.ndarray] = {}
            for (begin, rows), dock in itertools.product(fresh.items(), self.docks):
                if begin != f"dock {dock}":
                    made = self.charged(self.best_of(self.moved(rows, self.drives(_place(begin), dock, load))), dock)
                    key = f"dock {dock}"
                    new[key] = np.concatenate([new[key], made]) if key in new else made
            fresh = {}
            for key, rows in new.items():
                before = known.get(key, rows[:0])
                known[key] = self.best_of(np.concatenate([before, rows]))
                if len(rows) and not np.array_equal(known[key], before):
                    fresh[key] = self.best_of(rows)
        return known

    def best(self) -> tuple[float, float] | None:
        """Value of the visits made, and the least objective with as much; None where there is no plan."""
        task, visits = self.task, self.visits
        count, number = len(visits), {visit["name"]: i for i, visit in enumerate(visits)}
        earlier: list[set[int]] = [set() for _ in visits]
        for i, visit in enumerate(visits):
            if "after" in visit:
                earlier[i].add(number[visit["after"]])
            if "before" in visit:
                earlier[number[visit["before"]]].add(i)
            if task["order"] == "given":
                earlier[i] |= set(range(i))
        free = {i for i, visit in enumerate(visits) if "value" in visit}
        subsets = [frozenset(s) for r in range(count + 1) for s in itertools.combinations(range(count), r)]

        def load(done: frozenset[int]) -> float:
            change = (visits[i].get("take_up", 0.0) - visits[i].get("set_down", 0.0) for i in done)
            return float(task["defaults"]["payload"] + sum(change))

        stops = {task["start"], task["end"], *self.docks, *(visit["place"] for visit in visits)}
        for kg in sorted({load(s) for s in subsets if 0.0 <= load(s) <= self.most_kg} | {load(frozenset())}):
            for begin, end in itertools.permutations(sorted(stops), 2):
                self.drives(begin, end, kg)
            for i in range(count):
                self.stays(i, kg)
        start = task["start"]
        self.taken(("idle",), start, [{"wait": {"duration": 3600.0}}], start)
        for dock in self.docks:
            self.taken(("dock", dock), dock, [{"dock": {"recharge": {"duration": 100.0}}}], dock)
        self.measure()
        per_s = self.cost["idle",][:3] / 3600.0
        self.idle = np.array([1.0, per_s @ self.weights, *per_s[1:]])
        initial = np.array([1.0 - task["initial_charge"][name] for name in BATTERIES]) * self.capacity
        states = {frozenset(): {f"at {start}": np.array([[0.0, 0.0, *initial]])}}
        best = None
        for done in subsets:
            if done not in states:
                continue
            kg, need = load(done), set(range(count)) - done - free
            for key, rows in self.with_docks(states[done], kg).items():
                if not need:
                    ends = self.moved(rows, self.drives(_place(key), task["end"], kg))
                    ends = ends[(self.capacity - ends[:, 2:] >= self.reserve - 1e-11).all(axis=1)]
                    if len(ends):
                        found = sum(visits[i].get("value", 0.0) for i in done), float(ends[:, 1].min())
                        best = min(best or (-math.inf, 0.0), found, key=lambda b: (-round(b[0], 9), b[1]))
                for i in set(range(count)) - done:
                    after = done | {i}
                    if earlier[i] - done - free or any(i in earlier[j] for j in done):
                        continue
                    if not -1e-9 <= load(after) <= self.most_kg + 1e-9:
                        continue
                    made = self.moved(rows, self.drives(_place(key), visits[i]["place"], kg))
                    window = visits[i].get("window", {})
                    made = made + np.maximum(window.get("from", 0.0) - made[:, :1], 0.0) * self.idle
                    made = self.fine(made[made[:, 0] <= window.get("until", math.inf) * (1 + 1e-12)])
                    if len(made := self.moved(made, self.stays(i, load(after)))):
                        there, at = states.setdefault(after, {}), f"at {visits[i]['place']}"
                        there[at] = self.best_of(np.concatenate([there.get(at, made[:0]), made]))
        return best


def _place(key: str) -> str:
    return key.split(" ", 1)[1]
