"""Open-RMF ``building.yaml``: levels with vertices and lanes, joined by lifts.

Format: rmf_traffic_editor. A drawing's pixels become metres by the mean of its measurements; other levels are laid over
the reference level by the fiducials that both have (rotation, scale, shift), as rmf_building_map_tools does.
"""

from __future__ import annotations

import cmath
import math
from collections import Counter
from dataclasses import KW_ONLY, dataclass, field

from missionsim.exchange.site import EARTH_M, Site, clean
from missionsim.exchange.source import Value

_SYSTEMS = ("reference_image", "wgs84", "web_mercator", "cartesian_meters")
_LANE_USED = {"bidirectional", "is_bidirectional", "graph_idx", "speed_limit"}
_VERTEX_USED = {"is_charger", "lift_cabin", "lift", "name"}
_SHAFT_GAP_M = 0.05
"""Between a cabin and its shaft, as rmf_building_map_tools has it: what stands in the shaft is in the lift."""
_USED = {"building_name", "name", "coordinate_system", "levels", "lifts", "reference_level_name", "graphs"}
_LEVEL_USED = {"vertices", "lanes", "measurements", "fiducials", "elevation", "drawing", "x_meters", "y_meters"}
_LEVEL_USED |= {"flattened_x_offset", "flattened_y_offset"}


@dataclass
class _Vertex:
    value: Value
    point: complex | None
    word: str
    """Its name; empty where it has none."""
    parameters: dict[str, Value]
    charger: bool = False
    used: bool = False
    """Whether a lane ends at it."""
    cabin: str = ""
    """The lift in which it stands."""
    place: str = ""
    """What the site calls it."""


@dataclass
class _Lane:
    value: Value
    start: _Vertex
    end: _Vertex
    parameters: dict[str, Value]
    graph: int
    both_ways: bool
    max_speed: float | None


@dataclass
class _Level:
    name: str
    value: Value
    vertices: list[_Vertex] = field(default_factory=list)
    lanes: list[_Lane] = field(default_factory=list)
    pixels: list[float] = field(default_factory=list)
    scale: float = 1.0
    turn: complex = 1.0
    shift: complex = 0.0
    _: KW_ONLY
    graphs: set[int] = field(default_factory=set)
    laid: bool = False
    """Whether it lies over the reference level."""

    def at(self, point: complex) -> complex:
        """Metres of a point of the file."""
        return self.scale * self.turn * point + self.shift


def read(root: Value, site: Site) -> None:
    """Fill the site with all levels."""
    site.name = root.word("building_name") or root.word("name") or site.name
    system = root.word("coordinate_system") or "reference_image"
    if system not in _SYSTEMS and (found := root.get("coordinate_system")):
        found.fault("an unknown coordinate system", ", ".join(_SYSTEMS))
    _left(root, _USED, site)
    levels = {name: _Level(name, value) for name, value in root.items("levels")}
    if any(_is_generated(vertex) for level in levels.values() for vertex in level.value.entries("vertices")):
        site.format, system = "Open-RMF navigation graph", "cartesian_meters"
    flip = -1.0 if system in ("reference_image", "web_mercator") else 1.0
    for level in levels.values():
        _read_level(level, site, flip)
    graphs = {graph for level in levels.values() for graph in level.graphs}
    if (wanted := site.options.graph) is not None and wanted not in graphs:
        root.fault(f"no lane is of graph {wanted}", ", ".join(map(str, sorted(graphs))) or "a map with lanes")
    if not levels:
        root.fault("a building without levels", "levels: {L1: …}")
    if system == "reference_image":
        for level in levels.values():
            level.pixels = _pixels(level)
    if not levels or root.faults.found:
        return
    reference = levels.get(root.word("reference_level_name"), next(iter(levels.values())))
    if system == "reference_image":
        _scales(levels, reference, site)
    elif system in ("wgs84", "web_mercator"):
        _project(levels, site, mercator=system == "web_mercator")
    if root.faults.found:
        return
    _enter_cabins(root, levels, reference, flip, site)
    if system == "reference_image":
        _align_by_lifts(levels, reference, site)
    _build(levels, site)


def _read_level(level: _Level, site: Site, flip: float) -> None:
    for value in level.value.entries("vertices"):
        parts = value.entries()
        numbers = [part.number() for part in parts[:2]]
        if len(numbers) < 2:
            value.fault("a vertex is [x, y, z, name]", "[x, y, z, name, {…}]")
        x, y = [*numbers, None, None][:2]
        point = None if x is None or y is None else complex(x, flip * y)
        parameters = _parameters(parts[-1]) if len(parts) > 4 or _is_generated(value) else {}
        word = parts[3].data if len(parts) > 3 else "name" in parameters and parameters["name"].data
        charger = _said(parameters, "is_charger")
        level.vertices.append(_Vertex(value, point, str(word or "").strip(), parameters, charger))
    for lane in level.value.entries("lanes"):
        ends, parameters = _ends(lane, level)
        if len(ends) < 2:
            lane.fault("a lane is [from, to]", "[from, to, {…}]")
        if len(ends) < 2 or ends[0] is None or ends[1] is None:
            continue
        graph = parameters["graph_idx"].whole() if "graph_idx" in parameters else 0
        both_ways = _said(parameters, "bidirectional", "is_bidirectional")
        limit = parameters["speed_limit"].number(0.0, 60.0) if "speed_limit" in parameters else None
        if graph is None:
            continue
        level.graphs.add(graph)
        if site.options.graph in (None, graph):
            # 0 is no limit
            level.lanes.append(_Lane(lane, ends[0], ends[1], parameters, graph, both_ways, limit or None))
            ends[0].used = ends[1].used = True
    _left(level.value, _LEVEL_USED, site)
    if (height := level.value.get("elevation")) and height.data:
        site.tell("left out: elevation of a level; lanes are level ground", level.value.line)


def _left(value: Value, used: set[str], site: Site) -> None:
    for key, part in value.items():
        if part.data and key not in used:
            site.tell(f"left out: {clean(key)[:40]}", part.line)


def _ends(value: Value, level: _Level) -> tuple[list[_Vertex | None], dict[str, Value]]:
    """Vertices that a lane or a measurement joins, None for one that is not there, and its parameters."""
    parts = value.entries()
    ends: list[_Vertex | None] = []
    for part in parts[:2]:
        known = type(part.data) is int and 0 <= part.data < len(level.vertices)
        if not known:
            part.fault("no vertex has this number", f"0 to {len(level.vertices) - 1}")
        ends.append(level.vertices[part.node.data] if known else None)
    return ends, _parameters(parts[2]) if len(parts) > 2 else {}


def _is_generated(vertex: Value) -> bool:
    """Whether it is ``[x, y, {name: …}]``, of a graph that was generated of a map: metres, y upwards."""
    parts = vertex.entries()
    return len(parts) == 3 and isinstance(parts[2].data, dict)


def _parameters(value: Value) -> dict[str, Value]:
    """Parameters stand as ``name: [type, value]``."""
    result = {}
    for key, entry in value.items():
        pair = entry.entries() if isinstance(entry.data, list) else []
        result[key] = pair[1] if len(pair) == 2 else entry
    return result


def _said(parameters: dict[str, Value], *keys: str) -> bool:
    """Whether the first of the parameters that is there is true; a fault where it is neither true nor false."""
    return next((parameters[key].truth() for key in keys if key in parameters), False)


def _scales(levels: dict[str, _Level], reference: _Level, site: Site) -> None:
    """Scale of the reference level from its measurements; the others over their fiducials."""
    reference.scale = _measured(reference, site) or 1.0
    fixed = _fiducials(reference)
    for level in levels.values():
        if level is reference:
            continue
        own = _fiducials(level)
        pairs = [(fixed[name], own[name]) for name in fixed if name in own]
        bonds = [(pairs[j][0] - pairs[i][0], pairs[j][1] - pairs[i][1]) for i in range(len(pairs)) for j in range(i)]
        bonds = [(a, b) for a, b in bonds if a and b]
        if not bonds:
            if level.lanes:
                level.scale = _measured(level, site) or 1.0
                site.tell(
                    "level without two fiducials of the reference level: its own measurements hold", level.value.line
                )
            continue
        relative = sum(abs(b) / abs(a) for a, b in bonds) / len(bonds)
        level.turn = cmath.rect(1.0, -cmath.phase(sum(cmath.rect(1.0, cmath.phase(b / a)) for a, b in bonds)))
        level.scale = reference.scale / relative
        level.shift = -sum(level.at(b) - reference.scale * a for a, b in pairs) / len(pairs)
        level.laid = True


def _pixels(level: _Level) -> list[float]:
    """m per pixel of each measurement: distance over drawn length."""
    found = []
    for measurement in level.value.entries("measurements"):
        ends, parameters = _ends(measurement, level)
        if len(ends) < 2 or "distance" not in parameters:
            measurement.fault("a measurement is two vertices and their distance", "[0, 1, {distance: [3, 12.5]}]")
            continue
        distance = parameters["distance"].number(1e-3, 1e6)
        a, b = (None if end is None else end.point for end in ends)
        if distance is None or a is None or b is None:
            continue
        if a == b:
            measurement.fault("a measurement between two vertices at one place", "vertices that lie apart")
            continue
        found.append(distance / abs(b - a))
    return found


def _measured(level: _Level, site: Site) -> float | None:
    """m per pixel, the mean of the measurements."""
    found = level.pixels
    if found:
        if max(found) > 1.05 * min(found):
            told = f"measurements disagree: {min(found):.5g} to {max(found):.5g} m per pixel; their mean holds"
            site.tell(told, level.value.line)
        return sum(found) / len(found)
    if site.options.scale is not None:
        return site.options.scale
    if level.lanes or any(vertex.point for vertex in level.vertices):
        known = "--scale METRES_PER_PIXEL (Open-RMF itself takes 1 here)"
        level.value.fault("a level without measurements: how long a pixel is, nobody knows", known)
    return None


def _fiducials(level: _Level) -> dict[str, complex]:
    result = {}
    for fiducial in level.value.entries("fiducials"):
        parts = fiducial.entries()
        numbers = [part.number() for part in parts[:2]]
        if len(parts) > 2 and numbers[0] is not None and numbers[1] is not None:
            result[str(parts[2].data)] = complex(numbers[0], -numbers[1])
    return result


def _project(levels: dict[str, _Level], site: Site, mercator: bool) -> None:
    """Degrees (x is the longitude) or web Mercator to metres around the middle. Web Mercator: the editor draws the
    world 256 wide, y downwards; larger numbers are metres."""
    degrees: list[tuple[_Vertex, tuple[float, float]]] = []
    every = [(one, one.point) for level in levels.values() for one in level.vertices if one.point is not None]
    drawn = all(0 <= point.real <= 256 and 0 <= -point.imag <= 256 for _, point in every)
    shift, unit = (complex(-128, 128), math.pi * EARTH_M / 128) if drawn else (0j, 1.0)
    for vertex, point in every:
        where = (point.imag, point.real)
        if mercator:
            metres = (point + shift) * unit
            latitude = math.degrees(2 * math.atan(math.exp(min(metres.imag / EARTH_M, 700.0))) - math.pi / 2)
            where = (latitude, math.degrees(metres.real / EARTH_M))
        if abs(where[0]) > 90 or abs(where[1]) > 360:
            vertex.value.fault("no longitude and latitude", "-180 to 180 and -90 to 90, degrees")
            return
        degrees.append((vertex, where))
    if not degrees:
        return
    plane = site.plane([where for _, where in degrees])
    for vertex, where in degrees:
        vertex.point = complex(*plane.to_metres(*where))


def _enter_cabins(root: Value, levels: dict[str, _Level], reference: _Level, flip: float, site: Site) -> None:
    """Lift of each vertex that stands in a cabin: named by the vertex, or inside the lift's rectangle."""
    rectangles = []
    for name, lift in root.items("lifts"):
        home = levels.get(lift.word("reference_floor_name"), reference)
        numbers = [lift.optional(key) for key in ("x", "y", "yaw", "width", "depth")]
        x, y, yaw, width, depth = (0.0 if number is None else number for number in numbers)
        served = {key for key, doors in lift.items("level_doors") if doors.data}
        half = width / 2 + _SHAFT_GAP_M, depth / 2 + _SHAFT_GAP_M
        rectangles.append((name, home.at(complex(x, flip * y)), cmath.rect(1.0, -yaw), *half, served))
    for level in levels.values():
        for vertex in level.vertices:
            named = (vertex.parameters[key].data for key in ("lift_cabin", "lift") if key in vertex.parameters)
            vertex.cabin = next((str(name) for name in named if name), "")
            if vertex.cabin or not vertex.used or vertex.point is None:
                continue
            for name, centre, back, width, depth, served in rectangles:
                away = (level.at(vertex.point) - centre) * back
                if level.name in served and abs(away.real) <= width and abs(away.imag) <= depth:
                    vertex.cabin = name
    for name, lift in root.items("lifts"):
        if sum(any(vertex.cabin == name for vertex in level.vertices) for level in levels.values()) < 2:
            site.tell(f"left out: lift '{clean(name)[:40]}', in which no vertices of two levels stand", lift.line)


def _align_by_lifts(levels: dict[str, _Level], reference: _Level, site: Site) -> None:
    """Lay a level without fiducials over the reference level by the cabin of a lift that both have."""
    fixed = {vertex.cabin: vertex.point for vertex in reference.vertices if vertex.cabin}
    for level in levels.values():
        for vertex in level.vertices:
            home, own = fixed.get(vertex.cabin), vertex.point
            if level is reference or level.laid or home is None or own is None:
                continue
            level.shift = reference.at(home) - level.at(own)
            level.laid = True
            site.tell("level without fiducials is laid over the reference level by a lift's cabin", level.value.line)


def _build(levels: dict[str, _Level], site: Site) -> None:
    """A place for each vertex with a name or a lane; the cabins of a lift are one place."""
    every = [vertex for level in levels.values() for vertex in level.vertices]
    words, cabins = (Counter(filter(None, named)) for named in ((v.word for v in every), (v.cabin for v in every)))
    several = sum(bool(level.lanes or any(vertex.word for vertex in level.vertices)) for level in levels.values()) > 1
    lifts: dict[str, str] = {}
    for level in levels.values():
        for index, vertex in enumerate(level.vertices):
            if vertex.point is None or not (vertex.used or vertex.word or vertex.cabin):
                continue
            given = ((name, vertex.value) for name, value in vertex.parameters.items() if value.data)
            site.left_out("a vertex", given, _VERTEX_USED)
            if vertex.cabin in lifts:
                vertex.place = lifts[vertex.cabin]
                continue
            word = vertex.word or vertex.cabin or f"v{index}"
            if several and not vertex.cabin and (not vertex.word or words[word] > 1):
                word = f"{level.name}_{word}"
            metres = level.at(vertex.point)
            vertex.place = site.place(word, (metres.real, metres.imag), charger=vertex.charger)
            if vertex.cabin:
                lifts[vertex.cabin] = vertex.place
                site.places[vertex.place]["title"] = f"lift {vertex.cabin}"
    if any(cabins[name] > 1 for name in lifts):
        site.tell("a lift is one place on all its levels: what it draws and how long it takes is not in the map")
    for level in levels.values():
        for lane in level.lanes:
            line, ends = lane.value.line, (lane.start.place, lane.end.place)
            if not all(ends):
                continue
            given = ((key, lane.value) for key, value in lane.parameters.items() if value.data)
            site.left_out("a lane", given, _LANE_USED)
            if lane.graph:
                site.tell(f"lane of graph {lane.graph} (--graph takes one graph alone)", line)
            site.edge(*ends, line, both_ways=lane.both_ways, max_speed=lane.max_speed)
