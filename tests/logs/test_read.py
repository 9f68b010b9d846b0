"""Reading CSV and Parquet: layouts that are read, and messages for those that are not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from missionsim.labels import Labels
from missionsim.logs import LogTable, check_log, describe, read_log, read_logs, row_durations
from missionsim.logs.formats.dialect import Dialect, count_rows
from tests.logs.conftest import motion, write_csv

GOOD = "time_s,power_robot_w,speed_m_s,surface\n0.5,10,0.1,tile\n1.5,12,0.2,carpet\n2.5,11,0.3,tile\n"


def kinds(log: LogTable) -> list[tuple[str, str]]:
    return [(remark.kind, remark.column) for remark in log.remarks]


def test_small_csv(tmp_path: Path) -> None:
    path = tmp_path / "run_00.csv"
    path.write_text(GOOD)
    log = read_log(path)
    assert (log.run, log.batteries, log.rows, log.power_from["robot"]) == ("run_00", ("robot",), 3, "power")
    np.testing.assert_array_equal(log.dt_s, [1.0, 1.0, 1.0])
    assert log.energy_wh("robot") == pytest.approx(33 / 3600)
    surface = log.columns["surface"]
    assert isinstance(surface, Labels)
    assert surface.texts().tolist() == ["tile", "carpet", "tile"]
    assert log.remarks == ()
    assert len(log.sha256) == 64


def test_arrays_are_read_only(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(GOOD)
    log = read_log(path)
    with pytest.raises(ValueError, match="read-only"):
        log.time_s[0] = 3.0
    with pytest.raises(TypeError):
        log.columns["x"] = log.dt_s  # type: ignore[index]


def test_parquet_and_csv_give_the_same(tmp_path: Path) -> None:
    columns = {**motion(), "surface": ["tile"] * 200 + ["carpet"] * 200, "on_laser": np.ones(400, dtype=int)}
    one = read_log(write_csv(tmp_path / "a.csv", columns))
    parquet.write_table(
        pa.table({key: pa.array(list(map(_plain, value))) for key, value in columns.items()}), tmp_path / "a.parquet"
    )
    two = read_log(tmp_path / "a.parquet")
    assert list(one.columns) == list(two.columns)
    for name in one.columns:
        a, b = one.columns[name], two.columns[name]
        if isinstance(a, Labels):
            assert isinstance(b, Labels)
            assert (a.texts() == b.texts()).all()
        else:
            assert not isinstance(b, Labels)
            np.testing.assert_allclose(a, b, rtol=1e-8)


def _plain(value: object) -> object:
    return value if isinstance(value, str) else float(value)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD.replace(",", ";"), "semicolons"),
        (GOOD.replace(",", "\t"), "tabs"),
        (GOOD.replace(",", ";").replace(".", ","), "decimal comma"),
        ("\ufeff" + GOOD, "byte order mark"),
        ("# robot 7\n# carpet hall\n" + GOOD, "2 lines before the header"),
        (GOOD.replace("\n", "\r\n"), ""),
        (GOOD.replace("10,", " 10 ,").replace("time_s,", "time_s, "), ""),
        (GOOD.replace("1.5,", "\n1.5,"), ""),
    ],
)
def test_other_layouts(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8", newline="")
    log = read_log(path)
    np.testing.assert_array_equal(log.power_w["robot"], [10, 12, 11])
    np.testing.assert_array_equal(log.number("speed_m_s"), [0.1, 0.2, 0.3])
    assert said in " ".join(map(str, log.remarks))


def test_utf16(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(GOOD, encoding="utf-16")
    log = read_log(path)
    np.testing.assert_array_equal(log.power_w["robot"], [10, 12, 11])
    assert ("format", "") in kinds(log)


def test_missing_spellings(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [
        f"{i}.5,{word},0.1" for i, word in enumerate(["10", "nan", "11", "NA", "12", "", "13", "None", "14", "null"])
    ]
    path.write_text("time_s,power_robot_w,speed_m_s\n" + "\n".join(rows) + "\n")
    log = read_log(path)
    missing = next(r for r in log.remarks if r.kind == "missing")
    assert missing.count == 5
    np.testing.assert_allclose(log.power_w["robot"][:9:2], [10, 11, 12, 13, 14])


@pytest.mark.parametrize(
    ("text", "message", "line", "column", "hint"),
    [
        ("", "the file is empty", 1, 1, ""),
        ("\n\n", "the file is empty", 1, 1, ""),
        ("time_s,power_robot_w\n", "there is a header but no rows", 1, 0, ""),
        ("0.5,10\n1.5,11\n", "the first line holds numbers, not column names", 1, 1, ""),
        ("time_s,power_robot_w\n0.5,10\n1.5,abc\n2.5,1_0\n", "this is not a number", 3, 5, ""),
        ("time_s,power_robot_w,speed_m_s\n0.5,10,1\n1.5,10\n2.5,10,1\n",
         "2 values where the header names 3 columns", 3, 1, ""),
        ("time_s,power_robot_w\n0,5,10,5\n1,5,11,5\n", "4 values where the header names 2 columns", 2, 1,
         "decimal commas? then separate the columns with semicolons"),
        ("time_s,power_robot_w,time_s\n0.5,10,1\n", "the column 'time_s' stands twice in the header", 1, 22, ""),
        ("tme_s,power_robot_w\n0.5,10\n1.5,11\n", "the column 'time_s' is missing", 1, 0,
         "rename 'tme_s' or use a map"),
        ("time_s,voltage_robot_v\n0.5,10\n1.5,11\n", "no battery is measured", 1, 0,
         "'current_robot_a' beside 'voltage_robot_v'"),
        ("time_s,power_w\n0.5,10\n1.5,11\n", "no battery is measured", 1, 0,
         "'power_w' as power_robot_w (rename it, or use a map)"),
        ("time_s,power_robot_w\n0.5,10\n", "the log has 1 row with a time", 0, 0, ""),
        ("time_s,power_robot_w\n,10\n,11\n,12\n", "the log has 0 rows with a time", 0, 0, ""),
        ("time_s,power_robot_w\n1,\n2,\n3,\n", "no battery has values in two rows or more", 0, 0, ""),
        ("time_s,power_robot_w\n1,5\n1,5\n1,6\n", "all rows have the same time", 0, 0, ""),
        ("time_s,power_robot_w,on_laser\n1,5,maybe\n2,5,perhaps\n3,6,1\n", "this column holds text, not numbers", 2,
         0, ""),
    ],
)  # fmt: skip
def test_what_cannot_be_read(
    tmp_path: Path, faults_of, text: str, message: str, line: int, column: int, hint: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    fault = faults_of(read_log, path).faults[0]
    assert fault.message == message
    assert (fault.file, fault.line, fault.column, fault.hint) == (str(path), line, column, hint)
    assert any(f.message == message for f in check_log(path))


def test_all_bad_cells_at_once(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{i},1{'x' if i % 2 else ''},0.1" for i in range(100)]
    path.write_text("time_s,power_robot_w,speed_m_s\n" + "\n".join(rows) + "\n")
    faults = faults_of(read_log, path).faults
    assert len(faults) == 21
    assert any(fault.message == "and 30 more such cells" for fault in faults)
    assert {fault.line for fault in faults if fault.column} == set(range(3, 43, 2))
    assert all(fault.column == len(str(fault.line - 2)) + 2 for fault in faults if fault.column)


def test_position_counts_blank_lines_and_quotes(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.csv"
    path.write_text('time_s,surface,power_robot_w\n0.5,"tile, old",10\n\n\n1.5,"tile, old",x1\n')
    fault = faults_of(read_log, path).faults[0]
    assert (fault.line, fault.column, fault.path, fault.got) == (5, 17, "power_robot_w", "x1")


def test_comments_among_the_rows(tmp_path: Path, faults_of) -> None:
    head, *rows = GOOD.splitlines(keepends=True)
    path = tmp_path / "run.csv"
    path.write_text(head + "# paused\n" + rows[0] + "# resumed, by hand\n" + "".join(rows[1:]) + "# end\n")
    log = read_log(path)
    assert (log.rows, log.energy_wh("robot")) == (3, pytest.approx(33 / 3600))
    assert [r.message for r in log.remarks] == ["lines that begin with # stand among the rows: 3"]
    path.write_text("# logger 3\n" + path.read_text())
    assert len(describe([read_log(path)], notes=True)) == 2  # lines before the header are told beside them
    path.write_text(head + "# paused\n" + rows[0] + "1.5,x,0.2,carpet\n2.5,1,0.1\n# end\n")
    assert {fault.line for fault in faults_of(read_log, path).faults} == {4, 5}


def test_rows_are_counted_as_they_are_read(tmp_path: Path) -> None:
    """Rows of quoted tables are counted by bytes, which must agree with what lines of text would say."""
    rng = np.random.default_rng(0)
    path = tmp_path / "a.csv"
    for ends in (["\n"], ["\r\n"], ["\n", "\r\n", "\r"]):
        for cells in (["a,b", "1"], ["1", "", " ", "\t"]):
            for _ in range(12):
                lines = "".join(rng.choice(cells) + rng.choice(ends) for _ in range(rng.integers(1, 10)))
                path.write_bytes(('"h"\n' + lines + rng.choice(["", "z"])).encode())
                with path.open(encoding="utf-8") as handle:
                    rows = sum(bool(line.strip()) for line in handle) - 1
                assert count_rows(path, Dialect(("h",), ",", ".", "utf-8", 1)) == rows


def test_binary_and_bags(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.csv"
    for head, said in [
        (b"\x00\x01\x02", "this is not a text file"),
        (b"#ROSBAG V2.0\n", "this is a ROS 1 bag, not a table"),
        (b"ULog\x01\x12\x35", "this is a ULog, not a table"),
    ]:
        path.write_bytes(head + b"\x00" * 50)
        assert faults_of(read_log, path).faults[0].message == said
    path.write_bytes(b"time_s,power_robot_w\n0.5,10\n1.5,\xff\n")
    fault = faults_of(read_log, path).faults[0]
    assert (fault.message, fault.line, fault.column) == ("this is not a number", 3, 5)
    path.write_bytes("time_s,power_robot_w,größe\n0.5,10,1\n".encode() + b"1.5,\xff,1\n")
    fault = faults_of(read_log, path).faults[0]
    assert (fault.message, fault.line, fault.column) == ("a byte that is not UTF-8 text", 3, 5)


def test_broken_parquet(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({"time_s": [0.5, 1.5], "power_robot_w": [1.0, 2.0]}), path)
    whole = path.read_bytes()
    for cut in (0, 3, 20, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        message = faults_of(read_log, path).faults[0].message
        assert "cannot be read" in message or "this is no Parquet file" in message
    path.write_bytes(b"PAR1" + whole[40:])
    assert faults_of(read_log, path).faults


def test_parquet_types(tmp_path: Path) -> None:
    stamps = pa.array([1_000_000, 1_500_000, 2_000_000], pa.timestamp("us"))
    table = pa.table(
        {
            "time_s": stamps,
            "power_robot_w": pa.array([1, None, 3], pa.int32()),
            "on_laser": [True, False, True],
            "surface": pa.array(["a", None, "b"]).dictionary_encode(),
            "weird": pa.array([[1], [2], [3]]),
            "nothing": pa.nulls(3),
            "segment": [1, 2, 3],
        }
    )
    path = tmp_path / "a.parquet"
    parquet.write_table(table, path)
    log = read_log(path)
    np.testing.assert_allclose(log.time_s, [1.0, 1.5, 2.0])
    np.testing.assert_allclose(log.power_w["robot"], [1, 2, 3])
    np.testing.assert_array_equal(log.number("on_laser"), [1, 0, 1])
    assert log.columns["surface"].texts().tolist() == ["a", "", "b"]  # type: ignore[union-attr]
    assert log.columns["segment"].texts().tolist() == ["1", "2", "3"]  # type: ignore[union-attr]
    assert "weird" not in log.columns
    assert "nothing" not in log.columns
    assert {("format", "weird"), ("missing", "nothing"), ("missing", "power_robot_w")} <= set(kinds(log))


def test_folders(tmp_path: Path, faults_of) -> None:
    for folder, tens in (("a", 0), ("b", 100)):
        (tmp_path / folder).mkdir()
        for run in (2, 1, 10):
            (tmp_path / folder / f"run_{run:02d}.csv").write_text(GOOD + f"3.5,{tens + run},0.1,tile\n")
    (tmp_path / "a" / "notes.txt").write_text("no log")
    assert [log.run for log in read_logs(tmp_path / "a")] == ["run_01", "run_02", "run_10"]
    both = read_logs([tmp_path / "a", tmp_path / "b"])
    assert [log.run for log in both][:2] == ["a/run_01", "a/run_02"]
    assert len(read_logs([tmp_path / "a", tmp_path / "a" / "run_01.csv"])) == 3
    (tmp_path / "empty").mkdir()
    messages = {f.message for f in faults_of(read_logs, [tmp_path / "empty", tmp_path / "a" / "run_1.csv"]).faults}
    assert messages == {"the folder holds no log", "there is no such file"}
    (tmp_path / "a" / "run_03.csv").write_text("time_s\n1\n")
    (tmp_path / "a" / "run_04.csv").write_text("")
    assert len(faults_of(read_logs, tmp_path / "a").faults) == 3 - 1


def test_copies_of_a_log_are_one_measurement(tmp_path: Path) -> None:
    for name, text in {"a": GOOD, "b": GOOD, "c": GOOD.replace("12", "13"), "d": GOOD}.items():
        (tmp_path / f"{name}.csv").write_text(text)
    (tmp_path / "z.csv").symlink_to(tmp_path / "c.csv")
    first, third = read_logs(tmp_path)
    assert (first.run, third.run) == ("a", "c")
    lines = describe([first, third])
    assert len(lines) == 2
    assert lines[0].startswith("warning: a: the log was given under several names")
    assert str(tmp_path / "b.csv") in lines[0]
    assert str(tmp_path / "d.csv") in lines[0]
    assert str(tmp_path / "z.csv") in lines[1]
    given = read_logs([tmp_path / "c.csv", tmp_path / "c.csv"])
    assert len(given) == 1
    assert given[0].remarks == (), "the same path twice needs no warning"


def test_last_line_cut_short(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.csv"
    path.write_text(GOOD + "3.5,1")
    log = read_log(path)
    assert log.rows == 3
    remark = log.remarks[0]
    assert (remark.message, remark.action, remark.line) == ("the last line is cut short", "it was left out", 5)
    path.write_text(GOOD.replace("1.5,12,0.2,carpet", "1.5,12") + "3.5,1")
    assert len(faults_of(read_log, path).faults) == 2


@pytest.mark.parametrize(
    ("time", "durations"),
    [
        ([0.5, 1.5, 2.5], [1.0, 1.0, 1.0]),
        ([0.0, 1.0, 2.0], [0.5, 1.0, 1.0]),
        ([0.0, 1.0, 5.0, 6.0], [0.5, 2.5, 2.5, 1.0]),
        ([10.0, 10.1], [0.1, 0.1]),
        ([0.2, 1.2], [0.7, 1.0]),
    ],
)
def test_durations(time: list[float], durations: list[float]) -> None:
    np.testing.assert_allclose(row_durations(np.array(time)), durations)


def test_start_up_is_light(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(GOOD)
    code = (
        "import sys; from missionsim.logs import check_log; assert check_log(sys.argv[1]) == [];"
        "print([m for m in ('pandas', 'scipy', 'matplotlib', 'rosbags', 'pint', 'simpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_describe_joins_runs(tmp_path: Path) -> None:
    for index in range(3):
        columns = motion(seed=index)
        columns["time_s"][50:] += 60.0
        write_csv(tmp_path / f"run_{index}.csv", columns)
    lines = describe(read_logs(tmp_path))
    assert len(lines) == 1
    assert "1 gap" in lines[0]
    assert lines[0].endswith("(and 2 more runs)")
