"""The recorder: closes an interval whenever something changes, and gives the intervals as a timeline."""

from __future__ import annotations

from collections.abc import Sequence, Set
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import simpy

from missionsim.effects.timeline import Timeline
from missionsim.plan.legs import Leg, Phase, Settings, covariates_of

REST = Phase(0.0, 0)


class Row(NamedTuple):
    """An interval over which nothing changes but what a constant acceleration changes."""

    start_s: float
    duration_s: float
    leg: int
    phase: Phase
    elapsed_s: float
    """Time since the start of the phase, where something else changed meanwhile."""
    state: int
    """Index into the recorder's table of component states."""
    moving_time_s: float
    start_from_rest: bool
    charging: tuple[int, ...]
    """Per battery: 0 not at a charger, 1 charging, 2 held at its level by the charger; empty without a charger."""


class Recorder:
    """Collects rows; the processes of a run report every change to it before they make it."""

    def __init__(self, env: simpy.Environment, components: Sequence[str]) -> None:
        self.env = env
        self.components = tuple(components)
        self.rows: list[Row] = []
        self.leg, self.phase, self.phase_began_s = 0, REST, 0.0
        self.states: dict[tuple[float, ...], int] = {}
        """Those of all components that rows refer to: units on, units starting, time of switching on, 3 · components
        each."""
        self._state, self._state_index = [0.0] * (3 * len(self.components)), -1
        self._since_s = self._moving_time_s = 0.0
        self._was_moving = False
        self.charging: tuple[int, ...] = ()
        """What a charger does to the batteries; set only where nothing is left to be closed."""
        self.changed: simpy.Event | None = None

    def close(self) -> None:
        """End the current interval now; nothing happens where it has no length."""
        now: float = self.env.now
        duration = now - self._since_s
        if duration <= 0.0:
            return
        self.rows.append(self.row(self._since_s, duration))
        self._was_moving = self.phase.moving
        if self._was_moving:
            self._moving_time_s += duration
        self._since_s = now

    def move(self, leg: int, phase: Phase = REST) -> None:
        """A phase of the plan begins; without one the robot stands still from now on."""
        self.close()
        self.leg, self.phase, self.phase_began_s = leg, phase, self.env.now

    def component(self, index: int, units: int, starting: int) -> None:
        """A component changes its state: units on, units starting up."""
        self.close()
        count = len(self.components)
        state = self._state
        if units and not state[index]:
            state[2 * count + index] = self.env.now
        state[index] = units
        state[count + index] = starting
        self._state_index = -1
        if self.changed is not None and not self.changed.triggered:
            self.changed.succeed()

    def row(self, start_s: float, duration_s: float) -> Row:
        """What the interval under way would be, were it to begin then and to last so long without a change."""
        if self._state_index < 0:  # of those that take time: many a change is followed by others at its instant
            self._state_index = self.states.setdefault(tuple(self._state), len(self.states))
        phase, elapsed_s = self.phase, start_s - self.phase_began_s
        starts = phase.moving and not self._was_moving
        state, moving_s = self._state_index, self._moving_time_s
        return Row(start_s, duration_s, self.leg, phase, elapsed_s, state, moving_s, starts, self.charging)


def timeline(
    parts: Sequence[tuple[Sequence[Row], Sequence[Leg], Sequence[Sequence[float]]]],
    components: Sequence[str],
    needs: Set[str] = frozenset(),
) -> Timeline:
    """The interval table of the rows of one or many runs, one after the other.

    `parts`: of each run: its rows, and the legs of its plan and the states of its components (`Recorder.states`), to
    which rows refer by index. `needs`: covariates that the model reads; ``time_s`` is only given where it is one of
    them. Gives glossary columns and rates, ready for `missionsim.effects.timeline`.
    """
    flat = chain.from_iterable((r[0], r[1], r[4], r[6], r[7], *r[3][2:]) for rows, _, _ in parts for r in rows)
    start, duration, elapsed, moving_time, starts, speed, accel, lateral, lateral_rate, yaw, yaw_rate, moving = (
        np.fromiter(flat, dtype=np.float64).reshape(-1, 12).T.copy()
    )
    # the settings of many rows, and of many runs, are the same object
    known: dict[int, int] = {}
    settings: list[Settings] = []
    leg_of: list[int] = []
    segment_of: list[int] = []
    state_of: list[int] = []
    states: list[Sequence[float]] = []
    for rows, legs, own in parts:
        for r in rows:
            leg = legs[r[2]]
            one = leg.settings
            index = known.get(id(one))
            if index is None:
                index = known[id(one)] = len(settings)
                settings.append(one)
            leg_of.append(index)
            segment_of.append(leg.segment)
            state_of.append(len(states) + r[5])
        states += own
    which = np.array(leg_of, dtype=np.intp)
    columns: dict[str, Any] = {
        "speed_m_s": speed + accel * elapsed,
        "accel_m_s2": accel,
        "lateral_speed_m_s": lateral + lateral_rate * elapsed,
        "lateral_accel_m_s2": lateral_rate,
        "yaw_rate_rad_s": yaw + yaw_rate * elapsed,
        "moving": moving,
        "moving_time_s": moving_time,
        "starts": starts,
        **{name: values[which] for name, values in covariates_of(settings).items()},
    }
    rates: dict[str, Any] = {
        "speed_m_s": accel,
        "lateral_speed_m_s": lateral_rate,
        "yaw_rate_rad_s": yaw_rate,
        "moving_time_s": moving,
    }
    if "time_s" in needs:
        columns["time_s"], rates["time_s"] = start, np.ones(len(start))
    width = len(components)
    state = np.fromiter(chain.from_iterable(states), dtype=np.float64).reshape(len(states), 3 * width).T[:, state_of]
    on = state[:width] > 0.0
    on_time, ticking = np.where(on, start - state[2 * width :], 0.0), on.astype(float)
    for i, name in enumerate(components):
        columns[f"on_{name}"], columns[f"starting_{name}"] = state[i], state[width + i]
        columns[f"on_time_{name}_s"], rates[f"on_time_{name}_s"] = on_time[i], ticking[i]
    return Timeline(start, duration, columns, rates, np.array(segment_of, dtype=np.int64))
