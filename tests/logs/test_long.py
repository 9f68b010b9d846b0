"""Tables with one row for each value, as data bases and car scanners export them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.logs import read_log
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.5)
WATTS, SPEED = loggers.power(T), loggers.speed(T)
WH = float(WATTS.sum() * 0.5 / 3600)


def stamp(t: float) -> str:
    return f"2025-03-14T09:{21 + int(t) // 60}:{t % 60:06.3f}Z"


def rows(*signals: tuple[str, np.ndarray], late: float = 0.0) -> list[tuple[str, str, str]]:
    """Name, time and value of each, signal after signal."""
    return [
        (name, stamp(t + late * i), f"{value:.5g}")
        for i, (name, values) in enumerate(signals)
        for t, value in zip(T, values, strict=True)
    ]


def influx(path: Path) -> None:
    """Two measurements with fields of one name, and annotations."""
    text = "#group,false,false,false,false,true,true\n#datatype,string,long,dateTime:RFC3339,double,string,string\n"
    text += "#default,_result,,,,,\n,result,table,_time,_value,_field,_measurement\n"
    told = rows(("power.heater", 0 * T + 3), ("power.battery", WATTS), ("speed.odometry", SPEED))
    text += "".join(
        f",,{0},{time},{value},{name.partition('.')[0]},{name.partition('.')[2]}\n" for name, time, value in told
    )
    path.write_text(text)


def home(path: Path) -> None:
    """Words for what is not known, among texts of a switch."""
    told = rows(("sensor.agv_battery_power", WATTS), ("sensor.agv_speed", SPEED), late=0.1)
    told.insert(0, ("sensor.agv_speed", stamp(0), "unavailable"))
    told += [("switch.agv_lamp", stamp(0.2), "off"), ("switch.agv_lamp", stamp(40), "on")]
    path.write_text("entity_id,state,last_changed\n" + "".join(f"{n},{v},{t}\n" for n, t, v in told))


def scanner(path: Path) -> None:
    """Units in a column, and a number that is a code for no value in one signal alone."""
    told = rows(("Battery power", 1000 * WATTS), ("Vehicle speed", 3.6 * SPEED), ("Limit", 0 * T + 9999), late=0.1)
    units = {"Battery power": "mW", "Vehicle speed": "km/h", "Limit": "W"}
    text = '"TIME";"PID";"VALUE";"UNITS";\n'
    path.write_text(text + "".join(f'"{t}";"{n}";"{v}";"{units[n]}";\n' for n, t, v in told))


@pytest.mark.parametrize(
    ("write", "long"),
    [
        (influx, "long: {name: [_field, _measurement], value: _value}"),
        (home, "long: {name: [entity_id], value: state}"),
        (scanner, "long: {name: [PID], value: VALUE, unit: UNITS}"),
    ],
)
def test_one_row_a_value(tmp_path: Path, write: object, long: str) -> None:
    assert callable(write)
    path, made, out = tmp_path / "run1.csv", tmp_path / "made.yaml", tmp_path / "out.parquet"
    write(path)
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 0
    assert long in made.read_text()
    assert main(["import", str(path), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    log = read_log(out)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.02)
    assert log.number("speed_m_s").max() == pytest.approx(SPEED.max(), rel=0.02)


def test_a_column_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, made = tmp_path / "run1.csv", tmp_path / "made.yaml"
    home(path)
    main(["import", str(path), "--suggest", "--out", str(made), "--quiet"])
    made.write_text(made.read_text().replace("[entity_id]", "[entity]"))
    assert main(["import", str(path), "--map", str(made), "--out", str(tmp_path / "o.parquet"), "--quiet"]) == 2
    told = capsys.readouterr().err
    assert "'entity' is not in" in told
    assert "did you mean: entity_id" in told
    assert "files.log.long.name" in told


def test_a_wide_table_with_a_state_is_none(tmp_path: Path) -> None:
    path, made = tmp_path / "a.csv", tmp_path / "made.yaml"
    path.write_text(
        "time,name,state,power_w\n"
        + "".join(f"{t},agv,{i % 3},{w}\n" for i, (t, w) in enumerate(zip(T, WATTS, strict=True)))
    )
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 0
    assert "long:" not in made.read_text()


NUMBERED = """kind: map
name: numbered
files: {log: {name: "*.csv", time: t, long: {name: id, value: value}}}
signals: {p: log.419360001, v: log.419360002}
timeline: p
columns: {time_s: time_s, power_robot_w: p, speed_m_s: v}
"""


@pytest.mark.parametrize("rows", [60, 0])
def test_names_that_are_numbers_stay_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: int) -> None:
    lines = [f"{i},419360001,{40 + i % 7}\n{i},419360002,{i % 3}\n" for i in range(rows)]
    (tmp_path / "log.csv").write_text("t,id,value\n" + "".join(lines))
    (tmp_path / "map.yaml").write_text(NUMBERED)
    out = tmp_path / "out.parquet"
    told = main(["import", str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.yaml"), "--out", str(out)])
    assert told == (0 if rows else 2)
    if rows:
        assert read_log(out).number("power_robot_w").min() >= 40
    else:
        assert "no row with a time" in capsys.readouterr().err


@pytest.mark.parametrize("other", ["kW", ""])
def test_a_unit_that_changes_within_a_signal(tmp_path: Path, other: str) -> None:
    """A part of the rows in kW, or without the unit: all are one signal, in the unit that came first."""
    path, made, out = tmp_path / "run1.csv", tmp_path / "made.yaml", tmp_path / "out.parquet"
    told = [
        (t, "power", w / 1000 if other and t > 30 else w, other if t > 30 else "W")
        for t, w in zip(T, WATTS, strict=True)
    ]
    told += [(t, "speed", v, "m/s") for t, v in zip(T, SPEED, strict=True)]
    path.write_text("time,signal,value,unit\n" + "".join(f"{t},{n},{v:.6g},{u}\n" for t, n, v, u in told))
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 0
    assert main(["import", str(path), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    assert read_log(out).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_words_without_a_unit_beside_numbers_with_one(tmp_path: Path) -> None:
    path, made = tmp_path / "run1.csv", tmp_path / "made.yaml"
    told = [f"{t},power,{w:.6g},W\n{t},power,idle,\n" for t, w in zip(T, WATTS, strict=True)]
    told += [f"{t},speed,{v:.6g},m/s\n" for t, v in zip(T, SPEED, strict=True)]
    path.write_text("time,signal,value,unit\n" + "".join(told))
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 0
