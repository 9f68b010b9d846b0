"""Forward selection by the prediction of left-out runs, for logs whose base model is far from right.

There the mixed noise model takes what is missing for noise (see `missionsim.identify.predictive`). Each step adds the
effect that predicts left-out runs best, where cluster-robust errors support it, and the clock of the meter stays at
zero unless prediction improves clearly and in most runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate, Layout
from missionsim.identify.design import Source
from missionsim.identify.evidence import Evidence
from missionsim.identify.model import Model
from missionsim.identify.predictive import LeastSquares, Left, far_from_right, sober_clock
from missionsim.identify.settings import (
    AS_MUCH,
    ENERGY_FALL,
    FAMILY_LEVEL,
    HALVED,
    HALVED_LEVEL,
    INDEPENDENT_S,
    LARGEST_PASS_THROUGH,
    LEAST_FALL,
    LEAST_PASS_THROUGH,
    LOUDER,
    NESTED,
    PASS_THROUGH_FALL,
    POWER_Z,
    SEVERAL_RUNS,
    STRICT_LEVEL,
    SWALLOWED,
    UNCLEAR,
    USUAL_PASS_THROUGH,
    WORSE_ENERGY,
    WORSE_ENERGY_LEVEL,
    Settings,
)
from missionsim.physics import Array

LOGGED = "logged_power"


@dataclass(frozen=True)
class Trial:
    """One effect tried beside others."""

    candidate: int
    """Number of the effect."""
    columns: tuple[int, ...]
    """Its regression columns that keep their sign."""
    left: Left
    """Prediction of the left-out folds with it."""
    shares: Array
    covariance: Array
    """Both: of its columns, with cluster jackknife."""
    p_value: float
    """Wald test over folds."""
    passed: dict[str, bool]
    """Gate -> passed."""

    @property
    def accepted(self) -> bool:
        """Whether all gates are passed."""
        return all(self.passed.values())


@dataclass(frozen=True)
class Forward:
    """Result of the selection."""

    chosen: tuple[int, ...]
    """Regression columns in the model, in the order in which their effects entered."""
    clock: Clock
    """Of the power meter."""
    squares: LeastSquares
    """Least squares at this clock."""
    trials: dict[int, Trial]
    """Effect number -> the trial with it, within the final set or beside it."""
    rivals: dict[int, tuple[int, ...]]
    """Effect number -> effects that left-out runs do not tell from it."""

    def evidence(self, column: int) -> Evidence:
        """What speaks for a column, in the words of the gates."""
        trial = next(t for t in self.trials.values() if column in t.columns)
        place = trial.columns.index(column)
        without = self.squares.leave_out([k for k in self.chosen if k not in trial.columns])
        ratio = without.total / max(trial.left.total, 1e-300)
        return Evidence(
            column=column,
            gain=0.5 * float(self.squares.seconds.sum()) / INDEPENDENT_S * float(np.log(ratio)),
            share=float(trial.shares[place]),
            share_sd=float(np.sqrt(trial.covariance[place, place])),
            p_robust=trial.p_value,
            p_runs=trial.p_value if int(self.squares.run.max()) else np.nan,  # parts of one run are no runs
            passed=dict(trial.passed),
        )

    def halves(self, number: int, chosen: Sequence[int]) -> bool:
        """Whether an effect leaves less than half of the squared error of left-out folds beside a set of columns."""
        trial = self.trials.get(number)
        return trial is not None and trial.left.total < HALVED * self.squares.leave_out(chosen).total

    def stands(self, model: Model) -> bool:
        """Whether it stands against a model of the finer search: left-out runs err far less than all do with that one,
        or less, and it holds the same effects and others, all at the level of that search."""
        squares = LeastSquares.of(model.design)
        fitted = squares.errors(squares.index(model.chosen), model.estimate(model.chosen)[0]).total
        p_values = {number: t.p_value for number, t in self.trials.items() if set(t.columns) <= set(self.chosen)}
        more = {model.source.layout.columns[k].candidate for k in model.chosen} < set(p_values)
        sure = more and max(p_values.values()) < model.constraints.settings.alpha / len(self.trials)
        return self.squares.leave_out(self.chosen).total < (AS_MUCH if sure else SWALLOWED) * fitted

    def smallest_detectable(self, columns: int, settings: Settings) -> Array:
        """Share of energy of each column that four of five sets of runs would show, from the cluster jackknife."""
        from scipy.special import stdtrit

        level = max(FAMILY_LEVEL, settings.alpha) / max(len(self.trials), 1)
        factor = POWER_Z - float(stdtrit(max(len(self.squares.sums) - 1, 1), 0.5 * level))
        out = np.full(columns, np.inf)
        for trial in self.trials.values():
            out[list(trial.columns)] = np.maximum(factor * np.sqrt(np.diag(trial.covariance)), settings.min_share)
        return out


@dataclass
class Choice:
    """A fitted model, what spoke for each column in it, and what was tried and refused."""

    model: Model
    empty: Model
    evidence: dict[int, Evidence]
    refused: dict[int, Evidence] = field(default_factory=dict)
    forward: Forward | None = None
    """The selection by prediction, where the base was far from right."""


def forward(source: Source, given: Sequence[str] | None = None, *, near: bool = False) -> Forward | None:
    """Select effects by the prediction of left-out runs, or fit given ones.

    `near`: whether a base that is near enough is no reason to leave it.

    Returns
    -------
    Forward or None
        None where the base is near enough for the finer search.

    Raises
    ------
    ValueError
        If a given effect is unknown or has no column that acts in these runs.
    """
    clock = Clock.as_logged(len(source.runs))
    squares = LeastSquares.of(source.design(clock)) if near else far_from_right(source)
    if squares is None:
        return None
    search = _Search(squares, source.layout, source.constraints.candidates, source.constraints.settings)
    chosen = search.chosen(given)
    # at another clock every column is another one: what was chosen at the first need not stand
    if search.settings.align and (found := sober_clock(source, chosen)) != clock:
        clock = found
        search = replace(search, squares=LeastSquares.of(source.design(clock)))
        chosen = search.chosen(given)
    trials: dict[int, Trial] = {}
    rivals: dict[int, tuple[int, ...]] = {}
    inside = {search.effect_of(k) for k in chosen}
    # those that were refused are fitted as well: what they lack, and how large they could be, is told
    for number, options in search.options():
        own = [k for k in chosen if search.effect_of(k) == number]
        rest = [k for k in chosen if k not in own]
        if own:  # a given effect keeps all its columns, whatever their signs
            trials[number] = trial = search.measured(number, own, rest)
            if np.all(search.candidates[number].sign * trial.shares >= 0.0):
                rivals[number] = search.rivals(trial, rest, inside)
        elif tried := [t for o in options if (t := search.tried(number, o, rest)) is not None]:
            trials[number] = min(tried, key=lambda t: t.left.total)
    return Forward(chosen, clock, search.squares, trials, rivals)


@dataclass(frozen=True)
class _Search:
    """Sets of effects, each judged by least squares of the runs at one clock."""

    squares: LeastSquares
    layout: Layout
    candidates: Sequence[Candidate]
    settings: Settings

    def effect_of(self, column: int) -> int:
        """Number of the effect of a column."""
        return self.layout.columns[column].candidate

    def options(self) -> Iterator[tuple[int, list[list[int]]]]:
        """Ways in which each effect may enter: all its levels together, or one column of its grid of shapes."""
        for number, candidate in enumerate(self.candidates):
            own = [k for k in range(len(self.layout.columns)) if self.effect_of(k) == number]
            if own:
                yield number, [own] if candidate.levels else [[k] for k in own]

    def chosen(self, given: Sequence[str] | None) -> tuple[int, ...]:
        """Columns of the effects that pass every gate, or of the given ones: all levels of a label that act, of a grid
        the one that predicts best."""
        chosen: tuple[int, ...] = ()
        for name in given or ():
            own = [(number, o) for number, o in self.options() if self.candidates[number].effect == name]
            if not own:
                raise ValueError(f"effect {name} has no column that acts in these runs")
            number, options = own[0]
            found = [t for o in options if (t := self.tried(number, o, chosen)) is not None]
            chosen = (*chosen, *(min(found, key=lambda t: t.left.total).columns if found else options[0]))
        if given is not None:
            return chosen
        for _ in range(self.settings.max_effects):
            inside = {self.effect_of(k) for k in chosen}
            tried = [
                trial
                for number, options in self.options()
                if number not in inside
                for option in options
                if (trial := self.tried(number, option, chosen)) is not None and trial.accepted
            ]
            if not tried:
                pair = self._pair(chosen)
                if not pair:
                    break
                chosen = (*chosen, *pair)
                continue
            # watts that another meter measured come before anything whose size has to be found
            known = [t for t in tried if self._logged(t.columns)]
            # what makes them needless imitates them
            for best in sorted(known or tried, key=lambda t: t.left.total):
                kept = self._kept((*chosen, *best.columns))
                if self._logged(chosen) <= self._logged(kept) or self._louder(best, chosen):
                    break
            else:
                break
            chosen = kept
            # the newcomer itself is needless beside the others: it would come and go for ever
            if not set(best.columns) & set(chosen):
                break
        return chosen

    def _pair(self, chosen: tuple[int, ...]) -> tuple[int, ...]:
        """Columns of the two effects that together predict best, if each passes every gate beside the other; else none.

        Alone each may be hidden by the other, as payloads and floors are in nine runs that combine three of both.
        """
        inside = {self.effect_of(k) for k in chosen}
        options = [(n, option) for n, each in self.options() if n not in inside for option in each]
        pairs = [(one, other) for one, other in itertools.combinations(options, 2) if one[0] != other[0]]
        if not pairs:
            return ()
        (n, one), (m, other) = min(pairs, key=lambda p: self.squares.leave_out([*chosen, *p[0][1], *p[1][1]]).total)
        first = self.tried(n, one, (*chosen, *other))
        if first is None or not first.accepted:
            return ()
        second = self.tried(m, other, (*chosen, *first.columns))
        return (*first.columns, *second.columns) if second is not None and second.accepted else ()

    def _logged(self, columns: Sequence[int]) -> set[int]:
        """Effects among them that pass on watts of another meter."""
        return {n for n in map(self.effect_of, columns) if self.candidates[n].effect.startswith(LOGGED)}

    def _surely_drawn(self, trial: Trial) -> bool:
        """Whether an effect is watts of another meter that come as converters pass them on."""
        if not self._logged(trial.columns):
            return False
        unit = self.layout.unit(trial.columns[0])
        factor, reach = float(trial.shares[0]) * unit, 2.0 * float(np.sqrt(trial.covariance[0, 0])) * unit
        least, most = USUAL_PASS_THROUGH
        return factor + reach > least and factor - reach < most

    def _louder(self, best: Trial, chosen: Sequence[int]) -> bool:
        """Whether an effect explains so much more than the logged watts in a set that it is no imitation of them."""
        logged, total = self._logged(chosen), self.squares.leave_out(chosen).total
        without = self.squares.leave_out([k for k in chosen if self.effect_of(k) not in logged]).total
        return total - best.left.total > LOUDER * (without - total)

    def _kept(self, chosen: tuple[int, ...]) -> tuple[int, ...]:
        """The set without effects that a later one has made needless (backward elimination)."""
        while True:
            for number in dict.fromkeys(map(self.effect_of, chosen)):
                own = [k for k in chosen if self.effect_of(k) == number]
                rest = tuple(k for k in chosen if k not in own)
                trial = self.tried(number, own, rest)
                if rest and (trial is None or not trial.accepted):
                    chosen = rest
                    break
                # a level whose sign a later effect has turned goes
                if trial is not None and len(trial.columns) < len(own):
                    chosen = tuple(k for k in chosen if k in rest or k in trial.columns)
                    break
            else:
                return chosen

    def tried(self, number: int, columns: Sequence[int], beside: Sequence[int]) -> Trial | None:
        """An effect beside others; None where physics forbids the sign that it would take. What all levels of a label
        have in common is the base's where that predicts as well."""
        own, sign = list(columns), self.candidates[number].sign
        # levels that point the wrong way go one at a time, the worst first: without it the others may turn
        while own:
            value = self.squares.fit([*beside, *own])[-len(own) :] * [self.layout.unit(k) for k in own]
            wrong = sign * value if sign else np.abs(value)
            if wrong.min() >= 0.0:
                least, trial = int(np.argmin(wrong)), self.measured(number, own, beside)
                if 1 < len(own) == sum(column.candidate == number for column in self.layout.columns):
                    fewer = self.measured(number, own[:least] + own[least + 1 :], beside)
                    trial = fewer if fewer.left.total < (1.0 + PASS_THROUGH_FALL) * trial.left.total else trial
                return trial
            own.pop(int(np.argmin(wrong)))
        return None

    def measured(self, number: int, own: Sequence[int], beside: Sequence[int]) -> Trial:
        """What speaks for an effect beside others, and the answer of every gate."""
        from scipy.special import fdtrc

        squares, layout = self.squares, self.layout
        before, chosen = squares.leave_out(beside), [*beside, *own]
        after = squares.leave_out(chosen)
        value, covariance = squares.jackknife(chosen, after)
        shares, own_covariance = value[-len(own) :], covariance[-len(own) :, -len(own) :]
        folds, k = len(squares.sums), len(own)
        size = max(float(np.trace(own_covariance)), 1e-300)
        # a level of one run alone leaves its covariance singular, which a little of its size on the diagonal mends
        wald = float(shares @ np.linalg.solve(own_covariance + 1e-9 * size * np.eye(k), shares))
        p_value = float(fdtrc(k, folds - k, wald * (folds - k) / (k * (folds - 1)))) if folds > k else 1.0
        halved, runs = after.total < HALVED * before.total, int(squares.run.max()) + 1
        logged = bool(self._logged(own))
        # what a base parameter without prior imitates cannot be found at all
        limit, twins = self.settings.recalibration_limit, map(self._twin, {c.candidate for c in layout.columns})
        effects = sum(q is None or limit * squares.prior_sd[q] < 1.0 for q in twins)
        q, beyond = self._twin(number), True
        if q is not None and (parameter := float(squares.whole[1 + q, 1 + q])) > 0.0:
            # a shift of the base parameter by more than its prior allows, and no more off than there is
            shift = float(shares[0]) * float(squares.whole[1 + q, 1 + squares.q + own[0]]) / parameter
            beyond = bool(shift > -1.0 and abs(shift) > limit * squares.prior_sd[q])
        part = (before.total - after.total) / max(before.total, 1e-300)
        family = FAMILY_LEVEL if squares.by_run and part > LEAST_FALL else STRICT_LEVEL
        passed = {
            # what bends a curve where few rows lie is seen in the energy of runs first
            "runs": part > (PASS_THROUGH_FALL if logged else LEAST_FALL)
            or (part > ENERGY_FALL and squares.energy_no_worse(chosen, after, beside, before) < WORSE_ENERGY_LEVEL),
            "robust": p_value < max(family, self.settings.alpha) / effects or (halved and p_value < HALVED_LEVEL),
            "energy": squares.energy_no_worse(beside, before, chosen, after, WORSE_ENERGY) > WORSE_ENERGY_LEVEL,
            "clock": not self.candidates[number].by_clock or runs > SEVERAL_RUNS or (runs > 1 and halved),
            "practical": halved or float(np.abs(shares).sum()) > self.settings.min_share,
            "beyond recalibration": beyond,
        }
        if logged:
            # far from a watt for each watt logged it is no loss on the way, but something that goes along with it
            passed["practical"] &= bool(LEAST_PASS_THROUGH < shares[0] * layout.unit(own[0]) < LARGEST_PASS_THROUGH)
        if self.candidates[number].levels and [name for name, holds in passed.items() if not holds] == ["robust"]:
            # a Wald test of several levels of a few runs each has no power, and a label asks one question of its own
            levels = [k for k in range(len(layout.columns)) if self.effect_of(k) == number]
            by_chance = squares.shuffled(levels, beside, FAMILY_LEVEL, np.random.default_rng(runs))
            if by_chance <= FAMILY_LEVEL:
                p_value, passed["robust"] = by_chance, True
        return Trial(number, tuple(own), after, shares, own_covariance, p_value, passed)

    def _twin(self, number: int) -> int | None:
        """Place of the base parameter that imitates an effect."""
        twin = self.candidates[number].prior
        return self.layout.parameters.index(twin) if twin in self.layout.parameters else None

    def rivals(self, trial: Trial, rest: Sequence[int], inside: set[int]) -> tuple[int, ...]:
        """Effects that predict left-out runs as well in the place of one, of watts that are logged and drawn at a usual
        factor clearly better; forms of its own cause that hold it as a special case are none."""
        most = -UNCLEAR if self._surely_drawn(trial) else UNCLEAR
        found: list[int] = []
        for number, options in self.options():
            # the twin of a base parameter was recalibrated already: it is no other explanation
            if number in inside or self.candidates[number].prior is not None:
                continue
            form = self.candidates[number].covariate == self.candidates[trial.candidate].covariate
            for option in options:
                other = self.tried(number, option, rest)
                if other is None or not other.passed["robust"] or (form and self._nested(trial.columns, option)):
                    continue
                if not other.left.within(trial.left, most):
                    continue
                # whether it explains what the other in its place leaves over (Davidson and MacKinnon 1981)
                again = self.tried(trial.candidate, trial.columns, [*rest, *option])
                if again is None or not (again.passed["runs"] and again.passed["robust"]):
                    found.append(number)
                    break
        return tuple(found)

    def _nested(self, one: Sequence[int], other: Sequence[int]) -> bool:
        """Whether one set of columns lies in the span of the other."""
        a, b = (1 + self.squares.q + np.asarray(c, dtype=np.intp) for c in sorted((one, other), key=len))
        whole = self.squares.whole
        cross = whole[np.ix_(b, a)]
        rest = np.diag(whole)[a] - np.sum(cross * np.linalg.lstsq(whole[np.ix_(b, b)], cross, rcond=1e-12)[0], axis=0)
        return bool(np.all(rest <= NESTED * np.diag(whole)[a]))
