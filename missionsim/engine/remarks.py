"""What a run makes strange: terms that charge a battery where nothing should, and charge beyond the capacity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import PowerModel, TermKey
from missionsim.effects.timeline import Timeline
from missionsim.engine.batteries import Battery
from missionsim.errors import Fault
from missionsim.expressions import Place
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.plan.legs import SegmentInfo
from missionsim.runs.covariates import COVARIATES

J_PER_WH = 3600.0
BEYOND = 0.05
"""Part of the range of the logs by which a mission may leave it before that is told."""
TOLERANCE = 1e-9
"""Relative to the energy of the battery's terms, or to its capacity: below it is rounding."""
Energies = Mapping[str, Mapping[TermKey, Array]]


def doubts(
    model: PowerModel,
    line: Timeline,
    energies: Energies,
    charge_wh: Mapping[str, Array],
    batteries: Mapping[str, Battery],
    segments: Sequence[SegmentInfo],
    places: Mapping[str, Place] | None = None,
    file: str = "",
) -> tuple[Fault, ...]:
    """Warnings about batteries that are charged by what should draw from them.

    A component or a law with negative power is told wherever it has it; a formula of motion or of an added effect where
    the whole battery is charged, unless that is while braking or descending of a robot that regenerates. Terms that the
    engine itself limits to what a robot gives back are none of it. `energies`: battery → term key → energy of each
    interval [J], shape (n,); `charge_wh` (shape (n,)): at the end of each interval; `places`: of the batteries in the
    robot file. They stand at the place of the formula; what leaves the range of the logs, at its segment in `file`.
    """
    found: list[Fault] = []
    if not len(line):
        return ()
    back = _giving_back(model, line)
    for term in model.terms:
        joules = energies[term.key.battery].get(term.key)
        if joules is None or term.effect.recovers or term.effect.back or not (negative := joules < 0.0).any():
            continue
        parts = energies[term.key.battery].values()
        scale = float(sum(np.abs(part).sum() for part in parts))
        if term.effect.id not in _OF_COMPONENTS:
            negative = negative & (np.sum(list(parts), axis=0) < 0.0) & ~back
        if (given := -float(joules[negative].sum())) <= TOLERANCE * scale:
            continue
        found.append(
            term.effect.place.warning(
                f"the power of '{term.key.name}' is negative: it charges battery '{term.key.battery}' with "
                f"{given / J_PER_WH:.4g} Wh in {_named(line.segment[negative], segments)}; is the sign right?",
                got=term.effect.equation,
                allowed="power that is drawn is positive",
            )
        )
    for name, battery in batteries.items():
        full = battery.capacity_j / J_PER_WH
        beyond = charge_wh[name] > full * (1.0 + TOLERANCE)
        if beyond.any():
            most = float(charge_wh[name].max())
            found.append(
                (places or {})
                .get(name, Place())
                .warning(
                    f"battery '{name}' comes to {100.0 * most / full:.4g} % of its capacity in "
                    f"{_named(line.segment[beyond], segments)}: more than it can hold, {most - full:.4g} Wh beyond "
                    "full; the surplus is counted as if it were kept"
                )
            )
    return (*found, *_beyond(model, line, segments, file))


def _beyond(model: PowerModel, line: Timeline, segments: Sequence[SegmentInfo], file: str) -> list[Fault]:
    """Warnings where the mission leaves the range of the logs that the model's effects were fitted to."""
    read = {name for term in model.terms for name in (*term.effect.needs, term.effect.covariate)} | _ALWAYS_TOLD
    found: list[Fault] = []
    floors = line.columns.get("surface")
    if model.floors and isinstance(floors, Labels):
        for number, floor in enumerate(floors.names):
            strange = floors.codes == number
            if floor and floor not in model.floors and np.any(strange):
                numbers = line.segment[np.broadcast_to(strange, (len(line),))]
                there, place = _named(numbers, segments), Place(file, segments[int(numbers[0])].line)
                measured = ", ".join(sorted(model.floors))
                told = f"floor '{floor}' in {there}: the logs that this robot was fitted to have {measured}"
                found.append(place.warning(told, got=floor, allowed=measured))
    for name, (low, high) in model.known.items():
        one = COVARIATES.get(name)
        if one is None or one.text or name not in read or name not in line.columns:
            continue
        values = np.broadcast_to(np.asarray(line.columns[name], dtype=float), (len(line),))
        if one.magnitude:
            values, low, high = np.abs(values), 0.0, max(abs(low), abs(high))
        if name == "speed_m_s":
            low = min(low, 0.0)  # every drive begins at rest
        room = BEYOND * (high - low)
        over = np.maximum(values - high, low - values)
        if not np.any(over > room):
            continue
        worst = int(np.argmax(over))
        measured = f"{low * one.factor:.3g} to {high * one.factor:.3g} {one.unit}".strip()
        there = f"{values[worst] * one.factor:.3g} {one.unit}".strip()
        worst_in = int(line.segment[worst])
        found.append(
            Place(file, segments[worst_in].line).warning(
                f"{one.title} {there} in {_named(line.segment[over > room], segments, worst_in)}: the logs that this "
                f"robot was fitted to have {measured}",
                got=there,
                allowed=measured,
            )
        )
    return found


_ALWAYS_TOLD = {"slope_rad", "payload_kg"}
"""Told even where no term reads them: a base that was fitted on the level knows nothing of a ramp."""
_OF_COMPONENTS = ("law", "component", "always_on", "startup", "switchboard", "processor")


def _giving_back(model: PowerModel, line: Timeline) -> NDArray[np.bool_]:
    """Intervals in which a robot that regenerates slows down or descends."""
    if not float(model.constants.get("regeneration", 0.0)) > 0.0:
        return np.zeros(len(line), dtype=bool)
    columns: Mapping[str, Any] = line.columns
    return np.asarray((columns["accel_m_s2"] < 0.0) | (columns["slope_rad"] < 0.0))


def _named(numbers: NDArray[np.int64], segments: Sequence[SegmentInfo], first: int | None = None) -> str:
    """Segments by name, `first` before the others."""
    ordered = sorted(np.unique(numbers).tolist(), key=lambda i: i != first)
    names = list(dict.fromkeys(segments[i].label or segments[i].name for i in ordered))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"segment '{names[0]}'{more}"


def never_on(line: Timeline) -> tuple[str, ...]:
    """Components that were neither on nor starting at any time."""
    names = [name[3:] for name in line.columns if name.startswith("on_") and f"starting_{name[3:]}" in line.columns]
    return tuple(
        name
        for name in names
        if not np.any(line.columns[f"on_{name}"]) and not np.any(line.columns[f"starting_{name}"])
    )
