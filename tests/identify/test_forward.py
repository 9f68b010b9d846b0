"""Effects chosen by the prediction of left-out runs: the gates, on sums written out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.identify.data import Candidate, Column, Layout
from missionsim.identify.forward import _Search
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.settings import Settings


@pytest.mark.parametrize(
    ("sizes", "there"),
    [
        ((2.0, 3.0, 4.0), True),  # p = 0.035; left-out runs are predicted with 4.5 of 29
        ((1.0, 2.0, 6.0), False),  # 31.5 of 41
        ((-3.0, 3.0, 3.0), False),
    ],
)
def test_an_effect_that_halves_the_error_of_left_out_runs_is_there_though_its_size_differs(
    sizes: tuple[float, ...], there: bool
) -> None:
    driven = np.tile([0.0, 1.0], 200)
    folds = [np.vstack([size * driven, driven, np.ones(400), 10.0 + size * driven]) for size in sizes]
    squares = LeastSquares(np.array([f @ f.T for f in folds]), np.full(3, 400.0), np.zeros(0), np.arange(3))
    columns = [Column(number, number, f"{number}", 1.0) for number in range(5)]
    effect = Candidate("turning_scrub", ("0",))
    layout = Layout((), np.zeros(0), tuple(columns), 10.0, 1.0)
    search = _Search(squares, layout, [effect], Settings())
    trial = search.measured(0, [0], [])
    assert trial.p_value > 0.01
    assert trial.passed["robust"] is there
