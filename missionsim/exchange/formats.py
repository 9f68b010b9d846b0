"""The formats that `import-site` reads: how each is recognised by its content, and what reads it; graphs of networkx.

Those are GraphML (OSMnx, yEd and others write it) and node-link JSON. Positions are ``x, y`` or ``pos`` in metres, or
``lat, lon`` (``x, y`` where the graph's ``crs`` is EPSG:4326); ``length`` is in metres, ``max_speed`` in m/s
(``maxspeed`` and ``speed_kph`` in km/h, as in OpenStreetMap), ``grade`` is rise over run.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from missionsim.errors import Fault, InputError
from missionsim.exchange import gpx, nav2, qgc, rmf_building, vda5050
from missionsim.exchange.site import Site, SiteOptions, clean, says_charger
from missionsim.exchange.source import Element, Faults, Value, finite, parse_xml, read_document, read_text
from missionsim.inputs.tree import as_written

_X, _Y = ("x",), ("y",)
_LAT, _LON = ("lat", "latitude"), ("lon", "lng", "longitude")
_HEIGHT = ("elevation", "z", "ele", "height")
_LENGTH = ("length", "length_m", "distance", "dist")
_SPEED = ("max_speed", "speed_limit", "max_speed_m_s", "maxSpeed", "speed")
_KMH = ("speed_kph", "maxspeed")
_SLOPE = ("grade", "slope")
_TITLE = ("name", "label", "title")
_NODE_USED = {*_X, *_Y, *_LAT, *_LON, *_HEIGHT, *_TITLE, "pos", "position", "id"}
_EDGE_USED = {*_LENGTH, *_SPEED, *_KMH, *_SLOPE, "name", "label", "id", "weight", "source", "target", "key"}
_NO = {"", "0", "false", "no", "none"}


@dataclass(frozen=True)
class Part:
    """A node (`ends` is its name) or an edge, its attributes and its line."""

    ends: tuple[str, ...]
    attributes: Mapping[str, Any]
    line: int


def read_graphml(root: Element, text: str, site: Site) -> None:
    """Fill the site of a GraphML file, which networkx reads."""
    import networkx

    try:
        graph = networkx.parse_graphml(text)
    except Exception as problem:  # networkx raises what its parts raise
        reason = " ".join(str(problem).split())[:200] or type(problem).__name__
        raise InputError(Fault(site.file, root.line, 0, f"networkx cannot read this graph: {reason}")) from None
    lines = {node.attributes.get("id", ""): node.line for part in root.all("graph") for node in part.all("node")}
    ways = [(edge.attributes, edge.line) for part in root.all("graph") for edge in part.all("edge")]
    between = {(given.get("source", ""), given.get("target", "")): line for given, line in ways}
    nodes = [Part((str(name),), data, lines.get(str(name), 0)) for name, data in graph.nodes(data=True)]
    edges = []
    for start, end, data in graph.edges(data=True):
        line = between.get((str(start), str(end)), between.get((str(end), str(start)), 0))
        edges.append(Part((str(start), str(end)), data, line))
    faults = Faults(site.file)
    for end, line in ((end, line) for ends, line in between.items() for end in ends if end not in lines):
        faults.add(line, "no node has this id", end, "the id of a node")
    faults.stop()
    _fill(nodes, edges, graph.graph, graph.is_directed(), site, faults)
    faults.stop()


def read_node_link(root: Value, site: Site) -> None:
    """Fill the site of a node-link file (d3, networkx.node_link_data)."""
    nodes, edges = [], []
    known: dict[str, str] = {}
    for index, node in enumerate(root.entries("nodes")):
        identity = node.fields.get("id", node.fields.get("name", index)) if isinstance(node.data, dict) else node.data
        name = str(identity)
        if name in known:
            node.fault(f"node '{name[:60]}' stands twice", "an id of its own")
        known[name] = name
        nodes.append(Part((name,), node.fields, node.line))
    for edge in root.entries("links", "edges"):
        start, end = (found.named(known) if (found := edge.need(key)) else None for key in ("source", "target"))
        if start is not None and end is not None:
            edges.append(Part((start, end), edge.fields, edge.line))
    if not nodes:
        root.fault("a graph without nodes", "nodes: [{id: …}]")
    graph = root.get("graph")
    attributes = graph.fields if graph else {}
    site.name = clean(str(attributes.get("name") or "")) or site.name
    if not root.faults.found:
        _fill(nodes, edges, attributes, root.fields.get("directed") is True, site, root.faults)


def _fill(
    nodes: Sequence[Part], edges: Sequence[Part], graph: Mapping[str, Any], directed: bool, site: Site, faults: Faults
) -> None:
    degrees = "4326" in str(graph.get("crs", ""))
    positions = {node.ends[0]: _position(node, degrees) for node in nodes}
    angles = [p for p in positions.values() if p and p[2]]
    if any(abs(p[0]) > 90 or abs(p[1]) > 360 for p in angles):
        faults.add(nodes[0].line, "no latitudes and longitudes", str(angles[0][:2]), "degrees")
        return
    plane = site.plane([(p[0], p[1]) for p in angles]) if angles else None
    names: dict[str, str] = {}
    for node in nodes:
        found = positions[node.ends[0]]
        where = None if found is None else plane.to_metres(found[0], found[1]) if plane and found[2] else found[:2]
        title = next((clean(str(node.attributes[key])) for key in _TITLE if node.attributes.get(key)), "")
        title = "" if title == node.ends[0] else title
        pairs = node.attributes.items()
        told = ((key, value) for key, value in pairs if says_charger(key, isinstance(value, str) and value))
        charger = next((not says_charger(key) or str(value).lower() not in _NO for key, value in told), False)
        names[node.ends[0]] = site.place(node.ends[0], where, _number(node, _HEIGHT), title=title, charger=charger)
        _left(node, _NODE_USED, "a node", site)
    for edge in edges:
        start, end = names[edge.ends[0]], names[edge.ends[1]]
        for keys in (_LENGTH, _SPEED, _SLOPE):
            given = [key for key in keys if edge.attributes.get(key) is not None]
            if given and _number(edge, keys) is None:
                site.tell(f"left out: '{given[0]}' of an edge that is no number", edge.line)
        length = _number(edge, _LENGTH)
        if length is None and (length := _number(edge, ("weight",))) is not None:
            site.tell("weight of an edge is taken for its length in metres", edge.line)
        if length is not None and not 0.0 < length < 1e9:
            site.tell("left out: length of an edge that is not above 0", edge.line)
            length = None
        if length is None and site.straight(start, end) is None:
            known = "length, or x and y of both nodes"
            faults.add(edge.line, "how long this edge is, is unknown", " to ".join(edge.ends), known)
            continue
        named = [edge.attributes[key] for key in ("name", "label", "id") if edge.attributes.get(key) is not None]
        name = clean(str(named[0])) if named else ""
        speed = _speed(edge, site)
        slope, rise = None, _number(edge, _SLOPE)
        if rise is not None and abs(rise) > 2.0:
            site.tell("left out: slope of an edge above 200 % (rise over run is expected)", edge.line)
        elif rise:
            site.tell("slope of an edge is rise over run", edge.line)
            slope = math.atan(rise)
        more = {"length": length, "max_speed": speed, "slope": slope}
        site.edge(start, end, edge.line, name=name, both_ways=not directed, **more)
        _left(edge, _EDGE_USED, "an edge", site)


def _number(part: Part, keys: Sequence[str]) -> float | None:
    return next((number for key in keys if (number := finite(part.attributes.get(key))) is not None), None)


def _position(node: Part, degrees: bool) -> tuple[float, float, bool] | None:
    """(x, y, False) in metres, or (latitude, longitude, True)."""
    latitude, longitude = _number(node, _LAT), _number(node, _LON)
    if latitude is not None and longitude is not None:
        return latitude, longitude, True
    x, y = _number(node, _X), _number(node, _Y)
    raw = node.attributes.get("pos", node.attributes.get("position"))
    if (x is None or y is None) and raw is not None:
        words = raw if isinstance(raw, (list, tuple)) else re.findall(r"[-+.\deE]+", str(raw))
        pair = [finite(word) for word in words[:2]]
        x, y = pair if len(pair) == 2 else (None, None)
    if x is None or y is None or max(abs(x), abs(y)) > 1e12:
        return None
    return (y, x, True) if degrees else (x, y, False)


def _speed(edge: Part, site: Site) -> float | None:
    speed = _number(edge, _SPEED)
    if speed is None:
        raw = next((edge.attributes[key] for key in _KMH if edge.attributes.get(key) is not None), None)
        if raw is None:
            return None
        found = re.findall(r"(\d+(?:\.\d+)?)\s*(mph)?", str(raw))  # of several the lowest holds
        speed = min((float(number) * (0.44704 if unit else 1 / 3.6) for number, unit in found), default=None)
    if speed is None or not 0.0 < speed <= 60.0:
        site.tell("left out: speed of an edge that is not between 0 and 60 m/s", edge.line)
        return None
    return speed


def _left(part: Part, used: set[str], what: str, site: Site) -> None:
    for key in part.attributes:
        if key not in used and not says_charger(key):
            site.tell(f"left out: '{clean(str(key))[:40]}' of {what}", part.line)


def _is_order(data: dict[str, Any]) -> bool:
    first = next(iter(data["nodes"]), None) if isinstance(data.get("nodes"), list) else None
    return "orderId" in data or (isinstance(first, dict) and "sequenceId" in first)


FORMATS: tuple[tuple[str, Callable[[dict[str, Any]], bool], Callable[[Value, Site], None]], ...] = (
    ("Nav2 route graph", lambda data: data.get("type") == "FeatureCollection", nav2.read),
    ("layout interchange format", lambda data: "layouts" in data or "origins" in data, vda5050.read_layout),
    ("VDA 5050 order", _is_order, vda5050.read),
    (
        "QGroundControl plan",
        lambda data: "mission" in data or {"items", "plannedHomePosition"} <= data.keys(),
        qgc.read,
    ),
    ("Open-RMF building map", lambda data: "levels" in data, rmf_building.read),
    ("node-link graph", lambda data: "nodes" in data and ("links" in data or "edges" in data), read_node_link),
)
"""Formats of JSON or YAML in the order in which they are tried: name, what tells it from the others, and its reader."""
KNOWN = "Nav2 GeoJSON, Open-RMF building.yaml, LIF, GPX, QGroundControl .plan, VDA 5050 order, GraphML, node-link JSON"


def import_site(path: str | Path, options: SiteOptions | None = None) -> Site:
    """Read a site, route graph, track or order of another tool, with remarks on what has no place in ours.

    Raises InputError: all faults of the file, with lines; a file of no known format.
    """
    text = read_text(path).lstrip("\ufeff")
    name = clean(Path(path).name.split(".")[0]) or "site"
    site, faults = Site(str(path), "", name, options or SiteOptions()), Faults(str(path))
    if text.startswith("QGC WPL"):
        site.format = "QGroundControl waypoints"
        qgc.read_text(text, site)
        return site
    if text.lstrip().startswith("<"):
        root = parse_xml(text, site.file)
        if root.tag == "gpx":
            site.format = "GPX"
            gpx.read(root, site, faults)
            faults.stop()
        elif root.tag == "graphml":
            site.format = "GraphML"
            read_graphml(root, text, site)
        else:
            raise InputError(Fault(site.file, root.line, 0, "no format that is known", "", f"<{root.tag}>", KNOWN))
        return site
    try:
        document = read_document(path, text)
    except InputError as problem:
        told = [replace(f, allowed=KNOWN) if f.message.startswith("not YAML") else f for f in problem.faults]
        raise InputError(told) from None
    data = document.data
    known, value = data if isinstance(data, dict) else {}, Value(document, faults, document.root)
    inside = value.get("payload") if "topic" in known else None
    if inside is not None and isinstance(inside.data, dict):  # as brokers' clients save a message
        known, value = inside.data, inside
    if "$schema" in known:
        raise InputError(Fault(site.file, 1, 1, "a JSON schema, not a file that follows it", allowed=KNOWN))
    for site.format, is_this, read in FORMATS:
        if is_this(known):
            read(value, site)
            faults.stop()
            return site
    if "rmf_fleet" in known:
        raise InputError(Fault(site.file, 1, 1, "a fleet, not a site", allowed="missionsim import-robot"))
    raise InputError(Fault(site.file, 1, 1, "no format that is known", got=as_written(data), allowed=KNOWN))
