"""A table of runs beside the logs: one row a run, with what held for the whole of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.errors import Fault, InputError
from missionsim.importer.mapping import import_source
from missionsim.importer.run_table import keys_of, rows_called
from missionsim.importer.sources import find_files
from missionsim.importer.suggest import suggest_map
from missionsim.inputs.loading import load_map
from missionsim.labels import Labels
from missionsim.logs import LogTable
from tests.logs.conftest import motion, write_csv

ROWS = ["run_01.csv,tile,0,21.5,Ann", "run_02.csv,carpet,2500,19,Bo", "run_03.csv,tile,5000,20,Ann"]
HEADER = "file,floor,load_g,ambient_C,driver"
MAP = """\
kind: map
runs: {table: runs.csv, key: file}
signals: {floor: runs.floor, load: runs.load_g, air: runs.ambient_C}
columns:
  time_s: time_s
  power_robot_w: power_robot_w
  speed_m_s: speed_m_s
  surface: floor
  payload_kg: {value: load, unit: g}
  temp_ambient_c: air
"""


def published(folder: Path, rows: list[str] = ROWS, runs: int = 3, text: str = MAP, header: str = HEADER) -> Path:
    """Logs in a folder, their table of runs above it, and the map beside that."""
    (folder / "logs").mkdir(exist_ok=True)
    for index in range(runs):
        write_csv(folder / "logs" / f"run_{index + 1:02d}.csv", motion(200, seed=index))
    (folder / "runs.csv").write_text("\n".join([header, *rows]) + "\n")
    (folder / "map.yaml").write_text(text)
    return folder / "logs"


def told(log: LogTable) -> tuple[str, float, float]:
    """Floor, load and temperature of a run, each the same in every row."""
    floor = log.columns["surface"]
    assert isinstance(floor, Labels)
    numbers = [np.unique(np.asarray(log.columns[name])) for name in ("payload_kg", "temp_ambient_c")]
    assert all(len(one) == 1 for one in numbers)
    assert len(np.unique(floor.codes)) == 1
    return floor.names[floor.codes[0]], float(numbers[0][0]), float(numbers[1][0])


def test_each_run_has_what_its_row_says(tmp_path: Path) -> None:
    logs = import_source(published(tmp_path), load_map(tmp_path / "map.yaml"))
    assert [told(log) for log in logs] == [("tile", 0.0, 21.5), ("carpet", 2.5, 19.0), ("tile", 5.0, 20.0)]


@pytest.mark.parametrize("keys", [("run_01", "run_02", "run_03"), ("a/logs/run_01.csv", "a/logs/run_02.csv", "x.csv"),
                                  ("1", "2", "3"), (r"D:\x\run_01.CSV", r"D:\x\run_02.CSV", "")])  # fmt: skip
def test_how_a_row_names_its_run(tmp_path: Path, keys: tuple[str, ...]) -> None:
    rows = [key + row[row.index(",") :] for key, row in zip(keys, ROWS, strict=True)]
    logs = import_source(published(tmp_path, rows, 2), load_map(tmp_path / "map.yaml"))
    assert [told(log) for log in logs] == [("tile", 0.0, 21.5), ("carpet", 2.5, 19.0)]
    said = [remark for log in logs for remark in log.remarks if "of no run" in remark.message]
    assert [remark.severity for remark in said] == ["note"]
    assert "1 of 3 rows of" in said[0].message
    assert "line 4" in said[0].message


def test_numbers_count_from_nought_as_well() -> None:
    assert [rows_called(["0", "1", "10"], [name]) for name in ("run_00", "run_10", "run_1_2")] == [[0], [2], []]


def test_numbers_keep_their_digits() -> None:
    assert keys_of(np.array([20250314.0, 7.0, 1.5])) == ["20250314", "7", "1.5"]


def test_another_log_and_a_table_of_something_else_are_no_table_of_runs(tmp_path: Path) -> None:
    """Of two logs with an index, the first was the table of the second, and left out; gains had a row for log_1."""
    for name in ("log_1", "log_2"):
        rows = "".join(f"{i},{0.2 * i:.1f},{20 + i % 7},{0.1 * (i % 9):.1f}\n" for i in range(60))
        (tmp_path / f"{name}.csv").write_text(f"index,time_s,power_robot_w,speed_m_s\n{rows}", encoding="utf-8")
    logs = sorted(tmp_path.glob("log_*.csv"))
    assert "table" not in suggest_map(logs).text
    (tmp_path / "gains.csv").write_text("id,kp,ki\n1,0.2,0.3\n2,0.5,0.1\n", encoding="utf-8")
    (tmp_path / "x.csv").mkdir()
    assert "table" not in suggest_map(logs[:1]).text


def test_a_table_in_the_folder_of_the_logs_is_no_log(tmp_path: Path) -> None:
    folder = published(tmp_path)
    (tmp_path / "runs.csv").rename(folder / "runs.csv")
    assert len(import_source(folder, load_map(tmp_path / "map.yaml"))) == 3
    made = suggest_map(find_files([folder]))
    assert "runs: {table: runs.csv, key: file}" in made.text


def test_runs_that_a_column_tells_apart(tmp_path: Path) -> None:
    columns = motion(200)
    run = np.where(np.arange(200) < 100, 7, 8)
    write_csv(tmp_path / "day.csv", {**columns, "trial": run})
    (tmp_path / "runs.csv").write_text("trial,floor,load_g,ambient_C\n7,tile,0,20\n8,carpet,1000,21\n")
    text = MAP.replace("key: file", "key: trial, by: trial")
    (tmp_path / "map.yaml").write_text(text)
    logs = import_source(tmp_path / "day.csv", load_map(tmp_path / "map.yaml"))
    assert [(log.run, *told(log)) for log in logs] == [("day_7", "tile", 0.0, 20.0), ("day_8", "carpet", 1.0, 21.0)]
    made = suggest_map([tmp_path / "day.csv"])
    assert "runs: {table: runs.csv, key: trial, by: [trial]}" in made.text


FAULTS: list[tuple[list[str], str, Fault]] = [
    (ROWS[:2], MAP, Fault("map.yaml", 2, 30, "no row of runs.csv is of the run 'run_03'", "runs.key", "run_03",
                          "run_01, run_02", "run_02")),
    ([*ROWS, ROWS[0]], MAP, Fault("runs.csv", 5, 0, "a second row of one run, the first is line 2", "file",
                                  "run_01.csv", "one row a run")),
    (ROWS, MAP.replace("key: file", "key: driver"),
     Fault("map.yaml", 2, 30, "no row of runs.csv is of the run 'run_01'", "runs.key", "run_01", "Ann, Bo",
           "key: file")),
    (ROWS, MAP.replace("key: file", "key: fiel"),
     Fault("map.yaml", 2, 30, "'fiel' is not in runs.csv", "runs.key", "fiel",
           "file, floor, load_g, ambient_C, driver", "file")),
    (ROWS, MAP.replace("runs.csv", "run.csv"),
     Fault("map.yaml", 2, 15, "there is no such table beside the logs or the map", "runs.table", "run.csv", "",
           "runs.csv")),
    (ROWS, MAP.replace("runs.load_g", "runs.load"),
     Fault("map.yaml", 3, 36, "'runs.load' is not in runs.csv", "signals.load", "runs.load",
           "runs.file, runs.floor, runs.load_g, runs.ambient_C, runs.driver", "runs.load_g")),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "text", "fault"), FAULTS)
def test_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: list[str], text: str, fault: Fault) -> None:
    published(tmp_path, rows, text=text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        import_source("logs", load_map("map.yaml"))
    (found,) = caught.value.faults
    assert (Path(found.file).name, *vars(found).values())[2:] == (fault.file, *vars(fault).values())[2:]
    assert Path(found.file).name == fault.file


def test_files_of_one_name_in_two_folders_do_not_share_a_row(tmp_path: Path) -> None:
    folder = published(tmp_path, ["run_01,tile,0,20,Ann", "run_02,tile,0,20,Ann"], 2)
    (tmp_path / "again").mkdir()
    (folder / "run_02.csv").rename(tmp_path / "again" / "run_01.csv")
    with pytest.raises(
        InputError, match=r"runs.csv:2: error: one row for two runs(.|\n)*the folder in it: again/run_01"
    ):
        import_source([folder, tmp_path / "again"], load_map(tmp_path / "map.yaml"))


def test_a_run_without_a_row_is_left_out_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    published(tmp_path, ROWS[:2])
    monkeypatch.chdir(tmp_path)
    assert main(["import", "logs", "--map", "map.yaml", "--out", "out"]) == 1
    said = capsys.readouterr()
    assert "logs/run_03.csv: error: no row of runs.csv is of the run 'run_03' (map.yaml:2)" in said.err
    assert "left out: logs/run_03.csv" in said.out


def test_a_table_needs_a_key(tmp_path: Path) -> None:
    published(tmp_path, text=MAP.replace(", key: file", ""))
    with pytest.raises(InputError, match="'table' and 'key' go together"):
        load_map(tmp_path / "map.yaml")


def test_a_suggested_map_takes_the_table(tmp_path: Path) -> None:
    header, more = f"{HEADER},tyre pressure [bar],mean_power_W,date", [",2.1,14,2024-05-01", ",2.5,15,2024-05-02"]
    rows = [f"{row}{end}" for row, end in zip(ROWS, [*more, more[0]], strict=True)]
    folder = published(tmp_path, rows, header=header)
    made = suggest_map([folder / "run_01.csv"])
    (tmp_path / "made.yaml").write_text(made.text)
    logs = import_source(folder, load_map(tmp_path / "made.yaml"))
    assert [told(log) for log in logs] == [("tile", 0.0, 21.5), ("carpet", 2.5, 19.0), ("tile", 5.0, 20.0)]
    assert {"driver", "tyre_pressure_bar"} <= logs[0].columns.keys()
    assert not any("mean" in name or name == "date" for name in logs[0].columns)  # results, and what is no cause


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_the_table_is_not_overwritten(tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    logs = published(tmp_path)
    before = (tmp_path / "runs.csv").read_text()
    out = ["--out", str(tmp_path / "runs.csv")] if option == "--out" else ["--out", str(tmp_path / "new.csv")]
    out += ["--json", str(tmp_path / "runs.csv")] if option == "--json" else []
    assert main(["import", str(logs / "run_01.csv"), "--map", str(tmp_path / "map.yaml"), *out]) == 2
    assert f"{option} would overwrite" in capsys.readouterr().err
    assert (tmp_path / "runs.csv").read_text() == before


@pytest.mark.parametrize(
    ("header", "key"),
    [
        ("run,file", "file"),  # a name says more than a number
        ("file,run", "file"),
        ("no,run", None),
        ("original,renamed", None),
    ],
)
def test_of_two_columns_that_name_the_runs(tmp_path: Path, header: str, key: str | None) -> None:
    """The first that fitted was the key: each run had what another one's row said."""
    names = {"run": "{}", "no": "{}", "file": "run_0{}.csv", "original": "run_0{}", "renamed": "run_0{}"}
    first, second = header.split(",")
    rows = [f"{names[first].format(k)},{names[second].format(4 - k)},{20 + k}" for k in (1, 2, 3)]
    folder = published(tmp_path, rows, header=f"{header},ambient_C")
    made = suggest_map(find_files([folder]))
    assert f"key: {key or 'KEY'}" in made.text
    told = [f"runs.csv: '{first}' and '{second}' name the runs, but not the same rows: write one in the place of KEY"]
    assert list(made.missing) == ([] if key else told)


@pytest.mark.parametrize("keys", [("folder", "run1", "run2", "run3"), ("run", "1", "2", "3")])
@pytest.mark.parametrize("inside", ["data.csv", "log_7.csv"])
def test_logs_in_folders_that_the_table_names(tmp_path: Path, keys: tuple[str, ...], inside: str) -> None:
    """Of a folder with a table of runs and the folders of the runs, the table alone was taken, for a log."""
    (tmp_path / "runs.csv").write_text(
        f"{keys[0]},{HEADER[5:]}\n" + "".join(f"{k},{row[11:]}\n" for k, row in zip(keys[1:], ROWS, strict=True))
    )
    for index in (1, 2, 3):
        (tmp_path / f"run{index}").mkdir()
        write_csv(tmp_path / f"run{index}" / inside, motion(200, seed=index))
    made = suggest_map(find_files([tmp_path]))
    assert f"runs: {{table: runs.csv, key: {keys[0]}}}" in made.text
    (tmp_path / "made.yaml").write_text(made.text)
    logs = import_source(tmp_path, load_map(tmp_path / "made.yaml"))
    assert [log.columns["surface"].names for log in logs] == [("tile",), ("carpet",), ("tile",)]


def test_a_run_without_a_word_has_no_row(tmp_path: Path) -> None:
    """An empty cell of what tells runs apart was an empty key of the table."""
    columns = motion(200, seed=1) | {"part": ["a"] * 100 + [""] * 100}
    write_csv(tmp_path / "day.csv", columns)
    (tmp_path / "runs.csv").write_text("part,floor\na,tile\n,carpet\n")
    (tmp_path / "map.yaml").write_text(
        MAP.replace("key: file}", "key: part, by: [part]}")
        .replace(", load: runs.load_g, air: runs.ambient_C", "")
        .replace("  payload_kg: {value: load, unit: g}\n  temp_ambient_c: air\n", "")
    )
    with pytest.raises(InputError, match=r"no row of runs\.csv is of the run 'day_none'"):
        import_source(tmp_path / "day.csv", load_map(tmp_path / "map.yaml"))
