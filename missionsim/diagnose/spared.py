"""Which runs are held out: the last ones, unless these alone show what effects depend on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from missionsim.diagnose.steady import steady_temperatures
from missionsim.effects.library import all_effects
from missionsim.identify.predictive import left_by_others
from missionsim.identify.settings import TOLD_APART
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import MOTION, is_switch, logged_name
from missionsim.runs.run import Run

LEAST_KEPT = 1.0 / 3.0
"""Part of what tells them apart that the fitted runs keep (assumed): a quarter of eight runs takes more of one cause in
one case of fourteen, of a drive made to tell two apart always."""

BLOCK_ROWS = 2**14
"""Rows that are added up at once; of all rows of a long run the copies would take longer than the sums."""


def spared(logs: Sequence[Run], count: int) -> tuple[list[int], list[str]]:
    """Places of the last `count` runs; or, where these alone show causes of effects, of as many that show least of
    them, with what the last ones show.

    Runs that were driven to tell two causes apart would be held out as the last, and never be learnt from.
    """
    names, sums = _causes([steady_temperatures(log) for log in logs])
    total = sums.sum(axis=0)
    whole = left_by_others(total, 1)
    asked = whole > TOLD_APART * np.diag(whole)[:, None]

    def kept(rest: Array) -> Array:
        return np.divide(left_by_others(rest, 1), whole, out=np.ones(rest.shape[:-2] + whole.shape), where=asked)

    last = list(range(len(logs) - count, len(logs)))
    gone = kept(total - sums[last].sum(axis=0)) < LEAST_KEPT
    # what is not shown at all is not shown apart from anything either
    alone = np.diag(gone)
    pairs = gone & ~alone[:, None] & ~alone[None, :] | np.diag(alone)
    lost = sorted({names[k] for pair in np.argwhere(pairs) for k in pair})
    held: list[int] = []
    few = gone.sum()
    while lost and len(held) < count:
        others = [number for number in range(len(logs)) if number not in held]
        left = kept(total - sums[held].sum(axis=0) - sums[others])
        losses, least = (left < LEAST_KEPT).sum(axis=(1, 2)), left.min(axis=(1, 2))
        few, _, number = min(zip(losses, -least, np.negative(others), strict=True))
        held.append(-int(number))
    # where every choice loses as much, the last ones are as good
    return (sorted(held), lost) if few < gone.sum() else (last, [])


def _causes(logs: Sequence[Run]) -> tuple[list[str], Array]:
    """Causes of effects that all runs log, motion as it is and squared, a label once for each of its texts; and of each
    run the integrals over time of products of one and of them, shape (runs, 1 + causes, 1 + causes)."""
    needed = {logged_name(name) for effect in all_effects((), ("",)) for name in effect.needs}
    logged = set.intersection(*(set(log.covariates()) for log in logs))
    causes: list[tuple[str, str | int]] = []
    for name in sorted(name for name in logged if name in needed or is_switch(name)):
        labels = [column for log in logs if isinstance(column := log.columns[name], Labels)]
        if len(labels) == len(logs):
            causes += [(name, text) for text in sorted({text for label in labels for text in label.names})]
        elif not labels:  # text in some runs and numbers in others are no cause
            causes += [(name, power) for power in ((1, 2) if name in MOTION else (1,))]

    def products(log: Run) -> Array:
        total = np.zeros((1 + len(causes), 1 + len(causes)))
        for begin in range(0, len(log), BLOCK_ROWS):
            part = slice(begin, begin + BLOCK_ROWS)
            rows = np.ones((len(total), len(log.dt_s[part])))
            for row, (name, of) in zip(rows[1:], causes, strict=True):
                column = log.columns[name][part]
                row[:] = column.equals(str(of)) if isinstance(column, Labels) else column ** int(of)
            rows *= np.sqrt(log.dt_s[part])
            total += rows @ rows.T
        return total

    # of what some rows do not know nothing is said: NaN is never more
    return [name for name, _ in causes], np.array([products(log) for log in logs])
