"""A map in the making, to which each room of suggestions adds what it sees."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from keyword import iskeyword

import numpy as np

from missionsim.expressions import FUNCTIONS
from missionsim.importer.roles import ROLES, Field, Guess, guess_role, size_of
from missionsim.importer.sources import identifier
from missionsim.physics import Array


@dataclass
class Draft:
    """A map in the making."""

    fields: dict[str, Field]
    """Field → what was read of it; fields of joined files as ``file.column``."""
    direct: bool
    """Whether formulas may name the columns themselves (a single table)."""
    time_s: Array | None = None
    """Times of the rows of a single table, once they are known."""
    _: KW_ONLY
    signals: dict[str, str] = field(default_factory=dict)
    fills: dict[str, str] = field(default_factory=dict)
    head: dict[str, str] = field(default_factory=dict)
    let: dict[str, str] = field(default_factory=dict)
    columns: dict[str, tuple[str, Guess]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    clock: str = "own"
    clocks: dict[str, str] = field(default_factory=dict)
    """Both: kind of the times of a table, and of each of several files by its short name."""
    _totals: dict[str, str] = field(default_factory=dict)
    """Helper that is a sum → what it is called as a field."""

    @property
    def told(self) -> set[str]:
        """Fields that some column tells."""
        return {name for _, guess in self.columns.values() for name in guess.field.split("\n")}

    def best(self, role: str, least: float = 0.3) -> list[Guess]:
        """The guesses for a role, best first, also of fields that another role fits better."""
        used = self.told | {*self.signals.values()}
        guesses = [guess_role(one, ROLES[role]) for one in self.fields.values() if one.name not in used]
        found = [guess for guess in guesses if guess is not None and guess.score > least]
        return sorted(found, key=lambda guess: (-guess.score, len(guess.field)))

    def values(self, name: str, unit: str = "") -> Array:
        """Numbers of a field in the glossary's unit."""
        return np.asarray(self.fields[name].values, dtype=np.float64) * size_of(unit)

    def ref(self, name: str, alias: str) -> str:
        """How a formula names a field: itself, or a short name in `signals`."""
        if self.direct and identifier(name) == name and name not in FUNCTIONS and name != "pi" and not iskeyword(name):
            return name
        for known, there in (*self.signals.items(), *self._totals.items()):
            if there == name:
                return known
        taken = {identifier(other) for other in self.fields} if self.direct else set()
        while alias in taken or alias in self.signals or alias in FUNCTIONS or iskeyword(alias):
            alias += "_"
        self.signals[alias] = name
        return alias

    def total(self, name: str, alias: str, fields: Sequence[str], factors: Sequence[float] = ()) -> str:
        """The sum of fields of one table or topic, each times its factor, as a helper; what it is called as a field."""
        first, sizes = self.fields[fields[0]], factors or [1.0] * len(fields)
        terms = [self.ref(one, f"{alias}_{i}") for i, one in enumerate(fields, 1)]
        terms = [f"{term} * {size:g}" if size != 1.0 else term for term, size in zip(terms, sizes, strict=True)]
        values = np.sum([size * self.values(one) for one, size in zip(fields, sizes, strict=True)], axis=0)
        full = name if self.direct else f"{first.name.rpartition('.')[0]}.{name}"
        self.let[name], self._totals[name] = " + ".join(terms), full
        self.fields[full] = replace(first, name=full, count=len(values), values=values, title="")
        return full

    def column(self, name: str, formula: str, guess: Guess) -> None:
        """A column of the log; the first that is given stays."""
        if name in self.columns:
            return
        formula = quoted(formula)
        if guess.unit:
            formula = f"{{value: {formula}, unit: {quoted(guess.unit)}}}"
        self.columns[name] = (formula, guess)


def quoted(text: str) -> str:
    """A text as YAML: bare where it is a word or a plain formula."""
    plain = re.fullmatch(r"[A-Za-z_/][\w ./+*()-]*", text) is not None and text.lower() not in (
        "yes", "no", "on", "off", "true", "false", "null", "y", "n",
    )  # fmt: skip
    return text if plain else json.dumps(text, ensure_ascii=False)
