"""Suggestions for the time of a table, for what tells several runs in it apart, and for a table of runs."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from missionsim.errors import InputError
from missionsim.importer.draft import Draft, quoted
from missionsim.importer.roles import ROLES, Field, Guess, fields_of, guess_all, guess_role, says, words_of
from missionsim.importer.run_table import keys_of, names_of_file, rows_called
from missionsim.importer.sources import identifier, stamps_of
from missionsim.labels import Labels
from missionsim.logs.clean import in_turn
from missionsim.logs.raw import RawTable
from missionsim.logs.readers import source_suffixes
from missionsim.logs.times import date_and_clock, is_fine, is_stamp
from missionsim.physics import Array, Bools, Int64s


def suggest_time(draft: Draft, path: Path) -> None:
    """Add the column or columns of the time of a table to a draft, and the times themselves."""
    found = sorted(draft.best("time"), key=lambda guess: _distinct(draft.fields[guess.field].values) < 0.3)
    texts = [guess for guess in found if isinstance(draft.fields[guess.field].values, Labels)]
    if texts and not re.search(r"\d{4}", draft.fields[texts[0].field].range()):  # an epoch says more than a time of day
        found.sort(key=lambda guess: "an epoch" not in guess.why or guess.score < 1.2)
    pairs = seconds_and_nanoseconds(draft.fields)
    fine = next((pair for pair in pairs if _distinct(draft.fields[pair[1]].values) > 0.5), ())
    raw = RawTable(str(path), {one.name: one.values for one in draft.fields.values()})
    if fine and not texts and (not found or found[0].field in fine):
        names, formula = list(fine), ""
        guess = Guess("time", "\n".join(names), "", 2.0, "seconds and nanoseconds", "sure")
        refs = [draft.ref(name, alias) for name, alias in zip(names, ("secs", "nsecs"), strict=True)]
        draft.columns["time_s"] = (f"{{stamp: [{', '.join(refs)}]}}", guess)
    elif found and found[0] not in texts:
        guess = found[0]
        names, formula = [guess.field], draft.ref(guess.field, "t")
    elif texts:
        columns = [(guess, draft.fields[guess.field].values) for guess in texts]
        first = {g.field: values.names[0] for g, values in columns if isinstance(values, Labels) and values.names}
        days = [g for g in texts if not date_and_clock(first.get(g.field, ""))[1]]
        whole = [g for g in texts if g not in days and date_and_clock(first[g.field])[0]]
        clocks = [g for g in texts if g not in days and g not in whole]
        chosen = whole[:1] or ([days[0], clocks[0]] if days and clocks else clocks[:1])
        if not chosen:
            message = "dates without a time of day: give time_s a column of times"
            draft.missing.append(message)
            draft.columns["time_s"] = ("TIME", Guess("time", "", "", 0.0, message, "not found"))
            return
        names = [g.field for g in chosen]
        refs = [draft.ref(name, alias) for name, alias in zip(names, ("date", "clock"), strict=False)]
        guess = Guess("time", "\n".join(names), "", 2.0, "time stamps", "sure")
        draft.columns["time_s"] = (f"{{stamp: [{', '.join(refs)}]}}", guess)
        formula = ""
    else:
        numbers = [one for one in draft.fields.values() if not isinstance(one.values, Labels) and len(one.values) > 2]
        counts = (one.name for one in numbers if (np.diff(np.asarray(one.values)) == 1).all())  # counts the rows
        table = one_row_a_run(draft.fields, path)
        index = "" if table else next(counts, "")
        message = table or "no column looks like a time: write it in the place of TIME"
        if index:
            message = f"no column is a time; '{index}' counts the rows: put their rate in the place of RATE"
            draft.head["constants"] = "{rate: RATE Hz}"
            draft.time_s = draft.values(index) * 0.01
        draft.missing.append(message)
        guess = Guess("time", index, "", 0.0, message, "not found")
        draft.columns["time_s"] = (f"{draft.ref(index, 'index')} / rate" if index else "TIME", guess)
        return
    try:
        stamps = stamps_of(raw, names, None, guess.unit or None)
    except InputError as error:
        draft.missing.append(str(error.faults[0].message))
        draft.columns.setdefault("time_s", ("TIME", guess))
        return
    draft.time_s, draft.clock = stamps.seconds, stamps.kind
    if formula and stamps.kind == "own" and _is_clock(stamps.seconds):
        hours, minutes, seconds = f"{formula} // 10000", f"{formula} // 100 % 100", f"{formula} % 100"
        draft.time_s = stamps.seconds // 10000 * 3600 + stamps.seconds // 100 % 100 * 60 + stamps.seconds % 100
        told = replace(guess, why=f"{guess.why}; hours, minutes and seconds in one number, as GPS receivers write")
        draft.column("time_s", f"{hours} * 3600 + {minutes} * 60 + {seconds}", told)
    if formula:
        words = "" if stamps.kind == "own" else f", {stamps.form}"
        draft.column("time_s", formula, replace(guess, why=guess.why + words))
    else:
        told = replace(guess, why=f"{guess.why}, {stamps.form}" if guess.field == "\n".join(fine) else stamps.form)
        draft.columns["time_s"] = (draft.columns["time_s"][0], told)


_SECONDS, _NANOSECONDS = r"(?i)(?<![a-z])s(ec(ond)?s?)?\Z", r"(?i)(?<![a-z])n(ano)?s(ec(ond)?s?)?\Z"


def seconds_and_nanoseconds(fields: Mapping[str, Field]) -> list[tuple[str, str]]:
    """Columns that are one time together: their names are alike but for the unit; or without names, and an epoch."""
    fine = [name for name in fields if re.search(_NANOSECONDS, name)]
    named = [
        (name, other)
        for name in fields
        for other in fine
        if re.search(_SECONDS, name) and re.sub(_SECONDS, "", name) == re.sub(_NANOSECONDS, "", other)
        if is_fine(fields[name].values, fields[other].values)
    ]
    return named or [
        pair
        for pair in itertools.pairwise(fields)
        if all(re.fullmatch(r"col_\d+", name) for name in pair) and _is_epoch(*(fields[name].values for name in pair))
    ]


def _is_epoch(whole: Array | Labels, nano: Array | Labels) -> bool:
    """Whether two columns without names are seconds since 1970 and their nanoseconds, which grow from row to row."""
    if isinstance(whole, Labels) or isinstance(nano, Labels) or not is_fine(whole, nano) or np.nanmin(whole) < 5e8:
        return False
    return float(np.mean(np.diff(whole + 1e-9 * nano) >= 0)) > 0.95


def _is_clock(values: Array) -> bool:
    """Whether numbers are a time of day as ``hhmmss.ss``: no seconds and minutes from 60 on, so it jumps by 40."""
    known = values[np.isfinite(values)]
    if len(known) < 20 or not (known < 240000).all() or not 30 < float((known % 100).max()) < 60:
        return False
    return bool((known // 100 % 100 < 60).all() and (np.diff(known // 100) > 0).any())


def _distinct(values: Array | Labels) -> float:
    """Share of the rows at which a column changes."""
    codes = values.codes if isinstance(values, Labels) else values
    return float(np.mean(codes[1:] != codes[:-1])) if len(codes) > 1 else 1.0


_CLASHES, _MOST, _ROWS = 0.1, 50, 10
"""Part of the rows with the time of another one from which they are of several recordings; most of these, and rows that
each has at least (assumed)."""


def recognised_runs(
    fields: Mapping[str, Field], time_s: Array | None, times: set[str], turning: Mapping[str, str]
) -> dict[str, str]:
    """How several runs in one table are told apart, for a suggested map: by columns, where time restarts, at gaps.
    `turning`: column → field, of those that jump back and forth. Gives ``runs`` → its value as YAML; empty for one run.
    """
    if time_s is None or len(time_s) < 4:
        return {}
    if (apart := _in_turn(fields, time_s, times, turning)) is not None:
        more = [name for name in fields if name not in (apart, *times) and says("run", words_of(name)[0])]
        return {"runs": f"{{by: [{', '.join(map(identifier, [apart, *more]))}]}}  # several recordings in one file"}
    step = np.diff(time_s[np.maximum.accumulate(np.where(np.isfinite(time_s), np.arange(len(time_s)), 0))])
    usual = float(np.nanmedian(np.abs(step)))
    restarts = step < -max(1.0, 10 * usual)
    changes: dict[str, Bools] = {}
    for name, one in fields.items():
        values = _counts(one)
        if name in times or values is None:
            continue
        change = values[1:] != values[:-1]
        if change.any() and (not restarts.any() or not (change & ~restarts).any()):
            changes[name] = change
    if restarts.any():
        together = np.logical_or.reduce(list(changes.values())) if changes else np.zeros_like(restarts)
        if (together == restarts).all():
            return {"runs": f"{{by: [{', '.join(map(identifier, changes))}]}}  # time begins anew where these change"}
        return {"runs": "{restart: true}  # time begins anew"}
    named = [name for name in changes if says("run", words_of(name)[0])]
    if named:
        return {"runs": f"{{by: [{', '.join(map(identifier, named))}]}}"}
    wide = step > max(60.0, 100 * usual)
    return {"runs": "{gap: 60 s}  # long holes in time"} if wide.any() else {}


_TABLE_BYTES, _BESIDE = 1 << 20, 100
"""Size of a table of runs at most, and files of a folder among which it is looked for (both assumed)."""
_NO_CAUSE = ("power", "voltage", "current", "energy", "speed", "distance", "time")
"""Roles of a column of runs that a run brought about, or that tell when it was."""


def table_of_runs(paths: Sequence[Path], runs: Sequence[str] = ()) -> tuple[Path, list[str], list[Field]] | None:
    """The table beside some logs, or above them, that has a row for each: its path, the column that names the runs (or
    several that name them as well, but not the same rows), and its other columns; None where there is none. `runs`:
    where one log holds several, what tells them apart."""
    names = [[run] for run in runs] or [[*names_of_file(path), path.resolve().parent.name] for path in paths]
    words = [word.lstrip("0").encode() for one in names for word in one[-2:]]
    beside = dict.fromkeys(folder for path in paths for folder in (path.resolve().parent, path.resolve().parent.parent))
    for file in (file for folder in beside for file in sorted(folder.glob("*.[ct]sv"))[:_BESIDE]):
        given = file.is_file() and any(file.samefile(path) for path in paths)
        if not file.is_file() or file.stat().st_size > _TABLE_BYTES or (given and len(paths) == 1):
            continue
        text = file.read_bytes()
        if given and any(_head(path) == _head(file) for path in paths if path.is_file() and not file.samefile(path)):
            continue  # one of several logs
        if not any(re.search(rb"\d+\Z", word) or word in text for word in words):
            continue
        try:
            fields = fields_of(file)
        except InputError:
            continue
        logs = names
        if not runs:  # the folder of the table names no run
            outside = [(one, path) for one, path in zip(names, paths, strict=True) if not file.samefile(path)]
            logs = [one if path.resolve().parent != file.parent else one[:-1] for one, path in outside]
        fitting: list[tuple[bool, Field, list[list[int]]]] = []
        for one in fields:
            keys = keys_of(one.values)
            if len(keys) < 2 or len(set(keys)) < len(keys) or len(fields) < 2 or guess_role(one, ROLES["time"]):
                continue
            found = [rows_called(keys, log) for log in logs]
            called = words_of(one.name)[0]
            named = isinstance(one.values, Labels) or bool(runs) or says("run", called)
            # of one log, any table has a row of its number
            named = named or (len(logs) > 1 and says("number", called))
            met = {row for rows in found for row in rows}
            if named and sum(map(bool, found)) > 0.5 * len(logs) and len(met) > (len(logs) > 1):
                fitting.append((isinstance(one.values, Labels), one, found))
        if fitting:
            words_first = max(by_word for by_word, _, _ in fitting)  # numbers come by chance
            (_, best, rows), *others = (one for one in fitting if one[0] == words_first)
            alike = [best, *(one for _, one, other in others if other != rows)]
            return file, [one.name for one in alike], [one for one in fields if one not in alike]
    return None


def _head(path: Path) -> bytes:
    """The first line of a file."""
    with path.open("rb") as file:
        return file.readline(1 << 16).strip()


def join_runs(draft: Draft, path: Path, keys: Sequence[str], columns: Sequence[Field]) -> None:
    """Take what a table of runs says of the conditions of a run into a draft, as fields ``runs.column``."""
    key = keys[0] if len(keys) == 1 else "KEY"
    if len(keys) > 1:
        named = " and ".join(f"'{one}'" for one in keys)
        draft.missing.append(
            f"{path.name}: {named} name the runs, but not the same rows: write one in the place of KEY"
        )
    given = draft.head.get("runs", "{}")
    more = ", " if given != "{}" else ""
    draft.head["runs"] = given.replace("{", f"{{table: {quoted(path.name)}, key: {quoted(key)}{more}", 1)
    for one in columns:
        guess = guess_all([one]).get(one.name)
        words = words_of(one.name)[0]
        stamps = isinstance(one.values, Labels) and any(map(is_stamp, one.values.names[:1]))
        if not (stamps or (guess and guess.role in _NO_CAUSE) or says("result", words) or says("notes", words)):
            draft.fields[f"runs.{one.name}"] = replace(one, name=f"runs.{one.name}", count=0)


def one_row_a_run(fields: Mapping[str, Field], path: Path) -> str:
    """What is said of a table without times of which each row is a run: of results, or of conditions; else nothing."""
    results = [name for name in fields if says("result", words_of(name)[0])]
    texts = {name: one.values for name, one in fields.items() if isinstance(one.values, Labels)}
    distinct = (name for name, labels in texts.items() if len(np.unique(labels.codes)) == len(labels))
    runs = [name for name in distinct if says("run", words_of(name)[0])]
    if len(results) < 2 and not runs:
        return ""
    logs = sorted(p.relative_to(path.parent) for p in path.parent.glob("*/*") if p.suffix.lower() in source_suffixes())
    logs = logs or sorted(p.relative_to(path.parent) for p in path.parent.glob("*/*/*.csv"))
    there = f"; the logs are perhaps {logs[0].as_posix()} and {len(logs) - 1} more files" if logs else ""
    return f"one row a run ({', '.join([*runs, *results])}): a table of runs, and no log of one{there}"


def _counts(one: Field) -> Array | Int64s | None:
    """Values of a column of words or of whole numbers; None for any other."""
    if isinstance(one.values, Labels):
        return one.values.codes
    return one.values if np.isfinite(one.values).all() and (one.values == np.round(one.values)).all() else None


def _in_turn(fields: Mapping[str, Field], time_s: Array, times: set[str], turning: Mapping[str, str]) -> str | None:
    """The column that tells recordings apart whose rows stand in one table in any order: one that is called so, or
    without which rows have the times of others, or values jump back and forth. What tells apart messages that fill
    their own columns is none.
    """
    clashes = float(np.mean(np.diff(np.sort(time_s[np.isfinite(time_s)])) == 0)) > _CLASHES
    for name, one in fields.items():
        values = _counts(one)
        called = says("vehicle", words_of(name)[0])
        if name in (*times, *turning.values()) or values is None or not (called or clashes or turning):
            continue
        _, group, count = np.unique(values, return_inverse=True, return_counts=True)
        if not 2 <= len(count) <= _MOST or count.min() < _ROWS:
            continue
        order = np.argsort(group, kind="stable")
        parted = {column: np.asarray(fields[field].values)[order] for column, field in turning.items()}
        if not (called or clashes) and in_turn({"time_s": time_s[order]} | parted):
            continue  # it does not tell them apart
        step = np.diff(time_s[order])[np.diff(group[order]) == 0]
        numbers = [np.isfinite(other.values) for other in fields.values() if not isinstance(other.values, Labels)]
        shares = [np.bincount(group, known) / count for known in numbers]
        alike = all(np.ptp(share) < 0.5 for share in shares)
        if alike and (called or (np.nan_to_num(step, nan=1.0) > 0).all()):
            return name
    return None
