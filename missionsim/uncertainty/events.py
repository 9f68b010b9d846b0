"""Intervals of many runs whose events come in the order of the nominal run: phases, waits, components that start up.

The order is read off the nominal run by SimPy; here each run has its own instants. A run in which two events change
their order has an interval of negative length, and is given back to SimPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from missionsim.effects.covariates import Truth
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.meter import alone
from missionsim.engine.recorder import REST
from missionsim.engine.simulate import RunSetup
from missionsim.files import grouped
from missionsim.physics import Array, Value
from missionsim.plan.legs import Phase, Plan
from missionsim.uncertainty.matrices import PROGRESS_POINTS, Intervals, Progress

TIE_S = 1e-9
"""Instants that differ by less are one."""


class Part(NamedTuple):
    """Intervals over which no component changes."""

    leg: int
    phase: int | None
    """Which of the leg's phases, where something changes within the leg; None for all of them."""
    waits: bool
    """The robot stands before the leg until components are on."""
    on: tuple[float, ...]
    starting: tuple[float, ...]
    """Both: units of each component."""
    ready: tuple[int, ...]
    """Components whose start-up ends it; empty where its phases do."""


def parts_of(setup: RunSetup) -> tuple[Part, ...] | str:
    """The parts of a nominal run, or in words why its events cannot be followed."""
    plan, world = setup.plan, alone(setup.model, setup.names, setup.execute(()))
    end = world.recorder.row(world.env.now, 0.0)
    states, count = list(world.recorder.states), len(setup.names)
    found: list[Part] = []
    begun: dict[int, int] = {}
    for row in [*world.recorder.rows, end]:
        on, starting = states[row.state][:count], states[row.state][count : 2 * count]
        waits = row.phase is REST
        if not waits and row.elapsed_s == 0.0:
            begun[row.leg] = begun.get(row.leg, -1) + 1
        part = Part(row.leg, None if waits else begun[row.leg], waits, on, starting, ())
        if found:
            earlier = found[-1]
            if earlier == part and row is not end:
                continue  # a charger looks ahead only so far
            ready = tuple(c for c in range(count) if earlier.starting[c] and not starting[c])
            if ready and not earlier.waits and earlier[:3] != part[:3]:
                return "a component is ready at the very instant at which something else ends"
            found[-1] = earlier._replace(ready=ready)
        found.append(part)
    return tuple(_whole(plan, found))


def _whole(plan: Plan, found: list[Part]) -> list[Part]:
    """Each leg with one part, unless something changes within it; legs that take no time among them."""
    made: list[Part] = []
    by_leg = grouped(found[:-1], lambda part: part.leg)  # the last tells how it ends
    for leg in range(len(plan.legs)):
        mine = by_leg.get(leg, [])
        rests, drives = [p for p in mine if p.waits], [p for p in mine if not p.waits]
        like = drives or rests or made[-1:] or found[-1:]
        if len({(part.on, part.starting) for part in like}) == 1 or not drives:
            drives = [like[-1]._replace(leg=leg, phase=None, waits=False, ready=())]
        made += [*rests, *drives]
    return made


def phases_of(
    plan: Plan, nominal: Plan, parts: tuple[Part, ...], startup_s: Sequence[Value]
) -> tuple[list[Phase], list[int], Truth]:
    """The phases of many runs and what each is part of.

    `plan`: of many runs; `nominal`: from which `parts` are; `startup_s` (shape (runs,)): of each component. Gives
    phases, the part of each, and which runs have another order of events.
    """
    by_leg, usual = (
        grouped((phase for step in of.steps for phase in step.phases), lambda phase: phase.leg)
        for of in (plan, nominal)
    )

    def lasting(phase: Phase) -> Any:
        recharge = plan.legs[phase.leg].recharge
        return phase.duration_s if recharge is None else recharge.duration_s

    made: list[Phase] = []
    which: list[int] = []
    odd: Truth = False
    now: Value = 0.0
    switched: dict[int, Value] = {}
    begun: tuple[tuple[int, int], Value] = (-1, -1), 0.0
    before = (0.0,) * len(startup_s)
    for number, part in enumerate(parts):
        for c, units in enumerate(part.starting):
            if units and not before[c]:
                switched[c] = now
        before = part.starting
        ready = [switched[c] + startup_s[c] for c in part.ready]
        odd = odd | np.any([np.abs(one - ready[0]) > TIE_S for one in ready[1:]], axis=0) if ready[1:] else odd
        if part.waits:
            made.append(Phase(cast("float", np.maximum(ready[0] - now, 0.0)), part.leg))
            odd, now = odd | (ready[0] - now < -TIE_S), ready[0]
        elif part.phase is None:
            for phase in by_leg[part.leg]:
                made.append(phase._replace(duration_s=lasting(phase)))
                now = now + made[-1].duration_s
        else:
            known = by_leg[part.leg]
            if len(known) != len(usual[part.leg]):
                return made, which, True  # which phase it is in which something changes, is not known
            phase = known[part.phase]
            if begun[0] != (part.leg, part.phase):
                begun = (part.leg, part.phase), now
            end = ready[0] if ready else begun[1] + lasting(phase)
            lasts, odd = cast("float", np.maximum(end - now, 0.0)), odd | (end - now < -TIE_S)
            gone = cast("float", now - begun[1])
            phase = phase._replace(  # what is left of it
                duration_s=lasts,
                speed_m_s=phase.speed_m_s + phase.accel_m_s2 * gone,
                lateral_m_s=phase.lateral_m_s + phase.lateral_m_s2 * gone,
                yaw_rad_s=phase.yaw_rad_s + phase.yaw_rad_s2 * gone,
            )
            made.append(phase)
            now = end
        which += [number] * (len(made) - len(which))
    return made, which, odd


def charge_course(
    battery: ConstantEnergy, docked: list[int], intervals: Intervals, part: slice, used_j: Array, knots: Array
) -> tuple[Array, Array, Array]:
    """Energy left in a battery [J] that some intervals charge: at even instants, at the end, and the least of all.

    `battery`: with capacities and charges of the runs; `docked`: intervals at a charger that serves it; `used_j`,
    `knots`: energy delivered, and instants between the intervals.
    """
    left, times = [np.broadcast_to(battery.initial, knots.shape[1:])], [knots[0]]
    for i, used in enumerate(used_j):
        if i not in docked:
            left.append(left[-1] - used)
            times.append(knots[i + 1])
            continue
        recharge, lasts = intervals.legs[i].recharge, knots[i + 1] - knots[i]
        assert recharge is not None
        power = np.asarray(recharge.power_w[battery.name])
        power = np.broadcast_to(power if power.ndim == 0 else power[part], lasts.shape)
        draw = used / np.where(lasts > 0.0, lasts, 1.0)
        for after, state in battery.charging(left[-1], power, draw, lasts):
            left.append(state)
            times.append(knots[i] + after)
    course = np.array(left)
    return Progress(np.array(times), PROGRESS_POINTS)(course), course[-1], course.min(axis=0)
