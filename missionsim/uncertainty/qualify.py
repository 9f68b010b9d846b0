"""Whether a mission can be evaluated as arrays, and what of it no draw changes."""

from __future__ import annotations

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import ConstantEnergy
from missionsim.engine.simulate import RunSetup, simulate
from missionsim.errors import MissionsimError
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.build import make_plan
from missionsim.plan.legs import Plan
from missionsim.uncertainty.arrays import AGREEMENT, ArrayMission
from missionsim.uncertainty.draws import Sampler
from missionsim.uncertainty.intervals import parts_of
from missionsim.uncertainty.single import left_to_chance

_CHECK_PROBABILITIES = (0.5, 0.002, 0.998, 0.25, 0.75)
_CHECK_DRAWS, _TRIED = 3, 256
_MOST_AGAIN = 0.9
"""Share of the runs that go back to SimPy up to which arrays are worth their while for the others."""


def compile_arrays(mission: MissionSpec, model: PowerModel, sampler: Sampler) -> ArrayMission | str:
    """Compile a mission for evaluation as arrays. Gives the compiled mission, or in words why its runs need SimPy."""
    try:
        plan = make_plan(mission)
        reason = _obstacle(mission, model, plan)
        parts = reason or parts_of(RunSetup(mission, plan, model, {}, {}))
    except MissionsimError as error:
        parts = f"the nominal mission fails: {error}"
    if isinstance(parts, str):
        return parts
    made = ArrayMission(mission, model, sampler, plan, parts)
    _, again = made.evaluate(sampler.draw(0, 0, _TRIED), _TRIED)
    if again.mean() > _MOST_AGAIN:
        return (
            f"in {100 * again.mean():.0f} % of its runs a battery comes to a threshold, another way is shorter, or a "
            "value changes what the plan consists of"
        )
    return _disagreement(made) or made


def _obstacle(mission: MissionSpec, model: PowerModel, plan: Plan) -> str:
    if plan.activities:
        return "activities overlap with the segments, so that events may change their order"
    if mission.policy.on_empty == "recharge_and_continue":
        return "it recharges when a battery comes to its reserve"
    charges = [leg.recharge for leg in plan.legs if leg.recharge is not None]
    if any(charge.duration_s is None or np.isfinite(charge.if_below) for charge in charges):
        return "how long it recharges depends on the charge"
    if charges and (model.memory or model.lags or "time_s" in model.needs):
        return "it recharges, and powers change with time"
    if plan.gated:
        return "a block is repeated until a time"
    chance = left_to_chance(mission)
    if chance:
        return f"chance decides in each run: {', '.join(name.removeprefix('chance.') for name in chance)}"
    setup = RunSetup(mission, plan, model, {}, {})
    if any(not isinstance(battery, ConstantEnergy) for battery in setup.batteries.values()):
        return "a battery is no constant store of energy"
    whole = simulate(mission, plan=plan, model=model)
    if not whole.completed:
        return "the nominal mission does not end"
    if any(b.home_wh for b in whole.batteries.values()):
        return "it ends away from its dock, so that each run has a way home of its own"
    return ""


def _disagreement(made: ArrayMission) -> str:
    """Why the arrays are not to be trusted: the largest difference to SimPy on some draws; empty if none."""
    values, sampler = made.sampler.values, made.sampler
    few = sampler.draw(0, 0, _CHECK_DRAWS)
    at = sampler.at({value.name: np.array(_CHECK_PROBABILITIES) for value in values})
    draws = {name: np.concatenate([at[name], few[name]]) for name in few}
    count = len(_CHECK_PROBABILITIES) + _CHECK_DRAWS
    columns, again = made.evaluate(draws, count)
    for i in range(count):
        if again[i]:
            continue
        try:
            result = simulate(made.mission, values={n: float(v[i]) for n, v in draws.items()}, model=made.model)
        except MissionsimError as error:
            return f"a drawn mission fails: {error}"
        for name, battery in result.batteries.items():
            ours = float(columns[f"energy_{name}_wh"][i])
            if not abs(ours - battery.energy_wh) <= AGREEMENT * max(abs(battery.energy_wh), 1e-12):
                return f"arrays and SimPy differ by {abs(ours / battery.energy_wh - 1):.1e} on battery '{name}'"
            off = abs(float(columns[f"charge_left_{name}_wh"][i]) - battery.charge_left_wh)
            if not off <= AGREEMENT * battery.capacity_wh:
                return f"arrays and SimPy differ by {off:.1e} Wh in what is left in battery '{name}'"
        if bool(columns["feasible"][i]) != result.feasible:
            return "arrays and SimPy do not agree on what is feasible"
    return ""
