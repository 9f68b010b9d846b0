"""Imports beside the bare readers of others, in one run: the processor's time, the best of three turns."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from missionsim.cli.app import run_command
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs.write import write_log
from tests.logs.bag_writers import write_bag

MOST_CSV, MOST_BAG = 3.0, 2.0


def _ratio(ours: Callable[[], object], theirs: Callable[[], object]) -> float:
    """Least processor time of one over that of the other, measured in turns, without the heap that other tests left."""
    found: dict[Callable[[], object], list[float]] = {ours: [], theirs: []}
    gc.collect()
    gc.freeze()
    try:
        for _ in range(3):
            for work, times in found.items():
                begin = time.process_time()
                work()
                times.append(time.process_time() - begin)
    finally:
        gc.unfreeze()
    return min(found[ours]) / min(found[theirs])


@pytest.mark.benchmark_ratio
def test_csv_beside_pandas(tmp_path: Path) -> None:
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

    assert _ratio(ours, lambda: pd.read_csv(source).to_parquet(tmp_path / "theirs.parquet")) <= MOST_CSV


@pytest.mark.benchmark_ratio
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_bag_beside_its_reader(tmp_path: Path, kind: str) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, 300.0)
    assert run_command(["import", str(bag), "--suggest", "--out", str(tmp_path / "map.yaml"), "--quiet"]) == 0
    spec = load_map(tmp_path / "map.yaml")

    def bare() -> None:
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, _, raw in reader.messages():
                reader.deserialize(raw, connection.msgtype)

    assert _ratio(lambda: import_source(bag, spec), bare) <= MOST_BAG
