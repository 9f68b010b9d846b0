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


class Late(simpy.Event):
    """An event that takes place after all other events of its instant."""

    def trigger_late(self) -> None:
        """Schedule it now, once."""
        if self._value is simpy.events.PENDING:
            self._ok = True
            self._value = None
            self.env.schedule(self, priority=LATE)


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
        self.wake = Late(board.env)
        self._coming: simpy.Event | None = None
        self.process = board.env.process(self._run())

    @property
    def wanted(self) -> int:
        """Units that the most demanding of those who need it asks for."""
        return max(self.needs.values(), default=0)

    def when_on(self) -> simpy.Event:
        """An event that happens when it is on; only for one that is off."""
        if self._coming is None:
            self._coming = self.board.env.event()
        return self._coming

    def _run(self) -> Generator[simpy.Event, Any, None]:
        board, env, recorder = self.board, self.board.env, self.board.recorder
        while True:
            yield self.wake
            self.wake = Late(env)
            wanted = self.wanted
            if wanted and not self.units_on:
                for name in self.info.requires:
                    if not board.components[name].units_on:
                        yield board.components[name].when_on()
                if self.info.startup_s > 0.0 and self.wanted:
                    recorder.component(self.index, 0, self.wanted)
                    yield env.timeout(self.info.startup_s)
                wanted = self.wanted
            if wanted != self.units_on or self.info.startup_s > 0.0:
                recorder.component(self.index, wanted, 0)
            self.units_on = wanted
            if wanted and self._coming is not None:
                self._coming.succeed()
                self._coming = None


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
        self.components: dict[str, Component] = {}
        for index, info in enumerate(self._infos.values()):
            self.components[info.name] = Component(self, info, index)
        self._held: dict[Any, Mapping[str, int]] = {}
        self._closures: dict[tuple[tuple[str, int], ...], dict[str, int]] = {}
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
            if component.wanted != component.units_on:
                component.wake.trigger_late()

    def waiting_for(self, sensors: tuple[tuple[str, int], ...]) -> list[simpy.Event]:
        """Events of those components, required ones included, that take time to come on; empty where none."""
        closure = self.closure(sensors)
        off = [self.components[name] for name in closure if not self.components[name].units_on]
        return [component.when_on() for component in off] if any(c.info.startup_s > 0.0 for c in off) else []
