"""Schemes and sensors chosen for task, visit and edge: as good as each of them required in turn, run as planned."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from missionsim.cli.app import run_command
from missionsim.inputs.loading import load_task
from missionsim.planner.chance import plan_task
from missionsim.planner.site import make_site
from missionsim.planner.solve import solve_site
from tests.planner.random_tasks import random_task

LOOKS = [{"scheme": "look"}, {"scheme": "look", "sensors": {"eye": 1, "lidar": 1}}, {"scheme": "glance"}]


def _task(seed: int, folder: Path) -> Path:
    """A random task whose edges have names, and where one way to look takes of the other battery."""
    rng = np.random.default_rng(seed)
    path = random_task(rng, folder)
    robot = yaml.safe_load((folder / "robot.yaml").read_text())
    robot["components"]["arm"] = {"loads": [{"battery": "drive", "power": float(rng.uniform(1, 30))}]}
    robot["schemes"]["glance"] = {"motion": False, "image_analysis": True, "sensors": {"required": {"arm": 1}}}
    site = yaml.safe_load((folder / "site.yaml").read_text())
    for number, edge in enumerate(site["edges"]):
        edge["name"] = f"e{number}"
    for name, data in (("robot.yaml", robot), ("site.yaml", site)):
        (folder / name).write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def _objective(path: Path, visits: list[dict], edges: dict, schemes: list | None = None) -> float:
    changes = [("visits", visits), ("edges", edges)]
    return solve_site(
        make_site(load_task(path, changes + ([("choose.schemes", schemes)] if schemes else [])))
    ).objective


def _as_each_in_turn(seed: int, folder: Path) -> None:
    path = _task(seed, folder)
    visits = yaml.safe_load(path.read_text())["visits"]
    edges = [{"e0": {"schemes": a}, "e1": {"schemes": b}} for a, b in itertools.product(["quick", "slow"], repeat=2)]
    each = {}
    for pair in itertools.product(range(3), repeat=2):
        made = [{**visit, **LOOKS[k]} for visit, k in zip(visits, pair, strict=True)]
        each[pair] = [_objective(path, made, edge) for edge in (edges if pair == (0, 0) else edges[:1])]
    chosen = [{**visit, "schemes": LOOKS[: 3 - k]} for k, visit in enumerate(visits)]
    found = _objective(path, chosen, edges[0])
    best = min(each[pair][0] for pair in itertools.product(range(3), range(2)))
    assert found == pytest.approx(best, rel=1e-9) or (math.isinf(found) and math.isinf(best))
    whole = _objective(path, visits, edges[0], ["quick", "slow", *LOOKS])
    best = min(values[0] for values in each.values())
    assert whole == pytest.approx(best, rel=1e-9) or (math.isinf(whole) and math.isinf(best))
    free = _objective(path, [{**visit, **LOOKS[0]} for visit in visits], {})
    # a scheme that is required on an edge is what no plan that may choose is worse than
    assert all(free <= value * (1 + 1e-9) for value in each[0, 0])


@pytest.mark.parametrize("seed", [7001, *(pytest.param(seed, marks=pytest.mark.long) for seed in (7004, 7007))])
def test_what_is_chosen_is_as_good_as_each_in_turn(seed: int, tmp_path: Path) -> None:
    _as_each_in_turn(seed, tmp_path)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(7100, 7200))
def test_choices_of_many_tasks(seed: int, tmp_path: Path) -> None:
    _as_each_in_turn(seed, tmp_path)


def test_what_was_chosen_is_written_and_runs_as_planned(root: Path, tmp_path: Path) -> None:
    task = root / "missions/planning/inspection.yaml"
    looks = "[{scheme: look, sensors: {lidar: 1}}, look]"
    words = ["--set", f"visits.0.schemes={looks}", "--set", "edges={lane: {schemes: seen}, yard_road: {schemes: seen}}"]
    files = [str(tmp_path / name) for name in ("plan.json", "mission.yaml", "run.json")]
    assert run_command(["plan", str(task), *words, "--json", files[0], "--out", files[1], "--quiet"]) == 0
    plan = json.loads(Path(files[0]).read_text())
    tank = next(leg for leg in plan["legs"] if leg.get("visit") == "tank")
    assert (tank["scheme"], tank["sensors"]) == ("look", None)
    written = yaml.safe_load(Path(files[1]).read_text())["segments"]
    assert [s["inspect"]["scheme"] for s in written if "inspect" in s and s["inspect"]["name"] == "tank"] == ["look"]
    assert {leg["scheme"] for leg in plan["legs"] if leg.get("edge") in ("lane", "yard_road")} == {"seen"}
    assert run_command(["run", files[1], "--json", files[2], "--quiet"]) == 0
    run = json.loads(Path(files[2]).read_text())
    for name, battery in plan["batteries"].items():
        assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("visits.0.schemes=[look, lok]", "look"),
        ("visits.0.schemes=[{scheme: look, sensors: {lidar: 3}}]", "lidar"),
        ("visits.0={place: tank, inspect: 9 s, scheme: look, schemes: [look]}", "given or chosen"),
        ("edges={lane: {schemes: look}}", "stands still"),
        ("edges={lan: {schemes: mapped}}", "lane"),
    ],
)
def test_choices_that_cannot_be_are_told(
    root: Path, capsys: pytest.CaptureFixture[str], setting: str, told: str
) -> None:
    task = root / "missions/planning/inspection.yaml"
    assert run_command(["plan", str(task), "--set", setting, "--quiet"]) == 2
    assert told in capsys.readouterr().err


def test_a_scheme_for_standing_is_chosen_with_chance_and_windows_too(root: Path) -> None:
    settings = [
        ("visits.0.schemes", [{"scheme": "look", "sensors": {"lidar": 1}}, "look"]),
        ("visits.0.window", {"from": "4 min", "until": "20 min"}),
    ]
    task = root / "missions/planning/inspection.yaml"
    answer, run = plan_task(load_task(task, settings))
    alone, _ = plan_task(load_task(task, [("visits.0.scheme", "look"), settings[1]]))
    assert run is not None
    assert answer.objective == pytest.approx(alone.objective, rel=1e-9)
    assert answer.duration_s == pytest.approx(run.duration_s, rel=1e-9)
