"""Which runs are fitted and which are held out: the last quarter, a fraction, names, a condition, or other files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from missionsim.diagnose.spared import spared
from missionsim.effects.base import Effect
from missionsim.effects.covariates import derive
from missionsim.effects.library import all_effects
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.fit.files import read_bounded, read_runs
from missionsim.identify.settings import LEARNT_SECONDS, MANY_SECONDS, SEVERAL_RUNS, STRETCH_S
from missionsim.inputs.robot import RobotSpec
from missionsim.labels import Labels
from missionsim.logs.read import meters_alike
from missionsim.numerals import counted
from missionsim.physics import Array
from missionsim.runs.admit import admit_to_test, unchanging
from missionsim.runs.covariates import is_switch, logged_name, may_be_cause
from missionsim.runs.drive import filled
from missionsim.runs.run import Run

BEYOND_SD = 2.0
"""Standard deviations of the fitted runs' means from which on other runs lie beyond them (assumed)."""


@dataclass(frozen=True)
class Split:
    """Runs to fit and runs to test on."""

    train: tuple[Run, ...]
    heldout: tuple[Run, ...]
    how: str
    """How the held-out runs were chosen, in words; says why where there are none."""
    shifted: bool = False
    """Whether they were chosen by a condition, so that they differ in kind."""
    left_out: tuple[str, ...] = ()
    """Runs that are neither, one line each with why."""
    given: tuple[Run, ...] = ()
    """Of the files that were given, those among which they were chosen."""

    @property
    def remarks(self) -> list[str]:
        """What no run can tell, and the switches that only the fitted or only the held-out runs log."""
        of_fitted, of_others = _of_one_side(self.train, self.heldout)
        told = [f"{name} is not logged in the runs not used, and is on in the fitted ones" for name in of_fitted]
        told += [f"{name} is not logged in the fitted runs, and is on in those not used" for name in of_others]
        return [*unchanging(self.given), *told]


def read_split(
    robot: RobotSpec, logs: Sequence[str | Path], holdout: str | Sequence[str | Path] | None = None
) -> Split:
    """Runs of some logs to fit and to test on; see `choose_split`."""
    runs, left_out = read_runs(robot, logs)
    split = choose_split(runs, holdout, robot, left_out)
    return replace(split, left_out=(*left_out, *split.left_out), given=tuple(runs))


def choose_split(
    logs: Sequence[Run],
    holdout: str | Sequence[str | Path] | None = None,
    robot: RobotSpec | None = None,
    left_out: Sequence[str] = (),
) -> Split:
    """Split runs into those that are fitted and those that are held out.

    `holdout`: a fraction (``"0.25"``, ``"25 %"``; ``"0"`` or ``"none"`` for none), names of runs (``"run_06,run_07"``),
    a condition over columns (``"surface == 'carpet'"``: runs in which it holds at least half of the time), or files and
    folders of other logs, which are checked against `robot`; `left_out`: runs that are not among `logs`, with why. By
    default the last quarter of four or more runs, as far as others show what they show. Raises InputError: for a value
    that is none of these, a condition that no run or every run meets, unknown runs, other logs of which none can be
    tested on.
    """
    logs = tuple(logs)
    if holdout is None:
        if len(logs) <= SEVERAL_RUNS:
            told = f"{counted(len(logs), 'run')} only: none held out, so nothing shows how "
            return Split(logs, (), f"{told}the model does on runs that were not used")
        return _last(logs, 0.25)
    parts = [str(holdout)] if isinstance(holdout, (str, Path)) else [str(item) for item in holdout]
    if all(Path(part).exists() for part in parts):
        return _files(logs, parts, robot)
    text = ",".join(parts)
    number = "0" if text.strip().lower() == "none" else text.strip()
    try:
        fraction = float(number[:-1]) / 100.0 if number.endswith("%") else float(number)
    except ValueError:
        pass
    else:
        if not 0.0 <= fraction < 1.0:
            raise InputError.single("--holdout as a fraction must be below 1", got=text, allowed="0 to 0.9")
        return _last(logs, fraction)
    if any(sign in text for sign in "=<>(") or any(word in text.split() for word in ("and", "or", "not")):
        columns = sorted(set.intersection(*(set(log.columns) for log in logs)))
        condition = compile_expression(text, names=columns, file="--holdout")
        shares = []
        for log in logs:
            meets = np.broadcast_to(np.asarray(condition.evaluate(log.columns), dtype=float), (len(log),))
            shares.append(float(np.nansum(meets * log.dt_s) / np.sum(log.dt_s)))
        held, train = (tuple(x for x, s in zip(logs, shares, strict=True) if (s >= 0.5) == of) for of in (True, False))
        if not held or not train:
            which = "no run" if not held else "every run"
            raise InputError.single(f"--holdout: {which} meets the condition at least half of the time", got=text)
        return Split(train, held, f"{counted(len(held), 'run')} with {text}", shifted=True)
    names = [name.strip() for name in text.split(",") if name.strip()]
    known = [log.run for log in logs]
    for name in names:
        if why := next((line for line in left_out if line.startswith(f"{name}: ")), ""):
            raise InputError.single(f"--holdout: the run '{name}' was left out", got=why, allowed=", ".join(known))
        if name not in known:
            allowed = (
                f"a fraction, a condition such as \"surface == 'carpet'\", files, or of the runs {', '.join(known)}"
            )
            raise InputError.unknown(f"--holdout: there is no run '{name}'", name, known, allowed=allowed)
    held, train = (tuple(log for log in logs if (log.run in names) == out) for out in (True, False))
    if not train:
        raise InputError.single("every run is held out; nothing is left to fit", got=text)
    return Split(train, held, f"runs {', '.join(names)}")


def _last(logs: tuple[Run, ...], fraction: float) -> Split:
    if fraction == 0.0:
        return Split(logs, (), "none held out, as asked")
    count = max(1, math.floor(fraction * len(logs) + 1e-9))
    if count >= len(logs):
        raise InputError.single("too few runs to hold some out", got=f"{len(logs)} run", allowed="at least 2 runs")
    places, causes = spared(logs, count)
    held, train = (tuple(log for n, log in enumerate(logs) if (n in places) == out) for out in (True, False))
    if causes:
        which, shown = ", ".join(run.run for run in held), ", ".join(causes)
        return Split(train, held, f"{which} of {len(logs)} runs, as the last ones show most of {shown}")
    how = f"the last {'run' if count == 1 else f'{count} runs'} of {len(logs)}"
    for name in sorted(set.intersection(*(set(log.columns) for log in logs))):
        fitted, tested = ([_texts(log.columns[name]) for log in some] for some in (train, held))
        of = set.union(*tested)
        if len(of) == 1 and 2 * sum(of == one for one in fitted) < len(fitted):
            how += f", all of {name} {next(iter(of))} as {sum(of == one for one in fitted)} of the fitted ones are"
            return Split(train, held, how, shifted=True)
    return Split(train, held, how)


def _texts(column: object) -> set[str]:
    """The texts that a label has, empty where it is missing; none for numbers."""
    return {(*column.names, "")[code] for code in np.unique(column.codes)} if isinstance(column, Labels) else set()


def _files(logs: tuple[Run, ...], parts: list[str], robot: RobotSpec | None) -> Split:
    held, refused, _ = read_bounded(robot, parts)
    same = {log.sha256 for log in held if log.sha256} & {log.sha256 for log in logs}
    train = tuple(log for log in logs if not (log.sha256 and log.sha256 in same))
    if not train:
        raise InputError.single("every run is held out; nothing is left to fit", got=", ".join(parts))
    alike = meters_alike([*train, *held])
    train, held = tuple(alike[: len(train)]), alike[len(train) :]
    kept, left_out = admit_to_test(held, train)
    how = f"{counted(len(kept), 'run')} from {', '.join(Path(p).name for p in parts)}"
    return Split(train, tuple(kept), how, left_out=(*left_out, *(f"held-out {told}" for told in refused)))


def stretches(runs: Sequence[Run]) -> tuple[list[Run], str]:
    """What is learnt from runs: all their rows, or of very long ones stretches spread over all; and in words which.

    Clocks of memory and rates go on through what is left out.
    """
    seconds = sum(run.duration_s for run in runs)
    if seconds < MANY_SECONDS:
        return list(runs), ""
    kept = []
    for number, run in enumerate(runs):
        part = LEARNT_SECONDS / seconds
        count = max(1, round(part * run.duration_s / STRETCH_S))
        length = max(2, round(part * run.rows / count))
        room = run.rows / count - length
        if room < 1.0:
            kept.append(run)
            continue
        # where a stretch lies in its part of the run differs from run to run: the golden section never repeats
        shift = math.modf(0.618034 * (number + 0.5))[0] * room
        keep = np.zeros(run.rows, dtype=bool)
        for begin in np.arange(count) * (run.rows / count) + shift:
            keep[int(begin) : int(begin) + length] = True
        derived = derive(run.columns, run.time_s, run.dt_s)
        kept.append(replace(run, columns=derived).rows_where(keep))
    hours = [sum(run.duration_s for run in some) / 3600.0 for some in (kept, runs)]
    return kept, "effects are looked for in {:.1f} of {:.1f} h, in stretches spread evenly over all runs".format(*hours)


def parts_of(run: Run, count: int) -> list[Run]:
    """A run cut into parts of as many rows, in which clocks of memory and rates go on."""
    whole = replace(run, columns=derive(run.columns, run.time_s, run.dt_s))
    edges = np.linspace(0, run.rows, count + 1).astype(int).tolist()
    parts = [whole.rows_where(slice(a, b)) for a, b in itertools.pairwise(edges)]
    return [replace(part, run=f"{run.run} part {number}") for number, part in enumerate(parts, 1)]


def with_same_causes(runs: Sequence[Run], batteries: Sequence[str], own: Sequence[Effect]) -> tuple[list[Run], str]:
    """Runs that have every cause which most of them log, and in words which were left out.

    One file without a column must not take the effects of that column from the hypotheses of all others: what is left
    would be named instead of it.
    """
    effects = (*all_effects((), ("",)), *own)
    causes = {logged_name(name) for effect in effects for name in effect.needs}
    have = [causes & set(filled(run, batteries, [])) for run in runs]
    most = {name for name in causes if sum(name in own_names for own_names in have) > 0.5 * len(runs)}
    kept = [run for run, own_names in zip(runs, have, strict=True) if most <= own_names]
    if len(kept) == len(runs) or len(kept) < max(2, len(runs) // 2):
        return list(runs), ""
    lacking = sorted(set().union(*(most - own_names for own_names in have)))
    names = ", ".join(run.run for run, own_names in zip(runs, have, strict=True) if not most <= own_names)
    return (
        kept,
        f"{names}: no {', '.join(lacking)}, which the other runs have and effects depend on; left out of the fit",
    )


def beyond(fitted: Sequence[Run], others: Sequence[Run]) -> tuple[list[str], list[str]]:
    """Labels of which other runs have texts that no fitted run has, with these; and columns whose mean over them lies
    beyond the fitted runs' (a heading has no beyond), of switches with how that differs."""
    labels, numbers = [], []
    for name in sorted(set.intersection(*(set(run.covariates()) for run in (*fitted, *others))) - {"heading_rad"}):
        here, there = ([run.columns[name] for run in own] for own in (fitted, others))
        texts = [set().union(*map(_texts, own)) - {""} for own in (here, there)]
        if new := sorted(texts[1] - texts[0]):
            labels.append(f"{name} ({', '.join(new)})")
        elif may_be_cause(name) and not texts[0]:
            means, other = (np.array([np.mean(run.number(name)) for run in own]) for own in (fitted, others))
            away = abs(float(other.mean() - means.mean()))
            if away > max(float(np.ptp(means)) / 2.0, BEYOND_SD * float(means.std())):
                numbers.append(f"{name} ({_switched(means, other)})" if is_switch(name) else name)
    for names, side in zip(_of_one_side(fitted, others), ("them", "the fitted ones"), strict=True):
        numbers += [f"{name} (not logged in {side})" for name in names]
    return labels, numbers


def _of_one_side(fitted: Sequence[Run], others: Sequence[Run]) -> tuple[list[str], list[str]]:
    """Switches that are on in fitted runs and that none of the others logs, and the other way round."""
    if not fitted or not others:
        return [], []
    sides = [[(n, run.number(n)) for run in own for n in filter(is_switch, run.columns)] for own in (fitted, others)]
    (here, here_on), (there, there_on) = (({n for n, _ in own}, {n for n, on in own if on.any()}) for own in sides)
    return sorted(here_on - there), sorted(there_on - here)


def _switched(fitted: Array, others: Array) -> str:
    """How a switch differs, from how much it is on in each run."""
    if not others.any():
        return "never on in them"
    if not fitted.any():
        return "on in them, never in the fitted ones"
    return f"on {'more' if others.mean() > fitted.mean() else 'less'} in them than in the fitted ones"


def lacking(
    runs: Sequence[Run], effects: Sequence[Effect], batteries: Sequence[str], known: Sequence[Run]
) -> dict[str, list[str]]:
    """Runs without columns that some effects need and that `known` runs have, and these columns."""
    needed = {logged_name(name) for effect in effects for name in effect.needs}
    needed = {name for name in needed if not is_switch(name)}  # a missing one counts as switched off
    needed &= set().union(*(filled(run, batteries) for run in known))
    found = {run.run: sorted(needed - set(filled(run, batteries))) for run in runs}
    return {name: columns for name, columns in found.items() if columns}
