"""A load that remembers how the robot drove: found, written, simulated. The world here is NumPy alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from missionsim.cli.app import run_command
from missionsim.diagnose.diagnosis import judged
from missionsim.diagnose.examine import Subject, examine
from missionsim.diagnose.split import choose_split
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import load_robot
from missionsim.logs import read_logs

from .study import diagnose
from .world import make

ROBOT = """kind: robot
name: rover
body: {mass: 20 kg, drive: skid_steer, max_speed: 1.5 m/s, max_acceleration: 0.5 m/s^2, max_deceleration: 0.5 m/s^2}
batteries: {main: {capacity: 100 Wh, nominal_voltage: 24 V}}
motion: {battery: main, model: polynomial, parameters: {c2: 12, c3: 30, c4: 9, standing: 9}}
schemes: {follow: {}}
"""
STEP_S = 0.02


def write_world(folder: Path, load: str, tau_s: float, size: float) -> None:
    """Six drives to learn from and two others: a fan that runs on, or heat that follows the processor."""
    rng = np.random.default_rng(5)
    for number in range(8):
        asked = np.repeat(rng.choice([0.0, 0.0, 0.3, 0.6, 0.9, 1.2], size=14), round(20 / STEP_S))
        busy = np.repeat(rng.choice([0.1, 0.4, 0.8, 1.0], size=19), round(15 / STEP_S))[: len(asked)]
        speed, heat = np.zeros(len(asked)), np.zeros(len(asked))
        heat[0] = busy[0] if load == "processor" else 0.0
        for i in range(1, len(asked)):
            speed[i] = speed[i - 1] + min(max(asked[i] - speed[i - 1], -0.5 * STEP_S), 0.5 * STEP_S)
            cause = busy[i - 1] if load == "processor" else 0.5 * (speed[i] + speed[i - 1])
            heat[i] = heat[i - 1] + STEP_S / tau_s * (cause - heat[i - 1])
        power = 12.0 * speed**2 + 30.0 * speed + 9.0
        power += size * (np.maximum(heat - speed, 0.0) if load == "fan" else heat)
        seconds = round(1.0 / STEP_S)
        watts, means, loads = (x.reshape(-1, seconds).mean(axis=1) for x in (power, speed, busy))
        noise = np.zeros(len(watts))
        for i in range(1, len(noise)):
            noise[i] = 0.7 * noise[i - 1] + rng.normal(0.0, 0.15)
        into = folder / ("train" if number < 6 else "later")
        into.mkdir(exist_ok=True)
        table = np.column_stack([np.arange(len(watts)) + 0.5, watts + noise, means, loads])
        header = "time_s,power_main_w,speed_m_s,cpu_load"
        np.savetxt(into / f"run_{number}.csv", table, "%.5f", ",", header=header, comments="")


def form_of(load: str, formula: str) -> bool:
    """Whether that is the load's law, with a time constant near its own."""
    lags = {"fan": ("k * max(lag(abs(speed_m_s), ", ") - abs(speed_m_s), 0)"), "processor": ("k * lag(cpu_load, ", ")")}
    before, after = lags[load]
    tau_s = float(formula.removeprefix(before).removesuffix(after))
    return tau_s == pytest.approx({"fan": 20.0, "processor": 25.0}[load], rel=0.2)


@pytest.mark.long
def test_a_fan_that_runs_on_is_a_law_with_a_lag(tmp_path: Path) -> None:
    """That such a law is written and simulated is decided by heat, below."""
    (tmp_path / "rover.yaml").write_text(ROBOT)
    write_world(tmp_path, "fan", 20.0, 14.0)
    split = choose_split(read_logs([tmp_path / "train"]))
    (law,) = judged(examine(Subject.of(load_robot(tmp_path / "rover.yaml")), split, "main", Settings())).proposed
    assert form_of("fan", law.first.formula)
    assert law.first.k == pytest.approx(14.0, rel=0.15)


def test_a_load_with_a_memory_is_found_written_and_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rover.yaml").write_text(ROBOT)
    write_world(tmp_path, "processor", 25.0, 6.0)
    asked = ["improve", "--robot", "rover.yaml", "train", "--holdout", "later", "--yes", "--out", "better.yaml"]
    assert run_command([*asked, "--json", "found.json", "--quiet"]) == 0
    (effect,) = yaml.safe_load(Path("better.yaml").read_text())["effects"]
    assert form_of("processor", effect["power"])
    assert effect["parameters"]["k"]["value"] == pytest.approx(6.0, rel=0.15)
    Path("drive.yaml").write_text(
        "kind: mission\nname: there\nrobot: better.yaml\ndefaults: {scheme: follow, speed: 0.9 m/s, cpu_load: 0.4}\n"
        "segments: [{wait: {duration: 20 s}}, {drive: {distance: 60 m}}, {wait: {duration: 2 min}}]\n"
    )
    assert run_command(["validate", "better.yaml", "drive.yaml", "--quiet"]) == 0
    assert run_command(["run", "drive.yaml", "--json", "run.json", "--quiet"]) == 0
    assert f'"{effect["name"]}"' in Path("run.json").read_text()
    errors = {}
    for name in ("rover.yaml", "better.yaml"):
        assert run_command(["compare", "--robot", name, "later", "--json", "compared.json", "--quiet"]) == 0
        errors[name] = json.loads(Path("compared.json").read_text())["batteries"]["main"]["power_rmse_w"]
    assert errors["better.yaml"] < 0.25 * errors["rover.yaml"]
    # the law that diagnose proposes, with the size and the error that it promises
    (promised,) = json.loads(Path("found.json").read_text())["batteries"]["main"]["first"]["proposed_laws"]
    assert promised["forms"][0]["formula"] == effect["power"]
    k = promised["forms"][0]["parameters"]["k"]["value"]
    assert k == pytest.approx(effect["parameters"]["k"]["value"], rel=0.01)
    assert promised["heldout_rmse_w"]["after"] == pytest.approx(errors["better.yaml"], rel=1e-4)


@pytest.mark.long
def test_what_a_form_without_memory_explains_is_no_lag(tmp_path: Path) -> None:
    # standing with a load looks like slowing down long ago; each law's own noise made its left-out errors its own too
    report, _ = diagnose(*make("rest_payload", 3, runs=5, heldout=1, duration_s=150.0).write(tmp_path))
    first = report["proposed_laws"][0]["forms"][0]
    assert first["formula"] == "k * (1 - (abs(speed_m_s) >= 0.005 or abs(yaw_rate_rad_s) >= 0.02)) * payload_kg"


@pytest.mark.long
def test_watts_of_one_of_several_like_loads_are_a_law(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three arms draw alike and one of them is logged: no converter has that factor, and yet the column explains it."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    for number in range(8):
        speed = np.repeat(rng.choice([0.0, 0.3, 0.6, 0.9, 1.2], size=20), 20)
        arm = np.repeat(rng.choice([0.0, 20.0, 40.0], size=25), 16) * rng.uniform(0.9, 1.1, 400)
        noise = np.zeros(400)
        for i in range(1, 400):
            noise[i] = 0.7 * noise[i - 1] + rng.normal(0.0, 0.15)
        table = np.column_stack([np.arange(400) + 0.5, 12 * speed**2 + 30 * speed + 9 + 3 * arm + noise, speed, arm])
        into = Path("train" if number < 6 else "later")
        into.mkdir(exist_ok=True)
        np.savetxt(
            into / f"{number}.csv", table, "%.4f", ",", header="time_s,power_main_w,speed_m_s,arm_w", comments=""
        )
    base = ["calibrate", "--new", "rover", "--base", "k1*v + k0", "--mass", "20 kg", "train", "--quiet"]
    assert run_command([*base, "--out", "rover.yaml"]) == 0
    assert run_command(["diagnose", "--robot", "rover.yaml", "train", "--holdout", "later", "--json", "seen.json"]) == 0
    seen = json.loads(Path("seen.json").read_text())["batteries"]["main"]
    named = {one["effect"]: one for one in seen["candidates"]}
    assert "of its column" in named["logged_power:arm_w"]["reason"]
    assert "logged_power:arm_w" not in capsys.readouterr().out.partition("NOT SEEN")[2]
    (law,) = seen["proposed_laws"]
    assert law["forms"][0]["formula"] == "k * arm_w"
    assert law["forms"][0]["parameters"]["k"]["value"] == pytest.approx(3.0, rel=0.03)
