"""Cost of the engine as ratios of two things measured in one run."""

from __future__ import annotations

import cProfile
import csv
import gc
import math
import pstats
import statistics
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simpy

from missionsim.control import PowerPredictor
from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.inputs.loading import load_mission
from missionsim.inputs.mission import MissionSpec
from missionsim.online import OnlinePredictor
from missionsim.results import write_results
from missionsim.results.whatif import Alternative, run_alternatives, varied
from missionsim.results.write import tables
from tests.benchmarks import patrol
from tests.benchmarks.conftest import InTurns, seconds_of
from tests.engine.making import load
from tests.engine.test_batteries import PLACES, simple

pytestmark = pytest.mark.benchmark_ratio
BY_HAND = 25.0


def energies(result: RunResult) -> list[float]:
    """Of the components and, last, of the motors, in J."""
    found = [0.0] * (patrol.COMPONENTS + 1)
    for battery in result.batteries:
        for name, energy in result.by_component_wh(battery).items():
            found[int(name[1:]) if name[1:].isdigit() else patrol.COMPONENTS] += energy * 3600.0
    return found


@pytest.mark.long
def test_the_patrol_beside_scripts_in_simpy(tmp_path: Path, in_turns: InTurns) -> None:
    """How much faster than polling depends on how long the mission idles, so two lengths of the same 40 segments.

    The script by hand is the least for this one mission (no trace, no batteries, no files), with the same energies.
    """
    polled, hand = [], []
    for scale in (1.0, 0.14):
        (tmp_path / str(scale)).mkdir()
        mission = load_mission(patrol.write(tmp_path / str(scale), scale))
        result = simulate(mission)
        assert len(result.segments) == 40
        assert len(result.timeline) >= 100
        assert patrol.by_hand(scale) == pytest.approx(energies(result), rel=1e-9)
        # polling misses the exact result by its step, not by more
        polling = patrol.polling_script(scale)
        assert sum(polling.energy_j) == pytest.approx(sum(energies(result)), rel=0.02 / scale)
        slow = seconds_of(partial(patrol.polling_script, scale))
        ours, script = in_turns(partial(simulate, mission), partial(patrol.by_hand, scale), BY_HAND)
        polled.append(slow / ours)
        hand.append(ours / script)
        print(
            f"{result.duration_s:.0f} s simulated in {ours * 1e3:.2f} ms: {polled[-1]:.0f} times faster than polling "
            f"at 10 Hz, {hand[-1]:.1f} times as long as by hand in SimPy"
        )
    assert polled[0] >= 60.0
    assert polled[1] >= 8.0
    assert max(hand) <= BY_HAND


def exponent(
    small: int, large: int, work: Callable[[int], Callable[[], object]], bound: float, turns: int = 3
) -> float:
    """Growth of the processor time with size: 1 is linear.

    The large one in turns with so many of the small as make its size, so that what else the machine does meets both
    alike, and the median of the turns, which end when more than half of all, however the rest come out, are below the
    bound; without what other tests have left for the garbage collector to look through.
    """
    few, many = work(small), work(large)
    ratios = []
    gc.collect()
    gc.freeze()
    for _ in range(turns):
        one = seconds_of(lambda: [few() for _ in range(large // small)])
        ratios.append(seconds_of(many) / one)
        if sum(1.0 + math.log(ratio) / math.log(large / small) <= bound for ratio in ratios) > turns // 2:
            break
    return 1.0 + math.log(statistics.median(ratios)) / math.log(large / small)


def rounds(times: int, dock: bool) -> MissionSpec:
    """A robot that drives out and back so many times, and recharges at the dock after each."""
    inner: list[dict[str, Any]] = [{"drive": {"to": "end"}}, {"drive": {"to": "dock"}}]
    inner += [{"dock": {"recharge": {"until": 0.9}}}] if dock else []
    machine = simple(batteries__main={"capacity": "20 Wh" if dock else "20 MWh"})
    segments = [{"repeat": {"times": times, "segments": inner}}]
    return load({"segments": segments, "start": "dock", "defaults": {"speed": 1.0}}, machine, PLACES)


@pytest.mark.long
def test_charger_visits_cost_the_same_each() -> None:
    missions = {times: rounds(times, True) for times in (25, 200)}
    growth = exponent(25, 200, lambda times: lambda: simulate(missions[times]), 1.1, turns=9)
    print(f"time over charger visits: exponent {growth:.2f}")
    assert growth <= 1.1


@pytest.mark.long
def test_segments_and_their_tables_cost_the_same_each(tmp_path: Path) -> None:
    missions = {times: rounds(times, False) for times in (125, 1000)}

    def work(times: int) -> Callable[[], object]:
        return lambda: write_results(simulate(missions[times]), tmp_path / str(times))

    growth = exponent(125, 1000, work, 1.1)
    print(f"time over segments, run and tables: exponent {growth:.2f}")
    assert growth <= 1.1


def test_tables_beside_a_bare_writer(tmp_path: Path, in_turns: InTurns) -> None:
    """All files of a run, computed, checked and renamed, against the bare writer of the standard library."""
    result = simulate(rounds(500, False))
    made = tables(result)

    def bare() -> None:
        for name, table in made.items():
            with (tmp_path / f"{name}.csv").open("w", newline="", encoding="utf-8") as handle:
                csv.writer(handle).writerows(zip(*table.values(), strict=True))

    ours, theirs = in_turns(lambda: write_results(result, tmp_path / "ours"), bare, 4.0)
    print(f"files of a run take {ours / theirs:.1f} times as long as a bare writer of their cells")
    assert ours / theirs <= 4.0


def test_alternatives_share_what_they_can(root: Path, in_turns: InTurns) -> None:
    """100 alternatives take less than 100 runs, each with its own files read."""
    path = root / "missions/pioneer3dx/corridor_forward_motion_50cm_s.yaml"
    alternatives = [Alternative("baseline"), *varied([("defaults.speed", [0.3 + 0.001 * i for i in range(99)])])]
    count = len(alternatives)
    together, alone = in_turns(
        lambda: run_alternatives(path, alternatives),
        lambda: simulate(load_mission(path, [("defaults.speed", 0.4)])),
        count / 1.8,
    )
    together /= count
    print(f"an alternative {together * 1e3:.1f} ms, alone {alone * 1e3:.1f} ms: {alone / together:.1f} times faster")
    assert alone / together >= 1.8


def test_a_run_passes_through_few_functions(tmp_path: Path) -> None:
    mission = load_mission(patrol.write(tmp_path))
    simulate(mission)
    profile = cProfile.Profile()
    profile.runcall(simulate, mission)
    passed = [name for name in pstats.Stats(profile).stats if "missionsim" in name[0]]  # type: ignore[attr-defined]
    everything = len(pstats.Stats(profile).stats)  # type: ignore[attr-defined]
    print(f"{len(passed)} functions of ours, {everything} with all libraries")
    assert 50 < len(passed) <= 150
    assert everything <= 285


def test_cost_grows_with_events_not_with_simulated_time(tmp_path: Path, in_turns: InTurns) -> None:
    (tmp_path / "short").mkdir()
    (tmp_path / "long").mkdir()
    short = load_mission(patrol.write(tmp_path / "short"))
    long = load_mission(patrol.write(tmp_path / "long", scale=100.0))
    a, b = simulate(short), simulate(long)
    assert b.duration_s > 90.0 * a.duration_s
    assert len(a.timeline) == len(b.timeline)
    more, less = in_turns(lambda: simulate(long), lambda: simulate(short), 1.5)
    ratio = more / less
    print(f"a mission 100 times longer costs {ratio:.2f} times as much")
    assert ratio < 1.5


def test_cost_of_an_event_within_ten_bare_timeouts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_turns: InTurns
) -> None:
    patrol.write(tmp_path)
    bursts = 10_000
    path = tmp_path / "bursts.yaml"
    path.write_text(
        "kind: mission\nname: bursts\nrobot: robot.yaml\n"
        f"segments:\n  - wait: {{duration: {bursts} s}}\n"
        "activities:\n  - {component: c1, every: 1 s, duration: 0.5 s}\n"
    )
    mission = load_mission(path)
    steps = 0
    original = simpy.Environment.step

    def counted(env: simpy.Environment) -> None:
        nonlocal steps
        steps += 1
        original(env)

    with monkeypatch.context() as patch:
        patch.setattr(simpy.Environment, "step", counted)
        result = simulate(mission)
    assert len(result.timeline) == 2 * bursts
    assert steps <= 2.1 * len(result.timeline)
    assert result.by_component_wh("main")["c1"] * 3600.0 == pytest.approx(bursts * 0.5 * patrol.component_power(1))

    def bare() -> None:
        env = simpy.Environment()

        def loop():  # type: ignore[no-untyped-def]
            for _ in range(steps):
                yield env.timeout(0.5)

        env.process(loop())
        env.run()

    ours, theirs = (seconds / steps for seconds in in_turns(lambda: simulate(mission), bare, 10.0))
    print(f"ours {ours * 1e6:.1f} µs an event, bare timeout {theirs * 1e6:.2f} µs, ratio {ours / theirs:.1f}")
    assert ours / theirs < 10.0


def test_samples_of_a_log_cost_the_same_each_on_line(root: Path, in_turns: InTurns) -> None:
    """The on-line predictor's memory and work do not grow while a mission runs."""
    mission = load_mission(root / "missions/khepera3/tunnel_inspection.yaml")

    def feed(samples: int) -> int:
        time_s = 0.05 * np.arange(samples)
        columns = {"time_s": time_s, "power_robot_w": 4.0 + np.sin(time_s), "speed_m_s": np.full(samples, 0.1)}
        return len(list(OnlinePredictor.from_mission(mission).feed(columns, every_s=1.0)))

    assert feed(3_000) == 151
    most, parts = in_turns(lambda: [feed(24_000)], lambda: [feed(3_000) for _ in range(8)], 2.0)
    print(f"20 minutes at 20 Hz take {most / parts:.2f} times as long as 8 times 2.5 minutes")
    assert most / parts < 2.0


def test_faults_cost_the_same_each(tmp_path: Path, in_turns: InTurns) -> None:
    """Eight times the faults: 64 times the work would be quadratic."""
    paths = {count: tmp_path / f"{count}.yaml" for count in (100, 800)}
    for count, path in paths.items():
        lines = "  - drvie: {distance: 3 m}\n  - wait: {duration: 3 m}\n" * (count // 2)
        path.write_text(f"kind: mission\nname: long\nrobot: pioneer3dx\nsegments:\n{lines}", encoding="utf-8")

    def told(count: int) -> None:
        with pytest.raises(InputError) as caught:
            load_mission(paths[count])
        assert len(caught.value.faults) == count

    many, few = in_turns(lambda: told(800), lambda: told(100), 24.0)
    print(f"800 faults are told in {many / few:.1f} times the time of 100")
    assert many / few < 24.0


def test_a_table_of_speeds_costs_little_more_than_a_point() -> None:
    """Watts of a control loop: the fixed cost of an evaluation outweighs the first thousand points."""
    rover = PowerPredictor("rover_tx2")

    def seconds(points: int) -> float:
        speeds, clocks = np.linspace(0.5, 5.0, points), np.full(points, 1.2672e9)
        return min(seconds_of(lambda: [rover.power(speeds, clocks, 0.6) for _ in range(5)]) for _ in range(15)) / 5

    few, many, most = (seconds(points) for points in (12, 2_052, 20_412))
    print(f"12 points {few * 1e3:.2f} ms; 2,052 take {many / few:.2f} times as long, 20,412 {most / few:.1f} times")
    assert many < 4.0 * few
    assert most < 30.0 * few
