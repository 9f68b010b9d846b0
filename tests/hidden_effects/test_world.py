"""The little world is sound: what was asked is planted, the same seed gives the same bits, the logs are valid."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from . import features, known, peers, truth
from .judge import judge
from .meter import Rows
from .motion import ROBOTS, STEP_S
from .peers import Outcome
from .planned import EXECUTION
from .plant import INSIDE, OUTSIDE
from .score import Task, score_task
from .study import ALL_CASES
from .world import experiment, make, write

POWER_CASES = [name for name in ALL_CASES if name.endswith("-5pct") or name.startswith(("two-g", "outside-"))]
HERE = Path(__file__).parent


def energy_share(world, effect: str) -> float:
    """Share of an effect in the training runs, from what a perfect meter shows."""
    runs = [world.truth[name] for name in world.train]
    part = sum(float(np.sum(np.abs(r[f"hidden:{effect}"]) * r["seconds"])) for r in runs)
    return part / sum(float(np.sum(r["power"] * r["seconds"])) for r in runs)


def test_every_effect_of_the_library_and_six_others_are_planted():
    hidden = {e.split(":")[0] for case in ALL_CASES.values() for e in case.hidden}
    assert hidden == {*INSIDE, *OUTSIDE, *EXECUTION}


@pytest.mark.parametrize("name", [n for n in POWER_CASES if not n.startswith("execution")])
def test_planted_share_is_the_asked_share(name):
    world = make(replace(ALL_CASES[name], noise_level=1), 5)
    for effect in world.case.hidden:
        # rows see signed means, so effects that change sign within a row lose a little
        assert energy_share(world, effect) == pytest.approx(world.case.share, rel=0.03)


def test_same_seed_same_bits_and_other_seed_other_world():
    case = ALL_CASES["grade-5pct"]
    first, again, other = make(case, 7), make(case, 7), make(case, 8)
    for run, log in first.train.items():
        for column, values in log.items():
            np.testing.assert_array_equal(values, again.train[run][column])
    assert not np.array_equal(first.train["run_00"]["power_robot_w"][:50], other.train["run_00"]["power_robot_w"][:50])


@pytest.mark.long
@pytest.mark.parametrize("name", ["nothing-pioneer3dx-level2", "turning_scrub-2pct", "two-grade-payload"])
def test_oracle_names_what_was_planted_and_nothing_else(name):
    world = make(ALL_CASES[name], 7, candidates=True)
    assert set(known.named(world).names) == set(world.case.hidden)


@pytest.mark.long
def test_covariance_of_the_oracle_is_that_of_the_noise():
    world = make(ALL_CASES["nothing-pioneer3dx-level2"], 7, candidates=True)
    white = []
    for run in world.truth.values():
        factor = known.factor_of(run, 2, ROBOTS["pioneer3dx"].meter_offset_w)
        white.append(linalg.solve_triangular(factor, run["measured"] - run["power"], lower=True))
    assert np.std(np.concatenate(white)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("name", ["nothing-energy", "nothing-voltage-current", "nothing-10hz", "cpu_frequency-5pct"])
def test_logs_have_the_columns_of_the_contract(name, tmp_path):
    folder = write(make(ALL_CASES[name], 2), tmp_path)
    files = sorted((folder / "train").glob("*.csv"))
    assert len(files) == 8
    assert len(list((folder / "heldout").glob("*.csv"))) == 3
    log = features.read_log(files[0])
    t = np.asarray(log["time_s"], dtype=float)
    assert np.all(np.diff(t) > 0.0)
    assert {"speed_m_s", "yaw_rate_rad_s", "slope_rad", "payload_kg", "surface", "on_kinect", "on_laser"} <= set(log)
    power = features.measured_power(log)
    assert np.all(np.isfinite(power))
    assert 5.0 < np.mean(power) < 25.0
    for column, values in log.items():
        if np.asarray(values).dtype.kind == "f":
            assert np.all(np.isfinite(values)), column
    if name == "nothing-energy":
        assert np.all(np.diff(log["energy_robot_wh"]) >= 0.0)
    answer = json.loads((folder / "answer.json").read_text())
    assert answer["hidden"] == list(ALL_CASES[name].hidden)


@pytest.mark.long
def test_nothing_hidden_is_the_base_model_within_its_prior():
    """The recalibrated base explains a level-1 world down to its noise: no effect lurks in 'nothing'."""
    for robot in ROBOTS:
        case = replace(ALL_CASES[f"nothing-{robot}-level1"], name="null")
        world = make(case, 11)
        x = np.concatenate([np.column_stack([v for k, v in r.items() if "base:" in k]) for r in world.truth.values()])
        y = np.concatenate([r["power"] for r in world.truth.values()])
        fit, *_ = np.linalg.lstsq(x, y, rcond=None)
        assert np.sqrt(np.mean((y - x @ fit) ** 2)) < 1e-9 * np.mean(y)


@pytest.mark.long
def test_confounded_designs_are_confounded_and_their_heldout_runs_are_not():
    world = make(ALL_CASES["confounded-carpet_payload-payload"], 4)

    def mixed(logs):
        pairs = {(str(s), float(p) > 0) for log in logs for s, p in zip(log["surface"], log["payload_kg"], strict=True)}
        return len(pairs)

    assert mixed(world.train.values()) == 2
    held = [log for seed in range(4) for log in make(world.case, seed).heldout.values()]
    assert mixed(held) > 2
    speeds = np.concatenate(
        [x["speed_m_s"] for x in make(ALL_CASES["confounded-one_speed-aerodynamic_drag"], 4).train.values()]
    )
    cruising = speeds[speeds > 0.2]
    assert np.mean(np.abs(cruising - np.median(cruising)) < 0.03) > 0.8


def test_experiment_is_the_same_robot_with_what_was_asked():
    world = make(ALL_CASES["confounded-carpet_payload-payload"], 3)
    log = experiment(world, [{"seconds": 60, "surface": "carpet", "payload_kg": 0}, {"seconds": 60, "payload_kg": 6}])
    first = log["time_s"] < 59.0
    assert set(log["surface"][first]) == {"carpet"}
    assert set(log["payload_kg"][first]) == {0.0}
    assert set(log["payload_kg"][log["time_s"] > 61.0]) == {6.0}
    assert set(log) == set(world.train["run_00"])


def test_path_stretch_and_dwell_show_in_the_motion():
    def drives(name):
        world = make(replace(ALL_CASES[name], noise_level=1), 6)
        planned = sum(leg.distance_m for leg in world.secrets.legs)
        runs = world.train.values()
        driven = np.mean([np.sum(r["speed_m_s"] * np.gradient(r["time_s"])) for r in runs])
        return driven / planned, np.mean([r["time_s"][-1] for r in runs])

    nothing, stretched = drives("nothing-planned"), drives("execution-path_stretch-8pct")
    assert nothing[0] == pytest.approx(1.0, abs=0.01)
    assert stretched[0] == pytest.approx(1.08, abs=0.015)


def test_row_means_keep_the_energy():
    rng = np.random.default_rng(0)
    values = rng.uniform(0.0, 10.0, 1000)
    rows = Rows(np.sort(rng.uniform(0.0, 100.0, 90)), 100.0)
    assert np.sum(rows.mean(values) * (rows.right - rows.left)) == pytest.approx(np.sum(values) * STEP_S)


def test_the_world_imports_nothing_of_the_product():
    for path in HERE.glob("*.py"):
        if path.name in ("product.py", "test_quick.py", "test_world.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] == "missionsim" for n in names), path.name


@pytest.mark.long
def test_peers_find_a_loud_effect_and_trees_beat_the_nominal_model():
    pytest.importorskip("pysindy")
    rows = {row["method"]: row for row in score_task(Task("turning_scrub-10pct", 3, with_product=False))}
    assert set(rows) == {"PySINDy", "PySINDy ensemble", "LASSO, by run", "stepwise BIC", "boosted trees", "oracle"}
    assert rows["LASSO, by run"]["first_right"]
    assert rows["boosted trees"]["rmse_w"] < 0.7 * rows["boosted trees"]["nominal_rmse_w"]
    assert rows["LASSO, by run"]["oracle_rmse_w"] < rows["LASSO, by run"]["nominal_rmse_w"]


@pytest.mark.long
def test_knowing_the_truth_leaves_the_meter_alone():
    """With the true columns what remains is the meter's own noise, gain and offset."""
    world = make(replace(ALL_CASES["grade-10pct"], noise_level=1), 1)
    logs = [*world.train.values(), *world.heldout.values()]
    tables = [features.table(log, "pioneer3dx") for log in logs]
    energy, rmse = truth.oracle(tables[:8], tables[8:], truth.columns(world, logs, ["grade"], tables), "pioneer3dx")
    nominal = peers.nominal(tables[8:])
    assert rmse < 0.05 * np.mean(tables[8].measured_w)
    assert rmse < 0.5 * nominal[1]
    assert energy < nominal[0]


def answer_of(*hidden: str, **more):
    return {"hidden": list(hidden), "share_of_energy": 0.05, "design": "rich"} | more


def test_judge_counts_a_wrong_name_with_the_truth_in_its_set_as_not_confident():
    outcome = Outcome(
        "missionsim", ("payload",), sets={"payload": ("surface_rolling_resistance",)}, verdict="ambiguous"
    )
    same = ["payload", "surface_rolling_resistance"]
    row = judge("confounded-x", 0, answer_of("surface_rolling_resistance", equivalent=same), outcome)
    assert (row["first_right"], row["in_set"], row["confident_wrong"], row["honest"]) == (False, True, False, True)
    sure = judge("confounded-x", 0, answer_of("payload", equivalent=same), Outcome("missionsim", ("payload",)))
    assert (sure["first_right"], sure["honest"], sure["overconfident"]) == (True, False, True)


def test_judge_on_nothing_outside_and_recalibration():
    assert judge("nothing-0", 0, answer_of(), Outcome("m", ()))["exact"] is True
    assert judge("nothing-0", 0, answer_of(), Outcome("m", ("grade",)))["confident_wrong"] is True
    said = judge("outside-fan", 0, answer_of("fan"), Outcome("m", (), verdict="unexplained_structure"))
    assert (said["outside_said"], said["confident_wrong"]) == (True, False)
    small = answer_of("viscous_friction", shift_in_prior_sd={"viscous_friction": 2.0})
    assert judge("viscous_friction-1pct", 0, small, Outcome("m", ()))["exact"] is True
    big = answer_of("viscous_friction", shift_in_prior_sd={"viscous_friction": 8.0})
    assert judge("viscous_friction-5pct", 0, big, Outcome("m", ()))["missed"] is True
