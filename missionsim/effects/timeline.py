"""The interval table: what happened, exactly between events, with covariates that are constant or linear in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Labels, is_text


@dataclass(frozen=True)
class Timeline:
    """Intervals of one run, in order of time.

    Attributes
    ----------
    start_s, duration_s : ndarray, shape (..., n)
        Start and length of each interval.
    columns : mapping
        Covariate at the start of each interval: number arrays of shape (..., n) or `Labels` of n.
    rates : mapping
        Change per second of a covariate inside the interval (speed in a ramp, ``moving_time_s``); 0 where absent.
    segment : ndarray of int, shape (n,)
        Segment of the mission; -1 before and after.
    constants : mapping
        Scalars that hold for the whole run (``mass_kg`` of the body alone, ``regeneration``).
    """

    start_s: NDArray[np.float64]
    duration_s: NDArray[np.float64]
    columns: Mapping[str, Any]
    rates: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    segment: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    constants: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(np.shape(self.duration_s)[-1])

    def covariates(self, index: NDArray[np.intp] | slice | None = None) -> dict[str, Any]:
        """Covariates at the start of the intervals `index` (all by default)."""
        if index is None:
            return {**self.constants, **self.columns}
        picked = {name: v[index] if is_text(v) else np.asarray(v)[..., index] for name, v in self.columns.items()}
        return {**self.constants, **picked}

    def at(
        self, index: NDArray[np.intp], offset_s: NDArray[np.float64], memory: frozenset[str] | None = None
    ) -> dict[str, Any]:
        """Covariates of the intervals `index` at times after their start.

        Parameters
        ----------
        index : ndarray of int, shape (m,)
        offset_s : ndarray, shape (m, q)
            Times after the start of each of them.
        memory : frozenset of str, optional
            The clocks that are read (see `changing`); the others stay as at the start. All by default.

        Returns
        -------
        dict
            Arrays of shape (m, q), or (m, 1) of what does not change; texts as `Labels` with codes of shape (m, 1).
        """
        cov: dict[str, Any] = dict(self.constants)
        for name, value in self.columns.items():
            if isinstance(value, Labels):
                cov[name] = Labels(value.codes[index][:, None], value.names)
            elif is_text(value):
                cov[name] = np.asarray(value)[index][:, None]
            else:
                cov[name] = np.asarray(value, dtype=float)[index][:, None]
        for name, rate in self.rates.items():
            if name in cov and (memory is None or name in memory or not _is_clock(name)):
                change = rate[index]
                if change.any():
                    cov[name] = cov[name] + change[:, None] * offset_s
        return cov

    def changing(self, memory: frozenset[str]) -> NDArray[np.bool_]:
        """Intervals in which something that matters changes with time, shape (n,).

        Parameters
        ----------
        memory : frozenset of str
            The clocks (``moving_time_s`` …) that some term of the model reads; the others are ignored.
        """
        result = np.zeros(len(self), dtype=bool)
        for name, rate in self.rates.items():
            if name in memory or not _is_clock(name):
                result |= np.asarray(rate) != 0.0
        return result

    def part(self, first: int, stop: int) -> Timeline:
        """Some intervals that follow each other."""
        cut = slice(first, stop)
        return Timeline(
            self.start_s[cut],
            self.duration_s[cut],
            Lazily(self.columns, lambda value: value[cut]),
            Lazily(self.rates, lambda rate: rate[cut]),
            self.segment[cut],
            self.constants,
        )


class Lazily(Mapping[str, Any]):
    """Values of another mapping, or of names, as a function of them; made when asked for: most columns never are."""

    def __init__(self, of: Mapping[str, Any], make: Callable[[Any], Any]) -> None:
        self._of, self._make = of, make

    def __getitem__(self, name: str) -> Any:
        return self._make(self._of[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._of)

    def __len__(self) -> int:
        return len(self._of)


def _is_clock(name: str) -> bool:
    return name == "moving_time_s" or name.startswith("on_time_")
