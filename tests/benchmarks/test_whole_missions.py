"""Whole missions beside other simulators of vehicles, where they are installed (extra `simulators`)."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from tests.benchmarks import drives, patrol
from tests.benchmarks.conftest import seconds_of

pytestmark = [pytest.mark.study, pytest.mark.benchmark_ratio]


def joules(result: RunResult) -> float:
    """Energy of all batteries."""
    return 3600.0 * sum(battery.energy_wh for battery in result.batteries.values())


TOOLS: dict[str, tuple[str, Callable[[RunResult, Path], drives.Measured], Callable[[RunResult], float], float, float]]
TOOLS = {
    "Basilisk": ("Basilisk", drives.basilisk, joules, 0.01, 2.0),
    "SUMO": ("libsumo", drives.sumo, lambda run: run.distance_m, 0.1, 6.0),
    "FASTSim": ("fastsim", drives.fastsim, lambda run: run.distance_m, 0.01, 0.5),
    "ProgPy's battery": ("progpy", drives.progpy, lambda run: run.duration_s, 0.01, 0.5),
}
"""Package, what it does, what of ours its figure must be and how nearly, most that ours may take of its time."""


@pytest.mark.parametrize("name", TOOLS)
def test_the_patrol_beside(name: str, tmp_path: Path) -> None:
    """The same 40 segments in 628 and 4,197 s; each gives less of it than ours, see docs/performance.md."""
    package, peer, expected, tolerance, most = TOOLS[name]
    if importlib.util.find_spec(package) is None:
        pytest.skip("an extra: pip install missionsim[simulators]")
    for scale in (0.14, 1.0):
        folder = tmp_path / str(scale)
        folder.mkdir()
        mission = load_mission(patrol.write(folder, scale))
        result = simulate(mission)
        ours = theirs = math.inf
        for _ in range(5):
            ours = min(ours, seconds_of(partial(simulate, mission)))
            spent, found = peer(result, folder)
            theirs = min(theirs, spent)
            assert found == pytest.approx(expected(result), rel=tolerance)
        print(f"{result.duration_s:.0f} s: ours {ours * 1e3:.1f} ms, {name} {theirs * 1e3:.1f}: {ours / theirs:.2f}")
        assert ours <= most * theirs
