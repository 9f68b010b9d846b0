"""Whether a mission can be evaluated as arrays, and if so, compiled for it; checked against SimPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.simulate import RunSetup, simulate, split_values
from missionsim.errors import MissionsimError
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.build import make_plan
from missionsim.plan.legs import Plan
from missionsim.uncertainty.arrays import AGREEMENT, ArrayMission
from missionsim.uncertainty.draws import Sampler
from missionsim.uncertainty.entries import Entries, Interval, numbers_of_plan, running_sum
from missionsim.uncertainty.probe import Dependence, probe
from missionsim.uncertainty.single import left_to_chance
from missionsim.uncertainty.ways import drawn_edges

Array = NDArray[np.float64]
_CHECK_PROBABILITIES = (0.5, 0.002, 0.998, 0.25, 0.75)
_CHECK_DRAWS, _TRIED = 3, 256


def compile_arrays(mission: MissionSpec, model: PowerModel, sampler: Sampler) -> ArrayMission | str:
    """Compile a mission for evaluation as arrays.

    Parameters
    ----------
    mission : MissionSpec
    model : PowerModel
    sampler : Sampler

    Returns
    -------
    ArrayMission or str
        The compiled mission, or in words why its runs need SimPy.
    """
    nominal = {value.name: value.nominal for value in sampler.values}
    try:
        plan = make_plan(mission)
        setup = RunSetup(mission, plan, model, {}, {})
        world = setup.execute(())
        whole = simulate(mission, plan=plan, model=model)
    except MissionsimError as error:
        return f"the nominal mission fails: {error}"
    reason = _obstacle(mission, plan, setup, whole)
    if reason:
        return reason
    shape = _shape(plan)

    def numbers_of(values: Mapping[str, float]) -> Array:
        numbers, drawn = split_values(values, model)
        varied = make_plan(mission, numbers)
        if _shape(varied) != shape:
            raise ValueError("an uncertain value changes what the plan consists of")
        return numbers_of_plan(varied, RunSetup(mission, varied, model, numbers, drawn))

    checks = [
        {
            name: float(values[0])
            for name, values in sampler.at({value.name: np.array([p]) for value in sampler.values}).items()
        }
        for p in _CHECK_PROBABILITIES
    ]
    edges = drawn_edges(mission, plan, frozenset(nominal))
    drawn = sampler.draw(0, 0, _CHECK_DRAWS)
    checks += [{name: float(values[i]) for name, values in drawn.items()} for i in range(_CHECK_DRAWS)]
    if edges is not None:  # draws by which the robot goes another way are SimPy's
        numbers = {name: np.array([check[name] for check in checks]) for name in nominal}
        elsewhere = edges.others_shorter(numbers, len(checks))
        checks = [check for check, away in zip(checks, elsewhere, strict=True) if not away]
    found = probe(numbers_of, nominal, checks)
    if isinstance(found, str):
        return found
    made = _assemble(mission, model, sampler, plan, found, world)
    if isinstance(made, str):
        return made
    made = replace(made, edges=edges)
    _, again = made.evaluate(sampler.draw(0, 0, _TRIED), _TRIED)
    if again.mean() > 0.5:
        return (
            f"in {100 * again.mean():.0f} % of its runs a battery comes to a threshold, another way is shorter or a "
            "power has a kink inside an interval"
        )
    return _disagreement(made, checks) or made


def _shape(plan: Plan) -> list[Any]:
    """What of a plan must not follow from uncertain values: all but its numbers."""
    return [
        (
            leg.kind,
            leg.instant,
            leg.direction_rad,
            leg.settings._replace(
                payload_kg=0.0,
                slope_rad=0.0,
                extra=tuple((name, value if isinstance(value, str) else 0.0) for name, value in leg.settings.extra),
            ),
        )
        for leg in plan.legs
    ]


def _obstacle(mission: MissionSpec, plan: Plan, setup: RunSetup, whole: Any) -> str:
    if plan.activities:
        return "activities overlap with the segments, so that events may change their order"
    if any(leg.recharge is not None for leg in plan.legs):
        return "it recharges"
    chance = left_to_chance(mission)
    if chance:
        return f"chance decides in each run: {', '.join(name.removeprefix('chance.') for name in chance)}"
    if any(not isinstance(battery, ConstantEnergy) for battery in setup.batteries.values()):
        return "a battery is no constant store of energy"
    if any(component.startup_s for component in setup.components):
        return "components take time to start"
    if not whole.completed:
        return "the nominal mission does not end"
    if any(b.home_wh for b in whole.batteries.values()):
        return "it ends away from its dock, so that each run has a way home of its own"
    return ""


def _assemble(
    mission: MissionSpec, model: PowerModel, sampler: Sampler, plan: Plan, dependence: Dependence, world: Any
) -> ArrayMission | str:
    spans, intervals, low = [], [], 0
    was_moving = False
    for step in plan.steps:
        high = 1 + max((phase.leg for phase in step.phases), default=low)
        leg = plan.legs[low]
        moves = leg.kind in ("roll", "slide", "turn")
        limit = plan.limits.yaw_accel_rad_s2 if leg.kind == "turn" else plan.limits.accel_m_s2
        instant = leg.instant or limit is None
        spans.append((low, high, instant))
        for i in range(low, high):
            for phase in (0, 1, 2) if moves and not instant else (1,):
                intervals.append(Interval(i, phase, moves, moves and not was_moving))
                was_moving = moves
        low = high
    if low != len(plan.legs):
        return "the steps of the plan do not cover its legs"
    batch = world.meter.batches
    if len(batch) != 1:
        return "the nominal run is not evaluated in one piece"
    line = batch[0].timeline
    # without activities, an interval ends where a phase ends
    phase_legs = [phase.leg for step in plan.steps for phase in step.phases if phase.duration_s > 0.0]
    if len(phase_legs) != len(line):
        return "components switch within a leg"
    states: dict[int, int] = {}
    for i, leg_index in enumerate(phase_legs):
        states.setdefault(leg_index, i)
    missing = [interval.leg for interval in intervals if interval.leg not in states]
    if missing:
        return "a leg takes no time at the nominal values"
    pick = np.array([states[interval.leg] for interval in intervals])
    skip = {
        "speed_m_s",
        "accel_m_s2",
        "lateral_speed_m_s",
        "lateral_accel_m_s2",
        "yaw_rate_rad_s",
        "moving",
        "moving_time_s",
        "starts",
        "slope_rad",
        "payload_kg",
        "time_s",
    }
    columns: dict[str, Any] = {
        name: value[pick] if hasattr(value, "codes") else np.asarray(value)[pick]
        for name, value in line.columns.items()
        if name not in skip and not name.startswith("on_time_")
    }
    columns["moving"] = np.array([float(interval.moving) for interval in intervals])
    columns["starts"] = np.array([float(interval.begins) for interval in intervals])
    switched = {}
    for name in [n[8:-2] for n in line.columns if n.startswith("on_time_")]:
        if f"on_time_{name}_s" in model.memory:
            units = columns[f"on_{name}"] > 0
            began, current = np.full(len(intervals), -1), -1
            for j, on in enumerate(units):
                current = (j if current < 0 else current) if on else -1
                began[j] = current
            switched[name] = began
    made = ArrayMission(
        mission, model, sampler, plan, dependence, tuple(spans), tuple(intervals), columns, switched, model, {}
    )
    return _without_fixed_terms(made)


def _without_fixed_terms(made: ArrayMission) -> ArrayMission:
    """Evaluate the terms that no draw changes, once and for all.

    Two runs with values of their own are evaluated: what follows from a draw, has two rows then. A term with zero as
    its undrawn coefficient is nought whatever else it depends on.
    """
    draws = made.sampler.at({value.name: np.array([0.3, 0.7]) for value in made.sampler.values})
    entries = Entries(made.plan, made.dependence, made.dependence.changes(draws, 2))
    motion = made.motion(entries, 2)
    cov, _ = made.covariates(entries, motion, running_sum(motion.duration_s.T))
    values = made.values(draws)
    powers = made.model.evaluate(cov, values)
    fixed: dict[tuple[str, str], Array] = {}
    kept = []
    for battery, watts in powers.items():
        terms = made.model.of(battery)
        whole = any(term.effect.of_load for term in terms)
        changing = {term.key for term in terms if np.ndim(watts[term.key]) == 2 and len(watts[term.key]) > 1}
        nought = {
            term.key
            for term in terms
            if [parameter.value for parameter in term.parameters.values()] == [0.0]
            and f"{battery}/{term.name_of(next(iter(term.parameters)))}" not in values
            and not np.any(watts[term.key])
        }
        relieved = any(term.effect.recovers and term.key in changing - nought for term in terms)
        for term in terms:
            together = relieved and (term.effect.drive or term.effect.recovers) and term.key not in nought
            if whole or term.key in changing - nought or together:
                kept.append(term)
            elif term.key not in nought:
                place = (battery, term.key.component)
                row = np.broadcast_to(np.asarray(watts[term.key], dtype=float), (1, len(made.intervals)))[0]
                fixed[place] = fixed.get(place, np.zeros(len(made.intervals))) + row
    return replace(made, varying=replace(made.model, terms=tuple(kept)), fixed=fixed)


def _disagreement(made: ArrayMission, checks: list[dict[str, float]]) -> str:
    """Why the arrays are not to be trusted: the largest difference to SimPy on the checked draws; empty if none."""
    draws = {name: np.array([check[name] for check in checks]) for name in (checks[0] if checks else {})}
    columns, again = made.evaluate(draws, len(checks))
    for i, check in enumerate(checks):
        if again[i]:
            continue
        try:
            result = simulate(made.mission, values=check, model=made.model)
        except MissionsimError as error:
            return f"a drawn mission fails: {error}"
        for name, battery in result.batteries.items():
            ours = float(columns[f"energy_{name}_wh"][i])
            if abs(ours - battery.energy_wh) > AGREEMENT * max(abs(battery.energy_wh), 1e-12):
                return (
                    f"arrays and SimPy differ by {abs(ours / battery.energy_wh - 1):.1e} on battery '{name}' "
                    "(a term has a kink or fades inside an interval)"
                )
        if bool(columns["feasible"][i]) != result.feasible:
            return "arrays and SimPy do not agree on what is feasible"
    return ""
