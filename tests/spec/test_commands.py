"""`missionsim validate`, `schema` and `robots` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from missionsim.cli.app import run_command


def test_validate_everything_shipped(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [str(root / name) for name in ("missions", "environments", "missionsim/robots")]
    assert run_command(["validate", *folders]) == 0
    out, err = capsys.readouterr()
    assert out.endswith("files: valid\n")
    assert err == ""


def test_validate_tells_yaml_and_logs_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text("kind: robto\n", encoding="utf-8")
    (tmp_path / "bad.csv").write_text("time_s,speed_m_s\n0,1\n1,1\n", encoding="utf-8")
    assert run_command(["validate", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert "bad.yaml:1:7: error: not the kind of file that is needed here" in err
    assert "did you mean: robot" in err
    assert "bad.csv" in err
    assert "2 files:" in out


def test_validate_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("kind: environment\nname: e\nplaces: {A: {x: 1}}\n", encoding="utf-8")
    assert run_command(["validate", str(path), "--json", "-"]) == 2
    out, err = capsys.readouterr()
    data = json.loads(out)
    assert err == ""
    assert (data["valid"], data["files"]) == (False, 1)
    fault = data["faults"][0]
    assert (fault["line"], fault["column"], fault["path"]) == (3, 13, "places.A")


def test_validate_without_files_and_with_an_empty_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["validate"]) == 2
    assert run_command(["validate", str(tmp_path)]) == 2
    assert "no YAML file or log in this folder" in capsys.readouterr().err


def test_a_warning_is_no_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "r.yaml"
    path.write_text(
        "kind: robot\nname: r\nbody: {drive: omni, max_speed: 1}\nbatteries: {b: {capacity: 1, reserve: 1}}\n",
        encoding="utf-8",
    )
    assert run_command(["validate", str(path)]) == 0
    out, err = capsys.readouterr()
    assert ": warning: starts at or below its reserve" in err
    assert out == "1 file: 0 errors, 1 warning\n"


def test_schema_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["schema", "--out", str(tmp_path / "new"), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == sorted(f"{kind}.schema.json" for kind in ("robot", "environment", "mission", "study", "map"))
    assert run_command(["schema", "robot"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "missionsim robot file"
    assert run_command(["schema", "robt"]) == 2
    assert "did you mean: robot" in capsys.readouterr().err


def test_robots(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["robots", "--json", "-"]) == 0
    robots = {robot["name"]: robot for robot in json.loads(capsys.readouterr().out)["robots"]}
    assert set(robots) >= {"pioneer3dx", "khepera3", "mecanum4", "rover_tx2"}
    pioneer = robots["pioneer3dx"]
    assert list(pioneer["batteries"]) == ["robot", "laptop"]
    switched = [name for name, item in pioneer["components"].items() if not item["always_on"]]
    assert sorted(switched) == ["kinect", "laser", "screen", "sonar"]
    assert pioneer["components"]["laser"]["units"] == 2
    assert run_command(["robots"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 100
