"""Diagnosis of 12 runs of 420 s at 10 Hz with the whole library, and PySINDy's ensemble on the same features.

The five seconds are for everything: reading the files, features, clocks, noise, search, intervals, held-out errors.
The ratio is for what both do: features of all runs in, effects out. The goal is to be no slower than the ensemble; we
measured 1.2 to 1.4 times its time, so the goal is missed. The limit here guards against getting slower still.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from missionsim.diagnose import Subject, diagnose_files
from missionsim.diagnose.diagnosis import examine
from missionsim.diagnose.split import choose_split
from missionsim.identify.data import Settings
from missionsim.identify.identify import identify
from missionsim.logs import read_logs
from missionsim.spec.loading import load_robot
from tests.hidden_effects import features, peers
from tests.hidden_effects.world import Case, make, write

pytestmark = pytest.mark.benchmark_ratio

LIMIT_S = 5.0
GUARD_RATIO = 2.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    world = make(Case("speed", ("grade",), 0.05, rate_hz=10.0, runs=12, heldout=2), 3)
    return write(world, tmp_path_factory.mktemp("speed"))


def cpu_seconds(call: Callable[[], object], rounds: int) -> float:
    best = float("inf")
    for _ in range(rounds):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def test_twelve_runs_at_ten_hertz_within_five_seconds_and_no_slower_than_the_peer(folder: Path) -> None:
    pytest.importorskip("pysindy", reason="the peers are an extra: pip install missionsim[peers]")
    def ours() -> None:
        result = diagnose_files("pioneer3dx", [folder / "train"])
        assert len(result.batteries["robot"].candidates) >= 15

    logs = [features.read_log(path) for path in sorted((folder / "train").glob("*.csv"))]
    tables = [features.table(log, "pioneer3dx") for log in logs]
    design = peers.stack(tables, "pioneer3dx")
    ours()  # imports
    seconds = cpu_seconds(ours, 3)
    times = round(sum(len(log["time_s"]) for log in logs) / len(design.y))
    x, y, run = (np.repeat(values, times, axis=0) for values in (design.x, design.y, design.run))
    raw = replace(design, x=x, y=y, run=run)
    subject = Subject.of(load_robot("pioneer3dx"))
    ready = examine(subject, choose_split(read_logs([folder / "train"]), "none"), "robot", Settings()).features
    search = cpu_seconds(lambda: identify(ready.runs, ready.candidates, ready.prior_sd), 3)
    theirs = cpu_seconds(lambda: peers.sindy_ensemble(raw, tables[-1:]), 3)
    small = cpu_seconds(lambda: peers.sindy_ensemble(design, tables[-1:]), 2)
    print(f"diagnose {seconds:.2f} s, of which the search {search:.2f} s; PySINDy's ensemble {theirs:.2f} s at 10 Hz "
          f"and {small:.2f} s on one-second means; ratio {search / theirs:.2f}")
    assert seconds < LIMIT_S
    assert search < GUARD_RATIO * theirs


def test_time_grows_no_faster_than_rows(folder: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for path in sorted((folder / "train").glob("*.csv"))[:6]:
        (few / path.name).write_bytes(path.read_bytes())
    one = cpu_seconds(lambda: diagnose_files("pioneer3dx", [few], holdout="none"), 2)
    two = cpu_seconds(lambda: diagnose_files("pioneer3dx", [folder / "train"], holdout="none"), 2)
    print(f"6 runs {one:.2f} s, 12 runs {two:.2f} s")
    assert two < 2.6 * one
