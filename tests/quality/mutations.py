"""Hostile files of every kind: bytes flipped, pieces cut, doubled, zeroed and swapped, numbers made absurd.

``python -m tests.quality.mutations --each 300 --seed 1`` tries that many mutants of each kind of file, each in a
process of its own with 10 s and 3 GB, and prints how they ended. It ends with 1 where there was a traceback, a hang, a
crash, an exit code of our own fault, or a recording that was read short without a word.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SITES = ROOT / "docs" / "examples" / "sites"
LIMIT_S, WALL_S, LIMIT_BYTES = 10, 90.0, 3 << 30
"""Seconds of the processor; seconds of the clock, on a machine that has other things to do; address space."""
RECORDINGS = ("run.bag", "run.mcap", "run.db3", "run.ulg", "run.bin", "run.jsonl")
NUMBERS = (b"nan", b"-inf", b"1e999", b"9" * 400, b"-1", b"0", b"1e-320", b"0x10", b"1_000", b"1,5", b"true", b"[1]")


@dataclass(frozen=True)
class Kind:
    """A file, and the command that reads it; `recording`: its rows are counted."""

    path: Path
    command: Callable[[Path, Path], list[str]]
    recording: bool = False
    text: bool = True


def kinds(folder: Path) -> dict[str, Kind]:
    """Sound files of every kind, made in a folder."""

    def validate(path: Path, out: Path) -> list[str]:
        return ["validate", str(path)]

    def site(path: Path, out: Path) -> list[str]:
        return ["import-site", str(path), "--out", str(out / "site.yaml")]

    def recorded(name: str) -> Callable[[Path, Path], list[str]]:
        return lambda path, out: [
            "import", str(path), "--map", str(folder / f"{name}.yaml"), "--out", str(out / "log.parquet"),
        ]  # fmt: skip

    found = {
        "mission.yaml": Kind(ROOT / "missions" / "pioneer3dx" / "valve_patrol.yaml", validate),
        "robot.yaml": Kind(ROOT / "missionsim" / "robots" / "pioneer3dx.yaml", validate),
        "environment.yaml": Kind(ROOT / "environments" / "trial_site.yaml", validate),
        "map.yaml": Kind(ROOT / "docs" / "maps" / "warthog.yaml", validate),
        "task.yaml": Kind(ROOT / "missions" / "planning" / "inspection.yaml", validate),
        "log.csv": Kind(ROOT / "docs" / "examples" / "patrol_driven.csv", validate),
        "log.parquet": Kind(folder / "log.parquet", validate, text=False),
        "building.yaml": Kind(SITES / "two_floors.building.yaml", site),
        "graph.geojson": Kind(SITES / "yard.geojson", site),
        "hall.lif.json": Kind(SITES / "hall.lif.json", site),
        "track.gpx": Kind(SITES / "hill.gpx", site),
        "rover.plan": Kind(SITES / "rover.plan", site),
        "rover.waypoints": Kind(SITES / "rover.waypoints", site),
        "order.json": Kind(SITES / "order.json", site),
        "lab.json": Kind(SITES / "lab.json", site),
        "streets.graphml": Kind(SITES / "streets.graphml", site),
        "fleet.yaml": Kind(
            SITES / "cart_config.yaml", lambda path, out: ["import-robot", str(path), "--out", str(out / "r.yaml")]
        ),
    }
    for name in RECORDINGS:
        found[name] = Kind(folder / name, recorded(name), True, name == "run.jsonl")
    return found


def prepare(folder: Path) -> None:
    """Write the recordings and a map for each."""
    import shutil

    from missionsim.cli.app import run_command
    from missionsim.logs import read_log
    from missionsim.logs.blocks import write_log
    from tests.logs.bag_writers import write_ardupilot, write_bag, write_ulog
    from tests.logs.loggers import write_states

    write_log(read_log(ROOT / "docs" / "examples" / "ramp_runs" / "run_00.csv"), folder / "log.parquet")
    write_bag(folder / "run.bag", "ros1", 8.0)
    for kind, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        bag = write_bag(folder / f"bag_{suffix}", kind, 8.0)
        shutil.copy(next(bag.rglob(f"*.{suffix}")), folder / f"run.{suffix}")
    write_ulog(folder / "run.ulg")
    write_ardupilot(folder / "run.bin", 20.0)
    write_states(folder / "run.jsonl")
    for name in RECORDINGS:
        run_command(["import", str(folder / name), "--suggest", "--out", str(folder / f"{name}.yaml"), "--quiet"])


def mutant(data: bytes, draw: random.Random, text: bool) -> bytes:
    """One to three changes of a file."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        at, length = draw.randrange(max(1, len(data))), draw.choice((1, 4, 40, 400, 4096))
        piece = data[at : at + length]
        match draw.randrange(9 if text else 7):
            case 0:
                changed = bytearray(data)
                for _ in range(draw.choice((1, 1, 5, 30))):
                    changed[draw.randrange(len(changed))] = draw.randrange(256)
                data = bytes(changed)
            case 1:
                data = data[: max(1, at)]
            case 2:
                data = data[:at] + data[at + length :]
            case 3:
                data = data[:at] + piece * draw.choice((1, 2, 9)) + data[at:]
            case 4:
                data = data[:at] + bytes(len(piece)) + data[at + length :]
            case 5:
                data = data[:at] + draw.randbytes(draw.choice((1, 3, 100))) + data[at:]
            case 6:
                other = draw.randrange(max(1, len(data)))
                data = data[:at] + data[other : other + length] + data[at + length :]
            case 7:
                found = list(re.finditer(rb"-?\d+(?:\.\d+)?", data))
                if found:
                    one = draw.choice(found)
                    data = data[: one.start()] + draw.choice(NUMBERS) + data[one.end() :]
            case _:
                lines = data.split(b"\n")
                draw.shuffle(lines) if draw.random() < 0.1 else lines.insert(
                    draw.randrange(len(lines)), draw.choice(lines)
                )
                data = b"\n".join(lines)
        data = data or b"\n"
    return data


def ended(kind: Kind, path: Path, out: Path) -> str:
    """How the command on a file ends, in a word."""
    pid = os.fork()
    if pid == 0:
        _child(kind, path, out)
    end = time.monotonic() + WALL_S
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        time.sleep(0.002)
    else:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        return "hang"
    code = os.waitstatus_to_exitcode(status)
    told = (out / "told").read_text(encoding="utf-8", errors="replace")
    if code < 0:
        return "hang" if -code == signal.SIGXCPU else "crash"
    if "Traceback" in told or code == 3:
        return "traceback"
    if code in (0, 1, 2):
        left = [p for p in out.iterdir() if p.name != "told"]
        return "half-written" if code == 2 and left else ("read", "read, told", "refused")[code]
    return f"exit {code}"


def _child(kind: Kind, path: Path, out: Path) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S + 1))
    handle = os.open(out / "told", os.O_WRONLY | os.O_CREAT)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    code = 3
    try:
        from missionsim.cli.app import run_command

        code = run_command([*kind.command(path, out), *(["--json", str(out / "json")] if kind.recording else [])])
        sys.stdout.flush()
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def size(out: Path) -> tuple[int, float, bool]:
    """Rows and seconds that were read, and whether something was said about them."""
    data = json.loads((out / "json").read_text(encoding="utf-8"))
    remarks = [remark for run in data["runs"] for remark in run["remarks"]]
    told = any(remark["severity"] != "note" or remark["kind"] in ("gap", "damaged") for remark in remarks)
    return sum(run["rows"] for run in data["runs"]), sum(run["duration_s"] for run in data["runs"]), told


def study(each: int, seed: int, only: Sequence[str], keep: Path | None) -> dict[str, Counter[str]]:
    """Counts of how mutants end, by kind of file."""
    # what a process would load first; rosbags and the like begin no threads
    import networkx
    import pandas
    import pyarrow.csv
    import pyarrow.parquet
    import pymavlink.DFReader
    import pyulog
    import rosbags.highlevel
    import scipy.signal
    import scipy.stats

    import missionsim.cli.exchange
    import missionsim.cli.import_
    import missionsim.cli.run
    import missionsim.importer.mapping
    import missionsim.logs.read

    assert all((networkx, pandas, pyarrow, pymavlink, pyulog, rosbags, scipy, missionsim))

    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pid = os.fork()  # threads of Arrow must not run where processes are forked from
        if pid == 0:
            prepare(folder)
            os._exit(0)
        os.waitpid(pid, 0)
        for label, kind in kinds(folder).items():
            if only and label not in only:
                continue
            draw, data = random.Random(f"{seed} {label}"), kind.path.read_bytes()
            counts[label] = Counter()
            whole: tuple[int, float, bool] = (0, 0.0, False)
            for index in range(each + 1):
                with tempfile.TemporaryDirectory() as scratch:
                    # beside the original, where missions name robots and environments
                    path, out = Path(scratch) / "a" / "b" / kind.path.name, Path(scratch) / "out"
                    path.parent.mkdir(parents=True)
                    out.mkdir()
                    (Path(scratch) / "environments").symlink_to(ROOT / "environments")
                    (path.parent / "inspector.yaml").symlink_to(ROOT / "missions" / "planning" / "inspector.yaml")
                    changed = data if index == 0 else mutant(data, draw, kind.text)
                    path.write_bytes(changed)
                    word = ended(kind, path, out)
                    if kind.recording and index == 0:
                        whole = size(out)
                    elif kind.recording and word == "read":
                        rows, seconds, told = size(out)
                        short = rows < 0.95 * whole[0] or seconds < 0.95 * whole[1]
                        word = "silently short" if short and not told and not whole[2] else word
                    if index == 0 and word not in ("read", "read, told"):
                        raise AssertionError(f"{label}: the sound file is {word}\n{(out / 'told').read_text()}")
                    counts[label][word] += index > 0
                    if keep and word not in ("read", "read, told", "refused"):
                        keep.mkdir(parents=True, exist_ok=True)
                        (keep / f"{index}_{word.replace(' ', '_')}_{label}").write_bytes(changed)
                        (keep / f"{index}_{word.replace(' ', '_')}_{label}.told").write_bytes(
                            (out / "told").read_bytes()
                        )
            print(
                f"{label:18}", ", ".join(f"{word} {count}" for word, count in counts[label].most_common()), flush=True
            )
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--keep", type=Path, help="folder for the files that were read badly")
    given = parser.parse_args(arguments)
    counts = study(given.each, given.seed, given.only, given.keep)
    total = sum(counts.values(), Counter())
    print(f"{'all':18}", ", ".join(f"{word} {count}" for word, count in total.most_common()))
    return int(bool(set(total) - {"read", "read, told", "refused"}))


if __name__ == "__main__":
    sys.exit(main())
