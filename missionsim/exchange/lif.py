"""Layout Interchange Format of the VDMA (LIF 1.x, JSON): nodes, one-way edges per type of vehicle, stations.

Format: VDMA, "LIF – Layout Interchange Format", and its JSON schema. Metres; a trajectory is a NURBS. Whether a node
has a charger is told by its action ``startCharging`` (VDA 5050), or by the name of the station at it.
"""

from __future__ import annotations

import math

from missionsim.exchange.geo import nurbs_length
from missionsim.exchange.site import Site, SiteOptions, says_charger
from missionsim.exchange.source import Value

_EDGE_USED = {"vehicleTypeId", "maxSpeed", "trajectory"}


def read(root: Value, site: Site, options: SiteOptions) -> None:
    """Fill the site: all layouts, since they share one origin."""
    meta = root.get("metaInformation")
    site.title = meta.word("projectIdentification") if meta else ""
    layouts = root.entries("layouts")
    vehicles = {v.word("vehicleTypeId") for layout in layouts for v in _vehicles(layout)} - {""}
    if options.vehicle and options.vehicle not in vehicles:
        root.fault(f"no edge or node is for vehicle type '{options.vehicle}'", ", ".join(sorted(vehicles)) or "none")
        return
    if len(vehicles) > 1 and not options.vehicle:
        listed = ", ".join(sorted(vehicles)[:6])
        site.tell(
            f"all types of vehicle are read, the lowest speed of each edge holds; --vehicle takes one of: {listed}"
        )
    names: dict[str, str] = {}
    for layout in layouts:
        for node in layout.entries("nodes"):
            _node(node, site, names, options)
    for layout in layouts:
        for station in layout.entries("stations"):
            _station(station, site, names, options)
        for edge in layout.entries("edges"):
            _edge(edge, site, names, options)
    if not names:
        root.fault("a layout without nodes", "layouts with nodes")


def _vehicles(layout: Value) -> list[Value]:
    keys = (("nodes", "vehicleTypeNodeProperties"), ("edges", "vehicleTypeEdgeProperties"))
    return [found for items, key in keys for item in layout.entries(items) for found in item.entries(key)]


def _properties(item: Value, key: str, options: SiteOptions) -> list[Value]:
    found = item.entries(key)
    return [one for one in found if one.word("vehicleTypeId") == options.vehicle] if options.vehicle else found


def _node(node: Value, site: Site, names: dict[str, str], options: SiteOptions) -> None:
    identity = node.need("nodeId") and node.word("nodeId")
    position = node.need("nodePosition")
    x, y = (position.need(key) for key in ("x", "y")) if position else (None, None)
    numbers = [value.number() if value else None for value in (x, y)]
    if not identity or numbers[0] is None or numbers[1] is None:
        return
    if identity in names:
        node.fault("a node's id stands twice", "nodeId of its own")
        return
    properties = _properties(node, "vehicleTypeNodeProperties", options)
    actions = [action for one in properties for action in one.entries("actions")]
    charges = any(action.word("actionType").lower() == "startcharging" for action in actions)
    for action in actions:
        if action.word("actionType").lower() != "startcharging":
            site.tell("left out: action of a node", action.line)
    heading = next((angle for one in properties if (angle := one.optional("theta")) is not None), None)
    if heading is not None and abs(heading) > 2 * math.pi:
        site.tell("left out: theta of a node beyond 2 pi (the format has radians)", node.line)
        heading = None
    title = node.word("nodeName") or node.word("nodeDescription")
    charger = options.charger if charges else None
    where = (numbers[0], numbers[1])
    names[identity] = site.place(identity, where, title=title, heading=heading, charger=charger)


def _station(station: Value, site: Site, names: dict[str, str], options: SiteOptions) -> None:
    words = [station.word(key) for key in ("stationId", "stationName", "stationDescription")]
    charges = says_charger(*words)
    for node in station.entries("interactionNodeIds"):
        if (name := node.named(names)) is None:
            continue
        place = site.places[name]
        place["title"] = "; ".join(filter(None, [place.get("title", ""), words[1] or words[0]]))
        if charges and "charger" not in place:
            site.tell("station is taken for a charger, because its name says so", station.line)
            place["charger"] = options.charger
    site.tell(
        "station: its name is the title of the nodes it is reached from; its own position is left out", station.line
    )


def _edge(edge: Value, site: Site, names: dict[str, str], options: SiteOptions) -> None:
    start, end = (found.named(names) if (found := edge.need(key)) else None for key in ("startNodeId", "endNodeId"))
    properties = _properties(edge, "vehicleTypeEdgeProperties", options)
    if options.vehicle and not properties:
        site.tell(f"left out: edge that {options.vehicle} may not use", edge.line)
        return
    if start is None or end is None:
        return
    speeds = [speed for one in properties if (speed := one.optional("maxSpeed", 0.0, 60.0))]
    drawn = [trajectory for one in properties if (trajectory := one.get("trajectory")) is not None]
    lengths = [length for one in drawn if (length := trajectory_length(one, site, 3)) is not None]
    for one in properties:
        site.left_out("an edge", one.items(), _EDGE_USED)
    length = max(lengths, default=None)
    name, speed = edge.word("edgeId"), min(speeds, default=None)
    site.edge(start, end, edge.line, name=name, length=length, max_speed=speed)


def trajectory_length(trajectory: Value, site: Site, degree: int) -> float | None:
    """Length of a NURBS of LIF or VDA 5050, m; None, and told, where its parts do not fit together.

    `degree` is what holds where none is given.
    """
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
