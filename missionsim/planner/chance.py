"""Plans that hold with a probability: margins on reserve and deadline until enough of fresh draws hold."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.files import write_text
from missionsim.planner.answer import Answer
from missionsim.planner.tour import Site
from missionsim.planner.write import mission_text
from missionsim.uncertainty.answers import proportion_interval
from missionsim.uncertainty.batch import Task, compute_block, prepare

RUNS = 4096
TRIES = 6
SEED = 20_260_101


def draws_of(answer: Answer, seed: int, runs: int = RUNS) -> dict[str, NDArray[Any]]:
    """Columns of many runs of a plan's mission, each with values drawn."""
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "mission.yaml"
        write_text(path, mission_text(answer, path))
        task = Task(str(path), answer.site.task.elsewhere, None, seed, "auto")
        if prepare(task).arrays is None:
            runs = min(runs, 200)  # one by one: a minute and more for what arrays do in a second
        return compute_block(task, 0, runs)


def holds(site: Site, columns: dict[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Which runs are feasible and within the deadline."""
    late = columns["duration_s"] > site.deadline_s * (1.0 + 1e-9)
    return np.asarray(columns["feasible"], dtype=bool) & ~late


def told(site: Site, columns: dict[str, NDArray[Any]]) -> dict[str, float]:
    """Share of the runs that hold, with its 95 % interval."""
    good = holds(site, columns)
    low, high = proportion_interval(int(good.sum()), good.size)
    return {"value": float(good.mean()), "low": low, "high": high, "runs": int(good.size)}


def with_probability(site: Site, asked: float, solve: Callable[[Site], Answer]) -> Answer:
    """The plan of least objective that still holds in so many of fresh draws, by margins that grow until it does.

    Parameters
    ----------
    site : Site
    asked : float
        Probability.
    solve : callable
        Site → its plan.

    Returns
    -------
    Answer
        With ``probability`` (of draws that the margins were not made from) and ``margins`` in `extra`.
    """
    physics = site.physics
    kept = physics.reserve_wh
    margin = np.zeros(len(kept))
    ahead = 0.0
    answer = Answer(site, False)
    try:
        for attempt in range(TRIES):
            physics.reserve_wh = kept + margin
            found = solve(replace(site, deadline_s=site.deadline_s - ahead))
            if not found.feasible:
                notes = [f"no plan holds in {100 * asked:g} % of the draws: with the margins for it there is none"]
                if answer.feasible:
                    notes.append(f"the plan without them holds in {100 * answer.extra['probability']['value']:.2f} %")
                return Answer(site, False, notes=notes, extra={"probability": answer.extra.get("probability")})
            answer = replace(found, site=site)
            physics.reserve_wh = kept
            columns = draws_of(answer, SEED + 2 * attempt)
            check = told(site, columns)
            if check["value"] >= asked:
                check = told(site, draws_of(answer, SEED + 2 * attempt + 1))
            answer.extra["probability"] = check | {"asked": asked}
            answer.extra["margins"] = {
                "reserve_wh": dict(zip(physics.names, margin.tolist(), strict=True)),
                "deadline_s": ahead,
            }
            if check["value"] >= asked:
                return answer
            # each limit is to hold often enough, and all of them together
            share = 1.0 - (1.0 - asked) / (2.0 if attempt == 0 else 2.0 + attempt)
            for b, name in enumerate(physics.names):
                short = -np.asarray(columns[f"margin_{name}_wh"], dtype=float)
                margin[b] += max(0.0, float(np.nanquantile(short, share)))
            if math.isfinite(site.deadline_s):
                ahead += max(0.0, float(np.nanquantile(columns["duration_s"], share)) - site.deadline_s)
    finally:
        physics.reserve_wh = kept
    best = answer.extra["probability"]["value"]
    return Answer(
        site,
        False,
        notes=[f"the surest plan found holds in {100 * best:.2f} % of the draws, {100 * asked:g} % are asked"],
        extra=dict(answer.extra),
    )
