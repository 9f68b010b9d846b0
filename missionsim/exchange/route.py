"""The way a mission takes over its map, leg by leg: what an order or a plan for another tool is written of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from missionsim.errors import InputError

if TYPE_CHECKING:
    from missionsim.inputs.mission import MissionSpec


@dataclass(frozen=True)
class Stop:
    """A place on the way, and what is done there."""

    place: str
    speed_m_s: float | None = None
    """On the way to it; None at the start."""
    edge: str = ""
    """Name of the edge to it; its ends where it has none."""
    length_m: float = 0.0
    """Of that edge."""
    waits: tuple[tuple[str, float], ...] = ()
    """What is done there, in words of ours (``wait``, ``inspect``), and for how long, s."""
    recharge_until: float | None = None
    """Fraction of the charge; 1 where charging lasts a time."""


def stops_of(mission: MissionSpec) -> tuple[list[Stop], list[str]]:
    """Places that a mission passes, in order, and what of it has no place in such a list. Raises InputError: a mission
    without an environment, or that leaves the places of its map."""
    from missionsim.plan.build import make_plan

    environment = mission.environment
    if environment is None or not mission.start:
        allowed = "environment and start"
        raise InputError.single("the mission has no map to drive on", file=str(mission.path), allowed=allowed)
    told: dict[str, None] = {}
    stops = [Stop(mission.start)]
    passed = 0.0
    for leg in make_plan(mission).legs:
        here = stops[-1]
        if leg.kind == "turn":
            continue
        if leg.kind == "stand":
            if leg.duration_s > 0:
                stops[-1] = replace(here, waits=(*here.waits, ("wait", leg.duration_s)))
        elif leg.kind == "dock":
            recharge = leg.recharge
            until = 1.0 if recharge is None or recharge.until is None else recharge.until
            stops[-1] = replace(here, recharge_until=until)
            if recharge is not None and recharge.until is None:
                told["charging for a time is written as charging until full"] = None
        elif leg.edge is None:
            allowed = "drives to places, along edges"
            raise InputError.single("the mission leaves the places of its map", file=str(mission.path), allowed=allowed)
        else:
            passed += leg.distance_m
            if abs(leg.edge.to_m - (environment.length_m(environment.edges[leg.edge.edge]) or 0.0)) > 1e-6:
                continue  # a part of an edge: its end comes
            spec = environment.edges[leg.edge.edge]
            name = spec.name or f"{leg.edge.begin} to {leg.edge.end}"
            stops.append(Stop(leg.edge.end, leg.speed_m_s, name, passed))
            passed = 0.0
        if leg.settings.payload_kg:
            told["payloads have no place in it"] = None
    if mission.activities:
        told["activities (components switched on and off) have no place in it"] = None
    return stops, list(told)
