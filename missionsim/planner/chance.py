"""From a task to a plan that holds: simulated as it is and, where asked, with a probability; by margins that grow."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.files import write_text
from missionsim.inputs.loading import load_mission
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array, Bools
from missionsim.planner.answer import Answer, mission_text
from missionsim.planner.rounds import of_one_kind, plan_rounds
from missionsim.planner.site import Site, make_site
from missionsim.planner.solve import FEW_LABELS, MOST_LABELS, WIDE, Watch, solve_site
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.batch import Task, compute_block, prepare
from missionsim.uncertainty.draws import row_of, simulate_block

Columns = dict[str, NDArray[Any]]
TRIES = 6
CHECKS = 3
"""So often a plan is checked on fresh draws, each time within wider margins."""
NOTHING = 1e-3
"""Of the capacity: a charge that is told as none."""
NEAR = 0.005
"""A share of draws that is no more than this above what is asked is near enough."""
SEED = 20_260_101
RUNS, FEW_RUNS = 4096, 200
"""Draws where arrays evaluate a mission, and where its runs are made one by one."""
SAME = 1e-9


@contextmanager
def _mission_file(answer: Answer) -> Iterator[str]:
    """A file of a plan's mission, while it is needed."""
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "mission.yaml"
        write_text(path, mission_text(answer, path))
        yield str(path)


def as_run(answer: Answer) -> tuple[Answer, RunResult]:
    """A plan with what SimPy says of its mission where that differs: of what the search takes more simply.

    Faults and warnings of the mission are told at the place of the task or of its environment where they come from.
    """
    task = answer.site.task
    with _mission_file(answer) as path:
        try:
            mission = load_mission(path, overrides=task.elsewhere)
        except InputError as error:
            faults = []
            for fault in error.faults:
                first, *rest = fault.path.split(".")
                where: tuple[str | int, ...] = (first, *rest)
                if first == "segments":
                    visit = answer.legs[int(rest[0])].visit
                    where = ("choose",) if visit is None else ("visits", visit, *rest[2:])
                if first in ("segments", "defaults"):
                    got, allowed, hint = fault.got, fault.allowed, fault.hint
                    fault = task.document.fault(where, fault.message, got=got, allowed=allowed, hint=hint)
                faults.append(fault)
            raise InputError(faults) from None
        run = simulate(mission)
    own = {os.path.abspath(item.path): str(item.path) for item in (task.robot, task.environment)}
    known = [(fault, own.get(os.path.abspath(fault.file))) for fault in mission.warnings]
    ours = [replace(fault, file=file) for fault, file in known if file is not None]
    told = [fault for fault in ours if fault not in task.warnings]
    legs_at = {segment.line: leg for segment, leg in zip(run.segments, answer.legs, strict=False)}
    for fault in run.warnings:
        if fault.file == path:
            leg = legs_at[fault.line]
            if leg.piece is not None:
                place = task.environment.document.place(("edges", leg.piece.way.edge))
            else:
                place = task.document.place(("visits",) if leg.visit is None else ("visits", leg.visit))
            fault = place.warning(fault.message, got=fault.got, allowed=fault.allowed)
        told.append(fault)
    run = replace(run, warnings=tuple(told))
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
    objective = float(np.array(real[: 1 + len(energy)]) @ answer.site.weights)
    found = replace(answer, legs=legs, duration_s=run.duration_s, objective=objective)
    found.energy_wh = {name: battery.energy_wh for name, battery in run.batteries.items()}
    found.charge_left_wh = {name: battery.charge_left_wh for name, battery in run.batteries.items()}
    found.extra = {**answer.extra, "corrected": float(np.max(np.abs(np.array(real) - plan) / np.maximum(real, SAME)))}
    return found, run


def plan_task(task: TaskSpec, watch: Watch | None = None) -> tuple[Answer, RunResult | None]:
    """The plan of least objective that holds when it is simulated and, where asked, in so many of fresh draws.

    Where it does not, it is planned within margins on the reserves and the deadline. `watch`: told of the progress;
    stops the search where it returns True, with the best plan so far. Gives a plan with ``probability`` (of draws that
    the margins were not made from) and ``margins`` in `extra` where asked, and the run of its mission.
    """
    site = make_site(task if task.repeat is None else of_one_kind(task))
    asked = None if task.within.with_probability is None else task.within.with_probability.value
    search = _Search(site, watch or (lambda what, objective, bound: False))
    made = search.simulated() if asked is None else search.sure(asked)
    if made is None:
        return search.none(asked), None
    answer, run = made
    place = task.document.place(("within",))
    safer = "within: {reserve_throughout: true}, or with_probability for a margin"
    emptied = []  # batteries of which nothing is left on the way: whatever takes more than planned ends there
    for name, capacity in site.physics.by_name(site.physics.capacity_wh).items():
        leg = min(answer.legs, key=lambda leg: leg.charge_wh[name], default=None)
        if leg is not None and leg.charge_wh[name] <= NOTHING * capacity:
            at = f"on edge '{leg.piece.name}' to '{leg.place}'" if leg.piece is not None else f"at '{leg.place}'"
            text = f"nothing is left of battery '{name}' ({leg.charge_wh[name]:.3f} Wh) {at}"
            emptied.append(place.warning(f"{text}: the reserve is only asked for at the end", allowed=safer))
    return answer, replace(run, warnings=(*run.warnings, *emptied))


def draws_of(answer: Answer, seed: int) -> Columns:
    """Columns of many runs of a plan's mission, each with values drawn. Where they are evaluated as arrays, what a
    battery would lack in a run that empties it is known too."""
    site = answer.site
    with _mission_file(answer) as path:
        task = Task(path, site.task.elsewhere, None, seed, "auto")
        prepared = prepare(task)
        if prepared.arrays is None:
            return compute_block(task, 0, FEW_RUNS)
        drawn = prepared.sampler.draw(seed, 0, RUNS)
        columns, again = prepared.arrays.evaluate(drawn, RUNS)
        empty = (_lowest(site, columns) < -SAME * site.physics.capacity_wh[:, None]).any(axis=0)
        columns["feasible"][empty] = False
        if (rest := np.flatnonzero(again & ~empty)).size:
            some = {name: values[rest] for name, values in drawn.items()}
            mission, model, sampler = prepared.mission, prepared.model, prepared.sampler
            made = simulate_block(mission, model, sampler, seed, 0, rest.size, draws=some, runs=rest)
            for name, column in columns.items():
                column[rest] = made[name]
        return columns


def _lowest(site: Site, columns: Columns) -> Array:
    """The least charge of each battery in each run [Wh], shape (batteries, runs); not a number where a run that SimPy
    did ends with none."""
    return np.array([columns[f"charge_{n}_wh"][:, 0] - columns[f"needed_{n}_wh"] for n in site.physics.names])


def _slack_of(site: Site, columns: Columns) -> Array:
    """What is left before each limit, shape (runs, 2 · batteries + 1): of each battery at the end and on the way [Wh],
    of the time [s]."""
    end = np.array([columns[f"margin_{name}_wh"] for name in site.physics.names])
    way = _lowest(site, columns)
    if site.task.within.reserve_throughout:
        way -= np.array([columns[f"charge_left_{name}_wh"] for name in site.physics.names]) - end
    return np.concatenate([end, way, [site.deadline_s - columns["duration_s"]]]).T


def told(site: Site, columns: Columns) -> dict[str, float]:
    """Share of the runs that hold, with its 95 % interval: those that are feasible, within the deadline, and keep the
    reserve on the way where that is asked."""
    count = len(site.physics.names)
    good = np.asarray(columns["feasible"], dtype=bool) & (columns["duration_s"] <= site.deadline_s * (1.0 + SAME))
    if site.task.within.reserve_throughout:
        way = _slack_of(site, columns)[:, count : 2 * count]
        good &= (way >= -SAME * site.physics.capacity_wh).all(axis=1)
    low, high = proportion_interval(int(good.sum()), good.size)
    return {"value": float(good.mean()), "low": low, "high": high, "runs": int(good.size)}


@dataclass
class _Tried:
    """A plan within margins, as it is simulated."""

    answer: Answer
    run: RunResult
    margins: Array
    """On the charge of each battery at the end and on the way [Wh], and on the time [s]."""


class _Search:
    """Plans of a site within margins, until one holds."""

    def __init__(self, site: Site, watch: Watch) -> None:
        self.site, self.watch = site, watch
        self.names = site.physics.names
        self.found = Answer(site, False)
        self.first: _Tried | None = None
        self.surest: tuple[dict[str, float], Columns] | None = None

    def plan(self, margins: Array, told: str, *, proves: bool = True) -> _Tried | None:
        """The best plan within margins, as it is simulated; with its proof or without."""
        site, physics, count = self.site, self.site.physics, len(self.names)
        tight = physics.but(reserve_wh=physics.reserve_wh + margins[:count], held_wh=margins[count:-1])
        within = replace(site, physics=tight, deadline_s=site.deadline_s - float(margins[-1]))
        labels = MOST_LABELS if proves else FEW_LABELS

        def watch(what: str, objective: float, bound: float) -> bool:
            return self.watch(told, objective, bound)

        shift = site.task.repeat is not None
        self.found = plan_rounds(within, watch) if shift else solve_site(within, watch, labels=labels)
        if not self.found.feasible:
            return None
        tried = _Tried(*as_run(replace(self.found, site=site)), margins)
        self.first = self.first or tried
        return tried

    def simulated(self) -> tuple[Answer, RunResult] | None:
        """The plan that holds when it is simulated, within margins for what the search takes more simply."""
        site, within, margins = self.site, self.site.task.within, np.zeros(2 * len(self.names) + 1)
        for attempt in range(TRIES):
            tried = self.plan(margins, f"margins for what the search leaves out, {attempt}" if attempt else "")
            if tried is None:
                return None
            answer, run = tried.answer, tried.run
            begins = np.cumsum([0.0, *(leg.duration_s for leg in answer.legs)])
            charged = max(begins[1:][[leg.kind == "charge" for leg in answer.legs]], default=0.0)
            # what each battery lacks at the end and on the way, and the time
            end, way = [], []
            for b, (name, battery) in enumerate(run.batteries.items()):
                lacks, empty = battery.reserve_required_wh - battery.charge_left_wh, battery.empty_at_s is not None
                end.append(0.0 if (battery.empty_at_s or charged) < charged else lacks)
                # below its cut-off a circuit is empty with charge in it
                way.append(battery.deficit_wh + max(battery.charge_left_wh, 0.0) if empty else 0.0)
                if within.reserve_throughout:
                    lowest = float(np.min(run.charge_wh[name], initial=battery.charge_left_wh))
                    way[-1] = max(way[-1], float(site.physics.reserve_wh[b]) - lowest)
            short = np.maximum([*end, *way, answer.duration_s - site.deadline_s * (1.0 + SAME)], 0.0)
            windows = [None if leg.visit is None else site.task.visits[leg.visit].window for leg in answer.legs]
            missed = any(
                window is not None and window.until is not None and begin > window.until.value * (1.0 + SAME) + SAME
                for window, begin in zip(windows, begins[:-1], strict=True)
            )
            if run.feasible and not (short > SAME).any() and not missed:
                return answer, run
            if answer.stopped or not short.any():
                return None
            # more than lacked, each time: a margin costs charge itself, and would only come near what is enough
            margins = margins + short * (1.0 + SAME + 0.1 * attempt)
        return None

    def sure(self, asked: float) -> tuple[Answer, RunResult] | None:
        """The plan that holds in a share of fresh draws, within margins that are as tight as the draws can tell; or a
        better one within these margins, with the proof."""
        target = asked
        for check in range(CHECKS):
            tried = self._tight(target, asked)
            if tried is None:
                return None
            fresh = self._draw(tried, SEED + 1 + check)
            if fresh["value"] >= asked:
                break
            if tried.answer.stopped:
                return None
            # as if half a standard error less had been seen of the draws that the margins were made from
            target = min(target + asked - fresh["value"] + 0.5 * math.sqrt(asked * (1.0 - asked) / fresh["runs"]), 1.0)
        else:
            return None
        answer = tried.answer
        vain = answer.extra.get("assumed") and answer.gap > WIDE
        if self.site.task.repeat is None and not answer.stopped and answer.gap > SAME and not vain:
            proved = self.plan(tried.margins, f"proof, for what holds in {100 * fresh['value']:.2f} %")
            if proved is not None:
                said = {key: proved.answer.extra[key] for key in ("assumed",) if key in proved.answer.extra}
                again = self._draw(proved, SEED + CHECKS + 1)
                if proved.answer.objective < answer.objective * (1.0 - SAME) and again["value"] >= asked:
                    tried, fresh = proved, again
                bound = min(proved.answer.bound, tried.answer.objective)
                answer = replace(tried.answer, bound=bound, stopped=proved.answer.stopped)
                answer.extra |= said
        count, margins = len(self.names), tried.margins.tolist()
        answer.extra["probability"] = fresh | {"asked": asked}
        answer.extra["margins"] = {
            "reserve_wh": dict(zip(self.names, margins[:count], strict=True)),
            "on_the_way_wh": dict(zip(self.names, margins[count:-1], strict=True)),
            "deadline_s": margins[-1],
        }
        return answer, tried.run

    def _draw(self, tried: _Tried, seed: int) -> dict[str, float]:
        """In how many draws a plan holds; what the surest was is kept."""
        columns = draws_of(tried.answer, seed)
        share = told(self.site, columns)
        if self.surest is None or share["value"] > self.surest[0]["value"]:
            self.surest = share, columns
        self.columns = columns
        return share

    def _tight(self, target: float, asked: float) -> _Tried | None:
        """The cheapest plan found that holds in a share of the draws that margins are made from."""
        margins = np.zeros(2 * len(self.names) + 1)
        low, high, beyond = None, None, None  # margins within which too few draws hold, enough do, no plan is
        best: _Tried | None = None
        limits = np.zeros(len(margins), dtype=bool)
        told_of = f"plan for {100 * asked:g} %"
        for attempt in range(TRIES):
            tried = self.plan(margins, f"{told_of}, {attempt + 1}", proves=False)
            if tried is None:
                if low is None or self.found.stopped:
                    return best
                beyond = margins  # no plan keeps such margins
                margins = 0.5 * (low + beyond)
                continue
            share = self._draw(tried, SEED)
            told_of = f"plan for {100 * asked:g} % (last held in {100 * share['value']:.2f} %)"
            if share["value"] >= target:
                high = margins
                if best is None or tried.answer.objective < best.answer.objective:
                    best = tried
                if not margins.any() or share["value"] <= target + NEAR:
                    break
            else:
                low = margins
            if tried.answer.stopped and best is not None:
                break
            # in haste somewhat more than needed, so that the first plan within holds
            needed = self._needed(tried, limits, min(target + 0.5 * NEAR, 1.0)) * (1.2 if tried.answer.stopped else 1.0)
            if not needed.any():
                break
            if any(known is not None and np.allclose(needed, known, rtol=0.02) for known in (low, high, beyond)):
                if high is not None and low is not None:
                    needed = 0.5 * (low + high)
                elif beyond is not None and low is not None:
                    needed = 0.5 * (low + beyond)
                else:
                    needed = 1.2 * needed
            margins = needed
        return best

    def _needed(self, tried: _Tried, limits: Bools, target: float) -> Array:
        """The least margins, alike in share for all limits that matter, within which a share of the draws would be.
        `limits`: which matter; those that some draw of this plan breaks are added."""
        slack = _slack_of(self.site, self.columns)
        told = {name: value for name, value in row_of(tried.run).items() if not isinstance(value, str)}
        columns: Columns = {name: np.nan_to_num(np.array([value])) for name, value in told.items()}
        away = _slack_of(self.site, columns) - slack
        limits |= ~(slack >= 0.0).all(axis=0)
        made = np.zeros(len(limits))
        if not limits.any():
            return made
        away = away[:, limits]
        low, high = target, 1.0
        for _ in range(20):
            share = 0.5 * (low + high)
            within = np.nanquantile(away, share, axis=0, method="higher")
            low, high = (low, share) if (away <= within).all(axis=1).mean() >= target else (share, high)
        made[limits] = np.maximum(np.nanquantile(away, high, axis=0, method="higher"), 0.0) * (1.0 + SAME)
        return made

    def none(self, asked: float | None) -> Answer:
        """That there is no plan, with what is known of why."""
        site, found = self.site, self.found
        if self.first is None:
            return Answer(site, False, notes=found.notes, extra=found.extra)
        if found.stopped:
            note = "the search was stopped before it found a plan that holds when it is simulated; there may be one"
            return Answer(site, False, notes=[note], stopped=True)
        if self.surest is None or asked is None:
            why = self.first.run.reason or "too late, or outside a window"
            held = f"the plan found does not hold when it is simulated ({why})"
            return Answer(site, False, notes=[f"{held}, and within margins for that there is none"])
        surest, columns = self.surest
        note = f"no plan was found that holds in {100 * asked:g} % of the draws"
        notes = [f"{note}, the surest that was found holds in {100 * surest['value']:.2f} %"]
        # single changes: a later deadline if that alone does, and asking for no more than the surest gives for certain
        would_do: list[dict[str, Any]] = []
        late = np.where(columns["feasible"], columns["duration_s"], np.inf)
        # two standard errors more than is asked, for other draws will be others
        share = asked + 2.0 * math.sqrt(asked * (1.0 - asked) / late.size)
        end = float(np.quantile(late, share, method="higher")) if share < 1.0 else np.inf
        if site.deadline_s < end < np.inf:
            text = f"a deadline of {end:.1f} s ({end - site.deadline_s:.1f} s later)"
            would_do.append({"change": "within.deadline", "to": end, "unit": "s", "text": text})
        if (less := float(np.floor(1e3 * surest["low"]) / 1e3)) > 0.0:
            text = f"with_probability: {100 * less:.1f} %"
            would_do.append({"change": "within.with_probability", "to": less, "unit": "", "text": text})
        return Answer(site, False, notes=notes, extra={"probability": surest | {"asked": asked}, "would_do": would_do})
