"""Monte Carlo: one physics, the same bits for any workers, resumable, with the error of its own answers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionsim.cli.app import run_command
from missionsim.engine.simulate import simulate
from missionsim.uncertainty.answers import capacity_needed, proportion_interval, quantile_ranks
from missionsim.uncertainty.batch import Task, paired_difference, prepare
from missionsim.uncertainty.draws import simulate_block, simulate_run, unread_values
from missionsim.uncertainty.store import BlockStore

ROOT = Path(__file__).resolve().parents[2]
MISSIONS = [p for p in sorted((ROOT / "missions").glob("*/*.yaml")) if "kind: mission" in p.read_text("utf-8")]
PATROL = str(ROOT / "missions/pioneer3dx/valve_patrol_as_driven.yaml")
FEEDBACK = str(ROOT / "missions/pioneer3dx/infeasible.yaml")


def numbers(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.asarray(v, dtype=float) for name, v in columns.items() if v.dtype != object}


def assert_agree(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    ours, theirs = numbers(one), numbers(other)
    assert ours.keys() == theirs.keys()
    for name in ours:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("path", MISSIONS, ids=lambda p: p.stem)
def test_arrays_and_simpy_agree_on_shipped_missions(path: Path) -> None:
    prepared = prepare(Task(str(path), (), None, 3, "auto"))
    if prepared.arrays is None:
        assert prepared.why_not_arrays
        return
    assert_agree(
        prepared.arrays.block(3, 40, 6), simulate_block(prepared.mission, prepared.model, prepared.sampler, 3, 40, 6)
    )


ROBOT = """kind: robot
name: random_robot
body: {{mass: 20 kg, drive: differential, max_speed: 2 m/s, max_acceleration: {accel}, max_yaw_rate: 1 rad/s}}
batteries: {{main: {{capacity: {{value: {capacity} Wh, sd: 5 %}}, reserve: 10 %}}}}
motion:
  battery: main
  model: polynomial
  parameters: {{c2: {{value: 6, sd: 5 %}}, c3: {{value: 10, sd: 5 %}}, c4: 4, standing: {{value: 3, sd: 0.1}}}}
components:
  lidar: {{loads: [{{battery: main, power: {{value: 8 W, sd: 0.3 W}}}}]}}
schemes: {{follow: {{sensors: {{optional: {{lidar: 1}}}}}}}}
effects:
  - {{effect: turning_scrub, battery: main, parameters: {{k: {{value: 3, sd: 0.2}}}}}}
  - {{effect: conversion_loss, battery: main, parameters: {{k: 0.002}}}}
"""

SEGMENTS = st.one_of(
    st.tuples(st.floats(0.5, 80.0), st.floats(0.1, 1.5), st.floats(0.0, 0.2), st.integers(0, 1)).map(
        lambda t: (
            f"  - drive: {{distance: {{value: {t[0]:.3f} m, sd: 2 %}}, speed: {{value: {t[1]:.3f} m/s, sd: 3 %}}, "
            f"behaviour: {{path_stretch: {{value: {1 + t[2]:.3f}, sd: 0.01}}}}, sensors: {{lidar: {t[3]}}}}}"
        )
    ),
    st.floats(1.0, 300.0).map(
        lambda s: f"  - wait: {{duration: {{value: {s:.2f} s, low: {0.9 * s:.2f} s, high: {1.2 * s:.2f} s}}}}"
    ),
    st.floats(10.0, 180.0).map(lambda a: f"  - turn: {{angle: {a:.1f} deg}}"),
    st.tuples(st.floats(0.5, 5.0), st.floats(10.0, 90.0)).map(
        lambda t: f"  - arc: {{radius: {t[0]:.2f} m, angle: {t[1]:.1f} deg, speed: {{value: 0.4 m/s, sd: 2 %}}}}"
    ),
)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(SEGMENTS, min_size=1, max_size=7),
    st.sampled_from(["0.3 m/s^2", "{value: 0.5 m/s^2, sd: 4 %}"]),
    st.sampled_from([1.0, 500.0]),
    st.integers(0, 10**6),
)
def test_arrays_and_simpy_agree_on_random_missions(
    tmp_path: Path, segments: list[str], accel: str, capacity: float, seed: int
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT.format(accel=accel, capacity=capacity), encoding="utf-8")
    text = "kind: mission\nname: random\nrobot: robot.yaml\ndefaults: {speed: 0.5 m/s, scheme: follow}\nsegments:\n"
    path = tmp_path / "mission.yaml"
    path.write_text(text + "\n".join(segments) + "\n", encoding="utf-8")
    prepared = prepare(Task(str(path), (), None, seed, "auto"))
    assert prepared.arrays is not None or prepared.why_not_arrays
    if prepared.arrays is not None:
        assert_agree(
            prepared.arrays.block(seed, 0, 4),
            simulate_block(prepared.mission, prepared.model, prepared.sampler, seed, 0, 4),
        )


def test_one_run_alone_is_the_run_of_the_batch() -> None:
    prepared = prepare(Task(PATROL, (), None, 11, "auto"))
    assert prepared.arrays is not None
    block = prepared.arrays.block(11, 0, 800)
    drawn, result, _ = simulate_run(prepared.mission, prepared.model, prepared.sampler, 11, 731)
    assert all(block[f"drawn:{name}"][731] == value for name, value in drawn.items())
    assert block["energy_robot_wh"][731] == pytest.approx(result.batteries["robot"].energy_wh, rel=1e-9)
    assert len(result.timeline) > 1


def test_another_uncertain_value_changes_no_other_draw() -> None:
    plain = prepare(Task(PATROL, (), None, 5, "auto")).sampler.draw(5, 0, 50)
    more = prepare(
        Task(PATROL, (("robot.components.kinect.loads.0.power", "{value: 2.82 W, sd: 0.1 W}"),), None, 5, "auto")
    )
    drawn = more.sampler.draw(5, 0, 50)
    assert len(drawn) == len(plain) + 1
    assert all(np.array_equal(drawn[name], values) for name, values in plain.items())


def files(folder: Path) -> dict[str, bytes]:
    """Content by name; without hidden files, the remains of blocks that were being written."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.startswith("."))
    return {str(p.relative_to(folder)): p.read_bytes() for p in found}


def batch(out: Path, *more: str, runs: int = 400) -> int:
    command = ["montecarlo", PATROL, "--runs", str(runs), "--seed", "9", "--out", str(out), "--quiet", *more]
    return run_command(command)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Files of a batch that one process computed without interruption."""
    folder = tmp_path_factory.mktemp("whole") / "batch"
    assert batch(folder, "--engine", "simpy") == 0
    return files(folder)


HELD = """
import time
from missionsim.cli import main
from missionsim.uncertainty.store import BlockStore
there = BlockStore.has
BlockStore.has = lambda store, first: there(store, first) and not time.sleep(600)
main()
"""
"""The command, which goes on to no more blocks when the first is there: it cannot end before it is ended."""


@pytest.mark.parametrize("ending", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.long)])
def test_an_ended_batch_resumes_to_the_same_bytes(
    tmp_path: Path, whole: dict[str, bytes], ending: signal.Signals
) -> None:
    out = tmp_path / "ended"
    command = ["montecarlo", PATROL, "--runs", "400", "--seed", "9", "--engine", "simpy", "--quiet", "--out", str(out)]
    process = subprocess.Popen(
        [sys.executable, "-c", HELD, *command, "--workers", "2"],
        start_new_session=True,
        # a shell's background job ignores Ctrl-C and hands that on
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        stderr=subprocess.PIPE,
        text=True,
    )
    while not list((out / "blocks").glob("runs_*.parquet")) and process.poll() is None:
        time.sleep(0.02)
    os.killpg(process.pid, ending)
    _, told = process.communicate()
    if ending == signal.SIGINT:
        assert process.returncode == 130
        assert "--resume" in told
        assert "Traceback" not in told
    done = len(list((out / "blocks").glob("runs_*.parquet")))
    assert 0 < done < 8
    assert not (out / "summary.json").exists()
    assert batch(out, "--engine", "simpy") == 2
    assert batch(out, "--engine", "simpy", "--resume") == 0
    assert files(out) == whole


@pytest.mark.long
def test_a_lost_worker_process_is_replaced(tmp_path: Path, whole: dict[str, bytes]) -> None:
    import psutil

    def strike() -> None:
        while not list((tmp_path / "out" / "blocks").glob("runs_*.parquet")):
            time.sleep(0.02)
        workers = [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]
        workers[0].kill()

    killer = threading.Thread(target=strike, daemon=True)
    killer.start()
    assert batch(tmp_path / "out", "--engine", "simpy", "--workers", "2") == 0
    killer.join(timeout=120)
    assert not killer.is_alive()
    assert files(tmp_path / "out") == whole


def test_json_follows_the_contract(tmp_path: Path) -> None:
    target = tmp_path / "answer.json"
    assert run_command(["montecarlo", PATROL, "--runs", "400", "--seed", "7", "--quiet", "--json", str(target)]) == 0
    answer = json.loads(target.read_text(encoding="utf-8"))
    assert answer["schema"] == "missionsim.montecarlo/1"
    assert answer["runs"] == 400
    assert answer["engine"] == "arrays"
    assert 0.0 <= answer["p_feasible"]["low"] <= answer["p_feasible"]["value"] <= answer["p_feasible"]["high"] <= 1.0
    energy = answer["batteries"]["laptop"]["energy_wh"]
    assert energy["q05"] < energy["q50"] < energy["q95"]
    for row in answer["importance"]:
        assert {"parameter", "battery", "first", "total", "first_interval", "total_interval"} <= row.keys()
        low, high = row["total_interval"]
        assert low <= row["total"] <= high
        assert row["first"] < row["total"] + 0.1
    assert set(answer["batteries"]["robot"]["by_component_wh"]) >= {"motors", "controller"}
    assert answer["unread"] == answer["chance"] == []


def test_until_stops_early_and_only_runs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "until"
    assert batch(out, "--engine", "simpy", "--until", "0.05", runs=100_000) == 0
    assert 0 < len(BlockStore(out).firsts()) < 10
    assert run_command(["montecarlo", PATROL, "--seed", "9", "--only", "3", "--json", "-"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert alone["run"] == 3
    assert run_command(["montecarlo", PATROL, "--seed", "9", "--only", "3", "--quiet", "--out", str(out)]) == 0
    assert json.loads((out / "run_000000003" / "drawn.json").read_text(encoding="utf-8")) == alone["drawn"]
    assert len(list((out / "run_000000003").glob("*.csv"))) > 2
    assert alone["drawn"]["robot.motion.parameters.c3"] == BlockStore(out).column("drawn:robot.motion.parameters.c3")[3]


def test_failures_are_told_where_and_when(tmp_path: Path) -> None:
    target = tmp_path / "answer.json"
    assert run_command(["montecarlo", FEEDBACK, "--runs", "30", "--quiet", "--json", str(target)]) == 0
    answer = json.loads(target.read_text(encoding="utf-8"))
    assert answer["engine"] == "simpy"
    assert answer["p_feasible"]["value"] == 0.0
    assert answer["failures"]["empty"][0]["battery"] == "laptop"
    assert answer["failures"]["empty"][0]["share"] == 1.0


def test_a_failing_run_is_kept_with_its_draws_and_its_message(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(
        "kind: robot\nname: sometimes\nbody: {mass: 20 kg, drive: differential, max_speed: 2 m/s}\n"
        "batteries: {main: {capacity: 100 Wh, reserve: 10 %}}\n"
        "motion: {battery: main, model: expression, power: 'log(gain)*speed_m_s', standing: '1.0', "
        "parameters: {gain: {value: 3, distribution: {kind: discrete, values: [3, -1], weights: [0.75, 0.25]}}}}\n",
        encoding="utf-8",
    )
    path = tmp_path / "mission.yaml"
    path.write_text(
        "kind: mission\nname: sometimes\nrobot: robot.yaml\nsegments:\n  - drive: {distance: 20 m, speed: 0.4 m/s}\n",
        encoding="utf-8",
    )
    target = tmp_path / "answer.json"
    out = str(tmp_path / "out")
    options = ["--runs", "60", "--engine", "simpy", "--out", out, "--quiet", "--json", str(target)]
    assert run_command(["montecarlo", str(path), *options]) == 0
    store = BlockStore(tmp_path / "out")
    gain, messages = store.column("drawn:robot.motion.parameters.gain"), store.column("message")
    assert 5 < np.count_nonzero(gain < 0.0) < 30
    assert all(bool(message) == (value < 0.0) for message, value in zip(messages, gain, strict=True))
    assert messages[gain < 0.0][0].startswith("failed: ")
    answer = json.loads(target.read_text(encoding="utf-8"))
    assert answer["p_feasible"]["value"] == pytest.approx(np.mean(gain > 0.0))
    assert answer["batteries"]["main"]["p_reserve"]["value"] == pytest.approx(np.mean(gain > 0.0))
    assert answer["failures"]["reasons"][0]["share"] == pytest.approx(np.mean(gain < 0.0))


@pytest.mark.parametrize("bad", [0.0, -0.3, np.nan])
def test_draws_that_cannot_be_evaluated_are_given_back_to_simpy(bad: float) -> None:
    prepared = prepare(Task(PATROL, (), None, 3, "auto"))
    assert prepared.arrays is not None
    draws = prepared.sampler.draw(3, 0, 6)
    draws["segments.4.drive.behaviour.speed_tracking"][2] = bad
    columns, again = prepared.arrays.evaluate(draws, 6)
    assert again.tolist() == [False, False, True, False, False, False]
    assert np.isfinite(columns["charge_robot_wh"][~again]).all()


def test_capacity_needed_is_the_deepest_discharge_between_chargings(tmp_path: Path) -> None:
    path = str(ROOT / "missions/pioneer3dx/recharging_patrol.yaml")
    prepared = prepare(Task(path, (), None, 1, "simpy"))
    block = simulate_block(prepared.mission, prepared.model, prepared.sampler, 1, 0, 1)
    kept = block["charge_laptop_wh"][0]
    assert block["charge_left_laptop_wh"][0] > kept[0]
    assert 0.0 < kept[0] - kept.min() <= block["needed_laptop_wh"][0] + 1e-9 < block["energy_laptop_wh"][0]


@pytest.mark.parametrize("policy", ["stop", "return_to_dock"])
def test_capacity_needed_is_that_of_the_whole_mission_also_where_runs_are_cut_short(policy: str) -> None:
    """Runs that end early say what the whole would have taken, as runs with a large battery do."""
    needed = {}
    for capacity in ("1 Wh", "4000 Wh"):
        overrides = (("robot.batteries.robot.capacity", capacity), ("policy.on_empty", policy))
        overrides += (("policy.dock", "dock"),) if policy == "return_to_dock" else ()
        prepared = prepare(Task(PATROL, overrides, None, 5, "simpy"))
        block = simulate_block(prepared.mission, prepared.model, prepared.sampler, 5, 0, 8)
        assert block["feasible"].any() == (capacity == "4000 Wh")
        needed[capacity] = {name: block[f"needed_{name}_wh"] for name in ("robot", "laptop")}
    for name in ("robot", "laptop"):
        np.testing.assert_allclose(needed["1 Wh"][name], needed["4000 Wh"][name], rtol=1e-9)


def test_capacity_needed_is_not_given_where_too_many_runs_have_no_end() -> None:
    needs = np.arange(1000.0)
    assert capacity_needed(needs)["value"] == pytest.approx(989.01)
    needs[::200] = np.nan  # 5 of 1000: they count as above all others
    assert capacity_needed(needs)["value"] > 990.0
    needs[::50] = np.nan
    assert capacity_needed(needs)["value"] is None


@pytest.mark.parametrize(
    "arguments",
    [["--runs", "0"], ["--workers", "0"], ["--until", "2"], ["--only", "-1"], ["--sobol", "100"], ["--resume"]],
)
def test_wrong_options_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["montecarlo", PATROL, *arguments]) == 2
    assert arguments[0] in capsys.readouterr().err


def test_arrays_are_refused_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(ROOT / "missions/pioneer3dx/recharging_patrol.yaml")
    assert run_command(["montecarlo", path, "--engine", "arrays", "--runs", "5"]) == 2
    assert "cannot be evaluated as arrays" in capsys.readouterr().err


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(20)
    covered_p = covered_q = 0
    for _ in range(1000):
        good = int(rng.binomial(400, 0.93))
        low, high = proportion_interval(good, 400)
        covered_p += low <= 0.93 <= high
        ordered = np.sort(rng.exponential(size=400))
        below, above = quantile_ranks(400, 0.95)
        covered_q += ordered[below] <= -np.log(0.05) <= ordered[above]
    assert 920 <= covered_p <= 980
    assert 920 <= covered_q <= 980


def test_alternatives_share_their_draws_and_differences_are_judged(tmp_path: Path) -> None:
    target = tmp_path / "answer.json"
    same, slower = "robot.body.mass=25 kg,26 kg", "segments.0.drive.speed=0.46 m/s,0.3 m/s"
    for vary, real in ((same, False), (slower, True)):
        command = ["whatif", PATROL, "--vary", vary, "--montecarlo", "300", "--quiet", "--json", str(target)]
        assert run_command(command) == 0
        rows = json.loads(target.read_text(encoding="utf-8"))["montecarlo"]["alternatives"]
        energy = {d["quantity"]: d for d in rows[-1]["differences"]}["energy_robot_wh"]
        assert energy["real"] is real
        assert energy["low"] <= energy["mean"] <= energy["high"]


def test_paired_intervals_cover_the_true_difference() -> None:
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(400):
        common = rng.normal(size=60)
        found = paired_difference("x", common, common + 0.3 + rng.normal(size=60))
        assert found is not None
        covered += found["low"] <= 0.3 <= found["high"]
    assert 368 <= covered <= 392


def test_a_dask_cluster_gives_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None, silence_logs=50) as cluster:
        assert batch(tmp_path / "there", "--engine", "simpy", "--scheduler", cluster.scheduler_address) == 0
    assert files(tmp_path / "there") == whole


@pytest.mark.long
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_bytes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        victim = next(iter(cluster.workers.values())).pid

        def strike() -> None:
            while len(list((tmp_path / "there" / "blocks").glob("runs_*.parquet"))) < 2:
                time.sleep(0.02)
            os.kill(victim, signal.SIGKILL)

        killer = threading.Thread(target=strike, daemon=True)
        killer.start()
        assert batch(tmp_path / "there", "--engine", "simpy", "--scheduler", cluster.scheduler_address) == 0
        killer.join(timeout=120)
        assert not killer.is_alive()
    assert files(tmp_path / "there") == whole


@pytest.mark.long
def test_no_scheduler_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("missionsim.cli.montecarlo.SCHEDULER_WAIT_S", 1)
    assert batch(tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


DRAWN_EVERYWHERE = """kind: robot
name: everywhere
body: {mass: {value: 20 kg, sd: 5 %}, drive: differential, max_speed: 2 m/s,
  regeneration: {value: 50 %, low: 30 %, high: 70 %}}
batteries:
  main:
    capacity: {value: 50 Wh, sd: 5 %}
    model: {kind: constant_energy, ageing: {value: 0.9, low: 0.8, high: 1.0}}
    reserve: 10 %
motion: {battery: main, model: polynomial, parameters: {c2: {value: 6, sd: 5 %}, c3: 10, c4: 4}}
links: {usb: {battery: main, efficiency: {value: 0.8, sd: 3 %}}}
components:
  board: {always_on: true, units: 3, loads: [{battery: main, power: {value: 2 W, sd: 5 %}}]}
  lidar: {loads: [{battery: main, through: usb, power: {value: 8 W, sd: 5 %}}]}
schemes: {follow: {sensors: {optional: {lidar: 1}}}}
effects:
  - {effect: grade, battery: main, parameters: {k: {value: 1.0, sd: 5 %}}}
  - {effect: temperature_friction, battery: main, parameters: {k: 0.3}}
"""


def test_every_value_drawn_is_used_and_at_its_nominal_value_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(DRAWN_EVERYWHERE, encoding="utf-8")
    path = tmp_path / "mission.yaml"
    path.write_text(
        "kind: mission\nname: hills\nrobot: robot.yaml\n"
        "defaults: {speed: 0.5 m/s, scheme: follow, sensors: {lidar: 1}, temperature: {value: 5 degC, sd: 4 K}}\n"
        "segments:\n  - drive: {distance: 30 m, slope: 8 %}\n  - drive: {distance: 30 m, slope: -25 %}\n",
        encoding="utf-8",
    )
    prepared = prepare(Task(str(path), (), None, 5, "auto"))
    assert len(prepared.sampler.values) == 10
    [cold] = [value for value in prepared.sampler.values if value.name == "defaults.temperature"]
    assert (cold.nominal, cold.distribution.sd) == (pytest.approx(5.0), pytest.approx(4.0))
    assert unread_values(prepared.mission, prepared.model, prepared.sampler) == ()
    plain = simulate(prepared.mission)
    for value in prepared.sampler.values:
        same = simulate(prepared.mission, values={value.name: value.nominal})
        other = simulate(prepared.mission, values={value.name: 1.05 * value.nominal})
        for energy in ("energy_wh", "charge_left_wh"):
            before, after = (getattr(result.batteries["main"], energy) for result in (plain, same))
            assert after == pytest.approx(before, rel=1e-13), value.name
        moved = other.batteries["main"].charge_left_wh - plain.batteries["main"].charge_left_wh
        assert abs(moved) > 1e-6, value.name
    assert prepared.arrays is not None, prepared.why_not_arrays
    assert_agree(
        prepared.arrays.block(5, 0, 6), simulate_block(prepared.mission, prepared.model, prepared.sampler, 5, 0, 6)
    )


def test_a_value_that_nothing_reads_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    unused = ["--set", "robot.schemes.image_analysis.max_speed={value: 0.3 m/s, sd: 5 %}"]
    assert run_command(["montecarlo", PATROL, "--runs", "30", *unused]) == 0
    assert "robot.schemes.image_analysis.max_speed" in capsys.readouterr().err
