"""What goes back into the files of other tools: their readers and schemas accept it, and the rest is unchanged."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.exchange.formats import import_site
from missionsim.exchange.nav2 import export_costs, steady_power
from missionsim.exchange.qgc import plan_of
from missionsim.exchange.rmf_fleet import export_fleet, read_fleet
from missionsim.exchange.site import SiteOptions, write_site
from missionsim.exchange.vda5050 import VERSIONS, order_of
from missionsim.inputs.loading import load_mission, load_robot, robot_from_text
from missionsim.inputs.mission import MissionSpec

HERE = Path(__file__).parent
FILES = HERE.parents[1] / "docs" / "examples" / "sites"
COST, LIMIT = re.compile(r',? ?"(?:cost|speed_limit)": [-+.\deE]+'), re.compile(r',? ?"metadata": \{ *\}')


def rest(text: str) -> str:
    """A graph without costs, speed limits and metadata that hold nothing else."""
    return LIMIT.sub("", COST.sub("", text))


def mission_of(name: str, folder: Path) -> MissionSpec:
    site = import_site(FILES / name, SiteOptions(load_robot("pioneer3dx")))
    write_site(site, folder / "s.yaml", folder / "m.yaml", "pioneer3dx")
    return load_mission(folder / "m.yaml")


def cart() -> Any:
    return robot_from_text(read_fleet(FILES / "cart_config.yaml").robot_text())


def test_fleet_config_becomes_a_robot_of_the_same_formula(tmp_path: Path) -> None:
    robot = cart()
    # friction m g v + ambient, with g as rmf_battery has it
    expected = 0.1 * 40 * 9.81 * np.array([0.2, 0.8]) + 15.0
    assert steady_power(robot, [(0.0, 0.2), (0.0, 0.8)])["robot"] == pytest.approx(expected)
    battery = robot.batteries["robot"]
    assert (battery.capacity_wh, battery.reserve.value) == pytest.approx((480.0, 0.2))
    assert battery.max_charge_power.value == pytest.approx(144.0)
    assert robot.body.max_acceleration.value == 0.5
    assert robot.components["tool"].loads[0].power.value == 3.5
    out = tmp_path / "cart.yaml"
    assert run_command(["import-robot", str(FILES / "cart_config.yaml"), "--out", str(out), "--quiet"]) == 0
    assert run_command(["validate", str(out), "--quiet"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("mass: 40.0", "mass: heavy", 16, "must be a number"),
        ("capacity: 20.0", "capacity: -1", 13, "impossible value"),
        ("    voltage: 24.0 # V\n", "", 12, "'voltage' is missing"),
        ("linear: [0.8, 0.5]", "linear: []", 5, "the top speed is missing"),
        ("rmf_fleet:", "rmf_fleets:", 2, "'rmf_fleet' is missing"),
    ],
)
def test_faults_of_a_fleet_config(old: str, new: str, line: int, says: str, tmp_path: Path) -> None:
    text = (FILES / "cart_config.yaml").read_text()
    (tmp_path / "c.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_fleet(tmp_path / "c.yaml")
    assert [(fault.line, fault.message) for fault in caught.value.faults] == [(line, says)], caught.value


@pytest.mark.parametrize("indent", ["", "  "])
def test_what_a_fleet_says_of_each_robot_is_told(indent: str, tmp_path: Path) -> None:
    of_each = f"\n{indent}robots:\n{indent}  one: {{charger: c1}}\n"
    text = (FILES / "cart_config.yaml").read_text().split("\n  robots:")[0]
    (tmp_path / "c.yaml").write_text(text.rstrip() + of_each)
    fleet = read_fleet(tmp_path / "c.yaml")
    assert fleet.robots == ("one",)
    assert any("robots" in remark.message for remark in fleet.remarks.values())


def test_shared_fleets_become_robots(shared: Path) -> None:
    configs = sorted((shared / "sites").glob("open_rmf/*_config.yaml"))
    if not configs:
        pytest.skip("no shared fleets here")
    for path in configs:
        numbers = yaml.safe_load(path.read_text())["rmf_fleet"]
        robot = robot_from_text(read_fleet(path).robot_text())
        speed = numbers["limits"]["linear"][0]
        mechanics = numbers["mechanical_system"]
        expected = (
            mechanics["friction_coefficient"] * mechanics["mass"] * 9.81 * speed + numbers["ambient_system"]["power"]
        )
        assert steady_power(robot, [(0.0, speed)])["robot"] == pytest.approx([expected])


def graphs(shared_folder: Path) -> list[Path]:
    return [FILES / "yard.geojson", *sorted(shared_folder.glob("sites/nav2_route/*.geojson"))]


def test_graph_gets_costs_and_keeps_every_other_byte(shared: Path, tmp_path: Path) -> None:
    for path in graphs(shared):
        before, found = path.read_bytes().decode(), export_costs(path, cart())
        after = found.raw.decode()
        assert rest(after) == rest(before), path
        properties = [f["properties"] for f in json.loads(after)["features"]]
        edges = {p["id"]: p for p in properties if p.get("startid") != p.get("endid")}
        for edge in found.edges:
            assert edges[edge["id"]]["cost"] == pytest.approx(edge["cost"], rel=1e-5)
            watts = 0.1 * 40 * 9.81 * edge["speed_m_s"] + 15.0
            assert edge["energy_wh"] == pytest.approx(watts * edge["length_m"] / edge["speed_m_s"] / 3600)
            assert edges[edge["id"]]["metadata"]["speed_limit"] == pytest.approx(edge["speed_m_s"] / 0.8, rel=1e-5)
        (tmp_path / "again.geojson").write_bytes(found.raw)
        again = import_site(tmp_path / "again.geojson", SiteOptions(cart()))
        assert [edge["max_speed"] for edge in again.edges] == pytest.approx(
            [e["speed_m_s"] for e in found.edges], rel=1e-5
        )


def test_costs_with_time_and_best_speed(tmp_path: Path) -> None:
    plain = export_costs(FILES / "yard.geojson", cart()).edges
    timed = export_costs(FILES / "yard.geojson", cart(), wh_per_s=0.01).edges
    for a, b in zip(plain, timed, strict=True):
        assert b["cost"] == pytest.approx(a["cost"] + 0.01 * a["seconds"])
    # c2 v^2 + c3 v + c4: per metre the least is at sqrt(c4/c2) = 0.7653 m/s, above the Pioneer's 0.75
    best = export_costs(FILES / "yard.geojson", load_robot("pioneer3dx"), battery="robot", best_speed=True).edges
    assert best[1]["speed_m_s"] == pytest.approx(0.75)
    heavy = export_costs(FILES / "yard.geojson", cart(), payload_kg=20.0).edges
    assert heavy[1]["energy_wh"] > plain[1]["energy_wh"]
    crlf = tmp_path / "crlf.geojson"
    crlf.write_bytes(b"\xef\xbb\xbf" + (FILES / "yard.geojson").read_bytes().replace(b"\n", b"\r\n"))
    raw = export_costs(crlf, cart()).raw
    assert raw.startswith(b"\xef\xbb\xbf{\r\n")
    assert raw.count(b"\r\n") == crlf.read_bytes().count(b"\r\n")


def logs(folder: Path) -> Path:
    """A cart that draws 0.06 m g v + m |a| v + 12 W, in a log with steps of 0.2 s."""
    time = np.arange(0.0, 300.0, 0.2)
    speed = np.clip(0.5 + 0.4 * np.sin(time / 11.0), 0.0, 0.8)
    rate = np.gradient(speed, time)
    power = 0.06 * 40 * 9.81 * speed + 40 * np.abs(rate) * speed + 12.0
    rows = [f"{t:.1f},{p:.9g},{v:.9g}" for t, p, v in zip(time, power, speed, strict=True)]
    (folder / "run.csv").write_text("\n".join(["time_s,power_robot_w,speed_m_s", *rows]) + "\n")
    return folder / "run.csv"


def test_measured_numbers_go_back_into_the_config(tmp_path: Path) -> None:
    before = (FILES / "cart_config.yaml").read_text()
    found = export_fleet(FILES / "cart_config.yaml", cart(), [logs(tmp_path)])
    after = yaml.safe_load(found.raw)["rmf_fleet"]
    assert after["mechanical_system"]["friction_coefficient"] == pytest.approx(0.06, rel=0.01)
    assert after["ambient_system"]["power"] == pytest.approx(12.0, rel=0.01)
    assert set(found.changed) == {"friction", "ambient"}
    numbers = re.compile(r"(friction_coefficient|power): [\d.]+")
    assert numbers.sub("", found.raw.decode()) == numbers.sub("", before)
    errors = {row["formula"]: row for row in found.errors}
    assert abs(errors["rmf_battery, measured numbers"]["energy_error_pct"]) < 0.5
    assert errors["rmf_battery, config as it was"]["energy_error_pct"] > 20.0


def test_without_logs_the_line_through_our_model(tmp_path: Path) -> None:
    found = export_fleet(FILES / "cart_config.yaml", load_robot("pioneer3dx"), battery="robot")
    after = yaml.safe_load(found.raw)["rmf_fleet"]
    assert after["battery_system"]["capacity"] == pytest.approx(259.2 / 12)
    speeds = np.linspace(0.075, 0.75, 10)
    watts = steady_power(load_robot("pioneer3dx"), [(0.0, v) for v in speeds])["robot"]
    slope = np.polyfit(speeds, watts, 1)[0]
    assert after["mechanical_system"]["friction_coefficient"] == pytest.approx(slope / (25 * 9.81), rel=1e-5)
    assert any("misses by up to" in remark for remark in found.remarks)
    assert found.errors == []


@pytest.mark.parametrize("version", VERSIONS)
def test_order_follows_the_schema_and_comes_back(version: str, tmp_path: Path) -> None:
    mission = mission_of("order.json", tmp_path)
    order, _ = order_of(mission, version=version, timestamp="2026-01-01T00:00:00.000Z")
    jsonschema.validate(order, json.loads((HERE / "order_schema.json").read_text()))
    assert [node["nodeId"] for node in order["nodes"]] == ["A", "B", "A"]
    assert order["edges"][0]["maximumSpeed" if version == "3.0.0" else "maxSpeed"] == pytest.approx(0.4)
    kinds = [[action["actionType"] for action in node["actions"]] for node in order["nodes"]]
    assert kinds == [[], ["wait"], ["startCharging"]]
    (tmp_path / "again.json").write_text(json.dumps(order))
    again = import_site(tmp_path / "again.json", SiteOptions(mission.robot))
    first = import_site(FILES / "order.json", SiteOptions(mission.robot))
    assert [next(iter(s)) for s in again.segments] == [next(iter(s)) for s in first.segments]
    assert {(e["from"], e["to"]) for e in again.edges} == {(e["from"], e["to"]) for e in first.edges}


def test_order_follows_the_published_schema(shared: Path, tmp_path: Path) -> None:
    path = shared / "sites/vda5050/order.schema"
    if not path.is_file():
        pytest.skip("no shared schema here")
    for mission in ("valve_patrol", "recharging_patrol"):
        order, _ = order_of(load_mission(HERE.parents[1] / f"missions/pioneer3dx/{mission}.yaml"))
        jsonschema.Draft202012Validator(json.loads(path.read_text())).validate(order)
        assert len(order["nodes"]) == len(order["edges"]) + 1 > 4


def test_plan_comes_back_where_it_was(tmp_path: Path) -> None:
    mission = mission_of("rover.plan", tmp_path)
    plan, _ = plan_of(mission)
    (tmp_path / "again.plan").write_text(json.dumps(plan))
    site = import_site(tmp_path / "again.plan", SiteOptions(mission.robot))
    assert mission.environment is not None
    there = {p.position for p in mission.environment.places.values()}
    for place in site.places.values():
        assert min(math.dist((place["x"], place["y"]), p) for p in there if p) < 0.15  # another middle, to 1e-6 degrees
    waits = [s["wait"]["duration"] for s in site.segments if "wait" in s]
    assert waits == [5.0, 5.0, 5.0 + 0.0, 30.0]
    simple = [item for item in plan["mission"]["items"] if item["type"] == "SimpleItem"]
    assert [item["doJumpId"] for item in simple] == list(range(1, len(simple) + 1))
    assert all(len(item["params"]) == 7 for item in simple)


def test_plan_needs_to_know_where_on_earth(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    mission = str(HERE.parents[1] / "missions/pioneer3dx/valve_patrol.yaml")
    out = tmp_path / "patrol.plan"
    assert run_command(["export", "qgc", mission, "--out", str(out)]) == 2
    assert "--origin" in capsys.readouterr().err
    assert not out.exists()
    assert run_command(["export", "qgc", mission, "--out", str(out), "--origin", "43.6,3.9", "--quiet"]) == 0
    assert json.loads(out.read_text())["mission"]["plannedHomePosition"][:2] == pytest.approx([43.6, 3.9])
    assert run_command(["export", "qgc", mission, "--out", str(out), "--origin", "north"]) == 2


def test_what_an_order_and_a_plan_cannot_say_is_told(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text("""
kind: environment
name: site
places: {a: {x: 0, y: 0}, b: {x: 10, y: 0}}
edges: [{from: a, to: b, length: 15 m, slope: 5 %, surface: gravel, temperature: 5 degC}]
""")
    (tmp_path / "mission.yaml").write_text("""
kind: mission
name: m
robot: pioneer3dx
environment: site.yaml
start: a
defaults: {scheme: forward_motion}
segments: [{drive: {to: b}}, {inspect: {duration: 5 s}}]
""")
    mission = load_mission(tmp_path / "mission.yaml")
    both = {f"{what} have no place in it" for what in ("slopes", "floors", "control schemes")}
    both |= {"temperatures and other conditions have no place in it", "inspections are written as waiting"}
    assert both <= set(order_of(mission)[1])
    assert both | {"lengths of ways have no place in it: they are straight"} <= set(plan_of(mission, (47.0, 8.0))[1])


def test_commands_write_the_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["export", "nav2", str(FILES / "yard.geojson"), "--robot", "pioneer3dx", "--out", str(out)]
    assert run_command([*arguments, "--json", "-"]) == 0
    assert len(json.loads(capsys.readouterr().out)["edges"]) == 3
    assert run_command([*arguments[:4], "pioneer4", *arguments[5:]]) == 2
    assert run_command([*arguments, "--battery", "main"]) == 2
    config = str(FILES / "cart_config.yaml")
    assert run_command(["export", "rmf", config, "--robot", "pioneer3dx", "--out", str(out), "--quiet"]) == 0
    mission = str(HERE.parents[1] / "missions/pioneer3dx/valve_patrol.yaml")
    assert run_command(["export", "vda5050", mission, "--out", str(out), "--quiet"]) == 0
    assert json.loads(out.read_text())["orderId"] == load_mission(mission).name
    assert run_command(["export", "vda5050", mission, "--out", str(out), "--version", "9"]) == 2
    # the input is not overwritten
    assert run_command([*arguments[:6], str(FILES / "yard.geojson")]) == 2
