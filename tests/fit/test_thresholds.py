"""What a fit tells, leaves out or allows for, in cases just on both sides of each number."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.fit import calibrate, final, parameters
from missionsim.fit import prepare as prepared
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.fit.parameters import FittedParameter, sd_on_other_logs
from missionsim.identify.align import Clock
from missionsim.identify.settings import Settings
from missionsim.inputs.edit import robot_text
from missionsim.inputs.loading import load_robot, robot_from_text
from missionsim.inputs.power import build_power_model
from missionsim.logs import LogTable
from tests.diagnose.logs import drawing, drive


def test_a_fit_knows_less_of_other_days() -> None:
    assert sd_on_other_logs(0.04, "fitted to 3 runs, data 0123abcd") == pytest.approx(0.05)
    assert sd_on_other_logs(0.04, "data sheet") == 0.04


@pytest.mark.parametrize(("part", "told"), [(0.009, False), (0.011, True)])
def test_a_faint_load_may_have_been_on_at_any_time(monkeypatch: pytest.MonkeyPatch, part: float, told: bool) -> None:
    log = drive(1, seconds=60.0)
    load_w = part * float(np.mean(log.power_w["robot"]))
    monkeypatch.setattr(prepared, "_switched_w", lambda *_: {"heater": load_w})
    ready = prepared.prepare(build_power_model(load_robot("pioneer3dx")), [log], "robot")
    assert any("nothing tells when heater" in remark for remark in ready.remarks) is told


@pytest.mark.parametrize(("part", "fitted"), [(0.45, False), (0.55, True)])
def test_a_model_has_a_value_in_half_of_the_rows(part: float, fitted: bool) -> None:
    x = np.where(np.arange(100) < 100 * part, 1.0, np.nan)
    run, own = SimpleNamespace(dt_s=np.ones(100)), {"c": SimpleNamespace(value=1.0)}
    ready = SimpleNamespace(gradients=[{"c": x}], base_w=[x], runs=[run], parameters=own, battery="robot")
    ready.measured_w = lambda: np.full(100, 3.0)
    model = SimpleNamespace(with_values=lambda values: values)
    if fitted:
        assert parameters._least_squares_start(model, ready) == {"robot/c": pytest.approx(3.0)}
    else:
        with pytest.raises(InputError, match="gives no number in 55%"):
            parameters._least_squares_start(model, ready)


@pytest.mark.parametrize(("watts", "fitted"), [(1e29, True), (1e31, False)])
def test_a_power_whose_square_is_no_number_is_none(watts: float, fitted: bool) -> None:
    x = np.full(100, watts)
    run, own = SimpleNamespace(dt_s=np.ones(100)), {"c": SimpleNamespace(value=1.0)}
    ready = SimpleNamespace(gradients=[{"c": x}], base_w=[x], runs=[run], parameters=own, battery="robot")
    ready.measured_w = lambda: np.full(100, 3.0)
    model = SimpleNamespace(with_values=lambda values: values)
    with nullcontext() if fitted else pytest.raises(InputError, match="in any row"):
        assert parameters._least_squares_start(model, ready)


@pytest.mark.parametrize(("apart", "told"), [(1.3e-4, {"a", "b"}), (5e-5, set())])
def test_columns_that_are_alike_but_for_a_ten_thousandth_are_not_told_apart(apart: float, told: set[str]) -> None:
    x, y = np.eye(2)
    assert parameters.told_apart(SimpleNamespace(gradients=[{"a": x, "b": x + apart * y}])) == told


@pytest.mark.parametrize(("apart", "alike"), [(3e-5, True), (1e-4, False)])
def test_of_columns_that_are_multiples_one_is_fitted(apart: float, alike: bool) -> None:
    """Their correlation is 1 − apart² / 2."""

    def log(apart: float) -> LogTable:
        one = drive(1, seconds=120.0)
        speed = one.columns["speed_m_s"]
        rest = np.random.default_rng(1).normal(size=len(speed)) * speed
        rest *= np.linalg.norm(speed) / np.linalg.norm(rest)
        return replace(one, columns={**one.columns, "reading": speed + apart * rest})

    made = calibrate_new(NewRobot("own", "k1*v + k2*reading", mass="20 kg"), [log(0.5)])
    told = parameters.fit_parameters(build_power_model(robot_from_text(made.text)), [log(apart)], "robot").remarks
    assert any("in the same way" in remark for remark in told) is alike


@pytest.mark.parametrize(("explained", "fitted"), [(-9.5, True), (-10.5, False)])
def test_a_fit_that_ran_away_is_refused(monkeypatch: pytest.MonkeyPatch, explained: float, fitted: bool) -> None:
    log, told = drive(1, seconds=60.0), SimpleNamespace(total=SimpleNamespace(seconds=60.0))
    told.power_rmse_w = float(np.std(log.power_w["robot"])) * np.sqrt(1.0 - explained)
    monkeypatch.setattr(parameters, "errors_of", lambda *_: told)
    with nullcontext() if fitted else pytest.raises(InputError, match="error far larger than the power"):
        parameters.fit_parameters(build_power_model(load_robot("pioneer3dx")), [log], "robot")


@pytest.mark.parametrize(("runs", "clusters"), [(3, {9}), (4, {4})])
def test_four_runs_are_the_sample_and_fewer_are_cut(runs: int, clusters: set[int]) -> None:
    ready = prepared.prepare(
        build_power_model(load_robot("pioneer3dx")), [drive(i, seconds=60.0) for i in range(runs)], "robot"
    )
    assert {len(np.unique(final._System.of(ready, Clock.as_logged(runs), Settings()).cluster))} == clusters


def test_a_base_parameter_keeps_a_thousandth_of_its_value() -> None:
    model = build_power_model(load_robot("pioneer3dx"))
    at_rest = model.parameters_of("robot")["standing"].value
    assert final._bounds(model, "robot")[0]["standing"] == pytest.approx(1e-3 * at_rest)


@pytest.mark.parametrize(("texts", "watched"), [(12, True), (13, False)])
def test_a_column_of_more_than_twelve_texts_is_not_watched(texts: int, watched: bool) -> None:
    floors = [f"floor {i % texts}" for i in range(60)]
    ready = prepared.prepare(
        build_power_model(load_robot("pioneer3dx")), [drive(1, seconds=60.0, surface=floors)], "robot"
    )
    assert ("surface" in ready.data()[0].covariates) is watched


@dataclass(frozen=True)
class Fit:
    parameters: Mapping[str, FittedParameter]
    model: None = None


def test_power_at_rest_is_that_of_rows_well_after_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stops of 13 s in rows of a second: high for three, then by 1 or 3 W off for ten, which count as one value."""
    second = np.arange(14, 20 * 26) % 26
    off = np.repeat(np.tile([1.0, 3.0], 10), 26)[14:]
    power = np.where(second < 13, 50.0, np.where(second < 16, 20.0, off))
    columns = {"speed_m_s": np.where(second < 13, 0.5, 0.0)}
    log = LogTable("a", columns, np.ones(len(power)), {"robot": power}, {"robot": None}, {"robot": "power"})
    nothing = SimpleNamespace(row_w=lambda _: np.zeros(len(power)))
    monkeypatch.setattr(calibrate, "drive", lambda *_: nothing)
    standing = FittedParameter("standing", "W", 7.0, 9.0, -11.0, 25.0, 7.0, True)
    rest = calibrate._with_rest(Fit({"standing": standing}), [log], "robot").parameters["standing"]
    assert rest.value == pytest.approx(9.0, abs=0.05)
    assert rest.sd == pytest.approx(1.0 / np.sqrt(19.0), rel=0.05)


@pytest.mark.parametrize(("rest_s", "standing"), [(4, False), (6, True)])
def test_power_at_rest_needs_some_seconds_of_it(rest_s: int, standing: bool) -> None:
    log = drive(1, seconds=120.0)
    speed = np.where(np.arange(120) < rest_s, 0.0, np.maximum(log.number("speed_m_s"), 0.1))
    moving = replace(log, columns={**log.columns, "speed_m_s": speed, "yaw_rate_rad_s": np.zeros(120)})
    made = calibrate_new(NewRobot("own", "c3*v + c4"), [drawing(moving, 5.0 + 10.0 * speed)])
    assert ("standing" in made.fit.parameters) is standing


@pytest.mark.parametrize(("most", "fits"), [(119, 1), (120, 2)])
def test_rows_as_logged_are_tried_of_logs_that_are_not_too_long(
    monkeypatch: pytest.MonkeyPatch, most: int, fits: int
) -> None:
    """Where an effect follows acceleration, which may act otherwise in a jolt than over a longer mean."""
    effect = "effects:\n  - {effect: acceleration, battery: robot, parameters: {k: 1}}\n"
    model = build_power_model(robot_from_text(robot_text("pioneer3dx") + effect))
    logs, periods, fit = [drive(i, seconds=60.0) for i in range(2)], [], final._fit

    def counted(*given: object) -> object:
        periods.append(given[4].period_s)
        return fit(*given)

    assert sum(log.rows for log in logs) == 120
    monkeypatch.setattr(final, "MOST_ROWS", most)
    monkeypatch.setattr(final, "_fit", counted)
    final.final_fit(model, logs, "robot", {}, Clock.as_logged(2), replace(Settings(), period_s=4.0))
    assert len(periods) == fits
    assert periods[0] == 4.0
