"""What files found in the wild hold and the examples do not: ids that stand twice, empty parts, newer keys."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.exchange.formats import import_site
from missionsim.exchange.nav2 import export_costs
from missionsim.exchange.site import Site, SiteOptions, write_site
from missionsim.inputs.loading import load_robot


def site_of(path: Path, content: object, **options: Any) -> Site:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return import_site(path, SiteOptions(**options))


def lengths(site: Site) -> list[float]:
    return [edge.get("length") or site.straight(edge["from"], edge["to"]) or 0.0 for edge in site.edges]


def graph(*ends: tuple[int, int]) -> dict[str, Any]:
    """Nodes 0 to 2 at x = 0, 3 and 10; all edges share one id."""
    nodes = [
        {"properties": {"id": i, "frame": "map"}, "geometry": {"type": "Point", "coordinates": [x, 0]}}
        for i, x in enumerate((0, 3, 10))
    ]
    edges = [{"properties": {"id": 9, "startid": a, "endid": b}, "geometry": {"type": "LineString"}} for a, b in ends]
    return {"type": "FeatureCollection", "features": [*nodes, *edges]}


def test_costs_belong_to_the_edge_and_not_to_its_id(tmp_path: Path) -> None:
    path = tmp_path / "g.geojson"
    assert lengths(site_of(path, graph((0, 0), (0, 1), (1, 2)))) == [3.0, 7.0]
    found = export_costs(path, load_robot("pioneer3dx"))
    assert [edge["length_m"] for edge in found.edges] == [3.0, 7.0]
    costs = [feature["properties"].get("cost") for feature in json.loads(found.raw)["features"][3:]]
    assert costs == [None, *(pytest.approx(edge["cost"], rel=1e-5) for edge in found.edges)]
    assert "1 edges from a node to itself stay as they are" in found.remarks


def test_nodes_all_but_at_one_point_and_limits_of_nothing(tmp_path: Path) -> None:
    content = graph((0, 1), (1, 2), (2, 0))
    content["features"][1]["geometry"]["coordinates"] = [1e-8, 0]
    for feature, limit in zip(
        content["features"][3:], ({"speed_limit": 1e-8}, {"abs_speed_limit": 0}, {}), strict=True
    ):
        feature["properties"]["metadata"] = limit
    site = site_of(tmp_path / "g.geojson", content)
    write_site(site, tmp_path / "s.yaml")
    assert lengths(site) == [0.001, 10.0, 10.0]
    assert not any("max_speed" in edge for edge in site.edges)


def test_faults_of_what_is_written_name_the_file_it_was_made_of(tmp_path: Path) -> None:
    site = site_of(tmp_path / "g.geojson", graph((0, 1)))
    site.edges[0]["slope"] = 9.0
    with pytest.raises(InputError, match=r"g\.geojson: error(?s:.)*slope"):
        write_site(site, tmp_path / "s.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["g.geojson"]


def test_web_mercator_of_the_editor_is_256_wide(tmp_path: Path) -> None:
    # 0.001 degrees of longitude on the equator, and the same northwards: y goes down in the file
    a = 128 * (1 + 103.8 / 180)
    b = 128 * (1 + 103.801 / 180)
    north = 128 - 128 / math.pi * math.log(math.tan(math.pi / 4 + math.radians(0.001) / 2))
    text = f"""coordinate_system: web_mercator
crowd_sim: {{enable: 0}}
name: city
levels:
  L1:
    vertices:
      - [{a!r}, 128, 0, start]
      - [{b!r}, 128, 0, east]
      - [{a!r}, {north!r}, 0, north]
    lanes:
      - [0, 1, {{bidirectional: [4, true]}}]
      - [0, 2, {{}}]
    human_lanes:
      - [0, 1, {{}}]
"""
    site = site_of(tmp_path / "city.building.yaml", text)
    assert lengths(site) == pytest.approx([111.3195, 110.5743], rel=1e-5)
    assert site.places["north"]["y"] > site.places["start"]["y"]
    assert {"left out: crowd_sim", "left out: human_lanes"} <= set(site.remarks)


def layout(**edge: Any) -> dict[str, Any]:
    kinds = [{"manufacturer": "A", "seriesName": "cart"}, {"manufacturer": "B", "seriesName": "truck"}]
    charging = {"mobileRobotTypes": kinds, "feasibleActions": [{"actionType": "startCharging"}]}
    nodes = [{"nodeId": i, "mapId": "m", "nodePosition": {"x": x, "y": 0}} for i, x in (("N1", 0), ("N2", 10))]
    nodes[0]["mobileRobotTypeNodeProperties"] = [charging]
    properties = [{"mobileRobotTypes": kinds[:1], **edge}, {"mobileRobotTypes": kinds[1:], "maximumSpeed": 0.5}]
    way = {"edgeId": "E", "startNodeId": "N1", "endNodeId": "N2", "mobileRobotTypeEdgeProperties": properties}
    part = {"layoutId": "L", "nodes": nodes, "edges": [way]}
    return {"metaInformation": {"lifId": "hall", "lifVersion": "2.0.0"}, "origins": [{"layouts": [part]}]}


def test_layouts_of_version_2(tmp_path: Path) -> None:
    content = layout(maximumSpeed=1.5, reachOrientationBeforeEntering=True)
    site = site_of(tmp_path / "l.json", content)
    assert (site.chargers, site.title, lengths(site)) == (["N1"], "hall", [10.0])
    assert [edge["max_speed"] for edge in site.edges] == [0.5]
    assert "left out: reachOrientationBeforeEntering of an edge" in site.remarks
    cart = site_of(tmp_path / "l.json", content, vehicle="cart")
    assert [edge["max_speed"] for edge in cart.edges] == [1.5]
    content["origins"].append({"layouts": []})
    assert any("several origins" in message for message in site_of(tmp_path / "l.json", content).remarks)


def test_types_of_robots_of_the_drafts_between_1_and_2(tmp_path: Path) -> None:
    content = layout(maximumSpeed=1.5)
    for one, name in zip(
        content["origins"][0]["layouts"][0]["edges"][0]["mobileRobotTypeEdgeProperties"], ("T1", "T2"), strict=True
    ):
        del one["mobileRobotTypes"]
        one["mobileRobotTypeId"] = name
    site = site_of(tmp_path / "l.json", content, vehicle="T1")
    assert [edge["max_speed"] for edge in site.edges] == [1.5]
    assert not any("mobileRobotTypeId" in message for message in site.remarks)


def order(*limits: float) -> dict[str, Any]:
    """Nodes 10 m apart; edges as a ROS message writes them: what is not given is empty or 0."""
    nodes = [
        {"nodeId": f"n{i}", "sequenceId": 2 * i, "released": True, "nodePosition": {"x": 10 * i, "y": 0}, "actions": []}
        for i in range(len(limits) + 1)
    ]
    unset = {"length": 0.0, "trajectory": {"degree": 0.0, "knotVector": [], "controlPoints": []}, "actions": []}
    edges = [
        {"edgeId": f"e{i}", "sequenceId": 2 * i + 1, "released": True, "maxSpeed": limit, **unset}
        for i, limit in enumerate(limits)
    ]
    return {"orderId": "o", "zoneSetId": "z", "nodes": nodes, "edges": edges}


@pytest.mark.parametrize("limits", [(10.0, 0.3, 0.0), ()])
def test_order_with_limits_above_the_robot_and_empty_parts_is_driven(limits: tuple[float, ...], tmp_path: Path) -> None:
    path, out, mission = tmp_path / "o.json", tmp_path / "s.yaml", tmp_path / "m.yaml"
    path.write_text(json.dumps(order(*limits)))
    arguments = ["import-site", str(path), "--out", str(out), "--mission", str(mission), "--robot", "pioneer3dx"]
    assert run_command([*arguments, "--quiet"]) == 0
    assert run_command(["run", str(mission), "--json", str(tmp_path / "run.json"), "--quiet"]) == 0
    site = import_site(path, SiteOptions(load_robot("pioneer3dx")))
    assert [segment["drive"].get("speed") for segment in site.segments if "drive" in segment] == (
        [0.75, 0.3, None] if limits else []
    )
    assert "left out: zones 'z'" in site.remarks
    assert not any("straight" in message for message in site.remarks)


@pytest.mark.parametrize(("nodes", "edges"), [((1, 2, 3), (4, 5)), ((0, 1, 2), (0, 1)), ((0, 1, 2), (1, 2))])
def test_edges_that_are_numbered_otherwise_are_known_by_their_ends(
    nodes: tuple[int, ...], edges: tuple[int, ...], tmp_path: Path
) -> None:
    content = order(0.5, 0.3)
    for node, number in zip(content["nodes"], nodes, strict=True):
        node["sequenceId"] = number
    for i, (edge, number) in enumerate(zip(content["edges"], edges, strict=True)):
        edge |= {"sequenceId": number, "startNodeId": f"n{i}", "endNodeId": f"n{i + 1}"}
    site = site_of(tmp_path / "o.json", content)
    assert [(edge["from"], edge["to"], edge["max_speed"]) for edge in site.edges] == [
        ("n0", "n1", 0.5),
        ("n1", "n2", 0.3),
    ]


def test_a_heading_in_degrees_is_told(tmp_path: Path) -> None:
    content = order(0.5)
    content["nodes"][0]["nodePosition"]["theta"] = 90.0
    site = site_of(tmp_path / "o.json", content)
    assert "heading" not in site.places["n0"]
    assert "left out: theta of a node beyond 2 pi (the format has radians)" in site.remarks


def test_an_order_whose_nodes_have_no_number_is_not_said_to_have_no_nodes(tmp_path: Path) -> None:
    content = order(0.5)
    for node in content["nodes"]:
        del node["sequenceId"]
    with pytest.raises(InputError) as problem:
        site_of(tmp_path / "o.json", content)
    assert "without nodes" not in str(problem.value)


def test_an_order_in_the_envelope_of_a_broker_s_client(tmp_path: Path) -> None:
    saved = {"topic": "uagv/v2/acme/7/order", "qos": 0, "payload": order(1.0, 1.0)}
    assert lengths(site_of(tmp_path / "o.json", saved)) == [10.0, 10.0]


def test_state_message_is_no_order(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a state message, not an order(?s:.)*missionsim import"):
        site_of(tmp_path / "s.json", {"orderId": "o", "nodeStates": [], "edgeStates": []})


def test_what_a_track_holds_beside_its_way_is_told(tmp_path: Path) -> None:
    point = '<trkpt lat="47.0" lon="8.{}"><ele>400</ele><time>2026-01-01T00:00:00Z</time><hdop>1</hdop></trkpt>'
    points = "".join(point.format(i) for i in (1, 2))
    text = f"<gpx>\n<metadata/><trk><name>a</name><type>run</type><trkseg>{points}</trkseg></trk></gpx>"
    remarks = site_of(tmp_path / "t.gpx", text).remarks
    assert {f"left out: {what}" for what in ("metadata of a gpx", "type of a trk", "hdop of a trkpt")} <= set(remarks)
    assert remarks["left out: time of a trkpt"].count == 2


def test_segments_that_touch_have_no_way_between_them(tmp_path: Path) -> None:
    parts = "".join(
        f'<trkseg><trkpt lat="47" lon="8.0{i}"/><trkpt lat="47" lon="8.0{i + 1}"/></trkseg>' for i in (1, 2)
    )
    assert not any("assumed" in told for told in site_of(tmp_path / "t.gpx", f"<gpx><trk>{parts}</trk></gpx>").remarks)


def test_navigation_graph_generated_of_a_map(tmp_path: Path) -> None:
    text = """building_name: hall
levels:
  L1:
    lanes: [[0, 1, {speed_limit: 0.4}], [1, 0, {}], [1, 2, {is_bidirectional: true}]]
    vertices: [[0, -7, {name: ''}], [3, -3, {name: dock, is_charger: true}], [3, 0, {name: a, lift: lift1}]]
  L2:
    lanes: [[0, 1, {}]]
    vertices: [[3, 0, {name: b, lift: lift1}], [3, 2, {name: roof, is_parking_spot: false}]]
lifts:
  lift2: {}
"""
    site = site_of(tmp_path / "0.yaml", text)
    assert (site.format, site.chargers) == ("Open-RMF navigation graph", ["dock"])
    assert [(place["x"], place["y"]) for place in site.places.values()] == [(0, -7), (3, -3), (3, 0), (3, 2)]
    assert lengths(site) == [5.0, 5.0, 3.0, 2.0]
    assert (site.edges[3]["from"], site.edges[3]["to"]) == (site.edges[2]["to"], "roof")  # the lift joins both levels
    assert any("lift2" in message for message in site.remarks)
    assert not any("is_parking_spot" in message for message in site.remarks)


def test_lift_of_a_map_in_metres_joins_its_levels(tmp_path: Path) -> None:
    level = """
    vertices: [[5, 5.02, 0, {0}_lift], [9, 5, 0, {0}_end]]
    lanes: [[0, 1, {{bidirectional: [4, true]}}]]"""
    text = "coordinate_system: cartesian_meters\nname: m\nlevels:\n  L1:" + level.format("one") + "\n  L2:"
    text += (
        level.format("two")
        + "\nlifts:\n  up: {x: 5, y: 5, yaw: 0, width: 2, depth: 2, level_doors: {L1: [d], L2: [d]}}\n"
    )
    site = site_of(tmp_path / "m.building.yaml", text)
    assert len({edge["from"] for edge in site.edges}) == 1


def test_fiducials_hold_before_a_lift(tmp_path: Path) -> None:
    # both drawings lie over each other by their fiducials; the lift is drawn 10 pixels off
    text = "coordinate_system: reference_image\nname: m\nlevels:\n" + "".join(
        f"""  L{i}:
    fiducials: [[0, 0, a], [100, 0, b]]
    measurements: [[0, 1, {{distance: [3, 10]}}]]
    vertices: [[0, 0, 0, ""], [100, 0, 0, ""], [{50 + 10 * i}, 0, 0, "", {{lift_cabin: [1, up]}}], [200, 0, 0, end_{i}]]
    lanes: [[2, 3, {{bidirectional: [4, true]}}]]
"""
        for i in (0, 1)
    )
    site = site_of(tmp_path / "m.building.yaml", text + "lifts: {up: {level_doors: {L0: [d], L1: [d]}}}\n")
    assert site.places["end_1"]["x"] == site.places["end_0"]["x"] == 20.0
    assert not any("without fiducials" in message for message in site.remarks)


def test_plan_of_old_versions_has_its_home_as_an_item(tmp_path: Path) -> None:
    home, *items = (
        {"command": 16, "coordinate": [47.0 + i / 1000, 8.0, 0], "frame": 3, "id": i, "type": "missionItem"}
        for i in range(3)
    )
    content = {"complexItems": [{"id": 3}], "items": items, "plannedHomePosition": home, "version": "1.0"}
    site = site_of(tmp_path / "old.mission", content)
    assert lengths(site) == pytest.approx([111.18, 111.18], rel=1e-3)
    assert "left out: complexItems" in site.remarks


@pytest.mark.parametrize(("speeds", "of"), [({}, ""), ({"cruiseSpeed": 2.0}, ", cruiseSpeed is the speed")])
def test_the_speed_of_a_plan_is_the_one_that_it_has(speeds: dict[str, float], of: str, tmp_path: Path) -> None:
    items = [{"command": 16, "coordinate": [47.0 + i / 1000, 8.0, 0], "frame": 3} for i in range(2)]
    site = site_of(tmp_path / "p.plan", {"fileType": "Plan", "mission": {"items": items, **speeds}})
    assert f"the plan is not for a rover: waypoints are driven on the ground{of}" in site.remarks


def test_a_fence_is_no_mission(tmp_path: Path) -> None:
    rows = [f"{i} 0 0 5001 3 0 0 0 40.07{i} -105.23 0 1" for i in range(3)]
    with pytest.raises(InputError, match="a plan without waypoints"):
        site_of(tmp_path / "fence.txt", "\n".join(["QGC WPL 110", *rows]))


def test_survey_whose_writer_left_out_its_items(tmp_path: Path) -> None:
    survey = {"VisualTransectPoints": [[47.0, 8.0], [47.001, 8.0]]}
    items = [{"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": survey}]
    site = site_of(tmp_path / "s.plan", {"fileType": "Plan", "mission": {"items": items, "vehicleType": 10}})
    assert lengths(site) == pytest.approx([111.18], rel=1e-3)


def test_lowest_of_several_speeds_of_a_street(tmp_path: Path) -> None:
    nodes = [{"id": "a", "x": 0, "y": 0}, {"id": "b", "x": 9, "y": 0}]
    street = {"source": "a", "target": "b", "maxspeed": "['50', '30', '25 mph']"}
    site = site_of(tmp_path / "g.json", {"nodes": nodes, "links": [street]})
    assert site.edges[0]["max_speed"] == pytest.approx(30 / 3.6)


def test_what_of_an_edge_is_no_number_is_told(tmp_path: Path) -> None:
    nodes = [{"id": "a", "x": 0, "y": 0}, {"id": "b", "x": 9, "y": 0}]
    edge = {"source": "a", "target": "b", "max_speed": "abc", "slope": "steep", "length": None}
    site = site_of(tmp_path / "g.json", {"nodes": nodes, "links": [edge]})
    told = " ".join(str(vars(remark)) for remark in site.remarks.values())
    assert "'max_speed' of an edge that is no number" in told
    assert "'slope' of an edge that is no number" in told
    assert "length" not in told
