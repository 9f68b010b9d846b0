"""Fits of base models: certified least-squares answers, intervals that cover, priors that are honoured."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError
from missionsim.fit.calibrate import NewRobot, calibrate_new, refit_robot
from missionsim.fit.parameters import data_tag, fit_parameters, fitted_source, fitted_to, log_hash
from missionsim.inputs.edit import Editing, robot_text
from missionsim.inputs.loading import load_robot, robot_from_text
from missionsim.inputs.power import build_power_model
from missionsim.logs import LogTable
from missionsim.runs.error import errors_of
from tests.diagnose.logs import drawing, drive

LOGS = [drive(seed, seconds=300.0) for seed in range(4)]


def test_new_robot_covers_the_truth_and_loads() -> None:
    made = calibrate_new(NewRobot("rover", "c2*v**2 + c3*v + c4", mass="25 kg"), LOGS)
    truth = {"c2": 6.25, "c3": 9.79, "c4": 6.0, "standing": 5.01, "kinect.power": 2.82}
    for name, value in truth.items():
        parameter = made.fit.parameters[name]
        assert abs(parameter.value - value) < 4.0 * parameter.sd, name
        assert parameter.low < parameter.value < parameter.high
    robot = robot_from_text(made.text)
    model = build_power_model(robot)
    assert model.parameters["robot/c3"].value == pytest.approx(made.fit.parameters["c3"].value, rel=1e-5)
    assert any("laser was never switched" in remark for remark in made.remarks)
    assert fitted_to(robot.sources["calibration"], LOGS)
    assert not fitted_to(robot.sources["calibration"], [drive(99, seconds=60.0)])


@pytest.mark.parametrize("anew", [True, False])
def test_the_meter_that_was_found_is_written_so_that_the_error_told_is_that_of_the_file(anew: bool) -> None:
    late = [drawing(log, np.roll(log.power_w["robot"], 2)) for log in (drive(seed, step_s=0.5) for seed in range(3))]
    made = calibrate_new(NewRobot("rover", "c2*v**2 + c3*v + c4"), late) if anew else refit_robot("pioneer3dx", late)
    fit = made.fits[0]
    assert fit.delay_s + fit.lag_s == pytest.approx(1.0, abs=0.2)
    written = build_power_model(robot_from_text(made.text))
    assert written.meter("robot").delay_s == pytest.approx(fit.delay_s)
    error = errors_of(written, late, "robot").power_rmse_w
    assert fit.after.power_rmse_w == pytest.approx(error, rel=1e-4)
    spread = np.std(np.concatenate([log.power_w["robot"] for log in late]))
    assert 1.0 - (error / spread) ** 2 == pytest.approx(fit.explained, abs=0.002)


@pytest.mark.parametrize("late", [0, 1])
def test_inertia_that_a_base_lacks_is_no_meter_ahead_of_the_motion(late: int) -> None:
    """A tracked robot's meter was written as 0.45 s early, a boat's as 0.25 s: both were 0.2 s late."""
    logs = []
    for seed in range(4):
        log = drive(seed, step_s=0.5, seconds=400.0)
        speed = log.number("speed_m_s")
        watts = log.power_w["robot"] + 60.0 * speed * np.gradient(speed, 0.5)
        logs.append(drawing(log, np.roll(watts, late)))
    fit = calibrate_new(NewRobot("rover", "c2*v**2 + c3*v + c4"), logs).fits[0]
    assert fit.delay_s + fit.lag_s == pytest.approx(0.5 * late, abs=0.15)


def test_how_long_a_component_has_been_on_is_no_component() -> None:
    """A log may hold the clock of a switch beside it."""
    logs = [drive(seed, seconds=200.0) for seed in range(4)]
    clocks = [np.cumsum(log.number("on_kinect")) for log in logs]
    timed = [
        replace(log, columns={**log.columns, "on_time_kinect_s": clock})
        for log, clock in zip(logs, clocks, strict=True)
    ]
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4"), timed)
    assert {*robot_from_text(made.text).components} == {"kinect"}


def test_without_noise_the_answer_is_exact() -> None:
    quiet = [drive(seed, seconds=300.0, noise=0.0) for seed in range(3)]
    fit = calibrate_new(NewRobot("rover", "c2*v**2 + c3*v + c4"), quiet).fit
    assert fit.explained > 0.9999
    for name, value in {"c2": 6.25, "c3": 9.79, "c4": 6.0, "standing": 5.01, "kinect.power": 2.82}.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=0.02), name


def test_a_formula_that_is_not_linear() -> None:
    quiet = [drive(seed, seconds=300.0) for seed in range(4)]
    fit = calibrate_new(NewRobot("rover", "c4 + c*abs(v)**p"), quiet).fit
    assert fit.explained > 0.95
    assert 1.0 < fit.parameters["p"].value < 2.0


def test_refit_stays_within_what_is_known() -> None:
    model = build_power_model(load_robot("pioneer3dx"))
    fit = fit_parameters(model, LOGS, "robot")
    assert fit.parameters["c3"].value == pytest.approx(9.79, rel=0.05)
    assert fit.parameters["c3"].sd < 0.03 * 9.79
    # the sonar was never on: nothing is learned of it
    sonar = fit.parameters["sonar.p1"]
    assert not sonar.seen
    assert sonar.value == sonar.before
    assert fit.after.power_rmse_w <= fit.before.power_rmse_w + 1e-9


def test_refit_writes_the_power_of_one_unit_of_what_is_always_on(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "kind: robot\nname: boards\nbody: {mass: 25 kg, drive: differential, max_speed: 1 m/s}\n"
        "batteries: {robot: {capacity: 100 Wh}}\n"
        "motion: {battery: robot, model: polynomial, parameters: {c2: 6.25, c3: 9.79, c4: 3.0, standing: 2.01}}\n"
        "components:\n"
        "  board: {always_on: true, units: 3, loads: [{battery: robot, power: {value: 0.8 W, sd: 50 %}}]}\n"
        "  kinect: {loads: [{battery: robot, power: 2.82 W}]}\n  laser: {loads: [{battery: robot, power: 2 W}]}\n",
        encoding="utf-8",
    )
    made = refit_robot(path, LOGS)
    fitted = made.fits[0].parameters["board.power"]
    assert fitted.seen
    assert abs(fitted.value - 2.4) > 0.1
    again = build_power_model(robot_from_text(made.text)).parameters["robot/board.power"]
    assert again.value == pytest.approx(fitted.value, rel=1e-5)
    assert again.sd == pytest.approx(fitted.sd, rel=1e-2)


@pytest.mark.parametrize("shift", [0.95, 1.06])
def test_refit_moves_a_wrong_value_towards_the_truth(shift: float) -> None:
    model = build_power_model(load_robot("pioneer3dx"))
    wrong = model.with_values({"robot/c3": 9.79 * shift})
    fit = fit_parameters(wrong, LOGS, "robot")
    assert abs(fit.parameters["c3"].value - 9.79) < 0.5 * abs(9.79 * shift - 9.79)


def test_noise_that_grows_with_power_does_not_break_a_poor_formula() -> None:
    """Large noise while driving, almost none at rest, and a formula that explains little: plain least squares hold."""
    logs: list[LogTable] = []
    for seed in range(4):
        log = drive(seed, seconds=300.0, scrub_w_s_rad=40.0)
        logs.append(log)
    fit = calibrate_new(NewRobot("skid", "c3*v + c4"), logs).fit
    speed = np.concatenate([np.asarray(log.columns["speed_m_s"]) for log in logs])
    power = np.concatenate([log.power_w["robot"] for log in logs])
    assert fit.explained > 0.0
    assert fit.parameters["standing"].value == pytest.approx(float(np.mean(power[speed == 0.0])), abs=3.0)


def stop_and_go(seed: int, row_s: float, longer: float = 1.0) -> LogTable:
    """Means over rows of a robot that drives for some seconds and stands for some, written here on a clock of 10 ms."""
    rng = np.random.default_rng(seed)
    parts: list[np.ndarray] = []
    while sum(map(len, parts)) < 30_000:
        driven = int(longer * rng.uniform(500, 900))
        parts += [np.zeros(int(rng.uniform(300, 600))), np.full(driven, rng.uniform(0.2, 0.6))]
    speed = np.convolve(np.concatenate(parts)[:30_000], np.full(80, 1.0 / 80), mode="same")
    power = 5.0 + (8.0 + 6.0 * speed**2) * (speed > 1e-6)
    every = round(100 * row_s)
    columns = {name: values.reshape(-1, every).mean(axis=1) for name, values in (("v", speed), ("p", power))}
    time_s = row_s * (np.arange(len(columns["v"])) + 0.5)
    table = {"time_s": time_s, "speed_m_s": columns["v"]}
    watts = columns["p"] + 0.05 * rng.standard_normal(len(time_s))
    return LogTable(
        f"run{seed}", table, np.full(len(time_s), row_s), {"robot": watts}, {"robot": None}, {"robot": "power"}
    )


def test_rows_too_slow_for_a_robot_that_often_stops_are_told() -> None:
    """What moving costs (13 W at rest of speed) is off by more than its interval in rows of a second, and told."""
    slow, fast = (
        calibrate_new(NewRobot("rover", "c2*v**2 + c4"), [stop_and_go(seed, row_s) for seed in range(3)])
        for row_s in (1.0, 0.1)
    )
    assert slow.fit.parameters["c4"].high < 12.5
    assert any("log at 5 Hz or more" in remark for remark in slow.remarks)
    assert fast.fit.parameters["c4"].value == pytest.approx(13.0, rel=0.02)
    assert not any("log at 5 Hz or more" in remark for remark in fast.remarks)


@pytest.mark.parametrize(("row_s", "longer", "told"), [(0.25, 1.0, False), (0.3, 1.0, True), (0.3, 2.0, False)])
def test_rows_of_a_third_of_a_second_are_slow_where_one_in_twenty_is_a_start_or_a_stop(
    row_s: float, longer: float, told: bool
) -> None:
    logs = [stop_and_go(seed, row_s, longer) for seed in range(2)]
    made = calibrate_new(NewRobot("rover", "c2*v**2 + c4"), logs)
    assert any("log at 5 Hz or more" in remark for remark in made.remarks) is told


def test_a_signed_turn_rate_in_a_formula_is_told() -> None:
    """Turns to both sides: cw*w averages to nothing over them, cw*abs(w) does not."""
    logs = [drive(seed, seconds=300.0, scrub_w_s_rad=40.0) for seed in range(3)]
    rates = np.concatenate([np.asarray(log.columns["yaw_rate_rad_s"]) for log in logs])
    assert rates.min() < 0.0 < rates.max()
    signed = calibrate_new(NewRobot("skid", "c3*v + cw*w + c4"), logs).remarks
    assert any("for both alike, abs(w)" in remark for remark in signed)
    both = calibrate_new(NewRobot("skid", "c3*v + cw*abs(w) + c4"), logs).remarks
    assert not any("has a sign" in remark for remark in both)


def test_a_formula_whose_parameters_cannot_be_told_apart() -> None:
    with pytest.raises(InputError, match="cannot tell some parameters"):
        calibrate_new(NewRobot("rover", "k1*v + k2*v + k3"), LOGS)
    with pytest.raises(InputError, match="which not every log has"):
        calibrate_new(NewRobot("rover", "k1*theta + k3"), LOGS)


def test_logs_of_a_robot_that_stands_still_say_nothing_of_driving() -> None:
    motion = ("speed_m_s", "yaw_rate_rad_s")
    still = [replace(log, columns=log.columns | dict.fromkeys(motion, np.zeros(log.rows))) for log in LOGS]
    with pytest.raises(InputError, match="stands still in every row"):
        calibrate_new(NewRobot("rover", "c3*v + c4"), still)
    off = {name: np.zeros(still[0].rows) for name in still[0].columns if name.startswith("on_")}
    alone = [replace(log, columns=log.columns | off) for log in still]
    nothing = calibrate_new(NewRobot("rover", "0"), alone).fit  # whose clock nothing shows
    assert (nothing.delay_s, nothing.lag_s) == (0.0, 0.0)
    made = calibrate_new(NewRobot("rover", "0"), still)
    assert set(made.fit.parameters) == {"standing", "kinect.power"}
    rest = made.fit.parameters["standing"].value
    assert min(log.power_w["robot"].min() for log in still) < rest < np.mean([log.power_w["robot"] for log in still])


def test_hashes_tell_logs_apart(tmp_path: Path) -> None:
    one, two = LOGS[0], LOGS[1]
    assert log_hash(one) != log_hash(two)
    assert data_tag([one, two]) == data_tag([two, one])
    assert fitted_to(f"fitted to 2 runs, data {data_tag([one, two])}", [two])
    assert not fitted_to("Table 2", [one])
    assert "fitted to" not in robot_text("pioneer3dx")


def test_every_run_of_many_is_known_again() -> None:
    many = [drawing(LOGS[0], LOGS[0].power_w["robot"] + 0.001 * i) for i in range(2500)]
    for count in (54, 600):  # more than a line of the file holds
        text = Editing(robot_text("pioneer3dx")).set_source("calibration", fitted_source(many[:count]), {}).text
        source = robot_from_text(text).sources["calibration"]
        assert all(fitted_to(source, [log]) for log in many[:count])
        assert not fitted_to(source, many[count : count + 40])
    text = Editing(robot_text("pioneer3dx")).set_source("calibration", fitted_source(many), {}).text
    source = robot_from_text(text).sources["calibration"]
    assert all(fitted_to(source, many[i : i + 20]) for i in range(0, 2500, 20))
    # as it was written before, for more than 40 runs
    of_all = hashlib.sha256("".join(sorted(map(log_hash, many[:54]))).encode()).hexdigest()[:8]
    assert fitted_to(f"fitted to 54 runs, data {of_all}", many[:54])


@pytest.mark.parametrize(
    ("less_w_s_m", "told"), [(10.5, "c3 came out negative (−0.2"), (14.0, "c3 came out negative (−3.7")]
)
def test_a_negative_coefficient_is_told_with_what_to_do(less_w_s_m: float, told: str) -> None:
    drives = (drive(seed, seconds=240.0) for seed in range(3))
    logs = [drawing(log, log.power_w["robot"] - less_w_s_m * log.columns["speed_m_s"]) for log in drives]
    (remark,) = (r for r in calibrate_new(NewRobot("cart", "c2*v**2 + c3*v + c4"), logs).remarks if "c3" in r)
    assert remark.startswith(told)
    assert ("leave its term out of --base" in remark) == (less_w_s_m < 12.0)
    assert ("missionsim diagnose" in remark) == (less_w_s_m > 12.0)
