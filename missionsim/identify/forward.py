"""Forward selection by the prediction of left-out runs, for logs whose base model is far from right.

There the mixed noise model takes what is missing for noise (see `missionsim.identify.predictive`). Each step adds the
effect that predicts left-out runs best, where cluster-robust errors support it, and the clock of the meter stays at
zero unless prediction improves clearly and in most runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from missionsim.identify.align import Clock
from missionsim.identify.data import Array, Candidate
from missionsim.identify.design import Layout, Source
from missionsim.identify.evidence import Evidence
from missionsim.identify.model import Model
from missionsim.identify.predictive import LeastSquares, Left, sober_clock
from missionsim.identify.settings import (
    FAMILY_LEVEL,
    INDEPENDENT_S,
    LARGEST_PASS_THROUGH,
    LEAST_FALL,
    NESTED,
    PASS_THROUGH_FALL,
    POWER_Z,
    RIVAL_PART,
    ROUGH,
    UNCLEAR,
    Settings,
)

LOGGED = "logged_power"


@dataclass(frozen=True)
class Trial:
    """One effect tried beside others.

    Attributes
    ----------
    candidate : number of the effect
    columns : its regression columns that keep their sign
    left : prediction of the left-out folds with it
    shares, covariance : of its columns, with cluster jackknife
    p_value : Wald test over folds
    passed : gate -> passed
    """

    candidate: int
    columns: tuple[int, ...]
    left: Left
    shares: Array
    covariance: Array
    p_value: float
    passed: dict[str, bool]

    @property
    def accepted(self) -> bool:
        """Whether all gates are passed."""
        return all(self.passed.values())


@dataclass(frozen=True)
class Forward:
    """Result of the selection.

    Attributes
    ----------
    chosen : regression columns in the model, in the order in which their effects entered
    clock : of the power meter
    squares : least squares at this clock
    trials : effect number -> the trial with it, within the final set or beside it
    rivals : effect number -> effects that left-out runs do not tell from it
    """

    chosen: tuple[int, ...]
    clock: Clock
    squares: LeastSquares
    trials: dict[int, Trial]
    rivals: dict[int, tuple[int, ...]]

    def evidence(self, column: int) -> Evidence:
        """What speaks for a column, in the words of the gates."""
        trial = next(t for t in self.trials.values() if column in t.columns)
        place = trial.columns.index(column)
        rest = [k for k in self.chosen if k not in trial.columns]
        without = self.squares.leave_out(rest)
        count = float(self.squares.seconds.sum()) / INDEPENDENT_S
        gain = 0.5 * count * float(np.log(without.total / max(trial.left.total, 1e-300)))
        sd = float(np.sqrt(trial.covariance[place, place]))
        return Evidence(
            column=column,
            gain=gain,
            share=float(trial.shares[place]),
            share_sd=sd,
            p_robust=trial.p_value,
            p_runs=trial.p_value,
            passed=dict(trial.passed),
        )

    def smallest_detectable(self, columns: int, settings: Settings) -> Array:
        """Share of energy of each column that four of five sets of runs would show, from the cluster jackknife."""
        from scipy.stats import t

        freedom = max(len(self.squares.sums) - 1, 1)
        level = max(FAMILY_LEVEL, settings.alpha) / max(len(self.trials), 1)
        factor = float(t.isf(0.5 * level, freedom)) + POWER_Z
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


def is_rough(squares: LeastSquares, mean_power_w: float) -> bool:
    """Whether the recalibrated base predicts most left-out runs so badly that its form is far from right.

    A ramp or two that it does not know are no reason: one missing effect of few runs is what the finer search is for.
    """
    error = np.sqrt(squares.leave_out(()).square / squares.seconds)
    return bool(np.median(error) > ROUGH * abs(mean_power_w))


def forward(
    source: Source, candidates: Sequence[Candidate], settings: Settings, given: Sequence[str] | None = None
) -> Forward | None:
    """Select effects by the prediction of left-out runs, or fit given ones.

    Returns
    -------
    Forward or None
        None where the base is near enough for the finer search.

    Raises
    ------
    ValueError
        If a given effect is unknown or has no column that acts in these runs.
    """
    still = Clock(0.0, 0.0, tuple(0.0 for _ in source.runs))
    squares = LeastSquares.of(source.design(still))
    if not is_rough(squares, source.layout.mean_power_w):
        return None
    clock = still

    def selected() -> tuple[int, ...]:
        if given is None:
            return _select(squares, source.layout, candidates, settings)
        return _given(squares, source.layout, candidates, settings, given)

    chosen = selected()
    if settings.align:
        clock = sober_clock(source, chosen)
        if clock != still:
            squares = LeastSquares.of(source.design(clock))
            chosen = selected()
    trials: dict[int, Trial] = {}
    rivals: dict[int, tuple[int, ...]] = {}
    inside = {source.layout.columns[k].candidate for k in chosen}
    for number, options in _options(source.layout, candidates):
        own = [k for k in chosen if source.layout.columns[k].candidate == number]
        rest = [k for k in chosen if k not in own]
        tried = [
            _try(squares, source.layout, candidates, number, o, rest, settings) for o in ([own] if own else options)
        ]
        found = [t for t in tried if t is not None]
        if found:
            trials[number] = min(found, key=lambda t: t.left.total)
        elif own:
            trials[number] = _measure(squares, source.layout, candidates[number], number, own, rest, settings)
        if number in inside and found:
            rivals[number] = _rivals(squares, source.layout, candidates, trials[number], rest, inside, settings)
    return Forward(chosen, clock, squares, trials, rivals)


def _options(layout: Layout, candidates: Sequence[Candidate]) -> Iterator[tuple[int, list[list[int]]]]:
    """Ways in which each effect may enter: all its levels together, or one column of its grid of shapes."""
    for number, candidate in enumerate(candidates):
        own = [k for k, column in enumerate(layout.columns) if column.candidate == number]
        if own:
            yield number, [own] if candidate.levels else [[k] for k in own]


def _select(
    squares: LeastSquares, layout: Layout, candidates: Sequence[Candidate], settings: Settings
) -> tuple[int, ...]:
    chosen: tuple[int, ...] = ()
    for _ in range(settings.max_effects):
        inside = {layout.columns[k].candidate for k in chosen}
        tried = [
            trial
            for number, options in _options(layout, candidates)
            if number not in inside
            for option in options
            if (trial := _try(squares, layout, candidates, number, option, chosen, settings)) is not None
            and trial.accepted
        ]
        if not tried:
            break
        known = [t for t in tried if candidates[t.candidate].effect.startswith(LOGGED)]
        best = min(known or tried, key=lambda t: t.left.total)
        chosen = _kept(squares, layout, candidates, settings, (*chosen, *best.columns))
        if not set(best.columns) & set(chosen):
            break
    return chosen


def _given(
    squares: LeastSquares, layout: Layout, candidates: Sequence[Candidate], settings: Settings, effects: Sequence[str]
) -> tuple[int, ...]:
    """Columns of given effects: all levels of a label that act, of a grid the one that predicts best."""
    chosen: tuple[int, ...] = ()
    for name in effects:
        options = [o for number, o in _options(layout, candidates) if candidates[number].effect == name]
        if not options:
            raise ValueError(f"effect {name} has no column that acts in these runs")
        number = layout.columns[options[0][0][0]].candidate
        tried = [_try(squares, layout, candidates, number, o, chosen, settings) for o in options[0]]
        found = [t for t in tried if t is not None]
        chosen = (*chosen, *(min(found, key=lambda t: t.left.total).columns if found else options[0][0]))
    return chosen


def _kept(
    squares: LeastSquares, layout: Layout, candidates: Sequence[Candidate], settings: Settings, chosen: tuple[int, ...]
) -> tuple[int, ...]:
    """The set without effects that a later one has made needless (backward elimination)."""
    while True:
        for number in dict.fromkeys(layout.columns[k].candidate for k in chosen):
            own = [k for k in chosen if layout.columns[k].candidate == number]
            rest = tuple(k for k in chosen if k not in own)
            trial = _try(squares, layout, candidates, number, own, rest, settings)
            if rest and (trial is None or not trial.accepted):
                chosen = rest
                break
        else:
            return chosen


def _try(
    squares: LeastSquares,
    layout: Layout,
    candidates: Sequence[Candidate],
    number: int,
    columns: Sequence[int],
    beside: Sequence[int],
    settings: Settings,
) -> Trial | None:
    """An effect beside others; None where physics forbids the sign that it would take."""
    own = list(columns)
    candidate = candidates[number]
    while own:
        value = squares.fit([*beside, *own])[-len(own) :]
        wrong = candidate.sign * value if candidate.sign else np.abs(value)
        if wrong.min() >= 0.0:
            break
        own.pop(int(np.argmin(wrong)))
    return _measure(squares, layout, candidate, number, own, beside, settings) if own else None


def _measure(
    squares: LeastSquares,
    layout: Layout,
    candidate: Candidate,
    number: int,
    own: Sequence[int],
    beside: Sequence[int],
    settings: Settings,
) -> Trial:
    """What speaks for an effect beside others, and the answer of every gate."""
    from scipy.stats import f

    before = squares.leave_out(beside)
    chosen = [*beside, *own]
    after = squares.leave_out(chosen)
    value, covariance = squares.jackknife(chosen, after)
    shares, own_covariance = value[-len(own) :], covariance[-len(own) :, -len(own) :]
    folds, k = len(squares.sums), len(own)
    size = max(float(np.trace(own_covariance)), 1e-300)
    wald = float(shares @ np.linalg.solve(own_covariance + 1e-9 * size * np.eye(k), shares))
    p_value = float(f.sf(wald * (folds - k) / (k * (folds - 1)), k, folds - k)) if folds > k else 1.0
    fall = before.square - after.square
    worse = np.abs(squares.energy_left_out(chosen, after)) - np.abs(squares.energy_left_out(beside, before))
    spread = float(np.std(worse, ddof=1)) / np.sqrt(folds) if folds > 1 else np.inf
    logged = candidate.effect.startswith(LOGGED)
    effects = len({column.candidate for column in layout.columns})
    passed = {
        "runs": float(fall.sum()) > (PASS_THROUGH_FALL if logged else LEAST_FALL) * before.total,
        "several runs": float(fall.sum() - fall.max()) > 0.0,
        "robust": p_value < max(FAMILY_LEVEL, settings.alpha) / effects,
        "energy": float(worse.mean()) < UNCLEAR * spread,
        "practical": float(np.abs(shares).sum()) > settings.min_share,
        "beyond recalibration": _beyond_recalibration(squares, layout, candidate, own, shares, settings),
    }
    if logged:
        size_one = shares[0] * layout.mean_power_w / layout.columns[own[0]].watts_per_unit
        passed["practical"] &= bool(0.0 < size_one < LARGEST_PASS_THROUGH)
    return Trial(number, tuple(own), after, shares, own_covariance, p_value, passed)


def _beyond_recalibration(
    squares: LeastSquares,
    layout: Layout,
    candidate: Candidate,
    columns: Sequence[int],
    shares: Array,
    settings: Settings,
) -> bool:
    """Whether an effect that a base parameter imitates is more than a shift of it that its prior allows."""
    if candidate.prior is None or candidate.prior not in layout.parameters:
        return True
    q = layout.parameters.index(candidate.prior)
    gradient, column = 1 + q, 1 + squares.q + columns[0]
    size = float(squares.whole[gradient, gradient])
    if size <= 0.0:
        return True
    shift = float(shares[0]) * float(squares.whole[gradient, column]) / size / squares.prior_sd[q]
    return bool(abs(shift) > settings.recalibration_limit)


def _rivals(
    squares: LeastSquares,
    layout: Layout,
    candidates: Sequence[Candidate],
    trial: Trial,
    rest: Sequence[int],
    inside: set[int],
    settings: Settings,
) -> tuple[int, ...]:
    """Effects that predict left-out runs as well in the place of one; forms that hold it as a special case are none."""
    if candidates[trial.candidate].effect.startswith(LOGGED):
        return ()
    gain = squares.leave_out(rest).total - trial.left.total
    found: list[int] = []
    for number, options in _options(layout, candidates):
        if number in inside or candidates[number].prior is not None:
            continue
        for option in options:
            other = _try(squares, layout, candidates, number, option, rest, settings)
            if other is None or not other.passed["robust"] or _nested(squares, trial.columns, option):
                continue
            behind = other.left.square - trial.left.square
            error = float(np.std(behind, ddof=1)) * np.sqrt(len(behind))
            near = behind.sum() < UNCLEAR * error and behind.sum() < (1.0 - RIVAL_PART) * gain
            if near and not _encompasses(squares, layout, candidates, trial, [*rest, *option], settings):
                found.append(number)
                break
    return tuple(found)


def _encompasses(
    squares: LeastSquares,
    layout: Layout,
    candidates: Sequence[Candidate],
    trial: Trial,
    beside: Sequence[int],
    settings: Settings,
) -> bool:
    """Whether an effect explains what another in its place leaves over (Davidson and MacKinnon 1981)."""
    again = _try(squares, layout, candidates, trial.candidate, trial.columns, beside, settings)
    return again is not None and again.passed["runs"] and again.passed["several runs"] and again.passed["robust"]


def _nested(squares: LeastSquares, one: Sequence[int], other: Sequence[int]) -> bool:
    """Whether one set of columns lies in the span of the other."""
    small, large = sorted((list(one), list(other)), key=len)
    a, b = (1 + squares.q + np.asarray(columns, dtype=np.intp) for columns in (small, large))
    inner = squares.whole[np.ix_(b, b)]
    cross = squares.whole[np.ix_(b, a)]
    rest = np.diag(squares.whole)[a] - np.sum(cross * np.linalg.lstsq(inner, cross, rcond=1e-12)[0], axis=0)
    return bool(np.all(rest <= NESTED * np.diag(squares.whole)[a]))
