"""What `import-site` makes of files of other tools; the files here were written by hand, numbers follow from them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.errors import Fault, InputError
from missionsim.exchange.formats import import_site
from missionsim.exchange.gpx import smooth_slopes
from missionsim.exchange.site import LocalPlane, SiteOptions, write_site
from missionsim.exchange.vda5050 import nurbs_length
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.loading import load_environment, load_mission, load_robot
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.segments import flat_segments

FILES = Path(__file__).parents[2] / "docs" / "examples" / "sites"


def loaded(name: str, tmp_path: Path, **options: Any) -> EnvironmentSpec:
    out = tmp_path / "site.yaml"
    write_site(import_site(FILES / name, SiteOptions(**options)), out)
    return load_environment(out)


def ways(environment: EnvironmentSpec) -> dict[tuple[str, str], float]:
    return {(a, b): environment.length_m(edge) for _, edge, a, b in environment.open_ways()}


def written(name: str, tmp_path: Path) -> MissionSpec:
    """Mission of a file, for the Pioneer."""
    site = import_site(FILES / name, SiteOptions(load_robot("pioneer3dx")))
    write_site(site, tmp_path / "s.yaml", tmp_path / "m.yaml", "pioneer3dx")
    return load_mission(tmp_path / "m.yaml")


def told(name: str, **options: Any) -> list[str]:
    return [remark.message for remark in import_site(FILES / name, SiteOptions(**options)).remarks.values()]


def test_nav2_keeps_ids_directions_and_lengths(tmp_path: Path) -> None:
    site = loaded("yard.geojson", tmp_path)
    assert ways(site) == {("0", "1"): 5.0, ("1", "0"): 5.0, ("1", "2"): 6.0}
    assert [edge.name for edge in site.edges] == ["3", "4", "5"]
    assert site.places["0"].charger is not None
    assert site.places["1"].charger is None
    assert site.places["0"].title == "bay"
    assert site.edges[0].max_speed is not None
    assert site.edges[0].max_speed.value == 0.5
    messages = told("yard.geojson")
    assert "left out: way from a place to itself" in messages
    assert any("operations" in message for message in messages)
    assert any("aisle" in message for message in messages)


def test_nav2_speed_limit_is_a_share_of_the_robots_top_speed(tmp_path: Path) -> None:
    robot = load_robot("pioneer3dx")
    speed = loaded("yard.geojson", tmp_path, robot=robot).edges[0].max_speed
    assert speed is not None
    assert speed.value == pytest.approx(0.5 * robot.body.max_speed.value)


def test_building_scales_aligns_and_joins_levels(tmp_path: Path) -> None:
    site = loaded("two_floors.building.yaml", tmp_path)
    # 0.05 m a pixel below; above, a to b is drawn with 100 pixels for the same 10 m, a quarter turn away
    assert site.places["dock"].position == pytest.approx((10.0, 0.0))
    assert site.places["lift1"].position == pytest.approx((5.0, -5.0))
    assert site.places["L2_store"].position == pytest.approx((10.0, -5.0))
    assert site.places["L1_store"].position == pytest.approx((0.0, -5.0))
    found = ways(site)
    assert found["lift1", "L2_store"] == pytest.approx(5.0)
    assert ("L1_store", "lift1") not in found  # that lane leads one way
    assert ("L2_store", "lift1") in found
    assert site.places["dock"].charger is not None
    assert [edge.max_speed and edge.max_speed.value for edge in site.edges] == [None, 0.6, None, None]
    assert len(loaded("two_floors.building.yaml", tmp_path, graph=1).edges) == 1


def test_building_without_measurements_needs_a_scale(tmp_path: Path) -> None:
    text = (FILES / "two_floors.building.yaml").read_text().replace("- [0, 1, {distance: [3, 10]}]", "[]")
    broken = tmp_path / "b.building.yaml"
    broken.write_text(text)
    with pytest.raises(InputError, match=r"b.building.yaml:7:5.*without measurements(?s:.)*--scale"):
        import_site(broken)
    assert import_site(broken, SiteOptions(scale=0.1)).places["dock"]["x"] == pytest.approx(20.0)


def test_lif_takes_vehicle_trajectory_and_chargers(tmp_path: Path) -> None:
    site = loaded("hall.lif.json", tmp_path, vehicle="cart")
    assert ways(site)["mid", "out"] == pytest.approx(math.pi / 2 * 10.0, rel=1e-4)  # a quarter circle
    assert [edge.max_speed.value for edge in site.edges if edge.max_speed] == [1.5, 1.0]
    assert [name for name, place in site.places.items() if place.charger] == ["in", "out"]
    assert site.places["in"].heading is not None
    assert len(loaded("hall.lif.json", tmp_path, vehicle="truck").edges) == 1
    with pytest.raises(InputError, match="no edge or node is for vehicle type 'lorry'"):
        import_site(FILES / "hall.lif.json", SiteOptions(vehicle="lorry"))


def test_track_gets_smoothed_slopes_and_names(tmp_path: Path) -> None:
    site = loaded("hill.gpx", tmp_path)
    climb = [edge for edge in site.edges if edge.slope.value]
    assert len(climb) == 4
    assert [math.tan(edge.slope.value) for edge in climb] == pytest.approx([0.0998] * 4, abs=0.002)
    assert site.places["hill 0"].title == "gate"
    assert {"top", "hut"} <= set(site.places)


def test_a_track_across_the_antimeridian_is_as_long_as_it_is(tmp_path: Path) -> None:
    """110 m were 39,470,272 m: the middle of 179.9995° and -179.9995° was 0°."""
    points = "".join(f'<trkpt lat="10" lon="{longitude}"/>' for longitude in (179.9995, 180.0, -179.9995))
    path, out = tmp_path / "line.gpx", tmp_path / "site.yaml"
    path.write_text(f"<gpx><trk><name>line</name><trkseg>{points}</trkseg></trk></gpx>")
    write_site(import_site(path), out)
    lengths = ways(load_environment(out))
    assert sum(lengths.values()) / 2 == pytest.approx(109.6, abs=0.1)  # 0.001° of the parallel of 10°


def test_plan_becomes_a_mission(tmp_path: Path) -> None:
    for name in ("rover.waypoints", "rover.plan"):
        mission = written(name, tmp_path)
        assert mission.start == "home"
        assert mission.environment is not None
        assert mission.environment.straight_m("home", "waypoint_1") == pytest.approx(76.06, abs=0.01)  # WGS 84
    # the first round begins at the plan's speed, the other two at that of the first one's end
    assert [segment.kind for segment in mission.segments] == ["drive", "wait", "drive", "repeat", "wait", "drive"]
    assert mission.segments[3].times == 2
    inner = list(flat_segments(mission.segments))
    assert [segment.kind for segment in inner] == [*("drive", "wait", "drive") * 2, "wait", "drive"]
    assert mission.defaults.speed is not None
    assert mission.defaults.speed.value == 0.6
    assert inner[0].speed is None
    assert [inner[i].speed.value for i in (2, 3, 5)] == [0.3] * 3
    assert inner[7].to == "home"


def test_order_becomes_a_mission(tmp_path: Path) -> None:
    mission = written("order.json", tmp_path)
    assert [segment.kind for segment in mission.segments] == ["drive", "wait", "drive", "dock"]
    assert mission.segments[1].duration.value == 12.5
    assert mission.environment is not None
    assert ways(mission.environment) == {("A", "B"): 8.0, ("B", "A"): 8.0}
    assert mission.environment.edges[0].max_speed is not None
    assert mission.environment.places["A"].charger is not None
    assert run_command(["run", str(tmp_path / "m.yaml"), "--quiet"]) in (0, 1)


def test_graphs_of_networkx(tmp_path: Path) -> None:
    streets = loaded("streets.graphml", tmp_path)
    edge = streets.edges[0]
    assert (streets.length_m(edge), edge.both_ways) == (120.5, False)
    assert edge.max_speed is not None
    assert edge.max_speed.value == pytest.approx(30 / 3.6, abs=1e-5)
    assert math.tan(edge.slope.value) == pytest.approx(0.05, abs=1e-5)
    lab = loaded("lab.json", tmp_path)
    assert ways(lab) == {("bench", "door"): 5.0, ("door", "bench"): 5.0, ("door", "far"): 12.0, ("far", "door"): 12.0}
    assert lab.places["bench"].charger is not None


@pytest.mark.long
def test_every_shared_site_is_read_or_refused_with_a_line(shared: Path, tmp_path: Path) -> None:
    folder = shared / "sites"
    if not folder.is_dir():
        pytest.skip("no shared sites here")
    read: list[str] = []
    refused: dict[str, tuple[Fault, ...]] = {}
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        try:
            write_site(import_site(path), tmp_path / "site.yaml")
            assert load_environment(tmp_path / "site.yaml").edges
            read.append(path.name)
        except InputError as problem:
            refused[path.name] = problem.faults
    assert {path.name for path in folder.rglob("*") if path.suffix in (".geojson", ".gpx", ".plan")} <= set(read)
    assert {path.name for path in folder.glob("open_rmf/*.building.yaml")} | {"example.lif.json"} <= set(read)
    assert all(fault.line and fault.file for faults in refused.values() for fault in faults), refused
    assert all("LICENSE" in name or "schema" in name or "README" in name or "config" in name for name in refused)


def test_shared_campus_is_as_long_as_on_the_ellipsoid(shared: Path) -> None:
    path = shared / "sites/open_rmf/campus.building.yaml"
    if not path.is_file():
        pytest.skip("no shared sites here")
    import yaml

    level = yaml.safe_load(path.read_text())["levels"]["L1"]
    total = 0.0
    for start, end, _ in level["lanes"]:
        (x1, y1), (x2, y2) = level["vertices"][start][:2], level["vertices"][end][:2]
        # haversine on a sphere of the mean radius differs from the ellipsoid by at most 0.6 %
        a = math.sin(math.radians(y2 - y1) / 2) ** 2
        a += math.cos(math.radians(y1)) * math.cos(math.radians(y2)) * math.sin(math.radians(x2 - x1) / 2) ** 2
        total += 2 * 6_371_008.8 * math.asin(math.sqrt(a))
    assert import_site(path).length_m == pytest.approx(total, rel=0.006)


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("yard.geojson", '"endid": 2, "metadata"', '"endid": 9, "metadata"', "no node has this id"),
        ("yard.geojson", '"coordinates": [ 3.0, 10.0 ]', '"coordinates": [ 3.0, "x" ]', "must be a number"),
        ("yard.geojson", '"id": 1,', '"id": 0,', "stands twice"),
        ("yard.geojson", "} } },", "} }", "not JSON"),
        ("two_floors.building.yaml", "- [3, 4,", "- [3, 40,", "no vertex has this number"),
        ("two_floors.building.yaml", "distance: [3, 10]", "distance: [3, -10]", "impossible value"),
        ("two_floors.building.yaml", "- [0, 1, {distance", "- [1, 1, {distance", "at one place"),
        ("two_floors.building.yaml", "[3, 0.6]", "[3, -1]", "impossible value"),
        ("two_floors.building.yaml", "[3, 0.6]", "[3, .nan]", "impossible value"),
        ("two_floors.building.yaml", "graph_idx: [2, 1]", "graph_idx: [2, x]", "must be a whole number"),
        ("two_floors.building.yaml", "is_charger: [4, true]", "is_charger: [4, maybe]", "must be true or false"),
        ("two_floors.building.yaml", "bidirectional: [4, false]", "bidirectional: 1", "must be true or false"),
        ("hall.lif.json", '"endNodeId": "out"', '"endNodeId": "exit"', "no node has this id"),
        ("hall.lif.json", '"x": 10.0, "y": 0.0}, "veh', '"x": 1e400, "y": 0.0}, "veh', "impossible value"),
        ("rover.plan", "47.0, 8.001, 0", "147.0, 8.001, 0", "no latitude and longitude"),
        ("rover.waypoints", "8.001", "here", "not a waypoint"),
        ("order.json", '3, "released": false, "startNodeId": "B"', '5, "x": "C"', "an edge that leads to no node"),
        ("hill.gpx", 'lat="47.0005"', 'lat="470005"', "needs lat and lon"),
        ("hill.gpx", "</trkpt>", "</trkpnt>", "not XML"),
        ("streets.graphml", 'target="12"', 'target="13"', "no node has this id"),
        ("lab.json", '"target": "far"', '"target": "near"', "no node has this id"),
    ],
)  # fmt: skip
def test_faults_tell_their_line(name: str, old: str, new: str, says: str, tmp_path: Path) -> None:
    text = (FILES / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        import_site(tmp_path / name)
    line = text.count("\n", 0, text.index(old)) + 1
    assert any(fault.line in (line, line + 1) and says in fault.message for fault in caught.value.faults), caught.value
    assert len(caught.value.faults) == 1 or says in ("stands twice", "an edge that leads to no node")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (" \n", "the file is empty"),
        ("<kml></kml>", "no format that is known"),
        ("<!DOCTYPE gpx [<!ENTITY a 'b'>]><gpx>&a;</gpx>", "document type declarations are not read"),
        ("<gpx>" * 70 + "</gpx>" * 70, "nested too deeply"),
        ("<gpx></gpx>", "without tracks, routes and waypoints"),
        ("[" * 70 + "]" * 70, "nested too deeply"),
        ('{"a": 1, "a": 2}', "key 'a' stands twice"),
        ('{"a": }', "not JSON: expecting value"),
        ('{"$schema": "https://json-schema.org/draft/2020-12/schema"}', "a JSON schema, not a file that follows it"),
        ("rmf_fleet: {name: tinyRobot}", "a fleet, not a site"),
        ("names: [a, b]", "no format that is known"),
        ('{"layouts": [{"nodes": []}]}', "a layout without nodes"),
    ],
)
def test_what_is_no_site_is_told(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "site").write_text(text)
    with pytest.raises(InputError, match=says):
        import_site(tmp_path / "site")


def test_command_writes_both_files_or_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, mission, told = tmp_path / "s.yaml", tmp_path / "m.yaml", tmp_path / "told.json"
    arguments = ["import-site", str(FILES / "rover.plan"), "--out", str(out), "--mission", str(mission)]
    assert run_command([*arguments, "--json", str(told)]) == 0
    summary = json.loads(told.read_text())
    assert (summary["places"], summary["format"], summary["segments"]) == (3, "QGroundControl plan", 6)
    assert "pioneer3dx, since --robot names none" in capsys.readouterr().out
    assert run_command(["validate", str(out), str(mission), "--quiet"]) == 0
    out.unlink()
    mission.unlink()
    arguments[1] = str(FILES / "yard.geojson")
    assert run_command(arguments) == 2
    assert "holds no mission" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["told.json"]


def test_local_plane_inverts_and_keeps_distances() -> None:
    plane = LocalPlane(47.0, 8.0)
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(-10_000, 10_000, (20, 2)):
        latitude, longitude = plane.to_degrees(float(x), float(y))
        assert plane.to_metres(latitude, longitude) == pytest.approx((x, y), abs=1e-5)
    # lengths of a degree as series in the latitude (Bowditch, American Practical Navigator)
    middle, parallel = math.radians(47.005), math.radians(47.0)
    north = 111132.92 - 559.82 * math.cos(2 * middle) + 1.175 * math.cos(4 * middle)
    east = 111412.84 * math.cos(parallel) - 93.5 * math.cos(3 * parallel) + 0.118 * math.cos(5 * parallel)
    assert plane.to_metres(47.01, 8.0)[1] == pytest.approx(0.01 * north, rel=1e-5)
    assert plane.to_metres(47.0, 8.01)[0] == pytest.approx(0.01 * east, rel=1e-5)


def test_nurbs_refuses_what_does_not_fit() -> None:
    assert nurbs_length([(0, 0), (3, 4)], [1, 1], [0, 0, 1, 1], 1) == pytest.approx(5.0)
    # a corner was cut
    assert nurbs_length([(0, 0), (5, 12), (10, 0)], [1] * 3, [0, 0, 0.41, 1, 1], 1) == pytest.approx(26.0, rel=1e-12)
    assert nurbs_length([(0, 0), (3, 4)], [1, 1], [0, 1, 2], 3) is None


def test_slopes_of_a_noisy_steady_climb() -> None:
    rng = np.random.default_rng(3)
    along = np.arange(0.0, 1000.0, 2.0)
    height = 0.05 * along + rng.normal(0.0, 2.0, len(along))
    ends = np.linspace(0.0, 998.0, 41)
    raw = np.diff(np.interp(ends, along, height)) / np.diff(ends)
    smooth = np.tan(smooth_slopes(along, height, ends, 50.0))
    assert np.std(smooth) < 0.35 * np.std(raw)
    assert np.mean(smooth) == pytest.approx(0.05, abs=0.005)


def test_a_speed_holds_into_the_next_round_of_a_jump(tmp_path: Path) -> None:
    """QGroundControl's DO_JUMP: all rounds but the first begin at the speed that the first one ended with."""
    rows = [
        (0, 16, 0, 0, 47.0, 8.0),
        (1, 178, 1, 1.5, 0, 0),
        (2, 16, 0, 0, 47.0001, 8.0),
        (3, 178, 1, 0.5, 0, 0),
        (4, 16, 0, 0, 47.0002, 8.0),
        (5, 177, 2, 2, 0, 0),
    ]
    lines = [f"{n}\t0\t3\t{c}\t{a}\t{b}\t0\t0\t{x}\t{y}\t0\t1" for n, c, a, b, x, y in rows]
    (tmp_path / "w.waypoints").write_text("\n".join(["QGC WPL 110", *lines]) + "\n")
    site = import_site(tmp_path / "w.waypoints", SiteOptions())
    first, second, block = site.segments
    assert [first["drive"]["speed"], second["drive"]["speed"]] == [1.5, 0.5]
    assert block["repeat"]["times"] == 2
    assert [part["drive"]["speed"] for part in block["repeat"]["segments"]] == [0.5, 0.5]


def test_charging_that_an_order_ends_is_told(tmp_path: Path) -> None:
    action = {"actionType": "stopCharging", "actionId": "1", "blockingType": "HARD"}
    place = {"x": 0.0, "y": 0.0, "mapId": "m"}
    node = {"nodeId": "a", "sequenceId": 0, "released": True, "nodePosition": place, "actions": [action]}
    order = {"orderId": "o", "orderUpdateId": 0, "nodes": [node], "edges": [], "version": "2.0.0", "headerId": 0}
    (tmp_path / "o.json").write_text(json.dumps(order))
    remarks = import_site(tmp_path / "o.json", SiteOptions()).remarks
    assert "left out: stopCharging: charging until full holds" in remarks
