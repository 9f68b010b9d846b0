"""One execution of a plan as SimPy processes: the driver, chargers and alarms, beside components and activities."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import Any, cast

import simpy

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import CHARGING, HELD, Battery
from missionsim.engine.components import FOREVER_S, Activities, ComponentInfo, Switchboard
from missionsim.engine.meter import Evaluating, Meter
from missionsim.engine.outcome import Alarm
from missionsim.engine.recorder import Recorder
from missionsim.physics import Value
from missionsim.plan.kinematics import group
from missionsim.plan.legs import Leg, Phase, Plan, Recharge, SegmentInfo, Step

Leave = Callable[[Leg | None, float, bool, str, int], tuple[list[Leg], tuple[Step, ...], bool] | None]
"""``(leg driven last, metres on it, whether the robot stands, battery, segment)`` to legs and steps to a dock, and back
where the robot goes on; and whether it comes back to the end of its edge (or to its beginning). None without a way."""

SPAN_S, LONGEST_LOOK_S = 3600.0, 1e7
"""How far a charger looks ahead at first, and at most."""
LONGEST_CHARGE_S = 30 * 86400.0
"""A charge level that is not reached in this time is not reached at all."""


class ChargerTooWeak(Exception):
    """The asked charge level cannot be reached."""


class World:
    """Everything that takes part in one execution.

    `alarms`: instants, found by an earlier execution, at which a battery interrupts this one; `leave`: way to a dock
    for alarms of kind ``reserve``; `goes_on`: whether the robot comes back from there and goes on where it stopped;
    `values`: parameters that differ from the model's.
    """

    def __init__(
        self,
        plan: Plan,
        model: PowerModel,
        batteries: Mapping[str, Battery],
        components: Sequence[ComponentInfo],
        *,
        alarms: Sequence[Alarm] = (),
        leave: Leave | None = None,
        goes_on: bool = False,
        values: Mapping[str, Value] | None = None,
    ) -> None:
        self.env = env = simpy.Environment()
        self.plan = plan
        self.legs: list[Leg] = list(plan.legs)
        self.segments: list[SegmentInfo] = list(plan.segments)
        self.recorder = Recorder(env, [info.name for info in components])
        self.board = Switchboard(env, self.recorder, components)
        self.meter = Meter(model, self.recorder, self.legs, batteries, values or {}, self.segments)
        self.completed, self.begun, self.reason = False, 0, ""
        self.interrupted: Alarm | None = None
        self.ends_s: dict[int, float] = {}
        self.excursions: list[list[float]] = []
        self.rounds: dict[int, int] = {leg.gate.block: 0 for leg in plan.legs if leg.gate is not None}
        self._docks: dict[str, simpy.Resource] = {}
        self._halt, self._answered = env.event(), env.event()
        self._ahead_s: float | None = None
        self._leave, self._goes_on, self._batteries = leave, goes_on, batteries
        self._going_on: list[Step] = []
        self._at = 0
        self._left: tuple[int, float] | None = None
        self._ended: set[int] = set()
        self._passed: set[tuple[str, int]] = set()
        self.activities = Activities(env, self.board, plan)
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
            self.activities.fire("place", self.plan.start)
        steps: Sequence[Step] | None = self.plan.steps
        home = False
        while steps is not None:
            try:
                yield from self._execute(steps)
                self.completed = not home and not self.reason
                break
            except ChargerTooWeak as problem:
                self.reason = str(problem)
                self.recorder.move(self.recorder.leg)
                break
            except simpy.Interrupt as interrupt:
                alarm = cast(Alarm, interrupt.cause)
                self.interrupted = self.interrupted or alarm
                self.reason = f"battery '{alarm.battery}' {'empty' if alarm.kind == 'empty' else 'at its reserve'}"
                steps = self._to_dock(alarm.battery) if alarm.kind == "reserve" and not home else None
                if steps is None:
                    self.recorder.close()
                elif self._goes_on:
                    self.reason, self.interrupted = "", None
                else:
                    home = True
        self._at_once(self._halt)

    def _execute(self, steps: Iterable[Step]) -> Generator[simpy.Event, Any, None]:
        env, recorder, legs, board = self.env, self.recorder, self.legs, self.board
        fire = self.activities.fire
        self._going_on = list(steps)
        for at, step in enumerate(self._going_on):
            self._at = at
            phases = step.phases
            current = -1
            if (gate := legs[phases[0].leg].gate) is not None:  # a block that is repeated until a time
                if gate.first and gate.block not in self._ended:
                    if env.now + gate.duration_s > gate.until_s * (1.0 + 1e-12):
                        self._ended.add(gate.block)
                    else:
                        self.rounds[gate.block] += 1
                if gate.block in self._ended:
                    continue
            for i, phase in enumerate(phases):
                leg = legs[phase.leg]
                if phase.leg != current:
                    current = phase.leg
                    if leg.first:
                        if leg.segment < len(self.plan.segments):
                            self.begun = leg.segment + 1
                        fire("begin", self.segments[leg.segment].label)
                    sensors = leg.settings.sensors
                    board.hold("segment", sensors)
                    if i == 0 and (waits := board.waiting_for(sensors)):
                        recorder.move(current)
                        yield env.all_of(waits)
                recorder.move(current, phase)
                if leg.recharge is not None:
                    yield from self._recharge(leg.recharge)
                    if self.segments[leg.segment].kind == "recharge":
                        self.excursions[-1][1] = env.now
                elif phase.duration_s > 0.0:
                    yield env.timeout(phase.duration_s)
                if i + 1 == len(phases) or phases[i + 1].leg != current:
                    if leg.place and leg.kind == "roll":
                        fire("place", leg.place)
                    if leg.last:
                        fire("end", self.segments[leg.segment].label)
                        self.ends_s[leg.segment] = env.now
            recorder.move(current)

    def _to_dock(self, battery: str) -> list[Step] | None:
        """Steps to a dock; where the robot goes on also charging there, back, and what is left. None where that cannot
        be; where it was to go on, with the reason."""
        recorder, legs, at = self.recorder, self.legs, self.recorder.leg
        leg, phase, elapsed = legs[at], recorder.phase, float(recorder.env.now - recorder.phase_began_s)
        done = _length(phase, elapsed) if phase.moving else 0.0  # metres on the leg under way
        for earlier in self._going_on[self._at].phases:
            if earlier is phase:
                break
            if earlier.leg == phase.leg:
                done += _length(earlier, earlier.duration_s)
        speed, decel = abs(phase.speed_m_s + phase.accel_m_s2 * elapsed), self.plan.limits.decel_m_s2
        braking_s = 0.0
        if phase.moving and leg.kind == "roll" and decel and not leg.instant:
            braking_s = speed / decel
        recorder.close()
        last: Leg | None = leg
        if leg.kind != "roll":
            driven = (legs[row.leg] for row in reversed(recorder.rows))
            last = next((one for one in driven if one.kind in ("roll", "slide")), None)
            done = 0.0 if last is None else last.distance_m
        done, stands, found = done + 0.5 * speed * braking_s, leg.kind != "roll", None
        if self._leave is not None:
            found = self._leave(last, done, stands, battery, len(self.segments))
        why = f"battery '{battery}' at its reserve, and no way leads to a dock that charges it and back"
        rest: list[Leg] = []
        if found is not None and self._goes_on:
            rest = self._rest(at, elapsed, found[2])
            left = len(rest) + len(self._going_on) - self._at - 1, rest[0].duration_s if rest else 0.0
            kind = self.segments[leg.segment].kind
            if kind == "recharge" or (self._left is not None and left >= self._left):
                why = f"battery '{battery}' at its reserve again: charged, it does not get further"
                found = None
            self._left = left
        if found is None:
            if self._goes_on:
                self.reason = why
            recorder.move(at)
            return None
        way, steps, _ = found
        made: list[Step] = []
        if braking_s and decel:  # to a standstill on the leg under way
            bend = leg.curvature_1_m
            braking = Leg("roll", leg.settings, leg.distance_m, leg.speed_m_s, bend, pace=leg.pace)
            legs.append(braking._replace(instant=leg.instant, segment=leg.segment))
            yaw = {"yaw_rad_s": speed * bend, "yaw_rad_s2": -decel * bend}
            made.append(Step("roll", (Phase(braking_s, len(legs) - 1, speed, -decel, moving=True, **yaw),)))
        else:
            recorder.move(at)
        made += _moved(steps, len(legs))
        legs.extend(way)
        if not self._goes_on:
            self.segments.append(SegmentInfo("return to dock", "return"))
            return made
        self.segments.append(SegmentInfo("recharge", "recharge", label="recharge"))
        made += [*_moved(group(rest, self.plan.limits), len(legs)), *self._going_on[self._at + 1 :]]
        legs.extend(rest)
        self.excursions.append([self.env.now, math.inf])
        return made

    def _rest(self, at: int, elapsed_s: float, went_on: bool) -> list[Leg]:
        """What is left of the step under way for a robot that comes back to it."""
        legs, leg = self.legs, self.legs[at]
        order = list(dict.fromkeys(phase.leg for phase in self._going_on[self._at].phases))
        first = order.index(at) if at in order else 0
        if leg.edge is not None and leg.kind == "roll":
            same = [i for i in range(len(order)) if leg.same_edge(legs[order[i]])]
            first = max(i for i in same if i >= first) + 1 if went_on else min(i for i in same if i <= first)
        rest = []
        for i in order[first:]:  # gone on with: neither a segment nor a round begins
            gate = legs[i].gate
            rest.append(legs[i]._replace(first=False, gate=None if gate is None else gate._replace(first=False)))
        if leg.kind == "stand" and rest:
            rest[0] = rest[0]._replace(duration_s=max(0.0, leg.duration_s - elapsed_s))
        return rest

    def _alarms(self, alarms: Sequence[Alarm]) -> Generator[simpy.Event, Any, None]:
        for alarm in alarms:
            yield self.env.timeout(max(0.0, alarm.time_s - self.env.now))
            if not self.driver.is_alive:
                return
            self.driver.interrupt(alarm)

    def _goal(self, name: str, level: float) -> tuple[float, int, bool]:
        """To which state a battery is charged next, in which mode, and whether that is all; its taper has pieces."""
        battery, state = self._batteries[name], self.meter.state[name]
        for piece, (upper, _) in enumerate(battery.taper):
            mode = CHARGING if piece == 0 else HELD + piece
            if upper >= level:
                return battery.full * level, mode, True
            if state < battery.full * upper and (name, mode) not in self._passed:
                return battery.full * upper, mode, False
        return battery.full * level, CHARGING, True

    def _recharge(self, recharge: Recharge) -> Generator[simpy.Event, Any, None]:
        env, recorder, meter = self.env, self.recorder, self.meter
        dock = self._docks.setdefault(recharge.place, simpy.Resource(env, max(1, recharge.slots)))
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
                        holds = {name: self._batteries[name].full for name in recharge.batteries}
                        if all(at[name] / whole >= recharge.if_below for name, whole in holds.items()):
                            return
                        full = {name for name, whole in holds.items() if at[name] >= whole * level}
                    active = [name for name in recharge.batteries if name not in full]
                    if not active and recharge.until is not None:
                        return
                    goals = {name: self._goal(name, level) for name in active}
                    modes = {name: goals[name][1] if name in goals else HELD for name in recharge.batteries}
                    recorder.charging = tuple(modes.get(name, 0) for name in order)
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
                    ring = env.timeout(min(left, wait))
                    yield ring | recorder.changed
                    if ring.triggered and ring.processed and times and wait <= left:
                        reached = {name for name, seconds in times.items() if seconds <= wait}
                        full |= {name for name in reached if goals[name][2]}
                        self._passed |= {(name, goals[name][1]) for name in reached}
            finally:
                recorder.changed = None
                recorder.close()
                recorder.charging = ()


def _length(phase: Phase, seconds: float) -> float:
    ahead = phase.speed_m_s * seconds + 0.5 * phase.accel_m_s2 * seconds * seconds
    aside = phase.lateral_m_s * seconds + 0.5 * phase.lateral_m_s2 * seconds * seconds
    return float((ahead * ahead + aside * aside) ** 0.5)


def _moved(steps: Iterable[Step], base: int) -> list[Step]:
    """Steps whose legs stand further back in a list."""
    return [Step(step.kind, tuple(p._replace(leg=p.leg + base) for p in step.phases)) for step in steps]
