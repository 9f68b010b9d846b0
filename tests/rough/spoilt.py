"""One spoilt run of eight: is it named, is nothing named for it, is nothing excluded that is there?

``python -m tests.rough.spoilt --seeds 0:3`` makes logs with nothing and with grade hidden, spoils them in fifteen ways,
runs ``diagnose`` and prints a table. It ends with 1 where a wrong effect was named, an effect that is there was
excluded, or fewer than nine tenths of the spoilt runs were named.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from missionsim.cli.app import run_command
from tests.hidden_effects.world import Case, make, write_csv

Log = dict[str, np.ndarray]
Spoil = Callable[[dict[str, Log], np.random.Generator], str]


def _one(change: Callable[[Log, np.random.Generator], None]) -> Spoil:
    def spoil(logs: dict[str, Log], rng: np.random.Generator) -> str:
        name = sorted(logs)[int(rng.integers(len(logs)))]
        change(logs[name], rng)
        return name

    return spoil


def _scaled(column: str, factor: float, offset: float = 0.0) -> Callable[[Log, np.random.Generator], None]:
    def change(log: Log, rng: np.random.Generator) -> None:
        log[column] = np.asarray(log[column], dtype=float) * factor + offset

    return change


def _shuffled(log: Log, rng: np.random.Generator) -> None:
    order = rng.permutation(len(log["time_s"]))
    for name in log:
        if name != "time_s":
            log[name] = np.asarray(log[name])[order]


def _late(log: Log, rng: np.random.Generator) -> None:
    log["power_robot_w"] = np.roll(log["power_robot_w"], 25)


def _power_shuffled(log: Log, rng: np.random.Generator) -> None:
    log["power_robot_w"] = rng.permutation(log["power_robot_w"])


def _speed_stands(log: Log, rng: np.random.Generator) -> None:
    third = len(log["speed_m_s"]) // 3
    log["speed_m_s"] = np.array(log["speed_m_s"])
    log["speed_m_s"][third:] = np.max(log["speed_m_s"][:third]) * 0.7


def _switch_stuck(log: Log, rng: np.random.Generator) -> None:
    log["on_laser"] = 0 * np.asarray(log["on_laser"])


def _three(logs: dict[str, Log], rng: np.random.Generator) -> str:
    names = sorted(rng.choice(sorted(logs), 3, replace=False).tolist())
    for name in names:
        logs[name]["power_robot_w"] = logs[name]["power_robot_w"] + 2.0
    return str(names[0])


def _cut_copies(logs: dict[str, Log], rng: np.random.Generator) -> str:
    """Copies that begin later, on a clock of their own, with noise on power and temperature."""
    first, *others = sorted(logs)
    for number, name in enumerate(others[:3]):
        log = {key: np.array(values)[5 * (number + 1) :] for key, values in logs[first].items()}
        log["time_s"] = log["time_s"] + 1000.0 * number + 0.137
        log["power_robot_w"] = log["power_robot_w"] + rng.normal(0.0, 0.2, len(log["time_s"]))
        logs[name] = log
    return others[0]


def _frozen(logs: dict[str, Log], rng: np.random.Generator) -> str:
    for log in logs.values():
        log["on_kinect"] = 0 * np.asarray(log["on_kinect"])
    return "on_kinect"


def _copies(logs: dict[str, Log], rng: np.random.Generator) -> str:
    first, *others = sorted(logs)
    for name in others[:3]:
        logs[name] = {key: np.array(values) for key, values in logs[first].items()}
        logs[name]["power_robot_w"] = logs[name]["power_robot_w"] + rng.normal(0.0, 0.01, len(logs[name]["time_s"]))
    return others[0]


def _other_robot(logs: dict[str, Log], rng: np.random.Generator) -> str:
    name = sorted(logs)[int(rng.integers(len(logs)))]
    log = make(Case("other", robot="small_rover", runs=1, heldout=0), int(rng.integers(1000))).train["run_00"]
    shared = {key: np.array(values) for key, values in log.items() if key in logs[name]}
    power = next(values for key, values in log.items() if key.startswith("power_"))
    logs[name] = {**shared, "power_robot_w": np.array(power)}
    return name


SPOILS: dict[str, Spoil] = {
    "a component's column stuck at 0": _frozen,
    "km/h in one run": _one(_scaled("speed_m_s", 3.6)),
    "mW in one run": _one(_scaled("power_robot_w", 1000.0)),
    "+2 W in one run": _one(_scaled("power_robot_w", 1.0, 2.0)),
    "+2 W in three runs": _three,
    "power times 1.3 in one run": _one(_scaled("power_robot_w", 1.3)),
    "power 25 s late in one run": _one(_late),
    "only the power of one run shuffled": _one(_power_shuffled),
    "speed of one run stands still": _one(_speed_stands),
    "a switch stuck in one run": _one(_switch_stuck),
    "mph in one run": _one(_scaled("speed_m_s", 2.2369)),
    "near-copies of one run": _copies,
    "copies, cut and shifted": _cut_copies,
    "rows of one run shuffled": _one(_shuffled),
    "another robot's run": _other_robot,
}


def diagnosed(logs: dict[str, Log], folder: Path) -> tuple[dict[str, object], str]:
    """The diagnosis of logs, and all that was said."""
    folder.mkdir()
    for name, log in logs.items():
        write_csv(log, folder / f"{name}.csv")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = run_command(["diagnose", "--robot", "pioneer3dx", str(folder), "--json", str(folder / "out.json")])
    if code not in (0, 1):
        return {}, said.getvalue()
    return json.loads((folder / "out.json").read_text(encoding="utf-8"))["batteries"].get("robot", {}), said.getvalue()


def judge(found: dict[str, object], said: str, spoilt: str, hidden: str, share: float) -> set[str]:
    """``named`` (the spoilt run), ``wrong`` (an effect named that is not there), ``excluded`` (one that is there)."""
    # a run's name stands elsewhere too, where the error is looked at; only what is said of the fault counts
    names = rf"^(LEFT OUT {spoilt}: |{spoilt} is .* in every row of all runs)"
    marks = {"named"} if re.search(names, said, re.MULTILINE) else set()
    effects = [one for one in found.get("effects", []) if found.get("verdict") == "effects_found"]  # type: ignore[attr-defined]
    marks |= {f"wrong {one['effect']}" for one in effects if one["effect"] != hidden}
    for one in found.get("candidates", []) if hidden else []:  # type: ignore[attr-defined]
        least = one.get("smallest_detectable_share")
        if one["effect"] == hidden and not one["accepted"] and least is not None and least < 0.7 * share:
            marks.add("excluded")
    return marks


def study(seeds: Sequence[int], only: Sequence[str] = ()) -> dict[str, Counter[str]]:
    counts: dict[str, Counter[str]] = {}
    for label, spoil in SPOILS.items():
        if only and not any(word in label for word in only):
            continue
        for hidden in ("", "grade"):
            counts[f"{label}, {hidden or 'nothing'} hidden"] = count = Counter[str]()
            for seed in seeds:
                case = Case(f"spoilt-{hidden}", (hidden,) if hidden else (), 0.04 if hidden else 0.0, heldout=0)
                world = make(case, seed)
                logs = {run: {key: np.array(values) for key, values in log.items()} for run, log in world.train.items()}
                spoilt = spoil(logs, np.random.default_rng(seed))
                with tempfile.TemporaryDirectory() as name:
                    found, said = diagnosed(logs, Path(name) / "logs")
                marks = judge(found, said, spoilt, hidden, case.share)
                count.update(["tried", *sorted(marks)])
            shown = ", ".join(f"{word} {n}" for word, n in count.items())
            print(f"{label:34} {hidden or 'nothing':8} {shown}", flush=True)
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:3", help="first:end")
    parser.add_argument("--only", nargs="*", default=[], help="words of the kinds of damage")
    given = parser.parse_args(arguments)
    counts = study(range(*map(int, given.seeds.split(":"))), given.only)
    total = sum(counts.values(), Counter())
    wrong = [word for word in total if word.startswith(("wrong", "excluded"))]
    print(f"all: {dict(total)}")
    return int(bool(wrong) or total["named"] < 0.9 * total["tried"])


if __name__ == "__main__":
    sys.exit(main())
