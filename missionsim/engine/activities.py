"""Activities beside the driving: components that are on from a trigger until another, or in bursts."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import simpy

from missionsim.engine.components import Switchboard
from missionsim.errors import InputError
from missionsim.plan.legs import Activity, Plan, Trigger

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

    def _wait(self, trigger: Trigger, edge: str) -> simpy.Event:
        if trigger.time_s is not None:
            return self._env.timeout(max(0.0, trigger.time_s - self._env.now))
        return self._events.setdefault(_key(trigger, edge), self._env.event())

    def _run(self, activity: Activity) -> Generator[simpy.Event, Any, None]:
        env, hold, on = self._env, self._board.hold, ((activity.component, activity.units),)
        while True:
            if activity.begin is not None:
                yield self._wait(activity.begin, "begin")
            stop = None if activity.end is None else self._wait(activity.end, "end")
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
    return InputError(
        activity.place.fault(
            f"the activity of '{activity.component}' every {activity.every_s:g} s has too many bursts in a mission of "
            f"{seconds:.4g} s and more",
            got=f"more than {MOST_BURSTS} bursts in all",
            allowed="a longer period, or a shorter mission (a slow speed, a long way or wait?)",
        )
    )


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
