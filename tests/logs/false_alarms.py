"""How many good logs are warned of in vain: every measured log at hand, and those of the little worlds.

``python -m tests.logs.false_alarms --seeds 0:2`` reads them as ``import``, ``validate`` and ``compare`` do (with the
robot where there is a file of it) and prints, for each set, how many of its logs got a warning and which. A gap that is
told is there (the little worlds leave rows out), and counts apart.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from missionsim.importer.mapping import import_source
from missionsim.importer.suggest import suggest_map
from missionsim.inputs import load_robot
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, read_log
from tests import hidden_effects
from tests.hidden_effects import world
from tests.hidden_effects.study import ALL_CASES
from tests.rough import world as rough

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"


def measured(folder: Path) -> Iterator[tuple[str, list[LogTable]]]:
    """Every measured log, by the shipped maps or by suggested ones."""
    data, maps = SHARED / "data", ROOT / "docs" / "maps"
    yield "car", [read_log(path) for path in sorted((data / "i3_trips").glob("*/trip*.csv"))]
    yield "floors", [read_log(path) for path in sorted((data / "husky_floors").glob("*/*.csv"))]
    for name, source in (
        ("warthog", data / "warthog_drive"),
        ("turtlebot3", data / "turtlebot3_msr2021" / "tb3_power_2hz.csv"),
        ("ase_rover", data / "ase_rover" / "ase_rover_10hz.csv"),
    ):
        yield name, import_source(source, load_map(maps / f"{name}.yaml"))
    raw = sorted((data / "turtlebot3_msr2021" / "raw_examples").glob("*DATA.TXT"))
    yield "turtlebot3 raw", import_source(raw, load_map(maps / "turtlebot3_raw.yaml"))
    for path in [*sorted((data / "i3_trips" / "raw").glob("*.csv")), *sorted((data / "wheel_ride").glob("*.csv"))]:
        made = folder / f"{path.stem}.yaml"
        made.write_text(suggest_map([path]).text, encoding="utf-8")
        yield f"{path.parent.name} {path.stem}, suggested map", import_source(path, load_map(made))


def worlds(folder: Path, seeds: range) -> Iterator[tuple[str, list[LogTable]]]:
    """Logs of the little worlds as their robots' owners would read them."""
    practice = sorted((SHARED / "practice").glob("*/*/*.csv"))
    yield "practice", [read_log(path, robot=load_robot("pioneer3dx")) for path in practice]
    shipped = Path(hidden_effects.__file__).parent / "robots"
    for seed in seeds:
        for number, case in enumerate(ALL_CASES.values()):
            if number % 7 != seed % 7:
                continue
            made = world.write(world.make(case, seed), folder / f"{seed}")
            file = shipped / f"{case.robot}.yaml"
            robot = load_robot(str(file) if file.exists() else case.robot)
            yield f"world: {case.design}", [read_log(path, robot=robot) for path in sorted(made.glob("*/*.csv"))]
        for kind in rough.WORLDS:
            train, held = rough.write(kind, seed, folder / f"{seed}_{kind}", 4)
            yield f"rough: {kind}", [read_log(path) for path in sorted([*train.glob("*.csv"), *held.glob("*.csv")])]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:2", help="a:b of the little worlds")
    first, last = map(int, parser.parse_args(arguments).seeds.split(":"))
    logs, warned, gaps, told = Counter[str](), Counter[str](), Counter[str](), dict[str, list[str]]()
    with tempfile.TemporaryDirectory() as name:
        for part in (measured(Path(name)), worlds(Path(name), range(first, last))):
            for label, read in part:
                for log in read:
                    every = [remark for remark in log.remarks if remark.severity != "note"]
                    remarks = [remark for remark in every if remark.kind != "gap"]
                    logs[label] += 1
                    gaps[label] += len(every) > len(remarks)
                    warned[label] += bool(remarks)
                    told.setdefault(label, []).extend(f"{log.run}: {remark}" for remark in remarks)
    for label, count in logs.items():
        print(f"{label:40} {count:5} logs, {warned[label]} warned of, {gaps[label]} told of a gap")
        for line in told[label]:
            print(f"    {line}")
    print(f"{'all':40} {logs.total():5} logs, {warned.total()} warned of, {gaps.total()} told of a gap")
    return int(warned.total() > logs.total() / 20)


if __name__ == "__main__":
    sys.exit(main())
