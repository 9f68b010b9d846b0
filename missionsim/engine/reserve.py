"""Ways to a dock, and the energy to come home from where segments end (Parasuraman 2012, Eqs. 11–13)."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.meter import Asked, Batch, Evaluating, alarms_in
from missionsim.engine.recorder import Row
from missionsim.inputs.mission import MissionSpec
from missionsim.physics import Value
from missionsim.physics.lag import GOES_ON, SETTLED
from missionsim.plan.kinematics import group
from missionsim.plan.legs import Leg, Limits, OnEdge, units_on
from missionsim.plan.routes import Routes, Way, along

if TYPE_CHECKING:
    from missionsim.engine.world import World


class Homing:
    """Ways to the dock of a mission.

    The dock is the policy's; without one the nearest place with a charger; without any charger the place where the
    mission starts. The way is the shortest by length, driven with the scheme, sensors, payload, stretch and asked
    speed of the last leg that drove (the defaults before the first). `routes`: None without an environment: then there
    is no way home.
    """

    def __init__(self, mission: MissionSpec, limits: Limits, routes: Routes | None) -> None:
        self.limits = limits
        self.routes = routes
        self._start = mission.start or ""
        self.docks: tuple[str, ...] = ()
        self._found: dict[str, list[Way] | None] = {}
        if routes is None or mission.environment is None:
            return
        start = (mission.start,) if mission.start else ()
        self.docks = (mission.policy.dock,) if mission.policy.dock else mission.environment.chargers or start

    def ways(self, place: str) -> list[Way] | None:
        """Shortest way from a place to a dock; None where there is none or the place is not known."""
        if self.routes is None or place not in self.routes.ways:
            return None
        if place not in self._found:
            found = [way for dock in self.docks if (way := self.routes.shortest(place, dock)) is not None]
            self._found[place] = min(found, key=_length, default=None)
        return self._found[place]

    def excursion(
        self, last: Leg | None, done_m: float, like: Leg, docks: Sequence[str], *, back: bool, stands: bool
    ) -> tuple[list[Leg], str, list[Leg], bool] | None:
        """The way to the nearest of some docks, and back to where the robot left the plan.

        From an edge under way it goes on to its end or back to its beginning, whichever is shorter in all; one that
        stands comes back to the same place. `last`: the leg that is driven, or that was the last to be; None at the
        mission's start. `done_m`: metres on it when the robot stands. `like`: how the ways are driven. `back`: whether
        the way back counts; there is none otherwise. `stands`: whether the robot stands rather than drives. Gives legs
        to the dock, the dock, legs back, and whether they lead to the end of the edge under way. None where the place
        is not known or no way leads there.
        """
        if self.routes is None:
            return None
        starts: list[tuple[str, list[Leg], list[Leg], bool]] = []
        if last is None:
            starts.append((self._start, [], [], False))
        elif last.kind == "roll" and last.edge is not None and last.distance_m > 0.0:
            edge = last.edge
            here = min(edge.from_m + (edge.to_m - edge.from_m) * done_m / last.distance_m, edge.to_m)
            ways = [way for place in edge[:2] for way in self.routes.ways[place] if way.edge == edge.edge]
            for way in ways:
                on = way.end == edge.end
                metres = way.length_m - here if on else here
                first = [_leg(like, way, way.length_m - metres)] if metres > 0.0 else []
                again = [_leg(like, other, 0.0, metres) for other in ways if other.end != way.end]
                if not (back and stands):  # it need not come back to the very place
                    starts.append((way.end, first, [], on))
                elif on and (again or not first):
                    starts.append((way.end, first, again[:1] if first else [], on))
        best: tuple[list[Leg], str, list[Leg], bool] | None = None
        least = math.inf
        for begin, first, again, on in starts:
            for dock in docks:
                out, home = self.routes.shortest(begin, dock), self.routes.shortest(dock, begin) if back else []
                if out is None or home is None:
                    continue
                length = _length(out) + _length(home) + math.fsum(leg.distance_m for leg in first)
                if length < least:
                    least = length
                    way_back = [*(_leg(like, way) for way in home), *again]
                    best = [*first, *(_leg(like, way) for way in out)], dock, way_back, on
        return best


def _leg(like: Leg, way: Way, from_m: float = 0.0, to_m: float | None = None) -> Leg:
    base = like.beside or like.settings  # an edge's own floor, slope, conditions and speed limit end with it
    pace = like.pace._replace(way=way.max_speed_m_s)
    edge = OnEdge(way.begin, way.end, way.edge, from_m, way.length_m if to_m is None else to_m)
    return Leg(
        "roll",
        along(base, way),
        (edge.to_m - edge.from_m) * _stretch(like),
        pace.speed,
        instant=like.instant,
        place=way.end,
        edge=edge,
        beside=base,
        pace=pace,
    )


def _stretch(leg: Leg) -> float:
    """Metres driven for each of the map."""
    return 1.0 if leg.edge is None else leg.distance_m / (leg.edge.to_m - leg.edge.from_m)


def _length(ways: Sequence[Way]) -> float:
    return math.fsum(way.length_m for way in ways)


def home_energies(
    world: World, homing: Homing, model: PowerModel, values: Mapping[str, Value], only_last: bool = False
) -> Evaluating[tuple[list[dict[str, float | None]], set[str]]]:
    """What coming home from the end of each segment takes out of each battery [Wh], with what it loses inside.

    `world`: after its execution. `values`: parameters that differ from the model's. `only_last`: only from where the
    robot is at the end; the list then has one entry. Gives one entry a segment, whose values are None where no way home
    is known; and the batteries that are empty before the robot is home from the last end.

    The way is driven at once (nothing to wait for), with the components of the last leg that drove and what is always
    on; activities beside the mission are taken as over.
    """
    legs, ends_s, last_row, meter = world.legs, world.ends_s, world.recorder.rows[-1:], world.meter
    ends = {leg.segment: index for index, leg in enumerate(legs) if leg.last}
    # of each leg, itself or the last one before it that drives; before the first such, that one
    drive = next((leg for leg in legs if leg.kind == "roll"), None)
    driven_at = [drive := leg if leg.kind == "roll" else drive for leg in legs]
    lags = {
        name: np.append(np.concatenate([batch.line.lags[name] for batch in meter.batches])[1:], end)
        for name, end in meter.lags.items()
    }
    last_rows = {legs[row.leg].segment: i for i, row in enumerate(world.recorder.rows)}
    ways: dict[Any, list[Leg]] = {}
    keys: list[Any] = []
    begins_s = [row.start_s for row in world.recorder.rows]
    charges = {
        name: np.concatenate([[battery.initial], *(batch.states[name] for batch in meter.batches)])
        for name, battery in meter.batteries.items()
    }
    states: list[dict[str, float]] = []
    for segment in [legs[row.leg].segment for row in last_row] if only_last else range(len(world.segments)):
        end, ended = ends.get(segment, -1), segment in ends_s
        if only_last and not ended:
            # stopped within a segment: the place is known where the robot stood
            end = last_row[0].leg
            ended = legs[end].kind != "roll"
        driven, place, key = driven_at[end], legs[end].place, None
        if end >= 0 and ended and driven is not None and (home := homing.ways(place)) is not None:
            last, clock = last_rows.get(segment), 0.0
            if last is not None and "moving_time_s" in model.memory:
                row = world.recorder.rows[last]
                clock = row.moving_time_s + (row.duration_s if row.phase.moving else 0.0)
            # rounds that are repeated have the same ways home
            warm = () if last is None else tuple(float(values[last]) for values in lags.values())
            key = place, driven.beside or driven.settings, driven.pace, _stretch(driven), driven.instant, warm, clock
            if key not in ways:
                ways[key] = [_leg(driven, way) for way in home]
        keys.append(key)
        closed = bisect_left(begins_s, ends_s.get(segment, math.inf))
        states.append({name: float(charge[closed]) for name, charge in charges.items()})
    energy = {name: np.zeros(len(ways)) for name in meter.batteries}
    asked, owner = _rows(world, homing, ways, values)
    if lags and owner:
        first = np.diff(owner, prepend=-1) > 0
        begins = np.array([key[-2] or [SETTLED] * len(lags) for key in ways])[owner]
        begin = {name: np.where(first, begins[:, i], GOES_ON) for i, name in enumerate(lags)}
        asked = asked._replace(lags=begin)
    answer = (yield asked) if asked.rows else None
    if answer is not None:
        for name, terms in answer.energies.items():
            for joules in terms.values():
                energy[name] += np.bincount(owner, weights=joules, minlength=len(ways))
    number = {key: i for i, key in enumerate(ways)}
    result: list[dict[str, float | None]] = [
        {name: None if key is None else float(energy[name][number[key]]) / 3600.0 for name in energy} for key in keys
    ]
    inner = [name for name, battery in meter.batteries.items() if not isinstance(battery, ConstantEnergy)]
    empty: set[str] = set()
    for entry, key, state in zip(result, keys, states, strict=True):
        last = entry is result[-1]
        low, high = (0, 0) if key is None else (bisect_left(owner, number[key] + i) for i in (0, 1))
        if answer is None or low == high or not (inner or last):
            continue
        part = answer.part(low, high)
        loads = meter.loads(asked.rows[low:high], part)
        after = {name: meter.batteries[name].after(state[name], loads[name]) for name in (loads if last else inner)}
        for name in inner:
            out = meter.batteries[name].charge_j(np.array([state[name], after[name][-1]]))
            entry[name] = float(out[0] - out[1]) / 3600.0
        if last:
            batch = Batch(*part, loads, state, after)
            empty = {name for name, battery in meter.batteries.items() if alarms_in(battery, batch, name)}
    return result or [dict.fromkeys(energy)], empty


def _rows(
    world: World, homing: Homing, ways: Mapping[Any, list[Leg]], values: Mapping[str, Value]
) -> tuple[Asked, list[int]]:
    """Rows of all ways home, and the number of the way that each belongs to."""
    legs: list[Leg] = []
    rows: list[Row] = []
    owner: list[int] = []
    states: dict[tuple[float, ...], int] = {}
    for number, (key, way) in enumerate(ways.items()):
        if not way:
            continue
        now, base = 0.0, len(legs)
        on = units_on(world.board.infos, way[0].settings.sensors)
        state = states.setdefault((*on, *([0.0] * (2 * len(on)))), len(states))
        for step in group(way, homing.limits):
            for phase in step.phases:
                if phase.duration_s > 0.0:
                    leg, moving_s = base + phase.leg, key[-1] + now
                    rows.append(Row(now, phase.duration_s, leg, phase, 0.0, state, moving_s, now == 0.0, ()))
                    owner.append(number)
                    now += phase.duration_s
        legs += way
    return Asked(rows, legs, list(states), values), owner
