"""Stops of a task: the orders in which they may be made, what is done at each and charged there, the roads between."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from missionsim.errors import InputError
from missionsim.inputs.check_task import earlier_of
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.segments import DockSegment, InspectSegment, RechargeSpec, WaitSegment
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array, Bools, Ints
from missionsim.plan.build import legs_of
from missionsim.planner.drives import Drives
from missionsim.planner.physics import Physics
from missionsim.planner.pieces import FREE, ROLLED, STOPPED, State, equipment, make_road, pieces_of

HAIR = 2e-9
"""Of its capacity a battery is charged more than what just suffices, unless it is full, lest it comes out empty by
rounding."""
MOST_FREE = 13
"""Visits in any order of which all subsets are gone through."""


class Order:
    """The states of a task's visits.

    A state is the set of visits done, as bits; in a given order that leaves nothing out (or of more than `MOST_FREE`
    visits) it is how many of them lie behind. `sequence`: an order to keep to; `most_kg`: in place of the task's.
    """

    def __init__(self, task: TaskSpec, sequence: tuple[int, ...] | None = None, most_kg: float | None = None) -> None:
        self.visits = task.visits
        count = len(self.visits)
        given = task.defaults.payload
        self.load_kg = 0.0 if given is None else given.value
        if sequence is None and task.order == "given":
            sequence = tuple(range(count))
        changes = [visit.take_up is not None or visit.set_down is not None for visit in self.visits]
        self._changes = any(changes)
        earlier = earlier_of(self.visits)
        self._optional = [visit.value is not None for visit in self.visits]
        if sequence is not None and any(self._optional) and count <= MOST_FREE:
            for rank, i in enumerate(sequence):
                earlier[i] |= set(sequence[:rank])
            sequence = None
        elif sequence is not None:  # positions do not tell what was left out, and so not what is carried
            self._optional = [free and not change for free, change in zip(self._optional, changes, strict=True)]
        self.sequence = sequence
        self._earlier = [sum(1 << other for other in needs) for needs in earlier]
        self._later = [sum(1 << i for i in range(count) if other in earlier[i]) for other in range(count)]
        self._needed = sum(1 << i for i in range(count) if not self._optional[i])
        self._most_kg = task.most_kg if most_kg is None else most_kg

    @cached_property
    def count(self) -> int:
        """How many states there are."""
        return len(self.visits) + 1 if self.sequence is not None else 1 << len(self.visits)

    def payload_kg(self, state: int) -> float:
        """Load carried in a state."""
        if not self._changes:
            return self.load_kg
        if self.sequence is not None:
            done = sorted(self.sequence[:state])  # also those left out
        else:
            done = [i for i in range(len(self.visits)) if state >> i & 1]
        load = self.load_kg + sum(self.visits[i].load_kg for i in done)
        return max(load, 0.0) if load > -1e-9 else load

    def after(self, state: int) -> list[tuple[int, int]]:
        """Visits that may come next and the state after each."""
        if self.sequence is not None:
            left = self.sequence[state:]
            must = next((k for k, i in enumerate(left) if not self._optional[i]), len(left))
            found = [(i, state + 1 + k) for k, i in enumerate(left[: must + 1])]
        else:
            found = [
                (i, state | 1 << i)
                for i in range(len(self.visits))
                if not state >> i & 1 and not self._earlier[i] & self._needed & ~state and not self._later[i] & state
            ]
        if not self._changes:
            return found
        most = math.inf if self._most_kg is None else self._most_kg * (1 + 1e-12)
        return [(i, after) for i, after in found if -1e-9 <= self.payload_kg(after) <= most]

    @cached_property
    def steps(self) -> list[tuple[Ints, Ints, Ints]]:
        """All visits from all states: states, visits, states after; in parts, each after those that follow from it."""
        parts: dict[int, list[tuple[int, int, int]]] = {}
        for state in range(self.count):
            level = state if self.sequence is not None else state.bit_count()
            if self.payload_kg(state) >= 0.0:
                parts.setdefault(level, []).extend((state, visit, after) for visit, after in self.after(state))
        made = [np.array(parts[level], dtype=np.intp).reshape(-1, 3) for level in sorted(parts, reverse=True)]
        return [(part[:, 0], part[:, 1], part[:, 2]) for part in made if len(part)]

    @cached_property
    def standing(self) -> list[tuple[int, int]]:
        """Under which of the loads each visit may be made: (load, visit)."""
        which, made = self.loads[1], set[tuple[int, int]]()
        for _, visits, afters in self.steps:
            made |= set(zip(which[afters].tolist(), visits.tolist(), strict=True))
        return sorted(made)

    @cached_property
    def driven(self) -> list[int]:
        """Under which of the loads the robot may drive."""
        which = self.loads[1]
        return sorted({int(which[0]), *(int(i) for begin, _, end in self.steps for i in (*which[begin], *which[end]))})

    @cached_property
    def loads(self) -> tuple[Array, Ints]:
        """The loads that may be carried, and which of them in each state."""
        carried = np.array([self.payload_kg(state) for state in range(self.count)])
        loads, which = np.unique(carried, return_inverse=True)
        return loads, np.ravel(which)

    @cached_property
    def ends(self) -> Bools:
        """States in which nothing that must be done is left."""
        return np.array([self.may_end(state) for state in range(self.count)])

    def may_end(self, state: int) -> bool:
        """Whether nothing that must be done is left."""
        if self.sequence is not None:
            return all(self._optional[i] for i in self.sequence[state:])
        return self._needed & ~state == 0

    @cached_property
    def possible(self) -> bool:
        """Whether the load allows to do what must be done, in some order."""
        found, waiting = {0}, [0]
        while waiting:
            state = waiting.pop()
            if self.may_end(state):
                return True
            new = {after for _, after in self.after(state)} - found
            found |= new
            waiting += new
        return False

    def left(self, values: Array) -> Array:
        """Value that may still be made from each state, shape (states,)."""
        if self.sequence is not None:
            return np.append(np.cumsum(values[list(self.sequence)][::-1])[::-1], 0.0)
        bits = np.arange(self.count)[:, None] >> np.arange(len(values)) & 1
        return np.asarray((1 - bits) @ values)


@dataclass(frozen=True, eq=False)
class Stop:
    """A place where the robot stands: the start, a visit, the goal or a dock."""

    place: str
    lasts_s: float = 0.0
    """Time of what is done there."""
    visit: int | None = None
    """Of the task."""
    charger: Charger | None = None


@dataclass(frozen=True, eq=False)
class Charger:
    """What charging at a dock does to the vector (objective, seconds, Wh missing of each battery, …)."""

    gain_w: Array
    """What comes in less what the robot draws, before the charge tapers off; 0 or less where it is not charged. Shape
    (batteries,)."""
    draw_w: Array
    """What the robot draws while docked. Shape (batteries,)."""
    served: Bools
    """Shape (batteries,)."""
    capacity_wh: Array
    """Shape (batteries,)."""
    rate: float = 0.0
    """Objective for a second at the dock; what `Tour.chargers` have."""
    levels: tuple[float, ...] | None = None
    """Fractions that may be charged to; None for any."""
    tapers: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Of each battery, up to which fraction of its capacity what comes in less what the robot draws [W]. Tuple of
    (tuple of (level, gain))."""
    obliged: ClassVar[bool] = True
    """A stop without charging is no stop; where any charge may be had, next to none may be."""

    @cached_property
    def _curves(self) -> list[tuple[Array, Array] | None]:
        """Of each battery that is charged, Wh missing and the seconds from empty to there; both rise and fall so."""
        made: list[tuple[Array, Array] | None] = []
        for charged, capacity, taper in zip(
            self.served & (self.gain_w > 0.0), self.capacity_wh, self.tapers, strict=True
        ):
            missing = capacity * (1.0 - np.array([0.0, *(upper for upper, _ in taper)]))
            gains = np.array([gain for _, gain in taper])
            times = np.cumsum([0.0, *(-np.diff(missing) * 3600.0 / gains)]) if charged else missing
            made.append((missing, times) if charged else None)
        return made

    def after(self, x: Array, seconds: Array, level: float = 1.0) -> Array:
        """The vectors after charging for some times, shape (times, resources); held at a level once there."""
        made = np.repeat(x[None, :], len(seconds), axis=0)
        made[:, 0] += self.rate * seconds
        made[:, 1] += seconds
        for b, curve in enumerate(self._curves):
            missing = x[2 + b]
            if curve is None:
                made[:, 2 + b] -= self.gain_w[b] * seconds / 3600.0
            else:
                there = np.interp(missing, curve[0][::-1], curve[1][::-1]) + seconds
                floor = min((1.0 - level) * self.capacity_wh[b], missing)
                made[:, 2 + b] = np.maximum(np.interp(there, curve[1], curve[0]), floor)
        return made

    def seconds_to(self, x: Array, level: float) -> Array:
        """Time until each battery served is at a level, shape (batteries,); infinite where it never is."""
        made = np.zeros(len(self.gain_w))
        for b, curve in enumerate(self._curves):
            missing, goal = x[2 + b], (1.0 - level) * self.capacity_wh[b]
            if curve is None:
                made[b] = math.inf if self.served[b] and missing > goal else 0.0
            elif missing > goal:
                made[b] = np.subtract(*np.interp([goal, missing], curve[0][::-1], curve[1][::-1]))
        return made

    def level_of(self, x: Array, seconds: float) -> float | None:
        """The level that charging for some time comes to; None where any charge may be had."""
        if self.levels is None:
            return None
        return min(self.levels, key=lambda level: abs(float(self.seconds_to(x, level).max()) - seconds))

    def options(self, x: Array) -> list[Array]:
        """Levels one by one, or the chain of all charges up to full."""
        if self.levels is not None:
            made = []
            for level in self.levels:
                seconds = float(self.seconds_to(x, level).max())
                if 0.0 < seconds < math.inf:
                    made.append(self.after(x, np.array([seconds]), level))
            return made
        curves = [(x[2 + b], c[0][::-1], c[1][::-1]) for b, c in enumerate(self._curves) if c is not None]
        times = [bends - np.interp(missing, known, bends) for missing, known, bends in curves]
        knots = np.unique(np.concatenate([np.empty(0), *times]))
        knots = knots[knots > 0.0]
        if not knots.size:
            return []
        chain = np.concatenate([x[None, :], self.after(x, knots)])
        missing = chain[:, 2 : 2 + len(self.gain_w)]
        less = HAIR * self.capacity_wh
        missing += less * (self.served & (self.gain_w > 0.0) & (missing > less))
        return [chain]


@dataclass
class Site:
    """Everything about a task that does not depend on what is chosen: stops, roads by payload, costs."""

    task: TaskSpec
    physics: Physics
    order: Order
    stops: list[Stop] = field(default_factory=list)
    """First the start, then the visits, the goal, the docks."""
    deadline_s: float = math.inf
    weights: Array = field(default_factory=lambda: np.zeros(0))
    """Of seconds and Wh in the objective. Shape (1 + batteries,)."""
    timeless: bool = False
    """Time is neither limited nor part of the objective: nothing is chosen for being quicker."""
    _roads: dict[float, tuple[Drives, Ints, Ints]] = field(default_factory=dict)
    _standing: dict[tuple[int, float], Array] = field(default_factory=dict)

    @property
    def goal(self) -> int:
        """Number of the stop that ends the mission."""
        return len(self.task.visits) + 1

    def road(self, payload_kg: float) -> tuple[Drives, Ints, Ints]:
        """The road under a load, made when first asked for; its states in which each stop is left and come to."""
        if payload_kg not in self._roads:
            physics, leaving = self.physics, []
            for number, stop in enumerate(self.stops):
                # at rest, unless it never stood (which only starts cost)
                stood = number == 0 or stop.charger is not None or stop.lasts_s > 0.0 or not physics.impulsive
                leaving.append(State(stop.place, 0.0, FREE if stood else ROLLED))
            road = make_road(physics, pieces_of(self.task, physics, payload_kg), leaving, self.shear)
            out = np.array([road.index[state] for state in leaving], dtype=np.intp)
            into = np.array([road.index[State(stop.place, 0.0, STOPPED)] for stop in self.stops], dtype=np.intp)
            self._roads[payload_kg] = Drives(road), out, into
        return self._roads[payload_kg]

    def standing(self, number: int, payload_kg: float) -> Array:
        """Seconds and Wh of what is done at a stop under a load, shape (choices, 1 + batteries): for each scheme."""
        stop, width = self.stops[number], 1 + len(self.physics.names)
        if stop.visit is None:
            return np.zeros((1, width))
        key = (number, payload_kg)
        if key not in self._standing:
            visit = self.task.visits[stop.visit]
            segments: list[tuple[str, InspectSegment | WaitSegment]] = []
            for choice in self.task.choices_of(visit):
                asked: dict[str, Any] = {"payload": Parameter(payload_kg, unit="kg"), "name": visit.label}
                asked |= equipment(choice or visit) | {
                    "duration": visit.inspect or visit.wait or Parameter(0.0, unit="s")
                }
                if visit.inspect is not None:
                    segments.append((stop.place, InspectSegment.model_construct(kind="inspect", **asked)))
                else:
                    segments.append((stop.place, WaitSegment.model_construct(kind="wait", **asked)))
            made = self._standing[key] = np.zeros((len(segments), width))
            for use, legs in zip(made, legs_of(self.physics.mission, segments), strict=True):
                for leg in legs:
                    use[0] += leg.duration_s
                    use[1:] += self.physics.standing_wh(leg.settings, leg.duration_s)
        return self._standing[key]

    @property
    def usable_wh(self) -> Array:
        """What may be missing in each battery at any time, shape (batteries,)."""
        physics = self.physics
        kept = np.maximum(physics.reserve_wh, 0.0) if self.task.within.reserve_throughout else 0.0
        return np.asarray(physics.capacity_wh - physics.held_wh - kept)

    @cached_property
    def windowed(self) -> bool:
        """Whether some visit must begin within a window."""
        return any(visit.window is not None for visit in self.task.visits)

    @cached_property
    def waits_until(self) -> float:
        """When the last visit's window opens, or the last round sets out; 0 where nothing has to wait."""
        windows = [visit.window.from_.value for visit in self.task.visits if visit.window is not None]
        repeat = self.task.repeat
        return max([*windows, 0.0 if repeat is None or repeat.every is None else math.inf], default=0.0)

    @cached_property
    def shear(self) -> Array:
        """Wh that waiting for a second takes, where something may have to wait. Shape (1 + batteries,)."""
        return np.append(0.0, self.waiting[1:] * float(self.waits_until > 0.0))

    @cached_property
    def waiting(self) -> Array:
        """Seconds and Wh of waiting for a second. Shape (1 + batteries,)."""
        wait = WaitSegment.model_construct(kind="wait", duration=Parameter(1.0, unit="s"))
        leg = next(legs_of(self.physics.mission, [(self.task.start, wait)]))[0]
        return np.concatenate([[1.0], self.physics.standing_wh(leg.settings, 3600.0) / 3600.0])


def make_site(task: TaskSpec, order: Order | None = None, physics: Physics | None = None) -> Site:
    """Stops with their costs; roads are made when they are asked for. `physics`: of a task that differs from this one
    in its stops alone. Raises InputError: where the task asks for what is not planned: turning at places."""
    if task.defaults.turn_at_places:
        where, told = ("defaults", "turn_at_places"), "turning at places is not planned"
        raise InputError(task.document.fault(where, told, allowed="turn_at_places: false"))
    physics = physics or Physics(task)
    energy, time = task.weights()
    weights = np.array([time, *(energy[name] for name in physics.names)])
    ends = [task.within.deadline, None if task.repeat is None else task.repeat.until]
    deadline = min((end.value for end in ends if end is not None), default=math.inf)
    stops = [Stop(task.start)]
    for i, visit in enumerate(task.visits):
        lasting = visit.inspect or visit.wait
        stops.append(Stop(visit.place, 0.0 if lasting is None else lasting.value, i))
    stops.append(Stop(task.goal))
    full = RechargeSpec.model_construct(until=Parameter(1.0), batteries=())
    dock = DockSegment.model_construct(kind="dock", recharge=full)
    levels = task.choose.charge
    chosen = None if levels == "any" else tuple(sorted({level.value for level in levels}))
    for place, (leg, *_) in zip(task.docks, legs_of(physics.mission, [(p, dock) for p in task.docks]), strict=True):
        assert leg.recharge is not None
        draw = physics.standing_wh(leg.settings, 3600.0)
        served = np.array([name in leg.recharge.batteries for name in physics.names])
        power = np.array([leg.recharge.power_w.get(name, 0.0) for name in physics.names])
        gain = np.where(served, power - draw, -draw)
        tapers = tuple(
            tuple((upper, float(min(gain[b], part * power[b]))) for upper, part in battery.taper) if served[b] else ()
            for b, battery in enumerate(physics.setup.batteries.values())
        )
        charger = Charger(gain, draw, served, physics.capacity_wh, levels=chosen, tapers=tapers)
        stops.append(Stop(place, charger=charger))
    return Site(task, physics, order or Order(task), stops, deadline, weights)
