"""Forms of time stamps that need a decision: names of zones, dots in clocks, minutes and seconds, numbers of days."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from missionsim.labels import Labels
from missionsim.logs.raw import Remark
from missionsim.physics import Array, Bools


class TimeError(ValueError):
    """Why texts or numbers cannot be read as times; `row`: of the first that cannot."""

    def __init__(self, told: str, row: int = 0) -> None:
        super().__init__(told)
        self.row = row


FEW_BAD = 0.05
"""Part of the distinct stamps of a column that may be none: their rows have no time (assumed)."""


def mostly_zoned(zoned: Bools, seconds: Array, labels: Labels) -> tuple[bool, str]:
    """Whether distinct stamps, of so many seconds, mostly have a UTC offset, and what is said of the others, which
    become NaN; nothing where there are none. Raises TimeError: too many others; no clock says what they mean."""
    known = np.isfinite(seconds)
    most = bool(2 * zoned[known].sum() > known.sum())
    odd = known & (zoned != most)
    seconds[odd] = np.nan
    if not odd.any():
        return most, ""
    row = int(np.argmax(np.r_[odd, False][labels.codes]))
    told = f"'{labels.names[labels.codes[row]][:40]}' has {'no' if most else 'a'} UTC offset, unlike other stamps"
    if odd.sum() > FEW_BAD * known.sum():
        raise TimeError(f"{told}; all stamps of a column need one, or none", row)
    return most, told


_ZONES = {
    "Z": 0, "UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3,
}  # fmt: skip
"""Names of one zone only, and their hours before UTC; CST, IST, BST and EST are those of several."""
_NAMED = re.compile(r"(:\d{2}(?:[.,]\d+)?(?:\s*[AP]M)?)\s*(?:([A-Z]{3,5})(?=\s+\d{4}\Z|\Z)|(Z)\Z)")
_DOTTED = re.compile(
    r"(\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}([-/.])\d{1,2}\2\d{2,4}),?[T ]+(\d{1,2})\.(\d{2})\.(\d{2})(?!\d)"
)


def written_out(text: str, drop: bool = True) -> str:
    """A time stamp with colons in its clock, and its zone's name as an offset at its end; a name of several zones is
    left out with `drop`. Raises TimeError: such a name, without `drop`."""
    text = _DOTTED.sub(r"\1 \3:\4:\5", text)
    if ":" not in text or (named := _NAMED.search(text)) is None:
        return text
    name = named[2] or named[3]
    if name not in _ZONES and not drop:
        raise TimeError(
            f"'{text[:40]}': there are several zones of the name {name}; "
            "say which in a map (zone: America/Chicago), or write the offset (-06:00)"
        )
    offset = f"+{_ZONES[name]:02d}:00" if name in _ZONES else ""
    return text[: named.end(1)] + text[named.end() :] + offset


_OFFSET = re.compile(r"(?<=\d)((?:\s*[AP]M)?)\s*(?:Z|([+-]\d{2}):?(\d{2})?)\Z", re.IGNORECASE)


def split_offset(text: str) -> tuple[str, float | None]:
    """A time stamp without its offset, and that [s]; None where there is none."""
    found = _OFFSET.search(text) if ":" in text else None
    if found is None:
        return text, None
    hours, minutes = float(found[2] or 0.0), float(found[3] or 0.0)
    sign = -1.0 if (found[2] or "").startswith("-") else 1.0
    return text[: found.start()] + found[1], _HOUR_S * hours + sign * 60.0 * minutes


HOURS_MINUTES = "hours and minutes"
_TENTHS = re.compile(r"(\d{1,4}):(\d{2}[.,]\d+)\Z")
_PAIR = re.compile(r"(\d{1,4}):(\d{2})\Z")
_DAY_H, _HOUR_S = 24, 3600.0


def is_minutes(text: str) -> bool:
    """Whether a text is minutes, seconds and a part of a second, as ``12:34.5``."""
    return _TENTHS.match(text) is not None


def minutes_and_seconds(texts: Sequence[str]) -> Array | None:
    """Seconds of ``12:34.5``, or of ``59:58`` in a column that counts beyond the hours of a day; None for all else."""
    for pattern in (_TENTHS, _PAIR):
        found = [pattern.match(text) for text in texts]
        parts = [(int(one[1]), float(one[2].replace(",", "."))) for one in found if one is not None]
        if parts and len(parts) == len(texts) and (pattern is _TENTHS or max(parts)[0] >= _DAY_H):
            return np.array([60.0 * minutes + seconds for minutes, seconds in parts])
    return None


def pair_in_doubt(texts: Sequence[str]) -> bool:
    """Whether all texts are ``12:34``, which is hours and minutes, or minutes and seconds."""
    return bool(texts) and all(map(_PAIR.match, texts))


def refuse_from_nought(first: str) -> None:
    """Raise TimeError where a column of such texts begins at nought, as a day does, and a run."""
    if int(first.partition(":")[0]) == 0:
        hint = f"write all three, {first}:00 or 00:{first}, parts of a second, or a date beside it"
        raise TimeError(f"'{first}' may be hours and minutes, or minutes and seconds; {hint}")


def hours_on(seconds: Array) -> tuple[Array, int]:
    """Minutes and seconds, shape (n,), with an hour more each time that they begin anew; and how often they do."""
    known = np.isfinite(seconds)
    values = seconds[known]
    back = np.diff(values, prepend=values[:1]) < -0.5 * _HOUR_S
    if values.max(initial=0.0) >= _HOUR_S or not back.any():
        return seconds, 0
    result = seconds.copy()
    result[known] = values + _HOUR_S * np.cumsum(back)
    return result, int(back.sum())


_DAYS = (("spreadsheets count", 25569.0), ("MATLAB counts", 719529.0))
"""Who counts days, and the number of 1970-01-01."""
_FIRST_D, _LAST_D = 10220.0, 27430.0
"""Days since 1970 of 1998 to 2045, as for epochs."""
_SURE_D, _MOST_D = 5e-5, 9e-4
"""Usual steps [days]: shorter ones would be rows of 20 kHz if they were seconds; longer ones are of a clock in seconds
(both assumed)."""


def as_days(values: Array, usual: float) -> tuple[Array, str, str] | None:
    """Seconds since 1970 of numbers of days, or since midnight of parts of one, their kind, and in words who counts so;
    None where they are none.

    `values`: shape (n,); `usual`: their usual step. Raises TimeError: they may be days, or seconds.
    """
    known = values[np.isfinite(values)]
    middle = float(np.median(known)) if len(known) else 0.0
    if not 0.0 < usual < _MOST_D:
        return None
    found = [(f"days, as {who} them", zero) for who, zero in _DAYS if _FIRST_D < middle - zero < _LAST_D]
    if not found and known.min() >= 0.0 and known.max() < 1.0:
        found = [("parts of a day, as spreadsheets write a time", 0.0)]
    for told, zero in found:
        if usual > _SURE_D:
            raise TimeError(
                f"{middle:.9g} in steps of {usual:.3g} may be {told}, or seconds; "
                "say which in a map: time_s: {value: …, unit: d}, or unit: s"
            )
        return (values - zero) * 86400.0, "local" if zero else "day", told
    return None


def seconds_of(times: object) -> Array:
    """Seconds since 1970 of a pandas Series of times, NaT as NaN."""
    import pandas as pd

    series = pd.Series(times)
    whole = series.to_numpy(dtype="datetime64[ns]").astype("int64").astype(np.float64) * 1e-9
    return np.where(series.isna().to_numpy(), np.nan, whole)


def in_zone(seconds: Array, zone: str) -> Array:
    """Wall time of a zone to UTC."""
    import pandas as pd

    if match := re.fullmatch(r"(?:UTC)?([+-])(\d{1,2})(?::?(\d{2}))?", zone.strip()):
        offset = int(match[2]) * _HOUR_S + int(match[3] or 0) * 60.0
        return seconds - (offset if match[1] == "+" else -offset)
    wall = pd.DatetimeIndex(np.round(seconds * 1e9).astype("int64").astype("datetime64[ns]"))
    try:
        times = wall.tz_localize(zone, ambiguous="infer", nonexistent="raise")
    except (KeyError, LookupError, TypeError) as error:
        if type(error).__name__ in ("ZoneInfoNotFoundError", "UnknownTimeZoneError", "KeyError"):
            raise TimeError(f"there is no zone '{zone}'; such as Europe/Berlin, UTC or +02:00") from None
        raise TimeError(str(error)) from None
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise TimeError(
            f"in {zone} the clocks change within these times and they do not say on which side they are ({reason}); "
            "give the offset in place of the zone: +02:00"
        ) from None
    return seconds_of(times.tz_convert(None))


def clock_changes(values: Array, name: str, remarks: list[Remark]) -> Array:
    """Local times over a night in which clocks change: the hour that stands twice or not at all is put right.

    Back: a jump by one hour into an hour of the night. Forward: a Sunday's step from before a full hour of the night to
    after the next one. Both with the usual step beside the hour.
    """
    step = np.diff(values)
    if len(step) < 3:
        return values
    usual = max(float(np.median(np.abs(step))), 1e-6)
    near = max(5 * usual, 2.0)
    hour = (values[1:] % 86400.0) / _HOUR_S
    back = (np.abs(step + _HOUR_S) <= near) & (hour < 4.0)
    sunday = np.floor(values[1:] / 86400.0) % 7 == 3  # 1970-01-01 was a Thursday
    full = np.round(values[:-1] / _HOUR_S) * _HOUR_S
    forward = (np.abs(step - _HOUR_S) <= near) & (hour < 4.0) & sunday & (np.abs(full - values[:-1]) <= near)
    if not (back.any() or forward.any()):
        return values
    way = "back" if back.any() else "forward"
    told = f"local time jumps {way} by one hour at night: the clocks were changed"
    action = "the hour was put right; with the zone (zone: Europe/Berlin in a map) it need not be guessed"
    remarks.append(Remark("clock", name, told, action, "warning", 0, int(back.sum() + forward.sum())))
    return np.asarray(values + np.cumsum(np.r_[0.0, _HOUR_S * back - _HOUR_S * forward]))
