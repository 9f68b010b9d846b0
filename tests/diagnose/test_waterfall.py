"""The waterfall in words: a rising energy error is told, and remains are never called nothing."""

from __future__ import annotations

from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest

from missionsim.diagnose import words
from missionsim.diagnose.findings import Diagnosis, HeldOut, Unexplained
from missionsim.diagnose.improve import Improved, Step, _why, improve
from missionsim.diagnose.split import choose_split
from missionsim.diagnose.waterfall import energy_note
from missionsim.identify.data import Settings
from missionsim.logs import read_logs
from missionsim.report.diagnosis_page import diagnosis_page
from missionsim.report.improve_page import improve_page
from missionsim.spec.loading import shipped_robots
from tests.diagnose.test_words import BATTERY, HELD

RAMPS = Path(__file__).parents[2] / "docs" / "examples" / "ramp_runs"
WANDERS = Unexplained(0.1, (), "the residual wanders by 3.6 % of the power")


def improved(after_pct: float, runs: int = 1) -> Improved:
    held = HeldOut("the last", tuple(f"run_{i}" for i in range(runs)), HELD, HELD)
    first = replace(BATTERY, heldout=held)
    steps = (Step("before", 2.3, 1.25), Step("recalibrated", 0.2, 1.22), Step("+ grade", after_pct, 0.57),
             Step("noise floor", 0.6, 0.34))
    return Improved("robot", "", ("grade",), (), steps, True, first, replace(first, effects=()), "stopped.")


def test_energy_note_is_silent_where_both_errors_fall() -> None:
    assert energy_note(improved(0.1)) == ""
    assert energy_note(improved(0.255)) == ""  # by less than a tenth of the floor's 0.6 %


# one run: 0.6 (1 + 2 sqrt(pi/2 - 1)) = 1.51 %; nine runs: 0.6 (1 + 2/3 sqrt(pi/2 - 1)) = 0.90 %
@pytest.mark.parametrize(("after_pct", "runs", "told"), [
    (1.45, 1, "up to 1.5 %; what is left may be chance"), (1.55, 1, "is more than noise and meters make"),
    (1.45, 9, "up to 0.9 %; what is left is more than noise and meters make"),
])  # fmt: skip
def test_energy_note_weighs_the_rise_against_the_floor(after_pct: float, runs: int, told: str) -> None:
    note = energy_note(improved(after_pct, runs))
    assert note.startswith(f"With '+ grade' the energy error rises from 0.20 to {after_pct:.2f} %")
    assert told in note
    assert note in unescape(improve_page("r", [improved(after_pct, runs)]))


@pytest.mark.parametrize("left", [WANDERS, Unexplained(0.1, ("slope_rad",), "residual varies with slope_rad")])
def test_what_remains_is_never_called_nothing(left: Unexplained) -> None:
    quiet = replace(BATTERY, verdict="effects_found", unexplained=left)
    assert _why(BATTERY, ()) == "nothing is left above the detection limits."
    assert "what remains" in _why(quiet, ())
    assert "nothing is left" not in _why(quiet, ())
    assert left.shape in words.headline(quiet)
    assert left.shape in dict(words.report(quiet))["REMAINS"]


@pytest.mark.parametrize(("bias_w", "told"), [(-720.4, "−720 W"), (-1234.0, "−1200 W"), (0.0123, "+0.012 W"),
                                              (4.07, "+4.1 W"), (0.0, "+0 W")])  # fmt: skip
def test_where_gives_watts_without_powers_of_ten(bias_w: float, told: str) -> None:
    lines = dict(words.report(replace(BATTERY, where=(replace(BATTERY.where[0], bias_w=bias_w),))))
    assert lines["WHERE"].endswith(f"model {told} against the meter")


def test_next_does_not_call_what_remains_nothing() -> None:
    page = diagnosis_page(Diagnosis("r", {"robot": replace(BATTERY, unexplained=WANDERS, next_experiments=())}))
    assert "No drive of ours varies what remains" in page
    assert "Nothing is left" not in page


def test_the_bar_of_an_added_effect_is_the_error_that_the_diagnosis_promised() -> None:
    text = shipped_robots()["pioneer3dx"].read_text(encoding="utf-8")
    split = choose_split(read_logs([RAMPS]), None)
    done = improve(text, split, "robot", Settings(), lambda *_: True)
    assert done.added == ("grade",)
    assert done.first.heldout is not None
    bar = {step.name: step for step in done.steps}["+ grade"]
    assert bar.energy_error_pct == pytest.approx(done.first.heldout.energy_error_pct["with_effects"], abs=0.1)
    assert bar.power_rmse_w == pytest.approx(done.first.heldout.power_rmse_w["with_effects"], rel=0.05)
