"""Tables, files and JSON of a run: cells add up, files are whole, names are the contract's."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from missionsim.cli.app import run_command
from missionsim.engine.simulate import simulate
from missionsim.files import sha256
from missionsim.inputs.loading import load_mission
from missionsim.results import tables, write_results
from missionsim.results.write import largest_consumers

CONTRACT = {
    *("energy_wh", "mean_power_w", "charge_left_wh", "charge_left_fraction", "reserve_wh", "empty_at_s"),
    *("by_component_wh", "by_term_wh", "by_segment_wh", "audit_relative_error"),
}


@pytest.fixture(scope="module")
def patrol(root: Path) -> Path:
    return root / "missions" / "pioneer3dx" / "valve_patrol.yaml"


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def test_cells_of_the_energy_table_add_up(patrol: Path) -> None:
    result = simulate(load_mission(patrol))
    table = tables(result)["energy"]
    for name, battery in result.batteries.items():
        cells = [e for b, e in zip(table["battery"], table["energy_wh"], strict=True) if b == name]
        assert sum(cells) == pytest.approx(battery.energy_wh, rel=1e-12)
    intervals = tables(result)["intervals"]
    spent = sum(p * d for p, d in zip(intervals["power_robot_w"], intervals["duration_s"], strict=True)) / 3600.0
    assert spent == pytest.approx(result.batteries["robot"].energy_wh, rel=1e-12)
    assert {len(column) for column in intervals.values()} == {len(result.timeline)}


def test_largest_consumers_are_in_order(patrol: Path) -> None:
    rows = largest_consumers(simulate(load_mission(patrol)))
    assert [row[1] for row in rows] == ["processor", "motors", "controller"]
    assert rows[0][2] >= rows[1][2] >= rows[2][2]
    assert sum(row[3] for row in rows) < 1.0


@pytest.mark.parametrize("format", ["csv", "parquet"])
def test_files(patrol: Path, tmp_path: Path, format: str) -> None:
    words = ["run", str(patrol), "--out", str(tmp_path), "--format", format, "--quiet"]
    assert run_command([*words, "--set", "robot.batteries.robot.capacity=100 Wh"]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{n}.{format}" for n in ("intervals", "segments", "energy", "summary", "edges")} | {
        "run.json",
        "provenance.json",
    }
    summary = json.loads((tmp_path / "run.json").read_text())
    provenance = json.loads((tmp_path / "provenance.json").read_text())
    assert provenance["files"]["mission"]["sha256"] == sha256(patrol)
    assert provenance["set"] == {"robot.batteries.robot.capacity": "100 Wh"}
    assert provenance["versions"]["simpy"]
    assert summary["batteries"]["robot"]["capacity_wh"] == pytest.approx(100.0)
    if format == "csv":
        energy: list[Any] = read(tmp_path / "energy.csv")
        segments: list[Any] = read(tmp_path / "segments.csv")
    else:
        import pyarrow.parquet

        energy = pyarrow.parquet.read_table(tmp_path / "energy.parquet").to_pylist()
        segments = pyarrow.parquet.read_table(tmp_path / "segments.parquet").to_pylist()
    total = sum(float(row["energy_wh"]) for row in energy if row["battery"] == "laptop")
    assert total == pytest.approx(summary["batteries"]["laptop"]["energy_wh"], rel=1e-12)
    assert [row["segment_name"] for row in segments] == summary["segments"]
    assert float(segments[-1]["charge_robot_wh"]) == pytest.approx(summary["batteries"]["robot"]["charge_left_wh"])
    # at V1 the shortest way home is 31 m long, at the dock nothing is needed
    assert float(segments[1]["home_robot_wh"]) > 0.1
    assert float(segments[-1]["home_robot_wh"]) == 0.0


def test_json_of_the_contract(patrol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", str(patrol), "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "missionsim.run/1"
    assert {"mission", "robot", "feasible", "duration_s", "distance_m", "batteries"} <= data.keys()
    assert (data["mission"], data["robot"], data["feasible"]) == ("valve_patrol", "pioneer3dx", True)
    for battery in data["batteries"].values():
        assert battery.keys() >= CONTRACT
        assert battery["empty_at_s"] is None
        assert sum(battery["by_component_wh"].values()) == pytest.approx(battery["energy_wh"], rel=1e-9)
        assert sum(battery["by_term_wh"].values()) == pytest.approx(battery["energy_wh"], rel=1e-9)
        assert sum(battery["by_segment_wh"]) == pytest.approx(battery["energy_wh"], rel=1e-9)
        assert battery["audit_relative_error"] < 1e-9


def test_infeasible_gives_exit_code_one(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", str(root / "missions/pioneer3dx/infeasible.yaml")]) == 1
    text = capsys.readouterr().out
    assert "NOT feasible" in text
    assert "empty at" in text
    assert "watch_V2" in text
    assert max(len(line) for line in text.splitlines()) <= 100


def test_summary_fits_a_terminal(patrol: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", str(patrol)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines) <= 100
    assert any("Three largest consumers" in line for line in lines)


def test_faults_give_exit_code_two(patrol: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for arguments in (["--set", "defaults.sped=0.3"], ["--set", "nonsense"], ["--robot", "pioner3dx"]):
        assert run_command(["run", str(patrol), *arguments, "--out", str(tmp_path / "no")]) == 2
        assert "error" in capsys.readouterr().err
    assert run_command(["run", "no_such_file.yaml"]) == 2
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("suffix", ["png", pytest.param("svg", marks=pytest.mark.long)])
def test_figures(root: Path, tmp_path: Path, suffix: str) -> None:
    mission = root / "missions" / "pioneer3dx" / "recharging_patrol.yaml"
    assert run_command(["run", str(mission), "--out", str(tmp_path), "--quiet", "--plot", suffix]) == 0
    for name in ("power", "charge", "energy"):
        data = (tmp_path / f"{name}.{suffix}").read_bytes()
        assert data.startswith(b"\x89PNG" if suffix == "png" else b"<?xml")
        assert len(data) > 5_000
    if suffix == "svg":
        import xml.etree.ElementTree as tree

        tree.parse(tmp_path / "power.svg")


def test_python_interface_equals_the_command(patrol: Path, tmp_path: Path) -> None:
    import missionsim

    result = missionsim.simulate(missionsim.load_mission(patrol))
    write_results(result, tmp_path)
    data = json.loads((tmp_path / "run.json").read_text())
    target = tmp_path / "command.json"
    run_command(["run", str(patrol), "--json", str(target), "--quiet"])
    other = json.loads(target.read_text())
    assert data["batteries"] == other["batteries"]
    assert len(missionsim.__all__) <= 20
    for name in missionsim.__all__:
        assert getattr(missionsim, name) is not None


@pytest.mark.parametrize("command", ["diagnose", "add_effect", "improve", "calibrate"])
def test_python_interface_computes_in_one_thread_as_the_command_does(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from threadpoolctl import threadpool_info, threadpool_limits

    from missionsim import interface

    threads: list[set[int]] = []

    def robot_of(*_: object) -> None:
        threads.append({library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"})
        raise KeyError(command)

    for home in ("missionsim.inputs.loading", "missionsim.fit.files", "missionsim.diagnose.diagnosis"):
        monkeypatch.setattr(f"{home}.load_robot", robot_of)
    call = getattr(interface, command)
    words = {"add_effect": ("pioneer3dx", "grade", "logs"), "improve": ("pioneer3dx", "logs")}
    options = {"battery": "robot"} if command in words else {}
    with threadpool_limits(2), pytest.raises(KeyError, match=command):
        call(*words.get(command, ("pioneer3dx", "logs")), **options)
    assert threads == [{1}]


def test_energy_by_control_scheme_adds_up() -> None:
    from missionsim import load_mission, simulate

    root = Path(__file__).resolve().parents[2]
    result = simulate(load_mission(root / "missions/pioneer3dx/valve_patrol.yaml"))
    for name, battery in result.batteries.items():
        schemes = result.by_scheme_wh(name)
        assert {"path_following", "centring_motion", "image_analysis"} <= schemes.keys()
        assert sum(schemes.values()) == pytest.approx(battery.energy_wh, rel=1e-12)
        # two stops of 38 s under image analysis
        assert schemes["image_analysis"] == pytest.approx({"robot": 5.49, "laptop": 14.0}[name] * 76 / 3600, rel=1e-3)
