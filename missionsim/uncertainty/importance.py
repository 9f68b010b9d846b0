"""Sobol indices: which uncertain value matters, alone and with all that it interacts with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.errors import InputError
from missionsim.files import Json
from missionsim.physics import Array
from missionsim.uncertainty.answers import LEVEL
from missionsim.uncertainty.draws import run_generator
from missionsim.uncertainty.single import left_to_chance

if TYPE_CHECKING:
    from missionsim.uncertainty.batch import Prepared

DESIGNS = 16
"""Independently scrambled designs; how they differ tells how sure the indices are."""
FEWEST = 4 * DESIGNS
CHANCE = "chance"
"""Name of all that a mission leaves to chance, taken as one value."""
_TRIED, _AFFORDABLE, _AFFORDABLE_SIMPY, _MOST_SAMPLES = 512, 150_000, 400, 1024
_EDGE = 2.0**-40
_MATTERS = 0.05
"""A rank correlation with the margin above this is told even of a value that changes no energy (a capacity)."""
_POINTS = {"arrays": 1 << 14, "simpy": 256}
"""So many points are evaluated at once, at most."""


def sobol_importance(prepared: Prepared, seed: int, samples: int, ranks: list[Json]) -> list[Json]:
    """First-order and total Sobol indices of each battery's energy.

    `samples`: a power of two, `FEWEST` or more; the mission is evaluated ``samples × (values + 2)`` times. `ranks`:
    rank correlations to be carried over. Gives ``parameter``, ``battery``, ``first``, ``total`` with their 95 %
    intervals, largest total first. What is left to chance is one value, `CHANCE`. Raises InputError: where values are
    correlated: the indices are not defined then.

    Saltelli et al. 2010, estimators (b) and (f) of Table 2, on scrambled Sobol' points (`scipy.stats.qmc`). A bootstrap
    would take these points for independent ones and give intervals far too wide; here `DESIGNS` designs are scrambled
    independently, and the interval is that of the jackknife over them with Student's t.
    """
    refuse_correlated(prepared)
    names = [value.name for value in prepared.sampler.values]
    names += [CHANCE] if left_to_chance(prepared.mission) else []
    if not names:
        return ranks
    first, total = _indices(prepared, seed, samples, len(names))
    known = {(row["battery"], row["parameter"]): row for row in ranks}
    rows = [
        {
            "parameter": name,
            "battery": battery,
            "first": first[0, i, b],
            "total": total[0, i, b],
            "first_interval": [first[1, i, b], first[2, i, b]],
            "total_interval": [total[1, i, b], total[2, i, b]],
            "rank_correlation": known.get((battery, name), {}).get("rank_correlation"),
            "margin_rank_correlation": known.get((battery, name), {}).get("margin_rank_correlation"),
        }
        for b, battery in enumerate(prepared.mission.robot.batteries)
        for i, name in enumerate(names)
        # else the value does not touch this battery's energy, nor what it keeps
        if total[0, i, b] > 0.0 or abs(_with_margin(known.get((battery, name), {}))) > _MATTERS
    ]
    return sorted(rows, key=lambda row: -max(float(row["total"]), _with_margin(row) ** 2))


def _with_margin(row: Mapping[str, Any]) -> float:
    return float(row.get("margin_rank_correlation") or 0.0)


def refuse_correlated(prepared: Prepared) -> None:
    """Say that correlated values have no Sobol indices."""
    if prepared.sampler.groups:
        raise InputError.single(
            "Sobol indices are not defined for correlated values",
            got="correlations in the mission",
            allowed="--sobol without correlations, or the rank correlations alone",
        )


def affordable_samples(prepared: Prepared, seed: int) -> int:
    """Base samples for which Sobol indices cost about as much as a batch; 0 where many runs need SimPy."""
    arrays, values = prepared.arrays, prepared.sampler.values
    if arrays is None or not values or prepared.sampler.groups:
        return 0
    _, again = arrays.evaluate(prepared.sampler.draw(seed, 0, _TRIED), _TRIED)
    most = min(_AFFORDABLE, _AFFORDABLE_SIMPY / max(float(again.mean()), 1e-9))
    samples = int(most) // (len(values) + 2)
    if samples < FEWEST:
        return 0
    return int(min(_MOST_SAMPLES, 1 << (samples.bit_length() - 1)))


def _indices(prepared: Prepared, seed: int, samples: int, values: int) -> tuple[Array, Array]:
    """First-order and total indices: estimate, low and high end; shape (3, values, batteries)."""
    from scipy.stats import qmc

    evaluated = []
    for design in range(DESIGNS):
        scrambling = np.random.default_rng(int(run_generator(seed, "sobol", design).integers(1 << 62)))
        generator = qmc.Sobol(2 * values, seed=scrambling)
        points = np.clip(generator.random(samples // DESIGNS), _EDGE, 1.0 - _EDGE).T
        a, b = points[:values], points[values:]
        pages = [np.array(a), np.array(b)]
        for i in range(values):
            pages.append(np.array(a))
            pages[-1][i] = b[i]
        together = max(1, _POINTS[prepared.engine] // a.shape[1])
        parts = [
            _energies(prepared, seed, np.concatenate(pages[i : i + together], axis=1))
            for i in range(0, len(pages), together)
        ]
        found = np.split(np.concatenate(parts, axis=1), len(pages), axis=1)
        evaluated.append((found[0], found[1], np.array(found[2:])))
    middle = np.nanmean([0.5 * (f_a + f_b) for f_a, f_b, _ in evaluated], axis=(0, -1))[:, None]
    variance, first, total = [], [], []
    for f_a, f_b, f_ab in evaluated:
        variance.append(np.nanmean(0.5 * ((f_a - middle) ** 2 + (f_b - middle) ** 2), axis=-1))
        first.append(np.nanmean((f_b - middle) * (f_ab - f_a), axis=-1))
        total.append(np.nanmean(0.5 * (f_a - f_ab) ** 2, axis=-1))
    return _ratio(np.array(first), np.array(variance)), _ratio(np.array(total), np.array(variance))


def _ratio(parts: Array, variances: Array) -> Array:
    """Ratio of sums over designs with its interval by the jackknife. `parts`: shape (designs, values, batteries);
    `variances`: shape (designs, batteries)."""
    from scipy.special import stdtrit

    whole = np.where(variances.sum(axis=0) > 0.0, variances.sum(axis=0), np.inf)
    ratio = parts.sum(axis=0) / whole
    without = (parts.sum(axis=0) - parts) / (whole - variances)[:, None, :]
    spread = np.sqrt((DESIGNS - 1) * np.mean((without - without.mean(axis=0)) ** 2, axis=0))
    half = float(stdtrit(DESIGNS - 1, 0.5 + 0.5 * LEVEL)) * spread
    return np.array([ratio, ratio - half, ratio + half])


def _energies(prepared: Prepared, seed: int, points: Array) -> Array:
    """Energy of each battery at probabilities of the values, shape (batteries, n); NaN where a run fails."""
    values, batteries = prepared.sampler.values, tuple(prepared.mission.robot.batteries)
    draws = {value.name: value.distribution.quantile(points[i]) for i, value in enumerate(values)}
    count = points.shape[1]
    # a point's probability of chance is the seed of all that chance does there
    lots = (points[-1] * 2**53).astype(np.int64) if len(points) > len(values) else np.arange(count)
    block = prepared.block(seed, 0, count, draws, lots)
    return np.array([block[f"energy_{name}_wh"] for name in batteries])
