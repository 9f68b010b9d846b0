"""Runs that nobody spoilt: how many are left out all the same?

``python -m tests.rough.clean --seeds 0:1`` asks `admit` about the cases of the smooth world, the regimes, the rough
worlds, and, where they are, the practice logs and the logs of real robots. It prints what was left out and counts.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.inputs.loading import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.logs import read_logs
from missionsim.runs.admit import admit
from missionsim.runs.run import Run
from tests.hidden_effects.study import ALL_CASES
from tests.hidden_effects.world import make, write_csv
from tests.rough import regimes
from tests.rough.world import WORLDS, write

SHARED = Path(__file__).resolve().parents[2].parent / "shared"
ROBOTS = Path(__file__).resolve().parents[1] / "hidden_effects" / "robots"
REAL = {"i3_trips": ("1270 kg", "ackermann"), "husky_floors": ("50 kg", "skid_steer")}


def _model(robot: str | Path) -> PowerModel:
    own = ROBOTS / f"{robot}.yaml"
    return build_power_model(load_robot(own if own.exists() else robot))


def _calibrated(logs: Sequence[Run], mass: str, drive: str, folder: Path) -> PowerModel:
    new = NewRobot("own", "c2*v**2 + c3*v + c4", mass=mass, drive=drive)
    (folder / "own.yaml").write_text(calibrate_new(new, list(logs)).text, encoding="utf-8")
    return _model(folder / "own.yaml")


def sources(seed: int, folder: Path) -> Iterator[tuple[str, str, list[Run], PowerModel]]:
    """Kind, name, runs and model of each set of clean logs."""
    for case in ALL_CASES.values():
        world = make(case, seed)
        own = folder / case.name
        own.mkdir()
        for name, log in world.train.items():
            write_csv(log, own / f"{name}.csv")
        yield "smooth", case.name, read_logs([own]), _model(case.robot)
    for label, regime in regimes.REGIMES.items():
        for effect in ("", *regimes.EFFECTS):
            frames, told = regimes.logs(regime, effect, 0.05, seed)
            own = folder / f"{label} {effect}"
            own.mkdir()
            for number, frame in enumerate(frames):
                frame.to_csv(own / f"run_{number:02d}.csv", index=False)
            (own / "other.yaml").write_text(regimes.robot_file(told, regime.file_sd), encoding="utf-8")
            yield "regimes", own.name, read_logs(sorted(own.glob("*.csv"))), _model(own / "other.yaml")
    for kind, world in WORLDS.items():
        own = folder / f"rough {kind}"
        own.mkdir()
        runs = read_logs([write(kind, seed, own)[0]])
        yield "rough", kind, runs, _calibrated(runs, f"{world.mass_kg} kg", world.drive, own)
    for answer in sorted(SHARED.glob("practice/*/answer.json")):
        told = str(json.loads(answer.read_text(encoding="utf-8")).get("robot", "pioneer3dx"))
        for part in ("train", "heldout"):
            yield "practice", f"{answer.parent.name} {part}", read_logs([answer.parent / part]), _model(told)
    for name, (mass, drive) in REAL.items():
        for part in ("train", "heldout"):
            if (SHARED / "data" / name / part).exists():
                runs = read_logs([SHARED / "data" / name / part])
                yield "real", f"{name} {part}", runs, _calibrated(runs, mass, drive, folder)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:1", help="first:end")
    counts: Counter[str] = Counter()
    for seed in range(*map(int, parser.parse_args(arguments).seeds.split(":"))):
        with tempfile.TemporaryDirectory() as name:
            for kind, label, runs, model in sources(seed, Path(name)):
                try:
                    told = admit(runs, model)[1]
                except InputError as error:
                    told = [str(error)]
                counts.update({f"{kind} sets": 1, f"{kind} runs": len(runs), f"{kind} left out": len(told)})
                for line in told:
                    print(f"{kind} {seed} {label}: {line}", flush=True)
    print(dict(counts))
    return int(any(counts[word] for word in counts if word.endswith("left out")))


if __name__ == "__main__":
    sys.exit(main())
