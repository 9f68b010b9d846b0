"""Numbers that loggers write where they have none: judged for the whole of a column, in tables, long ones and bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.importer.mapping import import_source
from missionsim.inputs.loading import load_map
from missionsim.logs import iter_blocks, read_log
from missionsim.logs.codes import Found, Tally, without
from tests.logs.conftest import write_csv

RNG = np.random.default_rng(3)
N = 2400
TIME_S = 0.5 * (np.arange(N) + 0.5)
SPEED = np.clip(0.5 + 0.6 * np.sin(TIME_S / 9.0), 0.0, None)
ROUGH_W = 6.0 + 30.0 * SPEED**2 + np.where(RNG.random(N) < 0.5, 0.0, 14.0)
"""A meter that jumps from row to row as far as a code lies below it."""
ENERGY_WH = float(ROUGH_W.sum()) * 0.5 / 3600.0
LOST = RNG.random(N) < 0.05


def without_codes(data: np.ndarray) -> tuple[np.ndarray, Found]:
    """A whole column with its codes for no value as NaN; and the codes."""
    tally = Tally()
    tally.add(data)
    return without(data, tally.found()), tally.found()


def energy_of(folder: Path, power: np.ndarray) -> tuple[float, list[str]]:
    log = read_log(write_csv(folder / "run.csv", {"time_s": TIME_S, "power_robot_w": power, "speed_m_s": SPEED}))
    return log.energy_wh("robot"), [r.message for r in log.remarks if "exactly" in r.message]


def test_minus_one_is_none_where_it_is_the_only_value_below_nought(tmp_path: Path) -> None:
    found, said = energy_of(tmp_path, np.where(LOST, -1.0, ROUGH_W.round(3)))
    assert found == pytest.approx(ENERGY_WH, rel=0.01)
    assert said == [f"{LOST.sum()} of {N} values are exactly -1, far from all others: a code for no value"]


@pytest.mark.parametrize(
    "power",
    [
        np.where(LOST, -ROUGH_W, ROUGH_W).round(3),  # what goes back into the battery
        np.where(LOST, -25.0, ROUGH_W.round(3)),  # and the most that may: 16.1 Wh were read as 18.3
        np.where(LOST, -1.0, np.where(RNG.random(N) < 0.1, 0.0, ROUGH_W.round())),  # nought is measured as well
        np.where(SPEED > 1.0, -1.0, 2.0 + ROUGH_W.round(3)).clip(-1.0),  # two stretches, at a limit of the charging
        np.where(LOST, -1.0, 1.0 + RNG.integers(0, 40, N)),  # steps of one, of which nought is missing by chance
    ],
)
def test_what_may_be_measured_stays(power: np.ndarray) -> None:
    kept, found = without_codes(power)
    assert not found
    assert kept is power


def test_two_codes_on_one_side() -> None:
    gone = np.where(np.arange(N) % 50 == 3, -999.0, np.where(np.arange(N) % 50 == 9, -9999.0, ROUGH_W))
    kept, found = without_codes(gone)
    assert [code for code, _, _ in found] == [-9999.0, -999.0]
    assert np.isnan(kept).sum() == 2 * N / 50


@pytest.mark.parametrize("cut", [7, 500, 2000])
@pytest.mark.parametrize(
    "column",
    [
        np.where(LOST, -1.0, ROUGH_W.round(3)),
        np.where((np.arange(N) // 600) == 2, -9999.0, ROUGH_W),  # a quarter of the rows, together
        np.where(np.arange(N) == 900, 999.0, 990.0 + 4.0 * ROUGH_W),  # measured
        np.where(LOST, 655.35, SPEED),
        SPEED - 0.3,
    ],
)
def test_a_column_in_blocks_is_judged_as_a_whole(column: np.ndarray, cut: int) -> None:
    tally = Tally()
    for first in range(0, N, cut):
        tally.add(column[first : first + cut])
    assert tally.found() == without_codes(column)[1]


def test_a_column_that_glides_through_minus_one_is_not_read_twice() -> None:
    tally = Tally()
    tally.add(np.round(1.5 * np.sin(TIME_S / 9.0), 2))
    assert -1.0 in tally.met
    assert not tally.in_doubt()


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_block_of_nothing_but_codes(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("missionsim.logs.formats.delimited._BLOCK_BYTES", 4_000)
    gone = (np.arange(N) // 300) == 3
    path = write_csv(
        tmp_path / "run.csv",
        {
            "time_s": TIME_S,
            "power_robot_w": ROUGH_W,
            "speed_m_s": SPEED,
            "pressure_pa": np.where(gone, -9999.0, 3 + SPEED),
        },
    )
    if suffix == ".parquet":
        import pyarrow.csv
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.csv.read_csv(path), path.with_suffix(suffix))
    blocks = list(iter_blocks(path.with_suffix(suffix), rows=100))
    assert len(blocks) > 10
    assert all(
        np.nanmin(np.asarray(block.columns["pressure_pa"])) > 0.0 for block in blocks if "pressure_pa" in block.columns
    )
    said = [r for block in blocks for r in block.remarks if "exactly" in r.message]
    assert [(r.message[:11], r.line) for r in said] == [("300 of 2400", 902 if suffix == ".csv" else 0)]


def test_bags(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'logs' is not installed")
    from missionsim.importer.suggest import suggest_map
    from tests.logs.bag_messages import Bag

    bag = Bag()
    for t, watt, v, lost in zip(TIME_S, ROUGH_W, SPEED, LOST, strict=True):
        bag.number("/power", float(t), -9999.0 if lost else float(watt))
        bag.odometry("/odom", float(t), float(v))
    path = bag.write(tmp_path / "run")
    made = suggest_map([path])
    (tmp_path / "m.yaml").write_text(made.text)
    (log,) = import_source(path, load_map(tmp_path / "m.yaml"))
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)
    assert "power_robot_w: watts " in made.text  # its sign is not turned by the codes
    (said,) = [r for r in log.remarks if "exactly -9999" in r.message]
    assert said.column == "/power.data"


@pytest.mark.parametrize("code", [255.0, 99.99, 999.9, 999.99, 9999.9, -999.9, float(np.float32(999.9))])
@pytest.mark.parametrize("rows", ["few", "one", "a stretch"])
def test_nines_with_a_point_and_the_end_of_a_byte(code: float, rows: str) -> None:
    lost = {"few": LOST, "one": np.arange(N) == 700, "a stretch": (np.arange(N) > 700) & (np.arange(N) < 900)}[rows]
    volts = 24.0 + RNG.normal(0, 0.3, N).round(2)
    kept, found = without_codes(np.where(lost, code, volts))
    assert [count for _, count, _ in found] == [lost.sum()]
    assert np.isnan(kept).sum() == lost.sum()


@pytest.mark.parametrize(
    "values",
    [
        np.where(LOST, 255.0, RNG.integers(0, 100, N)),  # a byte that goes to its end
        np.where(LOST, 99.99, 30 * SPEED),  # a load
        np.where(np.arange(N) == 700, 255.0, ROUGH_W),  # an inrush
        np.where(LOST, 999.9, 40.0 + 100.0 * (SPEED > 0.5) + SPEED),
    ],
)
def test_those_near_what_is_measured_stay(values: np.ndarray) -> None:
    assert without_codes(values)[1] == []


@pytest.mark.parametrize("code", [-9999.0, 65535.0, 255.0, 999.9])
def test_a_code_in_most_rows(code: float) -> None:
    temperature = np.where(np.arange(N) % 20 < 13, code, (20.0 + 5.0 * SPEED).round(2))
    kept, found = without_codes(temperature)
    assert [(one, count) for one, count, _ in found] == [(code, int((temperature == code).sum()))]
    assert np.nanmax(kept) < 30.0


def test_a_meter_at_its_limit_in_most_rows_stays() -> None:
    assert not without_codes(np.where(SPEED > 0.5, 32.767, (20.0 * SPEED).round(3)))[1]


@pytest.mark.parametrize(
    ("code", "least", "step"), [(65535.0, 24000.0, 100.0), (-9999.0, 24.0, 0.1), (255.0, 20.0, 1.0)]
)
@pytest.mark.parametrize("every", [20, 2])
def test_a_coarse_measurement_has_codes_as_well(code: float, least: float, step: float, every: int) -> None:
    """A voltage of five values, with -9999 V in one row of twenty, made -13.2 Wh of 0.66."""
    row = np.arange(N)
    coarse = least + step * (row // 500)
    assert [one for one, _, _ in without_codes(np.where(row % every == 1, code, coarse))[1]] == [code]
    counts = row // 500  # a state, and one that says all
    assert not without_codes(np.where(row % every == 1, code, counts))[1]
