"""Start-up: `validate` and `run` without plots against the bare interpreter with the libraries that they need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.conftest import InTurns

pytestmark = pytest.mark.benchmark_ratio
BARE = [sys.executable, "-c", "import simpy, numpy, yaml, pydantic"]
OURS = [sys.executable, "-c", "from missionsim.cli import main; main()"]
MOST = 3.0


def seconds(command: list[str]) -> float:
    """Processor time of a command with the start of its process: other work on the machine adds little to it."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return used.ru_utime + used.ru_stime


@pytest.mark.long
@pytest.mark.parametrize("command", ["validate", "run"])
def test_start_up_within_three_times_the_bare_interpreter(root: Path, command: str, in_turns: InTurns) -> None:
    mission = str(root / "missions" / "pioneer3dx" / "valve_patrol.yaml")
    ours = [*OURS, command, mission]
    ours_s, bare_s = in_turns(lambda: seconds(ours), lambda: seconds(BARE), MOST)
    ratio = ours_s / bare_s
    print(f"{command}: {ratio:.2f} times the bare interpreter")
    assert ratio < MOST
