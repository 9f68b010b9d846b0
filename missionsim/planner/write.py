"""A plan as a mission file that `missionsim run` executes, with comments that say why."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from missionsim.inputs.examples import shipped_robots
from missionsim.inputs.task import SchemeChoice, VisitSpec
from missionsim.planner.answer import Answer, Leg


def mission_text(answer: Answer, target: str | os.PathLike[str] | None) -> str:
    """The YAML text of a mission that does what the plan says.

    Parameters
    ----------
    answer : Answer
        Feasible.
    target : path-like or None
        Where it will lie, for the paths of robot and environment; None for the task's own folder.
    """
    task = answer.site.task
    folder = Path(target).absolute().parent if target is not None else task.path.absolute().parent
    lines = [
        f"# Written by `missionsim plan` from {task.path.name}: edit the task, not this file.",
        f"# {_summary(answer)}",
        *(f"# Planned with --set {path}={value!r}: run it with the same." for path, value in task.elsewhere),
        "kind: mission",
        f"name: {_text(task.name + '_plan')}",
        f"robot: {_text(_reference(task.robot_ref, task.robot.path, folder))}",
        f"environment: {_text(os.path.relpath(task.environment.path.absolute(), folder))}",
        f"start: {_text(task.start)}",
    ]
    if task.start_heading is not None:
        lines.append(f"start_heading: {task.start_heading.value!r}")
    if task.initial_charge:
        charges = {name: charge.value for name, charge in task.initial_charge.items()}
        lines.append(f"initial_charge: {flow(charges)}")
    data = task.document.data
    if data.get("defaults"):
        lines.append(f"defaults: {flow(data['defaults'])}")
    reserve = {name: task.reserve_of(name) for name in task.robot.batteries}
    policy: dict[str, Any] = {"dock": task.goal, "reserve": reserve}
    lines.append(f"policy: {flow(policy)}")
    lines.append("segments:")
    for leg in answer.legs:
        lines += _segment(answer, leg)
    if not answer.legs:
        lines.append("  - wait: {duration: 0 s}")
    return "\n".join(lines) + "\n"


def _summary(answer: Answer) -> str:
    energy = ", ".join(f"{value:.4g} Wh {name}" for name, value in answer.energy_wh.items())
    return f"{answer.duration_s:.1f} s, {energy}; {answer.claim}."


def _segment(answer: Answer, leg: Leg) -> list[str]:
    task = answer.site.task
    if leg.kind == "drive":
        assert leg.piece is not None
        piece = leg.piece
        body: dict[str, Any] = {"along": [piece.name]}
        if piece.speed is not None:
            body["speed"] = piece.speed
        body |= {} if piece.scheme is None else _equipment(piece.scheme)
        why = f"to {leg.place}"
    elif leg.kind == "visit":
        assert leg.visit is not None
        visit = task.visits[leg.visit]
        kind, given = ("inspect", visit.inspect) if visit.inspect is not None else ("wait", visit.wait)
        body = {"name": visit.label, "duration": given.value if given is not None else 0.0}
        body |= _equipment(visit if leg.scheme is None else leg.scheme)
        body["payload"] = leg.payload_kg
        return [f"  - {kind}: {flow(body)}  # {_charges(leg)}"]
    elif leg.kind == "wait":
        until = "until the next round is due" if task.repeat is not None else "until the window opens"
        why = until if leg.duration_s > 0.0 else "a stop at the dock"
        return [f"  - wait: {flow({'duration': leg.duration_s})}  # {why}: {_charges(leg)}"]
    else:
        recharge = {"until": leg.level} if leg.level is not None else {"duration": leg.duration_s}
        return [f"  - dock: {flow({'recharge': recharge})}  # at {leg.place}: {_charges(leg)}"]
    if leg.payload_kg != (0.0 if task.defaults.payload is None else task.defaults.payload.value):
        body["payload"] = leg.payload_kg
    return [f"  - drive: {flow(body)}  # {why}: {_charges(leg)}"]


def _equipment(given: SchemeChoice | VisitSpec) -> dict[str, Any]:
    asked = {"scheme": given.scheme, "navigation": given.navigation, "sensors": given.sensors}
    return {key: value for key, value in asked.items() if value is not None}


def _charges(leg: Leg) -> str:
    return "then " + ", ".join(f"{name} {charge:.4g} Wh" for name, charge in leg.charge_wh.items())


def _reference(given: str, path: Path, folder: Path) -> str:
    return given if given in shipped_robots() else os.path.relpath(path.absolute(), folder)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def flow(value: object) -> str:
    """Plain data as one line of YAML; JSON is a part of YAML 1.2, and its numbers keep all digits."""
    return json.dumps(value, ensure_ascii=False)
