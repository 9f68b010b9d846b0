"""The waterfall in words: a rising energy error is told, and remains are never called nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from missionsim.diagnose import sentences, words
from missionsim.diagnose.improve import Improved
from missionsim.diagnose.waterfall import (
    Step,
    clearly_better,
    energy_note,
    measured_note,
    noise_floor,
    noted,
    power_of_floor,
    unseen_note,
    worse_note,
)
from missionsim.diagnose.words import stopped
from missionsim.identify.findings import Diagnosis, HeldOut, Unexplained
from missionsim.identify.noise import mean_variance
from missionsim.report.diagnosis_page import diagnosis_page, improve_page
from tests.diagnose.test_words import BATTERY, GRADE, HELD

NONE_NAMED = replace(BATTERY, effects=(), verdict="nothing_missing")
WANDERS = Unexplained(0.1, (), "the residual wanders by 3.6 % of the power")


def improved(after_pct: float, runs: int = 1) -> Improved:
    held = HeldOut("the last", tuple(f"run_{i}" for i in range(runs)), HELD, HELD)
    first = replace(BATTERY, heldout=held, runs=("a", "b", "c", "d"))
    steps = (
        Step("before", 2.3, 1.25),
        Step("recalibrated", 0.2, 1.22),
        Step("+ grade", after_pct, 0.57),
        Step("noise floor", 0.6, 0.34),
    )
    return Improved("robot", "", ("grade",), (), steps, True, first, replace(first, effects=()), stopped="stopped.")


def test_what_was_added_is_told_with_the_size_that_the_file_has() -> None:
    """And with the one that it was found with, where what came in later changed it."""
    done = replace(improved(0.1), written=(replace(GRADE, energy_share=0.045),))
    assert replace(done, asked={"grade": 0.199}).told == ("grade (4.5 % of the energy, 19.9 % when it was found)")
    law = replace(done, formulas={"grade": "k * max(-slope_rad, 0)"})
    assert law.told == "grade, k * max(-slope_rad, 0) (4.5 % of the energy)"
    done = replace(done, asked={"grade": 0.047})
    assert done.told == "grade (4.5 % of the energy)"
    assert "Added: grade (4.5 % of the energy). The power error" in improve_page("r", [done])


def test_energy_note_is_silent_where_both_errors_fall() -> None:
    assert energy_note(improved(0.1)) == ""
    assert energy_note(improved(0.495)) == ""  # by less than half of the floor's 0.6 %
    assert energy_note(improved(0.505)) != ""


# fitted to four: 0.6 sqrt(5/4) = 0.671; one run: 0.671 (1 + 2 sqrt(pi/2 - 1)) = 1.68 %; nine runs: with 2/3, 1.01 %
@pytest.mark.parametrize(
    ("after_pct", "runs", "told"),
    [
        (1.65, 1, "On 1 run even a model of the right form shows up to 1.7 %; this may be chance"),
        (1.75, 1, "this is more than that"),
        (1.65, 9, "On 9 runs even a model of the right form shows up to 1.0 %; this is more than that"),
    ],
)
def test_energy_note_weighs_the_rise_against_the_floor(after_pct: float, runs: int, told: str) -> None:
    note = energy_note(improved(after_pct, runs))
    assert note.startswith(
        f"With '+ grade' the energy error rises from 0.20 to {after_pct:.2f} % while the power "
        "error falls from 1.22 to 0.570 W"
    )
    assert "±0.8 % in these logs" in note
    assert told in note
    assert note in unescape(improve_page("r", [improved(after_pct, runs)]))


@pytest.mark.parametrize("left", [WANDERS, Unexplained(0.1, ("slope_rad",), "residual varies with slope_rad")])
def test_what_remains_is_never_called_nothing(left: Unexplained) -> None:
    quiet = replace(BATTERY, verdict="effects_found", unexplained=left)
    assert left.shape in stopped(replace(quiet, verdict="unexplained_structure"), ())
    assert stopped(NONE_NAMED, ()) == "nothing is left above the detection limits."
    assert stopped(BATTERY, ()) == "diagnose of the file names grade beside it: improve that file once more."
    told = stopped(replace(quiet, effects=()), ())
    assert "what remains" in told
    assert "nothing is left" not in told
    assert left.shape in words.headline(quiet)
    assert left.shape in dict(words.report(quiet))["REMAINS"]


@pytest.mark.parametrize(
    ("bias_w", "told"),
    [(-720.4, "−720 W"), (-1234.0, "−1,234 W"), (0.0123, "+0.012 W"), (4.07, "+4.1 W"), (0.0, "+0 W")],
)
def test_where_gives_watts_without_powers_of_ten(bias_w: float, told: str) -> None:
    where = replace(BATTERY.where[0], seconds=2.0, gap_j=-2.0 * bias_w)
    lines = dict(words.report(replace(BATTERY, where=(where,))))
    assert lines["WHERE"].endswith(f"model {told} against the meter")


def test_clocks_that_were_left_alone_are_not_called_found() -> None:
    assert dict(words.report(replace(BATTERY, aligned=False)))["CLOCK"] == "taken as logged"


def test_runs_that_got_worse_are_told_first() -> None:
    energy = {"nominal": 1.0, "recalibrated": 0.5, "with_effects": 1.2}
    rmse = {"nominal": 1.3, "recalibrated": 1.2, "with_effects": 0.6}
    held = HeldOut("the last run", ("run_05",), energy, rmse)
    worse = replace(BATTERY, heldout=held)
    told = sentences.worse(worse)
    assert told == (
        "WORSE on runs that were not used to fit: what was found raises the energy error from 1.00 % (0.50 % "
        "recalibrated) to 1.20 %, while the power error falls from 1.30 W (1.20 W recalibrated) to 0.600 W."
    )
    assert words.headline(worse).startswith("WORSE")
    assert "runs not used" not in sentences.sure(worse)  # the power says that it is there
    between = replace(held, energy_error_pct={**energy, "with_effects": 0.9})
    assert sentences.worse(replace(BATTERY, heldout=between)) == ""
    more = replace(held, energy_error_pct=rmse, power_rmse_w={**rmse, "with_effects": 1.25})
    assert "from 1.20 W recalibrated (1.30 W of the file)" in sentences.worse(replace(BATTERY, heldout=more))
    assert "see the runs not used" in sentences.sure(replace(BATTERY, heldout=more))
    # 2 W of the meter: standby_load for the standing power of the file, and as good to a hundredth of what was wrong
    same = replace(more, power_rmse_w={"nominal": 2.0, "recalibrated": 0.108, "with_effects": 0.1095})
    assert sentences.worse(replace(BATTERY, heldout=same)) == ""
    assert "see the runs not used" in sentences.sure(replace(BATTERY, heldout=same))
    same.power_rmse_w["with_effects"] = 0.114
    assert "raises the power error from 0.108 W recalibrated (2.00 W" in sentences.worse(replace(BATTERY, heldout=same))
    done = improved(3.0)
    assert done.worse
    page = unescape(improve_page("r", [done]))
    assert page.index(done.worse) < page.index("Added: grade")
    told, command = done.advice(sentences.Asked("r.yaml", ["train"]))
    assert told.startswith("For the power at each moment the new file is better, for the energy of a run the file with")
    assert command == ""


def test_next_does_not_call_what_remains_nothing() -> None:
    page = diagnosis_page(Diagnosis("r", {"robot": replace(BATTERY, unexplained=WANDERS, next_experiments=())}))
    assert "No drive of ours varies what remains" in page
    assert "Nothing is left" not in page


def test_a_diagnosis_tells_why_the_energy_error_rises_too() -> None:
    energy = {"nominal": 2.3, "recalibrated": 0.2, "with_effects": 2.3}
    rmse = {"nominal": 1.3, "recalibrated": 1.2, "with_effects": 0.6}
    rising = noted(replace(BATTERY, heldout=HeldOut("the last run", ("run_05",), energy, rmse)))
    note = rising.remarks[0]
    assert note.startswith("With the effect the energy error rises from 0.20 to 2.30 % while the power error falls")
    assert ("NOTE", note) in words.report(rising)
    assert note in rising.to_json()["remarks"]
    assert note in unescape(diagnosis_page(Diagnosis("r", {"robot": rising})))
    assert noted(BATTERY) is BATTERY
    assert noted(nothing := replace(rising, effects=(), remarks=())) is nothing


def test_the_noise_floor_is_what_runs_of_this_noise_show() -> None:
    rng = np.random.default_rng(1)
    noise, power_w, seconds, runs = BATTERY.noise, BATTERY.mean_power_w, 420, 4000
    total = np.zeros((runs, seconds))
    for part in ("fast", "slow"):
        keep, sd = math.exp(-1.0 / noise[f"{part}_s"]), noise["sd_w"] * math.sqrt(noise[f"{part}_share"])
        state = rng.normal(0.0, sd, runs)
        for i in range(seconds):
            total[:, i] += state
            state = keep * state + rng.normal(0.0, sd * math.sqrt(1.0 - keep**2), runs)
    total += rng.normal(0.0, noise["sd_w"] * math.sqrt(1.0 - noise["fast_share"] - noise["slow_share"]), total.shape)
    assert mean_variance(noise, seconds) == pytest.approx(np.var(total.mean(axis=1)) / noise["sd_w"] ** 2, rel=0.1)
    for sd_w in (noise["offset_w"], noise["gain"] * power_w, noise["motion_gain"] * power_w):
        total += rng.normal(0.0, sd_w, (runs, 1))
    energy_pct, rmse_w = noise_floor(BATTERY)
    assert energy_pct == pytest.approx(100.0 * np.mean(np.abs(total.mean(axis=1))) / power_w, rel=0.05)
    assert rmse_w == pytest.approx(np.sqrt(np.mean(total**2)), rel=0.02)


def test_a_step_that_makes_held_out_runs_worse_is_told_first_with_what_to_type() -> None:
    bars = (Step("before", 11.4, 43.0), Step("recalibrated", 4.0, 32.8), Step("+ grade", 5.3, 25.1))
    rising = replace(improved(1.0), added=("grade", "law_x"), steps=(*bars, Step("+ law_x", 3.3, 32.5), bars[0]))
    assert "law_x raises the power error from 25.1 to 32.5 W" in rising.worse  # below the recalibrated 32.8 W
    told, command = rising.advice(sentences.Asked("my robot.yaml", ["train"], "--holdout held"))
    assert "without law_x" in told
    assert "--robot 'my robot.yaml' --holdout held --yes --without law_x train --out" in command
    page = unescape(improve_page("r", [rising], advice={"robot": (told, command)}))
    assert page.index(rising.worse) < page.index("Added: grade, law_x")
    assert command in page
    first = replace(rising, added=("grade",), steps=(*bars[:2], Step("+ grade", 3.3, 34.0), bars[0]))
    assert first.advice(sentences.Asked("r.yaml", ["train"]))[1].startswith("missionsim calibrate --robot r.yaml train")
    falling = replace(rising, steps=(*bars[:2], Step("+ grade", 3.3, 34.0), Step("+ law_x", 3.3, 20.0), bars[0]))
    assert falling.worse == ""  # a step that the next one makes good
    assert falling.advice(sentences.Asked("r.yaml", ["train"])) == ("", "")


def test_an_error_that_only_recalibration_lowers_is_said_so() -> None:
    rmse = {"nominal": 16.9, "recalibrated": 7.47, "with_effects": 7.52}
    held = HeldOut("the last run", ("run_05",), {"nominal": 18.5, "recalibrated": 4.4, "with_effects": 4.5}, rmse)
    told = sentences.errors(replace(BATTERY, heldout=held))
    assert "ONLY 16.9" not in told
    assert "was 16.9 W, is 7.47 W with the base alone fitted anew, and NO LESS, 7.52 W, with it" in told
    command = sentences.next_step(replace(BATTERY, heldout=held), sentences.Asked("my.yaml", ["train"]))
    assert command.startswith("missionsim calibrate")


def test_nothing_is_called_complete_while_the_runs_not_used_are_far_off() -> None:
    """1.2 % is the floor of these logs: runs that are hotter than all that were fitted, 20 % off."""
    quiet = replace(NONE_NAMED, runs=("a", "b", "c", "d"))
    assert "No evidence of anything missing" in words.headline(quiet)
    assert stopped(quiet, ()) == "nothing is left above the detection limits."
    held = HeldOut("the last run", ("run_05",), {"nominal": 20.0, "recalibrated": 20.6, "with_effects": 20.6}, HELD)
    far = replace(quiet, heldout=held)
    shaped = replace(far, verdict="unexplained_structure", unexplained=replace(far.unexplained, shape="a load"))
    assert "a load" in stopped(shaped, ())
    for told in (words.headline(far), stopped(far, ()), stopped(shaped, ())):
        assert "something is missing that the fitted runs do not show" in told
        assert "20.0 %" in told
        assert "evidence" not in told
        assert "nothing is left" not in told
    mended = replace(far, heldout=replace(held, energy_error_pct={**held.energy_error_pct, "recalibrated": 1.3}))
    assert "fitted runs do not show" not in words.headline(mended)  # that is a base to be fitted anew


def test_a_base_that_is_off_is_told_with_the_command_that_fits_it() -> None:
    bars = (Step("before", 68.22, 111.0), Step("recalibrated", 0.86, 7.18), Step("noise floor", 0.9, 7.2))
    told, command = replace(improved(1.0), added=(), steps=bars).advice(
        sentences.Asked("my.yaml", ["train"], "--holdout held")
    )
    assert "from 68.22 to 0.86 %" in told
    assert command == "missionsim calibrate --robot my.yaml train --out my_better.yaml"
    energy, rmse = ({"nominal": a, "recalibrated": b, "with_effects": b} for a, b in ((68.22, 0.86), (111.0, 7.18)))
    quiet = replace(BATTERY, effects=(), verdict="nothing_missing", heldout=HeldOut("the last", ("e",), energy, rmse))
    assert "from 68.22 to 0.86 %" in sentences.errors(quiet)
    assert sentences.next_step(quiet, sentences.Asked("my.yaml", ["train"])) == command
    # one battery of several is fitted alone, by both commands
    for asked, several in (
        (sentences.Asked("my.yaml", ["train"]), True),
        (sentences.Asked("my.yaml", ["train"], "--battery robot"), False),
    ):
        alone = command.replace("my.yaml ", "my.yaml --battery robot ", 1)
        assert sentences.next_step(quiet, asked, several) == alone
        assert replace(improved(1.0), added=(), steps=bars).advice(asked, several)[1] == alone
    near = (Step("before", 0.9, 7.2), *bars[1:])
    assert replace(improved(1.0), added=(), steps=near).advice(sentences.Asked("my.yaml", ["train"])) == ("", "")
    # on the runs that it is fitted to, a base fitted anew is always better
    fitted = replace(improved(1.0), added=(), steps=bars, heldout=False)
    assert fitted.advice(sentences.Asked("my.yaml", ["train"]))[1] == command
    steps = (Step("before", 1.1, 7.8), *bars[1:])
    assert replace(fitted, steps=steps).advice(sentences.Asked("my.yaml", ["train"])) == ("", "")
    assert replace(fitted, steps=steps, heldout=True).advice(sentences.Asked("my.yaml", ["train"]))[1] == command


def test_a_model_beside_which_something_remains_is_not_good() -> None:
    done = improved(0.1)
    left = "something remains that the library does not contain: a load."
    assert "verdict warn" in improve_page("r", [replace(done, stopped=left)])
    assert "verdict good" in improve_page("r", [replace(done, stopped=stopped(NONE_NAMED, ()))])
    assert "verdict bad" in improve_page("r", [replace(improved(3.0), stopped=stopped(NONE_NAMED, ()))])


def test_a_noise_floor_that_no_model_is_above_is_told_as_a_bound() -> None:
    clear = improved(0.7)
    assert "noise floor" not in measured_note(clear)
    assert power_of_floor(clear.steps) == "0.340"
    cut = replace(clear, steps=(*clear.steps[:-1], Step("noise floor", 0.6, 0.57)))
    assert power_of_floor(cut.steps) == "≤ 0.570"
    assert "≤ 0.570" in improve_page("r", [cut])
    assert "at most the error of the last model" in measured_note(cut)
    lucky = measured_note(improved(0.3, runs=4))  # 0.6 (1 ± 2 sqrt(pi/2 - 1) / 2)
    assert "over 4 runs a true model shows 0.15 to 1.05 %" in lucky


@pytest.mark.parametrize(("floors", "told"), [(2.9, False), (3.1, True)])
def test_runs_that_are_off_by_three_noise_floors_are_told(floors: float, told: bool) -> None:
    error_pct = floors * noise_floor(BATTERY)[0] * math.sqrt(2.0)  # fitted to one run: twice its variance
    held = HeldOut("the last run", ("run_05",), {"nominal": error_pct, "recalibrated": error_pct}, HELD)
    assert bool(unseen_note(replace(BATTERY, heldout=held))) is told


@pytest.mark.parametrize(
    ("beyond", "told"),
    [
        (("temp_ambient_c",), "; they lie beyond the fitted ones in temp_ambient_c"),
        (
            ("on_camera (on in them, never in the fitted ones)", "payload_kg"),
            "; they lie beyond the fitted ones in payload_kg; on_camera is on in them, never in the fitted ones",
        ),
        (("on_camera (never on in them)",), " what differs in them; on_camera is never on in them"),
    ],
)
def test_what_differs_in_the_runs_not_used_is_told_as_it_is(beyond: tuple[str, ...], told: str) -> None:
    """Of a switch it was said that they lie beyond the fitted ones in it."""
    held = HeldOut("the last run", ("run_05",), {"nominal": 50.0, "recalibrated": 50.0}, HELD, beyond=beyond)
    assert unseen_note(replace(BATTERY, heldout=held)).endswith(told)


@pytest.mark.parametrize(
    ("energy_pct", "power_w", "better"),
    [(1.0, 94.5, True), (1.0, 95.5, False), (1.004, 50.0, True), (1.006, 50.0, False)],
)
def test_a_recalibration_that_is_clearly_better(energy_pct: float, power_w: float, better: bool) -> None:
    assert clearly_better(Step("recalibrated", energy_pct, power_w), Step("before", 1.0, 100.0)) is better


@pytest.mark.parametrize(
    ("powers_w", "energy_pct", "worse"),
    [
        ((30.0, 20.0, 20.15), 1.0, False),  # 1 % above the better of file and recalibration
        ((30.0, 20.0, 20.25), 1.0, True),
        ((20.0, 30.0, 20.25), 1.0, True),
        ((30.0, 20.0, 10.0, 10.08), 1.0, False),
        ((30.0, 20.0, 10.0, 10.12), 1.0, True),
        ((30.0, 20.0, 10.0), 1.004, False),
        ((30.0, 20.0, 10.0), 1.006, True),
    ],
)
def test_what_counts_as_worse(powers_w: tuple[float, ...], energy_pct: float, worse: bool) -> None:
    bars = [Step("", energy_pct if i == len(powers_w) - 1 else 1.0, power) for i, power in enumerate(powers_w)]
    assert bool(worse_note(bars, ["grade", "payload"])) is worse


def test_worse_is_told_of_the_bar_that_predicts_best() -> None:
    """It was "raises the power error from 27.6 W recalibrated to 3.10 W", and the energy "falls"."""
    pairs = [(17.55, 27.9), (15.01, 27.6), (0.47, 2.89), (2.84, 3.1)]
    told = worse_note([Step("", *pair) for pair in pairs], ("the effects", "the law"), what="what was found")
    assert told.endswith(
        "the law raises the power error from 2.89 to 3.10 W, while the energy error goes from 0.47 to 2.84 %."
    )
