"""Suggestions for what a model may depend on beside motion: temperatures, load, floor, consumers, what is on."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.fields import Field
from missionsim.importer.roles import Guess
from missionsim.importer.sources import identifier
from missionsim.importer.units import UNITS, words_of
from missionsim.labels import Labels

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft


def suggest(draft: Draft) -> None:
    """Temperatures, load, floor, and what else a model may depend on."""
    names = {
        "temp_ambient": "temp_ambient_c", "temp_motor": "temp_motor_c", "payload": "payload_kg", "cpu_load": "cpu_load",
        "cpu_freq": "cpu_freq_hz", "surface": "surface", "scheme": "scheme",
    }  # fmt: skip
    for role, name in names.items():
        for guess in draft.best(role, 0.5)[:1]:
            draft.column(name, draft.ref(guess.field, role), guess)
    weight = next((name for name in draft.fields if name.endswith("loads[0].weight")), None)
    if weight is not None:
        count = draft.ref(weight.replace("[0].weight", ".count"), "loads")
        payload = Guess("payload", weight, "", 1.0, "the weight of the first load, none without a load", "likely")
        draft.column("payload_kg", f"where({count} > 0, {draft.ref(weight, 'weight')}, 0)", payload)
    used = {guess.field for _, guess in draft.columns.values()}
    for guess in draft.best("power"):
        words, _ = words_of(guess.field)
        values = draft.values(guess.field)
        known = values[np.isfinite(values)]
        consumer = re.search(r"\b(heat\w*|air ?con\w*|motors?|cpu|load|charger|servo\w*|fan|pump)\b", words)
        if guess.field in used or not consumer or re.search("request|max|min", words) or not np.ptp(known):
            continue
        factor = UNITS[guess.unit][2] if guess.unit else 1.0
        ref = draft.ref(guess.field, identifier(words.replace(" ", "_")))
        why = "a consumer of its own, for an effect of yours"
        formula = ref if factor == 1.0 else f"{ref} * {factor:g}"
        draft.column(
            identifier(words.replace(" ", "_")) + "_w", formula, Guess("", guess.field, "", 0.6, why, "a guess")
        )
    for name, one in draft.fields.items():
        component = switch_name(one)
        if component is None or name in used or f"on_{component}" in draft.columns:
            continue
        guess = Guess("on", name, "", 0.5, "changes between on and off", "a guess")
        ref = draft.ref(name, f"{component}_state")
        if isinstance(one.values, Labels):
            table = ", ".join(f"{quoted(word)}: {int(_is_on(word))}" for word in one.values.names)
            draft.columns.setdefault(f"on_{component}", (f"{{lookup: {ref}, values: {{{table}}}}}", guess))
        else:
            draft.column(f"on_{component}", ref, guess)


_ON = re.compile(r"\b(on|active|enabled|running|true|open|started|working)\b", re.IGNORECASE)
_OFF = re.compile(r"\b(off|inactive|disabled|stopped|false|closed|idle|unconfigured|finalized)\b", re.IGNORECASE)
_SWITCH = re.compile(r"(on|enabled?|active|switch|state|running|powered|label|status|data|is|goal|current)\Z")
_NO_SWITCH = (
    r"\b(joy|calib\w*|previous|start|charg\w*|battery|emergency|alert|driving|count|present|localized|paused|safety)\b"
)


def _is_on(word: str) -> bool:
    return _ON.search(word) is not None and _OFF.search(word) is None


def switch_name(one: Field) -> str | None:
    """Name of a component that a field may switch on and off; None where it does not look so."""
    topic, _, last = one.name.rpartition(".")
    words = words_of(last)[0].split() if last else []
    if isinstance(one.values, Labels):
        names = one.values.names
        if len(names) < 2 or len(names) > 8 or not any(map(_is_on, names)) or not any(map(_OFF.search, names)):
            return None
    elif set(np.unique(one.values[np.isfinite(one.values)])) != {0.0, 1.0}:
        return None
    marked = any(map(_SWITCH.match, words)) or isinstance(one.values, Labels)
    left = [word for word in words if not _SWITCH.match(word)]
    if not left:  # /laser/transition_event.goal_state.label
        marks = ("transition", "event", "goal", "state")
        left = [word for word in words_of(topic.split(".")[0])[0].split() if word not in marks]
    if not marked or not left or re.search(_NO_SWITCH, words_of(one.name)[0]):
        return None
    return identifier("_".join(left))


def quoted(text: str) -> str:
    """A text as YAML: bare where it is a word or a plain formula."""
    plain = re.fullmatch(r"[A-Za-z_/][\w ./+*()-]*", text) is not None and text.lower() not in (
        "yes", "no", "on", "off", "true", "false", "null", "y", "n",
    )  # fmt: skip
    return text if plain else json.dumps(text, ensure_ascii=False)
