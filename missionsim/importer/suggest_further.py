"""Suggestions for what else a log holds: what is switched on and off, and further columns under their own names."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from missionsim.glossary import column_of
from missionsim.importer.draft import Draft, quoted
from missionsim.importer.roles import Field, Guess, folded, guess_all, says, words_of
from missionsim.importer.sources import identifier
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


def _is_on(word: str) -> bool:
    return says("on", word) and not says("off", word)


def _turns(one: Field) -> bool:
    """Whether a field changes between on and off."""
    if isinstance(one.values, Labels):
        names = one.values.names
        return 2 <= len(names) <= 8 and any(map(_is_on, names)) and any(says("off", name) for name in names)
    return set(np.unique(one.values[np.isfinite(one.values)])) == {0.0, 1.0}


def _switch_name(one: Field) -> str | None:
    """Name of a component that a field may switch on and off; None where it does not look so."""
    topic, _, last = one.name.rpartition(".")
    words = words_of(last)[0].split() if last else []
    if not _turns(one):
        return None
    marked = any(says("switch", word) for word in words) or isinstance(one.values, Labels)
    left = [word for word in words if not says("switch", word)]
    if not left:  # /laser/transition_event.goal_state.label
        marks = ("transition", "event", "goal", "state")
        left = [word for word in words_of(topic.split(".")[0])[0].split() if word not in marks]
    if not marked or not left or says("no_switch", words_of(one.name)[0]):
        return None
    return identifier("_".join(left))


def suggest_switches(draft: Draft, components: Collection[str]) -> None:
    """Add what is switched. `components`: those of the robot, of which a name alone says it (``lamp``); some that are
    not seen, and columns that may be of them, are told."""
    used = {guess.field for _, guess in draft.columns.values()}
    left = []
    for name, one in draft.fields.items():
        own = identifier(words_of(name.rpartition(".")[2])[0].replace(" ", "_"))
        component = own if own in components and _turns(one) else _switch_name(one)
        if component is None or name in used or f"on_{component}" in draft.columns:
            left += [name] if name not in used and not isinstance(one.values, Labels) and _turns(one) else []
            continue
        guess = Guess("on", name, "", 0.5, "changes between on and off", "a guess")
        ref = draft.ref(name, f"{component}_state")
        if isinstance(one.values, Labels):
            table = ", ".join(f"{quoted(word)}: {int(_is_on(word))}" for word in one.values.names)
            draft.columns.setdefault(f"on_{component}", (f"{{lookup: {ref}, values: {{{table}}}}}", guess))
        else:
            draft.column(f"on_{component}", ref, guess)
    unseen = [one for one in components if f"on_{one}" not in draft.columns]
    if unseen and left:
        names, told = ", ".join(map(quoted, left[:6])), "no column says when this component of the robot is on"
        draft.remarks.append(f"{told}: {', '.join(unseen[:6])}; is it one of {names}? (`on_{unseen[0]}: COLUMN`)")
