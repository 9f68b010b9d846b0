"""What loggers write that was not measured then: numbers where they have none, and values of a slower topic again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from missionsim.physics import Array, Bools

_NINES = (999.0, 9999.0, 99999.0, 999999.0)
_CODES = np.unique([
    -1.0, *_NINES, *(-code for code in _NINES),
    *(code * scale for code in (32767.0, -32768.0, 65535.0) for scale in (1.0, 0.1, 0.01, 0.001)),
    2.0**31 - 1, -(2.0**31), 2.0**32 - 1,
])  # fmt: skip
"""Nines, and the ends of whole numbers, also scaled."""
_POINTED = (99.99, 999.9, 999.99, 9999.9)
_RARE = np.array([255.0, *_POINTED, *(-code for code in _POINTED)])
"""Codes that may as well be measured: nines with a point, and the end of a byte. They must be further off."""
_ALL = np.concatenate([_CODES, _RARE])
_ALIKE = 1e-7
"""Relative: numbers of four bytes miss a code by this at most."""
_FEW, _FAR, _LONE = 8, 0.5, 10.0
"""Values that a column has beside its codes, else it may be a count, unless it is far from nought; times their range
that a code lies beside them, and one that stands there once, in most rows or beside few values, or is rare (all
assumed)."""
_LASTS, _JUMPS = 2, 5.0
"""Rows that a code of -1, which lies near what is measured, lasts at most, and times the usual step of the others that
it jumps by (both assumed)."""
_TIMES, _GRAINS = 3, 2.5
"""Times that the only value below nought comes, and times the finest step of the others that it lies off the least of
them (both assumed)."""
_SAMPLE = 10_000
"""Values of a block of which the distinct ones are looked at."""

Found = list[tuple[float, int, int]]
"""Each code, its number of rows, its first row."""


@dataclass
class _Met:
    """Rows of a value that may be a code: the first, how many, in how many stretches."""

    first: int
    count: int = 0
    times: int = 0


@dataclass(kw_only=True)
class Tally:
    """What tells whether a column has codes for no value, block by block.

    A code is one of a list, exactly, again and again, and far from all other values, by half of their range; or -1 in
    single rows, with a jump before and after; or the only value below nought, again and again, where nought itself
    never comes. A reading at a limit has others near it.
    """

    rows: int = 0
    met: dict[float, _Met] = field(default_factory=dict)
    low: float = np.inf
    high: float = -np.inf
    least: float = np.inf
    """All three: of the values that are no code; the last of those from nought on."""
    distinct: set[float] = field(default_factory=set)
    below: set[float] = field(default_factory=set)
    """The least and the greatest value below nought, also -1 but no other code."""
    jumps: list[Array] = field(default_factory=list)
    steps: list[Array] = field(default_factory=list)
    """Both: to -1, and between the others."""
    grain: float = np.inf
    lasts: float = 0.0
    """Both, in blocks with only one value below nought: the finest step of the others, and the rows that one lasts."""
    last: float = np.nan

    def add(self, data: Array) -> None:
        """Take the next rows of the column, shape (n,)."""
        if not len(data):
            return
        with np.errstate(over="ignore", invalid="ignore"):
            whole = np.isfinite(data.sum())
        rest = data if whole else data[np.isfinite(data)]
        ones = data == -1.0
        rest = rest[rest != -1.0] if ones.any() else rest
        while len(rest):
            ends = np.array([rest.min(), rest.max()])
            codes = _ALL[_is(ends[:, None], _ALL).any(axis=0)]
            for code in codes:
                self._meet(float(code), _is(data, code))
                rest = rest[~_is(rest, code)]
            if not len(codes):
                self._measured(rest)
                break
        below = {float(value) for value in self._ends(rest[rest < 0.0] if self.low < 0.0 else rest[:0])}
        below |= {-1.0} if ones.any() else below
        if ones.any():
            self._meet(-1.0, ones)
            self.jumps.append(np.abs(np.diff(data, prepend=self.last))[ones & ~np.r_[False, ones[:-1]]])
            self.steps.append(np.abs(np.diff(rest)))
        if len(below) == 1 and len(self.below | below) == 1:
            (one,) = below
            if one != -1.0:
                self._meet(one, data == one)
            others = rest[rest >= 0.0]
            apart = np.diff(np.unique(others))
            self.grain = min(self.grain, float(apart.min()) if len(apart) else np.inf)
            self.lasts = max(self.lasts, len(others) / (1 + np.count_nonzero(np.diff(others))))
        self.below |= below
        self.rows, self.last = self.rows + len(data), float(data[-1])

    @staticmethod
    def _ends(values: Array) -> Array:
        return np.array([values.min(), values.max()]) if len(values) else values

    def _measured(self, rest: Array) -> None:
        """Take values that are no code."""
        self.low, self.high = min(self.low, float(rest.min())), max(self.high, float(rest.max()))
        self.least = min(
            self.least, float(rest.min()) if self.low >= 0.0 else float(rest[rest >= 0.0].min(initial=np.inf))
        )
        if len(self.distinct) < _FEW:
            self.distinct |= set(np.unique(rest[:_SAMPLE])[:_FEW].tolist())

    def _meet(self, code: float, rows: Bools) -> None:
        seen = self.met.setdefault(code, _Met(self.rows + int(np.argmax(rows))))
        seen.count += int(rows.sum())
        seen.times += int(np.count_nonzero(np.diff(np.r_[False, rows]) & rows))

    def found(self) -> Found:
        """The codes of the column."""
        coarse = len(self.distinct) > 2 and self.high - self.low < 0.5 * min(abs(self.low), abs(self.high))
        if len(self.distinct) < _FEW and not coarse:
            return []
        return [(code, seen.count, seen.first) for code, seen in sorted(self.met.items()) if self._is_code(code, seen)]

    def in_doubt(self) -> bool:
        """Whether the rows so far may hold a code, which those to come decide; -1 in a column that glides through it is
        none."""
        last = _jumps_far(self.jumps[-1:], self.steps[-1:])
        return last or any(code != -1.0 or self.below == {code} for code in self.met)

    def _is_code(self, code: float, seen: _Met) -> bool:
        # a limit of what is given back is the only value below nought too
        known = code == -1.0 or code in _ALL
        alone = known and self.below == {code} and self.least > 0.0 and self.least - code > _GRAINS * self.grain
        if alone and seen.times >= _TIMES and seen.count <= min(_LASTS * self.lasts * seen.times, 0.5 * self.rows):
            return True
        if code == -1.0:
            return 2 < seen.count <= _LASTS * seen.times and _jumps_far(self.jumps, self.steps)
        if code not in _ALL:
            return False
        far = max(self.low - code, code - self.high)
        # in most rows, or beside few values, it may be the limit of a meter or a state
        usual = 1 < seen.count < 0.5 * self.rows and code in _CODES and len(self.distinct) >= _FEW
        return far > (self.high - self.low) * (_FAR if usual else _LONE)


def _is(data: Array, code: Array | float) -> Bools:
    """Where numbers are a code, up to how they are kept."""
    return np.isclose(data, code, rtol=_ALIKE, atol=0.0)


def _jumps_far(jumps: list[Array], steps: list[Array]) -> bool:
    """Whether jumps are far wider than steps mostly are."""
    known = [one[np.isfinite(one)] for one in (np.concatenate([[], *jumps]), np.concatenate([[], *steps]))]
    return all(map(len, known)) and float(np.median(known[0])) > _JUMPS * float(np.quantile(known[1], 0.95))


def without(data: Array, found: Found) -> Array:
    """A column with its codes as NaN; the same array where it has none."""
    for code, _, _ in found:
        data = np.where(_is(data, code), np.nan, data)
    return data


_SLOW_SHARE = 0.3
"""Share of repeated neighbours above which a column may come from a slower topic."""
_SLOWEST_S = 15.0
"""A refresh slower than this is not a topic's rate but a value that stays."""
_EVEN = 0.5
"""Part of the time that rows about a usual step apart must make: else a row is written when something happens, such as
the two ends of each interval of a simulation, which say nothing of a rate."""
_PLATEAUS = 8
"""Of no more distinct values, equal ones are plateaus."""
_SHORT = 0.05
"""Part of the readings of a rounded topic that may be shorter than its period."""
_OF_ALL = 0.9
"""Part of the time of all runs of a meter in which a slower topic must be seen to be one (in worlds with coarse meters
that few runs showed, rows as they are predicted others better: 2.2 W in place of 2.9)."""
_ROUNDED = 10.0
"""A meter that usually moves by fewer of its steps reads the same again now and then."""


@dataclass(frozen=True)
class Refresh:
    """How often a column really changes."""

    fresh: Bools
    """Rows with a new value. Shape (n,)."""
    period_s: float
    """Typical time between them [s]."""


def refreshes(values: Array, time_s: Array, period_s: float | None = None) -> Refresh | None:
    """Find out whether a column repeats the values of a slower topic.

    `values`, `time_s`: shape (n,). `period_s`: how often it is refreshed, where that is known. Gives None where the
    column changes in most rows, or stays for other reasons: at a plateau, or standing still.

    A slower topic shows as runs of equal values of nearly equal length whose values hardly ever come back; a coarse
    meter or a robot that stands still gives runs of every length, or few distinct values. A slower topic that is
    rounded reads the same again as well, at once or later: it was refreshed all the same, and hardly any reading of it
    is shorter than its period.
    """
    n = len(values)
    if n < 20:
        return None
    if float(np.ptp(values)) <= 1e-6 * float(np.abs(values).max()):
        return None  # a constant with rounding noise
    change = np.r_[True, values[1:] != values[:-1]]
    starts = np.flatnonzero(change)
    if len(starts) < 5 or len(starts) > (1 - _SLOW_SHARE) * n:
        return None
    every = np.diff(np.r_[starts, n])
    lengths = every[1:-1]
    alive = values[starts][1:-1] != 0.0
    if alive.sum() < 4:
        return None
    lengths = lengths[alive]
    steps_s = np.diff(time_s[: min(n, 20000)])
    step_s = float(np.median(steps_s))
    if steps_s[steps_s < 2.0 * step_s].sum() < _EVEN * steps_s.sum():
        return None
    typical = float(np.median(lengths)) if period_s is None else period_s / step_s
    distinct = len(np.unique(values[starts[:2000]]))
    regular = np.abs(lengths - typical) <= max(1.0, 0.35 * typical)
    if period_s is None and (distinct < 0.25 * min(len(starts), 2000) or np.mean(regular) < 0.6):
        typical = float(np.median(lengths[lengths <= 1.5 * np.quantile(lengths, 0.25)]))
        whole = np.abs(lengths - np.round(lengths / typical) * typical) <= max(1.0, 0.15 * typical)
        if distinct <= _PLATEAUS or np.mean(lengths < 0.65 * typical) > _SHORT or np.mean(whole) < 0.6:
            return None
    if typical < 2 or typical * step_s > _SLOWEST_S:
        return None
    grain = float(np.min(np.diff(np.unique(values))))  # the least difference between two readings
    rounded = float(np.median(np.abs(np.diff(values[starts])))) < _ROUNDED * grain
    if period_s is None:  # half a second is two rows and three by turns in rows of a fifth
        typical = float(np.mean(lengths[np.abs(lengths - typical) <= max(1.0, 0.35 * typical)]))
        few = lengths[lengths < 4.5 * typical]
        for _ in range(3):
            typical = float(few.sum() / np.maximum(np.round(few / typical), 1.0).sum())
    for start, length in zip(starts, every, strict=True) if rounded else ():
        if length * step_s < _SLOWEST_S:
            again = start + np.round(np.arange(1, round(length / typical)) * typical).astype(int)
            change[again] = True
    return Refresh(change, typical * step_s)


def of_one_meter(
    masks: Sequence[Bools | None], values: Sequence[Array], times_s: Sequence[Array]
) -> list[Bools | None]:
    """Rows of each run in which a meter was really refreshed; None where every row is.

    Where some runs of one meter show a slower topic and others do not, as most of the time says: the readings of a
    coarse one come back by chance, and half a refresh between runs is taken for their clocks.
    `masks`: what each run shows alone; `values`, `times_s`: its power [W] and time [s], shape (n,).
    """
    seconds = [float(time_s[-1] - time_s[0]) for time_s in times_s]
    held = [(mask, time_s) for mask, time_s in zip(masks, times_s, strict=True) if mask is not None and mask.sum() > 1]
    seen_s = sum(s for s, mask in zip(seconds, masks, strict=True) if mask is not None)
    if seen_s < _OF_ALL * sum(seconds) or not held:
        return [None] * len(masks)
    every_s = [np.diff(time_s[mask]) for mask, time_s in held]
    period_s = float(np.median([np.mean(one[one < 1.6 * np.median(one)]) for one in every_s]))
    found: list[Bools | None] = []
    for mask, value, time_s in zip(masks, values, times_s, strict=True):
        seen = refreshes(value, time_s, period_s) if mask is None else None
        found.append(mask if seen is None else seen.fresh)
    return found
