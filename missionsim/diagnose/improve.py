"""Round after round: diagnose, add the best-supported effect, compare again, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from missionsim.diagnose.adopt import adopt
from missionsim.diagnose.diagnosis import Subject, diagnose_battery
from missionsim.diagnose.priors import NO_PRIOR_SD, prior_before
from missionsim.diagnose.proposed import as_finding, with_candidate
from missionsim.diagnose.split import Split
from missionsim.diagnose.waterfall import noise_floor
from missionsim.errors import InputError
from missionsim.identify.findings import BatteryDiagnosis, Finding
from missionsim.identify.settings import Settings

MOST_ROUNDS = 8
MOST_LAWS = 2
"""Proposed laws that are offered once the library has nothing more to add."""

Ask = Callable[[Finding, BatteryDiagnosis], bool]


@dataclass(frozen=True)
class Step:
    """One bar of the waterfall: errors on the held-out runs (on the fitted ones where none are held out).

    Attributes
    ----------
    name : str
        ``before``, ``recalibrated``, ``+ <effect>`` or ``noise floor``.
    energy_error_pct : float
        Mean over runs of the absolute energy error.
    power_rmse_w : float
    """

    name: str
    energy_error_pct: float
    power_rmse_w: float


@dataclass(frozen=True)
class Improved:
    """What came of it.

    Attributes
    ----------
    battery : str
    text : str
        The robot file with everything that was added.
    added, declined : tuple of str
    steps : tuple of Step
    heldout : bool
        Whether the steps are of runs that were not used to fit.
    first, last : BatteryDiagnosis
        Before anything was added, and after.
    stopped : str
        Why it ended, in words.
    compared : Step, optional
        What `missionsim compare` says of the written file on the runs of the steps: clocks as logged, row by row.
    """

    battery: str
    text: str
    added: tuple[str, ...]
    declined: tuple[str, ...]
    steps: tuple[Step, ...]
    heldout: bool
    first: BatteryDiagnosis
    last: BatteryDiagnosis
    stopped: str
    compared: Step | None = None


def improve(text: str, split: Split, battery: str, settings: Settings, ask: Ask) -> Improved:
    """Improve the text of a robot file for one battery.

    All steps are errors at the clock of the first diagnosis, so that only the model differs between them.

    Parameters
    ----------
    text : str
        Robot file.
    split : Split
    battery : str
    settings : Settings
    ask : callable
        ``(finding, diagnosis) -> bool``: whether to add it.
    """
    from missionsim.inputs.loading import robot_from_text

    robot = robot_from_text(text)
    start = Subject.of(robot)
    priors = _own_priors(start, battery, split.train)
    first = last = diagnose_battery(start, split, battery, None, settings)
    given, as_given = text, robot
    steps = [_step("before", first, "nominal"), _step("recalibrated", first, "recalibrated")]
    added: list[str] = []
    declined: list[str] = []
    stopped = ""
    for _ in range(MOST_ROUNDS):
        choice = next((e for e in last.effects if not e.indistinguishable_from and e.effect not in declined), None)
        if choice is None:
            break
        if not ask(choice, last):
            declined.append(choice.effect)
            continue
        # from the file as it was given: no round moves a base or an effect on from where another left it
        try:
            made = adopt(given, as_given, split, choice.effect, battery, settings, force=True, beside=added)
            robot = robot_from_text(made.text)
        except InputError:  # beside those found before, it would need a coefficient that physics forbids
            declined.append(choice.effect)
            continue
        text = made.text
        added.append(choice.effect)
        # the file's own base values came from these logs: what was known before them stays the prior
        again = Subject.of(robot, priors={**_fitted_priors(robot, battery), **priors})
        last = diagnose_battery(again, split, battery, None, settings, clock=first.clock)
        steps.append(_step(f"+ {choice.effect}", last, "nominal"))
    for _ in range(MOST_LAWS):
        law = next((p for p in last.proposed_laws if p.first.simulated and p.first.formula not in declined), None)
        if law is None:
            break
        if not ask(as_finding(law), last):
            declined.append(law.first.formula)
            continue
        given, name = with_candidate(given, battery, law.first.formula)
        as_given = robot_from_text(given)
        added = [effect for effect in added if effect not in law.instead_of]
        made = adopt(given, as_given, split, name, battery, settings, force=True, beside=added)
        text, robot = made.text, robot_from_text(made.text)
        added.append(name)
        again = Subject.of(robot, priors={**_fitted_priors(robot, battery), **priors})
        last = diagnose_battery(again, split, battery, None, settings, clock=first.clock)
        steps.append(_step(f"+ {name}", last, "nominal"))
    stopped = _why(last, declined)
    steps.append(Step("noise floor", *noise_floor(last)))
    return Improved(
        battery,
        text,
        tuple(added),
        tuple(declined),
        tuple(steps),
        first.heldout is not None,
        first,
        last,
        stopped,
        _compared(robot, split, battery),
    )


def _own_priors(subject: Subject, battery: str, logs: Sequence[Any]) -> dict[str, float]:
    """What was known before these logs; nothing of parameters that were fitted to them by `calibrate`."""
    return {
        term.name_of(name): prior_before(subject, parameter, logs)
        for term in subject.model.of(battery)
        for name, parameter in term.parameters.items()
    }


def _fitted_priors(robot: Any, battery: str) -> dict[str, float]:
    """Effects that were fitted to these logs have no prior of their own."""
    model = Subject.of(robot).model
    return {term.name_of(name): NO_PRIOR_SD for term in model.of(battery) if not term.base for name in term.parameters}


def _step(name: str, diagnosis: BatteryDiagnosis, kind: str) -> Step:
    if diagnosis.heldout is not None:
        return Step(name, diagnosis.heldout.energy_error_pct[kind], diagnosis.heldout.power_rmse_w[kind])
    which = {"nominal": "nominal_w", "recalibrated": "recalibrated_w"}[kind]
    energy, square, seconds = [], 0.0, 0.0
    for run in diagnosis.series:
        error = getattr(run, which) - run.measured_w
        energy.append(100.0 * abs(float(error.sum()) / float(run.measured_w.sum())))
        square += float(np.sum(error**2))
        seconds += len(error)
    return Step(name, float(np.mean(energy)), float(np.sqrt(square / max(seconds, 1.0))))


def _compared(robot: Any, split: Split, battery: str) -> Step | None:
    """The error of a robot file as `missionsim compare` measures it."""
    from missionsim.compare import compare
    from missionsim.inputs.power import build_power_model

    logs = [log for log in (split.heldout or split.train) if battery in log.power_w]
    found = compare(build_power_model(robot), logs, robot=robot).batteries.get(battery)
    if found is None:
        return None
    seconds = np.array([run.seconds for run in found.runs])
    square = np.array([run.power_rmse_w**2 for run in found.runs])
    return Step(
        "compare",
        float(np.mean([abs(run.energy_error_pct) for run in found.runs])),
        float(np.sqrt(np.average(square, weights=seconds))),
    )


def _why(last: BatteryDiagnosis, declined: Sequence[str]) -> str:
    unsure = [e for e in last.effects if e.indistinguishable_from]
    if unsure:
        names = " or ".join((unsure[0].effect, *unsure[0].indistinguishable_from))
        drive = f" Drive next: {last.next_experiments[0].do}." if last.next_experiments else ""
        none = "neither" if len(unsure[0].indistinguishable_from) == 1 else "none of them"
        return f"these data cannot tell {names}, so {none} is added.{drive}"
    if last.verdict == "unexplained_structure":
        return f"something remains that the library does not contain: {last.unexplained.shape}."
    if declined:
        return f"declined: {', '.join(declined)}."
    if last.unexplained.depends_on:
        on = ", ".join(last.unexplained.depends_on)
        return f"no further effect is above the detection limits; what remains still varies with {on}."
    if last.unexplained.shape:
        return f"no further effect is above the detection limits; what remains: {last.unexplained.shape}."
    return "nothing is left above the detection limits."
