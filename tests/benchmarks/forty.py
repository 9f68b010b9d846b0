"""The 40-segment patrol with noise in each segment: as a mission, by hand in NumPy, and in NASA's ProgPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

SEGMENTS = 40
LENGTH_M = np.array([5.0 + i % 7 for i in range(SEGMENTS)])
ASKED_M_S = np.array([round(0.3 + 0.01 * (i % 20), 2) for i in range(SEGMENTS)])
STRETCH, STRETCH_SD, TRACKING, TRACKING_SD = 1.1, 0.03, 0.9, 0.02
C2, C3, C4, PRIOR_SD = 6.25, 9.79, 3.66, 0.03
# watts of what is on all the time, by battery and component: two lasers and the Kinect
ROBOT_W = {"laser": 2 * 2.34, "kinect": 2.82}
LAPTOP_W = {
    "laser": 2 * 0.4,
    "kinect": 1.2,
    "robot_controller": 0.075,
    "wattmeter": 0.49,
    "switchboard1": 0.72,
    "switchboard2": 0.405,
    "processor": 13.27,
}
INSTANTS = 21


def write(folder: Path, times: int = 1) -> Path:
    """The mission file, with all segments so many times."""
    lines = [
        "kind: mission",
        "name: forty",
        "robot: pioneer3dx",
        "defaults: {scheme: forward_motion, sensors: {laser: 2, kinect: 1}, profile: constant_speed}",
        "segments:",
    ]
    for length, speed in [*zip(LENGTH_M, ASKED_M_S, strict=True)] * times:
        lines.append(
            f"  - drive: {{distance: {length} m, speed: {speed} m/s, behaviour: {{path_stretch: {{value: {STRETCH}, "
            f"sd: {STRETCH_SD}}}, speed_tracking: {{value: {TRACKING}, sd: {TRACKING_SD}}}}}}}"
        )
    path = folder / "forty.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def one_number(runs: int, rng: np.random.Generator) -> np.ndarray:
    """By hand, the least: the robot battery's total energy in Wh, nothing else kept."""
    way = LENGTH_M * (STRETCH + STRETCH_SD * rng.standard_normal((runs, SEGMENTS)))
    speed = ASKED_M_S * (TRACKING + TRACKING_SD * rng.standard_normal((runs, SEGMENTS)))
    c2, c3, c4 = (v * (1 + PRIOR_SD * rng.standard_normal((runs, 1))) for v in (C2, C3, C4))
    return ((c2 * speed + c3 + (c4 + sum(ROBOT_W.values())) / speed) * way).sum(axis=1) / 3600.0


def by_hand(runs: int, rng: np.random.Generator, charge: bool = False) -> dict[str, np.ndarray]:
    """By hand, what the arrays keep: the values drawn, duration, way, energies of both batteries by component in Wh.

    With `charge`, the energy taken from the robot's and the laptop's battery at even instants of each run as well.
    """
    stretch = STRETCH + STRETCH_SD * rng.standard_normal((runs, SEGMENTS))
    tracking = TRACKING + TRACKING_SD * rng.standard_normal((runs, SEGMENTS))
    c2, c3, c4 = (v * (1 + PRIOR_SD * rng.standard_normal((runs, 1))) for v in (C2, C3, C4))
    way, speed = LENGTH_M * stretch, ASKED_M_S * tracking
    duration = way / speed
    drive = (c2 * speed + c3) * way
    total = duration.sum(axis=1)
    kept = {"stretch": stretch, "tracking": tracking, "c2": c2, "c3": c3, "c4": c4}
    kept |= {"duration_s": total, "distance_m": way.sum(axis=1)}
    kept |= {"robot motors": drive.sum(axis=1) / 3600.0, "robot controller": c4[:, 0] * total / 3600.0}
    for battery, loads in (("robot", ROBOT_W), ("laptop", LAPTOP_W)):
        kept |= {f"{battery} {name}": watts * total / 3600.0 for name, watts in loads.items()}
        kept[battery] = sum(values for name, values in kept.items() if name.startswith(f"{battery} "))
    if charge:
        ends = np.concatenate([np.zeros((runs, 1)), np.cumsum(duration, axis=1)], axis=1)
        watts = drive / duration + c4 + sum(ROBOT_W.values())
        spent = np.concatenate([np.zeros((runs, 1)), np.cumsum(watts * duration, axis=1)], axis=1) / 3600.0
        at = np.linspace(0.0, 1.0, INSTANTS) * total[:, None]
        # interpolation of all runs at once: which segment each instant lies in, and how far along
        place = np.minimum((ends[:, None, 1:] <= at[:, :, None]).sum(axis=2), SEGMENTS - 1)
        begin, before = np.take_along_axis(ends, place, axis=1), np.take_along_axis(spent, place, axis=1)
        kept["robot charge"] = before + np.take_along_axis(watts, place, axis=1) / 3600.0 * (at - begin)
        kept["laptop charge"] = at * (sum(LAPTOP_W.values()) / 3600.0)
    return kept


def drawn_lists(runs: int, rng: np.random.Generator) -> list[tuple[list[float], list[float], float, float, float]]:
    """Ways and speeds of each run and its three coefficients, as plain numbers."""
    way = LENGTH_M * (STRETCH + STRETCH_SD * rng.standard_normal((runs, SEGMENTS)))
    speed = ASKED_M_S * (TRACKING + TRACKING_SD * rng.standard_normal((runs, SEGMENTS)))
    c2, c3, c4 = (v * (1 + PRIOR_SD * rng.standard_normal(runs)) for v in (C2, C3, C4))
    return list(zip(way.tolist(), speed.tolist(), c2.tolist(), c3.tolist(), c4.tolist(), strict=True))


def python_loop(runs: int, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """By hand as a plain Python loop: energies of both batteries in Wh and the duration; no charge over time."""
    robot_w, laptop_w = sum(ROBOT_W.values()), sum(LAPTOP_W.values())
    found = []
    for ways, speeds, c2, c3, c4 in drawn_lists(runs, rng):
        energy = total = 0.0
        for way, speed in zip(ways, speeds, strict=True):
            seconds = way / speed
            energy += (c2 * speed + c3) * way + (c4 + robot_w) * seconds
            total += seconds
        found.append((energy / 3600.0, laptop_w * total / 3600.0, total))
    return found


def simpy_by_hand(runs: int, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """The same with SimPy, a process and a timeout a segment, for this one mission."""
    import simpy

    robot_w, laptop_w = sum(ROBOT_W.values()), sum(LAPTOP_W.values())
    found = []
    for ways, speeds, c2, c3, c4 in drawn_lists(runs, rng):
        env = simpy.Environment()
        booked = [0.0]

        def drive(env=env, booked=booked, ways=ways, speeds=speeds, c2=c2, c3=c3, c4=c4):  # type: ignore[no-untyped-def]
            for way, speed in zip(ways, speeds, strict=True):
                begin = env.now
                yield env.timeout(way / speed)
                booked[0] += (c2 * speed + c3) * way + (c4 + robot_w) * (env.now - begin)

        env.process(drive())
        env.run()
        found.append((booked[0] / 3600.0, laptop_w * env.now / 3600.0, env.now))
    return found


def progpy_patrol(runs: int, seed: int) -> np.ndarray:
    """Energies of the robot's battery in Wh by ProgPy's Monte Carlo, in steps of a whole segment: its best case."""
    from progpy import PrognosticsModel
    from progpy.predictors import MonteCarlo
    from progpy.uncertain_data import UnweightedSamples

    rng = np.random.default_rng(seed)
    parts = ("motors", "controller", *ROBOT_W)

    class Patrol(PrognosticsModel):  # type: ignore[misc]
        inputs: list[str] = []  # noqa: RUF012
        states = ["segment", "time_s", "c2", "c3", "c4", *parts, "laptop"]  # noqa: RUF012
        outputs = ["energy_wh"]  # noqa: RUF012
        events = ["done"]  # noqa: RUF012

        def next_state(self, x: Any, u: Any, dt: float) -> Any:
            i = min(round(float(x["segment"])), SEGMENTS - 1)
            way = LENGTH_M[i] * rng.normal(STRETCH, STRETCH_SD)
            speed = ASKED_M_S[i] * rng.normal(TRACKING, TRACKING_SD)
            spent = {"motors": (x["c2"] * speed + x["c3"]) * way, "controller": x["c4"] * way / speed}
            spent |= {name: watts * way / speed for name, watts in ROBOT_W.items()}
            return self.StateContainer(
                {
                    **{name: x[name] for name in ("c2", "c3", "c4")},
                    **{name: x[name] + joules for name, joules in spent.items()},
                    "segment": x["segment"] + 1,
                    "time_s": x["time_s"] + way / speed,
                    "laptop": x["laptop"] + sum(LAPTOP_W.values()) * way / speed,
                }
            )

        def output(self, x: Any) -> Any:
            return self.OutputContainer({"energy_wh": sum(x[name] for name in parts) / 3600.0})

        def event_state(self, x: Any) -> dict[str, Any]:
            return {"done": 1.0 - x["segment"] / SEGMENTS}

        def threshold_met(self, x: Any) -> dict[str, Any]:
            return {"done": x["segment"] >= SEGMENTS}

    model = Patrol()
    first = [
        model.StateContainer(
            {
                "segment": 0.0,
                "time_s": 0.0,
                **dict.fromkeys(parts, 0.0),
                "laptop": 0.0,
                **{name: rng.normal(v, PRIOR_SD * v) for name, v in (("c2", C2), ("c3", C3), ("c4", C4))},
            }
        )
        for _ in range(runs)
    ]
    found = MonteCarlo(model).predict(
        UnweightedSamples(first), dt=1.0, horizon=SEGMENTS + 1, events=["done"], save_freq=SEGMENTS
    )
    last = found.time_of_event.final_state["done"]
    return np.array([sum(float(state[name]) for name in parts) / 3600.0 for state in last])
