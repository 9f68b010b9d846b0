"""Signals that come from one table with a row for each value, or from several files whose clocks are brought to one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from missionsim.errors import InputError
from missionsim.importer.roles import UNITS, Field, guess_all, known_unit, words_of
from missionsim.inputs.log_map import LongMap
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark, number_of, numbers_in, numbers_of
from missionsim.logs.readers import Topic
from missionsim.logs.times import is_stamp
from missionsim.physics import Array, Int64s

_VALUE = re.compile(r"(field )?(val|values?|state|reading|wert|valeur|valore?)")
_NAME = re.compile(
    r"(.* )?(entity|field|series|metric|pid|name|signal|sensor|variable|parameter|channel|tag|item|topic|key"
    r"|measurement|attribute|quantity|data ?point|label)( id| name)?"
)
_UNIT = re.compile(r"(.* )?(units?|uom|einheit)( of measurement)?")
"""What columns of names, values and units are called."""
_WIDE = ("power", "voltage", "current", "energy", "speed")
"""Roles that no column of such a table has."""
_ROWS, _AGAIN = 5, 0.1
"""Rows of each name at least, and part of them at the time of another one from which further columns tell signals
apart (both assumed)."""
_NUMBERS = 0.5
"""Part of the cells of a signal that are numbers, at least: the others say that there is none (assumed)."""


def signals_of(raw: RawTable, long: LongMap) -> Iterator[tuple[str, Int64s, ColumnData]]:
    """Each signal of a table: its name, with a unit in brackets behind it, the first that its rows have, to which those
    in others are converted; its rows; and its values there. Raises KeyError: a column that is not in the table."""
    texts = [_texts(raw.columns[name]) for name in long.name]
    units = _texts(raw.columns[long.unit]) if long.unit else None
    code = np.zeros(raw.rows, dtype=np.int64)
    for one in (*texts, *([units] if units else ())):
        _, code = np.unique(code * (len(one.names) + 1) + one.codes + 1, return_inverse=True)
    order = np.argsort(code, kind="stable")
    values = raw.odd.get(long.value, raw.columns[long.value])
    parts: dict[tuple[str, str], list[tuple[Int64s, str, float, ColumnData]]] = {}
    for rows in np.split(order, np.flatnonzero(np.diff(code[order])) + 1):
        if not len(rows):
            continue
        name = ".".join(text for one in texts if (text := str(one.texts()[rows[0]])))
        unit = str(units.texts()[rows[0]]) if units else ""
        found = _numbers(values[rows], raw.decimal)
        known = found.codes >= 0 if isinstance(found, Labels) else np.isfinite(found)
        if name and known.any():
            kind, factor = UNITS.get(known_unit(unit), (unit, 1.0))
            if isinstance(found, Labels) or kind == "temperature":
                kind, factor = unit, 1.0
            parts.setdefault((name, kind), []).append((rows[known], unit, factor, found[known]))
    for name in [name for name, kind in parts if not kind]:
        told = [same for (other, kind), same in parts.items() if other == name and kind]
        if len(told) == 1 and not any(
            isinstance(part[3], Labels) for part in (*told[0], *parts[name, ""])
        ):  # a unit that not every row repeats
            size = min(told[0], key=lambda part: part[0][0])[2]
            told[0] += [(rows, unit, size, data) for rows, unit, _, data in parts.pop((name, ""))]
    for (name, _), same in parts.items():
        (rows, _, size, data), *others = sorted(same, key=lambda part: part[0][0])
        unit = next((part[1] for part in same if part[1]), "")
        if others:
            rows = np.concatenate([rows, *(part[0] for part in others)])
            data = np.concatenate([np.asarray(data), *(np.asarray(part[3]) * (part[2] / size) for part in others)])
            order = np.argsort(rows)
            rows, data = rows[order], data[order]
        yield f"{name} [{unit}]" if unit else name, rows, data


def _texts(data: ColumnData) -> Labels:
    """Names in a column; numbers as they are, with all digits, so that two of them stay two (29 bits of a bus)."""
    if isinstance(data, Labels):
        return data
    return Labels.of("" if value != value else np.format_float_positional(value, trim="-") for value in data)


def _numbers(data: ColumnData, decimal: str) -> ColumnData:
    """Values of one signal as numbers, where most are; ``unavailable`` is none."""
    if not isinstance(data, Labels):
        return data
    labels, written = data.compact(), data.codes >= 0
    numbers = numbers_of(labels, lambda word: number_of(word.strip().replace(decimal, ".")))
    if written.any() and float(np.isfinite(numbers[written]).mean()) > _NUMBERS:
        return numbers
    return numbers_in(labels)


def recognised(fields: Mapping[str, Field], time_s: Array | None = None) -> LongMap | None:
    """Which columns of a table name a signal, hold its value and say its unit; None where it has a column for each.
    `time_s`: times of the rows, by which further columns are found that tell signals of one name apart."""
    called = {name: words_of(name)[0] or name.lower() for name in fields}
    value = next((name for name, words in called.items() if _VALUE.fullmatch(words)), None)
    texts = {
        name: one.values
        for name, one in fields.items()
        if isinstance(one.values, Labels) and name != value and not any(map(is_stamp, one.values.names[:1]))
        if (one.values.codes >= 0).mean() > 0.5
    }
    names = [
        name
        for name, labels in texts.items()
        if _NAME.fullmatch(called[name]) and _ROWS * len(labels.names) <= len(labels)
    ]
    roles = {guess.role for name, guess in guess_all(list(fields.values())).items() if guess.score > 0.8}
    if value is None or not names or roles & {*_WIDE}:
        return None
    chosen = [name for name in names if len(texts[name].names) > 1] or names[:1]
    unit = next((name for name in texts if _UNIT.fullmatch(called[name])), None)
    left = [name for name in texts if name not in (*chosen, unit) and len(texts[name].names) > 1]
    while time_s is not None and left and (now := _same_times(texts, chosen, time_s)) > _AGAIN:
        best = min(left, key=lambda name: _same_times(texts, [*chosen, name], time_s))
        if _same_times(texts, [*chosen, best], time_s) >= now:
            break
        chosen.append(best)
        left.remove(best)
    return LongMap(name=tuple(name for name in texts if name in chosen), value=value, unit=unit)


def _same_times(texts: Mapping[str, Labels], names: list[str], time_s: Array) -> float:
    """Part of the rows that have the time of another one of the same names."""
    keys = np.stack([time_s, *(texts[name].codes.astype(np.float64) for name in names)])
    return 1.0 - len(np.unique(keys, axis=1).T) / max(len(time_s), 1)


def written_at_changes(field: Field) -> bool:
    """Whether a signal is written only where it changes, so that it stays as it is until the next time."""
    time_s, values = field.time_s, field.values
    if time_s is None or len(time_s) < 20 or isinstance(values, Labels):
        return False
    step = np.diff(time_s)
    return bool((np.diff(values) != 0).all()) and float(step.max()) > 3.0 * float(np.median(step))


_DAY_S = 86400.0
_DATED_S = 1e8
"""Times beyond it are seconds since 1970 (assumed: from 1973 on)."""


def one_clock(topics: Sequence[Topic], clocks: dict[str, str], path: Path, remarks: list[Remark]) -> None:
    """Bring the files of a run to one clock, and see that they overlap.

    `topics`: of all files, their times are changed; `clocks`: short name of each file → kind of its times; `path`: the
    first file, for messages; `remarks`: what is said is added. Raises InputError: no clock in common, no overlap, or no
    row with a time.
    """
    topics = [topic for topic in topics if len(topic.time_s)]
    if not topics:
        allowed = "rows with a time and a value"
        raise InputError.single("these files hold no row with a time and a value", file=str(path), allowed=allowed)
    starts = {topic.name.partition(".")[0]: np.inf for topic in topics}
    for topic in topics:
        alias = topic.name.partition(".")[0]
        starts[alias] = min(starts[alias], float(topic.time_s.min()))
    for alias in starts:
        if clocks[alias] in ("utc", "own"):  # a recording may count from its start, and a lag lead to a date
            clocks[alias] = "utc" if starts[alias] > _DATED_S else "own"
    kinds = {clocks[alias] for alias in starts}
    early, late = min(starts, key=starts.__getitem__), max(starts, key=starts.__getitem__)
    lag = f"`lag: {starts[early] - starts[late]:.3f} s` for {early} lets it begin with {late}"
    hint = f"{lag}: correct it by what you know of both"
    if kinds & {"utc", "local"} and "day" in kinds:
        kind = {topic.name: clocks[topic.name.partition(".")[0]] for topic in topics}
        dated = [topic.time_s.min() for topic in topics if kind[topic.name] in ("utc", "local")]
        for topic in topics:
            if kind[topic.name] == "day":
                topic.time_s = topic.time_s + np.floor(min(dated) / _DAY_S) * _DAY_S
        kinds.discard("day")
        remarks.append(Remark("clock", "", "a file has times of day only", "the day is that of the other file", "note"))
    spans: dict[str, tuple[float, float]] = {}
    for one in topics:  # the signals of a table are one file
        name = one.name if one.title else one.name.partition(".")[0]
        first, last = spans.get(name, (np.inf, -np.inf))
        spans[name] = min(first, float(one.time_s.min())), max(last, float(one.time_s.max()))
    words = {"utc": "UTC", "local": "local time", "day": "time of day", "own": "seconds of its own"}
    told = ", ".join(f"{alias}: {words[kind]}" for alias, kind in clocks.items())
    if "own" in kinds and len(kinds) > 1:
        allowed = "times of day or dates in all of them, or seconds from one start in all"
        message = "these files have no clock in common"
        raise InputError.single(message, file=str(path), got=told, allowed=allowed, hint=hint)
    if kinds == {"own"} and len(clocks) > 1:
        action = "taken as counted from one start"
        remarks.append(Remark("clock", "", "the files have no clock but seconds of their own", action, "warning"))
    begin, end = max(span[0] for span in spans.values()), min(span[1] for span in spans.values())
    if begin >= end:
        late = max(spans, key=lambda name: spans[name][0])
        apart = begin - end
        zone = "a zone (zone: Europe/Berlin) for the file with local time" if {"utc", "local"} <= kinds else hint
        message = f"the files do not overlap: {late} begins {apart:.6g} s after another one ends"
        raise InputError.single(message, file=str(path), got=told, allowed="files of one run", hint=zone)
    if {"utc", "local"} <= kinds:
        action = "taken as UTC, as they overlap so; zone: says otherwise"
        remarks.append(Remark("clock", "", f"local times without a zone beside UTC ({told})", action, "warning"))
    for name, (first, last) in spans.items():
        if (outside := max(0.0, begin - first) + max(0.0, last - end)) > 1.0:
            message = f"{outside:.4g} s of {name} lie outside the other files"
            remarks.append(Remark("gap", "", message, "these were left out", "note"))
