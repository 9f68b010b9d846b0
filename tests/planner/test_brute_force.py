"""Plans of random tasks beside a brute force that shares nothing with the planner, and as their missions run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.inputs.loading import load_task
from missionsim.planner.chance import plan_task
from tests.planner.brute import Brute, TooMany, random_files


def _compare(seed: int, folder: Path) -> str:
    """Whether there is a plan, and the best; ``refused`` and ``too many`` are no cases."""
    files = random_files(np.random.default_rng(seed), folder)
    try:
        task = load_task(folder / "task.yaml")
    except InputError:  # an order, a load or a place that cannot be
        return "refused"
    try:
        best = Brute(folder, *files).best()
    except TooMany:
        return "too many"
    answer, run = plan_task(task)
    assert answer.feasible == (best is not None), seed
    if best is None or run is None:
        return "no plan"
    value, objective = best
    assert answer.value == pytest.approx(value, abs=1e-9), seed
    assert answer.gap < 1e-9, seed
    assert answer.objective == pytest.approx(objective, rel=1e-8, abs=1e-8), seed
    assert run.feasible, seed
    assert run.duration_s == pytest.approx(answer.duration_s, rel=1e-9), seed
    for name, battery in run.batteries.items():
        assert battery.energy_wh == pytest.approx(answer.energy_wh[name], rel=1e-9), seed
        assert battery.charge_left_wh == pytest.approx(answer.charge_left_wh[name], rel=1e-9, abs=1e-9), seed
    return "charged" if any(leg.kind == "charge" for leg in answer.legs) else "plan"


def _many(seeds: Iterable[int], folder: Path) -> dict[str, int]:
    counts: dict[str, int] = {}
    for seed in seeds:
        (folder / str(seed)).mkdir()
        kind = _compare(seed, folder / str(seed))
        counts[kind] = counts.get(kind, 0) + 1
    print(counts)
    return counts


# 4 and 5 are too many for the brute force; those after 15 have a plan of a robot that takes its time to speed up
FEW = (1, 3, 6, 7, 8, 12, 14, 15, 20, 25, 34)
MORE = (*range(4), *range(6, 16), 20, 25, 34, 44, 53)


@pytest.mark.parametrize("seeds", [FEW, pytest.param(MORE, marks=pytest.mark.long)], ids=["few", "more"])
def test_as_good_as_brute_force(tmp_path: Path, seeds: tuple[int, ...]) -> None:
    counts = _many(seeds, tmp_path)
    assert counts["plan"] + counts["charged"] >= len(seeds) // 2
    assert counts["charged"] >= 1
    assert counts["no plan"] >= 2


@pytest.mark.study
def test_as_good_as_brute_force_often(tmp_path: Path) -> None:
    counts = _many(range(1000, 2000), tmp_path)
    assert counts["plan"] + counts["charged"] >= 400
    assert counts["charged"] >= 20
