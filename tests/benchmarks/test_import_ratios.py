"""Imports beside the bare readers of others, in one run, by the processor's time."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from missionsim.cli.app import run_command
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs.blocks import write_log
from tests.benchmarks.conftest import MISSIONSIM, InTurns, cost
from tests.logs.bag_writers import write_bag

MOST_CSV, MOST_BAG = 3.0, 2.0
KINDS = ("ros1", "sqlite3", "mcap")
ONE_QUICK = ["mcap", *(pytest.param(kind, marks=pytest.mark.long) for kind in KINDS if kind != "mcap")]


@pytest.mark.long
@pytest.mark.benchmark_ratio
def test_csv_beside_pandas(tmp_path: Path, in_turns: InTurns) -> None:
    t = np.arange(200_000) * 0.05
    v = np.clip(0.5 + 0.4 * np.sin(t / 9), 0.0, None)
    frame = {"time": t, "volts": 25 - 0.1 * v, "amps": 1 + v, "v [km/h]": 3.6 * v, "w": np.sin(t / 7)}
    source, made = tmp_path / "day.csv", tmp_path / "map.yaml"
    pd.DataFrame(frame).round(4).to_csv(source, index=False)
    assert run_command(["import", str(source), "--suggest", "--out", str(made), "--quiet"]) == 0
    spec = load_map(made)

    def ours() -> None:
        (log,) = import_source(source, spec)
        write_log(log, tmp_path / "ours.parquet")

    mine, other = in_turns(ours, lambda: pd.read_csv(source).to_parquet(tmp_path / "theirs.parquet"), MOST_CSV)
    print(f"ratio {mine / other:.2f}")
    assert mine / other <= MOST_CSV


@pytest.mark.long
@pytest.mark.benchmark_ratio
@pytest.mark.parametrize("kind", ONE_QUICK)
def test_bag_beside_its_reader(tmp_path: Path, kind: str, in_turns: InTurns) -> None:
    """Against a loop over the wanted topics that does not even look into the messages."""
    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, 30.0, often=5, picture_bytes=10_000)
    assert run_command(["import", str(bag), "--suggest", "--out", str(tmp_path / "map.yaml"), "--quiet"]) == 0
    spec = load_map(tmp_path / "map.yaml")
    mine, other = in_turns(lambda: import_source(bag, spec), lambda: iterate(bag), MOST_BAG)
    print(f"ratio {mine / other:.2f}")
    assert mine / other <= MOST_BAG


def iterate(bag: Path) -> int:
    """Messages of the wanted topics."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [c for c in reader.connections if c.topic in ("/battery", "/odom", "/imu")]
        return sum(1 for _ in reader.messages(connections=wanted))


@pytest.mark.parametrize("kind", ONE_QUICK)
def test_memory_is_that_of_the_numbers(tmp_path: Path, kind: str) -> None:
    """Pictures of 8 and 24 MB in a bag take no memory; three times the messages take what their numbers need."""
    most = []
    for seconds in (8.0, 24.0):
        name = f"run_{seconds:g}"
        bag = write_bag(tmp_path / (f"{name}.bag" if kind == "ros1" else name), kind, seconds, picture_bytes=100_000)
        out = tmp_path / f"{name}.yaml"
        assert run_command(["import", str(bag), "--suggest", "--out", str(out), "--quiet"]) == 0
        tracemalloc.start()
        import_source(bag, load_map(out))
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    print(f"{most[0] / 1e6:.2f} and {most[1] / 1e6:.2f} MB")
    assert most[1] < 12e6
    assert most[1] - most[0] < 40 * (10 + 20 + 2) * 200


@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_a_gigabyte(tmp_path: Path, kind: str) -> None:
    """20 minutes of odometry at 50 Hz, an IMU at 100 Hz, a battery at 10 Hz, and 960 MB of pictures."""
    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, 1200.0, often=5, picture_bytes=80_000)
    made, log = tmp_path / "map.yaml", tmp_path / "log.parquet"
    iterating = "from tests.benchmarks.test_import_ratios import *; iterate(Path(sys.argv[1]))"
    costs = {
        "listing": cost(MISSIONSIM, "import", bag),
        "suggestion": cost(MISSIONSIM, "import", bag, "--suggest", "--out", made),
        "import": cost(MISSIONSIM, "import", bag, "--map", made, "--out", log),
        "bare iteration": cost(iterating, bag),
    }
    for name, spent in costs.items():
        print(f"{kind}: {name} {spent}")
    assert log.exists()
    assert max(spent.memory_gb for spent in costs.values()) < 0.4
    assert costs["import"].cpu_s <= MOST_BAG * costs["bare iteration"].cpu_s
