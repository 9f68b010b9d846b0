"""The graph of stops: which visit comes next, by which drive, and where batteries are charged."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.inputs.segments import DockSegment, InspectSegment, RechargeSpec, WaitSegment
from missionsim.inputs.task import TaskSpec, VisitSpec
from missionsim.inputs.values import Parameter
from missionsim.plan.build import legs_of
from missionsim.plan.legs import Leg
from missionsim.planner.core import Leaving
from missionsim.planner.drives import Drive, Drives
from missionsim.planner.orders import Order
from missionsim.planner.physics import Physics
from missionsim.planner.pieces import FREE, ROLLED, STOPPED, State, make_road, pieces_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stop:
    """A place where the robot stands: the start, a visit, the goal or a dock.

    Attributes
    ----------
    place : str
    use : ndarray, shape (1 + batteries,)
        Seconds and Wh of what is done there.
    visit : int or None
        Of the task.
    charger : Charger or None
    """

    place: str
    use: Array
    visit: int | None = None
    charger: Charger | None = None


@dataclass(frozen=True, eq=False)
class Charger:
    """What charging at a dock does to the vector (objective, seconds, Wh missing of each battery, …).

    Attributes
    ----------
    gain_w : ndarray, shape (batteries,)
        What comes in less what the robot draws, before the charge tapers off; 0 or less where it is not charged.
    draw_w : ndarray, shape (batteries,)
        What the robot draws while docked.
    served : ndarray of bool, shape (batteries,)
    capacity_wh : ndarray, shape (batteries,)
    rate : float
        Objective for a second at the dock.
    levels : tuple of float or None
        Fractions that may be charged to; None for any.
    tapers : tuple of (tuple of (level, gain))
        Of each battery, up to which fraction of its capacity what comes in less what the robot draws [W].
    """

    gain_w: Array
    draw_w: Array
    served: NDArray[np.bool_]
    capacity_wh: Array
    rate: float
    levels: tuple[float, ...] | None = None
    tapers: tuple[tuple[tuple[float, float], ...], ...] = ()

    def after(self, x: Array, seconds: float, level: float = 1.0) -> Array:
        """The vector after charging for some time, batteries held at a level once there."""
        made = x.copy()
        made[0] += self.rate * seconds
        made[1] += seconds
        count = len(self.gain_w)
        missing = x[2 : 2 + count]
        floor = (1.0 - level) * self.capacity_wh
        charged = np.array([self._charged(b, float(missing[b]), seconds) for b in range(count)])
        charged = np.maximum(charged, np.minimum(floor, missing))
        made[2 : 2 + count] = np.where(self.served, charged, missing + self.draw_w * seconds / 3600.0)
        return made

    def _charged(self, battery: int, missing: float, seconds: float) -> float:
        """What a battery lacks after charging for some time [Wh]."""
        capacity, left = float(self.capacity_wh[battery]), seconds
        for upper, gain in self.tapers[battery]:
            there = (1.0 - upper) * capacity
            if missing <= there:
                continue
            needed = (missing - there) * 3600.0 / gain if gain > 0.0 else math.inf
            if needed >= left:
                return missing - gain * left / 3600.0
            missing, left = there, left - needed
        return missing

    def seconds_to(self, x: Array, level: float | Array) -> Array:
        """Time until each battery served is at a level, shape (batteries,); infinite where it never is."""
        count = len(self.gain_w)
        made = np.zeros(count)
        for b, asked in enumerate(np.broadcast_to(level, count).tolist()):
            missing, capacity = float(x[2 + b]), float(self.capacity_wh[b])
            if not self.served[b]:
                continue
            for upper, gain in self.tapers[b]:
                there = (1.0 - min(upper, asked)) * capacity
                if missing > there:
                    made[b] += (missing - there) * 3600.0 / gain if gain > 0.0 else math.inf
                    missing = there
                if upper >= asked:
                    break
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
                    made.append(self.after(x, seconds, level)[None, :])
            return made
        levels = sorted({upper for taper in self.tapers for upper, _ in taper})
        times = np.concatenate([self.seconds_to(x, level) for level in levels])
        knots = sorted({float(t) for t in times if 0.0 < t < math.inf})
        return [np.array([x, *(self.after(x, t) for t in knots)])] if knots else []


@dataclass
class Site:
    """Everything about a task that does not depend on what is chosen: stops, roads by payload, costs.

    Attributes
    ----------
    stops : list of Stop
        First the start, then the visits, the goal, the docks.
    deadline_s : float
    weights : ndarray, shape (1 + batteries,)
        Of seconds and Wh in the objective.
    waiting : ndarray, shape (1 + batteries,)
        Seconds and Wh of waiting for a second.
    """

    task: TaskSpec
    physics: Physics
    order: Order
    stops: list[Stop] = field(default_factory=list)
    deadline_s: float = math.inf
    weights: Array = field(default_factory=lambda: np.zeros(0))
    roads: dict[float, Drives] = field(default_factory=dict)
    nodes: dict[float, tuple[NDArray[np.intp], NDArray[np.intp]]] = field(default_factory=dict)
    _standing: dict[tuple[int, float], Array] = field(default_factory=dict)

    @property
    def goal(self) -> int:
        """Number of the stop that ends the mission."""
        return len(self.task.visits) + 1

    def road(self, payload_kg: float) -> Drives:
        """The road under a load, made when first asked for."""
        if payload_kg not in self.roads:
            physics, stops = self.physics, self.stops
            leaving = [_leaving(physics, stop, i) for i, stop in enumerate(stops)]
            road = make_road(physics, pieces_of(self.task, physics, payload_kg), leaving)
            self.roads[payload_kg] = Drives(road)
            out = np.array([road.index[state] for state in leaving], dtype=np.intp)
            into = np.array([road.index[State(stop.place, 0.0, STOPPED)] for stop in stops], dtype=np.intp)
            self.nodes[payload_kg] = out, into
        return self.roads[payload_kg]

    def standing(self, number: int, payload_kg: float) -> Array:
        """Seconds and Wh of what is done at a stop under a load, shape (1 + batteries,)."""
        stop = self.stops[number]
        if stop.visit is None:
            return stop.use
        key = (number, payload_kg)
        if key not in self._standing:
            segment = visit_segment(self.task.visits[stop.visit], payload_kg)
            legs = next(legs_of(self.physics.mission, [(stop.place, segment)]))
            self._standing[key] = _standing(self.physics, legs)
        return self._standing[key]

    def objective(self, use: Array) -> Array:
        """Weighted seconds and Wh."""
        return np.asarray(use @ self.weights)

    @property
    def windowed(self) -> bool:
        """Whether some visit must begin within a window."""
        return any(visit.window is not None for visit in self.task.visits)

    @cached_property
    def waiting(self) -> Array:
        """Seconds and Wh of waiting for a second."""
        wait = WaitSegment.model_construct(kind="wait", duration=Parameter(1.0, unit="s"))
        leg = next(legs_of(self.physics.mission, [(self.task.start, wait)]))[0]
        return np.concatenate([[1.0], self.physics.standing_wh(leg.settings, 3600.0) / 3600.0])


def _leaving(physics: Physics, stop: Stop, number: int) -> State:
    """The state in which the robot drives off: at rest, unless it never stood (which only starts cost)."""
    stood = number == 0 or stop.charger is not None or stop.use[0] > 0.0 or not physics.impulsive
    return State(stop.place, 0.0, FREE if stood else ROLLED)


def visit_segment(visit: VisitSpec, payload_kg: float) -> Any:
    """The segment of a mission in which a visit is made."""
    common: dict[str, Any] = {
        "scheme": visit.scheme,
        "navigation": visit.navigation,
        "sensors": visit.sensors,
        "payload": Parameter(payload_kg, unit="kg"),
        "name": visit.label,
    }
    if visit.inspect is not None:
        return InspectSegment.model_construct(kind="inspect", duration=visit.inspect, **common)
    duration = visit.wait if visit.wait is not None else Parameter(0.0, unit="s")
    return WaitSegment.model_construct(kind="wait", duration=duration, **common)


def make_site(task: TaskSpec, order: Order | None = None) -> Site:
    """Stops with their costs; roads are made when they are asked for.

    Raises
    ------
    missionsim.errors.InputError
        Where the task asks for what is not planned: turning at places.
    """
    order = order or Order(task)
    if task.defaults.turn_at_places:
        raise _refused(task, "turning at places is not planned", "turn_at_places: false", "defaults", "turn_at_places")
    physics = Physics(task)
    energy, time = task.weights()
    weights = np.array([time, *(energy[name] for name in physics.names)])
    deadline = math.inf if task.within.deadline is None else task.within.deadline.value
    site = Site(task, physics, order, deadline_s=deadline, weights=weights)
    nothing = np.zeros(1 + len(physics.names))
    site.stops.append(Stop(task.start, nothing))
    stands = [(visit.place, visit_segment(visit, 0.0)) for visit in task.visits]
    for i, legs in enumerate(legs_of(physics.mission, stands)):
        site.stops.append(Stop(task.visits[i].place, _standing(physics, legs), i))
    site.stops.append(Stop(task.goal, nothing))
    dock = DockSegment.model_construct(
        kind="dock", recharge=RechargeSpec.model_construct(until=Parameter(1.0), batteries=())
    )
    for place, legs in zip(task.docks, legs_of(physics.mission, [(place, dock) for place in task.docks]), strict=True):
        site.stops.append(Stop(place, nothing, None, _charger(site, legs[0])))
    return site


def _refused(task: TaskSpec, message: str, allowed: str, *where: str) -> InputError:
    return InputError(task.document.fault(where, message, allowed=allowed))


def _standing(physics: Physics, legs: list[Leg]) -> Array:
    use = np.zeros(1 + len(physics.names))
    for leg in legs:
        use[0] += leg.duration_s
        use[1:] += physics.standing_wh(leg.settings, leg.duration_s)
    return use


def _charger(site: Site, leg: Leg) -> Charger:
    physics = site.physics
    assert leg.recharge is not None
    draw = physics.standing_wh(leg.settings, 3600.0)
    served = np.array([name in leg.recharge.batteries for name in physics.names])
    power = np.array([leg.recharge.power_w.get(name, 0.0) for name in physics.names])
    rate = float(site.objective(np.array([1.0, *(draw / 3600.0)])))
    levels = site.task.choose.charge
    chosen = None if levels == "any" else tuple(sorted({level.value for level in levels}))
    gain = np.where(served, power - draw, -draw)
    tapers = tuple(
        tuple((upper, float(min(gain[b], part * power[b]))) for upper, part in battery.taper) if served[b] else ()
        for b, battery in enumerate(physics.setup.batteries.values())
    )
    return Charger(gain, draw, served, physics.capacity_wh, rate, chosen, tapers)


class Tour:
    """Network of the core: a node is a state of the order and a stop; resources are objective, time, Wh missing.

    Parameters
    ----------
    site : Site
    drives : callable
        ``(payload, from stop, to stop) -> list of Drive``.
    missed : ndarray, optional
        Value of each visit, where some may be left out: then one more resource counts what was left out.
    by_value : bool
        What was left out is the objective.
    """

    def __init__(
        self,
        site: Site,
        drives: Callable[[float, int, int], list[Drive]],
        missed: Array | None = None,
        *,
        by_value: bool = False,
    ) -> None:
        self.site = site
        self.size = len(site.stops)
        self.nodes = site.order.count * self.size
        self._drives = drives
        self._missed = missed
        self._by_value = by_value
        self._known: dict[int, Leaving] = {}
        self._batteries = len(site.physics.names)

    def start(self) -> Array:
        """The vector at the start, shape (1, resources)."""
        missing = self.site.physics.missing_wh()
        extra = [] if self._missed is None else [0.0]
        return np.array([[0.0, 0.0, *missing, *extra]])

    def is_goal(self, node: int) -> bool:
        """Whether the mission ends here."""
        return node % self.size == self.site.goal

    def leaving(self, node: int) -> Leaving:
        """Drives to all stops that may come next."""
        known = self._known.get(node)
        if known is None:
            known = self._known[node] = self._make(node)
        return known

    def refill(self, node: int) -> Charger | None:
        """The charger of a dock."""
        return self.site.stops[node % self.size].charger

    def opens(self, node: int) -> Callable[[Array], Array] | None:
        """Waiting at a visit until its window opens."""
        visit = self.site.stops[node % self.size].visit
        window = None if visit is None else self.site.task.visits[visit].window
        if window is None or window.from_.value <= 0.0:
            return None
        state = node // self.size
        stand = float(self.site.standing(node % self.size, self.site.order.payload_kg(state))[0])
        begin, waiting = window.from_.value + stand, self.waiting()

        def wait(points: Array) -> Array:
            kept = [points[0]]
            for first, second in itertools.pairwise(points):
                if first[1] < begin < second[1]:
                    kept.append(first + (begin - first[1]) / (second[1] - first[1]) * (second - first))
                kept.append(second)
            made = np.array(kept)
            return np.asarray(made + np.maximum(begin - made[:, 1:2], 0.0) * waiting)

        return wait

    def waiting(self) -> Array:
        """What waiting for a second adds to the vector."""
        waiting = self.site.waiting
        extra = [] if self._missed is None else [0.0]
        return np.array([float(self.site.objective(waiting)), *waiting, *extra])

    def nexts(self, state: int, stop: int) -> list[tuple[int, int]]:
        """Stops that may come next and the state after each."""
        site = self.site
        if stop == site.goal:
            return []
        found = [(1 + visit, after) for visit, after in site.order.after(state)]
        if site.order.may_end(state):
            found.append((site.goal, state))
        found += [(dock, state) for dock in range(site.goal + 1, self.size) if dock != stop]
        return found

    def _make(self, node: int) -> Leaving:
        state, stop = divmod(node, self.size)
        site = self.site
        payload = site.order.payload_kg(state)
        heads: list[int] = []
        use: list[Array] = []
        moves: list[Any] = []
        for head, after in self.nexts(state, stop):
            for drive in self._drives(payload, stop, head):
                use.append(self.arc_use(drive, head, after))
                heads.append(after * self.size + head)
                moves.append((head, drive, use[-1]))
        width = 2 + self._batteries + (self._missed is not None)
        return Leaving(np.array(heads, dtype=np.intp), np.array(use).reshape(len(heads), width), moves)

    @property
    def valued(self) -> bool:
        """Whether some visits may be left out."""
        return self._missed is not None

    def arc_use(self, drive: Drive, head: int, after: int) -> Array:
        """What driving to a stop and what is done there add to the vector."""
        site = self.site
        total = drive.use + site.standing(head, site.order.payload_kg(after))
        if self._missed is None:
            return np.array([float(site.objective(total)), *total])
        left_out = 0.0
        if head == site.goal:
            left_out = float(self._missed.sum() - self._missed[self._done(after)].sum())
        return np.array([left_out if self._by_value else float(site.objective(total)), *total, left_out])

    def _done(self, state: int) -> list[int]:
        return self.site.order.done(state)
