"""Error statistics over progress against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.runs.error import RunError, cumulative_at, error_curve, error_statistics, progress_grid


def test_statistics_of_a_curve_worked_out_by_hand() -> None:
    found = error_statistics(np.array([-24.0, -12.0, -10.0, -10.0]))
    assert found.peak_pct == 24.0
    assert found.final_pct == 10.0
    assert found.mean_pct == pytest.approx(14.0, abs=1e-12)
    assert found.std_pct == pytest.approx(np.sqrt((100 + 4 + 16 + 16) / 4), abs=1e-12)


def test_error_is_model_minus_measured_relative_to_either() -> None:
    measured, predicted = np.array([2.0, 4.0]), np.array([1.0, 3.0])
    assert error_curve(measured, predicted).tolist() == [-50.0, -25.0]
    assert error_curve(measured, predicted, "predicted") == pytest.approx([-100.0, -100.0 / 3.0])
    assert RunError("", 1.0, 4.0, 3.0, 0.0).energy_error_pct == -25.0


def test_curve_is_undefined_where_nothing_was_measured() -> None:
    curve = error_curve(np.array([0.0, 2.0]), np.array([1.0, 3.0]))
    assert np.isnan(curve[0])
    assert error_statistics(curve).mean_pct == 50.0


def test_what_is_drawn_before_the_drive_is_no_error_of_it() -> None:
    """A robot that stood at 4 W, modelled as 40 W, before it drove at 400 W: peaks of 945 % were told of real logs."""
    measured = np.where(np.arange(100) < 10, 4.0, 400.0)
    predicted = np.where(np.arange(100) < 10, 40.0, 380.0)
    progress, grid = np.arange(1, 101) / 100, progress_grid()
    curve = error_curve(cumulative_at(progress, measured, grid), cumulative_at(progress, predicted, grid))
    assert error_statistics(curve).peak_pct < 100.0
    assert error_statistics(curve).final_pct == pytest.approx(100.0 * 1440.0 / 36040.0)


def test_constant_relative_error_has_no_spread() -> None:
    energy = np.full(400, 2.0)
    progress = np.arange(1, 401) / 400
    grid = progress_grid()
    curve = error_curve(cumulative_at(progress, energy, grid), cumulative_at(progress, 1.1 * energy, grid))
    found = error_statistics(curve)
    assert (found.peak_pct, found.mean_pct, found.final_pct) == pytest.approx((10.0, 10.0, 10.0), abs=1e-9)
    assert found.std_pct == pytest.approx(0.0, abs=1e-9)


def test_early_peak_of_a_late_run() -> None:
    # predicted 1 J each, measured 2 J in the first tenth and 1 J after: the error falls as 1/progress
    measured = np.where(np.arange(100) < 10, 2.0, 1.0)
    progress = np.arange(1, 101) / 100
    grid = progress_grid()
    curve = error_curve(cumulative_at(progress, measured, grid), cumulative_at(progress, np.ones(100), grid))
    found = error_statistics(curve)
    assert found.peak_pct == pytest.approx(50.0)
    assert found.final_pct == pytest.approx(100 * 10 / 110)
