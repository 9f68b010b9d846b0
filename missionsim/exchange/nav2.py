"""Nav2 route graphs (GeoJSON): nodes are points, each edge leads one way.

Format: the graph file loader of nav2_route. Edges are as long as the straight line between their nodes; their drawn
geometry is for display. ``speed_limit`` is a share (or percentage) of the top speed, ``abs_speed_limit`` is in m/s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.exchange.site import Site, SiteOptions, flow, says_charger
from missionsim.exchange.source import Faults, Value, parse_json, read_text, rewritten
from missionsim.inputs.loading import mission_from_text
from missionsim.inputs.power import build_power_model
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.tree import Node
from missionsim.physics import Array
from missionsim.plan.build import make_plan
from missionsim.plan.legs import steady_power_w

_TITLES = ("name", "label", "title")
_LINES = ("LineString", "MultiLineString")
_SPEEDS = ("speed_limit", "abs_speed_limit")


def read(root: Value, site: Site) -> None:
    """Fill the site."""
    features = root.entries("features")
    nodes: list[tuple[Value, Value]] = []
    edges: list[Value] = []
    for feature in features:
        geometry = feature.get("geometry")
        kind = geometry.word("type") if geometry else ""
        properties = feature.need("properties")
        if properties is None or geometry is None:
            if geometry is None:
                feature.fault("a feature without geometry", "Point, LineString or MultiLineString")
        elif kind == "Point":
            nodes.append((properties, geometry))
        elif kind in _LINES:
            edges.append(properties)
        else:
            site.tell(f"left out: {kind or 'a feature of no kind'}: a route graph has points and lines", feature.line)
    names = _nodes(root, site, nodes)
    for edge in edges:
        _edge(edge, site, names)
    if not nodes:
        root.fault("a route graph without nodes", "features of the kind Point")


def _nodes(root: Value, site: Site, nodes: list[tuple[Value, Value]]) -> dict[str, str]:
    names: dict[str, str] = {}
    positions = [_position(geometry) for _, geometry in nodes]
    plane = None
    crs = str(root.fields.get("crs"))
    if any(code in crs for code in ("4326", "CRS84")) and any(positions):
        points = [(p[1], p[0]) for p in positions if p]
        if all(abs(latitude) <= 90 and abs(longitude) <= 360 for latitude, longitude in points):
            plane = site.plane(points)
    for (properties, _), position in zip(nodes, positions, strict=True):
        number = _id(properties)
        if number is None or position is None:
            names.setdefault(str(properties.fields.get("id")), "")
            continue
        if names.get(number):
            properties.fault(f"node {number} stands twice", "an id of its own")
            continue
        metadata = properties.get("metadata")
        data = metadata.data if metadata else {}
        title = next((str(data[key]) for key in _TITLES if isinstance(data, dict) and key in data), "")
        _left(properties, site, "a node", _TITLES)
        where = plane.to_metres(position[1], position[0]) if plane else position[:2]
        height = position[2] if len(position) > 2 else None
        if charger := says_charger(data):
            site.tell("node is taken for a charger, because its metadata says so", properties.line)
        names[number] = site.place(number, (where[0], where[1]), height, title=title, charger=charger)
    return names


def _position(geometry: Value) -> tuple[float, ...] | None:
    coordinates = geometry.entries("coordinates")
    if len(coordinates) not in (2, 3):
        geometry.fault("a point has coordinates [x, y]", "[x, y]")
        return None
    numbers = [value.number() for value in coordinates]
    return None if None in numbers else tuple(number for number in numbers if number is not None)


def _id(properties: Value) -> str | None:
    found = properties.need("id")
    if found is None:
        return None
    if type(found.data) not in (int, str) or (type(found.data) is int and found.data < 0):
        found.fault("an id is a whole number from 0", "0, 1, 2 …")
        return None
    return str(found.data)


def _edge(edge: Value, site: Site, names: dict[str, str]) -> None:
    number = _id(edge)
    start, end = (found.named(names) if (found := edge.need(key)) else None for key in ("startid", "endid"))
    if number is None or not start or not end:
        return
    _left(edge, site, "an edge", _SPEEDS)
    if edge.has("cost"):
        site.tell("left out: cost of an edge, which ours replaces (missionsim export nav2)", edge.line)
    metadata, speed = edge.get("metadata"), None
    if metadata and (found := metadata.get("abs_speed_limit")):
        speed = found.number(0.0, 60.0)  # 0 is no limit, as for speed_limit
    elif metadata and (found := metadata.get("speed_limit")) and (speed := found.number(0.0, 100.0)):
        if speed > 1.0:  # AdjustSpeedLimit publishes per cent, DistanceScorer divides by a share
            site.tell("speed_limit above 1 is per cent of the top speed", found.line)
            speed /= 100.0
        if robot := site.options.robot:
            site.tell(f"speed_limit is a share of the top speed of {robot.name}", found.line)
            speed *= robot.body.max_speed.value
        else:
            unknown = "written for a top speed of 1 m/s; --robot tells"
            site.tell(f"speed_limit is a share of the top speed: {unknown}", found.line)
    site.edge(start, end, edge.line, name=number, max_speed=speed or None)


def _left(properties: Value, site: Site, what: str, used: tuple[str, ...]) -> None:
    """Tell what of a node or edge has no place in an environment."""
    for key in ("operations", "overridable", "frame"):
        if found := properties.get(key):
            site.tell(f"left out: {key} of {what}", found.line)
    if (metadata := properties.get("metadata")) and isinstance(metadata.data, dict):
        for name, entry in metadata.items():
            if name not in used:
                site.tell(f"left out: metadata '{name[:40]}' of {what}", entry.line)


@dataclass(frozen=True)
class GraphCosts:
    """A route graph with costs for a robot."""

    raw: bytes
    """The file; all but ``cost`` and ``speed_limit`` of the edges is as it was, byte for byte."""
    edges: list[dict[str, Any]]
    """``id``, ``length_m``, ``speed_m_s``, ``energy_wh``, ``seconds``, ``cost`` of each edge, in the file's order."""
    remarks: tuple[str, ...]


def export_costs(
    path: str | Path,
    robot: RobotSpec,
    *,
    battery: str = "",
    wh_per_s: float = 0.0,
    speed: float | None = None,
    best_speed: bool = False,
    payload_kg: float = 0.0,
) -> GraphCosts:
    """Cost and speed limit of each edge for this robot, in the text of the graph.

    `battery`: whose energy counts; all of them together by default. `wh_per_s`: what a second is worth, Wh: the cost is
    energy + `wh_per_s` · time. `speed`: wanted, m/s; the top speed by default. The limit of an edge holds as well.
    `best_speed`: take the speed of the lowest cost, up to the limit, on each edge.
    """
    text = read_text(path)
    document = parse_json(text.removeprefix("\ufeff"), str(path))
    faults = Faults(str(path))
    root = Value(document, faults, document.root)
    site = Site(str(path), "Nav2 route graph", "", SiteOptions(robot))
    read(root, site)
    faults.stop()
    known = iter(site.edges)  # one for each edge of the file that leads to another node; ids may stand twice
    top = robot.body.max_speed.value
    drives: dict[tuple[float, float], float] = {}
    wanted = []
    for feature in root.entries("features"):
        geometry, properties = feature.get("geometry"), feature.get("properties")
        if geometry is None or geometry.word("type") not in _LINES:
            continue
        same = properties is None or properties.fields["startid"] == properties.fields["endid"]
        edge = {} if same else next(known)
        limit = min(top, speed or top, edge.get("max_speed") or top)
        slope = edge.get("slope", 0.0)
        speeds = [limit * share for share in (np.linspace(0.1, 1.0, 19) if best_speed else [1.0])]
        drives |= {(slope, pace): 0.0 for pace in speeds}
        wanted.append((properties, edge, slope, speeds))
    powers = steady_power(robot, list(drives), payload_kg=payload_kg)
    watts = powers[battery] if battery else np.sum(list(powers.values()), axis=0)
    drives = dict(zip(drives, watts.tolist(), strict=True))
    edits: list[tuple[int, int, str]] = []
    told = []
    negative = 0
    for properties, edge, slope, speeds in wanted:
        if properties is None or not edge:
            continue
        length = edge.get("length") or site.straight(edge["from"], edge["to"]) or 0.0
        costs = [(drives[slope, pace] / 3600.0 + wh_per_s) * length / pace for pace in speeds]
        best = int(np.argmin(costs))
        pace, cost = speeds[best], max(0.0, costs[best])
        negative += costs[best] < 0.0
        energy = drives[slope, pace] / 3600.0 * length / pace
        row = {"id": properties.fields["id"], "length_m": length, "speed_m_s": pace, "energy_wh": energy}
        told.append({**row, "seconds": length / pace, "cost": cost})
        _edit(properties, cost, pace / top, edits)
    remarks = ["starts, stops and turns are not in the costs: a route knows them, an edge does not"]
    if len(told) < len(wanted):
        remarks.append(f"{len(wanted) - len(told)} edges from a node to itself stay as they are")
    if speed is not None and speed > top:
        remarks.append(f"the robot's top speed, {top:g} m/s, holds: {speed:g} m/s is above it")
    if negative:
        remarks.append(
            f"{negative} edges give energy back: their cost is 0, since the route server takes no negative one"
        )
    return GraphCosts(rewritten(path, text, edits), told, tuple(remarks))


def steady_power(
    robot: RobotSpec, drives: Sequence[tuple[float, float]], *, payload_kg: float = 0.0
) -> dict[str, Array]:
    """Power of each battery while driving straight on: without starts, stops and turns, warm, batteries full.

    Under the robot's first control scheme that moves. `drives`: slope [rad] and speed [m/s] of each. Gives arrays of
    shape (len(drives),) [W]. Raises InputError: what the robot cannot do.
    """
    scheme = next((name for name, spec in robot.schemes.items() if spec.motion), "")
    defaults = {"scheme": scheme, "profile": "constant_speed", "payload": f"{payload_kg:.9g} kg" if payload_kg else ""}
    lines = [f"kind: mission\nname: steady\nrobot: {flow(robot.name)}"]
    lines.append(f"defaults: {flow({key: value for key, value in defaults.items() if value})}\nsegments:")
    for slope, speed in drives:
        lines.append(f"  - drive: {{distance: 1 m, slope: {slope:.12g} rad, speed: {speed:.12g} m/s}}")
    legs = make_plan(mission_from_text("\n".join(lines) + "\n", robot)).legs
    return steady_power_w(robot, build_power_model(robot), [leg for leg in legs if leg.kind == "roll"])


def _edit(properties: Value, cost: float, share: float, edits: list[tuple[int, int, str]]) -> None:
    """Where the text of an edge's properties changes: replaced where there is one, else put behind the last entry."""
    limit = f'"speed_limit": {_number(share)}'
    metadata = properties.node.children.get("metadata") if isinstance(properties.node.children, dict) else None
    if metadata is not None and isinstance(metadata.children, dict):
        _put(metadata, "speed_limit", _number(share), edits)
    elif metadata is not None:
        edits.append((metadata.start, metadata.end, f"{{ {limit} }}"))
    _put(properties.node, "cost", _number(cost), edits, *([f'"metadata": {{ {limit} }}'] if metadata is None else []))


def _put(parent: Node, key: str, value: str, edits: list[tuple[int, int, str]], *more: str) -> None:
    assert isinstance(parent.children, dict)
    found = parent.children.get(key)
    if found is not None:
        edits.append((found.start, found.end, value))
    entries = [*([] if found else [f'"{key}": {value}']), *more]
    if entries and parent.children:
        last = list(parent.children.values())[-1]
        edits.append((last.end, last.end, "".join(f", {entry}" for entry in entries)))
    elif entries:
        edits.append((parent.start + 1, parent.end - 1, f" {', '.join(entries)} "))


def _number(value: float) -> str:
    """Six digits, always with a point: the route server reads costs as floating-point numbers."""
    return repr(float(f"{value:.6g}")) if math.isfinite(value) else "0.0"
