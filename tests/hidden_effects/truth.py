"""The held-out error that remains when the truth is known: the mark that every method is measured against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .features import Log, Table, effect_of, nominal_base, seconds_of, windows
from .judge import in_library
from .motion import Array
from .peers import PRIOR_SD, heldout_error, ridge
from .planned import EXECUTION
from .world import World

Columns = tuple[dict[str, Array], list[Array]]
"""Of one run: the base model's unit columns, and the power of each hidden effect [W]."""


def columns(
    world: World | None, logs: Sequence[Log], hidden: Sequence[str], tables: Sequence[Table]
) -> list[Columns] | None:
    """True columns of each run at its table's rows; None where they cannot be known (practice, outside the library).

    In the little world they are free of noise and as late as the meter sees them, so that knowing the truth includes
    knowing the meter's clock; for practice folders they are the library's columns, from the log.
    """
    names = [e for e in hidden if e not in EXECUTION]
    if world is None:
        if not all(in_library(e) for e in names):
            return None
        return [(table.base, [_library_column(table, e) for e in names]) for table in tables]
    out: list[Columns] = []
    for log, true in zip(logs, world.truth.values(), strict=True):
        time_s = np.asarray(log["time_s"], dtype=float)
        dt, group = windows(time_s), seconds_of(time_s)
        weight = np.bincount(group, dt)
        mean = {key: np.bincount(group, x * dt) / weight for key, x in true.items() if len(x) == len(dt)}
        base = {key.removeprefix("base:"): x for key, x in mean.items() if key.startswith("base:")}
        out.append((base, [mean[f"hidden:{e}"] for e in names]))
    return out


def _library_column(table: Table, effect: str) -> Array:
    for key, column in [*table.library.items(), *table.base.items()]:
        if effect_of(key) == effect:
            return column
    return np.zeros_like(table.measured_w)


def oracle(
    train: Sequence[Table], heldout: Sequence[Table], true: Sequence[Columns], robot: str
) -> tuple[float, float]:
    """Held-out energy error [%] and power RMSE [W] of least squares on the true columns and the recalibrated base."""
    parameters = nominal_base(robot)
    keys = tuple(parameters)
    blocks = [np.column_stack([*(base[key] for key in keys), *hidden]) for base, hidden in true]
    nominal = np.array([parameters[key] for key in keys] + [0.0] * (blocks[0].shape[1] - len(keys)))
    prior = np.array([PRIOR_SD * parameters[key] for key in keys] + [np.inf] * (len(nominal) - len(keys)))
    residual = [t.measured_w - x @ nominal for t, x in zip(train, blocks, strict=False)]
    change = ridge(np.concatenate(blocks[: len(train)]), np.concatenate(residual), prior)
    return heldout_error(heldout, [x @ (nominal + change) for x in blocks[len(train) :]])
