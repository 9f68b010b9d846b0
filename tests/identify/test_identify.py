"""The whole identification on a tiny world: nothing, one effect, twins, confounding, structure outside the library."""

from __future__ import annotations

import inspect
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from missionsim import interface
from missionsim.cli.options import ALPHA
from missionsim.identify import stepwise
from missionsim.identify.data import Candidate, RunData
from missionsim.identify.design import make_source
from missionsim.identify.identification import fit_effects, identify
from missionsim.identify.model import prediction
from missionsim.identify.settings import Settings

from .world import BASE, coefficient, library, make_runs


def _names(found):
    return [e.effect for e in found.effects]


def _strength(column, share):
    return {column: coefficient(make_runs(0), column, share)}


@pytest.mark.parametrize("seed", range(4))
def test_nothing_hidden_nothing_named(seed):
    found = identify(make_runs(seed, delay_s=0.25 if seed % 2 else 0.0), library(), {})
    assert found.verdict == "nothing_missing"
    assert not found.effects
    assert all(c.smallest_detectable_share > 0 for c in found.candidates)


@pytest.mark.parametrize(
    ("column", "effect"),
    [
        pytest.param("grade", "grade", marks=pytest.mark.long),
        ("payload", "payload"),
        pytest.param("turning_scrub", "turning_scrub", marks=pytest.mark.long),
        ("surface|carpet", "surface_rolling_resistance"),
        pytest.param("aerodynamic_drag", "aerodynamic_drag", marks=pytest.mark.long),
        ("component_power:camera", "component_power:camera"),
    ],
)
def test_one_effect_is_named_and_measured(column, effect):
    hidden = _strength(column, 0.05)
    found = identify(make_runs(11, hidden), library(), {})
    assert _names(found) == [effect]
    estimate = next(iter(found.effects[0].parameters.values()))
    # 1.5 half-widths: one seed must not decide whether 95 % intervals are right
    half = 0.5 * (estimate.high - estimate.low)
    assert abs(estimate.value - hidden[column]) < 1.5 * half
    assert found.effects[0].p_value < 1e-3


def test_a_noise_that_had_swallowed_the_effect_is_fitted_afresh(monkeypatch):
    """Two runs on hills whose noise had taken the grade: a fit that began there stayed, and the grade was demoted."""
    runs = make_runs(4, _strength("grade", 0.05), count=3)
    right = identify(runs, library(), {})
    fit = stepwise.fit_model

    def stuck(source, chosen, start=None, thorough=True):
        model = fit(source, chosen, start, thorough)
        return model if thorough else replace(model, noise=replace(model.noise, sigma_w=2.0 * model.noise.sigma_w))

    monkeypatch.setattr(stepwise, "fit_model", stuck)
    found = identify(runs, library(), {})
    assert _names(found) == _names(right) == ["grade"]
    assert found.noise["sd_w"] == pytest.approx(right.noise["sd_w"], rel=0.05)


def _rmse_on(found, runs, effects=True):
    """Power error on other runs, of the model found or of the recalibrated base alone [W]."""
    model = found.choice.model if effects else found.choice.empty
    source = make_source(runs, found.library, {}, found.settings, like=found.choice.model.source)
    design = source.design(source.clock)
    return float(np.sqrt(np.mean((prediction(model, model.chosen, design) - design.y) ** 2)))


@pytest.mark.long
def test_effect_helps_on_runs_not_used():
    runs = make_runs(5, _strength("payload", 0.06), count=9)
    found = identify(runs[:6], library(), {})
    with_effects = _rmse_on(found, runs[6:])
    assert with_effects < 0.8 * _rmse_on(found, runs[6:], effects=False)
    oracle = fit_effects(runs[:6], library(), ["payload"], {})
    assert with_effects == pytest.approx(_rmse_on(oracle, runs[6:]), rel=0.03)


def test_small_shift_of_a_base_parameter_is_recalibration():
    found = identify(make_runs(3, base_error={"camera.power": 0.05}), library(), {})
    assert not found.effects
    shift = {s.parameter: s for s in found.recalibration}["camera.power"]
    assert shift.shift == pytest.approx(0.05, abs=0.03)


def test_payload_only_on_carpet_names_both():
    hidden = _strength("payload", 0.05)
    found = identify(make_runs(8, hidden, count=4, payload_only_on_carpet=True), library(), {})
    assert found.verdict == "ambiguous"
    first = found.effects[0]
    assert {"payload", "surface_rolling_resistance"} <= {first.effect, *first.indistinguishable_from}
    assert first.separation_nats < 1.0
    apart = make_runs(8, hidden, count=4)
    assert identify(apart, library(), {}).effects[0].separation_nats > first.separation_nats + 5.0


@pytest.mark.long
def test_periodic_load_is_structure_not_an_effect():
    found = identify(make_runs(4, periodic_w=1.2, count=8), library(), {})
    assert found.verdict == "unexplained_structure"
    assert not found.effects
    assert "period" in found.unexplained.shape
    period = float(found.unexplained.shape.split("period")[-1].split()[0])
    assert 58 < period < 62


def test_dead_zone_is_not_called_scrub():
    found = identify(make_runs(6, dead_zone_w=25.0, count=5), library(), {})
    assert found.verdict == "unexplained_structure"
    assert "turning_scrub" not in _names(found)
    assert "yaw_rate_rad_s" in found.unexplained.depends_on


@pytest.mark.parametrize("delay", [-0.3, pytest.param(0.5, marks=pytest.mark.long)])
def test_clock_error_is_found_and_does_no_harm(delay):
    found = identify(make_runs(9, _strength("turning_scrub", 0.05), delay_s=delay), library(), {})
    assert _names(found) == ["turning_scrub"]
    assert found.delay_s + found.lag_s == pytest.approx(delay, abs=0.15)


@pytest.mark.parametrize("count", [1, 2])
def test_few_runs_work_and_say_so(count):
    found = identify(make_runs(10, _strength("grade", 0.08), count=count), library(), {})
    assert _names(found)[:1] == ["grade"]
    assert any("run" in remark for remark in found.remarks)
    assert np.isnan(found.effects[0].p_runs)


def test_shape_is_refitted_exactly():
    runs = make_runs(12, {"cold": 6.0}, count=8)
    moved = [
        np.cumsum((np.abs(r.covariates["speed_m_s"]) > 0.005) | (np.abs(r.covariates["yaw_rate_rad_s"]) > 0.02))
        for r in runs
    ]

    def refit(shape):
        return [r.columns["rolling_friction"] * np.exp(-m / shape["tau_s"]) for r, m in zip(runs, moved, strict=True)]

    candidates = [replace(c, refit=refit) if c.effect == "cold_friction" else c for c in library()]
    found = identify(runs, candidates, {})
    assert _names(found) == ["cold_friction"]
    tau = found.effects[0].parameters["tau_s"]
    assert tau.low < 70 < tau.high
    assert tau.value == pytest.approx(70, rel=0.25)
    assert _rmse_on(found, make_runs(13, {"cold": 6.0}, count=2)) < 1.0


def test_forced_fit_refuses_what_never_acts():
    runs = make_runs(1, count=2)
    with pytest.raises(ValueError, match="no column that acts"):
        fit_effects(runs, library(), ["radio_range"], {})


def test_no_run_is_refused():
    with pytest.raises(ValueError, match="at least one run"):
        identify([], library(), {}, Settings())


def test_result_does_not_depend_on_the_order_of_the_runs():
    runs = make_runs(14, _strength("grade", 0.04))
    one, two = (identify(r, library(), {}) for r in (runs, runs[::-1]))
    assert _names(one) == _names(two) == ["grade"]
    assert one.effects[0].energy_share == pytest.approx(two.effects[0].energy_share, rel=2e-2)


def _with_temperature(cold_runs, extra_n):
    """Six runs at temperatures of their own; a friction that no column shows is added in some of them."""
    runs = []
    for j, run in enumerate(make_runs(21, count=6)):
        temperature = np.full(len(run.time_s), 5.0 if j in cold_runs else 22.0)
        column = run.columns["rolling_friction"] * np.maximum(25.0 - temperature, 0.0)
        hidden = extra_n * run.columns["rolling_friction"] * (j in cold_runs)
        runs.append(
            replace(
                run,
                columns=run.columns | {"temperature": column},
                measured_w=run.measured_w + hidden,
                covariates=run.covariates | {"temp_ambient_c": temperature},
            )
        )
    return runs, [*library(), Candidate("temperature_friction", ("temperature",), covariate="temp_ambient_c")]


def test_what_rests_on_one_run_is_not_named_but_told():
    runs, candidates = _with_temperature({2}, 3.0)
    found = identify(runs, candidates, {})
    assert found.verdict == "unexplained_structure"
    assert not found.effects
    assert "run" in found.unexplained.depends_on
    reason = next(c.reason for c in found.candidates if c.effect == "temperature_friction")
    assert "rests on one run" in reason


def test_what_three_runs_show_is_named():
    runs, candidates = _with_temperature({1, 2, 4}, 3.0)
    assert "temperature_friction" in _names(identify(runs, candidates, {}))


def test_the_command_line_has_the_level_of_the_method():
    told = inspect.signature(interface.diagnose).parameters["alpha"].default
    assert Settings().alpha == ALPHA == told
    code = "import missionsim.cli.options, missionsim.identify.settings, sys; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0  # the command line begins at once


def loaded(rng: np.random.Generator, name: str, idle: bool, watts: float) -> RunData:
    """Five minutes at rest under a load of 5 % in a third of the runs and 15 to 95 % else, badly logged."""
    level = 0.05 if idle else rng.uniform(0.15, 0.95)
    load, ones = np.clip(level + 0.3 * rng.standard_normal(300), 0.0, 1.0), np.ones(300)
    measured = 7.0 + watts * level + 0.15 * rng.standard_normal(300)
    columns = {"cpu_load": load, "grade": np.where(rng.random(300) < 0.1, 1.0, 0.0)}
    return RunData(name, np.arange(300) + 0.5, ones, measured, 7.5 * ones, {"c4": 7.5 * ones}, columns, dict(columns))


@pytest.mark.parametrize(
    ("watts", "names"), [(1.6, ["cpu_load"]), pytest.param(0.5, ["cpu_load"], marks=pytest.mark.long), (0.0, [])]
)
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_a_noisy_load_is_seen_between_the_runs(seed: int, watts: float, names: list[str]) -> None:
    """Within runs its coefficient is a fraction, and offsets of the runs would take the rest."""
    rng = np.random.default_rng(seed)
    runs = [loaded(rng, f"run_{i}", i % 3 == 0, watts) for i in range(24)]
    effects = [Candidate("cpu_load", ("cpu_load",), covariate="cpu_load"), Candidate("grade", ("grade",))]
    assert [effect.effect for effect in identify(runs, effects, {"c4": 1.0}).effects] == names


@pytest.mark.parametrize("unlogged", [pytest.param(0.0, marks=pytest.mark.long), 6.0])
@pytest.mark.parametrize(("watts", "names"), [(5.0, ["cpu_load"]), (0.0, [])])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_load_logged_late_is_no_noise(seed: int, watts: float, names: list[str], unlogged: float) -> None:
    """Load in steps of 8 to 30 s that the log tells 2 s later: a noise of 25 s takes all but the differences. Alone, or
    beside another one that no column shows."""
    rng = np.random.default_rng(seed)
    ones, runs = np.ones(200), []
    for i in range(12):
        load = np.repeat(rng.choice([0.05, 0.5, 1.0], 30), rng.integers(8, 30, 30))[:202]
        measured = 12.0 + watts * load[2:] + 0.4 * rng.standard_normal(200)
        measured += unlogged * np.repeat(rng.random(25) < 0.4, 8)
        columns = {"cpu_load": load[:-2], "grade": np.where(rng.random(200) < 0.1, 1.0, 0.0)}
        base = 14.0 * ones
        runs.append(RunData(f"{i}", np.arange(200) + 0.5, ones, measured, base, {"c4": base}, columns, dict(columns)))
    effects = [Candidate("cpu_load", ("cpu_load",), covariate="cpu_load"), Candidate("grade", ("grade",))]
    found = identify(runs, effects, {"c4": 1.0}).effects
    assert [effect.effect for effect in found] == names
    assert all(0.1 < effect.energy_share < 0.25 for effect in found)


def test_short_spikes_hide_nothing():
    """A row in a hundred at seven times the power, as where motors start: unweighted, they hide a grade of 1.5 %."""
    rng = np.random.default_rng(1)
    runs = [
        replace(r, measured_w=r.measured_w * (1.0 + 6.0 * (rng.random(len(r.time_s)) < 0.01)))
        for r in make_runs(1, _strength("grade", 0.015))
    ]
    assert _names(identify(runs, library(), {})) == ["grade"]


def test_noise_that_grows_with_the_power_leaves_a_small_load_seen_at_rest():
    """Noise of a tenth of the power: the drive takes 50 W, and a camera 0.5 W more than its file says (1.3 %)."""
    rng, runs = np.random.default_rng(1), []
    for run in make_runs(1, {"component_power:camera": 0.5}, base_error={}, noise=0.0):
        drive = 15.0 * run.gradient["c4"] / BASE["c4"]
        power = (run.measured_w + drive) * (1.0 + 0.1 * rng.standard_normal(len(drive)))
        gradient = {**run.gradient, "c4": run.gradient["c4"] + drive}
        runs.append(replace(run, measured_w=power, base_w=run.base_w + drive, gradient=gradient))
    assert _names(identify(runs, library(), {})) == ["component_power:camera"]


def test_a_stretch_of_a_curve_that_only_ramps_support_says_nothing():
    """Sills that a robot meets as it brakes or starts, each with a jolt: the slope that they show is no form."""
    runs = []
    for run in make_runs(1, hidden := _strength("grade", 0.03)):
        speed, slope = run.covariates["speed_m_s"], run.covariates["slope_rad"].copy()
        sills = np.flatnonzero((np.abs(np.gradient(speed)) > 0.12) & (speed > 0.1))[:20]
        slope[sills] = 0.2
        grade = 20.0 * 9.81 * speed * np.sin(slope)
        power = run.measured_w + hidden["grade"] * (grade - run.columns["grade"])
        power[sills] += 8.0
        columns, covariates = {**run.columns, "grade": grade}, {**run.covariates, "slope_rad": slope}
        runs.append(replace(run, measured_w=power, columns=columns, covariates=covariates))
    found = identify(runs, library(), {})
    assert (_names(found), found.unexplained.depends_on) == (["grade"], ())


def test_one_steep_stretch_does_not_hide_what_the_others_show():
    """One drive whose steepest half minute holds most of the information: degrees of freedom are left without it."""
    hidden = _strength("grade", 0.02)
    run = make_runs(1, hidden, count=1)[0]
    steeper = np.where((run.time_s > 100.0) & (run.time_s < 130.0), 4.0, 1.0)
    grade, slope = (steeper * x for x in (run.columns["grade"], run.covariates["slope_rad"]))
    power = run.measured_w + hidden["grade"] * (grade - run.columns["grade"])
    columns, covariates = {**run.columns, "grade": grade}, {**run.covariates, "slope_rad": slope}
    run = replace(run, measured_w=power, columns=columns, covariates=covariates)
    assert _names(identify([run], library(), {})) == ["grade"]
