"""Checks of a mission against its robot and environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from missionsim.errors import Fault
from missionsim.inputs.checker import Checker
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import CorrelationSpec, MissionSpec
from missionsim.inputs.parameter import uncertain_values
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import flat_segments
from missionsim.inputs.tree import Where, dotted

_DECIDED = {"time_s", "speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "lateral_speed_m_s", "slope_rad", "payload_kg"}
_DECIDED |= {"surface", "scheme", "navigation", "segment", "x_m", "y_m", "heading_rad"}
_DECIDED |= {"moving", "moving_time_s", "starts"}
"""Columns that a run fills itself; `conditions` may not set them."""
_MAX_SEGMENTS = 1_000_000


def check_mission(mission: MissionSpec) -> list[Fault]:
    """Places, ways, schemes, sensors, speeds, activities; as far as robot and environment could be loaded."""
    return _MissionCheck(mission).run()


class _MissionCheck:
    def __init__(self, mission: MissionSpec) -> None:
        self.mission = mission
        self.check = Checker(mission.document)
        self.robot: RobotSpec | None = mission.robot
        self.environment: EnvironmentSpec | None = mission.environment
        data = mission.document.data if isinstance(mission.document.data, dict) else {}
        self.environment_broken = self.environment is None and data.get("environment") is not None
        self.places: list[str] = []
        self.mapped = False
        self.reached: dict[str, set[str]] = {}
        if self.environment is not None:
            self.places = self.environment.document.names("places")
            self.mapped = self.environment.whole and self.environment.sound
        # a movement leads off the map
        self.lost = any(
            s.kind in ("arc", "move") or getattr(s, "distance", None) for s in flat_segments(mission.segments)
        )
        self.labels: list[str] = []
        self.told: set[tuple[str, str]] = set()

    def place(self, where: Where, name: str, known: Sequence[str] | None = None) -> bool:
        """Whether a place is known (True where that cannot be told); `known` holds names of edges as well."""
        if self.environment is None:
            if self.environment_broken:
                return True
            allowed = "environment: FILE in the mission, or drives by distance"
            self.check.add(where, f"place '{name}' without an environment", f"'{name}'", allowed)
            return False
        return self.check.known(where, name, self.places if known is None else known, "place")

    def once(self, where: Where, message: str) -> bool:
        """Whether this is the first time that this is told (blocks are walked twice)."""
        label = (dotted(where), message)
        if label in self.told:
            return False
        self.told.add(label)
        return True

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
        where = segment.where
        if segment.distance is not None:
            return None, True
        stops: list[tuple[Where, str]]
        if segment.along is not None:
            stops = [((*where, "along", index), name) for index, name in enumerate(segment.along)]
        else:
            stops = [((*where, "via", index), name) for index, name in enumerate(segment.via)]
            stops.append(((*where, "to"), segment.to))
        known = self.places
        if segment.along is not None and self.environment is not None:
            known = [*known, *(edge.name for edge in self.environment.edges if edge.name is not None)]
        good = True
        for at, name in stops:
            if self.once(at, "place"):
                good = self.place(at, name, known) and good
        if not good or self.environment is None or any(name not in known for _, name in stops):
            return None, True
        if here is None:
            if not unknown and self.once(where, "start"):
                allowed = "start: " + " | ".join(self.places[:12])
                self.check.add(where, "a drive to a place, but the mission has no start", "", allowed)
            elif unknown and self.mission.start in (None, *self.places) and self.lost and self.once(where, "lost"):
                got = "a drive by distance, an arc or a move before it"
                message = "the place from which this drive starts is not known"
                self.check.add(where, message, got, "drives between places only")
            return stops[-1][1], False
        near = segment.along is not None
        for at, name in stops:
            end: str | None = name
            if self.mapped and here != name:
                if near:
                    found = self.environment.next_along(here, name)
                    end = None if found is None else found[1]
                elif name not in self.reachable(here):
                    end = None
                if end is None and self.once(at, f"way from {here}"):
                    beside = {end for _, _, begin, end in self.environment.open_ways() if begin == here}
                    neighbours = ", ".join(sorted(beside if near else self.reachable(here)))
                    message = f"no {'edge' if near else 'way'} from '{here}' to '{name}'{self.shut(here, name, near)}"
                    self.check.add(at, message, name, neighbours[:200] or f"nothing can be reached from '{here}'")
            if end not in self.places:  # which place an edge leads to is not known where the map has faults
                return None, True
            here = end
        return here, False

    def shut(self, here: str, name: str, near: bool) -> str:
        """What is closed, where a way is missing for that."""
        environment = self.environment
        assert environment is not None
        places = [place for place, spec in environment.places.items() if spec.closed]
        beside = [edge for edge in environment.edges if not near or {here, name} & {edge.from_, edge.to, edge.name}]
        shut = [edge.name or f"{edge.from_} to {edge.to}" for edge in beside if edge.closed]
        shut += [place for place in places if not near or any(place in (edge.from_, edge.to) for edge in beside)]
        return f" (closed: {', '.join(shut[:6])})" if shut else ""

    def reachable(self, start: str) -> set[str]:
        """Places that ways lead to."""
        if start not in self.reached and self.environment is not None:
            self.reached[start] = self.environment.reached(start)
        return self.reached.get(start, set())

    def dock(self, segment: Any, here: str | None, unknown: bool) -> None:
        """A charger at this place, for these batteries."""
        where = segment.where
        if not self.once(where, f"dock at {here} {unknown}") or self.environment is None:
            if self.environment is None and not self.environment_broken and self.once(where, "dock"):
                allowed = "an environment with a place that has a charger"
                self.check.add(where, "docking without an environment", "", allowed)
            return
        place = self.environment.places.get(here or "")
        if here is None or place is None:
            return
        if place.charger is None:
            allowed = ", ".join(self.environment.chargers) or "no place has a charger"
            self.check.add(where, f"no charger at '{here}'", here, allowed, key=True)
            return
        fed = place.charger.batteries or tuple(self.robot.batteries if self.robot is not None else ())
        for index, name in enumerate(segment.recharge.batteries):
            self.check.known((*where, "recharge", "batteries", index), name, fed, f"battery of the charger at '{here}'")
        for name in place.charger.batteries if self.robot is not None else ():
            if self.robot is not None and name not in self.robot.batteries:
                message = f"the charger at '{here}' feeds a battery that the robot lacks"
                self.check.add(where, message, name, ", ".join(self.robot.batteries), key=True)

    def run(self) -> list[Fault]:
        mission, check = self.mission, self.check
        if mission.start is not None:
            self.place(("start",), mission.start)
        self.settings(("defaults",), mission.defaults, None)
        self.collect(mission.segments)
        here = mission.start if mission.start in self.places else None
        unknown = mission.start is not None and here is None
        self.walk(mission.segments, here, unknown)
        if _count(mission.segments) > _MAX_SEGMENTS:
            check.add(("segments",), "too many segments", "repeats counted one by one", f"at most {_MAX_SEGMENTS}")
        self.policy()
        self.activities()
        if self.robot is not None:
            check.keys(("initial_charge",), mission.initial_charge, self.robot.batteries, "battery")
            check.keys(("behaviour", "schemes"), mission.behaviour.schemes, self.robot.schemes, "control scheme")
        self.chances()
        self.correlations()
        return check.faults

    def collect(self, segments: Sequence[Any]) -> None:
        """Names of all segments, for the activities' moments."""
        for segment in segments:
            if segment.name is not None:
                self.labels.append(segment.name)
            if segment.kind == "repeat":
                self.collect(segment.segments)

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
            wrong = any(self.check.document.is_faulty((*where, often)) for where, _ in told)
            if wrong or any(getattr(item, often, None) is not None for item in everywhere):
                continue
            for where, item in told:
                if getattr(item, long, None) is not None:
                    allowed = f"{often} beside it, in the mission's behaviour or in the robot's"
                    self.check.add((*where, long), f"'{long}' has no effect without '{often}'", long, allowed, key=True)

    def segment(self, segment: Any) -> None:
        """Settings of one segment, and what its kind needs."""
        where, robot = segment.where, self.robot
        if not self.once(where, "segment"):
            return
        self.settings(where, segment, segment)
        if robot is None:
            return
        drive = robot.body.drive
        if segment.kind == "move" and not robot.body.moves_sideways:
            message = f"a {drive} drive cannot move sideways"
            self.check.add(where, message, "move", "mecanum or omni drive", key=True)
        if segment.kind == "turn" and drive == "ackermann":
            self.check.add(where, "an ackermann drive cannot turn on the spot", "turn", "an arc", key=True)
        name = self.mission.scheme_of(segment) or ""
        moving = segment.kind in ("drive", "arc", "turn", "move")
        if moving and name in robot.schemes and not robot.schemes[name].motion:
            own = segment.scheme is not None
            given = own or self.mission.defaults.scheme is not None
            at = (*where, "scheme") if own else ("defaults", "scheme") if given else where
            self.check.stands_still(at, name, robot, f"a {segment.kind} segment", key=not given)

    def settings(self, where: Where, settings: Any, segment: Any | None) -> None:
        """Scheme, navigation, sensors, speed, payload, conditions of a segment or of `defaults`."""
        robot, check, mission = self.robot, self.check, self.mission
        for name in settings.conditions:
            if name in _DECIDED or name.startswith(("on_", "power_")):
                allowed = "conditions that the mission does not set otherwise"
                check.add((*where, "conditions", name), f"'{name}' is decided by the run", name, allowed, key=True)
        if robot is None:
            return
        if settings.scheme is not None:
            schemes = robot.document.names("schemes")
            check.known((*where, "scheme"), settings.scheme, schemes, "control scheme")
        name = mission.scheme_of(segment) if segment is not None else settings.scheme
        scheme = robot.schemes.get(name or "")
        if settings.navigation is not None:
            names = [key for item in robot.schemes.values() for key in item.navigation]
            if scheme is None:
                check.known((*where, "navigation"), settings.navigation, dict.fromkeys(names), "navigation")
            elif segment is not None or scheme.navigation:
                check.known((*where, "navigation"), settings.navigation, scheme.navigation, f"navigation of {name}")
        for sensor, count in (settings.sensors or {}).items():
            at = (*where, "sensors", sensor)
            if not check.units(at, sensor, count, robot) or scheme is None or segment is None or not count:
                continue
            under = mission.navigation_of(segment)
            _, used = scheme.sensor_rules(under)
            if sensor in robot.sensor_names and count > used.get(sensor, 0):
                text = ", ".join(f"{key} up to {most}" for key, most in used.items()) or "no sensors"
                whose = f"control scheme '{name}'" + (f" with {under}" if under else "")
                check.add(at, f"{whose} does not use {count} of '{sensor}'", f"{sensor}: {count}", text)
        self.limits(where, settings, scheme, name)

    def limits(self, where: Where, settings: Any, scheme: Any, name: str | None) -> None:
        """Speeds, turn rate and payload that the robot can do."""
        assert self.robot is not None
        if not self.robot.whole:
            return
        body = self.robot.body
        top = body.max_speed.value
        if getattr(settings, "kind", "") == "move" and body.max_lateral_speed is not None:
            top = max(top, body.max_lateral_speed.value)
        of = f" of {self.robot.name})"
        slow = scheme.max_speed.value if scheme is not None and scheme.max_speed is not None else None
        turn = body.max_yaw_rate.value if "max_yaw_rate" in body.model_fields_set else None
        load = body.max_payload.value if body.max_payload is not None else None
        told: set[str] = set()
        for key, most, message, unit, whose in (
            ("speed", top, "faster than the robot", "m/s", f" (body.max_speed{of}"),
            ("speed", slow, f"faster than control scheme '{name}'", "m/s", ""),
            ("yaw_rate", turn, "turns faster than the robot", "rad/s", f" (body.max_yaw_rate{of}"),
            ("payload", load, "more than the robot carries", "kg", ""),
        ):
            given = getattr(settings, key)
            if given is None or most is None or key in told or given.value <= most * (1 + 1e-12):
                continue
            told.add(key)
            self.check.add((*where, key), message, f"{given.value:g} {unit}", f"at most {most:g} {unit}{whose}")

    def policy(self) -> None:
        policy = self.mission.policy
        if self.robot is not None:
            self.check.keys(("policy", "reserve"), policy.reserve, self.robot.batteries, "battery")
        if policy.dock is None or not self.place(("policy", "dock"), policy.dock) or self.environment is None:
            return
        place = self.environment.places.get(policy.dock)
        if place is not None and place.charger is None and policy.on_empty != "stop":
            allowed = ", ".join(self.environment.chargers) or "a place with a charger"
            message = f"no charger at '{policy.dock}'"
            self.check.add(("policy", "dock"), message, policy.dock, allowed, warning=True)

    def activities(self) -> None:
        for index, activity in enumerate(self.mission.activities):
            where: Where = ("activities", index)
            if self.robot is not None:
                name = activity.component
                self.check.units((*where, "component"), name, activity.units, self.robot, 1)
                component = self.robot.components.get(name)
                if component is not None and component.always_on:
                    self.check.add((*where, "component"), f"'{name}' is always on", warning=True)
            begin, end = (m.time if m is not None else None for m in (activity.from_, activity.until))
            if begin is not None and end is not None and end.value <= begin.value:
                got, allowed = f"{end.value:g} s", f"more than {begin.value:g} s"
                self.check.add((*where, "until"), "the activity ends before it begins", got, allowed)
            for key, moment in (("from", activity.from_), ("until", activity.until)):
                if moment is None:
                    continue
                at = (*where, key)
                if moment.place is not None:
                    raw = self.check.document.node(at).children
                    self.place((*at, "place") if isinstance(raw, dict) else at, moment.place)
                if moment.segment is not None:
                    labels = list(dict.fromkeys(self.labels))
                    if not (moment.segment.isdecimal() and int(moment.segment) < len(self.mission.segments)):
                        self.check.known((*at, "segment"), moment.segment, labels, "segment")

    def correlations(self) -> None:
        mission = self.mission
        for index, item in enumerate(mission.correlations):
            where: Where = ("correlations", index, "between")
            if item.between[0] == item.between[1]:
                self.check.add(where, "a value is correlated with itself", got=item.between[0], allowed="two values")
                continue
            for number, path in enumerate(item.between):
                known = self.uncertain()
                if path in known:
                    continue
                if not known and (self.robot is None or self.environment_broken):
                    continue
                self.check.known((*where, number), path, known, "uncertain value")
        faulty = mission.document.is_faulty(("correlations",), below=True)
        if not faulty and not _possible(mission.correlations):
            got = ", ".join(dict.fromkeys(path for item in mission.correlations for path in item.between))
            allowed = "a positive definite matrix of correlations"
            self.check.add(("correlations",), "these correlations cannot hold together", got, allowed, key=True)

    def uncertain(self) -> list[str]:
        """Paths of all uncertain values of mission, robot and environment."""
        found = [path for path, _ in uncertain_values(self.mission)]
        for prefix, model in (("robot", self.robot), ("environment", self.environment)):
            if model is not None:
                found += [f"{prefix}.{path}" for path, _ in uncertain_values(model)]
        return found


def _possible(correlations: Sequence[CorrelationSpec]) -> bool:
    """Whether the matrix of all correlations is positive definite."""
    place = {path: i for i, path in enumerate(dict.fromkeys(path for item in correlations for path in item.between))}
    matrix = np.eye(len(place))
    for item in correlations:
        i, j = (place[path] for path in item.between)
        if i != j:
            matrix[i, j] = matrix[j, i] = item.rho
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def _count(segments: Sequence[Any]) -> int:
    return sum(item.least * _count(item.segments) if item.kind == "repeat" else 1 for item in segments)
