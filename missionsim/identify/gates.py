"""Is the best new effect real? Four gates: likelihood, runs, robust errors, practical size (step 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.identify.data import Array, Settings
from missionsim.identify.gram import Gram, project
from missionsim.identify.model import Model
from missionsim.identify.search import Rules, single_gains

INFORMATIVE = 0.02
BACKING = 0.6
"""Runs with this part of the information suffice: in a flat run the slope holds little but the noise of its sensor,
and many such runs must not outvote the ramps."""
REPEATED = 0.01
UNSURE_NATS = 2.0
"""The prediction of left-out runs is itself uncertain by this much; runs that agree with each other then decide."""
FEW_BETTER = 3
"""Runs that a clear gain of prediction must come from: an effect of the weather shows in the cold runs alone."""
BESIDE = 0.03
"""Part of the level that is left to further effects: what the form of the first leaves over adds to chance. Right
second effects of 4 % of the energy gained 13 nats and more, most wrong ones 7 to 12."""
SEVERAL_RUNS = 3
"""From here on runs test each other."""
ONE_RUN_NATS = 3.0
ONE_RUN_PART = 0.05
"""What must be left of an effect's gain without the run that shows it best."""
LOUD = 0.3
"""A block with this part of the information leaves too few degrees of freedom for a test with it."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for one column, given the others in the model.

    Attributes
    ----------
    gain : rise of the log-likelihood [nats]
    overdispersion : factor by which block scores scatter more than the noise model says, at least 1
    share, share_sd : coefficient as share of energy, and its robust standard error
    p_robust, p_runs : two-sided p-values from blocks and from whole runs (NaN with fewer than 3 runs)
    predictive : gain of the prediction of left-out runs [nats]; NaN with one run
    runs_better, runs_informative : left-out runs predicted better, of those that carry information
    passed : gate -> passed
    shape_sd : further standard error of the share, from the uncertain shape of the effect
    unit_shape_sd : the same of the coefficient in its own unit, relative to the coefficient
    """

    column: int
    gain: float
    overdispersion: float
    share: float
    share_sd: float
    p_robust: float
    p_runs: float
    predictive: float
    runs_better: int
    runs_informative: int
    passed: dict[str, bool]
    shape_sd: float = 0.0
    unit_shape_sd: float = 0.0

    @property
    def accepted(self) -> bool:
        """Whether all gates are passed."""
        return all(self.passed.values())

    @property
    def p_value(self) -> float:
        """The more careful of the likelihood and the robust p-value."""
        from scipy.stats import chi2

        return float(max(chi2.sf(2 * max(self.gain, 0.0) / self.overdispersion, 1), self.p_robust))


def block_numbers(model: Model, length_s: float) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
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


def block_length(model: Model, settings: Settings) -> float:
    """Length of the blocks: the setting, longer for slow logs [s]."""
    return max(settings.block_s, 10.0 * model.design.layout.step_s)


def overdispersion(model: Model, settings: Settings) -> float:
    """Median over the candidates outside the model of the scatter of block scores, relative to the noise model."""
    outside = [k for k in range(model.gram.p) if k not in model.chosen]
    if not outside:
        return 1.0
    design = model.design
    rows = np.vstack([design.residual, design.phi[outside]])
    projected = project(design, model.noise, rows, model.chosen)
    blocks = block_numbers(model, block_length(model, settings))
    score = projected.rows[1:] * projected.rows[0]
    sums = np.stack([np.bincount(blocks, weights=s) for s in score])
    info = np.sum(projected.rows[1:] ** 2, axis=1)
    usable = info > 1e-6 * np.maximum(np.diag(model.gram.full)[1:][outside], 1e-300)
    if not np.any(usable):
        return 1.0
    ratio = np.sum(sums[usable] ** 2, axis=1) / info[usable]
    return float(max(1.0, np.median(ratio)))


def weigh(model: Model, column: int, rules: Rules, settings: Settings, spread: float, effects: int) -> Evidence:
    """Evidence for `column`, which is in `model`, given the rest of the model.

    `effects` counts the candidate effects, for the Bonferroni correction.
    """
    others = [c for c in model.chosen if c != column]
    gain = float(single_gains(model.gram, rules, others)[column])
    tail = tails(rules, settings, effects, bool(others))[column]
    share, sd, p_robust, p_runs = _robust(model, column, others, settings)
    predictive, better, informative, backing = _left_out(model, column, others)
    several = len(model.design.runs) > 1
    passed = {
        "likelihood": gain / spread > nats_needed(tail),
        "runs": (not several)
        or (predictive > 0 and (2 * better >= informative or backing > BACKING))
        or (predictive > -UNSURE_NATS and p_runs < REPEATED)
        or (predictive > 2 * UNSURE_NATS and better >= FEW_BETTER),
        "robust": p_robust < 2.0 * tail,
        "practical": abs(share) > settings.min_share,
    }
    return Evidence(column, gain, spread, share, sd, p_robust, p_runs, predictive, better, informative, passed)


def tails(rules: Rules, settings: Settings, effects: int, beside: bool) -> Array:
    """Probability of a false alarm that each column is allowed, in one tail, shape (p,).

    The level is shared by all effects (Bonferroni). Where physics gives the sign, only that tail can alarm; not so
    `beside` an effect in the model, whose misfit goes either way. A grid of time constants is tried at several places
    that look alike: the root of their number counts.
    """
    number = np.bincount(rules.effect)[rules.effect]
    return np.asarray(settings.alpha / effects / np.sqrt(number) / np.where((rules.sign == 0) | beside, 2.0, 1.0))


def nats_needed(tail: float) -> float:
    """Rise of the log-likelihood that chance exceeds with probability `tail` on one side."""
    from scipy.stats import norm

    return 0.5 * float(norm.isf(tail)) ** 2


def _robust(model: Model, column: int, others: Sequence[int], settings: Settings) -> tuple[float, float, float, float]:
    """Share, cluster-robust standard error (CRV3) and p-values by blocks and by runs.

    The priors' pseudo-rows enter as known variance, not as jackknife blocks.
    """
    design = model.design
    rows = np.vstack([design.residual, design.phi[column]])
    p = project(design, model.noise, rows, others)
    x, x_pseudo = p.rows[1], p.pseudo[1]
    info = float(x @ x + x_pseudo @ x_pseudo)
    if info <= 0:
        return 0.0, np.inf, 1.0, float("nan")
    share = float(x @ p.rows[0] + x_pseudo @ p.pseudo[0]) / info
    e = p.rows[0] - share * x
    known = float(x_pseudo @ x_pseudo)
    blocks = block_numbers(model, block_length(model, settings))
    block_sd, block_p = _clustered(x, e, blocks, share, info, known)
    block_p = min(block_p, 2.0 * _beside_the_loudest(x, p.rows[0], blocks))
    run_p = float("nan")
    if len(design.runs) >= SEVERAL_RUNS:
        _, run_p = _clustered(x, e, design.run_index(), share, info, known)
    return share, max(block_sd, float(np.sqrt(1.0 / info))), block_p, run_p


def _clustered(
    x: Array, e: Array, cluster: np.ndarray[tuple[int, ...], np.dtype[np.intp]], share: float, info: float, known: float
) -> tuple[float, float]:
    from scipy.stats import t

    score = np.bincount(cluster, weights=x * e)
    leverage = np.minimum(np.bincount(cluster, weights=x * x) / info, 0.95)
    variance = float(np.sum((score / (1 - leverage)) ** 2)) + known
    weight = np.append(leverage, 0.0)
    freedom = max(1.5, float(np.sum(weight)) ** 2 / float(np.sum(weight**2)) - 1.0)
    sd = float(np.sqrt(variance)) / info
    return sd, float(2 * t.sf(abs(share) / max(sd, 1e-300), freedom))


def _beside_the_loudest(x: Array, left: Array, blocks: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> float:
    """p-value without the block that holds most of the information, where it holds so much that few degrees of
    freedom are left; 1 elsewhere."""
    leverage = np.bincount(blocks, weights=x * x)
    loudest = int(np.argmax(leverage))
    rest = blocks != loudest
    info = float(leverage.sum() - leverage[loudest])
    if leverage[loudest] < LOUD * leverage.sum() or info <= 0:
        return 1.0
    x, left = x[rest], left[rest]
    share = float(x @ left) / info
    numbers = np.unique(blocks[rest], return_inverse=True)[1]
    return _clustered(x, left - share * x, numbers, share, info, 0.0)[1]


def _left_out(model: Model, column: int, others: Sequence[int]) -> tuple[float, int, int, float]:
    """Predictive gain of left-out runs [nats], how many of the informative ones gain, how many there are, and the part
    of the information that lies in those that gain; from the Gram matrices (no refit of the noise)."""
    gram = model.gram
    count = gram.per_run.shape[0]
    if count < 2:
        return float("nan"), 0, 0, 0.0
    inside = [*others, column]
    whole = gram.evidence(inside) - gram.evidence(others)
    gains = np.empty(count)
    information = np.empty(count)
    position = 1 + gram.q + column
    for j in range(count):
        kept = np.arange(count) != j
        gains[j] = whole - (gram.evidence(inside, kept) - gram.evidence(others, kept))
        information[j] = max(float(gram.per_run[j, position, position]), 0.0)
    informative = information > INFORMATIVE * max(float(information.sum()), 1e-300)
    backing = float(information[gains > 0].sum() / max(float(information.sum()), 1e-300))
    return float(gains.sum()), int(np.sum(gains[informative] > 0)), int(informative.sum()), backing


def between_runs(model: Model, column: int) -> bool:
    """Whether a column hardly changes within runs, so that only differences between runs speak for it."""
    return differs_between([model.design.phi[column, rows] for rows in model.design.runs])


def differs_between(parts: Sequence[Array]) -> bool:
    """Whether values, one array for each run, differ between the runs and hardly within them; NaN is left out."""
    within = sum(float(np.nansum((v - np.nanmean(v)) ** 2)) for v in parts)
    every = np.concatenate(parts)
    return within < 0.1 * float(np.nansum((every - np.nanmean(every)) ** 2))


def rests_on_one_run(model: Model, column: int, spread: float) -> bool:
    """Whether hardly anything speaks for a column once the run that says most for it is left out."""
    gram = model.gram
    others = [k for k in model.chosen if k != column]
    count = gram.per_run.shape[0]
    kept = [Gram(np.delete(gram.per_run, j, axis=0), gram.prior_precision) for j in range(count)]
    least = min(part.gain(model.chosen) - part.gain(others) for part in kept)
    whole = gram.gain(model.chosen) - gram.gain(others)
    return bool(least < max(ONE_RUN_NATS * spread, ONE_RUN_PART * whole))


def smallest_detectable(model: Model, rules: Rules, spread: float, settings: Settings, effects: int) -> Array:
    """Smallest share of energy of each column that would be found in four of five cases, shape (p,)."""
    from scipy.stats import norm

    rest = model.gram.conditional([])
    outside = [k for k in range(model.gram.p) if k not in model.chosen]
    info = np.diag(rest)[1:].copy()
    if len(model.chosen):
        conditional = np.diag(model.gram.conditional(model.chosen))[1:]
        info[outside] = conditional[outside]
        for k in model.chosen:
            info[k] = model.gram.conditional([c for c in model.chosen if c != k])[1 + k, 1 + k]
    needed = norm.isf(tails(rules, settings, effects, bool(model.chosen))) + 0.84
    if model.chosen:
        needed[outside] = norm.isf(BESIDE * tails(rules, settings, effects, True)[outside]) + 0.84
    out = np.full(len(info), np.inf)
    usable = info > 1e-8 * np.maximum(np.diag(model.gram.full)[1:], 1e-300)
    out[usable] = np.maximum(needed[usable] * np.sqrt(spread / info[usable]), settings.min_share)
    return out
