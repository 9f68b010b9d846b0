"""Why there is no plan: what is short, and the smallest single change that would do; and what else there was."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from missionsim.files import Json, fields_of
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.task import TaskSpec
from missionsim.numerals import in_wh, rounded
from missionsim.physics import Array
from missionsim.planner.answer import Answer, Leg
from missionsim.planner.site import MOST_FREE, Order, Site, make_site
from missionsim.planner.solve import solve_site

AMPLE_WH = 1e5
ENOUGH = 1.0 + 1e-8
"""What would do is told by so much more, lest rounding takes it away again."""
CLOSE = 1.005
MOST_CALLS = 200
"""So many times a search for a smaller battery tells how far it is, before it is given up."""
POINTS = 9
"""Of the front of energy against time."""


def explain(site: Site) -> Json:
    """What is short where there is no plan, each with the single change that would do, smallest first.

    Gives ``short``: what lacks (``time`` or a battery), how much, where; ``would_do``: single changes, each of which
    gives a plan; ``text``: both as sentences.
    """
    if not site.order.possible:
        limit = "above nothing" if site.task.most_kg is None else f"between 0 and {site.task.most_kg:g} kg"
        line = f"payload: no order of the visits that the task allows keeps the load {limit}"
        return _told([{"what": "payload"}], [*_lighter(site), *_one_less(site)], [line])
    if lost := _shut_off(site.task):
        told = [f"'{place}' cannot be visited: every way there, or on from there, is closed" for place in lost]
        return _told([{"what": "way", "to": place} for place in lost], [*_opened(site), *_one_less(site)], told)
    short: list[dict[str, Any]] = []
    changes: list[dict[str, Any]] = []
    if math.isfinite(site.deadline_s):
        free = solve_site(replace(site, deadline_s=math.inf, weights=_time(site)), valued=False)
        if free.feasible:
            lacking = free.duration_s - site.deadline_s
            ends = np.cumsum([leg.duration_s for leg in free.legs])
            late = free.legs[min(int(np.searchsorted(ends, site.deadline_s, side="right")), len(ends) - 1)]
            short.append({"what": "time", "short_s": lacking, "leg": _name(late), "to": late.place})
            text = f"a deadline of {_up(free.duration_s, 1):.1f} s ({_up(lacking, 1):.1f} s later)"
            share = lacking / site.deadline_s
            changes.append(_change("within.deadline", ENOUGH * free.duration_s, "s", text, share))
    unserved = {}
    for b, name in enumerate(site.physics.names):
        docks = {stop.place: stop.charger for stop in site.stops if stop.charger is not None}
        if docks and not any(charger.gain_w[b] > 0.0 for charger in docks.values()):
            unserved[name] = f"; no dock that may be used charges it: {', '.join(docks)}"
        answer = with_ample(site, b)
        if answer is None:
            continue
        initial, reserve = float(site.physics.initial_wh[b]), float(site.physics.reserve_wh[b])
        needed, leg = _needed(answer, name, initial - reserve)
        lacking = needed + reserve - initial
        if lacking <= 0.0:
            continue
        short.append({"what": name, "short_wh": lacking, "leg": _name(leg), "to": leg.place})
        capacity = float(site.physics.capacity_wh[b])
        if needed + reserve <= capacity:
            level, before = 100.0 * (needed + reserve) / capacity, 100.0 * initial / capacity
            text = f"'{name}' at {min(100.0, _up(level, 1)):.1f} % at the start in place of {before:.1f} %"
            to = min(1.0, ENOUGH * level / 100.0)
            changes.append(_change(f"initial_charge.{name}", to, "", text, lacking / capacity))
        usable = (initial - reserve) / capacity
        if usable <= 0.0:
            continue
        larger = needed / usable
        if any(charger.gain_w[b] > 0.0 for charger in docks.values()):
            larger = _charged(site, name, capacity, larger)
        digits = max(2, 2 - math.floor(math.log10(larger)))
        text = f"a battery '{name}' of {_up(larger, digits):.{digits}f} Wh in place of {rounded(capacity, 4)} Wh"
        to, key = ENOUGH * larger, f"robot.batteries.{name}.capacity"
        changes.append(_change(key, to, "Wh", text, larger / capacity - 1.0))
    changes += [*_one_less(site), *_other_changes(site)]
    lines = []
    for item in short:
        amount = f"{item['short_s']:.1f} s" if "short_s" in item else f"{in_wh(_up(item['short_wh'], 3))} Wh"
        what = "time" if item["what"] == "time" else f"battery '{item['what']}'"
        where = f"first on {item['leg']} to {item['to']}, all else as asked{unserved.get(item['what'], '')}"
        lines.append(f"{what}: {amount} short, {where}")
    if short:
        return _told(short, changes, lines)
    # taking away one limit is not enough: what lacks of the plan that takes least of the first battery
    answer = with_ample(replace(site, deadline_s=math.inf), 0, every=True)
    if answer is None:
        windows = " within the windows" if site.windowed else ""
        ample = f"not with {AMPLE_WH:g} Wh in each battery and no deadline either"
        return _told(short, changes, [f"no way does all that is asked{windows}, {ample}"])
    lines.append("more than one limit is short: no single one, taken away, gives a plan; without any of them")
    if answer.duration_s > site.deadline_s:
        lines.append(f"time: {answer.duration_s - site.deadline_s:.1f} s short")
    for b, name in enumerate(site.physics.names):
        left = float(site.physics.initial_wh[b] - site.physics.reserve_wh[b])
        needed, leg = _needed(answer, name, left)
        if needed > left:
            lines.append(
                f"battery '{name}': {in_wh(_up(needed - left, 3))} Wh short, first on {_name(leg)} to {leg.place}"
            )
    return _told(short, changes, lines)


def _change(key: str, to: object, unit: str, text: str, relative: float) -> dict[str, Any]:
    """A single change that would do, and how large it is in its own measure."""
    return {"change": key, "to": to, "unit": unit, "text": text, "relative": relative}


def _told(short: list[dict[str, Any]], changes: list[dict[str, Any]], lines: list[str]) -> dict[str, Any]:
    changes.sort(key=lambda change: change["relative"])
    if changes:
        lines.append("smallest single change that would do: " + changes[0]["text"])
        lines += [f"or: {change['text']}" for change in changes[1:4]]
    else:
        lines.append(
            "no single change that was tried would do: a later deadline, a larger battery, a visit less, a dock"
        )
    return {"short": short, "would_do": changes, "text": lines}


def with_ample(site: Site, battery: int, *, every: bool = False) -> Answer | None:
    """The plan that takes least of a battery that holds as much as one likes; None where there is none. With `every`
    all batteries hold as much as one likes."""
    physics = site.physics
    which = np.full(len(physics.names), every) | (np.arange(len(physics.names)) == battery)
    capacity, initial = (np.where(which, AMPLE_WH, wh) for wh in (physics.capacity_wh, physics.initial_wh))
    ample = physics.but(capacity_wh=capacity, initial_wh=initial, reserve_wh=np.where(which, 0.0, physics.reserve_wh))
    task = site.task.model_copy(update={"choose": site.task.choose.model_copy(update={"docks": "none"})})
    stops = [stop for stop in site.stops if stop.charger is None]
    weights = np.eye(len(site.weights))[1 + battery]
    bare = replace(site, physics=ample, weights=weights, task=task, stops=stops, _roads={}, _standing={})
    answer = solve_site(bare, valued=False)
    return replace(answer, site=replace(bare, physics=physics)) if answer.feasible else None


def _charged(site: Site, name: str, low: float, high: float) -> float:
    """A capacity between one that is too little and one that will do without charging: the least found that will do
    with it."""
    robot, least = site.task.robot, low
    battery = robot.batteries[name]
    while high > CLOSE * low:
        middle = math.sqrt(low * high)
        capacity = replace(battery.capacity, value=battery.capacity.value * middle / least)
        batteries = {**robot.batteries, name: battery.model_copy(update={"capacity": capacity})}
        task = site.task.model_copy(update={"robot": robot.model_copy(update={"batteries": batteries})})
        calls = itertools.count(1)
        if solve_site(make_site(task), lambda *_, calls=calls: next(calls) > MOST_CALLS, valued=False).feasible:
            high = middle
        else:
            low = middle
    return high


def _needed(answer: Answer, name: str, left_wh: float) -> tuple[float, Leg]:
    """What a plan takes of a battery at most on the way, and the first leg on which that is more than is left."""
    spent = np.cumsum([0.0, *(leg.energy_wh[name] for leg in answer.legs)])
    below = np.flatnonzero(spent[1:] > left_wh)
    return float(spent.max()), answer.legs[below[0] if below.size else -1]


def _name(leg: Leg) -> str:
    if leg.piece is None:
        return leg.kind
    return "the way" if leg.piece.name == leg.place else f"edge '{leg.piece.name}'"


def _time(site: Site) -> Array:
    """Weights with which time alone counts."""
    return np.asarray(np.eye(1, len(site.weights))[0])


def _up(value: float, digits: int) -> float:
    """Rounded up: what is told must do."""
    return math.ceil(ENOUGH * value * 10.0**digits) / 10.0**digits


def _lighter(site: Site) -> Iterator[dict[str, Any]]:
    """The least that the robot would have to be able to carry, and what it would have to carry from the start."""
    task, order, most = site.task, site.order, site.task.most_kg
    if order.sequence is None and len(task.visits) > MOST_FREE:
        return
    loads = order.loads[0]
    for load in [] if most is None else loads[loads > most].tolist():
        if solve_site(make_site(task, Order(task, order.sequence, most_kg=load))).feasible:
            own, body = task.within.max_payload, task.robot.body.max_payload
            of_robot = own is None or (body is not None and body.value <= own.value)
            key = "robot.body.max_payload" if of_robot else "within.max_payload"
            text = f"a greatest load of {load:g} kg in place of {most:g} kg ({key})"
            yield _change(key, load, "kg", text, load / max(most or 0.0, 1e-9) - 1.0)
            break
    for extra in sorted({-load for load in loads.tolist() if load < 0.0}):
        kg = order.load_kg + extra
        if _changed(task, defaults=task.defaults.model_copy(update={"payload": Parameter(kg, unit="kg")})).feasible:
            text = f"{kg:g} kg on board at the start in place of {order.load_kg:g} kg (defaults: {{payload: …}})"
            yield _change("defaults.payload", kg, "kg", text, extra / max(float(np.abs(loads).max()), 1e-9))
            break


def _changed(task: TaskSpec, **changes: Any) -> Answer:
    """The plan of a task with something else in it."""
    return solve_site(make_site(task.model_copy(update=changes)))


def _one_less(site: Site) -> Iterator[dict[str, Any]]:
    """A visit less."""
    task, count = site.task, len(site.task.visits)
    for i, visit in enumerate(task.visits) if 1 < count <= 8 else ():
        rest = []
        for other in (*task.visits[:i], *task.visits[i + 1 :]):
            kept = {key: tuple(n for n in getattr(other, key) if n != visit.label) for key in ("before", "after")}
            rest.append(other.model_copy(update=kept))
        if _changed(task, visits=tuple(rest)).feasible:
            yield _change(f"visits.{i}", None, "", f"without the visit '{visit.label}'", 1.0 / count)


def _shut_off(task: TaskSpec) -> list[str]:
    """Places that must be visited and that open edges do not lead to and on from."""
    shut = {name for name, edge in task.edges.items() if edge.closed}
    out = task.environment.reached(task.start, shut)
    led = out & task.environment.reached(task.goal, shut, against=True)
    asked = [visit.place for visit in task.visits if visit.value is None]
    return [place for place in dict.fromkeys([*asked, task.goal]) if place not in led]


def _opened(site: Site) -> Iterator[dict[str, Any]]:
    """An edge or a place that is no longer closed."""
    task, environment = site.task, site.task.environment
    shut = {name: f"edges.{name}.closed" for name, edge in task.edges.items() if edge.closed}
    edges = [edge.name for edge in environment.edges if edge.closed and edge.name is not None]
    shut |= {name: f"environment.edges.{name}.closed" for name in edges}
    shut |= {name: f"environment.places.{name}.closed" for name, place in environment.places.items() if place.closed}
    for name, change in shut.items():
        kept = {key: edge for key, edge in task.edges.items() if key != name}
        other = task.model_copy(update={"edges": kept, "environment": environment.opened(name)})
        if not _shut_off(other) and solve_site(make_site(other)).feasible:
            what = "place" if name in environment.places else "edge"
            yield _change(change, False, "", f"{what} '{name}' open (--set {change}=false)", 0.4)


def _other_changes(site: Site) -> Iterator[dict[str, Any]]:
    """An edge that is opened; a window that ends later; the docks that the task does not use."""
    task = site.task
    yield from _opened(site)
    for i, visit in enumerate(task.visits):
        if visit.window is None or visit.window.until is None:
            continue
        free = visit.model_copy(update={"window": visit.window.model_copy(update={"until": None})})
        visits = (*task.visits[:i], free, *task.visits[i + 1 :])
        answer = _changed(task, visits=visits)
        if answer.feasible:
            number = next((k for k, leg in enumerate(answer.legs) if leg.visit == i), len(answer.legs))
            begins, until = sum(leg.duration_s for leg in answer.legs[:number]), visit.window.until.value
            text = f"a window of '{visit.label}' until {_up(begins, 1):.1f} s ({_up(begins - until, 1):.1f} s later)"
            share = (begins - until) / max(until, 1.0)
            yield _change(f"visits.{i}.window.until", ENOUGH * begins, "s", text, share)
    chargers = task.environment.chargers
    if set(chargers) - set(task.docks) and task.docks != chargers:
        answer = solve_site(_site(task, docks="all"))
        if answer.feasible:
            minutes = sum(leg.duration_s for leg in answer.legs if leg.kind == "charge") / 60.0
            where = ", ".join(dict.fromkeys(leg.place for leg in answer.legs if leg.kind == "charge"))
            text = f"charging {minutes:.1f} min at {where} (choose: {{docks: all}})"
            yield _change("choose.docks", "all", "", text, 0.5)


def alternatives(answer: Answer) -> list[Json]:
    """The next best plans that differ in kind: one scheme or one speed for all, no charging, least time or energy."""
    site, task = answer.site, answer.site.task
    choose = task.choose
    kinds: list[tuple[str, Site]] = []
    schemes = choose.schemes or ()
    used = [leg.piece.scheme for leg in answer.legs if leg.piece is not None]
    for scheme in schemes if len(schemes) > 1 else ():
        if any(one != scheme for one in used):
            name = "/".join(filter(None, (scheme.scheme, scheme.navigation)))
            kinds.append((f"only scheme {name}", _site(task, schemes=(scheme,))))
    if any(leg.kind == "charge" for leg in answer.legs):
        kinds.append(("no charging", _site(task, docks="none")))
    kinds.append(("least time", replace(site, weights=_time(site))))
    kinds.append(("least energy", replace(site, weights=1.0 - _time(site))))
    found: list[dict[str, Any]] = []
    for name, other in kinds:
        made = solve_site(other)
        if not made.feasible:
            found.append({"kind": name, "feasible": False})
            continue
        objective = float(np.array([made.duration_s, *made.energy_wh.values()]) @ site.weights)
        if objective <= answer.objective * (1 + 1e-9):
            continue
        worse = objective / answer.objective - 1.0 if answer.objective else None
        told = fields_of(made, "duration_s energy_wh") | {"order": made.order()}
        found.append({"kind": name, "feasible": True, "objective": objective, "worse": worse, **told})
    return sorted(found, key=lambda item: item.get("objective", math.inf))


def _site(task: TaskSpec, **choices: Any) -> Site:
    return make_site(task.model_copy(update={"choose": task.choose.model_copy(update=choices)}))


def pareto(site: Site) -> list[Answer]:
    """The front of energy against time: the least energy within deadlines from the fastest plan's to no matter what."""
    seconds = _time(site)
    energy = site.weights * (1.0 - seconds)
    if not energy.any():
        energy = 1.0 - seconds
    fastest = solve_site(replace(site, weights=seconds))
    cheapest = solve_site(replace(site, weights=energy))
    if not fastest.feasible or not cheapest.feasible:
        return []
    found: list[Answer] = []
    for deadline in np.linspace(fastest.duration_s, cheapest.duration_s, POINTS):
        made = solve_site(replace(site, weights=energy, deadline_s=float(deadline) * (1.0 + 1e-12)))
        if made.feasible and (not found or made.duration_s > found[-1].duration_s * (1 + 1e-9)):
            found.append(made)
    return found
