"""`import --suggest` on files as researchers publish them: what would be a wrong energy is put right, told or asked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from missionsim.importer.mapping import import_source
from missionsim.importer.suggest import Suggestion, suggest_map
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable
from tests.logs.conftest import write_csv

TIME_S = 0.1 * (np.arange(1200) + 0.5)
SPEED = np.clip(0.8 * np.sin(TIME_S / 6.0) + 0.4, 0.0, None)
POWER = 38.0 + 120.0 * SPEED + 60.0 * np.gradient(SPEED, TIME_S)
"""Below nought while it brakes."""
ENERGY_WH = float(POWER.sum()) * 0.1 / 3600.0


def imported(folder: Path, columns: Mapping[str, object], **form: str) -> tuple[LogTable, Suggestion]:
    """A log by nothing but the suggested map of its file, and the suggestion."""
    path = write_csv(folder / "run.csv", columns, **form)
    found = suggest_map([path])
    (folder / "map.yaml").write_text(found.text, encoding="utf-8")
    (log,) = import_source(path, load_map(folder / "map.yaml"))
    return log, found


def table(**columns: object) -> dict[str, object]:
    return {"Time (s)": TIME_S, "Speed (m/s)": SPEED, **{k.replace("_", " "): v for k, v in columns.items()}}


@pytest.mark.parametrize("code", [-9999.0, -999.0, 65535.0, 32767.0, 655.35])
def test_codes_for_no_value_are_left_out_of_every_column_and_told(tmp_path: Path, code: float) -> None:
    power = np.where(np.arange(1200) % 90 == 40, code, POWER.round(2))
    log, found = imported(tmp_path, table() | {"Power (W)": power})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)
    assert any(f"exactly {code:g}" in r.message and r.severity == "warning" for r in log.remarks)
    assert "-Power" not in found.text


def test_minus_one_in_single_rows_is_no_value_either(tmp_path: Path) -> None:
    speed = np.where(np.arange(1200) % 20 == 7, -1.0, SPEED.round(3))
    log, _ = imported(tmp_path, {"t": TIME_S, "v (m/s)": speed, "P (W)": POWER})
    assert np.trapezoid(log.number("speed_m_s"), log.time_s) == pytest.approx(np.trapezoid(SPEED, TIME_S), rel=0.01)


def test_a_saturated_meter_a_reversal_and_zeros_stay(tmp_path: Path) -> None:
    back = np.where((TIME_S > 50) & (TIME_S < 60), -1.0, SPEED.round(3))  # ten seconds backwards at one speed
    milli = np.minimum(1000 * np.clip(POWER, 0, None), 99999.0)
    for columns in ({"v (m/s)": back, "P (W)": POWER}, {"v (m/s)": SPEED, "P (mW)": milli}):
        log, _ = imported(tmp_path, {"t": TIME_S, **columns})
        assert not [r for r in log.remarks if "exactly" in r.message and "no value" in r.message]
        assert log.rows == 1200
    assert (log.power_w["robot"] > 99.9).sum() > 100


@pytest.mark.parametrize(
    ("delimiter", "decimal", "write"),
    [
        (";", ",", lambda mw: f"{mw:,.0f}".replace(",", ".")),
        (";", ",", lambda mw: f"{mw:,.1f}".translate(str.maketrans(",.", ".,"))),
        (",", ".", lambda mw: f'"{mw:,.0f}"'),
        (",", ".", lambda mw: f"{mw:,.1f}".replace(",", "'")),
    ],
)
def test_marks_of_thousands(tmp_path: Path, delimiter: str, decimal: str, write) -> None:  # type: ignore[no-untyped-def]
    columns = table() | {"Power (mW)": [write(mw) for mw in 1000 * POWER]}
    log, _ = imported(tmp_path, columns, delimiter=delimiter, decimal=decimal)
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.001)
    assert any("thousands" in remark.message for remark in log.remarks)
