"""One execution of a plan as SimPy processes: a driver, the components, the activities beside it, and alarms."""

from __future__ import annotations

import math
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
from missionsim.plan.legs import Activity, Gate, Leg, Phase, Plan, Recharge, SegmentInfo, Step, Trigger
from missionsim.plan.steps import group

Detour = Callable[[Leg, float, float], tuple[list[Leg], tuple[Step, ...]] | None]
"""``(leg, metres done on it, metres to brake) -> legs and steps home``, or None where there is no way."""

Excursion = Callable[[Leg, float, float, str, str, int], tuple[list[Leg], tuple[Step, ...], bool] | None]
"""``(leg, metres done, metres to brake, place, battery, segment)`` to legs and steps to a dock and back, and whether
the robot comes back to the end of its edge (or to its beginning)."""

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
    excursion : callable, optional
        In its place a way to a dock, which goes on afterwards where the robot stopped.
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
        excursion: Excursion | None = None,
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
        self._excursion = excursion
        self._going_on: list[Step] = []
        self._at = 0
        self._left: tuple[int, float] | None = None
        self.excursions: list[list[float]] = []
        self.rounds: dict[int, int] = {leg.gate.block: 0 for leg in plan.legs if leg.gate is not None}
        self._ended: set[int] = set()
        self._passed: set[tuple[str, int]] = set()
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
                if alarm.kind == "reserve" and self._excursion is not None:
                    found = self._to_dock_and_on(alarm.battery)
                    if found is None:
                        break
                    steps = found
                    self.reason, self.interrupted = "", None
                    continue
                way = self._way_home() if alarm.kind == "reserve" and not home else None
                if way is None:
                    self.recorder.close()
                    break
                steps, home = way, True
        self._at_once(self._halt)

    def _execute(self, steps: Iterable[Step]) -> Generator[simpy.Event, Any, None]:
        env, recorder, legs, board = self.env, self.recorder, self.legs, self.board
        signals = self.signals
        self._going_on = list(steps)
        for at, step in enumerate(self._going_on):
            self._at = at
            self._phases = phases = step.phases
            current = -1
            if (gate := legs[phases[0].leg].gate) is not None and self._shut(gate):
                continue
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
                    if self.segments[leg.settings.segment].kind == "recharge":
                        self.excursions[-1][1] = env.now
                elif phase.duration_s > 0.0:
                    yield env.timeout(phase.duration_s)
                if i + 1 == len(phases) or phases[i + 1].leg != current:
                    if leg.place and leg.kind == "roll":
                        signals.fire("place", leg.place)
                    if leg.last:
                        signals.fire("end", self.segments[leg.settings.segment].label)
                        self.ends_s[leg.settings.segment] = env.now
            recorder.rest(current)

    def _shut(self, gate: Gate) -> bool:
        """Whether a block that is repeated until a time has ended; counts its rounds."""
        if gate.first and gate.block not in self._ended:
            if self.env.now + gate.duration_s > gate.until_s * (1.0 + 1e-12):
                self._ended.add(gate.block)
            else:
                self.rounds[gate.block] += 1
        return gate.block in self._ended

    def _to_dock_and_on(self, battery: str) -> list[Step] | None:
        """Steps to a dock, charging there, back, and what is left; None where that cannot be, with the reason."""
        recorder, legs = self.recorder, self.legs
        phase, at = recorder.phase, recorder.leg
        leg, elapsed = legs[at], recorder.phase_elapsed_s
        step = self._going_on[self._at]
        order = list(dict.fromkeys(p.leg for p in step.phases))
        index = order.index(at) if at in order else 0
        done, braking_s, speed = self._stopping(phase, leg)
        recorder.close()
        place = next((legs[i].place for i in range(at if leg.kind == "roll" else at + 1, -1, -1) if legs[i].place), "")
        assert self._excursion is not None
        found = self._excursion(
            leg, done, 0.5 * speed * braking_s, place or self.plan.start, battery, len(self.segments)
        )
        if found is None:
            self.reason = f"battery '{battery}' at its reserve, and no way leads to a dock that charges it and back"
            recorder.rest(at)
            return None
        way, steps, went_on = found
        first = index
        if leg.edge is not None and leg.kind == "roll":
            same = [i for i in range(len(order)) if _same_edge(legs[order[i]], leg)]
            first = max(i for i in same if i >= index) + 1 if went_on else min(i for i in same if i <= index)
        rest = [_again(legs[i]) for i in order[first:]]
        if leg.kind == "stand" and rest:
            rest[0] = rest[0]._replace(duration_s=max(0.0, leg.duration_s - elapsed))
        later = self._going_on[self._at + 1 :]
        left = (len(rest) + len(later), rest[0].duration_s if rest else 0.0)
        if self.segments[leg.settings.segment].kind == "recharge" or (self._left is not None and left >= self._left):
            self.reason = f"battery '{battery}' at its reserve again: charged, it does not get further"
            recorder.rest(at)
            return None
        self._left = left
        brake = self._brake(leg, at, speed, braking_s)
        self.segments.append(SegmentInfo("recharge", "recharge", label="recharge"))
        base = len(legs)
        legs.extend(way)
        made = [*brake, *_moved(steps, base)]
        base = len(legs)
        legs.extend(rest)
        made += [*_moved(group(rest, self.plan.limits), base), *later]
        self.excursions.append([self.env.now, math.inf])
        return made

    def _stopping(self, phase: Phase, leg: Leg) -> tuple[float, float, float]:
        """Metres done on a leg under way, seconds that braking takes, and the speed now."""
        recorder = self.recorder
        done = _length(phase, recorder.phase_elapsed_s) if phase.moving else 0.0
        for earlier in self._phases:
            if earlier is phase:
                break
            if earlier.leg == phase.leg:
                done += _length(earlier, earlier.duration_s)
        speed = abs(phase.speed_m_s + phase.accel_m_s2 * recorder.phase_elapsed_s)
        decel = None if leg.instant else self.plan.limits.decel_m_s2
        return done, speed / decel if phase.moving and leg.kind == "roll" and decel else 0.0, speed

    def _brake(self, leg: Leg, at: int, speed: float, braking_s: float) -> tuple[Step, ...]:
        """Braking to a standstill on a leg under way; without it the robot stands at once."""
        decel = self.plan.limits.decel_m_s2
        if not braking_s or not decel:
            self.recorder.rest(at)
            return ()
        self.legs.append(_plain(leg))
        bend = leg.curvature_1_m
        brake = Phase(
            braking_s, len(self.legs) - 1, speed, -decel, yaw_rad_s=speed * bend, yaw_rad_s2=-decel * bend, moving=True
        )
        return (Step("roll", (brake,)),)

    def _way_home(self) -> tuple[Step, ...] | None:
        recorder = self.recorder
        leg = self.legs[recorder.leg]
        done, braking_s, speed = self._stopping(recorder.phase, leg)
        recorder.close()
        found = self._detour(leg, done, 0.5 * speed * braking_s) if self._detour else None
        if found is None:
            recorder.rest(recorder.leg)
            return None
        way, steps = found
        base = len(self.legs)
        self.segments.append(SegmentInfo("return to dock", "return"))
        self.legs.extend(way)
        return (*self._brake(leg, recorder.leg, speed, braking_s), *_moved(steps, base))

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
            stop = None if activity.end is None else self._trigger(activity.end, "end")
            if activity.every_s is not None:
                yield from self._bursts(activity, on, stop)
            else:
                board.hold(activity.key, on)
                ends = [] if stop is None else [stop]
                if activity.duration_s is not None:
                    ends.append(env.timeout(activity.duration_s))
                yield env.any_of(ends) if ends else env.event()
                board.hold(activity.key, ())
            if not repeats:
                return

    def _bursts(
        self, activity: Activity, on: tuple[tuple[str, int], ...], stop: simpy.Event | None
    ) -> Generator[simpy.Event, Any, None]:
        env, hold, key = self.env, self.board.hold, activity.key
        every, length = activity.every_s or FOREVER_S, activity.duration_s or 0.0
        began, count = env.now, 0
        if stop is not None:
            process = env.active_process
            if stop.callbacks is None or process is None:
                return
            stop.callbacks.append(lambda _: process.interrupt())
        try:
            while True:
                self._count_burst(activity)
                hold(key, on)
                if length < every:
                    yield env.timeout(length)
                    hold(key, ())
                count += 1
                yield env.timeout(max(0.0, began + count * every - env.now))
        except simpy.Interrupt:
            hold(key, ())

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

    def _goal(self, name: str, level: float) -> tuple[float, int, bool]:
        """To which state a battery is charged next, in which mode, and whether that is all; its taper has pieces."""
        battery, state = self._batteries[name], self.meter.state[name]
        for piece, (upper, _) in enumerate(battery.taper):
            mode = CHARGING if piece == 0 else HELD + piece
            if upper >= level:
                return battery.state_of(level), mode, True
            if state < battery.state_of(upper) and (name, mode) not in self._passed:
                return battery.state_of(upper), mode, False
        return battery.state_of(level), CHARGING, True

    def _recharge(self, recharge: Recharge) -> Generator[simpy.Event, Any, None]:
        env, recorder, meter = self.env, self.recorder, self.meter
        dock = self.docks.setdefault(recharge.place, simpy.Resource(env, max(1, recharge.slots)))
        order = list(self._batteries)
        level = 1.0 if recharge.until is None else recharge.until
        deadline = FOREVER_S if recharge.duration_s is None else env.now + recharge.duration_s
        with dock.request() as slot:
            yield slot
            began = env.now
            self._passed = set()
            full: set[str] | None = None
            try:
                while env.now < deadline:
                    left = deadline - env.now
                    recorder.close()
                    span = min(left, SPAN_S)
                    yield self._know(span)
                    if full is None:
                        at = meter.state
                        low = [n for n in recharge.batteries if self._batteries[n].fraction(at[n]) < recharge.if_below]
                        if not low:
                            return
                        full = {n for n in recharge.batteries if at[n] >= self._batteries[n].state_of(level)}
                    active = [name for name in recharge.batteries if name not in full]
                    if not active and recharge.until is not None:
                        return
                    goals = {name: self._goal(name, level) for name in active}
                    recorder.charge(
                        tuple(
                            0 if name not in recharge.batteries else HELD if name in full else goals[name][1]
                            for name in order
                        )
                    )
                    times: dict[str, float] = {}
                    while True:
                        for name in active:
                            if name not in times and ((found := meter.time_to(name, goals[name][0])) is not None):
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
                        reached = {name for name, seconds in times.items() if seconds <= wait}
                        full |= {name for name in reached if goals[name][2]}
                        self._passed |= {(name, goals[name][1]) for name in reached}
            finally:
                recorder.changed = None
                recorder.charge((0,) * len(order))


def _length(phase: Phase, seconds: float) -> float:
    ahead = phase.speed_m_s * seconds + 0.5 * phase.accel_m_s2 * seconds * seconds
    aside = phase.lateral_m_s * seconds + 0.5 * phase.lateral_m_s2 * seconds * seconds
    return float((ahead * ahead + aside * aside) ** 0.5)


def _moved(steps: Iterable[Step], base: int) -> list[Step]:
    """Steps whose legs stand further back in a list."""
    return [Step(step.kind, tuple(p._replace(leg=p.leg + base) for p in step.phases)) for step in steps]


def _same_edge(leg: Leg, other: Leg) -> bool:
    same = leg.edge is not None and other.edge is not None and leg.edge[:3] == other.edge[:3]
    return same and leg.settings.segment == other.settings.segment


def _again(leg: Leg) -> Leg:
    """A leg that is gone on with: neither its segment nor a round begins with it."""
    return leg._replace(first=False, gate=None if leg.gate is None else leg.gate._replace(first=False))


def _plain(leg: Leg) -> Leg:
    return Leg("roll", leg.settings, leg.distance_m, leg.speed_m_s, leg.curvature_1_m, instant=leg.instant)
