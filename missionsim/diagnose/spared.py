"""Which runs are held out: the last ones, unless these alone show what effects depend on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from missionsim.effects.library import all_effects
from missionsim.identify.settings import BETWEEN_PART
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import logged_name
from missionsim.runs.run import Run

TOLD_APART = 0.05
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
    lost = sorted({names[k] for pair in np.argwhere(kept(held) < LEAST_KEPT) for k in pair})
    if lost:
        held = []
        while len(held) < count:
            others = [number for number in range(len(logs)) if number not in held]
            held.append(max(others, key=lambda number: (float(kept([*held, number]).min()), number)))
    return sorted(held), lost


def _causes(logs: Sequence[Run]) -> tuple[list[str], Array]:
    """Causes of effects that hardly change within most runs, a label once for each of its texts, and of each run the
    integrals over time of products of one and of them, shape (runs, 1 + causes, 1 + causes)."""
    needed = {logged_name(name) for effect in all_effects((), ("",)) for name in effect.needs}
    names, rows = [], [[np.ones(len(log))] for log in logs]
    for name in sorted(needed.intersection(*(set(log.covariates()) for log in logs))):
        columns = [log.columns[name] for log in logs]
        texts = {text for column in columns if isinstance(column, Labels) for text in column.names}
        for text in sorted(texts) or [""]:
            parts = [column.equals(text) if isinstance(column, Labels) else column for column in columns]
            values = [np.asarray(part, dtype=np.float64) for part in parts]
            within = float(np.median([np.var(value) for value in values]))
            # of what some runs do not know nothing is said: NaN is never less
            if within < BETWEEN_PART * float(np.var(np.concatenate(values))):
                names.append(name)
                for own, value in zip(rows, values, strict=True):
                    own.append(value)
    return names, np.array([(np.array(own) * log.dt_s) @ np.array(own).T for own, log in zip(rows, logs, strict=True)])


def _apart(sums: Array) -> Array:
    """Squares of each cause over time that another one leaves, shape (causes, causes), on the diagonal all."""
    total = sums.sum(axis=0)
    gram = total[1:, 1:] - np.outer(total[0, 1:], total[0, 1:]) / total[0, 0]
    alone = np.diag(gram)
    rest = alone[:, None] - gram**2 / np.maximum(alone, 1e-300)
    np.fill_diagonal(rest, alone)
    return np.asarray(rest)
