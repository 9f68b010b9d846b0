"""How the robots of the little world move: legs, wheels, floors, loads, temperatures (no missionsim code in here)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 0.1
SURFACES = ("tile", "carpet", "gravel")


@dataclass(frozen=True)
class Robot:
    """A robot of the little world; the powers are the base model that the user has (all but Pioneer's are assumed)."""

    name: str
    mass_kg: float
    track_m: float
    c2: float
    c3: float
    c4: float
    rest_w: float
    components: dict[str, float]
    switching: str
    mostly_on: str
    speed_m_s: tuple[float, float]
    accel_m_s2: float
    payload_kg: tuple[float, ...]
    voltage_v: float
    resistance_ohm: float
    capacity_wh: float
    meter_offset_w: float
    quantum_w: float


ROBOTS = {
    "pioneer3dx": Robot("pioneer3dx", 25.0, 0.33, 6.25, 9.79, 3.66, 2.67, {"laser": 2.34, "kinect": 2.82}, "kinect",
     "laser", (0.12, 0.75), 0.45, (2.0, 4.0, 6.0), 25.0, 0.08, 180.0, 0.08, 0.001),
    "husky_like": Robot("husky_like", 50.0, 0.55, 60.0, 230.0, 75.0, 62.0, {"lidar": 24.0, "computer": 58.0},
     "computer", "lidar", (0.15, 1.0), 0.6, (10.0, 20.0, 40.0), 26.5, 0.03, 480.0, 1.8, 0.01),
    "small_rover": Robot("small_rover", 1.6, 0.16, 5.0, 4.2, 1.25, 0.95, {"radio": 0.55, "camera": 1.15}, "camera",
     "radio", (0.06, 0.5), 0.35, (0.25, 0.5, 1.0), 12.2, 0.12, 20.0, 0.03, 0.001),
}  # fmt: skip


@dataclass(frozen=True)
class RunDesign:
    """What the experimenter varied in one run."""

    duration_s: float
    hills: str = "flat"  # flat | ramps | climb
    payload_kg: float = 0.0
    pick_up: bool = False  # payload only in the second half
    surface: str = "mixed"  # mixed | tile | carpet
    temp_c: float = 20.0
    one_speed: float | None = None
    switching: str = "toggle"  # toggle | on | off
    mostly_on: str = "mostly"  # mostly | on
    payload_on_carpet: bool = False
    planned: bool = False


@dataclass(frozen=True)
class Motion:
    """True state of one run on the fine clock; every array has the shape (n,)."""

    time_s: Array
    speed: Array
    accel: Array
    yaw: Array
    wheel_left: Array
    wheel_right: Array
    slope: Array
    payload: Array
    surface: NDArray[np.int64]
    temp: Array
    cpu: Array
    freq_hz: Array
    distance_ap_m: Array
    x: Array
    y: Array
    heading: Array
    on: dict[str, Array]
    segment: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def design_runs(design: str, robot: Robot, runs: int, duration_s: float, rng: np.random.Generator) -> list[RunDesign]:
    """Designs of ``runs`` runs: 'rich' varies everything on its own, the others are confounded by construction."""
    out = []
    order = rng.permutation(runs)
    fixed_speed = float(np.round(rng.uniform(0.5, 0.8) * robot.speed_m_s[1], 2))
    for i in range(runs):
        heavy = float(rng.choice(robot.payload_kg))
        rich = RunDesign(
            duration_s,
            hills=str(rng.choice(["flat", "ramps", "ramps"])),
            payload_kg=heavy if rng.random() < 0.55 else 0.0,
            pick_up=bool(rng.random() < 0.4),
            surface=str(rng.choice(["mixed", "mixed", "mixed", "tile", "carpet"])),
            temp_c=float(rng.uniform(5.0, 30.0)),
        )
        if i == 0 and runs <= 2:  # so that every effect can show in few runs
            rich = replace(rich, hills="ramps", payload_kg=heavy, pick_up=True, surface="mixed")
        half = bool(order[i] < (runs + 1) // 2)  # balanced, in random order
        if design == "rich":
            one = rich
        elif design == "carpet_payload":
            one = replace(
                rich,
                payload_kg=max(robot.payload_kg) if half else 0.0,
                pick_up=False,
                surface="carpet" if half else "tile",
                payload_on_carpet=True,
            )
        elif design == "cold_payload":
            one = replace(
                rich,
                payload_kg=max(robot.payload_kg) if half else 0.0,
                pick_up=False,
                temp_c=float(rng.uniform(6.0, 8.0) if half else rng.uniform(24.0, 26.0)),
            )
        elif design == "one_speed":
            one = replace(rich, one_speed=fixed_speed)
        elif design == "slope_payload":
            one = replace(
                rich,
                payload_kg=max(robot.payload_kg) if half else 0.0,
                pick_up=False,
                hills="climb" if half else "flat",
            )
        elif design == "mostly_on_always":
            one = replace(rich, mostly_on="on")
        elif design == "switching_cold":
            one = replace(
                rich,
                switching="on" if half else "off",
                temp_c=float(rng.uniform(5.0, 9.0) if half else rng.uniform(22.0, 28.0)),
            )
        else:
            raise ValueError(f"no such design: {design}")
        out.append(one)
    return out


def smooth(values: Array, tau_s: float, step_s: float = STEP_S) -> Array:
    """First-order lag that starts in its steady state."""
    if tau_s <= 0.0:
        return values
    a = float(np.exp(-step_s / tau_s))
    from scipy.signal import lfilter  # takes most of a second to import

    out, _ = lfilter([1.0 - a], [1.0, -a], values, zi=[a * values[0]])
    return np.asarray(out)


def wander(n: int, tau_s: float, rng: np.random.Generator, tails: float | None = None) -> Array:
    """Stationary AR(1) of unit variance with the correlation time ``tau_s``; ``tails`` = degrees of freedom."""
    a = float(np.exp(-STEP_S / tau_s))
    shock = rng.standard_normal(n) if tails is None else rng.standard_t(tails, n) / np.sqrt(tails / (tails - 2.0))
    from scipy.signal import lfilter

    out, _ = lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], shock, zi=[a * rng.standard_normal()])
    return np.asarray(out)


def levels(t: Array, low_s: float, high_s: float, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Random piecewise-constant levels 0..count-1, each held for low_s..high_s."""
    edges = np.cumsum(rng.uniform(low_s, high_s, int(t[-1] / low_s) + 2))
    return np.asarray(rng.integers(0, count, len(edges) + 1)[np.searchsorted(edges, t)], dtype=np.int64)


def blocks(t: Array, low_s: float, high_s: float, rng: np.random.Generator) -> Array:
    """Random piecewise-constant signal of -1, 0, 1."""
    return levels(t, low_s, high_s, 3, rng).astype(float) - 1.0
