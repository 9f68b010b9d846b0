"""The meter: energy of every term in every interval and the state of every battery, evaluated in whole batches.

Rows of the recorder are evaluated at once when somebody must know (a charger, the end of the mission), never row by
row while the simulation runs, and those of many runs together: a run asks with `Asked` and is sent what they take.
Thresholds are found afterwards in closed form or by a bracketed root.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np

from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import Timeline, integrate, with_lags, within
from missionsim.engine.batteries import CHARGING, HELD, Battery, Loads
from missionsim.engine.outcome import J_PER_WH, Alarm
from missionsim.engine.recorder import Recorder, Row, timeline
from missionsim.errors import InputError
from missionsim.physics import Array, Value
from missionsim.physics.lag import GOES_ON
from missionsim.plan.legs import Leg, SegmentInfo

Energies = Mapping[str, Mapping[TermKey, Array]]
T = TypeVar("T")


class Asked(NamedTuple):
    """Rows whose energies somebody must know: with their legs, states of components and drawn values."""

    rows: Sequence[Row]
    legs: Sequence[Leg]
    states: Sequence[Sequence[float]]
    values: Mapping[str, Value]
    lags: Mapping[str, Array] = MappingProxyType({})
    """What is known of the model's lags where rows begin; not a number where they follow from the row before."""


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
    """Results of runs whose questions are answered together; where a run fails, its exception. `components`: names, as
    in the recorders' states."""
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
        begin = {
            name: np.concatenate([item.lags.get(name, np.full(len(item.rows), GOES_ON)) for item in asked])
            for name in model.lags
        }
        values = asked[0].values
        if len(asked) > 1 and values:
            values = {name: np.repeat([item.values[name] for item in asked], counts) for name in values}
        line = with_lags(model, line, values, begin)
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

    line: Timeline
    energies: Energies
    loads: dict[str, Loads]
    before: dict[str, float]
    states: dict[str, Array]


@dataclass(eq=False)
class Meter:
    """Energy and charge of a run."""

    model: PowerModel
    recorder: Recorder
    legs: list[Leg]
    """Of the plan; may grow while the mission runs."""
    batteries: Mapping[str, Battery]
    values: Mapping[str, Value]
    """Parameters that differ from the model's."""
    segments: Sequence[SegmentInfo]
    """Whose names messages tell."""
    batches: list[Batch] = field(default_factory=list)
    _done: int = 0
    _ahead: tuple[Row, Evaluated] | None = None

    def __post_init__(self) -> None:
        self.state = {name: battery.initial for name, battery in self.batteries.items()}
        self.lags: dict[str, float] = {}

    def settle(self, ahead_s: float = 0.0) -> Evaluating[None]:
        """Evaluate the rows that have been closed since the last time, and the next `ahead_s` if nothing changes."""
        recorder = self.recorder
        rows = recorder.rows[self._done :] if self._done else recorder.rows
        count = len(rows)
        ahead = recorder.row(recorder.env.now, ahead_s) if ahead_s > 0.0 else None
        if ahead is None and not rows:
            return
        self._done = len(recorder.rows)
        asked = rows if ahead is None else [*rows, ahead]
        begin = {name: np.append(value, np.full(len(asked) - 1, GOES_ON)) for name, value in self.lags.items()}
        answer = yield Asked(asked, self.legs, list(recorder.states), self.values, begin)
        if ahead is not None:
            self._ahead = ahead, answer.part(count, count + 1)
            answer = answer.part(0, count)
        if count:
            loads = self.loads(rows, answer)
            states = {name: battery.after(self.state[name], loads[name]) for name, battery in self.batteries.items()}
            self.batches.append(Batch(*answer, loads, self.state, states))
            if self.model.lags:
                line, last = answer.line, np.array([count - 1])
                end = within(self.model, line, last, line.duration_s[last, None], self.values)
                self.lags = {name: float(end[name][0, 0]) for name in self.model.lags}
            self.state = {name: float(ends[-1]) for name, ends in states.items()}

    def _refuse_nan(self, answer: Evaluated) -> None:
        """A term that is not a number somewhere lacks a covariate there, or divides by nought. Refused before the
        batteries see it: their equations have no solution that could be stepped along."""
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
        loads = self.loads([row._replace(charging=self.recorder.charging)], answer)[battery]
        return self.batteries[battery].reach(self.state[battery], loads, 0, level, row.duration_s)

    def first_alarm(self, reserves: Mapping[str, float], excursions: Sequence[Sequence[float]] = ()) -> Alarm | None:
        """The first battery to become empty, or to fall to its reserve where `reserves` names a level for it. While the
        robot goes to a dock and charges (begin and end of each excursion, s) no reserve counts, nor before."""
        after = excursions[-1][1] if excursions else 0.0
        found: list[Alarm] = []
        for name, battery in self.batteries.items():
            for batch in self.batches:
                if here := alarms_in(battery, batch, name, reserves.get(name), after):
                    found.append(min(here))
                    break
        return min(found, default=None)

    def table(self) -> tuple[Timeline, Energies, dict[str, Array]]:
        """One table of all batches, and the charge [Wh] of each battery at the end of each interval."""
        batches = self.batches
        if not batches:
            empty = np.zeros(0)
            return (
                Timeline(empty, empty, {}),
                {name: {} for name in self.batteries},
                dict.fromkeys(self.batteries, empty),
            )
        lines = [batch.line for batch in batches]
        charge = {
            name: battery.charge_j(np.concatenate([batch.states[name] for batch in batches])) / J_PER_WH
            for name, battery in self.batteries.items()
        }
        if len(batches) == 1:
            line = replace(lines[0], lags={}) if self.model.lags else lines[0]
            return line, batches[0].energies, charge
        energies = {
            name: {key: np.concatenate([batch.energies[name][key] for batch in batches]) for key in terms}
            for name, terms in batches[0].energies.items()
        }
        return Timeline.joined(lines), energies, charge

    def loads(self, rows: Sequence[Row], answer: Evaluated) -> dict[str, Loads]:
        """What each battery has to deliver in some rows."""
        nothing, alone = np.zeros(len(rows)), np.zeros(len(rows), dtype=np.int64)
        charges = any(row.charging for row in rows)
        found = {}
        for i, name in enumerate(self.batteries):
            power, mode = nothing, alone
            if charges:
                docks = [self.legs[row.leg].recharge for row in rows]
                power = np.array([dock.power_w.get(name, 0.0) if dock else 0.0 for dock in docks])
                mode = np.array([row.charging[i] if row.charging else 0 for row in rows], dtype=np.int64)
            total = np.add.reduce(list(answer.energies[name].values())) if answer.energies[name] else nothing
            if not np.isfinite(total).all():
                self._refuse_nan(answer)
            if charges and (mode > HELD).any():  # the taper is of what goes into the battery
                parts = np.array([part for _, part in self.batteries[name].taper])[np.maximum(mode - HELD, 0)]
                slowed = np.minimum(power, parts * power + total / answer.line.duration_s)
                power, mode = np.where(mode > HELD, slowed, power), np.where(mode > HELD, CHARGING, mode)
            found[name] = Loads(name, answer.line, total, mode, power, self.model, self.values)
        return found


def alarms_in(
    battery: Battery, batch: Batch, name: str, reserve: float | None = None, after_s: float = 0.0
) -> list[Alarm]:
    """When a battery becomes empty in a batch, and when it comes to its reserve, no earlier than some time."""
    loads, states, line = batch.loads[name], batch.states[name], batch.line
    before = np.concatenate([[batch.before[name]], states[:-1]])
    low = before[:0].astype(np.intp)
    if reserve is not None and (below := states < reserve).any():
        low = np.flatnonzero(below & (loads.charging == 0) & (line.start_s >= after_s * (1.0 - 1e-12)))
    found = []
    for kind, suspects in (("empty", battery.suspects(before, states, loads)), ("reserve", low)):
        for i in suspects.tolist():
            state, time = float(before[i]), None
            if kind == "empty":
                time = battery.empty_in(state, loads, i)
            elif reserve is not None:
                whole = float(line.duration_s[i])
                time = 0.0 if state < reserve else battery.reach(state, loads, i, reserve, whole)
            if time is not None:
                found.append(Alarm(float(line.start_s[i]) + time, name, kind, int(line.segment[i])))
                break
    return found
