"""Several runs in one file: split where a column changes, where time restarts, or at long gaps."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.importer.roles import Field
from missionsim.importer.sources import identifier
from missionsim.inputs.log_map import MapSpec, RunsMap
from missionsim.labels import Labels
from missionsim.logs.raw import RawTable, Remark
from missionsim.physics import Array


@dataclass
class Part:
    """Rows of one run in the source, and its name."""

    name: str
    rows: NDArray[np.int64]
    remarks: list[Remark] = field(default_factory=list)


def split_runs(raw: RawTable, stem: str, spec: MapSpec, time_s: Array) -> list[Part]:
    """Rows of each run, in the order in which they begin.

    With ``by``, rows with the same values belong together wherever they stand (two files joined and sorted do not
    break); with ``restart``, a jump of time back by more than a second (or ten steps) begins another run.
    """
    groups = [Part(stem, np.arange(raw.rows))]
    if spec.runs.by:
        groups = _by_columns(raw, stem, spec.runs.by)
    if spec.runs.restart:
        groups = [piece for group in groups for piece in _restarts(group, time_s)]
    return groups


def _by_columns(raw: RawTable, stem: str, names: tuple[str, ...]) -> list[Part]:
    code = np.zeros(raw.rows, dtype=np.int64)
    for name in names:
        data: Any = raw.columns[name]
        _, inverse = np.unique(data.codes if isinstance(data, Labels) else data, return_inverse=True)
        code = code * (int(inverse.max(initial=0)) + 1) + inverse
    _, first, code = np.unique(code, return_index=True, return_inverse=True)
    rows = np.split(np.argsort(code, kind="stable"), np.cumsum(np.bincount(code))[:-1])
    parts = []
    for index in np.argsort(first):
        at = int(first[index])
        words = [_word(raw.columns[name], at) for name in names]
        parts.append(Part(file_name("_".join([stem, *words])), rows[index]))
    return parts


def _word(data: Any, row: int) -> str:
    if isinstance(data, Labels):
        return data.names[data.codes[row]] if data.codes[row] >= 0 else "none"
    return f"{data[row]:g}"


def file_name(text: str) -> str:
    """A text as a name of a file: letters, digits, dot, dash and underscore."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")[:120] or "run"


def _restarts(part: Part, time_s: Array) -> list[Part]:
    time = time_s[part.rows]
    step = np.diff(time)
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    at = np.flatnonzero(step < -max(1.0, 10 * usual)) + 1
    return _numbered(part, np.split(np.arange(len(time)), at)) if len(at) else [part]


def _numbered(part: Part, pieces: list[NDArray[np.int64]]) -> list[Part]:
    width = max(2, len(str(len(pieces) - 1)))
    return [
        Part(f"{part.name}_{index:0{width}d}", part.rows[piece], part.remarks) for index, piece in enumerate(pieces)
    ]


def split_at_gaps(name: str, time_s: Array, runs: RunsMap) -> list[tuple[str, NDArray[np.int64], list[Remark]]]:
    """Pieces of a run between gaps longer than ``runs.gap``; pieces under ``runs.shortest`` are left out and told.

    What was left out is told in the first piece.
    """
    pieces = [np.arange(len(time_s))]
    if runs.gap is not None:
        pieces = np.split(pieces[0], np.flatnonzero(np.diff(time_s) > float(runs.gap)) + 1)
    shortest = float(runs.shortest) if runs.shortest is not None else 0.0
    long = [piece for piece in pieces if len(piece) >= 2 and time_s[piece[-1]] - time_s[piece[0]] >= shortest]
    left = sum(len(piece) for piece in pieces) - sum(len(piece) for piece in long)
    told = f"{len(pieces) - len(long)} pieces of {name} ({left} rows) are too short"
    remarks = [Remark("gap", "", told, "left out", "note", 0, left)] if left else []
    whole = Part(name, np.arange(len(time_s)))
    named = _numbered(whole, long) if len(pieces) > 1 else [Part(name, piece) for piece in long]
    return [(part.name, part.rows, remarks if index == 0 else []) for index, part in enumerate(named)]


def recognised_runs(fields: Mapping[str, Field], time_s: Array | None, times: set[str]) -> dict[str, str]:
    """How several runs in one table are told apart, for a suggested map: by columns, where time restarts, at gaps.

    Gives ``runs`` → its value as YAML; empty for one run.
    """
    if time_s is None or len(time_s) < 4:
        return {}
    step = np.diff(time_s)
    usual = float(np.median(np.abs(step)))
    restarts = step < -max(1.0, 10 * usual)
    changes: dict[str, NDArray[np.bool_]] = {}
    for name, one in fields.items():
        values = one.values.codes if isinstance(one.values, Labels) else one.values
        whole = isinstance(one.values, Labels) or (np.isfinite(values).all() and (values == np.round(values)).all())
        if name in times or not whole:
            continue
        change = values[1:] != values[:-1]
        if change.any() and (not restarts.any() or not (change & ~restarts).any()):
            changes[name] = change
    if restarts.any():
        together = np.logical_or.reduce(list(changes.values())) if changes else np.zeros_like(restarts)
        if (together == restarts).all():
            return {"runs": f"{{by: [{', '.join(map(identifier, changes))}]}}  # time begins anew where these change"}
        return {"runs": "{restart: true}  # time begins anew"}
    named = [name for name in changes if re.search(r"run|trip|session|experiment|config|trial", name, re.IGNORECASE)]
    if named:
        return {"runs": f"{{by: [{', '.join(map(identifier, named))}]}}"}
    wide = step > max(60.0, 100 * usual)
    return {"runs": "{gap: 60 s}  # long holes in time"} if wide.any() else {}
