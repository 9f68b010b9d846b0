"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.effects.covariates import is_moving
from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.runs.covariates import is_switch
from missionsim.runs.drive import Driven, drive
from missionsim.runs.run import Run

LEVEL = 3.0
"""Measured over modelled energy, against the median of all runs, from which on a run has another unit (assumed)."""
SUSPECT, EXPLAINED = 1.5, 1.25
"""The same from which on another unit of the speed is tried, and within which it explains the difference (assumed)."""
SPEEDS = {3.6: "km/h", 1000.0: "mm/s", 1.0 / 3.6: "m/s divided by 3.6"}
FEWEST = 3
FEWEST_LEVELS = 5
OFFSET, SCATTER = 0.06, 6.0
"""An offset of one run is told from this part of the mean power on, and this many deviations of all runs (assumed)."""
COPY_SHARE = 0.003
"""Standard deviation of the difference of two logs, in parts of the mean power, below which they are one measurement.
Noise of meters and drives is ten times as large."""


def admit(runs: Sequence[Run], model: PowerModel | None = None) -> tuple[list[Run], list[str]]:
    """Runs to learn from, and what was left out and why, one line a run.

    Raises
    ------
    missionsim.errors.InputError
        Where no run is left; with the faults that `validate` tells.
    """
    kept: list[Run] = []
    told: list[str] = []
    for run in runs:
        errors = [remark for remark in run.remarks if remark.severity == "error"]
        copy = next((other.run for other in kept if _copy(run, other)), "")
        if errors:
            told.append(f"{run.run}: {'; '.join(str(remark) for remark in errors)}")
        elif copy:
            told.append(f"{run.run}: a copy of {copy} but for noise; one measurement counts once")
        else:
            kept.append(run)
    if runs and not kept:
        raise InputError([r.fault(run.source) for run in runs for r in run.remarks if r.severity == "error"])
    if model is not None:
        odd = _odd(kept, model)
        told = [*(f"{name}: {why}" for name, why in odd.items()), *told]
        kept = [run for run in kept if run.run not in odd]
    return kept, told


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


def _copy(one: Run, other: Run) -> bool:
    if one.rows != other.rows or set(one.power_w) != set(other.power_w):
        return False
    return all(
        float(np.std(power - other.power_w[name])) <= COPY_SHARE * abs(float(np.mean(power)))
        for name, power in one.power_w.items()
    )


def _odd(runs: Sequence[Run], model: PowerModel) -> dict[str, str]:
    """Runs whose level against the model differs from that of the others by a factor, and the factor in words."""
    found: dict[str, str] = {}
    for battery in model.batteries:
        own = [run for run in runs if battery in run.power_w]
        if len(own) < FEWEST:
            continue
        try:
            driven = [drive(model, run, battery) for run in own]
        except InputError:
            continue  # told where the battery is looked at
        found |= _offset(driven, battery)
        ratios = np.array([_ratio(one, battery) for one in driven])
        usual = float(np.median(ratios))
        for run, ratio in zip(own, ratios, strict=True):
            off = ratio / usual
            if not np.isfinite(off) or max(abs(off), 1.0 / max(abs(off), 1e-12)) < SUSPECT:
                continue
            for factor, unit in SPEEDS.items():
                if "speed_m_s" in run.columns and _near(
                    _ratio(drive(model, _slower(run, factor), battery), battery) / usual
                ):
                    found[run.run] = f"speed_m_s is {factor:.3g} times too large ({unit}?)"
                    break
            else:
                if off < 0.0 or max(off, 1.0 / off) > LEVEL:
                    found[run.run] = (
                        f"power_{battery}_w is {off:.3g} times the other runs against the model: another unit?"
                    )
    # where most runs are odd it is the model that is
    return found if len(found) < 0.5 * len(runs) else {}


def _ratio(driven: Driven, battery: str) -> float:
    model_j = float(driven.model_w[battery] @ driven.dt_s)
    return float(driven.measured_w[battery] @ driven.dt_s) / model_j if model_j else float("nan")


def _offset(runs: Sequence[Driven], battery: str) -> dict[str, str]:
    """Runs whose power lies beside that of all others by one offset, at rest and in motion with the same things on."""
    if len(runs) < FEWEST_LEVELS:
        return {}
    levels = [_levels(one, battery) for one in runs]
    beside = np.full((len(runs), 2), np.nan)
    for i, own in enumerate(levels):
        for moving in (0, 1):
            apart = [
                own[key] - float(np.median(others))
                for key in own
                if key[0] == moving
                and len(others := [other[key] for j, other in enumerate(levels) if j != i and key in other])
                >= (3 if moving else 1)
            ]
            beside[i, moving] = np.mean(apart) if apart else np.nan
    if np.isnan(beside[:, 1]).sum() > 0.5 * len(runs):
        return {}
    mean = float(np.mean([abs(one.measured_w[battery].mean()) for one in runs]))
    known = [np.abs(column[np.isfinite(column)]) for column in beside.T]
    enough = [1.4826 * float(np.median(column)) for column in known if len(column) >= FEWEST_LEVELS - 1]
    scatter = min(enough, default=np.inf)
    least = max(OFFSET * mean, SCATTER * scatter)
    why = "an offset of its meter, or something on that is not logged?"
    return {
        one.run.run: f"power_{battery}_w lies {in_motion:+.2g} W beside the other runs, at rest and in motion: {why}"
        for one, (at_rest, in_motion) in zip(runs, beside, strict=True)
        if abs(in_motion) > least and 0.5 < at_rest / in_motion < 2.0
    }


def _levels(driven: Driven, battery: str) -> dict[tuple[object, ...], float]:
    """Median of measured less modelled power by rest or motion and by what is on, where there are rows enough."""
    cov, gap = driven.covariates, driven.measured_w[battery] - driven.model_w[battery]
    names = sorted(name for name in driven.run.columns if is_switch(name))
    states = np.column_stack([is_moving(cov) * np.ones(len(gap)), *(np.asarray(cov[name], float) for name in names)])
    kinds, which = np.unique(states, axis=0, return_inverse=True)
    groups = ((tuple(kind), gap[which.ravel() == i]) for i, kind in enumerate(kinds))
    return {kind: float(np.median(rows)) for kind, rows in groups if len(rows) >= (15 if kind[0] else 5)}


def _slower(run: Run, factor: float) -> Run:
    columns = {name: data for name, data in run.columns.items() if name != "accel_m_s2"}
    return replace(run, columns={**columns, "speed_m_s": run.number("speed_m_s") / factor})


def _near(off: float) -> bool:
    return bool(np.isfinite(off) and 1.0 / EXPLAINED < off < EXPLAINED)
