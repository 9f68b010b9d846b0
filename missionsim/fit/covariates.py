"""Covariates of a measured run: log columns, what follows from them, and what the remaining error may depend on."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.derive import derive
from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.labels import Labels

Array = NDArray[np.float64]
MOST_MISSING = 0.2
"""Part of a column's rows that may be missing and are filled from their neighbours."""
MOST_TEXTS = 12
# electrical quantities follow the load, so they can never be its cause; places and clocks of memory are no physics
_NO_CAUSE = re.compile(
    r"(^|_)(power|voltage|volts?|current|amps?|energy|soc|charge)(_|$)"
    r"|^(x_m|y_m|segment|starts|starts_per_s|body_mass_kg|mass_kg|regeneration|drive_w|load_w|moving)$|^on_time_"
)


@dataclass(frozen=True)
class Run:
    """One run at the raw rate, arrays of shape (n,).

    Attributes
    ----------
    name : str
    time_s, dt_s, measured_w : ndarray
    fresh : ndarray of bool or None
        Rows at which the power was refreshed.
    cov : mapping
        Covariates with derived ones, the robot's constants, ``drive_w`` and ``load_w`` of the base model.
    """

    name: str
    time_s: Array
    dt_s: Array
    measured_w: Array
    fresh: NDArray[np.bool_] | None
    cov: dict[str, Any]


def run_covariates(model: PowerModel, log: Any, battery: str, remarks: list[str]) -> Run:
    """Covariates of one log for one battery.

    Gaps in a numeric column are filled from its neighbours up to `MOST_MISSING`; a column with more is left out. Both
    are said in `remarks`.
    """
    time_s = np.asarray(log.time_s, dtype=float)
    columns: dict[str, Any] = {}
    for name, values in log.columns.items():
        if isinstance(values, Labels):
            columns[name] = values
            continue
        array = np.asarray(values, dtype=float)
        missing = ~np.isfinite(array)
        if missing.any():
            share = float(missing.mean())
            if share > MOST_MISSING:
                remarks.append(f"{log.run}: column {name} is empty in {share:.0%} of the rows and is left out")
                continue
            array = np.interp(time_s, time_s[~missing], array[~missing])
            remarks.append(f"{log.run}: {int(missing.sum())} missing values of {name} filled from their neighbours")
        columns[name] = array
    columns["time_s"] = time_s
    cov = model.complete(derive(columns, time_s, np.asarray(log.dt_s, dtype=float)))
    if "speed_m_s" in cov:
        cov["speed_m_s"] = np.asarray(cov["speed_m_s"], dtype=float)
    cov.update(_loads(model, cov, battery))
    fresh = log.fresh.get(battery) if log.fresh else None
    return Run(
        log.run, time_s, np.asarray(log.dt_s, dtype=float), np.asarray(log.power_w[battery], dtype=float), fresh, cov
    )


def _loads(model: PowerModel, cov: dict[str, Any], battery: str) -> dict[str, Any]:
    """``drive_w`` and ``load_w`` of the base model, for effects that need them; empty where it cannot be evaluated."""
    try:
        powers = model.evaluate(cov, battery=battery)[battery]
    except InputError:
        return {}
    rows = np.zeros(len(cov["time_s"]))
    drive = {term.key for term in model.of(battery) if term.effect.drive}
    return {
        "drive_w": sum((power for key, power in powers.items() if key in drive), start=rows),
        "load_w": sum(powers.values(), start=rows),
    }


def shared_names(runs: Sequence[Run], remarks: list[str]) -> set[str]:
    """Names of covariates that every run has; a missing ``on_…`` counts as switched off."""
    every = set.union(*(set(run.cov) for run in runs))
    for name in sorted(every):
        lacking = [run for run in runs if name not in run.cov]
        if not lacking or name.startswith("on_time_"):
            continue
        told = ", ".join(run.name for run in lacking[:3]) + (" …" if len(lacking) > 3 else "")
        if name.startswith("on_"):
            for run in lacking:
                run.cov[name] = np.zeros(len(run.time_s))
                run.cov[f"on_time_{name[3:]}_s"] = np.zeros(len(run.time_s))
            remarks.append(f"{name} is not logged in {told}: counted as switched off there")
        elif not _NO_CAUSE.search(name):
            remarks.append(f"{name} is not logged in {told}: effects that need it are not tested")
    return set.intersection(*(set(run.cov) for run in runs))


def texts(runs: Sequence[Run], names: set[str]) -> dict[str, tuple[str, ...]]:
    """The distinct texts of each text column over all runs, in order of the alphabet."""
    found: dict[str, tuple[str, ...]] = {}
    for name in sorted(names):
        values = [run.cov[name] for run in runs]
        if all(isinstance(value, Labels) for value in values):
            used = {value.names[int(code)] for value in values for code in np.unique(value.codes) if code >= 0}
            found[name] = tuple(sorted(used))
    return found


def watched(run: Run, names: set[str], known: Mapping[str, tuple[str, ...]]) -> dict[str, Array]:
    """Covariates that the remaining error may depend on; text columns as their number in `known`.

    Voltages, currents and powers are left out: they follow the load and are never its cause.
    """
    found: dict[str, Array] = {}
    for name in sorted(names):
        if _NO_CAUSE.search(name):
            continue
        value = run.cov[name]
        if isinstance(value, Labels):
            order = {text: i for i, text in enumerate(known[name])}
            if 1 < len(order) <= MOST_TEXTS:
                codes = np.array([*(order.get(text, -1) for text in value.names), -1])
                found[name] = codes[value.codes].astype(float)
        elif np.shape(value) == run.time_s.shape:
            found[name] = np.asarray(value, dtype=float)
    return found
