"""Batches that are killed at random moments and resumed: the same bytes, and no process left.

``python -m tests.quality.killed --batches 25 --seed 1`` runs each batch once to its end, then again with SIGKILL,
SIGTERM, SIGHUP or SIGINT at a random moment (perhaps several times, resumed in between), resumes it to its end, and
compares every file of the folder. It ends with 1 where a byte differs, a process outlives its parent for more than
20 s, a resumed batch is refused, or something is left behind.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
PATIENCE_S = 20.0
MARK = "MISSIONSIM_KILLED_STUDY"


def batches(draw: random.Random) -> list[str]:
    """A batch: mission, engine, workers, runs."""
    mission, engine, runs = draw.choice(
        (
            ("missions/pioneer3dx/valve_patrol_as_driven.yaml", "arrays", 30_000),
            ("missions/pioneer3dx/valve_patrol_as_driven.yaml", "simpy", 250),
            ("missions/khepera3/task_b.yaml", "simpy", 200),
        )
    )
    workers = draw.choice((1, 2, 3))
    return ["montecarlo", str(ROOT / mission), "--engine", engine, "--runs", str(runs), "--workers", str(workers)]


def left(mark: str) -> list[int]:
    """Processes that run on with a mark in their environment."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                if f"{MARK}={mark}".encode() in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
            except OSError:
                continue
    return found


def hashes(folder: Path) -> dict[str, str]:
    """Every file of a folder, hidden ones too, by its bytes."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def started(arguments: Sequence[str], mark: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "missionsim", *arguments, "--quiet"],
        cwd=ROOT,
        env={**os.environ, MARK: mark},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def tried(arguments: Sequence[str], folder: Path, draw: random.Random, mark: str) -> Counter[str]:
    """What happens to one batch, in words that are counted."""
    found: Counter[str] = Counter()
    begun = time.monotonic()
    process = started([*arguments, "--out", str(folder / "whole")], mark)
    _, told = process.communicate()
    whole_s = time.monotonic() - begun
    if process.returncode:
        raise AssertionError(f"{arguments}: exit {process.returncode}\n{told.decode()}")
    out = folder / "killed"
    for _ in range(draw.choice((1, 1, 2, 3))):
        process = started([*arguments, "--out", str(out), "--resume"], mark)
        how = draw.choice(SIGNALS)
        try:
            process.wait(draw.uniform(0.05, 1.0) * whole_s)
            found["ended before"] += 1
        except subprocess.TimeoutExpired:
            process.send_signal(how)
            found[f"killed by {how.name}"] += 1
        # pipes of the killed process end with its workers
        end = time.monotonic() + PATIENCE_S
        while left(mark) and time.monotonic() < end:
            time.sleep(0.05)
        process.communicate()
        for one in left(mark):
            found["PROCESS LEFT"] += 1
            os.kill(one, signal.SIGKILL)
        found["blocks there" if list(out.glob("blocks/*.parquet")) else "no block yet"] += 1
    process = started([*arguments, "--out", str(out), "--resume"], mark)
    _, told = process.communicate()
    if process.returncode:
        found[f"RESUMED WITH EXIT {process.returncode}"] += 1
        print(told.decode())
    else:
        same = hashes(out) == hashes(folder / "whole")
        found["same bytes" if same else "OTHER BYTES"] += 1
    others = sorted(path.name for path in folder.iterdir() if path.name not in ("whole", "killed"))
    if others:
        found["LEFT BEHIND"] += 1
        print(others)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batches", type=int, default=25)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    total: Counter[str] = Counter()
    for number in range(given.batches):
        draw = random.Random(f"{given.seed} {number}")
        command = batches(draw)
        with tempfile.TemporaryDirectory() as name:
            found = tried(command, Path(name), draw, f"{os.getpid()}-{number}")
        total += found
        words = ", ".join(f"{word} {count}" for word, count in found.items())
        print(f"{number:3} {Path(command[1]).stem:24} {' '.join(command[2:]):44} {words}", flush=True)
    print("all:", ", ".join(f"{word} {count}" for word, count in total.most_common()))
    return int(any(word.isupper() or word.startswith("RESUMED") for word in total))


if __name__ == "__main__":
    sys.exit(main())
