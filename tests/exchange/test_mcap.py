"""MCAP files of runs and comparisons: the mcap library reads them, schemas hold, they read back to the bit."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from missionsim.cli.app import run_command
from missionsim.engine.simulate import simulate
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map, load_mission
from missionsim.labels import Labels
from missionsim.logs import read_log
from tests.exchange.mcap_doctor import Doctor

ROOT = Path(__file__).resolve().parents[2]
PATROL = ROOT / "missions/pioneer3dx/valve_patrol.yaml"
RUNS = ROOT / "docs/examples/ramp_runs"


def messages(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Messages by topic, each checked against its own schema, with all checksums."""
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    validators: dict[int, Any] = {}
    with open(path, "rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if schema.id not in validators:
                described = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(described)
                validators[schema.id] = jsonschema.Draft202012Validator({**described, "additionalProperties": False})
            data = json.loads(message.data)
            if len(found[channel.topic]) < 50:
                validators[schema.id].validate(data)
            assert message.log_time == round(data["time_s"] * 1e9)
            found[channel.topic].append(data)
    return found


@pytest.fixture(scope="module")
def patrol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "patrol.mcap"
    assert run_command(["run", str(PATROL), "--mcap", str(path), "--quiet"]) == 0
    return path


def test_run_holds_power_charge_state_and_pose(patrol: Path) -> None:
    found = messages(patrol)
    assert set(found) == {"/power/robot", "/power/laptop", "/state", "/pose"}
    mission = load_mission(PATROL)
    result = simulate(mission)
    for battery in ("robot", "laptop"):
        rows = found[f"/power/{battery}"]
        assert len(rows) == 2 * len(result.timeline) + 1
        joules = sum(row["model_w"] * d for row, d in zip(rows[:-1:2], result.timeline.duration_s, strict=True))
        assert joules / 3600 == pytest.approx(result.batteries[battery].energy_wh, rel=1e-12)
        assert all(sum(row["terms"].values()) == pytest.approx(row["model_w"], abs=1e-9) for row in rows)
        assert rows[-1]["charge_wh"] == result.batteries[battery].charge_left_wh
        assert rows[0]["charge_wh"] == result.batteries[battery].initial_wh
    first, last = found["/pose"][0]["pose"], found["/pose"][-1]["pose"]
    assert (first["position"]["x"], first["position"]["y"]) == (0.0, 0.0)
    assert math.hypot(last["position"]["x"], last["position"]["y"]) == pytest.approx(0.0, abs=1e-3)  # back at the dock
    assert mission.environment is not None
    valve = mission.environment.places["V2"].position
    assert valve is not None
    near = min(math.dist(valve, (p["pose"]["position"]["x"], p["pose"]["position"]["y"])) for p in found["/pose"])
    assert near == pytest.approx(0.0, abs=1e-3)
    assert {row["scheme"] for row in found["/state"]} == {r for r in set(result.timeline.columns["scheme"].names) if r}


def test_run_reads_back_to_the_bit(patrol: Path) -> None:
    (log,) = import_source(patrol, load_map(patrol.with_suffix(".map.yaml")))
    found = messages(patrol)
    assert log.time_s.tolist() == [row["time_s"] for row in found["/state"]]
    for battery in ("robot", "laptop"):
        assert log.power_w[battery].tolist() == [row["model_w"] for row in found[f"/power/{battery}"]]
    result = simulate(load_mission(PATROL))
    assert log.energy_wh("robot") == pytest.approx(result.batteries["robot"].energy_wh, rel=1e-6)


def test_comparison_reads_back_to_the_bit(tmp_path: Path) -> None:
    path, source = tmp_path / "compared.mcap", RUNS / "run_00.csv"
    assert run_command(["compare", "--robot", "pioneer3dx", str(source), "--mcap", str(path), "--quiet"]) == 0
    (again,) = import_source(path, load_map(path.with_suffix(".map.yaml")))
    log = read_log(source)
    assert set(log.columns) <= set(again.columns)
    for name, column in log.columns.items():
        if isinstance(column, Labels):
            assert again.columns[name].texts().tolist() == column.texts().tolist()
        else:
            assert np.array_equal(again.columns[name], column, equal_nan=True), name
    rows = messages(path)["/power/robot"]
    assert [row["measured_w"] for row in rows] == log.power_w["robot"].tolist()
    assert all(row["residual_w"] == row["measured_w"] - row["model_w"] for row in rows)
    result = tmp_path / "c.json"
    run_command(["compare", "--robot", "pioneer3dx", str(source), "--json", str(result), "--quiet"])
    error = json.loads(result.read_text())["batteries"]["robot"]
    residual = np.array([row["residual_w"] for row in rows])
    assert np.sqrt(np.average(residual**2, weights=log.dt_s)) == pytest.approx(error["power_rmse_w"], rel=1e-6)


def test_several_runs_have_topics_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "compared.mcap"
    logs = [str(RUNS / f"run_0{i}.csv") for i in (0, 1)]
    assert run_command(["compare", "--robot", "pioneer3dx", *logs, "--mcap", str(path), "--quiet"]) == 0
    assert {"/run_00/power/robot", "/run_01/power/robot", "/run_00/state", "/run_01/state"} <= set(messages(path))


def test_layout_plots_topics_that_are_there(patrol: Path) -> None:
    layout = json.loads(patrol.with_suffix(".foxglove.json").read_text())
    found = messages(patrol)
    plotted = [line["value"] for panel in layout["configById"].values() for line in panel.get("paths", [])]
    assert len(plotted) >= 4
    for value in plotted:
        topic, _, field = value.partition(".")
        assert field in found[topic][0]

    def leaves(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])


def test_the_doctor_finds_no_fault(patrol: Path, tmp_path: Path) -> None:
    several = tmp_path / "compared.mcap"
    logs = [str(path) for path in sorted(RUNS.iterdir())[:3]]
    assert run_command(["compare", "--robot", "pioneer3dx", *logs, "--mcap", str(several), "--quiet"]) == 0
    for path in (patrol, several):
        found = Doctor(path)
        assert found.faults == []
        assert len(found.times) > 90


def test_the_doctor_sees_what_is_wrong(patrol: Path, tmp_path: Path) -> None:
    """Messages in no order, a count that is wrong, bytes of the summary that changed."""
    path = tmp_path / "ill.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("", "a test")
        channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        for time in (1, 3, 2):
            writer.add_message(channel, time, b"{}", time)
        writer.finish()  # type: ignore[no-untyped-call]
    assert Doctor(path).faults == ["a message at 2 after one at 3"]
    raw = bytearray(patrol.read_bytes())
    count = raw.index(bytes([11]), int.from_bytes(raw[-28:-20], "little"))  # statistics begin with their type
    while int.from_bytes(raw[count + 9 : count + 17], "little") != len(Doctor(patrol).times):
        count = raw.index(bytes([11]), count + 1)
    raw[count + 9] ^= 1
    path.write_bytes(raw)
    assert Doctor(path).faults == ["checksum of the summary", "messages in the statistics"]


@pytest.mark.parametrize(("part", "code"), [(0.3, 2), (0.7, 1), (0.99, 1)])
def test_half_a_file_is_told(
    patrol: Path, part: float, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its whole parts are read, where there are any; `--strict` refuses."""
    raw = patrol.read_bytes()
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(raw[: int(part * len(raw))])
    out = tmp_path / "log.parquet"
    map_file = patrol.with_suffix(".map.yaml")
    given = ["import", str(broken), "--map", str(map_file), "--out", str(out)]
    assert run_command([*given, "--strict"]) == 2
    assert not out.exists()
    assert "was never closed, or is cut" in capsys.readouterr().err
    assert run_command(given) == code
    said = capsys.readouterr()
    assert "was never closed, or is cut" in (said.out + said.err).replace("\n", " ")
    assert out.exists() == (code == 1)
