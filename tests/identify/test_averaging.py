"""Averages of all runs at once, and whitening of all stretches at once, against one at a time."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from missionsim.identify import align
from missionsim.identify.align import alignment
from missionsim.identify.averaging import Intervals, RunColumns, integral_curves, make_bins
from missionsim.identify.data import RunData
from missionsim.identify.design import KEPT_CURVES, make_source
from missionsim.identify.gram import Blocks, eliminate_random
from missionsim.identify.noise import START_ROWS, Packed, arma_of, start_factor, start_noise
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.settings import Settings

from .world import averaged, library, make_runs, with_gap


def _columns(step_s: float, rows: int, seed: int, gap: bool = False) -> RunColumns:
    rng = np.random.default_rng(seed)
    time_s = step_s * (np.arange(rows) + 0.5)
    power = rng.uniform(1, 9, rows)
    if gap:
        power[rows // 3 : rows // 2] = np.nan
    run = RunData(f"r{seed}", time_s, np.full(rows, step_s), power, rng.uniform(1, 9, rows))
    return RunColumns.of(run, make_bins(run, 1.0), [run.base_w, rng.standard_normal(rows), np.full(rows, 2.5)])


@pytest.fixture(scope="module")
def several() -> list[RunColumns]:
    return [_columns(0.1, 900, 1), _columns(0.5, 200, 2, gap=True), _columns(1.0, 60, 3)]


@pytest.mark.parametrize("lag_s", [0.0, 0.35])
def test_runs_together_are_averaged_like_runs_alone(several: list[RunColumns], lag_s: float) -> None:
    intervals = Intervals.of(several)
    delays = np.array([0.2, -0.37, 1.4])
    curves = integral_curves([run.values for run in several], [run.rows for run in several])
    together = intervals.means(curves, intervals.weights(delays, lag_s)).T
    alone = np.hstack([averaged(run, d, lag_s) for run, d in zip(several, delays, strict=True)])
    assert together == pytest.approx(alone, rel=1e-10, abs=1e-10)
    known = np.abs(together[2]) > 0.0  # a late column says nothing yet in the very first interval
    assert together[2, known] == pytest.approx(np.full(known.sum(), 2.5), rel=1e-9)
    assert known.sum() >= len(known) - 1
    base = integral_curves([run.values[:1] for run in several], [run.rows for run in several])
    assert intervals.means_of_one(intervals.cubics(base), delays, lag_s) == pytest.approx(together[0], rel=1e-10)


def test_rows_at_uneven_times_are_not_mixed_with_their_neighbours() -> None:
    """On an even grid half of a jolt in one row went into the next: accelerations came out a fifth too large."""
    rng = np.random.default_rng(5)
    time_s = np.cumsum(rng.uniform(0.95, 1.05, 300))
    jolts = rng.standard_normal(300)
    run = RunData("uneven", time_s, np.gradient(time_s), rng.uniform(1, 9, 300), np.zeros(300))
    columns = RunColumns.of(run, make_bins(run, 1.0), [jolts])
    assert averaged(columns, 0.0, 0.0)[0] == pytest.approx(jolts, rel=1e-9)
    late = averaged(columns, 0.5, 0.0)[0]
    assert 0.4 < np.corrcoef(late[1:], jolts[1:])[0, 1] < np.corrcoef(late[1:], jolts[1:] + jolts[:-1])[0, 1]


@pytest.mark.parametrize("step_s", [0.02, 1.0])
def test_rows_beside_a_gap_keep_their_values(step_s: float) -> None:
    time_s = np.concatenate([np.arange(500.0), 3000.0 + 1.04 * np.arange(500)]) * step_s
    power = np.concatenate([np.full(499, 1.0), [3.0, 4.0], np.full(499, 5.0)])
    run = RunData("gap", time_s, np.full(1000, step_s), power, power)
    columns = RunColumns.of(run, make_bins(run, 1.0), [power])
    assert columns.values.shape[1] == 1002 if step_s == 1.0 else columns.values.shape[1] < 250
    assert averaged(columns, 0.0, 0.0)[0] == pytest.approx(columns.bins.measured_w, rel=0.01)


def test_a_delay_of_whole_rows_is_a_plain_mean_of_rows(several: list[RunColumns]) -> None:
    run = several[0]
    found = averaged(run, 0.3, 0.0)[:, 5]
    assert found == pytest.approx(run.values[:, 50 - 3 : 60 - 3].mean(axis=1), rel=1e-9)


def test_a_lag_is_the_exponentially_weighted_mean_of_delays(several: list[RunColumns]) -> None:
    """On a smooth column, few delays are as good as many."""
    time_s = 0.1 * (np.arange(900) + 0.5)
    run = replace(several[0], values=np.sin(time_s / 3.0)[None, :])
    fine = np.arange(0.0005, 4.0, 0.001)
    weight = np.exp(-fine / 0.3)
    late = np.array([averaged(run, d, 0.0)[0, 20:-20] for d in fine[::20]])
    expected = weight[::20] @ late / weight[::20].sum()
    assert averaged(run, 0.0, 0.3)[0, 20:-20] == pytest.approx(expected, abs=4e-3)


@pytest.mark.parametrize("lag_s", [0.5, 1.0])
def test_a_step_rises_through_a_lag_as_an_exponential(lag_s: float) -> None:
    """Quadrature for polynomials rose in leaps of 0.7: lags came out a fifth too short, and delays as much too long."""
    time_s = 0.1 * (np.arange(400) + 0.5)
    step = (time_s > 20.0).astype(float)
    run = RunData("step", time_s, np.full(400, 0.1), step, step)
    columns = RunColumns.of(run, make_bins(run, 0.5), [step])
    since = np.maximum(np.arange(0.0005, 40.0, 0.001) - 20.0, 0.0)
    exact = (1.0 - np.exp(-since / lag_s)).reshape(80, 500).mean(axis=1)
    assert averaged(columns, 0.0, lag_s)[0] == pytest.approx(exact, abs=0.03)


def test_intervals_beside_a_gap_have_edges_of_their_own(several: list[RunColumns]) -> None:
    intervals = Intervals.of(several)
    low = intervals.edges_s[intervals.low_at]
    high = intervals.edges_s[intervals.low_at + 1]
    begins = intervals.rows_s[intervals.first][intervals.low_at]
    own = [(run.rows.edges_s[0], run.bins) for run in several]
    assert low - begins == pytest.approx(np.concatenate([bins.low_s - start for start, bins in own]))
    assert high - begins == pytest.approx(np.concatenate([bins.high_s - start for start, bins in own]))
    assert np.all(intervals.run[intervals.low_at] == intervals.run[intervals.low_at + 1])


def test_a_constant_column_says_nothing_about_the_clock(several: list[RunColumns]) -> None:
    """What is left of it after differences and means is rounding, which must not be blown up to a regressor."""
    without = [replace(run, values=run.values[:2]) for run in several]
    for delay_s, lag_s in ((0.0, 0.0), (0.1, 0.3), (-0.4, 0.2)):
        with_it = alignment(several, 1.0)(delay_s, lag_s)
        assert with_it == pytest.approx(alignment(without, 1.0)(delay_s, lag_s), abs=1e-7)


def test_kept_curves_change_nothing() -> None:
    runs = make_runs(1, count=3)
    source, fresh = (make_source(runs, library(), {}, Settings(align=False)) for _ in range(2))
    clocks = [replace(source.clock, delay_s=d, lag_s=t, run_delay_s=(0.1, 0.0, -0.1)) for d, t in ((0, 0), (0.2, 0.3))]
    whole = [source.design(c) for c in clocks]
    count = len(source.layout.columns)
    for k in range(count):
        assert source.design(clocks[1], [k]).phi[0] == pytest.approx(whole[1].phi[k], rel=1e-12)
    assert len(source._kept_curves) <= KEPT_CURVES < count
    again = source.design(clocks[0])
    for name in ("y", "base", "gradient", "phi", "random", "duration_s", "time_s"):
        assert np.array_equal(getattr(again, name), getattr(whole[0], name))
        assert np.array_equal(getattr(fresh.design(clocks[0]), name), getattr(again, name))


@pytest.mark.long
def test_a_varied_column_is_like_a_source_made_with_it() -> None:
    """Alone and on top of another varied column, for two clocks; everything else stays."""
    runs = make_runs(1, count=3)
    source = make_source(runs, library(), {}, Settings(align=False))
    names = [c.name for c in source.layout.columns]
    first, second = 1, 3
    clocks = [replace(source.clock, delay_s=d, lag_s=t, run_delay_s=(0.1, 0.0, -0.1)) for d, t in ((0, 0), (0.2, 0.3))]
    before = [source.design(c) for c in clocks]
    changed = {k: [np.sqrt(np.abs(run.columns[names[k]])) for run in runs] for k in (first, second)}
    columns = list(source.layout.columns)
    varied, expected = source, runs
    for k, rows in changed.items():
        columns[k] = replace(columns[k], watts_per_unit=0.7 + k)
        varied = varied.with_column(k, replace(source.layout, columns=tuple(columns)), rows)
        expected = [
            replace(run, columns=dict(run.columns) | {names[k]: own}) for run, own in zip(expected, rows, strict=True)
        ]
    made = make_source(expected, library(), {}, Settings(align=False), like=varied)
    for clock, old in zip(clocks, before, strict=True):
        for only in (None, [second, 0, first]):
            mine, other = varied.design(clock, only), made.design(clock, only)
            assert mine.layout is varied.layout
            for name in ("y", "base", "gradient", "random"):
                assert np.array_equal(getattr(mine, name), getattr(other, name))
            untouched = [p for p, k in enumerate(only or range(len(names))) if k not in changed]
            assert mine.phi[untouched] == pytest.approx(other.phi[untouched], rel=1e-12)
        assert np.array_equal(source.design(clock).phi, old.phi)
    whole = [varied.design(clocks[1]).phi[k] for k in changed]
    raw = [varied.averaged([own[None, :] for own in changed[k]], clocks[1])[0] for k in changed]
    for k, mine, own in zip(changed, whole, raw, strict=True):
        assert mine == pytest.approx(own * source.layout.mean_power_w / (0.7 + k), rel=1e-12)


SHAPE = (1.0, 5.0, 80.0, 0.5, 0.3)


def _packed(lengths: list[int], runs: list[int]) -> tuple[Packed, np.ndarray, list[slice], list[slice]]:
    ends = np.cumsum(lengths)
    stretches = [slice(int(e - n), int(e)) for e, n in zip(ends, lengths, strict=True)]
    bounds = [0, *np.cumsum(runs).tolist()]
    whole = [slice(a, b) for a, b in pairwise(bounds)]
    rng = np.random.default_rng(5)
    rows, scale = rng.standard_normal((4, int(ends[-1]))), rng.uniform(0.5, 2.0, int(ends[-1]))
    weight = rng.uniform(0.1, 1.0, int(ends[-1]))
    return Packed.of(rows, scale, weight, stretches, whole), rows, stretches, whole


@pytest.mark.parametrize("lengths", [[200, 197, 210], [300, 3, 41, 1, 39, 180], [5, 7], [40, 400, 39, 41]])
def test_stretches_side_by_side_are_whitened_like_each_alone(lengths: list[int]) -> None:
    packed, _, stretches, _ = _packed(lengths, lengths)
    white = packed.white(SHAPE)
    assert sum(len(group.parts) for group in packed.groups) == len(lengths)
    rng = np.random.default_rng(5)
    n = sum(lengths)
    rows, scale, weight = rng.standard_normal((4, n)), rng.uniform(0.5, 2.0, n), rng.uniform(0.1, 1.0, n)
    lags = np.arange(START_ROWS)
    covariance = 0.5 * np.exp(-lags / 5.0) + 0.3 * np.exp(-lags / 80.0)
    covariance[0] = 1.0
    for part in stretches:
        length = part.stop - part.start
        own = Packed.of(rows[:, part], scale[part], weight[part], [slice(0, length)], [slice(0, length)])
        assert white[:, part] == pytest.approx(own.white(SHAPE), rel=1e-9, abs=1e-10)
        head = min(length, START_ROWS)
        factor = np.linalg.cholesky(covariance[np.abs(np.subtract.outer(lags[:head], lags[:head]))])
        begun = slice(part.start, part.start + head)
        exact = np.linalg.solve(factor, (rows / scale)[:, begun].T).T * np.sqrt(weight[begun])
        ratio = arma_of(*SHAPE)[2]
        assert ratio * white[:, begun] == pytest.approx(exact, abs=1e-6)


def test_blocks_are_gram_matrices_of_the_white_rows_of_each_run() -> None:
    packed, _, _, runs = _packed([120, 60, 150, 20, 30], [180, 150, 50])
    white = packed.white(SHAPE)
    expected = np.stack([white[:, part] @ white[:, part].T for part in runs])
    assert packed.blocks(SHAPE) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_start_factor_undoes_the_correlation() -> None:
    inverse, diagonal, _ = start_factor(*SHAPE)
    lags = np.abs(np.subtract.outer(np.arange(START_ROWS), np.arange(START_ROWS)))
    covariance = 0.5 * np.exp(-lags / 5.0) + 0.3 * np.exp(-lags / 80.0)
    np.fill_diagonal(covariance, 1.0)
    assert inverse @ covariance @ inverse.T == pytest.approx(np.eye(START_ROWS), abs=1e-6)
    assert np.all(np.triu(inverse, 1) == 0.0)
    assert 1.0 / np.diag(inverse) == pytest.approx(diagonal)


def test_random_effects_are_integrated_out_for_several_noises_at_once() -> None:
    runs = [*make_runs(1, count=2), with_gap(make_runs(2, count=1)[0], 100, 140)]
    source = make_source(runs, library(), {}, Settings(align=False))
    design = source.design(source.clock)
    noise = replace(start_noise(design), sigma_w=0.7)
    blocks = Blocks.of(design, noise, design.residual[None, :], [0, 1]).at(noise.shape)
    reduced, log_det = eliminate_random(blocks, noise.random_sd())
    left, log_dets = eliminate_random(*(np.array([one, 2.0 * one]) for one in (blocks, noise.random_sd())))
    assert left[0] == pytest.approx(reduced, rel=1e-9, abs=1e-9 * np.abs(reduced).max())
    assert log_dets[0] == pytest.approx(log_det, rel=1e-10)
    assert np.all(log_dets[1] > log_dets[0])
    # the clock's random effects are rows of the gradient as well, whitened once only
    q = len(design.gradient)
    assert blocks[:, -2:, 0] == pytest.approx(blocks[:, 1 + q - 4 : 1 + q - 2, 0])
    assert design.random[3:] == pytest.approx(design.gradient[-4:-2])


@pytest.mark.parametrize(("uneven", "close"), [(0.0, False), (0.8, False), (0.0, True)])
def test_rows_are_looked_up_as_they_are_searched_for(uneven: float, close: bool) -> None:
    """At their edges and a rounding beside them, too; where lengths are very unlike, without a table."""
    rng = np.random.default_rng(2)
    runs = []
    for i in range(3):
        time_s = 0.7 * (np.arange(300) + 0.5 + uneven * rng.uniform(-0.5, 0.5, 300))
        if close:
            time_s[150:153] = time_s[150] + [0.0, 1e-4, 2e-4]
        run = RunData(f"r{i}", time_s, np.full(300, 0.7), rng.uniform(1, 9, 300), np.ones(300))
        runs.append(RunColumns.of(run, make_bins(run, 1.0), [run.base_w]))
    intervals = Intervals.of(runs)
    rows = intervals.rows_s
    assert (intervals._cells is None) is close
    for j in range(3):
        first, last = np.unique(intervals.first)[j], np.unique(intervals.last)[j]
        own = rows[first : last + 1]
        times = np.concatenate(
            [own, np.nextafter(own[1:], 0.0), np.nextafter(own[:-1], np.inf), rng.uniform(*own[[0, -1]], 999)]
        )
        found, searched = intervals._row_of(times), np.searchsorted(rows, times, side="right") - 1
        assert np.array_equal(*(np.clip(row, first, last - 1) for row in (found, searched)))


def test_least_squares_needs_no_derivatives_after_the_delay() -> None:
    source = make_source(make_runs(1, count=3), library(), {}, Settings(align=False))
    clock = replace(source.clock, delay_s=0.2, lag_s=0.3)
    plain, whole = (LeastSquares.of(source.design(clock, [2, 1], timed=timed)).sums for timed in (False, True))
    assert np.array_equal(plain, whole)


def test_a_start_of_the_clock_is_looked_for_once(several: list[RunColumns], monkeypatch: pytest.MonkeyPatch) -> None:
    """Other priors ask for it again, of the same columns; other columns, times or watts are another question."""
    asked: list[str] = []
    monkeypatch.setattr(align, "_best_clock", lambda *_: (float(asked.append("searched") or len(asked)), 0.0))
    monkeypatch.setattr(align, "_FOUND", {})
    first, last = several[0], several[-1]
    late = replace(last.bins, measured_w=last.bins.measured_w + 1.0)
    moved = replace(last.rows, edges_s=last.rows.edges_s + 0.01)
    others = [replace(last, values=last.values + 1.0), replace(last, bins=late), replace(last, rows=moved)]
    found = [align.find_clock([first, one], 1.0) for one in (last, replace(last, values=last.values.copy()), *others)]
    assert [delay_s for delay_s, _ in found] == [1.0, 1.0, 2.0, 3.0, 4.0]
    assert align.find_clock([first, last], 2.0) == (5.0, 0.0)
