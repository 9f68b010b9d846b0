"""From a task to a plan that holds: simulated as it is and, where asked, with a probability; by margins that grow."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import Fault, InputError
from missionsim.files import write_text
from missionsim.inputs.loading import load_mission
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array
from missionsim.planner.answer import Answer
from missionsim.planner.rounds import of_one_kind, plan_rounds
from missionsim.planner.solve import Watch, solve_site
from missionsim.planner.tour import Site, make_site
from missionsim.planner.write import mission_text
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.batch import Task, compute_block, prepare

RUNS = 4096
TRIES = 6
SEED = 20_260_101
SAME = 1e-9


@contextmanager
def _mission(answer: Answer) -> Iterator[str]:
    """A file of a plan's mission, while it is needed."""
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "mission.yaml"
        write_text(path, mission_text(answer, path))
        yield str(path)


def draws_of(answer: Answer, seed: int, runs: int = RUNS) -> dict[str, NDArray[Any]]:
    """Columns of many runs of a plan's mission, each with values drawn."""
    with _mission(answer) as path:
        task = Task(path, answer.site.task.elsewhere, None, seed, "auto")
        if prepare(task).arrays is None:
            runs = min(runs, 200)  # one by one: a minute and more for what arrays do in a second
        return compute_block(task, 0, runs)


def as_run(answer: Answer) -> tuple[Answer, RunResult]:
    """A plan with what SimPy says of its mission where that differs: of what the search takes more simply."""
    task = answer.site.task
    with _mission(answer) as path:
        try:
            mission = load_mission(path, overrides=task.elsewhere)
        except InputError as error:
            raise InputError([_in_task(answer, fault) for fault in error.faults]) from None
        run = simulate(mission)
    own = {os.path.abspath(item.path): str(item.path) for item in (task.robot, task.environment)}
    known = [(fault, own.get(os.path.abspath(fault.file))) for fault in mission.warnings]
    told = tuple(replace(fault, file=file) for fault, file in known if file is not None)
    run = replace(run, warnings=(*(fault for fault in told if fault not in task.warnings), *run.warnings))
    plan = [answer.duration_s, *answer.energy_wh.values(), *answer.charge_left_wh.values()]
    batteries = run.batteries.values()
    real = [run.duration_s, *(b.energy_wh for b in batteries), *(b.charge_left_wh for b in batteries)]
    if np.allclose(plan, real, rtol=SAME, atol=SAME) or not run.completed or len(run.segments) != len(answer.legs):
        return answer, run
    energy = {name: run.by_segment_wh(name) for name in run.batteries}
    legs, before = [], 0.0
    for i, leg in enumerate(answer.legs):
        last = int(np.searchsorted(run.timeline.segment, i, side="right")) - 1
        charge = {n: float(run.charge_wh[n][last]) if last >= 0 else b.initial_wh for n, b in run.batteries.items()}
        end = run.segment_end_s[i]
        used = {name: float(wh[i]) for name, wh in energy.items()}
        legs.append(replace(leg, duration_s=end - before, energy_wh=used, charge_wh=charge))
        before = end
    objective = float(answer.site.objective(np.array(real[: 1 + len(energy)])))
    found = replace(answer, legs=legs, duration_s=run.duration_s, objective=objective)
    found.energy_wh = {name: battery.energy_wh for name, battery in run.batteries.items()}
    found.charge_left_wh = {name: battery.charge_left_wh for name, battery in run.batteries.items()}
    found.extra = {**answer.extra, "corrected": float(np.max(np.abs(np.array(real) - plan) / np.maximum(real, SAME)))}
    return found, run


def _in_task(answer: Answer, fault: Fault) -> Fault:
    """A fault of the mission that a plan makes, at the place of the task where it comes from."""
    task, (first, *rest) = answer.site.task, fault.path.split(".")
    where: tuple[str | int, ...] = (first, *rest)
    if first == "segments":
        visit = answer.legs[int(rest[0])].visit
        where = ("choose",) if visit is None else ("visits", visit, *rest[2:])
    elif first != "defaults":
        return fault
    return task.document.fault(where, fault.message, got=fault.got, allowed=fault.allowed, hint=fault.hint)


def holds(site: Site, columns: dict[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Which runs are feasible and within the deadline."""
    late = columns["duration_s"] > site.deadline_s * (1.0 + 1e-9)
    return np.asarray(columns["feasible"], dtype=bool) & ~late


def told(site: Site, columns: dict[str, NDArray[Any]]) -> dict[str, float]:
    """Share of the runs that hold, with its 95 % interval."""
    good = holds(site, columns)
    low, high = proportion_interval(int(good.sum()), good.size)
    return {"value": float(good.mean()), "low": low, "high": high, "runs": int(good.size)}


def plan_task(task: TaskSpec, watch: Watch | None = None) -> tuple[Answer, RunResult | None]:
    """The plan of least objective that holds when it is simulated and, where asked, in so many of fresh draws.

    Where it does not, margins on the reserves and the deadline grow until it does.

    Parameters
    ----------
    task : TaskSpec
    watch : callable, optional
        Told of the progress; stops the search where it returns True, with the best plan so far.

    Returns
    -------
    Answer
        With ``probability`` (of draws that the margins were not made from) and ``margins`` in `extra` where asked.
    RunResult or None
        Of its mission.
    """
    site = make_site(task if task.repeat is None else of_one_kind(task))
    asked = None if task.within.with_probability is None else task.within.with_probability.value
    physics = site.physics
    kept, count = physics.reserve_wh, len(physics.names)
    margins = np.zeros(2 * count + 1)  # at the end and on the way of each battery, of time
    first = surest = low = enough = beyond = None
    best: tuple[Answer, RunResult] | None = None
    for attempt in range(TRIES):
        now = margins
        physics.reserve_wh, physics.held_wh = kept + now[:count], now[count:-1]
        try:
            within = replace(site, deadline_s=site.deadline_s - float(now[-1]))
            found = plan_rounds(within, watch) if task.repeat is not None else solve_site(within, watch)
        finally:
            physics.reserve_wh, physics.held_wh = kept, np.zeros(count)
        if not found.feasible:
            if asked is None or low is None:
                break
            beyond = now  # no plan keeps such margins
            margins = 0.5 * (low + beyond)
            continue
        answer, run = as_run(replace(found, site=site))
        first = first or answer
        late = max(0.0, answer.duration_s - site.deadline_s * (1.0 + SAME))
        short = np.append(_short(answer, run), late)
        good = run.feasible and not (short > SAME).any() and not _missed(answer)
        if asked is not None:
            columns = draws_of(answer, SEED + 2 * attempt)
            told_of = told(site, columns)
            if told_of["value"] >= asked:
                told_of = told(site, draws_of(answer, SEED + 2 * attempt + 1))
            good = told_of["value"] >= asked
            answer.extra["probability"] = told_of | {"asked": asked}
            if surest is None or told_of["value"] > surest["value"]:
                surest = told_of
            answer.extra["margins"] = {
                "reserve_wh": dict(zip(physics.names, now[:count].tolist(), strict=True)),
                "deadline_s": float(now[-1]),
            }
            # each limit is to hold often enough, and all of them together
            each = [-columns[f"margin_{name}_wh"] for name in physics.names]
            limits = max(1, sum(float(np.nanquantile(lacking, asked)) > 0.0 for lacking in each))
            share = 1.0 - (1.0 - asked) / (limits + 1 + attempt)
            lacks = [float(np.nanquantile(lacking, share)) for lacking in each]
            to_dock = [lack * any(leg.kind == "charge" for leg in answer.legs) for lack in lacks]
            late = float(np.nanquantile(columns["duration_s"], share)) - site.deadline_s
            short = np.array([*lacks, *to_dock, late])
        if good:
            enough = now
            if best is None or answer.objective < best[0].objective:
                best = answer, run
        else:
            low = now
        if best is not None and (answer.stopped or asked is None or low is None):
            return best
        if answer.stopped:
            break
        if enough is not None and low is not None:  # the cheapest plan lies between too little and enough
            now = 0.5 * (low + enough)
        elif beyond is not None and low is not None:
            now = 0.5 * (low + beyond)
        elif not (short > 0.0).any():
            break
        else:
            now = now + np.maximum(short, 0.0) * (1.0 + SAME)
        margins = now
    if best is not None:
        return best
    if first is None:
        return Answer(site, False, notes=found.notes, extra=found.extra), None
    if answer.stopped:
        note = "the search was stopped before it found a plan that holds when it is simulated; there may be one"
        return Answer(site, False, notes=[note], stopped=True), None
    if surest is None or asked is None:
        why = run.reason or "too late, or outside a window"
        note = f"the plan found does not hold when it is simulated ({why}), and within margins for that there is none"
        return Answer(site, False, notes=[note]), None
    note = f"no plan was found that holds in {100 * asked:g} % of the draws"
    extra = {"probability": surest | {"asked": asked}, "would_do": _surer(site, columns, asked, surest["low"])}
    return Answer(
        site, False, notes=[f"{note}, the surest that was found holds in {100 * surest['value']:.2f} %"], extra=extra
    ), None


def _surer(site: Site, columns: dict[str, NDArray[Any]], asked: float, low: float) -> list[dict[str, Any]]:
    """Single changes with which a plan holds as often as is asked: a later deadline if that alone does, and asking for
    no more than the surest plan gives for certain."""
    found = []
    late = np.where(columns["feasible"], columns["duration_s"], np.inf)
    # two standard errors more than is asked, for other draws will be others
    share = asked + 2.0 * float(np.sqrt(asked * (1.0 - asked) / late.size))
    end = float(np.quantile(late, share, method="higher")) if share < 1.0 else np.inf
    if site.deadline_s < end < np.inf:
        text = f"a deadline of {end:.1f} s ({end - site.deadline_s:.1f} s later)"
        found.append({"change": "within.deadline", "to": end, "unit": "s", "text": text})
    if (less := float(np.floor(1e3 * low) / 1e3)) > 0.0:
        text = f"with_probability: {100 * less:.1f} %"
        found.append({"change": "within.with_probability", "to": less, "unit": "", "text": text})
    return found


def _short(answer: Answer, run: RunResult) -> Array:
    """What each battery lacks at the end of the run, and what each lacks on the way, Wh, shape (2 · batteries,)."""
    site, batteries = answer.site, run.batteries.items()
    end = [0.0 if b.empty_at_s is not None else b.reserve_required_wh - b.charge_left_wh for _, b in batteries]
    way = [max(b.deficit_wh, 0.0) if b.empty_at_s is not None else 0.0 for _, b in batteries]
    if site.task.within.reserve_throughout:
        lowest = [float(np.min(run.charge_wh[name], initial=b.charge_left_wh)) for name, b in batteries]
        way = np.maximum(way, site.physics.reserve_wh - np.array(lowest)).tolist()
    return np.maximum([*end, *way], 0.0)


def _missed(answer: Answer) -> bool:
    """Whether a visit begins outside its window."""
    clock = 0.0
    for leg in answer.legs:
        window = None if leg.visit is None else answer.site.task.visits[leg.visit].window
        if window is not None and window.until is not None and clock > window.until.value * (1.0 + SAME) + SAME:
            return True
        clock += leg.duration_s
    return False
