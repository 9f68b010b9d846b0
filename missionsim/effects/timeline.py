"""The interval table: what happened, exactly between events, with covariates that are constant or linear in time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Columns, Labels, Value, is_text
from missionsim.physics import Array


@dataclass(frozen=True)
class Timeline:
    """Intervals of one run, in order of time."""

    start_s: Array
    duration_s: Array
    """Both: start and length of each interval. Shape (..., n)."""
    columns: Mapping[str, Any]
    """Covariate at the start of each interval: number arrays of shape (..., n) or `Labels` of n."""
    rates: Mapping[str, Array] = field(default_factory=dict)
    """Change per second of a covariate inside the interval (speed in a ramp, ``moving_time_s``); 0 where absent."""
    segment: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Segment of the mission; -1 before and after. Shape (n,)."""
    constants: Mapping[str, Any] = field(default_factory=dict)
    """Scalars that hold for the whole run (``mass_kg`` of the body alone, ``regeneration``)."""

    def __len__(self) -> int:
        return int(np.shape(self.duration_s)[-1])

    def covariates(self) -> Columns:
        """Covariates at the start of the intervals."""
        return {**self.constants, **self.columns}

    def at(self, index: NDArray[np.intp], offset_s: Array, memory: frozenset[str] | None = None) -> Columns:
        """Covariates of the intervals `index` at times after their start.

        `index`: shape (m,). `offset_s` (shape (m, q)): times after the start of each of them. `memory`: the clocks that
        are read (see `changing`); the others stay as at the start. All by default. Gives arrays of shape (m, q), or (m,
        1) of what does not change; texts as `Labels` with codes of shape (m, 1).
        """
        cov: Columns = dict(self.constants)
        for name, value in self.columns.items():
            if isinstance(value, Labels):
                cov[name] = Labels(value.codes[index][:, None], value.names)
            elif is_text(value):
                cov[name] = np.asarray(value)[index][:, None]
            else:
                cov[name] = np.asarray(value, dtype=float)[index][:, None]
        for name in self.rates:
            if name in cov and (memory is None or name in memory or not _is_clock(name)):
                change = self.rates[name][index]
                if change.any():
                    cov[name] = cov[name] + change[:, None] * offset_s
        return cov

    def changing(self, memory: frozenset[str]) -> NDArray[np.bool_]:
        """Intervals in which something that matters changes with time, shape (n,).

        `memory`: the clocks (``moving_time_s`` …) that some term of the model reads; the others are ignored.
        """
        result = np.zeros(len(self), dtype=bool)
        for name in self.rates:
            if name in memory or not _is_clock(name):
                result |= np.asarray(self.rates[name]) != 0.0
        return result

    def ways_m(self) -> NDArray[np.float64]:
        """Way driven in each interval [m], forward and sideways."""
        time, cov, rates = self.duration_s, self.columns, self.rates
        if "speed_m_s" not in cov:
            return np.zeros(len(self))
        ahead = cov["speed_m_s"] * time + 0.5 * rates["speed_m_s"] * time**2
        aside = cov["lateral_speed_m_s"] * time + 0.5 * rates["lateral_speed_m_s"] * time**2
        return np.asarray(np.hypot(ahead, aside))

    @staticmethod
    def joined(lines: Sequence[Timeline]) -> Timeline:
        """The intervals of several timelines with the same columns, one after the other."""

        def stacked(parts: list[Any]) -> Any:
            if isinstance(parts[0], Labels):
                return Labels.of([text for part in parts for text in part.texts()])
            return np.concatenate(parts)

        first = lines[0]
        return Timeline(
            np.concatenate([line.start_s for line in lines]),
            np.concatenate([line.duration_s for line in lines]),
            Lazily(first.columns, lambda name: stacked([line.columns[name] for line in lines])),
            Lazily(first.rates, lambda name: stacked([line.rates[name] for line in lines])),
            np.concatenate([line.segment for line in lines]),
            first.constants,
        )

    def part(self, first: int, stop: int) -> Timeline:
        """Some intervals that follow each other."""
        cut = slice(first, stop)
        return Timeline(
            self.start_s[cut],
            self.duration_s[cut],
            Lazily(self.columns, lambda name: self.columns[name][cut]),
            Lazily(self.rates, lambda name: self.rates[name][cut]),
            self.segment[cut],
            self.constants,
        )


class Lazily(Mapping[str, Any]):
    """Values by name, made when asked for: most columns never are."""

    def __init__(self, names: Collection[str], make: Callable[[str], Value | Labels]) -> None:
        self._names, self._make = names, make

    def __getitem__(self, name: str) -> Any:
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _is_clock(name: str) -> bool:
    return name == "moving_time_s" or name.startswith("on_time_")
