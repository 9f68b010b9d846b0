"""Maps: expressions, units, attitude, runs, refreshes; and the numeric steps behind them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from pandas.testing import assert_frame_equal

from missionsim.cli.app import run_command as main
from missionsim.errors import InputError
from missionsim.glossary import STILL_SPEED_M_S
from missionsim.importer import transform
from missionsim.importer.mapping import import_source
from missionsim.importer.roles import to_glossary
from missionsim.inputs.loading import check_files, load_map
from missionsim.labels import Labels
from missionsim.logs import LogTable, read_log
from tests.logs.conftest import motion, write_csv

N = 600


def source(tmp_path: Path, **more: object) -> Path:
    """A log of another layout: milliseconds, wheel speeds, mA and mV, attitude of a 0.1 rad slope."""
    columns = motion(N, 0.1)
    v, w = columns["speed_m_s"], columns["yaw_rate_rad_s"]
    half = 0.05
    turned = np.cumsum(w) * 0.1
    table: dict[str, object] = {
        "stamp ms": 1000.0 * columns["time_s"],
        "wl": (v - 0.2 * w) / 0.3,
        "wr": (v + 0.2 * w) / 0.3,
        "volt": np.full(N, 24000.0),
        "amp": -1000.0 * columns["power_robot_w"] / 24.0,
        # heading about z, then nose up by 2·half about the left axis (REP 103: negative pitch)
        "qw": np.cos(turned / 2) * np.cos(half),
        "qx": np.sin(turned / 2) * np.sin(half),
        "qy": -np.cos(turned / 2) * np.sin(half),
        "qz": np.sin(turned / 2) * np.cos(half),
        "floor": np.where(np.arange(N) < 300, 1, 2),
        "mode": np.where(np.arange(N) < 300, "auto", "manual"),
    }
    return write_csv(tmp_path / "grass_07.csv", {**table, **more})  # type: ignore[arg-type]


BASE = """\
kind: map
signals: {t_ms: stamp ms}
constants: {radius: 30 cm}
let: {v_left: wl * radius, v_right: wr * radius}
columns:
  time_s: {value: t_ms, unit: ms}
  voltage_robot_v: {value: volt, unit: mV}
  current_robot_a: {value: -amp, unit: mA}
  speed_m_s: (v_left + v_right) / 2
"""


def run(tmp_path: Path, text: str, path: Path | None = None) -> list[LogTable]:
    (tmp_path / "m.yaml").write_text(text)
    return import_source(path or source(tmp_path), load_map(tmp_path / "m.yaml"))


def test_columns_units_constants_sign(tmp_path: Path) -> None:
    (log,) = run(tmp_path, BASE)
    truth = motion(N, 0.1)
    np.testing.assert_allclose(log.time_s, truth["time_s"], rtol=1e-8)
    assert log.duration_s == pytest.approx(N * 0.1)
    np.testing.assert_allclose(log.power_w["robot"], truth["power_robot_w"], rtol=1e-7)
    np.testing.assert_allclose(log.number("speed_m_s"), truth["speed_m_s"], atol=1e-8)
    assert list(log.columns) == ["time_s", "voltage_robot_v", "current_robot_a", "speed_m_s"]
    assert log.run == "grass_07"


def test_attitude_rates_texts(tmp_path: Path) -> None:
    (log,) = run(
        tmp_path,
        BASE
        + """\
  slope_rad: {quaternion: [qx, qy, qz, qw], give: slope}
  heading_rad: {quaternion: [qx, qy, qz, qw], give: heading}
  yaw_rate_rad_s: {differentiate: heading_rad, average: 0.4 s}
  accel_m_s2: {differentiate: speed_m_s}
  payload_kg: 6
  surface: {lookup: floor, values: {1: tile, 2: carpet}}
  on_kinect: {lookup: mode, values: {auto: 1, manual: 0}}
  scheme: mode
  navigation: {text: odometry}
  segment: floor
  floor_kind: {file_name: [grass, asphalt]}
  power_ratio: voltage_robot_v * current_robot_a / (payload_kg + 1)
""",
    )
    truth = motion(N, 0.1)
    turned = np.cumsum(truth["yaw_rate_rad_s"]) * 0.1
    np.testing.assert_allclose(log.number("slope_rad"), 0.1, atol=1e-8)
    np.testing.assert_allclose(log.number("heading_rad"), turned, atol=1e-7)
    expected = (turned[6:] - turned[2:-4]) / 0.4
    np.testing.assert_allclose(log.number("yaw_rate_rad_s")[4:-2], expected, atol=1e-6)
    np.testing.assert_allclose(log.number("accel_m_s2"), np.gradient(truth["speed_m_s"], 0.1), atol=1e-6)
    assert set(log.number("payload_kg")) == {6.0}
    words = {name: data.names for name, data in log.columns.items() if isinstance(data, Labels)}
    assert words == {
        "surface": ("tile", "carpet"),
        "scheme": ("auto", "manual"),
        "navigation": ("odometry",),
        "segment": ("1", "2"),
        "floor_kind": ("grass",),
    }
    assert log.number("on_kinect").tolist() == [1.0] * 300 + [0.0] * 300
    np.testing.assert_allclose(log.number("power_ratio"), truth["power_robot_w"] / 7, rtol=1e-7)


def test_slope_is_that_of_the_direction_of_travel(tmp_path: Path) -> None:
    (log,) = run(
        tmp_path,
        BASE.replace("(v_left + v_right) / 2", "(v_left + v_right) / 2 - 0.4")
        + "  slope_rad: {quaternion: [qx, qy, qz, qw], travel: speed_m_s}\n",
    )
    speed = log.number("speed_m_s")
    assert (speed < 0).any()
    moves = np.abs(speed) > STILL_SPEED_M_S  # at rest its sign is that of the travel before
    np.testing.assert_allclose(log.number("slope_rad")[moves], np.where(speed < 0, -0.1, 0.1)[moves], atol=1e-8)


def test_keep_others_and_gaps(tmp_path: Path) -> None:
    kept = BASE.replace("columns:", "keep: floor == 1 or mode == 'manual' and t_ms > 45000\nothers: true\ncolumns:")
    (log,) = run(tmp_path, kept)
    assert log.rows == 450
    assert {"wl", "qz", "mode"} <= log.columns.keys()
    assert any("150 of 600 rows do not meet" in r.message for r in log.remarks)
    first, second = run(tmp_path, kept.replace("columns:", "runs: {gap: 5 s}\ncolumns:", 1))
    assert (first.run, first.rows, second.run, second.rows) == ("grass_07_00", 300, "grass_07_01", 150)
    assert second.time_s[0] == 0.0
    (only,) = run(tmp_path, kept.replace("columns:", "runs: {gap: 5 s, shortest: 20 s}\ncolumns:", 1))
    assert only.rows == 300
    assert any("1 pieces of grass_07 (150 rows) are too short" in r.message for r in only.remarks)


def test_a_word_that_is_a_column_s_name_is_told(tmp_path: Path) -> None:
    (log,) = run(tmp_path, BASE + "  scheme: {text: mode}\n  surface: mode\n")
    scheme, surface = log.columns["scheme"], log.columns["surface"]
    assert isinstance(scheme, Labels)
    assert isinstance(surface, Labels)
    assert (scheme.names, set(surface.names)) == (("mode",), {"auto", "manual"})
    (told,) = [r for r in log.remarks if r.column == "scheme"]
    assert "for the column write scheme: mode" in told.action


def test_runs_by_columns_and_restart(tmp_path: Path) -> None:
    by = BASE.replace("columns:", "runs: {by: [mode, floor]}\ncolumns:")
    logs = run(tmp_path, by)
    assert [(log.run, log.rows) for log in logs] == [("grass_07_auto_1", 300), ("grass_07_manual_2", 300)]
    assert logs[1].time_s[0] == 0.0
    columns = {name: np.r_[data, data] for name, data in motion().items()}
    path = write_csv(tmp_path / "two.csv", columns)
    plain = "kind: map\nruns: {restart: true}\ncolumns: {time_s: time_s, power_robot_w: power_robot_w}\n"
    first, second = run(tmp_path, plain, path)
    assert (first.rows, second.rows) == (400, 400)
    np.testing.assert_array_equal(first.power_w["robot"], second.power_w["robot"])


def test_one_row_for_each_refresh(tmp_path: Path) -> None:
    amp = -1000.0 * np.repeat(motion(60, 1.0)["power_robot_w"], 10) / 24.0
    text = BASE.replace("columns:", "refresh: amp\ncolumns:")
    (log,) = run(tmp_path, text, source(tmp_path, amp=amp))
    truth = motion(N, 0.1)
    assert log.rows == 58
    np.testing.assert_allclose(log.power_w["robot"], motion(60, 1.0)["power_robot_w"][2:], rtol=1e-7)
    # a value that appears in row 20 stands for the rows 11 to 20
    np.testing.assert_allclose(log.number("speed_m_s")[0], truth["speed_m_s"][11:21].mean(), atol=1e-7)
    np.testing.assert_allclose(log.dt_s, 1.0, atol=1e-9)
    assert not [r for r in log.remarks if r.severity != "note"]
    (late,) = run(tmp_path, text.replace("unit: mA}", "unit: mA, lag: 0.25 s}"), source(tmp_path, amp=amp))
    np.testing.assert_allclose(late.number("speed_m_s")[0], truth["speed_m_s"][8:18].mean(), atol=1e-7)


def test_refresh_windows_when_the_value_stays() -> None:
    time = np.arange(100) * 0.1
    signal = np.repeat([1.0, 2.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], 10)
    start, stop, row = transform.refresh_times([signal], time)
    np.testing.assert_allclose(stop - start, 1.0)
    assert signal[row].tolist() == [2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]


def test_two_topics_one_after_the_other_are_one_refresh() -> None:
    time = np.arange(200) * 0.05
    left = np.repeat(np.arange(10.0), 20)
    right = np.r_[0.0, 0.0, np.repeat(np.arange(10.0), 20)][:200]
    start, stop, row = transform.refresh_times([left, right], time)
    np.testing.assert_allclose(stop - start, 1.0)
    assert (left[row] == right[row]).all()


def test_lag_step_and_average(tmp_path: Path) -> None:
    truth = motion(N, 0.1)
    (log,) = run(tmp_path, BASE.replace("unit: mA}", "unit: mA, lag: 0.5 s}"))
    np.testing.assert_allclose(log.power_w["robot"][:590], truth["power_robot_w"][5:595], rtol=1e-6)
    (log,) = run(tmp_path, BASE.replace("columns:", "step: 1 s\ncolumns:"))
    assert log.rows == 60
    np.testing.assert_allclose(log.number("speed_m_s"), truth["speed_m_s"].reshape(60, 10).mean(axis=1), atol=1e-7)
    np.testing.assert_allclose(log.dt_s, 1.0, atol=1e-7)


def test_file_without_header(tmp_path: Path) -> None:
    path = tmp_path / "raw.TXT"
    path.write_text("".join(f"{i},12.0,{500 + i % 3}\n" for i in range(50)))
    text = """\
kind: map
table: {header: [index, volts, milliamps]}
columns: {time_s: index / 10, voltage_robot_v: volts, current_robot_a: {value: milliamps, unit: mA}}
"""
    (log,) = run(tmp_path, text, path)
    assert log.rows == 50
    assert log.power_w["robot"][1] == pytest.approx(12 * 0.501)


@pytest.mark.parametrize(
    ("unit", "name", "value", "expected"),
    [
        ("km/h", "speed_m_s", 3.6, 1.0), ("deg", "slope_rad", 180.0, np.pi), ("%", "slope_rad", 100.0, np.pi / 4),
        ("deg/s", "yaw_rate_rad_s", 180.0, np.pi), ("mW", "power_robot_w", 1.0, 1e-3),
        ("kW", "power_robot_w", 1.0, 1e3), ("J", "energy_robot_wh", 3600.0, 1.0),
        ("kWh", "energy_robot_wh", 1.0, 1000.0), ("mA", "current_robot_a", 5.0, 0.005), ("ns", "time_s", 1e9, 1.0),
        ("us", "time_s", 1e6, 1.0), ("min", "time_s", 2.0, 120.0), ("K", "temp_motor_c", 273.15, 0.0),
        ("%", "cpu_load", 40.0, 0.4), ("GHz", "cpu_freq_hz", 1.2, 1.2e9), ("g", "payload_kg", 500.0, 0.5),
        ("kW", "other", 2.0, 2000.0), ("degF", "temp_ambient_c", 212.0, 100.0),
    ],
)  # fmt: skip
def test_units(unit: str, name: str, value: float, expected: float) -> None:
    assert to_glossary(np.array([value]), unit, name)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("unit", "name"), [("kg", "speed_m_s"), ("mA", "power_robot_w"), ("flurbs", "power_robot_w"), ("m", "time_s")]
)
def test_wrong_units(unit: str, name: str) -> None:
    with pytest.raises(InputError, match="unit"):
        to_glossary(np.ones(2), unit, name)


@pytest.mark.parametrize(
    ("change", "message", "line"),
    [
        (("(v_left + v_right) / 2", "(v_left + v_rigth) / 2"), "'v_rigth' is not known here", 9),
        (("(v_left + v_right) / 2", "(v_left + v_right"), "formula cannot be read", 9),
        (("(v_left + v_right) / 2", "__import__('os').system('x')"), "this is not allowed in a formula", 9),
        (("unit: mV", "unit: kg"), "wrong unit", 7),
        (("unit: mV", "unti: mV"), "unknown key 'unti'", 7),
        (("stamp ms", "stamp_ms"), "'stamp_ms' is not in", 2),
        (("wl * radius", "speed_m_s * 2"), "these columns need each other", 6),
        (("wl * radius", "mode * 2"), "the formula cannot be computed: mode holds text", 4),
        (("kind: map", "kind: mapp"), "not the kind of file that is needed here", 1),
        (("time_s: {value: t_ms, unit: ms}", "times: {value: t_ms, unit: ms}"), "the column 'time_s' is missing", 5),
        (("(v_left + v_right) / 2", "{value: wl, text: a}"), "a column needs exactly one of", 9),
        (("(v_left + v_right) / 2", "{lookup: mode, values: {auto: 1}}"), "'manual' has no value", 9),
        (("(v_left + v_right) / 2", "mode"), "this column holds text, not numbers", 9),
        (("signals:", "refresh: nothing\nsignals:"), "'nothing' is not a column of the source", 2),
        (("signals:", "runs: {by: [nothing]}\nsignals:"), "'nothing' is not a column of the source", 2),
        # a source column of the same name would come first, unseen; beside `columns` the column would be missing
        (("{v_left: wl * radius,", "{wl: 2 * wl, v_left: wl * radius,"), "'wl' stands for something else already", 4),
        (("{radius: 30 cm}", "{radius: 30 cm, volt: 1}"), "'volt' stands for something else already", 3),
        (("{v_left: wl * radius,", "{speed_m_s: wl, v_left: wl * radius,"), "'speed_m_s' stands for something else", 4),
        (("signals:", "keep: speed_m_s > 99\nsignals:"), "no run is left after 'keep' and 'runs'", 0),
    ],
)
def test_faults_of_a_map(tmp_path: Path, change: tuple[str, str], message: str, line: int) -> None:
    with pytest.raises(InputError) as caught:
        run(tmp_path, BASE.replace(*change))
    fault = next((f for f in caught.value.faults if message in f.message), None)
    assert fault is not None, str(caught.value)
    assert fault.line == line


def test_attitude_of_known_rotations() -> None:
    def turned(axis: tuple[float, float, float], angle: float) -> tuple[np.ndarray, ...]:
        return (*(np.array([part * np.sin(angle / 2)]) for part in axis), np.array([np.cos(angle / 2)]))

    nose_up = turned((0, 1, 0), -0.2)
    assert transform.attitude(*nose_up, "slope")[0] == pytest.approx(0.2)  # type: ignore[call-arg, arg-type]
    assert transform.attitude(*nose_up, "pitch")[0] == pytest.approx(-0.2)  # type: ignore[call-arg, arg-type]
    assert transform.attitude(*turned((1, 0, 0), 0.3), "roll")[0] == pytest.approx(0.3)  # type: ignore[call-arg, arg-type]
    assert transform.attitude(*turned((0, 0, 1), 0.7), "heading")[0] == pytest.approx(0.7)  # type: ignore[call-arg, arg-type]
    assert transform.attitude(*turned((0, 0, 1), 0.7), "slope")[0] == pytest.approx(0.0)  # type: ignore[call-arg, arg-type]
    zero = np.zeros(1)
    assert np.isnan(transform.attitude(zero, zero, zero, zero, "slope")[0])


def test_moving_average_and_rate_of_a_line_are_exact() -> None:
    time = np.sort(np.random.default_rng(0).uniform(0, 10, 200))
    line = 3.0 * time + 1.0
    np.testing.assert_allclose(transform.rate_of_change(line, time, 0.7), 3.0, rtol=1e-9)
    np.testing.assert_allclose(transform.rate_of_change(line, time), 3.0, rtol=1e-9)
    inside = (time > time[0] + 0.5) & (time < time[-1] - 0.5)
    np.testing.assert_allclose(transform.moving_average(line, time, 1.0)[inside], line[inside], rtol=1e-9)


def test_shipped_maps_are_valid(root: Path) -> None:
    maps = sorted((root / "docs" / "maps").glob("*.yaml"))
    assert len(maps) >= 5
    assert check_files(maps) == []


def test_shipped_maps_fit_the_schema_that_editors_use(root: Path) -> None:
    import jsonschema
    import yaml

    schema = json.loads((root / "missionsim" / "schemas" / "map.schema.json").read_text())
    short = {
        "kind": "map",
        "refresh": "amp",
        "runs": {"by": "mode"},
        "signals": {"v": {"field": "x", "fill": "linear"}},
        "columns": {
            "time_s": "t",
            "power_robot_w": 5,
            "on_laser": {"lookup": "mode", "values": {"auto": 1, "b": "two"}},
        },
    }
    for text in [yaml.safe_dump(short), *(path.read_text() for path in (root / "docs" / "maps").glob("*.yaml"))]:
        jsonschema.validate(yaml.safe_load(text), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**short, "colums": {}}, schema)


def test_command_writes_and_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.yaml").write_text(BASE)
    path = source(tmp_path)
    out = tmp_path / "log.parquet"
    assert main(["import", str(path), "--map", str(tmp_path / "m.yaml"), "--out", str(out), "--json", "-"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["runs"][0]["rows"] == N
    assert summary["runs"][0]["batteries"]["robot"]["power_from"] == "voltage*current"
    log = read_log(out)
    assert log.rows == N
    import pyarrow.parquet as parquet

    metadata = parquet.read_schema(out).metadata
    assert metadata[b"missionsim.map"] == b"m.yaml"
    assert len(metadata[b"missionsim.source_sha256"]) == 64
    assert main(["import", str(path), "--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "log.csv")]) == 0
    np.testing.assert_allclose(read_log(tmp_path / "log.csv").power_w["robot"], log.power_w["robot"], rtol=1e-12)
    capsys.readouterr()
    assert main(["import", str(path)]) == 0
    assert "stamp ms" in capsys.readouterr().out
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing.csv", "--map", "m.yaml", "--out", "a.parquet"], "there is no such file"),
        (["grass_07.csv", "--map", "n.yaml", "--out", "a.parquet"], "cannot read this file"),
        (["grass_07.csv", "--map", "m.yaml"], "--out is missing"),
        (["grass_07.csv", "--out", "a.parquet"], "--out needs --map"),
        (["grass_07.csv", "--map", "m.yaml", "--out", "a.xlsx"], "a log is written as CSV or Parquet"),
        (["grass_07.csv", "--map", "by.yaml", "--out", "a.parquet"], "the source holds 2 runs, and --out is one file"),
    ],
)
def test_command_faults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    source(tmp_path)
    (tmp_path / "m.yaml").write_text(BASE)
    (tmp_path / "by.yaml").write_text(BASE.replace("columns:", "runs: {by: [mode]}\ncolumns:"))
    assert main(["import", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "a.parquet").exists()


@pytest.mark.parametrize(
    ("time", "more", "code", "said"),
    [
        ("t_ms", "", 2, "time runs backwards by 59900 s"),  # two recordings, one after the other
        ("volt", "", 2, "all rows have the same time"),
        ("saw", "", 1, "the rows were sorted by time"),  # no clock: a quarter of its steps go back
        ("t_ms", "step: 1e-9 s", 2, "'step' would make"),
    ],
)
def test_rows_of_two_runs_are_not_sorted_into_one(
    time: str, more: str, code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = source(tmp_path, saw=0.5 * (np.arange(N) % 4) + 0.01 * np.arange(N)), tmp_path / "log.parquet"
    if "backwards" in said:
        header, *rows = path.read_text().splitlines()
        path.write_text("\n".join([header, *rows, *rows]))
    (tmp_path / "m.yaml").write_text(f"{BASE.replace('value: t_ms, unit: ms', f'value: {time}')}{more}\n")
    assert main(["import", str(path), "--map", str(tmp_path / "m.yaml"), "--out", str(out)]) == code
    captured = capsys.readouterr()
    assert said in " ".join((captured.out + captured.err).split())
    assert out.exists() == (code == 1)


def test_one_stamp_that_a_logger_wrote_wrong_costs_no_run(tmp_path: Path) -> None:
    """A row of a few hundred that jumps back is no second run, whether a map reads it or not."""
    columns = motion(1000)
    columns["time_s"][700] = 20.0
    write_csv(tmp_path / "run.csv", columns)
    (tmp_path / "m.yaml").write_text("kind: map\ncolumns: {time_s: time_s, power_robot_w: power_robot_w}")
    mapped = import_source(tmp_path / "run.csv", load_map(tmp_path / "m.yaml"))[0]
    for log in (read_log(tmp_path / "run.csv"), mapped):
        remark = next(remark for remark in log.remarks if remark.kind == "time_backwards")
        assert (remark.severity, remark.count, remark.line) == ("warning", 1, 702)
        assert log.duration_s == pytest.approx(500.0, abs=0.6)


LONG = """kind: map
columns:
  time_s: {time}
  power_robot_w: watts
  speed_m_s: {{value: speed, unit: km/h{speed}}}
  surface: floor
{more}"""


def long_table(path: Path, stamp: str = "seconds", change: str = "") -> Path:
    rows = []
    for i in range(4000):
        seconds = {"seconds": f"{7 + 0.1 * i:.1f}", "epoch": f"{1.7e9 + 0.1 * i:.1f}"}.get(stamp)
        seconds = seconds or f"2025-03-14 {9 + i // 36000:02d}:{i // 600 % 60:02d}:{i // 10 % 60:02d}.{i % 10}"
        seconds = "8.0" if change == "backwards" and i == 3500 else seconds
        extra = "" if change == "hollow" and i > 2000 else f"{i % 17}"
        rows.append(f"{seconds},{20 + i % 13},{abs(i % 400 - 200) / 40},{'wood' if i < 1700 else 'carpet'},{extra}")
    path.write_text("time,watts,speed,floor,temperature\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("stamp", "speed", "more", "change", "by_blocks"),
    [
        ("seconds", "", "others: true", "", True),
        ("epoch", "", "keep: watts > 21", "", True),
        ("iso", "", "", "", False),  # local time: the clocks may change
        ("seconds", ", lag: 2 s", "", "", False),
        ("seconds", "", "step: 1 s", "", False),
        ("seconds", "", "", "backwards", False),
        ("seconds", "", "others: true", "hollow", False),  # a column that a later block has not
    ],
)
def test_long_tables(
    stamp: str, speed: str, more: str, change: str, by_blocks: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = long_table(tmp_path / "long.csv", stamp, change)
    time = "{stamp: time}" if stamp == "iso" else "time"
    (tmp_path / "map.yaml").write_text(LONG.format(time=time, speed=speed, more=more))
    command = ["import", str(table), "--map", str(tmp_path / "map.yaml"), "--quiet", "--json"]
    told = []
    for limit, name in ((1 << 60, "whole"), (0, "blocks")):
        monkeypatch.setattr("missionsim.importer.mapping._LONG_BYTES", limit)
        monkeypatch.setattr("missionsim.importer.mapping._BLOCK_ROWS", 500)
        monkeypatch.setattr("missionsim.logs.formats.delimited._BLOCK_BYTES", 40_000)
        out = tmp_path / f"{name}.parquet"
        assert main([*command, str(tmp_path / f"{name}.json"), "--out", str(out)]) == 0
        (run,) = json.loads((tmp_path / f"{name}.json").read_text())["runs"]
        told.append({key: value for key, value in run.items() if key not in ("file", "remarks")})
    assert told[1] == {**told[0], "duration_s": pytest.approx(told[0]["duration_s"]), "batteries": told[1]["batteries"]}
    energies = [one["batteries"]["robot"]["energy_wh"] for one in told]
    assert energies[1] == pytest.approx(energies[0], rel=1e-12)
    tables = [pq.read_table(tmp_path / f"{name}.parquet").to_pandas() for name in ("whole", "blocks")]
    assert_frame_equal(*tables, check_categorical=False)
    groups = pq.ParquetFile(tmp_path / "blocks.parquet").num_row_groups
    assert (groups > 3) == by_blocks


def test_a_run_that_comes_back_lasts_no_longer_than_its_rows(tmp_path: Path) -> None:
    """A button marks trials, and what lies between is trial 0: no time of the trials is counted for it."""
    lines = [f"{t / 10},{(t // 300) % 2 * (t // 600 + 1)},{10 + t % 2}\n" for t in range(2100)]
    (tmp_path / "day.csv").write_text("t,trial,p\n" + "".join(lines))
    (tmp_path / "map.yaml").write_text("kind: map\nruns: {by: trial}\ncolumns: {time_s: t, power_robot_w: p}\n")
    done = ["import", str(tmp_path / "day.csv"), "--map", str(tmp_path / "map.yaml"), "--out", str(tmp_path / "out")]
    assert main([*done, "--quiet"]) == 0
    for name, seconds in (("day_0", 120), ("day_1", 30), ("day_2", 30)):
        log = read_log(tmp_path / "out" / f"{name}.parquet")
        assert log.energy_wh("robot") == pytest.approx(10.5 * seconds / 3600, rel=0.05), name
