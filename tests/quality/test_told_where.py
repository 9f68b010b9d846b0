"""Faults and remarks of commands: told once, with their place in the user's file, before anything is computed."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.glossary import column_of
from missionsim.inputs.loading import load_mission
from missionsim.labels import Labels
from missionsim.results.write import provenance

ROBOT = """kind: robot
name: bot
body: {drive: differential, max_speed: 1.2 m/s, mass: 30 kg}
batteries:
  main: {capacity: 288 Wh}
motion: {battery: main, model: expression, power: c2*v + c4, parameters: {c2: 4, c4: 8}}
components:
  lidar: {loads: [{battery: main, law: {power: p1*1, parameters: {p1: 3}}}]}
effects:
  - {name: own, battery: main, power: k*1, parameters: {k: 1}}
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
"""


def files(folder: Path, robot: tuple[str, str] = ("", ""), mission: tuple[str, str] = ("", "")) -> str:
    for name, text, (old, new) in (("bot.yaml", ROBOT, robot), ("errand.yaml", MISSION, mission)):
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1) if old else text)
    return str(folder / "errand.yaml")


@pytest.mark.parametrize(
    ("robot", "place", "told", "hint"),
    [
        (("k*1", "k*sped_m_s"), "10:39", "'own' reads 'sped_m_s', which is not known here", "speed_m_s"),
        (("k*1", "k*nosuch"), "10:39", "'own' reads 'nosuch', which is not known here", ""),
        (("p1*1", "p1*rte"), "8:48", "'lidar' reads 'rte'", ""),
        (("c2*v", "c2*vv"), "6:51", "'motion' reads 'vv'", ""),
        (("k*1", "k*scheme"), "10:39", "computes with scheme, which holds words", ""),
        (("k*1", "k*'drive'"), "10:41", "a word stands alone", ""),
        (("k*1", "k*1 +"), "10:39", "formula cannot be read: invalid syntax", ""),
        (("k*1", "k/payload_kg"), "10:39", "is not a number in segment", ""),
    ],
)
def test_formulas_are_told_with_their_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], robot: tuple[str, str], place: str, told: str, hint: str
) -> None:
    assert run_command(["run", files(tmp_path, robot)]) == 2
    err = capsys.readouterr().err
    line = next(line for line in err.splitlines() if told in line)
    assert line.startswith(f"{tmp_path / 'bot.yaml'}:{place}: error: ")
    assert ("did you mean" in err) == bool(hint)
    assert not hint or f"did you mean: {hint}\n" in err + "\n"


def test_an_expression_keeps_its_place_through_pickle() -> None:
    formula = compile_expression("2 * surface", file="a.yaml", line=3, column=7, path="effects.0.power")
    again = pickle.loads(pickle.dumps(formula))
    assert again == formula
    with pytest.raises(InputError, match=r"a.yaml:3:7: error: the formula computes with surface") as caught:
        again.evaluate({"surface": Labels.of(["carpet", "tile"])})
    assert caught.value.faults[0].path == "effects.0.power"


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["run", "errand.yaml", "--json", "folder"], "--json is a folder"),
        (["run", "errand.yaml", "--out", "bot.yaml"], "--out is a file"),
        (["run", "errand.yaml", "--out="], "--out names nothing"),
        (["montecarlo", "errand.yaml", "--json", "bot.yaml/a/b.json"], "--json leads through bot.yaml"),
        (["whatif", "errand.yaml", "--vary", "defaults.speed=0.5", "--out", "folder"], "--out is a folder"),
        (["compare", "--robot", "bot.yaml", "log.csv", "--report", "folder"], "--report is a folder"),
        (["calibrate", "--new", "x", "--base", "k*v", "log.csv", "--out=folder"], "--out is a folder"),
        (["improve", "--robot", "bot.yaml", "log.csv", "--out", "folder", "--yes"], "--out is a folder"),
    ],
)
def test_what_cannot_be_written_is_told_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: list[str], told: str
) -> None:
    files(tmp_path)
    (tmp_path / "folder").mkdir()
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("missionsim.inputs.loading._finished", lambda *_, **__: pytest.fail("was computed"))
    assert run_command(command) == 2
    out, err = capsys.readouterr()
    assert told in err
    assert not out
    assert sorted(tmp_path.rglob("*")) == before


def test_warnings_are_told_once_and_not_where_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mission = files(tmp_path, mission=("distance: 40 m", "distance: 40 m, slope: 3 deg"))
    told = f"{mission}:6:36: warning: this slope costs nothing"
    assert run_command(["run", mission]) == 0
    assert capsys.readouterr().err.count(told) == 1
    assert run_command(["run", mission, "--quiet"]) == 0
    assert not capsys.readouterr().err
    assert run_command(["whatif", mission, "--vary", "defaults.speed=0.5,0.6"]) == 0
    assert capsys.readouterr().err.count(told) == 1
    assert run_command(["validate", mission]) == 0
    assert capsys.readouterr().err.count(told) == 1


def test_a_capacity_may_be_a_charge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["run", files(tmp_path, ("288 Wh", "288 kg"))]) == 2
    assert "an energy such as 259 Wh, or a charge such as 20 Ah" in capsys.readouterr().err


def test_the_summary_says_why_no_way_home_is_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = ", scheme: drive}\nsegments:\n  - drive: {", "}\nsegments:\n  - drive: {scheme: drive, "
    mission = files(tmp_path, mission=(old, new))
    assert run_command(["run", mission]) == 0
    out = capsys.readouterr().out
    assert "home Wh unknown (main): the mission has no environment" in out
    assert "│no scheme │" in out


def test_effects_tell_columns_of_logs_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["effects", "--json", "-"]) == 0
    effects = {effect["id"]: effect for effect in json.loads(capsys.readouterr().out)["effects"]}
    assert effects["cold_friction"]["needs"] == ["speed_m_s"]
    assert effects["start_surge"]["derived"] == ["starts"]
    assert effects["component_warmup:<component>"]["needs"] == ["on_<component>"]
    for effect in effects.values():
        known = {"on_<component>": "on_kinect", "voltage_<battery>_v": "voltage_robot_v", "<column>": "speed_m_s"}
        names = {known.get(name, name) for name in effect["needs"]}
        assert all(column_of(name) is not None for name in names)


def test_paths_of_the_provenance_are_tidy(tmp_path: Path) -> None:
    (tmp_path / "missions").mkdir()
    (tmp_path / "yard.yaml").write_text(
        "kind: environment\nname: yard\nplaces: {a: {x: 0, y: 0}, b: {x: 9, y: 0}}\nedges: [{from: a, to: b}]\n"
    )
    files(tmp_path / "missions", mission=("robot:", "environment: ../yard.yaml\nrobot:"))
    paths = provenance(load_mission(tmp_path / "missions" / "errand.yaml"))["files"]
    assert paths["environment"]["path"] == str(tmp_path / "yard.yaml")


def a_log(folder: Path) -> str:
    rows = [(0.5 * i, 0.3 + 0.2 * ((i // 20) % 3), 0.01 * ((7 * i) % 11)) for i in range(400)]
    path = folder / "run.csv"
    path.write_text("time_s,power_robot_w,speed_m_s\n" + "".join(f"{t},{5 + 9 * v + n},{v}\n" for t, v, n in rows))
    return str(path)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"--new": "a b/c"}, "--new: error: not a name"),
        ({"--new": "a: b"}, "--new: error: not a name"),
        ({"--capacity": "lots"}, "--capacity: error: not a number with a unit"),
        ({"--mass": "2 m"}, "--mass: error: wrong unit"),
        ({"--drive": "hover"}, "--drive: error: not one of the allowed words"),
        ({"--base": "k * v + " + " + ".join(f"a{i}*v" for i in range(150))}, "--base: error: formula has too many"),
        ({"--base": "k * nocolumn"}, "and columns: speed_m_s"),
        ({"--base": "k * v + c * sped_m_s"}, "did you mean: speed_m_s"),
    ],
)
def test_a_new_robot_that_cannot_be_is_told_by_its_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: dict[str, str], told: str
) -> None:
    out = tmp_path / "new.yaml"
    given = {"--new": "x", "--base": "k*v + c", **options, "--out": str(out)}
    assert run_command(["calibrate", a_log(tmp_path), *(word for pair in given.items() for word in pair)]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert "robot.yaml" not in err
    assert not out.exists()


def test_a_parameter_that_is_nearly_a_column_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new.yaml"
    assert run_command(["calibrate", a_log(tmp_path), "--new", "x", "--base", "k*v + sped_m_s", "--out", str(out)]) == 0
    assert "if the column speed_m_s is meant" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("robot", "mission", "told"),
    [
        (
            ("p1*1", "-30*p1"),
            ("", ""),
            "bot.yaml:8:48: warning: the power of 'lidar' is negative: it charges battery "
            "'main' with 1.290 Wh in segment 'drive'; is the sign right?",
        ),
        (("power: k*1", "power: -60*k*v"), ("", ""), "bot.yaml:10:39: warning: the power of 'own' is negative"),
        (("c2*v + c4", "c2*v + c4 + 900*a*v"), ("", ""), "bot.yaml:6:51: warning: the power of 'motion' is negative"),
        (
            ("p1*1", "-30*p1"),
            ("", ""),
            "bot.yaml:5:9: warning: battery 'main' comes to 100.4 % of its capacity in segment 'drive' and 1 more",
        ),
    ],
)
def test_what_charges_a_battery_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], robot: tuple[str, str], mission: tuple[str, str], told: str
) -> None:
    path = files(tmp_path, robot, mission)
    text = (tmp_path / "bot.yaml").read_text()
    (tmp_path / "bot.yaml").write_text(text.replace("mass: 30 kg}", "mass: 30 kg, max_acceleration: 0.5 m/s^2}"))
    assert run_command(["run", path]) == 0
    out, err = capsys.readouterr()
    assert told in err
    assert "warning: " in out
    assert run_command(["run", path, "--quiet"]) == 0
    assert not "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "robot",
    [
        ("power: k*1", "power: -k*v"),  # less than the rest draws: a correction
        ("max_speed: 1.2 m/s", "max_speed: 1.2 m/s, regeneration: 50 %"),  # below, with a formula that gives back
    ],
)
def test_corrections_and_regeneration_are_no_doubt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], robot: tuple[str, str]
) -> None:
    path = files(tmp_path, robot)
    text = (tmp_path / "bot.yaml").read_text().replace("capacity: 288 Wh", "capacity: 288 Wh, initial_charge: 80 %")
    text = text.replace("mass: 30 kg}", "mass: 30 kg, max_acceleration: 0.5 m/s^2}")
    if "regeneration" in text:
        text = text.replace("c2*v + c4", "c2*v + c4 + 900*a*v")
    (tmp_path / "bot.yaml").write_text(text)
    assert run_command(["run", path]) == 0
    assert "warning" not in "".join(capsys.readouterr())


def test_components_that_are_never_on_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = "components:\n", "components:\n  arm: {loads: [{battery: main, power: 40 W}]}\n"
    assert run_command(["run", files(tmp_path, (old, new))]) == 0
    assert "never on in this mission, so costing nothing: arm\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    "activity",
    ["every: 1e-7 s, duration: 1e-8 s", "from: {segment: go}, until: {segment: go}, every: 10 us, duration: 1 us"],
)
def test_bursts_that_are_too_many_are_refused_at_the_door(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, activity: str
) -> None:
    text = f"{{distance: 40 m, name: go}}\nactivities:\n  - {{component: lidar, {activity}}}\n"
    path = files(tmp_path, mission=("{distance: 40 m}\n  - wait: {duration: 2 min}\n", text))
    monkeypatch.setattr("simpy.Environment.run", lambda *_, **__: pytest.fail("was simulated"))
    assert run_command(["run", path]) == 2
    assert f"{path}:8:" in capsys.readouterr().err


def test_an_effect_of_a_component_that_is_not_there_is_refused_before_fitting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files(tmp_path)
    monkeypatch.setattr("missionsim.diagnose.adopt.examine", lambda *_: pytest.fail("was fitted"))
    log = a_log(tmp_path)
    Path(log).write_text(Path(log).read_text().replace("power_robot_w", "power_main_w"))
    command = ["add-effect", "--robot", str(tmp_path / "bot.yaml"), "--effect", "component_power:lidr", log]
    assert run_command([*command, "--out", str(tmp_path / "new.yaml")]) == 2
    assert "did you mean: component_power:lidar" in capsys.readouterr().err
