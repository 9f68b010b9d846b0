"""`Run`: what happened, measured or simulated, under glossary names, checked and frozen; long ones in fewer rows.

And a run without one fault that its log may have: another unit or sign, an inverted switch, a column that hangs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from missionsim.files import sha256
from missionsim.glossary import column_of
from missionsim.labels import ColumnData, Labels
from missionsim.physics import Array, Bools
from missionsim.runs.covariates import is_switch

if TYPE_CHECKING:
    from missionsim.logs.raw import Remark

_MEASURED = ("time_s", "power_<battery>_w", "current_<battery>_a", "energy_<battery>_wh")


@dataclass(frozen=True)
class Run:
    """One run, or a block of a long one; all arrays have shape (n,) and are read-only."""

    run: str
    """Name of the run: the file's name without its suffix."""
    columns: Mapping[str, ColumnData]
    """Glossary name (and any further name of the file) → float64 array in SI units, or `Labels` for text."""
    dt_s: Array
    """Time that each row stands for [s]: half-way to its neighbours (contract). The end rows reach as far outwards as
    inwards, but not before time zero. Computed before rows were left out, so a row's time stays its own."""
    power_w: Mapping[str, Array]
    """Battery → mean power around each row [W], from its power, voltage × current, or differenced energy."""
    fresh: Mapping[str, Bools | None]
    """Battery → True in the rows where the power was really refreshed; None where every row is."""
    power_from: Mapping[str, str]
    """Battery → ``power``, ``voltage*current`` or ``energy``."""
    source: str = ""
    """The file as the user gave it."""
    remarks: tuple[Remark, ...] = field(default=(), compare=False)
    """What was wrong, and what was done."""
    _: KW_ONLY
    begin_s: float = math.nan
    """When it began, in seconds since 1970; not a number where its log does not say."""
    whole: Mapping[str, ColumnData] | None = field(default=None, repr=False, compare=False)
    """Its columns with the rows that were left out within it, where there are such: without them in its file, the rows
    beside them would stand for their time."""

    def __post_init__(self) -> None:
        for name in ("columns", "power_w", "fresh", "power_from"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for data in (*self.columns.values(), *self.power_w.values(), *self.fresh.values(), self.dt_s):
            array = data.codes if isinstance(data, Labels) else data
            if array is not None:
                array.flags.writeable = False

    @property
    def time_s(self) -> Array:
        """Time from the start of the run [s]."""
        return self.number("time_s")

    @property
    def batteries(self) -> tuple[str, ...]:
        """Names of the batteries that were measured."""
        return tuple(self.power_w)

    def reading_s(self, battery: str) -> float:
        """How long a reading of a meter that is slower than the rows usually stays [s]; 0 where none does."""
        fresh = self.fresh.get(battery)
        return 0.0 if fresh is None or np.count_nonzero(fresh) < 2 else float(np.median(np.diff(self.time_s[fresh])))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.dt_s)

    @property
    def duration_s(self) -> float:
        """Time that the rows stand for, together [s]."""
        return float(self.dt_s.sum())

    def __len__(self) -> int:
        return self.rows

    @functools.cached_property
    def sha256(self) -> str:
        """SHA-256 of the source file; empty for a table made in memory."""
        return sha256(self.source) if self.source else ""

    def number(self, name: str) -> Array:
        """A numeric column, shape (n,); KeyError where it is not there."""
        data = self.columns[name]
        if isinstance(data, Labels):
            raise KeyError(f"{name} is text")
        return data

    def energy_wh(self, battery: str) -> float:
        """Energy that a battery delivered over the rows of the log [Wh]."""
        return float(self.power_w[battery] @ self.dt_s) / 3600.0

    def covariates(self, batteries: Collection[str] | None = None) -> dict[str, ColumnData]:
        """Columns that a model may depend on: all but time and the power, current and energy of its batteries."""
        found = {}
        for name, data in self.columns.items():
            column = column_of(name)
            others = column is not None and batteries is not None and column[1] not in batteries
            if column is None or column[0].name not in _MEASURED or (others and name != "time_s"):
                found[name] = data
        return found

    def rows_where(self, keep: Bools | slice) -> Run:
        """The same run with only the chosen rows; each keeps the time that it stood for."""
        columns = {name: data[keep] for name, data in self.columns.items()}
        power_w = {name: power[keep] for name, power in self.power_w.items()}
        rest = {name: None if fresh is None else fresh[keep] for name, fresh in self.fresh.items()}
        return replace(self, columns=columns, dt_s=self.dt_s[keep], whole=None, power_w=power_w, fresh=rest)


def row_durations(time_s: Array) -> Array:
    """Time that each row stands for: half-way to its neighbours, the end rows symmetric but not before time zero.

    `time_s` (shape (n,)): increasing, n ≥ 2 [s]. Gives an array of shape (n,): [s]; for evenly spaced rows that start
    half a step after zero the sum is n steps.
    """
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    first = time_s[0] - (middle[0] - time_s[0])
    if time_s[0] >= 0:
        first = max(first, 0.0)
    last = time_s[-1] + (time_s[-1] - middle[-1])
    return np.diff(np.r_[first, middle, last])


MOST_ROWS = 500_000
"""Rows of all runs together from which on they are averaged (an hour at 10 Hz has 36,000)."""
STEP_S = 1.0
_CYCLIC = frozenset({"heading_rad"})


class Bounded:
    """Averages runs as they come once all together have more than `MOST_ROWS` rows."""

    def __init__(self) -> None:
        self.rows = 0

    def __call__(self, run: Run) -> Run:
        """The run, averaged where it is one too many."""
        self.rows += run.rows
        return run if self.rows <= MOST_ROWS else coarser(run)

    def all(self, runs: Sequence[Run]) -> tuple[list[Run], str]:
        """Those that came before too, and in words what was done; nothing where the rows are few."""
        if self.rows <= MOST_ROWS:
            return list(runs), ""
        return [coarser(run) for run in runs], f"{self.rows:,} rows were averaged to {STEP_S:g} s"


def coarser(run: Run) -> Run:
    """A run in rows of about `STEP_S`, each the mean of its rows, weighted by time; texts are those of its middle.

    Rows that are longer already stay, and so does a run whose meter is slower than its rows, for the readings say when
    they were made.
    """
    if run.rows < 2 or float(np.median(run.dt_s)) > 0.5 * STEP_S or any(f is not None for f in run.fresh.values()):
        return run
    number = np.floor((run.time_s - run.time_s[0]) / STEP_S + 1e-6)
    begin = np.flatnonzero(np.diff(number, prepend=-1.0))
    middle = (begin + np.append(begin[1:], run.rows)) // 2

    def mean(values: Array) -> Array:
        known = np.isfinite(values)
        weight = run.dt_s * known
        seconds = np.add.reduceat(weight, begin)
        total = np.add.reduceat(np.where(known, values, 0.0) * weight, begin)
        return np.asarray(np.where(seconds > 0.0, total / np.where(seconds > 0.0, seconds, 1.0), np.nan))

    def column(name: str, data: ColumnData) -> ColumnData:
        return data[middle] if isinstance(data, Labels) or name in _CYCLIC else mean(data)

    columns, dt_s = {name: column(name, data) for name, data in run.columns.items()}, np.add.reduceat(run.dt_s, begin)
    return replace(run, columns=columns, dt_s=dt_s, power_w={name: mean(power) for name, power in run.power_w.items()})


SPEEDS = {3.6: "km/h", 2.2369: "mph", 3.2808: "ft/s", 100.0: "cm/s", 1000.0: "mm/s", 1.0 / 3.6: "m/s divided by 3.6"}
STANDS = 0.15
"""Part of a run over which a column must stand still to be looked at."""
LARGER = 1.5
"""Times the values of any other run, from which a column may be in another unit (assumed)."""


def larger(name: str, run: Run, others: Sequence[Run]) -> int:
    """1 where a column of a run is larger than in any other run, −1 where it is smaller, else 0."""
    sizes = np.array([np.quantile(np.abs(one.number(name)), (0.95, 0.99)) for one in others if name in one.columns])
    low, high = np.quantile(np.abs(run.number(name)), (0.95, 0.99))
    if not len(sizes):
        return 0
    return int(low > LARGER * sizes[:, 1].max()) - int(high < sizes[:, 0].min() / LARGER)


def divided(run: Run, name: str, factor: float) -> Run:
    """A run with a column divided by a factor; an acceleration that belongs to another speed goes."""
    gone = "accel_m_s2" if name == "speed_m_s" else ""
    columns = {own: data for own, data in run.columns.items() if own != gone}
    return replace(run, columns={**columns, name: run.number(name) / factor})


def mended(run: Run, others: Sequence[Run]) -> Iterator[tuple[str, Run]]:
    """A run without one fault that its log may have, and the fault in words."""
    for name, factors in _FACTORS.items():
        if name in run.columns:
            size = larger(name, run, others)
            for factor, words in factors.items():
                if (factor > 0.0 and (factor > 1.0) != (size > 0)) or size == 0 < factor:
                    continue
                yield f"{name} {words}", divided(run, name, factor)
    for name in filter(is_switch, run.columns):
        state = run.number(name)
        if {*np.unique(state).tolist()} == {0.0, 1.0}:
            inverted = replace(run, columns={**run.columns, name: 1.0 - state})
            yield f"{name} is 1 where it should be 0 (inverted?)", inverted
    for name in ("speed_m_s", "slope_rad", "yaw_rate_rad_s", *(f"power_{battery}_w" for battery in run.power_w)):
        if name not in run.columns:
            continue
        # the longest stretch of one value, where it is much of the run
        values = run.number(name)
        starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
        lengths = np.diff(np.r_[starts, len(values)])
        longest = int(np.argmax(lengths))
        if STANDS * len(values) < lengths[longest] < 0.95 * len(values):
            first, last = int(starts[longest]), int(starts[longest] + lengths[longest] - 1)
            keep = np.ones(run.rows, dtype=bool)
            keep[first : last + 1] = False
            since, till = run.time_s[first], run.time_s[last]
            yield f"{name} stands at {values[first]:.4g} from {since:.6g} to {till:.6g} s", run.rows_where(keep)


_FACTORS: Mapping[str, Mapping[float, str]] = {
    "slope_rad": {
        -1.0: "has the other sign",
        180.0 / np.pi: "is 57 or 100 times too large (degrees or per cent?)",
        100.0: "is 57 or 100 times too large (degrees or per cent?)",
    },
    "speed_m_s": {factor: f"is {factor:.3g} times too large ({unit}?)" for factor, unit in SPEEDS.items()},
    "yaw_rate_rad_s": {180.0 / np.pi: "is 57.3 times too large (degrees?)"},
    "accel_m_s2": {-1.0: "has the other sign", 9.81: "is 9.81 times too large (g?)"},
}
