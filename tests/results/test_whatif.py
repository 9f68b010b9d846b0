"""Alternatives equal full runs; differences add up; the infeasible ones are marked."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from missionsim.cli.app import run_command
from missionsim.cli.whatif import split_values, to_vary
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.inputs.loading import load_mission
from missionsim.results.whatif import Alternative, run_alternatives, varied


@pytest.fixture(scope="module")
def corridor(root: Path) -> Path:
    return root / "missions" / "pioneer3dx" / "corridor_forward_motion_50cm_s.yaml"


def whatif(arguments: list[str], target: Path) -> dict[str, Any]:
    assert run_command(["whatif", *arguments, "--json", str(target), "--quiet"]) == 0
    data: dict[str, Any] = json.loads(target.read_text())
    return data


def test_every_alternative_equals_a_full_run(corridor: Path, tmp_path: Path) -> None:
    data = whatif(
        [
            str(corridor),
            "--vary",
            "defaults.speed=0.3,0.46,0.75",
            "--vary",
            "defaults.sensors={},{laser: 1, kinect: 1}",
        ],
        tmp_path / "w.json",
    )
    assert data["schema"] == "missionsim.whatif/1"
    assert len(data["alternatives"]) == 1 + 6
    baseline = data["alternatives"][0]
    assert baseline["name"] == "baseline"
    for row in data["alternatives"]:
        result = simulate(load_mission(corridor, list(row["set"].items())))
        assert row["duration_s"] == result.duration_s
        assert row["feasible"] == result.feasible
        for name, battery in result.batteries.items():
            cells = row["batteries"][name]
            assert cells["energy_wh"] == battery.energy_wh
            assert cells["difference_wh"] == pytest.approx(
                battery.energy_wh - baseline["batteries"][name]["energy_wh"], abs=1e-15
            )
            assert sum(cells["difference_by_term_wh"].values()) == pytest.approx(cells["difference_wh"], abs=1e-12)


def test_study_of_named_alternatives(root: Path, tmp_path: Path) -> None:
    study = root / "missions" / "pioneer3dx" / "corridor_speeds.yaml"
    data = whatif(["--study", str(study)], tmp_path / "s.json")
    names = [row["name"] for row in data["alternatives"]]
    assert names[0] == "baseline"
    assert {"very_slow", "slow", "fastest", "one_laser", "no_laser"} <= set(names)
    by_name = {row["name"]: row for row in data["alternatives"]}
    slow = by_name["very_slow"]
    assert slow["duration_s"] == pytest.approx(500.0)
    # Table 5: 0.1 m/s costs 1.3030 Wh, 0.5 m/s 0.4110 Wh (Eq. 9)
    assert slow["batteries"]["robot"]["difference_wh"] == pytest.approx(1.3030 - 0.4110, abs=1e-4)
    laser = by_name["one_laser"]["batteries"]["robot"]
    assert laser["difference_wh"] == pytest.approx(-2.34 * 100.0 / 3600.0)
    assert laser["difference_by_term_wh"]["laser"] == pytest.approx(-2.34 * 100.0 / 3600.0)


def test_infeasible_alternatives_are_marked(corridor: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["whatif", str(corridor), "--vary", "robot.batteries.robot.capacity=259 Wh,0.2 Wh"]) == 0
    text = capsys.readouterr().out
    assert "NO" in text
    assert "battery 'robot' empty" in text
    assert max(len(line) for line in text.splitlines()) <= 100


def test_table_of_a_what_if(corridor: Path, tmp_path: Path) -> None:
    whatif([str(corridor), "--vary", "defaults.speed=0.3,0.4", "--out", str(tmp_path / "w.csv")], tmp_path / "w.json")
    with (tmp_path / "w.csv").open(newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    for alternative in ("speed=0.3", "speed=0.4"):
        for battery in ("robot", "laptop"):
            mine = [r for r in rows if r["alternative"] == alternative and r["battery"] == battery]
            total = next(float(r["difference_wh"]) for r in mine if r["term"] == "total")
            assert sum(float(r["difference_wh"]) for r in mine if r["term"] != "total") == pytest.approx(total)


def test_all_faults_of_all_alternatives_at_once(corridor: Path) -> None:
    with pytest.raises(InputError) as caught:
        run_alternatives(
            corridor, [Alternative("a", (("defaults.speed", "9 m/s"),)), Alternative("b", (("defaults.sped", "0.3"),))]
        )
    assert len(caught.value.faults) >= 2


@pytest.mark.parametrize(
    "arguments", [[], ["--vary", "defaults.speed="], ["--vary", "x"], ["--vary", "defaults.speed=1,,2"]]
)
def test_what_it_refuses(corridor: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["whatif", str(corridor), *arguments]) == 2
    assert "error" in capsys.readouterr().err


def test_values_between_commas() -> None:
    assert split_values("0.3, 0.46 ,1e-1") == ["0.3", "0.46", "1e-1"]
    assert split_values("{laser: 1, kinect: 1},[1,2],'a,b'") == ["{laser: 1, kinect: 1}", "[1,2]", "'a,b'"]
    assert split_values("it's,that's,'it''s, b'") == ["it's", "that's", "'it''s, b'"]
    with pytest.raises(InputError) as caught:
        to_vary(['defaults.speed="0.5 m/s" x,1,,"0.6 m/s', "a=[1"])
    told = sorted((fault.path, fault.got) for fault in caught.value.faults)
    paths = ("defaults.speed", "defaults.speed", "defaults.speed", "a")
    assert told == sorted(zip(paths, ('"0.5 m/s" x', "", '"0.6 m/s', "[1"), strict=True))
    made = varied([("defaults.speed", ["1", "2"]), ("a.b", ["x", "y"])])
    assert [item.name for item in made] == ["speed=1, a.b=x", "speed=1, a.b=y", "speed=2, a.b=x", "speed=2, a.b=y"]
    paths = [f"robot.components.{name}.loads.0.power" for name in ("lidar", "camera")]
    assert [item.name for item in varied([(path, ["1"]) for path in paths])] == ["lidar.0.power=1, camera.0.power=1"]


def test_keys_of_the_robot_need_no_prefix(corridor: Path) -> None:
    (plain,) = varied([("batteries.robot.capacity", ["100 Wh"])])
    (full,) = varied([("robot.batteries.robot.capacity", ["100 Wh"])])
    found = run_alternatives(corridor, [plain, full]).results
    assert found[0].batteries["robot"].capacity_wh == found[1].batteries["robot"].capacity_wh == pytest.approx(100)


def test_workers_give_the_same_table_and_all_faults(corridor: Path, tmp_path: Path) -> None:
    speeds = ",".join(f"0.{i}" for i in range(30, 38))
    vary = [str(corridor), "--vary", f"defaults.speed={speeds}", "--vary", "robot.motion.parameters.c2=5,6,7"]
    one = whatif(vary, tmp_path / "one.json")
    assert whatif([*vary, "--workers", "2"], tmp_path / "two.json") == one
    bad = [Alternative("a", (("defaults.speed", "fast"),)), Alternative("b", (("defaults.speed", "-1 m/s"),))]
    with pytest.raises(InputError) as error:
        run_alternatives(corridor, [Alternative("baseline"), *bad])
    assert len(error.value.faults) == 2


def test_alternatives_share_the_files_that_none_changes(corridor: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from missionsim.inputs import loading

    read: list[str] = []
    original = loading.read_document

    def counted(path: Path) -> Any:
        read.append(path.name)
        return original(path)

    monkeypatch.setattr(loading, "read_document", counted)
    run_alternatives(corridor, [Alternative("baseline"), *varied([("defaults.speed", [0.3, 0.31, 0.32])])])
    assert len(read) == len(set(read))
    # outside of it, a file that was changed meanwhile is read anew
    load_mission(corridor)
    assert len(read) > len(set(read))


def test_an_impossible_cell_is_one_row_that_says_why(corridor: Path, tmp_path: Path) -> None:
    found = whatif(
        [str(corridor), "--vary", "defaults.speed=0.3,9", "--out", str(tmp_path / "w.csv")], tmp_path / "w.json"
    )
    baseline, slow, fast = found["alternatives"]
    assert not fast["feasible"]
    assert "faster than the robot" in fast["reason"]
    for row in (baseline, slow):
        for battery in row["batteries"].values():
            assert battery["margin_wh"] <= battery["charge_left_wh"]
    assert "impossible: faster" in (tmp_path / "w.csv").read_text()
