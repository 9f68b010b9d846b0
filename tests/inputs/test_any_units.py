"""Numbers with units where any unit may stand: parameters of motion, laws and effects."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.inputs import edit, units
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.parameter import parameters

ROBOT = """\
kind: robot
name: cart
body: {mass: 30 kg, drive: differential, max_speed: 2 m/s}
batteries: {robot: {capacity: 100 Wh}}
motion:
  battery: robot
  parameters: {c2: {value: 4, sd: 0.2}, c3: {value: 10 N, sd: 5 %}, c4: {value: 11 W, sd: 0.5 W}, standing: 9 W}
components:
  sonar:
    loads: [{battery: robot, law: {power: "k*rate", rate: 10 Hz, parameters: {k: {value: 20 mW s, sd: 1 mW s}}}}]
effects:
  - {effect: standby_load, battery: robot, parameters: {k: {value: 500 mW, sd: 0.1 W, low: 0.2 W, high: 1 kW}}}
  - {name: own, battery: robot, power: "k*v", parameters: {k: {value: 20, sd: 2, unit: mW s/m}}}
"""


def test_value_and_sd_with_units_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cart.yaml").write_text(ROBOT)
    assert run_command(["validate", str(tmp_path / "cart.yaml")]) == 0, capsys.readouterr().err
    robot = robot_from_text(ROBOT)
    assert robot.motion is not None
    motion = robot.motion.parameters
    assert (motion["c4"].value, motion["c4"].sd, motion["c4"].unit) == (11.0, 0.5, "W")
    assert motion["c3"].sd == pytest.approx(0.5)
    law = robot.components["sonar"].loads[0].law
    assert law is not None
    assert (law.parameters["k"].value, law.parameters["k"].sd) == pytest.approx((0.02, 0.001))
    load = robot.effects[0].parameters["k"]
    assert (load.value, load.sd, load.low, load.high) == pytest.approx((0.5, 0.1, 0.2, 1000.0))
    own = robot.effects[1].parameters["k"]
    assert (own.value, own.sd) == pytest.approx((0.02, 0.002))


def test_watts_for_each_per_cent() -> None:
    assert units.any_unit("W/%") == (pytest.approx(100.0), "W")
    assert units.parse("0.5 Wh/%")[0] == pytest.approx(180_000.0)


def test_a_spread_in_another_unit_is_a_fault() -> None:
    with pytest.raises(InputError, match="sd in another unit than its value"):
        robot_from_text(ROBOT.replace("sd: 0.5 W", "sd: 0.5 V"))
    with pytest.raises(InputError, match="high in another unit than its value"):
        robot_from_text(ROBOT.replace("high: 1 kW", "high: 1 kg"))


@pytest.mark.parametrize("path", ["motion.parameters.c4", "motion.parameters.standing", "effects.0.parameters.k"])
def test_fitted_values_replace_those_with_units(path: str) -> None:
    new = edit.Editing(ROBOT).set_values({path: {"value": 0.75, "sd": 0.25, "status": "fitted"}}).text
    found = dict(parameters(robot_from_text(new)))[path]
    assert (found.value, found.sd, found.unit, found.status) == (0.75, 0.25, "W", "fitted")


@pytest.mark.parametrize("text", ["1 m/9**9**9", "1 m^9^9^9", "1 W*9**9**9*s", "1 (m^9)^9^9^9", "1 m**9999999999"])
def test_a_unit_that_would_be_computed_for_ever_is_refused(text: str) -> None:
    for dimension in ("length", "power"):
        with pytest.raises(units.UnitError):
            units.parse(text, dimension)[0]
    with pytest.raises(units.UnitError):
        units.parse(text)


@pytest.mark.parametrize(
    ("text", "value"), [("1 kg*m^2/s^3", 1.0), ("2 mW/(m/s)^2", 0.002), ("3 J/s", 3.0), ("1 (m/s)**2", 1.0)]
)
def test_powers_of_units_are_read(text: str, value: float) -> None:
    assert units.parse(text)[0] == pytest.approx(value)


def test_an_empirical_file_is_a_plain_file_beside_its_yaml(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "secret.csv").write_text("password\n1\n")
    (tmp_path / "inner" / "values.csv").write_text("w\n10\n12\n")
    os.mkfifo(tmp_path / "inner" / "pipe")
    given = "c4: {value: 11, distribution: {kind: empirical, file: FILE, column: w}}"
    refused = ("pipe", "/dev/zero", "/dev/stdin", "../secret.csv")
    robots = []
    for number, file in enumerate(("values.csv", *refused)):
        robots.append(tmp_path / "inner" / f"cart_{number}.yaml")
        robots[-1].write_text(ROBOT.replace("c4: {value: 11 W, sd: 0.5 W}", given.replace("FILE", file)))
    done = subprocess.run(
        [sys.executable, "-m", "missionsim", "validate", *map(str, robots)],
        capture_output=True,
        text=True,
        timeout=300,
        stdin=subprocess.PIPE,
        input=None,
        check=False,
    )
    assert done.returncode == 2
    assert [str(robot) in done.stderr for robot in robots] == [False, True, True, True, True]
    assert "password" not in done.stderr
