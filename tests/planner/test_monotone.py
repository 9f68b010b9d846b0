"""One more choice never makes a plan worse, a tighter limit never better: random tasks, changed one by one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.inputs.loading import load_task
from missionsim.planner.site import make_site
from missionsim.planner.solve import solve_site
from tests.planner.random_tasks import random_task

Change = tuple[str, object]


def _changes(data: dict) -> tuple[list[Change], list[Change]]:
    """Changes of a random task that give more to choose, and changes that leave less."""
    speeds, within = [speed.value for speed in data.choose.speeds], data.within
    more: list[Change] = [
        ("choose.speeds", [*speeds, 0.95]),
        ("within.deadline", 1.3 * within.deadline.value),
        ("within.reserve", 0.05),
        ("initial_charge", {"drive": 1.0, "brain": 1.0}),
    ]
    less: list[Change] = [
        ("choose.speeds", speeds[:1]),
        ("choose.schemes", ["slow"]),
        ("choose.docks", "none"),
        ("within.deadline", 0.85 * within.deadline.value),
        ("within.reserve", 0.15),
        ("within.reserve_throughout", True),
        ("order", "given"),
        ("edges", {"e0": {"closed": True}}),
    ]
    if data.docks:
        more += [("choose.charge", [0.3, 0.6, 0.9]), ("choose.charge", "any")]
    return more, less


def _monotone(seed: int, folder: Path, few: int | None = None) -> None:
    path = random_task(np.random.default_rng(seed), folder)
    text = path.with_name("site.yaml").read_text()
    path.with_name("site.yaml").write_text(text.replace("- from:", "- name: e0\n  from:", 1))
    rng = np.random.default_rng(seed)
    task = load_task(path)
    base = solve_site(make_site(task)).objective
    for sign, changes in zip((1.0, -1.0), _changes(task), strict=True):
        picked = changes if few is None else [changes[i] for i in rng.choice(len(changes), few, replace=False)]
        for change in picked:
            if change[0] == "edges":
                try:
                    other = load_task(path, [change])
                except InputError:
                    continue  # some place cannot be reached any more: told when loading
            else:
                other = load_task(path, [change])
            found = solve_site(make_site(other)).objective
            better = found <= base * (1 + 1e-9) if sign > 0 else found >= base * (1 - 1e-9)
            assert better or (math.isinf(found) and math.isinf(base)), (seed, change, base, found)


@pytest.mark.parametrize(
    "seed", [4000, 4001, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4002, 4006))]
)
def test_more_choice_is_no_worse_and_tighter_limits_no_better(seed: int, tmp_path: Path) -> None:
    _monotone(seed, tmp_path, few=2)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(5000, 5200))
def test_all_changes_of_many_tasks(seed: int, tmp_path: Path) -> None:
    _monotone(seed, tmp_path)
