"""Answers of a batch, with intervals that hold what they say."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.uncertainty.answers import describe, quantile_ranks, rank_importance


def test_quantiles_are_numpys() -> None:
    values = np.random.default_rng(8).normal(size=5001)
    found = describe(np.append(values, np.nan))
    for name, q in (("q05", 0.05), ("q50", 0.5), ("q99", 0.99)):
        assert found[name] == pytest.approx(np.quantile(values, q), rel=1e-12)
        low, high = found["intervals"][name]
        assert (low, high) == tuple(np.sort(values)[list(quantile_ranks(5001, q))])
        assert low < found[name] < high


def test_a_small_sample_does_not_bound_a_far_quantile() -> None:
    found = describe(np.arange(50.0))
    assert found["intervals"]["q99"][1] is None
    assert found["intervals"]["q01"][0] is None
    assert found["intervals"]["q50"][0] > 0.0


def test_first_order_index_from_the_sample_itself() -> None:
    rng = np.random.default_rng(2)
    switch, wide, idle = rng.choice([0.4, 5.0], p=[0.1, 0.9], size=4000), rng.normal(size=4000), rng.normal(size=4000)
    drawn = {"switch": switch, "wide": wide, "idle": idle}
    energies = {"a": 3.0 * switch, "b": 2.0 * wide + rng.normal(size=4000)}
    rows = {(row["battery"], row["parameter"]): row["first"] for row in rank_importance(drawn.items(), energies)}
    assert rows["a", "switch"] == pytest.approx(1.0)
    assert rows["b", "wide"] == pytest.approx(0.8, abs=0.03)
    assert rows["b", "idle"] < 0.02
    assert rows["a", "wide"] < 0.02
