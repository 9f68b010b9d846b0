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


def spared(logs: Sequence[Run], count: int) -> tuple[list[int], list[str]]:
    """Places of the last `count` runs; or, where these alone show causes of effects, of as many that show least of
    them, with what the last ones show.

    Runs that were driven to tell two causes apart would be held out as the last, and never be learnt from.
    """
    names, sums = _causes(logs)
    whole = _apart(sums)
    asked = whole > TOLD_APART * np.diag(whole)[:, None]

    def kept(held: Sequence[int]) -> Array:
        rest = _apart(np.delete(sums, held, axis=0))
        return np.divide(rest, whole, out=np.ones_like(whole), where=asked)

    held = list(range(len(logs) - count, len(logs)))
    gone = kept(held) < LEAST_KEPT
    # what is not shown at all is not shown apart from anything either
    alone = np.diag(gone)
    pairs = gone & ~alone[:, None] & ~alone[None, :] | np.diag(alone)
    lost = sorted({names[k] for pair in np.argwhere(pairs) for k in pair})
    if lost:
        held = []
        while len(held) < count:
            others = [number for number in range(len(logs)) if number not in held]
            held.append(max(others, key=lambda number: (float(kept([*held, number]).min()), number)))
    return sorted(held), lost


def _causes(logs: Sequence[Run]) -> tuple[list[str], Array]:
    """Causes of effects that all runs log, motion as it is and squared, a label once for each of its texts; and of each
    run the integrals over time of products of one and of them, shape (runs, 1 + causes, 1 + causes)."""
    needed = {logged_name(name) for effect in all_effects((), ("",)) for name in effect.needs}
    logged = set.intersection(*(set(log.covariates()) for log in logs))
    names, rows = [], [[np.ones(len(log))] for log in logs]
    for name in sorted(name for name in logged if name in needed or is_switch(name)):
        columns = [log.columns[name] for log in logs]
        texts = sorted({text for column in columns if isinstance(column, Labels) for text in column.names})
        names += [name] * (len(texts) or 1 + (name in MOTION))
        for own, column in zip(rows, columns, strict=True):
            if isinstance(column, Labels):
                own += [column.equals(text).astype(np.float64) for text in texts]
            else:
                own += [column, column**2] if name in MOTION else [column]
    # of what some rows do not know nothing is said: NaN is never more
    return names, np.array([(np.array(own) * log.dt_s) @ np.array(own).T for own, log in zip(rows, logs, strict=True)])


def _apart(sums: Array) -> Array:
    """Squares of each cause over time that another one leaves, shape (causes, causes), on the diagonal all."""
    total = sums.sum(axis=0)
    gram = total[1:, 1:] - np.outer(total[0, 1:], total[0, 1:]) / total[0, 0]
    alone = np.diag(gram)
    varies = alone > 1e-9 * np.diag(total)[1:]
    alone = np.where(varies, alone, 0.0)
    rest = alone[:, None] - np.where(varies, gram**2 / np.where(varies, alone, 1.0), 0.0)
    np.fill_diagonal(rest, alone)
    return np.asarray(rest)
