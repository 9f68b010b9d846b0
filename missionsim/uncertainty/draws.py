"""The uncertain values of a mission, their draws by name and run index, and runs with them by SimPy, alone or many."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import SFC64, Generator, Philox
from numpy.typing import NDArray

from missionsim.effects.model import PowerModel
from missionsim.engine.meter import Evaluating, alone, together
from missionsim.engine.outcome import RunResult
from missionsim.engine.setup import split_values
from missionsim.engine.simulate import RunSetup, simulate
from missionsim.errors import MissionsimError
from missionsim.files import Json
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import Distribution, uncertain_values
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, Int64s
from missionsim.plan.build import make_plan, plan_runs
from missionsim.plan.legs import Plan
from missionsim.uncertainty.intervals import PROGRESS_POINTS

CHUNK = 4096
"""Runs that share a generator; drawing one run alone costs at most so many numbers a stream."""
LARGEST_NORMAL = 14.0
"""No normal number here is larger: the generator's tail beyond 3.65 reaches 53 bits' worth, 10.1, further."""
_SMALLEST = 2.0**-54


def _digest(size: int, *parts: object) -> bytes:
    text = "\x00".join(str(part) for part in parts)
    return hashlib.blake2b(text.encode(), digest_size=size, person=b"missionsim.v2").digest()


class Streams:
    """Numbers of the streams of one seed; one generator serves all, put into each chunk's state in turn.

    `seed`: the batch's seed, any size.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._bits = SFC64(0)
        self._state: Any = self._bits.state
        self._generator = Generator(self._bits)

    def normals(self, name: str, first: int, count: int) -> Array:
        """Standard normal numbers of the runs ``first … first + count − 1`` of a stream, shape (count,)."""
        return self._numbers(name, first, count, normal=True)

    def uniforms(self, name: str, first: int, count: int) -> Array:
        """Uniform numbers, strictly between 0 and 1, with 53 bits, shape (count,)."""
        return np.asarray(np.maximum(self._numbers(name, first, count, normal=False), _SMALLEST))

    def _numbers(self, name: str, first: int, count: int, *, normal: bool) -> Array:
        numbers = np.empty(count)
        place = 0
        while place < count:
            chunk, skipped = divmod(first + place, CHUNK)
            size = min(CHUNK - skipped, count - place)
            generator = self._at(name, chunk)
            # numbers come one after the other, so that a chunk's beginning does not depend on how many are taken
            drawn = numbers[place : place + size] if skipped == 0 else np.empty(skipped + size)
            if normal:
                generator.standard_normal(out=drawn)
            else:
                generator.random(out=drawn)
            if skipped:
                numbers[place : place + size] = drawn[skipped:]
            place += size
        return numbers

    def _at(self, name: str, chunk: int) -> Generator:
        words = self._state["state"]["state"]
        words[:3] = np.frombuffer(_digest(24, self.seed, name, chunk), dtype="<u8")
        words[3] = 1
        self._bits.state = self._state
        return self._generator


def run_generator(seed: int, name: str, run: int) -> Generator:
    """A generator of its own for one run, for what needs an unknown number of draws (arrivals, retries). Counter-based
    (Philox, Salmon et al. 2011), keyed by seed and name; 2^128 numbers lie between neighbouring runs."""
    return Generator(Philox(key=int.from_bytes(_digest(16, seed, name), "little"), counter=[0, 0, run, 1]))


Draws = dict[str, Array]


@dataclass(frozen=True)
class UncertainValue:
    """One number that a Monte Carlo varies."""

    name: str
    """Path: the mission's own, or ``robot.…``, ``environment.…``."""
    nominal: float
    """Value without uncertainty, SI."""
    unit: str
    distribution: Distribution


@dataclass(frozen=True)
class Sampler:
    """Draws of all uncertain values of a mission."""

    values: tuple[UncertainValue, ...]
    groups: tuple[tuple[tuple[str, ...], Array], ...] = ()
    """Values that are correlated with each other, with the Cholesky factor of their normal scores. Tuple of (names,
    cholesky)."""

    def draw(self, seed: int, first: int, count: int) -> Draws:
        """Values of the runs ``first … first + count − 1``. Gives name → ndarray of shape (count,), SI. The same for
        any block and whatever else is uncertain."""
        streams = Streams(seed)
        correlated = self._correlated(
            {name: streams.normals(name, first, count) for group in self.groups for name in group[0]}
        )
        found: Draws = {}
        for value in self.values:
            name, law = value.name, value.distribution
            if name in correlated:
                found[name] = law.quantile(correlated[name])
            elif law.of_scores:
                scores, (low, high) = streams.normals(name, first, count), law.score_bounds
                outside = np.zeros(0, dtype=np.intp)
                if max(low, -high) > -LARGEST_NORMAL and count and (scores.min() < low or scores.max() > high):
                    outside = np.flatnonzero((scores < low) | (scores > high))
                found[name] = law.at_scores(scores)
                if outside.size:
                    # where bounds cut a score off, a fresh number of the run takes its place: a score inside has the
                    # truncated distribution already, and so has the fresh one, hence their mixture too
                    fresh = streams.uniforms(f"{name}\x00outside", first, count)[outside]
                    found[name][outside] = law.quantile(fresh)
            else:
                found[name] = law.quantile(streams.uniforms(name, first, count))
        return found

    def at(self, probabilities: Mapping[str, Array]) -> Draws:
        """Values at independent uniform numbers, correlated by a Gaussian copula."""
        from scipy.special import ndtri

        scores = {name: ndtri(probabilities[name]) for names, _ in self.groups for name in names}
        uniform = {**probabilities, **self._correlated(scores)}
        return {value.name: value.distribution.quantile(uniform[value.name]) for value in self.values}

    def _correlated(self, scores: Mapping[str, Array]) -> dict[str, Array]:
        """Probabilities of the values in groups, from independent normal scores of each."""
        found = {}
        for names, cholesky in self.groups:
            from scipy.special import ndtr

            # row by row, so that a run's numbers do not depend on the block they stand in
            for i, name in enumerate(names):
                mixed = cholesky[i, 0] * scores[names[0]]
                for j in range(1, i + 1):
                    mixed = mixed + cholesky[i, j] * scores[names[j]]
                found[name] = ndtr(mixed)
        return found


def make_sampler(mission: MissionSpec) -> Sampler:
    """The sampler of a mission, its robot and its environment. No draw of a parameter of the power model leaves the
    bounds that physics sets."""
    terms = () if mission.robot is None else build_power_model(mission.robot).terms
    bounds = {
        "robot." + term.parameters[spec.name].path: (spec.low, spec.high)
        for term in terms
        for spec in term.effect.parameters
        if spec.name in term.parameters
    }
    found: list[UncertainValue] = []
    for prefix, part in (("", mission), ("robot.", mission.robot), ("environment.", mission.environment)):
        if part is not None:
            for path, parameter in uncertain_values(part):
                assert parameter.distribution is not None
                drawn = parameter.distribution.within(*bounds.get(prefix + path, (-math.inf, math.inf)))
                found.append(UncertainValue(prefix + path, parameter.value, parameter.unit, drawn))
    names = [value.name for value in found]
    return Sampler(tuple(found), _groups(mission, names))


def _groups(mission: MissionSpec, names: list[str]) -> tuple[tuple[tuple[str, ...], Array], ...]:
    pairs = {item.between: item.rho for item in mission.correlations}
    linked = {name: {name} for pair in pairs for name in pair}
    for one, other in pairs:
        together = linked[one] | linked[other]
        for name in together:
            linked[name] = together
    groups: list[tuple[tuple[str, ...], Array]] = []
    for members in {frozenset(group) for group in linked.values()}:
        ordered = tuple(name for name in names if name in members)
        matrix = np.eye(len(ordered))
        for (one, other), rho in pairs.items():
            if one in members:
                i, j = ordered.index(one), ordered.index(other)
                matrix[i, j] = matrix[j, i] = rho
        groups.append((ordered, np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)))
    return tuple(sorted(groups, key=lambda group: group[0]))


MOST_TOGETHER, ROWS_TOGETHER = 256, 30_000
"""Runs, and their intervals, whose energies are evaluated together."""
FAILED = "failed: "
"""Before what is told of a run that could not be driven at all."""
_FAILED = (MissionsimError, ArithmeticError, ValueError, RuntimeError)
"""What ends one run only."""


def simulate_run(
    mission: MissionSpec, model: PowerModel, sampler: Sampler, seed: int, run: int
) -> tuple[dict[str, float], RunResult, bool]:
    """Run number `run` of a batch alone, with SimPy. Gives the drawn values by name, the result, and whether a drawn
    speed was cut to what the robot can do."""
    drawn = {name: float(values[0]) for name, values in sampler.draw(seed, run, 1).items()}
    plan = make_plan(mission, split_values(drawn, model)[0], run_generator(seed, "chance", run))
    result = simulate(mission, values=drawn, plan=plan, model=model)
    return {**drawn, **_chance(plan)}, result, plan.limited


def _chance(plan: Plan) -> dict[str, float]:
    return {f"chance.{what}": float(times) for what, times in plan.chance}


def left_to_chance(mission: MissionSpec) -> tuple[str, ...]:
    """Names of what a mission leaves to chance (``chance.obstacles``); none where all follows from its values."""
    try:
        return tuple(_chance(make_plan(mission, rng=run_generator(0, "chance", 0))))
    except MissionsimError:
        return ()  # the nominal mission cannot be planned; its runs tell why


def simulate_block(
    mission: MissionSpec,
    model: PowerModel,
    sampler: Sampler,
    seed: int,
    first: int,
    count: int,
    draws: Draws | None = None,
    runs: Int64s | None = None,
) -> dict[str, NDArray[np.generic]]:
    """A block of runs with SimPy, as columns; a run that fails is kept with its draws and its message.

    `draws` are those of `sampler`, if they are there already; `runs` the numbers of the runs, where they are not
    those from `first` on.
    """
    own = np.arange(first, first + count, dtype=np.int64) if runs is None else runs
    draws = dict(draws or sampler.draw(seed, first, count))
    chance = left_to_chance(mission)
    numbers, drawn = split_values(draws, model)
    plans: list[Plan | None] = [None] * count  # made at once, but for those that are to be planned alone
    if not chance:
        with contextlib.suppress(MissionsimError):
            planned = plan_runs(mission, numbers)
            odd = [False] * count if planned.odd is None else planned.odd
            plans = [None if alone else plan for plan, alone in zip(planned.each(count), odd, strict=True)]
    made: list[Plan | None] = [None] * count
    rows_of = {**numbers, **drawn}
    each = list(zip(*(np.asarray(column).tolist() for column in rows_of.values()), strict=True)) or [()] * count

    def run(i: int) -> Evaluating[dict[str, Any]]:
        mine = dict(zip(rows_of, each[i], strict=True))
        values = {name: mine[name] for name in numbers}
        made[i] = plan = plans[i] or make_plan(mission, values, run_generator(seed, "chance", int(own[i])))
        setup = RunSetup(mission, plan, model, values, {name: mine[name] for name in drawn})
        setup.again = run_generator(seed, "chance", int(own[i])) if chance or plan.gated else None
        result = yield from setup.run(trace=False)
        made[i] = setup.plan
        return {**row_of(result), "speed_limited": plan.limited}

    columns = {"run": own, **columns_of(mission, model, count)}
    some = next((sum(len(step.phases) for step in plan.steps) for plan in plans if plan is not None), 1)
    size = max(1, min(MOST_TOGETHER, ROWS_TOGETHER // max(1, some)))
    for low in range(0, count, size):
        these = [run(i) for i in range(low, min(low + size, count))]
        for i, found in enumerate(together(model, tuple(mission.robot.components), these), low):
            if isinstance(found, Exception) and not isinstance(found, _FAILED):
                raise found
            if isinstance(found, Exception):
                told = str(found) if isinstance(found, MissionsimError) else f"{type(found).__name__}: {found}"
                found = {name: np.nan for name in columns if name.startswith("component_")}
                found["message"] = f"{FAILED}{told}"
            for name, value in found.items():
                columns[name][i] = value
    counted = [{} if plan is None else _chance(plan) for plan in made]
    for name in chance:
        draws[name] = np.array([found.get(name, np.nan) for found in counted])
    return columns | {f"drawn:{name}": values for name, values in draws.items()}


class _Read(dict[str, float]):
    """Numbers by path that remember which of them were read."""

    def __init__(self, numbers: Mapping[str, float]) -> None:
        super().__init__(numbers)
        self.seen: set[str] = set()

    def get(self, key: str, default: Any = None) -> Any:
        if key in self:
            self.seen.add(key)
        return super().get(key, default)


def unread_values(mission: MissionSpec, model: PowerModel, sampler: Sampler) -> tuple[str, ...]:
    """Uncertain values that a run at the nominal values does not read, so that their draws change nothing there."""
    numbers, _ = split_values({value.name: value.nominal for value in sampler.values}, model)
    read = _Read(numbers)
    try:
        plan = make_plan(mission, read, run_generator(0, "chance", 0))
        setup = RunSetup(mission, plan, model, read, split_values(numbers, model)[1])
        alone(model, setup.names, setup.execute(()))
    except MissionsimError:
        return ()  # its runs tell what is wrong
    used = read.seen | {f"robot.{parameter.path}" for parameter in model.parameters.values()}
    used |= {f"robot.{term.link[0]}" for term in model.terms} | {"robot.body.mass", "robot.body.regeneration"}
    return tuple(name for name in numbers if name not in used)


def components_of(model: PowerModel) -> tuple[tuple[str, str], ...]:
    """Battery and component of every term, each pair once."""
    return tuple(sorted({(term.key.battery, term.key.component) for term in model.terms}))


def columns_of(mission: MissionSpec, model: PowerModel, count: int) -> dict[str, NDArray[np.generic]]:
    """Columns of a block of runs but for their numbers and draws, of which nothing is known yet."""
    batteries = tuple(mission.robot.batteries)
    of_batteries = [f"{what}_{name}_wh" for name in batteries for what in ("energy", "charge_left", "margin", "needed")]
    parts = [f"component_{battery}_{component}_wh" for battery, component in components_of(model)]
    columns: dict[str, NDArray[Any]] = {name: np.zeros(count, dtype=bool) for name in ("feasible", "speed_limited")}
    for name in ("duration_s", "distance_m", "failed_at_s", *of_batteries, *parts):
        columns[name] = np.full(count, 0.0 if name in parts else np.nan)
    columns |= {name: np.full(count, "", dtype=object) for name in ("failed_segment", "failed_battery", "message")}
    return columns | {f"charge_{name}_wh": np.full((PROGRESS_POINTS, count), np.nan).T for name in batteries}


def row_of(result: RunResult) -> Json:
    """A run as one number or text a column."""
    row: dict[str, Any] = {
        "feasible": result.feasible,
        "duration_s": result.duration_s,
        "distance_m": result.distance_m,
        "message": result.reason,
    }
    ends = np.asarray(result.timeline.start_s) + np.asarray(result.timeline.duration_s)
    grid = np.arange(PROGRESS_POINTS) * (result.duration_s / (PROGRESS_POINTS - 1))
    grid[-1] = result.duration_s
    knots = np.concatenate([[0.0], ends])
    failed = []
    for name, battery in result.batteries.items():
        row[f"energy_{name}_wh"] = battery.energy_wh
        row[f"charge_left_{name}_wh"] = battery.charge_left_wh
        row[f"margin_{name}_wh"] = battery.charge_left_wh - battery.reserve_required_wh
        for component, energy in result.by_component_wh(name).items():
            row[f"component_{name}_{component}_wh"] = energy
        charge = np.concatenate([[battery.initial_wh], np.asarray(result.charge_wh[name])])
        row[f"needed_{name}_wh"] = np.nan if battery.needed_wh is None else battery.needed_wh
        row[f"charge_{name}_wh"] = np.interp(grid, knots, charge)
        if battery.empty_at_s is not None:
            failed.append((battery.empty_at_s, battery.empty_in_segment, name))
    if failed:
        time_s, segment, name = min(failed)
        row.update(failed_at_s=time_s, failed_segment=segment, failed_battery=name)
    return row
