"""Rounds and shifts: how many rounds, of which speed, and how long to charge before each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.planner.answer import Answer, Leg
from missionsim.planner.solve import Watch
from missionsim.planner.tour import Charger, Site
from missionsim.planner.why import pareto

Array = NDArray[np.float64]
KINDS = 7
"""Rounds of different speed that a shift is put together from."""
MOST_ROUNDS = 1000


@dataclass
class Shift:
    """Rounds of a few kinds that all begin and end at one place, with charging there before each.

    Attributes
    ----------
    site : Site
    kinds : list of Answer
        The rounds to choose from.
    every_s, until_s : float
        Each round begins so long after the one before, or later; all are done by then.
    use : ndarray, shape (kinds, 2 + batteries)
        Objective, seconds and Wh of each kind.
    """

    site: Site
    kinds: list[Answer]
    every_s: float
    until_s: float
    use: Array = field(init=False)
    charger: Charger | None = field(init=False)

    def __post_init__(self) -> None:
        use = np.array([[kind.duration_s, *kind.energy_wh.values()] for kind in self.kinds])
        self.use = np.column_stack([use @ self.site.weights, use])
        home = self.site.task.start
        self.charger = next((s.charger for s in self.site.stops if s.charger is not None and s.place == home), None)

    def relaxed(self, rounds: int) -> tuple[float, Array] | None:
        """Bound on the objective, and how many rounds of each kind, where parts of rounds and any charge may be had."""
        from scipy.optimize import linprog

        physics, charger = self.site.physics, self.charger
        gain = np.zeros(len(physics.names)) if charger is None else np.maximum(charger.gain_w, 0.0) / 3600.0
        rows = [np.append(self.use[:, 2 + b], -gain[b]) for b in range(len(gain))]
        sides = list(physics.initial_wh - physics.reserve_wh)
        if math.isfinite(self.until_s):
            rows.append(np.append(self.use[:, 1], 1.0))
            sides.append(self.until_s)
        made = linprog(
            np.append(self.use[:, 0], 0.0 if charger is None else charger.rate),
            A_ub=np.array(rows),
            b_ub=np.array(sides),
            A_eq=np.append(np.ones(len(self.use)), 0.0)[None, :],
            b_eq=[float(rounds)],
            bounds=[(0.0, None)] * len(self.use) + [(0.0, 0.0 if charger is None else None)],
            method="highs",
        )
        return (float(made.fun), np.asarray(made.x[:-1])) if made.success else None

    def drive(self, order: list[int]) -> Answer | None:
        """The shift of some rounds in an order, charging before each as little as will do; None where it fails."""
        site, physics = self.site, self.site.physics
        answer = Answer(site, True)
        answer.energy_wh = dict.fromkeys(physics.names, 0.0)
        x = np.array([0.0, 0.0, *physics.missing_wh()])
        reserve = physics.reserve_wh
        keep = reserve if site.task.within.reserve_throughout else np.zeros(len(reserve))
        for k, kind in enumerate(order):
            spare = max(0.0, k * self.every_s - x[1])
            need = x[2:] + self.use[kind, 2:] - (physics.capacity_wh - (reserve if k + 1 == len(order) else keep))
            seconds = self._seconds(x, need)
            if not math.isfinite(seconds):
                return None
            if spare > seconds and self.charger is not None:
                full = float(self.charger.seconds_to(x, 1.0).max())
                seconds = max(seconds, min(spare, full if math.isfinite(full) else 0.0))
            if seconds > 0.0 and self.charger is not None:
                x = self.charger.after(x, seconds)
                self._add(
                    answer, Leg("charge", site.task.start, seconds, self._energy(self.charger.draw_w * seconds), {}), x
                )
                if (x[2:] + self.use[kind, 2:] > physics.capacity_wh * (1.0 + 1e-9)).any():
                    return None
            if spare > seconds + 1e-9:
                wait = site.waiting * (spare - seconds)
                x = x + np.array([float(wait @ site.weights), *wait])
                self._add(answer, Leg("wait", site.task.start, spare - seconds, self._energy(wait[1:] * 3600.0), {}), x)
            for leg in self.kinds[kind].legs:
                use = np.array([leg.duration_s, *leg.energy_wh.values()])
                x = x + np.array([float(use @ site.weights), *use])
                self._add(answer, leg, x)
        if x[1] > self.until_s * (1 + 1e-10) or (x[2:] > (physics.capacity_wh - reserve) * (1 + 1e-10)).any():
            return None
        answer.objective = float(x[0])
        answer.charge_left_wh = dict(zip(physics.names, (physics.capacity_wh - x[2:]).tolist(), strict=True))
        return answer

    def _seconds(self, x: Array, need: Array) -> float:
        """How long to charge for what is needed, with a little more than rounding takes."""
        if (need <= 0.0).all():
            return 0.0
        if self.charger is None or (self.charger.gain_w[need > 0.0] <= 0.0).any():
            return math.inf
        wanted = 1.0 - (x[2:] - np.maximum(need, 0.0)) / self.site.physics.capacity_wh
        return float(self.charger.seconds_to(x, np.minimum(wanted, 1.0)).max()) * (1.0 + 1e-9) + 1e-6

    def _energy(self, joules: Array) -> dict[str, float]:
        return dict(zip(self.site.physics.names, (joules / 3600.0).tolist(), strict=True))

    def _add(self, answer: Answer, leg: Leg, x: Array) -> None:
        names = self.site.physics.names
        left = dict(zip(names, (self.site.physics.capacity_wh - x[2:]).tolist(), strict=True))
        answer.legs.append(replace(leg, charge_wh=left))
        answer.duration_s += leg.duration_s
        for name in names:
            answer.energy_wh[name] += leg.energy_wh[name]

    def best(self, rounds: int) -> Answer | None:
        """The cheapest shift of so many rounds that whole numbers near the relaxed ones give."""
        found = self.relaxed(rounds)
        if found is None:
            return None
        bound, shares = found
        mixes = [_whole(shares, rounds)]
        for i in range(len(self.use)):
            mixes.append(np.eye(len(self.use), dtype=int)[i] * rounds)
            moved = mixes[0].copy()
            donor = int(np.argmax(moved))
            moved[donor] -= 1
            moved[i] += 1
            mixes.append(moved)
        made = [self.drive([kind for kind, count in enumerate(mix) for _ in range(count)]) for mix in mixes]
        feasible = [answer for answer in made if answer is not None]
        if not feasible:
            return None
        answer = min(feasible, key=lambda item: item.objective)
        answer.bound = min(bound, answer.objective)
        answer.extra["rounds"] = rounds
        kinds = f"of shifts of {len(self.kinds)} kinds of rounds"
        answer.extra["assumed"] = [f"{kinds}, {'charging only at the start' if self.charger else 'without charging'}"]
        return answer

    def most(self) -> tuple[int, Answer | None]:
        """As many rounds as can be, and how many at most there could be."""
        low, high = 0, MOST_ROUNDS
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self.relaxed(middle) is not None else (low, middle - 1)
        for rounds in range(low, 0, -1):
            answer = self.best(rounds)
            if answer is not None:
                return low, answer
        return low, None


def _whole(shares: Array, total: int) -> NDArray[np.int64]:
    """Whole numbers nearest to shares that add up to a total."""
    made = np.floor(shares + 1e-9).astype(np.int64)
    for i in np.argsort(made - shares)[: max(0, total - int(made.sum()))]:
        made[i] += 1
    return made


def plan_rounds(site: Site, watch: Watch | None = None) -> Answer:
    """As many rounds as asked for, or as can be, with the least objective among those."""
    repeat = site.task.repeat
    assert repeat is not None
    until = min(site.deadline_s, math.inf if repeat.until is None else repeat.until.value)
    changes: dict[str, Any] = {"repeat": None, "choose": site.task.choose.model_copy(update={"docks": "none"})}
    stops = [stop for stop in site.stops if stop.charger is None]
    task = site.task.model_copy(update=changes)
    one = replace(site, task=task, stops=stops, deadline_s=until, roads={}, nodes={}, _standing={})
    physics = site.physics
    kept = physics.initial_wh, physics.reserve_wh
    # a round may begin full and, before charging, end empty
    physics.initial_wh, physics.reserve_wh = physics.capacity_wh.copy(), np.zeros_like(physics.capacity_wh)
    try:
        kinds = pareto(one, KINDS, watch)
    finally:
        physics.initial_wh, physics.reserve_wh = kept
    if not kinds:
        return Answer(site, False, notes=["not even one round can be driven on full batteries without charging on it"])
    shift = Shift(site, kinds, 0.0 if repeat.every is None else repeat.every.value, until)
    if repeat.rounds == "as_often_as_possible":
        at_most, answer = shift.most()
        if answer is None:
            return Answer(site, False, notes=["not even one round can be done within the time and the charge"])
        answer.extra["rounds_at_most"] = at_most
        return answer
    answer = shift.best(repeat.rounds)
    if answer is None:
        _, fewer = shift.most()
        done = 0 if fewer is None else fewer.extra["rounds"]
        where = "" if shift.charger is not None else f"; no dock at '{site.task.start}' may be used (choose: docks)"
        note = f"{repeat.rounds} rounds cannot be done within the time and the charge, {done} can{where}"
        return Answer(site, False, notes=[note], extra={"rounds": done})
    return answer
