"""What large work takes, as commands in processes of their own, beside the least that does a part of it by hand.

``python -m pytest -s -m study tests/benchmarks/test_large.py`` prints these rows of docs/performance.md.
"""

from __future__ import annotations

import csv
import json
import math
from importlib import metadata, resources
from pathlib import Path

import numpy as np
import pytest

from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from missionsim.results.write import tables
from tests.benchmarks import patrol
from tests.benchmarks.conftest import MISSIONSIM, cost, seconds_of
from tests.hidden_effects.world import Case, make, write

pytestmark = [pytest.mark.study, pytest.mark.benchmark_ratio]
BLOCK = 40
"""Segments that the patrol repeats."""
MOST_MB, MOST_PAGE_MB = 660.0, 1.5


def test_run_with_tables_of_50_000_segments(tmp_path: Path) -> None:
    """All tables as CSV, beside the standard library's writer of the same cells and a run without tables."""
    spent = {}
    for segments in (12_500, 50_000):
        folder = tmp_path / str(segments)
        folder.mkdir()
        mission = patrol.write(folder, 0.14, segments // BLOCK)
        spent[segments] = cost(MISSIONSIM, "run", mission, "--quiet", "--out", folder / "out")
        print(f"run --out of {segments} segments: {spent[segments]}")
    plain = cost(MISSIONSIM, "run", mission, "--quiet")
    made = tables(simulate(load_mission(mission)))

    def bare() -> None:
        for name, table in made.items():
            with (tmp_path / f"{name}.csv").open("w", newline="", encoding="utf-8") as handle:
                csv.writer(handle).writerows(zip(*table.values(), strict=True))

    theirs = seconds_of(bare)
    cells = sum(len(table) * len(next(iter(table.values()))) for table in made.values())
    ratio = spent[50_000].cpu_s / theirs
    growth = math.log(spent[50_000].cpu_s / spent[12_500].cpu_s) / math.log(4.0)
    print(f"without tables {plain}; {cells / 1e6:.1f} million cells by a bare writer {theirs:.1f} s: {ratio:.1f} times")
    print(f"exponent {growth:.2f}")
    assert ratio <= 4.0
    assert growth <= 1.1
    assert spent[50_000].memory_gb <= 0.8


def test_100_000_segments(tmp_path: Path) -> None:
    """Beside the same mission by hand in SimPy: one mission, no files, no intervals kept; the same energies."""
    script = "from missionsim.engine.simulate import *; from missionsim.inputs.loading import load_mission; "
    script += "from tests.benchmarks.test_engine_ratios import energies; "
    script += "print(*energies(simulate(load_mission(sys.argv[1]))))"
    times = 100_000 // BLOCK
    (tmp_path / "one").mkdir()
    empty = cost(script, patrol.write(tmp_path / "one", 0.14))
    ours = cost(script, patrol.write(tmp_path, 0.14, times))
    found: list[float] = []
    theirs = seconds_of(lambda: found.extend(patrol.by_hand(0.14, times)))
    assert found == pytest.approx([float(text) for text in ours.said], rel=1e-9)
    seconds, memory = ours.cpu_s - empty.cpu_s, ours.memory_gb - empty.memory_gb
    print(f"100,000 segments: {seconds:.1f} s and {memory:.2f} GB more than 40 ({empty}); whole process {ours}")
    print(f"by hand in SimPy {theirs:.1f} s: {seconds / theirs:.1f} times")
    assert seconds <= 22.0 * theirs
    assert memory <= 0.7


def test_a_thousand_alternatives(root: Path, tmp_path: Path) -> None:
    """Beside so many runs of missions each loaded alone."""
    mission = root / "missions/pioneer3dx/corridor_forward_motion_50cm_s.yaml"
    speeds = ",".join(f"{0.3 + 0.0003 * i:.4f}" for i in range(999))
    words = (mission, "--vary", f"defaults.speed={speeds}", "--quiet", "--json", tmp_path / "found.json")
    ours, two = cost(MISSIONSIM, "whatif", *words), cost(MISSIONSIM, "whatif", *words, "--workers", 2)
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert len(found["alternatives"]) == 1000
    alone = 50.0 * seconds_of(lambda: [simulate(load_mission(mission, [("defaults.speed", 0.4)])) for _ in range(20)])
    print(f"1,000 alternatives: {ours}; with two processes {two.clock_s:.1f} s by the clock")
    print(f"each loaded alone {alone:.1f} s: {alone / ours.cpu_s:.1f} times as long")
    assert ours.cpu_s <= alone / 2.5
    assert ours.memory_gb <= 0.3


@pytest.mark.parametrize("megabytes", [113, 356])
def test_import_of_csv(megabytes: int, tmp_path: Path) -> None:
    """Beside pandas' read of the file and its Parquet."""
    import pyarrow as pa
    import pyarrow.csv

    source, made = tmp_path / "day.csv", tmp_path / "map.yaml"
    t = np.arange(megabytes * 1_000_000 // 41) * 0.05
    v = np.clip(0.5 + 0.4 * np.sin(t / 9), 0.0, None)
    columns = {"time": t, "volts": 25 - 0.1 * v, "amps": 1 + v, "v [km/h]": 3.6 * v, "w": np.sin(t / 7)}
    pa.csv.write_csv(pa.table({name: np.round(values, 4) for name, values in columns.items()}), source)
    assert source.stat().st_size == pytest.approx(megabytes * 1e6, rel=0.1)
    cost(MISSIONSIM, "import", source, "--suggest", "--out", made, "--quiet")
    words = ("import", source, "--map", made, "--out", tmp_path / "ours.parquet", "--quiet")
    peer = "import pandas; pandas.read_csv(sys.argv[1]).to_parquet(sys.argv[2])"
    turns = [(cost(MISSIONSIM, *words), cost(peer, source, tmp_path / "theirs.parquet")) for _ in range(3)]
    ours, theirs = (min(turn, key=lambda one: one.cpu_s) for turn in zip(*turns, strict=True))
    print(f"CSV of {source.stat().st_size / 1e6:.0f} MB: {ours}; pandas {theirs}")
    print(f"{ours.cpu_s / theirs.cpu_s:.2f} times the time, {ours.memory_gb / theirs.memory_gb:.2f} times the memory")
    assert ours.cpu_s <= 3.0 * theirs.cpu_s
    assert ours.memory_gb <= 0.6


def test_size_of_a_report_page(tmp_path: Path) -> None:
    """Pages of eleven runs with everything that they need, beside the chart script as it comes."""
    import gzip

    folder = write(make(Case("pages", ("grade",), 0.05, runs=11, heldout=0), 3), tmp_path) / "train"
    script = resources.files("missionsim.report").joinpath("plotly", "plotly-basic.min.js.gz").read_bytes()
    bundle = len(gzip.decompress(script)) / 1e6
    for command in ("compare", "diagnose"):
        page = tmp_path / f"{command}.html"
        cost(MISSIONSIM, command, "--robot", "pioneer3dx", folder, "--quiet", "--report", page, codes=(0, 1))
        size = page.stat().st_size / 1e6
        print(f"page of {command}, eleven runs: {size:.2f} MB, {size / bundle:.2f} times Plotly's basic bundle")
        assert size <= MOST_PAGE_MB


def sizes_mb() -> dict[str, tuple[float, float]]:
    """Of what an installation without extras brings: MB of all files, and of those that are bytecode."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    found: dict[str, tuple[float, float]] = {}
    waiting = [("missionsim", "")]
    seen = set()
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        package = metadata.distribution(name)
        files = [(file, file.locate()) for file in package.files or ()]
        sizes = [
            (Path(path).stat().st_size / 1e6, file.suffix == ".pyc") for file, path in files if Path(path).is_file()
        ]
        found[name] = (sum(size for size, _ in sizes), sum(size for size, compiled in sizes if compiled))
        for text in package.requires or ():
            wanted = Requirement(text)
            if wanted.marker is None or wanted.marker.evaluate({"extra": extra}):
                waiting += [(canonicalize_name(wanted.name), one) for one in ("", *wanted.extras)]
    return found


def test_size_of_an_installation() -> None:
    """What pip brings, beside the four libraries that hold numbers and tables."""
    found = sizes_mb()
    whole, compiled = (sum(size[i] for size in found.values()) for i in (0, 1))
    four = sum(found[name][0] for name in ("numpy", "scipy", "pandas", "pyarrow"))
    largest = sorted(found, key=lambda name: -found[name][0])[:8]
    print(f"{len(found)} packages, {whole:.0f} MB, {compiled:.0f} of it bytecode; {whole / four:.2f} times those four")
    print(", ".join(f"{name} {found[name][0]:.0f}" for name in largest))
    assert whole <= MOST_MB
