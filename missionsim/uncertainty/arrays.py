"""Many runs at once: draws × intervals, with the engine's own planner, kinematics and power model.

A mission qualifies when its events cannot change their order: no charger, no activities, no chance, batteries of
constant energy. Its plan is made on arrays of draws (`missionsim.plan.build.plan_runs`), its powers by the same
`PowerModel`; terms that no draw changes are evaluated once. Before use, runs at the edges and in the middle of the
distributions are compared with SimPy; and a run in which a battery comes to a threshold, or whose plan has another
shape, is given back to SimPy, since there the events do change.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Columns, Truth
from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import SAMPLES
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.outcome import J_PER_WH
from missionsim.engine.setup import split_values
from missionsim.engine.simulate import RESERVE_TOLERANCE, RunSetup
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.build import plan_runs
from missionsim.plan.legs import Plan
from missionsim.uncertainty import matrices
from missionsim.uncertainty.draws import Draws, Sampler
from missionsim.uncertainty.events import Part, charge_course, phases_of
from missionsim.uncertainty.single import components_of, number_columns, simulate_block

Array = NDArray[np.float64]
AGREEMENT = 1e-9
"""Largest relative difference to SimPy that is accepted."""
CACHED_RUNS = 2048
"""Runs evaluated at a time: their arrays of draws × intervals stay in the processor's cache."""
MOST_NUMBERS = 2_000_000
"""Numbers of a matrix of runs × intervals; runs are planned and evaluated in parts of at most so many."""
_PARTS = np.linspace(0.0, 1.0, matrices.PROGRESS_POINTS)
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
    varying: PowerModel
    """The terms that some draw changes."""
    fixed: Mapping[tuple[str, str], Array]
    """Battery and component → power of all other terms on each part [W], shape (parts,)."""
    parts: tuple[Part, ...]
    """What the nominal run consists of: its legs, and waits for components that start up."""

    def block(self, seed: int, first: int, count: int) -> dict[str, NDArray[np.generic]]:
        """Columns of the runs ``first … first + count − 1``."""
        draws = self.sampler.draw(seed, first, count)
        found, again = self.evaluate(draws, count)
        columns = {"run": np.arange(first, first + count, dtype=np.int64), **found}
        columns |= {f"drawn:{name}": values for name, values in draws.items()}
        chosen = np.flatnonzero(again)
        if chosen.size:
            drawn = {name: values[chosen] for name, values in draws.items()}
            runs = simulate_block(
                self.mission, self.model, self.sampler, seed, first, chosen.size, draws=drawn, runs=first + chosen
            )
            for name, column in columns.items():
                column[chosen] = runs[name]
        return columns

    @property
    def intervals(self) -> int:
        """Intervals of the nominal run."""
        return sum(len(step.phases) for step in self.plan.steps)

    def evaluate(self, draws: Draws, count: int) -> tuple[dict[str, NDArray[np.generic]], NDArray[np.bool_]]:
        """Columns at given draws, and the runs that need SimPy. `draws`: value name → ndarray of shape (count,)."""
        columns, again = self._empty(count), np.zeros(count, dtype=bool)
        together = max(1, MOST_NUMBERS // self.intervals)
        for low in range(0, count, together):
            high = min(low + together, count)
            part = {name: values[low:high] for name, values in draws.items()}
            with np.errstate(all="ignore"):  # what is no number goes to SimPy, which tells why
                self._part(part, high - low, {name: v[low:high] for name, v in columns.items()}, again[low:high])
        columns["feasible"][:] = True
        for name in self.mission.robot.batteries:
            below = columns.pop(f"{_BELOW}{name}")
            columns["feasible"] &= ~below
            text = f"battery '{name}' ends below its reserve"
            for i in np.flatnonzero(below).tolist():
                before = columns["message"][i]
                columns["message"][i] = f"{before}; {text}" if before else text
        return columns, again

    def _empty(self, count: int) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {name: np.zeros(count, dtype=bool) for name in ("feasible", "speed_limited")}
        batteries = tuple(self.mission.robot.batteries)
        columns |= {name: np.zeros(count) for name in number_columns(batteries, components_of(self.model))}
        columns["failed_at_s"][:] = np.nan
        columns |= {name: np.full(count, "", dtype=object) for name in ("failed_segment", "failed_battery", "message")}
        columns |= {f"charge_{name}_wh": np.empty((matrices.PROGRESS_POINTS, count)).T for name in batteries}
        return columns | {f"{_BELOW}{name}": np.zeros(count, dtype=bool) for name in batteries}

    def _part(self, draws: Draws, count: int, columns: Mapping[str, NDArray[Any]], again: NDArray[np.bool_]) -> None:
        """Plan some runs and evaluate them in pieces."""
        numbers, drawn = split_values(draws, self.model)
        plan = plan_runs(self.mission, numbers)
        setup = RunSetup(self.mission, plan, self.model, numbers, {})
        values = {name: np.asarray(value)[:, None] for name, value in drawn.items()}
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
        intervals: matrices.Intervals,
        part: slice,
        setup: RunSetup,
        values: Mapping[str, Array],
        columns: Mapping[str, NDArray[Any]],
        again: NDArray[np.bool_],
    ) -> None:
        """Evaluate some runs into their part of the columns, in J and Wh."""
        duration = intervals.duration(part)
        knots = matrices.running_sum(duration.T)
        cov, rates = self.covariates(intervals, part, duration, knots)
        parts = {(b, c): columns[f"component_{b}_{c}_wh"] for b, c in components_of(self.model)}
        energy, doubt = self._energies(cov, rates, duration, knots[-1], values, parts, intervals.part_of)
        for joules in parts.values():
            joules *= 1.0 / J_PER_WH
        columns["duration_s"][:], columns["distance_m"][:] = knots[-1], matrices.distance_of(cov, duration)
        sound = np.isfinite(knots[-1]) & (duration.min(axis=1) >= 0.0)
        again |= ~sound
        if not sound.all():
            knots = np.where(sound, knots, 0.0)
        progress = matrices.Progress(knots, matrices.PROGRESS_POINTS)
        for name, battery in setup.batteries.items():
            capacity, initial, reserve = (
                number[part] if isinstance(number, np.ndarray) else number
                for number in (battery.capacity_j, battery.initial, setup.required[name])
            )
            even = self._even.get(name)
            if even is None:
                spent = matrices.running_sum(energy[name].T)
                total, most, charge = spent[-1], spent[1:].max(axis=0), progress(spent)
            else:  # a power that never changes
                total = most = even * knots[-1]
                charge = np.multiply.outer(_PARTS, total)
            net = total
            if docked := [i for i, leg in enumerate(intervals.legs) if leg.recharge and name in leg.recharge.batteries]:
                used = even * duration if even is not None else energy[name]
                assert isinstance(battery, ConstantEnergy)
                store = replace(battery, capacity_j=capacity, initial=initial)
                course = charge_course(store, docked, intervals, part, used.T, knots)
                charge, net, most = initial - course[0], initial - course[1], initial - course[2]
            np.subtract(initial, charge, out=charge)
            np.multiply(charge, 1.0 / J_PER_WH, out=columns[f"charge_{name}_wh"].T)
            required, slack = capacity * reserve, RESERVE_TOLERANCE * capacity
            left = initial - net
            floor = required if self.mission.policy.on_empty == "return_to_dock" else 0.0
            again |= ~(initial - most > floor + slack)  # also where it is not a number
            again |= doubt > AGREEMENT * np.abs(total)
            np.less(left, required - slack, out=columns[f"{_BELOW}{name}"])
            for quantity, joules in (
                ("energy", total),
                ("charge_left", left),
                ("margin", left - required),
                ("needed", np.maximum(most, 0.0)),
            ):
                np.multiply(joules, 1.0 / J_PER_WH, out=columns[f"{quantity}_{name}_wh"])

    def split(self, setup: RunSetup) -> tuple[matrices.Intervals, Truth]:
        """Intervals of many runs, and which runs have another order of events."""
        whole = all(part.phase is None and not part.waits for part in self.parts)
        if whole and all(leg.recharge is None for leg in self.plan.legs):
            return matrices.Intervals.of(setup.plan), False
        phases, which, odd = phases_of(setup.plan, self.plan, self.parts, [info.startup_s for info in setup.components])
        return matrices.Intervals.of(setup.plan, phases, which), odd

    @functools.cached_property
    def _units(self) -> tuple[Array, Array]:
        """Units of each component that are on, and starting, in each part, shapes (components, parts)."""
        return np.array([part.on for part in self.parts]).T, np.array([part.starting for part in self.parts]).T

    @functools.cached_property
    def _needs(self) -> frozenset[str]:
        terms = self.model.terms
        return frozenset(name for term in terms for name in (*term.effect.needs, *term.effect.memory))

    def covariates(
        self, intervals: matrices.Intervals, part: slice, duration: Array, knots: Array
    ) -> tuple[Columns, Columns]:
        """Covariates at the start of each interval and their change per second. `part`: the runs; `duration`: shape
        (runs, intervals); `knots` (shape (intervals + 1, runs)): instants between the intervals."""
        cov, rates = intervals.covariates(part)
        names = list(self.mission.robot.components)
        for i, name in enumerate(names):
            cov[f"on_{name}"], cov[f"starting_{name}"] = (units[i, intervals.part_of] for units in self._units)
        if "moving_time_s" in self._needs:
            moving = cov["moving"]
            cov["moving_time_s"] = matrices.running_sum((duration * moving).T)[:-1].T
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
    def _fixed(self) -> tuple[dict[str, Any], dict[tuple[str, str], float], list[tuple[str, str]], Array]:
        """Powers that no draw changes. Of each battery, by leg or one number for all; of the components that have the
        same on all legs; the components that do not, and theirs as columns."""
        total: dict[str, Any] = {name: np.zeros(len(self.parts)) for name in self.model.batteries}
        even, changing = {}, []
        for key, watts in self.fixed.items():
            total[key[0]] = total[key[0]] + watts
            if np.all(watts == watts[0]):
                even[key] = float(watts[0])
            else:
                changing.append(key)
        columns = np.stack([self.fixed[key] for key in changing], axis=1) if changing else np.zeros((0, 0))
        for name, watts in total.items():
            total[name] = float(watts[0]) if np.all(watts == watts[0]) else watts
        return total, even, changing, columns

    @functools.cached_property
    def _impulsive(self) -> bool:
        return any(term.effect.impulse is not None for term in self.model.terms)

    @functools.cached_property
    def _even(self) -> dict[str, float]:
        """Power [W] of the batteries whose power is the same, and not below zero, in all intervals of all runs."""
        return {
            name: watts
            for name, watts in self._fixed[0].items()
            if not self._impulsive and not self.varying.of(name) and isinstance(watts, float) and watts >= 0.0
        }

    @functools.cached_property
    def _driving(self) -> dict[str, list[TermKey]]:
        """The terms of each battery whose sum the regeneration bends at zero."""
        model = self.varying
        return {b: [t.key for t in model.of(b) if t.effect.drive or t.limited] for b in model.batteries}

    def _energies(
        self,
        cov: dict[str, Any],
        rates: dict[str, Any],
        duration: Array,
        time_s: Array,
        values: Mapping[str, Array],
        parts: Mapping[tuple[str, str], Array],
        part_of: NDArray[np.intp],
    ) -> tuple[dict[str, Array], Any]:
        """Energy by battery and interval, shape (runs, intervals), in J; by component it is added to `parts`. Also how
        far the energy of each run may be off [J]: far, where a term has a kink inside an interval."""
        doubt: Any = 0.0
        total, even, changing, powers = self._fixed
        total = {name: watts if isinstance(watts, float) else watts[part_of] for name, watts in total.items()}
        curved_at = np.ones(duration.shape[1], dtype=bool)  # in which intervals power changes
        if not (self.model.memory or self.model.lags or "time_s" in self._needs):
            changing_in = [np.any(rate != 0.0, axis=0) if np.ndim(rate) > 1 else rate != 0.0 for rate in rates.values()]
            curved_at = np.broadcast_to(functools.reduce(np.logical_or, changing_in), curved_at.shape)
        for key, watts in even.items():
            np.multiply(time_s, watts, out=parts[key])
        for key, joules in zip(changing, (duration @ powers[part_of]).T if changing else (), strict=True):
            parts[key][:] = joules
        steady_loads = [name for name in total if name not in self._even and not self.varying.of(name)]
        energy = {name: duration * total[name] for name in steady_loads}
        lags = matrices.lags_within(self.varying, cov, rates, duration, values)

        def book(powers: Mapping[str, Mapping[Any, Any]], where: Any, length: Array, sampled: bool = False) -> None:
            nonlocal doubt
            whole = length is duration
            lasts = time_s if whole else length.sum(axis=1)
            for battery, terms in powers.items():
                mean = total[battery] if isinstance(total[battery], float) else total[battery][where]
                means = terms
                if sampled:
                    means, off = matrices.mean_powers(
                        terms, length, functools.partial(inside, battery), self._driving[battery]
                    )
                    doubt = doubt + (length * off).sum(axis=1)
                for key, watts in means.items():
                    watts = np.asarray(watts, dtype=float)
                    if watts.shape == (len(length), 1):  # the same in all intervals
                        joules = lasts * watts[:, 0]
                    else:
                        joules = np.einsum("ij,ij->i", length, np.broadcast_to(watts, length.shape))
                    parts[battery, key.component] += joules
                    if np.shape(mean) == length.shape:
                        mean += watts
                    else:
                        mean = mean + watts
                if terms and whole:
                    energy[battery] = np.multiply(length, mean, out=mean if np.shape(mean) == length.shape else None)
                elif terms:
                    if battery not in energy:
                        energy[battery] = np.zeros(duration.shape[::-1]).T
                    energy[battery][:, where] = length * mean

        def inside(battery: str, rows: Any, columns: Any, times: Array) -> dict[TermKey, Any]:
            columns = np.flatnonzero(curved_at)[columns]
            at = matrices.at_times(cov, rates, rows, columns, times)
            at |= {name: lag(rows * duration.shape[1] + columns, times[:, None])[:, 0] for name, lag in lags.items()}
            return self.varying.evaluate(at, {name: value[rows, 0] for name, value in values.items()}, battery)[battery]

        if self.varying.terms and not curved_at.any():
            book(self.varying.evaluate(cov, values), slice(None), duration)
        elif self.varying.terms:
            steady, curved = np.flatnonzero(~curved_at), np.flatnonzero(curved_at)
            if steady.size:
                book(self.varying.evaluate(matrices.take(cov, steady), values), steady, duration[:, steady])
            length = duration[:, curved]
            times = (0.5 * length[..., None] * (SAMPLES + 1.0)).reshape(len(length), -1)
            repeated = np.repeat(curved, len(SAMPLES))
            nodes = matrices.take(cov, repeated)  # in their last axis interval by interval
            for name, change in rates.items():
                if np.any(change):
                    nodes[name] = nodes[name] + times * np.asarray(change)[..., repeated]
            every = np.add.outer(np.arange(len(length)) * duration.shape[1], curved).ravel()
            for name, lag in lags.items():
                nodes[name] = lag(every, times.reshape(-1, len(SAMPLES))).reshape(times.shape)
            book(self.varying.evaluate(nodes, values), curved, length, sampled=True)
        if self._impulsive:
            for term, impulse in self.model.impulses(cov, values).items():
                spread = np.broadcast_to(impulse, duration.shape)
                energy[term.battery] += spread
                parts[term.battery, term.component] += spread.sum(axis=1)
        return energy, doubt
