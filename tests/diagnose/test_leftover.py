"""What stands out in one kind of motion is told in words, never called nothing; noise is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.diagnose import Diagnosis, Subject, diagnose, words
from missionsim.diagnose.diagnosis import diagnose_battery
from missionsim.diagnose.leftover import fed_note, goes_with, standing_out, straight_note
from missionsim.diagnose.split import Split, beyond
from missionsim.identify.data import Candidate
from missionsim.identify.findings import Judged, Structure
from missionsim.identify.identification import identify
from missionsim.identify.settings import Settings
from missionsim.inputs.edit import robot_text
from missionsim.inputs.loading import load_robot, robot_from_text
from missionsim.labels import Labels
from missionsim.logs import LogTable
from missionsim.report.diagnosis_page import diagnosis_page
from missionsim.runs.motion import MOTIONS
from tests.laws.found import run_of

from .logs import drawing, drive

SLOWING = MOTIONS.index("slowing down")
ROBOT = "pioneer3dx"


def left_over(
    here_w: float, *, runs: int = 4, part: float = 0.09, noise_w: float = 1.0, flip: bool = False, uneven: float = 0.0
) -> Structure | None:
    """The judgement on noise with a mean error in some rows of each run."""
    rng = np.random.default_rng(5)
    count = 500 * runs
    run = np.repeat(np.arange(runs), 500)
    here = np.arange(count) % 500 < 500 * part
    sign = np.where(flip & (run % 2 == 1), -1.0, 1.0)
    error_w = rng.normal(0.0, noise_w, count) + here * here_w * sign * (1.0 + uneven * (1.5 - run))
    rows = np.zeros((len(MOTIONS), count), dtype=bool)
    rows[SLOWING], rows[[0, 1], :] = here, ~here & (np.arange(count) % 2 == [[0], [1]])
    return standing_out(error_w, np.ones(count), run, rows, noise_w=noise_w, mean_power_w=20.0)


def test_most_of_the_error_in_little_time_is_told() -> None:
    found = left_over(12.0)
    assert found is not None
    assert found.covariate == "accel_m_s2"
    assert found.shape == (
        "a systematic error while slowing down, model 12 W too high: 94 % of the squared "
        "error in 9 % of the time; no effect of the library describes it"
    )
    low = left_over(-12.0)
    assert low is not None
    assert "model 12 W too low" in low.shape
    assert left_over(12.0, uneven=0.1) is not None


@pytest.mark.parametrize("fell", [(4.0, 4.0, 4.0, 0.0, 0.0, 0.0), (4.0, 0.0, 4.0, 4.0, 0.0, 0.0)])
@pytest.mark.parametrize("words", [False, True])
def test_rain_that_fell_on_the_cold_days_alone_may_be_what_the_cold_is_called(
    fell: tuple[float, ...], words: bool
) -> None:
    """Rolling on wet ground was "temperature_friction, sure"; on dry cold days the new file was 17 W off in place of
    4."""
    rng, runs, logged = np.random.default_rng(2), [], []
    for celsius, rain in zip((2.0, 2.8, 3.1, 18.9, 20.0, 20.6), fell, strict=True):
        speed = np.repeat(rng.uniform(0.0, 1.0, 30), 10)
        gradient = {"c3": 20.0 * speed, "c4": np.full(300, 15.0)}
        cold = speed * (21.0 - celsius)
        fallen = Labels.of(np.repeat("wet" if rain else "dry", 300)) if words else np.full(300, rain)
        more, temp_c = 0.5 * cold + rng.normal(0.0, 0.3, 300), np.full(300, celsius)
        runs.append(run_of(celsius, gradient, more, {"cold": cold}, speed_m_s=speed, temp_ambient_c=temp_c))
        logged.append({**runs[-1].covariates, "rain": fallen})
    one = Candidate("temperature_friction", ("cold",), covariate="temp_ambient_c")
    found = identify(runs, [one], {"c3": 0.05, "c4": 0.05})
    assert [effect.effect for effect in found.effects] == ["temperature_friction"]
    told = goes_with(found, logged, {})
    assert not goes_with(found, logged, {"temperature_friction": ("rain",)})  # its own column, as that of a logged load
    assert [*told] == (["temperature_friction"] if fell[1] else [])
    assert all("rain goes with it in these runs" in words for words in told.values())


def test_a_column_that_hardly_changes_is_no_rival_of_turning() -> None:
    """A radio signal of -60 dBm times the turn rate is the turn rate."""
    rng, runs, logged = np.random.default_rng(3), [], []
    for number in range(5):
        yaw = np.repeat(rng.choice([0.0, 0.4, 0.8], 30), 10)
        gradient = {"c4": np.full(300, 15.0)}
        more = 4.0 * yaw + rng.normal(0.0, 0.3, 300)
        runs.append(run_of(number, gradient, more, {"yaw": yaw}, speed_m_s=yaw, yaw_rate_rad_s=yaw))
        logged.append({**runs[-1].covariates, "wifi_rssi_dbm": -60.0 - 4.0 * rng.random(300)})
    one = Candidate("turning_scrub", ("yaw",), covariate="yaw_rate_rad_s")
    found = identify(runs, [one], {"c4": 0.05})
    assert [effect.effect for effect in found.effects] == ["turning_scrub"]
    assert goes_with(found, logged, {}) == {}


@pytest.mark.parametrize(
    "noise",
    [{"here_w": 0.0}, {"here_w": 12.0, "flip": True}, {"here_w": 12.0, "runs": 2}, {"here_w": 12.0, "noise_w": 8.0}],
)
def test_noise_and_what_runs_disagree_on_is_not(noise: dict[str, float]) -> None:
    assert left_over(**noise) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("here_w", "part", "uneven", "noise_w", "told"),
    [
        (2.8, 0.1, 0.0, 1.0, False),  # 46 % of the squared error
        (3.2, 0.1, 0.0, 1.0, True),
        (5.0, 0.23, 0.0, 1.0, True),
        (5.0, 0.27, 0.0, 1.0, False),  # no small part of the time
        (5.0, 0.1, 0.0, 2.7, False),  # 1.9 standard deviations of a row's noise
        (5.0, 0.1, 0.0, 2.3, True),
        (5.0, 0.1, 0.32, 1.0, True),  # t = 5.4
        (5.0, 0.1, 0.38, 1.0, False),  # t = 4.6
    ],
)
def test_an_error_of_one_kind_of_motion_is_most_of_it_in_little_time_and_clear(
    here_w: float, part: float, uneven: float, noise_w: float, told: bool
) -> None:
    """Four runs of 1000 s, off by 1 W to either side elsewhere; `uneven`: how far the runs lie from their mean."""
    second, run = np.arange(4000) % 1000, np.repeat(np.arange(4), 1000)
    here, side = second < 1000 * part, 1.0 - 2.0 * (second % 2)
    error_w = np.where(here, here_w * (1.0 + uneven * (1.0 - 2.0 * (run % 2))), side)
    rows = np.zeros((len(MOTIONS), 4000), dtype=bool)
    rows[SLOWING], rows[0], rows[1] = here, ~here & (side > 0.0), ~here & (side < 0.0)
    found = standing_out(error_w, np.ones(4000), run, rows, noise_w=noise_w, mean_power_w=20.0)
    assert (found is not None) is told


def braking(log: LogTable, less_w: float) -> LogTable:
    """The log of a robot that draws less while its speed falls."""
    falls = np.gradient(log.columns["speed_m_s"], log.columns["time_s"]) < -0.05
    return drawing(log, log.power_w["robot"] - less_w * falls)


@pytest.mark.usefixtures("effects_alone")
def test_a_diagnosis_does_not_call_it_nothing() -> None:
    logs = [braking(drive(seed, seconds=300.0, step_s=0.5), 4.0) for seed in range(4)]
    diagnosis = diagnose(Subject.of(load_robot(ROBOT)), logs, holdout="none")
    found = diagnosis.batteries["robot"]
    assert found.verdict == "unexplained_structure"
    assert "accel_m_s2" in found.unexplained.depends_on
    # inertia that gives back comes nearest, and is refused: braking saves the same at any speed
    assert "acceleration" not in [effect.effect for effect in found.effects]
    told = "acceleration: form not right"
    assert told in words.headline(found)
    assert told in dict(words.report(found))["REMAINS"]
    assert told in found.to_json()["unexplained"]["shape"]
    assert told in diagnosis_page(Diagnosis("r", {"robot": found}))
    assert "nothing beyond the noise" not in str(words.report(found))


@pytest.mark.parametrize(("on", "told"), [(0.01, True), pytest.param(0.5, False, marks=pytest.mark.long)])
def test_watts_that_fitted_runs_hold_too_little_of_are_told(on: float, told: bool) -> None:
    """A heater that the battery does not feed: summer runs hardly switch it on, or half of the time; winter runs do."""

    def run(seed: int, part: float) -> LogTable:
        log = drive(seed, seconds=200.0, noise=0.03)
        heater = 4.0 * (np.arange(200) % 50 < 50 * part)
        return drawing(log, log.power_w["robot"], power_heater_w=heater)

    fitted = [run(seed, on if seed == 3 or not told else 0.0) for seed in range(8)]
    others = [run(seed, 1.0) for seed in (8, 9)]
    split = Split(tuple(fitted), tuple(others), "winter")
    last = diagnose_battery(Subject.of(load_robot("pioneer3dx")), split, "robot", Settings())
    note = fed_note(last, "robot", fitted, others)
    assert ("logged_power:power_heater_w --force" in note) is told
    assert ("% in the others" in note) is told


def test_what_the_runs_not_used_have_beyond_the_fitted_ones_is_told() -> None:
    def run(seed: int, warm_c: float, floor: str) -> LogTable:
        log = drive(seed, seconds=100.0, surface=[floor] * 100)
        return drawing(log, log.power_w["robot"], temp_ambient_c=np.full(100, warm_c))

    summer = [run(seed, 15.0 + 4.0 * seed, "tile" if seed % 2 else "grass") for seed in range(4)]
    winter = [run(4, 2.0, "tile"), run(5, -4.0, "snow")]
    assert beyond(summer, winter) == (["surface (snow)"], ["speed_m_s", "temp_ambient_c"])
    # the fitted ones have 15 to 27 degC, a standard deviation of 4.5 about 21
    assert "temp_ambient_c" not in beyond(summer, [run(6, 29.5, "tile")])[1]
    assert "temp_ambient_c" in beyond(summer, [run(6, 30.5, "tile")])[1]
    # of a switch no mean lies beyond: it is on or not
    for before, after, told in (
        (0.0, 1.0, "on_camera (on in them, never in the fitted ones)"),
        (1.0, 0.0, "on_camera (never on in them)"),
        (0.2, 1.0, "on_camera (on more in them than in the fitted ones)"),
        (0.8, 0.5, "on_camera (on less in them than in the fitted ones)"),
    ):
        switched = [
            drawing(one, one.power_w["robot"], on_camera=(np.arange(100) < 100 * part) * 1.0)
            for some, part in ((summer, before), (winter, after))
            for one in some
        ]
        assert told in beyond(switched[:4], switched[4:])[1]
    # one that only one side logs
    on, off = (drawing(winter[0], winter[0].power_w["robot"], on_camera=np.full(100, state)) for state in (1.0, 0.0))
    assert "on_camera (not logged in the fitted ones)" in beyond(summer, [on])[1]
    assert "on_camera (not logged in them)" in beyond([*summer[:2], on], winter)[1]
    assert "on_camera" not in str(beyond(summer, [off]))
    # an angle has no beyond
    turned = [drawing(one, one.power_w["robot"], heading_rad=np.full(100, 9.0 * i)) for i, one in enumerate(summer)]
    assert "heading_rad" not in beyond(turned[:3], turned[3:])[1]
    found = diagnose_battery(
        Subject.of(load_robot("pioneer3dx")), Split(tuple(summer), tuple(winter), "later"), "robot", Settings()
    )
    assert found.heldout is not None
    assert {"surface (snow)", "temp_ambient_c"} <= {*found.heldout.beyond}
    assert found.heldout.shifted  # no run of its kind was fitted


@pytest.mark.parametrize(("here", "there", "told"), [(0.005, 0.028, False), (0.005, 0.032, True), (0.015, 0.5, False)])
def test_watts_that_are_worth_a_sentence(here: float, there: float, told: bool) -> None:
    """Parts of the energy, where one part in a hundred would be seen in the fitted runs."""

    def run(part: float) -> LogTable:
        log = drive(1, seconds=60.0)
        return drawing(log, log.power_w["robot"], power_heater_w=part * log.power_w["robot"])

    heater = Judged("logged_power:power_heater_w", False, "", 0.01)
    last = SimpleNamespace(candidates=[Judged("grade", False, "", 0.01), heater])
    assert bool(fed_note(last, "robot", [run(here)], [run(there)])) is told


@pytest.mark.parametrize(
    ("bend", "unit", "told"), [("abs(yaw_rate_rad_s)", "W s", False), ("tanh(abs(yaw_rate_rad_s) / 0.01)", "W", True)]
)
def test_a_law_that_reads_the_noise_of_straight_drives_is_told(bend: str, unit: str, told: bool) -> None:
    """A gyro's 0.03 rad/s while the robot drives straight: a simulated mission has none there."""
    law = f'\n  - {{name: law, battery: robot, power: "k * {bend}", parameters: {{k: {{value: 20, unit: {unit}}}}}}}\n'
    text = robot_text("pioneer3dx")
    model = Subject.of(robot_from_text(text + "\neffects:" + law)).model
    rng = np.random.default_rng(1)
    runs = [drive(seed, seconds=300.0) for seed in range(3)]
    noisy = []
    for run in runs:
        rate = run.number("yaw_rate_rad_s") + rng.normal(0, 0.03, run.rows)
        noisy.append(replace(run, columns={**run.columns, "yaw_rate_rad_s": rate}))
    note = straight_note(model, noisy, "robot")
    assert ("do not trust `run` on straight ways" in note) is told
    assert straight_note(model, runs, "robot") == ""
