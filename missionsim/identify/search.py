"""Which set of candidate columns explains the residual best, signs respected (step 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array, Candidate, Layout
from missionsim.identify.gram import Gram
from missionsim.identify.settings import MOST_TRIPLES


@dataclass(frozen=True)
class Constraints:
    """What a set of columns must obey: signs, and one column of a grid at a time.

    ``sign`` (p,) and ``effect`` (p,) by column; ``joint`` (p,) is True for levels of one label, which may be in
    together.
    """

    sign: NDArray[np.intp]
    effect: NDArray[np.intp]
    joint: NDArray[np.bool_]

    @classmethod
    def of(cls, layout: Layout, candidates: Sequence[Candidate]) -> Constraints:
        """Constraints of the columns of a layout."""
        own = [candidates[c.candidate] for c in layout.columns]
        return cls(
            np.array([c.sign if c.prior is None or c.sign else 1 for c in own], dtype=np.intp),
            np.array([c.candidate for c in layout.columns], dtype=np.intp),
            np.array([bool(c.levels) for c in own]),
        )

    @cached_property
    def grid_nats(self) -> Array:
        """Nats that each column owes to its grid of shapes: a grid is one effect, not several, shape (p,)."""
        return np.where(self.joint, 0.0, np.log(np.bincount(self.effect)[self.effect]))

    def compatible(self, column: int, chosen: Iterable[int]) -> bool:
        """Whether a column may join a set."""
        for other in chosen:
            if other == column:
                return False
            if self.effect[other] == self.effect[column] and not self.joint[column]:
                return False
        return True

    def signs_hold(self, chosen: Sequence[int], coefficients: Array) -> bool:
        """Whether every coefficient has the sign that physics asks for."""
        return bool(np.all(self.sign[list(chosen)] * coefficients >= 0))


def single_gains(gram: Gram, constraints: Constraints, chosen: Sequence[int]) -> Array:
    """Log-likelihood gain of each column beyond the chosen ones; -inf where signs or grids forbid, shape (p,)."""
    rest = gram.conditional(chosen)
    b, info = rest[0, 1:], np.maximum(np.diag(rest)[1:], 0.0)
    # what base parameters imitate exactly leaves rounding, which would gain anything
    floor = 1e-8 * np.maximum(np.diag(gram.full)[1:], 1e-300)
    usable = info > floor
    gain = np.where(usable, 0.5 * b * b / np.where(usable, info, 1.0), 0.0)
    gain = np.where(constraints.sign * b < 0, -np.inf, gain)
    for k in range(len(gain)):
        if not constraints.compatible(k, chosen):
            gain[k] = -np.inf
        elif len(chosen) and np.isfinite(gain[k]):
            # a new column may turn the sign of one that is in
            values, _ = gram.coefficients([*chosen, k])
            if not constraints.signs_hold([*chosen, k], values):
                gain[k] = -np.inf
    return gain


def set_gains(gram: Gram, constraints: Constraints, sets: NDArray[np.intp]) -> Array:
    """Gain of many sets of one size, shape (sets,); sign-infeasible ones get -inf.

    The best sign-feasible unconstrained set is the non-negative least squares optimum, because each face of the
    constraint is itself a set.
    """
    index = sets + 1
    blocks = gram.full[index[:, :, None], index[:, None, :]].copy()
    diagonal = np.arange(sets.shape[1])
    # twins in one set: a hair of ridge keeps the answer finite
    blocks[:, diagonal, diagonal] *= 1 + 1e-9
    blocks[:, diagonal, diagonal] += 1e-9
    b = gram.full[index, 0]
    x = np.linalg.solve(blocks, b[:, :, None])[:, :, 0]
    gain = 0.5 * np.sum(b * x, axis=1)
    return np.where(np.all(constraints.sign[sets] * x >= 0, axis=1), gain, -np.inf)


def all_sets(constraints: Constraints, size: int, base: Sequence[int] = ()) -> NDArray[np.intp]:
    """All allowed sets of up to three columns; beyond that, sets that differ from `base` in one column."""
    p = len(constraints.sign)
    # beyond triples all sets would take seconds, and swaps of one column reach most of them
    if size <= 2 or (size == 3 and p**3 / 6 < MOST_TRIPLES):
        sets = [c for c in combinations(range(p), size) if _allowed(constraints, c)]
    else:
        sets = []
        for out in range(len(base)):
            kept = [b for i, b in enumerate(base) if i != out]
            sets += [(*kept, k) for k in range(p) if constraints.compatible(k, kept)]
    return np.asarray(sets, dtype=np.intp).reshape(-1, size)


def _allowed(constraints: Constraints, columns: Sequence[int]) -> bool:
    return all(constraints.compatible(c, columns[:i]) for i, c in enumerate(columns))


def best_set(gram: Gram, constraints: Constraints, size: int, base: Sequence[int]) -> tuple[tuple[int, ...], float]:
    """Best allowed set of a size and its gain."""
    sets = all_sets(constraints, size, base)
    if not len(sets):
        return tuple(base), -np.inf
    gains = set_gains(gram, constraints, sets)
    top = int(np.argmax(gains))
    return tuple(int(k) for k in sets[top]), float(gains[top])
