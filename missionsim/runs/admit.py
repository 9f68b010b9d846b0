"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.runs.error import errors_of
from missionsim.runs.run import Run

LEVEL = 3.0
"""Measured over modelled energy, against the median of all runs, from which on a run has another unit (assumed)."""
SUSPECT, EXPLAINED = 1.5, 1.25
"""The same from which on another unit of the speed is tried, and within which it explains the difference (assumed)."""
SPEEDS = {3.6: "km/h", 1000.0: "mm/s", 1.0 / 3.6: "m/s divided by 3.6"}
FEWEST = 3
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
            ratios = np.array([_ratio(model, run, battery) for run in own])
        except InputError:
            continue  # told where the battery is looked at
        usual = float(np.median(ratios))
        for run, ratio in zip(own, ratios, strict=True):
            off = ratio / usual
            if not np.isfinite(off) or max(abs(off), 1.0 / max(abs(off), 1e-12)) < SUSPECT:
                continue
            for factor, unit in SPEEDS.items():
                if "speed_m_s" in run.columns and _near(_ratio(model, _slower(run, factor), battery) / usual):
                    found[run.run] = f"speed_m_s is {factor:.3g} times too large ({unit}?)"
                    break
            else:
                if off < 0.0 or max(off, 1.0 / off) > LEVEL:
                    found[run.run] = (
                        f"power_{battery}_w is {off:.3g} times the other runs against the model: another unit?"
                    )
    # where most runs are odd it is the model that is
    return found if len(found) < 0.5 * len(runs) else {}


def _ratio(model: PowerModel, run: Run, battery: str) -> float:
    error = errors_of(model, [run], battery).total
    return error.measured_j / error.model_j if error.model_j else float("nan")


def _slower(run: Run, factor: float) -> Run:
    columns = {name: data for name, data in run.columns.items() if name != "accel_m_s2"}
    return replace(run, columns={**columns, "speed_m_s": run.number("speed_m_s") / factor})


def _near(off: float) -> bool:
    return bool(np.isfinite(off) and 1.0 / EXPLAINED < off < EXPLAINED)
