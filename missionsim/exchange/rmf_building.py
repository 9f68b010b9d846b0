"""Open-RMF ``building.yaml``: levels with vertices and lanes, joined by lifts.

Format: rmf_traffic_editor. A drawing's pixels become metres by the mean of its measurements; other levels are laid over
the reference level by the fiducials that both have (rotation, scale, shift), as rmf_building_map_tools does.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

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
class _Level:
    name: str
    value: Value
    points: list[complex | None] = field(default_factory=list)
    vertices: list[Value] = field(default_factory=list)
    lanes: list[tuple[int, int, dict[str, Any], Value]] = field(default_factory=list)
    scale: float = 1.0
    turn: complex = 1.0
    shift: complex = 0.0
    _: KW_ONLY
    graphs: set[str] = field(default_factory=set)

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
    if (wanted := site.options.graph) is not None and str(wanted) not in graphs:
        root.fault(f"no lane is of graph {wanted}", ", ".join(sorted(graphs)) or "a map with lanes")
    if not levels:
        root.fault("a building without levels", "levels: {L1: …}")
    if not levels or root.faults.found:
        return
    reference = levels.get(root.word("reference_level_name"), next(iter(levels.values())))
    if system == "reference_image":
        _scales(levels, reference, site)
    elif system in ("wgs84", "web_mercator"):
        _project(levels, site, mercator=system == "web_mercator")
    if root.faults.found:
        return
    cabins = _cabins(root, levels, reference, flip, site)
    _align_by_lifts(levels, reference, cabins, site, system)
    _build(levels, cabins, site)


def _read_level(level: _Level, site: Site, flip: float) -> None:
    for vertex in level.value.entries("vertices"):
        level.vertices.append(vertex)
        parts = vertex.entries()
        numbers = [part.number() for part in parts[:2]]
        if len(numbers) < 2:
            vertex.fault("a vertex is [x, y, z, name]", "[x, y, z, name, {…}]")
        x, y = [*numbers, None, None][:2]
        level.points.append(None if x is None or y is None else complex(x, flip * y))
    for lane in level.value.entries("lanes"):
        parts = lane.entries()
        ends = [_index(part, level) for part in parts[:2]]
        if len(parts) < 2:
            lane.fault("a lane is [from, to]", "[from, to, {…}]")
        if len(ends) < 2 or ends[0] is None or ends[1] is None:
            continue
        parameters = _parameters(parts[2]) if len(parts) > 2 else {}
        level.graphs.add(str(parameters.get("graph_idx", 0)))
        if str(site.options.graph) in ("None", str(parameters.get("graph_idx", 0))):
            level.lanes.append((ends[0], ends[1], parameters, lane))
    _left(level.value, _LEVEL_USED, site)
    if (height := level.value.get("elevation")) and height.data:
        site.tell("left out: elevation of a level; lanes are level ground", level.value.line)


def _left(value: Value, used: set[str], site: Site) -> None:
    for key, part in value.items():
        if part.data and key not in used:
            site.tell(f"left out: {clean(key)[:40]}", part.line)


def _index(part: Value, level: _Level) -> int | None:
    if type(part.data) is int and 0 <= part.data < len(level.vertices):
        return part.data
    part.fault("no vertex has this number", f"0 to {len(level.vertices) - 1}")
    return None


def _is_generated(vertex: Value) -> bool:
    """Whether it is ``[x, y, {name: …}]``, of a graph that was generated of a map: metres, y upwards."""
    parts = vertex.entries()
    return len(parts) == 3 and isinstance(parts[2].data, dict)


def _named(vertex: Value) -> tuple[str, dict[str, Any]]:
    """Name (empty where there is none) and parameters of a vertex: ``[x, y, z, name, {…}]``, or a generated one."""
    parts = vertex.entries()
    parameters = _parameters(parts[-1]) if len(parts) > 4 or _is_generated(vertex) else {}
    word = parts[3].data if len(parts) > 3 else parameters.get("name")
    return str(word or "").strip(), parameters


def _parameters(value: Value) -> dict[str, Any]:
    """Parameters stand as ``name: [type, value]``."""
    result = {}
    for key, entry in value.items():
        pair = entry.data
        result[key] = pair[1] if isinstance(pair, list) and len(pair) == 2 else pair
    return result


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


def _measured(level: _Level, site: Site) -> float | None:
    """m per pixel: the mean of distance over drawn length."""
    found = []
    for measurement in level.value.entries("measurements"):
        parts = measurement.entries()
        ends = [_index(part, level) for part in parts[:2]]
        distance = _parameters(parts[2]).get("distance") if len(parts) > 2 else None
        if len(ends) < 2 or ends[0] is None or ends[1] is None or not isinstance(distance, (int, float)):
            measurement.fault("a measurement is two vertices and their distance", "[0, 1, {distance: [3, 12.5]}]")
            continue
        a, b = level.points[ends[0]], level.points[ends[1]]
        if a is not None and b is not None and a != b and 0 < distance < 1e6:
            found.append(distance / abs(b - a))
    if found:
        if max(found) > 1.05 * min(found):
            site.tell(
                f"measurements disagree: {min(found):.5g} to {max(found):.5g} m per pixel; their mean holds",
                level.value.line,
            )
        return sum(found) / len(found)
    if site.options.scale is not None:
        return site.options.scale
    if level.lanes or any(level.points):
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
    degrees = {}
    every = [point for level in levels.values() for point in level.points if point is not None]
    drawn = all(0 <= point.real <= 256 and 0 <= -point.imag <= 256 for point in every)
    shift, unit = (complex(-128, 128), math.pi * EARTH_M / 128) if drawn else (0j, 1.0)
    for level in levels.values():
        for index, point in enumerate(level.points):
            if point is None:
                continue
            where = (point.imag, point.real)
            if mercator:
                metres = (point + shift) * unit
                latitude = math.degrees(2 * math.atan(math.exp(min(metres.imag / EARTH_M, 700.0))) - math.pi / 2)
                where = (latitude, math.degrees(metres.real / EARTH_M))
            if abs(where[0]) > 90 or abs(where[1]) > 360:
                level.vertices[index].fault("no longitude and latitude", "-180 to 180 and -90 to 90, degrees")
                return
            degrees[level.name, index] = where
    if not degrees:
        return
    plane = site.plane(list(degrees.values()))
    for (name, index), where in degrees.items():
        levels[name].points[index] = complex(*plane.to_metres(*where))


def _cabins(
    root: Value, levels: dict[str, _Level], reference: _Level, flip: float, site: Site
) -> dict[tuple[str, int], str]:
    """Lift of each vertex that stands in a cabin: named by the vertex, or inside the lift's rectangle."""
    result: dict[tuple[str, int], str] = {}
    rectangles = []
    for name, lift in root.items("lifts"):
        home = levels.get(lift.word("reference_floor_name"), reference)
        numbers = [lift.optional(key) for key in ("x", "y", "yaw", "width", "depth")]
        x, y, yaw, width, depth = (0.0 if number is None else number for number in numbers)
        served = {key for key, doors in lift.items("level_doors") if doors.data}
        half = width / 2 + _SHAFT_GAP_M, depth / 2 + _SHAFT_GAP_M
        rectangles.append((name, home.at(complex(x, flip * y)), cmath.rect(1.0, -yaw), *half, served))
    for level in levels.values():
        used = {end for lane in level.lanes for end in lane[:2]}
        for index, vertex in enumerate(level.vertices):
            parameters = _named(vertex)[1]
            point = level.points[index]
            if cabin := parameters.get("lift_cabin") or parameters.get("lift"):
                result[level.name, index] = str(cabin)
            elif index in used and point is not None:
                for name, centre, back, width, depth, served in rectangles:
                    away = (level.at(point) - centre) * back
                    if level.name in served and abs(away.real) <= width and abs(away.imag) <= depth:
                        result[level.name, index] = name
    for name, lift in root.items("lifts"):
        if len({level for (level, _), cabin in result.items() if cabin == name}) < 2:
            site.tell(f"left out: lift '{clean(name)[:40]}', in which no vertices of two levels stand", lift.line)
    return result


def _align_by_lifts(
    levels: dict[str, _Level], reference: _Level, cabins: dict[tuple[str, int], str], site: Site, system: str
) -> None:
    """Lay a level without fiducials over the reference level by the cabin of a lift that both have."""
    if system != "reference_image":
        return
    fixed = {cabin: reference.points[index] for (name, index), cabin in cabins.items() if name == reference.name}
    for (name, index), cabin in cabins.items():
        level, home, own = levels[name], fixed.get(cabin), levels[name].points[index]
        if level is reference or level.shift or home is None or own is None or level.turn != 1.0:
            continue
        level.shift = reference.at(home) - level.at(own)
        site.tell("level without fiducials is laid over the reference level by a lift's cabin", level.value.line)


def _build(levels: dict[str, _Level], cabins: dict[tuple[str, int], str], site: Site) -> None:
    """A place for each vertex with a name or a lane; the cabins of a lift are one place."""
    names: dict[tuple[str, int], str] = {}
    words = {
        (level.name, index): word
        for level in levels.values()
        for index, vertex in enumerate(level.vertices)
        if (word := _named(vertex)[0])
    }
    several = len([level for level in levels.values() if level.lanes or any(key[0] == level.name for key in words)]) > 1
    lifts: dict[str, str] = {}
    for level in levels.values():
        used = {end for lane in level.lanes for end in lane[:2]}
        for index, vertex in enumerate(level.vertices):
            key, point = (level.name, index), level.points[index]
            if point is None or not (index in used or key in words or key in cabins):
                continue
            parameters = _named(vertex)[1]
            site.left_out("a vertex", ((name, vertex) for name, value in parameters.items() if value), _VERTEX_USED)
            if (cabin := cabins.get(key)) in lifts:
                names[key] = lifts[str(cabin)]
                continue
            word = words.get(key) or cabin or f"v{index}"
            if several and not cabin and (key not in words or list(words.values()).count(word) > 1):
                word = f"{level.name}_{word}"
            metres = level.at(point)
            charger = parameters.get("is_charger") is True
            names[key] = site.place(word, (metres.real, metres.imag), charger=charger)
            if cabin:
                lifts[cabin] = names[key]
                site.places[names[key]]["title"] = f"lift {cabin}"
    if any(sum(cabin == name for name in cabins.values()) > 1 for cabin in lifts):
        site.tell("a lift is one place on all its levels: what it draws and how long it takes is not in the map")
    for level in levels.values():
        for start, end, parameters, lane in level.lanes:
            ends = names.get((level.name, start)), names.get((level.name, end))
            if ends[0] is None or ends[1] is None:
                continue
            site.left_out("a lane", ((key, lane) for key, value in parameters.items() if value), _LANE_USED)
            if graph := parameters.get("graph_idx", 0):
                site.tell(f"lane of graph {graph} (--graph takes one graph alone)", lane.line)
            both = parameters.get("bidirectional", parameters.get("is_bidirectional", False)) is True
            limit = parameters.get("speed_limit")
            speed = float(limit) if isinstance(limit, (int, float)) and 0.0 < limit <= 60.0 else None
            site.edge(ends[0], ends[1], lane.line, both_ways=both, max_speed=speed)
