"""What a mission asks for and no term of its robot's model reads: it would cost nothing, silently."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from missionsim.errors import Fault
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.segments import flat_segments

_READERS = {"slope": {"grade"}, "payload": {"payload", "grade", "acceleration"}}
"""Effects of the library that read the setting; lifting and speeding up read the load as part of the mass."""
_WORDS = {"slope": re.compile(r"\b(slope_rad|theta)\b"), "payload": re.compile(r"\b(payload_kg|mass_kg|m)\b")}


def unread(mission: MissionSpec) -> list[Fault]:
    """Warnings for slopes and payloads that the robot's model does not know, each once, at its first place.

    `mission`: with its robot; without one, or with a faulty one, nothing is said.
    """
    robot = mission.robot
    if robot is None or not (mission.whole and robot.whole and robot.sound):
        return []
    found: list[Fault] = []
    for setting, advice in (
        ("slope", "effects: [{effect: grade, battery: …, parameters: {k: …}}], or the motion model traction"),
        ("payload", "effects: [{effect: payload, battery: …, parameters: {k: …}}], or the motion model traction"),
    ):
        if _reads(robot, setting):
            continue
        for document, where, value in _given(mission, setting):
            message = f"this {setting} costs nothing: no term of robot '{robot.name}' depends on it"
            found.append(document.fault(where, message, got=value, allowed=advice, severity="warning"))
            break
    return found


def _reads(robot: RobotSpec, setting: str) -> bool:
    if robot.motion is not None and robot.motion.model not in ("polynomial", "expression", "none"):
        # models of other packages count as reading all
        return True
    if any(effect.effect in _READERS[setting] for effect in robot.effects if not effect.candidate):
        return True
    formulas = [effect.power for effect in robot.effects if not effect.candidate]
    if robot.motion is not None:
        formulas += [robot.motion.power, robot.motion.standing]
    formulas += [load.law.power for part in robot.components.values() for load in part.loads if load.law is not None]
    return any(_WORDS[setting].search(text) for text in formulas if text)


def _given(mission: MissionSpec, setting: str) -> Iterator[tuple[Any, tuple[str | int, ...], str]]:
    """Document, path and text of each value that is not zero."""
    document = mission.document
    if setting == "payload" and mission.defaults.payload is not None and mission.defaults.payload.value:
        yield document, ("defaults", "payload"), f"{mission.defaults.payload.value:g} kg"
    by_place = False
    for segment in flat_segments(mission.segments):
        by_place |= bool(getattr(segment, "to", None) or getattr(segment, "along", None))
        value = getattr(segment, setting, None)
        if value is not None and value.value:
            text = f"{value.value:.4g} rad" if setting == "slope" else f"{value.value:g} kg"
            yield document, (*segment.where, setting), text
    if setting == "slope" and by_place and mission.environment is not None:
        for index, edge in enumerate(mission.environment.edges):
            if edge.slope.value:
                yield mission.environment.document, ("edges", index, "slope"), f"{edge.slope.value:.4g} rad"
