"""Numbers in sentences: no powers of ten, one minus, a clock told in words."""

from __future__ import annotations

import math

import pytest

from missionsim.diagnose import words
from missionsim.numerals import bare, meter_clock, rounded, watts
from missionsim.report.page import format_cell
from missionsim.report.terminal import signed
from tests.diagnose.test_words import BATTERY, GRADE, HELD, replace


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (9356.2, "9,356 W"), (27154.0, "27,154 W"), (1.0, "1.00 W"), (0.0137, "0.0137 W"), (-0.32, "−0.320 W"),
        (9.996, "10.0 W"), (0.0, "0 W"), (math.nan, "– W"),
    ],
)  # fmt: skip
def test_watts_are_told_without_powers_of_ten(value: float, told: str) -> None:
    assert watts(value) == told


def test_a_table_of_the_terminal_and_one_of_a_page_hold_the_same_digits() -> None:
    for value in (9356.2, -0.0456, 12.345, 1.0):
        assert format_cell(value, 3) == rounded(value)
    assert signed(9356.2) == "+9,356"


def test_a_clock_is_early_or_late_in_words() -> None:
    assert meter_clock(-0.9, 0.0) == "0.90 s ahead of the motion, lag 0.00 s"
    assert meter_clock(0.3, 0.3) == "0.30 s behind the motion, lag 0.30 s"
    assert meter_clock(-0.001, 0.2) == "with the motion, lag 0.20 s"
    assert dict(words.report(replace(BATTERY, delay_s=-0.9)))["CLOCK"].startswith("meter 0.90 s ahead of the motion")


def test_a_p_value_is_never_nought() -> None:
    assert "p = 7e-21, p over runs 3e-19" in words.found_line(replace(GRADE, p_value=7e-21, p_runs=3e-19))
    assert "p < 1e-300, p over runs < 1e-300" in words.found_line(replace(GRADE, p_value=0.0, p_runs=1e-310))


def test_a_car_has_kilowatts_in_plain_digits() -> None:
    held = replace(BATTERY.heldout, power_rmse_w={name: 2000.0 * value for name, value in HELD.items()})
    assert "power RMSE 9,200 → 5,400 → 2,400 W" in dict(words.report(replace(BATTERY, heldout=held)))["HELD-OUT"]


def test_parameters_are_told_without_zeros_at_their_end_and_with_one_minus() -> None:
    assert [bare(value) for value in (1.0, 0.98, -362.14, 13470.2, 100.0)] == ["1", "0.98", "−362.1", "13,470", "100"]
    k = replace(GRADE.parameters["k"], low=-0.2)
    assert "k = 0.98 (95 % −0.2 to 1.01)" in words.found_line(replace(GRADE, parameters={"k": k}))


def test_beyond_that_is_said_once() -> None:
    left = replace(BATTERY.unexplained, shape="a load that comes and goes")
    energy = dict.fromkeys(HELD, 30.0)
    both = replace(BATTERY, unexplained=left, heldout=replace(BATTERY.heldout, energy_error_pct=energy))
    assert words.headline(both).count("Beyond that") == 1
    assert "The energy of the runs not used is off by 30.0 %" in words.headline(both)
