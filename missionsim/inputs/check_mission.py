"""Checks of a mission against its robot and environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from missionsim.errors import Fault
from missionsim.inputs.check_route import RouteCheck
from missionsim.inputs.checker import Checker, Where
from missionsim.inputs.mission import CorrelationSpec, MissionSpec
from missionsim.inputs.parameter import uncertain_values
from missionsim.inputs.segments import flat_segments
from missionsim.inputs.tree import Document

_DECIDED = (
    "time_s",
    "speed_m_s",
    "accel_m_s2",
    "yaw_rate_rad_s",
    "lateral_speed_m_s",
    "slope_rad",
    "payload_kg",
    "surface",
    "scheme",
    "navigation",
    "segment",
    "x_m",
    "y_m",
    "heading_rad",
    "moving",
    "moving_time_s",
    "starts",
)
"""Columns that a run fills itself; `conditions` may not set them."""
_MAX_SEGMENTS = 1_000_000


def check_mission(mission: MissionSpec, document: Document) -> list[Fault]:
    """Places, ways, schemes, sensors, speeds, activities; as far as robot and environment could be loaded."""
    return _MissionCheck(mission, document).run()


class _MissionCheck(RouteCheck):
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
            check.add(
                ("segments",), "too many segments", got="repeats counted one by one", allowed=f"at most {_MAX_SEGMENTS}"
            )
        self.policy()
        self.activities()
        if self.robot is not None:
            batteries = list(self.robot.batteries)
            for name in mission.initial_charge:
                check.known(("initial_charge", name), name, batteries, "battery", key=True)
            for name in mission.behaviour.schemes:
                check.known(("behaviour", "schemes", name), name, self.robot.schemes, "control scheme", key=True)
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
            wrong = any(self.check.faulty((*where, often)) for where, _ in told)
            if wrong or any(getattr(item, often, None) is not None for item in everywhere):
                continue
            for where, item in told:
                if getattr(item, long, None) is not None:
                    self.check.add(
                        (*where, long),
                        f"'{long}' has no effect without '{often}'",
                        got=long,
                        allowed=f"{often} beside it, in the mission's behaviour or in the robot's",
                        key=True,
                    )

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
            self.check.add(
                where, f"a {drive} drive cannot move sideways", got="move", allowed="mecanum or omni drive", key=True
            )
        if segment.kind == "turn" and drive == "ackermann":
            self.check.add(where, "an ackermann drive cannot turn on the spot", got="turn", allowed="an arc", key=True)
        scheme = robot.schemes.get(self.mission.scheme_of(segment) or "")
        moving = segment.kind in ("drive", "arc", "turn", "move")
        if scheme is not None and moving and not scheme.motion:
            at, key = self.origin(segment, "scheme")
            self.check.add(
                at,
                f"control scheme '{self.mission.scheme_of(segment)}' stands still",
                got=f"a {segment.kind} segment",
                allowed=", ".join(name for name, item in robot.schemes.items() if item.motion),
                key=key,
            )

    def origin(self, segment: Any, key: str) -> tuple[tuple[str | int, ...], bool]:
        """Where a segment's setting stands: in itself, else in `defaults`, else the segment as a whole."""
        if getattr(segment, key, None) is not None:
            return (*segment.where, key), False
        if getattr(self.mission.defaults, key, None) is not None:
            return ("defaults", key), False
        return segment.where, True

    def settings(self, where: Where, settings: Any, segment: Any | None) -> None:
        """Scheme, navigation, sensors, speed, payload, conditions of a segment or of `defaults`."""
        robot, check, mission = self.robot, self.check, self.mission
        for name in settings.conditions:
            if name in _DECIDED or name.startswith(("on_", "power_")):
                check.add(
                    (*where, "conditions", name),
                    f"'{name}' is decided by the run",
                    got=name,
                    allowed="conditions that the mission does not set otherwise",
                    key=True,
                )
        if robot is None:
            return
        if settings.scheme is not None:
            check.known(
                (*where, "scheme"), settings.scheme, Checker(robot.document).raw_keys("schemes"), "control scheme"
            )
        name = mission.scheme_of(segment) if segment is not None else settings.scheme
        scheme = robot.schemes.get(name or "")
        if settings.navigation is not None:
            names = (
                scheme.navigation
                if scheme is not None
                else {key: None for item in robot.schemes.values() for key in item.navigation}
            )
            if segment is not None or scheme is None or scheme.navigation:
                check.known(
                    (*where, "navigation"),
                    settings.navigation,
                    names,
                    f"navigation of {name}" if scheme is not None else "navigation",
                )
        for sensor, count in (settings.sensors or {}).items():
            at = (*where, "sensors", sensor)
            if not check.units(at, sensor, count, robot):
                continue
            if scheme is None or segment is None or not count:
                continue
            _, allowed = scheme.sensor_rules(mission.navigation_of(segment))
            if sensor in robot.sensor_names and count > allowed.get(sensor, 0):
                under = mission.navigation_of(segment)
                text = ", ".join(f"{key} up to {most}" for key, most in allowed.items()) or "no sensors"
                check.add(
                    at,
                    f"control scheme '{name}'{f' with {under}' if under else ''} does not use {count} of '{sensor}'",
                    got=f"{sensor}: {count}",
                    allowed=text,
                )
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
            allowed = f"at most {most:g} {unit}{whose}"
            self.check.add((*where, key), message, got=f"{given.value:g} {unit}", allowed=allowed)

    def policy(self) -> None:
        policy = self.mission.policy
        if isinstance(policy.reserve, dict) and self.robot is not None:
            for name in policy.reserve:
                self.check.known(("policy", "reserve", name), name, self.robot.batteries, "battery", key=True)
        if policy.dock is None or not self.place(("policy", "dock"), policy.dock) or self.environment is None:
            return
        place = self.environment.places.get(policy.dock)
        if place is not None and place.charger is None and policy.on_empty != "stop":
            chargers = [name for name, item in self.environment.places.items() if item.charger is not None]
            self.check.add(
                ("policy", "dock"),
                f"no charger at '{policy.dock}'",
                got=policy.dock,
                allowed=", ".join(chargers) or "a place with a charger",
                warning=True,
            )

    def activities(self) -> None:
        for index, activity in enumerate(self.mission.activities):
            where: tuple[str | int, ...] = ("activities", index)
            if self.robot is not None:
                name = activity.component
                self.check.units((*where, "component"), name, activity.units, self.robot, 1)
                component = self.robot.components.get(name)
                if component is not None and component.always_on:
                    self.check.add((*where, "component"), f"'{name}' is always on", warning=True)
            begin, end = (m.time if m is not None else None for m in (activity.from_, activity.until))
            if begin is not None and end is not None and end.value <= begin.value:
                self.check.add(
                    (*where, "until"),
                    "the activity ends before it begins",
                    got=f"{end.value:g} s",
                    allowed=f"more than {begin.value:g} s",
                )
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
        for index, item in enumerate(self.mission.correlations):
            where: tuple[str | int, ...] = ("correlations", index, "between")
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
        if not self.check.touched("correlations") and not _possible(self.mission.correlations):
            self.check.add(
                ("correlations",),
                "these correlations cannot hold together",
                key=True,
                got=", ".join(dict.fromkeys(path for item in self.mission.correlations for path in item.between)),
                allowed="a positive definite matrix of correlations",
            )

    def uncertain(self) -> list[str]:
        """Paths of all uncertain values of mission, robot and environment."""
        found = [path for path, _ in uncertain_values(self.mission)]
        for prefix, model in (("robot", self.robot), ("environment", self.environment)):
            if model is not None:
                found += [f"{prefix}.{path}" for path, _ in uncertain_values(model)]
        return found


def _possible(correlations: Sequence[CorrelationSpec]) -> bool:
    """Whether the matrix of all correlations is positive definite."""
    import numpy as np

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
