"""Everything the search needs, from Gram matrices of whitened columns (Woodbury and Schur complements).

Gains of sets of columns with their signs respected, projections, random effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from missionsim.identify.data import Constraints
from missionsim.identify.design import Design
from missionsim.identify.noise import Noise, Packed, Shape
from missionsim.identify.settings import MOST_TRIPLES, SHARE_PRIOR
from missionsim.physics import Array, Ints

RANDOM_COUNT = 5
CLOCK_IN_GRADIENT = (-4, -3)
"""Rows of the gradient that are the last random effects as well: first and second derivative after the delay."""


@dataclass(frozen=True)
class Blocks:
    """Rows, gradient, chosen columns and random effects of a design, to be whitened with any shape of the noise.

    ``index`` says which of the packed rows stands for each of these: the clock's two random effects are nuisances of
    the base model as well, and are whitened once.
    """

    rows: Packed
    index: Ints

    @classmethod
    def of(cls, design: Design, noise: Noise, rows: Array, chosen: Sequence[int]) -> Blocks:
        """Prepare rows (k, n) in front of everything else; the noise gives scale and weights."""
        own = design.random[: -len(CLOCK_IN_GRADIENT)]
        stack = np.vstack([rows, design.gradient, design.phi[list(chosen)], own])
        q = len(design.gradient)
        index = np.append(np.arange(len(stack)), [len(rows) + q + at for at in CLOCK_IN_GRADIENT])
        return cls(Packed.of(stack, noise.scale, noise.weight, design.stretches, design.runs), index)

    def at(self, shape: Shape) -> Array:
        """Gram matrix of each run for innovations of unit variance, shape (runs, k, k)."""
        blocks = self.rows.blocks(shape)
        return blocks[:, self.index[:, None], self.index]


def eliminate_random(blocks: Array, random_sd: Array) -> tuple[Array, Array]:
    """Integrate out the last five rows (random effects) of each run's Gram matrix.

    Of one noise or several: blocks (..., runs, k, k), random_sd (..., 5). Gives the reduced matrices
    (..., runs, k-5, k-5) and log det(I + D Z'Z) of each run.
    """
    r = RANDOM_COUNT
    # a random effect of no size is none, and must not divide by nothing
    sd = np.maximum(random_sd, 1e-12)[..., None, :]
    scaled = blocks[..., -r:, :] * sd[..., None]
    factor = np.linalg.cholesky(scaled[..., -r:] * sd[..., None, :] + np.eye(r))
    half = np.linalg.solve(factor, scaled[..., :-r])
    log_det = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return blocks[..., :-r, :-r] - half.swapaxes(-1, -2) @ half, log_det


@dataclass(frozen=True)
class Gram:
    """Reduced Gram matrices: [y, N (q), Phi (p)] of each run, random effects integrated out."""

    per_run: Array
    """Shape (runs, 1+q+p, 1+q+p)."""
    prior_precision: Array
    """Of the base parameters' relative shifts, shape (q,)."""

    @property
    def q(self) -> int:
        """Number of base parameters."""
        return len(self.prior_precision)

    @cached_property
    def full(self) -> Array:
        """[y, Phi] from all runs, base parameters integrated out under their prior, shape (1+p, 1+p)."""
        total, q = self.per_run.sum(axis=0), self.q
        inner = total[1 : 1 + q, 1 : 1 + q] + np.diag(self.prior_precision)
        keep = np.r_[0, 1 + q : total.shape[0]]
        cross = total[np.ix_(keep, np.arange(1, 1 + q))]
        return np.asarray(total[np.ix_(keep, keep)] - cross @ np.linalg.solve(inner, cross.T))

    def _normal(self, chosen: Sequence[int], precision: float) -> tuple[Array, Ints, Array, Array]:
        """All runs together, rows of base and chosen columns, their prior precisions, and their normal matrix."""
        total = self.per_run.sum(axis=0)
        index = np.r_[np.arange(1, 1 + self.q), 1 + self.q + np.asarray(chosen, dtype=int)].astype(np.intp)
        priors = np.concatenate([self.prior_precision, np.full(len(chosen), precision)])
        return total, index, priors, total[np.ix_(index, index)] + np.diag(priors)

    def evidence(self, chosen: Sequence[int]) -> float:
        """Log evidence of a set of columns (up to a constant of the data), with priors on all coefficients."""
        total, index, precision, inner = self._normal(chosen, SHARE_PRIOR)
        try:
            factor = np.linalg.cholesky(inner)
        except np.linalg.LinAlgError:  # rounding alone: the data are exact, and no noise is small enough for them
            return -np.inf
        half = np.linalg.solve(factor, total[index, 0])
        det = 2 * np.log(np.diag(factor)).sum() - np.log(precision).sum()
        return float(-0.5 * (total[0, 0] - half @ half) - 0.5 * det)

    def gain(self, chosen: Sequence[int]) -> float:
        """Rise of the log-likelihood when the chosen columns enter (sign ignored)."""
        if not len(chosen):
            return 0.0
        index, inner = self._inner(chosen)
        b = self.full[index, 0]
        return float(0.5 * b @ np.linalg.solve(inner, b))

    def coefficients(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Shares of the chosen columns and their covariance (model-based)."""
        return self.shares(chosen), np.asarray(np.linalg.inv(self._inner(chosen)[1]))

    def shares(self, chosen: Sequence[int]) -> Array:
        """Shares of the chosen columns alone."""
        index, inner = self._inner(chosen)
        return np.asarray(np.linalg.solve(inner, self.full[index, 0]))

    def joint(self, chosen: Sequence[int], count: int) -> tuple[Array, Array]:
        """Relative shifts of the first `count` base parameters, then shares, and their posterior covariance."""
        total, index, _, inner = self._normal(chosen, 1e-9)
        keep = np.r_[np.arange(count), np.arange(self.q, len(index))].astype(int)
        try:
            covariance = np.linalg.inv(inner)
        except np.linalg.LinAlgError:  # a column that in these runs is the base's own: a hair of ridge
            inner = inner + np.diag(1e-9 * np.diag(inner))
            covariance = np.linalg.inv(inner)
        value = np.linalg.solve(inner, total[index, 0])
        return np.asarray(value[keep]), np.asarray(covariance[np.ix_(keep, keep)])

    def conditional(self, chosen: Sequence[int]) -> Array:
        """[y, Phi] after the chosen columns are projected out as well, shape (1+p, 1+p)."""
        if not len(chosen):
            return self.full
        index, inner = self._inner(chosen)
        cross = self.full[:, index]
        return np.asarray(self.full - cross @ np.linalg.solve(inner, cross.T))

    def _inner(self, chosen: Sequence[int]) -> tuple[Ints, Array]:
        """Rows of some columns and their matrix, with a hair of ridge, so that exact twins give a finite answer."""
        index = 1 + np.asarray(chosen, dtype=np.intp)
        out = self.full[np.ix_(index, index)]
        diagonal = np.diag_indices_from(out)
        out[diagonal] *= 1 + 1e-9
        out[diagonal] += 1e-9
        return index, out


def reduced(design: Design, noise: Noise, chosen: Sequence[int]) -> tuple[Gram, float]:
    """Gram matrices of some columns under a noise model, and log det(I + D Z'Z) of the random effects of all runs."""
    blocks = Blocks.of(design, noise, design.residual[None, :], chosen).at(noise.shape) / noise.sigma_w**2
    left, log_det = eliminate_random(blocks, noise.random_sd())
    return Gram(left, design.layout.prior_sd**-2.0), float(log_det.sum())


def make_gram(design: Design, noise: Noise) -> Gram:
    """Gram matrices of the whole design under a noise model."""
    return reduced(design, noise, range(len(design.phi)))[0]


def project(design: Design, noise: Noise, rows: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
    """What penalised regression on base parameters, random effects and chosen columns leaves of rows (k, n), whitened;
    and the rows of the priors (known variance), shape (k, q + runs * 5)."""
    k = rows.shape[0]
    q, s = len(design.layout.prior_sd), len(chosen)
    prepared = Blocks.of(design, noise, rows, chosen)
    white = prepared.rows.white(noise.shape)[prepared.index] / noise.sigma_w
    blocks = np.stack([white[:, part] @ white[:, part].T for part in design.runs])
    sd = np.maximum(noise.random_sd(), 1e-12)
    reduced, _ = eliminate_random(blocks, sd)
    total = reduced.sum(axis=0)
    inner = total[k : k + q + s, k : k + q + s].copy()
    precision = np.concatenate([design.layout.prior_sd**-2.0, np.full(s, 1e-9)])
    inner[np.diag_indices(q + s)] += precision
    fixed = np.linalg.solve(inner, total[k : k + q + s, :k]) if q + s else np.zeros((0, k))
    out = white[:k] - fixed.T @ white[k : k + q + s]
    # Gram matrices of the random effects with what is left of the rows
    left = blocks[:, -RANDOM_COUNT:, :k] - blocks[:, -RANDOM_COUNT:, k : k + q + s] @ fixed
    random = np.linalg.solve(blocks[:, -RANDOM_COUNT:, -RANDOM_COUNT:] + np.diag(sd**-2.0), left)
    for part, u in zip(design.runs, random, strict=True):
        out[:, part] -= u.T @ white[k + q + s :, part]
    pseudo = [-(fixed[:q].T / design.layout.prior_sd)] if q else []
    pseudo.append(-(random / sd[:, None]).transpose(2, 0, 1).reshape(k, -1))
    return out, np.hstack(pseudo)


def innovations(design: Design, noise: Noise, chosen: Sequence[int]) -> Array:
    """Whitened residual with the chosen columns in, shape (n,); unit variance if the noise model is right."""
    return np.asarray(project(design, noise, design.residual[None, :], chosen)[0][0])


def random_effects(design: Design, noise: Noise, chosen: Sequence[int]) -> Array:
    """Most probable meter offset, gain, motion gain, clock and lag deviation of each run, shape (runs, 5)."""
    p = project(design, noise, design.residual[None, :], chosen)[1][0]
    q = len(design.layout.prior_sd)
    sd = np.maximum(noise.random_sd(), 1e-12)
    return np.asarray(-p[q:].reshape(len(design.runs), RANDOM_COUNT) * sd)


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
            every = [*chosen, k]
            kept = np.all(constraints.sign[every] * gram.shares(every) >= 0)
            gain[k] = gain[k] if kept else -np.inf
    return gain


def set_gains(gram: Gram, constraints: Constraints, sets: Ints) -> Array:
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


def all_sets(constraints: Constraints, size: int, base: Sequence[int] = ()) -> Ints:
    """All allowed sets of up to three columns; beyond that, sets that differ from `base` in one column."""
    p = len(constraints.sign)
    # beyond triples all sets would take seconds, and swaps of one column reach most of them
    if size <= 2 or (size == 3 and p**3 / 6 < MOST_TRIPLES):
        every = combinations(range(p), size)
        sets = [c for c in every if all(constraints.compatible(k, c[:i]) for i, k in enumerate(c))]
    else:
        sets = []
        for out in range(len(base)):
            kept = [b for i, b in enumerate(base) if i != out]
            sets += [(*kept, k) for k in range(p) if constraints.compatible(k, kept)]
    return np.asarray(sets, dtype=np.intp).reshape(-1, size)


def best_set(gram: Gram, constraints: Constraints, size: int, base: Sequence[int]) -> tuple[int, ...]:
    """Best allowed set of a size."""
    sets = all_sets(constraints, size, base)
    return tuple(int(k) for k in sets[int(np.argmax(set_gains(gram, constraints, sets)))]) if len(sets) else tuple(base)
