"""Files as the programs of vehicles, plugs and computers write them: units, clocks and signs that their names hide."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.logs import LogTable, read_log, read_logs
from missionsim.logs.formats.delimited import read_csv
from missionsim.logs.readers import Options
from missionsim.logs.times import is_fine
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.1)
WH = float(loggers.power(T).sum() * 0.1 / 3600)


def write(path: Path, head: str, *columns: object) -> Path:
    rows = zip(*columns, strict=True)
    path.write_text(head + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def suggested(folder: Path, *paths: Path) -> LogTable:
    """The log that the suggested map makes of files, as it was suggested."""
    made, out = folder / "made.yaml", folder / "out.parquet"
    assert main(["import", *map(str, paths), "--suggest", "--out", str(made), "--quiet"]) == 0
    assert main(["import", *map(str, paths), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return read_log(out)


def test_microseconds_since_the_start_and_a_speed_that_points_north(tmp_path: Path) -> None:
    micro, v = (51e6 + 1e6 * T).astype(int), loggers.speed(T)
    watts = loggers.power(T)
    battery = write(
        tmp_path / "log_1_battery_status_0.csv", "timestamp,voltage_v,current_a", micro, 16 - watts / 99,
        watts / (16 - watts / 99),
    )  # fmt: skip
    place = write(
        tmp_path / "log_1_vehicle_local_position_0.csv", "timestamp,vx,vy,vz", micro + 400, v * 0.6, v * -0.8, 0 * v
    )
    log = suggested(tmp_path, battery, place)
    assert log.time_s[-1] == pytest.approx(loggers.LENGTH_S, abs=1)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(v.max(), rel=0.01)


def test_speeds_over_ground_in_one_table(tmp_path: Path) -> None:
    v = loggers.speed(T)
    path = write(tmp_path / "a.csv", "t,power_w,vx,vy", T.round(1), loggers.power(T), v * 0.6, v * 0.8)
    assert suggested(tmp_path, path).number("speed_m_s").max() == pytest.approx(v.max(), rel=0.01)
    for unit, size in (("m/s", 1), ("cm/s", 100)):
        names = f"t,power_w,v x [{unit}],v y [{unit}]"
        path = write(tmp_path / "d.csv", names, T.round(1), loggers.power(T), v * 0.6 * size, v * 0.8 * size)
        assert suggested(tmp_path, path).number("speed_m_s").max() == pytest.approx(v.max(), rel=0.01)
    path = write(tmp_path / "c.csv", "t,power_w,v x [m/s],v y [m/s]", T.round(1), loggers.power(T), v * 0.6, v * 0.8)
    assert suggested(tmp_path, path).number("speed_m_s").max() == pytest.approx(v.max(), rel=0.01)
    path = write(tmp_path / "b.csv", "t,power_w,vx,vy", T.round(1), loggers.power(T), v, 0.01 * v)
    assert suggested(tmp_path, path).number("speed_m_s").max() == pytest.approx(v.max(), rel=1e-9)


@pytest.mark.parametrize(("unit", "factor"), [("mph", 0.44704), ("kmh", 1 / 3.6), ("km/h", 1 / 3.6), ("kph", 1 / 3.6)])
def test_a_column_that_is_called_as_its_unit(tmp_path: Path, unit: str, factor: float) -> None:
    head = f"t_s,current_mA,busV,power_mW,{unit}"
    watts, v = loggers.power(T), loggers.speed(T)
    path = write(tmp_path / "a.csv", head, T, 1000 * watts / 12, 12 - watts / 1e4, 1000 * watts, v / factor)
    log = suggested(tmp_path, path)
    assert log.number("speed_m_s").max() == pytest.approx(v.max(), rel=1e-6)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_the_rails_of_a_small_computer_are_in_milliwatts(tmp_path: Path) -> None:
    days = [f"2025-03-14 09:{21 + int(t) // 60:02d}:{int(t) % 60:02d}.{int(t * 10) % 10}" for t in T.round(1)]
    up = [f"1:{int(t) // 60:02d}:{int(t) % 60:02d}" for t in T.round(1)]
    total = (1000 * loggers.power(T)).round()
    head = "time,uptime,CPU1,Power VDD_IN,Power VDD_SOC,Power TOT"
    path = write(tmp_path / "jtop.csv", head, days, up, 10 + T % 4, total, total / 3, total)
    log = suggested(tmp_path, path)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert np.median(np.diff(log.time_s)) == pytest.approx(0.1)  # by the date, not by whole seconds since the start


def test_the_current_of_all_controllers(tmp_path: Path) -> None:
    volts = 48 - loggers.power(T) / 99
    amps = loggers.power(T) / volts
    head = "ms_today,input_voltage,current_motor,current_in,current_in_setup,current_motor_setup,speed_meters_per_sec"
    day = (36e6 + 1000 * T).astype(int)
    path = write(tmp_path / "esc.csv", head, day, volts, amps, amps / 2, amps, 2 * amps, loggers.speed(T))
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_a_plug_measures_real_power(tmp_path: Path) -> None:
    watts = loggers.power(T).round(2)
    lines = [
        json.dumps({
            "Time": f"2025-03-14T09:{21 + i // 60:02d}:{i % 60:02d}",
            "ENERGY": {"Power": w, "ApparentPower": w / 0.6, "Factor": 0.6, "Voltage": 234, "Current": w / 0.6 / 234},
        })
        for i, w in enumerate(watts[::10])
    ]  # fmt: skip
    (tmp_path / "plug.jsonl").write_text("\n".join(lines) + "\n")
    assert suggested(tmp_path, tmp_path / "plug.jsonl").energy_wh("robot") == pytest.approx(WH, rel=0.02)
    path = write(
        tmp_path / "plug.csv",
        "unixtime,apower,voltage,current,pf",
        1.7e9 + T,
        watts,
        0 * T + 234,
        watts / 140,
        0.6 + 0 * T,
    )
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    # the time beside the message, as a broker's log keeps it
    parts = [json.loads(line) for line in lines]
    told = [
        json.dumps({"Time": one["Time"], "topic": "tele/plug", "payload": {"ENERGY": one["ENERGY"]}}) for one in parts
    ]
    (tmp_path / "broker.jsonl").write_text("\n".join(told) + "\n")
    assert suggested(tmp_path, tmp_path / "broker.jsonl").energy_wh("robot") == pytest.approx(WH, rel=0.02)


def test_a_flight_log_that_was_saved_as_text(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    rows = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 129, 23, BAT, QBff, TimeUS,Instance,Volt,Curr",
        "FMT, 130, 22, GPS, QBIHf, TimeUS,Status,GMS,GWk,Spd",
    ]
    for t, v, w in zip(T, loggers.speed(T), loggers.power(T), strict=True):
        volts = 16 - w / 99
        rows += [
            f"BAT, {2e6 + 1e6 * t:.0f}, 0, {volts:.4f}, {w / volts:.4f}",
            f"GPS, {2e6 + 1e6 * t:.0f}, 3, {1e6 + 1e3 * t:.0f}, 2200, {v:.4f}",
        ]
    (tmp_path / "00000012.log").write_text("\n".join(rows) + "\n")
    log = suggested(tmp_path, tmp_path / "00000012.log")
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


def map_of(path: Path, code: int = 0) -> str:
    """The suggested map of a file."""
    made = path.with_suffix(".yaml")
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == code
    return made.read_text()


def test_currents_in_hundredths_of_an_ampere(tmp_path: Path) -> None:
    volts = 16 - loggers.power(T) / 99
    amps = (100 * loggers.power(T) / volts).round().astype(int)
    head = "time_boot_ms,voltage_battery,current_battery,groundspeed"
    path = write(tmp_path / "a.csv", head, (1000 * T).astype(int), (1000 * volts).astype(int), amps, loggers.speed(T))
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_a_column_called_v_that_holds_millivolts(tmp_path: Path) -> None:
    volts = 12.8 - loggers.power(T) / 999
    path = write(
        tmp_path / "a.csv", "timestamp,V,I", T, (1000 * volts).round(), (-1000 * loggers.power(T) / volts).round()
    )
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_what_is_no_speed_of_the_robot(tmp_path: Path) -> None:
    watts, v = loggers.power(T), loggers.speed(T)
    path = write(tmp_path / "a.csv", "t,power_w,speed,speed_avg", T, watts, 36 * v, 0.3 + T / 1e3)
    assert "speed_m_s: {value: speed, unit: km/h}" in map_of(path)
    head = "t,state.voltage_input,state.current_input,state.speed,state.duty_cycle"
    text = map_of(write(tmp_path / "b.csv", head, T, 16 - watts / 99, watts / 16, (4614 * v).round(), v / 9))
    assert "'state.speed' is the electrical rpm of a motor" in text
    assert "speed_m_s:" not in text
    text = map_of(
        write(tmp_path / "c.csv", "t,v_charge,v_battery,charge_current", T, v, 28 - watts / 99, T % 3 / 99), 1
    )
    assert "speed_m_s:" not in text  # volts and amperes of the charger
    assert "charge_current" not in text.split("# not used")[0]
    text = map_of(
        write(tmp_path / "d.csv", "t,volt,curr,rpm_left,rpm_right", T, 24 - watts / 99, watts / 24, 99 * v, 98 * v), 1
    )
    assert "(rpm_left + rpm_right) * 0.05235987756 * wheel_radius" in text


def test_what_is_no_power_of_the_battery(tmp_path: Path) -> None:
    watts, v = loggers.power(T), loggers.speed(T)
    head = "t,measured_battery,total_current,total_power_consumed"
    path = write(tmp_path / "a.csv", head, T, 28 - watts / 99, watts / (28 - watts / 99), np.cumsum(watts) / 36e3)
    assert "'total_power_consumed' only grows: an energy, not a power" in map_of(path)
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    path = write(tmp_path / "b.csv", "t,Speed (km/h),Rider Power (W),Motor Power (W)", T, 3.6 * v, 99 + v, watts)
    assert "power_robot_w: POWER" in map_of(path, 1)
    text = map_of(write(tmp_path / "c.csv", "t,speed,power,cadence", T, v, 99 + v, 80 + T % 3))
    assert "a guess: the name; perhaps a rider's" in text
    head = "t,battery_current_a,battery_voltage_v,speed_mps,current_limit_a,power_limit_w"
    text = map_of(write(tmp_path / "e.csv", head, T, watts / 24, 24 - watts / 99, v, 20 + 0 * T, 480 + 0 * T))
    assert "current_robot_a: battery_current_a" in text  # no limits
    assert "power_" not in text.split("# not used")[0]
    head = "t,CH1_Voltage_V,CH1_Current_mA,CH2_Voltage_V,CH2_Current_mA"
    text = map_of(write(tmp_path / "d.csv", head, T, 12 - watts / 99, 83 * watts, 5 + T % 3 / 99, 300 + T % 7), 1)
    assert "there are more currents, which were not added: CH2_Current_mA" in text
    text = map_of(write(tmp_path / "f.csv", "t,mecanum_power_w,v", T, watts, v))
    assert "power_robot_w: mecanum_power_w" in text  # its wheels, not what is mechanical


def test_messages_with_their_topic_before_them(tmp_path: Path) -> None:
    parts = [json.dumps({"watt": round(float(w), 3)}) for w in loggers.power(T)]
    path = tmp_path / "sub.txt"
    path.write_text("".join(f"{1.7e9 + t:.1f} rover/power {part}\n" for t, part in zip(T, parts, strict=True)))
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    whole = [json.dumps({"Time": 1.7e9 + t, **json.loads(part)}) for t, part in zip(T, parts, strict=True)]
    path.write_text("".join(f"rover/power {part}\n" for part in whole))
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_what_tegrastats_prints(tmp_path: Path) -> None:
    lines = [
        f"RAM 1795/7859MB (lfb 385x4MB) SWAP 0/3929MB (cached 0MB) CPU [{10 + i % 20}%@960,off] GR3D_FREQ 7% "
        f"CPU@42.5C CV0@-256C VDD_GPU_SOC 153mW/153mW VDD_IN {1000 * w:.0f}mW/3258mW VDD_CPU 69mW/69mW"
        for i, w in enumerate(loggers.power(T)[::10])
    ]
    stamped = [f"03-04-2025 09:{21 + i // 60:02d}:{i % 60:02d} {line}" for i, line in enumerate(lines)]
    (tmp_path / "a.txt").write_text("\n".join(stamped) + "\n")
    log = suggested(tmp_path, tmp_path / "a.txt")
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.02)
    assert log.number("cpu_load").max() == pytest.approx(0.145)
    old = [line.replace("mW", "") for line in lines]  # older ones write no units and no times
    (tmp_path / "b.log").write_text("\n".join(["Thu Dec 17 18:16:50 UTC 2020", *old]) + "\n")
    text = map_of(tmp_path / "b.log", 1)
    assert "power_robot_w: {value: VDD_IN_mW, unit: mW}" in text
    assert "put their rate in the place of RATE" in text


@pytest.mark.parametrize(
    ("stamp", "line"),
    [
        ("[{:%H:%M:%S.%f}]", " V: {:.3f} V | I: {:.1f} mA | v: {:.3f} m/s"),
        ("{:%H:%M:%S.%f}", " -> V: {:.3f} V, I: {:.1f} mA, v: {:.3f} m/s"),
        ("{:%Y-%m-%d %H:%M:%S,%f}", " - INFO - V={:.3f}V I={:.1f}mA v={:.3f}"),
        ("[{:%Y-%m-%dT%H:%M:%S.%f}Z]", " battery.voltage={:.3f} battery.current={:.1f}mA speed={:.3f}"),
    ],
)
def test_names_with_numbers_in_each_line(tmp_path: Path, stamp: str, line: str) -> None:
    """A serial monitor and the like: they had been tables without a header, or refused."""
    start = datetime(2024, 11, 23, 13, 10, 40)
    rows = zip(T.tolist(), loggers.power(T), loggers.speed(T), strict=True)
    made = [stamp.format(start + timedelta(seconds=t)) + line.format(25, 40 * w, v) for t, w, v in rows]
    head = ["INA226 found: address=0x40"] * ("|" not in line)
    (tmp_path / "a.txt").write_text("\n".join([*head, *made]) + "\n")
    log = suggested(tmp_path, tmp_path / "a.txt")
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


def test_what_ros_prints_of_a_topic(tmp_path: Path) -> None:
    for second, nano in (("sec", "nanosec"), ("secs", "nsecs")):
        parts = []
        for t, w in zip(T, loggers.power(T), strict=True):
            volts, whole = 25 - w / 99, int(t)
            head = f"header:\n  stamp:\n    {second}: {1_700_000_000 + whole}\n    {nano}: {1e9 * (t - whole):.0f}\n"
            parts.append(f"{head}  frame_id: ''\nvoltage: {volts:.4f}\ncurrent: {-w / volts:.4f}\ncharge: .nan\n---\n")
        path = tmp_path / f"{second}.yaml"
        path.write_text("".join(parts))
        made, out = tmp_path / "map.yaml", tmp_path / "log.parquet"
        assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 0
        assert main(["import", str(path), "--map", str(made), "--out", str(out), "--quiet"]) == 0
        assert read_log(out).energy_wh("robot") == pytest.approx(WH, rel=0.01)
        path.write_text("".join(parts)[:-80])  # stopped in the midst of a message
        assert main(["import", str(path), "--map", str(made), "--out", str(out), "--quiet"]) == 1
    path.write_text("header:\n  stamp: ''\nvoltage: 3\n---\n")
    assert main(["import", str(path), "--map", str(made), "--out", str(tmp_path / "no.parquet")]) == 2
    assert not (tmp_path / "no.parquet").exists()


def test_rows_with_words_and_no_header(tmp_path: Path) -> None:
    parts = [
        f"{1_700_000_000 + 0.1 * i:.1f},base,{25 - w / 99:.4f},nan,{w / 24:.4f},True"
        for i, w in enumerate(loggers.power(T))
    ]
    (tmp_path / "a.csv").write_text("\n".join(parts) + "\n")
    text = map_of(tmp_path / "a.csv", 1)
    assert "table: {header: [col_1, col_2, col_3, col_4, col_5, col_6]}" in text
    assert len(parts) == 1200
    (tmp_path / "m.yaml").write_text(
        "kind: map\nname: m\ntable: {header: [t, frame, volts, x, amps, on]}\n"
        "columns: {time_s: t, voltage_robot_v: volts, current_robot_a: amps}\n"
    )
    out = tmp_path / "log.parquet"
    assert main(["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "m.yaml"), "--out", str(out)]) == 0
    assert read_log(out).rows == 1200  # the first line is a row as well


def test_units_behind_each_number(tmp_path: Path) -> None:
    rows = list(zip(T, loggers.speed(T), loggers.power(T), strict=True))
    cells = [(f"{24 - w / 99:.3f}V", f" {1000 * w / (24 - w / 99):.1f} mA", f"{3.6 * v:.3f} km/h") for _, v, w in rows]
    path = write(tmp_path / "a.csv", "t,volt,curr,speed", T, *zip(*cells, strict=True))
    lines = [
        json.dumps({"ts": 1.7e9 + t, "volt": volt, "curr": curr, "speed": v})
        for t, (volt, curr, v) in zip(T, cells, strict=True)
    ]
    (tmp_path / "b.jsonl").write_text("\n".join(lines) + "\n")
    told = write(tmp_path / "c.csv", "t,volt (V),curr (mA),speed [km/h]", T, *zip(*cells, strict=True))
    for one in (path, tmp_path / "b.jsonl", told):
        log = suggested(tmp_path, one)
        assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
        assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)
    assert "each cell has a unit behind its number (mA)" in str(read_log_remarks(path))
    names = write(
        tmp_path / "d.csv", "time_s,power_robot_w,run", T, loggers.power(T), [f"{1 + i % 3}b" for i in range(1200)]
    )
    assert read_log(names).columns["run"].names == ("1b", "2b", "3b")  # type: ignore[union-attr]


def read_log_remarks(path: Path) -> list[str]:
    """What was remarked on the columns of a text table."""
    return [remark.message for remark in read_csv(path, Options()).remarks]


def test_hours_minutes_and_seconds_in_one_number(tmp_path: Path) -> None:
    utc = [
        f"{17 + (3590 + int(t)) // 3600:02d}{(3590 + int(t)) // 60 % 60:02d}{(3590 + t) % 60:05.2f}" for t in T.round(2)
    ]
    path = write(tmp_path / "a.csv", "utc,power_w,speed", utc, loggers.power(T), loggers.speed(T))
    log = suggested(tmp_path, path)
    assert log.time_s[-1] == pytest.approx(T[-1], abs=0.2)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_decimal_commas_beside_a_cell_without_a_number(tmp_path: Path) -> None:
    rows = [f"{t:.1f};{w:.3f};{v:.3f}" for t, v, w in zip(T, loggers.speed(T), loggers.power(T), strict=True)]
    rows[5] = rows[5].rpartition(";")[0] + ";-"
    (tmp_path / "a.csv").write_text("Zeit [s];Leistung [W];Tempo v [m/s]\n" + "\n".join(rows).replace(".", ",") + "\n")
    log = suggested(tmp_path, tmp_path / "a.csv")
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


@pytest.mark.parametrize(
    ("name", "per_ah"), [("consumed_mAh", 1000.0), ("consumed_Ah", 1.0), ("current_consumed", 1.0)]
)
def test_a_charge_is_no_energy(tmp_path: Path, name: str, per_ah: float) -> None:
    watts = loggers.power(T)
    volts = 25.0 - watts / 50
    charge = per_ah * np.cumsum(watts / volts) * 0.1 / 3600
    path = write(tmp_path / "a.csv", f"t,speed_m_s,{name},voltage_V", T.round(1), loggers.speed(T), charge, volts)
    if name == "current_consumed":  # nothing says of what
        assert "consumed" not in map_of(path, 1).partition("columns:")[2].partition("# not used")[0]
        return
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert "# a guess: the charge times the mean voltage" in map_of(path)
    path = write(tmp_path / "b.csv", f"t,speed_m_s,{name}", T.round(1), loggers.speed(T), charge)
    assert f"('{name}' is a charge: without a voltage there is no energy in it)" in map_of(path, 1)


@pytest.mark.parametrize("step", [0.2, 0.01])
@pytest.mark.parametrize(
    "names",
    [
        "sec,nanosec",
        "secs,nsecs",
        "header.stamp.secs,header.stamp.nsecs",
        "field.header.stamp.sec,field.header.stamp.nanosec",
        "stamp_sec,stamp_nanosec",
    ],
)
def test_seconds_and_nanoseconds_are_one_time(tmp_path: Path, names: str, step: float) -> None:
    time = 1748959510 + step * np.arange(1000)
    nano = ((time % 1) / step).round().astype(int) * round(step * 1e9) % 10**9
    columns = (np.floor(time + 1e-6).astype(int), nano, loggers.speed(time % 300), loggers.power(time % 300))
    log = suggested(tmp_path, write(tmp_path / "a.csv", f"{names},speed_m_s,power_W", *columns))
    assert log.rows == (1000 if step > 0.1 else 100)  # means of fast rows
    assert log.time_s[-1] == pytest.approx(1000 * step, abs=2 * max(step, 0.1))
    assert not [name for name in log.columns if "n" in name.partition("_")[2] or name.startswith("n")]


@pytest.mark.parametrize(
    ("whole", "rest", "fine"),
    [(1.7e9, 2e8, True), (5.0, 9e8, True), (20250314.0, 92133.0, False), (1.7e9, 300.0, False)],
)
def test_a_date_or_milliseconds_are_no_seconds_and_nanoseconds(whole: float, rest: float, fine: bool) -> None:
    assert is_fine(np.array([whole, whole + 1.0]), np.array([0.0, rest])) is fine


W, SMALL = loggers.power(T), 0.1 * loggers.power(T)


@pytest.mark.parametrize(
    ("head", "columns", "sure"),
    [
        ("power_left_w,power_right_w,power_total_w", (SMALL, SMALL, W), "sure"),
        ("power_fl_w,power_fr_w,power_rl_w,power_rr_w,power_total_w", (SMALL, SMALL, SMALL, SMALL, W), "sure"),
        ("power_arm_w,power_base_w,power_total_w", (SMALL, 0.9 * W, W), "sure"),
        ("power_left_w,power_right_w", (0.4 * W, 0.6 * W), "a guess"),
        ("Power left [W],Power right [W]", (0.4 * W, 0.6 * W), "a guess"),
        ("power_fl_w,power_fr_w,power_rl_w,power_rr_w", (0.1 * W, 0.2 * W, 0.3 * W, 0.4 * W), "a guess"),
        ("power_arm_w,power_robot_w", (SMALL, W), "sure"),
        ("Sollleistung [W],mech. Leistung [W],Batterieleistung [W]", (1.5 * W, SMALL, W), "sure"),
        ("puissance consigne [W],puissance mécanique [W],puissance batterie [W]", (1.5 * W, SMALL, W), "sure"),
        ("Wellenleistung [W],Batterieleistung [W]", (SMALL, W), "sure"),
        ("puissance arbre [W],puissance totale [W]", (SMALL, W), "sure"),
        ("Wellenleistung [W],Leistung [W]", (SMALL, W), "sure"),
        ("power_shaft_w,power_w", (SMALL, W), "sure"),
    ],
)  # fmt: skip
def test_the_power_of_the_battery_among_others(
    tmp_path: Path, head: str, columns: tuple[np.ndarray, ...], sure: str
) -> None:
    path = write(tmp_path / "a.csv", f"time_s,speed_m_s,{head}", T, loggers.speed(T), *columns)
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    line = next(line for line in map_of(path).splitlines() if line.startswith("  power_robot_w:"))
    assert f"# {sure}: " in line


@pytest.mark.parametrize("head", ["power_arm_w,power_base_w", "power_1_w,power_2_w"])
def test_one_of_several_powers_is_never_sure(tmp_path: Path, head: str) -> None:
    path = write(tmp_path / "a.csv", f"time_s,speed_m_s,{head}", T, loggers.speed(T), 0.4 * W, 0.6 * W)
    assert "# a guess: a name of the glossary; there are others: " in map_of(path)


def test_sides_beside_a_battery_that_says_otherwise(tmp_path: Path) -> None:
    head = "time_s,speed_m_s,power_left_w,power_right_w,voltage_V,current_A"
    path = write(tmp_path / "a.csv", head, T, loggers.speed(T), 0.2 * W, 0.3 * W, 24 + 0 * T, W / 24)
    assert suggested(tmp_path, path).energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert "sides_w:" not in map_of(path)


@pytest.mark.parametrize(("name", "unit", "moving"), [("Yaw", 1.0, False), ("gps_heading", 180 / np.pi, True)])
def test_a_heading_without_a_yaw_rate(tmp_path: Path, name: str, unit: float, moving: bool) -> None:
    rate = loggers.turn(T)
    angle = (np.cumsum(rate) * 0.1 * unit + np.round(np.random.default_rng(0).normal(0, 0.005 * unit, len(T)), 3)) % (
        2 * np.pi * unit
    )
    head = f"time,power_w,speed,DesYaw,{name},GPS_Yaw"
    path = write(tmp_path / "a.csv", head, T, loggers.power(T), loggers.speed(T), 0 * T, angle.round(4), 0 * T)
    log, text = suggested(tmp_path, path), (tmp_path / "made.yaml").read_text()
    found = log.number("yaw_rate_rad_s")
    assert "differentiate: heading_rad, average: " in text
    drives = loggers.speed(T) > 0.3
    assert np.sqrt(np.mean((found - rate)[drives] ** 2)) < 0.03
    assert moving == ("where(abs(speed_m_s) > 0.3" in text)
    assert not moving or (found[~drives] == 0).all()


def test_files_of_one_run_with_flags_of_one_letter(tmp_path: Path) -> None:
    watts = loggers.power(T)
    battery = write(tmp_path / "BAT.csv", "timestamp,Inst,Volt,Curr", 1.7e9 + T, 0 * T, 0 * T + 24, watts / 24)
    place = write(
        tmp_path / "GPS.csv", "timestamp,I,Spd,U", 1.7e9 + T + 0.03, (0 * T).astype(int), loggers.speed(T),
        (0 * T + 1).astype(int),
    )  # fmt: skip
    log = suggested(tmp_path, battery, place)
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


def test_times_of_other_programs(tmp_path: Path) -> None:
    watts, v = loggers.power(T), loggers.speed(T)
    rows = ["X_Value\tU_Batt\tI_Batt\tGeschwindigkeit\tComment"]
    rows += [f"{t:.1f}\t24\t{w / 24:.5f}\t{s:.4f}\t" for t, w, s in zip(T, watts, v, strict=True)]
    (tmp_path / "a.lvm.txt").write_text("\n".join(rows) + "\n")
    log = suggested(tmp_path, tmp_path / "a.lvm.txt")
    assert log.rows == len(T)  # a tab at the end of the last line is a cell
    assert not [remark for remark in log.remarks if "cut short" in remark.message]
    path = write(tmp_path / "b.csv", "Time,vBatt,iBatt,v", [f"{t:.5g} sec" for t in T], 0 * T + 24, watts / 24, v)
    assert suggested(tmp_path, path).time_s[-1] == pytest.approx(T[-1])
    stamps = [f'"2024-05-14 09:{21 + i // 60}:{i % 60:02d}"' for i in range(len(T[::10]))]
    head = '"timestamp","Battery [2]","GPS [0]"\n"Europe/Berlin (+02:00)","Battery power","Speed"\n"","W","m/s"'
    log = suggested(tmp_path, write(tmp_path / "c.csv", head, stamps, -watts[::10], v[::10]))
    assert log.time_s[-1] == pytest.approx(T[::10][-1])
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.02)


def by_hand(folder: Path, path: Path, *changes: tuple[str, str]) -> LogTable:
    """The log of a folder by its suggested map, which is not complete, once the user has filled it in."""
    made, out = folder / "made.yaml", folder / "out.parquet"
    assert main(["import", str(path), "--suggest", "--out", str(made), "--quiet"]) == 1
    text = made.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    made.write_text(text)
    assert main(["import", str(path), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return read_log(out)


def test_voltage_and_current_in_files_of_their_own(tmp_path: Path) -> None:
    watts, run = loggers.power(T), tmp_path / "run"
    run.mkdir()
    files = [
        write(run / "main_current.csv", "Timestamp (s),Main Current (A)", T, watts / 24),
        write(run / "main_voltage.csv", "Timestamp (s),Main Voltage (V)", T, 24 - watts / 1e5),
        write(run / "odom.csv", "Timestamp (s),Linear velocity (m/s)", T, loggers.speed(T)),
    ]
    assert suggested(tmp_path, *files).energy_wh("robot") == pytest.approx(WH, rel=0.01)


def test_a_current_without_a_voltage_and_names_with_dates(tmp_path: Path) -> None:
    watts = loggers.power(T)
    for i in range(2):
        run = tmp_path / "all" / f"run{i}"
        run.mkdir(parents=True)
        write(run / f"ppk-2024051{i}T0921{i}0.csv", "Timestamp(ms),Current(uA)", 1000 * T, watts / 5 * 1e6)
        write(run / "odom.csv", "t_ms,v_m_s", 1000 * T, loggers.speed(T))
    made = tmp_path / "made.yaml"
    assert main(["import", str(tmp_path / "all"), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert "name: ppk-*.csv" in made.read_text()
    made.write_text(made.read_text().replace("VOLTS *", "5 *"))
    out = tmp_path / "out"
    assert main(["import", str(tmp_path / "all"), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    assert [log.energy_wh("robot") for log in read_logs(out)] == pytest.approx([WH, WH], rel=0.01)


def test_files_without_a_header(tmp_path: Path) -> None:
    run, watts = tmp_path / "run", loggers.power(T)
    run.mkdir()
    stamp = [1715678493 + T.astype(int), (np.round(T % 1, 1) * 1e9).astype(int)]
    write(run / "battery.csv", "", *stamp, ["base"] * len(T), 24 + 0 * T, -watts / 24)
    write(run / "odom.csv", "", *stamp, ["odom"] * len(T), 0 * T, 0 * T, loggers.speed(T))
    for path in run.iterdir():
        path.write_text(path.read_text().lstrip())
    signals = 'signals: {volts: "battery.#4", amps: "battery.#5", v: "odom.#6"}\ncolumns:'
    log = by_hand(tmp_path, run, ("columns:", signals), ("POWER  ", "volts * -amps\n  speed_m_s: v  "))
    assert log.energy_wh("robot") == pytest.approx(WH, rel=0.01)
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


def test_a_file_whose_time_is_not_found_stays_in_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write(run / "meter.csv", "t,watt", T, loggers.power(T))
    write(run / "odom.csv", "when,vel", T, loggers.speed(T))
    log = by_hand(
        tmp_path,
        run,
        ("time: TIME", "time: when"),
        ("signals:", "signals:\n  v: odom.vel"),
        ("columns:", "columns:\n  speed_m_s: v"),
    )
    assert "run/odom.csv: no column looks like a time" in capsys.readouterr().err
    assert log.number("speed_m_s").max() == pytest.approx(loggers.speed(T).max(), rel=0.01)


def test_files_of_one_name_in_folders_of_runs_are_one_file_of_each(tmp_path: Path) -> None:
    for i in range(3):
        run = tmp_path / "all" / f"run{i}"
        run.mkdir(parents=True)
        write(run / "odom.csv", "t,v_m_s", T, loggers.speed(T))
        write(run / "serial.csv", f"started {i},logger", T.astype(int) * 0 + i, T)
    made = tmp_path / "made.yaml"
    assert main(["import", str(tmp_path / "all"), "--suggest", "--out", str(made), "--quiet"]) == 1
    assert made.read_text().splitlines()[0].startswith("# suggested for odom.csv, serial.csv:")
