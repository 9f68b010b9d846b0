"""Draws of a plan's mission: how often it holds, and what is left before each limit."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.files import write_text
from missionsim.physics import Array
from missionsim.planner.answer import Answer, mission_text
from missionsim.planner.tour import Site
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.batch import Task, compute_block, prepare
from missionsim.uncertainty.single import simulate_block

Columns = dict[str, NDArray[Any]]
RUNS, FEW_RUNS = 4096, 200
"""Draws where arrays evaluate a mission, and where its runs are made one by one."""
SAME = 1e-9


@contextmanager
def mission_file(answer: Answer) -> Iterator[str]:
    """A file of a plan's mission, while it is needed."""
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "mission.yaml"
        write_text(path, mission_text(answer, path))
        yield str(path)


def draws_of(answer: Answer, seed: int) -> Columns:
    """Columns of many runs of a plan's mission, each with values drawn. Where they are evaluated as arrays, what a
    battery would lack in a run that empties it is known too."""
    site = answer.site
    with mission_file(answer) as path:
        task = Task(path, site.task.elsewhere, None, seed, "auto")
        prepared = prepare(task)
        if prepared.arrays is None:
            return compute_block(task, 0, FEW_RUNS)
        drawn = prepared.sampler.draw(seed, 0, RUNS)
        columns, again = prepared.arrays.evaluate(drawn, RUNS)
        lowest = np.array([_lowest(columns, name) for name in site.physics.names])
        empty = (lowest < -SAME * site.physics.capacity_wh[:, None]).any(axis=0)
        columns["feasible"][empty] = False
        if (rest := np.flatnonzero(again & ~empty)).size:
            some = {name: values[rest] for name, values in drawn.items()}
            mission, model, sampler = prepared.mission, prepared.model, prepared.sampler
            made = simulate_block(mission, model, sampler, seed, 0, rest.size, draws=some, runs=rest)
            for name, column in columns.items():
                column[rest] = made[name]
        return columns


def _lowest(columns: Columns, name: str) -> Array:
    """The least charge of a battery in each run [Wh]; not a number where a run that SimPy did ends with none."""
    return np.asarray(columns[f"charge_{name}_wh"][:, 0] - columns[f"needed_{name}_wh"])


def slack_of(site: Site, columns: Columns) -> Array:
    """What is left before each limit, shape (runs, 2 · batteries + 1): of each battery at the end and on the way [Wh],
    of the time [s]."""
    end = np.array([columns[f"margin_{name}_wh"] for name in site.physics.names])
    way = np.array([_lowest(columns, name) for name in site.physics.names])
    if site.task.within.reserve_throughout:
        way -= np.array([columns[f"charge_left_{name}_wh"] for name in site.physics.names]) - end
    return np.concatenate([end, way, [site.deadline_s - columns["duration_s"]]]).T


def holds(site: Site, columns: Columns) -> NDArray[np.bool_]:
    """Which runs are feasible, within the deadline, and keep the reserve on the way where that is asked."""
    count = len(site.physics.names)
    slack = slack_of(site, columns)
    kept = np.asarray(columns["feasible"], dtype=bool) & (columns["duration_s"] <= site.deadline_s * (1.0 + SAME))
    if site.task.within.reserve_throughout:
        kept &= (slack[:, count : 2 * count] >= -SAME * site.physics.capacity_wh).all(axis=1)
    return np.asarray(kept)


def told(site: Site, columns: Columns) -> dict[str, float]:
    """Share of the runs that hold, with its 95 % interval."""
    good = holds(site, columns)
    low, high = proportion_interval(int(good.sum()), good.size)
    return {"value": float(good.mean()), "low": low, "high": high, "runs": int(good.size)}


def standard_error(share: float, runs: float) -> float:
    """Standard error of a share of so many draws."""
    return math.sqrt(share * (1.0 - share) / runs)


def surer(site: Site, columns: Columns, asked: float, low: float) -> list[dict[str, Any]]:
    """Single changes with which a plan holds as often as is asked: a later deadline if that alone does, and asking for
    no more than the surest plan gives for certain."""
    found = []
    late = np.where(columns["feasible"], columns["duration_s"], np.inf)
    # two standard errors more than is asked, for other draws will be others
    share = asked + 2.0 * standard_error(asked, late.size)
    end = float(np.quantile(late, share, method="higher")) if share < 1.0 else np.inf
    if site.deadline_s < end < np.inf:
        text = f"a deadline of {end:.1f} s ({end - site.deadline_s:.1f} s later)"
        found.append({"change": "within.deadline", "to": end, "unit": "s", "text": text})
    if (less := float(np.floor(1e3 * low) / 1e3)) > 0.0:
        text = f"with_probability: {100 * less:.1f} %"
        found.append({"change": "within.with_probability", "to": less, "unit": "", "text": text})
    return found
