"""In which order visits may be made: the states of what is done already, and what may come next."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

from missionsim.inputs.check_task import earlier_of
from missionsim.inputs.task import TaskSpec

MOST_FREE = 13
"""Visits in any order of which all subsets are gone through."""


class Order:
    """The states of a task's visits.

    In any order a state is the set of visits done, as bits; in a given order it is how many of them lie behind.

    Parameters
    ----------
    task : TaskSpec
    sequence : sequence of int, optional
        An order to keep to.
    """

    def __init__(self, task: TaskSpec, sequence: tuple[int, ...] | None = None) -> None:
        self.visits = task.visits
        given = task.defaults.payload
        self.load_kg = 0.0 if given is None else given.value
        if sequence is None and task.order == "given":
            sequence = tuple(range(len(self.visits)))
        self.sequence = sequence
        self._changes = any(visit.take_up is not None or visit.set_down is not None for visit in self.visits)
        self._earlier = [sum(1 << other for other in needs) for needs in earlier_of(self.visits)]
        self._needed = sum(1 << i for i, visit in enumerate(self.visits) if visit.value is None)
        most = task.within.max_payload or task.robot.body.max_payload
        self._most_kg = None if most is None else most.value

    @cached_property
    def count(self) -> int:
        """How many states there are."""
        return len(self.visits) + 1 if self.sequence is not None else 1 << len(self.visits)

    def states(self) -> Iterator[int]:
        """All states, each after those that follow from it."""
        return iter(range(self.count - 1, -1, -1))

    def payload_kg(self, state: int) -> float:
        """Load carried in a state."""
        if not self._changes:
            return self.load_kg
        load = self.load_kg
        for i in self.done(state):
            visit = self.visits[i]
            load += visit.take_up.value if visit.take_up is not None else 0.0
            load -= visit.set_down.value if visit.set_down is not None else 0.0
        return max(load, 0.0) if load > -1e-9 else load

    def done(self, state: int) -> list[int]:
        """The visits done in a state; in a given order also those left out."""
        if self.sequence is not None:
            return sorted(self.sequence[:state])
        return [i for i in range(len(self.visits)) if state >> i & 1]

    def after(self, state: int) -> list[tuple[int, int]]:
        """Visits that may come next and the state after each."""
        found = []
        if self.sequence is not None:
            for position in range(state, len(self.sequence)):
                found.append((self.sequence[position], position + 1))
                if self.visits[self.sequence[position]].value is None:
                    break
        else:
            for i in range(len(self.visits)):
                if not state >> i & 1 and self._earlier[i] & self._needed & ~state == 0:
                    found.append((i, state | 1 << i))
        return [(i, after) for i, after in found if self._carries(after)]

    def _carries(self, state: int) -> bool:
        load = self.payload_kg(state)
        return not self._changes or (load >= -1e-9 and (self._most_kg is None or load <= self._most_kg * (1 + 1e-12)))

    def may_end(self, state: int) -> bool:
        """Whether nothing that must be done is left."""
        if self.sequence is not None:
            return all(self.visits[i].value is not None for i in self.sequence[state:])
        return self._needed & ~state == 0
