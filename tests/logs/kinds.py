"""One run as loggers of many kinds write it: names, units, stamps and separators differ, the truth does not."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from tests.logs.loggers import LENGTH_S, START, power, speed, turn, way

Writer = Callable[[Path], list[Path]]
KINDS: dict[str, Writer] = {}
STEP_S = 0.2
T = np.arange(0.0, LENGTH_S, STEP_S)
V, P = speed(T), power(T)
VOLTS = 25.0 - 0.02 * P
AMPS = P / VOLTS


def kind(writer: Writer) -> Writer:
    KINDS[writer.__name__] = writer
    return writer


def _rows(*columns: Iterable[object], sep: str = ",", comma: bool = False) -> str:
    lines = []
    for row in zip(*columns, strict=True):
        cells = [cell if isinstance(cell, str) else f"{cell:.10g}" for cell in row]
        lines.append(sep.join(cell.replace(".", ",") if comma and not isinstance(raw, str) else cell
                              for cell, raw in zip(cells, row, strict=True)))  # fmt: skip
    return "\n".join(lines) + "\n"


def _write(folder: Path, name: str, text: str, encoding: str = "utf-8") -> list[Path]:
    (folder / name).write_bytes(text.encode(encoding))
    return [folder / name]


def _stamps(form: str, t: Sequence[float] | np.ndarray = T, hours: float = 0.0) -> list[str]:
    found = []
    for second in t:
        at = START + timedelta(seconds=float(second), hours=hours)
        found.append(at.strftime(form.replace("%L", f"{at.microsecond // 1000:03d}")))
    return found


def _epoch(unit: float) -> list[str]:
    return [f"{(START.timestamp() + t) * unit:.0f}" for t in T]


def _table(kind: str, name: str, head: str, *columns: Iterable[object], encoding: str = "utf-8", **layout: Any) -> None:
    """A kind that is one file: what stands before its rows, and their columns."""
    KINDS[kind] = lambda folder: _write(folder, name, head + "\n" + _rows(*columns, **layout), encoding)


COMMAS: dict[str, Any] = {"sep": ";", "comma": True}
HOURS, ZERO = _stamps("%H:%M:%S.%L"), 0.0 * T
W, RPM, USED_J = turn(T), V / 0.1 * 30 / np.pi, np.cumsum(P) * STEP_S
# fmt: off
_table("german_time_of_day", "fahrt.csv",
       "Uhrzeit;Geschwindigkeit [km/h];Leistung [W];Drehrate [°/s];Außentemperatur [°C]",
       _stamps("%H:%M:%S,%L"), 3.6 * V, P, np.degrees(W), ZERO + 8.5, encoding="cp1252", **COMMAS)
_table("german_words_and_milli", "messung.csv",
       "Zeitstempel;Batteriespannung (mV);Batteriestrom (mA);Fahrgeschwindigkeit (m/s)",
       _stamps("%d.%m.%Y %H:%M:%S,%L"), 1000 * VOLTS, 1000 * AMPS, V, **COMMAS)
_table("french", "essai.csv", "Horodatage;Tension batterie (V);Courant batterie (A);Vitesse (m/s)",
       _stamps("%d/%m/%Y %H:%M:%S.%L"), VOLTS, AMPS, V, **COMMAS)
_table("spanish", "prueba.csv", "Fecha;Hora;Voltaje [V];Corriente [A];Velocidad [km/h]",
       _stamps("%d/%m/%Y"), HOURS, VOLTS, AMPS, 3.6 * V, **COMMAS)
_table("ina_meter", "ina.csv", "timestamp_ms,bus_voltage_V,shunt_voltage_mV,current_mA,power_mW,velocity_mps",
       1000 * T, VOLTS, AMPS * 10, 1000 * AMPS, 1000 * P, V)
_table("ina_without_units", "ina2.csv", "ms,voltage,current,power,speed", 1000 * T, VOLTS, 1000 * AMPS, 1000 * P, V)
_table("volts_and_milliamperes_without_units", "ina3.csv", "time_ms,voltage,current,speed",
       1000 * T, VOLTS, 1000 * AMPS, V)
_table("units_in_a_second_line", "daq.csv", "time,voltage,current,speed\ns,mV,mA,km/h",
       T, 1000 * VOLTS, 1000 * AMPS, 3.6 * V)
_table("title_names_units", "acme.csv", "ACME data logger, serial 4711\nTime;U_bat;I_bat;Speed\n[ms];[V];[mA];[km/h]",
       1000 * T, VOLTS, 1000 * AMPS, 3.6 * V, sep=";")
_table("preamble", "x200.csv", "Device:,X200\nStart:,2025-03-14\nRate:,5 Hz\n\n"
       "Elapsed (s),Battery Power (W),Vehicle Speed (mph)", T, P, V / 0.44704)
_table("tabs_and_quotes", "export.txt", '"Time (ms)"\t"Battery Power (kW)"\t"Vehicle Speed (mph)"',
       1000 * T, P / 1000, V / 0.44704, sep="\t", encoding="utf-16")
_table("iso_with_zone_and_negative_current", "robot.csv", "datetime,batt_v,batt_i,odom_vx,odom_wz",
       [f"{stamp}+02:00" for stamp in _stamps("%Y-%m-%dT%H:%M:%S.%L", hours=2.0)], VOLTS, -AMPS, V, W)
_table("letters_only", "uiv.csv", "t,U,I,v", T, VOLTS, AMPS, V)
_table("epoch_milliseconds", "cloud.csv", "ts,battery_voltage,battery_current,linear_velocity,angular_velocity",
       _epoch(1e3), VOLTS, AMPS, V, W)
_table("px4_csv", "log_battery.csv", "timestamp,voltage_v,current_a,remaining,ground_speed_m_s",
       [f"{1e6 * t + 33e6:.0f}" for t in T], VOLTS, AMPS, 0.9 - T / 1e4, V)
_table("twelve_hour_clock", "us.csv", "Timestamp,Pack Voltage (V),Pack Current (A),Speed (ft/s)",
       _stamps("%m/%d/%Y %I:%M:%S.%L %p"), VOLTS, AMPS, V / 0.3048)
_table("month_names", "trackLog.csv",
       "Device Time, Longitude, Latitude,HV Battery Voltage(V),HV Battery Current(A),Speed (OBD)(km/h)",
       _stamps("%d-%b-%Y %H:%M:%S.%L"), ZERO + 8.4, ZERO + 49.0, VOLTS, AMPS, 3.6 * V)
_table("space_separated_with_hash", "sim.txt", "# time[s] v[m/s] omega[rad/s] P_bat[W]", T, V, W, P, sep=" ")
_table("energy_counter", "meter.csv", "elapsed_s,energy_used_kJ,speed_kmh", T, USED_J / 1000, 3.6 * V)
_table("kilometres_and_centimetres", "c.csv", "t_us,Pbat_mW,v_cm_s,yaw_rate_dps",
       1e6 * T, 1000 * P, 100 * V, np.degrees(W))
_table("long_format_units_in_names", "words.csv",
       "Time since start in s,Battery voltage in V,Battery current in A,Robot speed in m/s", T, VOLTS, AMPS, V)
_table("excel_separator_line", "xl.csv", "sep=;\nDatum;Zeit;P [W];v [m/s]",
       _stamps("%d.%m.%Y"), _stamps("%H:%M:%S,%L"), P, V, **COMMAS)
# as pandas writes an index: a first column without a name
_table("row_number_first", "frame.csv", ",timestamp,power,linear_x",
       np.arange(len(T)), _stamps("%Y-%m-%d %H:%M:%S.%f"), P, V)
_table("motors_beside_the_battery", "full.csv", "time_s,motor_left_current_A,motor_right_current_A,"
       "battery_current_A,battery_voltage_V,cpu_temp_C,speed_m_s",
       T, 0.3 * AMPS, 0.4 * AMPS, AMPS, VOLTS, 45 + ZERO, V)
_table("preamble_padded_by_a_spreadsheet", "padded.csv",
       "Device,X200,\nStart,14.03.2025,\n,,\nTime (min),Battery Power (W),Speed (kn)", T / 60, P, V / 0.514444)
_table("units_after_a_stroke", "labor.csv", "t/s;U/V;I/mA;v/(km/h)", T, VOLTS, 1000 * AMPS, 3.6 * V, **COMMAS)
_table("units_after_a_comma", "comma.csv",
       '"Time, s","Battery Voltage, V","Battery Current, A","Wheel Speed, m/s"', T, VOLTS, AMPS, V)
_table("camel_case", "app.csv", "timestampMs,batteryVoltage,batteryCurrent,linearVelocity,angularVelocity",
       _epoch(1e3), VOLTS, AMPS, V, W)
_table("short_names", "short.csv", "t,Vbatt,Ibatt,vx,wz", T, VOLTS, AMPS, V, W)
_table("colon_before_milliseconds", "colon.csv", "time,watt,speed",
       [stamp[::-1].replace(".", ":", 1)[::-1] for stamp in HOURS], P, V)
_table("spreadsheet_days", "days.csv", "Time,Power (W),Speed (m/s)", [f"{45730.39 + t / 86400:.9f}" for t in T], P, V)
# below what would be too much for a current of any battery, but not of this one
_table("few_milliamperes", "small.csv", "time,voltage,current,speed", T, VOLTS * 2, 500 * AMPS, V)
# a speed without a unit, in km/h by the positions
_table("speed_by_positions", "xy.csv", "time,power_W,speed,pos_x,pos_y", T, P, 3.6 * V, way(T) * 0.8, way(T) * 0.6)
_table("odometer_alone", "odo.csv", "time_s,battery_power_W,distance_m", T, P, way(T))
_table("positions_alone", "pose.csv", "time_s,battery_power_W,pose_x,pose_y", T, P, way(T) * 0.8, way(T) * 0.6)
_table("total_and_parts", "parts.csv", "time,power_motors_W,power_cpu_W,power_total_W,cmd_vel,odom_vel",
       T, 0.6 * P, 0.2 * P, P, 0 * V + 0.5, V)
_table("italian", "prova.csv", "Tempo (s);Tensione batteria (V);Corrente batteria (A);Velocità (m/s)",
       T, VOLTS, AMPS, V, encoding="latin-1", **COMMAS)
_table("wheels_in_rpm_with_positions", "rpm.csv",
       "time_s,battery_power_W,left_wheel_rpm,right_wheel_rpm,x_m,y_m", T, P, RPM, RPM, way(T), ZERO)
_table("wheels_in_m_s", "wheels.csv", "time_s,battery_power_W,left_wheel_velocity [m/s],right_wheel_velocity [m/s]",
       T, P, V - 0.2 * W, V + 0.2 * W)
_table("feet", "feet.csv", "time_s,power_hp,speed_ft_s,altitude_ft", T, P / 745.69987158227, V / 0.3048, ZERO + 1640)
# fmt: on


@kind
def rostopic_echo(folder: Path) -> list[Path]:
    seq = np.arange(len(T))
    battery = (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.voltage,field.current,field.charge\n"
    )
    odom = ("%time,field.header.seq,field.header.stamp,field.child_frame_id,field.pose.pose.position.x,"
            "field.twist.twist.linear.x,field.twist.twist.angular.z\n")  # fmt: skip
    words = ["base"] * len(T)
    nanos = _epoch(1e9)
    return [
        *_write(folder, "battery.csv", battery + _rows(nanos, seq, nanos, words, VOLTS, -AMPS, 5 - T / 1e3)),
        *_write(folder, "odom.csv", odom + _rows(nanos, seq, nanos, words, way(T), V, turn(T))),
    ]


@kind
def plotjuggler(folder: Path) -> list[Path]:
    """One line a message: the cells of all other topics are empty."""
    head = (
        "__time,/battery_state/current,/battery_state/voltage,/odom/twist/twist/angular/z,/odom/twist/twist/linear/x\n"
    )
    lines = []
    for t, v, w, i, u in zip(T, V, turn(T), AMPS, VOLTS, strict=True):
        lines.append(f"{START.timestamp() + t:.6f},{-i:.6f},{u:.6f},,")
        lines.append(f"{START.timestamp() + t + 0.004:.6f},,,{w:.6f},{v:.6f}")
    return _write(folder, "juggler.csv", head + "\n".join(lines) + "\n")


@kind
def vesc(folder: Path) -> list[Path]:
    duty = 0.1 + 0.5 * V
    used = np.cumsum(P) * STEP_S / 3600.0
    zero = 0.0 * T
    columns = {
        "ms_today": 33_693_250 + 1000 * T, "input_voltage": VOLTS, "temp_mos_max": 31 + zero, "temp_motor": 28 + T / 60,
        "current_motor": AMPS / duty, "current_in": AMPS, "d_axis_current": zero, "q_axis_current": AMPS / duty,
        "erpm": 5000 * V, "duty_cycle": duty, "amp_hours_used": used / 24, "watt_hours_used": used,
        "tachometer": 1000 * way(T), "fault_code": zero, "vesc_id": zero + 37, "speed_meters_per_sec": V,
    }  # fmt: skip
    head, body = ";".join(columns) + "\n", _rows(*columns.values(), sep=";")
    return _write(folder, "vesc.csv", head + body)


@kind
def json_lines(folder: Path) -> list[Path]:
    lines = [
        json.dumps({"ts": int((START.timestamp() + t) * 1e3), "battery": {"voltage": u, "current": -i, "soc": 0.8},
                    "odometry": {"linear": v, "angular": w}})
        for t, u, i, v, w in zip(T, VOLTS, AMPS, V, turn(T), strict=True)
    ]  # fmt: skip
    return _write(folder, "telemetry.jsonl", "\n".join(lines) + "\n")
