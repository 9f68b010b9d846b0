"""Components as SimPy processes: off, starting, on; what they require first; off again when nobody needs them."""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import simpy

from missionsim.engine.recorder import Recorder
from missionsim.plan.steady import closure

LATE = simpy.events.EventPriority(2)
"""Priority after every normal event of the same instant: a component that one asks off and another on stays on,
whatever the order in which they ask."""


@dataclass(frozen=True, slots=True)
class ComponentInfo:
    """What the engine must know of a component."""

    name: str
    units: int = 1
    """How many there are."""
    always_on: bool = False
    requires: tuple[str, ...] = ()
    """Components that must be on before."""
    startup_s: float = 0.0
    """Time between switching on and being on; the first unit pays it."""


class Switchboard:
    """All components of a robot, who needs how many units of them, and how many are on.

    `infos`: in the order of the recorder's columns.
    """

    def __init__(self, env: simpy.Environment, recorder: Recorder, infos: Iterable[ComponentInfo]) -> None:
        self._env = env
        self._recorder = recorder
        self.infos = {info.name: info for info in infos}
        self._index = {name: index for index, name in enumerate(self.infos)}
        self._on = dict.fromkeys(self.infos, 0)
        self._starting: set[str] = set()
        self._coming: dict[str, simpy.Event] = {}
        self._held: dict[Hashable, Mapping[str, int]] = {}
        self._closures: dict[tuple[tuple[str, int], ...], dict[str, int]] = {(): {}}
        self._asked: set[str] = set()
        self._slow = any(info.startup_s > 0.0 for info in self.infos.values())
        always = {info.name: info.units for info in self.infos.values() if info.always_on}
        if always:
            self.hold("always on", tuple(always.items()))

    def closure(self, sensors: tuple[tuple[str, int], ...]) -> dict[str, int]:
        """Components with everything that they require; see `missionsim.plan.steady.closure`."""
        known = self._closures.get(sensors)
        if known is None:
            known = self._closures[sensors] = closure(self.infos, sensors)
        return known

    def hold(self, holder: Hashable, sensors: tuple[tuple[str, int], ...]) -> None:
        """From now on `holder` needs exactly these components (and what they require); () releases all."""
        wanted = self.closure(sensors)
        before = self._held.get(holder, {})
        if wanted is before:
            return
        self._held[holder] = wanted
        changed = {name for name in before.keys() | wanted.keys() if before.get(name) != wanted.get(name)}
        if changed and not self._asked:  # what is asked for by then is switched after all else of this instant
            late = simpy.Event(self._env)
            late._ok, late._value = True, None
            late.callbacks.append(self._switch_asked)
            self._env.schedule(late, priority=LATE)
        self._asked |= changed

    def waiting_for(self, sensors: tuple[tuple[str, int], ...]) -> list[simpy.Event]:
        """Events of those components, required ones included, that take time to come on; empty where none."""
        if not self._slow:
            return []
        off = [name for name in self.closure(sensors) if not self._on[name]]
        return [self._when_on(name) for name in off] if any(self.infos[name].startup_s > 0.0 for name in off) else []

    def _when_on(self, name: str) -> simpy.Event:
        """An event that happens when a component is on; only for one that is off."""
        return self._coming.setdefault(name, self._env.event())

    def _lacking(self, name: str) -> list[str]:
        """What a component requires and is not on."""
        return [required for required in self.infos[name].requires if not self._on[required]]

    def _wanted(self, name: str) -> int:
        """Units that the most demanding of those who need it asks for."""
        return max([held.get(name, 0) for held in self._held.values()])

    def _switch_asked(self, _: simpy.Event) -> None:
        asked, self._asked = sorted(self._asked, key=self._index.__getitem__), set()
        lacking = []
        for name in asked:
            if self._lacking(name):
                lacking.append(name)
            else:
                self._switch(name)
        for name in lacking:  # what they require has come on meanwhile, or takes its time
            self._switch(name)

    def _switch(self, name: str) -> None:
        """Become what is wanted: at once, or after what it requires and its start-up."""
        wanted, on = self._wanted(name), self._on[name]
        if name in self._starting or wanted == on:
            return
        if wanted and not on and (self.infos[name].startup_s > 0.0 or self._lacking(name)):
            self._starting.add(name)
            self._env.process(self._start(name))
            return
        self._set(name, wanted)

    def _set(self, name: str, units: int) -> None:
        self._recorder.component(self._index[name], units, 0)
        self._on[name] = units
        if units and name in self._coming:
            self._coming.pop(name).succeed()

    def _start(self, name: str) -> Generator[simpy.Event, Any, None]:
        for required in self._lacking(name):
            if not self._on[required]:
                yield self._when_on(required)
        startup_s = self.infos[name].startup_s
        if startup_s > 0.0 and self._wanted(name):
            self._recorder.component(self._index[name], 0, self._wanted(name))
            yield self._env.timeout(startup_s)
        self._starting.discard(name)
        self._set(name, self._wanted(name))
