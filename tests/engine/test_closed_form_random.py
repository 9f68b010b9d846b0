"""Random missions on random robots against integrals written out, to 1e-9: chains of drives and arcs, turns, stays.

The drive's need is a polynomial of the speed while the acceleration is constant; where braking or a descent makes it
negative it is cut at its root, found here by NumPy, so that neither quadrature nor physics of missionsim is used.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from tests.engine.making import run

G = 9.80665
V = Polynomial([0.0, 1.0])


@dataclass(frozen=True)
class Piece:
    """Part of a way that is driven in one go: length [m], speed limit [m/s], slope [rad], curvature [1/m]."""

    length: float
    limit: float
    slope: float = 0.0
    curvature: float = 0.0


@dataclass
class Robot:
    """Coefficients drawn at random; what is zero is left out."""

    rng: np.random.Generator
    own: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        draw = self.rng.uniform
        ranges = {
            "mass": (5, 80), "up": (0.2, 1.0), "down": (0.2, 1.5), "c2": (0.5, 15), "c3": (0.5, 30), "c4": (1, 9),
            "standing": (0.5, 5), "c6": (0, 120), "k": (0.2, 1.8), "scrub": (0, 20), "drag": (0, 4), "carried": (0, 2),
            "yaw": (0.5, 2), "yaw_accel": (0.5, 3), "camera": (1, 9), "idle": (0.5, 6), "loss": (0, 0.01),
            "surge": (0, 8),
        }  # fmt: skip
        self.own = {name: float(draw(*bounds)) for name, bounds in ranges.items()}
        self.own["back"] = float(self.rng.choice([0.0, 0.0, draw(0.1, 0.9)]))
        if self.own["k"] < 1.0:  # a weight felt in part relieves that part of the drive; alone, without inertia
            self.own["c6"] = 0.0

    def file(self) -> dict[str, Any]:
        own = self.own
        effects = {"grade": "k", "turning_scrub": "scrub", "aerodynamic_drag": "drag", "payload": "carried"}
        return {
            "kind": "robot",
            "name": "drawn",
            "body": {
                "mass": own["mass"], "drive": "differential", "max_speed": 5, "max_acceleration": own["up"],
                "max_deceleration": own["down"], "max_yaw_rate": own["yaw"], "max_yaw_acceleration": own["yaw_accel"],
                "regeneration": own["back"],
            },
            "batteries": {"main": {"capacity": "5000 Wh"}, "aux": {"capacity": "5000 Wh"}},
            "motion": {"battery": "main", "parameters": {n: own[n] for n in ("c2", "c3", "c4", "c6", "standing")}},
            "components": {
                "camera": {"loads": [{"battery": "main", "power": own["camera"]}, {"battery": "aux", "power": 2.0}]},
                "boards": {"always_on": True, "loads": [{"battery": "aux", "power": own["idle"]}]},
            },
            "effects": [
                *({"effect": e, "battery": "main", "parameters": {"k": own[n]}} for e, n in effects.items()),
                {"effect": "start_surge", "battery": "main", "parameters": {"E": own["surge"]}},
                {"effect": "conversion_loss", "battery": "aux", "parameters": {"k": own["loss"]}},
            ],
        }  # fmt: skip

    def need(self, piece: Piece, accel: float, payload: float) -> list[tuple[float, Polynomial]]:
        """The drive's power over the speed: (speed from which on, power)."""
        own = self.own
        friction = (
            own["c2"] * V**2
            + (own["c3"] + own["scrub"] * abs(piece.curvature) + own["carried"] * payload) * V
            + own["drag"] * V**3
        )
        lifting = own["k"] * (own["mass"] + payload) * G * math.sin(piece.slope) * V
        if own["k"] < 1.0:
            relieved = own["k"] * friction
            if piece.slope >= 0.0:
                return [(0.0, friction + lifting)]
            beyond, rest = relieved + lifting, friction - relieved
        else:
            beyond, rest = friction + lifting + own["c6"] * accel * V, 0.0 * V
        roots = sorted(float(r.real) for r in beyond.roots() if abs(r.imag) < 1e-12 and r.real > 1e-12)
        found = []
        for low, high in itertools.pairwise([0.0, *roots, 100.0]):
            share = 1.0 if beyond(0.5 * (low + high)) > 0.0 else own["back"]
            found.append((low, rest + share * beyond))
        return found

    def ramp(self, piece: Piece, low: float, high: float, accel: float, payload: float) -> float:
        """Energy of the drive while the speed goes between two values [J]."""
        needs = [*self.need(piece, accel, payload), (100.0, 0.0 * V)]
        total = 0.0
        for (start, power), (end, _) in itertools.pairwise(needs):
            a, b = max(low, start), min(high, end)
            if b > a:
                total += power.integ()(b) - power.integ()(a)
        return total / abs(accel)

    def way(self, pieces: list[Piece], payload: float) -> tuple[float, float]:
        """Time and energy from rest to rest along pieces [s, J]."""
        own = self.own
        tops = [min(p.limit, own["yaw"] / abs(p.curvature) if p.curvature else 5.0) for p in pieces]
        speeds = [0.0, *map(min, tops[:-1], tops[1:]), 0.0]
        for i, piece in enumerate(pieces):
            speeds[i + 1] = min(speeds[i + 1], math.sqrt(speeds[i] ** 2 + 2.0 * own["up"] * piece.length))
        for i in range(len(pieces) - 1, -1, -1):
            speeds[i] = min(speeds[i], math.sqrt(speeds[i + 1] ** 2 + 2.0 * own["down"] * pieces[i].length))
        time, energy = 0.0, own["surge"]
        for piece, first, last, limit in zip(pieces, speeds[:-1], speeds[1:], tops, strict=True):
            up, down = own["up"], own["down"]
            peak = (2.0 * piece.length * up * down + down * first**2 + up * last**2) / (up + down)
            top = min(limit, math.sqrt(peak))
            steady = piece.length - (top**2 - first**2) / (2.0 * up) - (top**2 - last**2) / (2.0 * down)
            held = max(0.0, steady) / top
            time += (top - first) / up + held + (top - last) / down
            power = [power for start, power in self.need(piece, 0.0, payload) if start <= top][-1]
            energy += self.ramp(piece, first, top, up, payload) + self.ramp(piece, last, top, -down, payload)
            energy += float(power(top)) * held
        return time, energy + own["c4"] * time


def drawn(rng: np.random.Generator, robot: Robot) -> tuple[list[dict[str, Any]], dict[str, float], float]:
    """Segments of a mission, the energy of each battery by hand [J], and its duration [s]."""
    own, draw = robot.own, rng.uniform
    segments: list[dict[str, Any]] = []
    energies, total = {"main": 0.0, "aux": 0.0}, 0.0

    def passed(time: float, main: float, camera: bool) -> None:
        nonlocal total
        total += time
        aux = own["idle"] + 2.0 * camera
        energies["main"] += main + own["camera"] * camera * time
        energies["aux"] += (aux + own["loss"] * aux**2) * time

    for _ in range(int(rng.integers(2, 7))):
        camera, payload = bool(rng.random() < 0.5), float(rng.choice([0.0, draw(0.5, 20)]))
        settings: dict[str, Any] = {"sensors": {"camera": 1}} if camera else {}
        pieces = []
        for _ in range(int(rng.integers(1, 5))):
            limit, slope = float(draw(0.05, 2.5)), float(rng.choice([0.0, draw(-0.15, 0.15)]))
            common = {"speed": limit, "slope": slope, "payload": payload, **settings}
            if rng.random() < 0.3:
                radius, angle = float(draw(0.3, 5)), float(draw(0.1, 3))
                pieces.append(Piece(radius * angle, limit, slope, 1.0 / radius))
                segments.append({"arc": {"radius": radius, "angle": angle, **common}})
            else:
                pieces.append(Piece(float(10 ** draw(-1.5, 1.7)), limit, slope))
                segments.append({"drive": {"distance": pieces[-1].length, **common}})
        passed(*robot.way(pieces, payload), camera)
        if rng.random() < 0.5:
            angle, rate, gain = float(draw(0.01, 3)), own["yaw"], own["yaw_accel"]
            segments.append({"turn": {"angle": angle, "payload": payload, **settings}})
            time = angle / rate + rate / gain if angle > rate**2 / gain else 2.0 * math.sqrt(angle / gain)
            passed(time, own["c4"] * time + own["scrub"] * angle, camera)
        time = float(draw(0.5, 600))
        segments.append({"wait": {"duration": time, "payload": payload, **settings}})
        passed(time, own["standing"] * time, camera)
    return segments, energies, total


def check(seed: int, count: int) -> None:
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        robot = Robot(rng)
        segments, energies, time = drawn(rng, robot)
        result = run(segments, robot.file())
        assert result.duration_s == pytest.approx(time, rel=1e-9), number
        found = {name: 3600.0 * battery.energy_wh for name, battery in result.batteries.items()}
        assert found == pytest.approx(energies, rel=1e-9), number


@pytest.mark.parametrize("count", [15, pytest.param(40, marks=pytest.mark.long)])
def test_random_missions(count: int) -> None:
    check(14, count)


@pytest.mark.study
def test_a_thousand_random_missions() -> None:
    check(15, 1000)
