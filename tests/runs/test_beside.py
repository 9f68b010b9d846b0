"""One run against what the others say of it, in cases just on both sides of each number."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from missionsim.labels import Labels
from missionsim.runs import beside

WAVE = np.sin(np.arange(400) * 2.0 * np.pi / 400)
OTHER = np.cos(np.arange(400) * 2.0 * np.pi / 400)


def of_run(number: int, **columns: np.ndarray) -> Any:
    return SimpleNamespace(run=f"{number}", columns=columns, number=columns.__getitem__)


def others(measured: Sequence[np.ndarray], scatter: Sequence[float], residual: float = 0.0) -> Any:
    """What the others say of each run is one wave about 10 W."""
    count = len(measured)
    runs = [SimpleNamespace(run=of_run(i), measured_w={"robot": w}) for i, w in enumerate(measured)]
    own = SimpleNamespace(runs=runs, battery="robot", left=np.ones(count, dtype=bool), scatter=np.array(scatter))
    own.said, own.late, own.residual = lambda _: 10.0 + WAVE, lambda _: 0, lambda *_: residual
    own.learn = lambda: None
    return own


@pytest.mark.parametrize(
    ("rest", "scatter", "looked_at"), [(5, 1.35, False), (5, 1.45, True), (4, 9.0, True), (3, 9.0, False)]
)
def test_a_run_rougher_than_the_others_is_looked_at(
    monkeypatch: pytest.MonkeyPatch, rest: int, scatter: float, looked_at: bool
) -> None:
    monkeypatch.setattr(beside, "_fault", lambda *_: "fault")
    monkeypatch.setattr(beside, "_stuck", lambda *_: {})
    own = others([WAVE] * (rest + 1), [1.0] * rest + [scatter])
    assert (f"{rest}" in beside.runs_beside(own, None)) is looked_at


@pytest.mark.parametrize(
    ("usual", "part", "told"), [(0.9, 0.08, True), (0.9, 0.12, False), (0.62, 0.05, True), (0.58, 0.05, False)]
)
def test_a_run_that_follows_nothing_where_the_others_follow_the_motion(
    monkeypatch: pytest.MonkeyPatch, usual: float, part: float, told: bool
) -> None:
    """Part of the variance that goes with the motion, in the others and, of that, in the last."""
    monkeypatch.setattr(beside, "_fault", lambda *_: "")
    monkeypatch.setattr(beside, "_stuck", lambda *_: {})
    powers = [np.sqrt(r) * WAVE + np.sqrt(1.0 - r) * OTHER for r in [usual] * 5 + [usual * part]]
    assert bool(beside.runs_beside(others(powers, [1.0] * 5 + [2.0]), None)) is told


@pytest.mark.parametrize(
    ("scatter", "residual", "explained"), [(9.0, 1.15, True), (9.0, 1.25, False), (1.5, 0.85, True), (1.5, 0.95, False)]
)
def test_a_fault_that_explains_why_a_run_scatters(
    monkeypatch: pytest.MonkeyPatch, scatter: float, residual: float, explained: bool
) -> None:
    """The run as it was, and mended, where the others scatter by 1 W."""
    monkeypatch.setattr(beside, "mended", lambda *_: [("a fault", None)])
    monkeypatch.setattr(beside, "drive", lambda *_: None)
    monkeypatch.setattr(beside, "_unlogged_switching", lambda *_: [])
    own = others([10.0 + WAVE] * 6, [1.0] * 5 + [scatter], residual)
    own.left[5] = False
    assert beside._fault(own, 5, None) == ("a fault" if explained else "")


@pytest.mark.parametrize(("usual", "gain", "told"), [(0.2, 0.27, False), (0.2, 0.33, True), (0.0, 0.09, False)])
def test_a_gain_beyond_those_of_the_others(
    monkeypatch: pytest.MonkeyPatch, usual: float, gain: float, told: bool
) -> None:
    """Logarithms of the gains: floors and loads have one too."""
    monkeypatch.setattr(beside, "replace", lambda one, **_: one)
    monkeypatch.setattr(beside, "mended", lambda *_: [])
    monkeypatch.setattr(beside, "_unlogged_switching", lambda *_: [])
    own = others([np.exp(g) * (10.0 + WAVE) for g in [0.0, usual] * 3 + [gain]], [1.0] * 6 + [9.0], 0.5)
    own.left[6] = False
    assert ("times that of the other runs" in beside._fault(own, 6, None)) is told


@pytest.mark.parametrize(("gains", "told"), [((0.0, -0.02, -0.03), True), ((0.0, -0.02, -0.15), False)])
def test_a_gain_that_the_weather_explains(
    monkeypatch: pytest.MonkeyPatch, gains: tuple[float, ...], told: bool
) -> None:
    """Friction that falls with heat: on the hottest of twelve days a rover drew 0.79 times what it draws else, and was
    called another meter, though it drew less on all warm days too."""
    monkeypatch.setattr(beside, "replace", lambda one, **_: one)
    monkeypatch.setattr(beside, "mended", lambda *_: [])
    monkeypatch.setattr(beside, "_unlogged_switching", lambda *_: [])
    every = [*gains, *gains, -0.24]
    own = others([np.exp(g) * (10.0 + WAVE) for g in every], [1.0] * 6 + [9.0], 0.5)
    for i, (one, gain) in enumerate(zip(own.runs, every, strict=True)):
        one.run = of_run(i, temp_ambient_c=np.full(400, 20.0 - 50.0 * gain))
    own.left[6] = False
    assert ("times that of the other runs" in beside._fault(own, 6, None)) is told


@pytest.mark.parametrize(
    ("levels", "mean_w", "told"),
    [
        ((0.0,) * 8 + (0.56,), 10.0, False),
        ((0.0,) * 8 + (0.64,), 10.0, True),
        ((-0.1, 0.1) * 5 + (-4.0, 0.8), 1.0, False),  # six of the deviations of all, where one run lies far off
        ((-0.1, 0.1) * 5 + (-4.0, 1.1), 1.0, True),
        ((0.0, 1.0) * 4 + (3.3,) * 3, 1.0, False),  # two groups that lie apart by 2.3 or 2.7 times the wider
        ((0.0, 1.0) * 4 + (3.7,) * 3, 1.0, True),
    ],
)
def test_an_offset_of_a_meter(
    monkeypatch: pytest.MonkeyPatch, levels: tuple[float, ...], mean_w: float, told: bool
) -> None:
    """Levels of the runs, at rest and in motion alike; whether the last one is told."""
    own = others([np.full(400, mean_w)] * len(levels), [1.0] * len(levels))
    for one in own.runs:
        one.covariates = {"speed_m_s": 1.0 + WAVE}
    own.beside = lambda i: np.full(400, levels[i])
    monkeypatch.setattr(beside, "_levels", lambda _, gap: {(moving,): (float(gap[0]), 200) for moving in (0.0, 1.0)})
    monkeypatch.setattr(beside, "_spread", lambda *_: 0.0)
    monkeypatch.setattr(beside, "_explained", lambda *_: False)
    assert (own.runs[-1].run.run in beside.offsets(own)) is told


@pytest.mark.parametrize(
    ("column", "explains"), [("access_point_distance_m", True), ("cpu_load", True), ("x_m", False)]
)
def test_an_offset_that_a_logged_load_explains(column: str, explains: bool) -> None:
    """The run far from the access point takes 8 W more, and so would any other that far."""
    own = others([np.full(400, 10.0)] * 8 + [np.full(400, 18.0)], [1.0] * 9)
    for i, one in enumerate(own.runs):
        one.model_w = {"robot": np.full(400, 10.0)}
        one.run = of_run(i, **{column: (0.9 if i == 8 else 0.3) * (1.1 + WAVE)})
    assert beside._explained(own.runs[8], own.runs, "robot", 8.0) is explains


def test_a_run_without_any_text_has_the_levels_of_no_floor() -> None:
    columns = {"surface": Labels.of([""] * 30)}
    driven = SimpleNamespace(run=SimpleNamespace(columns=columns), covariates={"speed_m_s": np.ones(30)})
    assert beside._levels(driven, np.full(30, 2.0)) == {(1.0, ""): (2.0, 30)}  # type: ignore[arg-type]
