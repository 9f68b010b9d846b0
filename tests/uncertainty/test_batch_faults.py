"""Damaged, foreign and unwritable folders, and what else goes wrong around a batch."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.uncertainty.batch import Task, _prepared, prepare
from missionsim.uncertainty.store import BlockStore
from tests.uncertainty.test_limits import written
from tests.uncertainty.test_montecarlo import files

DRIVE = "segments:\n  - drive: {distance: 9 m, speed: {value: 0.3 m/s, distribution: %s}}\n"
EMPIRICAL = DRIVE % "{kind: empirical, file: speeds.csv, column: v}"


@pytest.fixture
def mission(tmp_path: Path) -> str:
    _prepared.cache_clear()  # a new process reads it anew
    (tmp_path / "speeds.csv").write_text("v\n0.3\n0.35\n0.4\n", encoding="utf-8")
    return written(tmp_path, EMPIRICAL)


def batch(mission: str, out: Path, *more: str) -> int:
    options = ["--runs", "120", "--seed", "1", "--engine", "simpy", "--quiet", "--out", str(out)]
    return run_command(["montecarlo", mission, *options, *more])


def test_damaged_blocks_are_computed_again(tmp_path: Path, mission: str, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert batch(mission, out) == 0
    whole = files(out)
    flipped, cut = out / "blocks/runs_000000000.parquet", out / "blocks/runs_000000050.parquet"
    data = bytearray(flipped.read_bytes())
    data[len(data) // 3] ^= 0xFF
    flipped.write_bytes(bytes(data))
    with pytest.raises(Exception, match="is damaged"):
        list(BlockStore(out).tables(BlockStore(out).names(), [0]))
    cut.write_bytes(cut.read_bytes()[:100])
    (out / "summary.json").unlink()
    assert batch(mission, out, "--resume") == 0
    assert "2 damaged blocks, the first with run 0" in capsys.readouterr().err
    assert files(out) == whole


def test_a_batch_of_other_draws_is_not_resumed(
    tmp_path: Path, mission: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert batch(mission, out) == 0
    _prepared.cache_clear()  # a new process reads it anew
    (tmp_path / "speeds.csv").write_text("v\n0.3\n0.35\n0.45\n", encoding="utf-8")
    assert batch(mission, out, "--resume") == 2
    assert "another one, by its distributions" in capsys.readouterr().err
    assert batch(mission, out, "--resume", "--set", "defaults.payload=1 kg") == 2
    assert "overrides" in capsys.readouterr().err
    (out / "batch.json").write_text("{", encoding="utf-8")
    assert batch(mission, out, "--resume") == 2
    assert "does not tell which batch" in capsys.readouterr().err


def test_a_disk_that_is_full_is_told_with_the_file(
    tmp_path: Path, mission: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow.parquet as pq

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "Error writing bytes to file. Detail: [errno 28] No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    assert batch(mission, tmp_path / "out") == 2
    assert "runs_000000000.parquet: error: No space left on device" in capsys.readouterr().err


def test_ctrl_c_while_summing_up_leaves_a_resumable_batch(
    tmp_path: Path, mission: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("missionsim.uncertainty.batch.summarise", interrupt)
        assert batch(mission, out) == 130
    assert "--resume" in capsys.readouterr().err
    assert batch(mission, out, "--resume") == 0
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["runs"] == 120


@pytest.mark.parametrize("arguments", [["--runs", "1000000000000"], ["--workers", "99999"], ["--runs", "1e12"]])
def test_too_many_is_refused_at_once(mission: str, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["montecarlo", mission, *arguments]) == 2
    assert arguments[0] in capsys.readouterr().err


def test_correlations_that_cannot_hold_together_are_found_by_validate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pairs = ((0, 1, 0.9), (0, 2, 0.9), (1, 2, -0.9))
    text = "".join(
        f"  - {{between: [segments.{i}.drive.distance, segments.{j}.drive.distance], rho: {rho}}}\n"
        for i, j, rho in pairs
    )
    drives = "  - drive: {distance: {value: 9 m, sd: 1 m}}\n" * 3
    path = written(tmp_path, f"correlations:\n{text}segments:\n{drives}")
    for command in ("validate", "montecarlo"):
        assert run_command([command, path]) == 2
        assert "mission.yaml:4:1: error: these correlations cannot hold together" in capsys.readouterr().err


def test_values_that_are_said_to_correlate_do_and_no_other_draw_changes(tmp_path: Path) -> None:
    drives = "segments:\n" + "  - drive: {distance: {value: 90 m, sd: 5 m}}\n" * 3
    names = [f"segments.{i}.drive.distance" for i in range(3)]
    drawn = []
    for number, more in enumerate(("", f"correlations:\n  - {{between: [{names[0]}, {names[2]}], rho: -0.6}}\n")):
        (folder := tmp_path / str(number)).mkdir()
        drawn.append(prepare(Task(written(folder, more + drives), (), None, 5, "auto")).sampler.draw(5, 0, 4000))
    plain, linked = drawn
    assert np.array_equal(plain[names[1]], linked[names[1]])
    for draws, rho in ((plain, 0.0), (linked, -0.6)):
        assert np.corrcoef(draws[names[0]], draws[names[2]])[0, 1] == pytest.approx(rho, abs=0.05)
        assert draws[names[2]].mean() == pytest.approx(90.0, abs=0.3)
        assert draws[names[2]].std() == pytest.approx(5.0, abs=0.2)


def test_what_matters_for_the_reserve_is_told_beside_what_matters_for_energy(tmp_path: Path) -> None:
    path = written(tmp_path, "segments:\n  - drive: {distance: {value: 900 m, sd: 3 %}, speed: 0.5 m/s}\n")
    target = tmp_path / "answer.json"
    set_capacity = ["--set", "robot.batteries.main.capacity={value: 50 Wh, sd: 5 %}"]
    for sobol in ("0", "64"):
        more = ["--runs", "800", "--sobol", sobol, "--quiet", "--json", str(target)]
        assert run_command(["montecarlo", path, *set_capacity, *more]) == 0
        rows = {row["parameter"]: row for row in json.loads(target.read_text(encoding="utf-8"))["importance"]}
        capacity = rows["robot.batteries.main.capacity"]
        assert abs(capacity["rank_correlation"]) < 0.15
        assert capacity["margin_rank_correlation"] > 0.8
        assert rows["segments.0.drive.distance"]["margin_rank_correlation"] < -0.05
        assert (capacity["total"] is None) == (sobol == "0")


def test_alternatives_tell_how_sure_each_succeeds_and_what_it_keeps(tmp_path: Path) -> None:
    path = written(tmp_path, "segments:\n  - drive: {distance: {value: 900 m, sd: 3 %}, speed: 0.5 m/s}\n")
    target = tmp_path / "answer.json"
    vary = ["--vary", "segments.0.drive.speed=0.3,0.7", "--montecarlo", "200", "--quiet", "--json", str(target)]
    assert run_command(["whatif", path, *vary]) == 0
    rows = json.loads(target.read_text(encoding="utf-8"))["montecarlo"]["alternatives"]
    assert all(low <= row["p_feasible"] <= high for row in rows for low, high in [row["p_feasible_interval"]])
    differences = {d["quantity"]: d for d in rows[1]["differences"]}
    assert differences["margin_main_wh"]["mean"] == pytest.approx(-differences["energy_main_wh"]["mean"], rel=1e-9)


def test_alternatives_of_a_study_may_set_whole_mappings(tmp_path: Path) -> None:
    written(tmp_path, "segments:\n  - drive: {distance: 900 m, speed: {value: 0.5 m/s, sd: 3 %}}\n")
    path, target = tmp_path / "study.yaml", tmp_path / "answer.json"
    head = "kind: study\nname: lengths\nmission: mission.yaml\nalternatives:\n"
    path.write_text(head + "  short: {set: {segments.0.drive: {distance: 500 m, speed: 0.5 m/s}}}\n", encoding="utf-8")
    more = ["--montecarlo", "20", "--quiet", "--json", str(target)]
    assert run_command(["whatif", "--study", str(path), *more]) == 0
    rows = json.loads(target.read_text(encoding="utf-8"))["montecarlo"]["alternatives"]
    assert [row["name"] for row in rows] == ["baseline", "short"]


def test_copies_beside_the_blocks_are_none(tmp_path: Path, mission: str) -> None:
    out = tmp_path / "out"
    assert batch(mission, out) == 0
    whole = files(out)
    first = out / "blocks/runs_000000000.parquet"
    for name in ("runs_000000000 (copy).parquet", "runs_0.parquet"):
        (out / "blocks" / name).write_bytes(first.read_bytes())
    (out / "summary.json").unlink()
    assert batch(mission, out, "--resume") == 0
    assert {path: data for path, data in files(out).items() if path in whole} == whole
