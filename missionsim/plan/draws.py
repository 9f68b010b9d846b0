"""Numbers of a plan: a float, or an array with one number a run where many runs are planned at once.

The planner is written for floats and typed so: arrays take the same arithmetic. What follows is all that differs.
"""

from __future__ import annotations

import math
from itertools import repeat
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


def least(first: float, second: float) -> float:
    """The smaller of two numbers, run by run."""
    if isinstance(second, float):
        if isinstance(first, float):
            return min(first, second)
        return first if second == math.inf or first.max() <= second else np.minimum(first, second)
    return second if isinstance(first, float) and first == math.inf else np.minimum(first, second)


def remainder(angle: float) -> float:
    """An angle [rad] brought between -π and π, halves to even turns (IEEE 754)."""
    if isinstance(angle, float):
        return math.remainder(angle, 2.0 * math.pi)
    return angle - 2.0 * math.pi * np.round(angle / (2.0 * math.pi))


def sign(number: float) -> float:
    """1 or -1."""
    return math.copysign(1.0, number) if isinstance(number, float) else np.copysign(1.0, number)


def spread(value: T, count: int) -> list[T] | None:
    """What a part of a plan of `count` runs is in each of them; None where it is the same in all."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.shape == (count,) else None
    if isinstance(value, dict):
        inside = spread(tuple(value.values()), count)
        return None if inside is None else cast("list[T]", [dict(zip(value, values, strict=True)) for values in inside])
    if not isinstance(value, tuple) or isinstance(value, str):
        return None
    columns = [spread(item, count) for item in value]
    if all(column is None for column in columns):
        return None
    rows = zip(*(repeat(v, count) if c is None else c for v, c in zip(value, columns, strict=True)), strict=True)
    make = getattr(value, "_make", None)
    return list(rows if make is None else map(make, rows))


class Odd:
    """Runs whose plan has another shape than that of most: each is to be planned alone.

    A plan of many runs is one list of legs. Where a number decides whether there is a leg at all (a dwell of nought, a
    turn of nought), or whether there is a plan (a speed of nought), the runs that go against the others are marked.
    """

    def __init__(self) -> None:
        self.runs: NDArray[np.bool_] | None = None

    def most(self, decision: bool | NDArray[np.bool_]) -> bool:
        """What most runs decide; the others are odd."""
        if not isinstance(decision, np.ndarray):
            return bool(decision)
        answer = bool(2 * np.count_nonzero(decision) >= decision.size)
        self.mark(decision != answer)
        return answer

    def mark(self, runs: NDArray[np.bool_]) -> None:
        """These are odd."""
        self.runs = runs if self.runs is None else self.runs | runs
