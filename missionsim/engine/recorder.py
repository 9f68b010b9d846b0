"""The recorder: closes an interval whenever something changes, and gives the intervals as a timeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import Any, NamedTuple

import numpy as np
import simpy

from missionsim.effects.covariates import Labels
from missionsim.effects.timeline import Timeline
from missionsim.plan.legs import Leg, Phase

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
    """Per battery: 0 not at a charger, 1 charging, 2 held at its level by the charger."""


class Recorder:
    """Collects rows; the processes of a run report every change to it before they make it.

    Parameters
    ----------
    env : simpy.Environment
    components : sequence of str
    batteries : sequence of str
    """

    def __init__(self, env: simpy.Environment, components: Sequence[str], batteries: Sequence[str]) -> None:
        self.env = env
        self.components = tuple(components)
        self.rows: list[Row] = []
        self.leg = 0
        self._phase = REST
        self._phase_began_s = 0.0
        self._since_s = 0.0
        count = len(self.components)
        self._state = [0.0] * (3 * count)
        self._states: dict[tuple[float, ...], int] = {tuple(self._state): 0}
        self._state_index = 0
        self._moving_time_s = 0.0
        self._was_moving = False
        self.charging: tuple[int, ...] = (0,) * len(batteries)
        self.changed: simpy.Event | None = None

    def close(self) -> None:
        """End the current interval now; nothing happens where it has no length."""
        now: float = self.env.now
        duration = now - self._since_s
        if duration <= 0.0:
            return
        phase = self._phase
        moving = phase.moving
        self.rows.append(
            Row(
                self._since_s,
                duration,
                self.leg,
                phase,
                self._since_s - self._phase_began_s,
                self._state_index,
                self._moving_time_s,
                moving and not self._was_moving,
                self.charging,
            )
        )
        self._was_moving = moving
        if moving:
            self._moving_time_s += duration
        self._since_s = now

    def move(self, leg: int, phase: Phase) -> None:
        """A phase of the plan begins."""
        self.close()
        self.leg = leg
        self._phase = phase
        self._phase_began_s = self.env.now

    def rest(self, leg: int) -> None:
        """The robot stands still from now on."""
        self.move(leg, REST)

    def component(self, index: int, units: int, starting: int) -> None:
        """A component changes its state: units on, units starting up."""
        self.close()
        count = len(self.components)
        state = self._state
        if units and not state[index]:
            state[2 * count + index] = self.env.now
        state[index] = units
        state[count + index] = starting
        self._state_index = self._states.setdefault(tuple(state), len(self._states))
        self._announce()

    def charge(self, modes: tuple[int, ...]) -> None:
        """A charger takes up or ends its work on some battery."""
        self.close()
        self.charging = modes

    def _announce(self) -> None:
        if self.changed is not None and not self.changed.triggered:
            self.changed.succeed()

    @property
    def phase(self) -> Phase:
        """Phase under way."""
        return self._phase

    @property
    def phase_elapsed_s(self) -> float:
        """Time since the phase under way began."""
        return float(self.env.now - self._phase_began_s)

    def current_row(self, duration_s: float) -> Row:
        """What the interval under way would be, were it to last `duration_s` from now without a change."""
        phase = self._phase
        return Row(
            self.env.now,
            duration_s,
            self.leg,
            phase,
            self.env.now - self._phase_began_s,
            self._state_index,
            self._moving_time_s,
            phase.moving and not self._was_moving,
            self.charging,
        )

    def states(self) -> np.ndarray:
        """Component states, shape (states, 3 · components): units on, units starting, time of switching on."""
        return np.array(list(self._states), dtype=float).reshape(len(self._states), 3 * len(self.components))


def timeline(
    rows: Sequence[Row],
    legs: Sequence[Leg],
    components: Sequence[str],
    states: np.ndarray,
    constants: Mapping[str, Any] | None = None,
    needs: Set[str] = frozenset(),
) -> Timeline:
    """The interval table of some rows.

    Parameters
    ----------
    rows : sequence of Row
    legs : sequence of Leg
        Of the plan; rows refer to them by index.
    components : sequence of str
    states : ndarray, shape (states, 3 · components)
        From `Recorder.states`.
    constants : mapping, optional
        Covariates that hold for the whole run.
    needs : set of str
        Covariates that the model reads; ``time_s`` is only given where it is one of them.

    Returns
    -------
    Timeline
        Glossary columns and rates, ready for `missionsim.effects.integrate`.
    """
    count = len(rows)
    numbers = np.array([(r[0], r[1], r[2], r[4], r[5], r[6], r[7], *r[3][2:]) for r in rows], dtype=float).reshape(
        count, 14
    )
    start, duration, elapsed = numbers[:, 0], numbers[:, 1], numbers[:, 3]
    # only the settings of these rows: a mission is evaluated in as many parts as it comes to chargers
    used, leg_of = np.unique(numbers[:, 2].astype(np.intp), return_inverse=True)
    accel, lateral_rate, yaw_rate = numbers[:, 8], numbers[:, 10], numbers[:, 12]
    moving = numbers[:, 13]
    settings = [legs[i].settings for i in used.tolist()]
    columns: dict[str, Any] = {
        "speed_m_s": numbers[:, 7] + accel * elapsed,
        "accel_m_s2": accel,
        "lateral_speed_m_s": numbers[:, 9] + lateral_rate * elapsed,
        "lateral_accel_m_s2": lateral_rate,
        "yaw_rate_rad_s": numbers[:, 11] + yaw_rate * elapsed,
        "moving": moving,
        "moving_time_s": numbers[:, 5],
        "starts": numbers[:, 6],
        "slope_rad": np.array([s.slope_rad for s in settings])[leg_of],
        "payload_kg": np.array([s.payload_kg for s in settings])[leg_of],
    }
    for name in ("scheme", "navigation", "surface"):
        labels = Labels.of([getattr(s, name) for s in settings])
        columns[name] = labels[leg_of]
    extra_names = {name for s in settings for name, _ in s.extra}
    for name in sorted(extra_names):
        given = [dict(s.extra).get(name, np.nan) for s in settings]
        if any(isinstance(value, str) for value in given):
            columns[name] = Labels.of(given)[leg_of]
        else:
            columns[name] = np.array(given, dtype=float)[leg_of]
    state = states[numbers[:, 4].astype(np.intp)]
    width = len(components)
    rates: dict[str, Any] = {
        "speed_m_s": accel,
        "lateral_speed_m_s": lateral_rate,
        "yaw_rate_rad_s": yaw_rate,
        "moving_time_s": moving,
    }
    if "time_s" in needs:
        columns["time_s"], rates["time_s"] = start, np.ones(count)
    for i, name in enumerate(components):
        units = state[:, i]
        on = units > 0.0
        columns[f"on_{name}"] = units
        columns[f"starting_{name}"] = state[:, width + i]
        columns[f"on_time_{name}_s"] = np.where(on, start - state[:, 2 * width + i], 0.0)
        rates[f"on_time_{name}_s"] = on.astype(float)
    segment = np.array([s.segment for s in settings], dtype=np.int64)[leg_of]
    return Timeline(start, duration, columns, rates, segment, dict(constants or {}))
