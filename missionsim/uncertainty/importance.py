"""Sobol indices: which uncertain value matters, alone and with all that it interacts with."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.spec.distributions import Distribution

if TYPE_CHECKING:
    from missionsim.uncertainty.batch import Prepared

_EDGE = 2.0**-40


class _Law:
    """What SciPy asks of a distribution."""

    def __init__(self, distribution: Distribution) -> None:
        self.distribution = distribution

    def ppf(self, probability: NDArray[np.float64]) -> NDArray[np.float64]:
        # a scrambled Sobol point may lie on the border, where a normal distribution has no value
        return self.distribution.quantile(np.clip(probability, _EDGE, 1.0 - _EDGE))


def sobol_importance(prepared: Prepared, seed: int, samples: int, ranks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """First-order and total Sobol indices of each battery's energy (Saltelli 2010, by `scipy.stats.sobol_indices`).

    Parameters
    ----------
    prepared : Prepared
    seed : int
    samples : int
        A power of two; the mission is evaluated ``samples × (values + 2)`` times.
    ranks : list of dict
        Rank correlations to be carried over.

    Returns
    -------
    list of dict
        ``parameter``, ``battery``, ``first``, ``total`` with 95 % bootstrap intervals, largest total first.

    Raises
    ------
    missionsim.errors.InputError
        Where values are correlated: the indices are not defined then.
    """
    from scipy.stats import sobol_indices

    values = prepared.sampler.values
    if prepared.sampler.groups:
        raise InputError.single(
            "Sobol indices are not defined for correlated values",
            got="correlations in the mission",
            allowed="--sobol without correlations, or the rank correlations alone",
        )
    if not values:
        return ranks
    batteries = tuple(prepared.mission.robot.batteries)

    def energies(x: NDArray[np.float64]) -> NDArray[np.float64]:
        points = np.atleast_2d(x)
        draws = {value.name: points[i] for i, value in enumerate(values)}
        if prepared.arrays is not None:
            columns, _ = prepared.arrays.evaluate(draws, points.shape[1])
            return np.array([columns[f"energy_{name}_wh"] for name in batteries])
        found = np.empty((len(batteries), points.shape[1]))
        for j in range(points.shape[1]):
            result = simulate(
                prepared.mission,
                values={name: float(v[j]) for name, v in draws.items()},
                model=prepared.model,
                trace=False,
            )
            found[:, j] = [result.batteries[name].energy_wh for name in batteries]
        return found

    answer = sobol_indices(
        func=energies, n=samples, dists=[_Law(value.distribution) for value in values], rng=np.random.default_rng(seed)
    )
    with warnings.catch_warnings():
        # a value that does not touch a battery has no spread there; its interval is nan and its row is left out
        warnings.simplefilter("ignore")
        spread = answer.bootstrap(confidence_level=0.95, n_resamples=200)
    first, total = np.atleast_2d(answer.first_order), np.atleast_2d(answer.total_order)
    intervals = [
        np.atleast_2d(part)
        for part in (
            spread.first_order.confidence_interval.low,
            spread.first_order.confidence_interval.high,
            spread.total_order.confidence_interval.low,
            spread.total_order.confidence_interval.high,
        )
    ]
    known = {(row["battery"], row["parameter"]): row.get("rank_correlation") for row in ranks}
    rows = [
        {
            "parameter": value.name,
            "battery": battery,
            "first": float(first[b, i]),
            "total": float(total[b, i]),
            "first_interval": [float(intervals[0][b, i]), float(intervals[1][b, i])],
            "total_interval": [float(intervals[2][b, i]), float(intervals[3][b, i])],
            "rank_correlation": known.get((battery, value.name)),
        }
        for b, battery in enumerate(batteries)
        for i, value in enumerate(values)
        if np.isfinite(total[b, i])
    ]
    return sorted(rows, key=lambda row: -float(row["total"]))
