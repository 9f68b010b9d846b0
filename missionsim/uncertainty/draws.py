"""The uncertain values of a mission and their draws, by name and run index."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError, did_you_mean
from missionsim.spec.distributions import Distribution
from missionsim.spec.mission import MissionSpec
from missionsim.spec.uncertain_values import uncertain_values
from missionsim.uncertainty.streams import uniforms

Draws = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class UncertainValue:
    """One number that a Monte Carlo varies.

    Attributes
    ----------
    name : str
        Path: the mission's own, or ``robot.…``, ``environment.…``.
    nominal : float
        Value without uncertainty, SI.
    unit : str
    distribution : Distribution
    """

    name: str
    nominal: float
    unit: str
    distribution: Distribution


@dataclass(frozen=True)
class Sampler:
    """Draws of all uncertain values of a mission.

    Attributes
    ----------
    values : tuple of UncertainValue
    groups : tuple of (names, cholesky)
        Values that are correlated with each other, with the Cholesky factor of their normal scores.
    """

    values: tuple[UncertainValue, ...]
    groups: tuple[tuple[tuple[str, ...], NDArray[np.float64]], ...] = ()

    def draw(self, seed: int, first: int, count: int) -> Draws:
        """Values of the runs ``first … first + count − 1``.

        Parameters
        ----------
        seed, first, count : int

        Returns
        -------
        dict
            Name → ndarray of shape (count,), SI. The same for any block and whatever else is uncertain.
        """
        probabilities = {value.name: uniforms(seed, value.name, first, count) for value in self.values}
        return self.at(probabilities)

    def at(self, probabilities: Mapping[str, NDArray[np.float64]]) -> Draws:
        """Values at independent uniform numbers, correlated by a Gaussian copula."""
        uniform = dict(probabilities)
        for names, cholesky in self.groups:
            from scipy.special import ndtr, ndtri

            # row by row, so that a run's numbers do not depend on the block they stand in
            scores = [ndtri(uniform[name]) for name in names]
            for i, name in enumerate(names):
                mixed = cholesky[i, 0] * scores[0]
                for j in range(1, i + 1):
                    mixed = mixed + cholesky[i, j] * scores[j]
                uniform[name] = ndtr(mixed)
        return {value.name: value.distribution.quantile(uniform[value.name]) for value in self.values}


def make_sampler(mission: MissionSpec) -> Sampler:
    """The sampler of a mission, its robot and its environment.

    Raises
    ------
    missionsim.errors.InputError
        Where correlations name a value that is not uncertain, or cannot hold together.
    """
    found: list[UncertainValue] = []
    for prefix, part in (("", mission), ("robot.", mission.robot), ("environment.", mission.environment)):
        if part is not None:
            for path, parameter in uncertain_values(part):
                assert parameter.distribution is not None
                found.append(UncertainValue(prefix + path, parameter.value, parameter.unit, parameter.distribution))
    names = [value.name for value in found]
    return Sampler(tuple(found), _groups(mission, names))


def _groups(mission: MissionSpec, names: list[str]) -> tuple[tuple[tuple[str, ...], NDArray[np.float64]], ...]:
    pairs = {}
    for item in mission.correlations:
        for name in item.between:
            if name not in names:
                raise InputError.single(
                    "a correlation names a value that is not uncertain",
                    file=str(mission.path),
                    got=name,
                    allowed=", ".join(names) or "nothing here is uncertain",
                    hint=did_you_mean(name, names),
                )
        pairs[item.between] = item.rho
    linked = {name: {name} for pair in pairs for name in pair}
    for one, other in pairs:
        together = linked[one] | linked[other]
        for name in together:
            linked[name] = together
    groups: list[tuple[tuple[str, ...], NDArray[np.float64]]] = []
    for members in {frozenset(group) for group in linked.values()}:
        ordered = tuple(name for name in names if name in members)
        matrix = np.eye(len(ordered))
        for (one, other), rho in pairs.items():
            if one in members:
                i, j = ordered.index(one), ordered.index(other)
                matrix[i, j] = matrix[j, i] = rho
        try:
            groups.append((ordered, np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)))
        except np.linalg.LinAlgError:
            raise InputError.single(
                "these correlations cannot hold together (their matrix is not positive definite)",
                file=str(mission.path),
                got=", ".join(ordered),
                path="correlations",
            ) from None
    return tuple(sorted(groups, key=lambda group: group[0]))
