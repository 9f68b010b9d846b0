"""From a mission file to a plan: segments expanded, routes found, behaviour applied, every leg with its numbers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.expressions import Place
from missionsim.inputs.activities import AnchorSpec
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.power import build_power_model
from missionsim.inputs.values import Parameter
from missionsim.plan.chance import failures, stopped_by_obstacles, told_at
from missionsim.plan.draws import Odd, least, remainder, sign
from missionsim.plan.legs import Activity, Gate, Leg, Limits, OnEdge, Plan, Recharge, SegmentInfo, Settings, Trigger
from missionsim.plan.pace import Pace
from missionsim.plan.routes import Way, along, routes_of
from missionsim.plan.steady import steady_power_w
from missionsim.plan.steps import group, slow_components

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_SEGMENTS = 1_000_000
_EXTRAS = (
    ("temperature", "temp_ambient_c"),
    ("cpu_load", "cpu_load"),
    ("cpu_frequency", "cpu_freq_hz"),
    ("access_point_distance", "access_point_distance_m"),
)


def make_plan(
    mission: MissionSpec,
    numbers: Mapping[str, float] | None = None,
    rng: np.random.Generator | None = None,
    rounds: Mapping[int, int] | None = None,
) -> Plan:
    """The plan of a mission.

    Parameters
    ----------
    mission : MissionSpec
        With its robot and environment.
    numbers : mapping, optional
        Values that differ from the files', by path: the mission's own (``segments.0.drive.speed``), and with prefix
        ``robot.`` or ``environment.`` those of the other files.
    rng : numpy.random.Generator, optional
        Draws obstacles, failed relocalisations and inspections that are repeated; without it there are none.
    rounds : mapping of int to int, optional
        How often blocks are driven that are repeated until a time, by their number; without it as often as could be
        if nothing took longer than planned.

    Returns
    -------
    Plan

    Raises
    ------
    missionsim.errors.InputError
        Where the mission cannot be driven: no way, no place, no speed, no charger.

    Notes
    -----
    Behaviour applies here: `path_stretch` multiplies distances, `speed_tracking` speeds, `dwell` adds standing time at
    the end of a segment that moves. The most specific wins, value by value: the segment's own, the mission's for its
    scheme, the mission's, the defaults', the robot's for that scheme.
    """
    return _Builder(mission, numbers or {}, rng, rounds).build()


def plan_runs(mission: MissionSpec, numbers: Mapping[str, NDArray[np.float64]]) -> Plan:
    """The plan of many runs at once, as arrays: what follows from a drawn number is an array of shape (runs,).

    Parameters
    ----------
    mission : MissionSpec
    numbers : mapping
        Drawn values by path (see `make_plan`), arrays of shape (runs,).

    Returns
    -------
    Plan
        With `odd`: the runs whose plan has another shape, to be planned alone with `make_plan`. Nothing is left to
        chance.
    """
    with np.errstate(all="ignore"):  # a run of which no plan can be made is odd
        return _Builder(mission, cast("Mapping[str, float]", numbers), None).build()


def legs_of(
    mission: MissionSpec, segments: Iterable[tuple[str, Any]], numbers: Mapping[str, float] | None = None
) -> Iterator[list[Leg]]:
    """The legs of single segments of a mission, each begun at a place of its own.

    Parameters
    ----------
    mission : MissionSpec
        Gives robot, environment and defaults; its own segments are not used.
    segments : iterable of (str, SegmentSpec)
        Place where the segment begins, and the segment.
    numbers : mapping, optional
        See `make_plan`.
    """
    builder = _Builder(mission, numbers or {}, None)
    for place, segment in segments:
        builder.place, builder.heading = place, None
        before = len(builder.legs)
        builder._segment(segment)
        yield builder.legs[before:]


class _Builder:
    def __init__(
        self,
        mission: MissionSpec,
        numbers: Mapping[str, float],
        rng: np.random.Generator | None,
        rounds: Mapping[int, int] | None = None,
    ) -> None:
        self.rounds = rounds
        self._blocks = 0
        self.mission = mission
        self.robot = mission.robot
        self.numbers = numbers
        self.rng = rng
        self.odd = Odd()
        self.environment = environment = mission.environment
        self.routes = routes_of(mission, numbers)
        self.place = mission.start or ""
        self.heading = None if mission.start_heading is None else self.number(mission.start_heading)
        if self.heading is None and environment is not None and self.place in environment.places:
            given = environment.places[self.place].heading
            self.heading = None if given is None else self.number(given, "environment.")
        body = self.robot.body
        accel = self._robot(body.max_acceleration)
        decel = self._robot(body.max_deceleration)
        self.limits = Limits(
            accel,
            accel if decel is None else decel,
            self.number(body.max_yaw_rate, "robot."),
            self._robot(body.max_yaw_acceleration),
        )
        self.chance: dict[str, int] = {}
        self.legs: list[Leg] = []
        self.segments: list[SegmentInfo] = []
        self._names: dict[str, int] = {}
        self._base: dict[int, Settings] = {}
        self._scheme = ""
        self._routes: list[tuple[str, str, tuple[int, ...]]] = []
        self._ambient_values = self._ambient()
        self._ambient_surface = (environment.ambient.surface or "") if environment is not None else ""
        self._default_extras = {key: getattr(mission.defaults, key, None) for key, _ in _EXTRAS}
        self._tops: dict[tuple[str, bool, float], tuple[float, float, float]] = {}
        self._behaviours_of: dict[str, tuple[tuple[Any, str], ...]] = {}
        self._costs: dict[int, dict[tuple[int, str], float]] = {}

    def number(self, parameter: Parameter, prefix: str = "") -> float:
        """Value of a parameter, drawn or nominal."""
        if self.numbers and parameter.path:
            return self.numbers.get(prefix + parameter.path, parameter.value)
        return parameter.value

    def _robot(self, parameter: Parameter | None) -> float | None:
        return None if parameter is None else self.number(parameter, "robot.")

    def build(self) -> Plan:
        start = self.place
        for segment in self.mission.segments:
            self._segment(segment)
        slow = slow_components(self.robot)

        def breaks(before: Leg, after: Leg) -> bool:
            if after.gate is not None and after.gate.first:
                return True
            known = dict(before.settings.sensors)
            return any(name in slow and name not in known for name, _ in after.settings.sensors)

        steps = group(self.legs, self.limits, breaks if slow or self._blocks else None, self.odd)
        if self.routes is not None and self.routes.drawn:
            self.odd.mark(self.routes.others_shorter(self._routes))
        activities = tuple(self._activity(i, spec) for i, spec in enumerate(self.mission.activities))
        return Plan(
            tuple(self.legs),
            steps,
            tuple(self.segments),
            activities,
            self.limits,
            start,
            tuple(sorted(self.chance.items())),
            tuple(self._routes),
            self.odd.runs,
        )

    def fault(self, segment: Any, message: str, allowed: str = "") -> InputError:
        """A fault at the line of a segment."""
        return InputError(Fault(str(self.mission.path), int(getattr(segment, "line", 0)), 0, message, allowed=allowed))

    def _segment(self, segment: Any) -> None:
        if segment.kind == "repeat":
            if segment.until is not None:
                return self._until(segment)
            for _ in range(segment.times):
                for inner in segment.segments:
                    self._segment(inner)
            return None
        if len(self.segments) >= MOST_SEGMENTS:
            raise self.fault(segment, "too many segments", f"at most {MOST_SEGMENTS}, repeats counted one by one")
        self._name(segment)
        base = self._settings(segment)
        self._scheme = base.scheme
        before = len(self.legs)
        getattr(self, f"_{segment.kind}")(segment, base)
        if len(self.legs) == before:
            self.legs.append(Leg("stand", base))
        if segment.kind in ("drive", "arc", "turn", "move"):
            given = self._behaviour(segment, "dwell")
            dwell = (0.0 if given is None else given) + self._by_chance(segment, before)
            if self.odd.most(dwell != 0.0):
                self.legs.append(Leg("stand", self._still(base), duration_s=dwell))
        self.legs[before] = self.legs[before]._replace(first=True)
        self.legs[-1] = self.legs[-1]._replace(last=True, place=self.legs[-1].place or self.place)

    def _until(self, segment: Any) -> None:
        """Rounds as many as could end by a time if there were nothing but what is planned of them."""
        block, self._blocks = self._blocks, self._blocks + 1
        until = self.number(segment.until)
        asked = None if self.rounds is None else self.rounds.get(block, 0)
        planned, done = 0.0, 0
        while asked is None or done < asked:
            before, segments = len(self.legs), len(self.segments)
            names, routes = dict(self._names), len(self._routes)
            for inner in segment.segments:
                if inner.kind == "repeat" and inner.until is not None:
                    raise self.fault(segment, "a block until a time inside another one", "times: 5 for the inner one")
                self._segment(inner)
            took = sum(p.duration_s for step in group(self.legs[before:], self.limits) for p in step.phases)
            if isinstance(took, np.ndarray) or isinstance(until, np.ndarray):
                raise self.fault(segment, "how many rounds end by a time differs from run to run")
            if not took > 0.0:
                raise self.fault(segment, "a round that takes no time is repeated until a time", "times: 5")
            planned += took
            if asked is None and planned > until:
                if not done:
                    raise self.fault(
                        segment, f"not even one round ends by {until:g} s", f"until: {planned:.0f} s or more"
                    )
                del self.legs[before:], self.segments[segments:], self._routes[routes:]
                self._names = names
                return
            gate = Gate(block, until if asked is None else math.inf, took)
            self.legs[before:] = [leg._replace(gate=gate) for leg in self.legs[before:]]
            self.legs[before] = self.legs[before]._replace(gate=gate._replace(first=True))
            done += 1

    def _by_chance(self, segment: Any, before: int) -> float:
        """Put stops at obstacles into the segment's legs; time [s] of relocalisations that fail at its end."""
        if self.rng is None:
            return 0.0
        spacing = self._given(segment, "obstacle_spacing")
        if spacing is not None:
            stop = self._behaviour(segment, "obstacle_stop") or 0.0
            with self._told_at(*spacing):
                made, stops = stopped_by_obstacles(self.legs[before:], self.number(*spacing), stop, self.rng)
            self.legs[before:] = made
            self._count("obstacles", stops)
        failure = self._given(segment, "relocalisation_failure")
        if failure is None:
            return 0.0
        with self._told_at(*failure):
            failed = failures(self.number(*failure), self.rng)
        self._count("relocalisations_failed", failed)
        return failed * (self._behaviour(segment, "relocalisation_time") or 0.0)

    def _told_at(self, parameter: Parameter, prefix: str = "") -> contextlib.AbstractContextManager[None]:
        return told_at(str((self.robot if prefix else self.mission).path), parameter)

    def _count(self, what: str, times: int) -> None:
        self.chance[what] = self.chance.get(what, 0) + times

    def _name(self, segment: Any) -> None:
        label = segment.name
        if label is None:
            label = segment.kind
            if label == "drive" and segment.distance is None:
                label = f"drive {segment.to or segment.along[-1]}"
        count = self._names.get(label, 0) + 1
        self._names[label] = count
        name = label if count == 1 else f"{label} #{count}"
        self.segments.append(SegmentInfo(name, segment.kind, segment.line, label))

    def _settings(self, segment: Any) -> Settings:
        mission = self.mission
        known = self._base.get(id(segment))
        if known is not None:
            return known._replace(segment=len(self.segments) - 1)
        payload = mission.setting(segment, "payload")
        surface = mission.setting(segment, "surface")
        extra: dict[str, float | str] = dict(self._ambient_values)
        for key, column in _EXTRAS:
            given = getattr(segment, key)
            if given is None:
                given = self._default_extras[key]
            if given is not None:
                extra[column] = self.number(given)
        for source in (mission.defaults.conditions, segment.conditions):
            if source:
                extra |= {name: self._condition(value) for name, value in source.items()}
        slope = segment.slope if segment.kind in ("drive", "arc", "move") else None
        made = Settings(
            len(self.segments) - 1,
            *mission.equipment(segment),
            0.0 if payload is None else self.number(payload),
            0.0 if slope is None else self.number(slope),
            self._ambient_surface if surface is None else surface,
            tuple(sorted(extra.items())),
        )
        self._base[id(segment)] = made
        return made

    def _condition(self, value: Any, prefix: str = "") -> float | str:
        return self.number(value, prefix) if isinstance(value, Parameter) else str(value)

    def _ambient(self) -> dict[str, float | str]:
        environment = self.environment
        if environment is None:
            return {}
        ambient = environment.ambient
        pairs = (("temp_ambient_c", ambient.temperature), ("access_point_distance_m", ambient.access_point_distance))
        known: dict[str, float | str] = {name: self.number(p, "environment.") for name, p in pairs if p is not None}
        return known | {name: self._condition(value, "environment.") for name, value in ambient.conditions.items()}

    def _behaviours(self, scheme: str) -> tuple[tuple[Any, str], ...]:
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

    def _behaviour(self, segment: Any, key: str) -> float | None:
        given = self._given(segment, key)
        return None if given is None else self.number(*given)

    def _given(self, segment: Any, key: str) -> tuple[Parameter, str] | None:
        """The parameter of the behaviour of a segment, and the prefix of its path."""
        for source, prefix in ((segment.behaviour, ""), *self._behaviours(self._scheme)):
            given = None if source is None else getattr(source, key)
            if given is not None:
                return given, prefix
        return None

    def _pace(self, segment: Any, way_m_s: float = math.inf) -> Pace:
        tracking = self._given(segment, "speed_tracking")
        raised = 1.0 if tracking is None else max(1.0, tracking[0].value)
        robot, scheme, top = self._top(segment.kind == "move", raised)
        given = self.mission.setting(segment, "speed")
        asked = top if given is None else self.number(given)
        if tracking is not None:
            asked = asked * self.number(*tracking)
        self._above_0(asked, segment, "a segment that drives needs a speed above 0")
        return Pace(asked, robot, scheme, way_m_s)

    def _top(self, sideways: bool, raised: float) -> tuple[float, float, float]:
        """Greatest speed of the robot and of the control scheme, raised, and the one driven where none is asked."""
        key = (self._scheme, sideways, raised)
        if key not in self._tops:
            body, scheme = self.robot.body, self.robot.schemes.get(self._scheme)
            robot = self.number(body.max_speed, "robot.")
            given = None if scheme is None else scheme.max_speed
            most = math.inf if given is None else self.number(given, "robot.")
            top = robot
            if sideways and body.max_lateral_speed is not None and body.max_lateral_speed.value > body.max_speed.value:
                top = self.number(body.max_lateral_speed, "robot.")
            self._tops[key] = (top * raised, most * raised, least(robot, most))
        return self._tops[key]

    def _above_0(self, number: float, segment: Any, message: str) -> None:
        """A fault of the segment where a number is not above 0; of many runs, those in which it is not are odd."""
        if isinstance(number, np.ndarray):
            if not number.min() > 0.0:
                self.odd.mark(~(number > 0.0))
        elif not number > 0.0:
            raise self.fault(segment, message)

    def _stretch(self, segment: Any) -> float:
        given = self._behaviour(segment, "path_stretch")
        return 1.0 if given is None else given

    def _instant(self, segment: Any) -> bool:
        return self.mission.setting(segment, "profile") == "constant_speed" or self.limits.accel_m_s2 is None

    def _still(self, base: Settings) -> Settings:
        """Settings of standing at the end of a segment that moves."""
        last = self.legs[-1].settings if self.legs and self.legs[-1].settings.segment == base.segment else base
        return last

    def _drive(self, segment: Any, base: Settings) -> None:
        if segment.distance is not None:
            heading = None if segment.heading is None else self.number(segment.heading)
            self._face(segment, base, heading)
            pace = self._pace(segment)
            self.legs.append(
                Leg(
                    "roll",
                    base,
                    self.number(segment.distance) * self._stretch(segment),
                    pace.speed,
                    instant=self._instant(segment),
                    pace=pace,
                )
            )
            self.place = ""
            return
        if self.routes is None:
            raise self.fault(segment, "a drive to a place needs an environment", "environment: FILE, or distance: 50 m")
        if not self.place:
            raise self.fault(segment, "the place from which this drive starts is not known", "start: a place")
        file = str(self.mission.path)
        for stop in segment.along or ():
            if stop != self.place:
                way = self.routes.along(self.place, stop, file)
                self._way(segment, base, way)
                self.place = way.end
        least_of = self.mission.defaults.route
        cost = None if least_of == "length" or segment.to is None else self._cost(segment, base, least_of)
        for stop in (*segment.via, segment.to) if segment.to is not None else ():
            ways = self.routes.route(self.place, stop, file, cost) if stop != self.place else []
            if cost is None:
                self._routes.append((self.place, stop, tuple(way.edge for way in ways)))
            for way in ways:
                self._way(segment, base, way)
            self.place = stop

    def _cost(self, segment: Any, base: Settings, least_of: str) -> Callable[[Way], float]:
        """Seconds, or Wh of all batteries, of each way at steady speed, by the files' values whatever is drawn."""
        key = id(segment)
        if key not in self._costs:
            plain = self if not self.numbers else _Builder(self.mission, {}, None)
            assert plain.routes is not None
            plain._scheme = base.scheme
            settings = base if plain is self else plain._settings(segment)
            ways = [way for leaving in plain.routes.ways.values() for way in leaving]
            heading, before = plain.heading, len(plain.legs)
            ends = []
            for way in ways:
                plain.heading = None
                plain._way(segment, settings, way)
                ends.append(len(plain.legs) - before)
            legs = plain.legs[before:]
            plain.heading = heading
            del plain.legs[before:]
            seconds = np.array([leg.distance_m / leg.speed_m_s for leg in legs])
            model = self.mission.remembered("power model", lambda: build_power_model(self.robot))
            costs = seconds if least_of == "time" else seconds * steady_power_w(self.robot, model, legs) / 3600.0
            sums = np.diff(np.concatenate([[0.0], np.concatenate([[0.0], np.cumsum(costs)])[ends]]))
            self._costs[key] = {(w.edge, w.begin): c for w, c in zip(ways, sums.tolist(), strict=True)}
        table = self._costs[key]
        return lambda way: table[way.edge, way.begin]

    def _way(self, segment: Any, base: Settings, way: Way) -> None:
        self._face(segment, base, way.heading_rad)
        stretch = self._stretch(segment)
        settings = along(base, way, segment.surface)
        pace = self._pace(segment, way.max_speed_m_s)
        instant = self._instant(segment)
        pieces = self._radio(way, settings)
        for i, (share_from, share_to, here) in enumerate(pieces):
            self.legs.append(
                Leg(
                    "roll",
                    here,
                    way.length_m * (share_to - share_from) * stretch,
                    pace.speed,
                    instant=instant,
                    pace=pace,
                    place=way.end if i + 1 == len(pieces) else "",
                    edge=OnEdge(way.begin, way.end, way.edge, way.length_m * share_from, way.length_m * share_to),
                )
            )

    def _radio(self, way: Way, settings: Settings) -> list[tuple[float, float, Settings]]:
        """Pieces of a way with the distance to the nearest access point (its root mean square over the piece)."""
        environment = self.environment
        if environment is None or not environment.access_points or "access_point_distance_m" in way.extra:
            return [(0.0, 1.0, settings)]
        assert self.routes is not None
        points = [
            (self.number(p.x, "environment."), self.number(p.y, "environment."))
            for p in environment.access_points.values()
        ]
        pieces = []
        for low, high, distance in self.routes.away_from(way, points):
            extra = (
                settings.extra
                if distance is None
                else tuple(sorted({**dict(settings.extra), "access_point_distance_m": distance}.items()))
            )
            pieces.append((low, high, settings._replace(extra=extra)))
        return pieces

    def _face(self, segment: Any, base: Settings, heading: float | None) -> None:
        """Turn on the spot towards a heading, where the mission asks for it and headings are known."""
        if heading is None:
            return
        if self.heading is not None and self.mission.defaults.turn_at_places:
            turn = remainder(heading - self.heading)
            if self.odd.most(abs(turn) > 1e-9):
                self._turn_by(segment, base, turn)
        self.heading = heading

    def _turn_by(self, segment: Any, base: Settings, angle: float) -> None:
        given = self.mission.setting(segment, "yaw_rate")
        rate = self.limits.yaw_rate_rad_s if given is None else self.number(given)
        self._above_0(rate, segment, "a turn needs a yaw rate above 0")
        instant = self.mission.setting(segment, "profile") == "constant_speed"
        settings = base._replace(slope_rad=0.0)
        self.legs.append(Leg("turn", settings, angle_rad=angle, yaw_rate_rad_s=rate, instant=instant))

    def _turn(self, segment: Any, base: Settings) -> None:
        angle = self.number(segment.angle)
        self._turn_by(segment, base, angle)
        self.heading = None if self.heading is None else self.heading + angle

    def _arc(self, segment: Any, base: Settings) -> None:
        radius, angle = self.number(segment.radius), self.number(segment.angle)
        self._above_0(radius, segment, "an arc needs a radius above 0")
        given = self.mission.setting(segment, "yaw_rate")
        rate = self.limits.yaw_rate_rad_s if given is None else self.number(given)
        pace = self._pace(segment, rate * radius)
        length = radius * abs(angle) * self._stretch(segment)
        self.legs.append(
            Leg("roll", base, length, pace.speed, sign(angle) / radius, instant=self._instant(segment), pace=pace)
        )
        self.place = ""
        self.heading = None if self.heading is None else self.heading + angle

    def _move(self, segment: Any, base: Settings) -> None:
        pace = self._pace(segment)
        self.legs.append(
            Leg(
                "slide",
                base,
                self.number(segment.distance) * self._stretch(segment),
                pace.speed,
                direction_rad=self.number(segment.direction),
                instant=self._instant(segment),
                pace=pace,
            )
        )
        self.place = ""

    def _inspect(self, segment: Any, base: Settings) -> None:
        times = 1
        if segment.repeat_probability is not None and self.rng is not None:
            with self._told_at(segment.repeat_probability):
                times += failures(self.number(segment.repeat_probability), self.rng)
            self._count("inspections_repeated", times - 1)
        self._stand(base, times * self.number(segment.duration))

    def _wait(self, segment: Any, base: Settings) -> None:
        self._stand(base, self.number(segment.duration))

    def _stand(self, base: Settings, duration_s: float) -> None:
        self.legs.append(Leg("stand", base, duration_s=duration_s, place=self.place))

    def _dock(self, segment: Any, base: Settings) -> None:
        environment = self.environment
        charger = None
        if environment is not None and self.place in environment.places:
            charger = environment.places[self.place].charger
        if charger is None:
            raise self.fault(
                segment, f"no charger at '{self.place or 'an unknown place'}'", "a place with a charger, reached before"
            )
        asked = segment.recharge
        batteries = asked.batteries or charger.batteries or tuple(self.robot.batteries)
        offered = self.number(charger.power, "environment.")
        power = {}
        for name, spec in self.robot.batteries.items():
            if name in batteries:
                most = math.inf if spec.max_charge_power is None else self.number(spec.max_charge_power, "robot.")
                power[name] = least(offered, most) * self.number(spec.charge_efficiency, "robot.")
        recharge = Recharge(
            self.place,
            power,
            tuple(power),
            None if asked.until is None else self.number(asked.until),
            None if asked.duration is None else self.number(asked.duration),
            charger.slots,
            math.inf if segment.if_below is None else self.number(segment.if_below),
        )
        self.legs.append(Leg("dock", base, place=self.place, recharge=recharge))

    def _activity(self, key: int, spec: Any) -> Activity:
        begin = _trigger(self, spec.from_)
        end = _trigger(self, spec.until)
        every = None if spec.every is None else self.number(spec.every)
        duration = None if spec.duration is None else self.number(spec.duration)
        document = self.mission.document
        place = Place() if document is None else document.place(("activities", key, "every"))
        return Activity(spec.component, spec.units, begin, end, every, duration, key, place)


def _trigger(builder: _Builder, anchor: AnchorSpec | None) -> Trigger | None:
    if anchor is None:
        return None
    time = None if anchor.time is None else builder.number(anchor.time)
    return Trigger(time, anchor.place or "", anchor.segment or "")
