"""Repairs that keep a log usable: time put in order, missing values filled where that is safe; each one is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.numerals import counted
from missionsim.physics import Array, Bools, Int64s

_SLOW_QUANTITIES = ("temp_ambient_c", "temp_motor_c", "payload_kg", "access_point_distance_m", "cpu_freq_hz")
_SPARSE = 0.5
"""A column missing in more than this share of rows comes from a slower topic written without repeats."""
_FILLED = "filled where neighbours are near"
_OUTLIER_SHARE = 0.05
"""Fewer values than this share out of range are single bad readings; more are a wrong unit."""
_OUTLANDISH = 1e9
"""So many times beyond the limit is no wrong unit but nonsense, whatever its share."""
_DROWNING = 1e100
"""Larger numbers overflow when they are squared and summed."""
_REORDER_S = 2.0
"""Rows out of order by less than this are sorted; more means that the clock was set or that runs were joined."""
_STRAY = 0.002
"""So few rows are no second run, but stamps that a logger wrote wrong (assumed)."""
_CLASHING = 0.1
"""More rows than this part without a time, out of order, or with another's time and other values are no jitter of a
clock, but times too coarse for the rows or two recordings in one file (assumed)."""


@dataclass
class Rows:
    """A table under repair: columns, the row of the file that each row came from, and the remarks so far."""

    raw: RawTable
    columns: dict[str, ColumnData]
    row: Int64s
    remarks: list[Remark]
    dt: Array | None = None
    """Time that each row stands for [s], once time is in order."""
    whole: tuple[dict[str, ColumnData], Int64s] | None = None
    """Columns, and `row`, before rows that lack a value were left out."""

    @property
    def time(self) -> Array:
        """Time of the rows [s]."""
        return np.asarray(self.columns["time_s"])

    def number(self, name: str) -> Array | None:
        """A column of numbers; None where there is none of that name, or one of texts."""
        data = self.columns.get(name)
        return None if isinstance(data, Labels) else data

    def take(self, chosen: Bools | Int64s) -> None:
        """Keep or reorder rows."""
        self.columns = {name: data[chosen] for name, data in self.columns.items()}
        self.row = self.row[chosen]
        if self.dt is not None:
            self.dt = self.dt[chosen]

    def remark(
        self,
        kind: str,
        column: str,
        message: str,
        action: str,
        severity: str = "warning",
        at: int | Bools | None = None,
        count: int = 0,
    ) -> None:
        """Add a remark; `at`: the row (of this table) where it begins, or a mask of the rows, which counts them."""
        row = int(np.argmax(at)) if isinstance(at, np.ndarray) else at
        count = int(np.sum(at)) if isinstance(at, np.ndarray) else count
        line = self.raw.line(int(self.row[row])) if row is not None and len(self.row) else 0
        self.remarks.append(Remark(kind, column, message, action, severity, line, count))


def order_time(rows: Rows) -> None:
    """Make time finite, increasing and counted from the start of the run. Raises InputError: fewer than two rows; a
    time that restarts; a unit that is plainly not the second."""
    file = rows.raw.file
    finite = np.isfinite(rows.time)
    if not finite.all():
        told = f"{counted(int((~finite).sum()), 'row')} without a time"
        rows.remark("missing", "time_s", told, "they were left out", _severity(float(np.mean(~finite))), ~finite)
        rows.take(finite)
    if len(rows.time) < 2:
        told = f"the log has {counted(len(rows.time), 'row')} with a time"
        raise InputError(Fault(file, 0, 0, told, allowed="at least two"))
    if (late := out_of_order(rows.time, file, lambda row: rows.raw.line(int(rows.row[row])))) is not None:
        rows.remarks.append(late)
        rows.take(np.argsort(rows.time, kind="stable"))
    if (np.diff(rows.time) == 0).any():
        _merge_duplicates(rows)
    if len(rows.time) < 2:
        raise InputError(Fault(file, 0, 0, "all rows have the same time", path="time_s", allowed="at least two times"))
    if all(remark.kind != "time_backwards" for remark in rows.remarks):  # rows sorted by wrong times jump as well
        refuse_turns(rows.columns, file, rows.raw.line(int(rows.row[0])))
    step = np.diff(rows.time)
    typical = float(np.median(step))
    wide = step > max(5 * typical, typical + 0.5)
    if wide.any():
        longest = int(np.argmax(step))
        count = int(wide.sum())
        told = f"{counted(count, 'gap')}, the longest {step[longest]:.3g} s after"
        told += f" {rows.time[longest]:.6g} s (usual step {typical:.3g} s)"
        action = "the rows on both sides stand for the time between them (diagnose leaves it out)"
        rows.remark("gap", "time_s", told, action, "warning", longest + 1, count)


_ANEW = 10.0
"""A counter that falls in one row by so many times what it ever rises by in one, and mostly moves by, begins anew
(assumed): braking lowers it by less."""


def without_resets(values: Array) -> tuple[Array, Int64s]:
    """A counter counted on where it begins anew, in such a row by what it moves by in the rows beside; and these rows.
    `values`: shape (n,)."""
    known = np.flatnonzero(np.isfinite(values))
    step = np.diff(values[known])
    moved = np.abs(step[step != 0])
    if len(moved) < 10:
        return values, known[:0]
    anew = np.flatnonzero(-step > _ANEW * max(float(step.max()), float(np.quantile(moved, 0.9))))
    if not len(anew):
        return values, anew
    beside = np.delete(step, anew)
    step[anew] = np.interp(anew - np.arange(len(anew)) - 0.5, np.arange(len(beside)), beside)
    result = values.copy()
    result[known[1:]] = values[known[0]] + np.cumsum(step)
    return result, known[anew + 1]


def count_on(columns: dict[str, ColumnData], line_of: Callable[[int], int]) -> list[Remark]:
    """Count on each counter of energy that begins anew, in place; gives what is told. `line_of`: as `out_of_order`."""
    told = []
    for name, data in columns.items():
        if not isinstance(data, Labels) and (found := column_of(name)) and found[0].name == "energy_<battery>_wh":
            columns[name], anew = without_resets(data)
            if len(anew):
                message = f"the counter begins anew {counted(len(anew), 'time')}, first from {data[anew[0] - 1]:.6g} Wh"
                action = "counted on, over that row by what the rows beside it took"
                told.append(Remark("counter", name, message, action, "warning", line_of(int(anew[0])), len(anew)))
    return told


def out_of_order(time_s: Array, file: str, line_of: Callable[[int], int]) -> Remark | None:
    """What is told of finite times that run backwards, where their rows are to be sorted; None where none does.

    `line_of`: line of the file of a row. Raises InputError: a time that restarts, so that rows of two runs would mix.
    """
    step = np.diff(time_s)
    back = step < 0
    if not back.any():
        return None
    count, jump = int(back.sum()), float(-step.min())
    typical = float(np.median(np.abs(step)))
    early = np.maximum.accumulate(time_s) > time_s
    ahead = np.minimum.accumulate(time_s[::-1])[::-1] < time_s
    strays = min(int(early.sum()), int(ahead.sum()))
    if jump > max(_REORDER_S, 20 * typical) and strays > max(_STRAY * len(time_s), 1):
        worst = int(np.argmin(step)) + 1
        before, after = (f"{time_s[row]:.6g}" for row in (worst - 1, worst))
        told = f"time runs backwards by {jump:.6g} s, from {before} s to {after} s"
        got = f"{after} after {before}" + (f", {count} such places" if count > 1 else "")
        hint = "two runs in one file are split by a map with runs: {restart: true}"
        raise InputError(Fault(file, line_of(worst), 0, told, "time_s", got, "increasing times, one run a file", hint))
    told = f"time runs backwards in {counted(count, 'place')}, by up to {jump:.3g} s"
    done, line = "the rows were sorted by time", line_of(int(np.argmax(back)) + 1)
    return Remark("time_backwards", "time_s", told, done, _severity(count / len(step)), line, count)


def _severity(share: float) -> str:
    """How grave it is that a share of the rows has a wrong time: a few rows cost no run."""
    return "error" if share > _CLASHING else "warning"


def _merge_duplicates(rows: Rows) -> None:
    first = np.r_[True, np.diff(rows.time) > 0]
    starts, n = np.flatnonzero(first), len(first)
    group = np.cumsum(first) - 1
    single = np.diff(np.r_[starts, n]) == 1
    differs = np.zeros(n, dtype=bool)
    merged: dict[str, ColumnData] = {}
    for name, data in rows.columns.items():
        values = data.codes if isinstance(data, Labels) else data
        known = data.codes >= 0 if isinstance(data, Labels) else np.isfinite(data)
        # the first of a time that has a value: a hole beside it is no other value
        lead = np.minimum.reduceat(np.where(known, np.arange(n), n), starts)
        lead = np.where(lead < n, lead, starts)
        differs |= known & (values != values[lead][group])
        if isinstance(data, Labels):
            merged[name] = data[lead]
            continue
        number = np.add.reduceat(known.astype(float), starts)
        total = np.add.reduceat(np.where(known, data, 0.0), starts)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / number
        merged[name] = np.where(single, data[starts], mean)
    repeats, kept = ~first & ~differs, "one row was kept for each time"
    if repeats.any():
        told = f"{counted(int(repeats.sum()), 'row')} with the time of the row before"
        rows.remark("duplicate", "time_s", told, kept, "warning", repeats)
    if differs.any():
        told = f"{counted(int(differs.sum()), 'row')} with the time of the row before and other values"
        severity = _severity(float(differs.mean()))
        if severity == "error":
            _refuse_clashes(rows, merged, starts)
        rows.remark("duplicate", "time_s", told, f"{kept}, with the mean of the values", severity, differs)
    rows.columns, rows.row = merged, rows.row[starts]


_COARSE, _TURNS, _APART = 20, 5, 3.0
"""Times that a log has at least where many rows share each; rows of one time of as many recordings at most, and times
what a value changes by from time to time that it differs by between them (assumed)."""
ELECTRIC = ("power_", "voltage_", "current_", "energy_")
"""How columns of a battery begin."""


def _refuse_clashes(rows: Rows, means: dict[str, ColumnData], starts: Int64s) -> None:
    """Raise InputError where many rows share their time with others and their mean is of no robot: several recordings
    whose rows stand in turn, or times so coarse that hardly any are left."""
    n, line = len(rows.time), rows.raw.line(int(rows.row[0]))
    if 1 < len(starts) < min(_COARSE, n / 10):
        told = f"{n} rows have {counted(len(starts), 'time')}: the stamps are too coarse for the rows"
        allowed = "stamps of the rows, or a map with time_s from the rows' number and rate"
        raise InputError(Fault(rows.raw.file, line, 0, told, "time_s", allowed=allowed))
    for name, data in rows.columns.items():
        if isinstance(data, Labels) or column_of(name) is None or n > _TURNS * len(starts) or name == "time_s":
            continue
        with np.errstate(invalid="ignore"):
            spread = np.fmax.reduceat(data, starts) - np.fmin.reduceat(data, starts)
            both = np.abs(np.diff(np.asarray(means[name]))), spread[np.diff(np.r_[starts, n]) > 1]
        if not all(np.isfinite(one).any() for one in both):
            continue
        change, apart = (float(np.nanmedian(one)) for one in both)
        if apart > _APART * change and change > 0.0:
            told = f"rows of several recordings in turn: {name} differs by {apart:.4g} at one time"
            raise InputError(_several(rows.raw.file, line, f"{told}, by {change:.4g} after", "time_s"))


def _turns(data: Array) -> bool:
    """Whether a column, shape (n,), jumps back and forth: what it changes by from row to row is far more than to the
    next row but some."""
    data = data[np.isfinite(data)]
    if len(data) < _COARSE:
        return False
    near, *far = (float(np.median(np.abs(data[lag:] - data[:-lag]))) for lag in range(1, _TURNS + 1))
    return min(far) > 0.0 and near > _APART * min(far)


_LEAPS, _LEAP_M_WH, _LEAP, _FASTEST_M_S = 3, 2.0, 0.1, 5.0
"""Jumps in which a place or a counter leaps at least, how far, by what part of its range, and beyond which way that a
robot drives in that time (all assumed)."""


def _leaps(data: Array, time_s: Array, place: bool) -> bool:
    """Whether what cannot jump, a place [m] or a counter [Wh], of shape (n,), does so time and again, and each second
    time to where it was before: rows of two recordings, of each a few at a time. A place of nought is one that was
    lost."""
    known = np.isfinite(data) & np.isfinite(time_s) & ~(place & (data == 0.0))
    data, way = data[known], _FASTEST_M_S * place * np.abs(np.diff(time_s[known]))
    if len(data) < _COARSE:
        return False
    at = np.flatnonzero(np.abs(np.diff(data)) > np.maximum(_LEAP_M_WH + way, _LEAP * float(np.ptp(data))))
    if len(at) < _LEAPS or float(np.median(np.diff(at))) < _APART:
        return False
    return float(np.median(np.abs(data[at[1:] + 1] - data[at[:-1]]))) < 0.5 * float(np.abs(np.diff(data)[at]).min())


def in_turn(columns: Mapping[str, ColumnData]) -> list[str]:
    """The columns of the glossary that jump back and forth, as where rows of several recordings stand in turn: two or
    more from row to row, and not only electric ones, which a load that is switched moves; or a place or counter."""
    known = {name: data for name, data in columns.items() if not isinstance(data, Labels) and column_of(name)}
    apart = [name for name, data in known.items() if name != "time_s" and _turns(data)]
    if len(apart) > 1 and not all(name.startswith(ELECTRIC) for name in apart):
        return apart
    cannot = {"x_m": True, "y_m": True} | {name: False for name in known if name.startswith("energy_")}
    return [name for name, place in cannot.items() if name in known and _leaps(known[name], known["time_s"], place)]


def refuse_turns(columns: Mapping[str, ColumnData], file: str, line: int) -> None:
    """Raise InputError where rows of several recordings stand in turn, each with times of its own. `line`: that of the
    first row."""
    if apart := in_turn(columns):
        told = f"rows of several recordings in turn: {' and '.join(apart)} jump back and forth"
        raise InputError(_several(file, line, told, apart[0]))


def _several(file: str, line: int, told: str, column: str) -> Fault:
    hint = "a map with runs: {by: [the column that tells them apart]}"
    return Fault(file, line, 0, told, column, allowed="one recording a file", hint=hint)


def fill_missing(rows: Rows, required: set[str]) -> dict[str, Bools]:
    """Fill single missing values, hold slower topics, leave out what cannot be filled. `required`: columns that the
    batteries' power comes from. Gives column that was held from a slower topic → rows where it was really written."""
    held: dict[str, Bools] = {}
    for name in list(rows.columns):
        data = rows.columns[name]
        if name == "time_s":
            continue
        if isinstance(data, Labels):
            if (gone := data.codes < 0).any():
                told = f"{counted(int(gone.sum()), 'row')} without a text"
                rows.remark("missing", name, told, "they count as a name of their own", "note", gone)
            continue
        known = _known(rows, name, data)
        if known is None:
            continue
        if not known.any():
            severity = "warning" if name not in required else "error"
            rows.remark("missing", name, "no row has a value", "the column was left out", severity)
            del rows.columns[name]
            continue
        if known.mean() <= 1 - _SPARSE:
            held[name] = known
        rows.columns[name] = _filled(rows, name, np.asarray(rows.columns[name]), known, name in held)
    # columns that are missing too long too often go, then the rows that still have holes; without a speed a run says
    # hardly anything: while half of it is there, the rows go
    n = len(rows.row)
    for name in [name for name, data in rows.columns.items() if not isinstance(data, Labels) and name not in required]:
        holes = int(np.isnan(np.asarray(rows.columns[name])).sum())
        if holes > (_SPARSE if name == "speed_m_s" else 0.2) * n:
            told = f"{holes} of {n} rows have no value near"
            rows.remark("missing", name, told, "the column was left out", count=holes)
            del rows.columns[name]
    whole = np.ones(n, dtype=bool)
    for data in rows.columns.values():
        if not isinstance(data, Labels) and np.isnan(data.sum()):
            whole &= ~np.isnan(data)
    if not whole.all():
        told = f"{int((~whole).sum())} of {n} rows lack a value with no other near"
        rows.remark("missing", "", told, "these rows were left out", "warning", ~whole)
        rows.whole = dict(rows.columns), rows.row
        rows.take(whole)
        for name in held:
            held[name] = held[name][whole]
    return held


def _known(rows: Rows, name: str, data: Array) -> Bools | None:
    """Rows with a usable value; None where all are. Single readings out of range count as missing."""
    low, high = float(data.min()), float(data.max())
    found = column_of(name)
    limits = (-_DROWNING, _DROWNING)
    if found is not None and found[0].kind != "text":
        limits = (max(found[0].low, limits[0]), min(found[0].high, limits[1]))
    if np.isfinite(low) and np.isfinite(high) and limits[0] <= low and high <= limits[1]:
        return None
    known = np.isfinite(data)
    if not known.all() and known.any():
        slower = known.mean() <= 1 - _SPARSE
        action, severity = ("held from a slower topic", "note") if slower else (_FILLED, "warning")
        told = f"{int((~known).sum())} of {len(data)} values are missing"
        rows.remark("missing", name, told, action, severity, ~known)
    with np.errstate(invalid="ignore"):
        out = known & ((data < limits[0]) | (data > limits[1]))
    if count := int(out.sum()):
        beyond = min(_OUTLANDISH * max(abs(limits[0]), abs(limits[1])), _DROWNING)
        wild = bool(np.any(np.abs(data[out]) > beyond))
        single = wild or count < _OUTLIER_SHARE * len(data)
        unit = f" {found[0].unit}" if found is not None and found[0].unit not in ("", "1") else ""
        told = f"{count} values outside {limits[0]:g} … {limits[1]:g}{unit}, first {data[out][0]:.6g}"
        action = "they count as missing" if single else "left as they are: a wrong unit? (a map converts it)"
        rows.remark("range", name, told, action, "error", out)
        if single:
            known &= ~out
    return known if not known.all() else None


def _filled(rows: Rows, name: str, data: Array, known: Bools, sparse: bool) -> Array:
    time, at = rows.time, np.flatnonzero(known)
    found = column_of(name)
    stays = (found is not None and (found[0].kind == "count" or name in _SLOW_QUANTITIES)) or (
        sparse and not name.startswith("energy_")
    )
    before = np.maximum.accumulate(np.where(known, np.arange(len(data)), -1))
    after = np.minimum.accumulate(np.where(known, np.arange(len(data)), len(data))[::-1])[::-1]
    values = data[np.clip(before, at[0], at[-1])] if stays else np.interp(time, time[at], data[at])
    if found is None or (stays and not sparse):
        return np.where(known, data, values)
    period = float(np.median(np.diff(time[at]))) if len(at) > 1 else np.inf
    limit = max(1.0, 3 * float(np.median(np.diff(time))), 3 * period)
    if stays and sparse and len(at) > _COARSE and np.diff(data[at]).all():
        uneven = float(np.quantile(np.diff(time[at]), 0.9)) > 2.0 * period
        limit = np.inf if uneven else limit  # written only where it changes
    inside = (before >= 0) & (after < len(data))
    near = inside & (time[np.clip(after, 0, len(data) - 1)] - time[np.clip(before, 0, None)] <= limit)
    edge = ~inside & (np.abs(time - time[np.clip(np.where(before < 0, after, before), 0, len(data) - 1)]) <= limit)
    return np.where(known, data, np.where(near | edge, values, np.nan))
