"""Checks of a task against its robot and environment."""

from __future__ import annotations

from typing import Any

from missionsim.errors import Fault
from missionsim.inputs.checker import Checker, Where
from missionsim.inputs.task import TaskSpec, VisitSpec, speeds_of
from missionsim.inputs.tree import Document


def check_task(task: TaskSpec, document: Document) -> list[Fault]:
    """Places, ways, visits and their order, schemes, speeds, docks; as far as robot and environment could be loaded."""
    return _TaskCheck(task, document).run()


class _TaskCheck:
    def __init__(self, task: TaskSpec, document: Document) -> None:
        self.task = task
        self.check = Checker(document)
        self.places = None if task.environment is None else Checker(task.environment.document).raw_keys("places")

    def run(self) -> list[Fault]:
        task = self.task
        self.place(("start",), task.start)
        if task.end is not None:
            self.place(("end",), task.end)
        for index, visit in enumerate(task.visits):
            self.place(("visits", index, "place"), visit.place)
        self.visits()
        self.order()
        self.robot()
        self.ways()
        self.docks()
        if task.repeat is not None:
            self.repeat()
        return self.check.faults

    def place(self, where: Where, name: str) -> bool:
        return self.places is None or self.check.known(where, name, self.places, "place")

    def visits(self) -> None:
        labels: dict[str, int] = {}
        for index, visit in enumerate(self.task.visits):
            if visit.label in labels:
                self.check.add(
                    ("visits", index),
                    f"two visits are called '{visit.label}'",
                    got=visit.label,
                    allowed="a name of its own for each visit of a place",
                    key=True,
                )
            labels.setdefault(visit.label, index)
        for index, visit in enumerate(self.task.visits):
            for key in ("before", "after"):
                for number, name in enumerate(getattr(visit, key)):
                    where = ("visits", index, key)
                    raw = self.check.document.node(where).children
                    self.check.known((*where, number) if isinstance(raw, list) else where, name, labels, "visit")
            window, deadline = visit.window, self.task.within.deadline
            if window is not None and deadline is not None and window.from_.value > deadline.value:
                self.check.add(
                    ("visits", index, "window"),
                    "the window opens after the deadline",
                    got=f"{window.from_.value:g} s",
                    allowed=f"before {deadline.value:g} s",
                )

    def order(self) -> None:
        """Contradictory orders: a visit that must come before itself."""
        visits = self.task.visits
        number = {visit.label: index for index, visit in enumerate(visits)}
        after = earlier_of(visits)
        if self.task.order == "given":
            for index, needs in enumerate(after):
                for other in needs:
                    if other > index:
                        self.check.add(
                            ("visits", index),
                            f"'{visits[index].label}' stands before '{visits[other].label}' but must come after it",
                            got="order: given",
                            allowed="order: any, or the visits in the order that before and after ask for",
                            key=True,
                        )
            return
        left = set(number.values())
        while left:
            free = {index for index in left if not after[index] & left}
            if not free:
                names = ", ".join(visits[index].label for index in sorted(left))
                self.check.add(
                    ("visits", min(left)),
                    "these visits must each come before another of them, so that none can be first",
                    got=names,
                    allowed="before and after without a circle",
                    key=True,
                )
                return
            left -= free

    def robot(self) -> None:
        task, check, robot = self.task, self.check, self.task.robot
        if robot is None:
            return
        for name in task.initial_charge:
            check.known(("initial_charge", name), name, robot.batteries, "battery", key=True)
        if isinstance(task.within.reserve, dict):
            for name in task.within.reserve:
                check.known(("within", "reserve", name), name, robot.batteries, "battery", key=True)
        if isinstance(task.least.energy, dict):
            for name in task.least.energy:
                check.known(("least", "energy", name), name, robot.batteries, "battery", key=True)
        if task.defaults.scheme is not None:
            check.known(("defaults", "scheme"), task.defaults.scheme, robot.schemes, "control scheme")
        for index, visit in enumerate(task.visits):
            self.scheme(("visits", index), visit.scheme, visit.navigation, visit.sensors, moving=False)
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
            self.check.add(
                (*where, "speeds"),
                "faster than the robot",
                got=f"{speeds[-1]:g} m/s",
                allowed=f"at most {top:g} m/s (body.max_speed of {self.task.robot.name})",
            )
        for index, choice in enumerate(given.schemes or ()):
            self.scheme((*where, "schemes", index), choice.scheme, choice.navigation, choice.sensors, moving=True)

    def scheme(
        self, where: Where, scheme: str | None, navigation: str | None, sensors: dict[str, int] | None, *, moving: bool
    ) -> None:
        robot, check = self.task.robot, self.check
        assert robot is not None
        raw = check.document.node(where).children
        at = (*where, "scheme") if isinstance(raw, dict) else where
        if scheme is not None and not check.known(at, scheme, robot.schemes, "control scheme"):
            return
        spec = robot.schemes.get(scheme or "")
        if spec is not None and moving and not spec.motion:
            moves = ", ".join(name for name, item in robot.schemes.items() if item.motion)
            check.add(at, f"control scheme '{scheme}' stands still", got=str(scheme), allowed=moves)
        if navigation is not None and spec is not None:
            check.known((*where, "navigation"), navigation, spec.navigation, f"navigation of {scheme}")
        for name, count in (sensors or {}).items():
            check.units((*where, "sensors", name), name, count, robot)

    def payload(self) -> None:
        task = self.task
        given = task.defaults.payload
        load = 0.0 if given is None else given.value
        most = task.within.max_payload or task.robot.body.max_payload
        for index, visit in enumerate(task.visits):
            taken = 0.0 if visit.take_up is None else visit.take_up.value
            if most is not None and taken > most.value:
                self.check.add(
                    ("visits", index, "take_up"),
                    "more than the robot may carry",
                    got=f"{taken:g} kg",
                    allowed=f"at most {most.value:g} kg",
                )
            load += taken - (0.0 if visit.set_down is None else visit.set_down.value)
        if load < -1e-9 and not any(visit.value is not None for visit in task.visits):
            index = next(i for i in reversed(range(len(task.visits))) if task.visits[i].set_down is not None)
            self.check.add(
                ("visits", index, "set_down"),
                "more is set down than was taken up",
                got=f"{-load:g} kg too much over all visits",
                allowed="as much as defaults.payload and take_up give",
            )

    def ways(self) -> None:
        """Visits and the end that no open way leads to, or from which none leads on."""
        task, environment = self.task, self.task.environment
        if environment is None or self.places is None or not (environment.whole and environment.sound):
            return
        names = {edge.name for edge in environment.edges if edge.name is not None}
        for name in task.edges:
            self.check.known(("edges", name), name, names, "edge", key=True)
        if any(name not in self.places for name in (task.start, task.goal)):
            return
        closed = {name for name, edge in task.edges.items() if edge.closed}
        out, back = _reached(environment, task.start, closed), _reached(environment, task.goal, closed, against=True)
        if task.goal not in out:
            self.check.add(
                ("end",) if task.end else ("start",),
                f"no open way leads from '{task.start}' to '{task.goal}'",
                got=task.goal,
                allowed=", ".join(sorted(out))[:200],
            )
        for index, visit in enumerate(task.visits):
            if visit.place in self.places and task.goal in out and not {visit.place} <= out & back:
                way = f"from '{task.start}'" if visit.place not in out else f"on to '{task.goal}'"
                self.check.add(
                    ("visits", index, "place"),
                    f"'{visit.place}' cannot be visited: no open way leads {way}",
                    got=visit.place,
                    allowed=", ".join(sorted(out & back))[:200],
                )

    def docks(self) -> None:
        task, check = self.task, self.check
        environment, robot = task.environment, task.robot
        named = task.choose.docks
        if environment is None or isinstance(named, str):
            return
        chargers = [name for name, place in environment.places.items() if place.charger is not None]
        for index, name in enumerate(named):
            where = ("choose", "docks", index)
            if name in environment.places and name not in chargers:
                check.add(where, f"no charger at '{name}'", got=name, allowed=", ".join(chargers) or "no place has one")
            elif check.known(where, name, chargers, "place with a charger") and robot is not None:
                given = environment.places[name].charger
                served = given.batteries if given is not None and given.batteries else tuple(robot.batteries)
                if not set(served) & set(robot.batteries):
                    check.add(
                        where,
                        f"the charger at '{name}' charges none of the robot's batteries",
                        got=", ".join(served),
                        allowed=", ".join(robot.batteries),
                    )

    def repeat(self) -> None:
        task = self.task
        assert task.repeat is not None
        if task.start != task.goal:
            self.check.add(
                ("repeat",),
                "rounds must end where they start",
                got=f"start: {task.start}, end: {task.goal}",
                allowed=f"end: {task.start}",
                key=True,
            )


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


def _reached(environment: Any, start: str, closed: set[str], *, against: bool = False) -> set[str]:
    """Places that open edges lead to from a place; `against` their direction, the places that lead to it."""
    ways: dict[str, set[str]] = {}
    for _, edge, begin, end in environment.open_ways():
        if edge.name not in closed:
            begin, end = (end, begin) if against else (begin, end)
            ways.setdefault(begin, set()).add(end)
    found, waiting = {start}, [start]
    while waiting:
        new = ways.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found
