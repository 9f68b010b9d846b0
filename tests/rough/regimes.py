"""Thirteen regimes of logging and of bases, with nothing hidden and with one effect: what is named, and what is not.

``python -m tests.rough.regimes --seeds 0:1`` writes logs of robots of 2, 13, 50 and 590 kg as users log them (every
5 s or ten times a second, two hours or three minutes, a base that was calibrated on the very logs, clocks apart),
runs ``diagnose`` and prints a line a case and a table. It shares no formula with the library of effects. It ends with
1 where an effect that is not there was named with nothing that could stand for the truth beside it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

STEP = 0.1
G = 9.81


@dataclass(frozen=True)
class Robot:
    """A robot of this world: its base ``c2 v^2 + c3 v + c4``, at rest and its loads [W]."""

    mass_kg: float
    top_m_s: float
    c2: float
    c3: float
    c4: float
    rest_w: float
    camera_w: float
    payload_kg: float


ROBOTS = {
    "2kg": Robot(2.0, 0.4, 3.0, 5.0, 3.2, 2.9, 1.8, 0.5),
    "13kg": Robot(13.0, 0.9, 4.0, 11.0, 8.0, 7.0, 3.0, 4.0),
    "50kg": Robot(50.0, 1.2, 30.0, 160.0, 60.0, 55.0, 22.0, 20.0),
    "590kg": Robot(590.0, 2.5, 70.0, 800.0, 420.0, 380.0, 90.0, 150.0),
}


@dataclass(frozen=True)
class Regime:
    """How logs come: robot, runs, seconds a run, seconds a row, errors of base, meter and clock."""

    robot: str = "13kg"
    runs: int = 8
    seconds: float = 600.0
    row_s: float = 1.0
    base_sd: float = 0.03
    file_sd: float = 0.03
    noise: float = 0.03
    flicker: float = 0.0
    ripple: float = 0.002
    by_day: float = 0.0
    clock_s: float = 0.0
    calibrated: str = ""


REGIMES = {
    "plain 1 Hz": Regime(),
    "10 Hz": Regime(row_s=0.1, runs=6, seconds=420.0),
    "0.2 Hz": Regime(row_s=5.0, seconds=1800.0),
    "2 h runs": Regime(runs=4, seconds=7200.0),
    "40 runs of 200 s": Regime(runs=40, seconds=200.0),
    "flicker 4 %": Regime(flicker=0.04),
    "base 5 % off, file says 3 %": Regime(base_sd=0.05),
    "base 10 % off, file says 10 %": Regime(base_sd=0.10, file_sd=0.10),
    "base differs by day 3 %": Regime(by_day=0.03),
    "ripple 2 %": Regime(ripple=0.02),
    "590 kg, clocks 0.8 s apart": Regime(robot="590kg", clock_s=0.8),
    "50 kg, calibrated on these logs": Regime(robot="50kg", base_sd=0.10, calibrated="same"),
    "2 kg, v2 missing, calibrated": Regime(robot="2kg", base_sd=0.10, calibrated="straight"),
}
EFFECTS = (
    "grade",
    "payload",
    "acceleration",
    "turning_scrub",
    "cpu_load",
    "temperature_friction",
    "surface_rolling_resistance",
)


def _lagged(x: np.ndarray, tau_s: float) -> np.ndarray:
    from scipy.signal import lfilter

    keep = np.exp(-STEP / tau_s)
    return np.asarray(lfilter([1 - keep], [1, -keep], x - x[0]) + x[0])


def _wander(rng: np.random.Generator, n: int, tau_s: float) -> np.ndarray:
    """A stationary first-order wander of unit variance."""
    from scipy.signal import lfilter

    keep = np.exp(-STEP / tau_s)
    shocks = rng.standard_normal(n) * np.sqrt(1 - keep**2)
    shocks[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1, -keep], shocks))


def _held(rng: np.random.Generator, n: int, levels: Sequence[float], shortest_s: float, longest_s: float) -> np.ndarray:
    out, at = np.empty(n), 0
    while at < n:
        length = int(rng.uniform(shortest_s, longest_s) / STEP)
        out[at : at + length] = rng.choice(levels)
        at += length
    return out


def motion(rng: np.random.Generator, robot: Robot, seconds: float, run: int) -> dict[str, np.ndarray]:
    """A patrol: legs at a few speeds, halts, turns at the corners, a ramp and two floors along the way."""
    n = int(seconds / STEP)
    asked = _held(rng, n, robot.top_m_s * np.array([0.0, 0.35, 0.5, 0.7, 0.85, 1.0]), 6, 25)
    rate = 0.5 * robot.top_m_s  # m/s^2
    v = np.empty(n)
    v[0] = 0.0
    for i in range(1, n):
        v[i] = v[i - 1] + min(max(asked[i] - v[i - 1], -rate * STEP), rate * STEP)
    way = np.cumsum(v) * STEP / robot.top_m_s  # in seconds at top speed
    corner = (way % 23.0 < 2.0) & (v > 0)
    pivot = (v < 0.02 * robot.top_m_s) & (_held(rng, n, [0, 0, 0, 1], 3, 9) > 0)
    yaw = _lagged(np.where(corner, 0.6, 0.0) + np.where(pivot, 0.9, 0.0), 0.25)
    slope = _lagged(
        0.06 * ((way % 61.0 > 20) & (way % 61.0 < 28)) - 0.06 * ((way % 61.0 > 40) & (way % 61.0 < 48)), 0.8
    )
    cpu = np.clip(_held(rng, n, [0.15, 0.3, 0.5, 0.75, 0.95], 8, 60) + 0.03 * _wander(rng, n, 4.0), 0, 1)
    return {
        "v": v,
        "a": np.gradient(v, STEP),
        "yaw": yaw,
        "slope": slope,
        "carpet": ((way % 47.0) > 30.0).astype(float),
        "payload": _held(rng, n, [0.0, 0.0, 0.5, 1.0], 60, 200) * robot.payload_kg,
        "cpu": cpu,
        "camera": _held(rng, n, [0, 1, 1], 30, 90),
        "temp": 18.0 + 7.0 * np.sin(2.4 * run + 1) + 2.0 * _wander(rng, n, 900.0),
    }


def hidden(effect: str, m: dict[str, np.ndarray], robot: Robot) -> np.ndarray:
    """Power of a hidden effect, unscaled [W]; none of these is the library's form."""
    v, mass = m["v"], robot.mass_kg + m["payload"]
    loss = 1.0 + 0.15 * np.exp(-v / (0.25 * robot.top_m_s))  # gears are worse when slow
    if effect == "grade":
        pull = mass * G * np.sin(m["slope"]) * v * loss
        return np.maximum(pull, -0.7 * robot.c3 * v)
    if effect == "payload":
        return m["payload"] ** 0.95 * v * loss
    if effect == "acceleration":
        return np.maximum(mass * m["a"] * v * loss, 0.0)
    if effect == "turning_scrub":
        return 0.8 * np.tanh(m["yaw"] / 0.8)
    if effect == "cpu_load":
        return m["cpu"] ** 1.1
    if effect == "temperature_friction":
        return v * loss * (np.exp((25.0 - m["temp"]) / 22.0) - 0.6)
    assert effect == "surface_rolling_resistance"
    return m["carpet"] * v * loss


def logs(regime: Regime, effect: str, share: float, seed: int) -> tuple[list[pd.DataFrame], Robot]:
    """Runs in the columns of a log, and the robot as its file describes it."""
    rng = np.random.default_rng([seed, EFFECTS.index(effect) if effect else 99, list(REGIMES.values()).index(regime)])
    told = ROBOTS[regime.robot]
    off = lambda x: x * (1 + regime.base_sd * rng.standard_normal())  # noqa: E731
    c2, c3, c4, rest, camera = map(off, (told.c2, told.c3, told.c4, told.rest_w, told.camera_w))
    lag, clock, phase = rng.uniform(0.1, 0.4), rng.uniform(-1, 1) * regime.clock_s, rng.uniform(0, 6)
    motions = [motion(rng, told, regime.seconds, run) for run in range(regime.runs)]
    bases = []
    for m in motions:
        v = m["v"]
        moving = _lagged(((v > 0.003) | (m["yaw"] > 0.05)).astype(float), 0.1)
        ripple = 1 + regime.ripple * np.sin(2 * np.pi * v / told.top_m_s + phase)
        day = 1 + regime.by_day * rng.standard_normal()
        bases.append(day * ((c2 * v**2 + c3 * v) * ripple + c4 * moving + rest * (1 - moving)) + camera * m["camera"])
    raw = [hidden(effect, m, told) if effect else 0.0 * m["v"] for m in motions]
    size = np.mean(np.abs(np.concatenate(raw)))
    k = share * np.mean(np.concatenate(bases)) / size if effect else 0.0
    frames = []
    for m, base, extra in zip(motions, bases, raw, strict=True):
        power = base + k * extra
        n, scale = len(power), np.mean(power)
        power = _lagged(power, lag) * (1 + 0.008 * rng.standard_normal())
        power = power + scale * (regime.noise * _wander(rng, n, 0.4) + regime.flicker * _wander(rng, n, 60.0))
        clock_rows = int(clock / STEP)
        power = np.roll(power, clock_rows)
        rows = int(regime.row_s / STEP)
        count = n // rows
        mean = lambda x, r=rows, c=count: x[: r * c].reshape(c, r).mean(axis=1)  # noqa: E731
        last = lambda x, r=rows, c=count: x[r - 1 : r * c : r]  # noqa: E731
        moving = mean(m["v"]) > 0.002
        frames.append(
            pd.DataFrame(
                {
                    "time_s": np.round(np.arange(count) * regime.row_s + regime.row_s / 2, 2),
                    "power_robot_w": np.round(mean(power), 3 if told.mass_kg < 20 else 1),
                    "speed_m_s": np.round(mean(m["v"]) + 0.01 * told.top_m_s * rng.standard_normal(count) * moving, 4),
                    "yaw_rate_rad_s": np.round(mean(m["yaw"]) + 0.01 * rng.standard_normal(count), 4),
                    "slope_rad": np.round(mean(m["slope"]) + 0.003 * rng.standard_normal(count), 4),
                    "payload_kg": np.round(last(m["payload"]), 2),
                    "surface": np.where(last(m["carpet"]) > 0, "carpet", "tiles"),
                    "temp_ambient_c": np.round(mean(m["temp"]), 1),
                    "cpu_load": np.round(mean(m["cpu"]), 3),
                    "on_camera": last(m["camera"]).astype(int),
                }
            )
        )
    return frames, told


def robot_file(robot: Robot, sd: float) -> str:
    """The robot as a user's file, every figure with the same relative uncertainty."""
    figure = lambda x, unit="": f"{{value: {x}{unit}, sd: {100 * sd:g} %, status: assumed}}"  # noqa: E731
    return f"""kind: robot
name: other
body: {{mass: {robot.mass_kg} kg, drive: differential, max_speed: {robot.top_m_s} m/s}}
batteries:
  robot: {{capacity: 1000 Wh, nominal_voltage: 24 V}}
motion:
  battery: robot
  model: polynomial
  parameters:
    c2: {figure(robot.c2)}
    c3: {figure(robot.c3)}
    c4: {figure(robot.c4)}
    standing: {figure(robot.rest_w)}
components:
  camera:
    units: 1
    loads:
      - {{battery: robot, power: {figure(robot.camera_w, " W")}}}
schemes:
  drive: {{motion: true, sensors: {{optional: {{camera: 1}}}}}}
"""


def case(regime: Regime, effect: str, share: float, seed: int) -> dict[str, object]:
    """Diagnose one case as a user does: names, sets, verdict, seconds."""
    from missionsim.cli.app import run_command
    from missionsim.diagnose import diagnose_files

    frames, told = logs(regime, effect, share, seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        for number, frame in enumerate(frames):
            frame.to_csv(folder / "logs" / f"run_{number:02d}.csv", index=False)
        file = folder / "other.yaml"
        file.write_text(robot_file(told, regime.file_sd), encoding="utf-8")
        if regime.calibrated:
            if regime.calibrated == "straight":  # a formula that lacks what the robot has
                text = file.read_text(encoding="utf-8").replace("polynomial", 'expression\n  power: "c3*v + c4"')
                text = "\n".join(line for line in text.splitlines() if "c2:" not in line) + "\n"
                file.write_text(text.replace("  parameters:", "  standing: standing\n  parameters:"), encoding="utf-8")
            command = ["calibrate", str(folder / "logs"), "--robot", str(file), "--out", str(folder / "mine.yaml")]
            run_command([*command, "--quiet"])
            file = folder / "mine.yaml"
        start = time.process_time()
        found = diagnose_files(str(file), [folder / "logs"]).to_json()["batteries"]["robot"]
    named = {one["effect"]: one["indistinguishable_from"] for one in found["effects"]}
    return {"verdict": found["verdict"], "named": named, "seconds": time.process_time() - start, "report": found}


def judge(effect: str, found: dict[str, object]) -> str:
    """In a word: right, in a set with the truth, unexplained, silent, or wrong (nothing true beside a name)."""
    named: dict[str, list[str]] = found["named"]  # type: ignore[assignment]
    if not effect:
        if named:
            return "named alone" if any(not rivals for rivals in named.values()) else "named with rivals"
        return "unexplained" if found["verdict"] == "unexplained_structure" else "silent"
    first = next(iter(named), "")
    wrong = [name for name, rivals in named.items() if name != effect and effect not in rivals and not rivals]
    beside = f" + wrong {', '.join(wrong)}" if wrong else ""
    if first == effect:
        return "right" + beside
    if effect in named or any(effect in rivals for rivals in named.values()):
        return "in a set" + beside
    return ("wrong" + beside) if named else ("unexplained" if found["verdict"] == "unexplained_structure" else "silent")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:1", help="first:end")
    parser.add_argument("--only", nargs="*", default=[], help="words of the regimes")
    parser.add_argument("--effects", nargs="*", default=["", *EFFECTS], help="which; nothing at all is ''")
    parser.add_argument("--share", type=float, default=0.05, help="mean power of the effect over that of the runs")
    given = parser.parse_args(arguments)
    first, end = map(int, given.seeds.split(":"))
    counts: Counter[str] = Counter()
    for label, regime in REGIMES.items():
        if given.only and not any(word in label for word in given.only):
            continue
        for seed in range(first, end):
            for effect in given.effects:
                for again in range(3 if not effect else 1):
                    found = case(regime, effect, given.share, seed + 1000 * again)
                    mark = judge(effect, found)
                    counts[f"{'effect' if effect else 'nothing'}: {mark.split(' + ')[0]}"] += 1
                    counts["confident wrong"] += "wrong" in mark or mark == "named alone"
                    named = ", ".join(
                        f"{name} [{' '.join(rivals)}]" if rivals else name
                        for name, rivals in found["named"].items()  # type: ignore[attr-defined]
                    )
                    print(
                        f"{label:34} {seed + 1000 * again:4d} {effect or 'nothing':28} {mark:20} {found['verdict']:22} "
                        f"{found['seconds']:5.1f} s  {named}",
                        flush=True,
                    )
    print(dict(counts))
    return int(counts["confident wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
