"""Is a law real? Its size, the likelihood with all tries counted, blocks of time, and runs left out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from missionsim.identify.evidence import chance_of, robust
from missionsim.identify.gram import Gram
from missionsim.identify.model import Model
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.proposed import FAR_BETTER
from missionsim.identify.settings import HALVED_LEVEL, SEVERAL_RUNS
from missionsim.identify.simpler import drifts_as_well
from missionsim.physics import Array

if TYPE_CHECKING:
    from missionsim.laws.search import Fitted

LEAST_SHARE = 0.008
"""Below this part of the energy, half-moving rows and noisy covariates make forms out of nothing (measured)."""
LEAST_RISE = 6.0
"""Nats beyond the penalty for all tries."""
LEAST_BETTER = 0.98
"""A law lowers the error of left-out runs at least to this part: what is left of the form of another law does not."""
FEW_BETTER = 0.95
"""The same where the base is far from right and the runs are too few to be the sample."""
OF_BASE = 0.03
"""Part of the square of a law that the base cannot imitate, up to which the law may be no more than rows that are half
in motion (measured: 0.005 to 0.015 of such, 0.05 to 0.5 of others)."""
HALF_ROWS = 0.5
"""Most of what the base cannot imitate of a law that may lie in rows in which terms of the base switch, or beside them
(measured: 0.67 to 0.91 where rows of a second in which a robot starts are all there is, 0.1 to 0.4 for a true law)."""
ACTS = 0.02
"""Part of a law's squared power from which on it acts in a run."""


@dataclass(frozen=True)
class Gates:
    """What a law must pass to be told."""

    share_sd: float
    """Robust standard error of the share of energy (jackknife over blocks)."""
    passed: dict[str, bool]


def gates(fitted: Fitted, *, clock: bool = False) -> Gates:
    """Size, likelihood with all tries counted, blocks of time, runs left out, no mere half rows or drift over the runs.

    `clock`: whether the law reads a clock, which any wander of half the runs looks like.
    """
    model = fitted.model
    share, sd, _, run_sd, run_p = robust(model, fitted.column)
    least, runs, by_chance = LEAST_BETTER, 0, chance_of(0.5 * (share / max(sd, 1e-300)) ** 2)
    if model.squares is not None:
        # where the base is far from right, whole runs differ: floors, loads and roads are not drawn anew every 20 s
        if len(model.design.runs) > SEVERAL_RUNS:
            # a corner of the data, as slow turns on snow, is driven in two or three runs, however many there are
            sd, runs, by_chance = max(sd, run_sd), SEVERAL_RUNS, max(by_chance, run_p)
        else:  # two runs know little of a product of three: what it says of other runs is a guess
            least, runs = FEW_BETTER, len(fitted.form)
    errors = fitted.errors
    # few runs leave that test no power, and what leaves less than half of their squared error needs little
    level = HALVED_LEVEL if errors.with_law < FAR_BETTER * errors.without else chance_of(fitted.penalty)
    passed = {
        "size": abs(share) >= LEAST_SHARE,
        "likelihood": fitted.rise > fitted.penalty + LEAST_RISE,
        "blocks": by_chance < level,
        "left-out runs": errors.with_law < least * errors.without
        and errors.better >= (0.75 if clock else 0.5) * errors.acting,
        # stretches of one run are no runs
        "several runs": min(errors.acting, len(model.design.runs)) >= runs,
        "whole rows": _in_half_rows(model) <= HALF_ROWS,
        "no drift": not drifts_as_well(model.design, model.chosen[-1:], model.chosen[:-1]),
    }
    return Gates(sd, passed)


def _in_half_rows(model: Model) -> float:
    """Part of what the base cannot imitate of the last column, where that is little, that lies in rows in which its
    terms switch, or beside them: a robot drives through a part of such a row, as a threshold of the speed says."""
    design = model.design
    weight = np.sqrt(design.duration_s)
    rows = np.vstack([design.gradient[: len(design.layout.parameters)], design.phi[list(model.chosen[:-1])]]) * weight
    own = design.phi[model.chosen[-1]] * weight
    left = (own - rows.T @ np.linalg.lstsq(rows.T, own, rcond=None)[0]) ** 2
    switched = np.convolve(design.gradient[-1] != 0.0, np.ones(3), "same") > 0
    of_base = left.sum() <= OF_BASE * (own**2).sum()
    return float(left[switched].sum() / max(float(left.sum()), 1e-300)) if of_base else 0.0


@dataclass(frozen=True)
class LeftOut:
    """Errors of runs, or of stretches of a single one, that were left out one at a time."""

    without: float
    with_law: float
    """Both: power error (RMS) [W]."""
    energy_without: float
    energy_with: float
    """Both: mean absolute energy error [%]."""
    better: int
    acting: int
    """Both: runs predicted better, of those in which the law acts."""
    by_run: tuple[float, ...]
    """Power error of each run with the law (RMS) [W]."""


def left_out(model: Model, last: int = 1) -> LeftOut:
    """Each run predicted from the others, or each stretch of a single run, without the last columns of a model and with
    them."""
    square, energy, size = (_of_stretches if len(model.design.runs) == 1 else _of_runs)(model, last)
    acting = size > ACTS * max(float(size.sum()), 1e-300)
    told = np.isfinite(energy[0])
    rms, mean = np.sqrt(square.mean(axis=1)), energy[:, told].mean(axis=1) if told.any() else np.zeros(2)
    better = int(np.sum((square[1] < square[0])[acting]))
    runs = tuple(float(x) for x in np.sqrt(square[1]))
    return LeftOut(float(rms[0]), float(rms[1]), float(mean[0]), float(mean[1]), better, int(acting.sum()), runs)


def _of_runs(model: Model, last: int) -> tuple[Array, Array, Array]:
    """Mean squared power error and energy error [%], each (2, runs), and squared size of the last columns (runs,)."""
    design, gram = model.design, model.gram
    count = len(design.runs)
    q = len(design.layout.parameters)
    square, energy, size = np.zeros((2, count)), np.full((2, count), math.nan), np.zeros(count)
    for j, rows in enumerate(design.runs):
        part = Gram(gram.per_run[np.arange(count) != j], gram.prior_precision)
        seconds = design.duration_s[rows]
        measured = float(np.sum(design.y[rows] * seconds))
        for i, chosen in enumerate((model.chosen[:-last], model.chosen)):
            value, _ = part.joint(chosen, q)
            power = value[:q] @ design.gradient[:q, rows] + value[q:] @ design.phi[list(chosen)][:, rows]
            error = design.base[rows] + power - design.y[rows]
            square[i, j] = np.average(error**2, weights=seconds)
            if measured:  # a run, or a piece of one, in which a drive's meter stood at nought has no energy error
                energy[i, j] = 100.0 * abs(float(np.sum(error * seconds)) / measured)
        size[j] = float(np.sum(design.phi[-last:, rows] ** 2))
    return square, energy, size


def _of_stretches(model: Model, last: int) -> tuple[Array, Array, Array]:
    """The same of the stretches into which least squares cuts few runs."""
    squares = LeastSquares.of(model.design)
    left = [squares.leave_out(chosen) for chosen in (model.chosen[:-last], model.chosen)]
    own = [1 + squares.q + k for k in model.chosen[-last:]]
    measured = squares.sums[:, -2, -1]
    energy = [np.abs(one.energy) / np.where(measured == 0.0, math.nan, np.abs(measured)) for one in left]
    square = np.array([one.square / squares.seconds for one in left])
    return square, 100.0 * np.array(energy), np.asarray(squares.sums[:, own, own].sum(axis=1))
