"""Many runs at once: draws × intervals, with the engine's own planner, kinematics and power model.

A mission qualifies when its events cannot change their order: no charger, no activities, no chance, batteries of
constant energy. Its plan is made on arrays of draws (`missionsim.plan.build.plan_runs`), its powers by the same
`PowerModel`; what no draw changes has no axis of runs. Intervals in which power changes are integrated as the engine
does it, those of all runs one after the other. Before use, runs at the edges and in the middle of the distributions are
compared with SimPy; and a run in which a battery comes to a threshold, or whose plan has another shape, is given back
to SimPy, since there the events do change.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Columns, Truth, is_clock
from missionsim.effects.model import PowerModel, Term, TermKey
from missionsim.effects.timeline import SAMPLES, integrate
from missionsim.engine.batteries import CHARGE_TOLERANCE, ConstantEnergy, greatest_fall
from missionsim.engine.outcome import J_PER_WH
from missionsim.engine.setup import split_values
from missionsim.engine.simulate import RunSetup, simulate
from missionsim.errors import MissionsimError
from missionsim.inputs.mission import MissionSpec
from missionsim.physics import Array, Bools, Int64s, Ints
from missionsim.plan.build import make_plan, plan_runs
from missionsim.plan.legs import Plan
from missionsim.uncertainty import intervals as spans
from missionsim.uncertainty.draws import Draws, Sampler, columns_of, components_of, left_to_chance, simulate_block

AGREEMENT = 1e-9
"""Largest relative difference to SimPy that is accepted."""
CACHED_RUNS = 2048
"""Runs evaluated at a time: their arrays of draws × intervals stay in the processor's cache."""
MOST_NUMBERS = 2_000_000
"""Numbers of a matrix of runs × intervals; runs are planned and evaluated in parts of at most so many."""
_PARTS = np.linspace(0.0, 1.0, spans.PROGRESS_POINTS)
# the C library keeps what arrays of up to this size give back, in place of asking the system for each anew (malloc(3):
# its threshold grows to the largest block that was ever freed)
_largest = np.empty(24 << 20, dtype=np.uint8)
del _largest
_BELOW = "below its reserve: "


@dataclass(frozen=True)
class ArrayMission:
    """A mission compiled for evaluation as arrays; `block` gives the same columns as `simulate_block`."""

    mission: MissionSpec
    model: PowerModel
    sampler: Sampler
    plan: Plan
    """At the nominal values."""
    parts: tuple[spans.Part, ...]
    """What the nominal run consists of: its legs, and waits for components that start up."""

    def block(
        self, seed: int, first: int, count: int, draws: Draws | None = None, runs: Int64s | None = None
    ) -> dict[str, NDArray[np.generic]]:
        """Columns of the runs ``first … first + count − 1``, or of others at their draws."""
        own = np.arange(first, first + count, dtype=np.int64) if runs is None else runs
        draws = self.sampler.draw(seed, first, count) if draws is None else draws
        found, again = self.evaluate(draws, count)
        columns = {"run": own, **found, **{f"drawn:{name}": values for name, values in draws.items()}}
        if (chosen := np.flatnonzero(again)).size:
            some = {name: values[chosen] for name, values in draws.items()}
            made = simulate_block(self.mission, self.model, self.sampler, seed, first, chosen.size, some, own[chosen])
            for name, column in columns.items():
                column[chosen] = made[name]
        return columns

    def evaluate(self, draws: Draws, count: int) -> tuple[dict[str, NDArray[np.generic]], Bools]:
        """Columns at given draws, and the runs that need SimPy. `draws`: value name → ndarray of shape (count,)."""
        columns, again = columns_of(self.mission, self.model, count), np.zeros(count, dtype=bool)
        columns |= {f"{_BELOW}{name}": np.zeros(count, dtype=bool) for name in self.mission.robot.batteries}
        together = max(1, MOST_NUMBERS // sum(len(step.phases) for step in self.plan.steps))
        for low in range(0, count, together):
            high = min(low + together, count)
            part = {name: values[low:high] for name, values in draws.items()}
            with np.errstate(all="ignore"):  # what is no number goes to SimPy, which tells why
                self._part(part, high - low, {name: v[low:high] for name, v in columns.items()}, again[low:high])
        columns["feasible"][:] = True
        for name in self.mission.robot.batteries:
            below = np.asarray(columns.pop(f"{_BELOW}{name}"), dtype=bool)
            columns["feasible"][below] = False
            text = f"battery '{name}' ends below its reserve"
            for i in np.flatnonzero(below).tolist():
                columns["message"][i] = "; ".join(filter(None, (columns["message"][i], text)))
        return columns, again

    def _planned(self, draws: Draws) -> tuple[RunSetup, dict[str, Array]]:
        """The plan of some runs with what goes with it, and parameters of the model, each of shape (runs, 1)."""
        numbers, drawn = split_values(draws, self.model)
        setup = RunSetup(self.mission, plan_runs(self.mission, numbers), self.model, numbers, {})
        return setup, {name: np.asarray(value)[:, None] for name, value in drawn.items()}

    def _part(self, draws: Draws, count: int, columns: Mapping[str, NDArray[Any]], again: Bools) -> None:
        """Plan some runs and evaluate them in pieces."""
        setup, values = self._planned(draws)
        plan = setup.plan
        limited = [leg.pace.limited for leg in plan.legs]
        columns["speed_limited"][:] = functools.reduce(np.logical_or, limited, False)
        if plan.odd is not None:
            again |= plan.odd
        intervals, odd = self.split(setup)
        again |= odd
        if len(plan.legs) != len(self.plan.legs) or not set(range(len(plan.legs))) <= set(intervals.leg_of.tolist()):
            again[:] = True
            return
        together = max(1, min(CACHED_RUNS, 2 * MOST_NUMBERS // (len(SAMPLES) * len(intervals.leg_of))))
        for low in range(0, count, together):
            part = slice(low, min(low + together, count))
            self._piece(
                intervals,
                part,
                setup,
                {name: value[part] for name, value in values.items()},
                {name: column[part] for name, column in columns.items()},
                again[part],
            )

    def _piece(
        self,
        intervals: spans.Intervals,
        part: slice,
        setup: RunSetup,
        values: Mapping[str, Array],
        columns: Mapping[str, NDArray[Any]],
        again: Bools,
    ) -> None:
        """Evaluate some runs into their part of the columns, in J and Wh."""
        duration = intervals.duration(part)
        knots = spans.running_sum(duration.T)
        sound = np.isfinite(knots[-1]) & (duration.min(axis=1) >= 0.0)
        again |= ~sound
        if not sound.all():
            duration, knots = np.where(sound[:, None], duration, 0.0), np.where(sound, knots, 0.0)
        cov, rates = self.covariates(intervals, part, duration, knots)
        parts = {(b, c): columns[f"component_{b}_{c}_wh"] for b, c in components_of(self.model)}
        energy = self._energies(cov, rates, duration, knots, values, parts, intervals.part_of)
        for joules in parts.values():
            joules *= 1.0 / J_PER_WH
        columns["duration_s"][:], columns["distance_m"][:] = knots[-1], spans.distance_of(cov, duration)
        progress = spans.Progress(knots, spans.PROGRESS_POINTS)
        for name, battery in setup.batteries.items():
            capacity, initial, reserve = (
                number[part] if isinstance(number, np.ndarray) else number
                for number in (battery.capacity_j, battery.initial, setup.required[name])
            )
            given = energy[name]
            if isinstance(given, float):  # a power that never changes
                total = most = fall = given * knots[-1]
                charge = np.multiply.outer(_PARTS, total)
            else:
                spent = spans.running_sum(given.T)
                total, most, charge = spent[-1], spent[1:].max(axis=0), progress(spent)
                fall = most if given.min() >= 0.0 else greatest_fall(-spent)
            net = total
            if docked := [i for i, leg in enumerate(intervals.legs) if leg.recharge and name in leg.recharge.batteries]:
                used = given * duration if isinstance(given, float) else given
                assert isinstance(battery, ConstantEnergy)
                store = replace(battery, capacity_j=capacity, initial=initial)
                *course, fall = spans.charge_course(store, docked, intervals, part, used.T, knots)
                charge, net, most = initial - course[0], initial - course[1], initial - course[2]
            np.subtract(initial, charge, out=charge)
            np.multiply(charge, 1.0 / J_PER_WH, out=columns[f"charge_{name}_wh"].T)
            required, slack = capacity * reserve, CHARGE_TOLERANCE * capacity
            left = initial - net
            floor = required if self.mission.policy.on_empty == "return_to_dock" else 0.0
            again |= ~(initial - most > floor + slack)  # also where it is not a number
            np.less(left, required - slack, out=columns[f"{_BELOW}{name}"])
            for quantity, joules in (
                ("energy", total),
                ("charge_left", left),
                ("margin", left - required),
                ("needed", np.maximum(fall, 0.0)),
            ):
                np.multiply(joules, 1.0 / J_PER_WH, out=columns[f"{quantity}_{name}_wh"])

    def split(self, setup: RunSetup) -> tuple[spans.Intervals, Truth]:
        """Intervals of many runs, and which runs have another order of events."""
        whole = all(part.phase is None and not part.waits for part in self.parts)
        if whole and all(leg.recharge is None for leg in self.plan.legs):
            return spans.Intervals.of(setup.plan), False
        phases, which, odd = spans.phases_of(
            setup.plan, self.plan, self.parts, [info.startup_s for info in setup.components]
        )
        return spans.Intervals.of(setup.plan, phases, which), odd

    @functools.cached_property
    def _needs(self) -> frozenset[str]:
        terms = self.model.terms
        return frozenset(name for term in terms for name in (*term.effect.needs, *term.effect.memory))

    def covariates(
        self, intervals: spans.Intervals, part: slice, duration: Array, knots: Array
    ) -> tuple[Columns, Columns]:
        """Covariates at the start of each interval and their change per second. `part`: the runs; `duration`: shape
        (runs, intervals); `knots` (shape (intervals + 1, runs)): instants between the intervals."""
        cov, rates = intervals.covariates(part)
        names = list(self.mission.robot.components)
        units = np.array([(part.on, part.starting) for part in self.parts])
        for i, name in enumerate(names):
            cov[f"on_{name}"], cov[f"starting_{name}"] = units[intervals.part_of, :, i].T
        if "moving_time_s" in self._needs:
            moving = cov["moving"]
            cov["moving_time_s"] = spans.running_sum((duration * moving).T)[:-1].T
            rates["moving_time_s"] = moving
        start = knots[:-1].T
        for name in names:
            if f"on_time_{name}_s" in self.model.memory:
                on = cov[f"on_{name}"] > 0.0
                places = np.arange(len(on))
                # where it was switched on last: the first place after the last one where it was off
                began = np.maximum.accumulate(np.where(on, -1, places)) + 1
                cov[f"on_time_{name}_s"] = np.where(on, start - start[:, np.minimum(began, places)], 0.0)
                rates[f"on_time_{name}_s"] = on.astype(float)
        if "time_s" in self._needs:
            cov["time_s"], rates["time_s"] = start, np.ones(len(intervals.leg_of))
        return cov, rates

    @functools.cached_property
    def _split(self) -> tuple[PowerModel, dict[str, dict[str, Array]]]:
        """The terms that some draw changes, or an interval, as two runs tell; of each battery the power of the others
        on each part [W], by component. A term that stands with others (in a loss of the load, in what the drive is
        relieved of or pushes back) changes with them; one whose only numbers are zero and not drawn is none."""
        setup, values = self._planned(self.sampler.at({v.name: np.array([0.3, 0.7]) for v in self.sampler.values}))
        intervals, part = self.split(setup)[0], slice(0, 2)
        duration = intervals.duration(part)
        cov, rates = self.covariates(intervals, part, duration, spans.running_sum(duration.T))
        for name in [*(name for name, rate in rates.items() if np.any(rate)), *self.model.lags]:
            cov[name] = np.broadcast_to(cov.get(name, 0.0), duration.shape) + np.array([[0.0], [1.0]])
        kept, still = list[Term](), {name: dict[str, Array]() for name in self.model.batteries}
        parts, first = np.unique(intervals.part_of, return_index=True)
        if len(parts) < len(self.parts):
            return self.model, still
        for battery, powers in self.model.evaluate(cov, values).items():
            terms = [
                term
                for term in self.model.of(battery)
                if any(p.value or f"{battery}/{term.name_of(n)}" in values for n, p in term.parameters.items())
                or np.any(powers[term.key])
            ]
            changing = {term.key for term in terms if np.shape(powers[term.key])[:-1] == (2,)}
            load = any(term.effect.of_load for term in terms)
            relieved = any((term.limited or term.effect.of_drive) and term.key in changing for term in terms)
            for term in terms:
                rows, component = still[battery], term.key.component
                coupled = load or (relieved and (term.effect.drive or term.limited))
                if coupled or term.key in changing or term.effect.impulse is not None:
                    kept.append(term)
                else:
                    watts = np.broadcast_to(np.asarray(powers[term.key], dtype=float), (1, duration.shape[1]))[0, first]
                    rows[component] = rows[component] + watts if component in rows else watts
        return replace(self.model, terms=tuple(kept)), still

    def _energies(
        self,
        cov: Columns,
        rates: Columns,
        duration: Array,
        knots: Array,
        values: Mapping[str, Array],
        parts: Mapping[tuple[str, str], Array],
        part_of: Ints,
    ) -> dict[str, Array | float]:
        """Energy by battery and interval, shape (runs, intervals), in J; the power of a battery in W where it never
        changes. By component it is added to `parts`."""
        (model, still), energy, lasts = self._split, dict[str, Array | float](), knots[-1]
        changing = np.full(len(part_of), bool(model.lags))
        for rate in (np.asarray(rate) for name, rate in rates.items() if name in model.memory or not is_clock(name)):
            changing |= rate.any(axis=0) if rate.ndim > 1 else rate != 0.0
        curved, steady, steady_s = np.flatnonzero(changing), duration, lasts
        inside: dict[str, dict[TermKey, Array]] = {}
        if curved.size:
            flat = spans.one_after_the_other(cov, rates, duration, knots, curved)
            own = {name: np.repeat(value[:, 0], curved.size) for name, value in values.items()}
            inside = integrate(model, flat, own, AGREEMENT)
            steady = np.where(changing, 0.0, duration)
            steady_s = steady.sum(axis=1)
        impulses = model.impulses(cov, values)
        for battery, terms in model.evaluate(cov, values).items():
            mean = np.zeros(len(part_of))
            for component, row in still[battery].items():
                watts = row[part_of]
                parts[battery, component] += lasts * row[0] if (row == row[0]).all() else duration @ watts
                mean = mean + watts
            if not terms and (mean >= 0.0).all() and (mean == mean[0]).all():
                energy[battery] = float(mean[0])
                continue
            energy[battery] = joules = duration * mean
            for key, given in terms.items():
                watts = np.asarray(given, dtype=float)
                if watts.shape == (len(duration), 1):  # the same in all intervals
                    booked = steady_s * watts[:, 0]
                else:
                    booked = np.einsum("ij,ij->i", steady, np.broadcast_to(watts, duration.shape))
                joules += steady * watts
                if curved.size:
                    pieces = inside[battery][key].reshape(-1, curved.size)
                    joules[:, curved] += pieces
                    booked += pieces.sum(axis=1)
                if key in impulses:  # those of intervals in which power changes are in them
                    spread = np.where(changing, 0.0, impulses[key]) + np.zeros(duration.shape)
                    joules += spread
                    booked += spread.sum(axis=1)
                parts[battery, key.component] += booked
        return energy


_CHECK_PROBABILITIES = (0.5, 0.002, 0.998, 0.25, 0.75)
_CHECK_DRAWS, _TRIED = 3, 256
_MOST_AGAIN = 0.9
"""Share of the runs that go back to SimPy up to which arrays are worth their while for the others."""


def compile_arrays(mission: MissionSpec, model: PowerModel, sampler: Sampler) -> ArrayMission | str:
    """Compile a mission for evaluation as arrays. Gives the compiled mission, or in words why its runs need SimPy."""
    try:
        setup = RunSetup(mission, make_plan(mission), model, {}, {})
        parts = _obstacle(setup) or spans.parts_of(setup)
    except MissionsimError as error:
        parts = f"the nominal mission fails: {error}"
    if isinstance(parts, str):
        return parts
    made = ArrayMission(mission, model, sampler, setup.plan, parts)
    _, again = made.evaluate(sampler.draw(0, 0, _TRIED), _TRIED)
    if again.mean() > _MOST_AGAIN:
        return (
            f"in {100 * again.mean():.0f} % of its runs a battery comes to a threshold, another way is shorter, or a "
            "value changes what the plan consists of"
        )
    return _disagreement(made) or made


def _obstacle(setup: RunSetup) -> str:
    mission, plan, model = setup.mission, setup.plan, setup.model
    if plan.activities:
        return "activities overlap with the segments, so that events may change their order"
    if mission.policy.on_empty == "recharge_and_continue":
        return "it recharges when a battery comes to its reserve"
    charges = [leg.recharge for leg in plan.legs if leg.recharge is not None]
    if any(charge.duration_s is None or np.isfinite(charge.if_below) for charge in charges):
        return "how long it recharges depends on the charge"
    if charges and (model.memory or model.lags or "time_s" in model.needs):
        return "it recharges, and powers change with time"
    if plan.gated:
        return "a block is repeated until a time"
    chance = left_to_chance(mission)
    if chance:
        return f"chance decides in each run: {', '.join(name.removeprefix('chance.') for name in chance)}"
    if any(not isinstance(battery, ConstantEnergy) for battery in setup.batteries.values()):
        return "a battery is no constant store of energy"
    whole = simulate(mission, plan=plan, model=model)
    if not whole.completed:
        return "the nominal mission does not end"
    if any(b.home_wh for b in whole.batteries.values()):
        return "it ends away from its dock, so that each run has a way home of its own"
    return ""


def _disagreement(made: ArrayMission) -> str:
    """Why the arrays are not to be trusted: the largest difference to SimPy on some draws; empty if none."""
    values, sampler = made.sampler.values, made.sampler
    few = sampler.draw(0, 0, _CHECK_DRAWS)
    at = sampler.at({value.name: np.array(_CHECK_PROBABILITIES) for value in values})
    draws = {name: np.concatenate([at[name], few[name]]) for name in few}
    count = len(_CHECK_PROBABILITIES) + _CHECK_DRAWS
    columns, again = made.evaluate(draws, count)
    for i in range(count):
        if again[i]:
            continue
        try:
            result = simulate(made.mission, values={n: float(v[i]) for n, v in draws.items()}, model=made.model)
        except MissionsimError as error:
            return f"a drawn mission fails: {error}"
        for name, battery in result.batteries.items():
            ours = float(columns[f"energy_{name}_wh"][i])
            if not abs(ours - battery.energy_wh) <= AGREEMENT * max(abs(battery.energy_wh), 1e-12):
                return f"arrays and SimPy differ by {abs(ours / battery.energy_wh - 1):.1e} on battery '{name}'"
            off = abs(float(columns[f"charge_left_{name}_wh"][i]) - battery.charge_left_wh)
            if not off <= AGREEMENT * battery.capacity_wh:
                return f"arrays and SimPy differ by {off:.1e} Wh in what is left in battery '{name}'"
        if bool(columns["feasible"][i]) != result.feasible:
            return "arrays and SimPy do not agree on what is feasible"
    return ""
