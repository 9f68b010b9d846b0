"""A site read from another tool's file, the environment and mission that are written of it; and the way a mission takes
over its map, of which an order or a plan for another tool is written."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.exchange.source import Value
from missionsim.files import atomic_write, fields_of
from missionsim.inputs.loading import load_environment, load_mission, load_robot
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import flat_segments
from missionsim.plan.build import make_plan

EARTH_M, _E2 = 6_378_137.0, 6.694379990141e-3
"""Semi-major axis, m, and squared eccentricity of the WGS 84 ellipsoid."""


@dataclass(frozen=True)
class LocalPlane:
    """Metres east and north of a point on the WGS 84 ellipsoid.

    The Gauss–Krüger series to second order: distances within 10 km of the origin are right to 1e-5.
    """

    latitude: float
    longitude: float
    """Both: origin, degrees."""

    def to_metres(self, latitude: float, longitude: float) -> tuple[float, float]:
        """x (east) and y (north) of a point, m."""
        phi, phi0 = math.radians(latitude), math.radians(self.latitude)
        delta = math.radians((longitude - self.longitude + 180.0) % 360.0 - 180.0)
        normal = EARTH_M / math.sqrt(1 - _E2 * math.sin(phi) ** 2)
        meridian = EARTH_M * (1 - _E2) / (1 - _E2 * math.sin((phi + phi0) / 2) ** 2) ** 1.5
        east = normal * math.cos(phi) * delta
        return east, meridian * (phi - phi0) + normal * math.sin(phi) * math.cos(phi) * delta**2 / 2

    def to_degrees(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude of a point given in metres: `to_metres` inverted by Newton's method."""
        latitude = self.latitude + math.degrees(y / EARTH_M)
        longitude = self.longitude + math.degrees(x / (EARTH_M * math.cos(math.radians(self.latitude))))
        for _ in range(5):
            east, north = self.to_metres(latitude, longitude)
            latitude += math.degrees((y - north) / EARTH_M)
            longitude += math.degrees((x - east) / (EARTH_M * math.cos(math.radians(latitude))))
        return latitude, longitude


CHARGER_W = 100.0
"""Assumed where neither the file nor a robot tells: maps name chargers but not their power."""
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_/.-]*( [A-Za-z0-9_/.-]+)*|-?[0-9][0-9.e+-]* [A-Za-z%][A-Za-z0-9/^%]*")
_RESERVED = {"true", "false", "null", "nan", "inf"}
_UNITS = {"x": "m", "y": "m", "length": "m", "max_speed": "m/s", "slope": "rad", "heading": "rad"}
_UNITS |= {"speed": "m/s", "duration": "s", "distance": "m"}
_CHARGER = re.compile(r"(?<!dis)charg", re.IGNORECASE)


@dataclass(frozen=True)
class SiteOptions:
    """What a user may say beside the file."""

    robot: RobotSpec | None = None
    """Whose top speed shares of it mean, and whose charging power a charger has."""
    vehicle: str = ""
    """Type of vehicle whose properties hold (layout interchange format)."""
    graph: int | None = None
    """Number of the lane graph (Open-RMF); all of them by default."""
    scale: float | None = None
    """m per pixel of a drawing without measurements (Open-RMF)."""
    smooth_m: float = 50.0
    """Elevations of a track are smoothed over this distance to each side, m."""

    @property
    def charger(self) -> dict[str, object]:
        """The charger of a place that a file marks as one."""
        batteries = self.robot.batteries.values() if self.robot else ()
        powers = [battery.max_charge_power.value for battery in batteries if battery.max_charge_power]
        watts, note = (max(powers), "what the robot takes") if powers else (CHARGER_W, "the map does not tell")
        return {"power": {"value": f"{watts:g} W", "status": "assumed", "note": note}}


@dataclass
class Remark:
    """Something of a file that has no place in ours, or that was decided; how often, and where first."""

    message: str
    line: int
    count: int = 1

    def __str__(self) -> str:
        often = f" ({self.count} times)" if self.count > 1 else ""
        where = f" [{'from ' if self.count > 1 else ''}line {self.line}]" if self.line else ""
        return f"{self.message}{often}{where}"


@dataclass
class Site:
    """Places, ways and perhaps a mission of a file."""

    file: str
    format: str
    name: str
    options: SiteOptions
    _: KW_ONLY
    title: str = ""
    notes: list[str] = field(default_factory=list)
    """Where positions are measured from, and the like."""
    places: dict[str, dict[str, Any]] = field(default_factory=dict)
    edges: list[dict[str, Any]] = field(default_factory=list)
    """Both: as they stand in an environment file, numbers in SI."""
    segments: list[dict[str, Any]] = field(default_factory=list)
    """As they stand in a mission file; empty where the file holds no mission."""
    start: str = ""
    speed: float | None = None
    """m/s, of the mission's segments that give none."""
    heights: dict[str, float] = field(default_factory=dict)
    remarks: dict[str, Remark] = field(default_factory=dict)
    edge_names: set[str] = field(default_factory=set)

    def tell(self, message: str, line: int = 0) -> None:
        """Say once, with a count, what was left out or decided."""
        if message in self.remarks:
            self.remarks[message].count += 1
        else:
            self.remarks[message] = Remark(message, line)

    def plane(self, points: Sequence[tuple[float, float]]) -> LocalPlane:
        """Metres around the middle of (latitude, longitude) points, degrees, to 1e-6; noted in the environment."""
        latitudes, longitudes = zip(*points, strict=True)
        first = longitudes[0]  # on whose side of 180° the others lie
        near = [first + (longitude - first + 180.0) % 360.0 - 180.0 for longitude in longitudes]
        plane = LocalPlane(*(round((min(values) + max(values)) / 2, 6) for values in (latitudes, near)))
        self.notes.append(f"metres east and north of {plane.latitude}, {plane.longitude} (WGS 84)")
        return plane

    def left_out(self, what: str, items: Iterable[tuple[str, Value]], used: Container[str]) -> None:
        """Tell which of the keys and values have no place in ours."""
        for key, value in items:
            if key not in used:
                self.tell(f"left out: {key[:40]} of {what}", value.line)

    def place(
        self,
        name: str,
        position: tuple[float, float] | None,
        height: float | None = None,
        *,
        charger: bool = False,
        **more: object,
    ) -> str:
        """Add a place under a name of its own (a taken one gets a number); gives that name."""
        name = _unique(name, self.places)
        self.places[name] = {key: value for key, value in more.items() if value not in (None, "")}
        if charger:
            self.places[name]["charger"] = self.options.charger
        if position is not None:
            self.places[name] |= {"x": round(position[0], 6), "y": round(position[1], 6)}
        if height is not None:
            self.heights[name] = height
        return name

    def edge(
        self, start: str, end: str, line: int = 0, *, name: str = "", both_ways: bool = False, **more: object
    ) -> None:
        """Add a way; one from a place to itself is left out and told."""
        if start == end:
            self.tell("left out: way from a place to itself", line)
            return
        given: dict[str, Any] = {}
        if name:
            name = _unique(name, self.edge_names)
            self.edge_names.add(name)
            given["name"] = name
        given |= {"from": start, "to": end} | {key: value for key, value in more.items() if value is not None}
        if given.get("max_speed", 1.0) < 1e-3:
            self.tell("left out: speed limit below 1 mm/s", line)
            del given["max_speed"]
        straight = self.straight(start, end)
        length = given.get("length")
        if straight is not None and length is not None and length < straight:
            if length < straight * 0.999:
                self.tell("length of a way is below the straight distance of its places, which holds instead", line)
            del given["length"]
        if straight == 0.0 and not given.get("length"):
            self.tell("way between two places at one point: its length is written as 1 mm", line)
            given["length"] = 0.001
        rise = self.heights.get(end, math.nan) - self.heights.get(start, math.nan)
        if "slope" not in given and rise and not math.isnan(rise) and straight:
            given["slope"] = math.atan2(rise, straight)
        if not both_ways:
            given["both_ways"] = False
        self.edges.append(given)

    def straight(self, start: str, end: str) -> float | None:
        """Straight distance of two places, m; None where one has no position."""
        ends = [self.places[name] for name in (start, end)]
        if any("x" not in place for place in ends):
            return None
        return math.hypot(ends[1]["x"] - ends[0]["x"], ends[1]["y"] - ends[0]["y"])

    @property
    def chargers(self) -> list[str]:
        """Names of the places with a charger."""
        return [name for name, place in self.places.items() if "charger" in place]

    @property
    def length_m(self) -> float:
        """Length of all ways, each once, m."""
        return sum(edge.get("length") or self.straight(edge["from"], edge["to"]) or 0.0 for edge in self.edges)

    def summary(self) -> dict[str, object]:
        """What was read, for ``--json``."""
        one_way = sum(not edge.get("both_ways", True) for edge in self.edges)
        counts = {"places": len(self.places), "edges": len(self.edges), "one_way": one_way}
        head = {"schema": "missionsim.site/1", "source": self.file, **fields_of(self, "format name"), **counts}
        told = [vars(remark) for remark in self.remarks.values()]
        return {**head, **fields_of(self, "length_m chargers"), "segments": len(self.segments), "told": told}

    def environment_text(self) -> str:
        """The environment file."""
        head = {"kind": "environment", "name": self.name, "title": self.title, "notes": "; ".join(self.notes)}
        lines = ["places:", *(f"  {flow(name)}: {flow(place)}" for name, place in self.places.items())]
        lines += ["edges:" if self.edges else "edges: []", *(f"  - {flow(edge)}" for edge in self.edges)]
        return self._text(head, lines)

    def mission_text(self, robot: str, environment: str, scheme: str = "") -> str:
        """The mission file, for a robot's name or path and the path of the environment file."""
        head = {"kind": "mission", "name": self.name, "robot": robot, "environment": environment, "start": self.start}
        defaults = {key: value for key, value in (("speed", self.speed), ("scheme", scheme)) if value}
        lines = [f"defaults: {flow(defaults)}", "segments:", *(f"  - {flow(segment)}" for segment in self.segments)]
        return self._text(head, lines)

    def _text(self, head: Mapping[str, str], lines: Iterable[str]) -> str:
        top = [f"{key}: {flow(value)}" for key, value in head.items() if value]
        return "\n".join([f"# from {Path(self.file).name} ({self.format}) by missionsim import-site", *top, *lines, ""])


def write_site(site: Site, out: str | Path, mission: str | Path | None = None, robot: str = "") -> None:
    """Write the environment, and perhaps the mission, after both have been loaded as a user would; all or nothing.

    `robot`: shipped name, or path seen from the present folder. Raises InputError: the file holds no mission, or what
    it asks for is not possible for the robot.
    """
    if mission is not None and not site.segments:
        raise InputError.single(f"{site.format} holds no mission", file=site.file, allowed="--out alone")
    with ExitStack() as stack:
        place = stack.enter_context(atomic_write(out))
        place.write_text(site.environment_text(), encoding="utf-8")
        _checked(site, load_environment, place)
        if mission is None:
            return
        draft = stack.enter_context(atomic_write(mission))
        folder = Path(mission).resolve().parent
        shown = os.path.relpath(Path(robot).resolve(), folder) if Path(robot).is_file() else robot
        loaded = load_robot(robot)
        scheme = next((name for name, spec in loaded.schemes.items() if spec.motion), "")
        if scheme:
            site.tell(f"control scheme '{scheme}' is assumed: the first of the robot that moves")
        draft.write_text(site.mission_text(shown, os.path.relpath(place.resolve(), folder), scheme), encoding="utf-8")
        _checked(site, load_mission, draft)
        final = os.path.relpath(Path(out).resolve(), folder)
        draft.write_text(site.mission_text(shown, final, scheme), encoding="utf-8")


def _checked(site: Site, load: Callable[[Path], object], draft: Path) -> None:
    """Load what was written; faults of it are told of the file that it was made of, since the draft goes away."""
    try:
        load(draft)
    except InputError as problem:
        raise InputError([replace(fault, file=site.file, line=0, column=0) for fault in problem.faults]) from None


def says_charger(*words: object) -> bool:
    """Whether names, descriptions or metadata speak of charging."""
    return any(_CHARGER.search(json.dumps(word, ensure_ascii=False, default=str)) for word in words if word)


def clean(text: str) -> str:
    """A name as one line without control characters, at most 180 long."""
    return "".join(c if c.isprintable() else " " for c in text).strip()[:180].strip()


def _unique(name: str, taken: Mapping[str, Any] | set[str]) -> str:
    name = clean(name) or "place"
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}_{number}", number + 1
    return candidate


def flow(value: object, key: str = "") -> str:
    """Data as YAML 1.2 in one line; numbers of known keys get their unit."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{flow(k)}: {flow(v, k)}" for k, v in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        number = f"{round(value, 6):.15g}"
        return f"{number} {_UNITS[key]}" if key in _UNITS else number
    text = str(value)
    plain = _PLAIN.fullmatch(text) and text.lower() not in _RESERVED
    return text if plain else json.dumps(text, ensure_ascii=False)


@dataclass(frozen=True)
class Stop:
    """A place on the way, and what is done there."""

    place: str
    speed_m_s: float | None = None
    """On the way to it; None at the start."""
    edge: str = ""
    """Name of the edge to it; its ends where it has none."""
    length_m: float = 0.0
    """Of that edge."""
    waits: tuple[tuple[str, float], ...] = ()
    """What is done there, in words of ours (``wait``, ``inspect``), and for how long, s."""
    recharge_until: float | None = None
    """Fraction of the charge; 1 where charging lasts a time."""


def stops_of(mission: MissionSpec) -> tuple[list[Stop], list[str]]:
    """Places that a mission passes, in order, and what of it has no place in such a list. Raises InputError: a mission
    without an environment, or that leaves the places of its map."""
    environment = mission.environment
    if environment is None or not mission.start:
        allowed = "environment and start"
        raise InputError.single("the mission has no map to drive on", file=str(mission.path), allowed=allowed)
    told: dict[str, None] = {}
    stops = [Stop(mission.start)]
    passed = 0.0
    for leg in make_plan(mission).legs:
        here = stops[-1]
        if leg.kind == "turn":
            continue
        if leg.kind == "stand":
            if leg.duration_s > 0:
                stops[-1] = replace(here, waits=(*here.waits, ("wait", leg.duration_s)))
        elif leg.kind == "dock":
            recharge = leg.recharge
            until = 1.0 if recharge is None or recharge.until is None else recharge.until
            stops[-1] = replace(here, recharge_until=until)
            if recharge is not None and recharge.until is None:
                told["charging for a time is written as charging until full"] = None
        elif leg.edge is None:
            allowed = "drives to places, along edges"
            raise InputError.single("the mission leaves the places of its map", file=str(mission.path), allowed=allowed)
        else:
            passed += leg.distance_m
            if abs(leg.edge.to_m - (environment.length_m(environment.edges[leg.edge.edge]) or 0.0)) > 1e-6:
                continue  # a part of an edge: its end comes
            spec = environment.edges[leg.edge.edge]
            name = spec.name or f"{leg.edge.begin} to {leg.edge.end}"
            stops.append(Stop(leg.edge.end, leg.speed_m_s, name, passed))
            passed = 0.0
        asked = {
            "payloads": leg.settings.payload_kg,
            "slopes": leg.settings.slope_rad,
            "floors": leg.settings.surface,
            "temperatures and other conditions": leg.settings.extra,
            "control schemes": leg.settings.scheme,
        }
        told |= {f"{what} have no place in it": None for what, given in asked.items() if given}
    if any(segment.kind == "inspect" for segment in flat_segments(mission.segments)):
        told["inspections are written as waiting"] = None
    if mission.activities:
        told["activities (components switched on and off) have no place in it"] = None
    return stops, list(told)
