"""Runs that differ: what the same motion costs, or what the meters of the runs make of all power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.diagnose import Subject
from missionsim.diagnose import diagnose as diagnose_runs
from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import Split
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.identify import stepwise
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import load_robot, robot_from_text
from missionsim.interface import diagnose
from missionsim.labels import Labels
from missionsim.logs import LogTable

from .logs import drawing, drive

pytestmark = pytest.mark.usefixtures("effects_alone")

ROBOT = """kind: robot
name: own
body: {drive: differential, mass: 30 kg, max_speed: 2 m/s}
batteries: {main: {capacity: 500 Wh}}
motion:
  battery: main
  model: polynomial
  parameters:
    c2: {value: 4 W s^2/m^2, sd: 0.12}
    c3: {value: 40 W s/m, sd: 1.2}
    c4: {value: 5 W, sd: 0.15}
    standing: {value: 24 W, sd: 0.7}
"""


def runs(folder: Path, meter_sd: float, motion_sd: float, offset_w: float = 0.0) -> list[Path]:
    """Twelve runs of a little world: stops and goes at steady speeds, rows of a second, noise with a memory of 5 s."""
    rng = np.random.default_rng(5)
    (folder / "own.yaml").write_text(ROBOT)
    paths = []
    for number in range(12):
        speed = np.repeat(rng.choice([0.0, 0.0, 0.4, 0.8, 1.2], 20), 15)
        noise = np.zeros(300)
        for i in range(1, 300):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.3)
        cost, meter = 1.0 + np.array([motion_sd, meter_sd]) * rng.choice([-1.0, 1.0], 2)
        power = meter * np.where(speed > 0.0, cost * (5.0 + 40.0 * speed + 4.0 * speed**2), 24.0)
        power = power + offset_w * rng.choice([-1.0, 1.0])
        path = folder / f"run{number:02d}.csv"
        table = np.column_stack([np.arange(300) + 0.5, speed, power + noise])
        np.savetxt(path, table, delimiter=",", header="time_s,speed_m_s,power_main_w", comments="", fmt="%.4f")
        paths.append(path)
    return paths


@pytest.mark.filterwarnings("ignore:left out run00")
@pytest.mark.parametrize(
    ("meter_sd", "motion_sd", "offset_w", "verdict"),
    [
        (0.04, 0.0, 0.0, "nothing_missing"),
        (0.0, 0.09, 0.0, "unexplained_structure"),
        pytest.param(0.0, 0.0, 3.0, "unexplained_structure", marks=pytest.mark.long),
    ],
)
def test_meters_that_differ_are_no_missing_effect(
    tmp_path: Path, meter_sd: float, motion_sd: float, offset_w: float, verdict: str
) -> None:
    logs = runs(tmp_path, meter_sd, motion_sd, offset_w)
    found = diagnose(tmp_path / "own.yaml", logs, holdout="none").batteries["main"]
    assert found.verdict == verdict
    told = " ".join(found.remarks)
    assert ("in all that they draw, at rest too" in told) == (meter_sd > 0.0)
    assert ("several times what meters and drives usually do" in found.unexplained.shape) == (meter_sd == 0.0)
    assert ("the runs differ by 3.1 W" in found.unexplained.shape) == (offset_w > 0.0)
    assert ("what the same motion costs" in found.unexplained.shape) == (motion_sd > 0.0)


@pytest.mark.long
def test_what_costs_no_more_at_rest_is_no_meter(tmp_path: Path) -> None:
    """Friction in rain, beside turns that cost the same: a gain of all came nearer than one of the motion, and was
    called meters that differ, "at rest too"; nothing was missing."""
    rng = np.random.default_rng(7)
    (tmp_path / "own.yaml").write_text(ROBOT)
    logs = []
    for number in range(12):
        speed = np.repeat(rng.choice([0.0, 0.4, 0.8, 1.2], 20), 15)
        rain = 4.0 * (number % 3 == 0)
        warm = 20.0 + rng.normal(0.0, 4.0)
        noise = np.zeros(300)
        for i in range(1, 300):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.3)
        power = np.where(speed > 0.0, 5.0 + 40.0 * speed + 4.0 * speed**2, 24.0)
        power = power + 0.7 * rain * (speed > 0.0) * (1.3 - 0.3 * speed)
        logs.append(tmp_path / f"run{number:02d}.csv")
        table = np.column_stack([np.arange(300) + 0.5, speed, power + noise, np.full((300, 2), [rain, warm])])
        header = "time_s,speed_m_s,power_main_w,rain_mm_h,temp_ambient_c"
        np.savetxt(logs[-1], table, delimiter=",", header=header, comments="", fmt="%.4f")
    found = diagnose(tmp_path / "own.yaml", logs, holdout="none").batteries["main"]
    assert "at rest too" not in " ".join(found.remarks)
    assert found.verdict == "unexplained_structure"
    assert "from run to run it goes with rain_mm_h" in found.unexplained.shape
    assert not [one.do for one in found.next_experiments if "log it as a column" in one.do]


@pytest.mark.parametrize(
    ("winds", "told"),
    [((2.2, 2.0, 9.0, 1.0), True), ((2.2, 2.0, 1.0, 9.0), False), ((2.2, 2.0, 9.0), False)],
    ids=["in order", "in another order", "three runs"],
)
def test_a_logged_column_in_whose_order_few_runs_cost_is_named(
    tmp_path: Path, winds: tuple[float, ...], told: bool
) -> None:
    """Four runs are too few for a correlation, but "log it as a column" is no answer to one that is logged, does not
    change in any run, and in whose order the runs cost."""
    rng = np.random.default_rng(3)
    (tmp_path / "own.yaml").write_text(ROBOT)
    logs = []
    for number, (wind, cost) in enumerate(zip(winds, (1.06, 0.96, 1.2, 0.85), strict=False)):
        speed = np.repeat(rng.choice([0.0, 0.4, 0.8, 1.2], 40), 15)
        noise = np.zeros(600)
        for i in range(1, 600):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.3)
        power = np.where(speed > 0.0, cost * (5.0 + 40.0 * speed + 4.0 * speed**2), 24.0) + noise
        logs.append(tmp_path / f"run{number:02d}.csv")
        rows = np.arange(600) + 0.5
        table = np.column_stack([rows, speed, power, np.full(600, wind), -60.0 + number + np.sin(rows / 20.0)])
        header = "time_s,speed_m_s,power_main_w,wind_speed_m_s,wifi_rssi_dbm"
        np.savetxt(logs[-1], table, delimiter=",", header=header, comments="", fmt="%.4f")
    found = diagnose(tmp_path / "own.yaml", logs, holdout="none").batteries["main"]
    assert "what the same motion costs" in found.unexplained.shape
    words = (
        "; it may be wind_speed_m_s, in whose order these 4 runs cost, of the columns that differ between them alone "
        "(by chance so in 8 % of cases)"
    )
    assert (words in found.unexplained.shape) == told
    assert ("wind_speed_m_s" in found.unexplained.shape) == told
    do = [one.do for one in found.next_experiments]
    assert any("log it as a column" in one for one in do) != told
    assert any("more runs that differ in wind_speed_m_s" in one for one in do) == told


def test_a_robot_that_moves_sideways_does_not_rest(tmp_path: Path) -> None:
    """Wheels that let it move either way, and a motion that costs more in some runs: rows without forward speed counted
    as rest, and runs that cost the same at rest were called meters that differ, "at rest too"."""
    rng = np.random.default_rng(5)
    motion = """  model: expression
  power: c2 * (v**2 + u**2) + c3 * hypot(v, u) + c4
  parameters: {c2: 4 W s^2/m^2, c3: 40 W s/m, c4: 5 W, rest: 24 W}
  standing: rest
"""
    (tmp_path / "own.yaml").write_text(ROBOT[: ROBOT.index("  model")] + motion)
    logs = []
    for number in range(12):
        speed, sideways = np.repeat(rng.choice([0.0, 0.4, 0.8, 1.2], 20), 15), np.repeat(rng.random(20) < 0.7, 15)
        noise = np.zeros(300)
        for i in range(1, 300):
            noise[i] = 0.8 * noise[i - 1] + rng.normal(0.0, 0.3)
        cost = 1.0 + 0.09 * rng.choice([-1.0, 1.0])
        power = np.where(speed > 0.0, cost * (5.0 + 40.0 * speed + 4.0 * speed**2), 24.0) + noise
        logs.append(tmp_path / f"run{number:02d}.csv")
        table = np.column_stack([np.arange(300) + 0.5, speed * ~sideways, speed * sideways, power])
        header = "time_s,speed_m_s,lateral_speed_m_s,power_main_w"
        np.savetxt(logs[-1], table, delimiter=",", header=header, comments="", fmt="%.4f")
    found = diagnose(tmp_path / "own.yaml", logs, holdout="none").batteries["main"]
    assert "at rest too" not in " ".join(found.remarks)
    assert "the runs differ by" in found.unexplained.shape


FLOORS = ("tile", "carpet", "snow", "ice", "grass")


def on_floors(
    newtons: Sequence[float],
    seed: int,
    gain: float = 0.0,
    seconds: Sequence[float] = (200.0,) * 5,
    scrub_w_s_rad: Sequence[float] = (0.0,) * 5,
) -> list[LogTable]:
    """Nine drives, each on one floor: its force and its scrub, or a random part more of all that motion draws."""
    rng = np.random.default_rng(seed)
    logs = []
    for i in range(9):
        log = drive(100 * seed + i, seconds=seconds[i % 5])
        speed = log.columns["speed_m_s"]
        more = newtons[i % 5] * speed + scrub_w_s_rad[i % 5] * np.abs(log.columns["yaw_rate_rad_s"])
        more = more + gain * rng.normal() * (log.power_w["robot"] - 5.0) * (speed > 0.0)
        power = log.power_w["robot"] + more
        logs.append(drawing(log, power, surface=Labels.of([FLOORS[i % 5]] * log.rows)))
    return logs


def test_every_floor_has_its_level_where_the_floors_explain_how_the_runs_differ() -> None:
    newtons = (0.5, 2.0, 6.0, 0.0, 3.5)
    found = diagnose_runs(Subject.of(load_robot("pioneer3dx")), on_floors(newtons, 1), holdout="none").batteries[
        "robot"
    ]
    (floor,) = found.effects
    assert floor.effect == "surface_rolling_resistance"
    assert floor.indistinguishable_from == ()
    assert "k_ice" not in floor.parameters  # the floor of the base
    for name, force in zip(FLOORS, newtons, strict=True):
        if force > 1.0:
            assert floor.parameters[f"k_{name}"].value == pytest.approx(force, abs=0.8)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_the_floor_of_the_base_is_the_one_that_costs_least_however_short_its_runs_are(seed: int) -> None:
    newtons = (3.0, 4.0, 9.0, 5.0, 6.0)
    logs = on_floors(newtons, seed, seconds=(400.0, 300.0, 200.0, 30.0, 200.0))
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="9 kg"), logs)
    found = diagnose_runs(Subject.of(robot_from_text(made.text)), logs, holdout="none").batteries["robot"]
    (floor,) = found.effects
    told = {name.removeprefix("k_"): one.value for name, one in floor.parameters.items()}
    expected = {name: force - 3.0 for name, force in zip(FLOORS, newtons, strict=True) if name != "tile"}
    assert told == pytest.approx(expected, abs=0.4)


@pytest.mark.long
def test_scrub_by_floor_is_asked_over_runs_as_rolling_is() -> None:
    """One level, of the floor that scrubs most, was all that stood out: 2.3 % in place of 0.4."""
    scrub = (2.0, 3.0, 6.0, 1.0, 4.0)
    train, heldout = (tuple(on_floors((0.0,) * 5, seed, scrub_w_s_rad=scrub)) for seed in (1, 51))
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="9 kg"), train)
    found = improve(made.text, Split(train, heldout, "apart"), "robot", Settings(), lambda finding, diagnosis: True)
    assert found.added == ("turning_scrub", "surface_turning_scrub")
    told = {e.effect: {k: p.value for k, p in e.parameters.items()} for e in robot_from_text(found.text).effects}
    for floor, k in zip(FLOORS, scrub, strict=True):
        every = told["turning_scrub"]["k"] + told["surface_turning_scrub"].get(f"k_{floor}", 0.0)
        assert every == pytest.approx(k, abs=0.3)
    assert found.steps[-2].energy_error_pct < 0.2 * found.steps[1].energy_error_pct


@pytest.mark.long
@pytest.mark.parametrize(
    ("newtons", "gain", "names"),
    [((0.0, 2.0, 1.0, 3.0, 0.5), 0.0, 2), pytest.param((0.0,) * 5, 0.06, 1, marks=pytest.mark.long)],
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_floors_are_compared_beside_the_base_as_it_is_with_what_was_found(
    newtons: Sequence[float], gain: float, names: int, seed: int
) -> None:
    """A base that was fitted without scrub took part of it for rolling, in each run as much as it turned."""
    logs = on_floors(newtons, seed, gain, scrub_w_s_rad=(4.0,) * 5)
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="9 kg"), logs)
    found = diagnose_runs(Subject.of(robot_from_text(made.text)), logs, holdout="none").batteries["robot"]
    assert [effect.effect for effect in found.effects] == ["turning_scrub", "surface_rolling_resistance"][:names]


@pytest.mark.long
def test_floors_and_the_cold_are_both_found_where_the_noise_had_taken_them_for_runs_that_differ() -> None:
    logs = []
    for i, log in enumerate([*on_floors((0.5, 2.0, 6.0, 0.0, 3.5), 30), *on_floors((0.5, 2.0, 6.0, 0.0, 3.5), 31)]):
        temp_c = round(float(np.random.default_rng([7, 300 + i]).normal(15.0, 8.0)), 1)
        cold_w = 0.3 * max(25.0 - temp_c, 0.0) * log.columns["speed_m_s"]
        made = drawing(log, log.power_w["robot"] + cold_w, temp_ambient_c=np.full(log.rows, temp_c))
        logs.append(replace(made, run=f"run{i:02d}"))
    own = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="9 kg"), logs)
    found = diagnose_runs(Subject.of(robot_from_text(own.text)), logs, holdout="none").batteries["robot"]
    assert {effect.effect for effect in found.effects} == {"temperature_friction", "surface_rolling_resistance"}
    assert found.unexplained.shape == ""


@pytest.mark.long
def test_floors_that_cost_less_than_the_base_knows_take_no_dear_one_with_them() -> None:
    logs = on_floors((-3.0, 3.0, -1.0, -2.0, 3.5), 1)
    (floor,) = diagnose_runs(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"].effects
    assert floor.parameters.keys() == {"k_carpet", "k_grass"}
    assert floor.indistinguishable_from == ()


@pytest.mark.parametrize("floors", [pytest.param(3, marks=pytest.mark.long), 6])
def test_where_each_floor_was_driven_once_floor_and_run_are_one(floors: int) -> None:
    logs = []
    for i in range(6):
        log = drive(i, seconds=200.0, surface=[f"floor {i % floors}"] * 200)
        logs.append(drawing(log, log.power_w["robot"] + 2.0 * (-1) ** (i // 2) * log.columns["speed_m_s"]))
    found = diagnose_runs(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"]
    assert "what the same motion costs" in found.unexplained.shape
    assert ("it may be the floor: drive two of them once more" in found.unexplained.shape) == (floors == 6)
    (apart,) = (s.size_share for s in found.unexplained.structures if s.covariate == "run")
    (floor,) = (c for c in found.candidates if c.effect == "surface_rolling_resistance")
    assert floor.smallest_detectable_share >= apart > 0.03  # the floors may differ by all that the runs do


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_runs_that_differ_by_chance_do_not_differ_by_floor(seed: int) -> None:
    logs = on_floors((0.0,) * 5, seed, gain=0.06)
    found = diagnose_runs(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"]
    assert not any(effect.effect.startswith("surface") for effect in found.effects)


@pytest.mark.parametrize(("idle", "steady"), [(0, False), (4, False), (4, True)])
def test_of_the_floor_on_which_it_only_stood_or_turned_a_run_says_nothing(
    monkeypatch: pytest.MonkeyPatch, idle: int, steady: bool
) -> None:
    """Four runs without a way counted as four on the first floor that cost nothing, and a run at one speed had its
    scatter for its cost: floors of half of the energy were missed (Husky, 19.7 W where 6.0 were possible)."""
    rng = np.random.default_rng(3)
    phi, left = [], []
    for floor, cost in enumerate((110.0, 60.0, 20.0)):
        for _ in range(3):
            speed = 0.5 + (0.001 if steady else 0.2) * rng.standard_normal(60)
            phi.append([speed * (floor == level) for level in range(3)])
            left.append((cost + 4.0 * rng.standard_normal()) * speed + 2.0 * rng.standard_normal(60))
    phi += [np.zeros((3, 60))] * idle
    left += [2.0 * rng.standard_normal(60) for _ in range(idle)]
    rows = [slice(60 * i, 60 * (i + 1)) for i in range(len(phi))]
    layout = SimpleNamespace(mean_power_w=150.0)
    design = SimpleNamespace(phi=np.hstack(phi), y=np.concatenate(left), runs=rows, layout=layout)
    model = SimpleNamespace(design=design, noise=SimpleNamespace(total_sd_w=2.0))
    monkeypatch.setattr(stepwise, "prediction", lambda *_: 0.0)
    assert stepwise._between(SimpleNamespace(model=model), range(3), ()) < 1e-4  # type: ignore[arg-type]
