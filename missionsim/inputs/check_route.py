"""Where a mission leads: every place is known and every way exists."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from missionsim.inputs.checker import Checker, Where
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import flat_segments
from missionsim.inputs.tree import Document, dotted


class RouteCheck:
    """Follows a mission from place to place."""

    def __init__(self, mission: MissionSpec, document: Document) -> None:
        self.mission = mission
        self.check = Checker(document)
        self.robot: RobotSpec | None = mission.robot
        self.environment: EnvironmentSpec | None = mission.environment
        has_environment = isinstance(document.data, dict) and document.data.get("environment") is not None
        self.environment_broken = has_environment and self.environment is None
        self.places: list[str] = []
        self.ways: dict[str, set[str]] = {}
        if self.environment is not None:
            self.places = Checker(self.environment.document).raw_keys("places")
            whole = self.environment.whole and self.environment.sound
            self.ways = _ways(self.environment) if whole else {}
        self.labels: list[str] = []
        self.told: set[tuple[str, str]] = set()

    def place(self, where: Where, name: str, known: Sequence[str] | None = None) -> bool:
        """Whether a place is known (True where that cannot be told); `known` holds names of edges as well."""
        if self.environment is None:
            if self.environment_broken:
                return True
            self.check.add(
                where,
                f"place '{name}' without an environment",
                got=f"'{name}'",
                allowed="environment: FILE in the mission, or drives by distance",
            )
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

    def segment(self, segment: Any) -> None:
        """What else there is to check in a segment; `missionsim.inputs.check_mission` says."""

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
                self.check.add(
                    where,
                    "a drive to a place, but the mission has no start",
                    allowed="start: " + " | ".join(self.places[:12]),
                )
            elif (
                unknown
                and self.mission.start in (None, *self.places)
                and self.once(where, "lost")
                and self._lost_before(segment)
            ):
                self.check.add(
                    where,
                    "the place from which this drive starts is not known",
                    got="a drive by distance, an arc or a move before it",
                    allowed="drives between places only",
                )
            return stops[-1][1], False
        near = segment.along is not None
        for at, name in stops:
            end: str | None = name
            if self.ways and here != name:
                if near:
                    found = self.environment.next_along(here, name)
                    end = None if found is None else found[1]
                elif name not in self.reachable(here):
                    end = None
                if end is None and self.once(at, f"way from {here}"):
                    neighbours = ", ".join(sorted(self.ways.get(here, ()) if near else self.reachable(here)))
                    self.check.add(
                        at,
                        f"no {'edge' if near else 'way'} from '{here}' to '{name}'{self.shut(here, name, near)}",
                        got=name,
                        allowed=neighbours[:200] or f"nothing can be reached from '{here}'",
                    )
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

    def _lost_before(self, segment: Any) -> bool:
        """Whether a movement off the map comes before this segment in the file."""
        return any(
            item.kind in ("arc", "move") or (item.kind == "drive" and item.distance is not None)
            for item in flat_segments(self.mission.segments)
        )

    def reachable(self, start: str) -> set[str]:
        """Places that ways lead to."""
        found, stack = {start}, [start]
        while stack:
            for name in self.ways.get(stack.pop(), ()):
                if name not in found:
                    found.add(name)
                    stack.append(name)
        return found

    def dock(self, segment: Any, here: str | None, unknown: bool) -> None:
        """A charger at this place, for these batteries."""
        where = segment.where
        if not self.once(where, f"dock at {here} {unknown}") or self.environment is None:
            if self.environment is None and not self.environment_broken and self.once(where, "dock"):
                self.check.add(
                    where, "docking without an environment", allowed="an environment with a place that has a charger"
                )
            return
        if here is None:
            return
        place = self.environment.places.get(here)
        chargers = [name for name, item in self.environment.places.items() if item.charger is not None]
        if place is None:
            return
        if place.charger is None:
            self.check.add(
                where,
                f"no charger at '{here}'",
                got=here,
                allowed=", ".join(chargers) or "no place has a charger",
                key=True,
            )
            return
        fed = place.charger.batteries or tuple(self.robot.batteries if self.robot is not None else ())
        for index, name in enumerate(segment.recharge.batteries):
            self.check.known((*where, "recharge", "batteries", index), name, fed, f"battery of the charger at '{here}'")
        for name in place.charger.batteries if self.robot is not None else ():
            if self.robot is not None and name not in self.robot.batteries:
                self.check.add(
                    where,
                    f"the charger at '{here}' feeds a battery that the robot lacks",
                    got=name,
                    allowed=", ".join(self.robot.batteries),
                    key=True,
                )


def _ways(environment: EnvironmentSpec) -> dict[str, set[str]]:
    ways: dict[str, set[str]] = {name: set() for name in environment.places}
    for _, _, begin, end in environment.open_ways():
        ways.setdefault(begin, set()).add(end)
    return ways
