"""Columns beyond the glossary: which a law may read, which repeat another, which are the meter's own."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from missionsim.diagnose.proposed import law_name
from missionsim.laws.adapter import ground_of
from missionsim.laws.factors import make_grammar
from missionsim.laws.proposal import _own_meter, propose
from missionsim.laws.search import Search
from missionsim.runs.covariates import may_be_cause, remarks_on, repeated

from .found import identified, law_of, run_of

LEANS = "k * abs(speed_m_s) * cos(heading_rad - #)"
BREEZE = "k * abs(speed_m_s)**2 * cos(heading_rad - #)"


def drives() -> list[dict[str, Any]]:
    """Two runs with an arm, a hill and the same speed in several units."""
    rng = np.random.default_rng(8)
    runs = []
    for rows in (300, 200):
        speed = rng.uniform(-0.4, 1.2, rows)
        slope = rng.normal(0.0, 0.05, rows)
        runs.append(
            {
                "time_s": np.arange(rows) + 0.5,
                "speed_m_s": speed,
                "slope_rad": slope,
                "temp_ambient_c": np.full(rows, float(rows) / 10.0),
                "speed_km_h": np.round(3.6 * speed, 2),
                "motor_rpm": np.abs(800.0 * speed) + rng.normal(0.0, 2.0, rows),
                "slope_pct": 100.0 * np.tan(slope),
                "temp_ambient_f": 32.0 + 0.18 * np.full(rows, float(rows)),
                "headwind_m_s": 3.0 + 0.2 * speed + rng.normal(0.0, 1.0, rows),
                "arm_power": rng.choice([0.0, 12.0, 30.0], rows),
            }
        )
    return runs


def test_a_quantity_in_other_units_is_told_and_no_law_reads_it() -> None:
    runs = drives()
    twins = repeated(runs)
    assert twins == {
        "motor_rpm": "speed_m_s",
        "slope_pct": "slope_rad",
        "speed_km_h": "speed_m_s",
        "temp_ambient_f": "temp_ambient_c",
    }
    assert "speed_km_h is a straight line of speed_m_s: no law reads it" in remarks_on(runs)
    read = {factor.variable for factor in make_grammar(runs, {*twins}).factors}
    assert {"headwind_m_s", "speed_m_s", "slope_rad"} <= read
    assert not read & set(twins)


@pytest.mark.parametrize("name", ["arm_power", "arm_current_a", "gripper_power_w", "arm_2_current_raw", "heater_amps"])
def test_what_a_part_draws_may_be_a_cause(name: str) -> None:
    assert may_be_cause(name)
    assert may_be_cause("cabin_setpoint_c")
    assert may_be_cause("headwind_m_s")
    run = drives()[0] | {name: np.linspace(0.0, 9.0, 300) ** 2}
    assert name in {factor.variable for factor in make_grammar([run]).factors}


@pytest.mark.parametrize(("lowest", "powers"), [(0.0, False), (-0.5, True), (-5.0, False)])
def test_noise_about_nought_is_no_sign(lowest: float, powers: bool) -> None:
    run = drives()[0] | {"arm_torque": np.linspace(lowest, 9.0, 300)}
    read = {factor.text for factor in make_grammar([run]).factors}
    assert ("max(arm_torque, 0)**2" in read) is powers
    assert ("abs(arm_torque)" in read) is (lowest < -1.0)


@pytest.mark.parametrize(("lowest", "descends"), [(-0.004, False), (-0.03, True)])
def test_noise_on_level_ground_is_no_descent(lowest: float, descends: bool) -> None:
    """A robot that only climbed: "descending costs" held on its own runs, and took further ones, on which it did
    descend, from 4 to 27 W."""
    run = drives()[0] | {"slope_rad": np.linspace(lowest, 0.08, 300)}
    read = {factor.text for factor in make_grammar([run]).factors}
    assert "max(slope_rad, 0)" in read
    assert ("max(-slope_rad, 0)" in read) is descends


def test_what_takes_a_negative_number_away_adds() -> None:
    wind = drives()[0] | {"headwind_m_s": np.linspace(-4.0, 3.0, 300)}
    read = {factor.text for factor in make_grammar([wind]).factors}
    assert "max(headwind_m_s + 2.6, 0)" in read
    assert not [text for text in read if "- -" in text]


def test_a_law_of_what_moves_is_not_called_one_of_turning() -> None:
    moves = "(abs(speed_m_s) >= 0.005 or abs(yaw_rate_rad_s) >= 0.02)"
    assert law_name(f"k * {moves} * exp(-abs(speed_m_s) / 3.3)") == "law_speed"
    assert law_name(f"k * {moves} * abs(yaw_rate_rad_s)") == "law_speed_turning"


def test_what_is_above_nought_is_no_second_form_of_what_never_falls_below() -> None:
    read = {factor.text for factor in make_grammar(drives()).factors}
    assert {"arm_power", "(arm_power > 0)", "max(arm_power - 12, 0)"} <= read
    assert not {"max(arm_power - 0, 0)", "max(arm_power - 0, 0)**1.5"} & read


@pytest.mark.parametrize(
    "name",
    [
        *("power", "power_w", "current_a", "amps", "power_arm_w", "current_robot_a", "battery_current", "pack_power_w"),
        *("charging_current_a", "charge_current", "state_of_charge", "soc", "voltage", "arm_voltage_v", "total_power"),
        *("left_motor_current", "wheel_power_w", "drive_power", "energy_arm", "mean_current_a", "dc_power"),
        "motor_pwr_w",
        *("cmd_speed_m_s", "speed_cmd", "cmd_vel_linear_x", "target_yaw_rate_rad_s", "steering_setpoint_rad"),
        *("gps_hdop", "longitude", "num_satellites", "position_covariance"),
    ],
)
def test_what_follows_the_load_or_asks_for_motion_is_no_cause(name: str) -> None:
    assert not may_be_cause(name)


def test_a_load_without_a_unit_is_told() -> None:
    (told,) = (remark for remark in remarks_on(drives()) if "arm_power" in remark)
    assert "log it as arm_power_w" in told


def test_the_measured_power_under_another_name_is_no_cause() -> None:
    runs = drives()
    rng = np.random.default_rng(2)
    for run in runs:
        run["power"] = 40.0 + 30.0 * np.abs(run["speed_m_s"]) + run["arm_power"]
        run["kinova_current"] = run["power"] / 24.0 + rng.normal(0.0, 0.02, len(run["power"]))
        run["constant"] = np.full(len(run["power"]), 3.0)
    y = np.concatenate([run.pop("power") for run in runs])
    ground = SimpleNamespace(covariates=runs, averaged=lambda raw: np.hstack(raw), design=SimpleNamespace(y=y))
    assert _own_meter(ground) == {"kinova_current"}


@pytest.mark.parametrize("late_s", [0.4, pytest.param(0.0, marks=pytest.mark.long)])
def test_a_law_is_seen_at_the_clock_that_it_asks_for(late_s: float) -> None:
    """A robot that drives at one speed: only its turns, which no effect of the library costs, show a late meter."""
    rng, runs = np.random.default_rng(1), []
    for number in range(6):
        turn = np.zeros(1500)
        for start in range(50, 1420, 100):
            turn[start : start + int(rng.integers(10, 60))] = rng.uniform(0.2, 1.0) * rng.choice([-1, 1])
        speed, time_s = np.where(np.arange(1500) > 25, 0.5, 0.0), np.arange(1500) * 0.2 + 0.1
        gradient = {"c3": 10.0 * speed, "c4": 3.5 * (speed > 0), "standing": 2.7 * (speed == 0)}
        base = np.sum(list(gradient.values()), axis=0)
        power = base + 8.0 * np.tanh(np.abs(turn) / 0.15)
        more = np.interp(time_s - late_s, time_s, power) + 0.3 * rng.standard_normal(1500) - base
        runs.append(run_of(number, gradient, more, step_s=0.2, speed_m_s=speed, yaw_rate_rad_s=turn))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05)
    assert set(made.first.variables) == {"yaw_rate_rad_s"}
    assert made.first.k == pytest.approx(8.0, rel=0.05)  # 6.8 at the clock of the base


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_a_load_that_is_switched_is_found_in_rows_as_long_as_the_clock_moves() -> None:
    """A camera, on and off, beside a base with a power at rest and a slow meter: likelihood alone lets the level go
    that all runs share, and blames the rows in which the robot stops."""
    rng, runs = np.random.default_rng(0), []
    for number in range(8):
        speed = np.repeat(rng.choice([0.0, 0.1, 0.2], 40), rng.integers(40, 150, 40))[:2700]
        camera = np.repeat(rng.integers(0, 2, 9), 300)
        power = np.where(speed > 0.0, 5.9, 5.2) + 5.0 * speed + 2.2 * camera
        for i in range(1, 2700):
            power[i] += 0.78 * (power[i - 1] - power[i])  # ten values a second, time constant 0.4 s
        v, watt = speed.reshape(-1, 10).mean(axis=1), power.reshape(-1, 10).mean(axis=1)
        measured = 0.104 * np.round((watt + 0.05 * rng.standard_normal(270)) / 0.104)
        gradient = {"c4": 7.0 * (v > 0.0), "c3": 2.0 * v, "standing": 6.3 * (v == 0.0)}
        more = measured - np.sum(list(gradient.values()), axis=0)
        runs.append(run_of(number, gradient, more, speed_m_s=v, camera=camera[5::10].astype(float)))
    made = law_of(runs, c3=1.0, c4=1.0, standing=1.0)
    assert made.first.variables == ("camera",)
    assert made.first.k == pytest.approx(2.2, rel=0.1)


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_a_form_that_the_base_has_already_is_in_no_set() -> None:
    """A processor whose load costs more from 60 % on: how its cost goes with the load itself, the file says."""
    rng, runs = np.random.default_rng(4), []
    for number in range(8):
        speed = np.repeat(rng.choice([0.0, 0.1, 0.3], 12), 25)
        load = np.repeat(rng.uniform(0.05, 1.0, 30), 10)
        gradient = {"c3": 4.0 * speed, "c4": np.full(300, 3.0), "cpu_load.k": 1.5 * load}
        more = 2.0 * np.maximum(load - 0.6, 0.0) + 0.1 * rng.standard_normal(300)
        runs.append(run_of(number, gradient, more, speed_m_s=speed, cpu_load=load))
    found = identified(runs, **{"c3": 0.5, "c4": 0.5, "cpu_load.k": 1.0})
    ground = ground_of(found, [run.covariates for run in runs])
    search = Search(ground, make_grammar(ground.covariates, set(), clocks=False))
    form = {search.grammar.text((i,)): (i,) for i in range(len(search.grammar.factors))}
    top = search.fit(form["k * max(cpu_load - 0.57, 0)"])
    assert form["k * cpu_load"] not in [one.form for one in search._exactly(top, [*form.values()])]
    made = propose(found, ground.covariates)
    assert made is not None
    assert made.certain == ("cpu_load",)


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_a_threshold_is_found_between_the_numbers_of_the_grammar() -> None:
    """A gear that churns above 23.8 degC: of the numbers of the grammar, a steeper rise from one further below came
    nearer than either."""
    rng, runs = np.random.default_rng(9), []
    for celsius in (2.7, 4.9, 8.5, 12.7, 14.3, 15.5, 15.7, 16.4, 20.4, 26.3, 27.6, 33.1):
        speed = np.repeat(rng.choice([0.0, 0.4, 0.8, 1.5], 15), 20)
        warm = celsius + np.linspace(0.0, 0.4, 300)
        gradient = {"c3": 40.0 * speed, "c4": np.full(300, 60.0)}
        more = 15.0 * speed * np.maximum(warm - 23.8, 0.0) + 1.5 * rng.standard_normal(300)
        runs.append(run_of(celsius, gradient, more, speed_m_s=speed, temp_ambient_c=warm))
    made = law_of(runs, c3=0.05, c4=0.05)
    bend = re.fullmatch(r"k \* abs\(speed_m_s\) \* max\(temp_ambient_c - ([\d.]+), 0\)", made.first.formula)
    assert bend is not None
    assert float(bend[1]) == pytest.approx(23.8, abs=0.2)
    assert made.first.k == pytest.approx(15.0, rel=0.03)


@pytest.mark.parametrize(("runs", "far_off", "close"), [(1, 1, 2), (2, 2, 3), (3, 3, 3), (6, 3, 3)])
def test_few_runs_show_no_long_products(runs: int, far_off: int, close: int) -> None:
    """Watts of one of several heaters, times a bend of the speed by chance: another run would have to show that."""
    grammar = make_grammar(drives(), set())
    design = SimpleNamespace(y=np.zeros(9), stretches=[slice(0, 9)], runs=[slice(0, 9)] * runs)
    far, near = (
        Search(SimpleNamespace(design=design, model=SimpleNamespace(squares=squares)), grammar) for squares in (1, None)
    )
    assert (len(far.by_size), len(near.by_size)) == (far_off, close)


@pytest.mark.usefixtures("laws_at_once")
@pytest.mark.parametrize(
    "what", ["current", *(pytest.param(what, marks=pytest.mark.long) for what in ("logged wind", "field that leans"))]
)
def test_what_comes_from_a_direction_of_the_compass(what: str) -> None:
    """A wind of which the strength is logged, and a field that leans without an inclinometer: 29 W off and "log it as a
    column" before. A slow current that nobody logs, beside the drag of water at rest: it was taken for such a field."""
    logged = what == "logged wind"
    rng, runs = np.random.default_rng(4), []
    for number in range(5):
        rows, wind = 1200, [5.0, 3.0, 7.0, 1.0, 4.0][number]
        speed = np.repeat(rng.uniform(0.0, 3.0, rows // 40), 40) * (np.arange(rows) % 240 > 30)
        heading = np.repeat(rng.uniform(-np.pi, np.pi, rows // 80), 80) + 0.02 * rng.standard_normal(rows)
        through = speed + wind * np.cos(heading - 0.8)
        costs = speed * through * np.abs(through) if logged else 35.0 * speed * np.cos(heading - 0.8)
        gradient = {"c3": 40.0 * speed, "c4": 30.0 * (speed > 0), "standing": 25.0 * (speed == 0)}
        if what == "current":
            gradient["c2"] = 60.0 * speed**3
            costs = 60.0 * ((speed + 0.1 * np.cos(heading - 0.8)).clip(0.0) ** 3 * (speed > 0) - speed**3)
        columns = {"speed_m_s": speed, "heading_rad": heading} | ({"wind_m_s": np.full(rows, wind)} if logged else {})
        runs.append(run_of(number, gradient, costs + 1.5 * rng.standard_normal(rows), **columns))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05, **({"c2": 0.05} if what == "current" else {}))
    through_air = "(abs(speed_m_s) + wind_m_s * cos(heading_rad - #))"
    formula = f"k * abs(speed_m_s) * {through_air} * abs{through_air}" if logged else LEANS
    formula = BREEZE if what == "current" else formula
    told = re.sub(r"(?<=heading_rad - )[\d.]+", "#", made.first.formula)
    assert told == formula
    for angle in re.findall(r"heading_rad - ([\d.]+)", made.first.formula):
        assert float(angle) == pytest.approx(0.8, abs=0.03)
    # 3 * 60 * 0.1 is the slope of the cube in the current
    k = {"logged wind": 1.0, "field that leans": 35.0, "current": 18.0}[what]
    assert made.first.k == pytest.approx(k, rel=0.03)
    assert "heading_rad" in made.certain


@pytest.mark.usefixtures("laws_at_once")
@pytest.mark.parametrize(
    ("one_way", "loaded"),
    [(False, False), *(pytest.param(*one, marks=pytest.mark.long) for one in ((True, False), (True, True)))],
)
def test_an_actuator_takes_power_while_it_moves(one_way: bool, loaded: bool) -> None:
    """A steering, and a mast that takes power on its way up: the angle itself says nothing of it, and turning was
    blamed. A fork takes it for the load that it lifts: a law of standing with a load stood in."""
    rng, runs = np.random.default_rng(5), []
    for number in range(4):
        rows, time_s = 3000, 0.1 * np.arange(3000)
        speed = np.repeat(rng.choice([0.0, 0.4, 0.8], 60), 50)
        goal = np.repeat(rng.uniform(-0.4, 0.4, 100), 30)
        angle = np.zeros(rows)
        for i in range(1, rows):
            angle[i] = angle[i - 1] + np.clip(goal[i] - angle[i - 1], -0.06, 0.06)
        moves = np.gradient(angle, time_s)
        costs = 50.0 * (np.maximum(moves, 0.0) if one_way else np.abs(moves))
        load = np.repeat(rng.choice([0.0, 1.0, 3.0], 20), 150)
        gradient = {"c3": 40.0 * speed, "c4": 30.0 * (speed > 0), "standing": 25.0 * (speed == 0)}
        columns = {"speed_m_s": speed, "mast_angle": angle}
        if loaded:
            costs, columns = load * costs, columns | {"payload_kg": load}
        runs.append(run_of(number, gradient, costs + 1.5 * rng.standard_normal(rows), step_s=0.1, **columns))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05)
    rate = "(mast_angle - lag(mast_angle, 0.3)) / 0.3"
    lifted = f"payload_kg * max({rate}, 0)" if loaded else f"max({rate}, 0)"
    assert made.first.formula == (f"k * {lifted}" if one_way else f"k * abs({rate})")
    assert made.first.k == pytest.approx(50.0, rel=0.15)
    assert made.curve is None


@pytest.mark.usefixtures("laws_at_once")
@pytest.mark.parametrize("what", ["steered on the spot", "warmer inside"])
def test_what_a_further_column_does_beside_another(what: str) -> None:
    """Wheels that take power where they are steered on the spot alone were found with a third of it (11.0 of 12.2 W
    left); a cooler that works against the difference of two temperatures was not found (13.5 of 13.6 W)."""
    rng, runs = np.random.default_rng(6), []
    for number in range(5):
        rows, time_s = 2000, 0.1 * np.arange(2000)
        speed = np.repeat(rng.choice([0.0, 0.0, 0.5, 0.9], 40), 50)
        goal = np.repeat(rng.uniform(-0.5, 0.5, 80), 25)
        angle = np.zeros(rows)
        for i in range(1, rows):
            angle[i] = angle[i - 1] + np.clip(goal[i] - angle[i - 1], -0.05, 0.05)
        outside = rng.uniform(0.0, 25.0) + 3.0 * np.sin(time_s / rng.uniform(20.0, 60.0))
        inside = rng.uniform(5.0, 30.0) + 8.0 * np.sin(time_s / rng.uniform(20.0, 60.0))
        columns, costs = {"steering_rad": angle}, 60.0 * np.abs(np.gradient(angle, time_s)) * (speed == 0.0)
        if what == "warmer inside":
            columns, costs = (
                {"cabin_temp_c": inside, "outside_temp_c": outside},
                3.0 * np.maximum(inside - outside, 0.0),
            )
        gradient = {"c3": 40.0 * speed, "c4": 30.0 * (speed > 0), "standing": 25.0 * (speed == 0)}
        watts = costs + 1.5 * rng.standard_normal(rows)
        runs.append(run_of(number, gradient, watts, step_s=0.1, speed_m_s=speed, **columns))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05)
    rate = "abs((steering_rad - lag(steering_rad, 0.3)) / 0.3)"
    formula = "max(cabin_temp_c - outside_temp_c, 0)" if "warm" in what else f"{rate} * (abs(speed_m_s) < 0.005)"
    assert made.first.formula == f"k * {formula}"
    assert made.first.k == pytest.approx(3.0 if "warm" in what else 60.0, rel=0.15)


@pytest.mark.usefixtures("laws_at_once")
def test_a_threshold_may_lie_where_few_rows_do() -> None:
    """A skid from 0.57 rad/s on, which one row in 25 reaches, and light runs turn no faster than 0.7 rad/s: the grammar
    had no threshold above 0.44 rad/s, where it was there with a load alone, and light runs that turn fast were off."""
    rng, runs = np.random.default_rng(1), []
    for number, payload in enumerate([0.0, 2.0, 4.0, 2.0, 0.0, 6.0]):
        rows, parts = 900, 60
        kind = rng.choice(3, parts, p=[0.5, 0.46, 0.04])
        fast = rng.uniform(0.58, 1.15 if payload else 0.7, parts)
        turns = np.repeat(np.select([kind == 1, kind == 2], [rng.uniform(0.05, 0.45, parts), fast], 0.0), 15)
        yaw = np.abs(turns + 0.01 * rng.standard_normal(rows)) * (turns > 0.0)
        speed = np.repeat(rng.uniform(0.0, 0.6, rows // 30), 30)
        gradient = {"c3": 40.0 * speed, "c4": np.full(rows, 30.0)}
        costs = 80.0 * np.maximum(yaw - 0.57, 0.0) + 0.6 * rng.standard_normal(rows)
        columns = {"speed_m_s": speed, "yaw_rate_rad_s": yaw, "payload_kg": np.full(rows, payload)}
        runs.append(run_of(number, gradient, costs, **columns))
    made = law_of(runs, c3=0.05, c4=0.05)
    assert re.sub(r"[\d.]+(?=, 0)", "#", made.first.formula) == "k * max(abs(yaw_rate_rad_s) - #, 0)"
    assert float(re.findall(r"- ([\d.]+)", made.first.formula)[0]) == pytest.approx(0.57, abs=0.03)


@pytest.mark.usefixtures("laws_at_once")
@pytest.mark.parametrize("uphill_alone", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_law_may_follow_what_hardly_changes_where_it_acts(uphill_alone: bool) -> None:
    """A load that was carried uphill alone: the dearer climb was told as the slope's, without a word of the load."""
    rng, runs = np.random.default_rng(6), []
    for number in range(4):
        rows = 600
        speed = np.repeat(rng.uniform(0.1, 1.0, rows // 40), 40)
        slope = np.repeat(rng.choice([-0.08, 0.0, 0.06, 0.1], rows // 60), 60) + 0.001 * rng.standard_normal(rows)
        load = 25.0 * (slope > 0.03) if uphill_alone else np.repeat(rng.choice([0.0, 25.0], rows // 60), 60)
        gradient = {"c3": 40.0 * speed, "c4": np.full(rows, 30.0)}
        more = 300.0 * speed * np.maximum(slope, 0.0) + 0.5 * rng.standard_normal(rows)
        runs.append(run_of(number, gradient, more, speed_m_s=speed, slope_rad=slope, payload_kg=load))
    made = law_of(runs, c3=0.05, c4=0.05)
    assert made.first.formula == "k * abs(speed_m_s) * max(slope_rad, 0)"
    assert made.goes_with == (("payload_kg",) if uphill_alone else ())


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_drag_goes_by_the_speed_through_the_air(sign: float) -> None:
    """A wind along the way, against the robot or with it, in a column of the user's."""
    rng, runs = np.random.default_rng(3), []
    for number in range(5):
        rows = 1200
        speed = np.repeat(rng.uniform(0.0, 6.0, rows // 40), 40) * (np.arange(rows) % 240 > 30)
        wind = np.repeat(rng.uniform(-3.0, 6.0, rows // 60), 60) + 0.1 * rng.standard_normal(rows)
        through = speed + wind
        gradient = {"c3": 20.0 * speed, "c4": 30.0 * (speed > 0), "standing": 25.0 * (speed == 0)}
        more = 0.9 * speed * through * np.abs(through) + 1.5 * rng.standard_normal(rows)
        runs.append(run_of(number, gradient, more, speed_m_s=speed, along_m_s=sign * wind))
    made = law_of(runs, c3=0.05, c4=0.05, standing=0.05)
    through = f"(abs(speed_m_s) {'+' if sign > 0.0 else '-'} along_m_s)"
    assert made.first.formula == f"k * abs(speed_m_s) * {through} * abs{through}"
    assert made.first.k == pytest.approx(0.9, rel=0.03)
