"""Batches of evaluated rows as one table, and a table as totals by segment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from missionsim.effects.covariates import Labels
from missionsim.effects.timeline import Lazily, Timeline
from missionsim.engine.batteries import Battery
from missionsim.engine.meter import Batch, Energies
from missionsim.engine.outcome import J_PER_WH


def joined(batches: list[Batch], batteries: Mapping[str, Battery]) -> tuple[Timeline, Energies, dict[str, Any]]:
    """One table of all batches."""
    if not batches:
        empty = np.zeros(0)
        return Timeline(empty, empty, {}), {name: {} for name in batteries}, dict.fromkeys(batteries, empty)
    charge = {
        name: np.concatenate([battery.charge_j(batch.states[name]) for batch in batches]) / J_PER_WH
        for name, battery in batteries.items()
    }
    if len(batches) == 1:
        return batches[0].timeline, batches[0].energies, charge
    lines = [batch.timeline for batch in batches]
    first = lines[0]
    line = Timeline(
        np.concatenate([item.start_s for item in lines]),
        np.concatenate([item.duration_s for item in lines]),
        Lazily({name: name for name in first.columns}, lambda name: _stacked([line.columns[name] for line in lines])),
        Lazily({name: name for name in first.rates}, lambda name: np.concatenate([line.rates[name] for line in lines])),
        np.concatenate([item.segment for item in lines]),
        first.constants,
    )
    energies = {
        name: {key: np.concatenate([batch.energies[name][key] for batch in batches]) for key in terms}
        for name, terms in batches[0].energies.items()
    }
    return line, energies, charge


def _stacked(parts: list[Any]) -> Any:
    if isinstance(parts[0], Labels):
        return Labels.of([text for part in parts for text in part.texts()])
    return np.concatenate(parts)


def distance_of(line: Timeline) -> float:
    """Distance driven in all intervals [m], forward and sideways."""
    if not len(line):
        return 0.0
    cov, rates, time = line.columns, line.rates, line.duration_s
    ahead = cov["speed_m_s"] * time + 0.5 * rates["speed_m_s"] * time**2
    aside = cov["lateral_speed_m_s"] * time + 0.5 * rates["lateral_speed_m_s"] * time**2
    return float(np.sum(np.hypot(ahead, aside)))
