"""How far a robot gets: the places it can go to and come back from, and where on a way it must turn back."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.files import Json, fields_of, write_text
from missionsim.inputs.loading import Override, load_robot, load_task, shipped_robots
from missionsim.inputs.task import TaskSpec, VisitSpec
from missionsim.physics import Array
from missionsim.plan.kinematics import group
from missionsim.plan.legs import Leg as PlanLeg
from missionsim.planner.answer import Answer, flow
from missionsim.planner.chance import as_run, draws_of, told
from missionsim.planner.physics import Physics
from missionsim.planner.pieces import pieces_of
from missionsim.planner.site import Site, make_site
from missionsim.planner.solve import solve_site
from missionsim.planner.why import with_ample

SCHEMA = "missionsim.reach/1"
SEED = 20_270_101


@dataclass
class Reached:
    """What is known of one place."""

    place: str
    reachable: bool
    """There and back with the reserve, by the files' values."""
    sure: bool
    """And so in the share of draws that is asked."""
    plan: Answer
    """There and back; where the charge does not suffice, the one that takes least of it."""
    left_wh: dict[str, float]
    """What each battery then holds; less than nothing where it does not suffice."""
    holds: dict[str, float] = field(default_factory=dict)
    """Share of the draws in which it does (``value``, ``low``, ``high``, ``runs``)."""
    turn: dict[str, Any] | None = None
    """Of a place out of reach, the last point of the way there from which the robot comes back: ``edge``, ``from``,
    ``to``, ``metres`` on it, ``battery`` that decides; ``sure_metres`` and ``sure_edge`` with the share asked."""
    warnings: tuple[Fault, ...] = ()
    """Of the way, such as slopes beyond those of the logs that the robot was fitted to."""


def reach_task(
    environment: Path, robot: str, begin: str, overrides: Sequence[Override] = (), end: str | None = None
) -> TaskSpec:
    """The task of going out from a place and coming back to it (or to another). `robot`: shipped robot or robot file;
    `overrides`: on the task: ``within.reserve``, ``choose.speeds``, ``robot.…``."""
    spec = load_robot(robot)
    moving = [name for name, scheme in spec.schemes.items() if scheme.motion]
    data = {
        "kind": "task",
        "name": "reach",
        "robot": robot if robot in shipped_robots() else os.path.abspath(robot),
        "environment": os.path.abspath(environment),
        "start": begin,
        "end": end or begin,
        "visits": [{"place": begin}],
        "choose": {"schemes": moving} if moving else {},
    }
    with tempfile.TemporaryDirectory(prefix="missionsim-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "reach.yaml"
        write_text(path, "".join(f"{key}: {flow(value)}\n" for key, value in data.items()))
        try:
            return load_task(path, list(overrides), None)
        except InputError as problem:  # nobody knows this file
            raise InputError(
                replace(fault, file="", line=0, column=0) if fault.file == str(path) else fault
                for fault in problem.faults
            ) from None


def reach(task: TaskSpec, probability: float = 0.95, done: Callable[[], object] = lambda: None) -> list[Reached]:
    """Every place of a task's environment: whether it can be gone to and come back from.

    `task`: from `reach_task`; `probability`: share of draws of the uncertain values in which the charge is to suffice;
    `done`: called after each place. The places are in the order of the environment, without those that no open way
    leads to and back from.
    """
    found, physics = [], Physics(task)
    for place in task.environment.places:
        if place == task.start:
            done()
            continue
        out = task.model_copy(update={"visits": (VisitSpec.model_construct(place=place),)})
        site = make_site(out, physics=physics)
        names = site.physics.names
        first = solve_site(site)
        plan = first if first.feasible else _least(site)
        if plan is None:
            done()
            continue
        plan, run = as_run(plan)
        holds: dict[str, float] = {}
        turn = None
        inside = np.array([b.internal_loss_wh / max(b.energy_wh, 1e-9) for b in run.batteries.values()])
        if first.feasible and run.feasible:  # else it lacks what the search leaves out
            holds = told(site, draws_of(plan, SEED))
        else:
            # by how much more than planned each battery gives in all but the rarest draws, relative; as if they were
            # bottomless: what is drawn, not when it ends
            bottomless = [(f"robot.batteries.{name}.capacity", "100000 Wh") for name in names]
            ample = plan.site.task.model_copy(update={"overrides": (*plan.site.task.overrides, *bottomless)})
            columns = draws_of(replace(plan, site=replace(plan.site, task=ample)), SEED)
            each = 1.0 - (1.0 - probability) / len(names)
            drawn = np.array([float(np.nanquantile(columns[f"energy_{name}_wh"], each)) for name in names])
            more = np.maximum(drawn / np.maximum([plan.energy_wh[name] for name in names], 1e-9) - 1.0, 0.0)
            if (turn := _turn(site, plan, inside)) is not None:
                sure = _turn(site, plan, (1.0 + more) * (1.0 + inside) - 1.0)
                turn["sure_metres"], turn["sure_edge"] = (0.0, None) if sure is None else (sure["metres"], sure["edge"])
        used = np.array(list(plan.energy_wh.values())) * (1.0 + inside)
        left = physics.by_name(physics.initial_wh - used)
        if run.completed:
            left = {name: battery.charge_left_wh for name, battery in run.batteries.items()}
        certain = bool(holds) and holds["value"] >= probability
        found.append(Reached(place, bool(holds), certain, plan, left, holds, turn, run.warnings))
        done()
    return found


def _least(site: Site) -> Answer | None:
    """The way of which least is lacking in the battery that lacks most, whatever the charge."""
    plans = [found for b in range(len(site.physics.names)) if (found := with_ample(site, b, every=True)) is not None]
    left = site.physics.initial_wh - site.physics.reserve_wh
    lacking = [float((np.array(list(made.energy_wh.values())) - left).max()) for made in plans]
    return plans[int(np.argmin(lacking))] if plans else None


def _turn(site: Site, plan: Answer, more: Array) -> dict[str, Any] | None:
    """Where on the way out the robot must turn back so as to keep its reserve; before an edge that leads one way only,
    where it would not come home from its end by any way."""
    physics = site.physics
    left, pieces = physics.initial_wh - physics.reserve_wh, pieces_of(site.task, physics, site.order.load_kg)
    out: list[PlanLeg] = []
    back: list[PlanLeg] = []
    for leg in plan.legs:
        if leg.piece is None:
            break
        there, like = leg.piece.legs, (leg.piece.way.edge, leg.piece.scheme, leg.piece.speed)
        # the same edge driven back in the same way; None where it leads one way only
        turned = (p.legs for p in pieces[leg.place] if (p.way.edge, p.scheme, p.speed) == like)
        retraced = next(turned, None)
        home: Sequence[PlanLeg] = retraced or ()
        end: Sequence[PlanLeg] | None = back if retraced else []
        if retraced is None and leg.place != site.task.goal:  # by the way of which least is lacking; None without
            visits = (VisitSpec.model_construct(place=leg.place),)
            homeward = site.task.model_copy(update={"start": leg.place, "visits": visits})
            other = _least(make_site(homeward, physics=physics))
            end = (
                None
                if other is None
                else [one for leg in other.legs if leg.piece is not None for one in leg.piece.legs]
            )

        def short(share: float, there: Any = there, home: Any = home, out: Any = out, end: Any = end) -> Array:
            if end is None:
                return np.asarray(drive_wh(physics, [*out, *there]) * (1.0 + more) - left + np.inf)
            way = [*out, *_part(there, share, True), *_part(home, share, False), *end]
            return np.asarray(drive_wh(physics, way) * (1.0 + more) - left)

        lacking = short(1.0)
        if end is not None and (lacking <= 0.0).all():
            out, back = [*out, *there], [*home, *end]
            continue
        low, high = 0.0, 1.0 if home else 0.0
        if (short(1e-9) > 0.0).any():
            high = 0.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if (short(middle) <= 0.0).all() else (low, middle)
        lacking = short(max(high, 1e-9)) if home else lacking
        return {
            **fields_of(leg.piece, "edge=name edge_index=way.edge from=way.begin to=way.end"),
            "metres": low * leg.piece.way.length_m,
            "one_way": not home,
            "battery": physics.names[int(np.argmax(lacking))],
        }
    return None


def _part(legs: Sequence[PlanLeg], share: float, first: bool) -> list[PlanLeg]:
    """The first (or last) share of an edge."""
    wanted = share * math.fsum(leg.distance_m for leg in legs)
    made: list[PlanLeg] = []
    for leg in legs if first else reversed(legs):
        metres = min(leg.distance_m, wanted)
        if metres <= 0.0:
            break
        made.append(leg._replace(distance_m=metres))
        wanted -= metres
    return made if first else made[::-1]


def drive_wh(physics: Physics, legs: Sequence[PlanLeg]) -> Array:
    """Energy of driving legs, with every acceleration between them, shape (batteries,), Wh."""
    phases = [
        (physics.settings_index(legs[phase.leg].settings), phase, i == 0)
        for step in group(legs, physics.limits)
        for i, phase in enumerate(step.phases)
        if phase.duration_s > 0.0
    ]
    if not phases:
        return np.zeros(len(physics.names))
    columns = np.array([(n, p.duration_s, p.speed_m_s, p.accel_m_s2, start) for n, p, start in phases], dtype=float)
    return np.asarray(physics.energy_wh(*columns.T).sum(axis=0))


def summary(task: TaskSpec, found: Sequence[Reached], probability: float) -> Json:
    """The answer as JSON (schema ``missionsim.reach/1``)."""
    places = {}
    for item in found:
        plan, physics = item.plan, item.plan.site.physics
        reserve = physics.by_name(physics.reserve_wh)
        places[item.place] = {
            **fields_of(item, "reachable sure"),
            "holds": item.holds or None,
            "way": [task.start, *(leg.place for leg in plan.legs if leg.piece is not None)],
            **fields_of(item, "duration_s=plan.duration_s energy_wh=plan.energy_wh charge_left_wh=left_wh"),
            "margin_wh": {name: item.left_wh[name] - reserve[name] for name in reserve},
            "point_of_no_return": item.turn,
        }
    return {
        "schema": SCHEMA,
        **fields_of(task, "environment=environment.name robot=robot.name from=start to=goal"),
        "probability": probability,
        "places": places,
        "unreachable": sorted(set(task.environment.places) - set(places) - {task.start}),
    }
