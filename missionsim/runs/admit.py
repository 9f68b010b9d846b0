"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from missionsim.effects.model import PowerModel
from missionsim.errors import Fault, InputError
from missionsim.runs.copies import copies
from missionsim.runs.covariates import is_switch
from missionsim.runs.odd import odd_runs
from missionsim.runs.run import Run

if TYPE_CHECKING:
    from missionsim.logs.remarks import Remark


def admit(runs: Sequence[Run], model: PowerModel | None = None) -> tuple[list[Run], list[str]]:
    """Runs to learn from, and what was left out and why, one line a run.

    Raises
    ------
    missionsim.errors.InputError
        Where no run is left; with the faults that `validate` tells.
    """
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
