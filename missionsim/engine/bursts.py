"""Activities in bursts: how many there will be at least, so that a period in a wrong unit is told at the door."""

from __future__ import annotations

from missionsim.errors import InputError
from missionsim.plan.legs import Activity, Plan, Trigger


def refuse_bursts(plan: Plan, most: int) -> None:
    """Refuse activities with more bursts in all than `most`, by the times of the plan.

    What the plan does not know (charging until a level, waiting for a component) only makes a mission longer.

    Raises
    ------
    missionsim.errors.InputError
        For the activity with most bursts.
    """
    clock = _Clock(plan)
    counted = [
        (clock.seconds(activity) / activity.every_s, activity)
        for activity in plan.activities
        if activity.every_s is not None
    ]
    if sum(count for count, _ in counted) > most:
        raise too_many_bursts(max(counted, key=lambda item: item[0])[1], clock.end_s, most)


def too_many_bursts(activity: Activity, seconds: float, most: int) -> InputError:
    """The fault of an activity whose period is too short for its mission."""
    return InputError(
        activity.place.fault(
            f"the activity of '{activity.component}' every {activity.every_s:g} s has too many bursts in a mission of "
            f"{seconds:.4g} s and more",
            got=f"more than {most} bursts in all",
            allowed="a longer period, or a shorter mission (a slow speed, a long way or wait?)",
        )
    )


class _Clock:
    """When the plan comes to its places and segments."""

    def __init__(self, plan: Plan) -> None:
        now = 0.0
        self.times: dict[tuple[str, str], list[float]] = {("place", plan.start): [0.0]} if plan.start else {}
        for step in plan.steps:
            current = -1
            for i, phase in enumerate(step.phases):
                leg = plan.legs[phase.leg]
                label = plan.segments[leg.settings.segment].label
                if leg.first and phase.leg != current:
                    self.times.setdefault(("begin", label), []).append(now)
                current = phase.leg
                now += phase.duration_s
                if i + 1 == len(step.phases) or step.phases[i + 1].leg != current:
                    if leg.place and leg.kind == "roll":
                        self.times.setdefault(("place", leg.place), []).append(now)
                    if leg.last:
                        self.times.setdefault(("end", label), []).append(now)
        self.end_s = now

    def seconds(self, activity: Activity) -> float:
        """Planned time of an activity's first bursts [s]; 0 where the plan never comes to their beginning."""
        begin = 0.0 if activity.begin is None else self._first(activity.begin, "begin", 0.0)
        end = self.end_s if activity.end is None else self._first(activity.end, "end", begin)
        return max(0.0, min(end, self.end_s) - begin)

    def _first(self, trigger: Trigger, edge: str, after_s: float) -> float:
        if trigger.time_s is not None:
            return trigger.time_s
        kind, name = ("place", trigger.place) if trigger.place else (edge, trigger.segment)
        return next((time for time in self.times.get((kind, name), ()) if time >= after_s), self.end_s)
