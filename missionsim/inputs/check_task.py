"""Checks of a task against its robot and environment."""

from __future__ import annotations

from typing import Any

from missionsim.errors import Fault
from missionsim.inputs.power import strange_floors
from missionsim.inputs.task import SpeedRange, TaskSpec, VisitSpec, speeds_of
from missionsim.inputs.tree import Where
from missionsim.inputs.validation import Checker


def check_task(task: TaskSpec) -> list[Fault]:
    """Places, ways, visits and their order, schemes, speeds, docks; as far as robot and environment could be loaded."""
    check = _TaskCheck(task)
    check.visits()
    check.order()
    check.robot()
    check.ways()
    check.docks()
    if task.repeat is not None:
        check.rounds()
    return [*check.faults, *strange_floors(task)]


class _TaskCheck(Checker):
    def __init__(self, task: TaskSpec) -> None:
        super().__init__(task.document)
        self.task = task
        self.places = None if task.environment is None else task.environment.document.names("places")

    def rounds(self) -> None:
        """What a round must leave as it was, and what is said of one mission only."""
        task = self.task
        if task.start != task.goal:
            got = f"start: {task.start}, end: {task.goal}"
            self.add(("repeat",), "rounds must end where they start", got, f"end: {task.start}", key=True)
        for index, visit in enumerate(task.visits):
            if visit.window is not None:
                told = "a window counts from the start of the mission, and rounds are many"
                self.add(("visits", index, "window"), told, "window and repeat", "one of them", key=True)
        up = sum(visit.take_up.value for visit in task.visits if visit.take_up is not None)
        down = sum(visit.set_down.value for visit in task.visits if visit.set_down is not None)
        if abs(up - down) > 1e-9 * max(up, down):
            told, got = "a round must set down what it takes up", f"{up:g} kg taken up, {down:g} kg set down"
            self.add(("repeat",), told, got, "as much of each", key=True)

    def visits(self) -> None:
        task = self.task
        labels: dict[str, int] = {}
        named: list[tuple[Where, str | None]] = [(("start",), task.start), (("end",), task.end)]
        named += [(("visits", index, "place"), visit.place) for index, visit in enumerate(task.visits)]
        for at, name in named:
            if name is not None and self.places is not None:
                self.known(at, name, self.places, "place")
        for index, visit in enumerate(task.visits):
            if visit.label in labels:
                allowed = "a name of its own for each visit of a place"
                told = f"two visits are called '{visit.label}'"
                self.add(("visits", index), told, visit.label, allowed, key=True)
            labels.setdefault(visit.label, index)
        for index, visit in enumerate(self.task.visits):
            for key in ("before", "after"):
                for number, name in enumerate(getattr(visit, key)):
                    where = ("visits", index, key)
                    raw = self.document.node(where).children
                    self.known((*where, number) if isinstance(raw, list) else where, name, labels, "visit")
            window, deadline = visit.window, self.task.within.deadline
            if visit.value is not None or window is None or deadline is None:
                continue  # what may be left out need not be possible
            if window.from_.value > deadline.value:
                got, allowed = f"{window.from_.value:g} s", f"before {deadline.value:g} s"
                self.add(("visits", index, "window"), "the window opens after the deadline", got, allowed)

    def order(self) -> None:
        """Contradictory orders: a visit that must come before itself."""
        visits = self.task.visits
        number = {visit.label: index for index, visit in enumerate(visits)}
        after = earlier_of(visits)
        if self.task.order == "given":
            for index, needs in enumerate(after):
                for other in needs:
                    if other > index:
                        told = f"'{visits[index].label}' stands before '{visits[other].label}' but must come after it"
                        allowed = "order: any, or the visits in the order that before and after ask for"
                        self.add(("visits", index), told, "order: given", allowed, key=True)
            return
        left = set(number.values())
        while left:
            free = {index for index in left if not after[index] & left}
            if not free:
                names = ", ".join(visits[index].label for index in sorted(left))
                message = "these visits must each come before another of them, so that none can be first"
                self.add(("visits", min(left)), message, names, "before and after without a circle", key=True)
                return
            left -= free

    def robot(self) -> None:
        task, robot = self.task, self.task.robot
        if robot is None:
            return
        self.keys(("initial_charge",), task.initial_charge, robot.batteries, "battery")
        self.keys(("within", "reserve"), task.within.reserve, robot.batteries, "battery")
        self.keys(("least", "energy"), task.least.energy, robot.batteries, "battery")
        if task.defaults.scheme is not None:
            moving = task.choose.schemes is None  # else all edges are driven under those
            self.scheme(("defaults",), task.defaults.scheme, task.defaults.navigation, None, moving=moving)
        for index, visit in enumerate(task.visits):
            self.scheme(("visits", index), visit.scheme, visit.navigation, visit.sensors, moving=False)
            for number, choice in enumerate(visit.schemes or ()):
                where = ("visits", index, "schemes", number)
                self.scheme(where, choice.scheme, choice.navigation, choice.sensors, moving=False)
        self.choices(("choose",), task.choose)
        for name, edge in task.edges.items():
            self.choices(("edges", name), edge)
        self.payload()

    def choices(self, where: Where, given: Any) -> None:
        """Speeds and schemes that may be chosen, everywhere or on an edge."""
        assert self.task.robot is not None
        top = self.task.robot.body.max_speed.value
        speeds = speeds_of(given.speeds)
        if speeds is not None and speeds[-1] > top * (1 + 1e-12):
            allowed = f"at most {top:g} m/s (body.max_speed of {self.task.robot.name})"
            each = [] if isinstance(given.speeds, SpeedRange) else [speed.value for speed in given.speeds]
            raw = self.document.node((*where, "speeds")).children
            at = (each.index(max(each)),) if each and isinstance(raw, list) else () if each else ("to",)
            self.add((*where, "speeds", *at), "faster than the robot", f"{speeds[-1]:g} m/s", allowed)
        known = self.task.robot.schemes
        some = any(c.scheme not in known or known[c.scheme].motion for c in given.schemes or ())
        # beside schemes to drive with, those of the task that stand still are for inspections
        moving = given is not self.task.choose or not some
        for index, choice in enumerate(given.schemes or ()):
            self.scheme((*where, "schemes", index), choice.scheme, choice.navigation, choice.sensors, moving=moving)

    def scheme(
        self, where: Where, scheme: str | None, navigation: str | None, sensors: dict[str, int] | None, *, moving: bool
    ) -> None:
        robot = self.task.robot
        assert robot is not None
        raw = self.document.node(where).children
        at = (*where, "scheme") if isinstance(raw, dict) else where
        if scheme is not None and not self.known(at, scheme, robot.schemes, "control scheme"):
            return
        spec = robot.schemes.get(scheme or "")
        if spec is not None and moving and not spec.motion:
            self.stands_still(at, str(scheme), robot, str(scheme))
        if navigation is not None and spec is not None:
            self.known((*where, "navigation"), navigation, spec.navigation, f"navigation of {scheme}")
        for name, count in (sensors or {}).items():
            self.units((*where, "sensors", name), name, count, robot)

    def payload(self) -> None:
        task = self.task
        given = task.defaults.payload
        load = 0.0 if given is None else given.value
        most = task.most_kg
        if most is not None and load > most:
            allowed = f"at most {most:g} kg"
            self.add(("defaults", "payload"), "more than the robot may carry", f"{load:g} kg", allowed)
        for index, visit in enumerate(task.visits):
            taken = 0.0 if visit.take_up is None else visit.take_up.value
            if most is not None and taken > most and visit.value is None:
                where, allowed = ("visits", index, "take_up"), f"at most {most:g} kg"
                self.add(where, "more than the robot may carry", f"{taken:g} kg", allowed)
            load += visit.load_kg
        if load < -1e-9 and not any(visit.value is not None for visit in task.visits):
            index = next(i for i in reversed(range(len(task.visits))) if task.visits[i].set_down is not None)
            got, allowed = f"{-load:g} kg too much over all visits", "as much as defaults.payload and take_up give"
            self.add(("visits", index, "set_down"), "more is set down than was taken up", got, allowed)

    def ways(self) -> None:
        """Visits and the end that no way leads to, or from which none leads on, were all that is closed open; what only
        closed edges keep from being visited has no plan, and the planner says what to open."""
        task, environment = self.task, self.task.environment
        if environment is None or self.places is None or not (environment.whole and environment.sound):
            return
        names = [edge.name for edge in environment.edges if edge.name is not None]
        self.keys(("edges",), task.edges, names, "edge")
        if any(name not in self.places for name in (task.start, task.goal)):
            return
        free = environment.opened()
        out, back = free.reached(task.start), free.reached(task.goal, against=True)
        if task.goal not in out:
            message = f"no way leads from '{task.start}' to '{task.goal}'"
            self.add(("end" if task.end else "start",), message, task.goal, ", ".join(sorted(out))[:200])
            return
        for index, visit in enumerate(task.visits):
            if visit.value is None and visit.place in self.places and not {visit.place} <= out & back:
                way = f"from '{task.start}'" if visit.place not in out else f"on to '{task.goal}'"
                message = f"'{visit.place}' cannot be visited: no way leads {way}"
                allowed = ", ".join(sorted(out & back))[:200]
                self.add(("visits", index, "place"), message, visit.place, allowed)

    def docks(self) -> None:
        task = self.task
        environment, robot = task.environment, task.robot
        named = task.choose.docks
        if environment is None or isinstance(named, str):
            return
        chargers = environment.chargers
        for index, name in enumerate(named):
            where = ("choose", "docks", index)
            if name in environment.places and name not in chargers:
                self.add(where, f"no charger at '{name}'", name, ", ".join(chargers) or "no place has one")
            elif self.known(where, name, chargers, "place with a charger") and robot is not None:
                given = environment.places[name].charger
                served = given.batteries if given is not None and given.batteries else tuple(robot.batteries)
                if not set(served) & set(robot.batteries):
                    message = f"the charger at '{name}' charges none of the robot's batteries"
                    self.add(where, message, ", ".join(served), ", ".join(robot.batteries))


def earlier_of(visits: tuple[VisitSpec, ...]) -> list[set[int]]:
    """For each visit the visits that must come before it."""
    number = {visit.label: index for index, visit in enumerate(visits)}
    earlier: list[set[int]] = [set() for _ in visits]
    for index, visit in enumerate(visits):
        earlier[index] |= {number[name] for name in visit.after if name in number}
        for name in visit.before:
            if name in number:
                earlier[number[name]].add(index)
    return earlier
