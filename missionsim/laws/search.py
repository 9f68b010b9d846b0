"""Score every form of the grammar as the diagnosis scores its effects, and count all tries.

Products are formed at the analysis rate for the first pass, which only ranks; what is told comes from forms that are
evaluated at the raw rate and averaged like every other column.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from missionsim.identify.model import Model, log_likelihood
from missionsim.identify.noise import Noise
from missionsim.identify.proposed import CLOCKS, FAR_BETTER
from missionsim.identify.settings import SEVERAL_RUNS
from missionsim.laws.adapter import Ground, Rows32, Sieve
from missionsim.laws.gates import LEAST_RISE, LEAST_SHARE, LeftOut, left_out
from missionsim.laws.grammar import Grammar
from missionsim.physics import Array, Ints

MOST_ROWS = 6000
"""Longer data are averaged to about so many rows for the first pass."""
AT_ONCE = 16
SHORTLIST = 1500
SEEDS = 3
BENDS = 4
BENT = 6
"""Best forms whose numbers are varied, and how often."""
SHARPENED = 2
HALVINGS = 4
"""Best forms of different kinds whose numbers are looked for between those of the grammar, and how often a step is
halved."""
SHARPER = 0.95
"""Part of the error of left-out runs that other numbers leave at most: of so many, some are better by chance."""
EXACT = 40
ABSORBED = 0.93
NEARLY = 0.7
"""Forms below this part of the least share are not worth a fit. Without these two, `SAME`, `HELPS` and a least share of
its own, of 80 cases of tests/laws one lost its law, two got a wrong one, one a better, and `improve` took longer."""
SAME = 0.98
HELPS = 0.995
HARDLY_WORSE = 1.03
"""At a glance a law lowers the error of left-out runs to this part at least (with a noise of its own it must do far
better, see `missionsim.laws.gates`), and misses the best by no more than this."""
NEEDED_ERROR = 1.02
"""A law without one of its quantities must predict left-out runs so much worse, or that quantity goes."""
REPEATS = 1.5
"""The same must repeat: mean of the logarithm of each run's error, in standard errors, where runs are several."""
CLOSE_ERROR = 1.005
"""Of two forms whose left-out errors come this close, likelihood decides."""


@dataclass(frozen=True)
class Scored:
    """A form with what speaks for it at one noise: rise of the log-likelihood [nats], share of energy, and the score,
    which is the rise less the logarithm of the number of forms of that size."""

    form: tuple[int, ...]
    gain: float
    share: float
    score: float


@dataclass(frozen=True)
class Fitted:
    """A form in the model with noise of its own; its column is the last."""

    form: tuple[int, ...]
    model: Model
    watts: Array
    """Power for a coefficient of 1 at the analysis rate. Shape (n,)."""
    rise: float
    """Of the log evidence against the model without it, noise fitted on both sides."""
    penalty: float
    """For all tries of its size."""

    @property
    def column(self) -> int:
        """Number of the law's column."""
        return len(self.model.chosen) - 1

    @property
    def share(self) -> float:
        """Share of energy."""
        return float(self.model.gram.shares(self.model.chosen)[-1])

    @cached_property
    def errors(self) -> LeftOut:
        """Errors of runs left out one at a time."""
        return left_out(self.model)


@dataclass(frozen=True)
class Searched:
    """What the search found: the best form and all that come near it, at the noise of the best."""

    best: Fitted
    near: tuple[Scored, ...]


class Search:
    """All forms of a grammar on one ground."""

    def __init__(self, ground: Ground, grammar: Grammar, memory: bool = False) -> None:
        self.ground, self.grammar, self.memory = ground, grammar, memory
        # what a single run says of a product of three, or of two beside a base far off, is a guess about others
        runs, near = len(ground.design.runs), ground.model.squares is None
        self.by_size = grammar.forms(memory)[: runs + near if runs <= SEVERAL_RUNS else None]
        self.penalties = [math.log(max(len(forms), 1)) for forms in self.by_size]
        rows = len(ground.design.y)
        self.every = max(1, math.ceil(rows / MOST_ROWS))
        # first row of each group of `every` rows; groups end with their stretch
        parts = [np.arange(part.start, part.stop, self.every) for part in ground.design.stretches]
        self.groups = np.concatenate(parts).astype(np.intp)
        self._averaged: dict[tuple[int, ...], Array] = {}

    @property
    def tried(self) -> int:
        """Number of forms."""
        return sum(len(forms) for forms in self.by_size)

    @cached_property
    def rows(self) -> Array:
        """Factors of the first pass at the analysis rate, shape (factors, n), of mean size 1; the others are 0."""
        first = [i for i, factor in enumerate(self.grammar.factors) if not factor.fine]
        rows = self.ground.averaged(self.grammar.products([[i] for i in first]))
        out = np.zeros((len(self.grammar.factors), rows.shape[1]))
        out[first] = rows / np.maximum(np.mean(np.abs(rows), axis=1, keepdims=True), 1e-300)
        return out

    def penalty(self, form: Sequence[int]) -> float:
        """Nats for all tries of a form's size."""
        return self.penalties[len(form) - 1]

    def screen(self, noise: Noise, among: Sequence[Ints] | None = None) -> list[Scored]:
        """Forms with the sign that physics asks for, best score first; `among` holds some forms of each size."""
        sieve = Sieve(self.ground, noise, self.groups, self.every)
        factors = sieve.coarse(self.rows)
        back = np.array([f.gives_back for f in self.grammar.factors])
        mean_power = self.ground.mean_power_w
        found: list[Scored] = []
        for forms, penalty in zip(among or self.by_size, self.penalties, strict=True):

            def rows_of(some: slice, part: slice, forms: Ints = forms) -> Rows32:
                own = factors[:, part]
                x = own[forms[some, 0]]
                for column in range(1, forms.shape[1]):
                    x *= own[forms[some, column]]
                return x

            level, score, information, absorbed = sieve(len(forms), rows_of)
            usable = (information > 0.0) & (absorbed < ABSORBED) & (level > 0.0)
            usable &= (score > 0.0) | back[forms].any(axis=1)
            information = np.where(information > 0.0, information, 1.0)
            gain = 0.5 * score**2 / information
            share = score / information * level / mean_power
            worth = usable & (gain > penalty) & (np.abs(share) > NEARLY * LEAST_SHARE)
            for i in np.flatnonzero(worth):
                form = tuple(int(f) for f in forms[i])
                found.append(Scored(form, float(gain[i]), float(share[i]), float(gain[i]) - penalty))
        return sorted(found, key=lambda one: -one.score)

    def watts(self, form: Sequence[int]) -> Array:
        """Power of a form for a coefficient of 1, evaluated at the raw rate, shape (n,)."""
        return np.asarray(self.columns([form])[0])

    def on_time(self, fitted: Fitted) -> Search:
        """The same search at the clock that a law asks for; itself where that is hardly better."""
        ground = self.ground.on_time(self.grammar.products([fitted.form]), fitted.model)
        return self if ground is self.ground else Search(ground, self.grammar, self.memory)

    def columns(self, forms: Sequence[Sequence[int]]) -> Array:
        """The same of several forms, shape (forms, n)."""
        missing = [form for form in dict.fromkeys(tuple(form) for form in forms) if form not in self._averaged]
        for begin in range(0, len(missing), AT_ONCE):
            some = missing[begin : begin + AT_ONCE]
            self._averaged.update(zip(some, self.ground.averaged(self.grammar.products(some)), strict=True))
        return np.array([self._averaged[tuple(form)] for form in forms])

    def fit(self, form: tuple[int, ...], start: Noise | None = None, beside: Sequence[Fitted] = ()) -> Fitted:
        """A form in the model, with noise of its own; the fit of its size begins where that of another form ended."""
        watts = self.watts(form)
        model = self.ground.with_law(watts, start, beside[0].model.noise if beside else None)
        return Fitted(form, model, watts, log_likelihood(model) - self.without, self.penalty(form))

    def settled(self, fitted: Fitted) -> Fitted:
        """The fit whose noise predicts left-out runs better: its own, one that begins where the null ended, or where
        both fail, the usual (rows as long as the clock's lag blur what is switched, and an offset of each run that is
        fitted hides a level that all of them share)."""
        null = self.ground.model
        other = self.fit(fitted.form, null.noise)
        better = other if other.errors.with_law < fitted.errors.with_law else fitted
        if self.ground.model.squares is None:
            model = self.ground.at_noise(self.ground.extended(fitted.watts), self.ground.usual())
            usual = replace(better, model=model)
            better = usual if usual.errors.with_law < FAR_BETTER * better.errors.with_law else better
        # a fit of noise ends where it began to climb: with and without the law, the best of all of them
        own = [fitted.model.noise, other.model.noise, null.noise]
        own += [replace(null.noise, gain=n.gain, motion_gain=n.motion_gain) for n in own[:2]]
        extended = self.ground.extended(fitted.watts)
        rise = max(log_likelihood(self.ground.at_noise(extended, noise)) for noise in own)
        return replace(better, rise=rise - max(log_likelihood(replace(null, noise=noise)) for noise in own))

    @cached_property
    def without(self) -> float:
        """Log evidence of the model without a law."""
        return log_likelihood(self.ground.model)

    def best(self) -> Searched | None:
        """The best form and those near it; None where no form is worth a fit."""
        if not self.grammar.factors:
            return None
        usual = self.screen(self.ground.usual())
        if not usual:
            return None
        listed = self.sized([one.form for one in usual[:SHORTLIST]])
        null = self.screen(self.ground.plain(self.ground.model.noise), listed)
        seeds = self._apart(usual[: 10 * SEEDS])[:SEEDS] + self._apart(null[: 10 * SEEDS])[:SEEDS]
        fits: list[Fitted] = []
        for form in self._promising(dict.fromkeys(one.form for one in seeds)):
            fits.append(self.fit(form, beside=fits))
        if not fits:
            return None
        # noise that is fitted with each form is no common ground; how left-out runs are predicted is
        top = min(fits, key=lambda f: f.errors.with_law)
        near = self.near(top, listed)
        if near and near[0].form != top.form:
            other = next((f for f in fits if f.form == near[0].form), None) or self.fit(near[0].form, top.model.noise)
            if other.errors.with_law < CLOSE_ERROR * top.errors.with_law:
                top = other
                near = self.near(top, listed)
        plain = self._plainest(top)
        if plain is not top:
            needless = self._variables(top.form) - self._variables(plain.form)
            has = np.array([factor.variable in needless for factor in self.grammar.factors])
            top, listed = plain, [forms[~has[forms].any(axis=1)] for forms in listed]
            near = self.near(top, listed)
        return Searched(top, tuple(near)) if near else None

    def sharpened(self, done: Searched) -> tuple[Search, Searched]:
        """The same with numbers between those of the grammar, where left-out runs are predicted clearly better so and
        the likelihood rises too; and the search that knows those numbers."""
        top = done.best
        finer, halved = self._halved(top, done.near)
        fits = [finer.fit(form, top.model.noise) for form in halved]
        fits = [fit for fit in fits if fit.rise > top.rise and fit.errors.with_law < SHARPER * top.errors.with_law]
        if not fits:
            return finer, done
        best = min(fits, key=lambda fit: fit.errors.with_law)
        near = tuple(finer._exactly(best, [*(one.form for one in done.near), *(fit.form for fit in fits)]))
        return finer, Searched(best, near) if near else done

    def _halved(self, top: Fitted, near: Sequence[Scored]) -> tuple[Search, list[tuple[int, ...]]]:
        """The best forms of different kinds with the numbers at which left-out runs err least, found by halving the way
        to their neighbours; and the search that knows those numbers."""
        finer = copy(self)
        finer._averaged = dict(self._averaged)
        # a quantity more was found needless, or would have led
        told = self._variables(top.form)
        unlike = [form for form in self._unlike(one.form for one in near) if self._variables(form) <= told]

        @cache
        def error(form: tuple[int, ...]) -> float:
            return left_out(self.ground.at_noise(self.ground.extended(finer.watts(form)), top.model.noise)).with_law

        found = []
        others = [self._coarsely(forms, error) for forms in self.grammar.unscreened(top.form)]
        # a step is worse than a ramp until its threshold is met, and at a noise that took the steps for its own
        finer.grammar, splits = self.grammar.splits(top.form)
        others += [one[0].form for forms in splits if (one := finer._exactly(top, forms, self.ground.usual()))]
        for form in (*unlike[:SHARPENED], *others):
            best = form
            for _ in range(HALVINGS):
                finer.grammar, more = finer.grammar.halfway(best)
                best = min([best, *more], key=error)
            if best != top.form:
                found.append(best)
        return finer, found

    @staticmethod
    def _coarsely(forms: Sequence[tuple[int, ...]], error: Callable[[tuple[int, ...]], float]) -> tuple[int, ...]:
        """The best of forms in the order of their numbers: of every few, then of those beside it."""
        step = max(1, round(math.sqrt(len(forms) / 2)))
        at = min(range(0, len(forms), step), key=lambda i: error(forms[i]))
        return min(forms[max(0, at - step + 1) : at + step], key=error)

    def _unlike(self, forms: Iterable[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """The first of those that differ in no more than a threshold or a time constant."""
        unlike: dict[tuple[Any, ...], tuple[int, ...]] = {}
        for form in forms:
            factors = [self.grammar.factors[i] for i in form]
            unlike.setdefault(tuple((f.kind, *f.numbers[1:]) if f.kind else (f.text,) for f in factors), form)
        return [*unlike.values()]

    def _variables(self, form: Sequence[int]) -> set[str]:
        return {self.grammar.factors[i].variable for i in form}

    def _plainest(self, top: Fitted) -> Fitted:
        """A law without the quantities that left-out runs hardly need, the most needless gone first.

        A slow wander looks like a clock within the pieces of a run, and a quantity that hardly varies, or that another
        of them follows, multiplies a law for nothing.
        """
        best, far = top, self.ground.model.squares is not None
        while True:
            plainer = []
            for name in sorted(self._variables(best.form)):
                form = tuple(i for i in best.form if self.grammar.factors[i].variable != name)
                if not form:
                    continue
                fit = self.fit(self._bent(form, top), top.model.noise)
                # what wanders raises the likelihood of a clock, and all that is missing that of any quantity
                trusted = not far and name not in CLOCKS
                needed = trusted and top.rise - top.penalty > fit.rise - fit.penalty + LEAST_RISE
                as_good = fit.errors.with_law < NEEDED_ERROR * top.errors.with_law
                if not far and not as_good and len(top.errors.by_run) > SEVERAL_RUNS:
                    # of eight runs a few are better by chance; what every run needs is needed, though one needs it
                    # most: a payload is constant in runs
                    worse = np.subtract(*(np.log(np.maximum(one.errors.by_run, 1e-300)) for one in (fit, top)))
                    repeats = float(np.mean(worse)) >= REPEATS * float(np.std(worse, ddof=1)) / math.sqrt(len(worse))
                    as_good = not repeats and bool(np.any(worse <= 0.0))
                if not needed and as_good:
                    plainer.append(fit)
            if not plainer:
                return best
            best = min(plainer, key=lambda fit: fit.errors.with_law)

    def _bent(self, form: tuple[int, ...], top: Fitted) -> tuple[int, ...]:
        """A part of a law with the numbers that suit it best, which those of the whole law need not be."""
        near = self._exactly(top, [form, *self.grammar.bent(form)])
        return next((one.form for one in near if one.form != top.form), form)

    def _promising(self, forms: Iterable[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """Forms that are worth a noise of their own: those that predict left-out runs, at noise that is at hand, better
        than no law and hardly worse than the best of them."""
        forms = list(forms)
        if self.ground.model.squares is not None or len(self.ground.design.runs) < 2:
            return forms
        noises = (self.ground.usual(), self.ground.plain(self.ground.model.noise))
        designs = [self.ground.extended(watts) for watts in self.columns(forms)]
        errors = [[left_out(self.ground.at_noise(design, noise)) for noise in noises] for design in designs]
        ratio = [min(one.with_law / one.without for one in own) for own in errors]
        best = [min(one.with_law for one in own) for own in errors]
        limit = HARDLY_WORSE * min(best, default=0.0)
        return [f for f, r, b in zip(forms, ratio, best, strict=True) if r < HELPS and b <= limit]

    def sized(self, forms: Sequence[tuple[int, ...]]) -> list[Ints]:
        sizes = range(1, len(self.by_size) + 1)
        return [np.array([f for f in forms if len(f) == size], dtype=np.intp).reshape(-1, size) for size in sizes]

    def _apart(self, ranked: Sequence[Scored]) -> list[Scored]:
        """Forms that do not look like a better one."""
        kept: list[Scored] = []
        rows: list[Array] = []
        for one in ranked:
            x = np.prod(self.rows[list(one.form)], axis=0)
            x = (x - x.mean()) / max(float(np.linalg.norm(x - x.mean())), 1e-300)
            if all(abs(float(x @ other)) < SAME for other in rows):
                kept.append(one)
                rows.append(x)
        return kept

    def near(self, top: Fitted, listed: Sequence[Ints]) -> list[Scored]:
        """Best forms at the noise of one of them, evaluated exactly; best score first."""
        ranked = [one.form for one in self.screen(top.model.noise, listed)[:EXACT]]
        for _ in range(BENDS):
            known = self._exactly(top, ranked)
            ranked = [one.form for one in known]
            # the best, and the best of those that differ in more than a threshold or a time constant
            some = dict.fromkeys([*ranked[:BENT], *self._unlike(ranked)[:BENT]])
            more = [form for one in some for form in self.grammar.bent(one)]
            if set(more) <= set(ranked):
                break
            ranked += more
        return self._exactly(top, ranked)

    def _exactly(self, top: Fitted, some: Sequence[tuple[int, ...]], noise: Noise | None = None) -> list[Scored]:
        forms = list(dict.fromkeys([top.form, *some]))
        x = self.columns(forms)
        level = np.mean(np.abs(x), axis=1)
        rows = np.arange(len(self.ground.design.y))
        exact = Sieve(self.ground, noise or top.model.noise, rows, 1)
        unit = (x / np.where(level > 0.0, level, 1.0)[:, None]).astype(np.float32)
        _, score, information, absorbed = exact(len(forms), lambda some, part: unit[some, part].copy())
        gain = 0.5 * score**2 / np.maximum(information, 1e-300)
        share = score / np.maximum(information, 1e-300) / self.ground.mean_power_w
        found = [
            Scored(form, float(g), float(s), float(g) - self.penalty(form))
            for form, g, s, part in zip(forms, gain, share, absorbed, strict=True)
            if (s > 0.0 or any(self.grammar.factors[i].gives_back for i in form))
            and (part < ABSORBED or form == top.form)
        ]
        return sorted(found, key=lambda one: -one.score)
