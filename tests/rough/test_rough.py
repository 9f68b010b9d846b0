"""A base formula far from right, on data of a little world of its own: what is named, and what the error does."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionsim.diagnose import diagnose_files
from missionsim.diagnose.improve import improve
from missionsim.diagnose.split import choose_split
from missionsim.fit.calibrate import NewRobot, calibrate_new
from missionsim.identify.settings import Settings
from missionsim.logs import read_logs
from tests.hidden_effects.study import ALL_CASES
from tests.hidden_effects.world import make
from tests.hidden_effects.world import write as write_case
from tests.rough.regimes import REGIMES, case
from tests.rough.world import WORLDS, write

STUDY_SEEDS = range(1, 9)


def driven(kind: str, seed: int, folder: Path):
    train, heldout = write(kind, seed, folder)
    world = WORLDS[kind]
    split = choose_split(read_logs([train]), [heldout])
    robot = NewRobot("own", "c2*v**2 + c3*v + c4", mass=f"{world.mass_kg} kg", drive=world.drive)
    made = calibrate_new(robot, split.train)
    return improve(made.text, split, "robot", Settings(), lambda finding, diagnosis: True)


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
@pytest.mark.parametrize("kind", ["scrub"])
def test_the_right_effect_comes_first_and_the_error_falls(kind: str, tmp_path: Path) -> None:
    found = driven(kind, 0, tmp_path)
    named = [name for name in found.added if not name.startswith("law_")]
    if not WORLDS[kind].truth:
        assert not named
        return
    assert named[0] in WORLDS[kind].truth
    before, last = found.steps[1], found.steps[-2]
    assert last.power_rmse_w < 0.7 * before.power_rmse_w
    assert last.energy_error_pct < before.energy_error_pct + 1.0


@pytest.mark.study
@pytest.mark.parametrize("kind", WORLDS)
@pytest.mark.parametrize("seed", STUDY_SEEDS)
def test_rough_worlds(kind: str, seed: int, tmp_path: Path) -> None:
    found = driven(kind, seed, tmp_path)
    truth = WORLDS[kind].truth
    named = [name for name in found.added if not name.startswith("law_")]
    assert (named[0] in truth) if truth else not named


@pytest.mark.long
def test_a_noisy_speed_at_ten_hertz_does_not_hide_the_inertia() -> None:
    # rectified noise adds the same to every run: that is the base's to take, no fault of the effect
    assert list(case(REGIMES["10 Hz"], "acceleration", 0.05, 0)["named"]) == ["acceleration"]


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_no_effect_is_named_beside_a_law_that_needs_none(tmp_path: Path) -> None:
    """A robot that skids above a turn rate: the laser, which is always on, was named with a power below nought."""
    folder = write_case(make(ALL_CASES["outside-skid"], 1010), tmp_path)
    (found,) = diagnose_files("pioneer3dx", [folder / "train"]).batteries.values()
    assert not found.effects
    assert "yaw_rate_rad_s" in found.proposed_laws[0].certain
