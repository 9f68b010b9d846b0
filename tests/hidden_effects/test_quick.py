"""A quick subset of the study for CI, on tuning seeds; the full study has its own command (see score.py).

Marked `study` or `long` is what a quick test elsewhere holds as well: names of further effects `tests/identify`,
behaviours `tests/diagnose/test_execution.py`, two effects at once `test_own_robot.py`, what no library holds and what
these data cannot tell `tests/identify/test_identify.py`, the drive that tells it `tests/diagnose/test_experiments.py`,
rules of the selection `tests/identify/test_rules.py` and `test_thresholds.py`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from missionsim.diagnose.diagnosis import judged
from missionsim.diagnose.examine import Subject, examine
from missionsim.diagnose.split import read_split
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import load_robot

from .judge import judge
from .product import diagnose
from .score import Task, earlier, parser, run, score_task, tasks, write_results
from .study import ALL_CASES, UNTOUCHED_SEEDS
from .world import make, write


@cache
def row(case: str, seed: int = 1) -> dict:
    """missionsim's row of one case; a failure fails the test with its traceback."""
    result = score_task(Task(case, seed, with_peers=False))[0]
    assert not result.get("failure"), result["failure"]
    return result


@cache
def told(case: str, seed: int = 1) -> dict:
    """The same without the errors of the nominal model and of the truth, and without experiments."""
    with TemporaryDirectory() as scratch:
        world = make(ALL_CASES[case], seed)
        folder = write(world, Path(scratch))
        mission = folder / "mission.yaml"
        given = mission if mission.exists() else None
        outcome, _ = diagnose(folder / "train", folder / "heldout", world.case.robot, given)
    return judge(case, seed, world.answer, outcome)


def study(*values: str) -> list[Any]:
    return [pytest.param(value, marks=pytest.mark.study) for value in values]


EFFECTS = pytest.mark.usefixtures("effects_alone")
"""Of tests that a law could not decide; where nothing is hidden, none may be proposed."""


@pytest.mark.parametrize("robot", ["pioneer3dx", *study("small_rover", "husky_like")])
def test_nothing_hidden_names_nothing(robot):
    result = told(f"nothing-{robot}-level2", 0)
    assert result["named"] == ""
    assert result["verdict"] == "nothing_missing"


FIVE = ["grade", *study("surface_rolling_resistance", "acceleration", "cpu_load")]


@pytest.mark.long
@EFFECTS
@pytest.mark.parametrize("effect", FIVE)
def test_five_percent_of_the_energy_is_found_and_the_heldout_error_falls_as_far_as_it_can(effect):
    result = row(f"{effect}-5pct")
    assert result["first_right"], result
    assert not result["confident_wrong"], result
    removable = result["nominal_rmse_w"] ** 2 - result["oracle_rmse_w"] ** 2
    # the mark knows acceleration without noise, the product only its logged column
    assert result["nominal_rmse_w"] ** 2 - result["rmse_w"] ** 2 > 0.8 * removable


@cache
def named(case: str, seed: int) -> tuple[str, ...]:
    """What is named in one case, of which nothing else is asked: no held-out errors, no laws and no score."""
    with TemporaryDirectory() as scratch:
        folder = write(make(ALL_CASES[case], seed), Path(scratch))
        robot = load_robot("pioneer3dx")
        split = read_split(robot, [folder / "train"], [folder / "heldout"])
        seen = examine(Subject.of(robot), split, "robot", Settings())
    return tuple(effect.effect for effect in judged(seen, laws=False).effects)


@pytest.mark.long
def test_oil_that_thickens_exponentially_brings_no_second_name():
    assert named("temperature_friction-5pct", 42) == ("temperature_friction",)


@pytest.mark.long
def test_a_known_load_that_draws_more_is_not_called_its_warming_up():
    assert named("component_power-kinect-2pct", 0) == ("component_power:kinect",)


@pytest.mark.long
@EFFECTS
def test_what_stands_in_for_a_plan_that_is_not_kept_is_not_named() -> None:
    """Copper loss comes in, and its form is not right: what decides against it is that judgement."""
    assert told("execution-dwell-3pct", 1010)["named"] == "dwell"


@pytest.mark.long
def test_surges_that_the_clock_without_them_had_smeared_are_named():
    assert named("start_surge-2pct", 1010) == ("start_surge",)


@pytest.mark.long
def test_a_surge_acts_on_ramps_and_its_form_is_judged_with_them():
    assert named("start_surge-5pct", 1013) == ("start_surge",)


@pytest.mark.long
def test_a_payload_that_the_noise_took_for_runs_that_differ_is_named_beside_what_was_louder():
    assert {*named("two-start_surge-payload", 1010)} == {"start_surge", "payload"}


@pytest.mark.long
def test_what_recalibration_takes_of_an_effect_is_no_other_form_of_it():
    assert {*named("two-rolling_friction-turning_scrub", 1010)} == {"rolling_friction", "turning_scrub"}


@pytest.mark.long
def test_what_is_too_small_at_a_glance_takes_no_place_from_what_is_not():
    assert named("mixed-payload-highspeed", 1010) == ("payload",)


@pytest.mark.study
def test_two_effects_are_both_named():
    result = row("two-turning_scrub-surface_rolling_resistance")
    assert result["all_named"], result
    assert not result["confident_wrong"], result


@pytest.mark.long
@EFFECTS
@pytest.mark.parametrize("truth", ["payload", *study("surface_rolling_resistance")])
def test_payload_only_on_carpet_cannot_be_told_apart_until_the_proposed_experiment_is_driven(truth):
    result = row(f"confounded-carpet_payload-{truth}")
    assert result["honest"], result
    assert result["verdict"] == "ambiguous"
    assert result["resolved_by_two"], result


@pytest.mark.study
@pytest.mark.parametrize("what", ["fan", "skid"])
def test_what_no_library_holds_is_not_named(what):
    result = row(f"outside-{what}")
    assert not result["confident_wrong"], result


@pytest.mark.long
@EFFECTS
@pytest.mark.parametrize("variant", ["energy", "two-runs"])
def test_other_meters_and_few_runs(variant):
    result = told(f"turning_scrub-5pct-{variant}")
    assert result["first_right"], result
    assert not result["confident_wrong"], result


@EFFECTS
@pytest.mark.parametrize("name", ["dwell", *study("path_stretch", "speed_tracking")])
def test_behaviour_effects_are_found_from_the_plan_and_the_motion(name):
    result = told(f"execution-{name}-8pct")
    assert name in result["named"].split(), result
    assert not result["confident_wrong"], result


@pytest.mark.study
def test_nothing_planned_names_no_behaviour():
    assert row("nothing-planned")["named"] == ""


@EFFECTS
def test_the_same_case_twice_gives_the_same_report(tmp_path):
    folder = write(make(replace(ALL_CASES["grade-5pct-two-runs"], duration_s=200.0), 2), tmp_path)
    first, second = (diagnose(folder / "train", folder / "heldout", "pioneer3dx")[1] for _ in range(2))
    assert first == second


def test_table_is_written_whole(root: Path, tmp_path):
    study = earlier(root / "results/hidden_effects/world.csv", [])
    cases = "nothing-pioneer3dx-level2", "grade-5pct"
    rows = [next(r for r in study if r["case"] == case and r["method"] == "missionsim") for case in cases]
    write_results(rows, tmp_path, "world", "two cases")
    text = (tmp_path / "world.md").read_text()
    assert "nothing hidden" in text
    assert "one effect, 5 %" in text
    assert (tmp_path / "world.csv").read_text().count("\n") == 3
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.long
@EFFECTS
def test_practice_folders_are_scored_by_the_same_command(shared: Path, tmp_path):
    case = shared / "practice" / "grade-5pct"
    (tmp_path / case.name / "train").mkdir(parents=True)
    for log in sorted((case / "train").iterdir())[:4]:
        (tmp_path / case.name / "train" / log.name).symlink_to(log)
    for name in ("heldout", "answer.json"):
        (tmp_path / case.name / name).symlink_to(case / name)
    options = parser().parse_args(["--practice", str(tmp_path), "--cases", "grade-5pct", "--no-peers"])
    found = {r["case"]: r for r in run(list(tasks(options)), 1, quiet=True) if r["method"] == "missionsim"}
    assert not any(r.get("failure") for r in found.values()), found
    assert found["grade-5pct"]["first_right"]


@pytest.mark.study
@pytest.mark.parametrize("name", ALL_CASES)
def test_study_no_confident_wrong_name_on_an_untouched_seed(name, tmp_path):
    world = make(ALL_CASES[name], UNTOUCHED_SEEDS[0])
    folder = write(world, tmp_path)
    mission = folder / "mission.yaml"
    given = mission if mission.exists() else None
    outcome, _ = diagnose(folder / "train", folder / "heldout", world.case.robot, given)
    assert not judge(name, world.seed, world.answer, outcome)["confident_wrong"], outcome
