"""How far a robot gets: there and back agrees with planning each place, and the point of no return with driving it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import yaml

from missionsim.cli.app import run_command
from missionsim.inputs.loading import load_task
from missionsim.planner.chance import plan_task
from missionsim.report.figures_run import site_figure
from missionsim.report.site_map import map_of_plan

SMALL = "robot.batteries.drive.capacity=8 Wh"


def reach(root: Path, tmp_path: Path, *words: str, code: int) -> dict:
    """JSON of `reach` on the trial site."""
    site, robot = root / "environments/trial_site.yaml", root / "missions/planning/inspector.yaml"
    target = tmp_path / "reach.json"
    asked = ["reach", str(site), "--robot", str(robot), "--from", "hall", *words]
    assert run_command([*asked, "--json", str(target), "--quiet"]) == code
    return json.loads(target.read_text())


@pytest.mark.long
def test_all_places_within_reach_of_the_whole_battery(root: Path, tmp_path: Path) -> None:
    found = reach(root, tmp_path, "--plot", str(tmp_path / "map.svg"), code=0)
    assert len(found["places"]) == 11
    assert all(item["sure"] and min(item["margin_wh"].values()) > 0.0 for item in found["places"].values())
    assert "<svg" in (tmp_path / "map.svg").read_text()


def test_the_point_of_no_return_is_where_the_reserve_is_left(root: Path, tmp_path: Path) -> None:
    found = reach(root, tmp_path, "--set", SMALL, "--plot", str(tmp_path / "map.svg"), code=1)
    assert "<svg" in (tmp_path / "map.svg").read_text()
    out = {name: item for name, item in found["places"].items() if not item["reachable"]}
    assert out
    assert all(item["margin_wh"][item["point_of_no_return"]["battery"]] < 0.0 for item in out.values())
    turn = out["weir"]["point_of_no_return"]
    assert turn["edge"] == "weir_path"
    assert turn["sure_metres"] < turn["metres"]
    # the same way with a place put where the robot is to turn back, simulated
    site = yaml.safe_load((root / "environments/trial_site.yaml").read_text())
    a, b = site["places"]["tank"], site["places"]["weir"]
    xy = [[float(str(place[key]).split()[0]) for key in ("x", "y")] for place in (a, b)]
    length = sum((p - q) ** 2 for p, q in zip(*xy, strict=True)) ** 0.5
    site["places"]["turn"] = {}
    edge = next(item for item in site["edges"] if item["name"] == "weir_path")
    site["edges"].append({**edge, "name": "part", "to": "turn", "length": turn["metres"]})
    assert turn["metres"] < length
    (tmp_path / "site.yaml").write_text(json.dumps(site))
    plan, run = tmp_path / "plan.yaml", tmp_path / "run.json"
    way = out["weir"]["way"]
    there = way[: way.index("weir")]
    drives = [*there[1:], "part", *there[::-1]]
    mission = {
        "kind": "mission",
        "name": "turn",
        "robot": str(root / "missions/planning/inspector.yaml"),
        "environment": str(tmp_path / "site.yaml"),
        "start": "hall",
        "defaults": {"scheme": "mapped"},
        "segments": [{"drive": {"along": drives}}],
    }
    plan.write_text(json.dumps(mission))
    energies = []
    for scheme in ("mapped", "seen"):
        run_command(["run", str(plan), "--set", f"defaults.scheme={scheme}", "--json", str(run), "--quiet"])
        energies.append(json.loads(run.read_text())["batteries"]["drive"]["energy_wh"])
    assert pytest.approx(min(energies, key=lambda wh: abs(wh - 6.4)), rel=1e-6) == 8.0 * 0.8


ONE_WAY = """kind: environment
name: chute
places: {base: {x: 0, y: 0}, mid: {x: 200, y: 0}, far: {x: 200, y: 100}, top: {x: 0, y: 900}}
edges:
  - {name: road, from: base, to: mid}
  - {name: chute, from: mid, to: far, both_ways: false}
  - {name: up, from: far, to: top, slope: 4 %}
  - {name: down, from: top, to: base}
  - {name: short_cut, from: far, to: base, both_ways: false, closed: true}
"""


@pytest.mark.parametrize(("capacity", "reachable"), [(1.0, True), (0.8, False)])
def test_what_a_battery_loses_inside_brings_nobody_home(tmp_path: Path, capacity: float, reachable: bool) -> None:
    """A place was in reach by what the terminals deliver, while no run came back with its reserve."""
    model = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 20], [1, 26]], "resistance": 1.0}
    robot = {
        **{"kind": "robot", "name": "r", "body": {"drive": "differential", "max_speed": 1}},
        "batteries": {"main": {"capacity": f"{capacity} Ah", "nominal_voltage": "24 V", "model": model}},
        "motion": {"battery": "main", "model": "polynomial", "parameters": {"c2": 0, "c3": 50, "c4": 10}},
        "schemes": {"follow": {}},
    }
    site = {"kind": "environment", "name": "s", "places": {"hall": {"x": 0, "y": 0}, "far": {"x": 540, "y": 0}}}
    site["edges"] = [{"from": "hall", "to": "far"}]
    for name, data in (("robot", robot), ("site", site)):
        (tmp_path / f"{name}.yaml").write_text(json.dumps(data))
    words = ["reach", str(tmp_path / "site.yaml"), "--robot", str(tmp_path / "robot.yaml"), "--from", "hall"]
    target = tmp_path / "reach.json"
    run_command([*words, "--set", "choose.speeds=[1]", "--json", str(target), "--quiet"])
    found = json.loads(target.read_text())["places"]["far"]
    assert found["reachable"] == reachable
    assert 24 * capacity - found["energy_wh"]["main"] > found["margin_wh"]["main"] + 1.0
    assert (found["point_of_no_return"] is None) == reachable


def test_before_an_edge_that_leads_one_way_the_robot_must_turn_back(root: Path, tmp_path: Path) -> None:
    """And only where no other way from its end leads home."""
    site, turns = tmp_path / "site.yaml", {}
    robot = root / "missions/planning/inspector.yaml"
    for name, text in (("shut", ONE_WAY), ("open", ONE_WAY.replace(", closed: true", ""))):
        site.write_text(text)
        words = ["reach", str(site), "--robot", str(robot), "--from", "base", "--json", str(tmp_path / "a.json")]
        assert run_command([*words, "--set", "robot.batteries.drive.capacity=16 Wh", "--quiet"]) == 1
        places = json.loads((tmp_path / "a.json").read_text())["places"]
        assert not places["top"]["reachable"]
        turns[name] = places["far"]["point_of_no_return"]
        assert places["far"]["reachable"] is (name == "open")
    assert turns["open"] is None
    assert (turns["shut"]["edge"], turns["shut"]["from"], turns["shut"]["metres"]) == ("chute", "mid", 0.0)
    assert turns["shut"]["one_way"]


def test_what_the_robot_was_not_fitted_to_is_told_at_its_edge(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site, robot = tmp_path / "site.yaml", tmp_path / "robot.yaml"
    site.write_text(ONE_WAY.replace("name: up,", "name: up, surface: grit,"))
    text = (root / "missions/planning/inspector.yaml").read_text()
    robot.write_text(text.replace("{surface: [paved]}", "{surface: [paved], slope_rad: [-0.01, 0.01]}"))
    words = ["reach", str(site), "--robot", str(robot), "--from", "base", "--json", str(tmp_path / "a.json")]
    assert run_command(words) in (0, 1)
    assert f"{site}:7:5: warning: slope 2.29 °" in capsys.readouterr().err
    assert any("slope 2.29 °" in told for told in json.loads((tmp_path / "a.json").read_text())["warnings"])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--from", "hull"], "did you mean: hall"),
        (["--back-to", "nowhere"], "--back-to: no place 'nowhere'"),
        (["--probability", "95"], "between 0 and 1"),
        (["--plot", "map.gif"], "--plot is a picture"),
        (["--set", "choose.schemes=[look]"], "stands still"),
    ],
)
def test_bad_questions(root: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str) -> None:
    site, robot = root / "environments/trial_site.yaml", root / "missions/planning/inspector.yaml"
    begin = [] if "--from" in words else ["--from", "hall"]
    assert run_command(["reach", str(site), "--robot", str(robot), *begin, *words, "--quiet"]) == 2
    assert told in capsys.readouterr().err


def test_pictures_and_page_of_a_plan(root: Path, tmp_path: Path) -> None:
    task = root / "missions/planning/inspection.yaml"
    words = ["plan", str(task), "--set", "visits=[{place: pump}]", "--plot", str(tmp_path / "map.png")]
    assert run_command([*words, "--report", str(tmp_path / "plan.html"), "--quiet"]) == 0
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"
    page = (tmp_path / "plan.html").read_text()
    assert "pump_road" in page
    assert "proved best" in page


def test_the_map_counts_the_visits_and_says_what_is_charged_without_text_upon_text(root: Path) -> None:
    changes = [("robot.batteries.drive.capacity", "7 Wh"), ("choose.docks", "all"), ("within.reserve", "{drive: 10 %}")]
    task = load_task(root / "missions/planning/inspection.yaml", changes)
    answer, _ = plan_task(task, lambda what, objective, bound: math.isfinite(objective))
    figure = site_figure(map_of_plan(answer))
    figure.draw_without_rendering()
    (axes, _) = figure.axes
    texts = [text for text in axes.texts if text.get_text()]
    words = [text.get_text() for text in texts]
    assert {str(i + 1) for i in range(len(answer.order()))} <= set(words)
    charged = {leg.place for leg in answer.legs if leg.kind == "charge"}
    assert charged
    assert all(any(word.startswith(f"{place}\ncharges ") for word in words) for place in charged)
    named = [text for text in texts if text.get_text().split("\n")[0] in task.environment.places]
    assert len(named) == len(task.environment.places)
    boxes = [text.get_window_extent() for text in named]
    assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])
