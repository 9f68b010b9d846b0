"""Intervals of many runs whose events come in the order of the nominal run, as matrices of runs × intervals.

The order is read off the nominal run by SimPy; here each run has its own instants. A run in which two events change
their order has an interval of negative length, and is given back to SimPy.

Matrices are kept in Fortran order here and in `arrays`: the runs of one interval lie side by side, so that what holds
for an interval meets them as one number, and sums over intervals add whole rows.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np

from missionsim.effects.covariates import Columns, Covariates, Labels, Truth
from missionsim.effects.timeline import Timeline
from missionsim.engine.batteries import ConstantEnergy, greatest_fall
from missionsim.engine.meter import alone
from missionsim.engine.recorder import REST
from missionsim.engine.simulate import RunSetup
from missionsim.files import grouped
from missionsim.physics import Array, Ints, Value
from missionsim.plan.legs import Leg, Phase, Plan, covariates_of, table

_RATE = "d/dt "
PROGRESS_POINTS = 21
"""Charge of each battery is kept at so many instants, evenly over a run's duration."""


def running_sum(rows: Array) -> Array:
    """Sums of the rows before each row, and of all: shape (k, n) → (k + 1, n)."""
    sums = np.empty((len(rows) + 1, rows.shape[1]))
    sums[0] = 0.0
    for i, row in enumerate(rows):
        np.add(sums[i], row, out=sums[i + 1])
    return sums


class Progress:
    """Linear interpolation at even parts of each run's duration.

    `knots` (shape (k, runs)): instants from 0 that do not decrease along a run, the last one its duration; `points`:
    how many parts, with both ends.
    """

    def __init__(self, knots: Array, points: int) -> None:
        last, count = len(knots) - 1, knots.shape[1]
        total = knots[-1]
        column = np.arange(count)
        # the first of the even instants that a knot does not come after, counted, tells the knots before each of them
        place = knots[1:] * ((points - 1) / np.where(total > 0.0, total, 1.0))
        np.ceil(place, out=place)
        place *= count
        place += column
        passed = np.bincount(place.astype(np.intp).ravel(), minlength=points * count)
        at = np.empty((points - 2, count), dtype=np.intp)
        before = passed[:count].copy()
        for g in range(1, points - 1):
            before += passed[g * count : (g + 1) * count]
            np.minimum(before, last - 1, out=at[g - 1])
        at *= count
        at += column
        self.at, self.after, self.points = at, at + count, points
        flat = knots.ravel()
        begin, length = flat.take(at), flat.take(self.after)
        length -= begin
        part = np.multiply.outer(np.arange(1, points - 1) / (points - 1), total)
        part -= begin
        if not length.all():
            part = np.where(length > 0.0, part, 1.0)
            length = np.where(length > 0.0, length, 1.0)
        part /= length
        self.part = np.clip(part, 0.0, 1.0, out=part)

    def __call__(self, values: Array) -> Array:
        """Values at the even instants, shape (points, runs), from values at the knots, shape (k, runs)."""
        flat = values.ravel()
        found = np.empty((self.points, values.shape[1]))
        found[0], found[-1] = values[0], values[-1]
        before, inner = flat.take(self.at), found[1:-1]
        np.subtract(flat.take(self.after), before, out=inner)
        inner *= self.part
        inner += before
        return found


def one_after_the_other(cov: Covariates, rates: Covariates, duration: Array, knots: Array, which: Ints) -> Timeline:
    """Some of the intervals of all runs, run by run. `cov`, `rates`, `duration`: shape (runs, intervals) or
    (intervals,); `knots` (shape (intervals + 1, runs)): instants between them; `which`: intervals."""

    def flat(value: Any) -> Any:
        if isinstance(value, Labels):
            return Labels(np.tile(value.codes[which], len(duration)), value.names)
        return np.broadcast_to(value, duration.shape)[:, which].ravel()

    columns, changes = ({name: flat(value) for name, value in given.items()} for given in (cov, rates))
    return Timeline(flat(knots[:-1].T), flat(duration), columns, changes)


@dataclass(frozen=True)
class Intervals:
    """The phases of a plan of many runs, the legs that they belong to, and what of a run nothing but draws changes in:
    its leg, or its part (`Part`)."""

    plan: Plan
    phases: tuple[Phase, ...]
    leg_of: Ints
    part_of: Ints

    @classmethod
    def of(cls, plan: Plan, phases: Sequence[Phase] | None = None, parts: Sequence[int] | None = None) -> Intervals:
        """Those of a plan, or others with their parts."""
        if phases is None:
            phases = [phase for step in plan.steps for phase in step.phases]
        legs = np.array([phase.leg for phase in phases], dtype=np.intp)
        return cls(plan, tuple(phases), legs, legs if parts is None else np.array(parts, dtype=np.intp))

    @functools.cached_property
    def legs(self) -> list[Leg]:
        """The leg of each interval."""
        return [self.plan.legs[i] for i in self.leg_of.tolist()]

    def duration(self, part: slice) -> Array:
        """Of each interval [s], shape (runs, intervals)."""
        lasting: Array = self._tables[""]
        if lasting.ndim > 1:
            return lasting[:, part].T
        return np.repeat(lasting[:, None], part.stop - part.start, axis=1).T

    @functools.cached_property
    def _tables(self) -> Columns:
        """Covariates of each interval at its start and, with a prefix, their rates; see `table`."""
        settings = covariates_of([leg.settings for leg in self.plan.legs])
        found = {"": table([phase.duration_s for phase in self.phases])}
        found |= {name: values[self.leg_of] for name, values in settings.items()}
        for name, level, rate in (
            ("speed_m_s", "speed_m_s", "accel_m_s2"),
            ("lateral_speed_m_s", "lateral_m_s", "lateral_m_s2"),
            ("yaw_rate_rad_s", "yaw_rad_s", "yaw_rad_s2"),
        ):
            found[name] = table([getattr(phase, level) for phase in self.phases])
            found[_RATE + name] = table([getattr(phase, rate) for phase in self.phases])
        moving = np.array([phase.moving for phase in self.phases])
        # a leg that takes no time in any run is planned as standing
        before = np.concatenate([[False], moving[:-1]])
        found["moving"], found["starts"] = moving.astype(float), (moving & ~before).astype(float)
        return found

    def covariates(self, part: slice) -> tuple[Columns, Columns]:
        """Covariates at the start of each interval, shape (runs, intervals) or (intervals,), and their rates."""
        cov: Columns = {}
        rates: Columns = {}
        for name, rows in self._tables.items():
            one = rows if isinstance(rows, Labels) or rows.ndim == 1 else rows[:, part].T
            (rates if name.startswith(_RATE) else cov)[name.removeprefix(_RATE)] = one
        del cov[""]
        cov["accel_m_s2"], cov["lateral_accel_m_s2"] = rates["speed_m_s"], rates["lateral_speed_m_s"]
        return cov, rates


def distance_of(cov: Covariates, duration: Array) -> Array:
    """Distance driven [m], shape (runs,)."""
    if not np.any(cov["accel_m_s2"]) and not np.any(cov["lateral_speed_m_s"]):
        speed = np.broadcast_to(np.abs(cov["speed_m_s"]), duration.shape)
        return np.asarray(np.einsum("ij,ij->i", speed, duration))
    ahead = cov["speed_m_s"] * duration + 0.5 * cov["accel_m_s2"] * duration**2
    aside = cov["lateral_speed_m_s"] * duration + 0.5 * cov["lateral_accel_m_s2"] * duration**2
    return np.asarray(np.hypot(ahead, aside).sum(axis=1))


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
) -> tuple[Array, Array, Array, Array]:
    """Energy left in a battery [J] that some intervals charge: at even instants, at the end, and the least of all; and
    by how much it falls at most.

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
    return Progress(np.array(times), PROGRESS_POINTS)(course), course[-1], course.min(axis=0), greatest_fall(course)
