"""What the checks find in a log, what they do about it, and that a healthy log raises nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.interface import import_log
from missionsim.logs import LogTable, Remark, check_log, iter_blocks, read_log, read_logs
from missionsim.logs.blocks import write_log
from missionsim.logs.codes import refreshes
from missionsim.logs.obstacles import clock_delay
from missionsim.logs.raw import power_from_energy
from tests.logs.conftest import motion, write_csv


def read(tmp_path: Path, columns: dict[str, np.ndarray]) -> LogTable:
    return read_log(write_csv(tmp_path / "run.csv", columns))


def found(log: LogTable, kind: str, column: str | None = None) -> Remark:
    hits = [r for r in log.remarks if r.kind == kind and (column is None or r.column == column)]
    assert len(hits) == 1, [str(r) for r in log.remarks]
    return hits[0]


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("step_s", [0.05, 0.5, 1.0])
def test_healthy_logs_raise_nothing(tmp_path: Path, seed: int, step_s: float) -> None:
    log = read(tmp_path, motion(400 if step_s > 0.1 else 3000, step_s, seed))
    assert [str(r) for r in log.remarks] == []
    assert check_log(tmp_path / "run.csv") == []


def test_a_coarse_meter_and_a_plateau_are_no_slow_topic(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"] = np.round(columns["power_robot_w"])
    columns["speed_m_s"] = np.where(columns["time_s"] < 100, 0.3, 0.6)
    assert [r.kind for r in read(tmp_path, columns).remarks] == []


@pytest.mark.parametrize(("step_s", "told"), [(1000.0, True), (100.0, True), (60.0, False), (5.0, False)])
def test_milliseconds_in_place_of_seconds(tmp_path: Path, step_s: float, told: bool) -> None:
    columns = motion()
    columns["time_s"] = columns["time_s"] * (step_s / 0.5)
    found = [r for r in read(tmp_path, columns).remarks if (r.kind, r.column) == ("unit", "time_s")]
    assert bool(found) == told
    if told:
        assert found[0].severity == "warning"
        assert f"steps of {step_s:g} s" in found[0].message
        assert "milliseconds" in found[0].message


def test_few_or_uneven_rows_are_not_taken_for_milliseconds(tmp_path: Path) -> None:
    few = {name: data[:15] for name, data in motion(step_s=100.0).items()}
    assert not [r for r in read(tmp_path, few).remarks if r.column == "time_s"]
    uneven = motion()
    uneven["time_s"] = np.cumsum(np.where(np.arange(400) % 3 == 0, 1000.0, 61.0))
    assert not [r for r in read(tmp_path, uneven).remarks if (r.kind, r.column) == ("unit", "time_s")]


@pytest.mark.parametrize(("swapped", "severity"), [(1, "warning"), (30, "warning"), (60, "error")])
def test_time_backwards_is_sorted_and_told(tmp_path: Path, swapped: int, severity: str) -> None:
    """A pair of rows that came late cost the whole run."""
    columns = motion()
    order = np.arange(400)
    for at in 100 + 2 * np.arange(swapped):
        order[[at, at + 1]] = [at + 1, at]
    log = read(tmp_path, {name: data[order] for name, data in columns.items()})
    remark = found(log, "time_backwards")
    assert (remark.line, remark.count, remark.severity, remark.action) == (
        103,
        swapped,
        severity,
        "the rows were sorted by time",
    )
    np.testing.assert_allclose(log.power_w["robot"], columns["power_robot_w"], rtol=1e-8)
    refused = [fault.line for fault in check_log(tmp_path / "run.csv") if fault.severity == "error"]
    assert refused == [103] * (severity == "error")


def test_two_runs_in_one_file_are_refused(tmp_path: Path, faults_of) -> None:
    columns = {name: np.r_[data, data] for name, data in motion().items()}
    fault = faults_of(read, tmp_path, columns).faults[0]
    assert fault.message == "time runs backwards by 199.5 s, from 199.75 s to 0.25 s"
    assert fault.line == 402


@pytest.mark.parametrize("absurd", [1e18, -1e18, 1e300])
@pytest.mark.parametrize("since", [0.0, 1.7e9])
def test_times_that_no_clock_shows_are_told_where_they_stand(
    tmp_path: Path, faults_of, absurd: float, since: float
) -> None:
    columns = motion()
    columns["time_s"] = columns["time_s"] + since
    columns["time_s"][[100, 200]] = absurd
    faults = faults_of(read, tmp_path, columns).faults
    assert [fault.line for fault in faults] == [102, 202]
    assert {fault.message for fault in faults} == {"a time that no clock shows"}
    assert {fault.got for fault in faults} == {f"{absurd:g} s"}


def test_duplicates(tmp_path: Path) -> None:
    columns = motion()
    again = {name: np.insert(data, 50, data[49]) for name, data in columns.items()}
    log = read(tmp_path, again)
    remark = found(log, "duplicate")
    assert (remark.severity, remark.line, remark.count) == ("warning", 52, 1)
    np.testing.assert_allclose(log.power_w["robot"], columns["power_robot_w"], rtol=1e-8)
    again["power_robot_w"][50] += 2.0
    log = read(tmp_path, again)
    assert found(log, "duplicate").severity == "warning"
    assert log.power_w["robot"][49] == pytest.approx(columns["power_robot_w"][49] + 1.0, rel=1e-8)


def test_a_repeat_with_other_values_is_told_by_itself_and_costs_no_run(tmp_path: Path) -> None:
    columns = motion()
    twice = np.repeat(np.arange(400), np.where(np.arange(400) % 20 == 7, 2, 1))
    again = {name: data[twice] for name, data in columns.items()}
    other = int(np.flatnonzero(np.diff(again["time_s"]) == 0.0)[4]) + 1
    again["yaw_rate_rad_s"] = again.get("yaw_rate_rad_s", np.zeros(len(twice))) + 0.0
    again["yaw_rate_rad_s"][other] += 0.001
    log = read(tmp_path, again)
    same, differs = (r for r in log.remarks if r.kind == "duplicate")
    assert (same.count, same.line, same.severity) == (19, 10, "warning")
    assert same.message == "19 rows with the time of the row before"
    assert (differs.count, differs.line, differs.severity) == (1, other + 2, "warning")
    assert differs.message == "1 row with the time of the row before and other values"
    assert not [fault for fault in check_log(tmp_path / "run.csv") if fault.severity == "error"]


@pytest.mark.parametrize(("part", "refused"), [(0.08, False), (0.12, True), (0.5, True)])
def test_many_times_with_other_values_are_refused(tmp_path: Path, part: float, refused: bool) -> None:
    columns = motion()
    # of each hundred rows some have the time of the row before
    step = round(1.0 / part)
    columns["time_s"] = np.where(np.arange(400) % step == 1, np.roll(columns["time_s"], 1), columns["time_s"])
    log = read(tmp_path, columns)
    assert (found(log, "duplicate").severity == "error") == refused


def test_a_value_beside_a_hole_at_the_same_time_is_no_other_value(tmp_path: Path) -> None:
    columns = motion()
    again = {name: np.insert(data, 50, data[49]) for name, data in columns.items()}
    again["power_robot_w"][49] = np.nan
    log = read(tmp_path, again)
    assert found(log, "duplicate").message == "1 row with the time of the row before"
    np.testing.assert_allclose(log.power_w["robot"], columns["power_robot_w"], rtol=1e-8)


def test_gap_and_lost_rows_keep_the_time(tmp_path: Path) -> None:
    columns = motion()
    keep = np.ones(400, dtype=bool)
    keep[100:160] = False
    log = read(tmp_path, {name: data[keep] for name, data in columns.items()})
    remark = found(log, "gap")
    assert "1 gap, the longest 30.5 s after 49.75 s" in remark.message
    assert log.duration_s == pytest.approx(200.0)


def test_missing_values_are_filled_near_and_left_out_far(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"][[10, 50]] = np.nan
    columns["speed_m_s"][200:240] = np.nan
    log = read(tmp_path, columns)
    kinds = [(r.column, r.count) for r in log.remarks if r.kind == "missing"]
    assert kinds == [("power_robot_w", 2), ("speed_m_s", 40), ("", 40)]
    assert log.rows == 360
    expected = 0.5 * (columns["power_robot_w"][9] + columns["power_robot_w"][11])
    assert log.power_w["robot"][10] == pytest.approx(expected)
    assert not np.isnan(log.number("speed_m_s")).any()
    assert log.duration_s == pytest.approx(180.0)


def test_an_optional_column_missing_too_long_is_left_out(tmp_path: Path) -> None:
    columns = motion()
    columns["slope_rad"] = np.where(np.arange(400) < 250, 0.01 * np.sin(np.arange(400)), np.nan)
    log = read(tmp_path, columns)
    assert "slope_rad" not in log.columns
    assert log.rows == 400
    assert any(r.column == "slope_rad" and r.action == "the column was left out" for r in log.remarks)
    # a run without a speed says hardly anything: odometry that was silent for a third of it takes its rows along
    columns = motion()
    columns["speed_m_s"] = np.where((np.arange(400) < 120) | (np.arange(400) > 250), columns["speed_m_s"], np.nan)
    assert read(tmp_path, columns).rows == 400 - 131


def test_temperature_is_held(tmp_path: Path) -> None:
    columns = motion()
    columns["temp_ambient_c"] = np.where(np.arange(400) % 40 == 3, 20.0 + np.arange(400) // 40, np.nan)
    log = read(tmp_path, columns)
    assert log.rows == 400
    assert log.number("temp_ambient_c")[[0, 3, 42, 43, 399]].tolist() == [20.0, 20.0, 20.0, 21.0, 29.0]


def test_sparse_power_is_a_slow_topic(tmp_path: Path) -> None:
    columns = motion(2000, 0.1)
    columns["power_robot_w"] = np.where(np.arange(2000) % 10 == 5, columns["power_robot_w"], np.nan)
    log = read(tmp_path, columns)
    fresh = log.fresh["robot"]
    assert fresh is not None
    assert np.flatnonzero(fresh).tolist() == list(range(5, 2000, 10))


def test_power_repeated_from_a_slower_topic_counts_once(tmp_path: Path) -> None:
    columns = motion(4000, 0.05)
    slow = columns["power_robot_w"][::20]
    columns["power_robot_w"] = np.repeat(slow, 20)
    log = read(tmp_path, columns)
    assert "about 1 Hz in rows of 20 Hz" in found(log, "repeated").message
    fresh = log.fresh["robot"]
    assert fresh is not None
    assert np.flatnonzero(fresh).tolist() == list(range(0, 4000, 20))


def test_a_current_that_is_held_counts_once_though_the_voltage_drifts(tmp_path: Path) -> None:
    columns = motion(4000, 0.2)
    columns["current_robot_a"] = np.repeat(columns.pop("power_robot_w")[::5] / 24.0, 5)
    columns["voltage_robot_v"] = np.round(24.0 - 0.0005 * np.arange(4000), 2)
    fresh = read(tmp_path, columns).fresh["robot"]
    assert fresh is not None
    assert np.flatnonzero(fresh).tolist() == list(range(0, 4000, 5))


def test_no_payload_is_a_payload_like_others_and_no_missing_word(tmp_path: Path) -> None:
    told = {}
    for word in ("none", "heavy", "NaN"):
        path = write_csv(tmp_path / f"{word}.csv", {**motion(), "temp_ambient_c": np.full(400, np.nan)})
        lines = path.read_text(encoding="utf-8").splitlines()
        lines = [f"{lines[0]},payload", *(f"{line},{word}" for line in lines[1:])]
        path.write_text("\n".join(lines).replace("nan", word if word == "none" else "") + "\n", encoding="utf-8")
        for log in (read_log(path), *iter_blocks(path, rows=300)):
            assert "temp_ambient_c" not in log.columns
            told[word] = str(log.columns["payload"].texts()[0]) if "payload" in log.columns else ""
    assert told == {"none": "none", "heavy": "heavy", "NaN": ""}


def test_frozen_sensor(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"][100:150] = columns["power_robot_w"][100]
    log = read(tmp_path, columns)
    remark = found(log, "frozen")
    assert (remark.column, remark.line, remark.count) == ("power_robot_w", 102, 49)
    fresh = log.fresh["robot"]
    assert fresh is not None
    assert (~fresh).sum() == 49


@pytest.mark.parametrize(("column", "noise"), [("speed_m_s", 0.005), ("yaw_rate_rad_s", 0.03)])
def test_noise_at_rest_that_counts_as_driving_is_told(tmp_path: Path, column: str, noise: float) -> None:
    columns = motion(2000, 0.1)
    rest = (columns["time_s"] > 60) & (columns["time_s"] < 120)
    for name in ("speed_m_s", "yaw_rate_rad_s"):
        columns[name] = np.where(rest, 0.0, columns[name])
    assert all(r.kind != "standstill" for r in read(tmp_path, columns).remarks)
    columns[column] = columns[column] + np.where(rest, np.random.default_rng(1).normal(0.0, noise, 2000), 0.0)
    remark = found(read(tmp_path, columns), "standstill", column)
    assert "count as driving" in remark.message
    assert f"where(abs({column}) < " in remark.action
    assert 100 < remark.count < 600


@pytest.mark.parametrize(
    ("bias", "noise", "told", "formula"),
    [
        (0.035, 0.015, "0.034", "where(abs(yaw_rate_rad_s - 0.034) < 0.04, 0, yaw_rate_rad_s - 0.034)"),
        (-0.04, 0.02, "-0.041", "where(abs(yaw_rate_rad_s + 0.041) < 0.06, 0, yaw_rate_rad_s + 0.041)"),
        (0.025, 0.006, "0.025", "yaw_rate_rad_s - 0.025"),
        (0.05, 0.001, "0.05", "yaw_rate_rad_s - 0.05"),  # no row at rest is below the limit
    ],
)
def test_a_bias_at_rest_is_told_as_one_and_the_map_takes_it_away(
    tmp_path: Path, bias: float, noise: float, told: str, formula: str
) -> None:
    """It was called noise, to be set to zero at rest, which leaves it in all motion and in every turn."""
    columns = motion(2000, 0.1)
    rest = (columns["time_s"] > 60) & (columns["time_s"] < 120)
    for name in ("speed_m_s", "yaw_rate_rad_s"):
        columns[name] = np.where(rest, 0.0, columns[name])
    columns["speed_m_s"] = np.where(rest, 0.0, columns["speed_m_s"] + 0.06)
    columns["yaw_rate_rad_s"] *= np.where(columns["time_s"] > 150, -1.0, 1.0)
    columns["yaw_rate_rad_s"] += bias + np.random.default_rng(1).normal(0.0, noise, 2000)
    remark = found(read(tmp_path, columns), "standstill")
    assert remark.column == "yaw_rate_rad_s"
    assert f"a bias of {told} rad/s at rest" in remark.message
    assert "count as driving" in remark.message
    assert remark.action.endswith(f": {formula}")
    lines = ["kind: map", "name: level", "others: true", "columns:"]
    lines += [f"  {name}: {name}" for name in ("time_s", "power_robot_w", "speed_m_s")]
    (tmp_path / "level.yaml").write_text("\n".join([*lines, f"  yaw_rate_rad_s: {formula}", ""]))
    (level,) = import_log([tmp_path / "run.csv"], tmp_path / "level.yaml")
    assert not [r for r in level.remarks if r.kind == "standstill"]
    assert float(np.mean(np.asarray(level.columns["yaw_rate_rad_s"])[rest])) == pytest.approx(0.0, abs=0.002)


def test_noise_without_its_sign_and_turns_on_the_spot_are_no_bias(tmp_path: Path) -> None:
    columns = motion(2000, 0.1)
    rest = (columns["time_s"] > 60) & (columns["time_s"] < 120)
    noise = np.random.default_rng(1).normal(0.0, 0.03, (3, 2000))
    columns["speed_m_s"] = np.where(rest, 0.0, columns["speed_m_s"] + 0.06)
    turns = np.where(columns["time_s"] < 90, 0.03, -0.03) + 0.3 * noise[0]
    moves = columns["yaw_rate_rad_s"]
    for yaw, others in ((np.abs(noise[0]), np.abs(moves)), (np.hypot(*noise[:2]), np.abs(moves)), (turns, moves)):
        columns["yaw_rate_rad_s"] = np.where(rest, yaw, others)
        assert "noise at rest" in found(read(tmp_path, columns), "standstill").message
    columns["yaw_rate_rad_s"] = np.where(rest, 0.0, columns["yaw_rate_rad_s"])
    columns["speed_m_s"] = np.where(rest, np.linalg.norm(0.1 * noise, axis=0), columns["speed_m_s"])
    assert "noise at rest" in found(read(tmp_path, columns), "standstill").message
    # half of the time without speed it turns slowly, and stands in the other half
    columns["speed_m_s"] = np.where(rest, 0.0, columns["speed_m_s"])
    columns["yaw_rate_rad_s"] = np.where(rest & (columns["time_s"] < 90), 0.05, columns["yaw_rate_rad_s"])
    assert not [r for r in read(tmp_path, columns).remarks if r.kind == "standstill"]
    # it never stands, and turns faster than any bias now and then
    columns["yaw_rate_rad_s"] = np.where(rest, 0.08 + noise[0], columns["yaw_rate_rad_s"])
    assert not [r for r in read(tmp_path, columns).remarks if r.kind == "standstill"]


@pytest.mark.parametrize("crawls", [False, True])
def test_noise_that_leaves_no_row_at_rest_is_told_by_the_power(tmp_path: Path, crawls: bool) -> None:
    """A speed that wanders by 0.1 m/s while the robot stands; a robot that crawls as slowly needs power for it."""
    rng = np.random.default_rng(3)
    speed = np.repeat([0.0, 1.0, 0.0, 1.6, 0.0, 0.6], 50)
    noise = np.abs(rng.normal(0.0, 0.1, 300))
    power = 30.0 + 50.0 * (speed + crawls * noise) + rng.normal(0.0, 1.0, 300)
    columns = {"time_s": np.arange(300.0), "speed_m_s": speed + noise, "power_robot_w": power}
    told = [r for r in read(tmp_path, columns).remarks if r.kind == "standstill"]
    assert bool(told) is not crawls
    if told:
        assert 130 < told[0].count < 151
        assert "where(abs(speed_m_s) < 0.3, 0, speed_m_s)" in told[0].action


@pytest.mark.parametrize("step_w", [1e-6, 0.2])
def test_a_meter_that_is_cut_off_is_told(tmp_path: Path, step_w: float) -> None:
    columns = motion()
    noisy = columns["power_robot_w"] + np.random.default_rng(2).normal(0.0, 1.0, 400)
    columns["power_robot_w"] = np.round(noisy / step_w) * step_w
    assert not [r for r in read(tmp_path, columns).remarks if r.kind == "ceiling"]
    most = float(np.quantile(columns["power_robot_w"], 0.9))
    remark = found(read(tmp_path, {**columns, "power_robot_w": np.minimum(columns["power_robot_w"], most)}), "ceiling")
    assert remark.count == pytest.approx(40, abs=3)
    assert f"({remark.count / 4:.0f} %)" in remark.message
    # without noise the power of the usual speed stands where it is, as that at rest does
    steps = np.repeat([20.0, 60.0, 60.0, 60.0, 20.0, 60.0, 60.0, 60.0], 50)
    assert not [r for r in read(tmp_path, {**columns, "power_robot_w": steps}).remarks if r.kind == "ceiling"]


def test_rolling_to_a_stop_and_off_again_is_no_noise_at_rest(tmp_path: Path) -> None:
    """A wheel that gives back what it took: little power at any low speed, up to the last that may be one of rest."""
    time = np.arange(0.1, 400.0, 0.2)
    speed = 8.5 * np.abs(np.sin(np.pi * time / 40.0))
    power = 14.0 + 0.8 * speed**3 + 20.0 * np.random.default_rng(1).normal(size=len(time))
    log = read(tmp_path, {"time_s": time, "speed_m_s": speed, "power_robot_w": power})
    assert not [r for r in log.remarks if r.kind == "standstill"]


def test_a_robot_that_stands_is_not_frozen(tmp_path: Path) -> None:
    columns = motion()
    columns["speed_m_s"][100:200] = 0.0
    columns["x_m"] = 0.5 * np.cumsum(columns["speed_m_s"])
    assert not [r for r in read(tmp_path, columns).remarks if r.kind == "frozen"]
    columns["x_m"][220:300] = columns["x_m"][220]
    assert found(read(tmp_path, columns), "frozen").column == "x_m"


def test_meter_off_while_driving(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"][:40] = 0.0
    remark = found(read(tmp_path, columns), "frozen")
    assert "exactly zero in" in remark.message


def test_a_part_that_is_off_and_a_car_whose_battery_logs_volt_and_ampere_are_no_faults(tmp_path: Path) -> None:
    columns = motion()
    columns["speed_m_s"] *= 30.0
    columns["current_robot_a"] = 400.0 * columns.pop("power_robot_w") / 360.0
    columns["voltage_robot_v"] = np.full(400, 360.0)
    columns["power_ac_w"] = np.zeros(400)
    columns["power_heater_w"] = np.where(np.arange(400) < 150, 5000.0, 0.0)
    assert [str(r) for r in read(tmp_path, columns).remarks if r.severity != "note"] == []


@pytest.mark.parametrize(
    ("column", "change", "severity", "said"),
    [
        ("speed_m_s", lambda c: c["speed_m_s"] * 36.0, "warning", "km/h"),
        ("yaw_rate_rad_s", lambda c: np.degrees(c["yaw_rate_rad_s"]), "warning", "degrees"),
        ("power_robot_w", lambda c: c["power_robot_w"] * 1e4, "warning", "milliwatts"),
    ],
)
def test_units_without_a_second_witness(tmp_path: Path, column: str, change, severity: str, said: str) -> None:
    columns = motion()
    columns[column] = change(columns)
    remark = found(read(tmp_path, columns), "unit", column)
    assert remark.severity == severity
    assert said in remark.message


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("power_robot_w", 1000.0, "1,000 times voltage × current"),
        ("current_robot_a", 1000.0, "1/1,000 times voltage × current"),
        ("voltage_robot_v", 1000.0, "1/1,000 times voltage × current"),
        ("current_robot_a", -1.0, "−1 (the sign) times voltage × current"),
        ("energy_robot_wh", 3600.0, "3,600 times the sum of power"),
        ("speed_m_s", 3.6, "3.6 (km/h) times the path of x_m, y_m"),
        ("yaw_rate_rad_s", 180 / np.pi, "57.3 (degrees) times the changes of heading_rad"),
        ("accel_m_s2", 1000.0, " times the changes of speed_m_s"),
    ],
)
def test_units_against_another_column(tmp_path: Path, column: str, factor: float, said: str) -> None:
    columns = _rich()
    assert [r.kind for r in read(tmp_path, columns).remarks] == []
    columns[column] = columns[column] * factor
    log = read(tmp_path, columns)
    messages = [r.message for r in log.remarks if r.kind == "unit" and r.severity == "error"]
    assert any(said in message for message in messages), [str(r) for r in log.remarks]
    assert any(fault.severity == "error" for fault in check_log(tmp_path / "run.csv"))


@pytest.mark.parametrize(("sign", "kinds"), [(1.0, []), (-1.0, ["unit"])])
def test_the_sign_of_an_acceleration_whose_sensor_is_not_level(tmp_path: Path, sign: float, kinds: list[str]) -> None:
    """In one of four runs alone the wrong sign was seen, and that one left out."""
    columns = _rich()
    columns["accel_m_s2"] = sign * columns["accel_m_s2"] + 0.5
    assert [remark.kind for remark in read(tmp_path, columns).remarks] == kinds


def _rich() -> dict[str, np.ndarray]:
    columns = motion()
    time, speed, power = columns["time_s"], columns["speed_m_s"], columns["power_robot_w"]
    columns["voltage_robot_v"] = 24.0 - 0.05 * power
    columns["current_robot_a"] = power / columns["voltage_robot_v"]
    columns["energy_robot_wh"] = np.cumsum(power) * 0.5 / 3600
    columns["heading_rad"] = np.cumsum(columns["yaw_rate_rad_s"]) * 0.5
    columns["x_m"] = np.cumsum(speed * np.cos(columns["heading_rad"])) * 0.5
    columns["y_m"] = np.cumsum(speed * np.sin(columns["heading_rad"])) * 0.5
    columns["accel_m_s2"] = np.gradient(speed, time)
    return columns


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("slope_rad", 4.0, "outside -1.3 … 1.3 rad"),
        ("cpu_load", 55.0, "outside 0 … 1,"),
        ("temp_ambient_c", 293.0, "outside -90 … 90 degC"),
    ],
)
def test_a_whole_column_out_of_range(tmp_path: Path, column: str, value: float, said: str) -> None:
    columns = motion()
    columns[column] = value * (1 + 0.01 * np.sin(np.arange(400)))
    remark = found(read(tmp_path, columns), "range", column)
    assert said in remark.message
    assert remark.severity == "error"
    assert remark.count == 400


def test_single_readings_out_of_range_count_as_missing(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"][33] = 1e9
    log = read(tmp_path, columns)
    assert found(log, "range").line == 35
    assert log.power_w["robot"][33] == pytest.approx(
        0.5 * (columns["power_robot_w"][32] + columns["power_robot_w"][34])
    )


def test_charging_sign(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"] *= -1
    remark = found(read(tmp_path, columns), "sign")
    assert remark.severity == "error"
    assert "what it delivers is positive" in remark.message
    columns["power_robot_w"] = -columns["power_robot_w"] - 60.0  # under a sun that gives more than the robot needs
    remark = found(read(tmp_path, columns), "sign")
    assert remark.severity == "warning"
    assert "does the sun feed it?" in remark.message


def test_rows_of_a_disturbed_meter_are_told(tmp_path: Path) -> None:
    columns = motion()
    columns["power_robot_w"][[50, 150, 250]] = 9000.0
    assert "3 rows alone at up to 9000 W" in found(read(tmp_path, columns), "range", "power_robot_w").message


def test_what_is_written_only_where_it_changes_is_held(tmp_path: Path) -> None:
    """Rows far from a change of the voltage were left out: two thirds of the energy."""
    columns = motion()
    watts, volts = columns.pop("power_robot_w"), np.full(400, np.nan)
    changes = np.unique(np.r_[0, np.cumsum(np.random.default_rng(1).geometric(0.08, size=28))])
    volts[changes] = 24.0 + 0.1 * (np.arange(len(changes)) % 2)
    log = read(tmp_path, {**columns, "voltage_robot_v": volts, "current_robot_a": watts / 24.05})
    assert log.rows == 400
    assert log.energy_wh("robot") == pytest.approx(float(watts.sum()) * 0.5 / 3600.0, rel=0.01)


def test_what_a_robot_takes_at_the_dock_is_left_out(tmp_path: Path) -> None:
    columns = motion()
    rest = (columns["time_s"] > 120) & (columns["time_s"] < 170)
    for name in ("speed_m_s", "yaw_rate_rad_s"):
        columns[name] = np.where(rest, 0.0, columns[name])
    noise = 0.05 * np.random.default_rng(4).normal(size=400)
    columns["power_robot_w"] = np.where(rest, 4.0 + noise, columns["power_robot_w"])
    assert read(tmp_path, columns).remarks == ()
    # a while on the ground, then at the dock, whose charger feeds the robot once the battery is full
    columns["power_robot_w"] = np.where(rest & (columns["time_s"] > 130), -60.0, columns["power_robot_w"])
    columns["power_robot_w"] = np.where(rest & (columns["time_s"] > 160), 0.0, columns["power_robot_w"])
    log = read(tmp_path, columns)
    remark = found(log, "charging", "power_robot_w")
    assert "charged with 60 W on average" in remark.message
    there = np.isin(columns["time_s"], log.time_s)
    assert np.flatnonzero(~there).tolist() == list(range(259, 341))  # and a row of both at the contact and as it leaves
    assert log.energy_wh("robot") == pytest.approx(float(columns["power_robot_w"][there].sum()) * 0.5 / 3600.0)
    assert read(tmp_path, {**columns, "solar_w": np.where(rest, 70.0, 10.0)}).rows == 400  # what feeds it is known
    # a short visit to the dock; what a drive gives back in stopping takes no ten seconds, and a descent is no rest
    for begin, kept in ((130, 318), (121, 400)):
        there = rest & (columns["time_s"] > begin) & (columns["time_s"] < begin + 7)
        columns["power_robot_w"] = np.where(rest, np.where(there, -60.0, 4.0 + noise), columns["power_robot_w"])
        assert read(tmp_path, columns).rows == kept
    # noise about nought is no charger
    columns["power_robot_w"] = np.where(rest, 40.0 * noise, columns["power_robot_w"])
    assert read(tmp_path, columns).rows == 400


@pytest.mark.parametrize("name", ["out.csv", "out.parquet"])
def test_a_run_that_is_written_is_read_as_the_same(tmp_path: Path, name: str) -> None:
    """The rows beside those that were left out, at a charger or in a hole, stood for their time: + 38 % of energy."""
    columns = motion()
    rest, hole = (
        (columns["time_s"] > 120) & (columns["time_s"] < 170),
        (columns["time_s"] > 50) & (columns["time_s"] < 80),
    )
    for column in ("speed_m_s", "yaw_rate_rad_s"):
        columns[column] = np.where(rest, 0.0, columns[column])
    columns["power_robot_w"] = np.where(rest, -60.0, np.where(hole, np.nan, columns["power_robot_w"]))
    log = read(tmp_path, columns)
    for _ in range(2):
        write_log(log, tmp_path / name)
        again = read_log(tmp_path / name)
        assert again.energy_wh("robot") == pytest.approx(log.energy_wh("robot"))
        assert (again.rows, again.duration_s) == (log.rows, pytest.approx(log.duration_s))
        log = again


@pytest.mark.parametrize(
    ("factor", "unit"), [(1, "seconds"), (1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_epochs_of_every_unit(tmp_path: Path, factor: float, unit: str) -> None:
    columns = motion()
    stamps = [f"{1_700_000_000 * factor + t * factor:.{3 if factor == 1 else 0}f}" for t in columns["time_s"]]
    path = write_csv(tmp_path / "a.csv", {**columns, "time_s": stamps})
    log = read_log(path)
    assert log.time_s[0] == 0
    np.testing.assert_allclose(np.diff(log.time_s), 0.5, atol=2e-3)
    assert f"recognised as {unit} since 1970" in found(log, "clock").message
    blocks = list(iter_blocks(path, rows=100))
    assert [round(float(block.time_s[0])) for block in blocks] == sorted({round(float(b.time_s[0])) for b in blocks})
    assert blocks[-1].time_s[-1] == pytest.approx(log.time_s[-1], abs=1e-3)


def test_names(tmp_path: Path) -> None:
    columns = motion()
    columns["yaw_rate_rads"] = columns.pop("yaw_rate_rad_s")
    columns["fan_rpm"] = np.sin(np.arange(400))
    remark = found(read(tmp_path, columns), "name")
    assert remark.message == "not a name of the glossary; did you mean yaw_rate_rad_s?"
    assert remark.column == "yaw_rate_rads"


@pytest.mark.parametrize("delay_s", [-0.8, 0.0, 0.4, 1.1])
@pytest.mark.parametrize("step_s", [0.1, 0.25])
def test_clock_delay(delay_s: float, step_s: float) -> None:
    columns = motion(1500, step_s)
    time = columns["time_s"]
    power = np.interp(time - delay_s, time, columns["power_robot_w"])
    estimate = clock_delay(time, power, columns["speed_m_s"], columns["yaw_rate_rad_s"])
    assert estimate is not None
    assert estimate.delay_s == pytest.approx(delay_s, abs=0.5 * step_s)


def test_clock_remark(tmp_path: Path) -> None:
    columns = motion(1500, 0.1)
    columns["power_robot_w"] = np.interp(columns["time_s"] - 0.6, columns["time_s"], columns["power_robot_w"])
    remark = found(read(tmp_path, columns), "clock")
    assert "later than the motion" in remark.message
    assert remark.severity == "note"


def test_no_clock_from_noise() -> None:
    rng = np.random.default_rng(3)
    time = np.arange(500) * 0.5
    assert clock_delay(time, rng.normal(size=500), rng.normal(size=500)) is None
    assert clock_delay(time, np.ones(500), np.zeros(500)) is None
    assert clock_delay(time[:20], np.ones(20), np.ones(20)) is None


def test_voltage_times_current(tmp_path: Path) -> None:
    columns = _rich()
    del columns["power_robot_w"], columns["energy_robot_wh"]
    log = read(tmp_path, columns)
    assert log.power_from["robot"] == "voltage*current"
    np.testing.assert_allclose(log.power_w["robot"], motion()["power_robot_w"], rtol=1e-7)


def test_energy_counter_fine_and_coarse(tmp_path: Path) -> None:
    columns = _rich()
    total = columns["energy_robot_wh"][-1] - columns["energy_robot_wh"][0]
    for name in ("power_robot_w", "voltage_robot_v", "current_robot_a"):
        del columns[name]
    log = read(tmp_path, columns)
    assert (log.power_from["robot"], log.fresh["robot"]) == ("energy", None)
    inside = log.power_w["robot"][1:-1] @ log.dt_s[1:-1] / 3600
    assert inside == pytest.approx(total, rel=0.01)
    coarse = dict(columns, energy_robot_wh=np.floor(columns["energy_robot_wh"] / 0.01) * 0.01)
    log = read(tmp_path, coarse)
    fresh = log.fresh["robot"]
    assert fresh is not None
    assert fresh.sum() == len(np.unique(coarse["energy_robot_wh"])) - 1
    assert log.energy_wh("robot") == pytest.approx(total, abs=0.02)
    assert "the counter moves in" in found(log, "repeated").message


def test_power_from_energy_is_exact_where_power_is_constant() -> None:
    time = np.array([0.0, 1.0, 3.0, 4.0, 8.0])
    power, fresh = power_from_energy(7.2 * time / 3600, time)
    np.testing.assert_allclose(power, 7.2)
    assert fresh is None
    power, fresh = power_from_energy(np.array([0.0, 0.0, 0.0, 8.0, 8.0]) / 3600, time)
    np.testing.assert_allclose(power, 2.0)
    assert fresh is not None
    assert fresh.tolist() == [False, False, False, True, False]
    power, _ = power_from_energy(np.zeros(5), time)
    np.testing.assert_array_equal(power, np.zeros(5))


def test_refreshes_period() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(1000) * 0.1
    slow = refreshes(np.repeat(rng.normal(size=200), 5), time)
    assert slow is not None
    assert slow.period_s == pytest.approx(0.5)
    assert refreshes(rng.normal(size=1000), time) is None
    assert refreshes(np.full(1000, 3.0), time) is None
    assert refreshes(np.repeat([1.0, 2.0, 1.0, 2.0], 250), time) is None
    # two rows for each interval of a simulation, its two ends, are no meter of half the rate
    begins = np.cumsum(rng.uniform(0.2, 60.0, 200))
    ends = np.append(begins[1:] - 1e-6, begins[-1] + 1.0)
    assert refreshes(np.repeat(rng.normal(size=200), 2), np.column_stack([begins, ends]).ravel()) is None


def test_a_rounded_topic_that_reads_the_same_again_was_refreshed() -> None:
    """Not so where it stays for long, nor one of fine steps: nobody knows what that would have read."""
    rng = np.random.default_rng(4)
    watts = 20.0 * np.round(70.0 + 40.0 * np.sin(np.arange(200) / 9.0) + rng.normal(0.0, 6.0, 200))
    watts[100:108], watts[150:180] = 500.0, 700.0
    watts[[99, 108, 149, 180]] = 240.0
    fine = watts + np.cumsum(rng.normal(0.0, 0.1, 200))
    fine[100:108] = fine[100]
    time = 0.1 * np.arange(2000)
    found = [refreshes(np.repeat(w, 10), time) for w in (watts, fine)]
    fresh = [set(np.flatnonzero(one.fresh)) if one is not None else set() for one in found]
    every = set(range(0, 2000, 10))
    assert every - fresh[0] == set(range(1510, 1800, 10))
    assert every - fresh[1] == set(range(1010, 1080, 10))


@pytest.mark.parametrize("seconds", [200, 2000])
def test_a_coarse_meter_that_is_read_once_a_second_is_seen_in_every_run(seconds: int) -> None:
    """Its readings come back, the more so the longer the run is; those of a meter read in each row do at once."""
    rng = np.random.default_rng(5)
    speed = np.repeat(rng.choice([0.0, 0.2, 0.5], seconds // 20), 20)
    watts = 11.0 + 40.0 * speed + rng.normal(0.0, 0.3, seconds)
    time = 0.1 * np.arange(10 * seconds)
    held = refreshes(0.5 * np.round(2.0 * np.repeat(watts, 10)), time)
    assert held is not None
    assert held.period_s == pytest.approx(1.0)
    assert {*range(0, 10 * seconds, 10)} <= {*np.flatnonzero(held.fresh).tolist()}
    each_row = np.repeat(watts, 10) + rng.normal(0.0, 0.3, 10 * seconds)
    assert refreshes(0.5 * np.round(2.0 * each_row), time) is None
    duty = np.repeat(np.tile([11.0, 14.0], seconds // 2), 10)  # a load that comes and goes is no topic
    assert refreshes(duty, time) is None


@pytest.mark.parametrize("seed", [1, 3])
def test_readings_of_half_a_second_are_two_and_three_rows_of_a_fifth_by_turns(seed: int) -> None:
    """Of two rows or of three in a run alone, each reading that came again at once was half a row off, and so was the
    clock: with 5.75 W in place of 2.80 W of error in the worlds where it was seen."""
    rng = np.random.default_rng(seed)
    time = 0.2 * np.arange(2000) + rng.uniform(-0.06, 0.06, 2000)
    watts = 100.0 + 15.0 * np.repeat(rng.normal(size=80), 10) + rng.normal(0.0, 2.0, 800)
    held = refreshes(2.0 * np.round(0.5 * watts[((time + 0.1) / 0.5).astype(int)]), time)
    assert held is not None
    assert held.period_s == pytest.approx(0.5, abs=0.01)
    assert int(held.fresh.sum()) == pytest.approx(800, rel=0.02)


@pytest.mark.parametrize(("seconds", "held"), [((240.0, 240.0, 40.0), True), ((60.0, 60.0, 40.0), False)])
def test_a_meter_is_refreshed_alike_in_all_runs(tmp_path: Path, seconds: tuple[float, ...], held: bool) -> None:
    """In one it showed a few values alone: half a refresh later than in the others, which their clocks took."""
    rng = np.random.default_rng(7)
    for number, (length, spread) in enumerate(zip(seconds, (3.0, 3.0, 0.7), strict=True)):
        power = np.repeat(2.5 * np.round(8.0 + spread * rng.normal(size=int(4 * length))), 5)
        columns = {"time_s": 0.05 * np.arange(len(power)), "power_robot_w": power}
        write_csv(tmp_path / f"run{number}.csv", columns | {"speed_m_s": 0.5 + 0.01 * rng.normal(size=len(power))})
    alone = [read_log(tmp_path / f"run{i}.csv").fresh["robot"] is not None for i in range(3)]
    assert alone == [True, True, False]
    together = read_logs(tmp_path)
    assert [log.fresh["robot"] is not None for log in together] == [held] * 3
    told = [[r.message for r in log.remarks if (r.kind, r.column) == ("repeated", "power_robot_w")] for log in together]
    assert [len(words) for words in told] == [int(held)] * 3
    if held:
        assert told[2] == ["refreshed as in the other runs, slower than its rows"]
        assert together[2].reading_s("robot") == pytest.approx(0.25)


@pytest.mark.parametrize("text", ["", "mud"])
def test_a_floor_that_no_run_tells_is_no_column(tmp_path: Path, text: str) -> None:
    for number, floor in enumerate(("", text)):
        rows = [f"{t},{10 + number + t % 3},0.{t % 4},{floor}" for t in range(30)]
        (tmp_path / f"run{number}.csv").write_text("\n".join(["time_s,power_robot_w,speed_m_s,surface", *rows, ""]))
    assert ["surface" in log.columns for log in read_logs(tmp_path)] == [bool(text)] * 2


def test_the_robot_sharpens_the_checks(tmp_path: Path) -> None:
    from missionsim.inputs import load_robot

    robot = load_robot("pioneer3dx")
    columns = motion()
    columns["speed_m_s"] = columns["speed_m_s"] * 3.6
    columns["on_kinectt"] = np.ones(400)
    columns["power_robott_w"] = columns["power_robot_w"] * 2
    log = read_log(write_csv(tmp_path / "run.csv", columns), robot=robot)
    messages = {r.column: r.message for r in log.remarks if r.kind in ("unit", "name")}
    assert "did you mean kinect?" in messages["on_kinectt"]
    assert "did you mean robot?" in messages["power_robott_w"]
    assert "the robot drives" in messages["speed_m_s"]
