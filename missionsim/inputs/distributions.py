"""Distributions of uncertain numbers: named, frozen, with mean, standard deviation and quantile function."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from missionsim.physics import Array

KINDS = ("normal", "truncated_normal", "lognormal", "uniform", "triangular", "discrete", "empirical")


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

    @property
    def mean(self) -> float:
        """Mean, SI."""
        match self.kind:
            case "normal" | "lognormal":
                return float(self.mean_ or 0.0)
            case "uniform":
                return (self._low + self._high) / 2
            case "triangular":
                return (self._low + self._high + float(self.mode or 0.0)) / 3
            case "truncated_normal":
                return self._truncated_moments()[0]
        return float(np.dot(self.values, self.weights))

    @property
    def sd(self) -> float:
        """Standard deviation, SI."""
        match self.kind:
            case "normal" | "lognormal":
                return float(self.sd_ or 0.0)
            case "uniform":
                return (self._high - self._low) / math.sqrt(12.0)
            case "triangular":
                a, b, c = self._low, self._high, float(self.mode or 0.0)
                return math.sqrt((a * a + b * b + c * c - a * b - a * c - b * c) / 18)
            case "truncated_normal":
                return self._truncated_moments()[1]
        mean = self.mean
        return math.sqrt(float(np.dot((np.asarray(self.values) - mean) ** 2, self.weights)))

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

        mean, sd = float(self.mean_ or 0.0), float(self.sd_ or 0.0)
        if self.kind == "normal" or sd == 0.0:
            return np.asarray(mean + sd * ndtri(u)) if sd else np.full(u.shape, mean)
        if self.kind == "lognormal":
            sigma2 = math.log1p((sd / mean) ** 2)
            return np.asarray(np.exp(math.log(mean) - sigma2 / 2 + math.sqrt(sigma2) * ndtri(u)))
        a, b = (self._low - mean) / sd, (self._high - mean) / sd
        if a > 0:  # mirror, so that the upper tail keeps its digits
            log_low, log_high = log_ndtr(-b), log_ndtr(-a)
            z = -ndtri_exp(log_low + np.log1p((1 - u) * np.expm1(log_high - log_low)))
        elif b < 0:
            log_low, log_high = log_ndtr(a), log_ndtr(b)
            z = ndtri_exp(log_low + np.log1p(u * np.expm1(log_high - log_low)))
        else:
            z = ndtri(ndtr(a) + u * (ndtr(b) - ndtr(a)))
        return np.asarray(np.clip(mean + sd * z, self._low, self._high))

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
        """Values at standard normal numbers, SI; for kinds that follow from them, without regard to bounds.

        The values take the place of the scores.
        """
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

    def as_dict(self) -> dict[str, object]:
        """Kind and numbers that are set."""
        named = {"mean": self.mean_, "sd": self.sd_, "low": self.low, "high": self.high, "mode": self.mode}
        result: dict[str, object] = {"kind": self.kind}
        result |= {key: value for key, value in named.items() if value is not None}
        if self.values:
            result |= {"values": list(self.values), "weights": list(self.weights)}
        return result

    @property
    def _low(self) -> float:
        return -math.inf if self.low is None else self.low

    @property
    def _high(self) -> float:
        return math.inf if self.high is None else self.high

    def _truncated_moments(self) -> tuple[float, float]:
        mean, sd = float(self.mean_ or 0.0), float(self.sd_ or 0.0)
        if sd == 0.0:
            return min(max(mean, self._low), self._high), 0.0
        from scipy.stats import truncnorm

        first, second = truncnorm.stats((self._low - mean) / sd, (self._high - mean) / sd, mean, sd, moments="mv")
        return float(first), math.sqrt(float(second))
