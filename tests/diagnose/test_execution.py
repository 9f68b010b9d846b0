"""How the robot drove otherwise than planned: found where it did, not where it did not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from missionsim.diagnose.execution import _judged, execution_effects, seen_once, told_of
from missionsim.effects.timeline import Timeline
from missionsim.engine.simulate import simulate
from missionsim.identify.findings import Finding
from missionsim.inputs.loading import load_mission
from missionsim.labels import Labels
from missionsim.logs import LogTable
from missionsim.runs.motion import still_of

MISSION = """kind: mission
name: there_and_back
robot: pioneer3dx
defaults: {scheme: forward_motion, profile: constant_speed}
segments:
  - drive: {name: out, distance: 20 m, speed: 0.5 m/s}
  - wait: {name: pause, duration: 20 s}
  - drive: {name: back, distance: 12 m, speed: 0.3 m/s}
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Timeline:
    path: Path = tmp_path_factory.mktemp("plan") / "mission.yaml"
    path.write_text(MISSION, encoding="utf-8")
    return simulate(load_mission(path)).timeline


def log(seed: int, *, stretch: float = 1.0, tracking: float = 1.0, dwell_s: float = 0.0) -> LogTable:
    """A drive of the mission at 1 Hz with 0.5 % of scatter in way and speed."""
    rng = np.random.default_rng(seed)
    speeds: list[np.ndarray] = []
    names: list[str] = []
    for name, distance, speed in (("out", 20.0, 0.5), ("pause", 0.0, 0.0), ("back", 12.0, 0.3)):
        if speed:
            reached = speed * tracking * (1.0 + 0.005 * rng.standard_normal())
            seconds = round(distance * stretch * (1.0 + 0.005 * rng.standard_normal()) / reached)
            speeds.append(np.full(seconds, reached))
        else:
            seconds = round(20.0 + dwell_s + rng.uniform(-1.0, 1.0))
            speeds.append(np.zeros(seconds))
        names += [name] * seconds
    v = np.concatenate(speeds)
    count = len(v)
    columns = {
        "time_s": np.arange(count) + 0.5,
        "speed_m_s": np.abs(v + 0.002 * rng.standard_normal(count)),
        "yaw_rate_rad_s": np.zeros(count),
        "segment": Labels.of(names),
    }
    power = 6.25 * v**2 + 9.79 * v + np.where(v > 0, 3.66, 2.67)
    return LogTable(f"run_{seed}", columns, np.ones(count), {"robot": power}, {"robot": None}, {"robot": "power"})


def found(plan: Timeline, logs: list[LogTable]) -> dict[str, Finding]:
    effects = execution_effects(plan, logs, "robot", 0.01)
    return {one.effect: one for one in effects if one.level}


def test_driven_as_planned_names_nothing(plan: Timeline) -> None:
    assert still_of(plan)[0] == pytest.approx(0.03)  # a tenth of the slowest speed: a noisy log stands still below
    assert found(plan, [log(seed) for seed in range(6)]) == {}


@pytest.mark.parametrize(
    ("more", "effect", "value"),
    [
        ({"stretch": 1.06}, "path_stretch", 1.06),
        ({"tracking": 0.94}, "speed_tracking", 0.94),
        ({"dwell_s": 15.0}, "dwell", 15.0),
    ],
)
def test_each_effect_is_named_alone_with_its_size(
    plan: Timeline, more: dict[str, float], effect: str, value: float
) -> None:
    named = found(plan, [log(seed, **more) for seed in range(6)])
    assert set(named) == {effect}
    one = named[effect]
    k = one.parameters["k"]
    assert k.low < k.value < k.high
    assert k.value == pytest.approx(value, rel=0.05)
    assert one.p_value < 0.01


def test_longer_and_slower_take_energy(plan: Timeline) -> None:
    longer = found(plan, [log(seed, stretch=1.10) for seed in range(6)])["path_stretch"]
    assert 0.02 < longer.energy_share < 0.10
    waiting = found(plan, [log(seed, dwell_s=30.0) for seed in range(6)])["dwell"]
    assert waiting.energy_share > 0.0


def test_one_run_says_that_it_cannot_show_scatter(plan: Timeline) -> None:
    effects = execution_effects(plan, [log(0, stretch=1.2)], "robot")
    assert not any(one.level for one in effects)
    assert "one run cannot show how it scatters" in {one.remark for one in effects}
    (told,) = seen_once(effects)
    assert "path_stretch: 1.2 times the planned way (+" in told
    assert "cannot show whether it repeats" in told
    assert seen_once(execution_effects(plan, [log(0)], "robot")) == []
    assert seen_once(execution_effects(plan, [log(seed, stretch=1.2) for seed in range(4)], "robot")) == []
    judged = {one.effect: one for one in told_of(effects)}
    assert set(judged) == {"path_stretch", "speed_tracking", "dwell"}
    assert not any(one.accepted for one in judged.values())


def test_each_scheme_has_its_own_stretch(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(
        "kind: mission\nname: two\nrobot: pioneer3dx\ndefaults: {profile: constant_speed, speed: 0.5 m/s}\nsegments:\n"
        "  - drive: {name: a, distance: 20 m, scheme: forward_motion}\n"
        "  - inspect: {name: look, duration: 10 s, scheme: image_analysis, sensors: {kinect: 1}}\n"
        "  - drive: {name: b, distance: 20 m, scheme: path_following, sensors: {laser: 2}}\n",
        encoding="utf-8",
    )
    timeline = simulate(load_mission(path)).timeline
    logs = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        first, second = (round(20.0 * stretch / 0.5 * (1 + 0.004 * rng.standard_normal())) for stretch in (1.0, 1.15))
        v = np.concatenate([np.full(first, 0.5), np.zeros(10), np.full(second, 0.5)])
        scheme = ["forward_motion"] * first + ["image_analysis"] * 10 + ["path_following"] * second
        count = len(v)
        columns = {
            "time_s": np.arange(count) + 0.5,
            "speed_m_s": v,
            "yaw_rate_rad_s": np.zeros(count),
            "scheme": Labels.of(scheme),
        }
        power = 6.25 * v**2 + 9.79 * v + 3.0
        logs.append(
            LogTable(f"run_{seed}", columns, np.ones(count), {"robot": power}, {"robot": None}, {"robot": "power"})
        )
    named = [one for one in execution_effects(timeline, logs, "robot") if one.level]
    assert [(one.effect, one.scheme) for one in named] == [("path_stretch", "path_following")]
    assert named[0].parameters["k"].value == pytest.approx(1.15, abs=0.01)


@pytest.mark.parametrize(
    ("effect", "value", "away"),
    [
        ("path_stretch", 1.008, False),  # an odometer's scale
        ("path_stretch", 1.012, True),
        ("speed_tracking", 0.992, False),
        ("speed_tracking", 0.988, True),
        ("dwell", 1.8, False),
        ("dwell", 2.2, True),
        ("dwell", -9.0, False),
    ],
)
def test_two_runs_show_what_is_beyond_an_odometers_scale(effect: str, value: float, away: bool) -> None:
    assert _judged(effect, "", np.full(2, value), 0.05, 1e-3).level == "identified" * away
    once = _judged(effect, "", np.full(1, value), 0.011, 1e-3)
    assert bool(seen_once([once])) is (away or value < 0.0)
    assert not seen_once([replace(once, energy_share=0.009)])
