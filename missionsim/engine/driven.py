"""The edges of the map that a run drove, one after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.effects.model import TermKey
from missionsim.effects.timeline import Timeline
from missionsim.engine.recorder import Row
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.physics import Array
from missionsim.plan.legs import Leg


@dataclass(frozen=True)
class DrivenEdge:
    """An edge, or the part of it that was driven before the robot turned back."""

    segment: int
    begin: str
    end: str
    """Both: places, in the direction of travel."""
    edge: int
    """Which of the environment's edges."""
    name: str
    """Of the edge; its places where it has none."""
    length_m: float
    """Of the map that was passed."""
    begin_s: float
    end_s: float
    energy_wh: Mapping[str, float]
    charge_wh: Mapping[str, float]
    """Both: by battery: delivered on it, and left at its end."""


def edges_driven(
    environment: EnvironmentSpec,
    rows: Sequence[Row],
    legs: Sequence[Leg],
    line: Timeline,
    energies: Mapping[str, Mapping[TermKey, Array]],
    charge_wh: Mapping[str, Array],
) -> list[DrivenEdge]:
    """The edges of a run in order; standing on them (obstacles) belongs to them.

    `rows`: of the recorder, as many as `line` has intervals; `line`, `energies`, `charge_wh`: as in
    `missionsim.engine.outcome.RunResult`.
    """
    leg_of = np.array([row.leg for row in rows], dtype=np.intp)
    starts = np.flatnonzero(np.append(True, leg_of[1:] != leg_of[:-1])) if len(leg_of) else leg_of
    spans: list[list[int]] = []
    last: Leg | None = None
    for first, stop in zip(starts.tolist(), [*starts[1:].tolist(), len(leg_of)], strict=True):
        leg = legs[int(leg_of[first])]
        if leg.edge is None or leg.kind != "roll":
            continue
        went_on = (
            last is not None
            and last.edge is not None
            and last.edge[:3] == leg.edge[:3]
            and last.segment == leg.segment
            and abs(last.edge.to_m - leg.edge.from_m) < 1e-9
        )
        if went_on and last is not leg:
            spans[-1][1] = stop
        else:
            spans.append([first, stop])
        last = leg
    total = {name: np.sum(list(terms.values()), axis=0) / 3600.0 for name, terms in energies.items()}
    sums = {name: [0.0, *np.cumsum(wh).tolist()] for name, wh in total.items()}
    charges = {name: charge.tolist() for name, charge in charge_wh.items()}
    start_s, end_s, segment = line.start_s.tolist(), (line.start_s + line.duration_s).tolist(), line.segment.tolist()
    made = []
    for first, stop in spans:
        begin, end = legs[int(leg_of[first])], legs[int(leg_of[stop - 1])]
        assert begin.edge is not None
        spec = environment.edges[begin.edge.edge]
        made.append(
            DrivenEdge(
                segment[first],
                begin.edge.begin,
                begin.edge.end,
                begin.edge.edge,
                spec.name or f"{spec.from_}–{spec.to}",
                (end.edge or begin.edge).to_m - begin.edge.from_m,
                start_s[first],
                end_s[stop - 1],
                {name: known[stop] - known[first] for name, known in sums.items()},
                {name: charge[stop - 1] for name, charge in charges.items()},
            )
        )
    return made
