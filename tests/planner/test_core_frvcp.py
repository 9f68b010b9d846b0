"""Fixed routes of electric vehicles with published least times (e-VRO/frvcpy), by the planner's core."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from missionsim.planner.core import Bounds, Label, Leaving, Outcome, search

EMPTY = Leaving(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), [])


class _Curve:
    """Charging by breakpoints of time and charge; a vector is (time as objective, time, charge missing)."""

    obliged = False

    def __init__(self, time: list[float], charge: list[float]) -> None:
        self.time, self.charge = np.array(time), np.array(charge)

    def options(self, x: np.ndarray) -> list[np.ndarray]:
        charge = self.charge[-1] - x[2]
        since = float(np.interp(charge, self.charge, self.time))
        knots = [(t, q) for t, q in zip(self.time, self.charge, strict=True) if q > charge + 1e-12]
        points = [x] + [np.array([x[0] + t - since, x[1] + t - since, self.charge[-1] - q]) for t, q in knots]
        return [np.array(points)] if len(points) > 1 else []


class _Route:
    """A node is a position on the route, or a charger on the way to the next position."""

    def __init__(self, instance: dict, route: list[int]) -> None:
        time, energy = np.array(instance["time_matrix"]), np.array(instance["energy_matrix"])
        process = instance.get("process_times", [0.0] * len(time))
        kinds = {item["node_id"]: item["cs_type"] for item in instance["css"]}
        curves = {item["cs_type"]: _Curve(item["time"], item["charge"]) for item in instance["breakpoints_by_type"]}
        self.chargers = sorted(kinds)
        self.width = 1 + len(self.chargers)
        self.route, self.kinds, self.curves = route, kinds, curves
        self.nodes = len(route) * self.width
        self.limits = np.array([math.inf, instance.get("t_max", math.inf), float(instance["max_q"])])
        self._leaving: dict[int, Leaving] = {}
        for position in range(len(route) - 1):
            places = [route[position], *self.chargers]
            for slot, here in enumerate(places):
                heads, use = [], []
                for there, head in [
                    (route[position + 1], (position + 1) * self.width),
                    *((c, position * self.width + 1 + k) for k, c in enumerate(self.chargers)),
                ]:
                    if there != here or there == route[position + 1]:
                        spent = time[here][there] + (process[there] if head % self.width == 0 else 0.0)
                        heads.append(head)
                        use.append([spent, spent, energy[here][there]])
                self._leaving[position * self.width + slot] = Leaving(np.array(heads), np.array(use), heads)

    def leaving(self, node: int) -> Leaving:
        return self._leaving.get(node, EMPTY)

    def refill(self, node: int) -> _Curve | None:
        place = self.route[node // self.width] if node % self.width == 0 else self.chargers[node % self.width - 1]
        return self.curves[self.kinds[place]] if place in self.kinds else None

    def opens(self, node: int) -> None:
        return None

    def rest(self, price: float) -> np.ndarray:
        """Least time, and price times energy, of the rest of the way from each node."""
        rest = np.full(self.nodes, math.inf)
        rest[(len(self.route) - 1) * self.width :] = 0.0
        for position in range(len(self.route) - 2, -1, -1):
            nodes = range(position * self.width, (position + 1) * self.width)
            before = None
            while before != (now := tuple(rest[nodes.start : nodes.stop])):  # detours over chargers make less of it
                before = now
                for node in nodes:
                    leaving = self._leaving[node]
                    rest[node] = (leaving.use[:, 1] + price * leaving.use[:, 2] + rest[leaving.heads]).min()
        return rest

    def solve(self, charge: float) -> Outcome:
        fastest = max(float((np.diff(c.charge) / np.diff(c.time)).max()) for c in self.curves.values())
        price = 1.0 / fastest  # what a unit of charge costs at least
        weights = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, price]])
        rest = np.stack([self.rest(0.0), self.rest(price)], axis=1)
        offset = np.array([0.0, price * self.limits[2]])
        bounds = Bounds(self.limits, np.zeros((self.nodes, 3)), weights, rest, offset)
        start = Label(0, np.array([[0.0, 0.0, self.limits[2] - charge]]))
        goal = (len(self.route) - 1) * self.width
        return search(self, [start], lambda node: node == goal, bounds)


@pytest.mark.parametrize("share", [8, pytest.param(1, marks=pytest.mark.study)])
def test_all_published_routes(shared: Path, share: int) -> None:
    folder = shared / "planning" / "frvcp"
    instance = json.loads((folder / "frvcpy-instance.json").read_text())
    routes = json.loads((folder / "routes.json").read_text())
    assert len(routes) == 80
    for name, known in list(routes.items())[::share]:
        outcome = _Route(instance, known["route"]).solve(instance["max_q"])
        assert outcome.objective == pytest.approx(known["obj"], abs=1e-4), name
        assert outcome.bound == pytest.approx(outcome.objective, abs=1e-9), name


@pytest.mark.parametrize(("capacity", "charged"), [(4.0, 0.0), (3.9, 0.1), (3.0, 1.0), (2.0, 2.0), (1.9, math.inf)])
def test_charger_at_a_customer(capacity: float, charged: float) -> None:
    """Legs that take 1, 1 and 2 and a charger at the second customer (frvcpy's issue 6): charge what is missing.

    frvcpy 0.1.1 charges 2 where all suffices and finds no way where it does not.
    """
    places = [0.0, 1.0, 2.0, 4.0]
    line = [[abs(a - b) for b in places] for a in places]
    instance = {
        "max_q": capacity,
        "css": [{"node_id": 2, "cs_type": 0}],
        "breakpoints_by_type": [{"cs_type": 0, "time": [0.0, capacity], "charge": [0.0, capacity]}],
        "energy_matrix": line,
        "time_matrix": line,
    }
    outcome = _Route(instance, [0, 1, 2, 3]).solve(capacity)
    assert outcome.objective == pytest.approx(4.0 + charged, abs=1e-9)
