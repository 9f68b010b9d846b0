"""From a mission file to a plan: segments expanded, routes found, behaviour applied, every leg with its numbers."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, cast

import numpy as np

from missionsim.inputs import segments as kinds
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array
from missionsim.plan.asked import Asked, failures, stopped_by_obstacles
from missionsim.plan.kinematics import group
from missionsim.plan.legs import (
    Gate,
    Kind,
    Leg,
    OnEdge,
    Pace,
    Plan,
    SegmentInfo,
    Settings,
    closure,
    remainder,
    sign,
    steady_power_w,
)
from missionsim.plan.routes import Way, along, routes_of

Route = tuple[str, str, tuple[int, ...]]


def make_plan(
    mission: MissionSpec,
    numbers: Mapping[str, float] | None = None,
    rng: np.random.Generator | None = None,
    rounds: Mapping[int, int] | None = None,
) -> Plan:
    """The plan of a mission.

    `numbers`: values that differ from the files', by path: the mission's own (``segments.0.drive.speed``), and with
    prefix ``robot.`` or ``environment.`` those of the other files. `rng`: draws obstacles, failed relocalisations and
    inspections that are repeated; without it there are none. `rounds`: how often blocks are driven that are repeated
    until a time, by their number; without it as often as could be if nothing took longer than planned. Raises
    InputError: where the mission cannot be driven: no way, no place, no speed, no charger.

    Behaviour applies here: `path_stretch` multiplies distances, `speed_tracking` speeds, `dwell` adds standing time at
    the end of a segment that moves. The most specific wins, value by value: the segment's own, the mission's for its
    scheme, the mission's, the defaults', the robot's for that scheme.
    """
    return _Builder(mission, numbers or {}, rng, rounds).build()


def plan_runs(mission: MissionSpec, numbers: Mapping[str, Array]) -> Plan:
    """The plan of many runs at once, as arrays: what follows from a drawn number is an array of shape (runs,).

    `numbers`: drawn values by path (see `make_plan`), arrays of shape (runs,). The plan has `odd`: the runs whose plan
    has another shape, to be planned alone with `make_plan`. Nothing is left to chance.
    """
    with np.errstate(all="ignore"):  # a run of which no plan can be made is odd
        return _Builder(mission, cast("Mapping[str, float]", numbers), None).build()


def legs_of(
    mission: MissionSpec, segments: Iterable[tuple[str, kinds.SegmentSpec]], numbers: Mapping[str, float] | None = None
) -> Iterator[list[Leg]]:
    """The legs of single segments of a mission, each begun at a place of its own.

    `mission`: gives robot, environment and defaults; its own segments are not used. `segments`: place where the segment
    begins, and the segment. `numbers`: see `make_plan`.
    """
    builder = _Builder(mission, numbers or {}, None)
    for place, segment in segments:
        builder.place, builder.heading = place, None
        before = len(builder.legs)
        builder._segment(segment)
        yield builder.legs[before:]


class _Builder(Asked):
    def __init__(
        self,
        mission: MissionSpec,
        numbers: Mapping[str, float],
        rng: np.random.Generator | None,
        rounds: Mapping[int, int] | None = None,
    ) -> None:
        super().__init__(mission, numbers)
        self.rounds = rounds
        self._blocks = 0
        self.rng = rng
        self.routes = routes_of(mission, numbers)
        self.place = mission.start or ""
        self.heading = self.maybe(mission.start_heading)
        if self.heading is None and self.environment is not None and self.place in self.environment.places:
            self.heading = self.maybe(self.environment.places[self.place].heading, "environment.")
        self.chance: Counter[str] = Counter()
        self.legs: list[Leg] = []
        self.segments: list[SegmentInfo] = []
        self._names: dict[str, int] = {}
        self._routes: list[Route] = []
        self._made: dict[
            tuple[int, str, float | None], tuple[kinds.SegmentSpec, list[Leg], str, float | None, list[Route]]
        ] = {}
        self._on_way: dict[tuple[int, int, str], Settings] = {}
        self._costs: dict[int, dict[tuple[int, str], float]] = {}

    def build(self) -> Plan:
        start = self.place
        for segment in self.mission.segments:
            self._segment(segment)
        # components that are not on at once: they, or something they require, take time to start
        table = self.robot.components
        starting = {name for name, c in table.items() if c.startup is not None and c.startup.duration.value > 0.0}
        slow = {name for name in table if not starting.isdisjoint(closure(table, [(name, 1)]))} if starting else set()

        def breaks(before: Leg, after: Leg) -> bool:
            if after.gate is not None and after.gate.first:
                return True
            known = dict(before.settings.sensors)
            return any(name in slow and name not in known for name, _ in after.settings.sensors)

        steps = group(self.legs, self.limits, breaks if slow or self._blocks else None, self.odd)
        if self.routes is not None and self.routes.drawn:
            self.odd.mark(self.routes.others_shorter(self._routes))
        activities = tuple(self.activity(i, spec) for i, spec in enumerate(self.mission.activities))
        return Plan(
            legs=tuple(self.legs),
            steps=steps,
            segments=tuple(self.segments),
            activities=activities,
            limits=self.limits,
            start=start,
            chance=tuple(sorted(self.chance.items())),
            routes=tuple(self._routes),
            odd=self.odd.runs,
        )

    def _segment(self, segment: kinds.SegmentSpec | kinds.RepeatSegment) -> None:
        if isinstance(segment, kinds.RepeatSegment):
            if segment.until is not None:
                return self._until(segment, segment.until)
            for inner in itertools.chain.from_iterable(itertools.repeat(segment.segments, segment.least)):
                self._segment(inner)
            return None
        if len(self.segments) >= kinds.MOST_SEGMENTS:
            raise self.fault(segment, "too many segments", f"at most {kinds.MOST_SEGMENTS}, repeats counted one by one")
        label = segment.kind if segment.name is None else segment.name
        if segment.name is None and isinstance(segment, kinds.DriveSegment) and segment.distance is None:
            label = f"drive {segment.to or (segment.along or ('',))[-1]}"
        count = self._names[label] = self._names.get(label, 0) + 1
        name = label if count == 1 else f"{label} #{count}"
        self.segments.append(SegmentInfo(name, segment.kind, segment.line, label))
        index, before, routes = len(self.segments) - 1, len(self.legs), len(self._routes)
        drawn = self.rng is not None or isinstance(self.heading, np.ndarray)
        where = None if drawn else (id(segment), self.place, self.heading)
        if where is not None and where in self._made:  # a round like one before
            _, legs, self.place, self.heading, more = self._made[where]
            self._routes += more
        else:
            legs = self._legs(segment, before)
            if where is not None:  # with the segment, so that its id stays its own
                self._made[where] = segment, legs, self.place, self.heading, self._routes[routes:]
        self.legs[before:] = [leg._replace(segment=index) for leg in legs]

    def _legs(self, segment: kinds.SegmentSpec, before: int) -> list[Leg]:
        """The legs of a segment, those from the builder's number `before` on."""
        base = self.settings(segment)
        self.scheme = base.scheme
        getattr(self, f"_{segment.kind}")(segment, base)
        if len(self.legs) == before:
            self.legs.append(Leg("stand", base))
        if segment.kind in ("drive", "arc", "turn", "move"):
            dwell = self.behaviour(segment, "dwell")
            if self.rng is not None and (spacing := self.given(segment, "obstacle_spacing")) is not None:
                stop = self.behaviour(segment, "obstacle_stop")
                with self.told_at(*spacing):
                    made, stops = stopped_by_obstacles(self.legs[before:], self.number(*spacing), stop, self.rng)
                self.legs[before:] = made
                self.chance["obstacles"] += stops
            if self.rng is not None and (failure := self.given(segment, "relocalisation_failure")) is not None:
                with self.told_at(*failure):
                    failed = failures(self.number(*failure), self.rng)
                self.chance["relocalisations_failed"] += failed
                dwell = dwell + failed * self.behaviour(segment, "relocalisation_time")
            if self.odd.most(dwell != 0.0):
                self.legs.append(Leg("stand", self.legs[-1].settings, duration_s=dwell))
        self.legs[before] = self.legs[before]._replace(first=True)
        self.legs[-1] = self.legs[-1]._replace(last=True, place=self.legs[-1].place or self.place)
        return self.legs[before:]

    def _until(self, segment: kinds.RepeatSegment, time: Parameter) -> None:
        """Rounds as many as could end by a time if there were nothing but what is planned of them."""
        block, self._blocks = self._blocks, self._blocks + 1
        until = self.number(time)
        asked = None if self.rounds is None else self.rounds.get(block, 0)
        planned, done = 0.0, 0
        while asked is None or done < asked:
            before, segments = len(self.legs), len(self.segments)
            names, routes = dict(self._names), len(self._routes)
            for inner in segment.segments:
                if isinstance(inner, kinds.RepeatSegment) and inner.until is not None:
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

    def _drive(self, segment: kinds.DriveSegment, base: Settings) -> None:
        if segment.distance is not None:
            self._face(segment, base, self.maybe(segment.heading))
            self._ahead("roll", segment, base, self.number(segment.distance), self.pace(segment))
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

    def _cost(self, segment: kinds.SegmentSpec, base: Settings, least_of: str) -> Callable[[Way], float]:
        """Seconds, or Wh of all batteries, of each way at steady speed, by the files' values whatever is drawn."""
        key = id(segment)
        if key not in self._costs:
            plain = self if not self.numbers else _Builder(self.mission, {}, None)
            assert plain.routes is not None
            plain.scheme = base.scheme
            settings = base if plain is self else plain.settings(segment)
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
            if least_of == "time":
                costs = seconds
            else:
                costs = seconds * np.sum(list(steady_power_w(self.robot, model, legs).values()), axis=0) / 3600.0
            sums = np.diff(np.concatenate([[0.0], np.concatenate([[0.0], np.cumsum(costs)])[ends]]))
            self._costs[key] = {(w.edge, w.begin): c for w, c in zip(ways, sums.tolist(), strict=True)}
        table = self._costs[key]
        return lambda way: table[way.edge, way.begin]

    def _way(self, segment: kinds.SegmentSpec, base: Settings, way: Way) -> None:
        self._face(segment, base, way.heading_rad)
        pace = self.pace(segment, way.max_speed_m_s)
        key = id(base), way.edge, way.begin
        settings = self._on_way.get(key) or self._on_way.setdefault(key, along(base, way, segment.surface))
        pieces = [(0.0, 1.0, settings)]
        spots = self.environment.access_points.values() if self.environment is not None else ()
        if spots and self.routes is not None and "access_point_distance_m" not in way.extra:
            points = [(self.number(p.x, "environment."), self.number(p.y, "environment.")) for p in spots]
            own = dict(settings.extra)
            pieces = [
                (low, high, settings._replace(extra=tuple(sorted({**own, "access_point_distance_m": m}.items()))))
                for low, high, m in self.routes.away_from(way, points)
            ] or pieces
        for low, high, here in pieces:
            edge = OnEdge(way.begin, way.end, way.edge, way.length_m * low, way.length_m * high)
            # other ways have the distance to an access point of this one (assumed)
            near = {name: metres for name, metres in here.extra if spots and name == "access_point_distance_m"}
            beside = base._replace(extra=tuple(sorted({**dict(base.extra), **near}.items()))) if near else base
            self._ahead("roll", segment, here, way.length_m * (high - low), pace, edge=edge, beside=beside)
        self.legs[-1] = self.legs[-1]._replace(place=way.end)

    def _ahead(
        self, kind: Kind, segment: kinds.SegmentSpec, base: Settings, metres: float, pace: Pace, **more: Any
    ) -> None:
        """A leg that is driven, as much longer as the behaviour says."""
        metres = metres * self.behaviour(segment, "path_stretch", 1.0)
        instant = self.mission.setting(segment, "profile") == "constant_speed" or self.limits.accel_m_s2 is None
        self.legs.append(Leg(kind, base, metres, pace.speed, instant=instant, pace=pace, **more))

    def _face(self, segment: kinds.SegmentSpec, base: Settings, heading: float | None) -> None:
        """Turn on the spot towards a heading, where the mission asks for it and headings are known."""
        if heading is None:
            return
        if self.heading is not None and self.mission.defaults.turn_at_places:
            turn = remainder(heading - self.heading)
            if self.odd.most(abs(turn) > 1e-9):
                self._turn_by(segment, base, turn)
        self.heading = heading

    def _turn_by(self, segment: kinds.SegmentSpec, base: Settings, angle: float) -> None:
        rate = self.yaw_rate(segment)
        self.above_0(rate, segment, "a turn needs a yaw rate above 0")
        instant = self.mission.setting(segment, "profile") == "constant_speed"
        settings = base._replace(slope_rad=0.0)
        self.legs.append(Leg("turn", settings, angle_rad=angle, yaw_rate_rad_s=rate, instant=instant))

    def _turn(self, segment: kinds.TurnSegment, base: Settings) -> None:
        angle = self.number(segment.angle)
        self._turn_by(segment, base, angle)
        self.heading = None if self.heading is None else self.heading + angle

    def _arc(self, segment: kinds.ArcSegment, base: Settings) -> None:
        radius, angle = self.number(segment.radius), self.number(segment.angle)
        self.above_0(radius, segment, "an arc needs a radius above 0")
        pace = self.pace(segment, self.yaw_rate(segment) * radius)
        self._ahead("roll", segment, base, radius * abs(angle), pace, curvature_1_m=sign(angle) / radius)
        self.place = ""
        self.heading = None if self.heading is None else self.heading + angle

    def _move(self, segment: kinds.MoveSegment, base: Settings) -> None:
        direction = self.number(segment.direction)
        body, most = self.robot.body, math.inf
        if body.max_lateral_speed is not None:  # a speed that is not the segment's own is cut to it
            limits = self.number(body.max_speed, "robot."), self.number(body.max_lateral_speed, "robot.")
            most = kinds.fastest(direction, *limits)
        pace = self.pace(segment, most)
        self._ahead("slide", segment, base, self.number(segment.distance), pace, direction_rad=direction)
        self.place = ""

    def _inspect(self, segment: kinds.InspectSegment, base: Settings) -> None:
        times = 1
        if segment.repeat_probability is not None and self.rng is not None:
            with self.told_at(segment.repeat_probability):
                times += failures(self.number(segment.repeat_probability), self.rng)
            self.chance["inspections_repeated"] += times - 1
        self._wait(segment, base, times)

    def _wait(self, segment: kinds.InspectSegment | kinds.WaitSegment, base: Settings, times: int = 1) -> None:
        duration_s = times * self.number(segment.duration)
        self.legs.append(Leg("stand", base, duration_s=duration_s, place=self.place))

    def _dock(self, segment: kinds.DockSegment, base: Settings) -> None:
        self.legs.append(Leg("dock", base, place=self.place, recharge=self.recharge(segment, self.place)))
