"""Formats in one registry, encodings, names that stand twice, files joined by time, bad files left out."""

from __future__ import annotations

import codecs
import json
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.errors import InputError
from missionsim.importer.mapping import import_source
from missionsim.importer.suggest import suggest_map
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, iter_blocks, read_log, read_logs, readers
from missionsim.logs.raw import RawTable
from tests.logs import loggers
from tests.logs.conftest import motion, write_csv

MAP = """\
kind: map
files:
  power: {name: power.csv, time: Zeitstempel}
  odometry: {name: odometry.csv, time: stamp}
  events: {name: events.csv, time: time}
signals:
  volts: power.Spannung [V]
  amps: power.Strom [mA]
  v: {field: "odometry.v_x [m/s]", fill: FILL}
  lamp: events.lamp_state
timeline: amps
columns:
  time_s: time_s
  voltage_robot_v: volts
  current_robot_a: {value: amps, unit: mA}
  speed_m_s: v
  on_lamp: lamp
"""


def run(tmp_path: Path, text: str, *sources: Path) -> list[LogTable]:
    (tmp_path / "m.yaml").write_text(text)
    return import_source(list(sources), load_map(tmp_path / "m.yaml"))


# one registry


def test_a_format_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A format of somebody else, found by its entry point, is read by every command, large files too."""

    def read(path: Path, options: readers.Options) -> RawTable:
        numbers = np.frombuffer(path.read_bytes()[4:], dtype="<f8").reshape(3, -1)
        return RawTable(str(path), dict(zip(("time_s", "power_robot_w", "speed_m_s"), numbers, strict=True)))

    reader = readers.Reader("acme", "ACME log", (".acme",), (b"ACME",), table=read)

    class Point:
        name, value = "acme", "acme:READER"

        @staticmethod
        def load() -> readers.Reader:
            return reader

    monkeypatch.setattr(
        "importlib.metadata.entry_points", lambda group: [Point] if group == readers.ENTRY_POINTS else []
    )
    readers.registry.cache_clear()
    try:
        columns = motion(400)
        data = np.array([columns[name] for name in ("time_s", "power_robot_w", "speed_m_s")])
        (tmp_path / "a.acme").write_bytes(b"ACME" + data.tobytes())
        (log,) = read_logs(tmp_path)
        np.testing.assert_array_equal(log.power_w["robot"], columns["power_robot_w"])
        assert sum(block.rows for block in iter_blocks(tmp_path / "a.acme", rows=10)) == 400
        monkeypatch.setattr("missionsim.compare.core.LARGE_FILE_BYTES", 100)
        assert main(["compare", "--robot", "pioneer3dx", str(tmp_path), "--quiet"]) == 0
        assert main(["validate", str(tmp_path), "--quiet"]) == 0
        (tmp_path / "a.acme").write_bytes(b"time_s,power_robot_w\n1,2\n2,3\n")
        with pytest.raises(InputError, match="this is no ACME log, whatever its name says"):
            read_log(tmp_path / "a.acme")
    finally:
        readers.registry.cache_clear()


def test_no_suffix_stands_elsewhere(root: Path) -> None:
    """Suffixes of formats stand in the formats alone (and what a log is written as in `write` and `import`)."""
    rooms = [root / "missionsim" / room for room in ("logs", "importer", "cli", "compare")]
    spelled = {
        path.relative_to(root / "missionsim").as_posix()
        for room in rooms
        for path in room.rglob("*.py")
        if "formats" not in path.parts
        and any(f'"{s}"' in path.read_text() for s in (".parquet", ".ulg", ".db3", ".bag"))
    }
    assert spelled <= {"logs/blocks.py", "cli/import_.py"}


# encodings and names


@pytest.mark.parametrize(
    ("encoding", "told"),
    [("latin-1", "Latin-1"), ("cp1252", "Windows-1252"), ("utf-16", "UTF-16"), ("utf-16-le", "UTF-16"), ("utf-8", "")],
)
def test_encodings(tmp_path: Path, encoding: str, told: str) -> None:
    mark = "–" if encoding == "cp1252" else "°"
    rows = "\n".join(f"{i};{10 + i % 3};{20 + i % 2};Süd{mark}hang" for i in range(50))
    data = f"time_s;power_robot_w;Gehäuse [{mark}C];surface\n{rows}\n".encode(encoding)
    path = tmp_path / "run.csv"
    path.write_bytes(data)
    log = read_log(path)
    assert log.columns["surface"].names == (f"Süd{mark}hang",)  # type: ignore[union-attr]
    assert f"Gehäuse [{mark}C]" in log.columns
    assert [r for r in log.remarks if told and f"the text is {told}" in r.message] or not told
    late = tmp_path / "late.csv"
    late.write_bytes(
        b"time_s,power_robot_w,surface\n" + b"1,2,a\n" * 0 + b"".join(b"%d,10,abc\n" % i for i in range(20000))
    )
    late.write_bytes(late.read_bytes() + "20000,10,Süd\n".encode("latin-1"))
    assert read_log(late).columns["surface"].names == ("abc", "Süd")  # type: ignore[union-attr]
    assert not data.startswith(codecs.BOM_UTF8)


def test_a_name_that_stands_twice(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    rows = "".join(f"{i},{i % 5},{10 + i % 2},{20 + i % 2}\n" for i in range(40))
    path.write_text("t,v,Vent [C],Vent [C]\n" + rows)
    text = "kind: map\nsignals: {a: FIELD}\ncolumns: {time_s: t, power_robot_w: v + 5, temp_motor_c: a}\n"
    for field, first in (('"Vent [C] #1"', 10), ('"Vent [C] #2"', 20), ('"#4"', 20)):
        (log,) = run(tmp_path, text.replace("FIELD", field), path)
        assert log.number("temp_motor_c")[0] == first
    with pytest.raises(InputError) as caught:
        run(tmp_path, text.replace("FIELD", '"Vent [C]"'), path)
    fault = caught.value.faults[0]
    assert "stands 2 times" in fault.message
    assert "'#4'" in fault.allowed
    (log,) = run(tmp_path, text.replace("signals: {a: FIELD}\n", "").replace(", temp_motor_c: a", ""), path)
    assert log.rows == 40
    path.write_text("time_s,power_robot_w,Vent,Vent\n" + rows)
    assert read_log(path).rows == 40
    path.write_text("time_s,power_robot_w,speed_m_s,speed_m_s\n" + rows)
    with pytest.raises(InputError, match="stands twice in the header"):
        read_log(path)


def test_time_stamps_in_a_map(tmp_path: Path) -> None:
    rows = "".join(f"14.03.2025;09:21:{i:02d},500;{5 + i % 3}\n" for i in range(30))
    (tmp_path / "a.csv").write_text("Datum;Zeit;P\n" + rows)
    text = "kind: map\ncolumns: {time_s: {stamp: [Datum, Zeit], zone: Europe/Berlin}, power_robot_w: P}\n"
    (log,) = run(tmp_path, text, tmp_path / "a.csv")
    np.testing.assert_allclose(log.time_s, np.arange(30.0))
    assert any("a date, day first and a time of day in two columns, Europe/Berlin" in r.message for r in log.remarks)
    with pytest.raises(InputError, match="there is no zone 'Europe/Bern'"):
        run(tmp_path, text.replace("Berlin", "Bern"), tmp_path / "a.csv")
    with pytest.raises(InputError, match="'Datums' is not a column"):
        run(tmp_path, text.replace("[Datum,", "[Datums,"), tmp_path / "a.csv")


# files of one run


@pytest.mark.parametrize("fill", ["hold", "linear", "mean"])
def test_three_files_of_a_run(tmp_path: Path, fill: str) -> None:
    loggers.write_three(tmp_path / "run")
    (log,) = run(tmp_path, MAP.replace("FILL", fill), tmp_path / "run")
    t = log.time_s + 0.1
    assert log.rows == 1199
    assert np.abs(log.power_w["robot"] - loggers.power(t)).mean() < 0.02
    within = {"hold": 0.01, "linear": 0.001, "mean": 0.004}[fill]
    assert np.abs(log.number("speed_m_s") - loggers.speed(t)).mean() < within
    assert np.abs(log.number("on_lamp") - loggers.lamp(t)).sum() <= 2
    told = " ".join(map(str, log.remarks))
    for words in (
        "power: the text is Latin-1",
        "a date, day first, and time",
        "milliseconds since 1970",
        "taken as UTC",
    ):
        assert words in told


def test_a_file_that_has_times_of_day_only_has_the_day_of_the_others(tmp_path: Path) -> None:
    """Until ten seconds before their end: the rows of the others after that are left out, with a note."""
    power, *_ = loggers.write_three(tmp_path / "run")
    (dated,) = run(tmp_path, MAP.replace("FILL", "hold"), tmp_path / "run")
    lines = re.sub(r"\d\d\.\d\d\.\d{4} ", "", power.read_text("latin-1")).splitlines(keepends=True)
    power.write_text("".join(lines[:-100]), "latin-1")
    (log,) = run(tmp_path, MAP.replace("FILL", "hold"), tmp_path / "run")
    assert log.rows == dated.rows - 100
    np.testing.assert_allclose(log.power_w["robot"], dated.power_w["robot"][:-100])
    told = " ".join(map(str, log.remarks))
    assert "a file has times of day only; the day is that of the other file" in told
    assert "lie outside the other files; these were left out" in told


def test_files_that_do_not_belong_together(tmp_path: Path) -> None:
    files = loggers.write_three(tmp_path / "run")
    text = MAP.replace("FILL", "hold")
    with pytest.raises(InputError, match=r"the files do not overlap: odometry begins .* hint|do not overlap"):
        run(tmp_path, text.replace("time: Zeitstempel}", "time: Zeitstempel, zone: Europe/Berlin}"), tmp_path / "run")
    with pytest.raises(InputError, match=r"0 files match 'power\.csv' in run"):
        run(tmp_path, text, *files[1:])
    with pytest.raises(InputError, match=r"m\.yaml:4:\d+: error: the column of its time is missing"):
        run(tmp_path, text.replace("odometry.csv, time: stamp", "odometry.csv"), *files)
    files[1].write_text("stamp,v_x [m/s]\n" + "".join(f"{i},0.5\n" for i in range(100)))
    with pytest.raises(InputError, match="no clock in common") as told:
        run(tmp_path, text, *files)
    hint = re.search(r"`(lag: \S+ s)` for odometry", told.value.faults[0].hint)
    assert hint is not None
    assert run(tmp_path, text.replace("time: stamp", f"time: stamp, {hint[1]}"), *files)[0].rows > 90
    assert any("no clock in common" in one for one in suggest_map(files).missing)


# one bad file


def test_a_bad_file_is_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    for index in range(6):
        write_csv(tmp_path / "in" / f"run_{index}.csv", motion(100, seed=index))
    (tmp_path / "in" / "run_3.csv").write_bytes(b"\x00\x01\x02")
    (tmp_path / "m.yaml").write_text("kind: map\ncolumns: {time_s: time_s, power_robot_w: power_robot_w}\n")
    given = ["import", str(tmp_path / "in"), "--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "out")]
    assert main([*given, "--json", str(tmp_path / "found.json")]) == 1
    said = capsys.readouterr()
    assert "run_3.csv" in said.err
    assert "left out" in said.out
    found = json.loads((tmp_path / "found.json").read_text())
    assert (len(found["runs"]), len(found["left_out"])) == (5, 1)
    assert len(list((tmp_path / "out").iterdir())) == 5
    assert main([*given[:-1], str(tmp_path / "strict"), "--strict"]) == 2
    assert not (tmp_path / "strict").exists()


def test_a_damaged_recording_is_read_and_told(tmp_path: Path) -> None:
    path = loggers.write_states(tmp_path / "agv.jsonl")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:100], *lines[140:]]) + "\n")
    assert main(["import", str(path), "--suggest", "--out", str(tmp_path / "m.yaml"), "--quiet"]) == 0
    given = ["import", str(path), "--map", str(tmp_path / "m.yaml"), "--quiet", "--out"]
    assert main([*given, str(tmp_path / "a.parquet")]) == 1
    assert main([*given, str(tmp_path / "b.parquet"), "--strict"]) == 2
    assert not (tmp_path / "b.parquet").exists()


# clocks that jump


def test_a_clock_that_is_set_does_not_ask_for_memory(tmp_path: Path) -> None:
    columns = motion(400)
    columns["time_s"][200:] += 1.7e9
    path = write_csv(tmp_path / "a.csv", {**columns, "time_s": [f"{t:.2f}" for t in columns["time_s"]]})
    tracemalloc.start()
    log = read_log(path)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert log.time_s[-1] < 250
    assert log.energy_wh("robot") == pytest.approx(motion(400)["power_robot_w"].sum() * 0.5 / 3600, rel=0.05)
    told = [r for r in log.remarks if "time jumps 1 times, by up to 1.7e+09 s" in r.message]
    assert len(told) == 1
    blocks = list(iter_blocks(path, rows=50))
    assert np.concatenate([block.time_s for block in blocks])[-1] == pytest.approx(log.time_s[-1], abs=1e-3)


def test_a_long_folder_says_how_many_files_are_not_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(21):
        (tmp_path / f"r{number:02}.csv").write_text("time_s,a\n0,1\n1,2\n", encoding="utf-8")
    assert main(["import", str(tmp_path)]) == 0
    assert "r19.csv, … (21 in all)" in " ".join(capsys.readouterr().out.split())
