"""Suggestions by the names of files and folders, in which people write what they changed from run to run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.importer.roles import Guess, known_unit, size_of
from missionsim.importer.suggest_motion import quoted
from missionsim.logs.readers import run_of

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft

_FLOORS = (
    r"(?i)(carpet|rug|tiles?|wood|parquet|laminate|lino\w*|vinyl|concrete|cement|asphalt|tarmac|paved?|pavement|cobble\w*"
    r"|grass|lawn|gravel|sand|mud|dirt|soil|snow|ice|teppich|fliesen?|holz|beton|rasen|wiese|kies|schnee|pflaster)\Z"
)
_LOAD = re.compile(r"(?i)[a-z]*[-_]?(\d+(?:\.\d+)?)(kg|g)\Z")


def from_names(draft: Draft, paths: Sequence[Path]) -> None:
    """Add floor and payload where the names of several files, or of their folders, tell them; other words that differ
    from file to file, of which each has one, are told."""
    for words in _differing(paths):
        loads = {word: found for word in words if (found := _LOAD.match(word))}
        listed = ", ".join(map(quoted, words))
        if len(loads) == len(words) and "payload_kg" not in draft.columns:
            values = ", ".join(
                f"{quoted(word)}: {float(found[1]) * size_of(known_unit(found[2].lower())):g}"
                for word, found in loads.items()
            )
            guess = Guess("payload", "", "", 0.6, "the names of the files", "a guess")
            draft.columns["_load"] = (f"{{file_name: [{listed}]}}", guess)
            draft.columns["payload_kg"] = (f"{{lookup: _load, values: {{{values}}}}}", guess)
        elif any(re.match(_FLOORS, word) for word in words) and "surface" not in draft.columns:
            guess = Guess("surface", "", "", 0.6, "the names of the files", "a guess")
            draft.columns["surface"] = (f"{{file_name: [{listed}]}}", guess)
        else:
            told = f"the names of the files differ: `condition: {{file_name: [{listed}]}}` makes a column of it"
            draft.remarks.append(told)


def _differing(paths: Sequence[Path]) -> list[list[str]]:
    """Words that stand at one place of the names, or of those of the folders, and differ: each in several files, or one
    that is a load; no numbers, dates or days."""
    if len(paths) < 3 or len({path.suffix for path in paths}) > 1:
        return []
    found: list[list[str]] = []
    for names in ([run_of(path) for path in paths], [path.resolve().parent.name for path in paths]):
        parts = [re.split(r"[_\s-]+", name) for name in names]
        if len({len(part) for part in parts}) > 1:
            continue
        for place in zip(*parts, strict=True):
            words = list(dict.fromkeys(place))
            plain = all(re.fullmatch(r"[^\W\d_]{3,}", word) or _LOAD.match(word) for word in words)
            if plain and 1 < len(words) < len(paths) and words not in found:
                found.append(words)
    return found
