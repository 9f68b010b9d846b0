"""From a task to a plan that holds: simulated as it is and, where asked, with a probability; by margins that grow."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import Fault, InputError
from missionsim.inputs.loading import load_mission
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array
from missionsim.planner.answer import Answer, Leg
from missionsim.planner.draws import Columns, draws_of, mission_file, slack_of, standard_error, surer, told
from missionsim.planner.rounds import of_one_kind, plan_rounds
from missionsim.planner.solve import FEW_LABELS, MOST_LABELS, WIDE, Watch, solve_site
from missionsim.planner.tour import Site, make_site

TRIES = 6
CHECKS = 3
"""So often a plan is checked on fresh draws, each time within wider margins."""
NOTHING = 1e-3
"""Of the capacity: a charge that is told as none."""
NEAR = 0.005
"""A share of draws that is no more than this above what is asked is near enough."""
SEED = 20_260_101
SAME = 1e-9


def as_run(answer: Answer) -> tuple[Answer, RunResult]:
    """A plan with what SimPy says of its mission where that differs: of what the search takes more simply."""
    task = answer.site.task
    with mission_file(answer) as path:
        try:
            mission = load_mission(path, overrides=task.elsewhere)
        except InputError as error:
            raise InputError([_in_task(answer, fault) for fault in error.faults]) from None
        run = simulate(mission)
    own = {os.path.abspath(item.path): str(item.path) for item in (task.robot, task.environment)}
    known = [(fault, own.get(os.path.abspath(fault.file))) for fault in mission.warnings]
    told = tuple(replace(fault, file=file) for fault, file in known if file is not None)
    legs_at = {segment.line: leg for segment, leg in zip(run.segments, answer.legs, strict=False)}
    doubts = (_at_source(answer, fault, legs_at[fault.line]) if fault.file == path else fault for fault in run.warnings)
    run = replace(run, warnings=(*(fault for fault in told if fault not in task.warnings), *doubts))
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


def _at_source(answer: Answer, fault: Fault, leg: Leg) -> Fault:
    """A warning about a leg, at its edge of the environment or its visit of the task."""
    task = answer.site.task
    if leg.piece is not None:
        place = task.environment.document.place(("edges", leg.piece.way.edge))
    else:
        place = task.document.place(("visits",) if leg.visit is None else ("visits", leg.visit))
    return place.warning(fault.message, got=fault.got, allowed=fault.allowed)


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
    return answer, replace(run, warnings=(*run.warnings, *_emptied(answer)))


def _emptied(answer: Answer) -> Iterator[Fault]:
    """A warning for each battery of which nothing is left on the way: whatever takes more than planned ends there."""
    for b, name in enumerate(answer.site.physics.names):
        leg = min(answer.legs, key=lambda leg: leg.charge_wh[name], default=None)
        if leg is not None and leg.charge_wh[name] <= NOTHING * float(answer.site.physics.capacity_wh[b]):
            at = f"on edge '{leg.piece.name}' to '{leg.place}'" if leg.piece is not None else f"at '{leg.place}'"
            yield answer.site.task.document.place(("within",)).warning(
                f"nothing is left of battery '{name}' ({leg.charge_wh[name]:.3f} Wh) {at}: the reserve is only asked "
                "for at the end",
                allowed="within: {reserve_throughout: true}, or with_probability for a margin",
            )


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
        self.told = ""

    def plan(self, margins: Array, told: str, *, proves: bool = True) -> _Tried | None:
        """The best plan within margins, as it is simulated; with its proof or without."""
        site, physics, count = self.site, self.site.physics, len(self.names)
        kept = physics.reserve_wh

        def watch(what: str, objective: float, bound: float) -> bool:
            return self.watch(told, objective, bound)

        physics.reserve_wh, physics.held_wh = kept + margins[:count], margins[count:-1]
        try:
            within = replace(site, deadline_s=site.deadline_s - float(margins[-1]))
            if site.task.repeat is not None:
                self.found = plan_rounds(within, watch)
            else:
                self.found = solve_site(within, watch, labels=MOST_LABELS if proves else FEW_LABELS)
        finally:
            physics.reserve_wh, physics.held_wh = kept, np.zeros(count)
        if not self.found.feasible:
            return None
        tried = _Tried(*as_run(replace(self.found, site=site)), margins)
        self.first = self.first or tried
        return tried

    def simulated(self) -> tuple[Answer, RunResult] | None:
        """The plan that holds when it is simulated, within margins for what the search takes more simply."""
        margins = np.zeros(2 * len(self.names) + 1)
        for attempt in range(TRIES):
            tried = self.plan(margins, f"margins for what the search leaves out, {attempt}" if attempt else "")
            if tried is None:
                return None
            late = tried.answer.duration_s - self.site.deadline_s * (1.0 + SAME)
            short = np.maximum(np.append(_short(tried.answer, tried.run), late), 0.0)
            if tried.run.feasible and not (short > SAME).any() and not _missed(tried.answer):
                return tried.answer, tried.run
            if tried.answer.stopped or not short.any():
                return None
            margins = margins + short * (1.0 + SAME)
        return None

    def sure(self, asked: float) -> tuple[Answer, RunResult] | None:
        """The plan that holds in a share of fresh draws, within margins that are as tight as the draws can tell."""
        target = asked
        for check in range(CHECKS):
            tried = self._tight(target, asked)
            if tried is None:
                return None
            fresh = self._draw(tried, SEED + 1 + check)
            if fresh["value"] >= asked:
                return self._proved(tried, fresh, asked)
            if tried.answer.stopped:
                return None
            # as if half a standard error less had been seen of the draws that the margins were made from
            target = min(target + asked - fresh["value"] + 0.5 * standard_error(asked, fresh["runs"]), 1.0)
        return None

    def _proved(self, tried: _Tried, fresh: dict[str, float], asked: float) -> tuple[Answer, RunResult]:
        """A plan that holds, or a better one within its margins, with the proof."""
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
        low: Array | None = None
        high: Array | None = None
        best: _Tried | None = None
        beyond: Array | None = None
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

    def _needed(self, tried: _Tried, limits: NDArray[np.bool_], target: float) -> Array:
        """The least margins, alike in share for all limits that matter, within which a share of the draws would be.
        `limits`: which matter; those that some draw of this plan breaks are added."""
        slack = slack_of(self.site, self.columns)
        one = tried.run.batteries
        nominal = {f"margin_{n}_wh": b.charge_left_wh - b.reserve_required_wh for n, b in one.items()}
        nominal |= {f"charge_left_{n}_wh": b.charge_left_wh for n, b in one.items()}
        nominal |= {f"needed_{n}_wh": b.needed_wh or 0.0 for n, b in one.items()}
        columns: Columns = {name: np.array([value]) for name, value in nominal.items()}
        columns |= {f"charge_{n}_wh": np.array([[b.initial_wh]]) for n, b in one.items()}
        away = slack_of(self.site, columns | {"duration_s": np.array([tried.answer.duration_s])}) - slack
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
            note = (
                f"the plan found does not hold when it is simulated ({why}), and within margins for that there is none"
            )
            return Answer(site, False, notes=[note])
        surest, columns = self.surest
        note = f"no plan was found that holds in {100 * asked:g} % of the draws"
        extra = {"probability": surest | {"asked": asked}, "would_do": surer(site, columns, asked, surest["low"])}
        return Answer(
            site,
            False,
            notes=[f"{note}, the surest that was found holds in {100 * surest['value']:.2f} %"],
            extra=extra,
        )


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
