"""Suggestions of how several runs in one table are told apart."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from missionsim.importer.roles import Field, words_of
from missionsim.importer.sources import identifier
from missionsim.labels import Labels
from missionsim.logs.readers import source_suffixes
from missionsim.physics import Array

_RUN = re.compile(r"\b((test ?)?run|trip|session|experiment|config\w*|trial|fahrt|versuch)s?\d*\b")
"""Words of a column that tells runs apart: no part of a word, such as that of ground."""


_VEHICLE = re.compile(
    r"(vehicle|robot|agv|amr|rover|truck|device|roboter|fahrzeug|vehicule|vehiculo)s?( (id|name|nr|no|num|number))?"
)
_CLASHES, _MOST, _ROWS = 0.1, 50, 10
"""Part of the rows with the time of another one from which they are of several recordings; most of these, and rows that
each has at least (assumed)."""


def recognised_runs(fields: Mapping[str, Field], time_s: Array | None, times: set[str]) -> dict[str, str]:
    """How several runs in one table are told apart, for a suggested map: by columns, where time restarts, at gaps.
    Gives ``runs`` → its value as YAML; empty for one run."""
    if time_s is None or len(time_s) < 4:
        return {}
    if (apart := _in_turn(fields, time_s, times)) is not None:
        more = [name for name in fields if name not in (apart, *times) and _RUN.search(words_of(name)[0])]
        return {"runs": f"{{by: [{', '.join(map(identifier, [apart, *more]))}]}}  # several recordings in one file"}
    step = np.diff(time_s)
    usual = float(np.median(np.abs(step)))
    restarts = step < -max(1.0, 10 * usual)
    changes: dict[str, NDArray[np.bool_]] = {}
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
    named = [name for name in changes if _RUN.search(words_of(name)[0])]
    if named:
        return {"runs": f"{{by: [{', '.join(map(identifier, named))}]}}"}
    wide = step > max(60.0, 100 * usual)
    return {"runs": "{gap: 60 s}  # long holes in time"} if wide.any() else {}


_RESULT = re.compile(r"\b(duration|mean|avg|average|dauer|mittel\w*|mittlere\w*|duree|moyenne|duracion|media)\b")


def one_row_a_run(fields: Mapping[str, Field], path: Path) -> str:
    """What is said of a table without times of which each row is a run: of results, or of conditions; else nothing."""
    results = [name for name in fields if _RESULT.search(words_of(name)[0])]
    texts = {name: one.values for name, one in fields.items() if isinstance(one.values, Labels)}
    distinct = (name for name, labels in texts.items() if len(np.unique(labels.codes)) == len(labels))
    runs = [name for name in distinct if _RUN.search(words_of(name)[0])]
    if len(results) < 2 and not runs:
        return ""
    logs = sorted(p.relative_to(path.parent) for p in path.parent.glob("*/*") if p.suffix.lower() in source_suffixes())
    logs = logs or sorted(p.relative_to(path.parent) for p in path.parent.glob("*/*/*.csv"))
    there = f"; the logs are perhaps {logs[0].as_posix()} and {len(logs) - 1} more files" if logs else ""
    return f"one row a run ({', '.join([*runs, *results])}): a table of runs, and no log of one{there}"


def _counts(one: Field) -> Array | NDArray[np.int64] | None:
    """Values of a column of words or of whole numbers; None for any other."""
    if isinstance(one.values, Labels):
        return one.values.codes
    return one.values if np.isfinite(one.values).all() and (one.values == np.round(one.values)).all() else None


def _in_turn(fields: Mapping[str, Field], time_s: Array, times: set[str]) -> str | None:
    """The column that tells recordings apart whose rows stand in one table in any order: one that is called so, or
    without which rows have the times of others. What tells apart messages that fill their own columns is none.
    """
    clashes = float(np.mean(np.diff(np.sort(time_s[np.isfinite(time_s)])) == 0)) > _CLASHES
    for name, one in fields.items():
        values = _counts(one)
        called = _VEHICLE.fullmatch(words_of(name)[0]) is not None
        if name in times or values is None or not (called or clashes):
            continue
        _, group, count = np.unique(values, return_inverse=True, return_counts=True)
        if not 2 <= len(count) <= _MOST or count.min() < _ROWS:
            continue
        order = np.argsort(group, kind="stable")
        step = np.diff(time_s[order])[np.diff(group[order]) == 0]
        numbers = [np.isfinite(other.values) for other in fields.values() if not isinstance(other.values, Labels)]
        shares = [np.bincount(group, known) / count for known in numbers]
        alike = all(np.ptp(share) < 0.5 for share in shares)
        if alike and (called or (np.nan_to_num(step, nan=1.0) > 0).all()):
            return name
    return None
