"""What the segments of a mission ask for: the most specific of what is said of each setting, with its drawn number."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager

import numpy as np

from missionsim.errors import Fault, InputError, MissionsimError
from missionsim.inputs.mission import ActivitySpec, AnchorSpec, MissionSpec
from missionsim.inputs.robot import BehaviourSpec
from missionsim.inputs.segments import DockSegment, RepeatSegment, SegmentSpec
from missionsim.inputs.values import Parameter
from missionsim.plan.legs import Activity, Leg, Limits, Odd, Pace, Recharge, Settings, Trigger, least

MOST_OBSTACLES = 10_000
"""On one leg; where half as many are to be expected, the mission is refused: more than that will never be drawn."""


def failures(probability: float, rng: np.random.Generator) -> int:
    """How often something fails before it succeeds (geometric, by inversion of one uniform number).

    `probability`: of failing, each time, independently; 0 or more, below 1. Raises MissionsimError: where a drawn
    probability is none, or 1: it would never succeed.
    """
    if not 0.0 <= probability < 1.0:
        raise MissionsimError(f"a probability of {probability:g} was drawn; allowed: from 0 to less than 1")
    lot = 1.0 - rng.random()
    return int(math.log(lot) / math.log(probability)) if probability > 0.0 else 0


@contextlib.contextmanager
def told_at(file: str, parameter: Parameter) -> Iterator[None]:
    """Tell what is wrong with a number where it stands."""
    try:
        yield
    except MissionsimError as error:
        raise InputError(Fault(file, parameter.line, 0, str(error), parameter.path)) from error


def stopped_by_obstacles(
    legs: Iterable[Leg], spacing_m: float, stop_s: float, rng: np.random.Generator
) -> tuple[list[Leg], int]:
    """Legs cut where an obstacle makes the robot stop and wait.

    Obstacles arrive as a Poisson process over the distance driven; the robot brakes, stands for an exponentially
    distributed time (the wait does not depend on how long the obstacle has been there) and sets off again. `spacing_m`:
    mean distance between obstacles, above 0; `stop_s`: mean time stood at one. Gives the legs with the stops among
    them, and the number of stops. Raises MissionsimError: where more than half of `MOST_OBSTACLES` are to be expected
    on a leg.
    """
    made: list[Leg] = []
    stops = 0
    for leg in legs:
        if leg.kind not in ("roll", "slide") or leg.distance_m <= 0.0:
            made.append(leg)
            continue
        expected = leg.distance_m / spacing_m if spacing_m > 0.0 else math.inf
        if not expected <= 0.5 * MOST_OBSTACLES:
            raise MissionsimError(
                f"an obstacle every {spacing_m:g} m makes {expected:.3g} of them on a leg of {leg.distance_m:g} m; "
                f"allowed: at most {MOST_OBSTACLES // 2}"
            )
        done, here = 0.0, 0
        while True:
            at = done + rng.exponential(spacing_m)
            if at >= leg.distance_m:
                break
            made.append(_piece(leg, done, at)._replace(place=""))
            made.append(Leg("stand", leg.settings, duration_s=rng.exponential(stop_s)))
            done, here = at, here + 1
        made.append(_piece(leg, done, leg.distance_m) if here else leg)
        stops += here
    return made, stops


def _piece(leg: Leg, from_m: float, to_m: float) -> Leg:
    edge = leg.edge
    if edge is not None:
        scale = (edge.to_m - edge.from_m) / leg.distance_m
        edge = edge._replace(from_m=edge.from_m + from_m * scale, to_m=edge.from_m + to_m * scale)
    return leg._replace(distance_m=to_m - from_m, edge=edge)


EXTRAS = (
    ("temperature", "temp_ambient_c"),
    ("cpu_load", "cpu_load"),
    ("cpu_frequency", "cpu_freq_hz"),
    ("access_point_distance", "access_point_distance_m"),
)


class Asked:
    """Settings, behaviour and speeds of segments, under the control scheme in `scheme`.

    `numbers`: values that differ from the files', by path; arrays where many runs are planned at once.
    """

    def __init__(self, mission: MissionSpec, numbers: Mapping[str, float]) -> None:
        self.mission = mission
        self.robot = mission.robot
        self.environment = environment = mission.environment
        self.numbers = numbers
        self.odd = Odd()
        self.scheme = ""
        body = self.robot.body
        accel = self._robot(body.max_acceleration)
        decel = self._robot(body.max_deceleration)
        self.limits = Limits(
            accel,
            accel if decel is None else decel,
            self.number(body.max_yaw_rate, "robot."),
            self._robot(body.max_yaw_acceleration),
        )
        self._base: dict[int, Settings] = {}
        self._ambient_values = self._ambient()
        self._ambient_surface = (environment.ambient.surface or "") if environment is not None else ""
        self._default_extras = {key: getattr(mission.defaults, key, None) for key, _ in EXTRAS}
        self._tops: dict[tuple[str, bool, float], tuple[float, float, float]] = {}
        self._behaviours_of: dict[str, tuple[tuple[BehaviourSpec | None, str], ...]] = {}

    def number(self, parameter: Parameter, prefix: str = "") -> float:
        """Value of a parameter, drawn or nominal."""
        if self.numbers and parameter.path:
            return self.numbers.get(prefix + parameter.path, parameter.value)
        return parameter.value

    def _robot(self, parameter: Parameter | None) -> float | None:
        return None if parameter is None else self.number(parameter, "robot.")

    def fault(self, segment: SegmentSpec | RepeatSegment, message: str, allowed: str = "") -> InputError:
        """A fault at the line of a segment."""
        return InputError(Fault(str(self.mission.path), segment.line, 0, message, allowed=allowed))

    def settings(self, segment: SegmentSpec) -> Settings:
        """Settings of a segment; the same object however often it is repeated."""
        mission = self.mission
        known = self._base.get(id(segment))
        if known is not None:
            return known
        payload = mission.setting(segment, "payload")
        surface = mission.setting(segment, "surface")
        extra: dict[str, float | str] = dict(self._ambient_values)
        for key, column in EXTRAS:
            given = getattr(segment, key)
            if given is None:
                given = self._default_extras[key]
            if given is not None:
                extra[column] = self.number(given)
        for source in (mission.defaults.conditions, segment.conditions):
            if source:
                extra |= {name: self._condition(value) for name, value in source.items()}
        slope: Parameter | None = getattr(segment, "slope", None)
        made = Settings(
            *mission.equipment(segment),
            0.0 if payload is None else self.number(payload),
            0.0 if slope is None else self.number(slope),
            self._ambient_surface if surface is None else surface,
            tuple(sorted(extra.items())),
        )
        self._base[id(segment)] = made
        return made

    def _condition(self, value: object, prefix: str = "") -> float | str:
        return self.number(value, prefix) if isinstance(value, Parameter) else str(value)

    def _ambient(self) -> dict[str, float | str]:
        environment = self.environment
        if environment is None:
            return {}
        ambient = environment.ambient
        pairs = (("temp_ambient_c", ambient.temperature), ("access_point_distance_m", ambient.access_point_distance))
        known: dict[str, float | str] = {name: self.number(p, "environment.") for name, p in pairs if p is not None}
        return known | {name: self._condition(value, "environment.") for name, value in ambient.conditions.items()}

    def _behaviours(self, scheme: str) -> tuple[tuple[BehaviourSpec | None, str], ...]:
        """Who says how the robot behaves under a scheme, the most specific first."""
        known = self._behaviours_of.get(scheme)
        if known is None:
            mission = self.mission
            of_robot = self.robot.schemes.get(scheme)
            known = self._behaviours_of[scheme] = (
                (mission.behaviour.schemes.get(scheme), ""),
                (mission.behaviour, ""),
                (mission.defaults.behaviour, ""),
                (of_robot.behaviour if of_robot else None, "robot."),
            )
        return known

    def behaviour(self, segment: SegmentSpec, key: str) -> float | None:
        """The number that the behaviour of a segment says of something."""
        given = self.given(segment, key)
        return None if given is None else self.number(*given)

    def given(self, segment: SegmentSpec, key: str) -> tuple[Parameter, str] | None:
        """The parameter of the behaviour of a segment, and the prefix of its path."""
        for source, prefix in ((segment.behaviour, ""), *self._behaviours(self.scheme)):
            given = None if source is None else getattr(source, key)
            if given is not None:
                return given, prefix
        return None

    def pace(self, segment: SegmentSpec, way_m_s: float = math.inf) -> Pace:
        """Speed asked of a segment and what limits it."""
        tracking = self.given(segment, "speed_tracking")
        raised = 1.0 if tracking is None else max(1.0, tracking[0].value)
        robot, scheme, top = self._top(segment.kind == "move", raised)
        given = self.mission.setting(segment, "speed")
        asked = top if given is None else self.number(given)
        if tracking is not None:
            asked = asked * self.number(*tracking)
        self.above_0(asked, segment, "a segment that drives needs a speed above 0")
        return Pace(asked, robot, scheme, way_m_s)

    def _top(self, sideways: bool, raised: float) -> tuple[float, float, float]:
        """Greatest speed of the robot and of the control scheme, raised, and the one driven where none is asked."""
        key = (self.scheme, sideways, raised)
        if key not in self._tops:
            body, scheme = self.robot.body, self.robot.schemes.get(self.scheme)
            robot = self.number(body.max_speed, "robot.")
            given = None if scheme is None else scheme.max_speed
            most = math.inf if given is None else self.number(given, "robot.")
            top = robot
            if sideways and body.max_lateral_speed is not None and body.max_lateral_speed.value > body.max_speed.value:
                top = self.number(body.max_lateral_speed, "robot.")
            self._tops[key] = (top * raised, most * raised, least(robot, most))
        return self._tops[key]

    def above_0(self, number: float, segment: SegmentSpec, message: str) -> None:
        """A fault of the segment where a number is not above 0; of many runs, those in which it is not are odd."""
        if isinstance(number, np.ndarray):
            if not number.min() > 0.0:
                self.odd.mark(~(number > 0.0))
        elif not number > 0.0:
            raise self.fault(segment, message)

    def stretch(self, segment: SegmentSpec) -> float:
        """How many times as long as planned the way of a segment is."""
        given = self.behaviour(segment, "path_stretch")
        return 1.0 if given is None else given

    def instant(self, segment: SegmentSpec) -> bool:
        """Whether its speed is reached at once."""
        return self.mission.setting(segment, "profile") == "constant_speed" or self.limits.accel_m_s2 is None

    def yaw_rate(self, segment: SegmentSpec) -> float:
        """Limit of the yaw rate on a segment."""
        given = self.mission.setting(segment, "yaw_rate")
        return self.limits.yaw_rate_rad_s if given is None else self.number(given)

    def told_at(self, parameter: Parameter, prefix: str = "") -> AbstractContextManager[None]:
        """What is wrong with a number is told where it stands."""
        return told_at(str((self.robot if prefix else self.mission).path), parameter)

    def recharge(self, segment: DockSegment, place: str) -> Recharge:
        """Charging as a dock segment asks for it at a place."""
        environment = self.environment
        charger = None
        if environment is not None and place in environment.places:
            charger = environment.places[place].charger
        if charger is None:
            raise self.fault(
                segment, f"no charger at '{place or 'an unknown place'}'", "a place with a charger, reached before"
            )
        asked = segment.recharge
        batteries = asked.batteries or charger.batteries or tuple(self.robot.batteries)
        offered = self.number(charger.power, "environment.")
        power = {}
        for name, spec in self.robot.batteries.items():
            if name in batteries:
                most = math.inf if spec.max_charge_power is None else self.number(spec.max_charge_power, "robot.")
                power[name] = least(offered, most) * self.number(spec.charge_efficiency, "robot.")
        return Recharge(
            place,
            power,
            tuple(power),
            None if asked.until is None else self.number(asked.until),
            None if asked.duration is None else self.number(asked.duration),
            charger.slots,
            math.inf if segment.if_below is None else self.number(segment.if_below),
        )

    def activity(self, key: int, spec: ActivitySpec) -> Activity:
        """What a component does beside the driving."""
        begin = self._trigger(spec.from_)
        end = self._trigger(spec.until)
        every = None if spec.every is None else self.number(spec.every)
        duration = None if spec.duration is None else self.number(spec.duration)
        place = self.mission.document.place(("activities", key, "every"))
        return Activity(spec.component, spec.units, begin, end, every, duration, key, place)

    def _trigger(self, anchor: AnchorSpec | None) -> Trigger | None:
        if anchor is None:
            return None
        time = None if anchor.time is None else self.number(anchor.time)
        return Trigger(time, anchor.place or "", anchor.segment or "")
