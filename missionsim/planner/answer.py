"""The plan as it is told: legs, energies, charge, what was proved; and as a mission file that `run` executes."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.files import Json, PathLike, fields_of
from missionsim.inputs.loading import shipped_robots
from missionsim.inputs.task import SchemeChoice, VisitSpec
from missionsim.numerals import in_wh
from missionsim.physics import Array
from missionsim.planner.core import Label, chain_of
from missionsim.planner.pieces import Piece, equipment
from missionsim.planner.site import Site
from missionsim.planner.tour import Tour

SCHEMA = "missionsim.plan/1"
SAME = 1e-9
"""Gap that is told as none: rounding, and the hair's breadth by which batteries are charged more than is needed."""
ROUNDING = 1e-12
"""Relative difference of plan and bound that is none."""


@dataclass(frozen=True)
class Leg:
    """One leg of a plan: an edge driven, a visit, or charging."""

    kind: str
    """``drive``, ``visit``, ``wait`` or ``charge``."""
    place: str
    """Where it ends."""
    duration_s: float
    energy_wh: Mapping[str, float]
    """By battery."""
    charge_wh: Mapping[str, float]
    """Left at its end."""
    piece: Piece | None = None
    """The edge, of a drive."""
    visit: int | None = None
    scheme: SchemeChoice | None = None
    """Of a visit, where it was chosen."""
    payload_kg: float = 0.0
    level: float | None = None
    """Fraction charged to; None where charging lasts for `duration_s`."""


@dataclass
class Answer:
    """A plan, or why there is none."""

    site: Site
    feasible: bool
    legs: list[Leg] = field(default_factory=list)
    objective: float = float("inf")
    bound: float = float("-inf")
    """Both: of the plan, and below which no plan is."""
    duration_s: float = 0.0
    energy_wh: dict[str, float] = field(default_factory=dict)
    charge_left_wh: dict[str, float] = field(default_factory=dict)
    """Both: by battery."""
    notes: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    stopped: bool = False
    """Whether the search was stopped before its end."""

    @property
    def gap(self) -> float:
        """How much better, relative to the plan, any other plan could be at most."""
        if not self.feasible or self.objective - self.bound <= ROUNDING * abs(self.objective):
            return 0.0
        return (self.objective - self.bound) / abs(self.objective) if self.objective else 0.0

    @property
    def value(self) -> float:
        """Value of the visits that are made."""
        return math.fsum(self.site.task.visits[leg.visit].value or 0.0 for leg in self.legs if leg.visit is not None)

    @property
    def claim(self) -> str:
        """What is proved of the plan, in words, with what the proof leaves out."""
        unknown = "no bound is known on how much better another may be"
        text = f"at most {100 * self.gap:.2g} % from the best" if math.isfinite(self.gap) else unknown
        text = "proved best" if self.gap <= SAME else text
        left_out = list(self.extra.get("assumed", ()))
        if self.stopped:
            left_out.append("the search was stopped")
        physics = self.site.physics
        if off := self.extra.get("corrected"):
            why = ["what fades after a start"] * physics.fades + ["components that start up"] * bool(physics.slow)
            why += [f"the voltage of '{name}'" for name in physics.circuits]
            left_out.append(
                f"searched without {', '.join(why) or 'all that the run has'}: up to {100 * off:.2g} % more or less; "
                "all numbers are those of the run"
            )
        if "margins" in self.extra and any(
            [*self.extra["margins"]["reserve_wh"].values(), self.extra["margins"]["deadline_s"]]
        ):
            left_out.append("within its margins for chance")
        return f"{text} ({'; '.join(left_out)})" if left_out else text

    def summary(self) -> Json:
        """The plan as the JSON of the command line (schema ``missionsim.plan/1``)."""
        task = self.site.task
        physics = self.site.physics
        return {
            "schema": SCHEMA,
            **fields_of(task, "task=name robot=robot.name"),
            "feasible": self.feasible,
            "order": self.order(),
            **fields_of(self, "objective value bound gap"),
            "claim": self.claim if self.feasible else None,
            "duration_s": self.duration_s,
            "batteries": {
                name: {
                    "energy_wh": self.energy_wh.get(name),
                    "charge_left_wh": self.charge_left_wh.get(name),
                    "capacity_wh": float(physics.capacity_wh[b]),
                    "reserve_wh": float(physics.reserve_wh[b]),
                }
                for b, name in enumerate(physics.names)
            },
            "legs": [_leg_json(self, leg) for leg in self.legs],
            **self.extra,
        }

    def order(self) -> list[str]:
        """Names of the visits in the order in which they are made."""
        visits = self.site.task.visits
        return [visits[leg.visit].label for leg in self.legs if leg.visit is not None]

    def course(self) -> str:
        """The visits in their order, with how many rounds there are."""
        order, rounds = self.order(), self.extra.get("rounds", 1)
        each = len(order) // rounds
        text = " → ".join(order)
        if rounds == 1:
            return text
        of = f" of at most {self.extra['rounds_at_most']}" if "rounds_at_most" in self.extra else ""
        same = order == order[:each] * rounds
        return f"{rounds} rounds{of}" + (f", each {' → '.join(order[:each])}" if same else f": {text}")


def answer_of(tour: Tour, label: Label, objective: float, bound: float) -> Answer:
    """The legs of the best way that the search found."""
    site, physics = tour.site, tour.site.physics
    count = len(physics.names)
    made = Answer(site, True, objective=objective, bound=min(bound, objective))
    chain = chain_of(label)
    vectors = _vectors(chain, tour)
    clock, missing = 0.0, vectors[0][2 : 2 + count]
    used = np.zeros(count)

    def add(kind: str, place: str, use: Array, charged: Array | None = None, **more: Any) -> None:
        nonlocal clock, missing, used
        clock += float(use[0])
        used = used + use[1:]
        missing = missing + use[1:] if charged is None else charged
        wh, left = physics.by_name(use[1:]), physics.by_name(physics.capacity_wh - missing)
        made.legs.append(Leg(kind, place, float(use[0]), wh, left, **more))

    for k in range(1, len(chain)):
        step, state = chain[k], tour.at(chain[k].node)
        payload = site.order.payload_kg(tour.at(chain[k - 1].node)[0])
        stop = site.stops[state[1]]
        if step.move[0] == "refill":
            charger = stop.charger
            assert charger is not None
            x = vectors[k - 1].copy()
            seconds = float(vectors[k][1] - x[1])
            if seconds > 1e-9:
                level = charger.level_of(x, seconds)
                use = np.concatenate([[seconds], charger.draw_w * seconds / 3600.0])
                x[2 : 2 + count] = missing
                after = charger.after(x, use[:1], 1.0 if level is None else level)[0]
                add("charge", stop.place, use, after[2 : 2 + count], payload_kg=payload, level=level)
            elif made.legs and made.legs[-1].kind == "drive":
                add("wait", stop.place, np.zeros(1 + count), payload_kg=payload)  # it stood there all the same
            continue
        drive = step.move[1]
        for piece, use in zip(drive.pieces, drive.costs, strict=True):
            add("drive", piece.way.end, use, piece=piece, payload_kg=payload)
        waited = float(vectors[k][1] - vectors[k - 1][1] - step.move[2][1])
        stands = step.move[0] == 0 and bool(made.legs) and made.legs[-1].kind == "drive"  # between two rounds
        if waited > 1e-9 or stands:
            add("wait", stop.place, site.waiting * waited, payload_kg=payload)
        if stop.visit is not None:
            load = site.order.payload_kg(state[0])
            use, number = site.standing(state[1], load)[step.move[3]], stop.visit
            chosen = site.task.choices_of(site.task.visits[number])[step.move[3]]
            add("visit", stop.place, use, visit=number, scheme=chosen, payload_kg=load)
    made.duration_s = clock
    made.energy_wh = physics.by_name(used)
    made.charge_left_wh = physics.by_name(physics.capacity_wh - missing)
    return made


def _vectors(chain: list[Label], tour: Tour) -> list[Array]:
    """The vector at each label of a way, where labels are chains of points: chosen from the end backwards."""
    last = chain[-1].points
    point = last[int(np.argmin(last[:, 0]))]
    vectors = [point]
    for label, earlier in zip(chain[:0:-1], chain[-2::-1], strict=True):
        if label.move[0] == "refill":
            point = earlier.points[label.move[1]]
        elif len(earlier.points) == 1:
            point = earlier.points[0]
        elif (wait := tour.opens(label.node)) is None:
            point = point - label.move[2]
        else:  # the point that waiting takes to this one
            best, points = math.inf, earlier.points + label.move[2]
            found = points[0]
            for first, second in itertools.pairwise(points):
                begin, end = wait(first[None, :])[0], wait(second[None, :])[0]
                step = end - begin
                size = float(step @ step)
                share = min(1.0, max(0.0, float((point - begin) @ step) / size)) if size > 0.0 else 0.0
                off = float(np.abs(wait((first + share * (second - first))[None, :])[0] - point).max())
                if off < best:
                    best, found = off, first + share * (second - first)
            point = np.asarray(found) - label.move[2]
        vectors.append(point)
    return vectors[::-1]


def _leg_json(answer: Answer, leg: Leg) -> dict[str, Any]:
    made = fields_of(leg, "kind to=place duration_s energy_wh charge_wh payload_kg")
    if leg.piece is not None:
        settings = leg.piece.legs[0].settings
        made |= fields_of(leg.piece, "from=way.begin edge=name edge_index=way.edge distance_m speed_m_s=limit_m_s")
        made |= {"scheme": settings.scheme or None, "navigation": settings.navigation or None}
        made["sensors"] = dict(settings.sensors)
    if leg.visit is not None:
        visit = answer.site.task.visits[leg.visit]
        made |= {"visit": visit.label, **equipment(leg.scheme or visit)}
    if leg.kind == "charge":
        made["until"] = leg.level
    return made


def mission_text(answer: Answer, target: PathLike | None) -> str:
    """The YAML text of a mission that does what the plan says. `answer`: feasible. `target`: where it will lie, for the
    paths of robot and environment; None for the task's own folder."""
    task = answer.site.task
    folder = Path(target).absolute().parent if target is not None else task.path.absolute().parent
    shipped, robot = task.robot_ref in shipped_robots(), task.robot.path.absolute()
    energy = ", ".join(f"{in_wh(value)} Wh {name}" for name, value in answer.energy_wh.items())
    lines = [
        f"# Written by `missionsim plan` from {task.path.name}: edit the task, not this file.",
        f"# {answer.duration_s:.1f} s, {energy}; {answer.claim}.",
        *(f"# Planned with --set {path}={value!r}: run it with the same." for path, value in task.elsewhere),
        "kind: mission",
        f"name: {flow(task.name + '_plan')}",
        f"robot: {flow(task.robot_ref if shipped else os.path.relpath(robot, folder))}",
        f"environment: {flow(os.path.relpath(task.environment.path.absolute(), folder))}",
        f"start: {flow(task.start)}",
    ]
    if task.start_heading is not None:
        lines.append(f"start_heading: {task.start_heading.value!r}")
    if task.initial_charge:
        lines.append(f"initial_charge: {flow({name: charge.value for name, charge in task.initial_charge.items()})}")
    if defaults := task.document.data.get("defaults"):
        lines.append(f"defaults: {flow(defaults)}")
    reserve = {name: task.reserve_of(name) for name in task.robot.batteries}
    lines += [f"policy: {flow({'dock': task.goal, 'reserve': reserve})}", "segments:"]
    payload_kg = 0.0 if task.defaults.payload is None else task.defaults.payload.value
    for leg in answer.legs:
        body: dict[str, Any] = {}
        asked: SchemeChoice | VisitSpec | None = leg.scheme
        if leg.piece is not None:
            kind, why, asked = "drive", f"to {leg.place}: ", leg.piece.scheme
            body = {"along": [leg.piece.name]} | ({} if leg.piece.speed is None else {"speed": leg.piece.speed})
        elif leg.visit is not None:
            visit = task.visits[leg.visit]
            kind, why, given = ("wait", "", visit.wait) if visit.inspect is None else ("inspect", "", visit.inspect)
            body, asked = {"name": visit.label, "duration": 0.0 if given is None else given.value}, asked or visit
        elif leg.kind == "wait":
            until = "until the next round is due" if task.repeat is not None else "until the window opens"
            kind, why = "wait", f"{until if leg.duration_s > 0.0 else 'a stop at the dock'}: "
            body = {"duration": leg.duration_s}
        else:
            kind, why = "dock", f"at {leg.place}: "
            body = {"recharge": {"duration": leg.duration_s} if leg.level is None else {"until": leg.level}}
        body |= {key: value for key, value in equipment(asked).items() if value is not None}
        if leg.visit is not None or (leg.piece is not None and leg.payload_kg != payload_kg):
            body["payload"] = leg.payload_kg
        left = ", ".join(f"{name} {in_wh(charge)} Wh" for name, charge in leg.charge_wh.items())
        lines.append(f"  - {kind}: {flow(body)}  # {why}then {left}")
    if not answer.legs:
        lines.append("  - wait: {duration: 0 s}")
    return "\n".join(lines) + "\n"


def flow(value: object) -> str:
    """Plain data as one line of YAML; JSON is a part of YAML 1.2, and its numbers keep all digits."""
    return json.dumps(value, ensure_ascii=False)
