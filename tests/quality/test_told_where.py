"""Faults and remarks of commands: told once, with their place in the user's file, before anything is computed."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from missionsim.cli.app import run_command
from missionsim.errors import InputError
from missionsim.expressions import compile_expression
from missionsim.labels import Labels

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
        (("k*1", "k*'drive'"), "10:39", "computes with words", ""),
        (("k*1", "k*1 +"), "10:39", "formula cannot be read: invalid syntax", ""),
        (("k*1", "k/payload_kg"), "10:39", "is not a number in segment", ""),
    ],
)  # fmt: skip
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
