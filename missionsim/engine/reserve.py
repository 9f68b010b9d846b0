"""Energy to come home from where segments end (Parasuraman 2012, Eqs. 11–13)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.engine.meter import Asked, Evaluating
from missionsim.engine.recorder import Row
from missionsim.physics import Value
from missionsim.plan.homing import Homing, last_driven
from missionsim.plan.legs import Leg
from missionsim.plan.steps import group

if TYPE_CHECKING:
    from missionsim.engine.world import World


def home_energies(
    world: World, homing: Homing, model: PowerModel, values: Mapping[str, Value], only_last: bool = False
) -> Evaluating[list[dict[str, float | None]]]:
    """Energy in Wh to come home from the end of each segment, by battery.

    `world`: after its execution. `values`: parameters that differ from the model's. `only_last`: only from where the
    robot is at the end; the list then has one entry. Gives one entry a segment; values are None where no way home is
    known.

    The way is driven at once (nothing to wait for), with the components of the last leg that drove and what is always
    on; activities beside the mission are taken as over.
    """
    legs, ends_s, last_row = world.legs, world.ends_s, world.recorder.rows[-1:]
    ends = {leg.segment: index for index, leg in enumerate(legs) if leg.last}
    moved, driven_at = _moving_times(world), last_driven(legs)
    ways: dict[Any, list[Leg]] = {}
    keys: list[Any] = []
    for segment in [legs[row.leg].segment for row in last_row] if only_last else range(len(world.segments)):
        end, ended = ends.get(segment, -1), segment in ends_s
        if only_last and not ended:
            # stopped within a segment: the place is known where the robot stood
            end = last_row[0].leg
            ended = legs[end].kind != "roll"
        driven, place, key = driven_at[end], legs[end].place, None
        if end >= 0 and ended and driven is not None and homing.ways(place) is not None:
            clock = moved.get(segment, 0.0) if "moving_time_s" in model.memory else 0.0
            # rounds that are repeated have the same ways home
            key = place, driven.settings, driven.speed_m_s, driven.instant, clock
            if key not in ways:
                ways[key] = homing.from_place(place, driven) or []
        keys.append(key)
    batteries = model.batteries
    energy = {name: np.zeros(len(ways)) for name in batteries}
    asked, owner = _rows(world, homing, ways, values)
    if asked.rows:
        answer = yield asked
        for name, terms in answer.energies.items():
            for joules in terms.values():
                energy[name] += np.bincount(owner, weights=joules, minlength=len(ways))
    number = {key: i for i, key in enumerate(ways)}
    result: list[dict[str, float | None]] = [
        {name: None if key is None else float(energy[name][number[key]]) / 3600.0 for name in batteries} for key in keys
    ]
    return result or [dict.fromkeys(batteries)]


def _rows(
    world: World, homing: Homing, ways: Mapping[Any, list[Leg]], values: Mapping[str, Value]
) -> tuple[Asked, list[int]]:
    """Rows of all ways home, and the number of the way that each belongs to."""
    legs: list[Leg] = []
    rows: list[Row] = []
    owner: list[int] = []
    states: dict[tuple[float, ...], int] = {}
    always = {name: float(info.units) for name, info in world.board.infos.items() if info.always_on}
    for number, (key, way) in enumerate(ways.items()):
        if not way:
            continue
        now, base = 0.0, len(legs)
        units = {**world.board.closure(way[0].settings.sensors), **always}
        on = [float(units.get(name, 0)) for name in world.recorder.components]
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


def _moving_times(world: World) -> dict[int, float]:
    """Time moved until the end of each segment [s]."""
    return {
        world.legs[row.leg].segment: row.moving_time_s + (row.duration_s if row.phase.moving else 0.0)
        for row in world.recorder.rows
    }
