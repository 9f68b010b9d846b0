"""Bins: nothing is lost or counted twice, and reading in blocks changes nothing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionsim.compare.axes import LabelAxis, NumberAxis, PlaceGrid
from missionsim.compare.where import MAX_BUCKETS, Series
from missionsim.labels import Labels

KEYS = ("b:seconds", "b:gap", "b:square")


def filled(axis: NumberAxis | LabelAxis, column: object, pieces: int = 1) -> NumberAxis | LabelAxis:
    size = len(column)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    weights = {key: rng.uniform(0.5, 1.5, size) for key in KEYS}
    for part in np.array_split(np.arange(size), pieces):
        cells = axis.place(column[part])  # type: ignore[index]
        if cells is not None:
            axis.add(cells, {key: values[part] for key, values in weights.items()})
    return axis


@given(
    st.lists(st.floats(-1e6, 1e6, allow_nan=False), min_size=2, max_size=80),
    st.integers(1, 6),
    st.sampled_from([1.0, 180.0 / np.pi, 1e-9]),
)
def test_bins_hold_everything_once_in_any_number_of_blocks(values: list[float], pieces: int, factor: float) -> None:
    column = np.array(values)
    axis = filled(NumberAxis("x", "x", "", factor), column, min(pieces, len(values)))
    bins = axis.bins("b")
    rng = np.random.default_rng(0)
    for name in ("seconds", "gap_j", "square_w2s"):
        assert sum(getattr(one, name) for one in bins) == pytest.approx(rng.uniform(0.5, 1.5, len(values)).sum())
    assert len(bins) <= 8
    ends = [(one.low, one.high) for one in bins]
    assert all(a[1] <= b[0] + 1e-9 * abs(b[0]) for a, b in itertools.pairwise(ends))  # type: ignore[operator]


def test_bins_are_where_the_values_are() -> None:
    column = np.array([0.3] * 50 + [0.7] * 50)
    axis = filled(NumberAxis("speed_m_s", "speed", "m/s"), column)
    bins = axis.bins("b")
    assert [b.low <= v <= b.high for b, v in zip((bins[0], bins[-1]), (0.3, 0.7), strict=True)] == [True, True]
    assert bins[0].value.startswith("0.3 to ")


def test_bins_end_at_what_was_measured() -> None:
    load = np.concatenate([np.linspace(0.113, 0.95, 60), np.ones(20)])
    named = [one.value for one in filled(NumberAxis("cpu_load", "processor load", ""), load, 3).bins("b")]
    assert (named[0], named[-1]) == ("0.11 to 0.2", "1")
    assert next(one.value for one in filled(NumberAxis("x", "x", ""), -load).bins("b")) == "−1 to −0.8"


def test_a_wider_block_later_makes_the_grid_coarser_without_loss() -> None:
    axis = NumberAxis("x", "x", "")
    for column in (np.linspace(0, 1, 100), np.linspace(0, 1e5, 100)):
        cells = axis.place(column)
        assert cells is not None
        axis.add(cells, dict.fromkeys(KEYS, np.ones(100)))
    bins = axis.bins("b")
    assert sum(b.seconds for b in bins) == 200
    assert bins[0].seconds >= 100


def test_missing_numbers_are_left_out() -> None:
    axis = NumberAxis("x", "x", "")
    cells = axis.place(np.array([1.0, np.nan, 2.0]))
    assert cells is not None
    assert cells[1] == -1
    axis.add(cells, {"b:seconds": np.array([1.0, 10.0, 1.0])})
    assert sum(b.seconds for b in axis.bins("b")) == 2.0
    assert NumberAxis("x", "x", "").place(np.array([np.nan])) is None


def test_labels_keep_their_code_when_blocks_name_them_in_another_order() -> None:
    axis = LabelAxis("surface", "surface")
    for texts in (["tile", "carpet"], ["carpet", "carpet", "", "grass"]):
        cells = axis.place(Labels.of(texts))
        assert cells is not None
        axis.add(cells, dict.fromkeys(KEYS, np.ones(len(texts))))
    assert {b.value: b.seconds for b in axis.bins("b")} == {"tile": 1.0, "carpet": 3.0, "grass": 1.0}


def test_counts_are_labels_in_order() -> None:
    axis = filled(LabelAxis("on_laser", "lasers"), np.array([2.0, 0.0, 1.0, 2.0]))
    assert [b.value for b in axis.bins("b")] == ["0", "1", "2"]


@given(st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), min_size=1, max_size=60), st.integers(1, 5))
def test_map_holds_everything_once(points: list[tuple[float, float]], pieces: int) -> None:
    grid = PlaceGrid()
    xy = np.array(points)
    for part in np.array_split(xy, min(pieces, len(xy))):
        ones = np.ones(len(part))
        grid.add({"x_m": part[:, 0], "y_m": part[:, 1]}, dict.fromkeys(KEYS, ones))
    assert sum(cell.seconds for cell in grid.cells("b")) == pytest.approx(len(points))
    assert sum(cell.gap_j for cell in grid.coarse_cells("b")) == pytest.approx(len(points))
    half = 0.5 * grid.width_m + 1e-9
    for x, y in points:
        assert any(abs(c.x_m - x) <= half and abs(c.y_m - y) <= half for c in grid.cells("b"))


def test_long_series_keeps_energy_and_peaks() -> None:
    rows = 10 * MAX_BUCKETS + 37
    rng = np.random.default_rng(1)
    time_s, dt = np.arange(rows) * 0.1, np.full(rows, 0.1)
    measured, model = rng.normal(10, 1, rows), np.full(rows, 10.0)
    measured[12345] = 99.0
    whole, blocks = Series(), Series()
    whole.add(time_s, dt, measured, model)
    for part in np.array_split(np.arange(rows), 9):
        blocks.add(time_s[part], dt[part], measured[part], model[part])
    for series in (whole, blocks):
        assert len(series.columns["seconds"]) <= MAX_BUCKETS
        assert series.columns["measured_j"].sum() == pytest.approx(measured.sum() * 0.1)
        assert series.columns["measured_high_w"].max() == 99.0
        assert series.columns["error_low_w"].min() == -89.0
        assert series.progress[-1] == pytest.approx(1.0)
        assert np.all(np.diff(series.columns["start_s"]) > 0)
