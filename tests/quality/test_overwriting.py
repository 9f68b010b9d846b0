"""No command writes over what it reads, nor two results into one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import check_targets, read_call, run_command
from missionsim.cli.options import Call
from missionsim.errors import InputError
from missionsim.logs import read_log
from missionsim.logs.blocks import write_log

ROBOT = """kind: robot
name: bot
body: {drive: differential, max_speed: 1.2 m/s, mass: 30 kg}
batteries:
  main: {capacity: 288 Wh}
motion: {battery: main, model: expression, power: c2*v + c4, parameters: {c2: 4, c4: 8}}
schemes:
  drive: {sensors: {required: {}}}
"""
MISSION = """kind: mission
name: errand
robot: bot.yaml  # as in other.yaml
defaults: {speed: 0.8 m/s, scheme: drive}
segments:
  - drive: {distance: 40 m}
"""


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a robot, a mission and a study that name it, a map, logs and links."""
    monkeypatch.chdir(tmp_path)
    Path("bot.yaml").write_text(ROBOT)
    Path("errand.yaml").write_text(MISSION)
    Path("study.yaml").write_text("kind: study\nname: s\nmission: errand.yaml\nvary: {defaults.speed: [0.5]}\n")
    Path("map.yaml").write_text("kind: map\ncolumns: {time_s: time_s, power_main_w: power_main_w}\n")
    Path("logs").mkdir()
    for run in (1, 2):
        time = np.arange(30.0)
        lines = [f"{t},{10 + run + np.sin(t):.3f},{0.5 + 0.1 * np.cos(t):.3f}" for t in time]
        Path(f"logs/r{run}.csv").write_text("time_s,power_main_w,speed_m_s\n" + "\n".join(lines) + "\n")
    Path("logs/notes.json").write_text("{}")
    Path("link.yaml").symlink_to("bot.yaml")
    Path("folder").symlink_to("logs")
    return tmp_path


def call_of(words: list[str]) -> Call:
    call = read_call(words)
    assert call is not None
    return call


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("compare --robot bot.yaml logs --json bot.yaml", "--json would overwrite an input of this command"),
        ("compare --robot=bot.yaml logs --json=./logs/../bot.yaml", "--json would overwrite an input"),
        ("compare --robot bot.yaml logs --json link.yaml", "--json would overwrite an input"),
        ("compare --robot link.yaml logs --report bot.yaml", "--report is a page"),
        ("compare --robot bot.yaml logs --mission errand.yaml --json errand.yaml", "--json would overwrite an input"),
        ("compare --robot bot.yaml logs --out folder", "--out is a folder of logs"),
        ("compare --robot bot.yaml logs --report x.html --json x.html", "--report and --json are the same path"),
        ("compare --robot bot.yaml logs --json new/../x.html --report x.html", "--report and --json are the same path"),
        ("compare --robot bot.yaml logs --json x --out x", "--out and --json are the same path"),
        ("diagnose --robot bot.yaml logs --json logs/r2.csv", "--json would overwrite an input of this command, which"),
        ("diagnose --robot bot.yaml logs/r1.csv --holdout logs/r2.csv --json folder/r2.csv", "--json would overwrite"),
        # where root has every right and no file can be made: told before a page is written
        (
            "compare --robot bot.yaml logs --report x.html --json /proc/x.json",
            "--json lies in a folder that may not be",
        ),
        (
            "calibrate logs --new x --base k*v --out new.yaml --json /proc/new/x.json",
            "--json lies in a folder that may",
        ),
        ("run errand.yaml --json x.json --out /proc", "--out is a folder that may not be written to"),
        ("calibrate logs --new x --base k*v --out logs/r1.csv", "--out is a robot file"),
        ("calibrate logs --new x --base k*v --out new.yml.txt", "--out is a robot file"),
        ("calibrate logs --robot bot.yaml --out bot.yaml", "--out would overwrite an input"),
        ("add-effect --robot bot.yaml --effect grade logs --out=link.yaml", "--out would overwrite an input"),
        ("add-effect --robot bot.yaml --effect grade logs --out new.yaml --json new.yaml", "--out and --json are"),
        ("improve --robot bot.yaml logs --yes --out bot.yaml", "--out would overwrite an input"),
        ("improve --robot bot.yaml logs --yes --out improved.parquet", "--out is a robot file"),
        ("run errand.yaml --json errand.yaml", "--json would overwrite an input"),
        ("run errand.yaml --json bot.yaml", "--json would overwrite an input of this command, which errand.yaml names"),
        ("run errand.yaml --set robot=link.yaml --json bot.yaml", "--json would overwrite an input"),
        ("whatif --study study.yaml --out bot.yaml", "--out is a table"),
        ("montecarlo errand.yaml --runs 5 --json errand.yaml", "--json would overwrite an input"),
        ("validate bot.yaml logs --json bot.yaml", "--json would overwrite an input"),
        ("import logs/r1.csv --map map.yaml --out logs/r1.csv", "--out would overwrite an input"),
        ("import logs --map map.yaml --out logs/r2.csv", "--out would overwrite an input"),
        ("import logs/r1.csv --map map.yaml --out new.csv --json map.yaml", "--json would overwrite an input"),
    ],
)
def test_an_input_or_another_output_is_not_written_over(
    world: Path, capsys: pytest.CaptureFixture[str], command: str, told: str
) -> None:
    before = contents(world)
    assert run_command(command.split()) == 2
    out, err = capsys.readouterr()
    assert told in err
    assert err.count("error:") == 1
    assert not out
    assert contents(world) == before


@pytest.mark.parametrize(
    "command",
    [
        "compare --robot bot.yaml logs --json logs/notes.json --report a.html --out tables",
        "compare --robot bot.yaml logs/r1.csv --json - --report /dev/null",
        "run errand.yaml --json other.yaml",
        "run errand.yaml --json table.csv",
        "run errand.yaml --out . --json run_again.json",
        "improve --robot bot.yaml logs --yes --out other.yaml --json /dev/null --report /dev/null",
        "calibrate logs --new other --base k*v --out /dev/null",
        "import logs/r1.csv --map map.yaml --out logs/r1.parquet",
        "import logs --map map.yaml --out logs",
    ],
)
def test_what_is_no_input_may_be_written_over(world: Path, command: str) -> None:
    for name in ("other.yaml", "table.csv"):
        (world / name).write_text("")
    check_targets(call_of(command.split()))


def test_parquet_logs_are_not_imported_into_themselves(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (world / "binary").mkdir()
    write_log(read_log("logs/r1.csv"), world / "binary" / "r1.parquet")
    before = contents(world)
    assert run_command(["import", "binary", "--map", "map.yaml", "--out", "binary"]) == 2
    assert "--out would overwrite a file that is imported" in capsys.readouterr().err
    assert contents(world) == before


def test_all_clashes_are_told_at_once(world: Path) -> None:
    with pytest.raises(InputError) as caught:
        check_targets(call_of(["compare", "--robot", "bot.yaml", "logs", "--json", "bot.yaml", "--out", "logs"]))
    assert len(caught.value.faults) == 2


@pytest.mark.parametrize("command", ["compare", "diagnose", "calibrate"])
def test_commands_tell_of_copies(world: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    (world / "logs" / "r3.csv").write_bytes((world / "logs" / "r1.csv").read_bytes())
    more = ["--new", "x", "--base", "k*v", "--out", "x.yaml"] if command == "calibrate" else ["--robot", "bot.yaml"]
    run_command([command, "logs", *more])
    told = "".join(capsys.readouterr())
    assert "given under several names" in told
    assert "r3.csv" in told.replace("\n", "")
