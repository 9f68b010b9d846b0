"""Long logs block by block: together they are the whole log."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from missionsim.labels import Labels
from missionsim.logs import LogTable, iter_blocks, read_log
from missionsim.logs.raw import merge
from tests.logs.conftest import motion, write_csv


def joined(blocks: list[LogTable], name: str) -> list[object]:
    columns = [block.columns[name] for block in blocks]
    return [item for data in columns for item in (data.texts() if isinstance(data, Labels) else data).tolist()]


def columns_of(n: int, step_s: float = 0.1) -> dict[str, np.ndarray]:
    columns = motion(n, step_s)
    columns["energy_laptop_wh"] = np.cumsum(5 + columns["speed_m_s"]) * step_s / 3600
    columns["voltage_aux_v"] = np.repeat(12 - 0.001 * np.arange(n // 10), 10)
    columns["current_aux_a"] = np.repeat(1 + motion(n // 10)["speed_m_s"], 10)
    columns["surface"] = np.where(np.arange(n) % 700 < 300, "tile", "carpet")
    return columns


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("rows", [1999, *(pytest.param(rows, marks=pytest.mark.long) for rows in (500, 100_000))])
def test_blocks_are_the_log(tmp_path: Path, form: str, rows: int) -> None:
    columns = columns_of(40_000 if form == "csv" else 6000)
    keep = np.random.default_rng(0).random(len(columns["time_s"])) > 0.02
    columns = {name: data[keep] for name, data in columns.items()}
    if form == "csv":
        path = write_csv(tmp_path / "a.csv", columns)
    else:
        path = tmp_path / "a.parquet"
        parquet.write_table(
            pa.table({name: pa.array(data.tolist()) for name, data in columns.items()}), path, row_group_size=1700
        )
    whole = read_log(path)
    blocks = list(iter_blocks(path, rows=rows))
    assert sum(block.rows for block in blocks) == whole.rows
    if form == "parquet":
        assert len(blocks) == -(-whole.rows // rows)
    for name in whole.columns:
        assert joined(blocks, name) == joined([whole], name)
    np.testing.assert_allclose(np.concatenate([block.dt_s for block in blocks]), whole.dt_s, rtol=1e-9)
    for battery in whole.batteries:
        np.testing.assert_allclose(
            np.concatenate([b.power_w[battery] for b in blocks]), whole.power_w[battery], rtol=1e-6
        )
        assert sum(b.energy_wh(battery) for b in blocks) == pytest.approx(whole.energy_wh(battery), rel=1e-9)
    fresh = whole.fresh["aux"]
    assert fresh is not None
    assert (np.concatenate([np.asarray(b.fresh["aux"]) for b in blocks]) == fresh).all()


def test_repairs_in_blocks(tmp_path: Path) -> None:
    columns = motion(5000, 0.1)
    columns["speed_m_s"][[998, 999, 1000, 1001]] = np.nan
    columns["power_robot_w"][3000:3100] = np.nan
    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({name: pa.array(data) for name, data in columns.items()}), path)
    whole = read_log(path)
    blocks = list(iter_blocks(path, rows=1000))
    assert sum(b.rows for b in blocks) == whole.rows == 4900
    np.testing.assert_allclose(np.concatenate([b.number("speed_m_s") for b in blocks]), whole.number("speed_m_s"))
    remarks = merge(r for b in blocks for r in b.remarks)
    assert any(r.action == "these rows were left out" and r.count >= 100 for r in remarks)


def test_chosen_columns(tmp_path: Path) -> None:
    columns = columns_of(1000)
    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({name: pa.array(data.tolist()) for name, data in columns.items()}), path)
    (block,) = iter_blocks(path, columns=["speed_m_s"])
    assert set(block.batteries) == {"robot", "laptop", "aux"}
    assert "surface" not in block.columns
    assert "yaw_rate_rad_s" not in block.columns


def test_faults_in_blocks(tmp_path: Path, faults_of) -> None:
    path = tmp_path / "a.parquet"
    columns = motion(3000, 0.1)
    columns["time_s"][2000:] -= 100.0
    parquet.write_table(pa.table({name: pa.array(data) for name, data in columns.items()}), path)
    assert "time runs backwards" in faults_of(lambda: list(iter_blocks(path, rows=1000))).faults[0].message
    parquet.write_table(
        pa.table({"time_s": pa.array([], pa.float64()), "power_robot_w": pa.array([], pa.float64())}), path
    )
    assert faults_of(lambda: list(iter_blocks(path))).faults[0].message == "there is a header but no rows"
    text = tmp_path / "a.csv"
    text.write_text("time_s,power_robot_w\n" + "".join(f"{i},{i}\n" for i in range(2000)) + "2000,x\n")
    assert faults_of(lambda: list(iter_blocks(text))).faults[0].line == 2002


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    def peak(n: int) -> int:
        path = tmp_path / f"{n}.parquet"
        writer = None
        for start in range(0, n, 20_000):
            columns = {name: pa.array(data) for name, data in motion(20_000, 0.05, start).items()}
            columns["time_s"] = pa.array(0.05 * (np.arange(start, start + 20_000) + 0.5))
            table = pa.table(columns)
            writer = writer or parquet.ParquetWriter(path, table.schema)
            writer.write_table(table)
        assert writer is not None
        writer.close()
        tracemalloc.start()
        rows = sum(block.rows for block in iter_blocks(path, rows=20_000))
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert rows == n
        return most

    assert peak(240_000) < 1.2 * peak(80_000)
