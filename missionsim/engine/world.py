"""One execution of a plan as SimPy processes: a driver, the components, the activities beside it, and alarms."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import Any, cast

import simpy

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import CHARGING, HELD, Battery
from missionsim.engine.bursts import refuse_bursts, too_many_bursts
from missionsim.engine.components import ComponentInfo, Switchboard
from missionsim.engine.meter import Evaluating, Meter
from missionsim.engine.outcome import Alarm
from missionsim.engine.recorder import Recorder
from missionsim.plan.legs import Activity, Leg, Phase, Plan, Recharge, SegmentInfo, Step, Trigger

Detour = Callable[[Leg, float, float], tuple[list[Leg], tuple[Step, ...]] | None]
"""``(leg, metres done on it, metres to brake) -> legs and steps home``, or None where there is no way."""

FOREVER_S = 1e9
SPAN_S, LONGEST_LOOK_S = 3600.0, 1e7
"""How far a charger looks ahead at first, and at most."""
LONGEST_CHARGE_S = 30 * 86400.0
"""A charge level that is not reached in this time is not reached at all."""
MOST_BURSTS = 500_000
"""Bursts of all activities of one execution; more is a period or a duration with a wrong unit."""


class ChargerTooWeak(Exception):
    """The asked charge level cannot be reached."""


class Signals:
    """Places reached and segments begun or ended, as events that processes may wait for."""

    def __init__(self, env: simpy.Environment) -> None:
        self._env = env
        self._events: dict[tuple[str, str], simpy.Event] = {}

    def wait(self, kind: str, name: str) -> simpy.Event:
        """The next time that this happens."""
        return self._events.setdefault((kind, name), self._env.event())

    def fire(self, kind: str, name: str) -> None:
        """It happens now."""
        event = self._events.pop((kind, name), None)
        if event is not None:
            event.succeed()


class World:
    """Everything that takes part in one execution.

    Parameters
    ----------
    plan : Plan
    model : PowerModel
    batteries : mapping of str to Battery
    components : sequence of ComponentInfo
    alarms : sequence of Alarm
        Instants, found by an earlier execution, at which a battery interrupts this one.
    detour : callable, optional
        Way home for alarms of kind ``reserve``.
    values : mapping, optional
        Parameters that differ from the model's.
    """

    def __init__(
        self,
        plan: Plan,
        model: PowerModel,
        batteries: Mapping[str, Battery],
        components: Sequence[ComponentInfo],
        *,
        alarms: Sequence[Alarm] = (),
        detour: Detour | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> None:
        self.env = env = simpy.Environment()
        self.plan = plan
        self.legs: list[Leg] = list(plan.legs)
        self.segments: list[SegmentInfo] = list(plan.segments)
        self.recorder = Recorder(env, [info.name for info in components], list(batteries))
        self.board = Switchboard(env, self.recorder, components)
        self.meter = Meter(model, self.recorder, self.legs, batteries, values, self.segments)
        self.signals = Signals(env)
        self.docks: dict[str, simpy.Resource] = {}
        self.completed = False
        self.begun = 0
        self.interrupted: Alarm | None = None
        self.reason = ""
        self._bursts_done = 0
        self._halt = env.event()
        self._ahead_s: float | None = None
        self._answered = env.event()
        self.ends_s: dict[int, float] = {}
        self._detour = detour
        self._batteries = batteries
        self._phases: tuple[Phase, ...] = ()
        if any(activity.every_s is not None for activity in plan.activities):
            refuse_bursts(plan, MOST_BURSTS)
        for activity in plan.activities:
            env.process(self._activity(activity))
        self.driver = env.process(self._drive())
        if alarms:
            env.process(self._alarms(alarms))

    def run(self) -> Evaluating[None]:
        """Execute until the driver has finished, and evaluate everything."""
        while True:
            self.env.run(until=self._halt)
            if self._ahead_s is None:
                break
            yield from self.meter.settle(self._ahead_s)
            self._ahead_s, self._halt = None, self.env.event()
            self._at_once(self._answered)
        self.recorder.close()
        yield from self.meter.settle()

    def _know(self, ahead_s: float) -> simpy.Event:
        """Have the meter evaluate all until now, and what the next seconds would take were nothing to change."""
        self._ahead_s, self._answered = ahead_s, self.env.event()
        self._at_once(self._halt)
        return self._answered

    def _at_once(self, event: simpy.Event) -> None:
        """Let an event happen before all others of this instant."""
        event._ok, event._value = True, None
        self.env.schedule(event, priority=simpy.events.URGENT)

    def _drive(self) -> Generator[simpy.Event, Any, None]:
        if self.plan.start:
            self.signals.fire("place", self.plan.start)
        steps: Iterable[Step] = self.plan.steps
        home = False
        while True:
            try:
                yield from self._execute(steps)
                self.completed = not home and not self.reason
                break
            except ChargerTooWeak as problem:
                self.reason = str(problem)
                self.recorder.rest(self.recorder.leg)
                break
            except simpy.Interrupt as interrupt:
                alarm = cast(Alarm, interrupt.cause)
                self.interrupted = self.interrupted or alarm
                self.reason = f"battery '{alarm.battery}' {'empty' if alarm.kind == 'empty' else 'at its reserve'}"
                way = self._way_home() if alarm.kind == "reserve" and not home else None
                if way is None:
                    self.recorder.close()
                    break
                steps, home = way, True
        self._at_once(self._halt)

    def _execute(self, steps: Iterable[Step]) -> Generator[simpy.Event, Any, None]:
        env, recorder, legs, board = self.env, self.recorder, self.legs, self.board
        signals = self.signals
        for step in steps:
            self._phases = phases = step.phases
            current = -1
            for i, phase in enumerate(phases):
                leg = legs[phase.leg]
                if phase.leg != current:
                    current = phase.leg
                    if leg.first:
                        if leg.settings.segment < len(self.plan.segments):
                            self.begun = leg.settings.segment + 1
                        signals.fire("begin", self.segments[leg.settings.segment].label)
                    sensors = leg.settings.sensors
                    board.hold("segment", sensors)
                    if i == 0 and (waits := board.waiting_for(sensors)):
                        recorder.rest(current)
                        yield env.all_of(waits)
                recorder.move(current, phase)
                if leg.recharge is not None:
                    yield from self._recharge(leg.recharge)
                elif phase.duration_s > 0.0:
                    yield env.timeout(phase.duration_s)
                if i + 1 == len(phases) or phases[i + 1].leg != current:
                    if leg.place and leg.kind == "roll":
                        signals.fire("place", leg.place)
                    if leg.last:
                        signals.fire("end", self.segments[leg.settings.segment].label)
                        self.ends_s[leg.settings.segment] = env.now
            recorder.rest(current)

    def _way_home(self) -> tuple[Step, ...] | None:
        recorder = self.recorder
        phase, leg = recorder.phase, self.legs[recorder.leg]
        done = _length(phase, recorder.phase_elapsed_s) if phase.moving else 0.0
        for earlier in self._phases:
            if earlier is phase:
                break
            if earlier.leg == phase.leg:
                done += _length(earlier, earlier.duration_s)
        recorder.close()
        speed = abs(phase.speed_m_s + phase.accel_m_s2 * recorder.phase_elapsed_s)
        decel = None if leg.instant else self.plan.limits.decel_m_s2
        braking_s = speed / decel if phase.moving and leg.kind == "roll" and decel else 0.0
        found = self._detour(leg, done, 0.5 * speed * braking_s) if self._detour else None
        if found is None:
            recorder.rest(recorder.leg)
            return None
        way, steps = found
        base = len(self.legs)
        self.segments.append(SegmentInfo("return to dock", "return"))
        self.legs.extend(way)
        moved = tuple(Step(step.kind, tuple(p._replace(leg=p.leg + base) for p in step.phases)) for step in steps)
        if braking_s > 0.0 and decel:
            at = recorder.leg
            brake = Phase(
                braking_s,
                at,
                speed,
                -decel,
                yaw_rad_s=speed * leg.curvature_1_m,
                yaw_rad_s2=-decel * leg.curvature_1_m,
                moving=True,
            )
            self.legs.append(_plain(leg))
            return (Step("roll", (brake._replace(leg=len(self.legs) - 1),)), *moved)
        recorder.rest(recorder.leg)
        return moved

    def _alarms(self, alarms: Sequence[Alarm]) -> Generator[simpy.Event, Any, None]:
        for alarm in alarms:
            yield self.env.timeout(max(0.0, alarm.time_s - self.env.now))
            if not self.driver.is_alive:
                return
            self.driver.interrupt(alarm)

    def _activity(self, activity: Activity) -> Generator[simpy.Event, Any, None]:
        env, board = self.env, self.board
        on = ((activity.component, activity.units),)
        repeats = activity.begin is not None and activity.begin.time_s is None
        while True:
            if activity.begin is not None:
                yield self._trigger(activity.begin, "begin")
            if activity.every_s is not None and activity.end is None:
                yield from self._endless_bursts(activity, on)
            stop = self._trigger(activity.end, "end") if activity.end is not None else env.event()
            if activity.every_s is None:
                board.hold(activity.key, on)
                yield stop if activity.duration_s is None else stop | env.timeout(activity.duration_s)
                board.hold(activity.key, ())
            else:
                yield from self._bursts(activity, on, stop)
            if not repeats:
                return

    def _bursts(
        self, activity: Activity, on: tuple[tuple[str, int], ...], stop: simpy.Event
    ) -> Generator[simpy.Event, Any, None]:
        env, board = self.env, self.board
        every, length = activity.every_s or FOREVER_S, activity.duration_s or 0.0
        began, count = env.now, 0
        while not stop.processed:
            self._count_burst(activity)
            board.hold(activity.key, on)
            yield stop | env.timeout(min(length, every))
            if length < every or stop.processed:
                board.hold(activity.key, ())
            count += 1
            if not stop.processed:
                yield stop | env.timeout(max(0.0, began + count * every - env.now))
        board.hold(activity.key, ())

    def _endless_bursts(self, activity: Activity, on: tuple[tuple[str, int], ...]) -> Generator[simpy.Event, Any, None]:
        """Bursts until the mission ends, without anything else to wait for."""
        env, hold, key = self.env, self.board.hold, activity.key
        every, length = activity.every_s or FOREVER_S, activity.duration_s or 0.0
        began, count = env.now, 0
        while True:
            self._count_burst(activity)
            hold(key, on)
            if length < every:
                yield env.timeout(length)
                hold(key, ())
            count += 1
            yield env.timeout(max(0.0, began + count * every - env.now))

    def _count_burst(self, activity: Activity) -> None:
        self._bursts_done += 1
        if self._bursts_done > MOST_BURSTS:
            raise too_many_bursts(activity, self.env.now, MOST_BURSTS)

    def _trigger(self, trigger: Trigger, edge: str) -> simpy.Event:
        if trigger.time_s is not None:
            return self.env.timeout(max(0.0, trigger.time_s - self.env.now))
        if trigger.place:
            return self.signals.wait("place", trigger.place)
        return self.signals.wait(edge, trigger.segment)

    def _recharge(self, recharge: Recharge) -> Generator[simpy.Event, Any, None]:
        env, recorder, meter = self.env, self.recorder, self.meter
        dock = self.docks.setdefault(recharge.place, simpy.Resource(env, max(1, recharge.slots)))
        order = list(self._batteries)
        level = 1.0 if recharge.until is None else recharge.until
        deadline = FOREVER_S if recharge.duration_s is None else env.now + recharge.duration_s
        with dock.request() as slot:
            yield slot
            began = env.now
            full: set[str] | None = None
            try:
                while env.now < deadline:
                    left = deadline - env.now
                    recorder.close()
                    span = min(left, SPAN_S)
                    yield self._know(span)
                    if full is None:
                        at = meter.state
                        full = {n for n in recharge.batteries if at[n] >= self._batteries[n].state_of(level)}
                    active = [name for name in recharge.batteries if name not in full]
                    if not active and recharge.until is not None:
                        return
                    recorder.charge(
                        tuple(
                            0 if name not in recharge.batteries else HELD if name in full else CHARGING
                            for name in order
                        )
                    )
                    times: dict[str, float] = {}
                    while True:
                        for name in active:
                            if name not in times and (
                                (found := meter.time_to(name, self._batteries[name].state_of(level))) is not None
                            ):
                                times[name] = found
                        if len(times) == len(active) or span >= min(left, LONGEST_LOOK_S):
                            break
                        span = min(left, LONGEST_LOOK_S, 16.0 * span)
                        yield self._know(span)
                    stuck = not times and env.peek() == float("inf")
                    if recharge.duration_s is None and (stuck or env.now - began > LONGEST_CHARGE_S):
                        raise ChargerTooWeak(f"the charger at '{recharge.place}' gives less than the robot draws there")
                    recorder.changed = env.event()
                    wait = min(times.values(), default=min(left, 3600.0))
                    soonest = min(left, wait)
                    ring = env.timeout(soonest)
                    yield ring | recorder.changed
                    if ring.triggered and ring.processed and times and wait <= left:
                        full |= {name for name, seconds in times.items() if seconds <= wait}
            finally:
                recorder.changed = None
                recorder.charge((0,) * len(order))


def _length(phase: Phase, seconds: float) -> float:
    ahead = phase.speed_m_s * seconds + 0.5 * phase.accel_m_s2 * seconds * seconds
    aside = phase.lateral_m_s * seconds + 0.5 * phase.lateral_m_s2 * seconds * seconds
    return float((ahead * ahead + aside * aside) ** 0.5)


def _plain(leg: Leg) -> Leg:
    return Leg("roll", leg.settings, leg.distance_m, leg.speed_m_s, leg.curvature_1_m, instant=leg.instant)
