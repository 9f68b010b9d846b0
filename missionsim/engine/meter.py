"""The meter: energy of every term in every interval and the state of every battery, evaluated in whole batches.

Rows of the recorder are evaluated at once when somebody must know (a charger, the end of the mission), never row by
row while the simulation runs; thresholds are found afterwards in closed form or by a bracketed root.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import integrate
from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import Timeline
from missionsim.engine.batteries import Battery, Loads
from missionsim.engine.curves import Curves
from missionsim.engine.outcome import Alarm
from missionsim.engine.recorder import Recorder, Row, timeline
from missionsim.errors import InputError
from missionsim.plan.legs import Leg, SegmentInfo

Array = NDArray[np.float64]
Energies = dict[str, dict[TermKey, Array]]


@dataclass(frozen=True)
class Batch:
    """Evaluated rows: timeline, energies [J] by battery and term, loads and states at interval ends by battery."""

    timeline: Timeline
    energies: Energies
    loads: dict[str, Loads]
    before: dict[str, float]
    states: dict[str, Array]


class Meter:
    """Energy and charge of a run.

    Parameters
    ----------
    model : PowerModel
    recorder : Recorder
    legs : list of Leg
        Of the plan; may grow while the mission runs.
    batteries : mapping of str to Battery
    values : mapping, optional
        Parameters that differ from the model's.
    segments : sequence of SegmentInfo, optional
        Whose names messages tell.
    """

    def __init__(
        self,
        model: PowerModel,
        recorder: Recorder,
        legs: list[Leg],
        batteries: Mapping[str, Battery],
        values: Mapping[str, Any] | None = None,
        segments: Sequence[SegmentInfo] = (),
    ) -> None:
        self.model = model
        self.segments = segments
        self.recorder = recorder
        self.legs = legs
        self.batteries = batteries
        self.values = values
        self.needs = frozenset(name for term in model.terms for name in term.effect.needs)
        self.batches: list[Batch] = []
        self.state = {name: battery.initial for name, battery in batteries.items()}
        self._done = 0

    def settle(self) -> None:
        """Evaluate the rows that have been closed since the last time."""
        rows = self.recorder.rows[self._done :]
        if not rows:
            return
        self._done = len(self.recorder.rows)
        batch = self.evaluate(rows)
        self.batches.append(batch)
        self.state = {name: float(states[-1]) for name, states in batch.states.items()}

    def evaluate(self, rows: Sequence[Row]) -> Batch:
        """Energies and states of some rows that follow the present state."""
        line = timeline(rows, self.legs, self.recorder.components, self.recorder.states(), needs=self.needs)
        energies = integrate(self.model, line, self.values)
        self._refuse_nan(line, energies)
        modes = np.array([row.charging for row in rows], dtype=np.int64).reshape(len(rows), len(self.batteries))
        loads = {
            name: self._loads(
                name,
                line,
                energies[name],
                modes[:, i],
                np.array([_charger_power(self.legs[row.leg], name) for row in rows]),
            )
            for i, name in enumerate(self.batteries)
        }
        states = {name: self.batteries[name].after(self.state[name], loads[name]) for name in self.batteries}
        return Batch(line, energies, loads, dict(self.state), states)

    def _refuse_nan(self, line: Timeline, energies: Energies) -> None:
        """A term that is not a number somewhere lacks a covariate there, or divides by nought.

        Refused before the batteries see it: their equations have no solution that could be stepped along.
        """
        for battery, terms in energies.items():
            for key, joules in terms.items():
                bad = np.flatnonzero(~np.isfinite(joules))
                if bad.size:
                    i, number = int(bad[0]), int(line.segment[bad[0]])
                    lacking = [
                        name
                        for name, column in line.columns.items()
                        if isinstance(column, np.ndarray) and column.dtype.kind == "f" and np.isnan(column[i])
                    ]
                    segment = self.segments[number].name if number < len(self.segments) else str(number)
                    place = next(term.effect.place for term in self.model.terms if term.key == key)
                    raise InputError(
                        place.fault(
                            f"the power of '{key.name}' ({key.component}, battery '{battery}') is not a number in "
                            f"segment '{segment}'",
                            got=", ".join(f"no {name}" for name in lacking) or "an expression without a value there",
                            allowed="every covariate that the robot's effects read, on every segment",
                        )
                    )

    def time_to(self, battery: str, level: float, horizon_s: float) -> float | None:
        """Time from now until a battery's state comes to `level`, if nothing else changes; None if not so soon."""
        span = min(horizon_s, 3600.0)
        while True:
            batch = self.evaluate([self.recorder.current_row(span)])
            found = self.batteries[battery].reach(self.state[battery], batch.loads[battery], 0, level, span)
            if found is not None or span >= horizon_s:
                return found
            span = min(horizon_s, span * 16.0)

    def first_alarm(self, reserves: Mapping[str, float]) -> Alarm | None:
        """The first battery to become empty, or to fall to its reserve where `reserves` names a level for it."""
        found: list[Alarm] = []
        for name, battery in self.batteries.items():
            for batch in self.batches:
                alarms = [_first_empty(battery, batch, name)]
                if name in reserves:
                    alarms.append(_first_reserve(battery, batch, name, reserves[name]))
                here = [alarm for alarm in alarms if alarm is not None]
                if here:
                    found.append(min(here))
                    break
        return min(found, default=None)

    def _loads(
        self, battery: str, line: Timeline, energies: dict[TermKey, Array], modes: NDArray[np.int64], charger_w: Array
    ) -> Loads:
        total = np.sum(list(energies.values()), axis=0) if energies else np.zeros(len(line))
        changing = line.changing(self.model.memory) | (np.asarray(line.columns["starts"]) > 0.0)

        def energy_until(interval: int, seconds: float) -> float:
            part = _cut(line, interval, seconds)
            return float(sum(joules[0] for joules in integrate(self.model, part, self.values)[battery].values()))

        curves = Curves(self.model, line, battery, self.values, changing, total)
        return Loads(line.duration_s, total, modes, changing, charger_w, energy_until, curves)


def _cut(line: Timeline, interval: int, seconds: float) -> Timeline:
    index = np.array([interval])
    columns = {name: value[index] for name, value in line.columns.items()}
    rates = {name: np.asarray(value)[index] for name, value in line.rates.items()}
    return Timeline(line.start_s[index], np.array([seconds]), columns, rates, line.segment[index], line.constants)


def _charger_power(leg: Leg, battery: str) -> float:
    return leg.recharge.power_w.get(battery, 0.0) if leg.recharge else 0.0


def _first_empty(battery: Battery, batch: Batch, name: str) -> Alarm | None:
    loads, states = batch.loads[name], batch.states[name]
    before = np.concatenate([[batch.before[name]], states[:-1]])
    for i in battery.suspects(before, states, loads):
        time = battery.empty_in(float(before[i]), loads, int(i))
        if time is not None:
            return Alarm(float(batch.timeline.start_s[i]) + time, name, "empty", int(batch.timeline.segment[i]))
    return None


def _first_reserve(battery: Battery, batch: Batch, name: str, level: float) -> Alarm | None:
    loads, states = batch.loads[name], batch.states[name]
    before = np.concatenate([[batch.before[name]], states[:-1]])
    for i in np.flatnonzero((states < level) & (loads.charging == 0)):
        time = (
            0.0
            if before[i] < level
            else battery.reach(float(before[i]), loads, int(i), level, float(loads.duration_s[i]))
        )
        if time is not None:
            return Alarm(float(batch.timeline.start_s[i]) + time, name, "reserve", int(batch.timeline.segment[i]))
    return None
