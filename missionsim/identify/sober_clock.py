"""The clock of the meter by the prediction of left-out runs: zero unless it is clearly better."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify.align import Clock
from missionsim.identify.design import Source
from missionsim.identify.predictive import LeastSquares, Left
from missionsim.identify.settings import ADVANCE_LEVEL, CLOCK_FALL, DELAY_LEVEL


def sober_clock(source: Source, chosen: Sequence[int]) -> Clock:
    """Delay or lag of the meter, zero unless left-out runs are predicted better with it, clearly and in most of them.

    Delay and lag together only where they predict better than the best of each alone: opposite ones are a filter
    that smooths the motion, not a meter.
    """
    still = Clock(0.0, 0.0, tuple(0.0 for _ in source.runs))
    reach = max(1.0, source.layout.step_s)
    known: dict[tuple[float, float], Left] = {}

    def left(delay: float, lag: float) -> Left:
        key = (round(delay, 3), round(lag, 3))
        if key not in known:
            design = source.design(replace(still, delay_s=key[0], lag_s=key[1]), chosen)
            known[key] = LeastSquares.of(design).leave_out(range(len(chosen)))
        return known[key]

    best = (0.0, 0.0)
    delays, lags = (np.arange(-0.8, 0.81, 0.2) * reach, np.arange(0.0, 1.01, 0.2) * reach)
    alone = [(float(d), 0.0) for d in delays] + [(0.0, float(t)) for t in lags]
    together = [(float(d), float(t)) for d in delays for t in lags]
    for points in (alone, together):
        top = _finer(left, min(points, key=lambda p: left(*p).total), 0.1 * reach, points is together)
        if _clearly_better(left(*top), left(*best), ADVANCE_LEVEL if top[0] < min(best[0], 0.0) else DELAY_LEVEL):
            best = top
    return still if best == (0.0, 0.0) else replace(still, delay_s=best[0], lag_s=best[1])


def _finer(
    left: Callable[[float, float], Left], point: tuple[float, float], width: float, both: bool
) -> tuple[float, float]:
    steps = (
        [(1, 0), (-1, 0), (0, 1), (0, -1)] if both else ([(1, 0), (-1, 0)] if point[1] == 0.0 else [(0, 1), (0, -1)])
    )
    around = [(point[0] + i * width, max(0.0, point[1] + j * width)) for i, j in steps]
    return min([point, *around], key=lambda p: left(*p).total)


def _clearly_better(new: Left, old: Left, level: float) -> bool:
    from scipy.stats import t

    ratio = np.log(np.maximum(new.square, 1e-300) / np.maximum(old.square, 1e-300))
    count = len(ratio)
    if count < 2 or new.total > (1.0 - CLOCK_FALL) * old.total:
        return False
    sd = float(np.std(ratio, ddof=1)) / np.sqrt(count)
    return float(t.cdf(float(ratio.mean()) / max(sd, 1e-300), count - 1)) < level
