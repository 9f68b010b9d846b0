"""Energy to come home from where segments end (Parasuraman 2012, Eqs. 11–13)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.engine.meter import Asked, Evaluating
from missionsim.engine.recorder import Row
from missionsim.plan.homing import Homing, last_driven
from missionsim.plan.legs import Leg
from missionsim.plan.steps import group

if TYPE_CHECKING:
    from missionsim.engine.world import World


def home_energies(
    world: World, homing: Homing, model: PowerModel, values: Mapping[str, Any], only_last: bool = False
) -> Evaluating[list[dict[str, float | None]]]:
    """Energy in Wh to come home from the end of each segment, by battery.

    Parameters
    ----------
    world : World
        After its execution.
    homing : Homing
    model : PowerModel
    values : mapping
        Parameters that differ from the model's.
    only_last : bool
        Only from where the robot is at the end; the list then has one entry.

    Returns
    -------
    list of dict
        One entry a segment; values are None where no way home is known.

    Notes
    -----
    The way is driven at once (nothing to wait for), with the components of the last leg that drove and what is
    always on; activities beside the mission are taken as over.
    """
    legs: list[Leg] = []
    rows: list[Row] = []
    states: dict[tuple[float, ...], int] = {}
    owner: list[int] = []
    ends = [-1] * len(world.segments)
    for index, leg in enumerate(world.legs):
        if leg.last:
            ends[leg.segment] = index
    wanted = list(range(len(world.segments)))
    if only_last:
        wanted = [world.legs[world.recorder.rows[-1].leg].segment] if world.recorder.rows else []
    moved = _moving_times(world)
    driven_at = last_driven(world.legs)
    known: list[bool] = []
    cache: dict[Any, int] = {}
    same: list[int] = []
    for position, segment in enumerate(wanted):
        end = ends[segment]
        ended = segment in world.ends_s
        if only_last and not ended:
            # stopped within a segment: the place is known where the robot stood
            end = world.recorder.rows[-1].leg
            ended = world.legs[end].kind != "roll"
        driven = driven_at[end]
        place = world.legs[end].place
        reachable = end >= 0 and ended and driven is not None and homing.ways(place) is not None
        known.append(reachable)
        if driven is None or not reachable:
            same.append(position)
            continue
        clock = moved.get(segment, 0.0) if "moving_time_s" in model.memory else 0.0
        # rounds that are repeated have the same ways home
        key = (place, driven.settings, driven.speed_m_s, driven.instant, clock)
        same.append(cache.setdefault(key, position))
        if same[-1] == position and (way := homing.from_place(place, driven)):
            _append(world, homing, way, clock, legs, rows, states, owner, position)
    batteries = model.batteries
    totals = {name: np.zeros(max(1, len(wanted))) for name in batteries}
    if rows:
        answer = yield Asked(rows, legs, list(states), values)
        for name, terms in answer.energies.items():
            for joules in terms.values():
                totals[name] += np.bincount(np.array(owner), weights=joules, minlength=len(wanted))
    result: list[dict[str, float | None]] = [
        {name: float(totals[name][same[i]]) / 3600.0 if known[i] else None for name in batteries}
        for i in range(len(wanted))
    ]
    return result or [dict.fromkeys(batteries)]


def _append(
    world: World,
    homing: Homing,
    way: list[Leg],
    clock: float,
    legs: list[Leg],
    rows: list[Row],
    states: dict[tuple[float, ...], int],
    owner: list[int],
    position: int,
) -> None:
    """Rows of one way home."""
    base = len(legs)
    legs.extend(way)
    now, first = 0.0, True
    units = dict(world.board.closure(way[0].settings.sensors))
    units |= {name: info.units for name, info in world.board.infos.items() if info.always_on}
    on = [float(units.get(name, 0)) for name in world.recorder.components]
    width = len(on)
    state = states.setdefault((*on, *([0.0] * (2 * width))), len(states))
    for step in group(way, homing.limits):
        for phase in step.phases:
            if phase.duration_s <= 0.0:
                continue
            rows.append(Row(now, phase.duration_s, base + phase.leg, phase, 0.0, state, clock + now, first, ()))
            owner.append(position)
            now += phase.duration_s
            first = False


def _moving_times(world: World) -> dict[int, float]:
    """Time moved until the end of each segment [s]."""
    result: dict[int, float] = {}
    for row in world.recorder.rows:
        segment = world.legs[row.leg].segment
        result[segment] = row.moving_time_s + (row.duration_s if row.phase.moving else 0.0)
    return result
