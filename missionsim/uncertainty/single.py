"""One run of a batch with SimPy, and a block of them as columns."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import PowerModel
from missionsim.engine.meter import Evaluating, alone, together
from missionsim.engine.outcome import RunResult
from missionsim.engine.setup import split_values
from missionsim.engine.simulate import RunSetup, simulate
from missionsim.errors import MissionsimError
from missionsim.files import Json
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.build import make_plan, plan_runs
from missionsim.plan.legs import Plan
from missionsim.uncertainty.draws import Draws, Sampler, run_generator
from missionsim.uncertainty.intervals import PROGRESS_POINTS

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
    runs: NDArray[np.int64] | None = None,
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
