"""Input that once made a command hang, warn, crash or answer nonsense: each gets one message and exit code 2."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.errors import Fault, InputError
from missionsim.expressions import compile_expression
from missionsim.files import write_text
from missionsim.labels import Labels

ROBOT = """kind: robot
name: bot
body: {drive: differential, max_speed: 1.2 m/s, mass: 30 kg}
batteries:
  main: {capacity: 288 Wh}
motion: {battery: main, model: polynomial, parameters: {c2: 4, c3: 12, c4: 8, standing: 6}}
components:
  lidar: {loads: [{battery: main, power: 8 W}]}
schemes:
  drive: {sensors: {required: {lidar: 1}}}
"""
MISSION = """kind: mission
name: errand
robot: bot.yaml
defaults: {speed: 0.8 m/s, scheme: drive}
segments:
  - drive: {distance: 40 m}
  - wait: {duration: 2 min}
activities:
  - {component: lidar, every: 60 s, duration: 2 s}
"""
CIRCUIT = """main:
    capacity: 12 Ah
    nominal_voltage: 24 V
    model: {kind: equivalent_circuit, open_circuit_voltage: [[0, 22 V], [1, 26 V]], resistance: 30 mohm}
effects: [{name: own, battery: main, power: k / (speed_m_s - speed_m_s), parameters: {k: 1}}]"""
MOTION = "model: polynomial, parameters: {c2: 4, c3: 12, c4: 8, standing: 6}"


def run_with(folder: Path, robot: tuple[str, str] = ("", ""), mission: tuple[str, str] = ("", "")) -> int:
    assert robot[0] in ROBOT
    assert mission[0] in MISSION
    (folder / "bot.yaml").write_text(ROBOT.replace(*robot, 1) if robot[0] else ROBOT)
    (folder / "errand.yaml").write_text(MISSION.replace(*mission, 1) if mission[0] else MISSION)
    return run_command(["run", str(folder / "errand.yaml")])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("robot", "mission", "told"),
    [
        (("", ""), ("distance: 40 m", "distance: 1e9 km"), "too many bursts"),
        (("", ""), ("0.8 m/s", "1e-300 m/s"), "too many bursts"),
        (("", ""), ("every: 60 s, duration: 2 s", "from: {time: 50 s}, until: {time: 9 s}"), "ends before it begins"),
        (("", ""), ("2 min", "1e308 s"), "at most 1e+09 s"),
        (("mass: 30 kg", "mass: 30 kg, max_acceleration: 1e-300 m/s^2"), ("", ""), "1e-06 to 50 m/s^2"),
        ((MOTION, "model: expression, power: k*v*scheme, parameters: {k: 3}"), ("", ""), "holds words"),
        (
            (
                "schemes:",
                "effects: [{name: own, battery: main, power: 'k * lag(2*fan, 3)', parameters: {k: 1}}]\nschemes:",
            ),
            ("distance: 40 m", "distance: 40 m, conditions: {fan: fast}"),
            "holds words",
        ),
        ((MOTION, "model: expression, power: 9**9**9**9"), ("", ""), "not a number in segment"),
        (("c2: 4", "c2: 1e308"), ("2 min", "2 h"), "not a number in segment"),
        (
            ("schemes:", "effects: [{name: own, battery: main, power: k/payload_kg, parameters: {k: 1}}]\nschemes:"),
            ("", ""),
            "not a number in segment",
        ),
        (("main: {capacity: 288 Wh}", CIRCUIT), ("", ""), "not a number in segment"),
        (("", ""), ("distance: 40 m", "distance: 1e308 m"), "1e+12 m"),
    ],
)
def test_missions_that_cannot_be(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    robot: tuple[str, str],
    mission: tuple[str, str],
    told: str,
) -> None:
    monkeypatch.setattr("missionsim.engine.components.MOST_BURSTS", 2000)
    assert run_with(tmp_path, robot, mission) == 2
    out, err = capsys.readouterr()
    assert told in err
    assert not out


def test_the_mission_itself_runs(tmp_path: Path) -> None:
    assert run_with(tmp_path) == 0


def test_an_input_error_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(InputError([Fault("a.yaml", 2, 1, "wrong"), Fault("b.yaml", 1, 1, "wrong too")])))
    assert str(error) == "a.yaml:2:1: error: wrong\nb.yaml:1:1: error: wrong too"


def test_arithmetic_with_words_is_refused() -> None:
    floor = Labels.of(["carpet", "tile"])
    assert compile_expression("2 * (surface == 'tile')").evaluate({"surface": floor}).tolist() == [0.0, 2.0]
    with pytest.raises(InputError, match="holds words"):
        compile_expression("2 * surface").evaluate({"surface": floor})


def write_log(folder: Path, name: str = "run", rows: int = 60, **columns: object) -> Path:
    time = np.arange(rows, dtype=float)
    table: dict[str, object] = {
        "time_s": time,
        "power_robot_w": 10 + np.sin(time),
        "speed_m_s": 0.3 + 0.1 * np.sin(0.2 * time),
        **columns,
    }
    lists = [np.broadcast_to(np.asarray(value), rows).tolist() for value in table.values()]
    path = folder / f"{name}.csv"
    path.write_text("\n".join([",".join(table), *(",".join(map(str, row)) for row in zip(*lists, strict=True))]) + "\n")
    return path


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_reason_are_no_measurement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path, power_robot_w=1e308)
    assert run_command(["compare", "--robot", "pioneer3dx", str(path)]) == 2
    assert "60 values outside" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_a_frozen_meter_calibrates_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_log(tmp_path, power_robot_w=10.0), tmp_path / "robot.yaml"
    assert run_command(["calibrate", "--new", "x", "--base", "c3*v + c4", str(path), "--out", str(out)]) == 2
    assert "never changes" in capsys.readouterr().err
    assert not out.exists()


def test_faults_of_logs_come_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path, speed_m_s="fast")
    assert run_command(["compare", "--robot", "pioneer3dx", str(path)]) == 2
    assert capsys.readouterr().err.rstrip().splitlines()[-1].endswith("more such cells")


def test_a_pipe_is_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("run.csv", "errand.yaml"):
        os.mkfifo(tmp_path / name)
    assert run_command(["compare", "--robot", "pioneer3dx", str(tmp_path / "run.csv")]) == 2
    assert run_command(["run", str(tmp_path / "errand.yaml")]) == 2
    assert capsys.readouterr().err.count("is a pipe") == 2


@pytest.mark.parametrize("base", ["c / (v - v)", "k * 9**9**9"])
def test_a_base_without_a_value_calibrates_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], base: str
) -> None:
    path, out = write_log(tmp_path), tmp_path / "robot.yaml"
    assert run_command(["calibrate", "--new", "x", "--base", base, str(path), "--out", str(out)]) == 2
    assert "gives no number in any row" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("command", ["compare", "diagnose", "calibrate"])
def test_a_law_without_a_value_is_told_at_its_formula(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """compare ended with 0 and "No energy was measured", diagnose with a LinAlgError and 3."""
    robot, path, out = tmp_path / "robot.yaml", write_log(tmp_path), tmp_path / "out.yaml"
    robot.write_text(
        "kind: robot\nname: r\nbody: {mass: 9 kg, drive: differential, max_speed: 2 m/s}\n"
        "batteries: {robot: {capacity: 9 Wh}}\n"
        "motion: {battery: robot, model: polynomial, parameters: {c2: 1, c3: 2, c4: 3}}\n"
        "effects:\n  - {name: odd, battery: robot, power: k * v / 0, parameters: {k: 5}}\n"
    )
    options = ["--out", str(out)] if command == "calibrate" else []
    assert run_command([command, "--robot", str(robot), str(path), *options]) == 2
    err = capsys.readouterr().err
    assert "robot.yaml:7:40: error: the power of 'odd' (battery 'robot') is not a number in 60 of 60 rows" in err
    assert not out.exists()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("base", ["c2*v**c3", "k*exp(900*v)", "c2/0", "a*exp(exp(exp(b*v)))"])
def test_formulas_that_leave_all_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str], base: str) -> None:
    path, out = write_log(tmp_path), tmp_path / "robot.yaml"
    assert run_command(["calibrate", "--new", "x", "--base", base, str(path), "--out", str(out)]) in (0, 2)
    assert "our own fault" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "rows", "told"), [(("--battery", "robto"), 60, "did you mean: robot"), ((), 3, "no run has at least 8")]
)
def test_logs_that_hold_too_little(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], rows: int, told: str
) -> None:
    path, out = write_log(tmp_path, rows=rows), tmp_path / "robot.yaml"
    command = ["calibrate", "--new", "x", "--base", "c3*v + c4", *options, str(path), "--out", str(out)]
    assert run_command(command) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("power", "code", "told"),
    [
        (-10.0, 2, "what it delivers is positive"),
        (0.0, 0, "No energy was measured"),
        (1e4, 1, "1,000 times of modelled"),
        (1e-2, 1, "1/1,000 of modelled"),
    ],
)
def test_doubtful_meters_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], power: float, code: int, told: str
) -> None:
    path = write_log(tmp_path, power_robot_w=power)
    assert run_command(["compare", "--robot", "pioneer3dx", str(path)]) == code
    out = " ".join("".join(capsys.readouterr()).split())
    assert told in out
    assert "nan" not in out


def test_an_empty_robot_and_a_battery_that_feeds_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_with(tmp_path) == 0
    mission = str(tmp_path / "errand.yaml")
    assert run_command(["run", mission, "--set", "robot.batteries.spare.capacity=1 Wh", "--json", "-"]) == 0
    capsys.readouterr()
    assert run_command(["run", mission, "--robot", ""]) == 2
    assert "an argument is empty" in capsys.readouterr().err


def test_results_keep_links_and_devices(tmp_path: Path) -> None:
    target, link = tmp_path / "real.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    write_text("/dev/null", "lost")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(OSError, match="No space left"):
        write_text("/dev/full", "x")
    with pytest.raises(IsADirectoryError, match="a folder"):
        write_text(tmp_path, "x")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.txt", "real.txt"]


@pytest.mark.parametrize(
    ("term", "more"),
    [
        ("xterm", []),
        *(
            pytest.param(*both, marks=pytest.mark.long)
            for both in (("xterm", ["--json", "-"]), (None, []), (None, ["--json", "-"]))
        ),
    ],
)
def test_a_full_standard_output_is_called_so(
    term: str | None, more: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is buffered then does not fail once more when the program ends."""
    monkeypatch.delenv("TERM", raising=False)
    if term:
        monkeypatch.setenv("TERM", term)
    command = [sys.executable, "-c", "from missionsim.cli import main; main()", "robots", *more]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "standard output: error: No space left on device\n"


def test_messages_do_not_show_what_another_file_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "secret.txt").write_text("hunter2 is the password\n")
    mission = tmp_path / "mission.yaml"
    mission.write_text("kind: mission\nname: a\nrobot: secret.txt\nsegments: [{wait: {duration: 5 s}}]\n")
    assert run_command(["validate", str(mission)]) == 2
    assert "hunter2" not in capsys.readouterr().err
