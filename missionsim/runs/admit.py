"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.effects.covariates import is_moving
from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.runs.covariates import is_switch, may_be_cause
from missionsim.runs.drive import Driven, drive
from missionsim.runs.run import Run

LEVEL = 3.0
"""Measured over modelled energy, against the median of all runs, from which on a run has another unit (assumed)."""
SUSPECT, EXPLAINED = 1.5, 1.25
"""The same from which on another unit of the speed is tried, and within which it explains the difference (assumed)."""
ALIKE, ALONE = 4.0, 12.0
"""Levels of runs differ among themselves, by floors or loads: one is looked at beyond so many times that, and odd
without any known factor beyond so many (assumed)."""
SPEEDS = {3.6: "km/h", 1000.0: "mm/s", 1.0 / 3.6: "m/s divided by 3.6"}
FEWEST = 3
FEWEST_LEVELS = 5
OFFSET, SCATTER = 0.06, 6.0
"""An offset of one run is told from this part of the mean power on, and this many deviations of all runs (assumed)."""
LOADS = ("cpu_load", "cpu_freq_hz")
"""Columns of the glossary that may say why one run takes more than the others at rest and in motion alike."""
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
        if not usual > 0.0:
            continue
        apart = np.abs(np.log(np.maximum(ratios / usual, 1e-12)))
        middle = float(np.nanmedian(apart))
        least = max(np.log(SUSPECT), ALIKE * middle)
        for run, off, far in zip(own, ratios / usual, apart, strict=True):
            if not np.isfinite(off) or far < least:
                continue
            for factor, unit in SPEEDS.items():
                if _other_speeds(run, own, factor) and _near(
                    _ratio(drive(model, _slower(run, factor), battery), battery) / usual
                ):
                    found[run.run] = f"speed_m_s is {factor:.3g} times too large ({unit}?)"
                    break
            else:
                if off < 0.0 or far > np.log(LEVEL):
                    found[run.run] = (
                        f"power_{battery}_w is {off:.3g} times the other runs against the model: another unit?"
                    )
                elif far > ALONE * middle:
                    found[run.run] = (
                        f"power_{battery}_w is {off:.3g} times the other runs against the model, which agree: "
                        "another robot, unit or load?"
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
                (level - float(np.median(others)), rows)
                for key, (level, rows) in own.items()
                if key[0] == moving
                and len(others := [other[key][0] for j, other in enumerate(levels) if j != i and key in other])
                >= (3 if moving else 1)
            ]
            if apart:
                beside[i, moving] = np.average([one[0] for one in apart], weights=[one[1] for one in apart])
    if np.isnan(beside[:, 1]).sum() > 0.5 * len(runs):
        return {}
    towards = np.array([_towards_rest(one, battery) for one in runs])
    beside = np.column_stack([beside, towards - np.median(towards)])
    known = [np.abs(column[np.isfinite(column)]) for column in beside.T]
    scatter = [1.4826 * float(np.median(one)) if len(one) >= FEWEST_LEVELS - 1 else np.inf for one in known]
    mean = float(np.mean([abs(one.measured_w[battery].mean()) for one in runs]))
    why = "an offset of its meter, or something on that is not logged?"
    return {
        one.run.run: f"power_{battery}_w lies {apart[1]:+.2g} W beside the other runs, at rest and in motion: {why}"
        for one, apart in zip(runs, beside, strict=True)
        if abs(apart[1]) > max(OFFSET * mean, _spread(one, battery))
        and 0.5 < (apart[2] if np.isnan(apart[0]) else apart[0]) / apart[1] < 2.0
        and bool((np.abs(apart) > SCATTER * np.array(scatter)).any())
        and not _explained(one, runs, battery, float(apart[1]))
    }


def _levels(driven: Driven, battery: str) -> dict[tuple[object, ...], tuple[float, int]]:
    """Median of measured less modelled power, and the rows, by rest or motion and by what is on."""
    cov, gap = driven.covariates, driven.measured_w[battery] - driven.model_w[battery]
    names = sorted(name for name in driven.run.columns if is_switch(name))
    states = np.column_stack([is_moving(cov) * np.ones(len(gap)), *(np.asarray(cov[name], float) for name in names)])
    kinds, which = np.unique(states, axis=0, return_inverse=True)
    groups = ((tuple(kind), gap[which.ravel() == i]) for i, kind in enumerate(kinds))
    return {kind: (float(np.median(rows)), len(rows)) for kind, rows in groups if len(rows) >= (15 if kind[0] else 5)}


def _spread(driven: Driven, battery: str) -> float:
    """How far measured less modelled power scatters in motion; what a model far from right leaves is no offset."""
    gap = (driven.measured_w[battery] - driven.model_w[battery])[np.asarray(is_moving(driven.covariates), dtype=bool)]
    return 1.4826 * float(np.median(np.abs(gap - np.median(gap)))) if len(gap) else 0.0


def _towards_rest(driven: Driven, battery: str) -> float:
    """What a straight line through measured less modelled power over the speed comes to at rest."""
    gap, speed = (
        driven.measured_w[battery] - driven.model_w[battery],
        np.abs(np.asarray(driven.covariates["speed_m_s"])),
    )
    return float(np.polyfit(speed, gap, 1)[1]) if np.ptp(speed) > 0.0 else float("nan")


def _explained(driven: Driven, runs: Sequence[Driven], battery: str, offset: float) -> bool:
    """Whether a load that is logged makes up half an offset, by its slope in other runs or as none of them has it."""
    for name, data in driven.run.columns.items():
        if isinstance(data, Labels) or not (name in LOADS or (column_of(name) is None and may_be_cause(name))):
            continue
        others = [one for one in runs if one is not driven and name in one.run.columns]
        if len(others) < FEWEST:
            continue
        load = np.concatenate([one.run.number(name) - np.mean(one.run.number(name)) for one in others])
        gaps = [one.measured_w[battery] - one.model_w[battery] for one in others]
        gap = np.concatenate([one - one.mean() for one in gaps])
        more = float(np.mean(data)) - float(np.median([np.mean(one.run.number(name)) for one in others]))
        spread = float(load @ load)
        if spread < len(load) * (0.1 * more) ** 2 or 0.5 < float(load @ gap) / spread * more / offset < 2.0:
            return True
    return False


def _other_speeds(run: Run, runs: Sequence[Run], factor: float) -> bool:
    """Whether a run's speeds are more like those of the others when they are divided by a factor."""
    fast = {
        one.run: float(np.quantile(np.abs(one.number("speed_m_s")), 0.95)) for one in runs if "speed_m_s" in one.columns
    }
    own, usual = fast.get(run.run, 0.0), float(np.median([*fast.values()])) if fast else 0.0
    return own > 0.0 and usual > 0.0 and abs(np.log(own / factor / usual)) < abs(np.log(own / usual))


def _slower(run: Run, factor: float) -> Run:
    columns = {name: data for name, data in run.columns.items() if name != "accel_m_s2"}
    return replace(run, columns={**columns, "speed_m_s": run.number("speed_m_s") / factor})


def _near(off: float) -> bool:
    return bool(np.isfinite(off) and 1.0 / EXPLAINED < off < EXPLAINED)
