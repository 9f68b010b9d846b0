"""Checks of a mission against its robot and environment."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from missionsim.errors import Fault
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import Parameter, uncertain_values
from missionsim.inputs.power import strange_floors
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import MOST_SEGMENTS, every_segment, fastest, flat_segments
from missionsim.inputs.tree import Where
from missionsim.inputs.unread import unread_conditions, unread_settings
from missionsim.inputs.validation import Checker

_DECIDED = {"time_s", "speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "lateral_speed_m_s", "slope_rad", "payload_kg"}
_DECIDED |= {"surface", "scheme", "navigation", "segment", "x_m", "y_m", "heading_rad"}
_DECIDED |= {"moving", "moving_time_s", "starts"}
"""Columns that a run fills itself; `conditions` may not set them."""


def check_mission(mission: MissionSpec) -> list[Fault]:
    """Places, ways, schemes, sensors, speeds, activities; as far as robot and environment could be loaded."""
    check = _MissionCheck(mission)
    if mission.start is not None:
        check.place(("start",), mission.start)
    check.angle(("start_heading",), mission.start_heading)
    check.settings(("defaults",), mission.defaults, None)
    here = mission.start if mission.start in check.places else None
    check.walk(mission.segments, here, mission.start is not None and here is None)
    if _count(mission.segments) > MOST_SEGMENTS:
        check.add(("segments",), "too many segments", "repeats counted one by one", f"at most {MOST_SEGMENTS}")
    check.policy()
    check.activities()
    if check.robot is not None:
        check.keys(("initial_charge",), mission.initial_charge, check.robot.batteries, "battery")
        check.keys(("behaviour", "schemes"), mission.behaviour.schemes, check.robot.schemes, "control scheme")
    check.chances()
    check.correlations()
    unread = (*unread_settings(mission), *unread_conditions(mission))
    return [*check.faults, *unread, *strange_floors(mission, flat_segments(mission.segments))]


class _MissionCheck(Checker):
    def __init__(self, mission: MissionSpec) -> None:
        super().__init__(mission.document)
        self.mission = mission
        self.robot: RobotSpec | None = mission.robot
        self.environment: EnvironmentSpec | None = mission.environment
        data = mission.document.data if isinstance(mission.document.data, dict) else {}
        self.environment_broken = self.environment is None and data.get("environment") is not None
        self.places: list[str] = []
        if self.environment is not None:
            self.places = self.environment.document.names("places")
            self.reached = functools.cache(self.environment.reached)
        self.told: set[tuple[Where, str]] = set()

    def place(self, where: Where, name: str, known: Sequence[str] | None = None) -> bool:
        """Whether a place is known (True where that cannot be told); `known` holds names of edges as well."""
        if self.environment is not None:
            return self.known(where, name, self.places if known is None else known, "place")
        if not self.environment_broken:
            allowed = "environment: FILE in the mission, or drives by distance"
            self.add(where, f"place '{name}' without an environment", f"'{name}'", allowed)
        return self.environment_broken

    def once(self, where: Where, message: str) -> bool:
        """Whether this is the first time that this is told (blocks are walked twice)."""
        first = (where, message) not in self.told
        self.told.add((where, message))
        return first

    def walk(self, segments: Sequence[Any], here: str | None, unknown: bool) -> tuple[str | None, bool]:
        """Follow the places through the segments; `unknown` = somewhere that cannot be named any more."""
        for segment in segments:
            if segment.kind == "repeat":
                after = self.walk(segment.segments, here, unknown)
                if (segment.times is None or segment.times > 1) and after != (here, unknown):
                    after = self.walk(segment.segments, *after)
                here, unknown = after
                continue
            self.segment(segment)
            if segment.kind == "drive":
                here, unknown = self.drive(segment, here, unknown)
            elif segment.kind in ("arc", "move"):
                here, unknown = None, True
            elif segment.kind == "dock":
                self.dock(segment, here, unknown)
        return here, unknown

    def drive(self, segment: Any, here: str | None, unknown: bool) -> tuple[str | None, bool]:
        where, environment, near = segment.where, self.environment, segment.along is not None
        if segment.distance is not None:
            return None, True
        key = "along" if near else "via"
        stops: list[tuple[Where, str]] = [((*where, key, i), name) for i, name in enumerate(getattr(segment, key))]
        stops += [] if near else [((*where, "to"), segment.to)]
        known = self.places
        if near and environment is not None:
            known = [*known, *(edge.name for edge in environment.edges if edge.name is not None)]
        good = [self.place(at, name, known) for at, name in stops if self.once(at, "place")]
        if not all(good) or environment is None or any(name not in known for _, name in stops):
            return None, True
        if here is None:
            if not unknown and self.once(where, "start"):
                allowed = "start: " + " | ".join(self.places[:12])
                self.add(where, "a drive to a place, but the mission has no start", "", allowed)
            elif unknown and self.mission.start in (None, *self.places) and self.lost and self.once(where, "lost"):
                got = "a drive by distance, an arc or a move before it"
                message = "the place from which this drive starts is not known"
                self.add(where, message, got, "drives between places only")
            return stops[-1][1], False
        for at, name in stops:
            end: str | None = name
            if environment.whole and environment.sound and here != name:
                if near:
                    found = environment.next_along(here, name)
                    end = None if found is None else found[1]
                elif name not in self.reached(here):
                    end = None
                if end is None and self.once(at, f"way from {here}"):
                    beside = {end for _, _, begin, end in environment.open_ways() if begin == here}
                    neighbours = ", ".join(sorted(beside if near else self.reached(here)))
                    message = f"no {'edge' if near else 'way'} from '{here}' to '{name}'{self.shut(here, name, near)}"
                    self.add(at, message, name, neighbours[:200] or f"nothing can be reached from '{here}'")
            if end not in self.places:  # which place an edge leads to is not known where the map has faults
                return None, True
            here = end
        return here, False

    @functools.cached_property
    def lost(self) -> bool:
        """Whether a movement leads off the map."""
        flat = flat_segments(self.mission.segments)
        return any(s.kind in ("arc", "move") or getattr(s, "distance", None) for s in flat)

    def shut(self, here: str, name: str, near: bool) -> str:
        """What is closed, where a way is missing for that."""
        environment = self.environment
        assert environment is not None
        places = [place for place, spec in environment.places.items() if spec.closed]
        beside = [edge for edge in environment.edges if not near or {here, name} & {edge.from_, edge.to, edge.name}]
        shut = [edge.name or f"{edge.from_} to {edge.to}" for edge in beside if edge.closed]
        shut += [place for place in places if not near or any(place in (edge.from_, edge.to) for edge in beside)]
        return f" (closed: {', '.join(shut[:6])})" if shut else ""

    def dock(self, segment: Any, here: str | None, unknown: bool) -> None:
        """A charger at this place, for these batteries."""
        where, environment, robot = segment.where, self.environment, self.robot
        if environment is None:
            if not self.environment_broken and self.once(where, "dock"):
                self.add(where, "docking without an environment", "", "an environment with a place that has a charger")
            return
        place = environment.places.get(here or "")
        if not self.once(where, f"dock at {here} {unknown}") or here is None or place is None:
            return
        if place.charger is None:
            allowed = ", ".join(environment.chargers) or "no place has a charger"
            self.add(where, f"no charger at '{here}'", here, allowed, key=True)
            return
        fed = place.charger.batteries or tuple(robot.batteries if robot is not None else ())
        for index, name in enumerate(segment.recharge.batteries):
            self.known((*where, "recharge", "batteries", index), name, fed, f"battery of the charger at '{here}'")
        for name in place.charger.batteries:
            if robot is not None and name not in robot.batteries:
                message = f"the charger at '{here}' feeds a battery that the robot lacks"
                self.add(where, message, name, ", ".join(robot.batteries), key=True)

    def segment(self, segment: Any) -> None:
        """Settings of one segment, and what its kind needs."""
        where, robot = segment.where, self.robot
        if not self.once(where, "segment"):
            return
        self.settings(where, segment, segment)
        for key in ("angle", "direction", "heading"):
            self.angle((*where, key), getattr(segment, key, None))
        if robot is None:
            return
        drive = robot.body.drive
        if segment.kind == "move" and drive not in ("mecanum", "omni"):
            message = f"a {drive} drive cannot move sideways"
            self.add(where, message, "move", "mecanum or omni drive", key=True)
        if segment.kind == "turn" and drive == "ackermann":
            self.add(where, "an ackermann drive cannot turn on the spot", "turn", "an arc", key=True)
        name = self.mission.scheme_of(segment) or ""
        moving = segment.kind in ("drive", "arc", "turn", "move")
        if moving and name in robot.schemes and not robot.schemes[name].motion:
            own = segment.scheme is not None
            given = own or self.mission.defaults.scheme is not None
            at = (*where, "scheme") if own else ("defaults", "scheme") if given else where
            self.stands_still(at, name, robot, f"a {segment.kind} segment", key=not given)

    def angle(self, where: Where, given: Parameter | None) -> None:
        """A plain number of more than a whole turn is hardly meant in radians."""
        raw = self.document.node(where).data
        raw = raw.get("value") if isinstance(raw, dict) and "unit" not in raw else raw
        if given is None or not isinstance(raw, (int, float)) or abs(given.value) <= 2.0 * math.pi:
            return
        turns, meant = abs(given.value) / (2.0 * math.pi), f"{given.value:g} deg"
        message = f"a plain number is in radians: these are {turns:.3g} whole turns"
        self.add(where, message, f"{given.value:g}", f"{meant}, or {given.value:g} rad", meant, warning=True)

    def settings(self, where: Where, settings: Any, segment: Any | None) -> None:
        """Scheme, navigation, sensors, conditions, speeds and payload of a segment or of `defaults`."""
        robot, mission = self.robot, self.mission
        for name in settings.conditions:
            if name in _DECIDED or name.startswith(("on_", "power_")):
                allowed = "conditions that the mission does not set otherwise"
                self.add((*where, "conditions", name), f"'{name}' is decided by the run", name, allowed, key=True)
        if robot is None:
            return
        if settings.scheme is not None:
            self.known((*where, "scheme"), settings.scheme, robot.document.names("schemes"), "control scheme")
        name = mission.scheme_of(segment) if segment is not None else settings.scheme
        scheme = robot.schemes.get(name or "")
        if settings.navigation is not None:
            names = [key for item in robot.schemes.values() for key in item.navigation]
            if scheme is None:
                self.known((*where, "navigation"), settings.navigation, dict.fromkeys(names), "navigation")
            elif segment is not None or scheme.navigation:
                self.known((*where, "navigation"), settings.navigation, scheme.navigation, f"navigation of {name}")
        for sensor, count in (settings.sensors or {}).items():
            at = (*where, "sensors", sensor)
            if not self.units(at, sensor, count, robot) or scheme is None or segment is None or not count:
                continue
            under = mission.navigation_of(segment)
            _, used = scheme.sensor_rules(under)
            if sensor in robot.sensor_names and count > used.get(sensor, 0):
                text = ", ".join(f"{key} up to {most}" for key, most in used.items()) or "no sensors"
                whose = f"control scheme '{name}'" + (f" with {under}" if under else "")
                self.add(at, f"{whose} does not use {count} of '{sensor}'", f"{sensor}: {count}", text)
        body, of = robot.body, f" of {robot.name})"
        told: set[str] = set()
        top, limits, sideways = body.max_speed, "max_speed", body.max_lateral_speed
        if getattr(settings, "kind", "") == "move" and sideways is not None:
            top, limits = (
                Parameter(fastest(settings.direction.value, top.value, sideways.value)),
                f"{limits} and max_lateral_speed",
            )
        for key, most, message, unit, whose in (
            ("speed", top, "faster than the robot", "m/s", f" (body.{limits}{of}"),
            ("speed", None if scheme is None else scheme.max_speed, f"faster than control scheme '{name}'", "m/s", ""),
            ("yaw_rate", body.max_yaw_rate, "turns faster than the robot", "rad/s", f" (body.max_yaw_rate{of}"),
            ("payload", body.max_payload, "more than the robot carries", "kg", ""),
        ):
            given = getattr(settings, key) if robot.whole and key not in told else None
            unset = key == "yaw_rate" and "max_yaw_rate" not in body.model_fields_set
            if given is not None and most is not None and not unset and given.value > most.value * (1 + 1e-12):
                told.add(key)
                allowed = f"at most {most.value:g} {unit}{whose}"
                self.add((*where, key), message, f"{given.value:g} {unit}", allowed)

    def policy(self) -> None:
        policy, environment = self.mission.policy, self.environment
        if self.robot is not None:
            self.keys(("policy", "reserve"), policy.reserve, self.robot.batteries, "battery")
        if policy.dock is None or not self.place(("policy", "dock"), policy.dock) or environment is None:
            return
        place = environment.places.get(policy.dock)
        if place is not None and place.charger is None and policy.on_empty != "stop":
            message, allowed = f"no charger at '{policy.dock}'", ", ".join(environment.chargers)
            self.add(("policy", "dock"), message, policy.dock, allowed or "a place with a charger", warning=True)

    def activities(self) -> None:
        mission, robot = self.mission, self.robot
        labels = list(dict.fromkeys(s.name for s in every_segment(mission.segments) if s.name is not None))
        for index, activity in enumerate(mission.activities):
            where: Where = ("activities", index)
            if robot is not None:
                name = activity.component
                self.units((*where, "component"), name, activity.units, robot, 1)
                if name in robot.components and robot.components[name].always_on:
                    self.add((*where, "component"), f"'{name}' is always on", warning=True)
            begin, end = (m.time if m is not None else None for m in (activity.from_, activity.until))
            if begin is not None and end is not None and end.value <= begin.value:
                got, allowed = f"{end.value:g} s", f"more than {begin.value:g} s"
                self.add((*where, "until"), "the activity ends before it begins", got, allowed)
            for key, moment in (("from", activity.from_), ("until", activity.until)):
                at, segment = (*where, key), None if moment is None else moment.segment
                if moment is not None and moment.place is not None:
                    written = self.document.node(at).children
                    self.place((*at, "place") if isinstance(written, dict) else at, moment.place)
                if segment is not None and not (segment.isdecimal() and int(segment) < len(mission.segments)):
                    self.known((*at, "segment"), segment, labels, "segment")

    def chances(self) -> None:
        """What is left to chance comes in pairs: how often, and how long each time."""
        mission = self.mission
        told: list[tuple[Where, Any]] = [(("behaviour",), mission.behaviour)]
        told += [(("behaviour", "schemes", name), item) for name, item in mission.behaviour.schemes.items()]
        told += [(("defaults", "behaviour"), mission.defaults.behaviour)]
        told += [((*item.where, "behaviour"), item.behaviour) for item in flat_segments(mission.segments)]
        schemes = self.robot.schemes.values() if self.robot is not None else ()
        everywhere = [item for _, item in told] + [scheme.behaviour for scheme in schemes]
        for long, often in (("obstacle_stop", "obstacle_spacing"), ("relocalisation_time", "relocalisation_failure")):
            wrong = any(self.document.is_faulty((*where, often)) for where, _ in told)
            if wrong or any(getattr(item, often, None) is not None for item in everywhere):
                continue
            for where, item in told:
                if getattr(item, long, None) is not None:
                    allowed = f"{often} beside it, in the mission's behaviour or in the robot's"
                    self.add((*where, long), f"'{long}' has no effect without '{often}'", long, allowed, key=True)

    def correlations(self) -> None:
        mission = self.mission
        known = [path for path, _ in uncertain_values(mission)] if mission.correlations else []
        for prefix, model in (("robot", self.robot), ("environment", self.environment)):
            if model is not None and mission.correlations:
                known += [f"{prefix}.{path}" for path, _ in uncertain_values(model)]
        unsaid = not known and (self.robot is None or self.environment_broken)
        for index, item in enumerate(mission.correlations):
            where: Where = ("correlations", index, "between")
            if item.between[0] == item.between[1]:
                self.add(where, "a value is correlated with itself", got=item.between[0], allowed="two values")
            elif not unsaid:
                for number, path in enumerate(item.between):
                    self.known((*where, number), path, known, "uncertain value")
        paths = list(dict.fromkeys(path for item in mission.correlations for path in item.between))
        matrix = np.eye(len(paths))
        for item in mission.correlations:
            i, j = (paths.index(path) for path in item.between)
            if i != j:
                matrix[i, j] = matrix[j, i] = item.rho
        try:
            np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            if not self.document.is_faulty(("correlations",), below=True):
                got, allowed = ", ".join(paths), "a positive definite matrix of correlations"
                self.add(("correlations",), "these correlations cannot hold together", got, allowed, key=True)


def _count(segments: Sequence[Any]) -> int:
    return sum(item.least * _count(item.segments) if item.kind == "repeat" else 1 for item in segments)
