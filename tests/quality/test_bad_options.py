"""Values and names of options that cannot be meant: one clear message and exit code 2, before any long work."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from missionsim import load_mission, simulate
from missionsim.cli.app import run_command

MISSION = "missions/pioneer3dx/valve_patrol.yaml"
SITES = "docs/examples/sites"
LOGS = "docs/examples/ramp_runs"


@pytest.fixture(autouse=True)
def at_root(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root)


def told_by(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a refused command says; nothing else may be said, nor anything on standard output."""
    assert run_command(words) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.count("error:") == 1
    assert "warning" not in err
    return err


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("add-effect --robot pioneer3dx --effect grad LOGS --out x.yaml", "did you mean: grade"),
        ("add-effect --robot pioneer3dx --effect component_power:kinct LOGS --out x.yaml", "component_power:kinect"),
        ("add-effect --robot pioneer3dx --formula 'k*(' LOGS --out x.yaml", "--formula: error: formula cannot be read"),
        ("add-effect --robot pioneer3dx --formula k**v LOGS --out x.yaml", "not proportional to k"),
        ("add-effect --robot pioneer3dx --formula k*exp(k*v) LOGS --out x.yaml", "not proportional to k"),
        ("add-effect --robot pioneer3dx --formula k*k*v LOGS --out x.yaml", "not proportional to k"),
        ("add-effect --robot pioneer3dx --formula k*v+3 LOGS --out x.yaml", "not proportional to k"),
        ("improve --robot pioneer3dx LOGS --yes --without grad --out x.yaml", "did you mean: grade"),
        ("calibrate --new x --base 0 LOGS --out x.yaml", "no parameter that could be fitted"),
        ("calibrate --new x --base v LOGS --out x.yaml", "no parameter that could be fitted"),
        ("calibrate --new x --base nan LOGS --out x.yaml", "no number that a formula can hold"),
        ("calibrate --new x --base '-k*v' LOGS --out x.yaml", "--base='-k*v'"),
        ("montecarlo MISSION --runs 1.5", "--runs takes a whole number"),
        ("montecarlo MISSION --seed=0.5", "--seed takes a whole number"),
        ("whatif MISSION --vary defaults.speed=0.3,0.4 --workers 1.5", "--workers takes a whole number"),
        ("whatif MISSION --vary defaults.speed=0.3,0.4 --montecarlo 99999999999999", "2 to 1000000000"),
        ("whatif MISSION --vary segments.0.speed=0.3 --vary segments.0.speed=0.5", "varied more than once"),
        ("run MISSION --set robot.batteries.lptop.capacity=3", "did you mean: laptop"),
        ("run MISSION --set components.kinct.units=2", "did you mean: kinect"),
        ("run MISSION --set body={max_sped:\\ 1,drive:\\ differential}", "did you mean: max_speed"),
        ("run MISSION --set segments.0.speed={valu:\\ 1}", "did you mean: value"),
        (
            "reach environments/trial_site.yaml --robot pioneer3dx --from hall --set ambient.x=1",
            "command line: error: unk",
        ),
        ("export vda5050 MISSION --out x.json --timestamp yesterday", "time stamp"),
        ("export vda5050 MISSION --out x.json --timestamp 2026-13-01T00:00:00.000Z", "time stamp"),
        ("export nav2 SITES/yard.geojson --robot pioneer3dx --out x.geojson --speed nan", "--speed cannot be used so"),
        (
            "export rmf SITES/cart_config.yaml --robot pioneer3dx --out SITES/cart_config.yaml",
            "would overwrite an input",
        ),
        ("import-robot SITES/cart_config.yaml --battery a:b", "--battery is not a name"),
        ("import-robot SITES/cart_config.yaml --out x.txt", "--out is a robot file"),
        ("import-site SITES/hill.gpx --graph 1", "--graph is for Open-RMF files"),
        ("import-site SITES/lab.json --smooth 3", "--smooth is for GPX files"),
        ("import-site SITES/two_floors.building.yaml --graph 77", "no lane is of graph 77"),
        ("diagnose --robot pioneer3dx LOGS --report MISSION", "--report is a page"),
        ("compare --robot pioneer3dx LOGS --mcap MISSION", "--mcap is a recording"),
        ("plan missions/planning/inspection.yaml --report x.yaml", "--report is a page"),
        ("whatif MISSION --vary defaults.speed=0.3 --out x.xlsx", "--out is a table"),
    ],
)
def test_one_message(capsys: pytest.CaptureFixture[str], command: str, told: str) -> None:
    for short, long in (("MISSION", MISSION), ("SITES", SITES), ("LOGS", LOGS)):
        command = command.replace(short, long)
    assert told in told_by(capsys, *shlex.split(command))


def test_options_of_the_format_are_taken(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["two_floors.building.yaml", "--graph", "1"], ["hill.gpx", "--smooth", "20"]):
        assert run_command(["import-site", f"{SITES}/{words[0]}", *words[1:], "--quiet"]) == 0


def test_a_battery_without_a_load_gives_nothing() -> None:
    result = simulate(load_mission(MISSION, [("robot.batteries.spare.capacity", "3 Wh")]))
    assert {edge.energy_wh["spare"] for edge in result.edges_driven()} == {0.0}


def test_a_formula_that_gives_no_number_somewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{t},{10 + np.sin(t):.3f},{max(0.0, np.sin(0.2 * t)):.3f}" for t in range(200)]
    (tmp_path / "run.csv").write_text("time_s,power_robot_w,speed_m_s\n" + "\n".join(rows) + "\n")
    out = tmp_path / "x.yaml"
    words = [
        "--robot",
        "pioneer3dx",
        "--formula",
        "k * log(v)",
        str(tmp_path / "run.csv"),
        "--force",
        "--out",
        str(out),
    ]
    assert run_command(["add-effect", *words]) == 2
    err = capsys.readouterr().err
    assert "--formula: error: 'law_v' gives no number in" in err
    assert not out.exists()


def test_a_candidate_is_proportional_to_its_first_parameter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = Path("missionsim/robots/pioneer3dx.yaml").read_text()
    for power, code in (("k**speed_m_s", 2), ("k * speed_m_s**p", 0)):
        (tmp_path / "bot.yaml").write_text(
            f"{text}\neffects:\n  - {{name: own, battery: robot, candidate: true, power: {power}, parameters: "
            + ("{k: 1}}\n" if code else "{k: 1, p: 2}}\n")
        )
        assert run_command(["validate", str(tmp_path / "bot.yaml"), "--quiet"]) == code
    assert "not proportional to 'k'" in capsys.readouterr().err


def test_a_folder_that_begins_with_a_tilde(tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["montecarlo", str(root / MISSION), "--runs", "5", "--sobol", "0", "--quiet", "--out", "~/batch"]
    assert run_command(words) == 0
    assert list(Path("~/batch").glob("blocks/*.parquet"))
