"""A parameter in a unit that is not SI: what is written is what was fitted, and is read again as that."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.effects.library import declared
from missionsim.errors import InputError
from missionsim.inputs import edit, units
from missionsim.inputs.edit import robot_text
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.parameter import parameters
from missionsim.logs import LogTable

from .logs import drawing, drive
from .test_commands import write

pytestmark = pytest.mark.usefixtures("examined_once")

UNITS = ("W/rpm", "W/percent", "N h/mm", "mW")
EFFECT = '{{name: brush, battery: robot{more}, power: "k * brush_rpm", parameters: {{k: {k}}}}}'


def _brushing(seed: int) -> LogTable:
    log = drive(seed, seconds=200.0)
    rpm = np.random.default_rng(seed).choice([0.0, 60.0, 120.0], size=log.rows // 15 + 1).repeat(15)[: log.rows]
    return drawing(log, log.power_w["robot"] + 0.05 * rpm, brush_rpm=rpm)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("brush")
    for seed in range(4):
        write(_brushing(seed), root / ("train" if seed < 3 else "held"))
    return {name: root / name for name in ("train", "held")}


def _robot(folder: Path, k: str, more: str = "") -> Path:
    path = folder / "robot.yaml"
    path.write_text(robot_text("pioneer3dx") + f"effects:\n  - {EFFECT.format(k=k, more=more)}\n", encoding="utf-8")
    return path


def _told(line: str, folder: Path) -> dict[str, Any]:
    out = folder / "told.json"
    assert run_command(shlex.split(f"{line} --json {out} --quiet")) == 0
    return dict(json.loads(out.read_text(encoding="utf-8")))


def _error(robot: Path, logs: Path, folder: Path) -> float:
    return float(_told(f"compare --robot {robot} {logs}", folder)["batteries"]["robot"]["power_rmse_w"])


@pytest.mark.parametrize(
    ("command", "unit"),
    [
        ("add-effect --effect brush", UNITS[0]),
        *(pytest.param("add-effect --effect brush", unit, marks=pytest.mark.long) for unit in UNITS[1:]),
        pytest.param("improve --yes", "W/rpm", marks=pytest.mark.long),
    ],
)
def test_a_candidate_in_any_unit_is_written_as_it_was_fitted(
    logs: dict[str, Path], tmp_path: Path, command: str, unit: str
) -> None:
    robot, better = _robot(tmp_path, f"{{value: 0, low: 0, high: 1e9, unit: {unit}}}", ", candidate: true"), "b.yaml"
    line = f"{command} --robot {robot} {logs['train']} --holdout {logs['held']} --out {tmp_path / better}"
    told = _told(line, tmp_path)
    (written,) = robot_from_text((tmp_path / better).read_text(encoding="utf-8")).effects
    k = written.parameters["k"]
    assert k.value == pytest.approx(0.05, rel=0.1)  # the column stays as it was logged
    assert units.any_unit(k.unit)[0] == 1.0
    assert units.same_dimension(k.unit, unit)
    if command.startswith("add-effect"):
        assert told["parameters"]["k"]["unit"] == k.unit
        assert told["parameters"]["k"]["value"] == pytest.approx(k.value, rel=1e-6)
        with_effect = told["heldout"]["power_rmse_w"]["with_effects"]
        assert _error(tmp_path / better, logs["held"], tmp_path) == pytest.approx(with_effect, rel=1e-3)


@pytest.mark.parametrize("unit", [UNITS[2], *(pytest.param(u, marks=pytest.mark.long) for u in UNITS if u != UNITS[2])])
@pytest.mark.parametrize(
    "form", ["{{value: {0}, sd: {0}, low: 0, unit: {1}}}", "{0} {1}", "{{value: {0} {1}, unit: {1}}}"]
)
def test_calibrate_writes_in_the_unit_that_stands_there(
    logs: dict[str, Path], tmp_path: Path, unit: str, form: str
) -> None:
    factor = units.si_factor(unit)
    assert factor
    robot, better = _robot(tmp_path, form.format(f"{0.04 / factor:.6g}", unit)), tmp_path / "better.yaml"
    told = _told(f"calibrate --robot {robot} {logs['train']} --out {better}", tmp_path)["batteries"]["robot"]
    k = robot_from_text(better.read_text(encoding="utf-8")).effects[0].parameters["k"]
    fitted = told["parameters"]["brush.k"]
    assert fitted["value"] == pytest.approx(0.05, rel=0.1)
    assert (k.value, k.sd) == pytest.approx((fitted["value"], fitted["sd"]), rel=1e-5)
    assert k.note == f"0.04 {fitted['unit']} before"
    assert _error(better, logs["train"], tmp_path) == pytest.approx(told["rmse_w"], rel=1e-3)


def test_a_library_effect_in_another_unit_keeps_it() -> None:
    effect = "{effect: viscous_friction, battery: robot, parameters: {k: {value: 1e-6, high: 1, unit: N h/mm}}}"
    text = robot_text("pioneer3dx") + f"effects:\n  - {effect}\n"
    new = edit.Editing(text).set_values({"effects.0.parameters.k": {"value": 7.2, "sd": 0.36}}).text
    k = dict(parameters(robot_from_text(new)))["effects.0.parameters.k"]
    assert (k.value, k.sd, k.high) == pytest.approx((7.2, 0.36, 3.6e6))
    assert "value: 0.000002" in new or "value: 2e-06" in new


@pytest.mark.parametrize(
    ("unit", "si"), [("W/rpm", "W/(rad/s)"), ("N h/mm", "N s/m"), ("W/percent", "W"), ("percent", "1")]
)
def test_si_units_have_names_that_people_use(unit: str, si: str) -> None:
    assert units.any_unit(unit)[1] == si
    assert units.any_unit(si)[0] == 1.0


def test_numbers_of_a_distribution_are_in_the_unit_beside_them(tmp_path: Path) -> None:
    k = "{value: 3, unit: kW, distribution: {kind: normal, sd: 0.5}}"
    drawn = robot_from_text(_robot(tmp_path, k).read_text(encoding="utf-8")).effects[0].parameters["k"].distribution
    assert drawn is not None
    assert (drawn.mean, drawn.sd) == (3000.0, 500.0)


def test_a_unit_with_an_offset_is_no_factor() -> None:
    with pytest.raises(units.UnitError, match="offset"):
        units.any_unit("degF")
    assert units.si_factor("K") is None  # of temperatures in degC


def test_a_power_of_the_library_with_an_argument_too_many_is_refused_as_it_is_read() -> None:
    entry = {"equation": "k·x", "source": "assumed", "unit": "W", "needs": ["a", "b"], "power": "product(k, a, b)"}
    with pytest.raises(InputError, match="'product' takes other arguments"):
        declared("own", entry)
    declared("own", entry | {"power": "product(k, a)"})
