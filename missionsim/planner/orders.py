"""In which order visits may be made: the states of what is done already, and what may come next."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from missionsim.inputs.check_task import earlier_of
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array

MOST_FREE = 13
"""Visits in any order of which all subsets are gone through."""
Ints = NDArray[np.intp]


class Order:
    """The states of a task's visits.

    A state is the set of visits done, as bits; in a given order that leaves nothing out (or of more than `MOST_FREE`
    visits) it is how many of them lie behind. `sequence`: an order to keep to; `most_kg`: in place of the task's.
    """

    def __init__(self, task: TaskSpec, sequence: tuple[int, ...] | None = None, most_kg: float | None = None) -> None:
        self.visits = task.visits
        count = len(self.visits)
        given = task.defaults.payload
        self.load_kg = 0.0 if given is None else given.value
        if sequence is None and task.order == "given":
            sequence = tuple(range(count))
        changes = [visit.take_up is not None or visit.set_down is not None for visit in self.visits]
        self._changes = any(changes)
        earlier = earlier_of(self.visits)
        self._optional = [visit.value is not None for visit in self.visits]
        if sequence is not None and any(self._optional) and count <= MOST_FREE:
            for rank, i in enumerate(sequence):
                earlier[i] |= set(sequence[:rank])
            sequence = None
        elif sequence is not None:  # positions do not tell what was left out, and so not what is carried
            self._optional = [free and not change for free, change in zip(self._optional, changes, strict=True)]
        self.sequence = sequence
        self._earlier = [sum(1 << other for other in needs) for needs in earlier]
        self._later = [sum(1 << i for i in range(count) if other in earlier[i]) for other in range(count)]
        self._needed = sum(1 << i for i in range(count) if not self._optional[i])
        self._most_kg = task.most_kg if most_kg is None else most_kg

    @cached_property
    def count(self) -> int:
        """How many states there are."""
        return len(self.visits) + 1 if self.sequence is not None else 1 << len(self.visits)

    def payload_kg(self, state: int) -> float:
        """Load carried in a state."""
        if not self._changes:
            return self.load_kg
        if self.sequence is not None:
            done = sorted(self.sequence[:state])  # also those left out
        else:
            done = [i for i in range(len(self.visits)) if state >> i & 1]
        load = self.load_kg + sum(self.visits[i].load_kg for i in done)
        return max(load, 0.0) if load > -1e-9 else load

    def after(self, state: int) -> list[tuple[int, int]]:
        """Visits that may come next and the state after each."""
        if self.sequence is not None:
            left = self.sequence[state:]
            must = next((k for k, i in enumerate(left) if not self._optional[i]), len(left))
            found = [(i, state + 1 + k) for k, i in enumerate(left[: must + 1])]
        else:
            found = [
                (i, state | 1 << i)
                for i in range(len(self.visits))
                if not state >> i & 1 and not self._earlier[i] & self._needed & ~state and not self._later[i] & state
            ]
        if not self._changes:
            return found
        most = math.inf if self._most_kg is None else self._most_kg * (1 + 1e-12)
        return [(i, after) for i, after in found if -1e-9 <= self.payload_kg(after) <= most]

    @cached_property
    def steps(self) -> list[tuple[Ints, Ints, Ints]]:
        """All visits from all states: states, visits, states after; in parts, each after those that follow from it."""
        parts: dict[int, list[tuple[int, int, int]]] = {}
        for state in range(self.count):
            level = state if self.sequence is not None else state.bit_count()
            if self.payload_kg(state) >= 0.0:
                parts.setdefault(level, []).extend((state, visit, after) for visit, after in self.after(state))
        made = [np.array(parts[level], dtype=np.intp).reshape(-1, 3) for level in sorted(parts, reverse=True)]
        return [(part[:, 0], part[:, 1], part[:, 2]) for part in made if len(part)]

    @cached_property
    def standing(self) -> list[tuple[int, int]]:
        """Under which of the loads each visit may be made: (load, visit)."""
        which, made = self.loads[1], set[tuple[int, int]]()
        for _, visits, afters in self.steps:
            made |= set(zip(which[afters].tolist(), visits.tolist(), strict=True))
        return sorted(made)

    @cached_property
    def driven(self) -> list[int]:
        """Under which of the loads the robot may drive."""
        which = self.loads[1]
        return sorted({int(which[0]), *(int(i) for begin, _, end in self.steps for i in (*which[begin], *which[end]))})

    @cached_property
    def loads(self) -> tuple[Array, Ints]:
        """The loads that may be carried, and which of them in each state."""
        carried = np.array([self.payload_kg(state) for state in range(self.count)])
        loads, which = np.unique(carried, return_inverse=True)
        return loads, np.ravel(which)

    @cached_property
    def ends(self) -> NDArray[np.bool_]:
        """States in which nothing that must be done is left."""
        return np.array([self.may_end(state) for state in range(self.count)])

    def may_end(self, state: int) -> bool:
        """Whether nothing that must be done is left."""
        if self.sequence is not None:
            return all(self._optional[i] for i in self.sequence[state:])
        return self._needed & ~state == 0

    @cached_property
    def possible(self) -> bool:
        """Whether the load allows to do what must be done, in some order."""
        found, waiting = {0}, [0]
        while waiting:
            state = waiting.pop()
            if self.may_end(state):
                return True
            new = {after for _, after in self.after(state)} - found
            found |= new
            waiting += new
        return False

    def left(self, values: Array) -> Array:
        """Value that may still be made from each state, shape (states,)."""
        if self.sequence is not None:
            return np.append(np.cumsum(values[list(self.sequence)][::-1])[::-1], 0.0)
        bits = np.arange(self.count)[:, None] >> np.arange(len(values)) & 1
        return np.asarray((1 - bits) @ values)
