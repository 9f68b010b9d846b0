"""More visits than all orders of which can be gone through: the plan keeps to the task, runs, and says its gap."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from missionsim.cli.app import run_command
from missionsim.inputs.loading import load_task
from missionsim.planner.site import make_site
from missionsim.planner.solve import solve_large, solve_site


@pytest.mark.long
def test_twenty_visits_within_a_said_gap(root: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    spots = rng.uniform(0.0, 200.0, (24, 2))
    places = {f"p{i}": {"x": float(x), "y": float(y)} for i, (x, y) in enumerate(spots)}
    edges = []
    for i in range(1, 24):
        near = np.argsort(np.hypot(*(spots[:i] - spots[i]).T))[:3]
        edges += [{"name": f"e{i}_{j}", "from": f"p{i}", "to": f"p{j}"} for j in near.tolist()]
    site = {"kind": "environment", "name": "large", "places": places, "edges": edges}
    visits = [{"place": f"p{i}", "inspect": "10 s"} for i in range(1, 21)]
    visits[4]["after"], visits[9]["window"] = "p20", {"until": "20 min"}
    task = {
        "kind": "task",
        "name": "many",
        "robot": str(root / "missions/planning/inspector.yaml"),
        "environment": "site.yaml",
        "start": "p0",
        "visits": visits,
        "choose": {"speeds": [0.6, 1.0], "schemes": ["mapped"]},
    }
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(site))
    (tmp_path / "task.yaml").write_text(yaml.safe_dump(task))
    files = [str(tmp_path / name) for name in ("mission.yaml", "plan.json", "run.json")]
    words = ["plan", str(tmp_path / "task.yaml"), "--set", "robot.batteries.drive.capacity=200 Wh"]
    words += ["--set", "robot.batteries.computer.capacity=200 Wh"]
    assert run_command([*words, "--out", files[0], "--json", files[1], "--quiet"]) == 0
    plan = json.loads(Path(files[1]).read_text())
    assert sorted(plan["order"]) == sorted(visit["place"] for visit in visits)
    assert plan["order"].index("p20") < plan["order"].index("p5")
    assert 0.0 < plan["bound"] <= plan["objective"]
    assert plan["gap"] == pytest.approx(1.0 - plan["bound"] / plan["objective"])
    assert "heuristic" in plan["claim"]
    assert run_command(["run", files[0], *words[2:], "--json", files[2], "--quiet"]) == 0
    run = json.loads(Path(files[2]).read_text())
    assert plan["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
    for name, battery in plan["batteries"].items():
        assert battery["energy_wh"] == pytest.approx(run["batteries"][name]["energy_wh"], rel=1e-9)


def test_a_search_that_is_stopped_claims_nothing(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task = root / "missions/planning/inspection.yaml"
    small = "robot.batteries.drive.capacity=6 Wh"
    words = ["plan", str(task), "--set", small, "--set", "choose.docks=all", "--seconds", "0.000001"]
    code = run_command(words)
    told = capsys.readouterr().out
    assert code == 0 or "there may be one" in told


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.long)])
def test_bounds_of_many_visits_hold_with_values_and_loads(root: Path, seed: int) -> None:
    """Few visits, solved as if they were many: no bound is above what going through all orders finds."""
    rng = np.random.default_rng(seed)
    places = rng.permutation(["gate", "pump", "tank", "ridge", "mast", "yard", "well", "ramp"])
    visits: list[dict] = [{"place": str(place), "wait": "20 s"} for place in places[:6]]
    visits[0]["take_up"], visits[1]["set_down"], visits[1]["after"] = "3 kg", "2 kg", visits[0]["place"]
    for visit in visits[2:]:
        visit["value"] = float(rng.integers(1, 4))
    changes = [("visits", visits), ("within.deadline", f"{rng.integers(6, 12)} min"), ("choose.speeds", [0.6, 1.0])]
    site = make_site(load_task(root / "missions/planning/inspection.yaml", changes))
    exact = solve_site(site)
    found = solve_large(site)
    assert exact.feasible
    assert found.feasible
    assert found.value <= exact.value <= found.extra["value_at_most"] + 1e-9
    assert math.isfinite(found.bound)
    if found.value == exact.value:
        assert found.bound <= exact.objective * (1 + 1e-9) <= found.objective * (1 + 2e-9)


@pytest.mark.long
def test_sixteen_visits_of_value_and_a_load_are_bounded(root: Path, tmp_path: Path) -> None:
    places = ["gate", "pump", "tank", "ridge", "mast", "yard", "well", "ramp"]
    visits: list[dict] = [
        {"place": p, "name": f"{p}{k}", "wait": "5 s", "value": 1 + k} for p in places for k in (0, 1)
    ]
    visits[0] = {"place": "gate", "take_up": "3 kg"}
    visits[3] = {"place": "pump", "set_down": "3 kg", "after": "gate"}
    words = ["plan", str(root / "missions/planning/inspection.yaml"), "--set", f"visits={json.dumps(visits)}"]
    words += ["--set", "within.deadline=5 min", "--set", "choose.speeds=[1.2]", "--quiet"]
    assert run_command([*words, "--json", str(tmp_path / "plan.json")]) == 0
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert 0.0 < plan["bound"] <= plan["objective"]
    assert 0.0 < plan["value"] <= plan["value_at_most"] < 21.0
