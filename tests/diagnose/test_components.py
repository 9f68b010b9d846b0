"""A component that logs switch and the robot file lacks: it is named and added, whether it may fade or not."""

from __future__ import annotations

import pytest

from missionsim.diagnose import words
from missionsim.diagnose.adopt import adopt
from missionsim.diagnose.diagnosis import diagnose_battery
from missionsim.diagnose.examine import Subject
from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import Split
from missionsim.errors import InputError
from missionsim.identify.settings import Settings
from missionsim.inputs.edit import Editing, robot_text
from missionsim.inputs.loading import robot_from_text

from .logs import drawing, drive

pytestmark = pytest.mark.usefixtures("effects_alone", "examined_once")

BATTERY, BEACON_W = "robot", 1.2


@pytest.fixture(scope="module")
def split() -> Split:
    logs = []
    for seed in range(5):
        log = drive(seed, seconds=240.0, noise=0.03)
        on = ((log.time_s > 40.0 + 20.0 * seed) & (log.time_s < 130.0 + 20.0 * seed)).astype(float)
        logs.append(drawing(log, log.power_w[BATTERY] + BEACON_W * on, on_beacon=on))
    return Split(tuple(logs[:4]), (logs[4],), "the last")


@pytest.mark.long
def test_what_a_component_draws_is_added_though_it_may_fade(split: Split) -> None:
    text = robot_text("pioneer3dx")
    found = diagnose_battery(Subject.of(robot_from_text(text)), split, BATTERY, Settings())
    (beacon,) = found.effects
    assert (beacon.effect, beacon.other_forms) == ("component_power:beacon", ("component_warmup:beacon",))
    assert beacon.is_clear
    assert "may fade after beacon is switched on" in beacon.doubt
    assert found.verdict == "effects_found"
    drives = [line for heading, line in words.report(found) if heading == "NEXT"]
    assert any("switch beacon on and leave it on for 10 min" in line for line in drives)
    done = improve(text, split, BATTERY, Settings(), lambda *_: True)
    assert done.added == ("component_power:beacon",)
    made = robot_from_text(done.text)
    assert made.components["beacon"].loads[0].power is not None
    (effect,) = (spec for spec in made.effects if spec.effect == "component_power:beacon")
    assert effect.parameters["k"].value == pytest.approx(BEACON_W, rel=0.15)
    last = diagnose_battery(Subject.of(made), split, BATTERY, Settings())
    assert not last.effects


def test_a_component_that_only_the_logs_know_can_be_added_by_name(split: Split) -> None:
    text = robot_text("pioneer3dx")
    made = adopt(text, split, "component_power:beacon", BATTERY, Settings())
    assert "beacon" in robot_from_text(made.text).components
    with pytest.raises(InputError, match="no component 'becon'"):
        adopt(text, split, "component_power:becon", BATTERY, Settings())


def test_a_component_is_added_to_a_file_that_has_none() -> None:
    text = "kind: robot\nname: r\nbody: {mass: 5 kg, drive: differential, max_speed: 1 m/s}\n"
    text += "batteries: {b: {capacity: 1 Ah, nominal_voltage: 12 V}}\n"
    made = robot_from_text(Editing(text).add_component("lamp", "b").text)
    assert list(made.components) == ["lamp"]
