"""The little world: robots whose logs hide a known effect. It shares no code with the product under test.

A case is made fleet-wide from one seed: world (base coefficients 3 % off, smooth ripple), campaign (delay and lag of
the meter), runs (design, motion, meter, lost rows). ``python -m tests.hidden_effects.world OUT CASE [--seed S]`` writes
a case as ``OUT/<case>/train/*.csv, heldout/*.csv, answer.json`` in the layout of the practice logs.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .meter import Meter, Rows, draw_meter, log_rows, reading, row_times, through
from .motion import ROBOTS, STEP_S, Array, Motion, Robot, RunDesign, design_runs
from .planned import EXECUTION, SCHEME, Leg, behaviour_of, follow, mission_yaml, plan_mission
from .plant import INSIDE, OUTSIDE, TWINS, Draw, base_columns, base_power, draw_world, planted, voltage
from .track import drive, manoeuvre

Log = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Case:
    """What is asked of the world.

    Attributes
    ----------
    hidden
        Ids of the planted effects: the contract's, or those of :data:`tests.hidden_effects.plant.OUTSIDE`.
    share
        Part of the energy of the training runs that each planted effect takes (mean absolute power over mean power).
    """

    name: str
    hidden: tuple[str, ...] = ()
    share: float = 0.0
    robot: str = "pioneer3dx"
    design: str = "rich"
    noise_level: int = 2
    rate_hz: float = 1.0
    runs: int = 8
    heldout: int = 3
    duration_s: float = 420.0
    power_format: str = "power"
    columns: frozenset[str] = frozenset({"accel", "cpu_freq", "access_point"})
    equivalent: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Secrets:
    """What stays the same when the same robot drives one more run."""

    draw: Draw
    common: tuple[float, float]
    strengths: tuple[float, ...]
    legs: tuple[Leg, ...] = ()


@dataclass(frozen=True)
class World:
    """A made case: logs for the user, truth for the scorer. Dictionaries are keyed by run name."""

    case: Case
    seed: int
    train: dict[str, Log]
    heldout: dict[str, Log]
    answer: dict[str, object]
    secrets: Secrets = field(repr=False)
    truth: dict[str, dict[str, Array]] = field(repr=False, default_factory=dict)
    """Per run, at the log's rows: true power of each hidden effect ('hidden:<id>'), unit base columns ('base:<name>'),
    both as a meter without noise would show them; 'power' = noise-free measured power."""

    @property
    def mission(self) -> str | None:
        """The mission as YAML, where the runs follow one."""
        robot = ROBOTS[self.case.robot]
        parts = (robot.mostly_on, robot.switching)
        return mission_yaml(self.secrets.legs, f"{self.case.robot}.yaml", parts) if self.secrets.legs else None


@dataclass(frozen=True)
class _Run:
    motion: Motion
    meter: Meter
    base_w: Array
    volt: Array
    effects: list[Callable[[float], Array]]
    segments: list[str] | None
    seed: np.random.SeedSequence
    candidates: dict[str, Array] = field(default_factory=dict)


def make(case: Case, seed: int, *, candidates: bool = False) -> World:
    """Make a case; the same case and seed give the same bits on any machine with the same NumPy.

    With `candidates`, the truth holds the true column of each effect of the library as well ('candidate:<id>').
    """
    robot = ROBOTS[case.robot]
    root = np.random.SeedSequence([seed, zlib.crc32(case.name.encode())])
    world_seed, design_seed, *run_seeds = root.spawn(2 + case.runs + case.heldout)
    rng = np.random.default_rng(world_seed)
    world = draw_world(robot, case.noise_level, rng)
    common = (float(rng.uniform(-0.25, 0.25)), float(rng.uniform(0.1, 0.45)))
    rng = np.random.default_rng(design_seed)
    legs: tuple[Leg, ...] = ()
    plans: list[RunDesign | None] = [None] * (case.runs + case.heldout)
    if case.design == "planned":
        legs = plan_mission(robot, case.duration_s, rng)
    else:
        plans = [*design_runs(case.design, robot, case.runs, case.duration_s, rng)]
        plans += design_runs("rich", robot, case.heldout, case.duration_s, rng)
    secrets = Secrets(world, common, (), legs)
    runs = [_prepare(case, plan, robot, secrets, seq) for plan, seq in zip(plans, run_seeds, strict=True)]
    training = runs[: case.runs]
    strengths = _strengths(case, [r.effects for r in training], [r.base_w for r in training])
    secrets = replace(secrets, strengths=tuple(strengths))
    if candidates:
        _add_candidates(case, runs, robot, secrets.draw)
    recorded = [_record(case, run, secrets, robot) for run in runs]
    names = [f"run_{i:02d}" for i in range(case.runs)] + [f"held_{i:02d}" for i in range(case.heldout)]
    logs = {name: log for name, (log, _) in zip(names, recorded, strict=True)}
    truth = {name: true for name, (_, true) in zip(names, recorded, strict=True)}
    train, heldout = ({n: logs[n] for n in part} for part in (names[: case.runs], names[case.runs :]))
    return World(case, seed, train, heldout, _answer(case, seed, secrets, robot), secrets, truth)


def experiment(world: World, parts: Sequence[Mapping[str, Any]], number: int = 0) -> Log:
    """One more run of the same robot with the same meter: a scripted manoeuvre (see :func:`track.manoeuvre`)."""
    case, robot = world.case, ROBOTS[world.case.robot]
    seq = np.random.SeedSequence([world.seed, zlib.crc32(case.name.encode()), 77, number])
    motion = manoeuvre(robot, parts, np.random.default_rng(seq.spawn(1)[0]))
    return _record(case, _prepare(case, None, robot, world.secrets, seq, motion), world.secrets, robot)[0]


def _prepare(
    case: Case,
    plan: RunDesign | None,
    robot: Robot,
    secrets: Secrets,
    seq: np.random.SeedSequence,
    motion: Motion | None = None,
) -> _Run:
    rng = np.random.default_rng(seq)
    segments: list[str] | None = None
    if motion is None and plan is not None:
        motion = drive(robot, plan, rng)
    elif motion is None:
        motion, segments = follow(robot, secrets.legs, behaviour_of(case.hidden, case.share), rng)
    meter = draw_meter(robot, case.noise_level, secrets.common, rng)
    base_w = base_power(motion, robot, secrets.draw)
    volt = voltage(motion, robot, base_w, float(rng.uniform(0.5, 1.0)))
    powers = [name for name in case.hidden if name not in EXECUTION]
    effects = [planted(name, motion, robot, secrets.draw, base_w, volt, rng) for name in powers]
    return _Run(motion, meter, base_w, volt, effects, segments, seq)


def _strengths(case: Case, effects: list[list[Callable[[float], Array]]], base: list[Array]) -> list[float]:
    """Strength of each hidden effect so that its mean |power| is ``share`` of the mean total power (fixed point)."""
    count = len(effects[0])
    strengths = [1.0] * count
    for _ in range(60 if count else 0):
        parts = [[f(k) for f, k in zip(run, strengths, strict=True)] for run in effects]
        total = float(np.mean([np.mean(b) + sum(np.mean(p) for p in run) for b, run in zip(base, parts, strict=True)]))
        have = np.array([np.mean([np.mean(np.abs(run[i])) for run in parts]) for i in range(count)]) / total
        if np.any(have <= 0.0):
            raise ValueError(f"{case.name}: an effect never acts in these runs")
        if np.all(np.abs(have / case.share - 1.0) < 1e-6):
            break
        strengths = [float(k * case.share / h) for k, h in zip(strengths, have, strict=True)]
    return strengths


def _add_candidates(case: Case, runs: Sequence[_Run], robot: Robot, draw: Draw) -> None:
    """The power of every effect of the library that acts in these runs, each as strong as the planted ones."""
    parts = sorted(robot.components)
    names = [f"{e}:{part}" for e in INSIDE if e.startswith("component_") for part in parts]
    for name in [e for e in INSIDE if not e.startswith("component_")] + names:
        alone = replace(case, hidden=(name,), share=case.share or 0.02)
        drawn = [planted(name, r.motion, robot, draw, r.base_w, r.volt, np.random.default_rng(0)) for r in runs]
        training = [[f] for f in drawn[: case.runs]]
        try:
            (k,) = _strengths(alone, training, [r.base_w for r in runs[: case.runs]])
        except ValueError:  # it never acts
            continue
        for run, power in zip(runs, drawn, strict=True):
            run.candidates[name] = power(k)


def _record(case: Case, run: _Run, secrets: Secrets, robot: Robot) -> tuple[Log, dict[str, Array]]:
    rng = np.random.default_rng(run.seed.spawn(1)[0])
    parts = [f(k) for f, k in zip(run.effects, secrets.strengths, strict=True)]
    total = run.base_w + sum(parts, np.zeros_like(run.base_w))
    duration = len(run.base_w) * STEP_S
    times, keep = row_times(duration, case.rate_hz, case.noise_level, rng)
    rows = Rows(times, duration)
    fast_s = float(rng.uniform(1.0, 4.0))
    shown = reading(run.meter, total, case.noise_level, fast_s, rng)
    log = log_rows(run.motion, robot, shown, run.volt, rows, case.noise_level, case.columns, case.power_format, rng)
    if run.segments is not None:
        log["scheme"] = np.full(len(times), SCHEME)
        log["segment"] = rows.nearest(np.array(run.segments))
    powers = [name for name in case.hidden if name not in EXECUTION]
    true = {f"hidden:{name}": rows.mean(through(run.meter, p)) for name, p in zip(powers, parts, strict=True)}
    for name, column in base_columns(run.motion, robot).items():
        true[f"base:{name}"] = rows.mean(through(run.meter, column))
    true["power"] = rows.mean(through(run.meter, total))
    true["measured"] = rows.mean(shown)
    true["seconds"] = rows.right - rows.left
    true["noise_s"] = np.full(len(times), fast_s)
    for name, column in run.candidates.items():
        true[f"candidate:{name}"] = rows.mean(through(run.meter, column))
    return {k: v[keep] for k, v in log.items()}, {k: v[keep] for k, v in true.items()}


def _answer(case: Case, seed: int, secrets: Secrets, robot: Robot) -> dict[str, object]:
    """What was hidden, in the layout of the practice answers, plus what the scorer wants to know."""
    powers = [name for name in case.hidden if name not in EXECUTION]
    strength = dict(zip(powers, secrets.strengths, strict=True))
    twins: dict[str, float] = {}
    shares = dict.fromkeys(case.hidden, case.share)
    for name, k in strength.items():
        kind, _, part = name.partition(":")
        if kind in TWINS:  # total shift of the base parameter, drawn and planted together, in prior sds of 3 %
            nominal = robot.components[part] if part else getattr(robot, TWINS[kind])
            drawn = secrets.draw.components[part] if part else getattr(secrets.draw, TWINS[kind])
            twins[name] = float((drawn + k - nominal) / (0.03 * nominal))
            shares[name] = float(case.share * (drawn + k - nominal) / k)
    how = behaviour_of(case.hidden, case.share)
    return {
        "hidden": list(case.hidden),
        "share_of_energy": case.share,
        "noise_level": case.noise_level,
        "design": case.design,
        "note": case.note,
        "robot": case.robot,
        "seed": seed,
        "outside": [name for name in case.hidden if name in OUTSIDE],
        "equivalent": list(case.equivalent),
        "shift_in_prior_sd": twins,
        "share_true": shares,
        "strength": strength | {name: float(getattr(how, name)) for name in case.hidden if name in EXECUTION},
    }


def write(world: World, folder: Path) -> Path:
    """Write a made case below ``folder``; returns the case's folder."""
    out = folder / world.case.name
    for kind, logs in (("train", world.train), ("heldout", world.heldout)):
        (out / kind).mkdir(parents=True, exist_ok=True)
        for run, log in logs.items():
            write_csv(log, out / kind / f"{run}.csv")
    if world.mission is not None:
        robot_file = Path(__file__).parent / "robots" / f"{world.case.robot}.yaml"
        if robot_file.exists():
            shutil.copy(robot_file, out / robot_file.name)
        (out / "mission.yaml").write_text(world.mission, encoding="utf-8")
    (out / "answer.json").write_text(json.dumps(world.answer, indent=1) + "\n", encoding="utf-8")
    return out


def write_csv(log: Log, path: Path) -> None:
    """One run as CSV with a header."""
    columns = [[str(x) for x in values.tolist()] for values in log.values()]
    lines = [",".join(log), *(",".join(row) for row in zip(*columns, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Write cases as folders."""
    from .study import ALL_CASES

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("cases", nargs="*", help="names or beginnings of names; none = list them")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    chosen = [c for c in ALL_CASES.values() if any(c.name.startswith(p) for p in options.cases)]
    if not chosen:
        print("\n".join(ALL_CASES))
        return 0 if not options.cases else 2
    for case in chosen:
        print(write(make(case, options.seed), options.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
