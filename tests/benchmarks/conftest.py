"""Two things measured in turns: what else the machine does can only add, and meets both alike."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable

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
            if turn and not looked_at and mine < 0.9 * bound * other:
                break
        return mine, other

    return measured
