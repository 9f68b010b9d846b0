"""What somebody else adds takes one file: an effect with a column of its own, a motion model, a law of a component."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PACKAGE = """\
from missionsim.effects.base import Effect, ParameterSpec
from missionsim.effects.named_models import LawModel, MotionModel

WIND = Effect(
    "head_wind",
    "k*wind*v",
    "assumed",
    "wind from ahead",
    (ParameterSpec("k", "N s/m", "force per wind speed"),),
    ("wind_m_s", "speed_m_s"),
    lambda c, p: p["k"] * c["wind_m_s"] * c["speed_m_s"],
    drive=True,
    covariate="wind_m_s",
)


def tracks():
    rub = ParameterSpec("rub", "N", "friction of the tracks")
    return MotionModel(
        "tracks",
        "rub*v",
        "assumed",
        (Effect("rub", "rub*v", "", "", (rub,), ("speed_m_s",), lambda c, p: p["rub"] * c["speed_m_s"], drive=True),),
    )


PUMP = LawModel("pump", "q**3", (ParameterSpec("q", "W", "flow"),), (), lambda c, p: p["q"] ** 3)
"""
ROBOT = """\
kind: robot
name: digger
body: {mass: 30 kg, drive: skid_steer, max_speed: 2 m/s}
batteries: {robot: {capacity: 100 Wh}}
motion: {battery: robot, model: tracks, parameters: {rub: 20}}
components:
  pump: {always_on: true, loads: [{battery: robot, law: {model: pump, parameters: {q: 2}}}]}
"""


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Environment in which a package of one module and its entry points is installed."""
    site = tmp_path / "site"
    (site / "digger-1.0.dist-info").mkdir(parents=True)
    (site / "digger.py").write_text(PACKAGE)
    (site / "digger-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: digger\nVersion: 1.0\n")
    points = "head_wind = digger:WIND\ntracks = digger:tracks\npump = digger:PUMP\n"
    (site / "digger-1.0.dist-info" / "entry_points.txt").write_text("[missionsim.effects]\n" + points)
    return {**os.environ, "PYTHONPATH": str(site)}


def batteries(installed: dict[str, str], folder: Path, *commands: str) -> list[dict[str, Any]]:
    """What commands, called one after the other in one process, say of the battery."""
    code = "import sys; from missionsim.cli.app import run_command; " + (
        "sys.exit(max(run_command([*words.split(), '--json', f'{i}.json']) for i, words in enumerate(sys.argv[1:])))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *commands], capture_output=True, text=True, env=installed, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return [json.loads((folder / f"{i}.json").read_text())["batteries"]["robot"] for i in range(len(commands))]


def test_all_three_from_another_package(installed: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "digger.yaml").write_text(ROBOT)
    (tmp_path / "dig.yaml").write_text(
        "kind: mission\nname: dig\nrobot: digger.yaml\nsegments:\n  - drive: {distance: 10 m, speed: 0.5 m/s}\n"
    )
    (tmp_path / "logs").mkdir()
    rng = np.random.default_rng(3)
    for number in range(4):
        time = np.arange(300.0)
        speed = np.repeat(rng.choice([0.0, 0.3, 0.6, 1.0], 30), 10)
        wind = np.repeat(rng.uniform(0.0, 8.0, 10), 30)
        power = 20.0 * speed + 8.0 + 1.5 * wind * speed + rng.normal(0.0, 0.1, 300)
        table = np.column_stack([time, power, speed, wind])
        names = "time_s,power_robot_w,speed_m_s,wind_m_s"
        np.savetxt(tmp_path / "logs" / f"run_{number}.csv", table, "%.4f", ",", header=names, comments="")
    run, found, compared = batteries(
        installed, tmp_path, "run dig.yaml", "diagnose --robot digger.yaml logs", "compare --robot digger.yaml logs"
    )
    assert run["energy_wh"] * 3600.0 == pytest.approx(20 * 10 + 8 * 20)
    assert [effect["effect"] for effect in found["effects"]] == ["head_wind"]
    k = found["effects"][0]["parameters"]["k"]
    assert k["low"] < 1.5 < k["high"]
    assert "wind_m_s" in {row["by"] for row in compared["where"]}


def test_a_motion_model_of_the_package_is_one_file() -> None:
    from missionsim.effects import named_models

    here = Path(named_models.__file__).parent
    files = {path.stem.removeprefix("motion_") for path in here.glob("motion_*.yaml")}
    assert set(named_models.motion_model_ids()) == files
    for id in files:
        model = named_models.get_motion_model(id)
        assert model.id == id
        assert model.terms
