"""Runs beside others: those that are one measurement, and columns in which one lies where none, or only some, do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import COVARIATES, MOTION, is_switch, may_be_cause
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


FEWEST = 3
"""Runs that can say what is usual."""
BEYOND = 0.25
"""Distance of a run's usual value from all of the others, in parts of their range, from which they cannot say what is
usual there (assumed)."""
NEARLY = 0.25
"""Of what a run is off by, the part that those near it in something are off by too, where that may be why (assumed)."""
_ANY_DRIVE = MOTION | {"slope_rad", "heading_rad", "time_s"}
"""What differs between any two drives."""


def beyond(run: Run, others: Sequence[Run]) -> list[str]:
    """Columns, but those of motion, in which a run is where no other run is: what it costs more is not odd then."""
    found: list[str] = []
    for name, data, runs in _causes(run, others):
        have = [one.columns[name] for one in runs]
        if isinstance(data, Labels):
            seen = [text for one in have if isinstance(one, Labels) for text in {*one.names}]
            # what is called differently in every run is the name of a run
            if not {*data.names} & {*seen} and (name == "surface" or max(map(seen.count, seen), default=0) > 1):
                found.append(name)
            continue
        values = np.concatenate([one[np.isfinite(one)] for one in have if not isinstance(one, Labels)])
        own = data[np.isfinite(data)]
        if not len(own) or not len(values) or (np.ptp(own) > 0.0 and np.all(np.diff(own) >= 0.0)):
            continue  # a clock is elsewhere in every run
        low, high = np.quantile(values, [0.02, 0.98])
        most = max(BEYOND * float(high - low), 1e-9 * abs(float(high)))
        if not low - most <= float(np.median(own)) <= high + most:
            found.append(name)
    return found


def as_near(run: Run, others: Sequence[Run], level: Mapping[str, float]) -> list[str]:
    """Columns, but those of motion, in which the nearest of other runs are off the same way: heat or rain may be why.

    `level`: by run, log of measured over modelled energy.
    """
    found: list[str] = []
    usual = float(np.median([*level.values()]))
    off = level[run.run] - usual
    for name, data, having in _causes(run, others):
        have = [one for one in having if not _empty(one.columns[name])]
        if isinstance(data, Labels):
            same = {one.run: one.columns[name] for one in have}
            near = [run for run, own in same.items() if isinstance(own, Labels) and _mostly(own) == _mostly(data)]
        else:
            far = {one.run: abs(float(np.nanmedian(one.number(name)) - np.nanmedian(data))) for one in have}
            near = [run for run, own in far.items() if own == min(far.values())]
        if near and float(np.median([level[one] for one in near]) - usual) * np.sign(off) > NEARLY * abs(off):
            found.append(name)
    return found


def _empty(data: Array | Labels) -> bool:
    return not (np.any(data.codes >= 0) if isinstance(data, Labels) else np.isfinite(data).any())


def _mostly(data: Labels) -> str:
    """The label of most rows."""
    counted = np.bincount(data.codes[data.codes >= 0], minlength=1)
    return data.names[int(np.argmax(counted))] if counted.any() else ""


def _causes(run: Run, others: Sequence[Run]) -> Iterator[tuple[str, Array | Labels, list[Run]]]:
    """Columns of a run that may be why it draws more, but those of motion, and the other runs that have them."""
    for name, data in run.columns.items():
        have = [one for one in others if name in one.columns]
        sensed = name not in _ANY_DRIVE and not is_switch(name) and may_be_cause(name)
        if sensed and len(have) >= FEWEST and not _empty(data):
            yield name, data, have
