"""A meter that lags is a repair by itself: it is written where nothing is missing, and told by `diagnose` too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from missionsim.compare import compare_files
from missionsim.diagnose import sentences
from missionsim.diagnose.diagnosis import diagnose_battery
from missionsim.diagnose.examine import Subject
from missionsim.diagnose.improve import Improved, improve
from missionsim.diagnose.meter import Metered, base_is_off
from missionsim.diagnose.split import Split
from missionsim.diagnose.waterfall import Step
from missionsim.identify.settings import Settings
from missionsim.inputs.edit import robot_text
from missionsim.inputs.loading import robot_from_text
from missionsim.logs import LogTable
from missionsim.physics.lag import Meter, metered

from .logs import drawing, drive
from .test_commands import write

BATTERY = "robot"
TRUE = Meter(0.4, 0.7)
BEFORE = Step("before", 0.7, 17.1)


def late(seed: int) -> LogTable:
    log = drive(seed, seconds=200.0, step_s=0.25, noise=0.01)
    return drawing(log, metered(log.power_w[BATTERY], log.time_s, TRUE))


@pytest.fixture(scope="module")
def logs() -> list[LogTable]:
    return [late(seed) for seed in range(5)]


def split_of(logs: list[LogTable], held: int) -> Split:
    return Split(tuple(logs[: 5 - held]), tuple(logs[5 - held :]), "the last")


def improved(text: str, logs: list[LogTable], held: int, settings: Settings | None = None) -> Improved:
    return improve(text, split_of(logs, held), BATTERY, settings or Settings(), lambda *_: True)


@pytest.mark.usefixtures("effects_alone")
@pytest.mark.parametrize("held", [2, pytest.param(0, marks=pytest.mark.long)])
def test_the_meter_alone_is_written_where_nothing_else_is_wrong(
    logs: list[LogTable], held: int, tmp_path: Path
) -> None:
    text = robot_text("pioneer3dx")
    done = improved(text, logs, held)
    assert (done.added, done.base_alone) == ((), False)
    assert [step.name for step in done.steps] == ["before", "recalibrated", "meter", "noise floor"]
    before, _, alone, _ = done.steps
    assert alone.power_rmse_w < 0.6 * before.power_rmse_w
    was, now = robot_from_text(text), robot_from_text(done.text)
    old, new = ({n: p.value for n, p in robot.motion.parameters.items()} for robot in (was, now))
    assert new == old
    meter = Subject.of(now).model.meter(BATTERY)
    assert sum(meter) == pytest.approx(sum(TRUE), abs=0.1)
    told, command = done.advice(sentences.Asked("my.yaml", ["train"]))
    assert "The meter lags" in told
    assert "The file that is written has that meter" in told
    assert "base" not in told
    assert command == ""
    assert done.to_json()["meter"] == {"delay_s": meter.delay_s, "lag_s": meter.lag_s}
    robot = tmp_path / "better.yaml"
    robot.write_text(done.text, encoding="utf-8")
    for log in logs[5 - held :] if held else logs:
        write(log, tmp_path / "logs")
    (shown,) = [one.power_rmse_w for one in compare_files(robot, [tmp_path / "logs"]).batteries.values()]
    assert shown == pytest.approx(alone.power_rmse_w, rel=0.01)
    again = improved(done.text, logs, held)
    assert [step.name for step in again.steps] == ["before", "recalibrated", "noise floor"]
    assert again.late is None


@pytest.mark.usefixtures("effects_alone")
def test_diagnose_says_so_and_gives_the_command_that_does_it(logs: list[LogTable]) -> None:
    subject = Subject.of(robot_from_text(robot_text("pioneer3dx")))
    found = diagnose_battery(subject, split_of(logs, 2), BATTERY, Settings())
    assert "The meter lags" in sentences.errors(found)
    assert found.to_json()["meter"] == found.meter
    asked = sentences.Asked("my.yaml", ["train"], "--holdout held")
    command = "missionsim improve --robot my.yaml --holdout held train --out my_better.yaml"
    assert sentences.next_step(found, asked) == command


@pytest.mark.usefixtures("effects_alone")
def test_no_meter_where_the_clocks_are_to_be_left_alone(logs: list[LogTable]) -> None:
    done = improved(robot_text("pioneer3dx"), logs, 2, replace(Settings(), align=False))
    assert done.late is None
    assert "meter" not in [step.name for step in done.steps]


@pytest.mark.parametrize(
    ("recalibrated", "alone", "off"),
    [
        (Step("", 0.6, 2.58), None, True),
        (Step("", 0.6, 2.58), Step("meter", 1.1, 2.61), False),
        (Step("", 0.6, 1.6), Step("meter", 1.1, 2.61), True),
        (Step("", 0.6, 2.58), Step("meter", 4.0, 2.61), True),
        (Step("", 0.9, 1.6), Step("meter", 1.1, 2.61), False),
    ],
)
def test_a_base_is_off_where_the_meter_alone_does_not_mend_it(
    recalibrated: Step, alone: Step | None, off: bool
) -> None:
    model = Subject.of(robot_from_text(robot_text("pioneer3dx"))).model
    late = None if alone is None else Metered(model, alone, TRUE, Meter())
    assert base_is_off(BEFORE, recalibrated, late, 2.0) is off
