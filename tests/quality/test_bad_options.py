"""Values and names of options that cannot be meant: one clear message and exit code 2, before any long work."""

from __future__ import annotations

import shlex
import subprocess
import sys
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
        ("calibrate --robot pioneer3dx --mass 3 LOGS --out x.yaml", "--mass belongs to --new"),
        ("schema robot mission", "several schemas need --out"),
        ("montecarlo MISSION --runs 1.5", "--runs takes a whole number"),
        ("montecarlo MISSION --seed=0.5", "--seed takes a whole number"),
        ("whatif MISSION --vary defaults.speed=0.3,0.4 --workers 1.5", "--workers takes a whole number"),
        ("whatif MISSION --vary defaults.speed=0.3,0.4 --montecarlo 99999999999999", "2 to 1000000000"),
        ("whatif MISSION --vary segments.0.speed=0.3 --vary segments.0.speed=0.5", "varied more than once"),
        ("run MISSION --set robot.batteries.lptop.capacity=3", "did you mean: laptop"),
        ("run MISSION --set components.kinct.units=2", "did you mean: kinect"),
        ("run MISSION --set body={max_sped:\\ 1,drive:\\ differential}", "did you mean: max_speed"),
        ("run MISSION --set segments.0.speed={valu:\\ 1}", "did you mean: value"),
        ("run MISSION --set defaults.speed=0.2 --set defaults.speed=0.3", "got: 0.2 and 0.3"),
        ("whatif MISSION --vary defaults.speed=0.3 --set body.mass=9 --set robot.body.mass=8", "set more than once"),
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


MAP = "kind: map\nname: m\ncolumns: {time_s: time_s, power_robot_w: power_robot_w}\n"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("caps.csv", "TIME_S,POWER_ROBOT_W\n0,1\n1,2\n2,3\n", "did you mean: TIME_S"),
        ("header.csv", "time_s,power_robot_w\n", "no run of two rows or more"),
        ("backwards.csv", "time_s,power_robot_w\n3,1\n2,2\n1,3\n", "no run of two rows or more"),
        ("share.csv", "time_s,power_robot_w\n0,50 %\n1,40 %\n2,30 %\n", "this column holds text"),
        ("speed.csv", "time_s,power_robot_w\n0,5 m/s\n1,4 m/s\n2,3 m/s\n", "this column holds text"),
        ("run.csv.gz", b"\x1f\x8b\x08\0", "this is packed (gzip)"),
        ("run.zip", b"PK\x03\x04\0\0", "this is packed (zip)"),
        ("run.xlsx", b"PK\x03\x04" + 26 * b"\0" + b"xl/workbook.xml", "this is a spreadsheet"),
    ],
)
def test_tables_that_a_map_cannot_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: str | bytes, told: str
) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    words = ["--map", str(tmp_path / "map.yaml"), "--out", str(tmp_path / "log.csv")]
    assert run_command(["import", str(tmp_path / name), *words]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "log.csv").exists()


@pytest.mark.filterwarnings("error")
def test_cells_and_times_that_only_look_like_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = ["12.5"] * 40
    cells[7:9] = ["1_000", "١٢"]
    rows = [f"{'inf' if i == 20 else i},{cell}" for i, cell in enumerate(cells)]
    # text, whatever its name says: Arrow would unpack it
    (tmp_path / "run.csv.gz").write_text("time_s,power_robot_w\n" + "\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "map.yaml").write_text(MAP)
    out = tmp_path / "log.csv"
    assert (
        run_command(["import", str(tmp_path / "run.csv.gz"), "--map", str(tmp_path / "map.yaml"), "--out", str(out)])
        == 0
    )
    said = " ".join(capsys.readouterr().out.split())
    assert "2 of 40 cells are not numbers, first '1_000' (line 9)" in said
    assert "1 row without a time" in said
    assert "inf s" not in said
    assert {line.split(",")[1] for line in out.read_text().splitlines()[1:]} == {"12.5"}
    assert run_command(["compare", "--robot", "pioneer3dx", str(tmp_path / "run.csv.gz")]) == 2
    assert capsys.readouterr().err.count("this is not a number") == 2


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("cell", ['"1,0{i:02d}.5"', "nan"])
def test_a_power_without_a_number_is_not_suggested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cell: str
) -> None:
    rows = [f"{i},{cell.format(i=i)}" for i in range(60)]
    (tmp_path / "run.csv").write_text("time_s,power_robot_w\n" + "\n".join(rows) + "\n")
    assert run_command(["import", str(tmp_path / "run.csv"), "--suggest", "--out", str(tmp_path / "map.yaml")]) == 1
    assert "no column looks like power" in "".join(capsys.readouterr())


def test_a_new_robot_that_can_less_than_its_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["calibrate", "--new", "x", "--base", "c3*v + c4", f"{LOGS}/run_00.csv", "--out", str(tmp_path / "x.yaml")]
    assert run_command([*words, "--max-speed", "0.1 m/s", "--capacity", "0.01 Wh"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the top speed, 0.1 m/s, is below the 0.7" in said
    assert "the capacity, 0.01 Wh, is less than the 1.4" in said
    assert run_command([*words, "--mass", "0"]) == 2
    assert "more than 0 kg" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "code", "told"), [((), 0, ""), (("--json", "-"), 2, "standard output is closed")])
def test_a_closed_standard_output(words: tuple[str, ...], code: int, told: str) -> None:
    line = [sys.executable, "-m", "missionsim", "run", MISSION, *words]
    done = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *line], capture_output=True, text=True)
    assert done.returncode == code
    assert told in done.stderr
    assert not done.stdout


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("alternatives: {a: {set: {defaults.sped: 0.3}}}", "study.yaml: error: unknown key 'sped'"),
        ("alternatives: {baseline: {set: {}}}", "study.yaml:4:26: error: 'baseline' is what alternatives differ from"),
    ],
)
def test_faults_of_a_study_name_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str, told: str) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(f"kind: study\nname: s\nmission: {Path(MISSION).resolve()}\n{more}\n")
    assert told in told_by(capsys, "whatif", "--study", str(path))


def test_a_log_of_many_faults_is_left_out_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.csv").write_text("time_s,power_robot_w\n" + "".join(f"{i},fast\n" for i in range(30)))
    (tmp_path / "empty.parquet").write_bytes(b"")
    assert run_command(["compare", "--robot", "pioneer3dx", f"{LOGS}/run_00.csv", str(tmp_path)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("LEFT OUT")]
    assert [line.partition(":")[0] for line in lines] == ["LEFT OUT bad", "LEFT OUT empty"]
    assert lines[0].endswith("this is not a number (line 2), and 20 faults more")
    assert "line 0" not in lines[1]
