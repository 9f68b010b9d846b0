"""What the search for a law needs of an identification, in one place: rows, noise, what is already explained, gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Covariates
from missionsim.identify import noise as noises
from missionsim.identify.align import CLOCK_STEPS, uphill
from missionsim.identify.data import Column
from missionsim.identify.design import Design
from missionsim.identify.identification import Identification
from missionsim.identify.model import Model, log_likelihood, spread
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.reml import fit_noise
from missionsim.physics import Array, Ints

Rows32 = NDArray[np.float32]
CHUNK = 256
BLOCK = 60
"""Rows that are whitened by one product of matrices."""
LAGS_S = (0.0, 0.3, 0.6)
DELAYS_S = (-0.4, -0.2, 0.0, 0.2, 0.4)
CLOCK_NATS = 15.0
"""Rise of the log-likelihood from which on a law moves the clock of meter and motion."""


@dataclass(frozen=True)
class Ground:
    """The model that a law would be added to."""

    model: Model
    """With the effects that were found, and nothing that is in doubt."""
    covariates: tuple[Mapping[str, Any], ...]
    """Of each run of the model, at its raw rate."""
    held: tuple[tuple[str, tuple[int, ...]], ...]
    """Effects found and their columns."""

    @property
    def design(self) -> Design:
        """Rows of all runs at the analysis rate."""
        return self.model.design

    @property
    def chosen(self) -> tuple[int, ...]:
        """Columns of the effects found."""
        return self.model.chosen

    @property
    def mean_power_w(self) -> float:
        """Mean measured power."""
        return self.design.layout.mean_power_w

    def without(self, effects: Sequence[str]) -> Ground:
        """The ground without some of the effects found."""
        held = tuple((name, own) for name, own in self.held if name not in effects)
        inside = tuple(k for k in self.chosen if any(k in own for _, own in held))
        return replace(self, model=_refitted(self.model, self.design, inside, self.model.noise), held=held)

    def sizes(self, model: Model) -> dict[str, float]:
        """Part of the energy of each effect found, in a model of their columns with or without a law, which is last."""
        share = dict(zip(self.chosen, model.gram.shares(model.chosen).tolist(), strict=False))
        return {name: abs(sum(share[k] for k in columns)) for name, columns in self.held}

    def plain(self, noise: noises.Noise) -> noises.Noise:
        """A noise whose weights were not read off the residual: where an unknown law acts, rows look like outliers."""
        return noises.for_rows(self.design, noise)

    def usual(self) -> noises.Noise:
        """Noise as meters and drives usually have it, whatever this residual looks like."""
        return noises.start_noise(self.design)

    def averaged(self, raw: Sequence[Array]) -> Array:
        """Columns (k, rows) of each run at the raw rate as rows of the design, shape (k, n)."""
        return self.model.source.averaged(raw, self.model.clock)

    def with_law(self, watts: Array, start: noises.Noise | None = None, other: noises.Noise | None = None) -> Model:
        """The model with one more column (power for a coefficient of 1, averaged, shape (n,)) and noise of its own.

        The fit begins at usual noise, or at that of a like law: where the null took the law for noise, and its rows for
        outliers, it would stay there. Beside an `other` law it has about the size
        that it has here.
        """
        design = self.extended(watts)
        chosen = tuple(range(len(design.phi)))
        guess = start if start is not None or other is None else self.plain(other)
        return _refitted(self.model, design, chosen, guess, thorough=start is None)

    def at_noise(self, design: Design, noise: noises.Noise) -> Model:
        """An extended design as a model at a noise that was not fitted with it."""
        return Model(self.model.source, tuple(range(len(design.phi))), self.model.clock, design, noise)

    def on_time(self, raw: Sequence[Array], fitted: Model) -> Ground:
        """The ground at the clock that the law asks for; itself where that is hardly better.

        Without the law its own lag could not be seen. `raw`: power of the law in each run at the raw rate, (1, rows).
        """
        source, was = self.model.source, self.model.clock

        @cache
        def score(delay_s: float, lag_s: float) -> float:
            clock = replace(was, delay_s=delay_s, lag_s=lag_s)
            design, columns = source.design(clock, self.chosen), tuple(range(len(self.chosen)))
            there = replace(self, model=replace(self.model, clock=clock, design=design, chosen=columns))
            design = there.extended(source.averaged(raw, clock)[0])
            return log_likelihood(replace(fitted, clock=clock, design=design, squares=None))

        if not source.aligned:
            return self
        first = score(was.delay_s, was.lag_s)
        around = [(was.delay_s + delay, lag) for lag in LAGS_S for delay in DELAYS_S]
        best = max(((was.delay_s, was.lag_s), *around), key=lambda place: score(*place))
        best = uphill(score, best, 1.0, CLOCK_STEPS, 4, 4)
        if score(*best) < first + CLOCK_NATS:
            return self
        clock = replace(was, delay_s=best[0], lag_s=best[1])
        model = _refitted(self.model, source.design(clock), self.chosen, self.model.noise)
        return replace(self, model=replace(model, clock=clock))

    def extended(self, watts: Array) -> Design:
        """The design with the columns of the effects found and the law, in shares of energy; the law comes last, one
        column or several, shape (n,) or (k, n)."""
        layout, rows = self.design.layout, np.atleast_2d(watts)
        means = np.average(np.abs(rows), axis=1, weights=self.design.duration_s)
        columns = (
            *(layout.columns[k] for k in self.chosen),
            *(Column(-1, i, "law", float(m)) for i, m in enumerate(means)),
        )
        share = (layout.mean_power_w / np.maximum(means, 1e-300))[:, None]
        phi = np.vstack([self.design.phi[list(self.chosen)], rows * share])
        return replace(self.design, layout=replace(layout, columns=columns), phi=phi)


def _refitted(
    model: Model, design: Design, chosen: tuple[int, ...], guess: noises.Noise | None, thorough: bool = False
) -> Model:
    """The model with other columns and noise of its own, which stays bounded where the base is far from right."""
    if model.squares is None:
        noise = fit_noise(design, chosen, guess, thorough=thorough)
        return replace(model, chosen=chosen, design=design, noise=noise)
    squares = model.squares if design is model.design else LeastSquares.of(design)
    noise = noises.bounded_noise(design, squares, chosen)
    return replace(model, chosen=chosen, design=design, noise=noise, squares=squares)


def ground_of(found: Identification, covariates: Sequence[Covariates]) -> Ground:
    """The ground of an identification: effects that it names stay in, those that it puts in doubt do not.

    `covariates`: of every run that was given to it, at the raw rate.
    """
    model = found.choice.model
    columns = model.design.layout.columns
    names = [e.effect for e in found.effects]
    held = tuple(
        (name, tuple(k for k in model.chosen if found.library[columns[k].candidate].effect == name)) for name in names
    )
    inside = tuple(k for k in model.chosen if any(k in own for _, own in held))
    model = spread(model)
    if inside != model.chosen:
        model = _refitted(model, model.design, inside, model.noise)
    return Ground(model, tuple(covariates[i] for i in model.source.kept), held)


class Sieve:
    """Gains of many rows at once under one noise: everything but the rows themselves is whitened a single time."""

    def __init__(self, ground: Ground, noise: noises.Noise, group: Sequence[int] | Ints, every: int) -> None:
        design = ground.design
        q, chosen = len(design.gradient), list(ground.chosen)
        self.every, self.starts = every, np.asarray(group)
        self.counts = np.diff(np.append(self.starts, len(design.y))).astype(float)
        self.stretches, self.runs = (
            [slice(*np.searchsorted(self.starts, [part.start, part.stop]).tolist()) for part in parts]
            for parts in (design.stretches, design.runs)
        )
        self.shape = (noise.step_s * every, *noise.shape[1:])
        weight = np.add.reduceat(noise.weight, self.starts) / self.counts
        level = np.add.reduceat(noise.scale, self.starts) / self.counts
        self.root = np.sqrt(weight).astype(np.float32)
        # means of several rows scatter less, as far as the noise is white or fast
        self.unscale = (noises.arma_of(*self.shape)[2] / (level * noise.total_sd_w)).astype(np.float32)
        rows = np.vstack([design.residual[None, :], design.gradient, design.phi[chosen], design.random])
        # factor of the start and its diagonal (see `start_factor`), ratio of `arma_of`, answer of the filter to a unit
        # in each of `BLOCK` + 1 rows, and to one in the two rows and two innovations before them, the older first
        inverse, diagonal, _ = noises.start_factor(*self.shape)
        matrix = noises.block_filter(self.shape, BLOCK + 1)[:, : BLOCK + 1]
        answer, ratio = matrix[: BLOCK + 1], noises.arma_of(*self.shape)[2]
        past = np.eye(4)
        echo = noises.states_after(self.shape, past[:, :2], past[:, 2:]) @ matrix[BLOCK + 1 :]
        self.filter = tuple(np.asarray(x, dtype=np.float32) for x in (inverse, diagonal, ratio, answer, echo))
        known = self.coarse(rows)
        self.known: Array = np.empty(known.shape)
        for part in self.stretches:
            self.known[:, part] = self.white(known[:, part], part)
        sd = np.maximum(noise.random_sd(), 1e-12)
        self.fixed = 1 + q + len(chosen)
        total = np.zeros((self.fixed, self.fixed))
        self.without: list[tuple[Array, Array]] = []
        for part in self.runs:
            gram = self.known[:, part] @ self.known[:, part].T
            inner = np.eye(len(sd)) + sd[:, None] * gram[self.fixed :, self.fixed :] * sd
            middle = sd[:, None] * np.linalg.solve(inner, np.diag(sd))
            cross = middle @ gram[self.fixed :, : self.fixed]
            total += gram[: self.fixed, : self.fixed] - gram[: self.fixed, self.fixed :] @ cross
            self.without.append((middle, cross))
        precision = np.concatenate([design.layout.prior_sd**-2.0, np.full(len(chosen), 1e-9)])
        inside = total[1:, 1:] + np.diag(precision)
        self.solved = np.linalg.solve(inside, np.column_stack([total[1:, 0]]))[:, 0]
        self.inverse = np.linalg.inv(inside)
        # what the base explains within the prior standard deviations of a recalibration is no law
        freer = ground.model.constraints.settings.recalibration_limit
        self.free = np.linalg.inv(total[1:, 1:] + np.diag(precision / freer**2))

    def coarse(self, rows: Array) -> Rows32:
        """Rows (k, n) averaged to the coarser grid."""
        if self.every == 1:
            return rows.astype(np.float32)
        return np.asarray(np.add.reduceat(rows, self.starts, axis=1) / self.counts, dtype=np.float32)

    def white(self, rows: Rows32, part: slice) -> Rows32:
        """Whitened rows (k, n of the stretch) of unit variance; `rows` are overwritten.

        The recursive filter (`missionsim.identify.noise`) as products of matrices, `BLOCK` rows at a time.
        """
        inverse, diagonal, ratio, answer, echo = self.filter
        rows *= self.unscale[part]
        out = np.empty_like(rows)
        length = rows.shape[1]
        end = min(noises.START_ROWS, length)
        head = rows[:, :end] @ inverse[:end, :end].T
        np.divide(head, ratio, out=out[:, :end])
        last = head[:, -2:] * diagonal[-2:]
        while end < length:
            past = np.hstack([rows[:, end - 2 : end], last])
            begin, end = end, length if length - end <= BLOCK + 1 else end + BLOCK
            some = rows[:, begin:end] @ answer[: end - begin, : end - begin]
            some += past @ echo[:, : end - begin]
            out[:, begin:end] = some
            last = some[:, -2:]
        out *= self.root[part]
        return out

    def __call__(self, count: int, rows_of: Callable[[slice, slice], Rows32]) -> tuple[Array, Array, Array, Array]:
        """Mean size, score, information and the part that a free base absorbs, of each of `count` rows in W, shape
        (count,); `rows_of` gives some of them over a stretch, as a new array.

        One stretch after the other, and some of the rows at a time, so that they stay in the processor's cache.
        """
        level, size, cross = np.zeros(count), np.zeros(count), np.zeros((count, self.fixed))
        for run, (middle, fixed) in zip(self.runs, self.without, strict=True):
            both = np.zeros((count, len(self.known)))
            for part in self.stretches:
                if not run.start <= part.start < run.stop:
                    continue
                known = np.ascontiguousarray(self.known[:, part].T, dtype=np.float32)
                for begin in range(0, count, CHUNK):
                    some = slice(begin, min(begin + CHUNK, count))
                    rows = rows_of(some, part)
                    level[some] += np.abs(rows).sum(axis=1)
                    white = self.white(rows, part)
                    size[some] += np.einsum("ij,ij->i", white, white)
                    both[some] += white @ known
            random = both[:, self.fixed :]
            size -= np.sum((random @ middle) * random, axis=1)
            cross += both[:, : self.fixed] - random @ fixed
        others = cross[:, 1:]
        score = cross[:, 0] - others @ self.solved
        information = size - np.sum((others @ self.inverse) * others, axis=1)
        absorbed = np.sum((others @ self.free) * others, axis=1) / np.maximum(size, 1e-300)
        return level / max(self.known.shape[1], 1), score, information, absorbed
