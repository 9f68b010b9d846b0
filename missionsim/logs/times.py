"""Time stamps as loggers write them → seconds: ISO 8601, day first, time of day, date and time apart, epochs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.labels import Labels
from missionsim.logs import clocks
from missionsim.logs.clocks import TimeError as TimeError
from missionsim.logs.raw import RawTable, Remark
from missionsim.numerals import counted
from missionsim.physics import Array, Bools

_CLOCK = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?"
_ZONE = r"(?:\s*(?:Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))"
_DAY = re.compile(rf"(?:-?\d+ days? )?{_CLOCK}(?:\s*[AP]M)?\Z", re.IGNORECASE)
_ISO = re.compile(rf"\d{{4}}[-/.]?\d{{2}}[-/.]?\d{{2}}(?:[T _-]+(?:{_CLOCK}|\d{{6}}(?:[.,]\d+)?))?{_ZONE}?\Z", re.I)
_DATED = re.compile(rf"\d{{1,2}}([-/.])\d{{1,2}}\1\d{{4}}(?:,?[T ]+{_CLOCK}(?:\s*[AP]M)?)?{_ZONE}?\Z", re.IGNORECASE)
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10, "nov": 11,
    "dec": 12, "mai": 5, "okt": 10, "dez": 12,
}  # fmt: skip
_WORDED = re.compile(
    rf"(?:[a-z]{{2,9}},?\s+)?(?:(\d{{1,2}})[-/. ]+([a-z]{{3,9}})\.?|([a-z]{{3,9}})\.?[- ]+(\d{{1,2}}),?)"
    rf"(?:[-/, ]+(\d{{4}}))?(?:[,T: ]+({_CLOCK})\s*([AP]M)?)?(?:\s+(\d{{4}}))?{_ZONE}?\Z",
    re.IGNORECASE,
)
_SHORT = re.compile(r"(\d{2})\.(\d{2})\.(\d{2})(?!\d)(?=[,T ]|\Z)")
"""``14-Mar-2025 09:21:33.250``, ``Mar 14, 2025 9:21:33 AM``, ``Fri Mar 14 09:21:33 2025``."""
_HOUR, _DAY_S = 3600.0, 86400.0
_COMPACT = re.compile(r"(\d{4})[-/.]?(\d{2})[-/.]?(\d{2})[T _-]+(\d{2})(\d{2})(?=\d{2})")
_FIRST_S, _LAST_S = 8.83e8, 2.37e9
"""Logs are from 1998 to 2045: an epoch that says another year is in doubt (assumed)."""
_TICKS = (("1970", 0.0), ("1601", 11644473600.0), ("the year 1", 62135596800.0))
"""Zeros of clocks that count tenths of a microsecond [s] before 1970."""
_EPOCHS = ((1e17, 1e9, "nanoseconds"), (1e14, 1e6, "microseconds"), (1e11, 1e3, "milliseconds"), (1e8, 1.0, "seconds"))
"""Times from 1973 to 5138 in each unit lie above its limit and below the one before."""
_SLOWEST_S, _YEAR_S = 3000.0, 3e7
"""A longer usual step in a log of more than a year is none: microseconds since a start pass for seconds since 1970."""
NO_TIME = "no time stamp that is known: ISO 8601, 14.03.2025 09:21:33,250, 09:21:33.25, or a number"


@dataclass
class Stamps:
    """Times of rows."""

    seconds: Array
    """[s] since 1970 for ``utc`` and ``local`` (wall time counted as if it were UTC), since midnight for ``day``, since
    a zero of the logger's own for ``own``; NaN where there is none. Shape (n,)."""
    kind: str
    """``utc``, ``local``, ``date``, ``day`` or ``own``."""
    form: str
    """What was recognised, in words."""
    remarks: list[Remark] = field(default_factory=list)
    likely: bool = True
    """Whether they are of years in which logs are written."""


def is_stamp(text: str) -> bool:
    """Whether a text is written like a time stamp, a date or a time of day."""
    text = _in_numbers(text.strip())
    return any(pattern.match(text) for pattern in (_DAY, _ISO, _DATED)) or clocks.is_minutes(text)


def date_and_clock(text: str) -> tuple[bool, bool]:
    """Whether a time stamp has a date, and a time of day."""
    text = _in_numbers(text.strip())
    return _ISO.match(text) is not None or _DATED.match(text) is not None, ":" in text


def _in_numbers(text: str) -> str:
    """A date with the month's name, ``14.03.25`` or ``20250314_092133`` as ISO 8601; any other text as it is."""
    text = _COMPACT.sub(r"\1-\2-\3 \4:\5:", clocks.written_out(text))
    text = re.sub(r"\A(\d{1,2}/\d{1,2}/)(\d{2})(?=[,T ]|\Z)", r"\g<1>20\2", text)
    if re.search(r":\d{2}:\d{3}\Z", text):
        text = f"{text[:-4]}.{text[-3:]}"
    if short := _SHORT.match(text):
        return f"20{short[3]}-{short[2]}-{short[1]}{text[short.end() :]}"
    found = _WORDED.match(text)
    if found is None:
        return text
    month = _MONTHS.get((found[2] or found[3])[:3].lower())
    year = found[5] or found[8]
    if month is None or year is None:
        return text
    clock = found[6]
    if clock and found[7]:
        hour, rest = clock.split(":", 1)
        clock = f"{int(hour) % 12 + 12 * (found[7].upper() == 'PM')}:{rest}"
    zone = re.search(rf"{_ZONE}\Z", text, re.IGNORECASE)
    date = f"{year}-{month:02d}-{int(found[1] or found[4]):02d}"
    return (
        f"{date} {clock.rjust(len(clock) + (clock[1] == ':'), '0')}{zone[0].strip() if zone else ''}" if clock else date
    )


def read_stamps(parts: Sequence[Array | Labels], name: str, zone: str | None = None, local: bool = False) -> Stamps:
    """Times of one column; of a date and a time of day in two; or of whole seconds and nanoseconds.

    `parts` (shape (n,)): numbers (an epoch by their size, else seconds of the logger's own) or texts; `name`: for
    remarks; `zone`: zone of local times, such as ``Europe/Berlin`` or ``+02:00``; `local`: whether numbers since 1970
    are wall time of a zone that is not known. Raises TimeError: texts that are no time stamps; local times that do not
    say which of two hours they are in.
    """
    if len(parts) == 2 and is_fine(*parts):
        parts = [np.asarray(parts[0]) + 1e-9 * np.asarray(parts[1])]
    found = [numbers_as_times(part) if not isinstance(part, Labels) else _texts(part, zone) for part in parts]
    whole = found[0]
    if whole.form == clocks.HOURS_MINUTES and len(parts) == 1:
        _told_apart(whole, parts[0], name)
    if local and whole.kind == "utc":
        whole = Stamps(whole.seconds, "local", "ISO 8601 without a zone")
    if len(found) == 2:
        date, clock = sorted(found, key=lambda part: part.kind == "day")
        if clock.kind != "day" or date.kind not in ("date", "local"):
            raise TimeError(f"a date and a time of day are wanted, not {found[0].form} and {found[1].form}")
        whole = Stamps(date.seconds + clock.seconds, "local", f"{date.form} and {clock.form} in two columns")
    elif whole.kind == "date":
        raise TimeError("dates without a time of day; name both columns: [date, time]")
    known = np.isfinite(whole.seconds)
    values = whole.seconds[known]
    if whole.kind == "day" and (back := np.diff(values, prepend=values[:1]) < -0.5 * _DAY_S).any():
        values = values + _DAY_S * np.cumsum(back)
        message = f"the time of day passes midnight {int(back.sum())} times"
        whole.remarks.append(Remark("clock", name, message, "a day was added each time", "note"))
    elif whole.kind == "local" and zone is not None:
        whole, values = Stamps(whole.seconds, "utc", f"{whole.form}, {zone}"), clocks.in_zone(values, zone)
    elif whole.kind == "local":
        values = clocks.clock_changes(values, name, whole.remarks)
    if whole.kind != "own":
        whole.seconds = whole.seconds.copy()
        whole.seconds[known] = values
        told, severity = f"recognised as {whole.form}", "note"
        if not whole.likely:
            year = 1970 + int(float(np.median(values)) / 3.15576e7)
            told, severity = f"{told}, which says the year {year}: another unit, or another zero?", "warning"
        whole.remarks.insert(0, Remark("clock", name, told, "read as seconds", severity))
    return whole


def is_fine(whole: Array | Labels, nano: Array | Labels) -> bool:
    """Whether numbers are whole seconds, and others their nanoseconds, as ROS keeps a time."""
    if isinstance(whole, Labels) or isinstance(nano, Labels):
        return False
    known = np.isfinite(whole) & np.isfinite(nano)
    seconds, rest = whole[known], nano[known]
    if not len(rest) or (seconds % 1).any() or (rest % 1).any():
        return False
    # neither a date such as 20250314 nor milliseconds
    epoch = float(seconds.min()) > 5e8 or float(seconds.max()) < 1e7
    return epoch and float(rest.min()) >= 0.0 and 1e6 < float(rest.max()) < 1e9


def _told_apart(whole: Stamps, texts: Array | Labels, name: str) -> None:
    """Doubt texts such as ``12:34`` without a date. Raises TimeError: they may be read in both ways."""
    if isinstance(texts, Labels):
        clocks.refuse_from_nought(texts.names[0].strip())
    told = "each time is two numbers with a colon between: minutes and seconds?"
    whole.remarks.append(Remark("clock", name, told, "read as hours and minutes", "warning"))


_ABSURD_S = 1e11
"""A time beyond three thousand years, and a thousand times the usual one, is a mistake in its row."""
_JUMP_S = 3600.0
"""A step that is longer, and a thousand usual ones, is no gap of a mission: the clock was set, or the robot was off."""


def close_jumps(time_s: Array, remarks: list[Remark], usual: float | None = None, away: Bools | None = None) -> Array:
    """Times without jumps of the clock: each becomes a short gap, which parts the run for a diagnosis. `time_s` (shape
    (n,)): [s]; `remarks`: what is said is added; `usual`: usual step [s], where it is known; `away` (shape (n - 1,)):
    steps in which rows of another run lie."""
    step = np.diff(time_s)
    if len(step) < 2:
        return time_s
    usual = float(np.nanmedian(np.abs(step))) if usual is None else usual
    left = max(6.0 * usual, usual + 1.0)
    long = step > max(_JUMP_S, 1000.0 * usual)
    jumps = np.flatnonzero((long if away is None else long | (away & (step > left))) & np.isfinite(step))
    if not len(jumps):
        return time_s
    shift = np.zeros(len(time_s))
    shift[jumps + 1] = step[jumps] - left
    longest = float(step[jumps].max())
    message = f"time jumps {len(jumps)} times, by up to {longest:.4g} s after {time_s[jumps[0]]:.6g} s"
    why = "the clock was set or the logger was off" if long.any() else "rows of another run lie between"
    action = f"parted there: {why}, and {left:.3g} s are counted in place of each"
    remarks.append(Remark("gap", "time_s", message, action, "warning", 0, len(jumps)))
    return np.asarray(time_s - np.cumsum(shift))


class TimeAxis:
    """Times of a log, from its first row on; remembers the start from block to block of a long file."""

    def __init__(self) -> None:
        self.start: float | None = None
        self.begin_s = math.nan  # since 1970, where the times have a date
        self.days = 0.0
        self.last = -np.inf
        self.taken_out = 0.0
        self.usual: float | None = None
        self.end: float | None = None

    def apply(self, raw: RawTable) -> None:
        """Turn the column ``time_s`` of a table into seconds, and remark on what it was. Raises InputError: texts that
        are no time stamps."""
        data = raw.columns.get("time_s")
        if data is None or not raw.rows:
            return
        try:
            found = read_stamps([data], "time_s", local="time_s" in raw.local)
        except TimeError as error:
            raise InputError(Fault(raw.file, raw.line(error.row), 0, str(error), "time_s")) from None
        if found.kind == "own" and self.end is None:
            raw.remarks += found.remarks
        known = found.seconds[np.isfinite(found.seconds)]
        self._refuse_absurd(raw, found.seconds, known)
        if found.kind != "own" and len(known):
            if found.kind == "day" and known[0] + self.days < self.last - 0.5 * _DAY_S:
                self.days += _DAY_S
            if self.start is None:
                self.start = float(known[0])
                self.begin_s = self.start if found.kind != "day" else math.nan
                raw.remarks += found.remarks
            found.seconds = found.seconds + (self.days - self.start)
            self.last = float(known[-1]) + self.days
        seconds = found.seconds.copy()
        finite = np.isfinite(seconds)
        known = seconds[finite]
        if len(known):  # without jumps, also between this block and the one before
            if self.usual is None and len(known) > 2:
                self.usual = float(np.median(np.abs(np.diff(known))))
            before = [] if self.end is None else [self.end]
            known = known - self.taken_out
            closed = close_jumps(np.r_[before, known], raw.remarks, self.usual)[len(before) :]
            self.taken_out += float(known[-1] - closed[-1])
            self.end = float(closed[-1])
            seconds[finite] = closed
        raw.columns["time_s"] = seconds

    @staticmethod
    def _refuse_absurd(raw: RawTable, seconds: Array, known: Array) -> None:
        """Refuse single times that no clock shows, before a jump or a restart is told between them and the others."""
        most = max(_ABSURD_S, 1000.0 * float(np.median(np.abs(known)))) if len(known) else 0.0
        absurd = np.flatnonzero(np.isfinite(seconds) & (np.abs(seconds) > most))
        if len(absurd):
            usual = known[np.abs(known) <= most]
            allowed = f"as in the other rows, {usual.min():.6g} to {usual.max():.6g} s"
            told = "a time that no clock shows"
            rows = [(raw.line(int(i)), f"{seconds[i]:g} s") for i in absurd[:20]]
            raise InputError([Fault(raw.file, line, 0, told, "time_s", got, allowed) for line, got in rows])


def numbers_as_times(values: Array) -> Stamps:
    """Times of numbers, shape (n,): a date in digits, an epoch by their size, else seconds of the logger's own."""
    if (dates := _in_digits(values)) is not None:
        return Stamps(dates, "local", "a date in digits")
    known = values[np.isfinite(values)][: 1 << 16]
    middle, step = (float(np.median(known)) if len(known) else 0.0), np.diff(known)
    for told, zero_s in _TICKS:
        if _FIRST_S < middle * 1e-7 - zero_s < _LAST_S:
            return Stamps(values * 1e-7 - zero_s, "utc", f"tenths of a microsecond since {told}")
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    if (days := clocks.as_days(values, usual)) is not None:
        return Stamps(*days)
    found = next(((factor, unit) for limit, factor, unit in _EPOCHS if middle > limit), None)
    if found is None or (usual > _SLOWEST_S * found[0] and float(np.ptp(known)) > _YEAR_S * found[0]):
        return Stamps(values, "own", "seconds")
    likely = _FIRST_S < middle / found[0] < _LAST_S
    return Stamps(values / found[0], "utc", f"{found[1]} since 1970", likely=likely)


def _in_digits(values: Array) -> Array | None:
    """Seconds since 1970 of ``20250314092133`` or ``20250314092133250``; None where a row is no date."""
    known = np.isfinite(values)
    if not known.any() or not 1.9e13 < (middle := float(np.median(values[known]))) < 2.1e16 or 2.1e13 < middle < 1.9e16:
        return None
    scale = 1000 if middle > 1e15 else 1
    whole = np.where(known, values, 20000101e6 * scale)
    digits = (whole // scale).astype(np.int64)
    year, month, day = digits // 10**10, digits // 10**8 % 100, digits // 10**6 % 100
    hour, minute, second = digits // 10**4 % 100, digits // 100 % 100, digits % 100
    inside = (year > 1900) & (year < 2100) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    if not (inside & (hour < 24) & (minute < 60) & (second <= 60)).all():
        return None
    months = (year - 1970) * 12 + month - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + day - 1
    rest = (whole - digits * float(scale)) / scale
    return np.where(known, days * _DAY_S + hour * _HOUR + minute * 60.0 + second + rest, np.nan)


def _texts(labels: Labels, zone: str | None) -> Stamps:
    """Times of texts, each distinct text read once."""
    import pandas as pd

    odd, given = "", [clocks.written_out(text.strip(), drop=zone is not None) for text in labels.names]
    texts = pd.Series([_in_numbers(text) for text in given], dtype="object")
    sample = next(iter(texts), "")
    if (minutes := clocks.minutes_and_seconds(given)) is not None:
        seconds, hours = clocks.hours_on(np.r_[minutes, np.nan][labels.codes])
        told = Remark("clock", "time_s", "recognised as minutes and seconds", "read as seconds", "note")
        if hours:
            message = f"{told.message} that begin anew {counted(hours, 'time')}"
            told = replace(told, message=message, action="an hour was added each time")
        return Stamps(seconds, "own", "minutes and seconds", [told])
    if _DAY.match(sample):
        kind, form = "day", clocks.HOURS_MINUTES if clocks.pair_in_doubt(given) else "a time of day"
        if texts.str.contains("[AP]M", case=False, regex=True).any():
            dates = pd.to_datetime("2000-01-01 " + texts, format="mixed", errors="coerce", utc=True)
            values = clocks.seconds_of(dates) - 946684800.0
        else:
            full = texts.str.replace(",", ".").where(texts.str.count(":") > 1, texts + ":00")
            values = np.asarray(pd.to_timedelta(full, errors="coerce").dt.total_seconds(), dtype=np.float64)
    elif _ISO.match(sample):
        ends = texts.str.contains(rf":.*\d{_ZONE}\Z", case=False, regex=True).to_numpy(dtype=bool)
        plain = texts.str.replace(",", ".").str.replace("/", "-").str.replace("_", " ")
        plain = plain.str.replace(r"(?<=\d)\s*(UTC|GMT)$", "Z", regex=True)
        plain = plain.str.replace(r"^(\d{4})\.(\d{2})\.(\d{2})", r"\1-\2-\3", regex=True)
        values = clocks.seconds_of(pd.to_datetime(plain, format="ISO8601", utc=True, errors="coerce"))
        zoned, odd = clocks.mostly_zoned(ends, values, labels)
        kind = "utc" if zoned else "local" if re.search(r"\d[T _]+\d", sample, re.IGNORECASE) else "date"
        form = {"utc": "ISO 8601 with a zone", "local": "ISO 8601 without a zone", "date": "a date"}[kind]
    elif _DATED.match(sample):
        kind, form, values, odd = _dated(texts, labels)
    else:
        raise TimeError(f"'{next(iter(labels.names), '')[:40]}' is {NO_TIME}")
    if len(values) and np.isnan(values).mean() > clocks.FEW_BAD:
        bad = texts[int(np.argmax(np.isnan(values)))]
        raise TimeError(f"'{bad[:40]}' is {NO_TIME}")
    remarks = [Remark("clock", "time_s", odd, "such stamps count as none")] if odd else []
    return Stamps(np.r_[values, np.nan][labels.codes], kind, form, remarks)


def _dated(texts: Iterable[str], labels: Labels) -> tuple[str, str, Array, str]:
    """Day first or month first: the one that every date fits, and then the one that spans less time; and what is said
    of offsets."""
    import pandas as pd

    parts = [clocks.split_offset(text) for text in texts]
    series = pd.Series([text for text, _ in parts], dtype="object").str.replace(
        r"^(\d{1,2})[-/.](\d{1,2})[-/.]", r"\1/\2/", regex=True
    )
    series = series.str.replace(r"^(\S*?\d{4}),?[T ]+", r"\1 ", regex=True).str.replace(",", ".")
    kind = "local" if ":" in str(series.iloc[0]) else "date"
    mark = "%I" if series.str.contains("[AP]M", case=False, regex=True).any() else "%H"
    fractions, seconds = bool(series.str.contains(".", regex=False).any()), bool(series.str.count(":").max() > 1)
    tail = f" {mark}:%M" + ":%S" * seconds + ".%f" * fractions + " %p" * (mark == "%I") if kind == "local" else ""
    if fractions:
        series = series.where(series.str.contains(".", regex=False), series + ".0")
    readings = []
    for form, words in (("%d/%m/%Y", "day first"), ("%m/%d/%Y", "month first")):
        values = clocks.seconds_of(pd.to_datetime(series, format=form + tail, errors="coerce"))
        known = values[np.isfinite(values)]
        readings.append((float(np.isnan(values).mean()), float(np.ptp(known)) if len(known) else 0.0, words, values))
    _, _, words, values = min(readings, key=lambda reading: reading[:2])
    ends = np.array([offset is not None for _, offset in parts])
    zoned, odd = clocks.mostly_zoned(ends, values, labels)
    if zoned:
        offsets = np.array([offset or 0.0 for _, offset in parts])
        return "utc", f"a date, {words}, and time with a zone", values - offsets, odd
    return kind, f"a date, {words}" + (", and time" if kind == "local" else ""), values, odd
