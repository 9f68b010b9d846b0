"""The plan of a small site is the best of all that there are."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.planner.exhaustive import compare


def _same(seed: int, folder: Path) -> None:
    expected, found, answer = compare(seed, folder)
    if math.isinf(expected):
        assert math.isinf(found), (seed, found)
    else:
        assert found == pytest.approx(expected, rel=1e-9), seed
        assert answer.gap <= 1e-9, seed


@pytest.mark.parametrize("seed", [1, 2, 3, 5, 6, 7, 8, 9, 11, 35])
def test_equal_to_enumeration(seed: int, tmp_path: Path) -> None:
    _same(seed, tmp_path)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(1000, 2000))
def test_equal_to_enumeration_a_thousand_times(seed: int, tmp_path: Path) -> None:
    _same(seed, tmp_path)
