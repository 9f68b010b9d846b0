"""Components as SimPy processes (off, starting, on, what they require first), and the activities that switch them."""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import simpy

from missionsim.engine.recorder import Recorder
from missionsim.errors import InputError
from missionsim.plan.legs import Activity, Plan, Trigger, closure

LATE = simpy.events.EventPriority(2)
"""Priority after every normal event of the same instant: a component that one asks off and another on stays on,
whatever the order in which they ask."""


@dataclass(frozen=True, slots=True)
class ComponentInfo:
    """What the engine must know of a component."""

    name: str
    units: int = 1
    """How many there are."""
    always_on: bool = False
    requires: tuple[str, ...] = ()
    """Components that must be on before."""
    startup_s: float = 0.0
    """Time between switching on and being on; the first unit pays it."""


class Switchboard:
    """All components of a robot, who needs how many units of them, and how many are on.

    `infos`: in the order of the recorder's columns.
    """

    def __init__(self, env: simpy.Environment, recorder: Recorder, infos: Iterable[ComponentInfo]) -> None:
        self._env = env
        self._recorder = recorder
        self.infos = {info.name: info for info in infos}
        self._index = {name: index for index, name in enumerate(self.infos)}
        self._on = dict.fromkeys(self.infos, 0)
        self._starting: set[str] = set()
        self._coming: dict[str, simpy.Event] = {}
        self._held: dict[Hashable, Mapping[str, int]] = {}
        self._closures: dict[tuple[tuple[str, int], ...], dict[str, int]] = {(): {}}
        self._asked: set[str] = set()
        self._slow = any(info.startup_s > 0.0 for info in self.infos.values())
        always = {info.name: info.units for info in self.infos.values() if info.always_on}
        if always:
            self.hold("always on", tuple(always.items()))

    def closure(self, sensors: tuple[tuple[str, int], ...]) -> dict[str, int]:
        """Components with everything that they require; see `missionsim.plan.legs.closure`."""
        known = self._closures.get(sensors)
        if known is None:
            known = self._closures[sensors] = closure(self.infos, sensors)
        return known

    def hold(self, holder: Hashable, sensors: tuple[tuple[str, int], ...]) -> None:
        """From now on `holder` needs exactly these components (and what they require); () releases all."""
        wanted = self.closure(sensors)
        before = self._held.get(holder, {})
        if wanted is before:
            return
        self._held[holder] = wanted
        changed = {name for name in before.keys() | wanted.keys() if before.get(name) != wanted.get(name)}
        if changed and not self._asked:  # what is asked for by then is switched after all else of this instant
            late = simpy.Event(self._env)
            late._ok, late._value = True, None
            late.callbacks.append(self._switch_asked)
            self._env.schedule(late, priority=LATE)
        self._asked |= changed

    def waiting_for(self, sensors: tuple[tuple[str, int], ...]) -> list[simpy.Event]:
        """Events of those components, required ones included, that take time to come on; empty where none."""
        if not self._slow:
            return []
        off = [name for name in self.closure(sensors) if not self._on[name]]
        slow = any(self.infos[name].startup_s > 0.0 for name in off)
        return [self._coming.setdefault(name, self._env.event()) for name in off] if slow else []

    def _lacking(self, name: str) -> list[str]:
        """What a component requires and is not on."""
        return [required for required in self.infos[name].requires if not self._on[required]]

    def _wanted(self, name: str) -> int:
        """Units that the most demanding of those who need it asks for."""
        return max([held.get(name, 0) for held in self._held.values()])

    def _switch_asked(self, _: simpy.Event) -> None:
        """Have components become what is wanted: at once, or after what they require and their start-up."""
        asked, self._asked = sorted(self._asked, key=self._index.__getitem__), set()
        first = len(asked)
        for i, name in enumerate(asked):
            if i < first and self._lacking(name):
                asked.append(name)  # last: what it requires has come on by then, or takes its time
                continue
            wanted, on = self._wanted(name), self._on[name]
            if name in self._starting or wanted == on:
                continue
            if wanted and not on and (self.infos[name].startup_s > 0.0 or self._lacking(name)):
                self._starting.add(name)
                self._env.process(self._start(name))
            else:
                self._set(name, wanted)

    def _set(self, name: str, units: int) -> None:
        self._recorder.component(self._index[name], units, 0)
        self._on[name] = units
        if units and name in self._coming:
            self._coming.pop(name).succeed()

    def _start(self, name: str) -> Generator[simpy.Event, Any, None]:
        for required in self._lacking(name):
            if not self._on[required]:
                yield self._coming.setdefault(required, self._env.event())
        startup_s = self.infos[name].startup_s
        if startup_s > 0.0 and (wanted := self._wanted(name)):
            self._recorder.component(self._index[name], 0, wanted)
            yield self._env.timeout(startup_s)
        self._starting.discard(name)
        self._set(name, self._wanted(name))


FOREVER_S = 1e9
MOST_BURSTS = 500_000
"""Bursts of all activities of one execution; more is a period or a duration with a wrong unit."""


class Activities:
    """The activities of a plan as processes, which wait for places and segments that `fire` tells.

    Raises InputError: for bursts beyond `MOST_BURSTS` by the times of the plan. What the plan does not know (charging
    until a level, waiting for a component) only makes a mission longer.
    """

    def __init__(self, env: simpy.Environment, board: Switchboard, plan: Plan) -> None:
        self._env, self._board = env, board
        self._events: dict[tuple[str, str], simpy.Event] = {}
        self._bursts_done = 0
        bursting = [activity for activity in plan.activities if activity.every_s]
        if bursting:
            end_s, times = _planned(plan)
            counted = [(_seconds(one, end_s, times) / (one.every_s or end_s), one) for one in bursting]
            if sum(count for count, _ in counted) > MOST_BURSTS:
                raise _too_many(max(counted, key=lambda item: item[0])[1], end_s)
        for activity in plan.activities:
            env.process(self._run(activity))

    def fire(self, kind: str, name: str) -> None:
        """A ``place`` is reached, or a segment's ``begin`` or ``end``, now."""
        if self._events and (event := self._events.pop((kind, name), None)) is not None:
            event.succeed()

    def _run(self, activity: Activity) -> Generator[simpy.Event, Any, None]:
        env, hold, on = self._env, self._board.hold, ((activity.component, activity.units),)

        def reached(trigger: Trigger, edge: str) -> simpy.Event:
            if trigger.time_s is not None:
                return env.timeout(max(0.0, trigger.time_s - env.now))
            return self._events.setdefault(_key(trigger, edge), env.event())

        while True:
            if activity.begin is not None:
                yield reached(activity.begin, "begin")
            stop = None if activity.end is None else reached(activity.end, "end")
            if activity.every_s is not None:
                yield from self._bursts(activity, on, stop)
            else:
                hold(activity.key, on)
                ends = [] if stop is None else [stop]
                if activity.duration_s is not None:
                    ends.append(env.timeout(activity.duration_s))
                yield env.any_of(ends) if ends else env.event()
                hold(activity.key, ())
            if activity.begin is None or activity.begin.time_s is not None:
                return

    def _bursts(
        self, activity: Activity, on: tuple[tuple[str, int], ...], stop: simpy.Event | None
    ) -> Generator[simpy.Event, Any, None]:
        env, hold, key = self._env, self._board.hold, activity.key
        every, length = activity.every_s or FOREVER_S, activity.duration_s or 0.0
        began, count = env.now, 0
        if stop is not None:
            process = env.active_process
            if stop.callbacks is None or process is None:
                return
            stop.callbacks.append(lambda _: process.interrupt())
        try:
            while True:
                self._bursts_done += 1
                if self._bursts_done > MOST_BURSTS:
                    raise _too_many(activity, env.now)
                hold(key, on)
                if length < every:
                    yield env.timeout(length)
                    hold(key, ())
                count += 1
                yield env.timeout(max(0.0, began + count * every - env.now))
        except simpy.Interrupt:
            hold(key, ())


def _too_many(activity: Activity, seconds: float) -> InputError:
    told = (
        f"the activity of '{activity.component}' every {activity.every_s:g} s has too many bursts in a mission of "
        f"{seconds:.4g} s and more"
    )
    allowed = "a longer period, or a shorter mission (a slow speed, a long way or wait?)"
    return InputError(activity.place.fault(told, got=f"more than {MOST_BURSTS} bursts in all", allowed=allowed))


def _key(trigger: Trigger, edge: str) -> tuple[str, str]:
    return ("place", trigger.place) if trigger.place else (edge, trigger.segment)


def _planned(plan: Plan) -> tuple[float, dict[tuple[str, str], list[float]]]:
    """When the plan ends [s], and when it comes to its places and segments."""
    now = 0.0
    times: dict[tuple[str, str], list[float]] = {("place", plan.start): [0.0]} if plan.start else {}
    for step in plan.steps:
        for i, phase in enumerate(step.phases):
            leg = plan.legs[phase.leg]
            label = plan.segments[leg.segment].label
            if leg.first and (i == 0 or step.phases[i - 1].leg != phase.leg):
                times.setdefault(("begin", label), []).append(now)
            now += phase.duration_s
            if i + 1 == len(step.phases) or step.phases[i + 1].leg != phase.leg:
                if leg.place and leg.kind == "roll":
                    times.setdefault(("place", leg.place), []).append(now)
                if leg.last:
                    times.setdefault(("end", label), []).append(now)
    return now, times


def _seconds(activity: Activity, end_s: float, times: dict[tuple[str, str], list[float]]) -> float:
    """Planned time of an activity's first bursts [s]; 0 where the plan never comes to their beginning."""

    def first(trigger: Trigger | None, edge: str, after_s: float, default: float) -> float:
        if trigger is None:
            return default
        if trigger.time_s is not None:
            return trigger.time_s
        return next((time for time in times.get(_key(trigger, edge), ()) if time >= after_s), end_s)

    begin = first(activity.begin, "begin", 0.0, 0.0)
    return max(0.0, min(first(activity.end, "end", begin, end_s), end_s) - begin)
