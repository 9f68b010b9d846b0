"""Effects that logs of real robots ask for, each against a formula written here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.diagnose.examine import Subject, examine
from missionsim.diagnose.features import Features, make_features
from missionsim.diagnose.split import Split
from missionsim.effects.library import get_effect, logged_power_columns
from missionsim.effects.model import PowerModel
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.fit.parameters import fit_parameters
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import load_mission, robot_from_text
from missionsim.inputs.power import build_power_model
from missionsim.labels import Labels
from missionsim.runs.run import Run
from missionsim.uncertainty.batch import Task, prepare

MASS_KG, G = 30.0, 9.80665
ROBOT = """\
kind: robot
name: cart
body: {mass: 30 kg, drive: differential, max_speed: 2 m/s%s}
batteries: {robot: {capacity: 100 Wh, nominal_voltage: 25 V}}
motion: {battery: robot, parameters: {c2: 4, c3: 10, c4: 3, standing: 2}}
"""


def model(effects: str = "", body: str = "") -> PowerModel:
    text = ROBOT % body + (f"effects:\n{effects}" if effects else "")
    return build_power_model(robot_from_text(text))


def base(v: np.ndarray) -> np.ndarray:
    return np.where(v >= 0.005, 4.0 * v**2 + 10.0 * v + 3.0, 2.0)


V = np.array([0.5, 1.0, 1.0, 0.5, 0.0])
A = np.array([0.8, -0.6, 0.0, -2.0, 0.0])


def test_braking_gives_its_own_share_back() -> None:
    power = model("  - {effect: acceleration, battery: robot, parameters: {k: 1.5, regeneration: 0.8}}\n").total(
        {"speed_m_s": V, "accel_m_s2": A}, "robot"
    )
    wanted = base(V) + np.array([1.5 * 30 * 0.4, -1.2 * 30 * 0.6, 0.0, -1.2 * 30 * 1.0, 0.0])
    assert power == pytest.approx(wanted, rel=1e-12)
    assert power[3] < 0.0  # the battery is charged


def at_the_wheels(kinetic: np.ndarray, share: float) -> np.ndarray:
    """What the battery gives, written as a drive does: motor or generator by the sign of the net power."""
    moving = V >= 0.005
    net = 4.0 * V**2 + 10.0 * V + kinetic
    return np.where(moving, np.where(net > 0.0, net, share * net) + 3.0, 2.0)


def test_without_a_share_of_its_own_the_body_s_decides_what_the_net_power_gives_back() -> None:
    effect = "  - {effect: acceleration, battery: robot, parameters: {k: 1.5}}\n"
    cov = {"speed_m_s": V, "accel_m_s2": A}
    kinetic = 1.5 * MASS_KG * A * V
    assert model(effect).total(cov, "robot") == pytest.approx(base(V) + np.maximum(kinetic, 0.0), rel=1e-12)
    given = model(effect, ", regeneration: 60 %").total(cov, "robot")
    assert given == pytest.approx(at_the_wheels(kinetic, 0.6), rel=1e-12)


def test_braking_and_descents_together_relieve_the_drive_first() -> None:
    effects = "".join(
        f"  - {{effect: {name}, battery: robot, parameters: {{k: {k}, regeneration: 0.5, relief: 1}}}}\n"
        for name, k in (("acceleration", 1.5), ("grade", 1.2))
    )
    slope = np.array([-0.2, 0.1, -0.1, 0.0, 0.0])
    cov = {"speed_m_s": V, "accel_m_s2": A, "slope_rad": slope}
    both = 1.5 * MASS_KG * A * V + 1.2 * MASS_KG * G * np.sin(slope) * V
    assert model(effects).total(cov, "robot") == pytest.approx(at_the_wheels(both, 0.5), rel=1e-12)


def test_a_robot_that_drives_backwards_brakes_where_its_speed_shrinks() -> None:
    effect = get_effect("acceleration")
    cov = {"speed_m_s": np.array([-1.0, -1.0]), "accel_m_s2": np.array([0.5, -0.5]), "mass_kg": 2.0}
    assert effect.power(cov, {"k": 1.5, "regeneration": 0.4}) == pytest.approx([-0.6, 1.5])


def test_downhill_gives_its_own_share_back_whatever_the_drive_takes() -> None:
    slope = np.array([0.1, -0.01, -0.2])
    power = model("  - {effect: grade, battery: robot, parameters: {k: 1.4, regeneration: 50 %}}\n").total(
        {"speed_m_s": np.ones(3), "slope_rad": slope}, "robot"
    )
    wanted = 17.0 + MASS_KG * G * np.sin(slope) * np.array([1.4, 0.7, 0.7])
    assert power == pytest.approx(wanted, rel=1e-12)
    assert power[2] < 0.0


def test_copper_loss_follows_the_force_squared() -> None:
    effect = get_effect("copper_loss")
    cov = {
        "speed_m_s": np.array([1.0, 0.2, -1.0, 0.0]),
        "accel_m_s2": np.array([0.0, 1.0, 1.0, 0.0]),
        "slope_rad": np.array([0.1, 0.0, -0.1, 0.1]),
        "mass_kg": 10.0,
    }
    force = [10 * G * (np.sin(0.1) + 0.03), 10 + 10 * G * 0.03, -10 + 10 * G * (np.sin(-0.1) + 0.03), 0.0]
    assert effect.power(cov, {"k": 0.02, "rolling": 0.03}) == pytest.approx(0.02 * np.square(force), rel=1e-12)
    del cov["slope_rad"]
    assert effect.power(cov, {"k": 1.0, "rolling": 0.0}) == pytest.approx([0.0, 100.0, 100.0, 0.0])


def test_odometry_that_trembles_at_rest_pulls_nothing() -> None:
    """It took the load at rest for heat in the windings, which a mission, that really stands, then lacked: 44 % of the
    energy of a small robot."""
    rest = {"speed_m_s": np.array([5e-4, -5e-4, 0.3]), "accel_m_s2": np.zeros(3), "mass_kg": 2.0}
    for turns in (0.0, 0.8):  # or that turns on the spot
        power = get_effect("copper_loss").power(
            {**rest, "yaw_rate_rad_s": np.full(3, turns)}, {"k": 1.0, "rolling": 0.1}
        )
        assert power == pytest.approx([0.0, 0.0, (2.0 * 0.1 * G) ** 2])


LINEAR = "c3*v + kw*abs(w) + ka*m*a*v + kg*m*v*sin(theta)"
FORMULA = "motion: {battery: robot, model: expression, power: '%s + c4', standing: 2, parameters: {c3: 10, kw: 20, %s}}"
OF_MASS = "ka: 1.4, kg: 14, c4: 3"


def with_formula(power: str, effects: str = "") -> str:
    motion = next(line for line in ROBOT.splitlines() if line.startswith("motion"))
    return (ROBOT % "").replace(motion, FORMULA % (power, OF_MASS)) + (f"effects:\n{effects}" if effects else "")


LOST = "  - {effect: lost_recuperation, battery: robot, parameters: {k: %g}}\n"


@pytest.mark.parametrize("lost", [0.4, 1.0])
def test_what_a_linear_base_gives_back_is_lost_in_part_but_for_turning(lost: float) -> None:
    cov = {"speed_m_s": V, "accel_m_s2": A, "slope_rad": np.array([0.0, -0.1, -0.1, 0.1, 0.0])}
    cov |= {"yaw_rate_rad_s": np.array([0.0, 0.3, 1.0, 0.0, 0.0]), "time_s": np.arange(5.0)}
    own = build_power_model(robot_from_text(with_formula(LINEAR, LOST % lost)))
    kinetic, lifting = 1.4 * 30 * A * V, 14 * 30 * V * np.sin(cov["slope_rad"])
    ahead = 10 * V + kinetic + lifting
    moving = 20 * cov["yaw_rate_rad_s"] + np.maximum(ahead, 0.0) + (1 - lost) * np.minimum(ahead, 0.0) + 3
    assert own.total(cov, "robot") == pytest.approx(np.where(V > 0.0, moving, 2.0), rel=1e-12)
    assert np.sum(ahead < 0.0) == 3
    slopes = own.gradient(own.complete(cov), "robot")
    part = np.where(ahead < 0.0, 1.0 - lost, 1.0)
    assert slopes["kg"] == pytest.approx(part * lifting, rel=1e-6)
    assert slopes["lost_recuperation.k"] == pytest.approx(-lost * np.minimum(ahead, 0.0), rel=1e-6)


def test_a_mission_without_recuperation_takes_what_its_formula_would(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text(
        "kind: environment\nname: hill\nplaces: {top: {x: 0, y: 0}, end: {x: 90, y: 0}, back: {x: 0, y: 9}}\n"
        "edges: [{from: top, to: end, slope: -0.1}, {from: end, to: back, slope: -0.01}, {from: back, to: top}]\n"
    )
    (tmp_path / "mission.yaml").write_text(
        "kind: mission\nname: down\nrobot: robot.yaml\nenvironment: site.yaml\nstart: top\n"
        "defaults: {speed: 1 m/s}\nsegments: [{drive: {to: end}}, {drive: {to: back}}, {drive: {to: top}}]\n"
    )
    ahead = LINEAR.replace("kw*abs(w) + ", "")
    energy = []
    for text in (with_formula(LINEAR, LOST % 1), with_formula(f"max({ahead}, 0) + kw*abs(w)")):
        slow = text.replace("max_speed: 2 m/s", "max_speed: 2 m/s, max_acceleration: 0.5 m/s^2")
        (tmp_path / "robot.yaml").write_text(slow)
        energy.append(simulate(load_mission(tmp_path / "mission.yaml")).batteries["robot"].energy_wh)
    assert energy[0] == pytest.approx(energy[1], rel=1e-9)
    # in a batch, what pushes back stands with all of the drive, though k alone is drawn
    drawn = with_formula(LINEAR, LOST.replace("%g", "{value: 0.8, sd: 0.1}"))
    (tmp_path / "robot.yaml").write_text(drawn)
    (tmp_path / "mission.yaml").write_text(
        "kind: mission\nname: down\nrobot: robot.yaml\ndefaults: {speed: 0.5 m/s}\nsegments:\n"
        "  - drive: {distance: 20 m}\n  - wait: {duration: 60 s}\n  - drive: {distance: 5 m, slope: -5 deg}\n"
    )
    made = prepare(Task(str(tmp_path / "mission.yaml"), (), None, 1, "auto"))
    assert made.arrays is not None, made.why_not_arrays


def test_a_rate_of_what_a_mission_does_not_know_is_a_fault_of_the_input(tmp_path: Path) -> None:
    law = "  - {name: arm, battery: robot, power: 'k * abs(angle - lag(angle, 0.3))', parameters: {k: 5 W}}\n"
    (tmp_path / "robot.yaml").write_text((ROBOT % "") + f"effects:\n{law}")
    (tmp_path / "mission.yaml").write_text(
        "kind: mission\nname: ahead\nrobot: robot.yaml\nsegments: [{drive: {distance: 5 m, speed: 1 m/s}}]\n"
    )
    with pytest.raises(InputError, match="'arm' reads 'angle', which is not known here") as fault:
        simulate(load_mission(tmp_path / "mission.yaml"))
    assert "conditions: {angle: …}" in fault.value.faults[0].allowed


def test_a_base_that_takes_all_as_given_back_is_told_from_heat_in_the_windings() -> None:
    """Fitted to a drive that gives nothing back its slopes are half-way between: climbing and copper loss were called
    sure in its place."""
    logs = [stop_and_go(seed, 0.6) for seed in range(4)]
    base = "c2*v**2 + c3*v + ka*m*a*v + kg*m*v*sin(theta) + c4"
    own = robot_from_text(calibrate_new(NewRobot("own", base, mass="30 kg"), logs).text)
    (first, *_) = examine(Subject.of(own), Split(tuple(logs), (), ""), "robot", Settings()).found.effects
    assert first.effect == "lost_recuperation"
    assert first.parameters["k"].low < 0.4 < first.parameters["k"].high
    # a base that knows neither acceleration nor slope takes nothing as given back
    assert not any(c.effect == "lost_recuperation" for c in features(*logs).candidates)


def test_losses_of_resistance_and_of_conversion_differ_where_the_voltage_sags() -> None:
    effects = "  - {effect: battery_resistance, battery: robot, parameters: {k: 80 mohm}}\n"
    cov = {"speed_m_s": np.ones(2), "voltage_robot_v": np.array([25.0, 20.0])}
    assert model(effects).total(cov, "robot") == pytest.approx([17 + 0.08 * (17 / 25) ** 2, 17 + 0.08 * (17 / 20) ** 2])
    # a plan knows no voltage but the nominal one
    assert model(effects).total({"speed_m_s": 1.0}, "robot") == pytest.approx(17 + 0.08 * (17 / 25) ** 2)


def test_logged_watts_pass_through() -> None:
    effects = "".join(
        f"  - {{effect: 'logged_power:{name}', battery: robot, parameters: {{k: 1.1}}}}\n"
        for name in ("heater_w", "arm_kw")
    )
    cov = {"speed_m_s": np.ones(2), "heater_w": np.array([0.0, 50.0]), "arm_kw": np.array([0.02, 0.0])}
    assert model(effects).total(cov, "robot") == pytest.approx([17 + 22, 17 + 55])


def test_columns_of_watts_are_recognised_by_their_names() -> None:
    names = [
        *("heating_w", "aircon_kw", "power_arm_w", "power_robot_w", "total_w", "battery_power_w", "drive_w"),
        *("w", "speed", "motor_pwr_w", "left_wheel_power_w"),
    ]
    assert logged_power_columns(names, ("robot",)) == ("aircon_kw", "heating_w", "power_arm_w")


def test_scrub_by_floor() -> None:
    effects = (
        "  - {effect: surface_turning_scrub, battery: robot, parameters: {k_ice: 1, k_snow: 7}}\n"
        "  - {effect: 'surface_turning_scrub:tile', battery: robot, parameters: {k: 3}}\n"
    )
    cov = {"speed_m_s": np.ones(4), "yaw_rate_rad_s": np.array([1, -2, 1, 1.0])}
    cov["surface"] = Labels.of(["ice", "snow", "tile", "sand"])
    assert model(effects).total(cov, "robot") == pytest.approx([18.0, 31.0, 20.0, 17.0])


def stop_and_go(seed: int, back: float, **more: object) -> Run:
    """A cart of 30 kg that speeds up and brakes; the battery gets `back` of what is too much at the wheels."""
    rng = np.random.default_rng(seed)
    count = 400
    goal = np.repeat(rng.choice([0.0, 0.5, 1.0, 1.5], count // 10 + 1), 10)[:count]
    speed = np.zeros(count)
    for i in range(1, count):
        speed[i] = speed[i - 1] + min(max(goal[i] - speed[i - 1], -0.5), 0.4)
    accel = np.gradient(speed)
    slope = np.repeat(rng.choice([-0.15, -0.05, 0.0, 0.1], count // 40 + 1), 40)[:count]
    kinetic, lifting = 1.4 * MASS_KG * accel * speed, 1.4 * MASS_KG * G * speed * np.sin(slope)
    drive = 4.0 * speed**2 + 10.0 * speed
    net = drive + kinetic + lifting
    power = np.where(speed >= 0.005, np.maximum(net, 0.0) + back * np.minimum(net, 0.0) + 3.0, 2.0)
    power = power + rng.normal(0.0, 0.1, count)
    columns = {"time_s": np.arange(count) + 0.5, "speed_m_s": speed, "accel_m_s2": accel, "slope_rad": slope, **more}
    return Run(f"run_{seed}", columns, np.ones(count), {"robot": power}, {"robot": None}, {"robot": "power"})


def test_regeneration_is_a_parameter_that_logs_fit() -> None:
    effects = (
        "  - {effect: acceleration, battery: robot, parameters: {k: 1.4}}\n"
        "  - {effect: grade, battery: robot, parameters: {k: 1.4}}\n"
    )
    start = model(effects, ", regeneration: {value: 40 %, sd: 30 %}")
    assert start.parameters["robot/regeneration"].path == "body.regeneration"
    fit = fit_parameters(start, [stop_and_go(seed, 0.65) for seed in (1, 2)], "robot")
    found = fit.parameters["regeneration"]
    assert found.low < 0.65 < found.high
    assert found.value == pytest.approx(0.65, abs=0.03)
    assert fit.model.constants["regeneration"] == found.value
    assert "robot/regeneration" not in model(effects).parameters
    # a part is no more than all
    every = fit_parameters(start, [stop_and_go(seed, 1.0) for seed in (1, 2)], "robot").parameters["regeneration"]
    assert every.value + 1.96 * every.sd > 1.0 == every.high


def features(*logs: Run, **body: str) -> Features:
    return make_features(model(**body), logs, "robot")


def test_what_comes_back_is_asked_of_the_data() -> None:
    log = stop_and_go(3, 0.7)
    found = features(log)
    asked = {c.effect: c for c in found.candidates if "regeneration" in c.shape_bounds}
    assert asked.keys() == {"acceleration", "grade"}
    assert asked["grade"].shape_bounds == {"regeneration": (0.0, 1.0)}
    v, a, slope = (np.asarray(log.columns[n]) for n in ("speed_m_s", "accel_m_s2", "slope_rad"))
    kinetic, lifting = MASS_KG * a * v, MASS_KG * G * v * np.sin(slope)
    for effect, power in (("acceleration", kinetic), ("grade", lifting)):
        refit = asked[effect].refit
        assert refit is not None
        for share in (0.0, 0.3, 1.0):
            column = refit({"regeneration": share})[0]
            np.testing.assert_allclose(column, np.where(power > 0.0, power, share * power), atol=1e-12)
    # where the file says what comes back, the data are asked for the size alone; a battery that is never charged
    # cannot tell more of a descent than that it relieves the drive
    assert not any("regeneration" in c.shape_bounds for c in features(log, body=", regeneration: 50 %").candidates)
    never = features(stop_and_go(3, 0.0))
    assert [c.effect for c in never.candidates if "regeneration" in c.shape_bounds] == ["acceleration"]


def test_loads_that_are_logged_beside_are_candidates() -> None:
    rng = np.random.default_rng(1)
    heater = np.repeat(rng.choice([0.0, 40.0], 10), 40)
    log = stop_and_go(4, 0.0, heater_w=heater, nothing_w=np.zeros(400))
    ids = [c.effect for c in features(log).candidates]
    assert "logged_power:heater_w" in ids
    assert "logged_power:nothing_w" not in ids
    again = stop_and_go(4, 0.0)
    again = stop_and_go(4, 0.0, supply_w=again.power_w["robot"] * 1.01)
    found = features(again)
    assert not any(c.effect.startswith("logged_power") for c in found.candidates)
    assert any("supply_w follows the measured power" in remark for remark in found.remarks)


def test_a_steady_voltage_tells_no_resistance() -> None:
    rng = np.random.default_rng(2)
    ids = {
        sag: [c.effect for c in features(stop_and_go(5, 0.0, voltage_robot_v=25.0 - sag * rng.random(400))).candidates]
        for sag in (0.1, 4.0)
    }
    assert "battery_resistance" in ids[4.0]
    assert "battery_resistance" not in ids[0.1]


def test_a_mission_that_brakes_charges_its_battery(tmp_path: Path) -> None:
    (tmp_path / "cart.yaml").write_text(
        ROBOT % ", max_acceleration: 0.5, max_deceleration: 1"
        + "effects:\n  - {effect: acceleration, battery: robot, parameters: {k: 1.5, regeneration: 0.8}}\n"
    )
    (tmp_path / "mission.yaml").write_text(
        "kind: mission\nname: one\nrobot: cart.yaml\nsegments:\n  - drive: {distance: 10 m, speed: 2 m/s}\n"
    )
    result = simulate(load_mission(tmp_path / "mission.yaml"))
    # 0 to 2 m/s in 4 s and 4 m, down in 2 s and 2 m, 4 m at 2 m/s
    squares = 4.0 * (4.0 * 4.0 / 3.0 + 4.0 * 2.0 / 3.0 + 4.0 * 2.0)
    wanted = squares + 10.0 * 10.0 + 3.0 * 8.0 + 0.5 * MASS_KG * 4.0 * (1.5 - 1.2)
    battery = result.batteries["robot"]
    assert battery.energy_wh * 3600.0 == pytest.approx(wanted, rel=1e-9)
    assert battery.audit_relative_error < 1e-9
    assert not result.warnings
