"""Whatever is done to a log or a map, reading it gives a log, or faults with their place; never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionsim.errors import Fault, InputError
from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs import check_log, iter_blocks, read_log
from tests.logs.conftest import motion, write_csv
from tests.logs.test_maps import BASE, source

Result = TypeVar("Result")
SETTINGS = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
CELLS = st.sampled_from([
    "", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "abc", "0", "-5", '"', "'", ",", ";", "1,5", "1.5.2",
    "0x10", "１", "True", "2024-01-01", "\x00", "\ufeff", "é", "\r", "=1+1", "9" * 400, " ", "#", "\t",
])  # fmt: skip


def lines() -> list[str]:
    rng = np.random.default_rng(0)
    table = motion(60, 0.5)
    rows = [
        f"{t:.2f},{p:.3f},{v:.3f},{'tile' if rng.random() < 0.5 else 'carpet'}"
        for t, p, v in zip(table["time_s"], table["power_robot_w"], table["speed_m_s"], strict=True)
    ]
    return ["time_s,power_robot_w,speed_m_s,surface", *rows]


def attempt(function: Callable[[], Result]) -> tuple[Result | None, tuple[Fault, ...]]:
    """What a function gives, or the faults that it tells."""
    try:
        return function(), ()
    except InputError as error:
        return None, error.faults


def holds(path: Path) -> None:
    """The promise: a log without holes, or faults that name the file."""
    log, faults = attempt(lambda: read_log(path))
    if log is None:
        assert faults
        assert all(fault.file == str(path) and fault.message for fault in faults)
        assert check_log(path)
        return
    assert log.rows >= 2
    assert (np.diff(log.time_s) > 0).all()
    assert (log.dt_s >= 0).all()
    for battery in log.batteries:
        assert np.isfinite(log.power_w[battery]).all()
        assert np.isfinite(log.energy_wh(battery))
    changed = any(r.kind in ("missing", "range", "duplicate", "time_backwards", "format") for r in log.remarks)
    assert changed or log.rows == len([line for line in path.read_bytes().splitlines() if line.strip()]) - 1
    rows, faults = attempt(lambda: sum(block.rows for block in iter_blocks(path, rows=20)))
    assert rows or faults


@SETTINGS
@given(edits=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 3), CELLS), min_size=1, max_size=6))
def test_mangled_cells(tmp_path: Path, edits: list[tuple[int, int, str]]) -> None:
    table = [line.split(",") for line in lines()]
    for row, column, cell in edits:
        table[row][column] = cell
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(row) for row in table) + "\n", encoding="utf-8")
    holds(path)


@SETTINGS
@given(
    order=st.lists(st.integers(0, 59), min_size=2, max_size=80),
    cut=st.integers(1, 30),
    ending=st.sampled_from(["\n", "\r\n", "\n\n", "\r"]),
)
def test_mangled_rows(tmp_path: Path, order: list[int], cut: int, ending: str) -> None:
    header, *rows = lines()
    text = ending.join([header, *(rows[index] for index in order)])
    path = tmp_path / "a.csv"
    path.write_bytes(text[:-cut].encode())
    holds(path)


@SETTINGS
@given(edits=st.lists(st.tuples(st.integers(0, 1500), st.binary(min_size=0, max_size=3)), min_size=1, max_size=10))
def test_mangled_bytes(tmp_path: Path, edits: list[tuple[int, bytes]]) -> None:
    data = bytearray("\n".join(lines()).encode())
    for at, new in edits:
        data[at : at + 2] = new
    path = tmp_path / "a.csv"
    path.write_bytes(bytes(data))
    holds(path)


@SETTINGS
@given(st.binary(max_size=300))
def test_any_bytes(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(data)
    holds(path)


@SETTINGS
@given(
    edits=st.lists(st.tuples(st.integers(4, 4000), st.integers(0, 255)), min_size=1, max_size=8),
    cut=st.integers(0, 400),
)
def test_mangled_parquet(tmp_path: Path, edits: list[tuple[int, int]], cut: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({name: pa.array(column) for name, column in motion(50).items()}), path)
    data = bytearray(path.read_bytes())
    for at, new in edits:
        data[at % len(data)] = new
    path.write_bytes(bytes(data[: len(data) - cut]))
    log, faults = attempt(lambda: read_log(path))
    assert log is not None or faults
    assert all(fault.file == str(path) for fault in faults)


@SETTINGS
@given(
    edits=st.lists(
        st.tuples(
            st.integers(0, 400),
            st.sampled_from(["", "x", ":", "{", "}", "[", "- ", "\n", "'", '"', "time_s", "**", "/ 0", "1e9", "null"]),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_mangled_maps(tmp_path: Path, edits: list[tuple[int, str]]) -> None:
    text = BASE + "  slope_rad: {quaternion: [qx, qy, qz, qw]}\n  surface: {lookup: floor, values: {1: a, 2: b}}\n"
    for at, new in edits:
        text = text[:at] + new + text[at + 1 :]
    table = tmp_path / "grass_07.csv"
    if not table.exists():
        source(tmp_path)
    path = tmp_path / "m.yaml"
    path.write_text(text)
    logs, faults = attempt(lambda: import_source(table, load_map(path)))
    assert logs or faults
    assert all(fault.message for fault in faults)
    assert all(np.isfinite(log.power_w[name]).all() for log in logs or () for name in log.batteries)


@pytest.mark.parametrize("values", ["1e308", "-1e308", "1e-320"])
def test_extreme_numbers(tmp_path: Path, values: str) -> None:
    columns = motion(60)
    columns["odd"] = np.full(60, float(values))
    columns["odd"][::3] = 0.0
    holds(write_csv(tmp_path / "a.csv", columns))
