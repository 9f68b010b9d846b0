"""Runs that differ by a drift in their order, and by what was loaded more with every trip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missionsim.identify.data import RunData
from missionsim.identify.identification import Identification, identify
from missionsim.identify.simpler import drifts_as_well

from .world import library, make_runs

COUNT = 18


def loaded(kilograms: list[float], drift_n: float, each_n: float = 0.0) -> list[RunData]:
    """Runs of a robot whose friction grows by so many newtons over the day, and by so many with each kilogram."""
    runs = []
    for run, kg, order in zip(make_runs(3, count=COUNT), kilograms, np.linspace(0.0, 1.0, COUNT), strict=True):
        speed = run.columns["rolling_friction"]
        runs.append(
            replace(
                run,
                measured_w=run.measured_w + (drift_n * order + each_n * kg) * speed,
                columns=run.columns | {"payload": kg * speed},
                covariates=run.covariates | {"payload_kg": np.full(len(speed), kg)},
            )
        )
    return runs


MORE_EACH_TIME = [2.0 * (j // (COUNT // 3)) for j in range(COUNT)]
IN_TURN = [2.0 * (j % 3) for j in range(COUNT)]


def diagnosed(runs: list[RunData]) -> Identification:
    return identify(runs, library(), {})


@pytest.fixture(scope="module")
def drifted() -> Identification:
    """Friction that grew by 4 N over the day, while more was loaded each time."""
    return diagnosed(loaded(MORE_EACH_TIME, 4.0))


def test_a_drift_over_the_day_is_not_called_the_load_that_grew_with_it(drifted: Identification) -> None:
    found = drifted
    assert not found.effects
    assert found.verdict == "unexplained_structure"
    assert "either payload, or a steady drift from run to run in their order" in found.unexplained.shape


@pytest.mark.parametrize(
    ("kilograms", "drift_n"),
    [
        pytest.param(MORE_EACH_TIME, 0.0, marks=pytest.mark.long),
        pytest.param(IN_TURN, 0.0, marks=pytest.mark.long),
        (IN_TURN, 0.5),
    ],
)
def test_a_load_is_named_that_a_drift_does_not_explain_as_well(kilograms: list[float], drift_n: float) -> None:
    found = diagnosed(loaded(kilograms, drift_n, each_n=1.0))
    assert [effect.effect for effect in found.effects] == ["payload"]
    assert "drift" not in found.unexplained.shape


def test_three_runs_have_no_drift_that_could_be_told_from_anything(drifted: Identification) -> None:
    model = drifted.choice.model
    payload = next(k for k, c in enumerate(model.design.layout.columns) if c.name == "payload")
    assert drifts_as_well(model.design, [payload], [])
    few = diagnosed(loaded(MORE_EACH_TIME, 4.0)[::6]).choice.model
    assert not drifts_as_well(few.design, [payload], [])


def test_times_of_the_logs_give_the_order_whatever_their_names_are(drifted: Identification) -> None:
    model = drifted.choice.model
    payload = next(k for k, c in enumerate(model.design.layout.columns) if c.name == "payload")
    hidden = replace(model.design, names=tuple("abcdefghijklmnopqr"))
    assert not drifts_as_well(hidden, [payload], [])
    assert drifts_as_well(replace(hidden, begins_s=tuple(1.7e9 + 3600.0 * j for j in range(COUNT))), [payload], [])
    turned = tuple(1.7e9 + 3600.0 * (7 * j % COUNT) for j in range(COUNT))
    assert not drifts_as_well(replace(model.design, begins_s=turned), [payload], [])
    # clocks that begin anew with each start of the robot tell no order
    assert not drifts_as_well(replace(hidden, begins_s=tuple(1.5e9 + j for j in range(COUNT))), [payload], [])


@pytest.mark.long
def test_names_that_begin_with_what_was_loaded_tell_no_order_of_the_day(drifted: Identification) -> None:
    """Sorted by name, the heavy runs stand before the light ones whenever they were driven."""
    model = drifted.choice.model
    payload = next(k for k, c in enumerate(model.design.layout.columns) if c.name == "payload")
    names = tuple(f"{load}_{j}" for load in ("none", "some", "very") for j in range(COUNT // 3))
    assert not drifts_as_well(replace(model.design, names=names), [payload], [])
    pairs = diagnosed(loaded([0.0, 4.0] * (COUNT // 2), 0.0, each_n=0.5)).choice.model
    names = tuple(f"{'abcdefghi'[j // 2]}_{j}" for j in range(COUNT))
    assert not drifts_as_well(replace(pairs.design, names=names), [payload], [])  # a difference of two is no drift
