"""What errors on held-out runs mean, in words: the noise floor, why an energy error may rise, how it was measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from missionsim.identify.noise import mean_variance
from missionsim.numerals import counted, rounded, watts
from missionsim.runs.covariates import is_switch

if TYPE_CHECKING:
    from missionsim.diagnose.improve import Improved
    from missionsim.identify.findings import BatteryDiagnosis, HeldOut
    from missionsim.identify.proposed import Proposal
    from missionsim.runs.error import Errors

METER = "meter"
"""Name of the bar of the file's own model with another meter."""
SEEN = 0.5
"""A rise by less than this part of the noise floor is not worth a note."""
SEVERAL = 3.0
"""Energy error of held-out runs, in times the noise floor, from which something is missing whatever was found (assumed;
of a single run chance shows it once in 60)."""
SHOWN_PCT = 0.005
"""Difference of energy errors [%] that the printed digits hardly show."""
FAR_SHARE = 0.05
"""Part by which a recalibration lowers the power error where the base alone is worth fitting anew (assumed)."""
CLEAR_SHARE = 0.01
"""Rise of the power error over the best earlier model that is told (assumed)."""


class Step(NamedTuple):
    """One bar of the waterfall: errors of a model on the held-out runs (on the fitted ones where none are held out)."""

    name: str
    """``before``, ``recalibrated``, ``+ <effect>``, ``meter`` or ``noise floor``; of a diagnosis the kind of model."""
    energy_error_pct: float
    """Mean over runs of the absolute energy error."""
    power_rmse_w: float


def step_of(name: str, errors: Errors) -> Step:
    """The bar of a model by its errors."""
    return Step(name, errors.run_energy_error_pct, errors.power_rmse_w)


def bars_of(held: HeldOut, laws: Sequence[Proposal] = ()) -> list[Step]:
    """Errors on held-out runs as bars: of the file as it is, recalibrated, with the effects, with the first law too."""
    bars = [Step(kind, error_pct, held.power_rmse_w[kind]) for kind, error_pct in held.energy_error_pct.items()]
    errors = [(law.heldout_energy_pct, law.heldout_rmse_w) for law in laws[:1]]
    return bars + [Step("with_law", pct[1], watts[1]) for pct, watts in errors if pct is not None and watts is not None]


def noise_floor(diagnosis: BatteryDiagnosis) -> tuple[float, float]:
    """Errors that a true model would show: the noise, and runs whose meters and drives differ.

    Gives mean over runs of the absolute energy error [%], and RMS of the power error [W].
    """
    noise: Mapping[str, float] = diagnosis.noise
    power_w = diagnosis.mean_power_w
    between = (noise["offset_w"] / power_w) ** 2 + noise["gain"] ** 2 + noise["motion_gain"] ** 2
    rmse_w = math.sqrt(noise["sd_w"] ** 2 + between * power_w**2 + noise.get("within_rows_w", 0.0) ** 2)
    seconds = diagnosis.seconds / max(len(diagnosis.runs), 1)
    spread = math.sqrt(between + noise["sd_share"] ** 2 * mean_variance(noise, seconds))
    return 100.0 * spread * math.sqrt(2.0 / math.pi), rmse_w


def by_chance(floor_pct: float, count: int) -> tuple[float, float]:
    """Least and greatest energy error, as the mean over so many runs, of a true model whose mean over many is
    `floor_pct` [%]."""
    # the mean m of n absolute normal errors has the standard deviation m sqrt(pi/2 - 1) / sqrt(n)
    half = 2.0 * math.sqrt((math.pi / 2.0 - 1.0) / count)
    return floor_pct * max(0.0, 1.0 - half), floor_pct * (1.0 + half)


def rise_note(name: str, before: Step, after: Step, floor_pct: float, count: int, fitted: int) -> str:
    """In words, why an energy error grew with an effect although the power error fell; empty where it did not.

    `name`: what came in. `floor_pct`: mean absolute energy error of a true model. `count`: number of runs that the
    errors are of. `fitted`: number of runs that the model was fitted to; their common level is known no better than
    that.
    """
    energy_pct = after.energy_error_pct
    if energy_pct <= before.energy_error_pct + SEEN * floor_pct or after.power_rmse_w >= before.power_rmse_w:
        return ""
    chance = math.sqrt(1.0 + 1.0 / fitted) * by_chance(floor_pct, count)[1]
    level = floor_pct * math.sqrt(math.pi / 2.0)
    told = "this may be chance" if energy_pct <= chance else "this is more than that"
    return (
        f"With {name} the energy error rises from {before.energy_error_pct:.2f} to {energy_pct:.2f} % while the power "
        f"error falls from {rounded(before.power_rmse_w)} to {watts(after.power_rmse_w)}. Energy is a sum: without it, "
        "errors of opposite sign cancelled out over a run. With it, what is left is mostly the level by which a whole "
        f"run differs from the fitted ones, ±{level:.1f} % in these logs (one sd: meter, drive, slow noise). On "
        f"{counted(count, 'run')} even a model of the right form shows up to {chance:.1f} %; {told}."
    )


def energy_note(done: Improved) -> str:
    """`rise_note` of the first step of an improvement that makes the energy error grow; empty where none does."""
    *steps, floor = (step for step in done.steps if step.name != METER)
    count, fitted = len((done.first.heldout or done.first).runs), len(done.first.runs)
    pairs = pairwise(steps[1:])
    notes = (rise_note(f"'{new.name}'", old, new, floor.energy_error_pct, count, fitted) for old, new in pairs)
    return next(filter(None, notes), "")


def noted(battery: BatteryDiagnosis) -> BatteryDiagnosis:
    """The same diagnosis with why its energy error rose against recalibration alone, where it did, before its other
    remarks."""
    if battery.heldout is None or not battery.effects:
        return battery
    _, before, after = bars_of(battery.heldout)
    name = "the effect" if len(battery.effects) == 1 else "the effects"
    count = len(battery.heldout.runs)
    note = rise_note(name, before, after, noise_floor(battery)[0], count, len(battery.runs))
    return replace(battery, remarks=(note, *battery.remarks)) if note else battery


def unseen_note(battery: BatteryDiagnosis) -> str:
    """In words, that the energy of held-out runs is off by several times the noise floor, whatever is fitted; else
    empty. Nothing may be called complete then."""
    if battery.heldout is None:
        return ""
    left_pct = min(bar.energy_error_pct for bar in bars_of(battery.heldout, battery.proposed_laws))
    floor_pct = noise_floor(battery)[0]
    if left_pct <= SEVERAL * floor_pct * math.sqrt(1.0 + 1.0 / max(len(battery.runs), 1)):
        return ""
    named = {one: is_switch(one.partition(" (")[0]) for one in battery.heldout.beyond}
    columns = ", ".join(one for one, switch in named.items() if not switch)
    switched = "".join(f"; {one[:-1].replace(' (', ' is ', 1)}" for one, switch in named.items() if switch)
    return (
        f"the energy of the runs not used is off by {left_pct:.1f} %, where a right model would be by {floor_pct:.1f} "
        "%: something is missing that the fitted runs do not show. Fit runs of that kind too, or log what differs "
        f"in them{'; they lie beyond the fitted ones in ' * bool(columns)}{columns}{switched}"
    )


def clearly_less(one: Step, other: Step) -> bool:
    """Whether one model's power error is less by more than `FAR_SHARE`."""
    return one.power_rmse_w < (1.0 - FAR_SHARE) * other.power_rmse_w


def clearly_better(one: Step, other: Step) -> bool:
    """Whether one model's power error is less by more than `FAR_SHARE` and its energy error no greater."""
    return clearly_less(one, other) and one.energy_error_pct <= other.energy_error_pct + SHOWN_PCT


def best_before(bars: Sequence[Step]) -> int:
    """Number of the bar before the last that predicts best: file, recalibration, then each effect in its turn.

    One whose energy error is beyond both that of the file and of the recalibration is none to go back to.
    """
    most_pct = SHOWN_PCT + max(bars[0].energy_error_pct, bars[1].energy_error_pct)
    kept = [i for i, bar in enumerate(bars[:-1]) if bar.energy_error_pct <= most_pct]
    return min(kept, key=lambda i: bars[i].power_rmse_w)


def rises(bars: Sequence[Step]) -> tuple[bool, bool]:
    """Whether the last bar is worse: in power than the best before it by more than `CLEAR_SHARE` (than a mere
    recalibration by more than that part of what it removes, up to `FAR_SHARE`); in energy than both the file as it was
    and a mere recalibration."""
    best = best_before(bars)
    given_w, best_w = bars[0].power_rmse_w, bars[best].power_rmse_w
    rise_w = max(CLEAR_SHARE * best_w, min(FAR_SHARE * best_w, CLEAR_SHARE * (given_w - best_w)) if best == 1 else 0.0)
    power = bars[-1].power_rmse_w > best_w + rise_w
    return power, bars[-1].energy_error_pct > SHOWN_PCT + max(bar.energy_error_pct for bar in bars[:2])


def worse_note(
    bars: Sequence[Step], added: Sequence[str] = (), heldout: bool = True, what: str = "what was added"
) -> str:
    """In words, which error of the last bar is worse, and how the other fares; empty where none is (see `rises`).

    `bars`: errors of the file as it was, of a mere recalibration, and after each of `added`, or of `what` there is.
    """
    before, recalibrated, after = bars[0], bars[1], bars[-1]
    power, energy = rises(bars)
    if not (power or energy):
        return ""
    best = best_before(bars)
    told = f"from {watts(before.power_rmse_w)} ({watts(recalibrated.power_rmse_w)} recalibrated)"
    if power and after.power_rmse_w < before.power_rmse_w:
        told = f"from {watts(recalibrated.power_rmse_w)} recalibrated ({watts(before.power_rmse_w)} of the file)"
    if best > 1 and added:
        late = added[best - 1 :]
        what = late[0] if len(late) == 1 else f"what came after {added[best - 2]}"
        told = f"from {rounded(bars[best].power_rmse_w)}" if power else told
    powers = f"the power error {told} to {watts(after.power_rmse_w)}"
    told = f"{before.energy_error_pct:.2f} % ({recalibrated.energy_error_pct:.2f} % recalibrated)"
    if best > 1 and added and not energy:  # of the same bar as the power
        before, told = bars[best], f"{bars[best].energy_error_pct:.2f}"
    energies = f"the energy error from {told} to {after.energy_error_pct:.2f} %"
    which = "runs that were not used to fit" if heldout else "the fitted runs"
    if power and energy:
        return f"WORSE on {which}: {what} raises {powers} and {energies}."
    risen, other = (powers, energies) if power else (energies, powers)
    lower = after.energy_error_pct < before.energy_error_pct if power else after.power_rmse_w < before.power_rmse_w
    goes = other.replace(" error from", f" error {'falls' if lower else 'goes'} from")
    return f"WORSE on {which}: {what} raises {risen}, while {goes}."


def measured_note(done: Improved) -> str:
    """How the errors of the steps were measured, and what the noise floor is where a model errs by no more."""
    untested = "".join(f" {run}: no {', '.join(names)}; not tested on it." for run, names in done.untested.items())
    return (
        "Measured as missionsim compare does: rows as logged, the model as late as the meter of its file; energy "
        f"errors are means over runs of the magnitude.{untested}{_floor_note(done)}"
    )


def power_of_floor(steps: Sequence[Step]) -> str:
    """Power error of the noise floor [W], as a bound where the last model errs by no more."""
    cut = "≤ " if steps[-1].power_rmse_w >= steps[-2].power_rmse_w else ""
    return f"{cut}{rounded(steps[-1].power_rmse_w)}"


def _floor_note(done: Improved) -> str:
    *_, last, floor = done.steps
    told = ""
    if floor.power_rmse_w >= last.power_rmse_w:
        told += (
            " What nothing explains counts as noise: the noise floor of the power is known to be at most the error of "
            "the last model."
        )
    if floor.energy_error_pct > last.energy_error_pct:
        count = len((done.first.heldout or done.first).runs)
        low, high = by_chance(floor.energy_error_pct, count)
        told += (
            f" The noise floor of the energy is the mean of many runs: over {counted(count, 'run')} a true "
            f"model shows {low:.2f} to {high:.2f} %, so that one may well lie below it."
        )
    return told
