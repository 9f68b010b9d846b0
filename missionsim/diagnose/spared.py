"""Which runs are held out: the last ones, unless these alone show what effects depend on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from missionsim.effects.library import all_effects
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import MOTION, is_switch, logged_name
from missionsim.runs.run import Run

TOLD_APART = 0.01
"""Part of the squares of a cause over runs that another one must leave for both to be told apart at all (assumed)."""
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
    names, sums = _causes(logs)
    total = sums.sum(axis=0)
    whole = _apart(total)
    asked = whole > TOLD_APART * np.diag(whole)[:, None]

    def kept(rest: Array) -> Array:
        return np.divide(_apart(rest), whole, out=np.ones(rest.shape[:-2] + whole.shape), where=asked)

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


def _apart(total: Array) -> Array:
    """Squares of each cause over time that another one leaves, shape (..., causes, causes), on the diagonal all."""
    gram = total[..., 1:, 1:] - total[..., 1:, :1] * total[..., :1, 1:] / total[..., :1, :1]
    alone = np.diagonal(gram, axis1=-2, axis2=-1)
    varies = alone > 1e-9 * np.diagonal(total, axis1=-2, axis2=-1)[..., 1:]
    alone = np.where(varies, alone, 0.0)
    other, counts = (some[..., None, :] for some in (np.where(varies, alone, 1.0), varies))
    rest = alone[..., :, None] - np.where(counts, gram**2 / other, 0.0)
    every = np.arange(rest.shape[-1])
    rest[..., every, every] = alone
    return np.asarray(rest)
