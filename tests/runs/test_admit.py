"""Runs that must not be learnt from are named with their fault, first, and the exit code says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import missionsim
from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.inputs.loading import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.labels import Labels
from missionsim.logs import Remark, read_logs
from missionsim.runs.admit import admit, admit_to_test, unchanging, unfit_runs
from missionsim.runs.alike import copies
from missionsim.runs.run import Run
from tests.diagnose.logs import drive
from tests.hidden_effects.study import ALL_CASES
from tests.hidden_effects.world import make
from tests.hidden_effects.world import write as write_world
from tests.rough import regimes
from tests.rough.world import WORLDS, write

pytestmark = pytest.mark.usefixtures("examined_once")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return [drive(seed, seconds=200.0) for seed in range(5)]


def told(runs: list[Run]) -> list[str]:
    kept, lines = admit(runs, build_power_model(load_robot("pioneer3dx")))
    assert len(kept) + len(lines) == len(runs)
    return lines


def test_good_runs_are_all_learnt_from(runs: list[Run]) -> None:
    assert told(runs) == []


def test_a_run_without_a_speed_stops_nobody(runs: list[Run]) -> None:
    still = replace(runs[2], columns={n: data for n, data in runs[2].columns.items() if n != "speed_m_s"})
    (line,) = told([*runs[:2], still, *runs[3:]])
    assert line == "run_02: it has no speed_m_s, which most runs have: it cannot be driven"


def test_a_switch_that_is_inverted_everywhere_is_told(runs: list[Run]) -> None:
    """The model is too high where it is on, and too low where it is off: no effect was named, and the error stayed."""
    turned = [replace(run, columns={**run.columns, "on_kinect": 1.0 - run.columns["on_kinect"]}) for run in runs]
    with pytest.raises(
        InputError, match=r"on_kinect: the power falls by 2.8.* is it inverted\? A map turns it"
    ) as error:
        admit(turned, build_power_model(load_robot("pioneer3dx")))
    assert str(error.value).endswith(f"(all {len(runs)} runs)")
    still = [replace(run, columns={"time_s": run.time_s, "on_kinect": run.columns["on_kinect"]}) for run in runs]
    admit(still, build_power_model(load_robot("pioneer3dx")))


def test_a_load_that_runs_while_another_rests_makes_no_inverted_switch(runs: list[Run]) -> None:
    """A heater of 5 W whenever the camera of 2.8 W is off."""
    heated = [
        replace(run, power_w={"robot": run.power_w["robot"] + 5.0 * (1.0 - run.columns["on_kinect"])}) for run in runs
    ]
    assert told(heated) == []


def test_a_switch_that_is_stuck_is_told_where_the_power_lacks_what_it_switches(runs: list[Run]) -> None:
    """A camera that is on now and then, and in one run off all the time but logged as on."""
    made = []
    for number, run in enumerate(runs):
        on = run.columns["on_kinect"]
        seldom = on * (run.time_s < 60.0) * (number != 2)
        columns = {**run.columns, "on_kinect": np.ones(run.rows) if number == 2 else seldom}
        made.append(replace(run, columns=columns, power_w={"robot": run.power_w["robot"] - 2.82 * (on - seldom)}))
    (line,) = told(made)
    assert line.startswith("run_02: on_kinect is 1 in every row, and power_robot_w lies -2.")
    assert line.endswith(" W beside the other runs, as if it were 0")


def test_a_run_in_milliwatts_is_named_with_its_factor(runs: list[Run]) -> None:
    odd = replace(runs[2], power_w={"robot": 1000.0 * runs[2].power_w["robot"]})
    (line,) = told([*runs[:2], odd, *runs[3:]])
    assert line.startswith("run_02: power_robot_w is ")
    assert 800.0 < float(line.split("is ")[1].split(" times")[0]) < 1250.0


def test_a_run_in_km_h_is_named_with_its_unit(runs: list[Run]) -> None:
    fast = replace(runs[3], columns={**runs[3].columns, "speed_m_s": 3.6 * runs[3].number("speed_m_s")})
    (line,) = told([*runs[:3], fast, runs[4]])
    assert line == "run_03: speed_m_s is 3.6 times too large (km/h?)"


@pytest.mark.parametrize(
    ("name", "usual", "odd", "words"),
    [
        ("slope_rad", (-0.05, 0.05), 60.0, "slope_rad reaches 3, in the other runs 0.05: degrees or per cent?"),
        ("temp_ambient_c", (18.0, 20.0), 3.5, "temp_ambient_c reaches 70, in the other runs 20: degrees Fahrenheit?"),
        ("cpu_load", (0.2, 0.8), 0.0, "cpu_load is 0 in every row, as in no other run: was it logged?"),
    ],
)
def test_a_column_in_other_units_or_stuck_is_told_whatever_the_power_says(
    runs: list[Run], name: str, usual: tuple[float, float], odd: float, words: str
) -> None:
    values = np.tile(usual, 100)
    logged = [replace(run, columns={**run.columns, name: values}) for run in runs]
    assert told(logged) == []
    logged[2] = replace(runs[2], columns={**runs[2].columns, name: odd * values})
    assert told(logged) == [f"run_02: {words}"]


def test_power_that_no_run_has_in_common_with_its_motion_is_told_of_all(runs: list[Run]) -> None:
    rng = np.random.default_rng(2)
    others = [replace(run, power_w={"robot": rng.permutation(run.power_w["robot"])}) for run in runs[:3]]
    with pytest.raises(InputError, match="nothing to do with what the robot does"):
        told(others)


def test_a_slope_with_its_sign_turned_is_told_and_of_a_body_that_reverses_its_pitch(root: Path) -> None:
    ramps = read_logs([root / "docs/examples/ramp_runs"])
    model = build_power_model(load_robot("pioneer3dx"))

    def turned(run: Run, speed: float, slope: float) -> Run:
        logged = {"speed_m_s": speed * run.number("speed_m_s"), "slope_rad": slope * run.number("slope_rad")}
        return replace(run, columns={**run.columns, **logged})

    assert admit(ramps, model)[1] == []
    assert admit([turned(run, -1.0, 1.0) if i % 2 else run for i, run in enumerate(ramps)], model)[1] == []
    with pytest.raises(InputError, match="is downhill positive, as in the pitch of ROS"):
        admit([turned(run, 1.0, -1.0) for run in ramps], model)
    with pytest.raises(InputError, match="the pitch of the body"):
        admit([turned(run, -1.0, -1.0) if i % 2 else run for i, run in enumerate(ramps)], model)


def test_a_noisy_speed_of_a_robot_that_stands_says_nothing_of_its_slope() -> None:
    """It draws more where it stands downhill, for another reason; half of its speeds are backwards there, by noise."""
    rng = np.random.default_rng(5)
    standing = []
    for run in (drive(seed, seconds=800.0) for seed in range(5)):
        stands = run.time_s > 400.0
        slope = np.where(stands, np.where(run.time_s // 40.0 % 2, -0.05, 0.05), 0.0)
        rest = run.power_w["robot"][run.number("speed_m_s") == 0.0].mean() - 10.0 * slope
        power = np.where(stands, rest, run.power_w["robot"]) + rng.normal(0.0, 0.05, len(run))
        speed = np.where(stands, rng.normal(0.0, 0.01, len(run)), run.number("speed_m_s"))
        columns = {"time_s": run.time_s, "speed_m_s": speed, "slope_rad": slope}
        standing.append(replace(run, columns=columns, power_w={"robot": power}))
    assert told(standing) == []


def test_near_copies_count_once(runs: list[Run]) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(runs[0]))
    copy = replace(runs[0], run="again", power_w={"robot": runs[0].power_w["robot"] + noise})
    (line,) = told([*runs, copy])
    assert line.startswith("again: a copy of run_00")


def test_what_validate_refuses_is_left_out(runs: list[Run]) -> None:
    refused = replace(runs[1], remarks=(Remark("unit", "speed_m_s", "3.6 times the path", "left", "error"),))
    (line,) = told([runs[0], refused, *runs[2:]])
    assert "3.6 times the path" in line


@pytest.mark.usefixtures("effects_alone")
def test_the_command_says_it_first_and_exits_with_one(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for path in sorted((root / "docs/examples/ramp_runs").glob("*.csv"))[:6]:
        lines = path.read_text(encoding="utf-8").splitlines()[:200]
        if path.stem == "run_01":
            at = lines[0].split(",").index("power_robot_w")
            rows = [line.split(",") for line in lines[1:]]
            lines[1:] = [",".join([*r[:at], str(1000.0 * float(r[at])), *r[at + 1 :]]) for r in rows]
        (logs / path.name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = ["--robot", "pioneer3dx", str(logs), "--quiet"]
    assert run_command(["add-effect", "--effect", "grade", *arguments, "--out", str(tmp_path / "r.yaml")]) == 1
    assert capsys.readouterr().err.startswith("LEFT OUT run_01: power_robot_w is")
    assert run_command(["compare", *arguments[:-1]]) == 1
    out = capsys.readouterr().out
    assert out.startswith("LEFT OUT run_01: power_robot_w is")
    assert "5 runs" in out
    with pytest.warns(UserWarning, match="left out run_01: power_robot_w is") as told:
        fitted = missionsim.calibrate("pioneer3dx", logs)
    assert told[0].filename == __file__
    assert "run_01" not in fitted.to_json()["batteries"]["robot"]["runs"]
    later = tmp_path / "later"
    later.mkdir()
    for name in ("run_00.csv", "run_01.csv", "run_02.csv"):
        (logs / name).rename(later / name)
    words = ["diagnose", *arguments, "--holdout", str(later)]
    assert run_command(words) == 1
    assert capsys.readouterr().err.startswith("LEFT OUT held-out run_01: power_robot_w is")
    with pytest.warns(UserWarning, match="left out held-out run_01: power_robot_w is") as told:
        missionsim.diagnose("pioneer3dx", logs, holdout=str(later))
    assert told[0].filename == __file__
    for path in later.iterdir():
        path.rename(logs / path.name)
    # a new robot has no model yet, and is held against that of all its runs
    new = ["calibrate", "--new", "own", "--base", "c2*v**2 + c3*v + c4", str(logs), "--out", str(tmp_path / "own.yaml")]
    assert run_command([*new, "--json", str(tmp_path / "own.json")]) == 1
    said = json.loads((tmp_path / "own.json").read_text(encoding="utf-8"))
    assert [line.split(" is ")[0] for line in said["left_out"]] == ["run_01: power_robot_w"]
    assert "run_01" not in said["batteries"]["robot"]["runs"]


def test_held_out_runs_that_test_nothing_are_named_and_bad_predictions_stay(runs: list[Run]) -> None:
    """Their names may be those of fitted runs; more of them than fitted ones may be in another unit."""
    dear = replace(runs[3], power_w={"robot": 1.8 * runs[3].power_w["robot"]})
    cut = runs[1].rows_where(slice(40, -30))
    others = [drive(seed, seconds=200.0) for seed in range(4, 7)]
    milli = [replace(run, power_w={"robot": 1000.0 * run.power_w["robot"]}) for run in others]
    bad = replace(runs[0], run="run_03", remarks=(Remark("range", "power_robot_w", "below zero", "none", "error"),))
    kept, lines = admit_to_test([dear, bad, cut, *milli], runs[:3])
    assert [run.run for run in kept] == ["run_03"]
    assert lines.pop().startswith("held-out run_03: power_robot_w")
    assert lines[0] == "held-out run_01: a copy of run_01 but for noise, which is fitted: it tests nothing"
    assert [" times what the other runs draw so: another unit?" in line for line in lines[1:]] == [True] * 3
    with pytest.raises(InputError, match="it tests nothing"):
        admit_to_test([cut], runs[:3])


def test_an_offset_of_one_meter_is_named_in_watts(runs: list[Run]) -> None:
    odd = replace(runs[4], power_w={"robot": runs[4].power_w["robot"] + 2.0})
    (line,) = told([*runs[:4], odd])
    assert line.startswith("run_04: power_robot_w lies +")
    assert 1.6 < float(line.split("lies ")[1].split(" W")[0]) < 2.4


def test_what_was_on_in_one_run_and_is_logged_is_no_offset_of_a_meter(runs: list[Run]) -> None:
    on = {**runs[4].columns, "on_kinect": np.ones(len(runs[4]))}
    own = [replace(run, columns={**run.columns, "on_kinect": np.zeros(len(run))}) for run in runs[:4]]
    assert told([*own, replace(runs[4], columns=on, power_w={"robot": runs[4].power_w["robot"] + 5.0})]) == []


def test_rows_in_no_order_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    speed = np.clip(0.4 + 0.4 * np.sin(np.arange(400) / 9.0), 0.0, None)
    for name, order in (("good", np.arange(400)), ("shuffled", rng.permutation(400))):
        rows = [f"{t},{5 + 9 * v:.3f},{v:.4f}" for t, v in enumerate(speed[order])]
        (tmp_path / f"{name}.csv").write_text("time_s,power_robot_w,speed_m_s\n" + "\n".join(rows) + "\n")
    assert run_command(["validate", str(tmp_path / "good.csv")]) == 0
    assert run_command(["validate", str(tmp_path / "shuffled.csv")]) == 2
    assert "as if the rows were shuffled" in capsys.readouterr().err


def test_a_switch_that_never_moves_is_told(runs: list[Run]) -> None:
    stuck = [replace(run, columns={**run.columns, "on_kinect": np.zeros(len(run))}) for run in runs]
    told_of = [line for line in unchanging(stuck) if line.startswith("on_kinect")]
    assert told_of == ["on_kinect is 0 in every row of all runs: what it draws cannot be told by them"]
    moved = replace(stuck[0], columns={**stuck[0].columns, "on_kinect": np.arange(len(stuck[0])) % 2.0})
    assert not [line for line in unchanging([moved, *stuck[1:]]) if line.startswith("on_kinect")]


def driving(runs: list[Run]) -> list[Run]:
    """The same runs without the rows at rest."""
    return [run.rows_where(np.flatnonzero(np.abs(run.number("speed_m_s")) > 0.05)) for run in runs]


def test_an_offset_is_named_without_rows_at_rest_too(runs: list[Run]) -> None:
    odd = replace(runs[1], power_w={"robot": runs[1].power_w["robot"] - 2.0})
    (line,) = told(driving([runs[0], odd, *runs[2:]]))
    assert line.startswith("run_01: power_robot_w lies -")


@pytest.mark.parametrize("elsewhere", [0.0, 1.0])
def test_what_a_logged_load_explains_is_no_offset_of_a_meter(runs: list[Run], elsewhere: float) -> None:
    """A heater that is on in one run alone, or now and then in all runs and always in one."""
    rng = np.random.default_rng(2)
    heated = []
    for number, run in enumerate(runs):
        heater = np.full(len(run), 4.0) if number == 4 else elsewhere * rng.choice([0.0, 4.0], len(run), p=[0.9, 0.1])
        power = {"robot": run.power_w["robot"] + heater}
        heated.append(replace(run, power_w=power, columns={**run.columns, "heater_w": heater}))
    assert told(heated) == []
    assert len(told([*heated[:4], replace(heated[4], columns=runs[4].columns)])) == 1


@pytest.mark.parametrize(("tops", "odd"), [((46, 46, 46, 46, 46, 52), 5), ((48, 44, 47, 44, 46, 58), 2)])
def test_a_fan_by_a_logged_temperature_is_no_offset_of_a_meter(tops: tuple[float, ...], odd: int) -> None:
    """A fan above a motor at 45 °C, seldom in some runs and nearly always in one, which is hotter than all others."""
    fanned = []
    for number, top in enumerate(tops):
        run = drive(number, seconds=400.0)
        warm = 25.0 + (top - 25.0) * (1.0 - np.exp(-np.arange(len(run)) / (80.0 if number < 5 else 10.0)))
        power = {"robot": run.power_w["robot"] + 5.0 * (warm > 45.0)}
        fanned.append(replace(run, power_w=power, columns={**run.columns, "temp_motor_c": warm}))
    assert told(fanned) == []
    lines = told([replace(one, columns=drive(number, seconds=400.0).columns) for number, one in enumerate(fanned)])
    assert f"run_{odd:02d}: power_robot_w lies +" in lines[0]


def in_weather(degrees: list[float], weather: list[str], by_weather: float, by_heat: float, odd: int = -1) -> list[Run]:
    """Runs that draw more in rain and above 25 °C, or one that does so whatever the weather."""
    made = []
    for number, (warm, sky) in enumerate(zip(degrees, weather, strict=True)):
        run = drive(30 + number, seconds=200.0, run=f"run_{number:02d}")
        moving = np.abs(run.number("speed_m_s")) > 0.05
        heat = np.random.default_rng(number).normal(warm, 0.3, len(run))
        more = by_heat * np.maximum(heat - 25.0, 0.0) + by_weather * (sky == "rain") + 8.0 * (number == odd)
        own = run.number("speed_m_s") * (1.0 + 1e-3 * number)  # of so few speeds many come again in another run
        columns = {**run.columns, "speed_m_s": own, "temp_ambient_c": heat, "weather": Labels.of([sky] * len(run))}
        made.append(replace(run, columns=columns, power_w={"robot": run.power_w["robot"] + more * moving}))
    return made


def test_days_that_share_what_costs_more_excuse_each_other() -> None:
    """Of three runs in rain two are colder than all others; of three hot ones one is hotter; a lone run in rain is
    where no other was. A run that draws more on a day like others stays odd."""
    warm, dry = [20.0, 10.0, 24.0, 14.0, 22.0, 17.0], ["dry"] * 6
    assert told(in_weather([*warm, 19.0, -3.0, -4.0], [*dry, "rain", "rain", "rain"], 8.0, 0.0)) == []
    assert told(in_weather([*warm, 19.0], [*dry, "rain"], 8.0, 0.0)) == []
    assert told(in_weather([*warm, 27.0, 33.0, 36.0], [*dry, "dry", "dry", "dry"], 0.0, 1.1)) == []
    (line,) = told(in_weather([*warm, 19.0, 27.0, 12.0], [*dry, "dry", "rain", "rain"], 0.3, 0.0, odd=6))
    assert line.endswith("which agree: another robot, unit or load?")


@pytest.mark.parametrize("logged", [True, False])
def test_hotter_than_all_others_is_not_odd(runs: list[Run], logged: bool) -> None:
    """A fan above 16 °C: the two hottest of seven runs draw more, one of them by half, as no other run could say."""
    warm, plain = [], []
    for number, degrees in enumerate([9.0, 15.0, 18.5, 30.0, 7.0, 12.0, 23.0]):
        run = drive(number, seconds=200.0)
        heat = np.random.default_rng(number).normal(degrees, 0.3, len(run))
        run = replace(run, columns={**run.columns, "temp_ambient_c": heat} if logged else run.columns)
        warm.append(replace(run, power_w={"robot": run.power_w["robot"] + 0.45 * np.maximum(heat - 16.0, 0.0)}))
        plain.append(replace(run, power_w={"robot": run.power_w["robot"] + (3.0 if number == 1 else 0.0)}))
    assert (told(warm) == []) is logged
    # as hot as other runs were, it is an offset of the meter
    assert [line.split(":")[0] for line in told(plain)] == ["run_01"]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("floors", 1),
        pytest.param("heater", 6, marks=pytest.mark.long),
        ("heater", 2),
        pytest.param("wander", 2, marks=pytest.mark.long),
    ],
)
def test_rough_runs_are_no_spoilt_ones(kind: str, seed: int, tmp_path: Path) -> None:
    """Floors, a heater, an arm that no robot file knows: no run has another unit, nor a meter that is off."""
    world = WORLDS[kind]
    train, _ = write(kind, seed, tmp_path)
    new = NewRobot("own", "c2*v**2 + c3*v + c4", mass=f"{world.mass_kg} kg", drive=world.drive)
    rough = read_logs([train])
    (tmp_path / "own.yaml").write_text(calibrate_new(new, rough).text, encoding="utf-8")
    assert admit(rough, build_power_model(load_robot(tmp_path / "own.yaml")))[1] == []


def changed(run: Run, **columns: np.ndarray) -> Run:
    return replace(run, columns={**run.columns, **columns})


def test_a_copy_that_is_cut_and_shifted_in_time_counts_once(runs: list[Run]) -> None:
    rng = np.random.default_rng(3)
    later = runs[1].rows_where(np.arange(len(runs[1])) > 30)
    copy = changed(later, time_s=later.time_s + 1000.137)
    noisy = {"robot": later.power_w["robot"] + rng.normal(0.0, 0.2, len(later))}
    (line,) = told([*runs, replace(copy, run="again", power_w=noisy)])
    assert line.startswith("again: a copy of run_01")


def test_drives_that_were_made_alike_with_other_loads_are_no_copies(runs: list[Run]) -> None:
    """A simulation, or one recorded profile that is driven again: the same speeds, and power that is or is not."""
    loads = [changed(runs[0], payload_kg=np.full(len(runs[0]), kg)) for kg in (0.0, 5.0, 5.0)]
    heavy = replace(loads[1], power_w={"robot": 1.2 * loads[1].power_w["robot"]})
    assert copies([loads[0], heavy, loads[1]]) == {2: 1}
    assert copies(loads) == {2: 1}
    words = [changed(run, surface=Labels.of([floor] * len(run))) for run, floor in zip(loads[1:], "ab", strict=True)]
    assert copies(words) == {}


def test_speeds_that_were_commanded_alike_are_no_copies(runs: list[Run]) -> None:
    """Two runs of one mission whose logs hold commanded speeds: each a measurement of its own."""
    ramps = np.abs((np.arange(400) % 40) - 20) / 40.0
    alike = [changed(run.rows_where(slice(0, 400)), speed_m_s=np.resize(ramps, min(400, len(run)))) for run in runs]
    assert copies(alike) == {}


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        pytest.param("gain", "power_robot_w is 1.3", marks=pytest.mark.long),
        ("late", "power_robot_w lies +25 s beside what the robot does"),
        pytest.param("shuffled", "power_robot_w does not follow what the robot does", marks=pytest.mark.long),
        ("frozen", "speed_m_s stands at "),
        ("switch", "on_camera is 0 in every row, while the power goes up and down by its watts"),
        pytest.param("mph", "speed_m_s is 2.24 times too large (mph?)", marks=pytest.mark.long),
        ("sign", "slope_rad has the other sign"),
    ],
)
def test_a_fault_of_one_run_is_named_by_what_the_others_say(fault: str, words: str, tmp_path: Path) -> None:
    """A robot of the regimes' world, ten kilograms, that climbs; its file knows nothing of slopes."""
    frames, robot = regimes.logs(regimes.REGIMES["plain 1 Hz"], "grade", 0.05, 4)
    (tmp_path / "own.yaml").write_text(regimes.robot_file(robot, 0.03), encoding="utf-8")
    model = build_power_model(load_robot(tmp_path / "own.yaml"))
    spoilt, rng = frames[3].copy(), np.random.default_rng(1)
    power, third = spoilt["power_robot_w"], len(spoilt) // 3
    if fault == "gain":
        spoilt["power_robot_w"] = 1.3 * power
    elif fault == "late":
        spoilt["power_robot_w"] = np.roll(power, 25)
    elif fault == "shuffled":
        spoilt["power_robot_w"] = rng.permutation(power)
    elif fault == "frozen":
        spoilt.loc[third:, "speed_m_s"] = 0.4321
    elif fault == "switch":
        spoilt["on_camera"] = 0
    elif fault == "mph":
        spoilt["speed_m_s"] *= 2.2369
    else:
        spoilt["slope_rad"] *= -1.0
    logs = [tmp_path / f"run_{i:02d}.csv" for i in range(len(frames))]
    for path, frame in zip(logs, frames, strict=True):
        frame.to_csv(path, index=False)
    assert admit(read_logs(logs), model)[1] == []
    spoilt.to_csv(logs[3], index=False)
    (line,) = admit(read_logs(logs), model)[1]
    assert line.startswith(f"run_03: {words}")


def test_a_run_is_as_late_as_a_meter_that_holds_its_value_makes_most_of_them() -> None:
    """Two of three runs show the mean of the 3 s before; the roughest of them is late by that, as the others are."""
    runs = []
    for seed in range(160, 172):
        run = drive(seed, seconds=300.0, step_s=0.5)
        speed = run.columns["speed_m_s"] + np.random.default_rng(seed).normal(0.0, 1e-4, len(run))
        power = run.power_w["robot"].copy()
        for row in range(0, len(power), 6) if (seed - 160) % 3 else ():
            power[row : row + 6] = run.power_w["robot"][max(0, row - 6) : max(6, row)].mean()
        runs.append(replace(changed(run, speed_m_s=speed), power_w={"robot": power}))
    assert told(runs) == []


def test_a_straight_run_is_odd_only_for_a_model_without_scrub() -> None:
    """Eleven runs turn half of the time, each as much as the others, and one does not."""
    logs = []
    for seed in range(20, 32):
        run = drive(seed, seconds=400.0)
        speed = run.columns["speed_m_s"] + np.random.default_rng(seed).normal(0.0, 1e-4, 400)
        yaw = 0.8 * (run.time_s // 10.0 % 2.0) * (speed > 0.01) * (seed > 20)
        turned = changed(run, speed_m_s=speed, yaw_rate_rad_s=yaw)
        logs.append(replace(turned, power_w={"robot": run.power_w["robot"] + 40.0 * yaw}))
    assert told(logs) == []
    logs[0] = replace(logs[0], power_w={"robot": 0.6 * logs[0].power_w["robot"]})
    assert [line.split(":")[0] for line in told(logs)] == ["run_20"]


def test_runs_on_a_floor_that_costs_more_have_no_offset_of_a_meter() -> None:
    """Nine runs on tile, three in snow, that hardly rest: what snow takes looks as if it were there at rest."""
    runs = []
    for seed in range(12):
        floor = "snow" if seed % 4 == 3 else "tile"
        run = drive(seed, seconds=300.0, surface=[floor] * 300)
        still = run.columns["speed_m_s"] == 0.0
        noise = np.random.default_rng(seed).normal(0.0, 1e-4, 300)
        speed = np.where(still, 0.2, run.columns["speed_m_s"]) + noise
        power = run.power_w["robot"] + np.where(still, 3.2, 0.0)
        power = power + ((0.3, 0.6, 2.5)[seed // 4] if floor == "snow" else 0.0)
        runs.append(replace(changed(run, speed_m_s=speed), power_w={"robot": power}))
    assert told(runs) == []


@pytest.mark.parametrize(
    ("case", "seed"), [("payload-10pct", 1012), pytest.param("payload-5pct-energy", 1010, marks=pytest.mark.long)]
)
def test_a_run_that_carries_most_is_not_odd(case: str, seed: int, tmp_path: Path) -> None:
    """What half of one run shows of a load is held against the run that carries one throughout."""
    logs = write_world(make(ALL_CASES[case], seed), tmp_path) / "train"
    assert told(read_logs([logs])) == []


@pytest.mark.filterwarnings("error")
def test_runs_without_any_power_are_not_odd_in_their_unit(runs: list[Run]) -> None:
    assert unfit_runs([replace(run, power_w={"robot": 0.0 * run.power_w["robot"]}) for run in runs]) == {}


def test_a_column_without_a_value_excuses_nothing(runs: list[Run]) -> None:
    """Nor does one that lacks some."""
    hot = in_weather([20.0, 10.0, 24.0, 14.0, 22.0, 17.0, 19.0], ["dry"] * 7, 0.0, 0.0, odd=6)
    gone = [replace(run, columns={**run.columns, "temp_motor_c": np.full(len(run), np.nan)}) for run in hot]
    rows = np.where(np.arange(len(hot[0])) % 3, np.nan, 20.0)
    some = [replace(run, columns={**run.columns, "temp_motor_c": rows}) for run in hot]
    for made in (gone, some):
        (line,) = told(made)
        assert line.startswith("run_06: ")
