"""What legs cost: the energy of many phases of motion and standing at once, by the product's own power model."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np

from missionsim.effects.timeline import integrate
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.outcome import J_PER_WH
from missionsim.engine.recorder import Row, timeline
from missionsim.engine.simulate import RunSetup
from missionsim.inputs.mission import MissionBehaviour, MissionSpec, PolicySpec
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.power import build_power_model
from missionsim.inputs.segments import WaitSegment
from missionsim.inputs.task import TaskSpec
from missionsim.physics import Array
from missionsim.plan.build import make_plan
from missionsim.plan.legs import LONG_AGO_S, Leg, Phase, Settings, units_on


class Physics:
    """The power model of a task's robot, for arrays of phases. Terms that fade with the time moved or switched on are
    taken as faded while searching; the mission that comes out is simulated with them.

    `names`: batteries, in the order of all arrays; `limits`: accelerations of the body; `capacity_wh`, `initial_wh`,
    `reserve_wh`, `held_wh` (what is never to be used, not on the way to a dock either): shape (batteries,).
    """

    def __init__(self, task: TaskSpec) -> None:
        self.task = task
        wait = WaitSegment.model_construct(kind="wait", duration=Parameter(0.0, unit="s"))
        docks = task.goal in task.environment.places
        self.mission = MissionSpec.model_construct(  # that does nothing yet
            kind="mission",
            name=task.name,
            robot_ref=task.robot_ref,
            start=task.start,
            start_heading=task.start_heading,
            initial_charge=task.initial_charge,
            defaults=task.defaults,
            policy=PolicySpec.model_construct(dock=task.goal) if docks else PolicySpec(),
            segments=(wait,),
            behaviour=MissionBehaviour.model_construct(),
        )
        vars(self.mission).update(robot=task.robot, environment=task.environment, document=task.document)
        self.model = build_power_model(task.robot)
        plan = make_plan(self.mission)
        self.limits = plan.limits
        self.setup = RunSetup(self.mission, plan, self.model, {}, {})
        batteries = self.setup.batteries
        self.names = tuple(batteries)
        self.capacity_wh = np.array([battery.capacity_j for battery in batteries.values()]) / J_PER_WH
        self.initial_wh = np.array([float(one.charge_j(one.initial)) for one in batteries.values()]) / J_PER_WH
        kept = [battery.charge_j(battery.full * task.reserve_of(name)) for name, battery in batteries.items()]
        self.reserve_wh = np.array([float(joules) for joules in kept]) / J_PER_WH
        self.held_wh = np.zeros(len(self.names))
        self._infos = {info.name: info for info in self.setup.components}
        self._settings: dict[Settings, int] = {}
        self.pieces: dict[float, dict[str, list[Any]]] = {}
        """Of each payload, what may be driven from each place (`pieces_of`)."""
        self.impulsive = any(term.effect.impulse is not None for term in self.model.terms)
        self.fades = bool(self.model.memory)
        self.circuits = [name for name, battery in batteries.items() if not isinstance(battery, ConstantEnergy)]
        self.slow = any(info.startup_s > 0.0 for info in self._infos.values())

    def settings_index(self, settings: Settings) -> int:
        """Number of settings, for `energy_wh`."""
        return self._settings.setdefault(settings, len(self._settings))

    def energy_wh(
        self, settings: Array, duration_s: Array, speed_m_s: Array, accel_m_s2: Array, starts: Array
    ) -> Array:
        """Energy that each battery delivers in each of many phases.

        `settings` (shape (n,)): from `settings_index`. `duration_s`, `speed_m_s`, `accel_m_s2` (shape (n,)): length,
        speed at the start and acceleration of each phase; speed and acceleration 0 is standing. `starts` (shape (n,)):
        whether the robot stood before. Gives an array of shape (n, batteries) [Wh].
        """
        keys = np.stack([settings, duration_s, speed_m_s, accel_m_s2, starts], axis=1).astype(float)
        steady = (keys[:, 3] == 0.0) & (keys[:, 4] == 0.0) & (not self.fades)
        scale = np.where(steady, keys[:, 1], 1.0)
        keys[steady, 1] = 1.0  # constant power: computed for a second, whatever it lasts
        unique, inverse = np.unique(keys, axis=0, return_inverse=True)
        names, ago = list(self._infos), LONG_AGO_S if self.fades else 0.0
        states: dict[tuple[float, ...], int] = {}  # units on, units starting, time of switching on, of each component
        state_of = []
        for each in self._settings:
            on = units_on(self._infos, each.sensors)
            state = (*on, *(0.0 for _ in names), *(-ago for _ in names))
            state_of.append(states.setdefault(state, len(states)))
        rows = []
        for number, duration, speed, accel, begins in unique.tolist():
            which = int(number)
            phase = Phase(duration, which, speed, accel, moving=speed != 0.0 or accel != 0.0)
            rows.append(Row(0.0, duration, which, phase, 0.0, state_of[which], ago, bool(begins), ()))
        total = np.zeros((len(rows), len(self.names)))
        if rows:
            legs = [Leg("roll", each) for each in self._settings]
            line = timeline([(rows, legs, list(states))], names, self.model.needs)
            for b, terms in enumerate(integrate(self.model, line).values()):
                for joules in terms.values():
                    total[:, b] += joules
        return (total / J_PER_WH)[np.ravel(inverse)] * scale[:, None]

    def standing_wh(self, settings: Settings, duration_s: float) -> Array:
        """Energy of standing, shape (batteries,), Wh."""
        zero = np.zeros(1)
        number = np.array([self.settings_index(settings)])
        return np.asarray(self.energy_wh(number, np.array([duration_s]), zero, zero, zero)[0])

    def but(self, **charges: Array) -> Physics:
        """The same with other charges, `capacity_wh`, `initial_wh`, `reserve_wh` or `held_wh`: shape (batteries,)."""
        other = copy(self)
        vars(other).update(charges)
        return other

    def by_name(self, values: Array) -> dict[str, float]:
        """Numbers of the batteries, shape (batteries,), by their names."""
        return dict(zip(self.names, values.tolist(), strict=True))
