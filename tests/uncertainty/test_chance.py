"""What a mission leaves to chance: obstacles, relocalisations that fail, inspections done again."""

from __future__ import annotations

import numpy as np
import pytest

from missionsim.engine.simulate import simulate
from missionsim.inputs.loading import load_mission
from missionsim.inputs.mission import MissionSpec
from missionsim.plan.build import make_plan
from missionsim.uncertainty.answers import rank_importance
from missionsim.uncertainty.batch import Prepared, Task, prepare
from missionsim.uncertainty.draws import left_to_chance, simulate_block, simulate_run

SPACING_M, STOP_S, FAILURE, AGAIN_S, REPEAT = 20.0, 8.0, 0.3, 5.0, 0.25

MISSION = f"""kind: mission
name: by_chance
robot: pioneer3dx
defaults:
  scheme: forward_motion
  speed: 0.5 m/s
  sensors: {{laser: 1}}
  behaviour:
    obstacle_spacing: {SPACING_M} m
    obstacle_stop: {STOP_S} s
    relocalisation_failure: {FAILURE}
    relocalisation_time: {AGAIN_S} s
segments:
  - drive: {{distance: 100 m}}
  - repeat:
      times: 2
      segments:
        - inspect: {{duration: 10 s, scheme: image_analysis, sensors: {{kinect: 1}}, repeat_probability: {REPEAT}}}
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("chance") / "mission.yaml"
    file.write_text(MISSION, encoding="utf-8")
    return str(file)


@pytest.fixture(scope="module")
def mission(path: str) -> MissionSpec:
    return load_mission(path)


@pytest.fixture(scope="module")
def prepared(path: str) -> Prepared:
    return prepare(Task(path, (), None, 6, "auto"))


def test_chance_goes_to_simpy_also_inside_repeats(path: str, prepared: Prepared) -> None:
    assert prepared.arrays is None
    assert "inspections_repeated" in prepared.why_not_arrays
    only_inside = Task(path, (("defaults.behaviour", "{}"),), None, 6, "auto")
    assert "inspections_repeated" in prepare(only_inside).why_not_arrays


def test_counts_follow_their_distributions(mission: MissionSpec) -> None:
    rng = np.random.default_rng(4)
    plans = [make_plan(mission, rng=rng) for _ in range(1000)]
    found = {name: np.array([dict(plan.chance)[name] for plan in plans]) for name in dict(plans[0].chance)}
    obstacles = found["obstacles"]
    assert obstacles.mean() == pytest.approx(100.0 / SPACING_M, abs=4 * np.sqrt(5.0 / 1000))
    assert obstacles.var() == pytest.approx(5.0, rel=0.15)
    assert found["relocalisations_failed"].mean() == pytest.approx(FAILURE / (1 - FAILURE), rel=0.15)
    assert found["inspections_repeated"].mean() == pytest.approx(2 * REPEAT / (1 - REPEAT), rel=0.12)


def test_stops_add_time_but_no_way(mission: MissionSpec) -> None:
    plain = make_plan(mission)
    for seed in range(20):
        plan = make_plan(mission, rng=np.random.default_rng(seed))
        assert sum(leg.distance_m for leg in plan.legs) == pytest.approx(100.0, rel=1e-12)
        stands = [leg for leg in plan.legs if leg.kind == "stand"]
        counts = dict(plan.chance)
        failed = counts["relocalisations_failed"]
        assert len(stands) == 2 + counts["obstacles"] + (failed > 0)
        assert sum(leg.first for leg in plan.legs) == sum(leg.last for leg in plan.legs) == len(plan.segments)
        again = simulate(mission, plan=plan)
        assert again.duration_s >= simulate(mission, plan=plain).duration_s
        assert again.distance_m == pytest.approx(100.0, rel=1e-9)


def test_what_chance_did_is_stored_and_a_run_alone_repeats_it(prepared: Prepared) -> None:
    whole = simulate_block(prepared.mission, prepared.model, prepared.sampler, 6, 0, 8)
    part = simulate_block(prepared.mission, prepared.model, prepared.sampler, 6, 5, 3)
    assert set(left_to_chance(prepared.mission)) == {
        "chance.obstacles",
        "chance.relocalisations_failed",
        "chance.inspections_repeated",
    }
    for name in left_to_chance(prepared.mission):
        assert np.array_equal(whole[f"drawn:{name}"][5:], part[f"drawn:{name}"])
    drawn, result, _ = simulate_run(prepared.mission, prepared.model, prepared.sampler, 6, 7)
    assert drawn["chance.obstacles"] == whole["drawn:chance.obstacles"][7]
    assert result.batteries["robot"].energy_wh == whole["energy_robot_wh"][7]


def test_without_a_generator_nothing_happens_by_chance(mission: MissionSpec) -> None:
    plan = make_plan(mission)
    assert plan.chance == ()
    assert [leg.kind for leg in plan.legs] == ["roll", "stand", "stand"]


def test_rank_correlation_of_counts_is_spearmans_with_ties() -> None:
    from scipy.stats import spearmanr

    rng = np.random.default_rng(1)
    counts = rng.poisson(1.5, size=400).astype(float)
    energy = counts + rng.normal(size=400)
    [row] = rank_importance([("chance.obstacles", counts)], {"robot": energy})
    assert row["rank_correlation"] == pytest.approx(float(spearmanr(counts, energy).statistic), rel=1e-12)
