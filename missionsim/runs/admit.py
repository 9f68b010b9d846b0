"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.errors import Fault, InputError
from missionsim.runs.covariates import is_switch
from missionsim.runs.odd import odd_runs
from missionsim.runs.run import Run

if TYPE_CHECKING:
    from missionsim.logs.raw import Remark


SHARE = 0.003
"""Standard deviation of the difference of two powers, in parts of their mean, below which they are one measurement.
Noise of meters and drives is ten times as large."""
WINDOW, LEAST, PART, UNLIKE = 6, 60, 0.15, 0.9
"""Changes of the speed in a fingerprint; fingerprints that a run must have, the part of them that a copy shares at one
shift, and the part that must be unlike all others of the run: a measured speed never comes twice alike to its last
digit, a commanded one does."""
MOST = 4000
"""Fingerprints of a run that are compared."""


def admit(runs: Sequence[Run], model: PowerModel | None = None) -> tuple[list[Run], list[str]]:
    """Runs to learn from, and what was left out and why, one line a run. Raises InputError: where no run is left; with
    the faults that `validate` tells."""
    kept: list[Run] = []
    told: list[str] = []
    refused = [remark.column for run in runs for remark in _errors(run) if remark.kind in ("range", "unit")]
    # a unit that is wrong in most runs is wrong in those too whose values happen to be small
    wrong = {name for name in refused if len(runs) > 2 and refused.count(name) >= 0.5 * len(runs)}
    good = [run for run in runs if not _errors(run) and not wrong & {*run.columns}]
    twins = copies(good)
    for run in runs:
        if errors := _errors(run):
            told.append(f"{run.run}: {'; '.join(str(remark) for remark in errors)}")
        elif columns := wrong & {*run.columns}:
            told.append(f"{run.run}: {', '.join(sorted(columns))} is in another unit in most of these runs: here too?")
    for i, run in enumerate(good):
        if i in twins:
            told.append(f"{run.run}: a copy of {good[twins[i]].run} but for noise; one measurement counts once")
        else:
            kept.append(run)
    if runs and not kept:
        raise InputError([remark.fault(run.source) for run in runs for remark in _errors(run)])
    if model is not None:
        odd = odd_runs(kept, model)
        told = [*(f"{name}: {why}" for name, why in odd.items()), *told]
        faults = [Fault(run.source, 0, 0, odd[run.run]) for run in kept if run.run in odd]
        kept = [run for run in kept if run.run not in odd]
        if faults and not kept:
            raise InputError(faults)
    return kept, told


def _errors(run: Run) -> list[Remark]:
    return [remark for remark in run.remarks if remark.severity == "error"]


def unchanging(runs: Sequence[Run]) -> list[str]:
    """Switches and loads that have one value in every row of all runs, which cannot tell then what they draw."""
    names = [name for name in runs[0].columns if is_switch(name) or name == "cpu_load"] if runs else []
    found = {
        name: {value for run in runs for value in (run.number(name).min(), run.number(name).max())}
        for name in names
        if all(name in run.columns and run.rows for run in runs)
    }
    return [
        f"{name} is {next(iter(values)):g} in every row of all runs: what it draws cannot be told by them"
        for name, values in found.items()
        if len(values) == 1 and len(runs) > 1
    ]


def copies(runs: Sequence[Run]) -> dict[int, int]:
    """Number of a run that is a copy → number of the first run that it copies."""
    seen = [_fingerprints(run) for run in runs]
    rare = 1 + max((len(one) for one in seen), default=0) // MOST
    # by content, so that copies choose the same ones
    chosen = [{value: at for value, at in one.items() if value % rare == 0} for one in seen]
    owners: dict[int, list[int]] = {}
    for i, one in enumerate(chosen):
        for value in one:
            owners.setdefault(value, []).append(i)
    shifts: dict[tuple[int, int], Counter[int]] = {}
    for value, own in owners.items():
        for i, j in combinations(own, 2):
            shifts.setdefault((i, j), Counter())[chosen[j][value] - chosen[i][value]] += 1
    found: dict[int, int] = {}
    for j, run in enumerate(runs):
        for i in range(j):
            least = min(len(chosen[i]), len(chosen[j]))
            # of two runs of one mission some speeds are alike here and there, of a copy at one shift throughout
            shared = max(shifts.get((i, j), Counter({0: 0})).values())
            alike = least >= LEAST / rare and shared > PART * least
            if i not in found and set(run.power_w) == set(runs[i].power_w) and (alike or _same_power(runs[i], run)):
                found[j] = i
                break
    return found


def _same_power(one: Run, other: Run) -> bool:
    return one.rows == other.rows and all(
        float(np.std(power - other.power_w[name])) <= SHARE * abs(float(np.mean(power)))
        for name, power in one.power_w.items()
    )


def _fingerprints(run: Run) -> dict[int, int]:
    """One number for each few successive speeds → where they stand; none where speeds come again."""
    if "speed_m_s" not in run.columns:
        return {}
    speed = np.round(run.number("speed_m_s"), 9)
    speed = speed[np.isfinite(speed)]
    speed = speed[np.diff(speed, prepend=np.nan) != 0.0]
    if len(speed) < LEAST + WINDOW:
        return {}
    factor = np.uint64(0x9E3779B97F4A7C15)
    bits = (speed + 0.0).view(np.uint64) * factor
    mixed = np.zeros(len(bits) - WINDOW + 1, dtype=np.uint64)
    for k in range(WINDOW):
        mixed = (mixed ^ (bits[k : k + len(mixed)] >> np.uint64(13 + k))) * factor
    values, first = np.unique(mixed >> np.uint64(8), return_index=True)
    return dict(zip(values.tolist(), first.tolist(), strict=True)) if len(values) > UNLIKE * len(mixed) else {}
