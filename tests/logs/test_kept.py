"""Files as programs keep their tables: Arrow, MATLAB, NumPy, data bases, JSON of other shapes; and what is refused."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import sqlite3
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as parquet
import pytest
from scipy.io import savemat

from missionsim.cli.app import run_command as main
from missionsim.errors import InputError
from missionsim.importer.sources import find_files
from missionsim.logs import LogTable, read_log
from missionsim.logs.formats.arrays import read_numpy
from missionsim.logs.readers import Options, reader_of
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.1).round(1)
W, V, YAW = loggers.power(T), loggers.speed(T), loggers.turn(T)
WH = float(W.sum() * 0.1 / 3600)
PLAIN = {"t": T, "v": V, "w": YAW, "power": W}
ROWS = [
    {"t": t, "pose": {"x": 0.0}, "v": v, "w": w, "power": p, "on": True, "goal": None}
    for t, v, w, p in zip(T.tolist(), V.tolist(), YAW.tolist(), W.tolist(), strict=True)
]
STAMPED = [
    {"header": {"stamp": {"sec": int(1.7e9 + one["t"]), "nanosec": round(one["t"] % 1 * 1e9)}}, **one, "t": {}}
    for one in ROWS
]


def nested(path: Path) -> None:
    structs = {
        "elapsed": pa.array((T * 1e6).round().astype("int64"), pa.duration("us")),
        "twist": pa.array(
            [{"linear": {"x": v}, "angular": {"z": w}} for v, w in zip(V.tolist(), YAW.tolist(), strict=True)]
        ),
        "battery": pa.array([{"voltage": 25.0 - w / 50, "current": w / (25.0 - w / 50)} for w in W.tolist()]),
    }
    parquet.write_table(pa.table(structs), path)


def listed(path: Path) -> None:
    """Lists in cells, as pandas writes what a message holds several of."""
    lines = [f'{t},"[{v}, 0.0, 0.0]","[0. 0. {w}]",{p}\n' for t, v, w, p in zip(T, V, YAW, W, strict=True)]
    path.write_text("t,linear,angular,power\n" + "".join(lines))


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.feather": lambda path: feather.write_feather(pa.table(PLAIN), path),
    "a.parquet": nested,
    "a.mat": lambda path: savemat(path, {**PLAIN, "note": "x", "gain": 3.0}),
    "struct.mat": lambda path: savemat(path, {"log": PLAIN}),
    "a.npz": lambda path: np.savez(path, **PLAIN),  # type: ignore[arg-type]
    "dated.npz": lambda path: np.savez(  # with a row for a vector, and bytes
        path,
        stamp=np.datetime64("2024-05-01T10:00:00.000") + (T * 1000).round().astype("timedelta64[ms]"),
        **{"v": V[None], "w": YAW[:, None], "power": W, "state": np.full(len(T), b"go")},
    ),
    "a.npy": lambda path: np.save(path, np.rec.fromarrays(list(PLAIN.values()), names=list(PLAIN))),
    "columns.json": lambda path: path.write_text(
        json.dumps({"robot": "r1"} | {k: x.tolist() for k, x in PLAIN.items()})
    ),
    "events.json": lambda path: path.write_text(
        json.dumps({k: x.tolist() for k, x in PLAIN.items()} | {"events": [{"t": 1, "power": 1}, {"t": 2, "power": 2}]})
    ),
    "pandas.json": lambda path: path.write_text(
        json.dumps({k: {str(i): x for i, x in enumerate(y.tolist())} for k, y in PLAIN.items()}, indent=1)
    ),
    "samples.json": lambda path: path.write_text(json.dumps({"robot": "r1", "samples": ROWS}, indent=1)),
    "stamped.jsonl": lambda path: path.write_text("".join(json.dumps(one) + "\n" for one in STAMPED)),
    "texts.jsonl": lambda path: path.write_text(
        "".join(
            json.dumps(one | {"header": {"stamp": {k: str(x) for k, x in one["header"]["stamp"].items()}}}) + "\n"
            for one in STAMPED
        )
    ),
    "printed.log": lambda path: path.write_text("connected to /dev/ttyUSB0\n" + "".join(f"{one}\n" for one in ROWS)),
    "numpy2.log": lambda path: path.write_text(
        "".join(f"{one}\n".replace("'v': ", "'v': np.float64(").replace(", 'w'", "), 'w'") for one in ROWS)
    ),
    "lists.csv": listed,
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_programs_keep_is_read(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)
    made, out = tmp_path / "made.yaml", tmp_path / "out.parquet"
    assert main(["import", str(tmp_path / name), "--suggest", "--out", str(made), "--quiet"]) == 0
    code = main(["import", str(tmp_path / name), "--map", str(made), "--out", str(out), "--quiet"])
    assert code == (name == "printed.log")  # a line that is none
    log: LogTable = read_log(out)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(V.max(), rel=0.01)
    assert log.number("yaw_rate_rad_s").max() == pytest.approx(YAW.max(), rel=0.01)


def base(path: Path) -> None:
    with sqlite3.connect(path) as held:
        held.execute("create table samples (ts real, power real)")


def sheet(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("[Content_Types].xml", "<Types/>")


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.db", base, "sqlite3 -header -csv"),
        ("a.xlsx", sheet, "save the sheet as CSV"),
        ("a.mat", b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n" + b"\0" * 99, "'-v7'"),
        ("a.h5", b"\x89HDF\r\n\x1a\n" + b"\0" * 99, "an HDF5 file"),
        ("a.pkl", b"\x80\x04\x95\0\0" + b"\0" * 99, "would run code"),
        ("a.npy", lambda path: np.save(path, np.zeros((9, 3))), "without names"),
        ("a.log", b"(1715678493.130251) can0 221#0000000000000000\n" * 99, "decode it"),
    ],
)
def test_what_is_not_read_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes | Callable[[Path], object], told: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    assert main(["import", str(path), "--suggest", "--out", str(tmp_path / "made.yaml")]) == 2
    assert told in " ".join(capsys.readouterr().err.split())


def test_lists_of_cells_are_no_further_columns(tmp_path: Path) -> None:
    lines = (f'{t},{p},{v},"[{3700 - p / 9:.3f}, {3690 - p / 9:.3f}]"\n' for t, p, v in zip(T, W, V, strict=True))
    (tmp_path / "a.csv").write_text("t,power,v,bms.cell_vol\n" + "".join(lines))
    assert main(["import", str(tmp_path / "a.csv"), "--suggest", "--out", str(tmp_path / "m.yaml"), "--quiet"]) == 0
    assert "cell_vol" not in (tmp_path / "m.yaml").read_text().split("# not used")[0]


def test_a_folder_of_kept_files_is_read(tmp_path: Path) -> None:
    names = ["a.feather", "a.mat", "a.npz"]
    for name in names:
        WRITERS[name](tmp_path / name)
    (tmp_path / "text.mat").write_text("t,power\n0,1\n1,2\n")  # MATLAB calls its texts so too
    assert [path.name for path in find_files([tmp_path])] == [*names, "text.mat"]
    assert [reader_of(tmp_path / name).name for name in (*names, "text.mat")] == ["feather", "matlab", "numpy", "csv"]


def zipped(path: Path, content: bytes) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("runs/log.csv", content)


PACKERS: dict[str, Callable[[Path, bytes], object]] = {
    "a.csv.gz": lambda path, content: path.write_bytes(gzip.compress(content)),
    "cut.csv.gz": lambda path, content: path.write_bytes(gzip.compress(content)[:-300]),
    "a.csv.bz2": lambda path, content: path.write_bytes(bz2.compress(content)),
    "a.csv.xz": lambda path, content: path.write_bytes(lzma.compress(content)),
    "a.zip": zipped,
}


@pytest.mark.parametrize("name", PACKERS)
def test_a_packed_file_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    lines = "".join(f"{t},{w:.4f},{v:.4f}\n" for t, w, v in zip(T, W, V, strict=True))
    PACKERS[name](tmp_path / name, b"time_s,power_robot_w,speed_m_s\n" + lines.encode())
    log = read_log(tmp_path / name)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.1 if "cut" in name else 0.01)
    assert (log.source, log.run) == (str(tmp_path / name), name.partition(".")[0])
    assert [r.severity for r in log.remarks if r.kind == "damaged"] == ["error"] * ("cut" in name)
    PACKERS[name](tmp_path / name, b"time_s,power_robot_w\n1,2\nx,3\n")
    assert main(["validate", str(tmp_path / name)]) == 2
    assert name in capsys.readouterr().err


def test_a_folder_counts_no_run_twice_and_no_archive(tmp_path: Path) -> None:
    """`run.csv` and `run.csv.gz` were two runs, twice the energy; an archive beside them refused all."""
    for name in ("run.csv", "run.csv.gz", "other.csv.gz", "all.tar.gz"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in find_files([tmp_path])] == ["other.csv.gz", "run.csv"]


def test_a_packed_archive_is_not_one_table(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,power\n0,1\n1,2\n")
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as archive:
        archive.add(tmp_path / "log.csv")
    with pytest.raises(InputError, match="packed"):
        read_log(tmp_path / "a.tar.gz")


def test_what_is_no_vector_is_told(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **PLAIN, spectrum=V * 1j, image=np.zeros((len(T), 2, 2)))  # type: ignore[arg-type]
    told = [remark.message for remark in read_numpy(tmp_path / "a.npz", Options()).remarks]
    assert told == [f"spectrum, image: no vector of {len(T)} numbers or texts as the others are"]


@pytest.mark.parametrize("inside", [True, False])
def test_few_values_of_a_time_are_rows(tmp_path: Path, inside: bool) -> None:
    columns = {"t": [0, 1, 2, 3], "power": [5, 6, 7, 8]}
    (tmp_path / "a.json").write_text(json.dumps({"robot": "x", "data": columns} if inside else columns))
    reader = reader_of(tmp_path / "a.json")
    assert reader.recording is not None
    (topic,) = reader.recording(tmp_path / "a.json", Options()).topics
    assert topic.time_s.tolist() == [0, 1, 2, 3]


def test_a_long_file_of_lines_is_not_read_to_tell_its_shape(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in ROWS) + "\n" * 100)
    with open(path, "ab") as file:
        file.truncate(1 << 28)  # noughts, which would be as many letters
    tracemalloc.start()
    reader = reader_of(path)
    assert reader.recording is not None
    reader.recording(path, Options(most=2))
    assert tracemalloc.get_traced_memory()[1] < 1 << 22
    tracemalloc.stop()
