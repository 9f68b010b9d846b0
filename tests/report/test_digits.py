"""A figure has the same digits wherever it is printed."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest

from missionsim.cli.app import run_command

ROOT = Path(__file__).resolve().parents[2]
PATROL = ROOT / "missions" / "pioneer3dx" / "valve_patrol.yaml"
DRIVEN = ROOT / "docs" / "examples" / "patrol_driven.csv"


def cells(text: str, first: str) -> list[str]:
    """The cells of the first row of a table that begins with a word."""
    row = next(line for line in text.splitlines() if line.startswith("│") and line[1:].strip().startswith(first))
    return [cell.strip() for cell in row.strip("│").split("│")]


def printed(arguments: list[str], capsys: pytest.CaptureFixture[str], code: int = 0) -> str:
    assert run_command(arguments) == code
    return capsys.readouterr().out


def test_run_and_whatif_print_energies_alike(capsys: pytest.CaptureFixture[str]) -> None:
    ran = printed(["run", str(PATROL)], capsys)
    tried = printed(["whatif", str(PATROL), "--vary", "defaults.speed=0.3"], capsys)
    _, used, _, _, left, share, *_ = cells(ran, "robot")
    baseline = [line for line in tried.splitlines() if line.startswith("│0 baseline")]
    assert used in cells(baseline[0], "0 baseline")
    assert {left, share} <= set(cells(baseline[1], "0 baseline"))


def test_terminal_and_page_of_a_comparison_print_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    command = ["compare", str(DRIVEN), "--robot", "pioneer3dx", "--mission", str(PATROL), "--report", str(page)]
    told = printed(command, capsys)
    drawn = html.unescape(page.read_text("utf-8")).replace("−", "-")
    shown = set(re.findall(r"(?<![\d.])[-+]?\d+\.\d+(?:e[-+]?\d+)?(?![\d.])", drawn))
    _, measured, model, error, rmse, bias, *_ = cells(told, "robot")
    assert {measured, model, *(cell.replace("−", "-") for cell in (error, rmse, bias))} <= shown


def test_a_table_of_the_terminal_has_one_minus(capsys: pytest.CaptureFixture[str]) -> None:
    tried = printed(
        ["whatif", str(PATROL.with_name("recharging_patrol.yaml")), "--vary", "defaults.speed=0.75"], capsys
    )
    told = printed(["compare", str(ROOT / "docs" / "examples" / "ramp_runs"), "--robot", "pioneer3dx"], capsys)
    for text in (tried, told):
        assert "−" in text
        assert not re.search(r"(?<![\w.-])-\d", "\n".join(line for line in text.splitlines() if line.startswith("│")))
