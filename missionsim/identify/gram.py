"""Everything the search needs, from Gram matrices of whitened columns (Woodbury and Schur complements)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Array
from missionsim.identify.design import Design
from missionsim.identify.noise import Noise, whiten

RANDOM_COUNT = 5
SHARE_PRIOR = 4.0
"""Precision of the weak prior on a candidate's share of energy (sd 50 %): keeps runs without the effect harmless."""


def raw_blocks(design: Design, noise: Noise, rows: Array) -> tuple[Array, Array]:
    """Whitened Gram matrix of each run, shape (runs, k, k), and the whitened rows (k, n)."""
    white = whiten(design, noise, rows)
    return np.stack([white[:, part] @ white[:, part].T for part in design.runs]), white


def eliminate_random(blocks: Array, random_sd: Array) -> tuple[Array, Array]:
    """Integrate out the last five rows (random effects) of each run's Gram matrix.

    Returns the reduced matrices (runs, k-5, k-5) and log det(I + D Z'Z) of each run.
    """
    r = RANDOM_COUNT
    sd = np.maximum(random_sd, 1e-12)
    cross = blocks[:, :-r, -r:] * sd
    inner = blocks[:, -r:, -r:] * sd[:, None] * sd + np.eye(r)
    factor = np.linalg.cholesky(inner)
    half = np.linalg.solve(factor, np.swapaxes(cross, 1, 2))
    reduced = blocks[:, :-r, :-r] - np.swapaxes(half, 1, 2) @ half
    return reduced, 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)


@dataclass(frozen=True)
class Gram:
    """Reduced Gram matrices: [y, N (q), Phi (p)] of each run, random effects integrated out.

    Attributes
    ----------
    per_run : shape (runs, 1+q+p, 1+q+p)
    prior_precision : of the base parameters' relative shifts, shape (q,)
    """

    per_run: Array
    prior_precision: Array

    @property
    def q(self) -> int:
        """Number of base parameters."""
        return len(self.prior_precision)

    @property
    def p(self) -> int:
        """Number of candidate columns."""
        return int(self.per_run.shape[1]) - 1 - self.q

    def eliminated(self, total: Array) -> Array:
        """[y, Phi] after the base parameters are integrated out under their prior, shape (1+p, 1+p)."""
        q = self.q
        inner = total[1 : 1 + q, 1 : 1 + q] + np.diag(self.prior_precision)
        keep = np.r_[0, 1 + q : total.shape[0]]
        cross = total[np.ix_(keep, np.arange(1, 1 + q))]
        return np.asarray(total[np.ix_(keep, keep)] - cross @ np.linalg.solve(inner, cross.T))

    @cached_property
    def full(self) -> Array:
        """[y, Phi] from all runs, shape (1+p, 1+p)."""
        return self.eliminated(self.per_run.sum(axis=0))

    def evidence(self, chosen: Sequence[int], runs: NDArray[np.bool_] | None = None) -> float:
        """Log evidence of a set of columns (up to a constant of the data), with priors on all coefficients."""
        total = self.per_run.sum(axis=0) if runs is None else self.per_run[runs].sum(axis=0)
        q = self.q
        index = np.r_[np.arange(1, 1 + q), 1 + q + np.asarray(chosen, dtype=int)].astype(int)
        precision = np.concatenate([self.prior_precision, np.full(len(chosen), SHARE_PRIOR)])
        inner = total[np.ix_(index, index)] + np.diag(precision)
        factor = np.linalg.cholesky(inner)
        half = np.linalg.solve(factor, total[index, 0])
        det = 2 * np.log(np.diag(factor)).sum() - np.log(precision).sum()
        return float(-0.5 * (total[0, 0] - half @ half) - 0.5 * det)

    def gain(self, chosen: Sequence[int]) -> float:
        """Rise of the log-likelihood when the chosen columns enter (sign ignored)."""
        if not len(chosen):
            return 0.0
        index = 1 + np.asarray(chosen, dtype=int)
        b = self.full[index, 0]
        return float(0.5 * b @ np.linalg.solve(_steady(self.full[np.ix_(index, index)]), b))

    def coefficients(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Shares of the chosen columns and their covariance (model-based)."""
        index = 1 + np.asarray(chosen, dtype=int)
        inner = _steady(self.full[np.ix_(index, index)])
        return np.asarray(np.linalg.solve(inner, self.full[index, 0])), np.asarray(np.linalg.inv(inner))

    def shifts(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Relative shifts of the base parameters and their posterior covariance, with the chosen columns in."""
        total = self.per_run.sum(axis=0)
        q = self.q
        index = np.r_[np.arange(1, 1 + q), 1 + q + np.asarray(chosen, dtype=int)].astype(int)
        precision = np.concatenate([self.prior_precision, np.full(len(chosen), 1e-9)])
        inner = total[np.ix_(index, index)] + np.diag(precision)
        return np.linalg.solve(inner, total[index, 0])[:q], np.linalg.inv(inner)[:q, :q]

    def conditional(self, chosen: Sequence[int]) -> Array:
        """[y, Phi] after the chosen columns are projected out as well, shape (1+p, 1+p)."""
        if not len(chosen):
            return self.full
        index = 1 + np.asarray(chosen, dtype=int)
        cross = self.full[:, index]
        return np.asarray(self.full - cross @ np.linalg.solve(_steady(self.full[np.ix_(index, index)]), cross.T))

    def correlation(self, a: int, b: int, chosen: Sequence[int]) -> float:
        """Correlation of two columns after the other chosen ones are projected out, from -1 to 1."""
        left = self.conditional([k for k in chosen if k not in (a, b)])
        return float(left[1 + a, 1 + b] / np.sqrt(left[1 + a, 1 + a] * left[1 + b, 1 + b]))


def _steady(matrix: Array) -> Array:
    """A hair of ridge, so that exact twins give a finite answer."""
    out = matrix.copy()
    out[np.diag_indices_from(out)] *= 1 + 1e-9
    out[np.diag_indices_from(out)] += 1e-9
    return out


def make_gram(design: Design, noise: Noise) -> Gram:
    """Gram matrices of the whole design under a noise model."""
    rows = np.vstack([design.residual, design.gradient, design.phi, design.random])
    blocks, _ = raw_blocks(design, noise, rows)
    reduced, _ = eliminate_random(blocks, noise.random_sd())
    return Gram(reduced, design.layout.prior_sd**-2.0)


@dataclass(frozen=True)
class Projection:
    """Whitened rows with base parameters, random effects and chosen columns projected out.

    Attributes
    ----------
    rows : shape (k, n)
    pseudo : rows of the priors (known variance), shape (k, q + runs * 5)
    """

    rows: Array
    pseudo: Array


def project(design: Design, noise: Noise, rows: Array, chosen: Sequence[int]) -> Projection:
    """Residual of each row (k, n) after penalised regression on everything but the rows themselves."""
    k = rows.shape[0]
    q, s = len(design.layout.prior_sd), len(chosen)
    stack = np.vstack([rows, design.gradient, design.phi[list(chosen)], design.random])
    blocks, white = raw_blocks(design, noise, stack)
    sd = np.maximum(noise.random_sd(), 1e-12)
    reduced, _ = eliminate_random(blocks, sd)
    total = reduced.sum(axis=0)
    inner = total[k : k + q + s, k : k + q + s].copy()
    precision = np.concatenate([design.layout.prior_sd**-2.0, np.full(s, 1e-9)])
    inner[np.diag_indices(q + s)] += precision
    fixed = np.linalg.solve(inner, total[k : k + q + s, :k]) if q + s else np.zeros((0, k))
    out = white[:k] - fixed.T @ white[k : k + q + s]
    pseudo = [-(fixed[:q].T / design.layout.prior_sd)] if q else []
    for j, part in enumerate(design.runs):
        z = white[k + q + s :, part]
        lhs = blocks[j, -RANDOM_COUNT:, -RANDOM_COUNT:] + np.diag(sd**-2.0)
        u = np.linalg.solve(lhs, z @ out[:, part].T)
        out[:, part] -= u.T @ z
        pseudo.append(-(u.T / sd))
    return Projection(out, np.hstack(pseudo))


def innovations(design: Design, noise: Noise, chosen: Sequence[int]) -> Array:
    """Whitened residual with the chosen columns in, shape (n,); unit variance if the noise model is right."""
    return np.asarray(project(design, noise, design.residual[None, :], chosen).rows[0])


def random_effects(design: Design, noise: Noise, chosen: Sequence[int]) -> Array:
    """Most probable meter offset, gain, motion gain, clock and lag deviation of each run, shape (runs, 5)."""
    p = project(design, noise, design.residual[None, :], chosen).pseudo[0]
    q = len(design.layout.prior_sd)
    sd = np.maximum(noise.random_sd(), 1e-12)
    return np.asarray(-p[q:].reshape(len(design.runs), RANDOM_COUNT) * sd)
