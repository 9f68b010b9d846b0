"""Components as SimPy processes: off, starting, on; what they require first; off again when nobody needs them."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
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
    """What the engine must know of a component.

    Attributes
    ----------
    name : str
    units : int
        How many there are.
    always_on : bool
    requires : tuple of str
        Components that must be on before.
    startup_s : float
        Time between switching on and being on; the first unit pays it.
    """

    name: str
    units: int = 1
    always_on: bool = False
    requires: tuple[str, ...] = ()
    startup_s: float = 0.0


class Component:
    """One component: how many units who needs, and its state.

    Parameters
    ----------
    board : Switchboard
    info : ComponentInfo
    index : int
        Position in the recorder's columns.
    """

    def __init__(self, board: Switchboard, info: ComponentInfo, index: int) -> None:
        self.board = board
        self.info = info
        self.index = index
        self.needs: dict[Any, int] = {}
        self.units_on = 0
        self.busy = False
        self._coming: simpy.Event | None = None

    @property
    def wanted(self) -> int:
        """Units that the most demanding of those who need it asks for."""
        return max(self.needs.values(), default=0)

    @property
    def lacking(self) -> list[Component]:
        """What it requires and is not on."""
        components = [self.board.components[name] for name in self.info.requires]
        return [component for component in components if not component.units_on]

    def when_on(self) -> simpy.Event:
        """An event that happens when it is on; only for one that is off."""
        if self._coming is None:
            self._coming = self.board.env.event()
        return self._coming

    def switch(self) -> None:
        """Become what is wanted: at once, or after what it requires and its start-up."""
        wanted = self.wanted
        if self.busy or wanted == self.units_on:
            return
        if wanted and not self.units_on and (self.info.startup_s > 0.0 or self.lacking):
            self.busy = True
            self.board.env.process(self._start())
            return
        self._set(wanted)

    def _set(self, units: int) -> None:
        self.board.recorder.component(self.index, units, 0)
        self.units_on = units
        if units and self._coming is not None:
            self._coming.succeed()
            self._coming = None

    def _start(self) -> Generator[simpy.Event, Any, None]:
        board = self.board
        for component in self.lacking:
            if not component.units_on:
                yield component.when_on()
        if self.info.startup_s > 0.0 and self.wanted:
            board.recorder.component(self.index, 0, self.wanted)
            yield board.env.timeout(self.info.startup_s)
        self.busy = False
        self._set(self.wanted)


class Switchboard:
    """All components of a robot and who needs them.

    Parameters
    ----------
    env : simpy.Environment
    recorder : Recorder
    infos : iterable of ComponentInfo
    """

    def __init__(self, env: simpy.Environment, recorder: Recorder, infos: Iterable[ComponentInfo]) -> None:
        self.env = env
        self.recorder = recorder
        self._infos = {info.name: info for info in infos}
        self.components = {info.name: Component(self, info, index) for index, info in enumerate(self._infos.values())}
        self._held: dict[Any, Mapping[str, int]] = {}
        self._closures: dict[tuple[tuple[str, int], ...], dict[str, int]] = {}
        self._asked: dict[str, Component] = {}
        always = {info.name: info.units for info in self._infos.values() if info.always_on}
        if always:
            self.hold("always on", tuple(always.items()))

    def closure(self, sensors: tuple[tuple[str, int], ...]) -> dict[str, int]:
        """Components with everything that they require; see `closure`."""
        known = self._closures.get(sensors)
        if known is None:
            known = self._closures[sensors] = closure(self._infos, sensors)
        return known

    def hold(self, holder: Any, sensors: tuple[tuple[str, int], ...]) -> None:
        """From now on `holder` needs exactly these components (and what they require); () releases all."""
        wanted = self.closure(sensors)
        before = self._held.get(holder, {})
        if wanted is before:
            return
        self._held[holder] = wanted
        for name in before.keys() | wanted.keys():
            component = self.components[name]
            units = wanted.get(name, 0)
            if units:
                component.needs[holder] = units
            else:
                component.needs.pop(holder, None)
            if component.busy or component.wanted == component.units_on:
                continue
            if not self._asked:
                self._switch_late()
            self._asked[name] = component

    def _switch_late(self) -> None:
        """Switch what is asked for by then after all other events of this instant."""
        late = simpy.Event(self.env)
        late._ok, late._value = True, None
        late.callbacks.append(self._switch)
        self.env.schedule(late, priority=LATE)

    def _switch(self, _: simpy.Event) -> None:
        asked, self._asked = sorted(self._asked.values(), key=lambda component: component.index), {}
        for component in asked:
            if not component.lacking:
                component.switch()
        for component in asked:  # what they require has come on meanwhile, or takes its time
            component.switch()

    def waiting_for(self, sensors: tuple[tuple[str, int], ...]) -> list[simpy.Event]:
        """Events of those components, required ones included, that take time to come on; empty where none."""
        closure = self.closure(sensors)
        off = [self.components[name] for name in closure if not self.components[name].units_on]
        return [component.when_on() for component in off] if any(c.info.startup_s > 0.0 for c in off) else []
