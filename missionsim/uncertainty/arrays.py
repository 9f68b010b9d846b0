"""Many runs at once: draws × intervals, with the engine's own plan, kinematics and power model.

A mission qualifies when its events cannot change their order: no charger, no activities, no chance, batteries of
constant energy. Its numbers are found by probing the planner, its phases by the planner's kinematics on arrays, its
powers by the same `PowerModel`. Terms that no draw changes are evaluated once, in `compile`. Before use, runs at the
edges and in the middle of the distributions are compared with SimPy; and a run in which a battery comes to a threshold
is given back to SimPy, since there the events do change.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import GAUSS_WEIGHTS, NODES, WEIGHTS
from missionsim.effects.model import PowerModel
from missionsim.engine.simulate import RESERVE_TOLERANCE, split_values
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.kinematics import phases
from missionsim.plan.legs import Leg, Plan
from missionsim.uncertainty.draws import Draws, Sampler
from missionsim.uncertainty.entries import (
    SETTINGS,
    Entries,
    Interval,
    Motion,
    Progress,
    at_nodes,
    distance,
    drawn_conditions,
    running_sum,
    take,
)
from missionsim.uncertainty.probe import Dependence
from missionsim.uncertainty.run_table import RunTable
from missionsim.uncertainty.single import PROGRESS_POINTS, components_of, simulate_block
from missionsim.uncertainty.ways import Edges

Array = NDArray[np.float64]
AGREEMENT = 1e-9
"""Largest relative difference to SimPy that is accepted."""
CACHED_RUNS = 2048
"""Runs evaluated at a time: their arrays of draws × intervals stay in the processor's cache."""
_PARTS = np.linspace(0.0, 1.0, PROGRESS_POINTS)
# the C library keeps what arrays of up to this size give back, in place of asking the system for each anew (malloc(3):
# its threshold grows to the largest block that was ever freed)
_largest = np.empty(24 << 20, dtype=np.uint8)
del _largest
_MOVES = ("roll", "slide", "turn")


@dataclass(frozen=True)
class ArrayMission:
    """A mission compiled for evaluation as arrays; `block` gives the same columns as `simulate_block`.

    Attributes
    ----------
    varying : PowerModel
        The terms that some draw changes.
    fixed : mapping
        Battery and component → power of all other terms in each interval [W], shape (intervals,).
    edges : Edges or None
        Where the shortest ways may follow from draws.
    """

    mission: MissionSpec
    model: PowerModel
    sampler: Sampler
    plan: Plan
    dependence: Dependence
    spans: tuple[tuple[int, int, bool], ...]
    intervals: tuple[Interval, ...]
    columns: Mapping[str, Any]
    switched_on: Mapping[str, NDArray[np.intp]]
    varying: PowerModel
    fixed: Mapping[tuple[str, str], Array]
    edges: Edges | None = None

    def block(self, seed: int, first: int, count: int) -> dict[str, NDArray[Any]]:
        """Columns of the runs ``first … first + count − 1``."""
        draws = self.sampler.draw(seed, first, count)
        columns, again = self.evaluate(draws, count)
        columns = {"run": np.arange(first, first + count, dtype=np.int64), **columns}
        for name, values in draws.items():
            columns[f"drawn:{name}"] = values
        for i in np.flatnonzero(again).tolist():
            drawn = {name: values[i : i + 1] for name, values in draws.items()}
            run = simulate_block(self.mission, self.model, self.sampler, seed, first + i, 1, draws=drawn)
            for name, values in columns.items():
                values[i] = run[name][0]
        return columns

    def evaluate(self, draws: Draws, count: int) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Columns at given draws, and the runs that need SimPy because a battery comes to a threshold.

        Parameters
        ----------
        draws : dict
            Value name → ndarray of shape (count,).
        count : int
        """
        table = RunTable(tuple(self.mission.robot.batteries), components_of(self.model), count)
        changes, values = self.dependence.changes(draws, count), self.values(draws)
        for low in range(0, count, CACHED_RUNS):
            part = slice(low, min(low + CACHED_RUNS, count))
            with np.errstate(all="ignore"):  # what is no number goes to SimPy, which tells why
                self._piece(changes[:, part], {name: value[part] for name, value in values.items()}, table, part)
        if self.edges is not None:
            table.again |= self.edges.others_shorter(draws, count)
        return table.columns(), table.again

    def _piece(self, changes: Array, values: Mapping[str, Array], table: RunTable, part: slice) -> None:
        """Evaluate some runs into their part of the table."""
        count = changes.shape[1]
        numbers = table.numbers[:, part]
        entries = Entries(self.plan, self.dependence, changes)
        motion = self.motion(entries, count)
        knots = running_sum(motion.duration_s.T)
        cov, rates = self.covariates(entries, motion, knots)
        energy, doubt = self._energies(cov, rates, motion, knots[-1], values, numbers, table.part)
        numbers[0], numbers[1] = knots[-1], distance(cov, motion)
        sound = np.isfinite(knots[-1]) & (motion.duration_s.min(axis=1) >= 0.0)
        table.again[part], table.limited[part] = ~sound, motion.limited
        if not sound.all():
            knots = np.where(sound, knots, 0.0)
        progress = Progress(knots, PROGRESS_POINTS)
        for b, name in enumerate(self.mission.robot.batteries):
            capacity, initial, reserve = (entries.battery(b, i) for i in range(3))
            even = self._even.get(name)
            if even is None:
                spent = running_sum(energy[name].T)
                total, most, charge = spent[-1], spent[1:].max(axis=0), progress(spent)
            else:  # a power that never changes
                total = most = even * knots[-1]
                charge = np.multiply.outer(_PARTS, total)
            np.subtract(initial, charge, out=table.charge[b, :, part])
            required, slack = capacity * reserve, RESERVE_TOLERANCE * capacity
            left = initial - total
            floor = required if self.mission.policy.on_empty == "return_to_dock" else 0.0
            table.again[part] |= ~(initial - most > floor + slack)  # also where it is not a number
            table.again[part] |= doubt > AGREEMENT * np.abs(total)
            np.less(left, required - slack, out=table.below[b, part])
            for quantity, joules in (
                ("energy", total),
                ("charge_left", left),
                ("margin", left - required),
                ("needed", np.maximum(most, 0.0)),
            ):
                numbers[table.row(b, quantity)] = joules

    @functools.cached_property
    def _place(self) -> dict[tuple[int, int], int]:
        return {(interval.leg, interval.phase): i for i, interval in enumerate(self.intervals)}

    @functools.cached_property
    def _together(self) -> tuple[tuple[str, tuple[int, ...], list[int]], ...]:
        """Kind, legs and their intervals of all legs that need no kinematics of ramps, to be evaluated as one."""
        found: dict[str, tuple[list[int], list[int]]] = {}
        for low, high, instant in self.spans:
            kind = self.plan.legs[low].kind
            if instant or kind not in _MOVES:
                legs, places = found.setdefault(kind if kind in ("turn", "slide", "roll") else "stand", ([], []))
                legs += range(low, high)
                places += [self._place[leg, 1] for leg in range(low, high)]
        return tuple((kind, tuple(legs), places) for kind, (legs, places) in found.items())

    def motion(self, entries: Entries, count: int) -> Motion:
        """When the intervals begin, and how fast."""
        size = len(self.intervals)
        duration = np.empty((size, count)).T
        speed = np.zeros((size, count)).T
        ramps = [span for span in self.spans if not span[2] and self.plan.legs[span[0]].kind in _MOVES]
        rate = np.zeros((size, count)).T if ramps else np.zeros((1, size))
        limited = np.zeros(1, dtype=bool)
        for kind, legs, places in self._together:
            if kind == "stand":
                duration[:, places] = entries.legs(legs, "duration_s")
                continue
            way = np.abs(entries.legs(legs, "angle_rad")) if kind == "turn" else entries.legs(legs, "distance_m")
            limit, above = entries.limits(legs, kind == "turn")
            limited = limited | above
            if places == list(range(size)) and len(limit) == count:
                speed = limit
                np.divide(way, limit, out=duration)
            else:
                speed[:, places] = limit
                duration[:, places] = way / limit
        for low, high, _ in ramps:
            legs, turn = tuple(range(low, high)), self.plan.legs[low].kind == "turn"
            way = np.abs(entries.legs(legs, "angle_rad" if turn else "distance_m"))
            limit, above = entries.limits(legs, turn)
            limited = limited | above
            up = entries.limit("yaw_accel_rad_s2" if turn else "accel_m_s2")
            down = up if turn else entries.limit("decel_m_s2")
            made = phases(way, limit, up, down)
            for k, i in enumerate(legs):
                for phase in (0, 1, 2):
                    j = self._place[i, phase]
                    duration[:, j] = made.duration_s[:, k, phase]
                    speed[:, j] = made.speed_m_s[:, k, phase]
                    rate[:, j] = made.accel_m_s2[:, k, phase]
        return Motion(duration, speed, rate, limited)

    @functools.cached_property
    def _legs(self) -> list[Leg]:
        return [self.plan.legs[interval.leg] for interval in self.intervals]

    @functools.cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Parts of the speed that go ahead and aside in each interval."""
        both = np.zeros((2, len(self._legs)))
        for i, leg in enumerate(self._legs):
            if leg.kind == "slide":
                both[:, i] = np.cos(leg.direction_rad), np.sin(leg.direction_rad)
            elif leg.kind == "roll":
                both[0, i] = 1.0
        return both[0], both[1]

    @functools.cached_property
    def _drawn_conditions(self) -> tuple[str, ...]:
        return drawn_conditions(self.plan, self.dependence, self._bends[3])

    @functools.cached_property
    def _needs(self) -> frozenset[str]:
        terms = self.model.terms
        return frozenset(name for term in terms for name in (*term.effect.needs, *term.effect.memory))

    def covariates(self, entries: Entries, motion: Motion, knots: Array) -> tuple[dict[str, Any], dict[str, Any]]:
        """Covariates at the start of each interval and their change per second.

        Parameters
        ----------
        entries : Entries
        motion : Motion
        knots : ndarray, shape (intervals + 1, runs)
            Instants between the intervals.
        """
        duration, speed, rate = motion.duration_s, motion.speed_m_s, motion.accel_m_s2
        cov: dict[str, Any] = dict(self.columns)
        rates: dict[str, Any] = {}
        for name, part in zip(("", "lateral_"), self._directions, strict=True):
            whole, none = bool(np.all(part == 1.0)), not part.any()
            cov[f"{name}speed_m_s"] = speed if whole else part if none else speed * part
            cov[f"{name}accel_m_s2"] = rate if whole else part if none else rate * part
            rates[f"{name}speed_m_s"] = cov[f"{name}accel_m_s2"]
        turns, rolls, bent, all_legs = self._bends
        bend = turns
        if rolls and (curvature := entries.legs(bent, "curvature_1_m")).any():
            bend = np.empty((len(turns), len(curvature))).T
            bend[:] = turns
            bend[:, rolls] = curvature
        straight = bend is turns and not turns.any()
        cov["yaw_rate_rad_s"] = turns if straight else speed * bend
        rates["yaw_rate_rad_s"] = turns if straight else rate * bend
        for name in SETTINGS:
            numbers = entries.legs(all_legs, name)
            cov[name] = numbers if len(numbers) > 1 else numbers[0]
        for name in self._drawn_conditions:
            cov[name] = entries.legs(all_legs, name)
        if "moving_time_s" in self._needs:
            moving = np.asarray(self.columns["moving"])
            cov["moving_time_s"] = running_sum((duration * moving).T)[:-1].T
            rates["moving_time_s"] = moving
        start = knots[:-1].T
        for name, began in self.switched_on.items():
            on = began >= 0
            cov[f"on_time_{name}_s"] = np.where(on, start - start[:, np.maximum(began, 0)], 0.0)
            rates[f"on_time_{name}_s"] = on.astype(float)
        if "time_s" in self._needs:
            cov["time_s"], rates["time_s"] = start, np.ones(len(self.intervals))
        return cov, rates

    @functools.cached_property
    def _bends(self) -> tuple[Array, list[int], tuple[int, ...], tuple[int, ...]]:
        """Yaw rate for a unit of speed of turns on the spot; intervals that roll, their legs; legs of all intervals."""
        turns = np.array([np.copysign(1.0, leg.angle_rad) if leg.kind == "turn" else 0.0 for leg in self._legs])
        rolls = [i for i, leg in enumerate(self._legs) if leg.kind == "roll"]
        legs = tuple(interval.leg for interval in self.intervals)
        return turns, rolls, tuple(legs[i] for i in rolls), legs

    def values(self, draws: Draws) -> dict[str, Array]:
        """Parameters of the power model that are drawn, each of shape (runs, 1)."""
        drawn = split_values(draws, self.model)[1]
        return {name: np.asarray(values)[:, None] for name, values in drawn.items()}

    @functools.cached_property
    def _fixed(self) -> tuple[dict[str, Any], dict[tuple[str, str], float], list[tuple[str, str]], Array]:
        """Powers that no draw changes.

        Of each battery, by interval or one number for all; of the components that have the same in all intervals; the
        components that do not, and theirs as columns.
        """
        total: dict[str, Any] = {name: np.zeros(len(self.intervals)) for name in self.model.batteries}
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
    def _curved(self) -> NDArray[np.bool_]:
        """The intervals in which power changes."""
        if self.model.memory or "time_s" in self._needs:
            return np.ones(len(self.intervals), dtype=bool)
        return np.array([interval.phase != 1 for interval in self.intervals])

    def _energies(
        self,
        cov: dict[str, Any],
        rates: dict[str, Any],
        motion: Motion,
        time_s: Array,
        values: Mapping[str, Array],
        numbers: Array,
        part: Mapping[tuple[str, str], int],
    ) -> tuple[dict[str, Array], Any]:
        """Energy by battery and interval, shape (runs, intervals), in J; by component it is added to `numbers`.

        Also how far two quadratures of each run differ [J]: far, where a term has a kink inside an interval.
        """
        doubt: Any = 0.0
        duration = motion.duration_s
        total, even, changing, powers = self._fixed
        for key, watts in even.items():
            np.multiply(time_s, watts, out=numbers[part[key]])
        for key, joules in zip(changing, (duration @ powers).T if changing else (), strict=True):
            numbers[part[key]] = joules
        steady_loads = [name for name in total if name not in self._even and not self.varying.of(name)]
        energy = {name: duration * total[name] for name in steady_loads}

        def book(powers: Mapping[str, Mapping[Any, Any]], where: Any, length: Array, weights: Array | None) -> None:
            nonlocal doubt
            whole = length is duration
            lasts = time_s if whole else length.sum(axis=1)
            for battery, terms in powers.items():
                mean = total[battery] if isinstance(total[battery], float) else total[battery][where]
                for key, watts in terms.items():
                    watts = np.asarray(watts, dtype=float)
                    if weights is not None:
                        shape = (length.shape[1], len(weights))
                        watts = np.broadcast_to(watts, (*watts.shape[:-1], shape[0] * shape[1])).reshape(-1, *shape)
                        doubt = doubt + (length * np.abs(watts @ (weights - 0.5 * GAUSS_WEIGHTS))).sum(axis=1)
                        watts = watts @ weights
                    if watts.shape == (len(length), 1):  # the same in all intervals
                        joules = lasts * watts[:, 0]
                    else:
                        joules = np.einsum("ij,ij->i", length, np.broadcast_to(watts, length.shape))
                    numbers[part[battery, key.component]] += joules
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

        if self.varying.terms and not self._curved.any():
            book(self.varying.evaluate(cov, values), slice(None), duration, None)
        elif self.varying.terms:
            steady, curved = np.flatnonzero(~self._curved), np.flatnonzero(self._curved)
            if steady.size:
                book(self.varying.evaluate(take(cov, steady), values), steady, duration[:, steady], None)
            length = duration[:, curved]
            times = (0.5 * length[..., None] * (NODES + 1.0)).reshape(len(length), -1)
            book(self.varying.evaluate(at_nodes(cov, rates, curved, times), values), curved, length, 0.5 * WEIGHTS)
        if self._impulsive:
            for term, impulse in self.model.impulses(cov, values).items():
                spread = np.broadcast_to(impulse, duration.shape)
                energy[term.battery] += spread
                numbers[part[term.battery, term.component]] += spread.sum(axis=1)
        return energy, doubt
