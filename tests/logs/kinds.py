"""One run as loggers of many kinds write it: names, units, stamps and separators differ, the truth does not."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from datetime import timedelta
from pathlib import Path

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


@kind
def german_time_of_day(folder: Path) -> list[Path]:
    head = "Uhrzeit;Geschwindigkeit [km/h];Leistung [W];Drehrate [°/s];Außentemperatur [°C]\n"
    body = _rows(_stamps("%H:%M:%S,%L"), 3.6 * V, P, np.degrees(turn(T)), 0 * T + 8.5, sep=";", comma=True)
    return _write(folder, "fahrt.csv", head + body, "cp1252")


@kind
def german_words_and_milli(folder: Path) -> list[Path]:
    head = "Zeitstempel;Batteriespannung (mV);Batteriestrom (mA);Fahrgeschwindigkeit (m/s)\n"
    body = _rows(_stamps("%d.%m.%Y %H:%M:%S,%L"), 1000 * VOLTS, 1000 * AMPS, V, sep=";", comma=True)
    return _write(folder, "messung.csv", head + body)


@kind
def french(folder: Path) -> list[Path]:
    head = "Horodatage;Tension batterie (V);Courant batterie (A);Vitesse (m/s)\n"
    return _write(
        folder, "essai.csv", head + _rows(_stamps("%d/%m/%Y %H:%M:%S.%L"), VOLTS, AMPS, V, sep=";", comma=True)
    )


@kind
def spanish(folder: Path) -> list[Path]:
    head = "Fecha;Hora;Voltaje [V];Corriente [A];Velocidad [km/h]\n"
    body = _rows(_stamps("%d/%m/%Y"), _stamps("%H:%M:%S.%L"), VOLTS, AMPS, 3.6 * V, sep=";", comma=True)
    return _write(folder, "prueba.csv", head + body)


@kind
def ina_meter(folder: Path) -> list[Path]:
    head = "timestamp_ms,bus_voltage_V,shunt_voltage_mV,current_mA,power_mW,velocity_mps\n"
    return _write(folder, "ina.csv", head + _rows(1000 * T, VOLTS, AMPS * 10, 1000 * AMPS, 1000 * P, V))


@kind
def ina_without_units(folder: Path) -> list[Path]:
    return _write(
        folder, "ina2.csv", "ms,voltage,current,power,speed\n" + _rows(1000 * T, VOLTS, 1000 * AMPS, 1000 * P, V)
    )


@kind
def volts_and_milliamperes_without_units(folder: Path) -> list[Path]:
    return _write(folder, "ina3.csv", "time_ms,voltage,current,speed\n" + _rows(1000 * T, VOLTS, 1000 * AMPS, V))


@kind
def units_in_a_second_line(folder: Path) -> list[Path]:
    return _write(
        folder, "daq.csv", "time,voltage,current,speed\ns,mV,mA,km/h\n" + _rows(T, 1000 * VOLTS, 1000 * AMPS, 3.6 * V)
    )


@kind
def title_names_units(folder: Path) -> list[Path]:
    head = "ACME data logger, serial 4711\nTime;U_bat;I_bat;Speed\n[ms];[V];[mA];[km/h]\n"
    return _write(folder, "acme.csv", head + _rows(1000 * T, VOLTS, 1000 * AMPS, 3.6 * V, sep=";"))


@kind
def preamble(folder: Path) -> list[Path]:
    head = "Device:,X200\nStart:,2025-03-14\nRate:,5 Hz\n\nElapsed (s),Battery Power (W),Vehicle Speed (mph)\n"
    return _write(folder, "x200.csv", head + _rows(T, P, V / 0.44704))


@kind
def tabs_and_quotes(folder: Path) -> list[Path]:
    head = '"Time (ms)"\t"Battery Power (kW)"\t"Vehicle Speed (mph)"\n'
    return _write(folder, "export.txt", head + _rows(1000 * T, P / 1000, V / 0.44704, sep="\t"), "utf-16")


@kind
def iso_with_zone_and_negative_current(folder: Path) -> list[Path]:
    head = "datetime,batt_v,batt_i,odom_vx,odom_wz\n"
    stamps = [f"{stamp}+02:00" for stamp in _stamps("%Y-%m-%dT%H:%M:%S.%L", hours=2.0)]
    return _write(folder, "robot.csv", head + _rows(stamps, VOLTS, -AMPS, V, turn(T)))


@kind
def letters_only(folder: Path) -> list[Path]:
    return _write(folder, "uiv.csv", "t,U,I,v\n" + _rows(T, VOLTS, AMPS, V))


@kind
def epoch_milliseconds(folder: Path) -> list[Path]:
    return _write(folder, "cloud.csv", "ts,battery_voltage,battery_current,linear_velocity,angular_velocity\n"
                  + _rows(_epoch(1e3), VOLTS, AMPS, V, turn(T)))  # fmt: skip


@kind
def px4_csv(folder: Path) -> list[Path]:
    head = "timestamp,voltage_v,current_a,remaining,ground_speed_m_s\n"
    return _write(
        folder, "log_battery.csv", head + _rows([f"{1e6 * t + 33e6:.0f}" for t in T], VOLTS, AMPS, 0.9 - T / 1e4, V)
    )


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
def twelve_hour_clock(folder: Path) -> list[Path]:
    head = "Timestamp,Pack Voltage (V),Pack Current (A),Speed (ft/s)\n"
    return _write(folder, "us.csv", head + _rows(_stamps("%m/%d/%Y %I:%M:%S.%L %p"), VOLTS, AMPS, V / 0.3048))


@kind
def month_names(folder: Path) -> list[Path]:
    head = "Device Time, Longitude, Latitude,HV Battery Voltage(V),HV Battery Current(A),Speed (OBD)(km/h)\n"
    body = _rows(_stamps("%d-%b-%Y %H:%M:%S.%L"), 0 * T + 8.4, 0 * T + 49.0, VOLTS, AMPS, 3.6 * V)
    return _write(folder, "trackLog.csv", head + body)


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
def space_separated_with_hash(folder: Path) -> list[Path]:
    return _write(folder, "sim.txt", "# time[s] v[m/s] omega[rad/s] P_bat[W]\n" + _rows(T, V, turn(T), P, sep=" "))


@kind
def energy_counter(folder: Path) -> list[Path]:
    used = np.cumsum(P) * STEP_S
    return _write(folder, "meter.csv", "elapsed_s,energy_used_kJ,speed_kmh\n" + _rows(T, used / 1000, 3.6 * V))


@kind
def json_lines(folder: Path) -> list[Path]:
    lines = [
        json.dumps({"ts": int((START.timestamp() + t) * 1e3), "battery": {"voltage": u, "current": -i, "soc": 0.8},
                    "odometry": {"linear": v, "angular": w}})
        for t, u, i, v, w in zip(T, VOLTS, AMPS, V, turn(T), strict=True)
    ]  # fmt: skip
    return _write(folder, "telemetry.jsonl", "\n".join(lines) + "\n")


@kind
def kilometres_and_centimetres(folder: Path) -> list[Path]:
    return _write(
        folder, "c.csv", "t_us,Pbat_mW,v_cm_s,yaw_rate_dps\n" + _rows(1e6 * T, 1000 * P, 100 * V, np.degrees(turn(T)))
    )


@kind
def long_format_units_in_names(folder: Path) -> list[Path]:
    head = "Time since start in s,Battery voltage in V,Battery current in A,Robot speed in m/s\n"
    return _write(folder, "words.csv", head + _rows(T, VOLTS, AMPS, V))


@kind
def excel_separator_line(folder: Path) -> list[Path]:
    head = "sep=;\nDatum;Zeit;P [W];v [m/s]\n"
    return _write(
        folder, "xl.csv", head + _rows(_stamps("%d.%m.%Y"), _stamps("%H:%M:%S,%L"), P, V, sep=";", comma=True)
    )


@kind
def row_number_first(folder: Path) -> list[Path]:
    """As pandas writes an index: a first column without a name."""
    return _write(folder, "frame.csv", ",timestamp,power,linear_x\n"
                  + _rows(np.arange(len(T)), _stamps("%Y-%m-%d %H:%M:%S.%f"), P, V))  # fmt: skip


@kind
def motors_beside_the_battery(folder: Path) -> list[Path]:
    head = (
        "time_s,motor_left_current_A,motor_right_current_A,battery_current_A,battery_voltage_V,cpu_temp_C,speed_m_s\n"
    )
    return _write(folder, "full.csv", head + _rows(T, 0.3 * AMPS, 0.4 * AMPS, AMPS, VOLTS, 45 + 0 * T, V))


@kind
def preamble_padded_by_a_spreadsheet(folder: Path) -> list[Path]:
    head = "Device,X200,\nStart,14.03.2025,\n,,\nTime (min),Battery Power (W),Speed (kn)\n"
    return _write(folder, "padded.csv", head + _rows(T / 60, P, V / 0.514444))


@kind
def units_after_a_stroke(folder: Path) -> list[Path]:
    return _write(
        folder, "labor.csv", "t/s;U/V;I/mA;v/(km/h)\n" + _rows(T, VOLTS, 1000 * AMPS, 3.6 * V, sep=";", comma=True)
    )


@kind
def units_after_a_comma(folder: Path) -> list[Path]:
    head = '"Time, s","Battery Voltage, V","Battery Current, A","Wheel Speed, m/s"\n'
    return _write(folder, "comma.csv", head + _rows(T, VOLTS, AMPS, V))


@kind
def camel_case(folder: Path) -> list[Path]:
    head = "timestampMs,batteryVoltage,batteryCurrent,linearVelocity,angularVelocity\n"
    return _write(folder, "app.csv", head + _rows(_epoch(1e3), VOLTS, AMPS, V, turn(T)))


@kind
def short_names(folder: Path) -> list[Path]:
    return _write(folder, "short.csv", "t,Vbatt,Ibatt,vx,wz\n" + _rows(T, VOLTS, AMPS, V, turn(T)))


@kind
def colon_before_milliseconds(folder: Path) -> list[Path]:
    stamps = [stamp[::-1].replace(".", ":", 1)[::-1] for stamp in _stamps("%H:%M:%S.%L")]
    return _write(folder, "colon.csv", "time,watt,speed\n" + _rows(stamps, P, V))


@kind
def spreadsheet_days(folder: Path) -> list[Path]:
    return _write(
        folder, "days.csv", "Time,Power (W),Speed (m/s)\n" + _rows([f"{45730.39 + t / 86400:.9f}" for t in T], P, V)
    )


@kind
def few_milliamperes(folder: Path) -> list[Path]:
    """Below what would be too much for a current of any battery, but not of this one."""
    return _write(folder, "small.csv", "time,voltage,current,speed\n" + _rows(T, VOLTS * 2, 500 * AMPS, V))


@kind
def speed_by_positions(folder: Path) -> list[Path]:
    """A speed without a unit, in km/h by the positions."""
    return _write(
        folder, "xy.csv", "time,power_W,speed,pos_x,pos_y\n" + _rows(T, P, 3.6 * V, way(T) * 0.8, way(T) * 0.6)
    )


@kind
def odometer_alone(folder: Path) -> list[Path]:
    return _write(folder, "odo.csv", "time_s,battery_power_W,distance_m\n" + _rows(T, P, way(T)))


@kind
def positions_alone(folder: Path) -> list[Path]:
    return _write(
        folder, "pose.csv", "time_s,battery_power_W,pose_x,pose_y\n" + _rows(T, P, way(T) * 0.8, way(T) * 0.6)
    )


@kind
def total_and_parts(folder: Path) -> list[Path]:
    head = "time,power_motors_W,power_cpu_W,power_total_W,cmd_vel,odom_vel\n"
    return _write(folder, "parts.csv", head + _rows(T, 0.6 * P, 0.2 * P, P, 0 * V + 0.5, V))


@kind
def italian(folder: Path) -> list[Path]:
    head = "Tempo (s);Tensione batteria (V);Corrente batteria (A);Velocità (m/s)\n"
    return _write(folder, "prova.csv", head + _rows(T, VOLTS, AMPS, V, sep=";", comma=True), "latin-1")


@kind
def wheels_in_rpm_with_positions(folder: Path) -> list[Path]:
    rpm = V / 0.1 * 30 / np.pi
    head = "time_s,battery_power_W,left_wheel_rpm,right_wheel_rpm,x_m,y_m\n"
    return _write(folder, "rpm.csv", head + _rows(T, P, rpm, rpm, way(T), 0 * T))
