"""Plans of ground stations: QGroundControl ``.plan`` (and its older ``.mission``), and ``QGC WPL 110`` text.

Format: QGroundControl's plan file format and MAVLink's common commands (MAV_CMD). A ground robot drives the waypoints
on the ground: altitudes, take-off and landing do not move it.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.exchange.site import LocalPlane, Site, stops_of
from missionsim.exchange.source import Faults, Value
from missionsim.files import Json
from missionsim.inputs.mission import MissionSpec

_ORIGIN = re.compile(r"metres east and north of (-?[\d.]+), (-?[\d.]+) \(WGS 84\)")
WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF, SPLINE = 16, 17, 18, 19, 20, 21, 22, 82
DELAY, CONDITION_DELAY, JUMP, CHANGE_SPEED = 93, 112, 177, 178
_MOVING = {WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LAND, TAKEOFF, SPLINE, 84, 85}
_NAMES = {LAND: "land", TAKEOFF: "take-off", 84: "take-off", 85: "land", SPLINE: "spline waypoint"}
_LOCAL_FRAMES = {1, 4, 7, 9, 12, 13, 20, 21}
_ROVERS = {10, 11}
_SHAPES = ("circles", "polygons", "polygon", "points")


@dataclass
class Item:
    """One command: its seven parameters (None where null) and where it stands."""

    command: int
    parameters: list[float | None]
    frame: int
    number: int
    line: int

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude, degrees (in a local frame metres north and east); None where it has none."""
        a, b = self.parameters[4:6]
        unset = a is None or b is None or (a == b == 0.0 and self.frame not in _LOCAL_FRAMES)
        return None if unset else (float(a or 0.0), float(b or 0.0))


def read(root: Value, site: Site) -> None:
    """Fill the site of a JSON plan."""
    mission = root.get("mission") or root
    items: list[Item] = []
    for value in mission.entries("items"):
        items += _items(value, site)
    planned = mission.get("plannedHomePosition")
    held = planned and (planned.get("coordinate") or planned)  # a place, or an item that is there
    home = [value.number() for value in held.entries()[:2]] if held else []
    for key in ("geoFence", "rallyPoints", "complexItems"):
        part = root.get(key)
        if part is not None and (any(part.fields.get(k) for k in _SHAPES) or (part.data and not part.fields)):
            site.tell(f"left out: {key}", part.line)
    if root.faults.found:
        return
    if not items:
        mission.fault("a plan without items", "items: [{command: 16, …}]")
        return
    rover = mission.optional("vehicleType") in _ROVERS
    keys = ("cruiseSpeed", "hoverSpeed") if rover else ("hoverSpeed", "cruiseSpeed")
    speeds = {key: speed for key in keys if (speed := mission.optional(key, 0.0, 1000.0))}
    speed = next(iter(speeds.values()), None)
    if not rover:
        of = f", {next(iter(speeds))} is the speed" if speeds else ""
        site.tell(f"the plan is not for a rover: waypoints are driven on the ground{of}", mission.line)
    start = (home[0], home[1]) if len(home) == 2 and home[0] is not None and home[1] is not None else None
    build(items, start, speed, site)


def read_text(text: str, site: Site) -> None:
    """Fill the site of a ``QGC WPL`` file: index, current, frame, command, 7 parameters, autocontinue a line."""
    items, faults = [], Faults(site.file)
    for line, row in enumerate(text.splitlines()[1:], 2):
        words = row.split()
        if not words:
            continue
        try:
            numbers = [float(word) for word in words]
            if len(numbers) != 12 or not all(math.isfinite(number) for number in numbers):
                raise ValueError
        except ValueError:
            faults.add(line, "not a waypoint", row[:60], "12 numbers")
            continue
        items.append(Item(int(numbers[3]), [*numbers[4:11]], int(numbers[2]), int(numbers[0]), line))
    if not items and not faults.found:
        faults.add(1, "a plan without waypoints")
    faults.stop()
    first = items[0]
    at_home = first.number == 0 and first.command == WAYPOINT  # corners of a fence (5001 …) are no home
    build(items[at_home:], first.place if at_home else None, None, site)


def _items(value: Value, site: Site) -> list[Item]:
    """A simple item, or those inside a survey or corridor scan."""
    if value.word("type") == "ComplexItem" or value.has("complexItemType"):
        kind = value.word("complexItemType") or "complex item"
        inner = value.get("TransectStyleComplexItem") or value
        found = [item for entry in inner.entries("Items") for item in _items(entry, site)]
        if not found:  # what writers other than QGroundControl leave out; the points that it draws are the same way
            points = [[n.number() for n in point.entries()[:2]] for point in inner.entries("VisualTransectPoints")]
            found = [Item(WAYPOINT, [None] * 4 + pair + [None], 3, 0, value.line) for pair in points if len(pair) == 2]
        site.tell(f"{kind}: {'its waypoints are driven' if found else 'left out, it holds no waypoints'}", value.line)
        return found
    command = value.need("command")
    number = command.number(0, 65535) if command else None
    given: list[float | None] = []
    for entry in value.entries("params"):
        given.append(None if entry.data is None or entry.data == "NaN" else entry.number())
    coordinate = [entry.number() for entry in value.entries("coordinate")]
    for index in range(1, 5):  # .mission files
        if (one := value.get(f"param{index}")) is not None:
            given.append(one.number())
    parameters = (given[:4] + [None] * (4 - len(given[:4])) + coordinate if coordinate else given)[:7]
    parameters += [None] * (7 - len(parameters))
    frame = value.optional("frame") or 0.0
    jump = value.optional("doJumpId") or 0.0
    return [] if number is None else [Item(int(number), parameters, int(frame), int(jump), value.line)]


def build(items: list[Item], home: tuple[float, float] | None, speed: float | None, site: Site) -> None:
    """Places, ways and mission of the commands, from `home` (latitude and longitude, degrees) at a speed [m/s]."""
    moving = [(item, item.place) for item in items if item.command in _MOVING]
    points = []
    faults = Faults(site.file)
    for item, place in moving:
        if place is None or item.frame in _LOCAL_FRAMES:
            continue
        points.append(place)
        if abs(place[0]) > 90 or abs(place[1]) > 360:
            faults.add(item.line, "no latitude and longitude", f"{place[0]}, {place[1]}", "degrees")
    if home is not None and (abs(home[0]) > 90 or abs(home[1]) > 360):
        faults.add(0, "plannedHomePosition is no latitude and longitude", str(home), "degrees")
    if home is None and not any(place for _, place in moving):
        faults.add(items[0].line, "a plan without waypoints")
    faults.stop()
    points += [home] if home else []
    plane = site.plane(points) if points else None
    route = _Route(plane, speed, site, home)
    for item in items:
        route.begins[item.number] = len(site.segments), len(route.changes), route.speed
        route.follow(item)
    if not site.segments and route.here:
        site.segments.append({"wait": {"duration": 0.0}})
    site.tell("waypoints are joined by straight ways, which lead both ways")


@dataclass
class _Route:
    """Follows the commands from place to place."""

    plane: LocalPlane | None
    wanted: float | None
    site: Site
    begin: tuple[float, float] | None

    def __post_init__(self) -> None:
        self.here = self.home = ""
        self.changes: list[int] = []
        """Segments before which the speed changes."""
        self.begins: dict[int, tuple[int, int, float | None]] = {}
        """Segment at which an item begins, how many changes there were, and the speed, for jumps."""
        self.ways: set[tuple[str, str]] = set()
        self.limit = self.site.options.robot.body.max_speed.value if self.site.options.robot else math.inf
        self.site.speed = self.speed = self.allowed(self.wanted)
        if self.begin is not None and self.plane is not None:
            self.home = self.here = self.site.start = self.site.place("home", self.plane.to_metres(*self.begin))

    def allowed(self, speed: float | None) -> float | None:
        """A speed of the plan, at most the robot's."""
        if speed is not None and speed > self.limit:
            self.site.tell(f"a speed of the plan is above the robot's {self.limit:g} m/s, which holds instead")
        return None if not speed else min(speed, self.limit)

    def follow(self, item: Item) -> None:
        """Do what a command says, as far as a robot on the ground does."""
        site, first, second = self.site, item.parameters[0] or 0.0, item.parameters[1] or 0.0
        if item.command in _MOVING and (place := item.place) is not None:
            # a place that is reached again is the same place
            plane = None if item.frame in _LOCAL_FRAMES else self.plane
            where = place[::-1] if plane is None else plane.to_metres(*place)
            known = (n for n, p in site.places.items() if math.hypot(p["x"] - where[0], p["y"] - where[1]) < 0.01)
            name = next(known, "") or site.place(f"waypoint_{item.number or len(site.places)}", where)
            site.start = site.start or name
            if item.parameters[6] or item.command == SPLINE:
                site.tell("left out: altitude", item.line)
            self.segment(name, item.line)
            if item.command in (WAYPOINT, LOITER_TIME) and first > 0:
                site.segments.append({"wait": {"duration": first}})
            elif item.command in (LOITER_UNLIMITED, LOITER_TURNS):
                site.tell("loitering without a time: a stop, no wait", item.line)
            elif item.command in _NAMES:
                site.tell(f"{_NAMES[item.command]}: driven to as a waypoint", item.line)
        elif item.command in _MOVING:
            site.tell(f"left out: {_NAMES.get(item.command, 'waypoint')} without a position", item.line)
        elif item.command == RETURN and self.home:
            self.segment(self.home, item.line)
        elif item.command in (DELAY, CONDITION_DELAY) and 0 < first < 1e7:
            site.segments.append({"wait": {"duration": first}})
        elif item.command == CHANGE_SPEED and second > 0:
            self.speed = self.allowed(second)
            self.changes.append(len(site.segments))
        elif item.command == JUMP:  # repeats what lies between an earlier item and this one
            target, times = int(first), int(second)
            begin, changes, speed = self.begins.get(target, (len(site.segments), 0, None))
            block = site.segments[begin:]
            drives = [segment["drive"]["to"] for segment in block if "drive" in segment]
            if not drives or not 1 <= times <= 10_000 or any("repeat" in segment for segment in block):
                site.tell(f"left out: jump to item {target}, {times} times (endless, forward or nested)", item.line)
            else:
                self.way(drives[0], item.line)
                again, once = block, list[dict[str, Any]]()
                if self.speed != speed:  # a speed holds until it changes, into the next round
                    until = self.changes[changes] - begin
                    again = [self.paced(segment) for segment in block[:until]] + block[until:]
                if again != block:
                    once, times = block, times - 1
                site.segments[begin:] = [*once, {"repeat": {"times": times + 1, "segments": again}}]
        else:
            site.tell(f"left out: command {item.command}", item.line)

    def way(self, to: str, line: int) -> None:
        """The way from here, where there is none yet."""
        if self.here != to and (self.here, to) not in self.ways:
            self.ways |= {(self.here, to), (to, self.here)}
            self.site.edge(self.here, to, line, both_ways=True)

    def segment(self, to: str, line: int) -> None:
        """Drive to a place, at the present speed."""
        if self.here and self.here != to:
            self.way(to, line)
            self.site.segments.append(self.paced({"drive": {"to": to}}))
        self.here = to

    def paced(self, segment: dict[str, Any]) -> dict[str, Any]:
        """A segment at the present speed, where it is a drive."""
        if "drive" not in segment:
            return segment
        changed = self.speed is not None and self.speed != self.site.speed
        return {"drive": {"to": segment["drive"]["to"]} | ({"speed": self.speed} if changed else {})}


def plan_of(mission: MissionSpec, origin: tuple[float, float] | None = None) -> tuple[Json, tuple[str, ...]]:
    """A plan of QGroundControl for the way of a mission, and what of the mission it cannot say.

    `origin`: latitude and longitude of the map's point 0, 0, degrees; by default what its notes say, as `import-site`
    writes. Raises InputError: no origin, or places without positions.
    """
    environment = mission.environment
    stops, remarks = stops_of(mission)
    assert environment is not None
    if origin is None:
        match = _ORIGIN.search(environment.notes)
        if match is None:
            told = "where the map lies on the earth is unknown"
            raise InputError.single(told, file=str(environment.path), allowed="--origin LATITUDE,LONGITUDE")
        origin = (float(match.group(1)), float(match.group(2)))
    plane = LocalPlane(*origin)
    points = {}
    for name in dict.fromkeys(stop.place for stop in stops):
        position = environment.places[name].position
        if position is None:
            raise InputError.single(f"place '{name}' has no position", file=str(environment.path), allowed="x and y")
        points[name] = [round(degree, 9) for degree in plane.to_degrees(*position)]
    items: list[dict[str, Any]] = []

    def add(command: int, frame: int, parameters: list[float | None]) -> None:
        more: dict[str, Any] = {"autoContinue": True, "command": command, "doJumpId": len(items) + 1, "frame": frame}
        more |= {"AMSLAltAboveTerrain": None, "Altitude": 0, "AltitudeMode": 1} if command == WAYPOINT else {}
        items.append({**more, "params": parameters, "type": "SimpleItem"})

    speed = None
    for stop in stops:
        if stop.speed_m_s is not None and stop.speed_m_s != speed:
            speed = stop.speed_m_s
            add(CHANGE_SPEED, 2, [1, speed, -1, 0, 0, 0, 0])
        hold = sum(seconds for _, seconds in stop.waits)
        add(WAYPOINT, 3, [hold, 0, 0, None, *points[stop.place], 0])
    ways = [(a, b) for a, b in itertools.pairwise(stops) if a.place != b.place]
    if any(abs(b.length_m - (environment.straight_m(a.place, b.place) or 0.0)) > 1e-3 for a, b in ways):
        remarks.append("lengths of ways have no place in it: they are straight")
    if any(stop.recharge_until is not None for stop in stops):
        remarks.append("charging has no command in it: the robot stops at the charger")
    fastest = max((stop.speed_m_s or 0.0 for stop in stops), default=0.0)
    plan: Json = json.loads(Path(__file__).with_name("rover.plan").read_text("utf-8"))
    plan["mission"] |= {"cruiseSpeed": fastest, "hoverSpeed": fastest, "items": items}
    plan["mission"]["plannedHomePosition"] = [*points[stops[0].place], 0]
    return plan, tuple(remarks)
