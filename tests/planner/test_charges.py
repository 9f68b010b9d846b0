"""Several charges with two batteries: no worse than many levels, and a bound that holds for all."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from missionsim.inputs.loading import load_task
from missionsim.planner.answer import Answer
from missionsim.planner.solve import solve_site
from missionsim.planner.tour import make_site
from tests.planner.exhaustive import random_task

LEVELS = [round(0.05 * step, 2) for step in range(1, 21)]


def _task(seed: int, folder: Path, *, alike: bool) -> Path:
    """A random task of a robot whose batteries need charging on the way, with two docks."""
    rng = np.random.default_rng(seed)
    path = random_task(rng, folder)
    site = yaml.safe_load((folder / "site.yaml").read_text())
    names = list(site["places"])
    docks = [str(name) for name in rng.choice(names, 2, replace=False)]
    for name in names:
        site["places"][name].pop("charger", None)
    first = {"power": float(rng.uniform(25, 90))}
    second = first if alike else {"power": float(rng.uniform(15, 90))}
    for name, charger in zip(docks, (first, second), strict=True):
        site["places"][name]["charger"] = charger
    (folder / "site.yaml").write_text(yaml.safe_dump(site, sort_keys=False))
    robot = yaml.safe_load((folder / "robot.yaml").read_text())
    small = float(rng.uniform(0.5, 1.6))
    for name, share in (("drive", 1.0), ("brain", 0.5)):
        robot["batteries"][name]["capacity"] = share * small
        robot["batteries"][name]["max_charge_power"] = float(rng.uniform(20, 90))
    if rng.random() < 0.5:
        robot["batteries"]["drive"]["charge_taper"] = {"from": 0.6, "end_power": 0.2}
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot, sort_keys=False))
    task = yaml.safe_load(path.read_text())
    task["choose"] |= {"docks": docks, "charge": "any"}
    task["initial_charge"] = {"drive": 0.9, "brain": 0.9}
    task["within"]["deadline"] = 1500.0
    path.write_text(yaml.safe_dump(task, sort_keys=False))
    return path


def _beside_levels(seed: int, folder: Path, *, alike: bool) -> Answer:
    path = _task(seed, folder, alike=alike)
    found = solve_site(make_site(load_task(path)))
    levels = solve_site(make_site(load_task(path, [("choose.charge", LEVELS)])))
    assert found.feasible or not levels.feasible
    if levels.feasible:
        assert found.bound <= levels.objective * (1 + 1e-9), seed
        if "several charges" not in found.claim:
            assert found.objective <= levels.objective * (1 + 1e-9) + found.objective - found.bound, seed
    return found


@pytest.mark.parametrize(("seed", "alike"), [(1, True), (2, False), (3, True), (4, False), (8, True)])
def test_any_charge_beside_many_levels(seed: int, alike: bool, tmp_path: Path) -> None:
    _beside_levels(seed, tmp_path, alike=alike)


@pytest.mark.study
@pytest.mark.parametrize("alike", [True, False])
def test_any_charge_beside_many_levels_often(alike: bool, tmp_path: Path) -> None:
    charges, gaps = [], []
    for seed in range(100, 110):
        folder = tmp_path / str(seed)
        folder.mkdir()
        found = _beside_levels(seed, folder, alike=alike)
        if found.feasible:
            charges.append(sum(leg.kind == "charge" for leg in found.legs))
            gaps.append(found.gap)
    print(
        f"alike {alike}: {np.bincount(charges)} plans by charges, mean gap {np.mean(gaps):.2g}, largest {max(gaps):.2g}"
    )
    assert sum(count > 1 for count in charges) > 0
    assert math.isfinite(max(gaps))
