"""Drives up and down hills, from rest to rest, against their integrals written out: 500 at random, to 1e-9.

Braking downhill the drive needs nothing below some speed, wherever in the ramp that lies; a quadrature sees no kink
beyond its outermost nodes.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from missionsim.effects.timeline import Timeline, integrate
from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission, robot_from_text
from missionsim.inputs.power import build_power_model

C2, C3, C4, C6, K, MASS, G = 5.0, 9.0, 4.0, 36.0, 1.25, 30.0, 9.80665
ROBOT = f"""\
kind: robot
name: cart
body:
  {{mass: {MASS}, drive: differential, max_speed: 2, max_acceleration: 0.4, max_deceleration: 0.7,
  regeneration: REGENERATION}}
batteries: {{main: {{capacity: 1000 Wh}}}}
motion: {{battery: main, parameters: {{c2: {C2}, c3: {C3}, c4: {C4}, c6: {C6}}}}}
effects:
  - {{effect: grade, battery: main, parameters: {{k: {K}}}}}
"""


def phase(top: float, force: float, back: float) -> float:
    """∫ of what the drive takes over a ramp between rest and `top`, times the acceleration; `force` beside friction.

    The drive takes C2 v² + (C3 + force) v; where that is negative, `back` of it returns.
    """
    rest = min(top, max(0.0, -(C3 + force) / C2))  # below this speed it is negative

    def whole(v: float) -> float:
        return C2 * v**3 / 3.0 + (C3 + force) * v**2 / 2.0

    return whole(top) - whole(rest) + back * whole(rest)


def by_hand(distance: float, speed: float, slope: float, back: float) -> float:
    """Energy of one drive [J]."""
    up, down = 0.4, 0.7
    top = min(speed, math.sqrt(2.0 * distance * up * down / (up + down)))
    steady = max(0.0, distance - top**2 / 2.0 * (1.0 / up + 1.0 / down))
    weight = K * MASS * G * math.sin(slope)
    cruise = C2 * top**2 + (C3 + weight) * top
    energy = phase(top, weight + C6 * up, back) / up + phase(top, weight - C6 * down, back) / down
    energy += max(cruise, 0.0) * steady / top + back * min(cruise, 0.0) * steady / top
    return energy + C4 * (top / up + steady / top + top / down)


@pytest.mark.parametrize("back", [0.0, 0.6])
def test_drives_over_hills(tmp_path: Path, back: float) -> None:
    rng = np.random.default_rng(17)
    drives = [(rng.uniform(0.2, 30.0), rng.uniform(0.05, 2.0), rng.uniform(-0.06, 0.06)) for _ in range(500)]
    (tmp_path / "cart.yaml").write_text(ROBOT.replace("REGENERATION", str(back)))
    lines = [
        f"  - drive: {{distance: {d!r}, speed: {v!r}, slope: {s!r}}}\n  - wait: {{duration: 1 s}}\n"
        for d, v, s in drives
    ]
    (tmp_path / "hills.yaml").write_text(
        "kind: mission\nname: hills\nrobot: cart.yaml\nsegments:\n" + "".join(lines), encoding="utf-8"
    )
    result = simulate(load_mission(tmp_path / "hills.yaml"))
    joules = 3600.0 * np.asarray(result.by_segment_wh("main"))[::2]
    wanted = [by_hand(*drive, back) for drive in drives]
    assert joules == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("beyond", [1e-3, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_a_kink_hard_by_the_end_of_an_interval(beyond: float, start: float) -> None:
    """The drive's need ends a little before the robot stands, or a little after it began to brake."""
    accel = -0.5
    model = build_power_model(robot_from_text(ROBOT.replace("REGENERATION", "0").replace(f"c6: {C6}", "c6: 0")))
    for rest in (start + beyond, start + 1.0 - beyond):
        slope = math.asin(-(C3 + C2 * rest) / (K * MASS * G))
        weight = K * MASS * G * math.sin(slope)

        def taken(v: float, force: float = weight) -> float:
            return C2 * v**3 / 3.0 + (C3 + force) * v**2 / 2.0

        wanted = (taken(start + 1.0) - taken(rest)) / 0.5 + C4 * 2.0
        line = Timeline(
            np.zeros(1),
            np.full(1, 2.0),
            {
                "speed_m_s": np.full(1, start + 1.0),
                "slope_rad": np.full(1, slope),
                "accel_m_s2": np.full(1, accel),
                "moving": np.ones(1),
            },
            {"speed_m_s": np.full(1, accel)},
        )
        energy = sum(float(joules[0]) for joules in integrate(model, line)["main"].values())
        assert energy == pytest.approx(wanted, rel=1e-11)
