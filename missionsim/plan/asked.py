"""What the segments of a mission ask for: the most specific of what is said of each setting, with its drawn number."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from missionsim.errors import Fault, InputError, MissionsimError
from missionsim.inputs.mission import ActivitySpec, MissionSpec
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.segments import DockSegment, RepeatSegment, SegmentSpec
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

    def piece(leg: Leg, from_m: float, to_m: float) -> Leg:
        edge = leg.edge
        if edge is not None:
            scale = (edge.to_m - edge.from_m) / leg.distance_m
            edge = edge._replace(from_m=edge.from_m + from_m * scale, to_m=edge.from_m + to_m * scale)
        return leg._replace(distance_m=to_m - from_m, edge=edge)

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
            made.append(piece(leg, done, at)._replace(place=""))
            made.append(Leg("stand", leg.settings, duration_s=rng.exponential(stop_s)))
            done, here = at, here + 1
        made.append(piece(leg, done, leg.distance_m) if here else leg)
        stops += here
    return made, stops


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
        accel, decel = (self.maybe(p, "robot.") for p in (body.max_acceleration, body.max_deceleration))
        turning = self.number(body.max_yaw_rate, "robot."), self.maybe(body.max_yaw_acceleration, "robot.")
        self.limits = Limits(accel, accel if decel is None else decel, *turning)
        self._base: dict[int, Settings] = {}
        self._everywhere: dict[str, float | str] = {}
        self._surface = ""
        if environment is not None:
            ambient = environment.ambient
            self._surface = ambient.surface or ""
            for key, column in EXTRAS:
                given: Parameter | None = getattr(ambient, key, None)
                if given is not None:
                    self._everywhere[column] = self.number(given, "environment.")
            self._everywhere |= {name: self.condition(v, "environment.") for name, v in ambient.conditions.items()}

    def number(self, parameter: Parameter, prefix: str = "") -> float:
        """Value of a parameter, drawn or nominal."""
        if self.numbers and parameter.path:
            return self.numbers.get(prefix + parameter.path, parameter.value)
        return parameter.value

    def maybe(self, parameter: Parameter | None, prefix: str = "") -> float | None:
        """Value of a parameter that may be left out."""
        return None if parameter is None else self.number(parameter, prefix)

    def condition(self, value: Parameter | str, prefix: str = "") -> float | str:
        """Value of a covariate that may be a word."""
        return self.number(value, prefix) if isinstance(value, Parameter) else value

    def fault(self, segment: SegmentSpec | RepeatSegment, message: str, allowed: str = "") -> InputError:
        """A fault at the line of a segment."""
        return InputError(Fault(str(self.mission.path), segment.line, 0, message, allowed=allowed))

    def settings(self, segment: SegmentSpec) -> Settings:
        """Settings of a segment; the same object however often it is repeated."""
        mission = self.mission
        known = self._base.get(id(segment))
        if known is not None:
            return known
        payload, surface = mission.setting(segment, "payload"), mission.setting(segment, "surface")
        slope: Parameter | None = getattr(segment, "slope", None)
        extra = dict(self._everywhere)
        for key, column in EXTRAS:
            own: Parameter | None = getattr(segment, key)
            given: Parameter | None = getattr(mission.defaults, key, None) if own is None else own
            if given is not None:
                extra[column] = self.number(given)
        for source in (mission.defaults.conditions, segment.conditions):
            extra |= {name: self.condition(value) for name, value in source.items()}
        made = self._base[id(segment)] = Settings(
            *mission.equipment(segment),
            0.0 if payload is None else self.number(payload),
            0.0 if slope is None else self.number(slope),
            self._surface if surface is None else surface,
            tuple(sorted(extra.items())),
        )
        return made

    def behaviour(self, segment: SegmentSpec, key: str, unsaid: float = 0.0) -> float:
        """The number that the behaviour of a segment says of something."""
        given = self.given(segment, key)
        return unsaid if given is None else self.number(*given)

    def given(self, segment: SegmentSpec, key: str) -> tuple[Parameter, str] | None:
        """The parameter of the behaviour of a segment, and the prefix of its path: the most specific of those given."""
        mission, of_robot = self.mission, self.robot.schemes.get(self.scheme)
        for source, prefix in (
            (segment.behaviour, ""),
            (mission.behaviour.schemes.get(self.scheme), ""),
            (mission.behaviour, ""),
            (mission.defaults.behaviour, ""),
            (None if of_robot is None else of_robot.behaviour, "robot."),
        ):
            given: Parameter | None = getattr(source, key, None)
            if given is not None:
                return given, prefix
        return None

    def pace(self, segment: SegmentSpec, way_m_s: float = math.inf) -> Pace:
        """Speed asked of a segment and what limits it."""
        body, scheme = self.robot.body, self.robot.schemes.get(self.scheme)
        tracking = self.given(segment, "speed_tracking")
        raised = 1.0 if tracking is None else max(1.0, tracking[0].value)
        top = self.number(body.max_speed, "robot.")
        most = self.maybe(None if scheme is None else scheme.max_speed, "robot.")
        most = math.inf if most is None else most
        given = self.mission.setting(segment, "speed")
        asked = least(top, most) if given is None else self.number(given)
        if tracking is not None:
            asked = asked * self.number(*tracking)
        self.above_0(asked, segment, "a segment that drives needs a speed above 0")
        sideways = body.max_lateral_speed
        if segment.kind == "move" and sideways is not None and sideways.value > body.max_speed.value:
            top = self.number(sideways, "robot.")
        return Pace(asked, top * raised, most * raised, way_m_s)

    def above_0(self, number: float, segment: SegmentSpec, message: str) -> None:
        """A fault of the segment where a number is not above 0; of many runs, those in which it is not are odd."""
        if isinstance(number, np.ndarray):
            if not number.min() > 0.0:
                self.odd.mark(~(number > 0.0))
        elif not number > 0.0:
            raise self.fault(segment, message)

    def yaw_rate(self, segment: SegmentSpec) -> float:
        """Limit of the yaw rate on a segment."""
        given = self.mission.setting(segment, "yaw_rate")
        return self.limits.yaw_rate_rad_s if given is None else self.number(given)

    @contextlib.contextmanager
    def told_at(self, parameter: Parameter, prefix: str = "") -> Iterator[None]:
        """What is wrong with a number is told where it stands."""
        try:
            yield
        except MissionsimError as error:
            file = str((self.robot if prefix else self.mission).path)
            raise InputError(Fault(file, parameter.line, 0, str(error), parameter.path)) from error

    def recharge(self, segment: DockSegment, place: str) -> Recharge:
        """Charging as a dock segment asks for it at a place."""
        known = {} if self.environment is None else self.environment.places
        charger = known[place].charger if place in known else None
        if charger is None:
            message = f"no charger at '{place or 'an unknown place'}'"
            raise self.fault(segment, message, "a place with a charger, reached before")
        asked = segment.recharge
        batteries = asked.batteries or charger.batteries or tuple(self.robot.batteries)
        offered = self.number(charger.power, "environment.")
        power = {}
        for name, spec in self.robot.batteries.items():
            if name in batteries:
                most = self.maybe(spec.max_charge_power, "robot.")
                taken = least(offered, math.inf if most is None else most)
                power[name] = taken * self.number(spec.charge_efficiency, "robot.")
        below = self.maybe(segment.if_below)
        times = self.maybe(asked.until), self.maybe(asked.duration)
        return Recharge(place, power, tuple(power), *times, charger.slots, math.inf if below is None else below)

    def activity(self, key: int, spec: ActivitySpec) -> Activity:
        """What a component does beside the driving."""
        begin, end = (
            None if moment is None else Trigger(self.maybe(moment.time), moment.place or "", moment.segment or "")
            for moment in (spec.from_, spec.until)
        )
        place = self.mission.document.place(("activities", key, "every"))
        bursts = self.maybe(spec.every), self.maybe(spec.duration)
        return Activity(spec.component, spec.units, begin, end, *bursts, key, place)
