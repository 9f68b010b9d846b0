"""Which runs are held out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.diagnose.heldout import Models
from missionsim.diagnose.split import choose_split, parts_of, stretches
from missionsim.effects.covariates import derive
from missionsim.errors import InputError
from missionsim.identify.design import TooShortError
from missionsim.identify.settings import LEARNT_SECONDS, MANY_SECONDS
from missionsim.labels import Labels

from .logs import drive

RUNS = [drive(seed, seconds=30.0, payload_kg=np.full(30, float(seed))) for seed in range(8)]


def names(runs: tuple[object, ...]) -> list[str]:
    return [run.run for run in runs]  # type: ignore[attr-defined]


def test_last_quarter_is_the_default() -> None:
    split = choose_split(RUNS)
    assert names(split.train) == [f"run_{i:02d}" for i in range(6)]
    assert names(split.heldout) == ["run_06", "run_07"]
    assert split.how == "the last 2 runs of 8"


@pytest.mark.parametrize(("floors", "told"), [("tsttttss", True), ("ststssts", False)])
def test_last_runs_that_are_all_of_what_few_fitted_ones_are_differ_in_kind(floors: str, told: bool) -> None:
    """Files in the order of their names put one floor last."""
    words = [Labels.of([{"t": "tile", "s": "snow"}[floor]] * 30) for floor in floors]
    split = choose_split(
        [replace(run, columns={**run.columns, "surface": w}) for run, w in zip(RUNS, words, strict=True)]
    )
    assert names(split.heldout) == ["run_06", "run_07"]
    assert split.shifted is told
    count = floors[:6].count("s")
    assert (split.how == f"the last 2 runs of 8, all of surface snow as {count} of the fitted ones are") is told


@pytest.mark.parametrize(
    ("floors", "loads", "held", "how"),
    [
        # the two drives that tell load and floor apart came last
        ("ttttssssst", [0, 1, 0, 1, 4, 5, 4, 5, 0, 5], [3, 6], "show most of payload_kg, surface"),
        ("ttttssssst", [0, 1, 0, 1, 0, 1, 0, 1, 0, 1], [8, 9], "the last 2 runs of 10"),
        ("tttttttttt", [0, 1, 0, 1, 0, 1, 0, 1, 5, 6], [6, 7], "show most of payload_kg"),
        ("ttttttttss", [0, 1, 0, 1, 0, 1, 0, 1, 0, 1], [6, 7], "surface"),
        ("tttttttttt", [3] * 10, [8, 9], "the last 2 runs of 10"),
        # whichever are held out, their floors are shown by no other run
        ("abcdefghij", [0] * 10, [8, 9], "the last 2 runs of 10"),
        # and yet the load need not be
        ("abcdefghij", [0] * 9 + [5], [7, 8], "show most of payload_kg, surface"),
    ],
)
def test_what_the_last_runs_alone_show_is_fitted(floors: str, loads: list[int], held: list[int], how: str) -> None:
    runs, same = [], drive(0, seconds=30.0)
    for number, (floor, load) in enumerate(zip(floors, loads, strict=True)):
        own = {"payload_kg": np.full(30, float(load)), "surface": Labels.of([floor] * 30)}
        runs.append(replace(same, run=f"run_{number:02d}", columns={**same.columns, **own}))
    split = choose_split(runs, "0.2")
    assert names(split.heldout) == [f"run_{number:02d}" for number in held]
    assert how in split.how
    assert len(split.train) == 8


@pytest.mark.parametrize(
    ("usual", "last", "held"),
    [
        # load and cold go together but in the drive that tells them apart
        ([(p, 20.0 - 5.0 * p) for p in (0.0, 1.0, 2.0, 3.0)], (0.0, [4.0, 19.0]), False),
        ([(0.0, 5.0), (0.0, 19.0), (3.0, 5.0), (3.0, 19.0)], (0.0, [4.0, 19.0]), True),
    ],
)
def test_a_last_drive_that_alone_tells_causes_apart_is_fitted(
    usual: list[tuple[float, float]], last: tuple[float, list[float]], held: bool
) -> None:
    same = drive(0, seconds=60.0)
    runs = []
    for number, (load, cold) in enumerate([*usual, *usual, last]):
        own = {"payload_kg": np.full(60, load), "temp_ambient_c": np.resize(np.repeat(cold, 15), 60)}
        runs.append(replace(same, run=f"run_{number:02d}", columns={**same.columns, **own}))
    assert ("run_08" in names(choose_split(runs).heldout)) is held


@pytest.mark.parametrize(("speeds", "held"), [((0.5, [0.2, 0.9]), False), (([0.2, 0.9], [0.2, 0.9]), True)])
def test_the_only_drive_at_several_speeds_is_fitted(speeds: tuple[object, object], held: bool) -> None:
    same = drive(0, seconds=60.0)
    runs = []
    for number, speed in enumerate([*7 * [speeds[0]], speeds[1]]):
        moving = np.arange(60) > 4
        runs.append(
            replace(
                same,
                run=f"run_{number:02d}",
                columns={"time_s": same.time_s, "speed_m_s": np.resize(np.repeat(speed, 15), 60) * moving},
            )
        )
    assert ("run_07" in names(choose_split(runs).heldout)) is held


@pytest.mark.parametrize("floors", [["tile", "mud"], ["", ""]])
def test_floors_that_are_numbers_in_some_runs_or_have_no_text_are_no_cause(floors: list[str]) -> None:
    same, runs = drive(0, seconds=30.0), []
    for number in range(8):
        floor = Labels.of(floors * 15) if number % 2 or floors == ["", ""] else np.ones(30)
        own = {"surface": floor, "temp_ambient_c": np.full(30, 20.0 * (number == 7))}
        runs.append(replace(same, run=f"run_{number:02d}", columns={**same.columns, **own}))
    assert choose_split(runs).how == "run_05, run_06 of 8 runs, as the last ones show most of temp_ambient_c"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_runs_hold_none_out_and_say_so(count: int) -> None:
    assert len(choose_split(RUNS[:4]).heldout) == 1
    split = choose_split(RUNS[:count])
    assert split.heldout == ()
    assert len(split.train) == count
    assert "nothing shows how the model does on runs that were not used" in split.how


@pytest.mark.parametrize(("asked", "held"), [("0.5", 4), ("25 %", 2), ("0", 0), ("none", 0)])
def test_fraction(asked: str, held: int) -> None:
    assert len(choose_split(RUNS, asked).heldout) == held


def test_names_and_condition() -> None:
    assert names(choose_split(RUNS, "run_01,run_03").heldout) == ["run_01", "run_03"]
    split = choose_split(RUNS, "payload_kg > 5")
    assert names(split.heldout) == ["run_06", "run_07"]
    assert split.shifted
    assert names(choose_split(RUNS, ["run_01", "run_02"]).heldout) == ["run_01", "run_02"]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("run_1", "there is no run 'run_1'"),
        ("1.5", "--holdout as a fraction must be below 1"),
        ("payload_kg > 99", "no run meets the condition"),
        ("payload_kg >= 0", "every run meets the condition"),
        ("paload_kg > 3", "'paload_kg' is not known here"),
        (",".join(f"run_{i:02d}" for i in range(8)), "every run is held out"),
    ],
)
def test_faults_say_what_was_wrong(asked: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choose_split(RUNS, asked)


def test_a_typing_error_gets_a_hint() -> None:
    with pytest.raises(InputError) as caught:
        choose_split(RUNS, "run_1")
    assert caught.value.faults[0].hint == "run_01"


def test_of_very_long_runs_stretches_are_learnt_from() -> None:
    seconds = 40_000
    moving = (np.arange(seconds) // 90) % 2
    more = {"speed_m_s": 0.5 * moving, "on_kinect": 1.0 - moving, "payload_kg": np.full(seconds, 1.0)}
    long = drive(0, seconds=float(seconds), **more)
    runs = [replace(long, run=f"run_{number}") for number in range(3)]
    assert sum(run.duration_s for run in runs) > MANY_SECONDS
    few, nothing = stretches(runs[:2])
    assert few == runs[:2]
    assert not nothing
    kept, told = stretches(runs)
    assert "of 33.3 h" in told
    assert sum(run.duration_s for run in kept) == pytest.approx(LEARNT_SECONDS, rel=0.02)
    for run, whole in zip(kept, runs, strict=True):
        gaps = np.flatnonzero(np.diff(run.time_s) > 2.0)
        # several manoeuvres in each
        assert min(np.sum(np.diff(one) != 0.0) for one in np.split(run.number("speed_m_s"), gaps + 1)) >= 5
        assert run.time_s[0] < 0.1 * seconds
        assert run.time_s[-1] > 0.9 * seconds
        # what a row remembers is what it remembered in the whole run, and a cut is no start from rest
        at = np.searchsorted(whole.time_s, run.time_s)
        memory = derive(whole.columns, whole.time_s, whole.dt_s)
        again = derive(run.columns, run.time_s, run.dt_s)
        for name in ("moving_time_s", "on_time_kinect_s", "starts", "accel_m_s2"):
            assert np.array_equal(again[name], memory[name][at]), name
    # runs are not all cut at the same times
    assert len({round(float(run.time_s[0])) for run in kept}) == 3


@pytest.mark.parametrize(
    ("payload_kg", "left_out"),
    [
        ((1.0, 1.3, 1.0, 1.0), ["1"]),  # beyond all others
        ((0.1, 1.0, 1.1, 0.1), ["2"]),  # more than they in the mean
        ((0.9, 1.0, 1.1, 1.0), None),
        ((1.0, 3.0, 1.0), None),  # too few for a fit to the others and a test
    ],
)
def test_the_runs_with_most_of_what_an_effect_is_about_are_predicted_from_the_others(
    payload_kg: tuple[float, ...], left_out: list[str] | None
) -> None:
    runs = [
        SimpleNamespace(run=f"{i}", dt_s=np.ones(5), covariates={"payload_kg": np.full(5, kg)})
        for i, kg in enumerate(payload_kg)
    ]
    effect = SimpleNamespace(effect="payload", covariate="payload_kg")
    features = SimpleNamespace(runs=runs, candidates=[effect], covariates=[run.covariates for run in runs])
    models = SimpleNamespace(
        features=features,
        runs=runs,
        power=None,
        fit=lambda _effects, runs: SimpleNamespace(model=None),
        held_out=lambda _models, out, _how, _shifted: [run.run for run in out],
    )
    assert Models.shifted(models, [effect]) == left_out

    def of_none_long_enough(_effects: object, runs: object) -> None:
        raise TooShortError

    models.fit = of_none_long_enough
    assert Models.shifted(models, [effect]) is None


def test_a_single_run_is_cut_into_parts_in_which_its_clocks_go_on() -> None:
    seconds = 401
    run = drive(1, seconds=float(seconds), speed_m_s=np.full(seconds, 0.5))
    parts = parts_of(run, 4)
    assert len({part.run for part in parts}) == 4
    assert sum(part.rows for part in parts) == run.rows
    moved = np.concatenate([part.number("moving_time_s") for part in parts])
    assert np.all(np.diff(moved) > 0.0)  # warm when the second part begins


def test_a_run_that_was_left_out_is_not_unknown() -> None:
    with pytest.raises(InputError, match="the run 'run_9' was left out") as caught:
        choose_split(RUNS, "run_9", left_out=["run_9: power_robot_w lies +37 s beside what the robot does"])
    assert "beside what the robot does" in caught.value.faults[0].got
