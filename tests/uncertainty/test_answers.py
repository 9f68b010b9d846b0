"""Answers of a batch: exact in bounded memory, with intervals that hold what they say."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionsim.uncertainty.answers import describe, quantile_interval, rank_importance
from missionsim.uncertainty.selection import moments, order_statistics


@given(
    st.lists(st.lists(st.floats(-1e6, 1e6) | st.sampled_from([0.0, 1.0, np.nan]), max_size=60), min_size=1, max_size=6),
    st.integers(1, 40),
)
def test_order_statistics_are_exact_in_any_memory(lists: list[list[float]], in_memory: int) -> None:
    blocks = [np.array(numbers, dtype=float) for numbers in lists]
    ordered = np.sort(np.concatenate(blocks))
    ordered = ordered[np.isfinite(ordered)]
    known = moments(lambda: blocks)
    assert known.count == len(ordered)
    if not known.count:
        return
    assert known.mean == pytest.approx(ordered.mean(), rel=1e-9, abs=1e-6)
    if known.count > 1:
        assert known.sd == pytest.approx(ordered.std(ddof=1), rel=1e-9, abs=1e-6)
    ranks = sorted({0, known.count // 3, known.count // 2, known.count - 1})
    assert order_statistics(lambda: blocks, ranks, known, in_memory) == {rank: ordered[rank] for rank in ranks}


def test_order_statistics_of_a_long_column_with_many_equal_numbers() -> None:
    def parts() -> Iterator[np.ndarray]:
        rng = np.random.default_rng(3)
        for _ in range(30):
            yield np.concatenate([rng.lognormal(size=2000), np.full(500, 2.0)])

    known = moments(parts)
    whole = np.sort(np.concatenate(list(parts())))
    ranks = [0, 700, len(whole) // 2, len(whole) - 10]
    assert order_statistics(parts, ranks, known, 4000) == {rank: whole[rank] for rank in ranks}


def test_quantiles_are_numpys() -> None:
    values = np.random.default_rng(8).normal(size=5001)
    found = describe(lambda: [values[:1000], values[1000:]])
    for name, q in (("q05", 0.05), ("q50", 0.5), ("q99", 0.99)):
        assert found[name] == pytest.approx(np.quantile(values, q), rel=1e-12)
        low, high = found["intervals"][name]
        assert (low, high) == quantile_interval(np.sort(values), q)
        assert low < found[name] < high


def test_a_small_sample_does_not_bound_a_far_quantile() -> None:
    found = describe(lambda: [np.arange(50.0)])
    assert found["intervals"]["q99"][1] is None
    assert found["intervals"]["q01"][0] is None
    assert found["intervals"]["q50"][0] > 0.0


def test_first_order_index_from_the_sample_itself() -> None:
    rng = np.random.default_rng(2)
    switch, wide, idle = rng.choice([0.4, 5.0], p=[0.1, 0.9], size=4000), rng.normal(size=4000), rng.normal(size=4000)
    drawn = {"switch": switch, "wide": wide, "idle": idle}
    energies = {"a": 3.0 * switch, "b": 2.0 * wide + rng.normal(size=4000)}
    rows = {(row["battery"], row["parameter"]): row["first"] for row in rank_importance(drawn, energies)}
    assert rows["a", "switch"] == pytest.approx(1.0)
    assert rows["b", "wide"] == pytest.approx(0.8, abs=0.03)
    assert rows["b", "idle"] < 0.02
    assert rows["a", "wide"] < 0.02
