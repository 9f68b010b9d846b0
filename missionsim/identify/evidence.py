"""What speaks for one effect: gain of the likelihood, errors clustered by blocks and by runs, detection limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.identify.data import Constraints
from missionsim.identify.gram import Gram, project, single_gains
from missionsim.identify.model import Model
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.settings import BETWEEN_PART, ONE_RUN_NATS, ONE_RUN_PART, POWER_Z, SEVERAL_RUNS, WORSE_ENERGY
from missionsim.physics import Array, Bools, Ints

NODE, WEIGHT = np.polynomial.legendre.leggauss(48)
"""Of the integral over an angle: with them p-values of 1e-15 are those of the t distribution to 1e-9."""


REST_S = 10.0
"""Time at rest that tells what a robot draws there."""
AT_REST_TOO = 0.5
"""Part of what is off in all that it draws, from which on what is off at rest may be the same: a meter."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What speaks for one column, given the others in the model."""

    column: int
    gain: float
    """Rise of the log-likelihood [nats]."""
    share: float
    share_sd: float
    """Both: coefficient as share of energy, and its robust standard error."""
    p_robust: float
    p_runs: float
    """Both: two-sided p-values from blocks and from whole runs (NaN with fewer than 3 runs)."""
    passed: dict[str, bool]
    """Name of each gate that was asked (`missionsim.identify.rules`) and its answer."""
    shape_sd: float = 0.0
    """Further standard error of the share, from the uncertain shape of the effect."""
    unit_shape_sd: float = 0.0
    """The same of the coefficient in its own unit, relative to the coefficient."""

    @property
    def accepted(self) -> bool:
        """Whether all gates are passed."""
        return all(self.passed.values())

    @property
    def p_value(self) -> float:
        """The more careful of the likelihood and the robust p-value."""
        return max(chance_of(self.gain), self.p_robust)


def seconds_at_rest(model: Model) -> Array:
    """Time that each interval stands for, shape (n,), of those in which the robot stands [s]; else, and where no log
    tells it, nought."""
    source, seconds = model.source, model.design.duration_s
    rests = [run.at_rest for run in source.runs if run.at_rest is not None]
    if len(rests) < len(source.runs):
        return np.zeros_like(seconds)
    still = source.averaged([rest[None, :].astype(float) for rest in rests], model.clock)[0]
    return np.where(still > 0.99, seconds, 0.0)


def chance_of(gain: float, freedom: int = 1) -> float:
    """Probability that as many free columns gain so many nats by chance (likelihood ratio)."""
    # the functions themselves: the distributions around them (scipy.stats) take half a second to import
    from scipy.special import chdtrc

    return float(chdtrc(freedom, 2.0 * max(gain, 0.0)))


def tails(constraints: Constraints, beside: bool) -> Array:
    """Probability of a false alarm that each column is allowed, in one tail, shape (p,).

    The level is shared by all effects (Bonferroni). Where physics gives the sign, only that tail can alarm; not so
    `beside` an effect in the model, whose misfit goes either way. A grid of time constants is tried at several places
    that look alike: the root of their number counts.
    """
    effects = max(1, len(np.unique(constraints.effect)))
    number = np.bincount(constraints.effect)[constraints.effect]
    sides = np.where((constraints.sign == 0) | beside, 2.0, 1.0)
    return np.asarray(constraints.settings.alpha / effects / np.sqrt(number) / sides)


def nats_needed(tail: float) -> float:
    """Rise of the log-likelihood that chance exceeds with probability `tail` on one side."""
    from scipy.special import ndtri

    return 0.5 * float(ndtri(tail)) ** 2


def block_numbers(model: Model, length_s: float) -> Ints:
    """Number of the time block of each row, shape (n,); blocks never span two runs."""
    design = model.design
    out = np.empty(len(design.y), dtype=np.intp)
    total = 0
    for rows in design.runs:
        time_s = design.time_s[rows]
        own = np.floor((time_s - time_s[0]) / length_s).astype(np.intp)
        out[rows] = total + np.unique(own, return_inverse=True)[1]
        total = int(out[rows].max()) + 1
    return out


def evidence_of(model: Model, column: int) -> Evidence:
    """Evidence for `column`, which is in `model`, given the rest of the model; no gate is asked yet."""
    gain = float(single_gains(model.gram, model.constraints, [c for c in model.chosen if c != column])[column])
    share, sd, block_p, _, run_p = robust(model, column)
    return Evidence(column=column, gain=gain, share=share, share_sd=sd, p_robust=block_p, p_runs=run_p, passed={})


def robust(model: Model, column: int) -> tuple[float, float, float, float, float]:
    """Share of a column that is in `model`, and its cluster-robust standard error (CRV3) and p-value, by blocks and by
    runs (of fewer than three: infinite, and NaN).

    The priors' pseudo-rows enter as known variance, not as jackknife blocks: left out one at a time they would count as
    if the prior could be wrong by all of itself.
    """
    from scipy.special import stdtr

    design, others = model.design, [c for c in model.chosen if c != column]
    rows = np.vstack([design.residual, design.phi[column]])
    (y, x), (y_pseudo, x_pseudo) = project(design, model.noise, rows, others)
    info = float(x @ x + x_pseudo @ x_pseudo)
    share, sd, block_p, run_sd, run_p = 0.0, np.inf, 1.0, np.inf, float("nan")
    if info > 0:
        share = float(x @ y + x_pseudo @ y_pseudo) / info
        e = y - share * x
        known = float(x_pseudo @ x_pseudo)
        # slow logs need longer blocks: ten rows at least, else neighbours are not independent
        blocks = block_numbers(model, max(model.constraints.settings.block_s, 10.0 * design.layout.step_s))
        block_sd, leverage, inflation = _jackknife(x, e, blocks, info, known)
        block_p = _chance_of_jackknife(share / max(block_sd, 1e-300), leverage, inflation, known / info)
        # never surer than the noise model itself: few blocks can scatter little by chance
        sd = max(block_sd, float(np.sqrt(1.0 / info)))
        if len(design.runs) >= SEVERAL_RUNS:
            # runs differ by more than noise, the leading one perhaps most: Satterthwaite's t hardly ever alarms there
            run_sd, leverage, _ = _jackknife(x, e, design.run_index(), info, known)
            freedom = max(1.5, float(leverage.sum() ** 2 / (leverage @ leverage)) - 1.0)
            run_p = float(2.0 * stdtr(freedom, -abs(share) / max(run_sd, 1e-300)))
    return share, sd, block_p, run_sd, run_p


def _jackknife(x: Array, e: Array, cluster: Ints, info: float, known: float) -> tuple[float, Array, Array]:
    """Standard error of the jackknife over clusters (CRV3); parts of the information of each, and what its score
    counts for."""
    score = np.bincount(cluster, weights=x * e)
    leverage = np.bincount(cluster, weights=x * x) / info
    # one cluster that holds all would divide by nothing
    inflation = (1.0 - np.minimum(leverage, 0.95)) ** -2
    return float(np.sqrt(inflation @ score**2 + known)) / info, leverage, inflation


def _chance_of_jackknife(t: float, leverage: Array, inflation: Array, known: float) -> float:
    """Two-sided p-value of a share over its jackknife error, exact where noise is as large as the model says.

    The share is independent of the scores then, and the squared error is a quadratic form in normal variables, so that
    the normal tail in Craig's form (1991) makes its mean one integral over an angle. A t with Satterthwaite's degrees
    of freedom has no false alarms at low levels where few clusters lead, and no power.
    """
    ratio = t * t / np.sin((NODE + 1.0) * np.pi / 4.0) ** 2
    parts = 1.0 + ratio[:, None] * (inflation * leverage)
    # determinant of a diagonal matrix less one of rank one
    log_rest = np.log(np.maximum(1.0 - leverage.sum() + (leverage / parts).sum(axis=1), 1e-300))
    return float(0.5 * WEIGHT @ np.exp(-0.5 * (np.log(parts).sum(axis=1) + log_rest + ratio * known)))


def predicts_left_out(model: Model, columns: Sequence[int]) -> tuple[float, float]:
    """How well runs left out of a least-squares fit are predicted with some columns, against without them.

    Returns
    -------
    float
        Part of their squared power error that is left.
    float
        One-sided p-value, over runs, of "their energy error is hardly larger".
    """
    squares = LeastSquares.of(model.design)
    rest = [c for c in model.chosen if c not in columns]
    with_it, without = squares.leave_out(model.chosen), squares.leave_out(rest)
    left = with_it.total / max(without.total, 1e-300)
    return left, squares.energy_no_worse(rest, without, model.chosen, with_it, WORSE_ENERGY)


def cause_is_constant(model: Model, column: int) -> bool:
    """Whether what an effect depends on hardly changes within the runs, so that each run is a single observation."""
    name = model.constraints.of_column(column).covariate
    values = [np.asarray(run.covariates[name]) for run in model.source.runs if name in run.covariates]
    if not values:
        return False
    within = sum(float(np.nansum((v - np.nanmean(v)) ** 2)) for v in values)
    every = np.concatenate(values)
    return within < BETWEEN_PART * float(np.nansum((every - np.nanmean(every)) ** 2))


def cause_changes_in(model: Model, column: int) -> Bools:
    """In which runs what an effect depends on changes by what is much over all, shape (runs,): one drive with the cold
    in it shows what no two do that differ in more."""
    name = model.constraints.of_column(column).covariate
    values = [np.asarray(run.covariates.get(name, 0.0), dtype=float) for run in model.source.runs]
    least = BETWEEN_PART * np.nanvar(np.concatenate([np.atleast_1d(value) for value in values]))
    return np.array([np.nanvar(value) > least for value in values])


def constant_in_most(model: Model, column: int) -> bool:
    """Whether what an effect depends on changes within less than half of the runs, and between them."""
    name = model.constraints.of_column(column).covariate
    means = [np.nanmean(run.covariates[name]) for run in model.source.runs if name in run.covariates]
    return bool(means and np.ptp(means) > 0.0 and np.mean(cause_changes_in(model, column)) < 0.5)


def driven_for(model: Model, column: int) -> Bools:
    """In which runs the cause of a column changes that is constant in most, or that of another effect in the model,
    shape (runs,): with and without the load on one floor, the rest of what the load seemed to cost is the floor's."""
    steady = [cause_changes_in(model, k) for k in {column, *model.chosen} if constant_in_most(model, k)]
    return np.asarray(np.any([np.zeros(len(model.source.runs), dtype=bool), *steady], axis=0))


def rests_on_one_run(model: Model, column: int) -> int | None:
    """The run without which hardly anything speaks for a column; None where others do."""
    gram = model.gram
    others = [k for k in model.chosen if k != column]
    count = gram.per_run.shape[0]
    # noise and clock stay: one run more or less hardly moves them
    kept = [Gram(np.delete(gram.per_run, j, axis=0), gram.prior_precision) for j in range(count)]
    gains = [part.gain(model.chosen) - part.gain(others) for part in kept]
    whole = gram.gain(model.chosen) - gram.gain(others)
    return int(np.argmin(gains)) if min(gains) < max(ONE_RUN_NATS, ONE_RUN_PART * whole) else None


def smallest_detectable(model: Model) -> Array:
    """Smallest share of energy of each column that would be found in four of five cases, shape (p,)."""
    from scipy.special import ndtri

    info = np.diag(model.gram.conditional(model.chosen))[1:].copy()
    # an effect in the model is limited by the others in it, not by itself
    for k in model.chosen:
        info[k] = model.gram.conditional([c for c in model.chosen if c != k])[1 + k, 1 + k]
    needed = POWER_Z - ndtri(tails(model.constraints, bool(model.chosen)))
    out = np.full(len(info), np.inf)
    # columns that base and runs explain wholly have no limit at all
    usable = info > 1e-8 * np.maximum(np.diag(model.gram.full)[1:], 1e-300)
    out[usable] = np.maximum(needed[usable] / np.sqrt(info[usable]), model.constraints.settings.min_share)
    return out
