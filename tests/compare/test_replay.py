"""Replay: the log drives the model, block by block or at once, and what is missing is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missionsim.effects.library import get_effect
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.errors import InputError
from missionsim.runs.drive import assume, drive_blocks
from tests.compare.worlds import cut, drive, friction_model, log_of, true_power


def with_effect(model: PowerModel, name: str, **values: float) -> PowerModel:
    term = Term(
        TermKey("robot", name, name), get_effect(name), {k: ModelParameter(v) for k, v in values.items()}, base=False
    )
    return replace(model, terms=(*model.terms, term))


def replayed(model: PowerModel, log: object, size: int = 0) -> np.ndarray:  # type: ignore[type-arg]
    plan = assume(model, log.columns, log.batteries)  # type: ignore[attr-defined]
    blocks = cut(log, size) if size else [log]  # type: ignore[arg-type,list-item]
    return np.concatenate([block.model_w["robot"] for block in drive_blocks(plan, blocks)])


def test_replay_is_the_physics_written_out_again() -> None:
    columns = drive()
    model_w = replayed(friction_model(), log_of(columns, true_power(columns)))
    assert model_w == pytest.approx(true_power(columns), rel=1e-12)


@pytest.mark.parametrize("size", [pytest.param(1, marks=pytest.mark.long), 7, 64, 599])
@pytest.mark.parametrize(
    "effect",
    [
        ("cold_friction", {"k": 5.0, "tau": 60.0}),
        ("component_warmup:kinect", {"k": 2.0, "tau": 30.0}),
        ("start_surge", {"E": 12.0}),
        ("acceleration", {"k": 1.0}),
    ],
)
def test_blocks_carry_the_memory_of_the_model(size: int, effect: tuple[str, dict[str, float]]) -> None:
    columns = drive(rows=600)
    log = log_of(columns, true_power(columns))
    model = with_effect(friction_model(), effect[0], **effect[1])
    whole = replayed(model, log)
    assert np.ptp(whole - replayed(friction_model(), log)) > 0.1
    assert replayed(model, log, size) == pytest.approx(whole, rel=1e-9, abs=1e-9)


def test_a_slow_meter_is_compared_with_the_mean_of_the_rows_it_measured() -> None:
    columns = drive(rows=400)
    model = true_power(columns)
    fresh = np.zeros(400, dtype=bool)
    fresh[9::10] = True
    readings = model.reshape(40, 10).mean(axis=1)
    # the meter shows the mean of the ten rows that end with its refresh, and holds it for the nine rows after
    held = np.concatenate([np.full(9, readings[0]), np.repeat(readings, 10)])[:400]
    log = log_of(columns, held, fresh=fresh)
    plan = assume(friction_model(), log.columns, log.batteries)
    (block,) = drive_blocks(plan, [log])
    assert block.model_w["robot"] == pytest.approx(block.measured_w["robot"], rel=1e-12)


def test_missing_columns_with_a_plain_meaning_are_filled_and_said() -> None:
    columns = drive()
    for name in ("slope_rad", "yaw_rate_rad_s", "on_kinect"):
        del columns[name]
    log = log_of(columns, np.full(600, 5.0))
    model = with_effect(with_effect(friction_model(), "grade", k=1.0), "turning_scrub", k=2.0)
    plan = assume(model, log.columns, log.batteries)
    assert set(plan.notes) == {
        "no column on_kinect: kinect counts as switched off",
        "no column slope_rad: the ground is level",
        "no column yaw_rate_rad_s: the robot drives straight",
    }
    (block,) = drive_blocks(plan, [log])
    assert block.assumed == {"slope_rad", "yaw_rate_rad_s"}
    v = columns["speed_m_s"]
    assert block.model_w["robot"] == pytest.approx(6.25 * v**2 + 9.79 * v + np.where(v > 0, 3.66, 2.67))


def test_an_added_effect_without_its_column_is_left_out_and_said() -> None:
    columns = drive()
    log = log_of(columns, true_power(columns))
    plan = assume(with_effect(friction_model(), "cpu_load", k=3.0), log.columns, log.batteries)
    assert plan.notes == ("robot: the effect cpu_load is left out: the log has no cpu_load",)
    (block,) = drive_blocks(plan, [log])
    assert block.model_w["robot"] == pytest.approx(true_power(columns))


def test_a_base_model_without_its_column_is_a_fault_that_names_it() -> None:
    columns = drive()
    del columns["speed_m_s"]
    log = log_of(columns, np.full(600, 5.0))
    with pytest.raises(InputError, match=r"battery 'robot' is skipped: its motors .* needs the column speed_m_s"):
        assume(friction_model(), log.columns, log.batteries, source="run.csv")


def test_a_battery_that_the_robot_lacks_is_a_fault() -> None:
    with pytest.raises(InputError, match="battery 'main' was measured but the robot has none of that name"):
        assume(friction_model(), ["time_s", "speed_m_s"], ["main"])
