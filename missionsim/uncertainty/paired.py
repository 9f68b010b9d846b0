"""Alternatives under common random numbers: is a difference real?"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from missionsim.files import Json
from missionsim.physics import Array
from missionsim.uncertainty.answers import LEVEL, proportion_interval
from missionsim.uncertainty.batch import Task, blocks_of, compute_block, prepare


def paired_difference(quantity: str, baseline: Array, other: Array) -> Json | None:
    """Mean of the differences (other − baseline) of paired runs with a Student interval, and whether it is `real`.

    `baseline`, `other` (shape (n,)): run by run with the same draws; runs that failed in either (NaN) are left out.
    Gives None with fewer than two pairs; the difference is real where the 95 % interval leaves out zero.
    """
    change = np.asarray(other, dtype=float) - np.asarray(baseline, dtype=float)
    change = change[np.isfinite(change)]
    if len(change) < 2:
        return None
    from scipy.special import stdtrit

    half = float(stdtrit(len(change) - 1, 0.5 + 0.5 * LEVEL)) * float(change.std(ddof=1)) / math.sqrt(len(change))
    mean = float(change.mean())
    real = abs(mean) > half
    return {"quantity": quantity, "mean": mean, "low": mean - half, "high": mean + half, "real": real}


def compare_alternatives(
    tasks: Sequence[Task], runs: int, advance: Callable[[int], object] = lambda count: None
) -> list[Json]:
    """Run all alternatives with the same draws.

    `tasks`: the baseline first; all with the same seed. `advance`: told the number of runs of each block that is done.
    Gives, for each alternative: engine, share of feasible runs with its interval, mean energies and margins above the
    reserve, and for all but the first the differences.
    """
    found: list[dict[str, Any]] = []
    baseline: dict[str, Array] = {}
    for task in tasks:
        prepared = prepare(task)
        batteries = prepared.mission.robot.batteries
        quantities = ["feasible", "duration_s"]
        quantities += [f"{what}_{name}_wh" for name in batteries for what in ("energy", "margin")]
        parts: dict[str, list[Array]] = {name: [] for name in quantities}
        for first, count in blocks_of(prepared, runs).items():
            block = compute_block(task, first, count)
            for name in quantities:
                parts[name].append(np.asarray(block[name], dtype=float))
            advance(count)
        columns = {name: np.concatenate(values) for name, values in parts.items()}
        row: dict[str, Any] = {
            "engine": prepared.engine,
            "p_feasible": float(columns["feasible"].mean()),
            "p_feasible_interval": list(proportion_interval(int(columns["feasible"].sum()), runs)),
            "mean": {name: float(np.nanmean(values)) for name, values in columns.items() if name != "feasible"},
            "differences": [],
        }
        if baseline:
            made = (paired_difference(name, baseline[name], v) for name, v in columns.items() if name in baseline)
            row["differences"] = [difference for difference in made if difference is not None]
        else:
            baseline = columns
        found.append(row)
    return found
