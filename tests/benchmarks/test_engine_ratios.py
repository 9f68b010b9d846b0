"""Cost of the engine as ratios of two things measured in one run."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import simpy

from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from tests.benchmarks import patrol

pytestmark = pytest.mark.benchmark_ratio


def cpu_seconds(function: Callable[[], object], times: int) -> float:
    """Least processor time of several calls: what else the machine does can only add."""
    best = float("inf")
    for _ in range(times):
        begin = time.process_time()
        function()
        best = min(best, time.process_time() - begin)
    return best


def test_hundred_times_faster_than_polling_at_10_hz(tmp_path: Path) -> None:
    mission = load_mission(patrol.write(tmp_path))
    result = simulate(mission)
    polled = patrol.polling_script()
    # the two simulate the same thing: polling misses the exact result by its step, not by more
    exact = sum(float(sum(result.by_component_wh(b).values())) for b in ("main", "aux")) * 3600.0
    assert sum(polled.energy_j) == pytest.approx(exact, rel=0.01)
    assert len(result.segments) == 40
    assert len(result.timeline) >= 100
    assert len(result.energies["main"]) + len(result.energies["aux"]) >= patrol.COMPONENTS + 3
    ours = cpu_seconds(lambda: simulate(mission, trace=True), 20)
    theirs = cpu_seconds(patrol.polling_script, 2)
    print(
        f"polling {theirs * 1e3:.0f} ms, ours {ours * 1e3:.2f} ms, ratio {theirs / ours:.0f}, "
        f"{result.duration_s:.0f} s simulated"
    )
    assert theirs / ours >= 100.0


def test_cost_grows_with_events_not_with_simulated_time(tmp_path: Path) -> None:
    (tmp_path / "short").mkdir()
    (tmp_path / "long").mkdir()
    short = load_mission(patrol.write(tmp_path / "short"))
    long = load_mission(patrol.write(tmp_path / "long", scale=100.0))
    a, b = simulate(short), simulate(long)
    assert b.duration_s > 90.0 * a.duration_s
    assert len(a.timeline) == len(b.timeline)
    ratio = cpu_seconds(lambda: simulate(long), 20) / cpu_seconds(lambda: simulate(short), 20)
    print(f"a mission 100 times longer costs {ratio:.2f} times as much")
    assert ratio < 1.5


def test_cost_of_an_event_within_ten_bare_timeouts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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

    ours, theirs = cpu_seconds(lambda: simulate(mission), 4) / steps, cpu_seconds(bare, 5) / steps
    print(f"ours {ours * 1e6:.1f} µs an event, bare timeout {theirs * 1e6:.2f} µs, ratio {ours / theirs:.1f}")
    assert ours / theirs < 10.0
