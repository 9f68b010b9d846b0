"""Many runs at once: draws × intervals, with the engine's own plan, kinematics and power model.

A mission qualifies when its events cannot change their order: no charger, no activities, no chance, batteries of
constant energy. Its numbers are found by probing the planner, its phases by the planner's kinematics on arrays, its
powers by the same `PowerModel`. Before use, runs at the edges and in the middle of the distributions are compared with
SimPy; and a run in which a battery comes to a threshold is given back to SimPy, since there the events do change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import NODES, WEIGHTS
from missionsim.effects.model import PowerModel
from missionsim.engine.outcome import J_PER_WH
from missionsim.engine.simulate import RESERVE_TOLERANCE, split_values
from missionsim.plan.kinematics import phases
from missionsim.plan.legs import Leg, Plan
from missionsim.spec.mission import MissionSpec
from missionsim.uncertainty.draws import Draws, Sampler
from missionsim.uncertainty.entries import SETTINGS, Entries, Interpolation
from missionsim.uncertainty.probe import Dependence
from missionsim.uncertainty.single import PROGRESS_POINTS, components_of, simulate_block

Array = NDArray[np.float64]
CACHED_RUNS = 1024
"""Runs evaluated at a time: their arrays of draws × intervals stay in the processor's cache."""


@dataclass(frozen=True)
class Interval:
    """One interval of every run: which leg, which of its three phases (or standing)."""

    leg: int
    phase: int
    moving: bool
    begins: bool
    """Whether the robot starts from rest in it."""


@dataclass(frozen=True)
class ArrayMission:
    """A mission compiled for evaluation as arrays; `block` gives the same columns as `simulate_block`."""

    mission: MissionSpec
    model: PowerModel
    sampler: Sampler
    plan: Plan
    dependence: Dependence
    spans: tuple[tuple[int, int, bool], ...]
    intervals: tuple[Interval, ...]
    columns: Mapping[str, Any]
    switched_on: Mapping[str, NDArray[np.intp]]

    def block(self, seed: int, first: int, count: int) -> dict[str, NDArray[Any]]:
        """Columns of the runs ``first … first + count − 1``."""
        draws = self.sampler.draw(seed, first, count)
        pieces = [
            self.evaluate({name: values[low : low + CACHED_RUNS] for name, values in draws.items()},
                          min(CACHED_RUNS, count - low))
            for low in range(0, count, CACHED_RUNS)
        ]
        columns = {name: np.concatenate([piece[0][name] for piece in pieces]) for name in pieces[0][0]}
        again = np.concatenate([piece[1] for piece in pieces])
        columns = {"run": np.arange(first, first + count, dtype=np.int64), **columns}
        for name, values in draws.items():
            columns[f"drawn:{name}"] = values
        for i in np.flatnonzero(again):
            run = simulate_block(self.mission, self.model, self.sampler, seed, first + int(i), 1)
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
        entries = Entries(self.plan, self.dependence, draws)
        duration, speed, rate = self._phases(entries, count)
        start = np.concatenate([np.zeros((count, 1)), np.cumsum(duration, axis=1)[:, :-1]], axis=1)
        cov, rates = self._covariates(entries, start, duration, speed, rate)
        values = self._values(draws)
        energy, component = self._energies(cov, rates, duration, values, count)
        total = start[:, -1] + duration[:, -1]
        columns: dict[str, NDArray[Any]] = {}
        feasible = np.ones(count, dtype=bool)
        again = np.zeros(count, dtype=bool)
        grid = total[:, None] * np.linspace(0.0, 1.0, PROGRESS_POINTS)
        ends = np.concatenate([np.zeros((count, 1)), start + duration], axis=1)
        progress = Interpolation(grid, ends)
        reasons = np.full(count, "", dtype=object)
        charges, numbers = {}, {}
        for b, name in enumerate(self.mission.robot.batteries):
            capacity, initial, reserve = (np.ravel(entries.battery(b, i)) + np.zeros(count) for i in range(3))
            spent = np.cumsum(energy[name], axis=1)
            left = initial - spent[:, -1]
            lowest = initial[:, None] - spent
            floor = capacity * reserve if self.mission.policy.on_empty == "return_to_dock" else 0.0 * capacity
            again |= np.any(lowest <= floor[:, None] + RESERVE_TOLERANCE * capacity[:, None], axis=1)
            below = left < capacity * reserve - RESERVE_TOLERANCE * capacity
            feasible &= ~below
            text = f"battery '{name}' ends below its reserve"
            reasons[below] = [f"{old}; {text}" if old else text for old in reasons[below]]
            numbers[name] = {
                "energy": spent[:, -1],
                "charge_left": left,
                "margin": left - capacity * reserve,
                "needed": initial - left,
            }
            charges[name] = progress(np.concatenate([initial[:, None], lowest], axis=1)) / J_PER_WH
        columns["feasible"] = feasible
        columns["duration_s"], columns["distance_m"] = total, self._distance(cov, duration, rate)
        columns["failed_at_s"] = np.full(count, np.nan)
        for name, quantities in numbers.items():
            for key, joules in quantities.items():
                columns[f"{key}_{name}_wh"] = joules / J_PER_WH
        for (battery, part), joules in component.items():
            columns[f"component_{battery}_{part}_wh"] = joules / J_PER_WH
        for key in ("failed_segment", "failed_battery"):
            columns[key] = np.full(count, "", dtype=object)
        columns["message"] = reasons
        for name, charge in charges.items():
            columns[f"charge_{name}_wh"] = charge
        return columns, again

    def _values(self, draws: Draws) -> dict[str, Array]:
        _, drawn = split_values(draws, self.model)
        return {name: np.asarray(value)[:, None] for name, value in drawn.items()}

    def _phases(self, entries: Entries, count: int) -> tuple[Array, Array, Array]:
        """Duration, speed at the start and acceleration of each interval, shape (count, intervals)."""
        at = {(interval.leg, interval.phase): i for i, interval in enumerate(self.intervals)}
        duration = np.zeros((count, len(self.intervals)))
        speed = np.zeros_like(duration)
        steady = all(instant for low, _, instant in self.spans if self.plan.legs[low].kind in ("roll", "slide", "turn"))
        # where no speed changes within an interval, one row of zeros serves all runs
        rate = np.zeros((1, len(self.intervals))) if steady else np.zeros_like(duration)
        for low, high, instant in self.spans:
            legs = range(low, high)
            turn = self.plan.legs[low].kind == "turn"
            if self.plan.legs[low].kind not in ("roll", "slide", "turn"):
                for i in legs:
                    duration[:, at[i, 1]] = np.ravel(entries.leg(i, "duration_s"))
                continue
            size = np.concatenate(
                [
                    np.abs(entries.leg(i, "angle_rad") if turn else entries.leg(i, "distance_m")) + np.zeros((count, 1))
                    for i in legs
                ],
                axis=1,
            )
            limit = np.concatenate(
                [entries.leg(i, "yaw_rate_rad_s" if turn else "speed_m_s") + np.zeros((count, 1)) for i in legs], axis=1
            )
            if instant:
                made = phases(size, limit)
            else:
                up = entries.limit("yaw_accel_rad_s2" if turn else "accel_m_s2")
                down = up if turn else entries.limit("decel_m_s2")
                made = phases(size, limit, np.ravel(up) + np.zeros(count), np.ravel(down) + np.zeros(count))
            for k, i in enumerate(legs):
                for phase in (1,) if instant else (0, 1, 2):
                    j = at[i, phase]
                    duration[:, j] = made.duration_s[:, k, phase]
                    speed[:, j] = made.speed_m_s[:, k, phase]
                    if not instant:
                        rate[:, j] = made.accel_m_s2[:, k, phase]
        return duration, speed, rate

    def _covariates(
        self, entries: Entries, start: Array, duration: Array, speed: Array, rate: Array
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        legs = [self.plan.legs[interval.leg] for interval in self.intervals]
        moving = np.array([float(interval.moving) for interval in self.intervals])
        cov: dict[str, Any] = dict(self.columns)
        kinds = {leg.kind for leg in legs}
        ahead = np.array([_ahead(leg) for leg in legs])
        cov["speed_m_s"], cov["accel_m_s2"] = speed * ahead, rate * ahead
        rates: dict[str, Any] = {"speed_m_s": cov["accel_m_s2"]}
        aside = np.array([np.sin(leg.direction_rad) if leg.kind == "slide" else 0.0 for leg in legs])
        cov["lateral_speed_m_s"] = speed * aside if "slide" in kinds else np.zeros(len(legs))
        cov["lateral_accel_m_s2"] = rate * aside if "slide" in kinds else np.zeros(len(legs))
        rates["lateral_speed_m_s"] = cov["lateral_accel_m_s2"]
        bend: Any = np.zeros(len(legs))
        if any(leg.kind == "turn" or leg.curvature_1_m for leg in legs):
            bend = (
                np.concatenate(
                    [
                        np.full((1, 1), np.copysign(1.0, leg.angle_rad))
                        if leg.kind == "turn"
                        else np.reshape(entries.leg(interval.leg, "curvature_1_m"), (-1, 1)) + np.zeros((1, 1))
                        if leg.kind == "roll"
                        else np.zeros((1, 1))
                        for leg, interval in zip(legs, self.intervals, strict=True)
                    ],
                    axis=1,
                )
                if not entries.varies("curvature_1_m")
                else _stack(entries, self.intervals, legs, len(speed))
            )
        cov["yaw_rate_rad_s"] = speed * bend
        rates["yaw_rate_rad_s"] = rate * bend
        for name in SETTINGS:
            cov[name] = entries.setting(name, [interval.leg for interval in self.intervals], len(speed))
        moved = duration * moving
        cov["moving_time_s"] = np.cumsum(moved, axis=1) - moved
        rates["moving_time_s"] = moving
        for name, began in self.switched_on.items():
            on = began >= 0
            cov[f"on_time_{name}_s"] = np.where(on, start - start[:, np.maximum(began, 0)], 0.0)
            rates[f"on_time_{name}_s"] = on.astype(float)
        if any("time_s" in term.effect.needs for term in self.model.terms):
            cov["time_s"], rates["time_s"] = start, np.ones(len(legs))
        return cov, rates

    def _energies(
        self, cov: dict[str, Any], rates: dict[str, Any], duration: Array, values: dict[str, Array], count: int
    ) -> tuple[dict[str, Array], dict[tuple[str, str], Array]]:
        """Energy by battery and interval (count, intervals), and by battery and component (count,), in J."""
        ramps = np.array([interval.phase != 1 for interval in self.intervals])
        if self.model.memory or "time_s" in cov:
            ramps = np.ones_like(ramps)
        steady = np.flatnonzero(~ramps)
        energy = {name: np.zeros_like(duration) for name in self.model.batteries}
        component = {key: np.zeros(count) for key in components_of(self.model)}

        def book(powers: Mapping[str, Mapping[Any, Any]], where: NDArray[np.intp], length: Array, weights: Any) -> None:
            for battery, terms in powers.items():
                mean = np.zeros((1, len(where)))
                for key, power in terms.items():
                    watts = np.asarray(power, dtype=float)
                    if weights is not None:
                        shape = np.broadcast_shapes(watts.shape, (1, len(where) * len(weights)))
                        watts = np.broadcast_to(watts, shape).reshape(shape[0], len(where), -1) @ weights
                    watts = np.broadcast_to(watts, np.broadcast_shapes(watts.shape, (1, len(where))))
                    one = watts.shape[0] == 1
                    component[battery, key.component] += (
                        length @ watts[0] if one else np.einsum("ij,ij->i", length, watts)
                    )
                    mean = mean + watts
                if len(where) == duration.shape[1]:
                    energy[battery] += length * mean
                else:
                    energy[battery][:, where] += length * mean

        if steady.size:
            whole = steady.size == duration.shape[1]
            here, length = (cov, duration) if whole else (_take(cov, steady), duration[:, steady])
            book(self.model.evaluate(here, values), steady, length, None)
        curved = np.flatnonzero(ramps)
        if curved.size:
            length = duration[:, curved]
            times = (0.5 * length[..., None] * (NODES + 1.0)).reshape(count, -1)
            nodes: dict[str, Any] = {}
            for name, value in _take(cov, curved).items():
                repeated = (
                    value[np.repeat(np.arange(curved.size), len(NODES))]
                    if hasattr(value, "codes")
                    else (np.repeat(value, len(NODES), axis=-1))
                )
                change = rates.get(name)
                nodes[name] = (
                    repeated
                    if change is None
                    else repeated + times * np.repeat(np.asarray(change)[..., curved], len(NODES), axis=-1)
                )
            book(self.model.evaluate(nodes, values), curved, length, 0.5 * WEIGHTS)
        for key, joules in self.model.impulses(cov, values).items():
            spread = np.broadcast_to(joules, duration.shape)
            energy[key.battery] += spread
            component[key.battery, key.component] += spread.sum(axis=1)
        return energy, component

    def _distance(self, cov: Mapping[str, Any], duration: Array, rate: Array) -> Array:
        if not rate.any() and not np.any(cov["lateral_speed_m_s"]):
            return np.asarray(np.einsum("ij,ij->i", np.abs(cov["speed_m_s"]), duration))
        ahead = np.abs(cov["speed_m_s"] * duration + 0.5 * cov["accel_m_s2"] * duration**2)
        aside = cov["lateral_speed_m_s"] * duration + 0.5 * cov["lateral_accel_m_s2"] * duration**2
        return np.asarray(np.hypot(ahead, aside).sum(axis=1))


def _stack(entries: Entries, intervals: tuple[Interval, ...], legs: list[Leg], count: int) -> Array:
    return np.concatenate(
        [
            np.zeros((count, 1))
            + (
                np.copysign(1.0, leg.angle_rad)
                if leg.kind == "turn"
                else entries.leg(interval.leg, "curvature_1_m")
                if leg.kind == "roll"
                else 0.0
            )
            for leg, interval in zip(legs, intervals, strict=True)
        ],
        axis=1,
    )


def _ahead(leg: Leg) -> float:
    if leg.kind == "slide":
        return float(np.cos(leg.direction_rad))
    return 1.0 if leg.kind == "roll" else 0.0


def _take(cov: Mapping[str, Any], index: NDArray[np.intp]) -> dict[str, Any]:
    return {
        name: value[index] if hasattr(value, "codes") else np.asarray(value)[..., index] for name, value in cov.items()
    }
