"""Floors of a mission or a task that the robot's power model does not know."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, cast

from missionsim.errors import Fault, did_you_mean
from missionsim.inputs.mission import RobotAtSite
from missionsim.inputs.power import floors_priced
from missionsim.inputs.segments import SegmentSpec
from missionsim.inputs.tree import Document, Where


def strange_floors(site: RobotAtSite, segments: Iterable[SegmentSpec] = ()) -> Iterator[Fault]:
    """Warnings for floors that neither the model nor the logs behind it name, each once: they cost what the base does.

    `site`: a mission or a task. `segments`: those of the mission, blocks written out. Nothing is said where nothing in
    the robot's file is by floor.
    """
    robot, environment = site.robot, site.environment
    if robot is None or not (site.whole and robot.whole and robot.sound) or not (priced := floors_priced(robot)):
        return
    origins = [robot.origin, *(effect.origin for effect in robot.effects if not effect.candidate)]
    ranges = [cast("dict[str, list[Any]]", origin.get("range", {})) for origin in origins]
    known = sorted(priced.union(*(one.get("surface", ()) for one in ranges)))
    places: list[tuple[Document, Where, str | None]]
    places = [(site.document, (*segment.where, "surface"), segment.surface) for segment in segments]
    places.insert(0, (site.document, ("defaults", "surface"), site.defaults.surface))
    if environment is not None:
        places.append((environment.document, ("ambient", "surface"), environment.ambient.surface))
        edges = enumerate(environment.edges)
        places += [(environment.document, ("edges", index, "surface"), edge.surface) for index, edge in edges]
    told = set(known)
    for document, where, floor in places:
        if floor is None or floor in told:
            continue
        told.add(floor)
        message = f"floor '{floor}' costs no more than the base: nothing of robot '{robot.name}' names it"
        base = "floors on which the base holds stand in the robot's origin: {range: {surface: […]}}"
        allowed, hint = f"{', '.join(known)}; {base}", did_you_mean(floor, known)
        yield document.fault(where, message, got=floor, allowed=allowed, hint=hint, warning=True)
