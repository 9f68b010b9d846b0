"""`missionsim validate`, `schema` and `robots` as a user calls them."""

from __future__ import annotations

import inspect
import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from missionsim.cli.app import COMMANDS, EXIT_PIPE, plain_call, read_call, run_command, spelled_out


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
    kinds = ("robot", "environment", "mission", "study", "map", "task")
    assert names == sorted(f"{kind}.schema.json" for kind in kinds)
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


def test_one_effect_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["effects", "show", "component_warmup:kinect"]) == 0
    shown = capsys.readouterr().out
    for part in ("component_warmup:kinect", "power", "needs   on_kinect", "source", "parameters", "tau"):
        assert part in shown
    assert max(map(len, shown.splitlines())) <= 100
    assert run_command(["effects", "show", "grad"]) == 2
    assert "did you mean: grade" in capsys.readouterr().err


PATROL = "missions/pioneer3dx/valve_patrol.yaml"


@pytest.mark.parametrize(
    "words",
    [
        ["validate", PATROL, "missions/khepera3"],
        ["validate", PATROL, "--json", "-", "--quiet"],
        ["validate", "nowhere.yaml"],
        ["run", PATROL],
        ["run", "--set", "defaults.speed=0.3", PATROL, "--set=defaults.payload=2 kg", "--json", "-"],
        ["run", "--quiet", "missions/pioneer3dx/infeasible.yaml"],
        ["run", PATROL, "--out", "{out}", "--format=parquet", "--quiet"],
    ],
)
def test_plain_calls_are_read_as_the_parser_reads_them(
    words: list[str], root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(root)
    told = []
    for number in range(2):
        call = read_call([word.format(out=tmp_path / str(number)) for word in words], plain=number == 0)
        assert call is not None
        code = call.function(*call.arguments, **call.options)
        told.append((code, *capsys.readouterr(), sorted(path.name for path in (tmp_path / str(number)).glob("*"))))
    assert told[0] == told[1]


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["run"],
        ["--help"],
        ["run", "--help"],
        ["run", PATROL, "--plot"],
        ["run", PATROL, "--format", "xls"],
        ["run", PATROL, PATROL],
        ["run", PATROL, "--sat", "a=1"],
        ["run", PATROL, "--out"],
        ["run", PATROL, "--set", "-x=1"],
        ["run", PATROL, "--json", "a", "--json", "b"],
        ["validate", "--quiet"],
        ["effects", "--json", "-"],
        ["run", "--mission", PATROL],
        ["validate", PATROL, "-h"],
        ["diagnose", "logs"],
        ["diagnose", "logs", "--battery", "robot"],
        ["improve", "logs", "--robot", "pioneer3dx"],
        ["compare", "logs", "--robot", "pioneer3dx", "--tolerance", "1"],
    ],
)
def test_what_is_not_plain_is_left_to_the_parser(words: list[str]) -> None:
    assert not words or words[0] not in COMMANDS or plain_call(words[1:], COMMANDS[words[0]][0]) is None


@pytest.mark.parametrize(
    "line",
    [
        "diagnose --robot pioneer3dx logs more --holdout a,b --holdout=c --no-align --report page.html",
        "add-effect --robot=pioneer3dx logs --effect grade --out a.yaml --force --battery robot",
        "improve logs --yes --robot pioneer3dx --out improved.yaml --without grade --without payload --json -",
        "compare logs --robot pioneer3dx --mission m.yaml --out there",
        "calibrate --new cart --base c1*v+c0 logs --out cart.yaml --mass '20 kg'",
        "plan task.yaml --set within.reserve=30 --robot pioneer3dx --pareto --out made.yaml",
        "reach site.yaml --robot pioneer3dx --from hall --json -",
        "import bag --map map.yaml --out logs --quiet",
    ],
)
def test_a_plain_call_is_that_of_the_parser(line: str) -> None:
    words = shlex.split(line)
    plain, whole = plain_call(words[1:], COMMANDS[words[0]][0]), read_call(words, plain=False)
    assert plain is not None
    assert whole is not None
    assert plain.function is whole.function
    bound = [inspect.signature(one.function).bind(*one.arguments, **one.options) for one in (plain, whole)]
    for one in bound:
        one.apply_defaults()
    assert bound[0].arguments == bound[1].arguments


@pytest.mark.parametrize(
    ("words", "spelled"),
    [
        ("run --plot m.yaml", "run --plot=png m.yaml"),
        ("run --plot svg png m.yaml --quiet", "run --plot=svg --plot=png m.yaml --quiet"),
        ("run m.yaml --plot --out x", "run m.yaml --plot=png --out x"),
        ("run m.yaml --plot", "run m.yaml --plot=png"),
        ("run m.yaml --plot=svg", "run m.yaml --plot=svg"),
        ("montecarlo --plot m.yaml", "montecarlo --plot m.yaml"),
        ("robots --json - --quiet", "robots --json=- --quiet"),
    ],
)
def test_plot_may_stand_before_the_mission(words: str, spelled: str) -> None:
    assert spelled_out(words.split()) == spelled.split()


@pytest.mark.parametrize("words", [["run", PATROL], ["run", PATROL, "--json", "-"], ["--help"]])
def test_a_reader_that_goes_away_is_no_fault(words: list[str], root: Path) -> None:
    command = [sys.executable, "-c", "from missionsim.cli import main; main()", *words]
    with subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == EXIT_PIPE
