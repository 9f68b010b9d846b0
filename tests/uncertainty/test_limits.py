"""What a draw cannot do: exceed the robot's speed, drive nowhere fast, never succeed, or ask for a run that is not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.uncertainty.batch import Task, prepare
from missionsim.uncertainty.draws import simulate_block
from tests.uncertainty.test_montecarlo import PATROL, assert_agree

ROBOT = """kind: robot
name: limited
body: {{mass: 20 kg, drive: differential, max_speed: {top}, max_acceleration: 0.5 m/s^2}}
batteries: {{main: {{capacity: 50 Wh, reserve: 10 %}}}}
motion: {{battery: main, model: polynomial, parameters: {{c2: {{value: 6, sd: 5 %}}, c3: 10, c4: 4}}}}
schemes: {{follow: {{max_speed: 0.9 m/s}}}}
"""
DRIVES = """segments:
  - drive: {distance: 30 m, speed: {value: 0.6 m/s, sd: 15 %}}
  - drive: {distance: 20 m, speed: 0.7 m/s, behaviour: {speed_tracking: {value: 1.02, sd: 5 %}}}
  - arc: {radius: {value: 0.6 m, sd: 3 %}, angle: 90 deg, speed: {value: 0.55 m/s, sd: 5 %}, yaw_rate: 1 rad/s}
  - drive: {distance: 20 m, scheme: follow}
"""


def written(folder: Path, text: str, top: str = "0.75 m/s") -> str:
    (folder / "robot.yaml").write_text(ROBOT.format(top=top), encoding="utf-8")
    path = folder / "mission.yaml"
    path.write_text(f"kind: mission\nname: limits\nrobot: robot.yaml\n{text}", encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("top", ["0.75 m/s", "{value: 0.75 m/s, sd: 2 %}"])
def test_a_drawn_speed_is_cut_to_what_the_robot_can_do_by_both_engines(tmp_path: Path, top: str) -> None:
    prepared = prepare(Task(written(tmp_path, DRIVES, top), (), None, 2, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    ours = prepared.arrays.block(2, 0, 80)
    theirs = simulate_block(prepared.mission, prepared.model, prepared.sampler, 2, 0, 80)
    assert_agree(ours, theirs)
    fastest = ours.get("drawn:robot.body.max_speed", np.full(80, 0.75))
    # a nominal tracking above 1 says by how much the file takes the greatest speed to be exceeded
    tracked = 0.7 * ours["drawn:segments.1.drive.behaviour.speed_tracking"] > 1.02 * fastest
    above = (ours["drawn:segments.0.drive.speed"] > fastest) | tracked | (1.02 * fastest < 0.7)
    assert 3 < above.sum() < 70
    assert np.array_equal(ours["speed_limited"], above)


def test_cut_speeds_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, DRIVES)
    target = tmp_path / "answer.json"
    assert run_command(["montecarlo", path, "--runs", "300", "--sobol", "0", "--json", str(target)]) == 0
    share = json.loads(target.read_text(encoding="utf-8"))["speed_limited_share"]
    assert 0.02 < share < 0.5
    assert f"in {100 * share:.3g} % of the runs a drawn speed is above" in " ".join(capsys.readouterr().out.split())


DRIVE = "segments: [{drive: {distance: 9 m}}]\n"


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        (f"behaviour: {{obstacle_spacing: 1e-9 m, obstacle_stop: 2 s}}\n{DRIVE}", 4, "an obstacle every 1e-09 m"),
        ("segments:\n  - inspect: {duration: 3 s, repeat_probability: 1}\n", 5, "0 to less than 1"),
        (f"behaviour: {{relocalisation_failure: 100 %, relocalisation_time: 2 s}}\n{DRIVE}", 4, "0 to less than 1"),
        (
            "segments:\n  - wait: {duration: 3 s}\n  - drive: {distance: 9 m, speed: {value: 0.3 m/s, distribution: "
            "{kind: empirical, file: nofile.csv, column: v}}}\n",
            6,
            "cannot read nofile.csv",
        ),
    ],
)
def test_what_can_not_be_is_refused_where_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, line: int, told: str
) -> None:
    assert run_command(["montecarlo", written(tmp_path, text), "--runs", "5"]) == 2
    error = capsys.readouterr().err
    assert f"mission.yaml:{line}" in error
    assert told in error
    assert error.count("error:") == 1
    assert "a empirical" not in error


def test_a_column_of_a_csv_that_holds_no_numbers_is_told_by_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "speeds.csv").write_text("v,w\n0.3,\n0.4,\nfast,\n", encoding="utf-8")
    for column, told in (("v", "column 'v' of speeds.csv, line 4"), ("w", "no numbers in column 'w'")):
        speed = f"{{value: 0.3 m/s, distribution: {{kind: empirical, file: speeds.csv, column: {column}}}}}"
        path = written(tmp_path, f"segments:\n  - drive: {{distance: 9 m, speed: {speed}}}\n")
        assert run_command(["montecarlo", path, "--runs", "5"]) == 2
        assert told in capsys.readouterr().err


def test_a_drawn_probability_that_is_none_is_kept_as_a_failed_run(tmp_path: Path) -> None:
    chance = "repeat_probability: {value: 90 %, distribution: {kind: normal, sd: 20 %}}"
    path = written(tmp_path, f"segments:\n  - inspect: {{duration: 3 s, {chance}}}\n")
    prepared = prepare(Task(path, (), None, 2, "auto"))
    block = simulate_block(prepared.mission, prepared.model, prepared.sampler, 2, 0, 40)
    drawn = block["drawn:segments.0.inspect.repeat_probability"]
    assert 5 < np.count_nonzero(drawn >= 1.0) < 35
    assert all(("was drawn" in text) == (value >= 1.0) for text, value in zip(block["message"], drawn, strict=True))


def test_a_batch_whose_every_run_fails_on_what_is_drawn_is_a_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chance = "repeat_probability: {value: 50 %, distribution: {kind: normal, mean: 150 %, sd: 1 %}}"
    path = written(tmp_path, f"segments:\n  - inspect: {{duration: 3 s, {chance}}}\n")
    answer = tmp_path / "answer.json"
    assert run_command(["montecarlo", path, "--runs", "20", "--json", str(answer)]) == 2
    out, err = capsys.readouterr()
    assert "mission.yaml:5: error: a probability of 1.5" in err
    assert not out
    assert not answer.exists()


def test_a_run_beyond_the_batch_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["montecarlo", PATROL, "--runs", "20", "--only", "20"]) == 2
    assert "0 to 19" in capsys.readouterr().err
    assert run_command(["montecarlo", PATROL, "--runs", "20", "--only", "19", "--quiet"]) == 0
    assert run_command(["montecarlo", PATROL, "--only", "5000", "--quiet"]) == 0


def test_runs_in_which_a_drawn_length_makes_another_way_shorter_take_it(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(
        "kind: environment\nname: two_ways\nplaces: {A: {}, B: {}, C: {}, D: {}}\nedges:\n"
        "  - {from: A, to: B, length: {value: 25 m, sd: 8 %}}\n  - {from: B, to: D, length: {value: 25 m, sd: 8 %}}\n"
        "  - {from: A, to: C, length: {value: 27 m, sd: 8 %}}\n  - {from: C, to: D, length: 27 m, slope: 1 %}\n",
        encoding="utf-8",
    )
    text = "environment: map.yaml\nstart: A\ndefaults: {speed: 0.5 m/s}\nsegments: [{drive: {to: D}}, {drive: {to: A}}]"
    prepared = prepare(Task(written(tmp_path, text), (), None, 2, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    ours = prepared.arrays.block(2, 0, 60)
    first = ours["drawn:environment.edges.0.length"] + ours["drawn:environment.edges.1.length"]
    other = ours["drawn:environment.edges.2.length"] + 27.0
    assert 2 < np.count_nonzero(other < first) < 30
    np.testing.assert_allclose(ours["distance_m"], 2.0 * np.minimum(first, other), rtol=1e-12)
    assert_agree(ours, simulate_block(prepared.mission, prepared.model, prepared.sampler, 2, 0, 60))


def test_a_kink_inside_an_interval_is_found_in_every_run(tmp_path: Path) -> None:
    path = written(tmp_path, "segments:\n  - drive: {distance: 30 m, speed: {value: 0.5 m/s, sd: 4 %}}\n")
    robot = tmp_path / "robot.yaml"
    own = 'effects:\n  - {name: own, battery: main, power: "maximum(0, k*(v - 0.54))", parameters: {k: 30}}\n'
    robot.write_text(robot.read_text(encoding="utf-8") + own, encoding="utf-8")
    prepared = prepare(Task(path, (), None, 1, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    draws = prepared.sampler.draw(1, 0, 300)
    assert 1 < (draws["segments.0.drive.speed"] > 0.54).sum() < 30
    assert not prepared.arrays.evaluate(draws, 300)[1].any()
    assert_agree(
        prepared.arrays.block(1, 0, 300), simulate_block(prepared.mission, prepared.model, prepared.sampler, 1, 0, 300)
    )


def test_what_a_start_takes_at_once_is_in_every_run(tmp_path: Path) -> None:
    drive = "  - drive: {distance: 5 m, speed: {value: 0.5 m/s, sd: 4 %}}\n  - wait: {duration: 3 s}\n"
    path = written(tmp_path, f"defaults: {{profile: constant_speed}}\nsegments:\n{2 * drive}")
    robot = tmp_path / "robot.yaml"
    own = "effects:\n  - {effect: start_surge, battery: main, parameters: {E: 40}}\n"
    robot.write_text(robot.read_text(encoding="utf-8") + own, encoding="utf-8")
    prepared = prepare(Task(path, (), None, 1, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    assert_agree(
        prepared.arrays.block(1, 0, 40), simulate_block(prepared.mission, prepared.model, prepared.sampler, 1, 0, 40)
    )


@pytest.mark.parametrize("regeneration", ["0 %", "15 %", "{value: 40 %, sd: 10 %}"])
def test_where_braking_gives_back_is_found_in_every_run(tmp_path: Path, regeneration: str) -> None:
    drive = "  - drive: {distance: 12 m, speed: {value: 0.7 m/s, sd: 2 %}, slope: SLOPE}\n"
    slopes = ("-3 %", "-1 %", "1 %", "3 %")
    path = written(tmp_path, "segments:\n" + "".join(drive.replace("SLOPE", slope) for slope in slopes))
    robot = tmp_path / "robot.yaml"
    text = robot.read_text(encoding="utf-8").replace("body: {", f"body: {{regeneration: {regeneration}, ")
    own = "".join(
        f"  - {{effect: {name}, battery: main, parameters: {{k: {{value: 1.2, sd: 5 %}}}}}}\n"
        for name in ("grade", "acceleration")
    )
    robot.write_text(f"{text}effects:\n{own}", encoding="utf-8")
    prepared = prepare(Task(path, (), None, 1, "auto"))
    assert prepared.arrays is not None, prepared.why_not_arrays
    assert not prepared.arrays.evaluate(prepared.sampler.draw(1, 0, 200), 200)[1].any()
    assert_agree(
        prepared.arrays.block(1, 0, 200), simulate_block(prepared.mission, prepared.model, prepared.sampler, 1, 0, 200)
    )


def test_a_file_that_was_written_anew_is_read_anew(tmp_path: Path) -> None:
    path = written(tmp_path, "segments: [{wait: {duration: {value: 10 s, sd: 5 %}}}]")
    task = Task(path, (), None, 1, "auto")
    assert prepare(task) is prepare(task)
    before = prepare(task).arrays
    written(tmp_path, "segments: [{wait: {duration: {value: 200 s, sd: 5 %}}}]")
    after = prepare(task).arrays
    assert before is not None
    assert after is not None
    assert np.mean(after.block(1, 0, 50)["duration_s"]) > 10 * np.mean(before.block(1, 0, 50)["duration_s"])
