"""Runs that are one measurement: the same speeds, to their last digit, in the same order."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from missionsim.labels import Labels
from missionsim.runs.covariates import COVARIATES, is_switch
from missionsim.runs.run import Run

SHARE = 0.003
"""Standard deviation of the difference of two powers, in parts of their mean, below which they are one measurement.
Noise of meters and drives is ten times as large."""
WINDOW, LEAST, PART, UNLIKE, TOGETHER_S = 6, 60, 0.5, 0.9, 1.0
"""Changes of the speed in a fingerprint; fingerprints that a run must have, the part of them that a copy shares, and
the part that must be unlike all others of the run: a measured speed never comes twice alike to its last digit, a
commanded one does. What is shared comes that near to one time later [s]: ramps that were driven alike come at times of
their own."""
MOST = 4000
"""Fingerprints of a run that are compared."""


def copies(runs: Sequence[Run]) -> dict[int, int]:
    """Number of a run that is a copy → number of the first run that it copies. One that was driven alike under another
    condition, such as another payload all the way, is none."""
    conditions = [_conditions(run) for run in runs]
    seen = [_fingerprints(run) for run in runs]
    rare = 1 + max((len(one) for one in seen), default=0) // MOST
    # by content, so that copies choose the same ones
    chosen = [{value: at for value, at in one.items() if value % rare == 0} for one in seen]
    owners: dict[int, list[int]] = {}
    for i, one in enumerate(chosen):
        for value in one:
            owners.setdefault(value, []).append(i)
    shifts: dict[tuple[int, int], list[float]] = {}
    for value, own in owners.items():
        for i, j in combinations(own, 2):
            shifts.setdefault((i, j), []).append(chosen[j][value] - chosen[i][value])
    found: dict[int, int] = {}
    for j, run in enumerate(runs):
        for i in range(j):
            least = min(len(chosen[i]), len(chosen[j]))
            late = np.sort(shifts.get((i, j), []))
            shared = int(np.max(np.searchsorted(late, late + TOGETHER_S) - np.arange(len(late)), initial=0))
            alike = least >= LEAST / rare and shared > PART * least
            if i in found or set(run.power_w) != set(runs[i].power_w):
                continue
            same = run.rows == runs[i].rows and all(
                float(np.std(power - run.power_w[name])) <= SHARE * abs(float(np.mean(power)))
                for name, power in runs[i].power_w.items()
            )
            shared_conditions = conditions[i].keys() & conditions[j].keys()
            if (alike or same) and all(conditions[i][name] == conditions[j][name] for name in shared_conditions):
                found[j] = i
                break
    return found


def _conditions(run: Run) -> dict[str, object]:
    """What a run was driven under from its first row to its last, by column of the glossary."""
    found: dict[str, object] = {}
    for name, data in run.columns.items():
        if name in COVARIATES or is_switch(name):
            values = data.codes if isinstance(data, Labels) else data[np.isfinite(data)]
            if len(values) and np.ptp(values) == 0:
                found[name] = data.texts()[0] if isinstance(data, Labels) else float(values[0])
    return found


def _fingerprints(run: Run) -> dict[int, float]:
    """One number for each few successive speeds → when they begin [s]; none where speeds come again."""
    if "speed_m_s" not in run.columns:
        return {}
    speed = np.round(run.number("speed_m_s"), 9)
    time_s, speed = run.time_s[np.isfinite(speed)], speed[np.isfinite(speed)]
    changed = np.diff(speed, prepend=np.nan) != 0.0
    time_s, speed = time_s[changed], speed[changed]
    if len(speed) < LEAST + WINDOW:
        return {}
    factor = np.uint64(0x9E3779B97F4A7C15)
    bits = (speed + 0.0).view(np.uint64) * factor
    mixed = np.zeros(len(bits) - WINDOW + 1, dtype=np.uint64)
    for k in range(WINDOW):
        mixed = (mixed ^ (bits[k : k + len(mixed)] >> np.uint64(13 + k))) * factor
    values, first = np.unique(mixed >> np.uint64(8), return_index=True)
    own = dict(zip(values.tolist(), time_s[first].tolist(), strict=True))
    return own if len(values) > UNLIKE * len(mixed) else {}
