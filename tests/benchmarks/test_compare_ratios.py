"""Replay and comparison of long Parquet logs: time against pandas reading the same file, and bounded memory.

The small file runs with the suite. The full size, 10 million rows:
``python -m pytest -m study -s tests/benchmarks/test_compare_ratios.py``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.benchmark_ratio

CHUNK = 200_000
PANDAS = """
import json, sys, time
import pandas
import pyarrow.parquet
start, busy = time.perf_counter(), time.process_time()
pandas.read_parquet(sys.argv[1])
print(json.dumps({"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - busy}))
"""
OURS = """
import json, resource, sys, threading, time
from missionsim.compare import compare_files
import psutil, pyarrow.parquet, missionsim.logs, missionsim.inputs.power
process, own = psutil.Process(), []
def watch():
    while True:
        memory = process.memory_info(); own.append(memory.rss - memory.shared); time.sleep(0.02)
threading.Thread(target=watch, daemon=True).start()
start, busy = time.perf_counter(), time.process_time()
result = compare_files("pioneer3dx", [sys.argv[1]])
print(json.dumps({"wall_s": time.perf_counter() - start, "cpu_s": time.process_time() - busy, "rows": result.rows,
                  "peak_mb": max(own) / 1e6, "rmse_w": result.batteries["robot"].power_rmse_w}))
"""


def write_log(path: Path, rows: int) -> None:
    """A log of one robot with fourteen columns at 10 Hz: motion, slope, load, surface, temperature, pose."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    rng = np.random.default_rng(1)
    writer = None
    for first in range(0, rows, CHUNK):
        size = min(CHUNK, rows - first)
        time_s = (np.arange(first, first + size) + 0.5) * 0.1
        speed = np.where(time_s % 60 < 50, np.abs(0.4 + 0.1 * np.sin(time_s / 7) + rng.normal(0, 0.01, size)), 0.0)
        slope = 0.05 * np.sin(time_s / 97)
        power = 6.25 * speed**2 + 9.79 * speed + np.where(speed > 0, 3.66, 2.67) + 2.34
        table = pa.table(
            {
                "time_s": time_s,
                "power_robot_w": power + 30 * slope * speed + rng.normal(0, 0.3, size),
                "speed_m_s": speed,
                "accel_m_s2": np.gradient(speed, time_s),
                "yaw_rate_rad_s": np.where((time_s % 23 < 3) & (speed > 0), 0.5, 0.0),
                "slope_rad": slope,
                "payload_kg": np.where(time_s // 600 % 2 > 0, 4.0, 0.0),
                "surface": pa.array(np.where(time_s // 300 % 2 > 0, "tile", "carpet")).dictionary_encode(),
                "temp_ambient_c": 20 + 5 * np.sin(time_s / 1e4),
                "cpu_load": rng.uniform(0, 1, size),
                "on_laser": np.ones(size, dtype=np.int64),
                "on_kinect": np.zeros(size, dtype=np.int64),
                "x_m": 10 * np.sin(time_s / 50),
                "y_m": 5 * np.cos(time_s / 80),
            }
        )
        writer = writer or parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()


def measured(script: str, path: Path) -> dict[str, float]:
    """Run a script in a process of its own, so that nothing is warm and memory is its own."""
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def ratios(path: Path, times: int) -> tuple[dict[str, float], dict[str, float]]:
    """Least time of ours over least time of pandas, by clock and by processor, the two run in turn; and ours."""
    theirs, ours = [], []
    for _ in range(times):
        theirs.append(measured(PANDAS, path))
        ours.append(measured(OURS, path))
    best = {key: (min(o[key] for o in ours), min(t[key] for t in theirs)) for key in ("wall_s", "cpu_s")}
    for key, (mine, other) in best.items():
        print(f"{key}: pandas reads in {other:.2f}, read and compared in {mine:.2f}, ratio {mine / other:.2f}")
    print(f"own memory {max(o['peak_mb'] for o in ours):.0f} MB")
    return {key: mine / other for key, (mine, other) in best.items()}, ours[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("long_logs")


@pytest.mark.long
def test_bounded_memory_and_linear_time(folder: Path) -> None:
    small, large = folder / "small.parquet", folder / "large.parquet"
    write_log(small, 300_000)
    write_log(large, 750_000)
    a, b = measured(OURS, small), measured(OURS, large)
    print(
        f"300,000 rows: {a['wall_s']:.2f} s, {a['peak_mb']:.0f} MB; 750,000 rows: {b['wall_s']:.2f} s, "
        f"{b['peak_mb']:.0f} MB"
    )
    assert b["rows"] == 2.5 * a["rows"]
    # the second file has 50 MB more of numbers
    assert b["peak_mb"] - a["peak_mb"] < 30.0
    assert b["cpu_s"] < 2.8 * a["cpu_s"]


@pytest.mark.study
def test_ten_million_rows_within_three_times_pandas(folder: Path) -> None:
    path = folder / "ten_million.parquet"
    write_log(path, 10_000_000)
    found, ours = ratios(path, 3)
    assert ours["rows"] == 10_000_000
    assert ours["peak_mb"] < 600.0
    assert found["wall_s"] <= 3.0
    assert found["cpu_s"] <= 3.0
