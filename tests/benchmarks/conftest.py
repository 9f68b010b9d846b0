"""Two things measured in turns: what else the machine does can only add, and meets both alike."""

from __future__ import annotations

import gc
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

InTurns = Callable[[Callable[[], object], Callable[[], object], float], tuple[float, float]]
TURNS = 15


def seconds_of(work: Callable[[], object]) -> float:
    """Processor time of a call; what it returns, where that is a time it has measured itself."""
    begin = time.process_time()
    found = work()
    return found if isinstance(found, float) else time.process_time() - begin


@pytest.fixture
def in_turns(request: pytest.FixtureRequest) -> InTurns:
    """Least seconds of ours and of theirs, without the heap of other tests.

    Turns end when the bound of the ratio holds by far; where the figures are looked at (``-s``), all are taken.
    """
    looked_at = request.config.getoption("capture") == "no"

    def measured(ours: Callable[[], object], theirs: Callable[[], object], bound: float) -> tuple[float, float]:
        mine = other = math.inf
        gc.collect()
        gc.freeze()
        for turn in range(TURNS):
            mine, other = min(mine, seconds_of(ours)), min(other, seconds_of(theirs))
            # the first turn alone decides only what is far off: a disturbance may have lengthened theirs
            if not looked_at and mine < (0.9 if turn else 0.5) * bound * other:
                break
        return mine, other

    return measured


MISSIONSIM = "from missionsim.cli.app import run_command; code = run_command(sys.argv[1:])"
"""Script of `cost`: a command."""
TOLD = """
import os, time
print(sum(os.times()[:4]), open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
sys.exit(code)
"""


@dataclass(frozen=True)
class Cost:
    """Of a process, with its start: seconds of the processor and by the clock, and the most memory that it took."""

    cpu_s: float
    clock_s: float
    memory_gb: float
    said: tuple[str, ...] = ()
    """Words that it printed."""

    def __str__(self) -> str:
        return f"{self.cpu_s:.1f} s of the processor, {self.clock_s:.1f} s by the clock, {self.memory_gb:.2f} GB"


def cost(script: str, *arguments: object, codes: tuple[int, ...] = (0,)) -> Cost:
    """What a Python script takes in a process of its own, whose exit code (`code`) must be one of `codes`.

    The process itself says its memory: what the system tells of a child that has ended includes that of its parent.
    """
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; code = 0; {script}{TOLD}", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    clock = time.perf_counter() - begun
    assert done.returncode in codes, done.stderr
    *said, seconds, kilobytes = done.stdout.split()
    return Cost(float(seconds), clock, float(kilobytes) / 1024**2, tuple(said))
