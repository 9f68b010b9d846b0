"""Robot files changed by the program keep what people wrote."""

from __future__ import annotations

import difflib
from pathlib import Path

import pytest

from missionsim.errors import InputError
from missionsim.inputs import load_robot, shipped_robots
from missionsim.inputs.edit import Editing, for_folder, robot_text
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.parameter import parameters

EFFECT = {
    "effect": "turning_scrub",
    "battery": "robot",
    "parameters": {"k": {"value": 2.123456789, "sd": 0.1, "status": "fitted"}},
    "origin": {"command": "missionsim add-effect", "logs": [{"file": "run_00.csv", "sha256": "ab" * 32}]},
}


def changed_lines(before: str, after: str) -> list[str]:
    return [
        line
        for line in difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
        if line[:1] in "+-" and line[:3] not in ("+++", "---")
    ]


@pytest.mark.parametrize("name", list(shipped_robots()))
def test_adding_and_removing_an_effect_restores_the_text(name: str) -> None:
    text = robot_text(name)
    battery = next(iter(load_robot(name).batteries))
    with_effect = (
        Editing(text).add_effect({"effect": "standby_load", "battery": battery, "parameters": {"k": 1.5}}).text
    )
    assert all(line.startswith("+") for line in changed_lines(text, with_effect))
    added = robot_from_text(with_effect).effects[-1]
    assert (added.effect, added.parameters["k"].value) == ("standby_load", 1.5)
    assert changed_lines(text, Editing(with_effect).remove_effect(len(load_robot(name).effects)).text) == []


def test_a_text_that_is_opened_again_knows_nothing_of_the_changes_before() -> None:
    # an anchor and its alias, which a copy of what was read has to keep as one
    text = robot_text("pioneer3dx").replace("source: ", "source: &where ", 1)
    text = text.replace("source: Table 4 row 22}", "source: *where }") + "# the end\n"
    first = Editing(text).text
    assert "source: *where" in first
    changed = Editing(text).add_effect(EFFECT).set_values({"motion.parameters.c3": 3.5})
    assert changed.text != first
    assert Editing(text).text == first


def test_an_effect_stands_at_the_end_with_its_origin() -> None:
    text = robot_text("pioneer3dx")
    assert changed_lines(text, Editing(text).add_effect(EFFECT).text) == [
        "+effects:",
        "+  - effect: turning_scrub",
        "+    battery: robot",
        "+    parameters:",
        "+      k: {value: 2.123457, sd: 0.1, status: fitted}",
        "+    origin:",
        "+      command: missionsim add-effect",
        f"+      logs: [{{file: run_00.csv, sha256: {'ab' * 32}}}]",
    ]


def test_values_keep_unit_and_comments_and_lose_the_old_source() -> None:
    text = robot_text("pioneer3dx")
    updates = {
        "motion.parameters.c3": {"value": 9.912345678, "sd": 0.05, "status": "fitted"},
        "components.laser.loads.0.power": 2.4,
        "batteries.robot.capacity": 250 * 3600.0,
        "batteries.robot.reserve": 0.2,
    }
    changed = Editing(text).set_values(updates).text
    assert [line for line in changed_lines(text, changed) if line.startswith("+")] == [
        "+    capacity: {value: 250 Wh}",
        "+    reserve: {value: 20 %}",
        "+    c3: {value: 9.912346, unit: W s/m, sd: 0.05, status: fitted}",
        "+      - {battery: robot, power: {value: 2.4 W}}",
    ]
    robot = robot_from_text(changed)
    assert robot.batteries["robot"].capacity_wh == pytest.approx(250.0)
    assert robot.motion is not None
    assert robot.motion.parameters["c3"].sd == 0.05
    assert [line for line in changed.splitlines() if "#" in line] == [line for line in text.splitlines() if "#" in line]


def test_every_number_can_be_written_back() -> None:
    text = robot_text("pioneer3dx")
    robot = load_robot("pioneer3dx")
    known = {path: item for path, item in parameters(robot) if not path.startswith("schemes.")}
    changed = robot_from_text(Editing(text).set_values({path: item.value for path, item in known.items()}).text)
    after = dict(parameters(changed))
    for path, item in known.items():
        assert after[path].value == pytest.approx(item.value, rel=1e-6), path


def test_what_would_not_be_valid_is_refused() -> None:
    text = robot_text("pioneer3dx")
    with pytest.raises(InputError, match="no effect 'turning_scrubb'"):
        _ = Editing(text).add_effect(EFFECT | {"effect": "turning_scrubb"}).text
    with pytest.raises(InputError, match="no battery 'main'"):
        _ = Editing(text).add_effect(EFFECT | {"battery": "main"}).text
    with pytest.raises(InputError, match="impossible value"):
        _ = Editing(text).set_values({"components.laser.loads.0.power": -1.0}).text
    with pytest.raises(InputError, match="nothing called 'lasr'"):
        Editing(text).set_values({"components.lasr.loads.0.power": 1.0})


def test_lists_without_indent_stay_so() -> None:
    text = (
        "kind: robot\nname: r\nbody: {drive: differential, max_speed: 1}\n"
        "batteries: {main: {capacity: 10 Wh}}  # small\n"
        "components:\n  a:\n    loads:\n    - {battery: main, power: 1 W}  # measured\n"
    )
    changed = Editing(text).set_values({"components.a.loads.0.power": {"value": 1.25, "status": "fitted"}}).text
    # a comment behind a longer value moves, and is kept
    assert changed == text.replace("power: 1 W}  #", "power: {value: 1.25 W, status: fitted}} #")


def test_editor_line(tmp_path: Path) -> None:
    text = robot_text("pioneer3dx")
    first = for_folder(text, tmp_path).splitlines()[0]
    reference = first.partition("$schema=")[2]
    assert (tmp_path / reference).resolve().name == "robot.schema.json"
    assert (tmp_path / reference).resolve().is_file()
