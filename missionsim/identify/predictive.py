"""Least squares that predicts left-out runs: Gram matrices by fold, folds left out in turn, jackknife errors.

Where the base model is far from right, restricted maximum likelihood takes what is missing for slow noise: levels are
let go and coefficients follow differences. Plain least squares over time does not, and predicting whole left-out runs
tells honestly which effect helps, at which clock, and how sure the coefficients are (Stone 1974; cluster jackknife,
CRV3: Cameron, Gelbach and Miller 2008).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.align import CLOCK_STEPS, Clock, uphill
from missionsim.identify.data import Layout
from missionsim.identify.design import Design, Source
from missionsim.physics import Array, Bools, Ints

RIDGE = 1e-9
SHUFFLES = 499
"""Deals of levels among runs."""


@dataclass(frozen=True)
class Left:
    """Prediction of each fold from a fit to the others."""

    square: Array
    """Time integral of the squared power error of each fold [W2 s], shape (folds,)."""
    energy: Array
    """Predicted minus measured energy of each fold [J], shape (folds,)."""
    coefficients: Array
    """Relative shifts of the base, then shares, without each fold, shape (folds, q + chosen)."""

    @property
    def total(self) -> float:
        """Squared error of all folds together [W2 s]."""
        return float(self.square.sum())

    def by_chance(self, other: Left) -> float:
        """One-sided p-value, paired over folds, of no lower squared error than another; 1 where folds say nothing."""
        from scipy.special import stdtr

        ratio = np.log(np.maximum(self.square, 1e-300) / np.maximum(other.square, 1e-300))
        sd = float(np.std(ratio, ddof=1)) / np.sqrt(len(ratio)) if len(ratio) > 1 else 0.0
        return float(stdtr(len(ratio) - 1, float(ratio.mean()) / sd)) if sd > 0.0 else 1.0

    def within(self, other: Left, most: float) -> bool:
        """Whether it errs by no more than so many standard errors of the paired difference more than another."""
        behind = self.square - other.square
        return bool(behind.sum() <= most * float(np.std(behind, ddof=1)) * np.sqrt(len(behind)))


@dataclass(frozen=True)
class LeastSquares:
    """Sums of products by fold: least squares of any set of columns without looking at the rows again."""

    sums: Array
    """integrated over time, shape (folds, q + p + 3, q + p + 3) Rows are residual of the base, its gradient (q),
    candidate columns (p), one, measured power; each product."""
    seconds: Array
    """Length of each fold, shape (folds,)."""
    prior_sd: Array
    """Relative standard deviation of each base parameter, shape (q,)."""
    run: Ints
    """Number of the run of each fold, shape (folds,)."""

    @classmethod
    def of(cls, design: Design) -> LeastSquares:
        """Sums of a design; the folds are its runs, or stretches of them where there are few."""
        q = len(design.layout.parameters)
        rows = np.vstack([design.residual, design.gradient[:q], design.phi, np.ones_like(design.y), design.y])
        pieces = -(-const.FEWEST_FOLDS // len(design.runs)) if len(design.runs) < const.FEWEST_FOLDS - 2 else 1
        least = -(-const.FEWEST_FOLDS // (2 * len(design.runs)))

        @cache
        def products(start: int, stop: int) -> Array:
            part = slice(start, stop)
            return np.asarray((rows[:, part] * design.duration_s[part]) @ rows[:, part].T)

        shows = np.zeros(len(design.runs), dtype=bool)
        if pieces == 1 and len(design.phi) == len(design.layout.columns):  # of some columns it is not asked
            shows = shows_alone(design.layout, np.stack([products(run.start, run.stop) for run in design.runs]))
        folds: list[tuple[slice, int]] = []
        for number, run in enumerate(design.runs):
            length = float(design.duration_s[run].sum())
            count = max(least, min(const.STRETCHES if shows[number] else pieces, int(length // const.SHORTEST_FOLD_S)))
            edges = np.linspace(run.start, run.stop, count + 1).astype(int)
            folds += [(slice(int(a), int(b)), number) for a, b in itertools.pairwise(edges) if b > a]
        sums = np.stack([products(part.start, part.stop) for part, _ in folds])
        seconds = np.array([float(design.duration_s[part].sum()) for part, _ in folds])
        return cls(sums, seconds, design.layout.prior_sd[:q], np.array([run for _, run in folds], dtype=np.intp))

    @property
    def q(self) -> int:
        """Number of base parameters."""
        return len(self.prior_sd)

    @property
    def _enough_runs(self) -> bool:
        return int(self.run.max()) + 1 >= const.FEWEST_FOLDS - 2

    @property
    def by_run(self) -> bool:
        """Whether runs are the sample, not stretches of few."""
        return self._enough_runs or len(self.sums) == int(self.run.max()) + 1

    @cached_property
    def whole(self) -> Array:
        """Sums over all folds."""
        return np.asarray(self.sums.sum(axis=0))

    @cached_property
    def noise(self) -> float:
        """Mean squared error of the recalibrated base, which weighs its priors [W2]; half of it a refit."""
        index = np.arange(1, 1 + self.q)
        inner = self.whole[np.ix_(index, index)] + RIDGE * np.diag(np.diag(self.whole)[index])
        shift = np.linalg.lstsq(inner, self.whole[index, 0], rcond=1e-12)[0] if self.q else np.zeros(0)
        rest = float(self.whole[0, 0] - shift @ self.whole[index, 0])
        return max(rest, 1e-12 * float(self.whole[-1, -1])) / float(self.seconds.sum())

    def index(self, chosen: Sequence[int]) -> Ints:
        """Rows of the base parameters and of the chosen columns in the sums."""
        index: Ints = np.r_[1 : 1 + self.q, 1 + self.q + np.asarray(chosen, dtype=np.intp)].astype(np.intp)
        return index

    def _normal(self, sums: Array, index: Ints) -> tuple[Array, Array]:
        """Normal equations with the priors of the base, for one or several sums (..., m, m)."""
        inner = sums[..., index[:, None], index].copy()
        side = np.arange(len(index))
        inner[..., side, side] += RIDGE * np.maximum(np.diag(self.whole)[index], 1e-300)
        inner[..., side[: self.q], side[: self.q]] += self.noise * const.INDEPENDENT_S / self.prior_sd**2
        return inner, sums[..., index, 0]

    def _solved(self, inner: Array, side: Array) -> Array:
        """Solutions (..., m) of normal equations in which no base parameter changes its sign: an impossible curve of
        speed would stand in for what is missing. Of few runs, cut into stretches, some would hold and others not."""
        value = np.asarray(np.linalg.solve(inner, side[..., None])[..., 0])
        # one that takes power away may well turn: calibration without what is missing had bent it below nought
        least = np.where(self.whole[-2, 1 : 1 + self.q] < 0.0, -np.inf, -1.0)
        turned = np.any(value[:, : self.q] < least, axis=1) & self._enough_runs
        for i in np.flatnonzero(turned):
            gone = np.zeros(value.shape[1], dtype=bool)
            while np.any(value[i, : self.q] < least):
                gone[: self.q] |= value[i, : self.q] < least
                value[i, gone] = -1.0
                rest = np.linalg.solve(
                    inner[i][np.ix_(~gone, ~gone)], side[i, ~gone] + inner[i][~gone][:, gone].sum(axis=1)
                )
                value[i, ~gone] = rest
        return value

    def fit(self, chosen: Sequence[int], folds: Bools | None = None) -> Array:
        """Relative shifts of the base parameters, then shares of the chosen columns, shape (q + chosen,)."""
        sums = self.whole if folds is None else self.sums[folds].sum(axis=0)
        inner, side = self._normal(sums, self.index(chosen))
        return self._solved(inner[None], side[None])[0] if len(side) else np.zeros(0)

    def score(self, chosen: Sequence[int]) -> float:
        """Log-likelihood of a fit, up to a constant, with one independent observation every `INDEPENDENT_S`."""
        index = self.index(chosen)
        seconds = float(self.seconds.sum())
        square = self.errors(index, self.fit(chosen)).total
        return -0.5 * seconds / const.INDEPENDENT_S * float(np.log(max(square, 1e-300)))

    def leave_out(self, chosen: Sequence[int]) -> Left:
        """Each fold predicted from a fit to all others."""
        index = self.index(chosen)
        coefficients: Array = np.zeros((len(self.sums), len(index)))
        if len(self.sums) > 1 and len(index):
            inner, side = self._normal(self.whole - self.sums, index)
            coefficients = self._solved(inner, side)
        return self.errors(index, coefficients)

    def energy_left_out(self, chosen: Sequence[int], left: Left) -> Array:
        """Error of the energy of each fold [J] under the others' coefficients as they are written, shape (folds,).

        They give the energy of the fitted folds together (see `unbiased`): a bias that all runs share is not told.
        """
        index = self.index(chosen)
        if not len(index):
            return left.energy
        covariance = self.jackknife(chosen, left)[1]
        others = self.whole - self.sums
        ahead = others[:, index, -2]
        missing = others[:, 0, -2] - np.sum(left.coefficients * ahead, axis=1)
        step = ahead @ covariance
        size = np.maximum(np.sum(ahead * step, axis=1), 1e-300)
        return self.errors(index, left.coefficients + step * (missing / size)[:, None]).energy

    def energy_no_worse(
        self, few: Sequence[int], before: Left, more: Sequence[int], after: Left, slack: float = 0.0
    ) -> float:
        """One-sided p-value, over folds, of "more columns predict the energy of left-out folds as well as few", or
        worse by a part `slack` of it at most."""
        from scipy.special import stdtr

        count = len(self.sums)
        if count < const.SEVERAL_RUNS:
            return 1.0
        rise = np.abs(self.energy_left_out(more, after)) - np.abs(self.energy_left_out(few, before))
        rise -= slack * np.abs(self.sums[:, -2, -1])
        error = float(np.std(rise, ddof=1)) / np.sqrt(count)
        return float(stdtr(count - 1, -float(np.mean(rise)) / max(error, 1e-300)))

    def errors(self, index: Ints, coefficients: Array) -> Left:
        """Errors of each fold under given coefficients, shape (folds, m) or (m,)."""
        b = np.broadcast_to(coefficients, (len(self.sums), len(index)))
        inner = self.sums[:, index[:, None], index]
        cross = self.sums[:, index, 0]
        square = self.sums[:, 0, 0] - 2.0 * np.sum(b * cross, axis=1) + np.einsum("ji,jik,jk->j", b, inner, b)
        energy = np.sum(b * self.sums[:, index, -2], axis=1) - self.sums[:, 0, -2]
        return Left(np.maximum(square, 0.0), np.asarray(energy), np.array(b))

    def jackknife(self, chosen: Sequence[int], left: Left | None = None) -> tuple[Array, Array]:
        """Coefficients and their covariance from leaving folds out (CRV3), shapes (m,) and (m, m)."""
        left = left or self.leave_out(chosen)
        value = self.fit(chosen)
        count = len(self.sums)
        off = left.coefficients - value
        return value, (count - 1) / count * off.T @ off

    def shuffled(self, own: Sequence[int], beside: Sequence[int], level: float, draws: np.random.Generator) -> float:
        """p-value of levels that are constant in runs: how often they predict left-out runs as well once they are dealt
        out among the runs anew (Fisher 1935). It ends where `level` is out of reach; 1 where levels change in runs."""
        rows = self.index([*beside, *own])
        side = np.r_[0, rows, [-2, -1]]
        small = replace(self, sums=self.sums[:, side[:, None], side])
        chosen, first = range(len(rows) - self.q), 1 + len(rows) - len(own)
        by_run = np.stack([small.sums[self.run == i].sum(axis=0) for i in range(int(self.run.max()) + 1)])
        acts = np.diagonal(by_run, axis1=1, axis2=2)[:, first:-2] > 0.0
        if np.any(acts.sum(axis=1) > 1):
            return 1.0
        labelled = np.flatnonzero(acts.any(axis=1))
        levels = first + acts[labelled].argmax(axis=1)
        total, as_well, drawn = small.leave_out(chosen).total, 0, 0
        while drawn < SHUFFLES and as_well + 1 < level * (SHUFFLES + 1):
            place = np.tile(np.arange(len(side)), (len(self.sums), 1))
            for run, old, new in zip(labelled, levels, draws.permutation(levels), strict=True):
                place[np.ix_(self.run == run, [old, new])] = new, old
            other = np.take_along_axis(np.take_along_axis(small.sums, place[:, :, None], 1), place[:, None, :], 2)
            as_well += replace(small, sums=other).leave_out(chosen).total <= total
            drawn += 1
        return (as_well + 1) / (drawn + 1)

    def unbiased(self, chosen: Sequence[int], value: Array, covariance: Array) -> Array:
        """The coefficients nearest to `value`, in the metric of their covariance, that give the measured energy.

        The energy of all fitted runs together is one linear condition; what it takes is least where the data say least.
        """
        index = self.index(chosen)
        ahead = self.whole[index, -2]
        missing = float(self.whole[0, -2] - value @ ahead)
        base = np.arange(len(index)) < self.q
        for free in (np.ones(len(index), dtype=bool), base):
            step = np.where(free, covariance @ np.where(free, ahead, 0.0), 0.0)
            size = float(ahead @ step)
            moved = value + step * (missing / size) if size > 0.0 else value
            if np.all(moved[self.q :] * value[self.q :] >= 0.0):  # no effect may change its sign for it
                return moved
        return value


def shows_alone(layout: Layout, sums: Array) -> Bools:
    """Which runs tell two effects apart by what changes within them, more than all others together, shape (runs,); of
    their products as `LeastSquares` has them.

    A drive with and without the load on one floor is no draw of what runs are like: without it nothing is predicted.
    What changes within the others as well, as speed does, asks for no such drive.
    """
    effect = np.array([column.candidate for column in layout.columns], dtype=np.intp)
    known = 1 + len(layout.parameters)
    order = np.r_[-2, 1 : known + len(effect)]  # one, base, columns
    sums = sums[:, order[:, None], order]
    within, whole = (left_by_others(some, known) for some in (sums, sums.sum(axis=0)))
    total = np.diagonal(sums.sum(axis=0))[known:]
    changes = np.diagonal(within, axis1=1, axis2=2)
    here = (changes > (1.0 - const.BETWEEN_PART) * changes.sum(axis=0))[:, :, None]
    asked = (whole > const.TOLD_APART * total[:, None]) & (effect[:, None] != effect)
    return np.asarray(np.any(here & asked & (within > const.SHOWN_ALONE * whole), axis=(1, 2)))


def left_by_others(sums: Array, known: int) -> Array:
    """Squares of each column that `known` rows, which stand first, and one other column leave, and on the diagonal,
    that the known rows alone leave; of sums of products (..., known + columns, known + columns), shape (..., columns,
    columns)."""
    base, cross = sums[..., :known, :known], sums[..., :known, known:]
    gram = sums[..., known:, known:] - np.swapaxes(cross, -1, -2) @ np.linalg.pinv(base, hermitian=True) @ cross
    alone = np.diagonal(gram, axis1=-2, axis2=-1)
    varies = alone > 1e-9 * np.diagonal(sums, axis1=-2, axis2=-1)[..., known:]
    alone = np.where(varies, alone, 0.0)
    other, counts = (some[..., None, :] for some in (np.where(varies, alone, 1.0), varies))
    rest = alone[..., :, None] - np.where(counts, gram**2 / other, 0.0)
    every = np.arange(rest.shape[-1])
    rest[..., every, every] = alone
    return np.asarray(rest)


def far_from_right(source: Source) -> LeastSquares | None:
    """Least squares at clocks as logged where even the recalibrated base predicts most left-out runs so badly that its
    form is far from right; None elsewhere.

    A ramp or two that it does not know are no reason: one missing effect of few runs, or of few rows as a surge or a
    jolt is, is what the finer search is for.
    """
    design = source.design(Clock.as_logged(len(source.runs)))
    squares, mean_w = LeastSquares.of(design), abs(source.layout.mean_power_w)
    error = np.sqrt(squares.leave_out(()).square / squares.seconds)
    rows = np.abs(design.residual - squares.fit(()) @ design.gradient[: squares.q])
    often = np.average(rows > const.OFTEN * mean_w, weights=design.duration_s) > const.OFTEN_PART
    return squares if np.median(error) > const.ROUGH * mean_w and often else None


def sober_clock(source: Source, chosen: Sequence[int]) -> Clock:
    """Delay or lag of the meter, zero unless left-out runs are predicted better with it, most of them: a large gain in
    a few is no clock of the meter.

    Delay and lag together only where they predict better than the best of each alone: opposite ones are a filter
    that smooths the motion, not a meter.
    """
    still = Clock.as_logged(len(source.runs))
    reach = max(1.0, source.layout.step_s)

    @cache
    def rounded(delay: float, lag: float) -> Left:
        design = source.design(replace(still, delay_s=delay, lag_s=lag), chosen, timed=False)
        return LeastSquares.of(design).leave_out(range(len(chosen)))

    def left(place: tuple[float, float]) -> Left:
        return rounded(round(place[0], 3), round(place[1], 3))

    best = (0.0, 0.0)
    delays, lags = (np.arange(-0.8, 0.81, 0.2) * reach, np.arange(0.0, 1.01, 0.2) * reach)
    alone = [(float(d), 0.0) for d in delays] + [(0.0, float(t)) for t in lags]
    together = [(float(d), float(t)) for d in delays for t in lags]
    for points in (alone, together):
        top = min(points, key=lambda place: left(place).total)
        steps = [(1, 0), (-1, 0)] if points is together or top[1] == 0.0 else []
        steps += [(0, 1), (0, -1)] if points is together or top[1] != 0.0 else []
        finer = [(top[0] + i * 0.1 * reach, max(0.0, top[1] + j * 0.1 * reach)) for i, j in steps]
        top = min([top, *finer], key=lambda place: left(place).total)
        # a meter that lags is usual: where that leaves less than half of the squared error, a few folds may disagree
        lags_only = top[0] == 0.0 and left(top).total < const.HALVED * left(best).total
        level = const.HALVED_LEVEL if lags_only else const.DELAY_LEVEL
        if left(top).by_chance(left(best)) < level:
            best = top
    return still if best == (0.0, 0.0) else replace(still, delay_s=best[0], lag_s=best[1])


def least_squares_clock(source: Source, near: Clock, chosen: Sequence[int], earliest_s: float) -> Clock:
    """The clock near another at which left-out runs err least by least squares, which is how they are compared: between
    readings of a slow meter the likelihood hardly tells one from another. That other, the same in all runs, where the
    gain does not repeat over them; `earliest_s`: delay below which it is not looked for, unless it lies there.
    """
    least_s = min(near.delay_s, earliest_s)

    def at(delay_s: float, lag_s: float) -> Clock:
        return replace(near, delay_s=round(delay_s, 3), lag_s=round(lag_s, 3)).in_all(len(source.runs))

    @cache
    def left(delay_s: float, lag_s: float) -> Left:
        design = source.design(at(delay_s, lag_s), chosen, timed=False)
        return LeastSquares.of(design).leave_out(range(len(chosen)))

    def score(delay_s: float, lag_s: float) -> float:
        return -left(delay_s, lag_s).total if delay_s >= least_s else -np.inf

    was = (near.delay_s, near.lag_s)
    best = uphill(score, was, 1.0, CLOCK_STEPS, 4, 3)
    return at(*(best if left(*best).by_chance(left(*was)) < const.NEAR_LEVEL else was))
