"""The result of a search: a fitted model, what spoke for each effect in it, and what was refused."""

from __future__ import annotations

from dataclasses import dataclass, field

from missionsim.identify.evidence import Evidence
from missionsim.identify.forward import Forward
from missionsim.identify.model import Model


@dataclass
class Choice:
    """A fitted model, what spoke for each column in it, and what was tried and refused."""

    model: Model
    empty: Model
    evidence: dict[int, Evidence]
    refused: dict[int, Evidence] = field(default_factory=dict)
    forward: Forward | None = None
    """The selection by prediction, where the base was far from right."""
