"""The formats that `import-site` reads: how each is recognised by its content, and what reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from missionsim.errors import Fault, InputError
from missionsim.exchange import gpx, graph, nav2, qgc, rmf_building, vda5050
from missionsim.exchange.site import Site, SiteOptions, clean
from missionsim.exchange.source import Faults, Value, parse_xml, read_document, read_text
from missionsim.inputs.tree import as_written


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
    ("node-link graph", lambda data: "nodes" in data and ("links" in data or "edges" in data), graph.read_node_link),
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
            graph.read_graphml(root, text, site)
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
