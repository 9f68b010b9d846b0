"""Streams of random numbers: by name and run, whatever else is drawn."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from missionsim.uncertainty.streams import run_generator, uniforms


@given(st.integers(0, 2**40), st.text(max_size=20), st.integers(0, 10_000), st.integers(1, 50), st.integers(0, 49))
def test_a_run_has_the_same_number_in_any_block(seed: int, name: str, first: int, count: int, offset: int) -> None:
    block = uniforms(seed, name, first, count)
    alone = uniforms(seed, name, first + offset % count, 1)
    assert block[offset % count] == alone[0]


def test_streams_are_uniform_and_independent_of_each_other() -> None:
    one, two = uniforms(7, "a", 0, 200_000), uniforms(7, "b", 0, 200_000)
    assert stats.kstest(one, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.01
    assert abs(np.corrcoef(one[1:], one[:-1])[0, 1]) < 0.01
    assert one.min() > 0.0
    assert one.max() < 1.0


def test_seeds_and_names_change_the_numbers() -> None:
    base = uniforms(1, "a", 0, 8)
    assert not np.any(base == uniforms(2, "a", 0, 8))
    assert not np.any(base == uniforms(1, "aa", 0, 8))


def test_generators_of_runs_repeat_and_differ() -> None:
    first = run_generator(3, "dwell", 5).random(4)
    assert np.array_equal(first, run_generator(3, "dwell", 5).random(4))
    assert not np.any(first == run_generator(3, "dwell", 6).random(4))
