"""The pieces against closed forms and dense linear algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from missionsim.identify import model
from missionsim.identify.averaging import RunColumns, make_bins
from missionsim.identify.data import Constraints, RunData
from missionsim.identify.design import make_source, switch_jumps
from missionsim.identify.evidence import _chance_of_jackknife, _jackknife
from missionsim.identify.gram import Gram, all_sets, make_gram, project, set_gains
from missionsim.identify.noise import Packed, arma_of, start_noise
from missionsim.identify.reml import _Likelihood
from missionsim.identify.residual import hats, knots_of
from missionsim.identify.settings import Settings

from .world import averaged, library, make_runs, with_gap


def test_a_column_that_is_the_base_itself_to_the_last_digit_is_no_fault_of_ours() -> None:
    """Runs left out may leave a law nothing of its own: "our own fault: singular matrix"."""
    run = 1e9 * np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    value, covariance = Gram(run[None], np.zeros(1)).joint([0], 1)
    assert value.sum() == pytest.approx(1.0)
    assert np.all(np.isfinite(covariance))


@pytest.fixture(scope="module")
def source():
    return make_source(make_runs(1, count=3), library(), {}, Settings(align=False))


def _autocovariance(noise, count):
    lags = noise.step_s * np.arange(count)
    out = noise.fast_share * np.exp(-lags / noise.fast_s) + noise.slow_share * np.exp(-lags / noise.slow_s)
    out[0] = 1.0
    return out * noise.total_sd_w**2


def _dense(noise, count):
    c = _autocovariance(noise, count)
    return c[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))]


@pytest.mark.parametrize(("fast_s", "slow_s", "fast", "slow"), [(3, 60, 0.6, 0.1), (8, 200, 0.2, 0.7), (1, 30, 0.9, 0)])
def test_arma_has_the_autocovariance_of_the_sum(fast_s, slow_s, fast, slow):
    ar, ma, ratio = arma_of(1.0, fast_s, slow_s, fast, slow)
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    from scipy.signal import lfilter

    response = lfilter(ma, ar, impulse) / ratio
    for lag in (0, 1, 2, 7):
        expected = fast * np.exp(-lag / fast_s) + slow * np.exp(-lag / slow_s) if lag else 1.0
        assert response[: 4000 - lag] @ response[lag:] == pytest.approx(expected, rel=1e-3)


def test_whitening_is_the_inverse_cholesky_factor(source):
    design = source.design(source.clock)
    noise = start_noise(design)
    rows = np.random.default_rng(0).standard_normal((2, len(design.y)))
    packed = Packed.of(rows, noise.scale, noise.weight, design.stretches, design.runs)
    white = packed.white(noise.shape) / noise.sigma_w
    part = design.runs[1]
    factor = np.linalg.cholesky(_dense(noise, part.stop - part.start))
    exact = np.linalg.solve(factor, rows[:, part].T).T
    assert np.abs(white[:, part] - exact).max() < 0.02 * np.abs(exact).max()


def test_gram_is_dense_generalised_least_squares(source):
    """Estimate and covariance with random effects and priors equal those of the dense covariance matrix."""
    design = source.design(source.clock)
    noise = start_noise(design)
    chosen = [0, 2]
    values, covariance = make_gram(design, noise).coefficients(chosen)
    n = len(design.y)
    v = np.zeros((n, n))
    for part in design.runs:
        z = design.random[:, part] * noise.random_sd()[:, None]
        v[part, part] = _dense(noise, part.stop - part.start) + z.T @ z
    nuisance = design.gradient * design.layout.prior_sd[:, None]
    v += nuisance.T @ nuisance
    x = design.phi[chosen]
    solved = np.linalg.solve(v, np.vstack([x, design.residual]).T)
    info = x @ solved[:, :2]
    assert covariance == pytest.approx(np.linalg.inv(info), rel=2e-2)
    expected = np.linalg.solve(info, x @ solved[:, 2])
    assert np.abs(values - expected).max() < 0.03 * np.sqrt(np.diag(covariance)).max()


def test_projection_and_gram_agree(source):
    design = source.design(source.clock)
    noise = start_noise(design)
    (y, x), (y_prior, x_prior) = project(design, noise, np.vstack([design.residual, design.phi[3]]), [0])
    score = y @ x + y_prior @ x_prior
    rest = make_gram(design, noise).conditional([0])
    assert score == pytest.approx(rest[0, 4], rel=1e-6)
    assert x @ x + x_prior @ x_prior == pytest.approx(rest[4, 4], rel=1e-6)


def test_best_feasible_set_is_non_negative_least_squares(source):
    from scipy.optimize import nnls

    design = source.design(source.clock)
    gram = make_gram(design, start_noise(design))
    rules = Constraints.of(design.layout, library())
    columns = [0, 1, 2]
    info = gram.full[1:4, 1:4]
    factor = np.linalg.cholesky(info).T
    x, _ = nnls(factor, np.linalg.solve(factor.T, gram.full[0, 1:4]))
    expected = gram.full[0, 1:4] @ x - 0.5 * x @ info @ x
    best = 0.0
    for size in (1, 2, 3):
        sets = all_sets(rules, size)
        sets = sets[np.all(np.isin(sets, columns), axis=1)]
        best = max(best, float(set_gains(gram, rules, sets).max()))
    assert best == pytest.approx(expected, rel=1e-6)


def _ramp_run(step=1.0, n=200):
    t = step * (np.arange(n) + 0.5)
    return RunData("r", t, np.full(n, step), np.zeros(n), 3.0 + 0.1 * t, {"c": 3.0 + 0.1 * t})


@pytest.mark.parametrize("delay", [0.3, -0.3, 1.7])
@pytest.mark.parametrize("lag", [0.0, 0.4])
def test_a_delayed_ramp_is_exact(delay, lag):
    run = _ramp_run()
    bins = make_bins(run, 1.0)
    mean = averaged(RunColumns.of(run, bins, [run.base_w]), delay, lag)[0]
    inside = slice(8, -8)  # away from where the log begins and ends
    expected = 3.0 + 0.1 * (run.time_s - delay - lag)
    assert mean[inside] == pytest.approx(expected[inside], abs=1e-6)


def test_averages_keep_the_integral():
    rng = np.random.default_rng(2)
    run = replace(_ramp_run(0.1, 2000), base_w=rng.uniform(1, 9, 2000))
    bins = make_bins(run, 1.0)
    columns = RunColumns.of(run, bins, [run.base_w])
    mean = averaged(columns, 0.0, 0.0)[0]
    assert len(mean) == 200
    assert mean @ (bins.high_s - bins.low_s) == pytest.approx(run.base_w.sum() * 0.1, rel=1e-9)


def test_bins_do_not_span_a_gap():
    run = with_gap(make_runs(1, count=1)[0], 100, 140)
    bins = make_bins(run, 5.0)
    assert list(bins.starts) == [0, 20]
    assert np.all(bins.high_s - bins.low_s < 6.5)
    assert len(bins.measured_w) == len(bins.low_s) == len(bins.high_s)


def test_a_repeated_value_counts_once():
    run = _ramp_run(0.05, 4000)
    second = np.floor(run.time_s)
    fresh = np.r_[True, np.diff(second) > 0]
    run = replace(run, measured_w=second.astype(float), fresh=fresh)
    bins = make_bins(run, 1.0)
    assert len(bins.measured_w) == int(fresh.sum()) - 1
    # the value first seen at t stands for the second before t
    assert bins.high_s[10] == pytest.approx(bins.measured_w[10], abs=0.06)


def test_switch_jumps_are_booked_on_the_higher_side():
    on = np.r_[np.zeros(5), np.full(5, 2.0), np.zeros(5)]
    run = RunData("r", np.arange(15.0), np.ones(15), on, on, {"x": on})
    jumps = switch_jumps(run)
    assert np.flatnonzero(jumps).tolist() == [5, 9]
    assert jumps[5] == jumps[9] == 2.0


def test_hats_add_up_to_one_beside_the_reference():
    values = np.linspace(0, 1, 50)
    knots = knots_of(values)
    rows = hats(values, knots)
    beyond_second = values >= knots[1]
    assert rows[:, beyond_second].sum(axis=0) == pytest.approx(np.ones(beyond_second.sum()))


@pytest.mark.parametrize("field", ["measured_w", "base_w"])
def test_arrays_of_different_length_are_refused(field):
    good = _ramp_run()
    with pytest.raises(ValueError, match=field):
        replace(good, **{field: np.zeros(3)})


def test_time_must_increase():
    with pytest.raises(ValueError, match="increasing"):
        RunData("r", np.array([0.0, 0.0, 1.0]), np.ones(3), np.ones(3), np.ones(3))


def test_some_of_the_runs_are_those_of_the_whole(source):
    clock = replace(source.clock, delay_s=0.2, lag_s=0.3)
    whole, numbers = source.design(clock), [2, 0]
    part, at = whole.of_runs(numbers)
    again = source.of_runs(numbers).design(clock.of_runs(numbers))
    assert np.array_equal(at, source.rows_of(numbers))
    assert part.names == again.names == tuple(whole.names[j] for j in numbers)
    assert part.runs == again.runs
    assert part.stretches == again.stretches
    for name in ("y", "base", "gradient", "phi", "random"):
        assert np.allclose(getattr(part, name), getattr(again, name), rtol=1e-9, atol=1e-9)
    first, _ = whole.of_runs(numbers, 20)
    assert [run.stop - run.start for run in first.runs] == [20, 20]
    assert np.array_equal(first.y[:20], whole.y[whole.runs[2]][:20])


def test_the_noise_of_many_rows_is_fitted_to_runs_spread_over_all(monkeypatch: pytest.MonkeyPatch) -> None:
    source = make_source(make_runs(1, count=45), library(), {}, Settings(align=False))
    design, rows = source.design(source.clock), []
    fit = model.fit_noise
    monkeypatch.setattr(model, "fit_noise", lambda d, *more: rows.append(len(d.y)) or fit(d, *more))
    some = model.fitted_noise(design, ())
    assert rows == [39 * 410]
    assert some.sigma_w == pytest.approx(fit(design, ()).sigma_w, rel=0.02)
    assert len(some.weight) == 45 * 420


def test_what_lasts_more_than_25_seconds_is_the_slow_noise_and_none_is_larger_than_the_fast(source):
    """Nor do gains of runs differ by more than 5 %."""
    design = source.design(source.clock)
    likelihood = _Likelihood(design, 0, start_noise(design))
    noise = replace(start_noise(design), fast_s=40.0, slow_s=10.0, fast_share=0.1, slow_share=0.3, gain=0.2)
    place = np.exp(likelihood.place(noise))
    assert place[[0, 1, 3, 6]] == pytest.approx([25.0, 25.0, 1.0, 0.05])


def test_the_robust_error_is_that_of_the_fits_that_leave_a_cluster_out() -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(0.0, np.repeat([1.0, 0.5, 4.0, 1.0, 0.2], 8))  # the third cluster holds most of the information
    y = 0.7 * x + rng.normal(0.0, 1.0, len(x))
    cluster = np.repeat(np.arange(5), 8)
    share = float(x @ y / (x @ x))
    without = [float(x[cluster != g] @ y[cluster != g] / (x[cluster != g] @ x[cluster != g])) for g in range(5)]
    sd, *_ = _jackknife(x, y - share * x, cluster, float(x @ x), 0.0)
    assert sd == pytest.approx(np.sqrt(np.sum((np.array(without) - share) ** 2)))


@pytest.mark.long
@pytest.mark.parametrize(
    "weights",
    [[1, 1, 1], *(pytest.param(w, marks=pytest.mark.long) for w in ([9, 1, 1, 1, 1, 1], [5, 3, 2, *[0.02] * 50]))],
)
def test_false_alarms_of_the_robust_error_keep_to_their_level(weights: list[float]) -> None:
    """Of 20,000 shares of nothing 200 are to be found at a level of 1 %, however few clusters lead."""
    rng = np.random.default_rng(len(weights))
    x, cluster = np.sqrt(weights), np.arange(len(weights))
    found = 0
    for y in rng.normal(0.0, 1.0, (20_000, len(weights))):
        share = float(x @ y / (x @ x))
        sd, *parts = _jackknife(x, y - share * x, cluster, float(x @ x), 0.0)
        found += _chance_of_jackknife(share / sd, *parts, 0.0) < 0.01
    assert 150 < found < 250


def test_p_values_of_clusters_of_equal_weight_are_those_of_the_t_distribution() -> None:
    x, e = np.ones(4), np.array([0.02, -0.01, 0.01, -0.02])
    sd, *parts = _jackknife(x, e, np.arange(4), 4.0, 0.0)
    assert sd == pytest.approx(np.sqrt(np.sum(e**2)) / 3.0)
    assert _chance_of_jackknife(0.3 / sd, *parts, 0.0) == pytest.approx(
        2.0 * stats.t.sf(0.3 / np.sqrt(np.sum(e**2) / 12.0), 3), rel=1e-9
    )
