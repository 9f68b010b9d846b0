"""The formats that `import-site` reads: how each is recognised by its content, and what reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from missionsim.errors import Fault, InputError
from missionsim.exchange import gpx, graph, nav2, qgc, rmf_building, vda5050
from missionsim.exchange.site import Site, SiteOptions, clean
from missionsim.exchange.source import Faults, Value, parse_xml, read_document, read_text


@dataclass(frozen=True)
class Format:
    """One format of JSON or YAML: its name, what tells it from the others, and its reader."""

    name: str
    is_this: Callable[[dict[str, Any]], bool]
    read: Callable[[Value, Site], None]


def _keys(*names: str) -> Callable[[dict[str, Any]], bool]:
    return lambda data: all(name in data for name in names)


def _is_order(data: dict[str, Any]) -> bool:
    first = next(iter(data["nodes"]), None) if isinstance(data.get("nodes"), list) else None
    return "orderId" in data or (isinstance(first, dict) and "sequenceId" in first)


FORMATS = (
    Format("Nav2 route graph", lambda data: data.get("type") == "FeatureCollection", nav2.read),
    Format("layout interchange format", lambda data: "layouts" in data or "origins" in data, vda5050.read_layout),
    Format("VDA 5050 order", _is_order, vda5050.read),
    Format("QGroundControl plan", _keys("mission"), qgc.read),
    Format("QGroundControl plan", _keys("items", "plannedHomePosition"), qgc.read),
    Format("Open-RMF building map", _keys("levels"), rmf_building.read),
    Format(
        "node-link graph", lambda data: "nodes" in data and ("links" in data or "edges" in data), graph.read_node_link
    ),
)
"""In the order in which they are tried."""
KNOWN = "Nav2 GeoJSON, Open-RMF building.yaml, LIF, GPX, QGroundControl .plan, VDA 5050 order, GraphML, node-link JSON"


def import_site(path: str | Path, options: SiteOptions | None = None) -> Site:
    """Read a site, route graph, track or order of another tool, with remarks on what has no place in ours.

    Raises InputError: all faults of the file, with lines; a file of no known format.
    """
    text = read_text(path)
    name = clean(Path(path).name.split(".")[0]) or "site"
    site = Site(str(path), "", name, options or SiteOptions())
    if text.startswith("QGC WPL"):
        site.format = "QGroundControl waypoints"
        qgc.read_text(text, site)
        return site
    if text.lstrip("\ufeff \t\r\n").startswith("<"):
        return _read_xml(text.lstrip("\ufeff"), site)
    try:
        document = read_document(path, text)
    except InputError as problem:
        raise InputError([_either(fault) for fault in problem.faults]) from None
    data = document.data
    kind = next((f for f in FORMATS if isinstance(data, dict) and "$schema" not in data and f.is_this(data)), None)
    if kind is None:
        raise InputError(_unknown(site.file, data))
    site.format = kind.name
    faults = Faults(site.file)
    kind.read(Value(document, faults, document.root), site)
    faults.stop()
    return site


def _read_xml(text: str, site: Site) -> Site:
    root = parse_xml(text, site.file)
    if root.tag == "gpx":
        site.format = "GPX"
        faults = Faults(site.file)
        gpx.read(root, site, faults)
        faults.stop()
    elif root.tag == "graphml":
        site.format = "GraphML"
        graph.read_graphml(root, text, site)
    else:
        raise InputError(Fault(site.file, root.line, 0, "no format that is known", "", f"<{root.tag}>", KNOWN))
    return site


def _either(fault: Fault) -> Fault:
    return fault if fault.allowed or not fault.message.startswith("not YAML") else replace(fault, allowed=KNOWN)


def _unknown(file: str, data: Any) -> Fault:
    if isinstance(data, dict) and "$schema" in data:
        return Fault(file, 1, 1, "a JSON schema, not a file that follows it", allowed=KNOWN)
    if isinstance(data, dict) and "rmf_fleet" in data:
        return Fault(file, 1, 1, "a fleet, not a site", allowed="missionsim import-robot")
    keys = ", ".join(list(map(str, data))[:6]) if isinstance(data, dict) else type(data).__name__
    return Fault(file, 1, 1, "no format that is known", got=f"a file with {keys}"[:120], allowed=KNOWN)
