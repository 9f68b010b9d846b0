"""The interval table: what happened, exactly between events, with covariates that are constant or linear in time.

The energy of every term in every interval: exact where power is constant, Gauss–Kronrod with checked error elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from missionsim.effects.covariates import Columns, Labels, Value, is_clock
from missionsim.effects.model import PowerModel, TermKey
from missionsim.physics import Array, Bools, Int64s, Ints
from missionsim.physics.lag import GOES_ON, SETTLED, Lagged, halving_helps


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
    segment: Int64s = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Segment of the mission; -1 before and after. Shape (n,)."""
    lags: Mapping[str, Array] = field(default_factory=dict)
    """First-order lags of a model at the start of each interval, where these are known (`with_lags`). Shape (n,)."""

    def __len__(self) -> int:
        return int(np.shape(self.duration_s)[-1])

    @property
    def edges_s(self) -> Array:
        """Starts of the intervals, and the end of the last. Shape (n + 1,), or (0,) without any."""
        return np.append(self.start_s, self.start_s[-1:] + self.duration_s[-1:])

    def covariates(self) -> Columns:
        """Covariates at the start of the intervals."""
        return {**self.columns, **self.lags}

    def at(self, index: Ints, offset_s: Array, memory: frozenset[str] | None = None) -> Columns:
        """Covariates of the intervals `index` at times after their start.

        `index`: shape (m,). `offset_s` (shape (m, q)): times after the start of each of them. `memory`: the clocks that
        are read (see `changing`); the others stay as at the start. All by default. Gives arrays of shape (m, q), or (m,
        1) of what does not change; texts as `Labels` with codes of shape (m, 1).
        """
        cov: Columns = {}
        for name, value in self.columns.items():
            if isinstance(value, Labels):
                cov[name] = Labels(value.codes[index][:, None], value.names)
            else:
                cov[name] = np.asarray(value, dtype=float)[index][:, None]
        for name in self.rates:
            if name in cov and (memory is None or name in memory or not is_clock(name)):
                change = self.rates[name][index]
                if change.any():
                    cov[name] = cov[name] + change[:, None] * offset_s
        return cov

    def changing(self, model: PowerModel) -> Bools:
        """Intervals in which something that matters changes with time, shape (n,): with lags in all; clocks
        (``moving_time_s`` …) that no term of the model reads are ignored."""
        result = np.full(len(self), bool(model.lags))
        for name in self.rates:
            if name in model.memory or not is_clock(name):
                result |= np.asarray(self.rates[name]) != 0.0
        return result

    def ways_m(self) -> Array:
        """Way driven in each interval [m], forward and sideways."""
        time, none = self.duration_s, np.zeros(len(self))

        def along(name: str) -> Any:
            return self.columns.get(name, none) * time + 0.5 * self.rates.get(name, none) * time**2

        return np.asarray(np.hypot(along("speed_m_s"), along("lateral_speed_m_s")))

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
            {name: values[cut] for name, values in self.lags.items()},
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


RELATIVE_TOLERANCE = 1e-11

# Gauss–Kronrod nodes and weights on [-1, 1], 7 and 15 points (Kronrod 1965; QUADPACK, Piessens et al. 1983)
_NODES = np.array([
    0.9914553711208126, 0.9491079123427585, 0.8648644233597691, 0.7415311855993945,
    0.5860872354676911, 0.4058451513773972, 0.20778495500789848, 0.0,
])  # fmt: skip
_KRONROD = np.array([
    0.022935322010529224, 0.06309209262997856, 0.10479001032225019, 0.14065325971552592,
    0.1690047266392679, 0.19035057806478542, 0.20443294007529889, 0.20948214108472782,
])  # fmt: skip
_GAUSS = np.array([0.1294849661688697, 0.27970539148927664, 0.3818300505051189, 0.4179591836734694])
NODES = np.concatenate([-_NODES, _NODES[-2::-1]])
WEIGHTS = np.concatenate([_KRONROD, _KRONROD[-2::-1]])
GAUSS_WEIGHTS = np.zeros(15)
GAUSS_WEIGHTS[1::2] = np.concatenate([_GAUSS, _GAUSS[-2::-1]])
_GAP = 1.0 - float(NODES[-1])
_ENDS = np.outer([-1.0, 1.0], 1.0 - np.array([1e-7, 0.125 * _GAP])).ravel()
"""More samples beyond the outermost nodes, which see no kink there; not at the very ends, where a power may jump."""
SAMPLES = np.concatenate([NODES, _ENDS])
"""Where a power is asked for within an interval, on [-1, 1]."""


# values of the polynomial through the nodes at the ends: barycentric (Berrut and Trefethen 2004)
_APART = NODES[:, None] - NODES[None, :] + np.eye(len(NODES))
_TERMS = (1.0 / np.prod(_APART, axis=1))[:, None] / (_ENDS[None, :] - NODES[:, None])
_TO_ENDS = np.asarray(_TERMS / _TERMS.sum(axis=0))
_KINK = 0.25 * _GAP
"""A kink beyond the outermost node that moves the power at the end by 1 moves the mean by this much at most."""
_MEAN = np.append(0.5 * WEIGHTS, np.zeros(len(_ENDS)))
_RULES = np.column_stack([
    _MEAN, np.append(0.5 * GAUSS_WEIGHTS, np.zeros(len(_ENDS))) - _MEAN, np.vstack([-_TO_ENDS, np.eye(len(_ENDS))])
])  # fmt: skip
"""Of powers at `SAMPLES`: mean by the Kronrod rule; the Gauss rule less that: what is not smooth between the nodes; and
how far the ends are from the polynomial: times `_KINK` a bound of what a kink beyond the outermost nodes changes."""


def integrate(
    model: PowerModel, timeline: Timeline, values: Mapping[str, Value] | None = None, tolerance: float | None = None
) -> dict[str, dict[TermKey, Array]]:
    """Energy of each term in each interval.

    `timeline`: with arrays of shape (n,). `values`: parameters that differ from the model's, scalars or of shape (n,).
    `tolerance`: relative error that will do; then the caller sees to it that no transient was missed.
    Gives battery → term key → energy [J], shape (n,). Impulses (starts from rest) are in the interval they begin.
    """
    count = len(timeline)
    energies: dict[str, dict[TermKey, Array]] = {}
    timeline = with_lags(model, timeline, values)
    cov = timeline.covariates()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the engine refuses what is not finite
        for battery, terms in model.evaluate(cov, values).items():
            energies[battery] = {key: power * timeline.duration_s for key, power in terms.items()}
    index = np.flatnonzero(timeline.changing(model) & (timeline.duration_s > 0.0))
    if index.size:
        length = timeline.duration_s[index]
        offset = np.zeros(index.size)
        if tolerance is None and (model.memory or model.lags):
            # begun with 1, 1, 2, 4, 8 … s where a term may fade after the start: a quadrature over hours would not see
            # a transient of seconds at their beginning, nor notice that it did not
            cuts = [
                np.concatenate([[0.0], 2.0 ** np.arange(max(0, np.ceil(np.log2(max(t, 1.0))))), [t]]) for t in length
            ]
            lengths = [np.diff(cut) for cut in cuts]
            index = np.repeat(index, [len(one) for one in lengths])
            offset, length = np.concatenate([cut[:-1] for cut in cuts]), np.concatenate(lengths)
        _quadrature(model, timeline, values or {}, index, offset, length, energies, tolerance or RELATIVE_TOLERANCE)
    for key, joules in model.impulses(cov, values).items():
        energies[key.battery][key] = energies[key.battery][key] + np.broadcast_to(joules, (count,))
    return energies


def _of_rows(values: Mapping[str, Any], index: Ints) -> dict[str, Any]:
    return {name: value[index][:, None] if np.ndim(value) else value for name, value in values.items()}


def with_lags(
    model: PowerModel,
    timeline: Timeline,
    values: Mapping[str, Value] | None = None,
    begin: Mapping[str, Array] | None = None,
) -> Timeline:
    """A timeline with the lags that a model reads.

    They begin settled, and so they do where an interval does not begin when the one before ends. `begin` (shape (n,)):
    what is known of each where an interval begins; not a number elsewhere.
    """
    if timeline.lags or not model.lags or not len(timeline):
        return timeline
    ends = timeline.start_s + timeline.duration_s
    apart = np.abs(timeline.start_s[1:] - ends[:-1]) > 1e-9 * (1.0 + np.abs(ends[:-1]))
    start = np.append(SETTLED, np.where(apart, SETTLED, GOES_ON))
    known = {name: (begin or {}).get(name, start) for name in model.lags}
    begins = {name: np.where(np.isnan(given), start, given) for name, given in known.items()}
    found = _solved(model, timeline, np.arange(len(timeline)), values or {}, begins)
    return replace(timeline, lags={name: lag.start for name, lag in found.items()})


def _solved(
    model: PowerModel, line: Timeline, which: Ints, values: Mapping[str, Any], begin: Mapping[str, Array]
) -> dict[str, Lagged]:
    """The lags that a model reads over some intervals. `begin`: of each lag, what it is where each interval begins, or
    how that follows."""
    length = line.duration_s[which]

    def made(name: str) -> Lagged:
        def signal(index: Ints, seconds: Array) -> Array:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                x = model.lagging(name, line.at(which[index], seconds), _of_rows(values, which[index]))
            return np.broadcast_to(np.asarray(x, dtype=float), seconds.shape)

        tau_s = np.ravel(model.time_constant(name, _of_rows(values, which)))
        return Lagged(signal, length, np.broadcast_to(tau_s, len(length)), begin[name])

    return {name: made(name) for name in model.lags}


def within(
    model: PowerModel, line: Timeline, index: Ints, seconds: Array, values: Mapping[str, Value] | None = None
) -> Columns:
    """`Timeline.at` for a model: with the clocks and the lags that it reads."""
    cov = line.at(index, seconds, model.memory)
    if model.lags:
        which, rows = np.unique(index, return_inverse=True)
        begin = {name: start[which] for name, start in line.lags.items()}
        cov |= {name: lag(rows, seconds) for name, lag in _solved(model, line, which, values or {}, begin).items()}
    return cov


def _quadrature(
    model: PowerModel,
    timeline: Timeline,
    values: Mapping[str, Any],
    index: Ints,
    offset: Array,
    length: Array,
    energies: dict[str, dict[TermKey, Array]],
    tolerance: float,
) -> None:
    """Put the integrals over pieces of intervals in place of the constant powers' energies, for terms that change.

    Pieces whose error is too large are halved and tried again. `index`, `offset`, `length` (shape (m,)): interval,
    start within it and length of each piece.
    """
    depth = 0
    varying: Collection[TermKey] = ()  # the terms that change within some of the pieces, at depths above 0
    while index.size:
        half = 0.5 * length
        times = offset[:, None] + half[:, None] * (SAMPLES + 1.0)
        powers = model.evaluate(within(model, timeline, index, times, values), _of_rows(values, index))
        bad = np.zeros(index.size, dtype=bool)
        parts: dict[TermKey, Array] = {}
        for terms in powers.values():
            scale = np.zeros(index.size)
            off = np.zeros(index.size)
            for key, power in terms.items():
                watts = np.asarray(power)
                if key not in varying and (depth or watts.ndim < 2 or watts.shape[1] == 1):
                    scale += np.abs(watts[:, 0] if watts.ndim == 2 else np.mean(watts))
                    continue
                with np.errstate(over="ignore", invalid="ignore"):
                    whole = np.broadcast_to(watts, times.shape)
                    found = whole @ _RULES
                    parts[key] = length * found[:, 0]
                    scale += np.abs(whole) @ _MEAN
                    off += np.maximum(np.abs(found[:, 1]), _KINK * np.abs(found[:, 2:]).max(axis=1))
            bad |= off > tolerance * scale
        if not halving_helps(depth, index.size, len(timeline)):
            bad[:] = False
        good = ~bad
        for key, joules in parts.items():
            target = energies[key.battery][key]
            if depth == 0:
                target[index] = 0.0
            np.add.at(target, index[good], joules[good])
        again, start, piece = index[bad], offset[bad], half[bad]
        index, offset = np.concatenate([again, again]), np.concatenate([start, start + piece])
        length, depth, varying = np.concatenate([piece, piece]), depth + 1, parts.keys()
