"""Why a run may draw otherwise than the others: a column in which it lies where none does, or where some do as well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import MOTION, is_switch, may_be_cause
from missionsim.runs.run import Run

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
