"""The report in words: every heading of the skeleton, and never 'the cause is' for a set of two."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from missionsim.compare import Where
from missionsim.diagnose import adopt, sentences, words
from missionsim.diagnose.words import stopped
from missionsim.files import to_json
from missionsim.identify.findings import (
    BatteryDiagnosis,
    Diagnosis,
    Estimate,
    Experiment,
    Finding,
    HeldOut,
    Judged,
    Recalibrated,
    Unexplained,
)
from missionsim.report.diagnosis_page import diagnosis_page, diagnosis_sections
from missionsim.report.page import Chart

WHERE = Where(
    **{"by": "slope_rad", "title": "slope", "unit": "°", "value": "2 to 4", "low": 2.0, "high": 4.0},
    **{"share_of_gap": 0.5, "share_of_squared_error": 0.4, "explains": 0.3},
    **{"gap_j": 90.0, "seconds": 60.0, "square_w2s": 200.0},
)
GRADE = Finding(
    effect="grade",
    parameters={"k": Estimate(0.98, 0.95, 1.01)},
    energy_share=0.033,
    p_value=1e-9,
    share_low=0.030,
    share_high=0.036,
    p_runs=2e-9,
    level="identified, repeated across runs",
    heldout_rmse_before_w=1.8,
    heldout_rmse_after_w=0.5,
)
PAYLOAD = Finding(
    effect="payload",
    parameters={"k": Estimate(0.7, 0.6, 0.8, "m/s^2")},
    energy_share=0.05,
    p_value=1e-7,
    share_low=0.04,
    share_high=0.06,
    indistinguishable_from=("surface_rolling_resistance",),
    separation_nats=0.0,
)
HELD = {"nominal": 4.6, "recalibrated": 2.7, "with_effects": 1.2}
BATTERY = BatteryDiagnosis(
    battery="robot",
    verdict="effects_found",
    effects=(GRADE,),
    candidates=(
        Judged("aerodynamic_drag", False, "adds nothing", 0.011),
        Judged("conversion_loss", False, "adds nothing", 1.4),
    ),
    recalibration=(
        Recalibrated(
            parameter="c3", shift=0.042, shift_sd=0.02, shift_in_prior_sd=1.4, value=10.2, sd=0.2, unit="W s/m"
        ),
    ),
    delay_s=0.3,
    lag_s=0.3,
    clock_at_edge=False,
    noise={
        "sd_w": 0.4,
        "sd_share": 0.03,
        "fast_s": 4.0,
        "slow_s": 40.0,
        "fast_share": 0.5,
        "slow_share": 0.3,
        "offset_w": 0.18,
        "gain": 0.01,
        "motion_gain": 0.008,
    },
    untestable={"radio_range": ("access_point_distance_m",)},
    unexplained=Unexplained(0.0, (), ""),
    next_experiments=(),
    heldout=HeldOut("the last 2 runs of 8", ("run_06", "run_07"), HELD, HELD),
    shifted=None,
    execution=(),
    mean_power_w=13.0,
    runs=("run_00",),
    seconds=420.0,
    remarks=(),
    where=(WHERE,),
)


def text(battery: BatteryDiagnosis) -> str:
    return "\n".join(f"{heading} {line}" for heading, line in words.report(battery))


def test_found() -> None:
    assert words.headline(BATTERY) == (
        "Climbing costs 3.3 % of the energy that the model does not know; that is grade."
    )
    told = text(BATTERY)
    assert "WHERE slope 2 to 4 °: 40 % of the squared error" in told
    assert "CLOCK meter 0.30 s behind the motion, lag 0.30 s (applied)" in told
    assert "NOISE 0.40 W (3.1 % of the mean power), lasting 4 to 40 s\n" in told  # of one run nothing is known beyond
    several = text(replace(BATTERY, runs=("run_00", "run_01")))
    assert "lasting 4 to 40 s; runs differ by ±0.18 W and ±1.0 % (meter), ±0.8 % of the power (drive)\n" in several
    assert "grade: 3.3 % of energy (95 % 3.0 to 3.6); k = 0.98 (95 % 0.95 to 1.01)" in told
    assert "aerodynamic_drag < 1.1 % of energy; these data say nothing of conversion_loss" in told
    assert "energy error 4.60 → 2.70 (recalibrated) → 1.20 % (with the effects)" in told
    assert "BASE recalibrated, no discovery: c3 +4.2 % (+1.4 sd)" in told
    assert "UNTESTABLE without access_point_distance_m: radio_range" in told


def test_what_may_be_a_misfit_of_an_effect_that_is_named_may_be_another_form_of_it() -> None:
    floors = replace(PAYLOAD, effect="surface_rolling_resistance", indistinguishable_from=("grade",), p_value=0.016)
    battery = replace(BATTERY, effects=(GRADE, floors))
    either = "surface_rolling_resistance or another form of grade"
    assert f"{either}. These data cannot tell which." in words.headline(battery)
    assert "UNSURE surface_rolling_resistance OR another form of grade, 5.0 % of energy" in text(battery)
    assert stopped(battery, []).startswith(f"these data cannot tell {either}, so neither is added.")
    # what is sure is what is named
    assert sentences.sure(battery) == sentences.sure(BATTERY)


def test_that_whole_runs_show_it_is_told_of_the_effects_of_which_they_do() -> None:
    assert sentences.sure(BATTERY).endswith("; with whole runs as the sample it is there too.")
    scrub = replace(GRADE, effect="turning_scrub", level="identified", p_value=1e-8)
    told = sentences.sure(replace(BATTERY, effects=(GRADE, scrub)))
    assert told.endswith("; with whole runs as the sample grade shows too, turning_scrub does not.")
    assert sentences.sure(replace(BATTERY, effects=(scrub,))).endswith("; runs alone are too few to show it.")


def test_what_cannot_be_tested_stands_by_the_column_that_is_missing() -> None:
    needs = {"cpu_load": ("cpu_load",), "grade": ("slope_rad",), "cpu_frequency": ("cpu_freq_hz", "cpu_load")}
    lines = [line for heading, line in words.report(replace(BATTERY, untestable=needs)) if heading == "UNTESTABLE"]
    assert lines == ["without cpu_load: cpu_load, cpu_frequency (and cpu_freq_hz)", "without slope_rad: grade"]


def test_a_parameter_at_its_bound_or_without_a_width_is_told_in_words() -> None:
    floors = {"k_ice": Estimate(1e-9, -94.0, 94.0, "N"), "k_snow": Estimate(80.0, -20.0, 180.0, "N")}
    found = Finding(effect="surface_rolling_resistance", parameters=floors, energy_share=0.1, p_value=1e-6)
    assert words.parameters_told(found) == "k_ice = 0 N, its least (95 % up to 94), k_snow = 80 N (95 % −20 to 180)"
    back = {"regeneration": Estimate(0.81, 0.42, 1.2), "relief": Estimate(1.0, 1.0, 1.0)}
    braking = replace(found, effect="grade", parameters=back)
    assert words.parameters_told(braking) == "regeneration = 0.81 (95 % 0.42 to 1), relief = 1 (chosen, not fitted)"
    notes = [adopt._noted(estimate).get("note") for estimate in (floors["k_ice"], floors["k_snow"], back["relief"])]
    assert notes == ["none, its least", None, "chosen, not fitted"]  # of the file that has it
    full = replace(braking, parameters={"regeneration": Estimate(1.0, 0.9, 1.1)})
    assert words.parameters_told(full) == "regeneration = 1, its most (95 % down to 0.9)"


def test_a_candidate_of_the_robot_file_is_told_by_its_name_and_once() -> None:
    """Not "Camera_off takes less …; that is camera_off."."""
    less = {"k": Estimate(-0.57, -0.7, -0.4, "W")}
    own = Finding(effect="camera_off", parameters=less, energy_share=-0.037, p_value=1e-9)
    assert words.headline(replace(BATTERY, effects=(own,))) == (
        "The effect camera_off takes 0.570 W less than the model says (3.7 % of the energy)."
    )


def test_a_share_of_which_much_comes_back_is_told_net() -> None:
    """Not 112 % of the energy; nor is what comes back taken once more."""
    back = {**GRADE.parameters, "regeneration": Estimate(0.7, 0.6, 0.8)}
    speeding = replace(GRADE, effect="acceleration", parameters=back, energy_share=1.93, back=0.81, share_low=1.551)
    speeding = replace(speeding, share_high=2.24)
    one = replace(BATTERY, effects=(speeding,))
    assert words.headline(one).startswith(
        "Changing speed costs 31.0 % of the energy (112.0 % taken, 81.0 % given back)"
    )
    assert "acceleration: 31.0 % of energy: 112.0 % (95 % 90.0 to 130.0) taken, 81.0 % given back" in text(one)
    page = diagnosis_page(Diagnosis("r", {"robot": one}))
    assert '<div class="tile-value">31.0 % of the energy</div>' in page


@pytest.mark.parametrize(
    ("effects", "told"),
    [((GRADE,), " with it "), ((GRADE, PAYLOAD), " with grade and payload or surface_rolling_resistance ")],
)
def test_what_the_next_command_does_not_add_is_named_with_the_error(effects: tuple[Finding, ...], told: str) -> None:
    """ "0.521 W with it", of a payload that may be the floor; the command to type next reached 1.09 W."""
    assert told in sentences.errors(replace(BATTERY, effects=effects))


def test_nothing_is_excluded_of_what_may_be_the_cause() -> None:
    rival = Judged("surface_rolling_resistance", False, "these data cannot tell it from payload", 0.004, open=True)
    unsure = replace(BATTERY, effects=(PAYLOAD,), candidates=(*BATTERY.candidates, rival))
    lines = words.report(unsure)
    assert "surface_rolling_resistance" not in dict(lines)["NOT SEEN"]
    assert ("NEXT", "no manoeuvre that we know, driven for twelve minutes, tells any of these apart") in lines


def test_without_effects_there_is_no_error_with_them() -> None:
    line = dict(words.report(replace(BATTERY, effects=())))["HELD-OUT"]
    assert line == (
        "the last 2 runs of 8 (same kind): energy error 4.60 → 2.70 % (recalibrated); power RMSE 4.60 → 2.70 W"
    )


def test_a_base_that_is_far_off_is_no_mere_recalibration() -> None:
    far = replace(BATTERY.recalibration[0], parameter="kinect.power", shift=-21.0 / 100.0, shift_in_prior_sd=-7.0)
    lines = [
        line
        for heading, line in words.report(replace(BATTERY, recalibration=(far, *BATTERY.recalibration)))
        if heading == "BASE"
    ]
    assert lines[0] == "recalibrated, no discovery: c3 +4.2 % (+1.4 sd)"
    assert lines[1].startswith("further off than its sd allows")
    assert lines[1].endswith("kinect.power −21.0 % (−7.0 sd)")


def test_what_helps_but_is_not_named_is_told() -> None:
    doubtful = Judged("standby_load", False, "helps, but its form is not right", 0.04, True, 0.152)
    lines = words.report(replace(BATTERY, candidates=(doubtful,)))
    assert ("DOUBTFUL", "standby_load: 15.2 % of energy; not named: helps, but its form is not right") in lines
    assert "standby_load" not in dict(lines)["NOT SEEN"]


def test_clocks_at_the_edge_are_part_of_the_headline() -> None:
    quiet = replace(BATTERY, verdict="nothing_missing", effects=(), clock_at_edge=True)
    assert words.headline(quiet).endswith("further apart than what is searched: check them first.")


def test_a_duration_is_told_once() -> None:
    still = Experiment(("time_s",), "stand still, 3 min", math.nan, math.nan, math.nan, 3.0)
    assert words.next_line(still) == "stand still, 3 min"
    assert words.next_line(replace(still, do="turn, 1 min each")) == "turn, 1 min each (3 min)"


def test_a_set_of_two_is_never_called_the_cause() -> None:
    experiment = Experiment(("payload", "surface_rolling_resistance"), "drive tile then carpet", 0.99, 0.0, 70.0, 3.0)
    unsure = replace(BATTERY, verdict="ambiguous", effects=(PAYLOAD,), next_experiments=(experiment,))
    head = words.headline(unsure)
    assert "payload or surface_rolling_resistance" in head
    assert "These data cannot tell which" in head
    told = text(unsure)
    assert "UNSURE payload OR surface_rolling_resistance, 5.0 % of energy: these data cannot tell" in told
    assert "more of the same data will not help" in told
    assert "predicted separation 0.0 → 70 nats" in told
    assert "cause" not in f"{head} {told}"
    assert "FOUND" not in told


def test_nothing_and_something_unknown() -> None:
    nothing = replace(BATTERY, verdict="nothing_missing", effects=())
    assert "nothing missing above" not in words.headline(BATTERY)
    assert "No evidence of anything missing above the detection limits (1.1 to 1.1 % of" in words.headline(nothing)
    unknown = replace(
        nothing, verdict="unexplained_structure", unexplained=Unexplained(0.3, ("yaw_rate_rad_s",), "form not right")
    )
    assert "the library does not contain; it varies with turn rate (form not right)" in words.headline(unknown)


def test_few_runs_say_that_nothing_was_held_out() -> None:
    assert "nothing held out (1 run)" in text(replace(BATTERY, heldout=None))


@pytest.mark.parametrize("battery", [BATTERY, replace(BATTERY, effects=(PAYLOAD,), heldout=None)])
def test_json_and_page_hold_for_every_verdict(battery: BatteryDiagnosis) -> None:
    diagnosis = Diagnosis("pioneer3dx", {"robot": battery})
    assert '"schema": "missionsim.diagnosis/1"' in to_json(diagnosis.to_json())
    page = diagnosis_page(diagnosis)
    assert battery.effects[0].effect in page
    assert "http" + "://" not in page.split("<script")[0]


def test_the_page_shows_what_looks_alike() -> None:
    """Each effect found against all others, most alike first; one effect alone is enough for a figure."""

    def alike(battery: BatteryDiagnosis) -> list[Chart]:
        details = diagnosis_sections(Diagnosis("r", {"robot": battery}))[-1]
        return [b for b in details.blocks if isinstance(b, Chart)]

    assert alike(BATTERY) == []
    (chart,) = alike(replace(BATTERY, confounding={"grade": {"payload": -0.2, "acceleration": 0.93, "turning": 0.1}}))
    (trace,) = chart.traces
    assert trace["hovertext"] == [
        "grade and acceleration: r = 0.93",
        "grade and payload: r = -0.20",
        "grade and turning: r = 0.10",
    ]


def test_errors_with_the_effects_and_with_a_law_beside_them_are_told_apart() -> None:
    law = SimpleNamespace(heldout_rmse_w=(1.2, 0.9), heldout_energy_pct=(1.2, 1.1))
    told = sentences.errors(replace(BATTERY, proposed_laws=(law,)))
    assert "is 1.20 W with grade, 0.900 W with the law as well (energy 4.60 → 1.20 → 1.10 %)" in told
    assert "is 1.20 W with it (energy 4.60 → 1.20 %)" in sentences.errors(BATTERY)
    assert BATTERY.heldout is not None
    line = words.heldout_line(BATTERY.heldout, laws=[law])  # type: ignore[arg-type]
    assert line.endswith(
        "→ 1.20 (with the effects) → 1.10 % (with the law as well); power RMSE 4.60 → 2.70 → 1.20 → 0.900 W"
    )
    alone = words.heldout_line(BATTERY.heldout, False, [law])  # type: ignore[arg-type]
    assert alone.endswith("(recalibrated) → 1.10 % (with the law); power RMSE 4.60 → 2.70 → 0.900 W")


def test_a_doubt_of_an_effect_is_told_wherever_it_is_named() -> None:
    doubted = replace(BATTERY, effects=(replace(GRADE, remark="beside it k1 falls below nothing"),))
    assert "that may be grade" in words.headline(doubted)
    assert "that it is grade is not: beside it k1" in sentences.sure(doubted)
    assert words.found_line(doubted.effects[0]).endswith("; beside it k1 falls below nothing")
    assert "that is grade" in words.headline(BATTERY)


@pytest.mark.parametrize(
    ("share_low", "sizes", "doubted"),
    [
        (-0.001, [(-0.1, 1.01)], True),
        (0.001, [(0.1, 1.01)], False),
        (-0.001, [(-3.0, -1.0), (-1.0, 2.0)], False),  # levels of a label may sum to nothing and differ
    ],
)
def test_an_effect_whose_interval_holds_nought_may_be_there(
    share_low: float, sizes: list[tuple[float, float]], doubted: bool
) -> None:
    """Copper loss of 0.7 % (-0.3 to 1.7) was told as sure where nothing of it was hidden."""
    parameters = {f"k_{i}": Estimate(0.5 * (low + high), low, high, "N") for i, (low, high) in enumerate(sizes)}
    small = replace(PAYLOAD, indistinguishable_from=(), share_low=share_low, parameters=parameters)
    assert ("interval holds nought" in small.doubt) is doubted
    assert ("that may be payload" in words.headline(replace(BATTERY, effects=(GRADE, small)))) is doubted


@pytest.mark.parametrize(
    ("low", "absorbed", "doubted"), [(0.05, 0.99, True), (-0.01, 0.99, True), (0.05, 0.3, False), (0.2, 0.99, False)]
)
def test_an_effect_that_the_base_pays_already_may_be_there(low: float, absorbed: float, doubted: bool) -> None:
    """Copper loss of 36 % (5 to 67) of the energy was told as sure: inertia was hidden, and its constant part was the
    base's own."""
    sized = {"k": Estimate(0.26, 0.18, 0.35, "W/N^2"), "rolling": Estimate(0.185, 0.12, 0.29, "1")}
    one = replace(
        PAYLOAD, indistinguishable_from=(), share_low=low, share_high=0.67, absorbed=absorbed, parameters=sized
    )
    assert ("the base pays most of it already" in one.doubt) is doubted
    assert ("that may be payload" in words.headline(replace(BATTERY, effects=(GRADE, one)))) is doubted


def test_several_effects_go_in_together_and_options_stay() -> None:
    asked = sentences.Asked("own.yaml", ["logs"], "--holdout later")
    alone = sentences.next_step(BATTERY, asked)
    assert alone == "missionsim add-effect --robot own.yaml --effect grade --holdout later logs --out own_better.yaml"
    beside = replace(BATTERY, effects=(GRADE, replace(GRADE, effect="acceleration")))
    told = "missionsim improve --robot own.yaml --battery robot --holdout later logs --out own_better.yaml"
    assert sentences.next_step(beside, asked, several=True) == told
    law = SimpleNamespace(open=False, heldout_energy_pct=None, heldout_rmse_w=None)
    assert "improve" in sentences.next_step(replace(BATTERY, proposed_laws=(law,)), asked)
    law.open = True  # which is not added
    assert "add-effect" in sentences.next_step(replace(BATTERY, proposed_laws=(law,)), asked)


def test_beside_effects_that_cannot_be_told_apart_there_is_a_command_too() -> None:
    """A law went in with `improve`, 22.9 to 6.5 W, and `diagnose` had no command; for a base 5 % low neither."""
    asked = sentences.Asked("own.yaml", ["logs"])
    unsure = replace(BATTERY, effects=(replace(GRADE, indistinguishable_from=("payload",)),), heldout=None)
    assert sentences.next_step(unsure, asked) == ""
    law = SimpleNamespace(open=False, heldout_energy_pct=None, heldout_rmse_w=None)
    assert sentences.next_step(replace(unsure, proposed_laws=(law,)), asked).startswith("missionsim improve")
    energy = {"nominal": 5.7, "recalibrated": 0.7, "with_effects": 0.7}
    held = HeldOut("the last", ("e",), energy, {"nominal": 14.7, "recalibrated": 7.1, "with_effects": 7.0})
    assert sentences.next_step(replace(unsure, heldout=held), asked).startswith("missionsim calibrate")


def test_a_battery_is_named_where_there_are_several() -> None:
    assert "Battery" not in words.headline(replace(BATTERY, effects=(GRADE, PAYLOAD)))
    assert words.headline(BATTERY, several=True).startswith("Battery robot: Climbing costs")
    both = {name: replace(BATTERY, battery=name) for name in ("robot", "laptop")}
    page = diagnosis_page(Diagnosis("pioneer3dx", both))
    assert page.count("Battery laptop: Climbing costs") == 1
    assert "Battery robot: Climbing" not in diagnosis_page(Diagnosis("pioneer3dx", {"robot": BATTERY}))


def test_limits_above_half_of_the_energy_say_nothing_and_eight_are_shown() -> None:
    many = tuple(Judged(f"e{i}", False, "", 0.01 * i) for i in range(1, 9))
    limits = (*many, Judged("near", False, "", 0.45), Judged("blind", False, "", 0.55))
    told = dict(words.report(replace(BATTERY, candidates=limits)))["NOT SEEN"]
    assert "e8 < 8.0 % and 1 more with higher limits" in told
    assert told.endswith("say nothing of blind")


@pytest.mark.parametrize(
    ("p_value", "told"),
    [(0.00027, "one case in 3,700"), (0.04, "one case in 25"), (1e-6, "one case in 1,000,000"), (1e-9, "a million")],
)
def test_nothing_is_called_surer_than_it_is(p_value: float, told: str) -> None:
    sure = replace(GRADE, p_value=p_value)
    assert told in sentences.sure(replace(BATTERY, effects=(sure,)))
    surer = replace(GRADE, effect="payload", p_value=1e-12)
    assert f"{told} (grade, the least sure);" in sentences.sure(replace(BATTERY, effects=(surer, sure)))


@pytest.mark.parametrize(
    ("formula", "name", "told"),
    [
        ("k * (scheme == 'baseline')", "scheme", "Being in control scheme baseline"),
        ("k * (surface == 'grass')", "surface", "Being on grass"),
        ("k * abs(speed_m_s) * (surface == 'grass')", "surface", "Being on grass while driving"),
        ("k * abs(speed_m_s) * cos(heading_rad - 0.79)", "heading_rad", "Driving at headings about 45°"),
    ],
)
def test_a_law_of_one_level_or_direction_is_a_sentence(formula: str, name: str, told: str) -> None:
    variables = [*(["speed_m_s"] if "speed" in formula else []), name]
    assert sentences._law_subject(formula, variables) == told


def test_what_may_have_a_part_of_an_effect_is_told_with_it() -> None:
    payload = replace(PAYLOAD, indistinguishable_from=(), shared_with=("temperature_friction",))
    told = "payload, a part of it perhaps temperature_friction, which goes along with it from run to run"
    assert f"; that is {told}." in words.headline(replace(BATTERY, effects=(payload,)))
    assert words.found_line(payload).endswith(told.removeprefix("payload, "))


def test_how_the_robot_drove_beside_its_plan_is_told_with_its_scheme() -> None:
    dwell = replace(
        GRADE, effect="path_stretch", parameters={"k": Estimate(1.08, 1.05, 1.11)}, energy_share=0.02, scheme="seen"
    )
    told = dict(words.report(replace(BATTERY, execution=(dwell,))))["DRIVEN"]
    assert "path_stretch in seen: 1.08" in told
    assert "95 % 1.05 to 1.11" in told
    assert told.endswith("+2.0 % of the energy")


@pytest.mark.parametrize(
    ("carpet", "told"),
    [("0.08", "(on carpet hardly otherwise)"), ("0.8", "(on carpet most)"), ("-0.5", "(on carpet least)")],
)
def test_what_costs_something_on_every_floor_is_not_being_on_one(carpet: str, told: str) -> None:
    """A law of 0.92 on tile and 1 on carpet was "Being on carpet while driving"."""
    size = carpet.lstrip("-")
    floors = f"(0.92 {'-' if carpet.startswith('-') else '+'} {size} * (surface == 'carpet'))"
    formula = f"k * tanh(abs(speed_m_s) / 0.43) * {floors}"
    assert sentences._law_subject(formula, ["speed_m_s", "surface"]) == f"Driving {told}"


@pytest.mark.parametrize(("asphalt", "hardly"), [("0.016", True), ("0.06", True), ("0.6", False)])
def test_levels_that_hardly_differ_are_told_so(asphalt: str, hardly: bool) -> None:
    """Turning at 0.94, 0.956 and 1.00 of one size was "on asphalt and grass, each its own measure"."""
    floors = f"(0.94 + {asphalt} * (surface == 'asphalt') + 0.06 * (surface == 'grass'))"
    told = sentences._law_subject(f"k * abs(yaw_rate_rad_s) * {floors}", ["yaw_rate_rad_s", "surface"])
    alike, apart = "(on asphalt and grass hardly otherwise)", "on asphalt and grass, each its own measure,"
    assert told == f"Turning {alike if hardly else apart}"
