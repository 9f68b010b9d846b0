"""VDA 5050 orders (1.1 to 3.0), and the layouts of the VDMA (LIF 1 and 2) beside them: both share trajectories.

Orders: nodes and edges in the order of their sequenceId, with actions. Format: VDA 5050, "Interface for the
communication between automated guided vehicles and a master control", and its JSON schema of the order. Speed limits
are ``maxSpeed`` (to 2.x) or ``maximumSpeed`` (3.0), m/s.

Layouts: nodes, one-way edges per type of vehicle, stations. Format: VDMA, "LIF – Layout Interchange Format", and its
JSON schema. Metres; a trajectory is a NURBS. Whether a node has a charger is told by its action ``startCharging``, or
by the name of the station at it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.exchange.site import Site, clean, says_charger, stops_of
from missionsim.exchange.source import Value, finite
from missionsim.files import Json
from missionsim.inputs.mission import MissionSpec

_NODE_KEYS = ("vehicleTypeNodeProperties", "mobileRobotTypeNodeProperties")
_EDGE_KEYS = ("vehicleTypeEdgeProperties", "mobileRobotTypeEdgeProperties")
_ACTION_KEYS = ("actions", "requiredActions", "feasibleActions")
_PROPERTIES_USED = {"vehicleTypeId", "mobileRobotTypeId", "mobileRobotTypes", "maxSpeed", "maximumSpeed", "trajectory"}


def read_layout(root: Value, site: Site) -> None:
    """Fill the site: all layouts, since they share one origin."""
    meta = root.get("metaInformation")
    site.title = (meta.word("projectIdentification") or meta.word("lifId")) if meta else ""
    origins = root.entries("origins")
    layouts = [layout for part in (root, *origins) for layout in part.entries("layouts")]
    if len(origins) > 1:
        site.tell("layouts of several origins: how they lie to each other is not in the file, one origin is assumed")
    parts = (("nodes", _NODE_KEYS), ("edges", _EDGE_KEYS))
    items = [(item, keys) for layout in layouts for part, keys in parts for item in layout.entries(part)]
    vehicles = {name for item, keys in items for found in item.entries(*keys) for name in _types(found)}
    if (wanted := site.options.vehicle) and wanted not in vehicles:
        root.fault(f"no edge or node is for vehicle type '{wanted}'", ", ".join(sorted(vehicles)) or "none")
        return
    if len(vehicles) > 1 and not wanted:
        listed = ", ".join(sorted(vehicles)[:6])
        site.tell(
            f"all types of vehicle are read, the lowest speed of each edge holds; --vehicle takes one of: {listed}"
        )

    def properties_of(item: Value, keys: tuple[str, ...]) -> list[Value]:
        return [one for one in item.entries(*keys) if not wanted or wanted in _types(one)]

    names: dict[str, str] = {}
    for node in (node for layout in layouts for node in layout.entries("nodes")):
        identity = node.need("nodeId") and node.word("nodeId")
        position = node.need("nodePosition")
        x, y = (position.need(key) for key in ("x", "y")) if position else (None, None)
        numbers = [value.number() if value else None for value in (x, y)]
        if not identity or numbers[0] is None or numbers[1] is None:
            names.setdefault(str(node.fields.get("nodeId")), "")
            continue
        if names.get(identity):
            node.fault("a node's id stands twice", "nodeId of its own")
            continue
        properties = properties_of(node, _NODE_KEYS)
        actions = [action for one in properties for key in _ACTION_KEYS for action in one.entries(key)]
        others = [action for action in actions if action.word("actionType").lower() != "startcharging"]
        for action in others:
            site.tell("left out: action of a node", action.line)
        heading = next((angle for one in properties if (angle := _heading(one, site)) is not None), None)
        title = node.word("nodeName") or node.word("nodeDescription") or node.word("nodeDescriptor")
        where = (numbers[0], numbers[1])
        charger = len(others) < len(actions)
        names[identity] = site.place(identity, where, title=title, heading=heading, charger=charger)
    for layout in layouts:
        for station in layout.entries("stations"):
            keys = ("stationId", "stationName", "stationDescription", "stationDescriptor")
            words = [station.word(key) for key in keys]
            for node in station.entries("interactionNodeIds"):
                if not (name := node.named(names)):
                    continue
                place = site.places[name]
                place["title"] = "; ".join(filter(None, [place.get("title", ""), words[1] or words[0]]))
                if says_charger(*words) and "charger" not in place:
                    site.tell("station is taken for a charger, because its name says so", station.line)
                    place["charger"] = site.options.charger
            known = "station: its name is the title of the nodes it is reached from; its own position is left out"
            site.tell(known, station.line)
        for edge in layout.entries("edges"):
            start, end = (found.named(names) if (found := edge.need(k)) else None for k in ("startNodeId", "endNodeId"))
            properties = properties_of(edge, _EDGE_KEYS)
            if wanted and not properties:
                site.tell(f"left out: edge that {wanted} may not use", edge.line)
            elif start and end:
                limits = [limit for one in properties if (limit := one.get("maxSpeed", "maximumSpeed"))]
                speeds = [speed for limit in limits if (speed := limit.number(0.0, 60.0))]
                drawn = [trajectory for one in properties if (trajectory := one.get("trajectory")) is not None]
                lengths = [length for one in drawn if (length := trajectory_length(one, site, 3)) is not None]
                for one in properties:
                    site.left_out("an edge", one.items(), _PROPERTIES_USED)
                length, speed = max(lengths, default=None), min(speeds, default=None)
                site.edge(start, end, edge.line, name=edge.word("edgeId"), length=length, max_speed=speed)
    if not names:
        root.fault("a layout without nodes", "layouts with nodes")


def _heading(holder: Value, site: Site) -> float | None:
    angle = holder.optional("theta")
    if angle is not None and abs(angle) > 6.3:
        site.tell("left out: theta of a node beyond 2 pi (the format has radians)", holder.line)
        return None
    return angle


def _types(one: Value) -> set[str]:
    """Types of vehicle that properties are for: one id (1.x and drafts of 2.0), or names of series (2.0)."""
    series = (kind.word("seriesName") for kind in one.entries("mobileRobotTypes"))
    return {one.word("vehicleTypeId"), one.word("mobileRobotTypeId"), *series} - {""}


def nurbs_length(
    points: Sequence[tuple[float, float]], weights: Sequence[float], knots: Sequence[float], degree: int
) -> float | None:
    """Length of a planar NURBS curve, m; None where degree, points and knots do not fit together. `points`: length n;
    `weights`: length n; `knots`: length n + degree + 1."""
    count = len(points)
    if not 1 <= degree < count or len(knots) != count + degree + 1 or not all(w > 0 for w in weights):
        return None
    t = np.asarray(knots, float)
    if np.any(np.diff(t) < 0) or t[count] <= t[degree]:
        return None
    from scipy.interpolate import BSpline

    weight = np.asarray(weights, float)[:, None]
    homogeneous = np.hstack([np.asarray(points, float) * weight, weight])
    at = np.union1d(np.linspace(t[degree], t[count], 64 * count), t[degree : count + 1])  # corners lie at knots
    curve = BSpline(t, homogeneous, degree)(at)
    steps = np.diff(curve[:, :2] / curve[:, 2:], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def trajectory_length(trajectory: Value, site: Site, degree: int) -> float | None:
    """Length of a NURBS of LIF or VDA 5050, m; None, and told, where its parts do not fit together. `degree` is what
    holds where none is given."""
    points, weights = [], []
    for point in trajectory.entries("controlPoints"):
        x, y = point.optional("x"), point.optional("y")
        weight = point.optional("weight", 0.0)
        if x is None or y is None:
            return None
        points.append((x, y))
        weights.append(1.0 if weight is None else weight)
    knots = [knot for value in trajectory.entries("knotVector") if (knot := value.number()) is not None]
    given = trajectory.optional("degree", 1, 10)
    degree = degree if given is None else int(given)
    if not knots and len(points) > degree:  # clamped and uniform, as is usual where none are given
        inner = len(points) - degree
        knots = [0.0] * degree + [i / inner for i in range(inner + 1)] + [1.0] * degree
    length = nurbs_length(points, weights, knots, degree)
    if length is None:
        site.tell(
            "trajectory whose degree, points and knots do not fit together: the straight line holds", trajectory.line
        )
    return length


VERSIONS = ("2.0.0", "2.1.0", "3.0.0")
_NODE_USED = {"nodeId", "sequenceId", "nodePosition", "actions", "released", "nodeDescription", "nodeDescriptor"}
_EDGE_USED = {"edgeId", "sequenceId", "actions", "released", "maxSpeed", "maximumSpeed", "trajectory", "length"}
_EDGE_USED |= {"startNodeId", "endNodeId", "edgeDescription", "edgeDescriptor"}


def read(root: Value, site: Site) -> None:
    """Fill the site; the order is its mission."""
    if root.has("nodeStates"):
        root.fault("a state message, not an order", "missionsim import, which reads logs of them")
        return
    site.name = root.word("orderId") or site.name
    site.title = root.word("orderDescription")
    if zones := root.word("zoneSetId"):
        site.tell(f"left out: zones '{clean(zones)[:40]}'", root.line)
    nodes = _ordered(root, "nodes")
    edges = dict(_ordered(root, "edges"))
    if not nodes:
        if not root.faults.found:
            root.fault("an order without nodes", "at least one node")
        return
    site.speed = site.options.robot.body.max_speed.value if site.options.robot else None
    names: dict[str, str] = {}
    here = before = ""
    for number, node in nodes:
        name = _node(node, site, names)
        if name is None:
            continue
        if not here:
            site.start = name
        else:
            _edge(_leading(edges, number, (before, node.word("nodeId")), site), node, here, name, site)
        here, before = name, node.word("nodeId")
        for action in node.entries("actions"):
            kind = action.word("actionType")
            given = [p for p in action.entries("actionParameters") if isinstance(p.data, dict)]
            duration = _duration({p.word("key"): p.fields.get("value") for p in given})
            if kind.lower() == "startcharging":
                site.places[name].setdefault("charger", site.options.charger)
                site.segments.append({"dock": {"recharge": {"until": 1.0}}})
                site.tell("startCharging: a charger and charging until full", action.line)
            elif duration is not None:
                site.segments.append({"wait": {"name": f"{kind} {len(site.segments)}", "duration": duration}})
            elif kind.lower() == "stopcharging":
                site.tell("left out: stopCharging: charging until full holds", action.line)
            else:
                site.tell(f"left out: action '{kind[:40]}', which tells no duration", action.line)
    for edge in edges.values():
        edge.fault("an edge that leads to no node", "sequenceId one below that of a node")
    if not site.segments and here:
        site.segments.append({"wait": {"duration": 0.0}})
    speeds = [speed for edge in site.edges if (speed := edge.get("max_speed"))]
    site.speed = site.speed or max(speeds, default=None)
    if site.speed and any(edge.get("max_speed") is None or edge["max_speed"] > site.speed for edge in site.edges):
        site.tell(f"an order gives limits and no speeds: driven at the limit, at most {site.speed:g} m/s")


def _ordered(root: Value, key: str) -> list[tuple[int, Value]]:
    result = []
    for item in root.entries(key):
        found = item.need("sequenceId")
        number = found.number(0, 2**32) if found else None
        if number is not None:
            result.append((int(number), item))
    result.sort(key=lambda pair: pair[0])
    for (first, _), (second, item) in pairwise(result):
        if first == second:
            item.fault("a sequenceId stands twice", "a number of its own")
    return result


def _node(node: Value, site: Site, names: dict[str, str]) -> str | None:
    identity = node.need("nodeId") and node.word("nodeId")
    if not identity:
        return None
    if node.fields.get("released") is False:
        site.tell("horizon (released: false) is read like the base", node.line)
    site.left_out("a node", node.items(), _NODE_USED)
    if identity in names:
        return names[identity]
    position = node.get("nodePosition")
    where = None
    heading = None
    if position:
        x, y = position.optional("x"), position.optional("y")
        where = None if x is None or y is None else (x, y)
        heading = _heading(position, site)
        site.left_out("a position", position.items(), ("x", "y", "theta"))
    title = node.word("nodeDescription") or node.word("nodeDescriptor")
    names[identity] = site.place(identity, where, heading=heading, title=title)
    return names[identity]


def _leading(edges: dict[int, Value], number: int, ends: tuple[str, str], site: Site) -> Value | None:
    """Take out the edge that leads to a node: its sequenceId is one below the node's; where writers number otherwise
    (all nodes, then all edges), the first one between these nodes."""
    between = [
        n for n in (number - 1,) if n in edges and (edges[n].get("startNodeId") is None or _ends(edges[n]) == ends)
    ]
    if not between and (between := [n for n, edge in edges.items() if _ends(edge) == ends]):
        told = "sequenceId of an edge is not one below that of its endNodeId: startNodeId and endNodeId hold"
        site.tell(told, edges[between[0]].line)
    return edges.pop(between[0] if between else number - 1, None)


def _ends(edge: Value) -> tuple[str, str]:
    return str(edge.fields.get("startNodeId")), str(edge.fields.get("endNodeId"))


def _edge(edge: Value | None, node: Value, start: str, end: str, site: Site) -> None:
    if edge is None:
        node.fault("no edge leads to this node", "an edge with the sequenceId before the node's")
        return
    for key, ends in (("startNodeId", start), ("endNodeId", end)):
        if (given := edge.get(key)) and site.places.get(str(given.data)) and str(given.data) != ends:
            given.fault("the edge stands between other nodes", ends)
    site.left_out("an edge", edge.items(), _EDGE_USED)
    trajectory = edge.get("trajectory")
    length = edge.optional("length", 0.0, 1e9) or None
    if trajectory is not None and trajectory.entries("controlPoints"):  # ROS messages have an empty one where none is
        length = trajectory_length(trajectory, site, 1) or length
    if length is None and site.straight(start, end) is None:
        edge.fault("how long this edge is, is unknown: its nodes have no position", "nodePosition of both, or length")
        return
    limit = edge.get("maxSpeed", "maximumSpeed")
    speed = (limit.number(0.0, 60.0) if limit else None) or None
    if limit and limit.data == 0:
        site.tell("left out: a speed limit of 0", limit.line)
    if start != end:
        known = any(e["from"] == start and e["to"] == end for e in site.edges)
        if not known:
            site.edge(start, end, edge.line, name=edge.word("edgeId"), length=length, max_speed=speed)
        elif speed is not None:
            site.tell("an edge is driven again: its first limit holds", edge.line)
        site.segments.append({"drive": {"to": end} | ({"speed": min(speed, site.speed or speed)} if speed else {})})
    for action in edge.entries("actions"):
        site.tell("left out: action on an edge", action.line)


def _duration(parameters: dict[str, Any]) -> float | None:
    for key in ("duration", "waitTime", "time"):
        if 0.0 < (number := finite(parameters.get(key)) or 0.0) < 1e7:
            return number
    return None


def order_of(
    mission: MissionSpec, *, version: str = "3.0.0", timestamp: str = "", robot_id: str = "1"
) -> tuple[Json, tuple[str, ...]]:
    """An order for the way of a mission as JSON data, and what of the mission it cannot say.

    `version`: of VDA 5050: ``2.0.0``, ``2.1.0`` or ``3.0.0``. `timestamp`: ISO 8601 in UTC,
    ``2026-01-01T00:00:00.000Z``; now where empty. `robot_id`: serial number; the manufacturer is the robot's name.
    """
    if version not in VERSIONS:
        raise InputError.single("a version that is not written", got=version, allowed=", ".join(VERSIONS))
    if timestamp and not _is_timestamp(timestamp):
        allowed = "ISO 8601 in UTC: 2026-01-01T00:00:00.000Z"
        raise InputError.single("a time stamp that an order cannot have", got=timestamp, allowed=allowed)
    newer = version.startswith("3")
    stops, remarks = stops_of(mission)
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
    nodes, edges = [], []
    for index, stop in enumerate(stops):
        actions = [_action(f"{index}-{n}", "wait", duration=seconds) for n, (_, seconds) in enumerate(stop.waits)]
        if stop.recharge_until is not None:
            actions.append(_action(f"{index}-charge", "startCharging", until=stop.recharge_until))
        node: dict[str, Any] = {"nodeId": stop.place, "sequenceId": 2 * index, "released": True, "actions": actions}
        assert mission.environment is not None
        spec = mission.environment.places[stop.place]
        if spec.position is not None:
            x, y = spec.position
            node["nodePosition"] = {"x": x, "y": y, "mapId": str(mission.environment.name)}
            if spec.heading is not None:
                angle = math.remainder(spec.heading.value, 2 * math.pi)
                node["nodePosition"]["theta"] = max(-3.14159265359, min(3.14159265359, angle))
        nodes.append(node)
        if index:
            edge: dict[str, Any] = {"edgeId": stop.edge, "sequenceId": 2 * index - 1, "released": True}
            if not newer:
                edge |= {"startNodeId": stops[index - 1].place, "endNodeId": stop.place}
            edge["maximumSpeed" if newer else "maxSpeed"] = stop.speed_m_s
            edges.append({**edge, "length": stop.length_m, "actions": []})
    head = {"headerId": 0, "timestamp": timestamp or now, "version": version, "manufacturer": mission.robot.name}
    head |= {"serialNumber": robot_id, "orderId": str(mission.name), "orderUpdateId": 0}
    if newer and mission.title:
        head["orderDescription"] = mission.title
    if any(stop.waits for stop in stops):
        remarks.append(
            "the action 'wait' (key duration, s) is ours: the specification names no action that waits a time"
        )
    return {**head, "nodes": nodes, "edges": edges}, tuple(remarks)


def _is_timestamp(text: str) -> bool:
    try:
        return text.endswith("Z") and len(text) >= 20 and datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _action(identity: str, kind: str, **parameters: float) -> dict[str, Any]:
    listed = [{"key": key, "value": value} for key, value in parameters.items()]
    return {"actionId": identity, "actionType": kind, "blockingType": "HARD", "actionParameters": listed}
