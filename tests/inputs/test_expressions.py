"""Formulas: what is refused when they are read, and truth values that count as numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.labels import Labels


@pytest.mark.parametrize(
    ("text", "told", "column"),
    [
        ("k*where(v > 0, 1, 'a')", "a word stands alone", 22),
        ("'a'", "a word stands alone", 4),
        ("k*(v < 'a')", "a word stands alone", 11),
        ("k*(surface == 'a' + 'b')", "a word stands alone", 18),
        ("k*" + 400 * "9", "number is too large", 6),
        ("k*1e999", "number is too large", 6),
        ("k*2j", "not allowed", 6),
    ],
)
def test_what_no_row_could_evaluate_is_refused_when_read(text: str, told: str, column: int) -> None:
    with pytest.raises(InputError, match=told) as caught:
        compile_expression(text, file="a.yaml", line=1, column=4)
    assert caught.value.faults[0].column == column
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("(v > 1) - (v > 2)", [0.0, 1.0, 0.0]),
        ("-(v > 1)", [0.0, -1.0, -1.0]),
        ("(v > 1)**2", [0.0, 1.0, 1.0]),
        ("(v > 1)**(-1)", [np.inf, 1.0, 1.0]),
        ("True**v", [1.0, 1.0, 1.0]),
        ("not v > 1", [1.0, 0.0, 0.0]),
        ("(not v > 1) + (v > 0 and v < 3)", [2.0, 1.0, 0.0]),
        ("3 if v > 1 else v", [1.0, 3.0, 3.0]),
        ("abs(v > 1) * (surface == 'tile')", [0.0, 1.0, 0.0]),
        ("surface != 'tile'", [1.0, 0.0, 1.0]),
    ],
)
def test_truth_counts_as_one(text: str, value: list[float]) -> None:
    cov = {"v": np.array([1.0, 2.0, 3.0]), "surface": Labels.of(["ice", "tile", "ice"])}
    assert np.asarray(compile_expression(text).evaluate(cov)).tolist() == value
    alone = compile_expression(text).evaluate({"v": 2.0, "surface": "tile"})
    assert float(alone) == value[1]


@pytest.mark.parametrize("base", ["k*hypot(1e308,1e308)", "k*log(-1-v)", "k*9**(9**v*99)"])
def test_a_base_without_a_value_ends_with_a_message(
    root: Path, tmp_path: Path, base: str, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = root / "docs" / "examples" / "ramp_runs"
    out = str(tmp_path / "x.yaml")
    assert run_command(["calibrate", "--new", "x", "--base", base, str(logs / "run_00.csv"), "--out", out]) == 2
    told = capsys.readouterr().err
    assert "gives no number" in told or "run out of all numbers" in told
    assert not (tmp_path / "x.yaml").exists()
