"""The diagnosis: logs and robot in, verdict out; every battery that was measured."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from missionsim.compare.comparison import thousandfold
from missionsim.compare.where import WORTH_SAYING, Accumulator, Where, dependences, ranked
from missionsim.diagnose.examine import Examined, Subject, examine
from missionsim.diagnose.execution import execution_effects, seen_once, told_of
from missionsim.diagnose.experiments import Bench, next_experiments
from missionsim.diagnose.heldout import Models
from missionsim.diagnose.leftover import goes_with, leftover
from missionsim.diagnose.manoeuvres import site_of
from missionsim.diagnose.meter import with_meter
from missionsim.diagnose.proposed import as_finding, as_written, with_law
from missionsim.diagnose.split import Split, choose_split, read_split
from missionsim.diagnose.waterfall import noted
from missionsim.effects.timeline import Timeline
from missionsim.errors import InputError
from missionsim.fit.final import FinalFit
from missionsim.identify import findings
from missionsim.identify.data import Candidate
from missionsim.identify.estimates import Z95
from missionsim.identify.forward import LOGGED
from missionsim.identify.proposed import Proposal, plain
from missionsim.identify.settings import Settings
from missionsim.identify.verdict import decide
from missionsim.inputs.loading import load_mission, load_robot
from missionsim.laws.proposal import REPLACED
from missionsim.logs import describe
from missionsim.runs.covariates import MOTION, logged_name
from missionsim.runs.drive import drive
from missionsim.runs.run import Run

MOST_WHERE = 4
MOST_SHIFTS = 4
HARDLY, OTHER_UNIT = 0.01, 3.0
"""Part of the mean power by which a parameter that moves is told; factor from which on it may be in another unit
(assumed)."""
TRADED = 0.5
"""Part of the largest shift of power that all shifts together come to at most where parameters only trade (assumed)."""
STANDS_IN = "stood in for a law that the library does not hold"
OTHER_FACTOR = "a law of its column has a factor that no converter has"
NOTHING_LEFT = "comes to nothing beside the others once all are fitted together, or to more than can be"
NO_OTHER_FORM = "no other form of what it reads does better"
BESIDE_MORE = "something else remains, which may have its size or its place"


def diagnose_files(
    robot: str | Path,
    logs: Sequence[str | Path],
    *,
    holdout: str | Sequence[str | Path] | None = None,
    mission: str | Path | None = None,
    battery: str | None = None,
    settings: Settings | None = None,
) -> findings.Diagnosis:
    """Diagnose from files.

    Parameters
    ----------
    robot : str or path
        Shipped robot or file.
    logs : sequence of str or path
        Log files or folders.
    holdout : optional
        See `missionsim.diagnose.split.choose_split`.
    mission : path, optional
        The mission that every log is a drive of.
    battery : str, optional
        Only this one.

    Raises
    ------
    missionsim.errors.InputError
        For faults in any of the files, or where no battery can be diagnosed.
    """
    spec = load_robot(robot)
    timeline = None
    if mission is not None:
        from missionsim.engine.simulate import simulate

        timeline = simulate(load_mission(mission, robot=spec)).timeline
    split = read_split(spec, logs, holdout)
    found = diagnose(Subject.of(spec), split, timeline=timeline, battery=battery, settings=settings)
    return replace(found, left_out=split.left_out, remarks=tuple(split.remarks))


def diagnose(
    subject: Subject,
    logs: Sequence[Run] | Split,
    *,
    holdout: str | Sequence[str | Path] | None = None,
    timeline: Timeline | None = None,
    battery: str | None = None,
    settings: Settings | None = None,
) -> findings.Diagnosis:
    """Diagnose every battery that the logs measure; see `diagnose_files`.

    Parameters
    ----------
    logs : sequence of Run, or Split
        Runs, or what is fitted and what is held out of them.
    holdout, battery
        As for `diagnose_files`; of a split nothing else is held out.
    timeline : Timeline, optional
        The simulated mission.
    """
    settings = settings or Settings()
    split = logs if isinstance(logs, Split) else choose_split(logs, holdout, subject.robot)
    measured = list(dict.fromkeys(name for log in split.train for name in log.power_w))
    if battery is not None and battery not in measured:
        raise InputError.unknown(f"no log measures the battery '{battery}'", battery, measured)
    done: dict[str, findings.BatteryDiagnosis] = {}
    skipped: dict[str, InputError] = {}
    for name in measured if battery is None else [battery]:
        if name not in subject.model.batteries:
            skipped[name] = InputError.unknown(f"the robot has no battery '{name}'", name, subject.model.batteries)
            continue
        try:
            done[name] = diagnose_battery(subject, split, name, settings, timeline=timeline)
        except InputError as error:
            skipped[name] = error
    if not done:
        raise next(iter(skipped.values()))
    return findings.Diagnosis(subject.robot.name, done, {name: " ".join(str(e).split()) for name, e in skipped.items()})


def diagnose_battery(
    subject: Subject,
    split: Split,
    battery: str,
    settings: Settings,
    *,
    timeline: Timeline | None = None,
    seen: Examined | None = None,
    tried: Collection[str] = (),
) -> findings.BatteryDiagnosis:
    """The diagnosis of one battery.

    `subject`, `split`, `battery`, `settings`, `timeline`: as for `diagnose`. `seen`: what `examine` gave. `tried`:
    effects for which no law has to wait, since they came to nothing beside the others or are not wanted.
    """
    seen = seen or examine(subject, split, battery, settings)
    features, found, models, held = seen.features, seen.found, seen.models, seen.held
    effects, candidates, proposed, fitted, in_file = judged(seen, tried)
    fits = (subject.model, models.fit(()).model, fitted.model)
    heldout: findings.HeldOut | None = None
    if held:
        heldout = models.held_out(fits, held, split.how, split.shifted)
        before = models.without(effects, held)
        after = heldout.power_rmse_w["with_effects"]
        effects = tuple(replace(e, heldout_rmse_before_w=before[e.effect], heldout_rmse_after_w=after) for e in effects)
    source = found.choice.model.source
    design = source.design(at := models.clock.in_all(len(source.runs)))
    nominal_w, fitted_w = (models.averaged(power, source, at) for power in (fits[0], fits[-1]))
    series = tuple(
        findings.RunSeries(name, design.time_s[part], design.y[part], nominal_w[part], fitted_w[part])
        for name, part in zip(design.names, design.runs, strict=True)
    )
    # what the means of the analysis do not show, since it averages out within them
    square = sum(float(np.sum((run.fitted_w - run.measured_w) ** 2)) for run in series)
    square /= max(sum(len(run.time_s) for run in series), 1)
    within = max(models.errors(fits[-1], models.runs).power_rmse_w ** 2 - square, 0.0)
    logs = [log for log in (*split.train, *split.heldout) if battery in log.power_w]
    driven: list[findings.Finding] = []
    untestable = dict(features.untestable)
    if timeline is not None:
        untestable = {name: needs for name, needs in untestable.items() if "mission" not in needs}
        if all("speed_m_s" in log.columns for log in logs):
            driven = execution_effects(timeline, logs, battery, settings.alpha)
    execution = tuple(one for one in driven if one.level)
    recalibration = models.recalibrated(in_file)
    # what remains with all that was named, and which parts of it are averages that say nothing of their own
    left, more = found.unexplained, list[findings.Structure]()
    # beside what was found, a base within its priors was not far off: it had taken the part of what was missing
    if features.given_sd and (
        told := _far(recalibration, settings.recalibration_limit, found.mean_power_w, alone=not (effects or proposed))
    ):
        more.append(findings.Structure("", 0.0, 0.0, 0.0, told))
    if found.factor is None and not found.averages and (over := leftover(found, features.covariates)) is not None:
        more += [over] if over.covariate not in left.depends_on else []
    certain = [name for law in proposed for name in law.certain]
    left = replace(
        left,
        # the quantities of the law before those that one curve at a time showed
        depends_on=tuple(dict.fromkeys((*certain, *left.depends_on, *(s.covariate for s in more if s.covariate)))),
        shape="; ".join(filter(None, (left.shape, *(s.shape for s in more)))),
        structures=(*left.structures, *more),
    )
    alike = goes_with(found, features.covariates, {name: one.needs for name, one in features.effects.items()})
    effects = tuple(replace(e, remark="; ".join(filter(None, (e.remark, alike.get(e.effect))))) for e in effects)
    # a law that reads what no single named effect reads; else it is the form of that effect, told beside it
    reads = [{logged_name(name) for name in features.effects[effect.effect].needs} for effect in effects]
    law = any(not any({logged_name(v) for v in one.first.variables} <= own for own in reads) for one in proposed)
    if law:
        effects = tuple(replace(e, remark=_beside_law(e, proposed, features.candidates)) for e in effects)
    site = site_of(features.covariates, seen.most)
    bench = Bench(subject.model, features, found.choice, site, settings)
    unexplained = found.unexplained if found.verdict == "unexplained_structure" else None
    remains = [s for s in found.unexplained.structures if s not in found.averages]
    averages = (*found.averages, *more)
    doubted = [name for name in found.demoted if name not in {effect.effect for effect in effects}]
    remarks = [*describe([*split.train, *split.heldout]), *features.remarks, *found.remarks, *seen_once(driven)]
    made = noted(
        findings.BatteryDiagnosis(
            verdict=decide(effects, remains, doubted, law=law, execution=execution, averages=averages),
            effects=effects,
            candidates=(*candidates, *told_of(driven)),
            proposed_laws=proposed,
            recalibration=recalibration,
            delay_s=seen.clock.delay_s,
            lag_s=seen.clock.lag_s,
            clock_at_edge=found.clock_at_edge,
            noise={**found.noise, "within_rows_w": float(np.sqrt(within))},
            unexplained=left,
            remarks=tuple(dict.fromkeys(remarks)),
            mean_power_w=found.mean_power_w,
            confounding=found.confounding,
            battery=battery,
            untestable=untestable,
            next_experiments=() if proposed and not effects else next_experiments(bench, effects, unexplained),
            heldout=heldout,
            shifted=models.shifted(found.effects),
            execution=execution,
            runs=tuple(run.run for run in features.runs),
            seconds=sum(log.duration_s for log in split.train if log.run in {run.run for run in features.runs}),
            where=_where(models),
            series=series,
            clock=seen.clock,
            aligned=source.aligned,
            file_clock=subject.model.meter(battery),
        )
    )
    return with_meter(made, models, held)


class Named(NamedTuple):
    """What is said of every effect, by all commands alike."""

    effects: tuple[findings.Finding, ...]
    """Those that stay beside the laws, with the numbers of `fitted`."""
    candidates: tuple[findings.Judged, ...]
    """What became of all others."""
    proposed: tuple[Proposal, ...]
    """Laws that the library does not hold."""
    fitted: FinalFit
    """The model with the effects."""
    in_file: FinalFit
    """The same beside the first law, if there is one: the base as the file will have it."""


def judged(seen: Examined, tried: Collection[str] = (), laws: bool = True) -> Named:
    """The effects that stay beside the laws that are proposed, what became of all others, and the model with them.

    `tried`: as for `diagnose_battery`; `laws`: whether to look for a law that the library does not hold.
    """
    features, found, models, held = seen.features, seen.found, seen.models, seen.held
    proposed: tuple[Proposal, ...] = ()
    if laws and found.factor is None:
        made = seen.law()
        proposed = () if made is None else (made,)
        if features.unlogged:
            # loads that nobody logged look like a law of time, temperature or processor load, never like one of motion
            reads = [{name for form in law.laws for name in form.variables} for law in proposed]
            motion = MOTION | {"slope_rad"}
            kept = [bool(own & motion) and own <= motion | {"payload_kg", "mass_kg"} for own in reads]
            proposed = tuple(law for law, of_motion in zip(proposed, kept, strict=True) if of_motion)
        if found.choice.forward is not None and {e.effect for e in found.effects} - {*tried}:
            # where the base is far from right, effects that predict come first, unless a law predicts far better, or
            # better in the place of one of them
            proposed = tuple(law for law in proposed if law.far_better or law.takes_over)
    same = {law.effect for law in proposed if not law.open}
    # a law that has no other form than an effect put in doubt by what is left: it is that effect
    again = tuple(replace(e, remark=BESIDE_MORE) for e in found.doubted if e.effect in same and e.is_clear)
    proposed = () if again else proposed
    effects = tuple(e for e in found.effects if not any(e.effect in law.instead_of for law in proposed)) + again
    if effects and proposed:
        law = as_finding(proposed[0])
        beside = with_law(models, law.effect, law.effect)
        if found.choice.forward is not None:
            effects = beside.needed_beside(law, effects)
    effects = models.of_the_way_ahead(models.of_all_braking(effects))
    # a base that is known from these logs alone may take all of an effect
    effects, fitted = models.certain(effects, 0 if features.given_sd else 1, models.settings.min_share)
    if effects and proposed:
        # without the law they had taken a part of it: their sizes are those beside it, as `improve` writes them
        was = {effect.effect: effect.energy_share for effect in effects}
        while True:
            (_, *told), _ = beside.certain([law, *effects])
            small = [e for e in told if abs(e.energy_share) < REPLACED * abs(was[e.effect])]
            needed = beside.needed_beside(law, told) if small else ()
            faded = [e.effect for e in small if e not in needed or e.may_be_nothing]
            effects = tuple(effect for effect in told if effect.effect not in faded)
            proposed = tuple(replace(one, instead_of=(*one.instead_of, *faded)) for one in proposed)
            if not faded:
                break
        fitted = models.fit(effects, fixed=True)
    effects = models.leaning(effects, fitted)
    written = [as_written(law, models, effects, held) for law in proposed]
    proposed = tuple(law for law, _ in written)
    if any(law.first.low <= 0.0 <= law.first.high for law in proposed):  # nothing beside the base, once both are fitted
        return judged(seen, laws=False)
    named, stood_in = {effect.effect for effect in effects}, {name for law in proposed for name in law.instead_of}
    candidates, of_watts = [], {f"{LOGGED}:{name}" for law in proposed for name in law.first.variables}
    for one in found.candidates:
        gone = STANDS_IN if one.effect in stood_in else OTHER_FACTOR if one.effect in of_watts else ""
        gone = gone or (NOTHING_LEFT if one.accepted and one.effect not in named else "")
        if gone:
            one = replace(one, accepted=False, open=True, reason=gone)
        elif one.effect in {effect.effect for effect in again}:
            one = replace(one, accepted=True, open=False, doubtful_share=None, reason=NO_OTHER_FORM)
        candidates.append(one)
    return Named(effects, tuple(candidates), proposed, fitted, written[0][1] if written else fitted)


def _far(recalibration: Sequence[findings.Recalibrated], limit: float, mean_power_w: float, *, alone: bool) -> str:
    """In words, that a base which these runs refute is off; else empty. `alone`: nothing else explains them. What moves
    most power is told first, and what moves hardly any is not told beside it; what one parameter gains and another
    loses, as c2 and c3 do over few speeds, makes no base wrong."""
    moved = [one for one in recalibration if abs(one.shift) > Z95 * one.shift_sd]
    if any(abs(one.shift_in_prior_sd) > limit for one in moved):
        signed = {one.parameter: one.shift * float(np.nan_to_num(one.power_w)) for one in moved}
        watts = {name: abs(power_w) for name, power_w in signed.items()}
        moved = sorted(moved, key=lambda one: -watts[one.parameter])
        moved = [one for one in moved if watts[one.parameter] > HARDLY * mean_power_w] or moved
        shifts = ", ".join(f"{one.parameter} {one.shift_pct:+.3g} %" for one in moved[:MOST_SHIFTS])
        units = any(one.shift > OTHER_UNIT - 1.0 or one.shift < 1.0 / OTHER_UNIT - 1.0 for one in moved)
        if abs(sum(signed.values())) < TRADED * max(watts.values()):
            return f"the base of the robot file, of which some gained what the rest lost, was fitted anew: {shifts}"
        was_w = sum(float(np.nan_to_num(one.power_w)) for one in moved)
        if factor := thousandfold(was_w + sum(signed[one.parameter] for one in moved), was_w):
            factor = f" (all of it about {factor}: is the meter's unit the watt?)"
        what = f"far from right{', in other units perhaps,' * units} and was fitted anew"
        return f"the base of the robot file is {what}: {shifts}{factor}"
    if not alone:
        return ""
    return "the base of the robot file does not describe these runs; which of its parameters is off they do not say"


def _beside_law(effect: findings.Finding, laws: Sequence[Proposal], candidates: Sequence[Candidate]) -> str:
    """In words, that a law of another form reads what an effect goes by, which may then stand for a part of it."""
    goes_by = {logged_name(c.covariate) for c in candidates if c.effect == effect.effect}
    shared = [name for law in laws for name in law.first.variables if name in goes_by]
    return f"a law of {plain(shared[0])} explains beside it what that effect cannot" if shared else effect.remark


def _where(models: Models) -> tuple[Where, ...]:
    """Conditions in which the file as it is errs most in the fitted runs."""
    sums = Accumulator()
    for run in models.runs:
        sums.add(run.run, drive(models.power, run, models.battery))
    found = ranked(dependences(sums, models.battery))
    return tuple(where for where in found if where.explains > WORTH_SAYING)[:MOST_WHERE]
