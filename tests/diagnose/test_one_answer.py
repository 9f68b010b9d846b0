"""One question has one answer: what diagnose says, add-effect writes and improve adds."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from missionsim.compare.core import compare_files
from missionsim.diagnose.adopt import NotSignificant, adopt
from missionsim.diagnose.diagnosis import diagnose, diagnose_battery
from missionsim.diagnose.examine import Subject
from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import Split, choose_split
from missionsim.diagnose.words import headline, report
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.identify.findings import BatteryDiagnosis
from missionsim.identify.settings import Settings
from missionsim.importer.mapping import import_source
from missionsim.inputs.edit import robot_text
from missionsim.inputs.loading import load_map, robot_from_text
from missionsim.logs import LogTable, read_logs
from missionsim.numerals import meter_clock

pytestmark = pytest.mark.usefixtures("examined_once")


@pytest.fixture(scope="module")
def warthog(shared: Path, root: Path) -> list[LogTable]:
    return import_source(shared / "data" / "warthog_drive", load_map(root / "docs" / "maps" / "warthog.yaml"))


def alone(logs: list[LogTable], name: str, settings: Settings) -> tuple[str, Split, BatteryDiagnosis, float]:
    """A robot calibrated on one drive, that drive, its diagnosis and the error of the robot (RMS) [W]."""
    split = Split(tuple(log for log in logs if log.run.startswith(name)), (), "none")
    made = calibrate_new(NewRobot("own", "c2*v**2 + c3*v + c4", mass="590 kg", drive="skid_steer"), split.train)
    subject = Subject.of(robot_from_text(made.text))
    (fit,) = made.fits
    return made.text, split, diagnose_battery(subject, split, "robot", settings), fit.after.power_rmse_w


@pytest.mark.long
def test_a_short_drive_is_judged_alike_by_all_commands(warthog: list[LogTable]) -> None:
    """Two minutes on asphalt, of which four parts are too few to test turning: a law was a way round that test."""
    text, split, found, rmse_w = alone(warthog, "asphalt", Settings())
    assert not found.effects
    assert not found.proposed_laws
    (doubtful,) = (one for one in found.candidates if one.doubtful_share is not None)
    assert doubtful.effect == "turning_scrub"
    assert "these data do not name (perhaps turning_scrub)" in headline(found)
    assert found.noise["sd_w"] < rmse_w  # it was predicted from a part of the run, and told as noise
    for asked, formula in (("turning_scrub", False), ("k * abs(yaw_rate_rad_s)", True)):
        with pytest.raises(NotSignificant, match="48 % of the energy ± 28: not significant"):
            adopt(text, split, asked, "robot", Settings(), formula=formula)
    assert improve(text, split, "robot", Settings(), lambda *_: True).added == ()


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_what_the_parts_of_a_drive_are_predicted_as_well_without_is_not_named(warthog: list[LogTable]) -> None:
    """Drag at 2 m/s, whose coefficient may be nothing: the error with it was that without it."""
    settings = Settings(align=False)
    text, split, found, _ = alone(warthog, "grass_2024_8_8_16h19", settings)
    assert [effect.effect for effect in found.effects] == ["turning_scrub"]
    with pytest.raises(NotSignificant, match="comes to nothing beside the others"):
        adopt(text, split, "aerodynamic_drag", "robot", settings)
    made = improve(text, split, "robot", settings, lambda *_: True)
    assert made.added == ("turning_scrub",)
    turning, *_ = made.written
    k = adopt(text, split, "turning_scrub", "robot", settings).effect.parameters["k"]
    assert k == found.effects[0].parameters["k"]
    assert k.value == pytest.approx(turning.parameters["k"].value, rel=1e-6)
    # one number, one interval
    reach = (turning.share_high - turning.share_low) / turning.energy_share
    assert reach >= (k.high - k.low) / k.value * (1.0 - 1e-9)


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_what_improve_says_is_left_is_what_diagnose_says_of_its_file(root: Path, tmp_path: Path) -> None:
    """It held the base by what was known before these logs, which no command can know of the file that it wrote."""
    runs = root / "docs" / "examples" / "ramp_runs"
    split = choose_split(read_logs([runs]))
    made = improve(robot_text("pioneer3dx"), split, "robot", Settings(), lambda one, _: one.effect == "grade")
    subject = Subject.of(robot_from_text(made.text))
    found = diagnose(subject, split).batteries["robot"]
    assert json.dumps(made.last.to_json()) == json.dumps(found.to_json())
    assert found.unexplained.shape in made.stopped
    file = subject.model.meter("robot")
    assert f"(applied; the file has it {meter_clock(file.delay_s, file.lag_s)})" in dict(report(found))["CLOCK"]
    # what is told of the slope is what compare sees of it
    (told,) = map(float, re.findall(r"slope .*\(by ([\d.]+) % of the power\)", found.unexplained.shape))
    robot = tmp_path / "improved.yaml"
    robot.write_text(made.text, encoding="utf-8")
    seen = compare_files(str(robot), [runs]).batteries["robot"]
    explained = next(one.explained for one in seen.dependences if one.by == "slope_rad")
    assert told == pytest.approx(100.0 * math.sqrt(explained) * seen.power_rmse_w / found.mean_power_w, rel=0.5)
