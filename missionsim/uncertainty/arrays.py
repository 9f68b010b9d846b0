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
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.outcome import J_PER_WH
from missionsim.engine.simulate import RESERVE_TOLERANCE, RunSetup, simulate, split_values
from missionsim.errors import MissionsimError
from missionsim.plan.build import make_plan
from missionsim.plan.kinematics import phases
from missionsim.plan.legs import Leg, Plan
from missionsim.spec.mission import MissionSpec
from missionsim.uncertainty.draws import Draws, Sampler
from missionsim.uncertainty.probe import Dependence, probe
from missionsim.uncertainty.single import PROGRESS_POINTS, components_of, left_to_chance, simulate_block

Array = NDArray[np.float64]
_LEG = ("distance_m", "speed_m_s", "curvature_1_m", "angle_rad", "yaw_rate_rad_s", "duration_s")
_SETTINGS = ("payload_kg", "slope_rad")
_LIMITS = ("accel_m_s2", "decel_m_s2", "yaw_accel_rad_s2")
_CHECK_PROBABILITIES = (0.5, 0.002, 0.998, 0.25, 0.75)
CACHED_RUNS = 1024
"""Runs evaluated at a time: their arrays of draws × intervals stay in the processor's cache."""
AGREEMENT = 1e-9
"""Largest relative difference to SimPy that is accepted."""


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
        entries = _Entries(self.plan, self.dependence, draws)
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
            charges[name] = _at(grid, ends, np.concatenate([initial[:, None], lowest], axis=1)) / J_PER_WH
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

    def _phases(self, entries: _Entries, count: int) -> tuple[Array, Array, Array]:
        """Duration, speed at the start and acceleration of each interval, shape (count, intervals)."""
        at = {(interval.leg, interval.phase): i for i, interval in enumerate(self.intervals)}
        duration = np.zeros((count, len(self.intervals)))
        speed, rate = np.zeros_like(duration), np.zeros_like(duration)
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
                    speed[:, j], rate[:, j] = made.speed_m_s[:, k, phase], made.accel_m_s2[:, k, phase]
        return duration, speed, rate

    def _covariates(
        self, entries: _Entries, start: Array, duration: Array, speed: Array, rate: Array
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
        for name in _SETTINGS:
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
                energy[battery][:, where] += length * mean

        if steady.size:
            book(self.model.evaluate(_take(cov, steady), values), steady, duration[:, steady], None)
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
        ahead = np.abs(cov["speed_m_s"] * duration + 0.5 * cov["accel_m_s2"] * duration**2)
        aside = cov["lateral_speed_m_s"] * duration + 0.5 * cov["lateral_accel_m_s2"] * duration**2
        return np.asarray(np.hypot(ahead, aside).sum(axis=1))


class _Entries:
    """The plan's numbers at draws, each of shape (n, 1) or a number."""

    def __init__(self, plan: Plan, dependence: Dependence, draws: Draws) -> None:
        self.plan, self.dependence, self.draws = plan, dependence, draws
        self.varying = set(dependence.varying.tolist())
        self.width = len(_LEG) + len(_SETTINGS)

    def entry(self, index: int) -> Any:
        return self.dependence.at(self.draws, index) if index in self.varying else float(self.dependence.base[index])

    def leg(self, leg: int, name: str) -> Any:
        return self.entry(leg * self.width + _LEG.index(name))

    def varies(self, name: str) -> bool:
        place = _LEG.index(name)
        return any(index % self.width == place for index in self.varying if index < self.width * len(self.plan.legs))

    def setting(self, name: str, legs: list[int], count: int) -> Array:
        place = len(_LEG) + _SETTINGS.index(name)
        indices = [leg * self.width + place for leg in legs]
        if not self.varying.intersection(indices):
            return np.asarray(self.dependence.base[indices])
        return np.concatenate([np.zeros((count, 1)) + self.entry(index) for index in indices], axis=1)

    def limit(self, name: str) -> Any:
        return self.entry(self.width * len(self.plan.legs) + _LIMITS.index(name))

    def battery(self, battery: int, which: int) -> Any:
        return self.entry(self.width * len(self.plan.legs) + len(_LIMITS) + 3 * battery + which)


def _stack(entries: _Entries, intervals: tuple[Interval, ...], legs: list[Leg], count: int) -> Array:
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


def _at(grid: Array, times: Array, values: Array) -> Array:
    """Linear interpolation of each row, of shapes (n, points), (n, knots) and (n, knots); times of a row increase."""
    count, knots = times.shape
    # one search over all rows: each row's times, as parts of its last, get a range of their own
    row = 2.0 * np.arange(count)[:, None]
    scale = np.where(times[:, -1:] > 0.0, times[:, -1:], 1.0)
    found = np.searchsorted((times / scale + row).ravel(), (grid / scale + row).ravel(), side="right").reshape(
        grid.shape
    )
    right = np.clip(found - knots * np.arange(count)[:, None], 1, knots - 1)
    t0, t1 = np.take_along_axis(times, right - 1, axis=1), np.take_along_axis(times, right, axis=1)
    v0, v1 = np.take_along_axis(values, right - 1, axis=1), np.take_along_axis(values, right, axis=1)
    part = np.where(t1 > t0, (grid - t0) / np.where(t1 > t0, t1 - t0, 1.0), 1.0)
    return np.asarray(v0 + (v1 - v0) * np.clip(part, 0.0, 1.0))


def _numbers(plan: Plan, setup: RunSetup) -> Array:
    """Every number that a run's arrays need, in the order of `_Entries`."""
    values: list[float] = []
    for leg in plan.legs:
        values += [getattr(leg, name) for name in _LEG]
        values += [getattr(leg.settings, name) for name in _SETTINGS]
    limits = plan.limits
    decel = limits.decel_m_s2 or limits.accel_m_s2
    values += [np.nan if v is None else v for v in (limits.accel_m_s2, decel, limits.yaw_accel_rad_s2)]
    for name, battery in setup.batteries.items():
        values += [battery.capacity_j, float(battery.charge_j(battery.initial)), setup.required[name]]
    return np.asarray(values, dtype=float)


def compile_arrays(mission: MissionSpec, model: PowerModel, sampler: Sampler) -> ArrayMission | str:
    """Compile a mission for evaluation as arrays.

    Parameters
    ----------
    mission : MissionSpec
    model : PowerModel
    sampler : Sampler

    Returns
    -------
    ArrayMission or str
        The compiled mission, or in words why its runs need SimPy.
    """
    nominal = {value.name: value.nominal for value in sampler.values}
    try:
        plan = make_plan(mission)
        setup = RunSetup(mission, plan, model, {}, {})
        world = setup.execute(())
        whole = simulate(mission, plan=plan, model=model)
    except MissionsimError as error:
        return f"the nominal mission fails: {error}"
    reason = _obstacle(mission, plan, setup, whole)
    if reason:
        return reason
    shape = [
        (leg.kind, leg.instant, leg.direction_rad, leg.settings._replace(payload_kg=0.0, slope_rad=0.0))
        for leg in plan.legs
    ]

    def numbers_of(values: Mapping[str, float]) -> Array:
        numbers, drawn = split_values(values, model)
        varied = make_plan(mission, numbers)
        same = [
            (leg.kind, leg.instant, leg.direction_rad, leg.settings._replace(payload_kg=0.0, slope_rad=0.0))
            for leg in varied.legs
        ]
        if same != shape:
            raise ValueError("an uncertain value changes what the plan consists of")
        return _numbers(varied, RunSetup(mission, varied, model, numbers, drawn))

    checks = [
        {
            name: float(values[0])
            for name, values in sampler.at({value.name: np.array([p]) for value in sampler.values}).items()
        }
        for p in _CHECK_PROBABILITIES
    ]
    found = probe(numbers_of, nominal, checks)
    if isinstance(found, str):
        return found
    made = _assemble(mission, model, sampler, plan, found, world)
    return made if isinstance(made, str) else (_disagreement(made, checks) or made)


def _obstacle(mission: MissionSpec, plan: Plan, setup: RunSetup, whole: Any) -> str:
    if plan.activities:
        return "activities overlap with the segments, so that events may change their order"
    if any(leg.recharge is not None for leg in plan.legs):
        return "it recharges"
    chance = left_to_chance(mission)
    if chance:
        return f"chance decides in each run: {', '.join(name.removeprefix('chance.') for name in chance)}"
    if any(not isinstance(battery, ConstantEnergy) for battery in setup.batteries.values()):
        return "a battery is no constant store of energy"
    if any(component.startup_s for component in setup.components):
        return "components take time to start"
    if not whole.completed:
        return "the nominal mission does not end"
    if any(b.home_wh for b in whole.batteries.values()):
        return "it ends away from its dock, so that each run has a way home of its own"
    return ""


def _assemble(
    mission: MissionSpec, model: PowerModel, sampler: Sampler, plan: Plan, dependence: Dependence, world: Any
) -> ArrayMission | str:
    spans, intervals, low = [], [], 0
    was_moving = False
    for step in plan.steps:
        high = 1 + max((phase.leg for phase in step.phases), default=low)
        leg = plan.legs[low]
        moves = leg.kind in ("roll", "slide", "turn")
        limit = plan.limits.yaw_accel_rad_s2 if leg.kind == "turn" else plan.limits.accel_m_s2
        instant = leg.instant or limit is None
        spans.append((low, high, instant))
        for i in range(low, high):
            for phase in (0, 1, 2) if moves and not instant else (1,):
                intervals.append(Interval(i, phase, moves, moves and not was_moving))
                was_moving = moves
        low = high
    if low != len(plan.legs):
        return "the steps of the plan do not cover its legs"
    batch = world.meter.batches
    if len(batch) != 1:
        return "the nominal run is not evaluated in one piece"
    line = batch[0].timeline
    # without activities, an interval ends where a phase ends
    phase_legs = [phase.leg for step in plan.steps for phase in step.phases if phase.duration_s > 0.0]
    if len(phase_legs) != len(line):
        return "components switch within a leg"
    states: dict[int, int] = {}
    for i, leg_index in enumerate(phase_legs):
        states.setdefault(leg_index, i)
    missing = [interval.leg for interval in intervals if interval.leg not in states]
    if missing:
        return "a leg takes no time at the nominal values"
    pick = np.array([states[interval.leg] for interval in intervals])
    skip = {
        "speed_m_s",
        "accel_m_s2",
        "lateral_speed_m_s",
        "lateral_accel_m_s2",
        "yaw_rate_rad_s",
        "moving",
        "moving_time_s",
        "starts",
        "slope_rad",
        "payload_kg",
        "time_s",
    }
    columns: dict[str, Any] = {
        name: value[pick] if hasattr(value, "codes") else np.asarray(value)[pick]
        for name, value in line.columns.items()
        if name not in skip and not name.startswith("on_time_")
    }
    columns["moving"] = np.array([float(interval.moving) for interval in intervals])
    columns["starts"] = np.array([float(interval.begins) for interval in intervals])
    switched = {}
    for name in [n[8:-2] for n in line.columns if n.startswith("on_time_")]:
        if f"on_time_{name}_s" in model.memory:
            units = columns[f"on_{name}"] > 0
            began, current = np.full(len(intervals), -1), -1
            for j, on in enumerate(units):
                current = (j if current < 0 else current) if on else -1
                began[j] = current
            switched[name] = began
    return ArrayMission(mission, model, sampler, plan, dependence, tuple(spans), tuple(intervals), columns, switched)


def _disagreement(made: ArrayMission, checks: list[dict[str, float]]) -> str:
    """Why the arrays are not to be trusted: the largest difference to SimPy on the checked draws; empty if none."""
    draws = {name: np.array([check[name] for check in checks]) for name in (checks[0] if checks else {})}
    columns, again = made.evaluate(draws, len(checks))
    for i, check in enumerate(checks):
        if again[i]:
            continue
        try:
            result = simulate(made.mission, values=check, model=made.model)
        except MissionsimError as error:
            return f"a drawn mission fails: {error}"
        for name, battery in result.batteries.items():
            ours = float(columns[f"energy_{name}_wh"][i])
            if abs(ours - battery.energy_wh) > AGREEMENT * max(abs(battery.energy_wh), 1e-12):
                return (
                    f"arrays and SimPy differ by {abs(ours / battery.energy_wh - 1):.1e} on battery '{name}' "
                    "(a term has a kink or fades inside an interval)"
                )
        if bool(columns["feasible"][i]) != result.feasible:
            return "arrays and SimPy do not agree on what is feasible"
    return ""
