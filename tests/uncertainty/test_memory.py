"""Memory of a batch does not grow with the number of runs, nor with the length of the mission."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MEASURED = (
    "import resource, sys\nfrom missionsim.cli.app import run_command\n"
    "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
    "code = run_command(sys.argv[1:])\n"
    "print('PEAK', code, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
)


def peak_mb(folder: Path, segments: int, runs: int, engine: str) -> float:
    """Greatest memory [MB] of a batch whose every segment has uncertain numbers and changing speeds."""
    mission = folder / f"{segments}.yaml"
    pair = (
        "  - drive: {distance: {value: 6 m, sd: 3 %}, speed: {value: 0.5 m/s, sd: 5 %}, profile: trapezoidal}\n"
        "  - wait: {duration: {value: 3 s, sd: 10 %}}\n"
    )
    mission.write_text(f"kind: mission\nname: long\nrobot: pioneer3dx\nsegments:\n{pair * (segments // 2)}", "utf-8")
    command = ["montecarlo", str(mission), "--engine", engine, "--runs", str(runs), "--sobol", "0", "--quiet"]
    done = subprocess.run([sys.executable, "-c", MEASURED, *command], capture_output=True, text=True, cwd=ROOT)
    _, code, kilobytes = next(line for line in done.stdout.splitlines() if line.startswith("PEAK")).split()
    assert code == "0", done.stderr
    return int(kilobytes) / (1024.0 if sys.platform != "darwin" else 1024.0**2)


@pytest.mark.long
def test_memory_of_a_batch_as_arrays_over_segments(tmp_path: Path) -> None:
    short, long = (peak_mb(tmp_path, segments, 1200, "arrays") for segments in (30, 200))
    assert long < short + 100.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("segments", "runs", "engine"), [(500, 20_000, "arrays"), (2000, 20_000, "arrays"), (8000, 20, "simpy")]
)
def test_long_missions_stay_below_a_gigabyte(tmp_path: Path, segments: int, runs: int, engine: str) -> None:
    assert peak_mb(tmp_path, segments, runs, engine) < 1024.0
