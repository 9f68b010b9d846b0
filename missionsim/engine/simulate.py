"""Simulate a mission: execute its plan, find the instants at which a battery interrupts it, and book every joule."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from typing import cast

import numpy as np

from missionsim.effects.model import PowerModel, TermKey
from missionsim.engine.batteries import CHARGE_TOLERANCE, Battery, ConstantEnergy, greatest_fall
from missionsim.engine.components import ComponentInfo
from missionsim.engine.meter import Batch, Evaluating, alone
from missionsim.engine.outcome import J_PER_WH, Alarm, BatteryResult, DrivenEdge, RunResult, edges_driven
from missionsim.engine.reserve import Homing, home_energies
from missionsim.engine.setup import build_battery, check_covariates, doubts, split_values
from missionsim.engine.world import World
from missionsim.errors import Fault, InputError
from missionsim.inputs.mission import MissionSpec, reserve_of
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.power import build_power_model
from missionsim.inputs.robot import BatterySpec
from missionsim.inputs.segments import DockSegment, RechargeSpec
from missionsim.physics import Array
from missionsim.plan.build import legs_of, make_plan
from missionsim.plan.kinematics import group
from missionsim.plan.legs import Leg, Plan, Step
from missionsim.plan.routes import routes_of

MOST_ALARMS = 4
MOST_RECHARGES = 500
MOST_AUDIT_ERROR = 1e-9
"""Relative; rounding of a mission of 100,000 segments stays a thousand times below."""


class AuditError(Exception):
    """The energies of a run do not add up: our own fault, never the user's. `table`: energy of each term [J]."""

    def __init__(self, battery: str, error: float, batches: Sequence[Batch], table: Mapping[TermKey, Array]) -> None:
        terms = []  # whose cells in the table are not what the meter has booked
        for key, cells in table.items():
            booked = math.fsum(float(np.sum(batch.energies[battery][key])) for batch in batches)
            if abs(math.fsum(cells.tolist()) - booked) > MOST_AUDIT_ERROR * max(abs(booked), 1e-12):
                terms.append(f"{key.component}/{key.name}" if key.component != key.name else key.name)
        what = f"of {', '.join(terms)}" if terms else "left in it, against what it gave and got,"
        super().__init__(f"the energy of battery '{battery}' {what} does not add up: {error:.3g} of it (audit)")


def simulate(
    mission: MissionSpec,
    *,
    values: Mapping[str, float] | None = None,
    rng: np.random.Generator | None = None,
    trace: bool = True,
    plan: Plan | None = None,
    model: PowerModel | None = None,
) -> RunResult:
    """Simulate one mission.

    Parameters
    ----------
    mission : MissionSpec
        From `load_mission`.
    values : mapping, optional
        Numbers that differ from the files: parameters of the power model by ``battery/name`` (``robot/c3``), or any
        number by its path in the mission file, with prefix ``robot.`` or ``environment.`` in the others.
    rng : numpy.random.Generator, optional
        For what the mission itself leaves to chance (repeated inspections).
    trace : bool
        Keep the intervals; without them only totals remain.
    plan, model : optional
        Where they are known already.

    Raises
    ------
    missionsim.errors.InputError
        Where the mission cannot be simulated as asked.

    Notes
    -----
    A mission is executed first as if its batteries were bottomless. Only if one of them then comes to a threshold is
    it executed again, with an interrupt at that very instant; the first execution tells by how much the whole mission
    overdraws the battery.
    """
    if model is None:
        model = mission.remembered("power model", lambda: build_power_model(mission.robot))
    numbers, drawn = split_values(values or {}, model)
    again = copy.deepcopy(rng)
    if plan is None and not numbers and rng is None:
        plan = mission.remembered("plan", lambda: make_plan(mission))
    plan = make_plan(mission, numbers, rng) if plan is None else plan
    setup = RunSetup(mission, plan, model, numbers, drawn)
    setup.again = again
    result = alone(model, setup.names, setup.run(trace=trace))
    return result if trace else replace(result.totals(), home=result.home)


class RunSetup:
    """What all executions of one mission share."""

    def __init__(
        self,
        mission: MissionSpec,
        plan: Plan,
        model: PowerModel,
        numbers: Mapping[str, float] | Mapping[str, Array],
        drawn: Mapping[str, float],
    ) -> None:
        self.mission = mission
        self.plan = plan
        self.model = model
        self.drawn = drawn
        self.numbers = cast("Mapping[str, float]", numbers)  # of many runs, arrays: see missionsim.plan.legs
        self.again: np.random.Generator | None = None
        self.names = tuple(mission.robot.components)
        self.goes_on = mission.policy.on_empty == "recharge_and_continue"
        """Whether the robot recharges at its reserve and goes on."""
        self.batteries: dict[str, Battery] = {}
        self.required: dict[str, float] = {}
        """Reserve of each battery that is to be left, as a fraction."""

        def number(parameter: Parameter, prefix: str = "robot.") -> float:
            return self.numbers.get(prefix + parameter.path, parameter.value) if self.numbers else parameter.value

        for name, spec in mission.robot.batteries.items():
            charge, reserve = mission.initial_charge.get(name), reserve_of(mission.policy.reserve, name)
            initial = number(spec.initial_charge) if charge is None else number(charge, "")
            self.batteries[name] = build_battery(name, spec, number, initial, self._temperature(name, spec))
            self.required[name] = number(spec.reserve) if reserve is None else number(reserve, "")
        self.components = []
        for name, one in mission.robot.components.items():
            startup_s = 0.0 if one.startup is None else number(one.startup.duration)
            self.components.append(ComponentInfo(name, one.units, one.always_on, one.requires, startup_s))

    def _temperature(self, name: str, spec: BatterySpec) -> float | None:
        """Ambient temperature where the mission begins, for batteries that depend on it."""
        if spec.over_temperature is None:
            return None
        known = dict(self.plan.legs[0].settings.extra).get("temp_ambient_c") if self.plan.legs else None
        if known is None:
            document = self.mission.robot.document
            allowed = (
                "defaults: {temperature: 5 degC} in the mission, or ambient: {temperature: 5 degC} in its environment"
            )
            where = ("batteries", name, "over_temperature")
            told = f"battery '{name}' depends on the temperature, and mission '{self.mission.name}' does not say it"
            raise InputError(document.fault(where, told, allowed=allowed, key=True))
        return cast("float", known)

    @cached_property
    def homing(self) -> Homing:
        """Ways to the dock."""
        routes, limits = routes_of(self.mission, self.numbers), self.plan.limits
        made = self.mission.remembered("homing", lambda: Homing(self.mission, limits, routes))
        same = made.routes is routes and made.limits == limits
        return made if same else Homing(self.mission, limits, routes)

    def run(self, *, trace: bool = True) -> Evaluating[RunResult]:
        """All executions that the mission needs, and its result; with `trace`, what is strange about it too."""
        whole, world, alarms = yield from self._executions()
        if self.plan.gated:  # what was not driven is no part of the result
            self.plan = make_plan(self.mission, self.numbers, self.again, world.rounds)
            whole, world, alarms = yield from self._executions()
        return (yield from self.result(world, whole, alarms, trace))

    def _executions(self) -> Evaluating[tuple[World, World, list[Alarm]]]:
        """The execution on bottomless batteries, the one with all interrupts, and these."""
        whole = world = yield from self.execute(())
        alarms: list[Alarm] = []
        most = MOST_RECHARGES if self.goes_on else MOST_ALARMS
        reserves = {name: battery.full * self.required[name] for name, battery in self.batteries.items()}
        while len(alarms) < most:
            sends_home = self.mission.policy.on_empty != "stop" and (self.goes_on or not alarms)
            alarm = world.meter.first_alarm(reserves if sends_home else {}, world.excursions)
            if alarm is None:
                return whole, world, alarms
            alarms.append(alarm)
            world = yield from self.execute(alarms)
            if alarm.kind == "empty" or (self.goes_on and world.reason):
                return whole, world, alarms
        if self.goes_on:
            told = f"the mission goes to recharge more than {most} times"
            raise InputError.single(told, file=str(self.mission.path), allowed="a larger battery, a shorter mission")
        return whole, world, alarms

    def execute(self, alarms: Sequence[Alarm]) -> Evaluating[World]:
        """One execution with interrupts at known instants."""
        check_covariates(self.plan, self.model)
        parts = self.plan, self.model, self.batteries, self.components
        world = World(*parts, alarms=alarms, leave=self._leave, goes_on=self.goes_on, values=self.drawn)
        yield from world.run()
        return world

    def _leave(
        self, last: Leg | None, done_m: float, stands: bool, battery: str, segment: int
    ) -> tuple[list[Leg], tuple[Step, ...], bool] | None:
        """The way to a dock, booked on a segment; where the robot goes on also charging there and the way back."""
        environment, policy, like = self.mission.environment, self.mission.policy, last
        if like is None:
            like = next((leg for leg in self.plan.legs if leg.kind == "roll"), None)
        if environment is None or like is None:
            return None
        docks = self.homing.docks
        if self.goes_on:
            docks = tuple(name for name in environment.charging(battery) if policy.dock in (None, name))
        found = self.homing.excursion(last, done_m, like, docks, back=self.goes_on, stands=stands)
        if found is None:
            return None
        legs, dock, home, went_on = found
        if self.goes_on:
            until = Parameter(1.0) if policy.recharge_until is None else policy.recharge_until
            charge = DockSegment.model_construct(
                kind="dock", recharge=RechargeSpec.model_construct(until=until, batteries=())
            )
            legs += [*next(legs_of(self.mission, [(dock, charge)], self.numbers)), *home]
        legs = legs or [Leg("stand", like.settings, place=dock)]
        legs = [item._replace(segment=segment, first=False, last=False) for item in legs]
        legs[0], legs[-1] = legs[0]._replace(first=True), legs[-1]._replace(last=True)
        return legs, group(legs, self.plan.limits), went_on

    def result(self, world: World, whole: World, alarms: list[Alarm], trace: bool) -> Evaluating[RunResult]:
        """The result of the last execution."""
        line, energies, charge = world.meter.table()
        duration = float(world.env.now)
        home: dict[str, float | None] = dict.fromkeys(self.batteries)
        stranded: set[str] = set()
        driven: Callable[[], list[DrivenEdge]] | None = None
        if (site := self.mission.environment) is not None:
            driven = cache(lambda: edges_driven(site, world.recorder.rows, world.legs, line, energies, charge))
            homes, stranded = yield from home_energies(world, self.homing, self.model, self.drawn, only_last=True)
            home = homes[-1]
        results = {}
        reasons = [world.reason] if world.reason else []
        for name in self.batteries:
            results[name] = made = self._battery_result(name, world, whole, alarms, energies[name], home.get(name))
            if made.empty_at_s is None and world.completed:
                if made.charge_left_wh < made.reserve_required_wh - CHARGE_TOLERANCE * made.capacity_wh:
                    reasons.append(f"battery '{name}' ends below its reserve")
                elif name in stranded:
                    reasons.append(f"battery '{name}' cannot bring the robot home")
        mission, segments = self.mission, tuple(world.segments)
        warnings: tuple[Fault, ...] = ()
        off: tuple[str, ...] = ()
        if trace:
            places = {name: mission.robot.document.place(("batteries", name)) for name in self.batteries}
            file = str(mission.path)
            warnings = doubts(self.model, line, energies, charge, self.batteries, segments, places, file)
            on = line.columns  # none where the mission takes no time
            off = tuple(n for n in self.names if on and not (np.any(on[f"on_{n}"]) or np.any(on[f"starting_{n}"])))
        return RunResult(
            mission=mission.name,
            robot=mission.robot.name,
            feasible=world.completed and not reasons,
            completed=world.completed,
            reason="; ".join(reasons),
            duration_s=duration,
            distance_m=float(np.sum(line.ways_m())),
            timeline=line,
            energies=energies,
            charge_wh=charge,
            segments=segments,
            segment_end_s=world.ends_s,
            batteries=results,
            home=lambda: alone(self.model, self.names, home_energies(world, self.homing, self.model, self.drawn))[0],
            warnings=warnings,
            never_on=off,
            segments_driven=world.begun,
            interrupted=world.interrupted,
            dock_s=math.fsum(row.duration_s for row in world.recorder.rows if row.charging and any(row.charging)),
            driven=driven,
        )

    def _battery_result(
        self,
        name: str,
        world: World,
        whole: World,
        alarms: list[Alarm],
        terms: Mapping[TermKey, Array],
        home_wh: float | None,
    ) -> BatteryResult:
        battery, meter = self.batteries[name], world.meter
        cells = [math.fsum(joules.tolist()) for joules in terms.values()]
        used = math.fsum(cells)
        initial = float(battery.charge_j(battery.initial))
        left = float(battery.charge_j(meter.state[name]))
        loads = [batch.loads[name] for batch in meter.batches]
        charged = math.fsum(float(np.sum(load.charged_j)) for load in loads if load.charging.any())
        # the meter adds all terms interval by interval, the table all intervals term by term
        metered = sum(float(load.energy_j.cumsum()[-1]) for load in loads)
        scale = max(abs(used), abs(metered), 1e-12)
        audit = abs(used - metered) / scale
        loss = initial - left + charged - used
        if isinstance(battery, ConstantEnergy):
            audit = max(audit, abs(loss) / max(scale, abs(initial)))
            loss = 0.0
        empty = next((alarm for alarm in alarms if alarm.kind == "empty" and alarm.battery == name), None)
        if self.goes_on:  # what it would take on bottomless batteries is not what it takes
            whole = world
        course = np.concatenate([[initial], *(battery.charge_j(b.states[name]) for b in whole.meter.batches)])
        if audit > MOST_AUDIT_ERROR:
            raise AuditError(name, audit, meter.batches, terms)
        duration = float(world.env.now)
        return BatteryResult(
            name=name,
            energy_wh=used / J_PER_WH,
            mean_power_w=used / duration if duration else 0.0,
            capacity_wh=battery.capacity_j / J_PER_WH,
            initial_wh=initial / J_PER_WH,
            charged_wh=charged / J_PER_WH,
            charge_left_wh=left / J_PER_WH,
            charge_left_fraction=meter.state[name] / battery.full,
            internal_loss_wh=loss / J_PER_WH,
            reserve_required_wh=float(battery.charge_j(battery.full * self.required[name])) / J_PER_WH,
            home_wh=home_wh,
            reserve_wh=left / J_PER_WH - (home_wh or 0.0),
            empty_at_s=None if empty is None else empty.time_s,
            empty_in_segment="" if empty is None else world.segments[empty.segment].name,
            deficit_wh=max(0.0, -float(course.min())) / J_PER_WH,
            needed_wh=float(greatest_fall(course)) / J_PER_WH if whole.completed else None,
            audit_relative_error=audit,
        )
