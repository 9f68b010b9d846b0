"""Moments and exact order statistics of a column that is read part by part, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Parts = Callable[[], Iterable[Array]]
"""Gives the column from its beginning, part by part, as often as asked."""
IN_MEMORY = 1_000_000
_BINS = 1 << 14


@dataclass
class Moments:
    """Count, mean, sum of squared deviations and range of the finite numbers of a column."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    low: float = math.inf
    high: float = -math.inf

    def add(self, values: Array) -> None:
        """Add a part (Chan, Golub and LeVeque 1979)."""
        values = values[np.isfinite(values)]
        if not len(values):
            return
        mean, count = float(values.mean()), len(values)
        change, total = mean - self.mean, self.count + count
        self.squares += float(np.square(values - mean).sum()) + change * change * self.count * count / total
        self.mean += change * count / total
        self.count = total
        self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))

    @property
    def sd(self) -> float:
        """Standard deviation of the sample."""
        return math.sqrt(self.squares / (self.count - 1)) if self.low < self.high else 0.0


def moments(parts: Parts) -> Moments:
    """Moments of a column."""
    found = Moments()
    for part in parts():
        found.add(part)
    return found


def order_statistics(
    parts: Parts, ranks: Sequence[int], known: Moments, in_memory: int = IN_MEMORY
) -> dict[int, float]:
    """The finite numbers of a column that stand at some ranks, exactly.

    Parameters
    ----------
    parts : callable
    ranks : sequence of int
        From 0 for the smallest.
    known : Moments
        Of the column.
    in_memory : int
        So many numbers are sorted at once; where there are more, classes are counted first and only those that hold a
        rank are looked into.

    Returns
    -------
    dict
        Rank → number.
    """
    return _select(parts, sorted(set(ranks)), 0, known.count, known.low, known.high, in_memory)


def _select(
    parts: Parts, ranks: list[int], before: int, count: int, low: float, high: float, in_memory: int
) -> dict[int, float]:
    """Ranks among the `count` numbers in [low, high], of which `before` are smaller."""
    if not ranks:
        return {}
    if low == high:
        return dict.fromkeys(ranks, low)
    if count <= in_memory:
        chosen = np.concatenate([part[(part >= low) & (part <= high)] for part in parts()])
        found = np.partition(chosen, [rank - before for rank in ranks])
        return {rank: float(found[rank - before]) for rank in ranks}
    edges = np.linspace(low, high, _BINS + 1)[1:-1]

    def sorted_parts() -> Iterator[tuple[Array, NDArray[np.intp]]]:
        """Each part in order, and where in it each class begins and ends."""
        for part in parts():
            chosen = np.sort(part[(part >= low) & (part <= high)])
            yield chosen, np.concatenate([[0], np.searchsorted(chosen, edges), [len(chosen)]])

    counts = np.zeros(_BINS, dtype=np.int64)
    # the range of the numbers in each class, so that the search ends with numbers that are all the same
    lowest, highest = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    for chosen, cuts in sorted_parts():
        sizes = np.diff(cuts)
        counts += sizes
        some = np.flatnonzero(sizes)
        lowest[some] = np.minimum(lowest[some], chosen[cuts[some]])
        highest[some] = np.maximum(highest[some], chosen[cuts[some + 1] - 1])
    reached = before + np.cumsum(counts)
    wanted: dict[int, list[int]] = {}
    for rank, bin_ in zip(ranks, np.searchsorted(reached, ranks, side="right").tolist(), strict=True):
        wanted.setdefault(bin_, []).append(rank)
    result: dict[int, float] = {}
    room = in_memory
    pieces: dict[int, list[Array]] = {}
    for bin_, inside in wanted.items():
        size, first = int(counts[bin_]), int(reached[bin_] - counts[bin_])
        if lowest[bin_] == highest[bin_]:
            result |= dict.fromkeys(inside, float(lowest[bin_]))
        elif size <= room:
            room -= size
            pieces[bin_] = []
        else:
            result |= _select(parts, inside, first, size, float(lowest[bin_]), float(highest[bin_]), in_memory)
    if pieces:
        for chosen, cuts in sorted_parts():
            for bin_, kept in pieces.items():
                kept.append(chosen[cuts[bin_] : cuts[bin_ + 1]].copy())
    for bin_, kept in pieces.items():
        found = np.sort(np.concatenate(kept))
        first = int(reached[bin_] - counts[bin_])
        result |= {rank: float(found[rank - first]) for rank in wanted[bin_]}
    return result
