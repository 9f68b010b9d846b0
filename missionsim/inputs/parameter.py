"""A number of a file (`Parameter`), its distribution where it is uncertain, what can be wrong with one (`Issue`)."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from missionsim.inputs.base import Model
from missionsim.physics import Array


@dataclass(frozen=True)
class Distribution:
    """Distribution of one value, all numbers in the value's SI unit."""

    kind: str
    """``normal`` (mean, sd), ``truncated_normal`` (mean and sd of the untruncated, low, high), ``lognormal``
    (arithmetic mean and sd), ``uniform`` (low, high), ``triangular`` (low, mode, high), ``discrete`` (values, weights),
    ``empirical`` (values; resampled)."""
    mean_: float | None = None
    sd_: float | None = None
    low: float | None = None
    high: float | None = None
    mode: float | None = None
    values: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    """Both: of ``discrete`` and ``empirical``; weights add up to 1."""

    def within(self, low: float, high: float) -> Distribution:
        """The distribution cut off at bounds; one whose own kind sets its range stays as it is."""
        if self.kind not in ("normal", "truncated_normal") or (self._low >= low and self._high <= high):
            return self
        ends = max(self._low, low), min(self._high, high)
        return replace(self, kind="truncated_normal", low=ends[0], high=ends[1])

    @property
    def ends(self) -> tuple[float, float]:
        """Between which all its values lie, SI."""
        return (min(self.values), max(self.values)) if self.values else (self._low, self._high)

    @property
    def mean(self) -> float:
        """Mean, SI."""
        return self._moments[0]

    @property
    def sd(self) -> float:
        """Standard deviation, SI."""
        return self._moments[1]

    @functools.cached_property
    def _moments(self) -> tuple[float, float]:
        mean, sd = float(self.mean_ or 0.0), float(self.sd_ or 0.0)
        a, b, c = self._low, self._high, float(self.mode or 0.0)
        match self.kind:
            case "normal" | "lognormal":
                return mean, sd
            case "uniform":
                return (a + b) / 2, (b - a) / math.sqrt(12.0)
            case "triangular":
                return (a + b + c) / 3, math.sqrt((a * a + b * b + c * c - a * b - a * c - b * c) / 18)
            case "truncated_normal" if sd == 0.0:
                return min(max(mean, a), b), 0.0
            case "truncated_normal":
                from scipy.stats import truncnorm

                first, second = truncnorm.stats((a - mean) / sd, (b - mean) / sd, mean, sd, moments="mv")
                return float(first), math.sqrt(float(second))
        mean = float(np.dot(self.values, self.weights))
        return mean, math.sqrt(float(np.dot((np.asarray(self.values) - mean) ** 2, self.weights)))

    def quantile(self, probability: ArrayLike) -> Array:
        """Values at the probabilities (any shape, 0 to 1 exclusive for unbounded kinds); SI."""
        u = np.asarray(probability, dtype=float)
        match self.kind:
            case "uniform":
                return np.asarray(self._low + u * (self._high - self._low))
            case "triangular":
                a, b, c = self._low, self._high, float(self.mode or 0.0)
                if b == a:
                    return np.full(u.shape, a)
                split = (c - a) / (b - a)
                left = a + np.sqrt(np.maximum(u * (b - a) * (c - a), 0.0))
                right = b - np.sqrt(np.maximum((1 - u) * (b - a) * (b - c), 0.0))
                return np.asarray(np.where(u < split, left, right), dtype=float)
            case "discrete" | "empirical":
                order = np.argsort(self.values, kind="stable")
                steps = np.cumsum(np.asarray(self.weights)[order])
                index = np.searchsorted(steps, u * steps[-1], side="left")
                values = np.asarray(self.values, dtype=float)[order]
                return np.asarray(values[np.minimum(index, len(values) - 1)], dtype=float)
        from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

        a, b = self.score_bounds
        if a > 0:  # mirror, so that the upper tail keeps its digits
            log_low, log_high = log_ndtr(-b), log_ndtr(-a)
            z = -ndtri_exp(log_low + np.log1p((1 - u) * np.expm1(log_high - log_low)))
        elif b < 0:
            log_low, log_high = log_ndtr(a), log_ndtr(b)
            z = ndtri_exp(log_low + np.log1p(u * np.expm1(log_high - log_low)))
        else:
            z = ndtri(ndtr(a) + u * (ndtr(b) - ndtr(a)))
        return np.asarray(np.clip(self.at_scores(np.asarray(z)), self._low, self._high))

    @property
    def of_scores(self) -> bool:
        """Whether values follow from standard normal numbers by `at_scores`."""
        return self.kind in ("normal", "lognormal", "truncated_normal")

    @functools.cached_property
    def score_bounds(self) -> tuple[float, float]:
        """Standard normal numbers between which `at_scores` stays within the bounds."""
        mean, sd = float(self.mean_ or 0.0), float(self.sd_ or 0.0)
        if self.kind != "truncated_normal" or sd == 0.0:
            return -math.inf, math.inf
        return (self._low - mean) / sd, (self._high - mean) / sd

    def at_scores(self, scores: Array) -> Array:
        """Values at standard normal numbers, SI; for kinds that follow from them, without regard to bounds. The values
        take the place of the scores."""
        mean, sd = float(self.mean_ or 0.0), float(self.sd_ or 0.0)
        if self.kind == "lognormal" and sd:
            sigma2 = math.log1p((sd / mean) ** 2)
            mean, sd = math.log(mean) - sigma2 / 2, math.sqrt(sigma2)
        scores *= sd
        scores += mean
        if self.kind == "lognormal" and sd:
            np.exp(scores, out=scores)
        elif sd == 0.0:
            np.clip(scores, self._low, self._high, out=scores)
        return scores

    def scaled(self, factor: float) -> Distribution:
        """The distribution of `factor` times the value (factor > 0)."""
        numbers = (self.mean_, self.sd_, self.low, self.high, self.mode)
        mean, sd, low, high, mode = (None if number is None else number * factor for number in numbers)
        values = tuple(value * factor for value in self.values)
        return Distribution(self.kind, mean, sd, low, high, mode, values, self.weights)

    @property
    def _low(self) -> float:
        return -math.inf if self.low is None else self.low

    @property
    def _high(self) -> float:
        return math.inf if self.high is None else self.high


STATUSES = ("published", "fitted", "assumed", "measured")


@dataclass(frozen=True)
class Parameter:
    """A number of a robot, environment or mission file."""

    value: float
    """Nominal value in the SI unit `unit` (energies J, angles rad, temperatures degC)."""
    sd: float | None = None
    """Standard deviation, same unit."""
    low: float | None = None
    high: float | None = None
    """Both: range that was given; bounds of a fit for parameters of effects, of a uniform distribution elsewhere."""
    distribution: Distribution | None = None
    """What a Monte Carlo draws from; None for a certain number."""
    status: str = ""
    source: str = ""
    """Both, and `note`: ``published``, ``fitted``, ``assumed``, ``measured`` or empty; where the number comes from."""
    unit: str = "1"
    """SI unit; of a number where any unit may stand, what the unit that the file names is in SI."""
    _: KW_ONLY
    note: str = ""
    path: str = ""
    """Dotted path in its file, such as ``components.laser.loads.0.power``; empty for a default."""
    line: int = 0
    """1-based line in its file, 0 where there is none."""

    def __float__(self) -> float:
        return self.value

    def scaled(self, factor: float, unit: str) -> Parameter:
        """`factor` times the parameter, in another unit."""
        sd, low, high = (None if number is None else number * factor for number in (self.sd, self.low, self.high))
        drawn = None if self.distribution is None else self.distribution.scaled(factor)
        return replace(self, value=self.value * factor, sd=sd, low=low, high=high, distribution=drawn, unit=unit)


def parameters(model: object) -> list[tuple[str, Parameter]]:
    """Paths and parameters of all numbers that a model's file gives, in the file's order."""
    result: list[tuple[str, Parameter]] = []
    stack: list[object] = [model]
    while stack:
        item = stack.pop()
        if isinstance(item, Parameter):
            if item.path:
                result.append((item.path, item))
        elif isinstance(item, Model):
            stack.extend(getattr(item, name) for name in reversed(type(item).model_fields))
        elif isinstance(item, Mapping):
            stack.extend(reversed(list(item.values())))
        elif isinstance(item, tuple):
            stack.extend(reversed(item))
    return result


def uncertain_values(model: object) -> list[tuple[str, Parameter]]:
    """Those of `parameters` that have a distribution."""
    return [(path, parameter) for path, parameter in parameters(model) if parameter.distribution is not None]
