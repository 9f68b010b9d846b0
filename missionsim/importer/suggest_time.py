"""A suggestion for the time of a table: numbers, stamps, a date and a time of day, seconds and nanoseconds."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from missionsim.errors import InputError
from missionsim.importer.roles import Field, Guess
from missionsim.importer.sources import stamps_of
from missionsim.importer.suggest_runs import one_row_a_run
from missionsim.labels import Labels
from missionsim.logs.raw import RawTable
from missionsim.logs.times import date_and_clock, is_fine
from missionsim.physics import Array

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft


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
