"""The uncertain values of a mission and their draws, by name and run index."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError, did_you_mean
from missionsim.inputs.distributions import Distribution
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import uncertain_values
from missionsim.uncertainty.streams import LARGEST_NORMAL, Streams

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
        streams = Streams(seed)
        correlated = self._correlated(
            {name: streams.normals(name, first, count) for group in self.groups for name in group[0]}
        )
        found: Draws = {}
        for value in self.values:
            name, law = value.name, value.distribution
            if name in correlated:
                found[name] = law.quantile(correlated[name])
            elif law.of_scores:
                found[name] = _from_scores(law, streams, name, first, count)
            else:
                found[name] = law.quantile(streams.uniforms(name, first, count))
        return found

    def at(self, probabilities: Mapping[str, NDArray[np.float64]]) -> Draws:
        """Values at independent uniform numbers, correlated by a Gaussian copula."""
        from scipy.special import ndtri

        scores = {name: ndtri(probabilities[name]) for names, _ in self.groups for name in names}
        uniform = {**probabilities, **self._correlated(scores)}
        return {value.name: value.distribution.quantile(uniform[value.name]) for value in self.values}

    def _correlated(self, scores: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
        """Probabilities of the values in groups, from independent normal scores of each."""
        found = {}
        for names, cholesky in self.groups:
            from scipy.special import ndtr

            # row by row, so that a run's numbers do not depend on the block they stand in
            for i, name in enumerate(names):
                mixed = cholesky[i, 0] * scores[names[0]]
                for j in range(1, i + 1):
                    mixed = mixed + cholesky[i, j] * scores[names[j]]
                found[name] = ndtr(mixed)
        return found


def _from_scores(law: Distribution, streams: Streams, name: str, first: int, count: int) -> NDArray[np.float64]:
    """Draws from normal scores; where bounds cut a score off, a fresh number of the run takes its place.

    A score inside the bounds has the truncated distribution already, and so has the fresh one: their mixture too.
    """
    scores = streams.normals(name, first, count)
    low, high = law.score_bounds
    outside = np.zeros(0, dtype=np.intp)
    if max(low, -high) > -LARGEST_NORMAL and count and (scores.min() < low or scores.max() > high):
        outside = np.flatnonzero((scores < low) | (scores > high))
    values = law.at_scores(scores)
    if outside.size:
        values[outside] = law.quantile(streams.uniforms(f"{name}\x00outside", first, count)[outside])
    return values


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
