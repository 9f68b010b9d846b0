"""What a mission asks for and no term of the robot reads: it costs nothing, and that is told."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

from missionsim.errors import Fault, did_you_mean
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs.mission import MissionSpec
from missionsim.inputs.power import build_power_model
from missionsim.inputs.segments import flat_segments
from missionsim.inputs.tree import Document, Where

_EFFECT = "effects: [{{effect: {}, battery: …, parameters: {{k: …}}}}], or the motion model traction"
_SIDEWAYS = "u in a formula of motion, or the motion model mecanum"
_READERS = {
    "slope": ("this slope", "rad", "grade copper_loss", "slope_rad|theta", "grade"),
    "payload": ("this payload", "kg", "payload grade acceleration copper_loss", "payload_kg|mass_kg|m", "payload"),
    "direction": ("going sideways", "rad", "", "lateral_speed_m_s|u", _SIDEWAYS),
}
"""By setting: how it is called, its unit, effects of the library that read it (lifting, speeding up and pulling read
the load as part of the mass), its names in formulas, and what would read it."""


def unread_settings(mission: MissionSpec) -> Iterator[Fault]:
    """Warnings for slopes, payloads and ways sideways that the robot's model does not know.

    Each is told once, at its first place; nothing is said without a robot, or with a faulty one.
    """
    robot, environment = mission.robot, mission.environment
    motion = None if robot is None else robot.motion
    if robot is None or not (mission.whole and robot.whole and robot.sound):
        return
    if motion is not None and motion.model not in ("polynomial", "expression", "none"):
        return  # models of other packages count as reading all
    effects = [effect for effect in robot.effects if not effect.candidate]
    formulas = [effect.power for effect in effects] + ([motion.power, motion.standing] if motion is not None else [])
    formulas += [load.law.power for part in robot.components.values() for load in part.loads if load.law is not None]
    segments = list(flat_segments(mission.segments))
    for setting, (called, unit, readers, words, advice) in _READERS.items():
        if any(effect.effect in readers.split() for effect in effects):
            continue
        if any(re.search(rf"\b({words})\b", text) for text in formulas if text):
            continue
        places = [(mission.document, (*s.where, setting), getattr(s, setting, None)) for s in segments]
        if setting == "payload":
            places.insert(0, (mission.document, ("defaults", "payload"), mission.defaults.payload))
        elif setting == "direction" and robot.body.drive not in ("mecanum", "omni"):
            continue  # a fault, told as such
        elif environment is not None and any(getattr(s, "to", None) or getattr(s, "along", None) for s in segments):
            edges = enumerate(environment.edges)
            places += [(environment.document, ("edges", i, setting), getattr(e, setting, None)) for i, e in edges]
        for document, where, given in places:
            size = 0.0 if given is None else math.sin(given.value) if setting == "direction" else given.value
            if given is not None and abs(size) > 1e-9:
                message = f"{called} costs nothing: no term of robot '{robot.name}' depends on it"
                got, allowed = f"{given.value:.4g} {unit}", _EFFECT.format(advice) if readers else advice
                yield document.fault(where, message, got=got, allowed=allowed, warning=True)
                break


def unread_conditions(mission: MissionSpec) -> Iterator[Fault]:
    """Warnings for conditions that neither the robot's model nor the glossary knows, each once, at its first place."""
    robot, environment = mission.robot, mission.environment
    if robot is None or not (mission.whole and robot.whole and robot.sound):
        return
    if any(load.law is not None and load.law.model for part in robot.components.values() for load in part.loads):
        return  # these laws read more than they need
    sources: list[tuple[Document, Where, Any]] = [(mission.document, ("defaults",), mission.defaults)]
    sources += [(mission.document, segment.where, segment) for segment in flat_segments(mission.segments)]
    if environment is not None:
        sources.append((environment.document, ("ambient",), environment.ambient))
        sources += [(environment.document, ("edges", index), edge) for index, edge in enumerate(environment.edges)]
    strange = {name: (document, where) for document, where, of in reversed(sources) for name in of.conditions}
    read = build_power_model(robot).needs if strange else frozenset()
    for name, (document, where) in strange.items():
        if name not in read and column_of(name) is None:
            message = f"condition '{name}' costs nothing: no term of robot '{robot.name}' reads it"
            hint = did_you_mean(name, sorted(read) + [column.name for column in COLUMNS])
            yield document.fault((*where, "conditions", name), message, name, "", hint, key=True, warning=True)
