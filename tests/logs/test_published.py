"""`import --suggest` on files as researchers publish them: what would be a wrong energy is put right, told or asked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.errors import InputError
from missionsim.importer.mapping import import_source
from missionsim.importer.suggest import Suggestion, suggest_map
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, read_log
from tests.logs.conftest import write_csv

TIME_S = 0.1 * (np.arange(1200) + 0.5)
SPEED = np.clip(0.8 * np.sin(TIME_S / 6.0) + 0.4, 0.0, None)
POWER = 38.0 + 120.0 * SPEED + 1500.0 * np.gradient(SPEED, TIME_S)
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
    gone = np.arange(1200) % 20 == 7
    speed, power = np.where(gone, -1.0, SPEED.round(3)), np.where(gone, -1.0, POWER.round(2))
    log, _ = imported(tmp_path, {"t": TIME_S, "v (m/s)": speed, "P (W)": power})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)
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
        (";", ",", lambda mw: f"{mw:,.1f}".translate(str.maketrans(",.", "\u202f,"))),
        (";", ",", lambda mw: f"{mw:,.1f}\xa0mW".translate(str.maketrans(",.", "\xa0,"))),
        (",", ".", lambda mw: f"{mw:,.0f}".replace(",", " ")),
    ],
)
def test_marks_of_thousands(tmp_path: Path, delimiter: str, decimal: str, write) -> None:  # type: ignore[no-untyped-def]
    columns = table() | {"Power (mW)": [write(mw) for mw in 1000 * POWER]}
    log, _ = imported(tmp_path, columns, delimiter=delimiter, decimal=decimal)
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.001)
    assert any("thousands" in remark.message for remark in log.remarks)


def counted(power: np.ndarray) -> np.ndarray:
    return (np.cumsum(power) * 0.1 / 3600.0).round(5)


OUT, BACK = np.clip(POWER, 0.0, None), np.clip(-POWER, 0.0, None)


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (("Energy out [Wh]", "Energy in [Wh]"), counted),
        (("Discharged energy (Wh)", "Regenerated energy (Wh)"), counted),
        (("Traction energy (Wh)", "Regen energy (Wh)"), counted),
        (("Discharge power (W)", "Charge power (W)"), np.asarray),
        (("Discharge power (W)", "Charge power (W)"), lambda p: p if p is OUT else -p),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_what_goes_back_is_subtracted(tmp_path: Path, names: tuple[str, str], what, order: int) -> None:  # type: ignore[no-untyped-def]
    columns = dict([(names[0], what(OUT)), (names[1], what(BACK))][::order])
    log, found = imported(tmp_path, table() | columns)
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)
    assert all(guess.sure != "sure" for name, guess in found.columns.items() if "robot" in name)


def test_what_goes_back_alone_is_asked_about_and_another_counter_told(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "back.csv", table() | {"Regen energy (Wh)": counted(BACK)})
    assert any("goes back" in told for told in suggest_map([path]).missing)
    columns = table() | {"Energy A (Wh)": counted(OUT), "Energy B (Wh)": counted(BACK)}
    found = suggest_map([write_csv(tmp_path / "two.csv", columns)])
    assert found.columns["energy_robot_wh"].sure == "a guess"
    assert any("Energy B (Wh)" in told for told in found.remarks)


def test_both_sides_of_a_converter_are_no_two_directions(tmp_path: Path) -> None:
    _, found = imported(tmp_path, table() | {"Power in at the plug (W)": OUT + 9.0, "Power out (W)": 0.9 * OUT + 1.0})
    assert "subtracted" not in found.text


@pytest.mark.parametrize("wraps", [False, True])
def test_a_counter_that_begins_anew_loses_nothing(tmp_path: Path, wraps: bool) -> None:
    energy = counted(OUT)
    energy = (
        (energy + 1.3) % (0.5 * ENERGY_WH) if wraps else np.where(np.arange(1200) < 700, energy, energy - energy[700])
    )
    log, _ = imported(tmp_path, table() | {"Energy (Wh)": energy})
    assert log.energy_wh("robot") == pytest.approx(float(OUT.sum()) * 0.1 / 3600.0, rel=0.01)
    assert any("begins anew" in remark.message for remark in log.remarks)
    plain = write_csv(tmp_path / "log.csv", {"time_s": TIME_S, "speed_m_s": SPEED, "energy_robot_wh": energy})
    assert read_log(plain).energy_wh("robot") == pytest.approx(log.energy_wh("robot"), rel=1e-3)


def test_a_counter_that_braking_lowers_is_left_alone(tmp_path: Path) -> None:
    log, _ = imported(tmp_path, table() | {"Energy (Wh)": counted(np.where(SPEED > 0.9, -900.0, 40.0))})
    assert not any("begins anew" in remark.message for remark in log.remarks)


@pytest.mark.parametrize("name", ["Wh per step", "energy_step_wh"])
def test_energy_of_each_row_is_no_counter(tmp_path: Path, name: str) -> None:
    log, found = imported(tmp_path, table() | {name: POWER * 0.1 / 3600.0})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)
    assert found.columns["power_robot_w"].sure == "a guess"


@pytest.mark.parametrize("other", ["Mechanical power (W)", "Rated power (W)", "Nominal power [W]", "Peak power"])
def test_the_power_of_something_else_is_not_the_batterys(tmp_path: Path, other: str) -> None:
    wrong = np.full(1200, 500.0) if other[0] in "RN" else 0.6 * POWER
    log, _ = imported(tmp_path, table() | {other: wrong, "Electrical power (W)": POWER})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=1e-6)
    assert suggest_map([write_csv(tmp_path / "b.csv", table() | {other: wrong})]).missing


def test_a_constant_power_comes_last_and_cells_are_summed_with_a_question(tmp_path: Path) -> None:
    log, _ = imported(tmp_path, table() | {"Power P1 (W)": np.full(1200, 500.0), "Power P2 (W)": POWER})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=1e-6)
    cells = {f"Cell {i} voltage (V)": 3.6 + 0.001 * i - POWER / 1e4 for i in range(1, 8)}
    pack = np.sum(list(cells.values()), axis=0)
    log, found = imported(tmp_path, table() | cells | {"Pack current (A)": POWER / pack})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=1e-3)
    assert any("cells" in told for told in found.missing)


@pytest.mark.parametrize("name", ["cell_{}_v", "cell{}_voltage_mv", "vcell{}", "cells[{}]", "cells"])
def test_no_cell_is_taken_for_the_battery(tmp_path: Path, name: str) -> None:
    """Names of cells that stand close to their numbers, in a table and in messages."""
    amps = POWER / (7 * 3.7)
    cells = {name.format(i): np.full(1200, 3700.0 if name.endswith("mv") else 3.7) for i in range(1, 8)}
    path = write_csv(tmp_path / "a.csv", table() | cells | {"current_a": amps})
    if name == "cells":
        path = tmp_path / "a.jsonl"
        rows = zip(TIME_S, amps, strict=True)
        path.write_text("".join(json.dumps({"t": t, name: [3.7] * 7, "current": i}) + "\n" for t, i in rows))
    found = suggest_map([path])
    assert any("7 voltages of cells were added up" in told for told in found.missing)
    (tmp_path / "map.yaml").write_text(found.text)
    (log,) = import_source(path, load_map(tmp_path / "map.yaml"))
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)


@pytest.mark.parametrize("names", ["motor{}_speed_rpm", "wheel_{}_rpm"])
def test_wheels_that_are_numbered_are_all_taken(tmp_path: Path, names: str) -> None:
    count = 4 if "wheel" in names else 2
    turns = {names.format(i): SPEED / 0.1 / 0.10472 * (-1) ** i for i in range(count)}
    found = suggest_map([write_csv(tmp_path / "a.csv", {"t": TIME_S, "power_w": POWER} | turns)])
    (tmp_path / "map.yaml").write_text(found.text.replace("RADIUS", "-0.1"))
    (log,) = import_source(tmp_path / "a.csv", load_map(tmp_path / "map.yaml"))
    assert np.abs(log.number("speed_m_s")).max() == pytest.approx(SPEED.max(), rel=1e-3)


def test_words_of_wheels_are_no_pace(tmp_path: Path) -> None:
    words = {f"wheel_{i}_rpm": ["slow", "fast"] * 600 for i in (1, 2)}
    found = suggest_map([write_csv(tmp_path / "a.csv", {"t": TIME_S, "power_w": POWER} | words)])
    assert "speed_m_s" not in found.columns


START = datetime(2024, 11, 23, 13, 10, 40)
STAMPS = {
    "14 digits": "%Y%m%d%H%M%S",
    "17 digits": "%Y%m%d%H%M%S%f",
    "underscore": "%Y%m%d_%H%M%S",
    "dash": "%Y%m%d-%H%M%S.%f",
    "basic": "%Y%m%dT%H%M%SZ",
    "basic, micro": "%Y%m%dT%H%M%S.%f",
    "day first, micro": "%d/%m/%Y %H:%M:%S.%f",
    "month first, micro": "%m/%d/%Y %H:%M:%S.%f",
    "month first, short": "%m/%d/%y %H:%M:%S",
}


@pytest.mark.parametrize("form", STAMPS)
def test_compact_and_american_stamps(tmp_path: Path, form: str) -> None:
    times = [START + timedelta(seconds=i) for i in range(300)]
    stamps = [t.strftime(STAMPS[form]) for t in times]
    if form == "17 digits":
        stamps = [stamp[:17] for stamp in stamps]
    log, found = imported(tmp_path, {"timestamp": stamps, "v (m/s)": SPEED[:300], "Power (W)": POWER[:300]})
    assert log.time_s[-1] - log.time_s[0] == pytest.approx(299.0, abs=0.01)
    assert found.columns["time_s"].sure == "sure"


@pytest.mark.parametrize(
    ("zero", "per_second", "sure"),
    [
        (638_000_000_000_000_000, 1e7, "sure"),
        (133_800_000_000_000_000, 1e7, "sure"),
        (17_324_000_000_000_000, 1e7, "sure"),
        (300_000_000_000, 1e3, "a guess"),
    ],
)
def test_ticks_of_a_tenth_of_a_microsecond_and_years_without_robots(
    tmp_path: Path, zero: int, per_second: float, sure: str
) -> None:
    stamps = [zero + round(per_second * t) for t in TIME_S]
    log, found = imported(tmp_path, {"timestamp": stamps, "v (m/s)": SPEED, "Power (W)": POWER})
    assert log.time_s[-1] - log.time_s[0] == pytest.approx(TIME_S[-1] - TIME_S[0], abs=0.01)
    assert found.columns["time_s"].sure == sure


def two_vehicles(**more: object) -> dict[str, object]:
    """Rows of two vehicles in turn."""
    both = {"time": np.repeat(TIME_S, 2), "speed (m/s)": np.repeat(SPEED, 2)}
    return both | {"power (W)": np.stack([POWER, 1.5 * POWER], axis=1).ravel()} | more


@pytest.mark.parametrize("name", ["vehicle", "Robot ID", "which"])
def test_rows_of_two_vehicles_are_told_apart(tmp_path: Path, name: str) -> None:
    columns = two_vehicles() | {name: ["AGV-1", "AGV-2"] * 1200}
    path = write_csv(tmp_path / "fleet.csv", columns)
    (tmp_path / "map.yaml").write_text(suggest_map([path]).text, encoding="utf-8")
    logs = import_source(path, load_map(tmp_path / "map.yaml"))
    assert [log.energy_wh("robot") for log in logs] == pytest.approx([ENERGY_WH, 1.5 * ENERGY_WH], rel=1e-6)


def test_vehicles_whose_rows_have_times_of_their_own_are_told_apart(tmp_path: Path) -> None:
    time = np.repeat(TIME_S, 2) + np.tile([0.0, 0.03], 1200)
    path = write_csv(tmp_path / "fleet.csv", two_vehicles(time=time) | {"robot_id": [1, 2] * 1200})
    assert "runs: {by: [robot_id]}" in suggest_map([path]).text


def test_rows_of_two_vehicles_without_a_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in turn"):
        imported(tmp_path, two_vehicles())


def test_stamps_in_minutes_are_refused_and_those_in_seconds_averaged(tmp_path: Path) -> None:
    columns = {"v (m/s)": SPEED, "Power (W)": POWER}
    stamps = [(START + timedelta(seconds=0.1 * i)).strftime("%d.%m.%Y %H:%M") for i in range(1200)]
    with pytest.raises(InputError, match="too coarse"):
        imported(tmp_path, {"timestamp": stamps, **columns})
    stamps = [(START + timedelta(seconds=0.1 * i)).strftime("%Y-%m-%d %H:%M:%S") for i in range(1200)]
    log, _ = imported(tmp_path, {"timestamp": stamps, **columns})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.02)


def test_a_row_of_totals_at_the_end_is_left_out(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "run.csv", table() | {"Power (W)": POWER})
    path.write_text(path.read_text() + f"Total,{SPEED.mean():.3f},{POWER.sum():.1f}\n")
    (tmp_path / "map.yaml").write_text(suggest_map([path]).text, encoding="utf-8")
    (log,) = import_source(path, load_map(tmp_path / "map.yaml"))
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=1e-6)
    assert log.rows == 1200


def test_a_folder_for_each_run_gives_the_runs_their_names(tmp_path: Path) -> None:
    for run in ("R001_tile", "R002_grass"):
        (tmp_path / "all" / run).mkdir(parents=True)
        write_csv(tmp_path / "all" / run / "data.csv", table() | {"Power (W)": POWER})
    made = tmp_path / "map.yaml"
    assert main(["import", str(tmp_path / "all"), "--suggest", "--out", str(made), "--quiet"]) == 0
    made.write_text(made.read_text() + "  surface: {file_name: [tile, grass]}\n")
    for sources in ([tmp_path / "all"], [tmp_path / "all" / "*" / "data.csv"]):
        logs = import_source(sources, load_map(made))
        assert [log.run for log in logs] == ["R001_tile", "R002_grass"]
    assert logs[1].columns["surface"].names == ("grass",)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "columns",
    [
        {"exp": [1, 2, 3], "floor": ["tile", "grass", "tile"], "duration_s": [84.7, 65.6, 47.1],
         "mean_power_W": [24.9, 53.8, 28.6], "energy_Wh": [0.59, 0.98, 0.37]},
        {"run": ["R001", "R002", "R003"], "floor": ["tile", "grass", "tile"], "payload_kg": [0.0, 10.0, 0.0]},
    ],
)  # fmt: skip
def test_a_table_of_runs_is_no_log(tmp_path: Path, columns: dict[str, list[object]]) -> None:
    (tmp_path / "R001").mkdir()
    write_csv(tmp_path / "R001" / "data.csv", table() | {"Power (W)": POWER})
    found = suggest_map([write_csv(tmp_path / "runs.csv", columns)])
    assert any("one row a run" in told and "R001/data.csv" in told for told in found.missing)
    assert "RATE" not in found.text


@pytest.mark.parametrize(
    ("name", "unit", "column"),
    [
        ("load_kg", 1.0, "payload_kg"),
        ("carga (kg)", 1.0, "payload_kg"),
        ("CPU%", 0.01, "cpu_load"),
        ("GPU%", 0.01, "gpu_load"),
        ("T_amb_degC", 1.0, "temp_ambient_c"),
        ("cog_deg", np.pi / 180, "heading_rad"),
        ("arm_current_A", 1.0, "arm_current_a"),
    ],
)
def test_ordinary_names(tmp_path: Path, name: str, unit: float, column: str) -> None:
    values = (20.0 + 5.0 * np.sin(TIME_S / 9.0)).round(3)
    electric = {"battery_voltage_V": 24.0 - POWER / 1e3, "battery_current_A": POWER / (24.0 - POWER / 1e3)}
    log, _ = imported(tmp_path, table() | electric | {name: values})
    np.testing.assert_allclose(log.number(column), unit * values, rtol=1e-9)


@pytest.mark.parametrize("name", ["SOG_kn", "linear.x", "sog (m/s)"])
def test_ordinary_names_of_the_speed(tmp_path: Path, name: str) -> None:
    factor = 1852 / 3600 if name == "SOG_kn" else 1.0
    log, _ = imported(tmp_path, {"t": TIME_S, name: SPEED / factor, "Power (W)": POWER})
    np.testing.assert_allclose(log.number("speed_m_s"), SPEED, atol=1e-6)


@pytest.mark.parametrize("names", [["Wheel speed (rpm)"], ["left_rpm", "right_rpm"], ["wheel_rpm"]])
def test_wheels_in_rpm_ask_for_their_radius(tmp_path: Path, names: list[str]) -> None:
    turns = SPEED / 0.1 * 60 / (2 * np.pi)
    path = write_csv(tmp_path / "run.csv", {"t": TIME_S, "Power (W)": POWER} | dict.fromkeys(names, turns))
    found = suggest_map([path])
    assert any("RADIUS" in told for told in found.missing)
    (tmp_path / "map.yaml").write_text(found.text.replace("RADIUS m", "0.1 m"))
    (log,) = import_source(path, load_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(log.number("speed_m_s"), SPEED, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["Energiezähler [Wh]", "Verbrauch (Wh)", "energía consumida (Wh)", "Énergie consommée (Wh)"]
)
def test_counters_of_other_languages(tmp_path: Path, name: str) -> None:
    log, _ = imported(tmp_path, table() | {name: counted(POWER)})
    assert log.energy_wh("robot") == pytest.approx(ENERGY_WH, rel=0.01)


def test_slope_from_an_altitude_holds_at_starts_and_stops(tmp_path: Path) -> None:
    time = 0.2 * np.arange(3000.0)
    speed = np.clip(np.minimum((time % 60.0) - 8.0, 60.0 - time % 60.0) * 1.5, 0.0, 12.0)
    way = np.cumsum(speed) * 0.2
    slope = np.arctan(0.06 * np.cos(way / 50.0))
    columns = {"t": time, "v (m/s)": speed, "Power (W)": 500.0 + 200 * speed, "altitude (m)": 3.0 * np.sin(way / 50.0)}
    log, _ = imported(tmp_path, columns)
    moves = speed > 0.5
    assert np.sqrt(np.mean((log.number("slope_rad") - slope)[moves] ** 2)) < 0.01
    assert not [name for name in log.columns if "climb" in name or name.startswith("_")]


def test_a_held_meter_is_left_in_its_rows(tmp_path: Path) -> None:
    held = POWER[np.arange(1200) // 10 * 10]
    log, found = imported(tmp_path, table() | {"Power (W)": held})
    assert not {"refresh", "step"} & set(found.text.replace(":", " ").split())
    assert log.rows == 1200
    assert 80 < log.fresh["robot"].sum() <= 120  # at rest the readings are alike
