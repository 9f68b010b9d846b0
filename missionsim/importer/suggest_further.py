"""Suggestions for what has no name of the glossary: further columns, under their own names."""

from __future__ import annotations

import re

import numpy as np

from missionsim.glossary import column_of
from missionsim.importer.draft import Draft
from missionsim.importer.roles import Field, Guess, folded, guess_all, says, words_of
from missionsim.labels import Labels
from missionsim.physics import Array

_MOST = 12
"""Further columns at most (assumed): each one more is one more that chance may find."""
_ROLES = (*"xy", "power", "voltage", "current", "energy", "charge", "time", "speed", "heading", "elevation", "distance")
"""What tells the power again, or where and when it was."""
_SAME = 0.98
"""Correlation from which a number tells what a column tells already (assumed)."""
_NEAR = 0.02
"""Part of a recording by which a topic may begin later than the others, or end before them (assumed): rows begin when
every signal has come."""


def suggest(draft: Draft) -> None:
    """Add numbers that change and have no place yet; and all that a table of runs says."""
    used = draft.told | {*draft.signals.values()}
    left = [one for name, one in draft.fields.items() if name not in used]
    of_runs = [one for one in left if one.name.startswith("runs.") and "table:" in draft.head.get("runs", "")]
    known = [draft.fields[name] for name in used if name in draft.fields]
    chosen = [one for one in left if one not in of_runs and _tells(draft, one) and not _again(one, known)]
    if draft.direct and len(chosen) > _MOST:
        draft.remarks.append(f"{len(chosen)} further columns are not used: `others: true` keeps them")
        chosen = []
    for one in [*sorted(chosen, key=lambda one: len(one.name))[:_MOST], *of_runs]:
        name = _own_name(draft, one.name)
        if name in draft.columns or column_of(name) is not None:
            continue
        guess = Guess("", one.name, "", 0.5, "a further column, for an effect of yours", "a guess")
        draft.column(name, draft.ref(one.name, name), guess)


def _tells(draft: Draft, one: Field) -> bool:
    """Whether a field is a number that changes, of no usual message, and there while the others are."""
    words = words_of(one.name)[0]
    if isinstance(one.values, Labels) or folded(one) is not None or says("no_cause", words):
        return False
    guess = guess_all([one]).get(one.name)
    if guess is not None and guess.role in _ROLES:
        return False
    if draft.direct:
        return True
    if "/msg/" not in one.title or says("usual_message", one.title) or one.time_s is None:
        return False
    times = [known for name in draft.signals.values() if (known := draft.fields[name].time_s) is not None]
    return bool(times) and _beside(one, times)


def _again(one: Field, known: list[Field]) -> bool:
    """Whether a field goes with one that is taken already, message by message."""
    mine = np.asarray(one.values, dtype=np.float64)
    for other in known:
        if isinstance(other.values, Labels) or len(other.values) != len(mine):
            continue
        both = np.isfinite(mine) & np.isfinite(other.values)
        pair = mine[both], other.values[both]
        if len(pair[0]) > 2 and min(map(np.ptp, pair)) > 0 and abs(float(np.corrcoef(*pair)[0, 1])) > _SAME:
            return True
    return False


def _beside(one: Field, times: list[Array]) -> bool:
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    mine, near = np.asarray(one.time_s), _NEAR * (end - begin)
    return bool(mine[0] <= begin + near and (mine[-1] >= end - near or one.count > len(mine)))


def _own_name(draft: Draft, field: str) -> str:
    """Name of a further column: the field's own, with the topic's where it says too little."""
    name = field.removeprefix("runs.")
    if field.startswith("/"):
        topic, _, inner = field.partition(".")
        last = topic[topic.rindex("/") :]
        alike = {other.partition(".")[0] for other in draft.fields if other.partition(".")[0].endswith(last)}
        inner = re.sub(r"^(data|value)(?=\[|$)", "", inner)
        name = f"{topic if len(alike) > 1 else last}_{inner}"
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    return word if re.match(r"[A-Za-z]", word) else f"column_{word}"
