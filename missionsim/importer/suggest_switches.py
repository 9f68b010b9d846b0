"""Suggestions for what is switched: a column that changes between on and off, and says of which component."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from missionsim.importer.draft import Draft, quoted
from missionsim.importer.roles import Field, Guess, says, words_of
from missionsim.importer.sources import identifier
from missionsim.labels import Labels


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
