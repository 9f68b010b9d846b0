"""The meter: energy of every term in every interval and the state of every battery, evaluated in whole batches.

Rows of the recorder are evaluated at once when somebody must know (a charger, the end of the mission), never row by
row while the simulation runs, and those of many runs together: a run asks with `Asked` and is sent what they take.
Thresholds are found afterwards in closed form or by a bracketed root.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import integrate
from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import Timeline
from missionsim.engine.batteries import CHARGING, HELD, Battery, Loads
from missionsim.engine.outcome import Alarm
from missionsim.engine.recorder import Recorder, Row, timeline
from missionsim.errors import InputError
from missionsim.plan.legs import Leg, SegmentInfo

Array = NDArray[np.float64]
Energies = Mapping[str, Mapping[TermKey, Array]]
T = TypeVar("T")


class Asked(NamedTuple):
    """Rows whose energies somebody must know: with their legs, states of components and drawn values."""

    rows: Sequence[Row]
    legs: Sequence[Leg]
    states: Sequence[Sequence[float]]
    values: Mapping[str, Any]


class Evaluated(NamedTuple):
    """Intervals and the energy [J] of every battery's terms in them."""

    line: Timeline
    energies: Energies

    def part(self, first: int, stop: int) -> Evaluated:
        """Some intervals that follow each other."""
        cut = slice(first, stop)
        energies = {name: {key: joules[cut] for key, joules in terms.items()} for name, terms in self.energies.items()}
        return Evaluated(self.line.part(first, stop), energies)


Evaluating = Generator[Asked, Evaluated, T]
"""A run, or a part of it, that asks for energies as it goes and returns its result."""


def together(model: PowerModel, components: Sequence[str], runs: Sequence[Evaluating[T]]) -> list[T | Exception]:
    """Results of runs whose questions are answered together; where a run fails, its exception.

    Parameters
    ----------
    model : PowerModel
    components : sequence of str
        Names, as in the recorders' states.
    runs : sequence of generator
    """
    found: list[T | Exception] = [RuntimeError("unfinished")] * len(runs)
    answers: dict[int, Evaluated | Exception | None] = dict.fromkeys(range(len(runs)))
    while answers:
        asked: dict[int, Asked] = {}
        for i, answer in answers.items():
            try:
                asked[i] = runs[i].throw(answer) if isinstance(answer, Exception) else runs[i].send(answer)  # type: ignore[arg-type]
            except StopIteration as end:
                found[i] = end.value
            except Exception as error:
                found[i] = error
        answers = dict(zip(asked, _answers(model, components, list(asked.values())), strict=True))
    return found


def alone(model: PowerModel, components: Sequence[str], run: Evaluating[T]) -> T:
    """Result of one run."""
    (found,) = together(model, components, [run])
    if isinstance(found, Exception):
        raise found
    return found


def _answers(model: PowerModel, components: Sequence[str], asked: Sequence[Asked]) -> Sequence[Evaluated | Exception]:
    if not asked:
        return []
    try:
        line = timeline([item[:3] for item in asked], components, model.needs)
        counts = [len(item.rows) for item in asked]
        values = asked[0].values
        if len(asked) > 1 and values:
            values = {name: np.repeat([item.values[name] for item in asked], counts) for name in values}
        whole = Evaluated(line, integrate(model, line, values))
    except Exception as error:
        return [error] if len(asked) == 1 else [_answers(model, components, [item])[0] for item in asked]
    if len(asked) == 1:
        return [whole]
    ends = np.cumsum(counts).tolist()
    return [whole.part(end - count, end) for end, count in zip(ends, counts, strict=True)]


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
        self.values = values or {}
        self.batches: list[Batch] = []
        self.state = {name: battery.initial for name, battery in batteries.items()}
        self._done = 0
        self._ahead: tuple[Row, Evaluated] | None = None

    def settle(self, ahead_s: float = 0.0) -> Evaluating[None]:
        """Evaluate the rows that have been closed since the last time, and the next `ahead_s` if nothing changes."""
        recorder = self.recorder
        rows = recorder.rows[self._done :] if self._done else recorder.rows
        count = len(rows)
        ahead = recorder.current_row(ahead_s) if ahead_s > 0.0 else None
        if ahead is None and not rows:
            return
        self._done = len(recorder.rows)
        asked = rows if ahead is None else [*rows, ahead]
        answer = yield Asked(asked, self.legs, recorder.states(), self.values)
        if ahead is not None:
            self._ahead = ahead, answer.part(count, count + 1)
            answer = answer.part(0, count)
        if count:
            loads = self._loads(rows, answer)
            states = {name: battery.after(self.state[name], loads[name]) for name, battery in self.batteries.items()}
            self.batches.append(Batch(*answer, loads, self.state, states))
            self.state = {name: float(ends[-1]) for name, ends in states.items()}

    def _refuse_nan(self, answer: Evaluated) -> None:
        """A term that is not a number somewhere lacks a covariate there, or divides by nought.

        Refused before the batteries see it: their equations have no solution that could be stepped along.
        """
        line = answer.line
        for battery, terms in answer.energies.items():
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

    def time_to(self, battery: str, level: float) -> float | None:
        """Time from now until a battery's state comes to `level`, within what `settle` has looked ahead."""
        assert self._ahead is not None
        row, answer = self._ahead
        loads = self._loads([row._replace(charging=self.recorder.charging)], answer)[battery]
        return self.batteries[battery].reach(self.state[battery], loads, 0, level, row.duration_s)

    def first_alarm(self, reserves: Mapping[str, float], excursions: Sequence[Sequence[float]] = ()) -> Alarm | None:
        """The first battery to become empty, or to fall to its reserve where `reserves` names a level for it.

        While the robot goes to a dock and charges (begin and end of each excursion, s) no reserve counts, nor before.
        """
        after = excursions[-1][1] if excursions else 0.0
        found: list[Alarm] = []
        for name, battery in self.batteries.items():
            for batch in self.batches:
                alarms = [_first_empty(battery, batch, name)]
                if name in reserves:
                    alarms.append(_first_reserve(battery, batch, name, reserves[name], after))
                here = [alarm for alarm in alarms if alarm is not None]
                if here:
                    found.append(min(here))
                    break
        return min(found, default=None)

    def _loads(self, rows: Sequence[Row], answer: Evaluated) -> dict[str, Loads]:
        nothing, modes = np.zeros(len(rows)), np.zeros((len(rows), len(self.batteries)), dtype=np.int64)
        charges = any(any(row.charging) for row in rows)
        if charges:
            modes = np.array([row.charging for row in rows], dtype=np.int64)
        found = {}
        for i, name in enumerate(self.batteries):
            power = np.array([_charger_power(self.legs[row.leg], name) for row in rows]) if charges else nothing
            total = np.add.reduce(list(answer.energies[name].values())) if answer.energies[name] else nothing
            if not np.isfinite(total).all():
                self._refuse_nan(answer)
            mode = modes[:, i]
            if (mode > HELD).any():  # the taper is of what goes into the battery
                parts = np.array([part for _, part in self.batteries[name].taper])[np.maximum(mode - HELD, 0)]
                slowed = np.minimum(power, parts * power + total / answer.line.duration_s)
                power, mode = np.where(mode > HELD, slowed, power), np.where(mode > HELD, CHARGING, mode)
            found[name] = Loads(name, answer.line, total, mode, power, self.model, self.values)
        return found


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


def _first_reserve(battery: Battery, batch: Batch, name: str, level: float, after_s: float) -> Alarm | None:
    loads, states = batch.loads[name], batch.states[name]
    before = np.concatenate([[batch.before[name]], states[:-1]])
    late = batch.timeline.start_s >= after_s * (1.0 - 1e-12)
    for i in np.flatnonzero((states < level) & (loads.charging == 0) & late):
        time = (
            0.0
            if before[i] < level
            else battery.reach(float(before[i]), loads, int(i), level, float(loads.duration_s[i]))
        )
        if time is not None:
            return Alarm(float(batch.timeline.start_s[i]) + time, name, "reserve", int(batch.timeline.segment[i]))
    return None
