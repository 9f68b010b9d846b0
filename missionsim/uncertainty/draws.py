"""The uncertain values of a mission and their draws, by name and run index."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import SFC64, Generator, Philox

from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.parameter import Distribution, uncertain_values
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array

CHUNK = 4096
"""Runs that share a generator; drawing one run alone costs at most so many numbers a stream."""
LARGEST_NORMAL = 14.0
"""No normal number here is larger: the generator's tail beyond 3.65 reaches 53 bits' worth, 10.1, further."""
_SMALLEST = 2.0**-54


def _digest(size: int, *parts: object) -> bytes:
    text = "\x00".join(str(part) for part in parts)
    return hashlib.blake2b(text.encode(), digest_size=size, person=b"missionsim.v2").digest()


class Streams:
    """Numbers of the streams of one seed; one generator serves all, put into each chunk's state in turn.

    `seed`: the batch's seed, any size.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._bits = SFC64(0)
        self._state: Any = self._bits.state
        self._generator = Generator(self._bits)

    def normals(self, name: str, first: int, count: int) -> Array:
        """Standard normal numbers of the runs ``first … first + count − 1`` of a stream, shape (count,)."""
        return self._numbers(name, first, count, normal=True)

    def uniforms(self, name: str, first: int, count: int) -> Array:
        """Uniform numbers, strictly between 0 and 1, with 53 bits, shape (count,)."""
        return np.asarray(np.maximum(self._numbers(name, first, count, normal=False), _SMALLEST))

    def _numbers(self, name: str, first: int, count: int, *, normal: bool) -> Array:
        numbers = np.empty(count)
        place = 0
        while place < count:
            chunk, skipped = divmod(first + place, CHUNK)
            size = min(CHUNK - skipped, count - place)
            generator = self._at(name, chunk)
            # numbers come one after the other, so that a chunk's beginning does not depend on how many are taken
            drawn = numbers[place : place + size] if skipped == 0 else np.empty(skipped + size)
            if normal:
                generator.standard_normal(out=drawn)
            else:
                generator.random(out=drawn)
            if skipped:
                numbers[place : place + size] = drawn[skipped:]
            place += size
        return numbers

    def _at(self, name: str, chunk: int) -> Generator:
        words = self._state["state"]["state"]
        words[:3] = np.frombuffer(_digest(24, self.seed, name, chunk), dtype="<u8")
        words[3] = 1
        self._bits.state = self._state
        return self._generator


def run_generator(seed: int, name: str, run: int) -> Generator:
    """A generator of its own for one run, for what needs an unknown number of draws (arrivals, retries). Counter-based
    (Philox, Salmon et al. 2011), keyed by seed and name; 2^128 numbers lie between neighbouring runs."""
    return Generator(Philox(key=int.from_bytes(_digest(16, seed, name), "little"), counter=[0, 0, run, 1]))


Draws = dict[str, Array]


@dataclass(frozen=True)
class UncertainValue:
    """One number that a Monte Carlo varies."""

    name: str
    """Path: the mission's own, or ``robot.…``, ``environment.…``."""
    nominal: float
    """Value without uncertainty, SI."""
    unit: str
    distribution: Distribution


@dataclass(frozen=True)
class Sampler:
    """Draws of all uncertain values of a mission."""

    values: tuple[UncertainValue, ...]
    groups: tuple[tuple[tuple[str, ...], Array], ...] = ()
    """Values that are correlated with each other, with the Cholesky factor of their normal scores. Tuple of (names,
    cholesky)."""

    def draw(self, seed: int, first: int, count: int) -> Draws:
        """Values of the runs ``first … first + count − 1``. Gives name → ndarray of shape (count,), SI. The same for
        any block and whatever else is uncertain."""
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
                scores, (low, high) = streams.normals(name, first, count), law.score_bounds
                outside = np.zeros(0, dtype=np.intp)
                if max(low, -high) > -LARGEST_NORMAL and count and (scores.min() < low or scores.max() > high):
                    outside = np.flatnonzero((scores < low) | (scores > high))
                found[name] = law.at_scores(scores)
                if outside.size:
                    # where bounds cut a score off, a fresh number of the run takes its place: a score inside has the
                    # truncated distribution already, and so has the fresh one, hence their mixture too
                    fresh = streams.uniforms(f"{name}\x00outside", first, count)[outside]
                    found[name][outside] = law.quantile(fresh)
            else:
                found[name] = law.quantile(streams.uniforms(name, first, count))
        return found

    def at(self, probabilities: Mapping[str, Array]) -> Draws:
        """Values at independent uniform numbers, correlated by a Gaussian copula."""
        from scipy.special import ndtri

        scores = {name: ndtri(probabilities[name]) for names, _ in self.groups for name in names}
        uniform = {**probabilities, **self._correlated(scores)}
        return {value.name: value.distribution.quantile(uniform[value.name]) for value in self.values}

    def _correlated(self, scores: Mapping[str, Array]) -> dict[str, Array]:
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


def make_sampler(mission: MissionSpec) -> Sampler:
    """The sampler of a mission, its robot and its environment. No draw of a parameter of the power model leaves the
    bounds that physics sets."""
    terms = () if mission.robot is None else build_power_model(mission.robot).terms
    bounds = {
        "robot." + term.parameters[spec.name].path: (spec.low, spec.high)
        for term in terms
        for spec in term.effect.parameters
        if spec.name in term.parameters
    }
    found: list[UncertainValue] = []
    for prefix, part in (("", mission), ("robot.", mission.robot), ("environment.", mission.environment)):
        if part is not None:
            for path, parameter in uncertain_values(part):
                assert parameter.distribution is not None
                drawn = parameter.distribution.within(*bounds.get(prefix + path, (-math.inf, math.inf)))
                found.append(UncertainValue(prefix + path, parameter.value, parameter.unit, drawn))
    names = [value.name for value in found]
    return Sampler(tuple(found), _groups(mission, names))


def _groups(mission: MissionSpec, names: list[str]) -> tuple[tuple[tuple[str, ...], Array], ...]:
    pairs = {item.between: item.rho for item in mission.correlations}
    linked = {name: {name} for pair in pairs for name in pair}
    for one, other in pairs:
        together = linked[one] | linked[other]
        for name in together:
            linked[name] = together
    groups: list[tuple[tuple[str, ...], Array]] = []
    for members in {frozenset(group) for group in linked.values()}:
        ordered = tuple(name for name in names if name in members)
        matrix = np.eye(len(ordered))
        for (one, other), rho in pairs.items():
            if one in members:
                i, j = ordered.index(one), ordered.index(other)
                matrix[i, j] = matrix[j, i] = rho
        groups.append((ordered, np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)))
    return tuple(sorted(groups, key=lambda group: group[0]))
