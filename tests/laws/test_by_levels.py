"""A load that saturates with the turn rate and differs from floor to floor is one law with a level for each."""

from __future__ import annotations

import re

import numpy as np
import pytest

from missionsim.diagnose import Subject
from missionsim.diagnose.diagnosis import diagnose
from missionsim.diagnose.examine import examine
from missionsim.diagnose.split import Split
from missionsim.identify.findings import BatteryDiagnosis
from missionsim.identify.settings import Settings
from missionsim.inputs.loading import load_robot
from missionsim.laws.adapter import ground_of
from missionsim.laws.factors import make_grammar
from missionsim.laws.levels import by_levels
from missionsim.laws.search import Search
from missionsim.runs.run import Run
from tests.diagnose.logs import drawing, drive

FLOORS = {"snow": 9.0, "carpet": 5.0, "tile": 1.5}


def diagnosed(levels: dict[str, float]) -> BatteryDiagnosis:
    """Six runs, two on each floor, with a load of so many W at full turn, and one on ice without a turn."""
    logs: list[Run] = []
    for seed in range(6):
        floor = list(levels)[seed % len(levels)]
        log = drive(seed, noise=0.02, seconds=200.0, surface=[floor] * 200)
        power = log.power_w["robot"] + levels[floor] * np.tanh(np.abs(log.columns["yaw_rate_rad_s"]) / 0.25)
        logs.append(drawing(log, power))
    logs.append(drive(9, seconds=200.0, surface=["ice"] * 200, yaw_rate_rad_s=np.zeros(200)))
    return diagnose(Subject.of(load_robot("pioneer3dx")), logs, holdout="none").batteries["robot"]


@pytest.mark.usefixtures("laws_at_once")
def test_each_floor_has_its_part_of_the_highest() -> None:
    first = diagnosed(FLOORS).proposed_laws[0].first
    more = {floor: float(part) for part, floor in re.findall(r"([\d.]+) \* \(surface == '(\w+)'\)", first.formula)}
    assert first.variables == ("yaw_rate_rad_s", "surface")
    assert more.keys() == FLOORS.keys() - {"tile"}
    common = re.search(r"\(([\d.]+) \+ ", first.formula)
    assert common is not None  # of the least costly floor, and of any that no run has seen
    for floor, watts in FLOORS.items():
        assert abs(float(common[1]) + more.get(floor, 0.0) - watts / 9.0) < 0.08
    assert abs(first.k / 9.0 - 1.0) < 0.15


def searched(levels: dict[str, float], known: float) -> Search:
    """A search beside a base that was fitted to ten short runs, and that knows what turning costs in the mean."""
    logs = []
    for seed in range(10):
        floor = list(levels)[seed % len(levels)]
        log = drive(seed, seconds=150.0, noise=0.05, surface=[floor] * 150)
        turning = np.tanh(np.abs(log.columns["yaw_rate_rad_s"]) / 0.25)
        logs.append(drawing(log, 3.0 * log.power_w["robot"] + (levels[floor] - known) * turning))
    split = Split(tuple(logs), (), "none")
    seen = examine(Subject.of(load_robot("pioneer3dx")), split, "robot", Settings())
    ground = ground_of(seen.found, seen.features.covariates)
    assert ground.model.squares is not None  # the base is far from right
    return Search(ground, make_grammar(ground.covariates, set(), clocks=False))


@pytest.mark.long
def test_what_floors_differ_by_need_not_show_in_what_they_have_in_common() -> None:
    """The best law of one level is about something else."""
    search = searched({"snow": 24.0, "carpet": 13.0, "sand": 24.0, "grass": 19.0, "tile": 0.0}, 16.0)
    other = next(i for i, f in enumerate(search.grammar.factors) if f.variable == "speed_m_s" and not f.fine)
    wider, done = by_levels(search, search.fit((other,))) or (search, None)
    assert done is not None
    assert set(wider.grammar.variables(done.best.form)) == {"yaw_rate_rad_s", "surface"}


@pytest.mark.long
@pytest.mark.usefixtures("laws_at_once")
def test_floors_that_are_alike_have_no_levels() -> None:
    laws = diagnosed(dict.fromkeys(FLOORS, 5.0)).proposed_laws
    assert not [law for law in laws if "surface" in law.first.formula]
