"""The result of a run: interval table, energy of every term, batteries, and whether the mission is feasible."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from missionsim.effects.model import TermKey
from missionsim.effects.timeline import Timeline
from missionsim.engine.recorder import Row
from missionsim.errors import Fault
from missionsim.files import Json, fields_of, grouped
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.physics import Array
from missionsim.plan.legs import Leg, SegmentInfo


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
    """The edges of a run in order; standing on them (obstacles) belongs to them. `rows`: of the recorder, as many as
    `line` has intervals; `line`, `energies`, `charge_wh`: as in `missionsim.engine.outcome.RunResult`."""
    leg_of = np.array([row.leg for row in rows], dtype=np.intp)
    if not len(leg_of):
        return []
    starts = np.flatnonzero(np.append(True, leg_of[1:] != leg_of[:-1]))
    spans: list[list[int]] = []
    last: Leg | None = None
    reached_m = 0.0
    for first, stop in zip(starts.tolist(), [*starts[1:].tolist(), len(leg_of)], strict=True):
        leg = legs[int(leg_of[first])]
        if leg.edge is None or leg.kind != "roll":
            continue
        went_on = last is not None and last is not leg and leg.same_edge(last)
        if went_on and abs(reached_m - leg.edge.from_m) < 1e-9:
            spans[-1][1] = stop
        else:
            spans.append([first, stop])
        last, reached_m = leg, leg.edge.to_m
    nothing = np.zeros(len(leg_of))  # a battery that feeds nothing has no terms
    total = {name: np.sum([nothing, *terms.values()], axis=0) / 3600.0 for name, terms in energies.items()}
    sums = {name: [0.0, *np.cumsum(wh).tolist()] for name, wh in total.items()}
    charges = {name: charge.tolist() for name, charge in charge_wh.items()}
    start_s, end_s, segment = line.start_s.tolist(), (line.start_s + line.duration_s).tolist(), line.segment.tolist()
    made = []
    for first, stop in spans:
        begin, end = legs[int(leg_of[first])], legs[int(leg_of[stop - 1])]
        assert begin.edge is not None
        spec = environment.edges[begin.edge.edge]
        length_m = (end.edge or begin.edge).to_m - begin.edge.from_m
        energy = {name: known[stop] - known[first] for name, known in sums.items()}
        left = {name: charge[stop - 1] for name, charge in charges.items()}
        way = begin.edge.begin, begin.edge.end, begin.edge.edge, spec.name or f"{spec.from_}–{spec.to}"
        made.append(DrivenEdge(segment[first], *way, length_m, start_s[first], end_s[stop - 1], energy, left))
    return made


@dataclass(frozen=True, order=True)
class Alarm:
    """A battery at a threshold: when, which, whether ``empty`` or at its ``reserve``, and in which segment."""

    time_s: float
    battery: str
    kind: str
    segment: int = 0


J_PER_WH = 3600.0
SCHEMA = "missionsim.run/1"


@dataclass(frozen=True, kw_only=True)
class BatteryResult:
    """What a run did to one battery; the fields are those of the JSON, in its order."""

    name: str
    energy_wh: float
    """Delivered, the sum of all terms."""
    mean_power_w: float
    charge_left_wh: float
    charge_left_fraction: float
    """Both: at the end; below zero where more was asked than there was. The fraction is one of energy, and the state of
    charge for an `equivalent_circuit`."""
    reserve_wh: float
    """Charge left after coming home (Eq. 13): ``charge_left_wh − home_wh``, or the charge left where no way is
    known."""
    reserve_required_wh: float
    """What the mission's policy (or the robot file) wants left at the end."""
    home_wh: float | None
    """What coming to the dock from the mission's end takes out of the battery by the shortest way at the same settings
    (Parasuraman 2012, Eq. 12), with what is lost inside; None where the place or the way is not known."""
    empty_at_s: float | None
    empty_in_segment: str
    deficit_wh: float
    """By how much the whole mission, driven to its end, overdraws the battery; 0 where it does not."""
    needed_wh: float | None
    """What the whole mission, driven to its end as if batteries were bottomless, takes out at most before the next
    charging; None where it does not come to its end even so."""
    charged_wh: float
    """Received from chargers."""
    capacity_wh: float
    initial_wh: float
    """Both: full, and at the start."""
    internal_loss_wh: float
    """Lost inside the battery beyond what it delivered (0 for `constant_energy`)."""
    audit_relative_error: float
    """Difference between the table's cells and the meter, relative to the energy."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """One simulated mission."""

    mission: str
    robot: str
    """Both: names."""
    feasible: bool
    """The whole mission is done, no battery was ever empty, and at the end every battery holds its required reserve
    and, where a dock is known, enough to come home to it."""
    completed: bool
    """Every segment was executed."""
    reason: str
    """Why it is not feasible; empty where it is."""
    duration_s: float
    distance_m: float
    timeline: Timeline
    """Intervals with their covariates."""
    energies: Mapping[str, Mapping[TermKey, Array]]
    """Battery → term key → energy in each interval [J], shape (n,)."""
    charge_wh: Mapping[str, Array]
    """Charge at the end of each interval. Shape (n,)."""
    segments: tuple[SegmentInfo, ...]
    """As executed, repeats one by one; a detour to the dock is one more at the end."""
    segment_end_s: Mapping[int, float]
    """When each executed segment ended."""
    batteries: Mapping[str, BatteryResult]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    home: Callable[[], list[dict[str, float | None]]] | None = field(default=None, repr=False, compare=False)
    warnings: tuple[Fault, ...] = ()
    """What is strange but was computed: terms that charge a battery, charge beyond the capacity. Needs the trace."""
    never_on: tuple[str, ...] = ()
    """Components that were never switched on. Needs the trace."""
    segments_driven: int = 0
    """How many of the mission's segments were begun."""
    interrupted: Alarm | None = None
    """When, in which segment and by which battery the mission was cut short."""
    dock_s: float = 0.0
    """Time at chargers."""
    driven: Callable[[], list[DrivenEdge]] | None = field(default=None, repr=False, compare=False)

    def edges_driven(self) -> list[DrivenEdge]:
        """The edges of the map in the order in which they were driven; none without a map or without a trace."""
        return self.driven() if self.driven is not None else []

    def places_passed(self) -> dict[int, list[str]]:
        """Segment → the places from where it began to where it ended, of drives on the map."""
        return {i: [edges[0].begin, *(edge.end for edge in edges)] for i, edges in self._ways().items()}

    def _ways(self) -> dict[int, list[DrivenEdge]]:
        return grouped(self.edges_driven(), lambda edge: edge.segment)

    def repeats(self) -> dict[str, list[int]]:
        """Segments by what they are called; those of a block that is repeated have one name."""
        return grouped(range(len(self.segments)), lambda i: self.segments[i].label or self.segments[i].name)

    @property
    def returned(self) -> bool:
        """Whether the mission was cut short and the robot went back to its dock."""
        return bool(self.segments) and self.segments[-1].kind == "return"

    def was_done(self, segment: int) -> bool:
        """Whether a segment was begun and, where it is a dock, anything was done there: it may charge below a level."""
        end, before = self.segment_end_s.get(segment, math.inf), self.segment_end_s.get(segment - 1, 0.0)
        kind = self.segments[segment].kind  # a way home or to a dock and back is no segment of the mission
        begun = segment < self.segments_driven or kind in ("return", "recharge")
        return begun and not (kind == "dock" and end <= before)

    def home_energy(self) -> list[dict[str, float | None]]:
        """What coming home from the end of each segment takes out of each battery [Wh]; None where no way is known.
        Computed when asked for: a mission has as many ways home as segments."""
        return self.home() if self.home is not None else [{} for _ in self.segments]

    @property
    def energy_j(self) -> dict[str, dict[str, dict[str, Array]]]:
        """Battery → component → term → energy in each interval [J]; terms of one name on one component are added."""
        result: dict[str, dict[str, dict[str, Array]]] = {}
        for battery, terms in self.energies.items():
            components = result.setdefault(battery, {})
            for key, joules in terms.items():
                cells = components.setdefault(key.component, {})
                cells[key.name] = cells[key.name] + joules if key.name in cells else joules
        return result

    def cells_wh(self, battery: str) -> dict[TermKey, Array]:
        """Energy of each term by segment [Wh], shape (segments,)."""
        index, count = self.timeline.segment, len(self.segments)
        return {
            key: np.bincount(index, weights=joules, minlength=count) / J_PER_WH
            for key, joules in self.energies[battery].items()
        }

    def by_segment_wh(self, battery: str) -> Array:
        """Energy of each segment [Wh], shape (segments,)."""
        cells = self.cells_wh(battery)
        return np.sum(list(cells.values()), axis=0) if cells else np.zeros(len(self.segments))

    def by_component_wh(self, battery: str) -> dict[str, float]:
        """Energy of each component [Wh]."""
        return self._totals_wh(battery, "component")

    def by_term_wh(self, battery: str) -> dict[str, float]:
        """Energy of each physical term [Wh], over all components."""
        return self._totals_wh(battery, "name")

    def _totals_wh(self, battery: str, part: str) -> dict[str, float]:
        totals: dict[str, list[float]] = {}
        for key, joules in self.energies[battery].items():
            totals.setdefault(getattr(key, part), []).append(float(joules.sum()))
        return {name: math.fsum(parts) / J_PER_WH for name, parts in totals.items()}

    def by_scheme_wh(self, battery: str) -> dict[str, float]:
        """Energy under each control scheme [Wh]; ``none`` where no scheme runs; empty without a trace."""
        scheme = self.timeline.columns.get("scheme")
        if scheme is None:
            return {}
        total = np.broadcast_to(np.sum(list(self.energies[battery].values()), axis=0), len(self.timeline))
        sums = np.bincount(scheme.codes + 1, weights=total, minlength=len(scheme.names) + 1) / J_PER_WH
        return {name: float(energy) for name, energy in zip(("none", *scheme.names), sums, strict=True) if energy}

    def power_w(self, battery: str) -> Array:
        """Mean power of each interval [W], shape (n,)."""
        total = np.sum(list(self.energies[battery].values()), axis=0)
        return np.asarray(total / self.timeline.duration_s)

    def totals(self) -> RunResult:
        """The same result with the totals of segments in place of intervals, and no way home any more: a thousandth."""
        line = self.timeline
        count = int(line.segment.max()) + 1 if len(line) else 0
        duration = np.bincount(line.segment, weights=line.duration_s, minlength=count).astype(np.float64)
        start = np.concatenate([[0.0], np.cumsum(duration)[:-1]]) if count else np.zeros(0)
        sums = {
            name: {key: np.bincount(line.segment, joules, count).astype(np.float64) for key, joules in terms.items()}
            for name, terms in self.energies.items()
        }
        last = {name: values[-1:] for name, values in self.charge_wh.items()}
        short = Timeline(start, duration, {}, {}, np.arange(count, dtype=np.int64))
        return replace(self, timeline=short, energies=sums, charge_wh=last, home=None, driven=None)

    def summary(self) -> Json:
        """The run as the JSON of the command line (schema ``missionsim.run/1``)."""
        batteries = {}
        for name, battery in self.batteries.items():
            own = {field: value for field, value in vars(battery).items() if field != "name"}
            audit = own.pop("audit_relative_error")
            batteries[name] = {
                **own,
                "empty_in_segment": battery.empty_in_segment or None,
                "by_component_wh": self.by_component_wh(name),
                "by_term_wh": self.by_term_wh(name),
                "by_scheme_wh": self.by_scheme_wh(name),
                "by_segment_wh": self.by_segment_wh(name).tolist(),
                "audit_relative_error": audit,
            }
        passed, stop, ways = self.places_passed(), self.interrupted, list[Json]()
        for index, edges in self._ways().items():
            named = {"edges": [edge.name for edge in edges], "edge_indices": [edge.edge for edge in edges]}
            ways.append({"segment": index, **named, "places": passed[index]})
        return {
            "schema": SCHEMA,
            **fields_of(self, "mission robot feasible completed"),
            "reason": self.reason or None,
            **fields_of(self, "duration_s distance_m dock_s"),
            "segments": [segment.name for segment in self.segments],
            "segments_driven": self.segments_driven,
            "ways": ways,
            "interrupted": stop
            and {
                "at_s": stop.time_s,
                "segment": self.segments[stop.segment].name,
                **fields_of(stop, "battery kind"),
                "returned_to_dock": self.returned,
            },
            "batteries": batteries,
            "warnings": [fault.message for fault in self.warnings],
            "never_on": list(self.never_on),
            "provenance": dict(self.provenance),
        }
