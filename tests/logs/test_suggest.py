"""`import --suggest`: from a file that nobody described to a log, checked against the truth or a written map."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.errors import InputError
from missionsim.importer.mapping import import_source
from missionsim.importer.roles import words_of
from missionsim.importer.suggest import suggest_map
from missionsim.inputs.loading import load_map
from missionsim.logs import LogTable, read_log, read_logs
from missionsim.logs.formats.delimited import read_csv
from missionsim.logs.readers import Options
from tests.logs import loggers
from tests.logs.bag_writers import amps, battery_volts, speed, write_bag, write_diagnostics_bag, write_ulog
from tests.logs.conftest import motion


def suggested(tmp_path: Path, *sources: Path, exit_code: int = 0, change: tuple[str, str] = ("", "")) -> list[LogTable]:
    """Logs of a source by nothing but its suggested map (`change`: what the user corrects)."""
    given = [str(source) for source in sources]
    made = tmp_path / "suggested.yaml"
    assert main(["import", *given, "--suggest", "--out", str(made), "--quiet"]) == exit_code
    made.write_text(made.read_text().replace(*change) if change[0] else made.read_text())
    out = tmp_path / "logs"
    assert main(["import", *given, "--map", str(made), "--out", str(out), "--quiet"]) == 0
    return read_logs(out)


def near(log: LogTable, column: str, truth: np.ndarray, within: float) -> None:
    assert float(np.sqrt(np.mean((log.number(column) - truth) ** 2))) < within


def test_three_loggers_of_one_run(tmp_path: Path) -> None:
    loggers.write_three(tmp_path / "run")
    (log,) = suggested(tmp_path, tmp_path / "run")
    t = log.time_s + 0.1  # rows begin when every file has begun
    assert np.abs(log.power_w["robot"] - loggers.power(t)).mean() < 0.02
    near(log, "speed_m_s", loggers.speed(t), 0.02)
    near(log, "yaw_rate_rad_s", loggers.turn(t), 0.02)
    assert (log.number("on_lamp") == loggers.lamp(t)).mean() > 0.99


def test_several_runs_of_three_loggers(tmp_path: Path) -> None:
    for run in ("a", "b"):
        loggers.write_three(tmp_path / "all", f"{run}_")
    made = tmp_path / "m.yaml"
    files = [str(tmp_path / "all" / f"a_{name}.csv") for name in ("power", "odometry", "events")]
    assert main(["import", *files, "--suggest", "--out", str(made), "--quiet"]) == 0
    assert "{run}_power.csv" in made.read_text()
    assert main(["import", str(tmp_path / "all"), "--map", str(made), "--out", str(tmp_path / "logs"), "--quiet"]) == 0
    assert sorted(path.name for path in (tmp_path / "logs").iterdir()) == ["a.parquet", "b.parquet"]


def test_a_speed_by_its_unit_alone_and_a_floor_in_which_the_word_run_is_hidden(tmp_path: Path) -> None:
    columns = motion(600, 0.1)
    head = ["Zeit [s]", "Tempo (km/h)", "Leistung [W]", "CPU-Last [%]", "Untergrund"]
    rows = zip(columns["time_s"], 3.6 * columns["speed_m_s"], columns["power_robot_w"], strict=True)
    cells = [[*map(str, row), str(20 + i % 60), ("gras", "beton")[i // 200 % 2]] for i, row in enumerate(rows)]
    path = tmp_path / "fahrt.csv"
    path.write_text("\n".join(";".join(row).replace(".", ",") for row in [head, *cells]) + "\n", encoding="utf-8-sig")
    (log,) = suggested(tmp_path, path)
    near(log, "speed_m_s", columns["speed_m_s"], 1e-6)
    assert log.number("cpu_load").max() == pytest.approx(0.79)
    assert log.columns["surface"].names == ("gras", "beton")


@pytest.mark.parametrize("kind", ["ros1", pytest.param("sqlite3", marks=pytest.mark.long), "mcap"])
def test_bags(tmp_path: Path, kind: str) -> None:
    bag = write_bag(tmp_path / ("run.bag" if kind == "ros1" else "run"), kind, 40.0)
    (log,) = suggested(tmp_path, bag)
    np.testing.assert_allclose(log.power_w["robot"], battery_volts(log.time_s) * amps(log.time_s), rtol=1e-5)
    near(log, "speed_m_s", speed(log.time_s), 0.01)
    near(log, "slope_rad", np.full(log.rows, 0.05), 1e-6)


def test_a_second_battery_is_told(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", "mcap", batteries=("/drive/battery", "/logic/battery"))
    assert main(["import", str(bag), "--suggest", "--out", str(tmp_path / "m.yaml")]) == 0
    (told,) = [line for line in (tmp_path / "m.yaml").read_text().splitlines() if "a battery too" in line]
    assert "perhaps: /logic/battery;" in told


def test_a_battery_that_speaks_in_diagnostics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_diagnostics_bag(tmp_path / "run")
    (log,) = suggested(tmp_path, bag, exit_code=1, change=("RADIUS", "0.1"))
    np.testing.assert_allclose(log.power_w["robot"], battery_volts(log.time_s) * amps(log.time_s), rtol=1e-3)
    near(log, "speed_m_s", speed(log.time_s), 0.05)
    assert ((log.number("on_lidar") == 1) == ((log.time_s >= 10) & (log.time_s < 20))).all()
    assert main(["import", str(bag)]) == 0
    out = capsys.readouterr().out
    assert "/diagnostics[Power System].Charge" in out
    assert "/joint_states.effort[wheel_left]" in out
    assert "/joy.buttons[1]" in out
    (tmp_path / "lamp.yaml").write_text(
        "kind: map\nsignals: {volts: '/diagnostics[Power System].Battery voltage', lamp: '/joy.buttons[1]',\n"
        "  amps: '/diagnostics[Power System].Battery current', effort: '/joint_states.effort[wheel_left]'}\n"
        "timeline: lamp\ncolumns: {time_s: time_s, power_robot_w: volts * amps, on_lamp: lamp, effort: effort}\n"
    )
    (log,) = import_source(bag, load_map(tmp_path / "lamp.yaml"))
    assert ((log.number("on_lamp") == 1) == ((log.time_s > 4.95) & (log.time_s < 11.95))).all()
    near(log, "effort", 1 + speed(log.time_s), 0.05)


def test_ulog(tmp_path: Path) -> None:
    (log,) = suggested(tmp_path, write_ulog(tmp_path / "a.ulg"))
    np.testing.assert_allclose(log.power_w["robot"], battery_volts(log.time_s) * amps(log.time_s), rtol=1e-5)
    near(log, "speed_m_s", speed(log.time_s), 0.01)


def test_vda5050_states(tmp_path: Path) -> None:
    (log,) = suggested(tmp_path, loggers.write_states(tmp_path / "agv.jsonl"))
    np.testing.assert_allclose(log.power_w["robot"], loggers.power(log.time_s), rtol=1e-6)
    near(log, "speed_m_s", loggers.speed(log.time_s), 1e-6)
    assert set(log.number("payload_kg")) == {0.0, 12.5}
    assert not [remark for remark in log.remarks if remark.severity == "error"]


def test_a_gauge_is_no_meter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = loggers.write_states(tmp_path / "agv.jsonl", "2.1.0")
    assert main(["import", str(path), "--suggest", "--out", str(tmp_path / "m.yaml")]) == 1
    assert "'state.batteryState.batteryCharge' is a gauge: there are no watts in it" in capsys.readouterr().err
    assert main(["import", str(path), "--map", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "a.parquet")]) == 2
    assert not (tmp_path / "a.parquet").exists()


def test_listing_shows_names_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = loggers.write_three(tmp_path / "run")
    assert main(["import", *map(str, files)]) == 0
    out = capsys.readouterr().out
    for name in ("Strom [mA]", "Spannung [V]", "v_x [m/s]", "yaw_rate [deg/s]"):
        assert name in out
    assert "constant: Gehäuse [°C] = 31.5" in out
    assert out.index("Strom [mA]") < out.index("constant")


# the data of other people: what a suggestion gives, against the maps that were written by hand


def test_warthog(tmp_path: Path, shared: Path, root: Path) -> None:
    from missionsim.importer.mapping import import_source
    from missionsim.inputs.loading import load_map

    path = shared / "data" / "warthog_drive" / "grass_2024_7_29_14h8s51.csv"
    (log,) = suggested(tmp_path, path)
    (hand,) = import_source(path, load_map(root / "docs" / "maps" / "warthog.yaml"))
    assert log.energy_wh("robot") == pytest.approx(hand.energy_wh("robot"), rel=0.03)
    driven, by_hand = (float(np.abs(one.number("speed_m_s")) @ one.dt_s) for one in (log, hand))
    assert driven == pytest.approx(by_hand, rel=0.05)


@pytest.mark.parametrize("season", ["summer", "winter"])
def test_car(tmp_path: Path, shared: Path, season: str) -> None:
    path = shared / "data" / "i3_trips" / "raw" / f"{season}.csv"
    (log,) = suggested(tmp_path, path)
    rows = [line.split(";") for line in path.read_bytes().decode("latin-1").splitlines()]
    at = {name: index for index, name in reversed(list(enumerate(rows[0])))}
    cells = np.array([[float(row[at[n]]) for n in ("Battery Voltage [V]", "Battery Current [A]")] for row in rows[1:]])
    assert log.energy_wh("robot") == pytest.approx(-cells.prod(axis=1).sum() * 0.1 / 3600, rel=0.01)
    kmh = np.array([float(row[at["Velocity [km/h]"]]) for row in rows[1:]])
    assert log.number("speed_m_s").max() == pytest.approx(kmh.max() / 3.6)
    assert {"slope_rad", "temp_ambient_c"} <= log.columns.keys()


def test_wheel(tmp_path: Path, shared: Path) -> None:
    (log,) = suggested(tmp_path, shared / "data" / "wheel_ride" / "2020_05_16_08_02_06.csv")
    assert log.number("speed_m_s").max() < 15  # km/h by the distance that grows with it
    assert np.median(np.diff(log.time_s)) == pytest.approx(0.2, abs=0.1)


def first_two(source: Path, folder: Path, column: int) -> tuple[Path, int]:
    """A copy with the first two runs of each setting (`column` numbers them), and how many they are."""
    lines = source.read_text(encoding="utf-8").splitlines()
    numbers = sorted({line.split(",")[column] for line in lines[1:]}, key=int)[:2]
    kept = [line for line in lines[1:] if line.split(",")[column] in numbers]
    (folder / source.name).write_text("\n".join([lines[0], *kept]) + "\n", encoding="utf-8")
    return folder / source.name, len({tuple(line.split(",")[: column + 1]) for line in kept})


def test_turtlebot(tmp_path: Path, shared: Path) -> None:
    folder = shared / "data" / "turtlebot3_msr2021"
    source, count = first_two(folder / "tb3_power_2hz.csv", tmp_path, 3)
    assert len(suggested(tmp_path, source)) == count >= 30
    raw = folder / "raw_examples" / "A_movement_empty_1_baseline_run1_DATA.TXT"
    (log,) = suggested(tmp_path / "raw", raw, exit_code=1, change=("RATE", "200"))
    assert 3600 * log.energy_wh("robot") == pytest.approx(1458.63, rel=0.01)


def test_rover_and_floors(tmp_path: Path, shared: Path) -> None:
    source, count = first_two(shared / "data" / "ase_rover" / "ase_rover_10hz.csv", tmp_path, 1)
    assert len(suggested(tmp_path, source)) == count == 20
    path = shared / "data" / "husky_floors" / "train" / "ice_00.csv"
    (log,) = suggested(tmp_path / "husky", path)
    assert log.energy_wh("robot") == pytest.approx(read_log(path).energy_wh("robot"), rel=1e-9)
    assert log.columns["surface"].names == ("ice",)  # type: ignore[union-attr]


def test_the_battery_is_called_as_the_robot_calls_it(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("t,volts,amps\n" + "".join(f"{i},24,{2 + i % 3}\n" for i in range(60)))
    (tmp_path / "rover.yaml").write_text(
        "kind: robot\nname: rover\nbody: {mass: 20 kg, drive: skid_steer, max_speed: 1 m/s}\n"
        "batteries: {main: {capacity: 10 Ah, nominal_voltage: 24 V}}\n"
        "motion: {battery: main, model: polynomial, parameters: {c2: 12, c3: 30, c4: 15, standing: 9}}\n"
    )
    made, log = tmp_path / "map.yaml", tmp_path / "log.parquet"
    suggest = ["import", str(tmp_path / "run.csv"), "--suggest", "--robot", str(tmp_path / "rover.yaml")]
    assert main([*suggest, "--out", str(made), "--quiet"]) == 0
    assert main(["import", str(tmp_path / "run.csv"), "--map", str(made), "--out", str(log), "--quiet"]) == 0
    assert read_log(log).batteries == ("main",)
    assert main([*suggest[:2], "--map", str(made), "--robot", "pioneer3dx", "--out", str(log)]) == 2


def two_recordings(offset: float = 0.0) -> tuple[list[list[str]], list[list[str]]]:
    """Time, power, speed and turn rate of two robots."""
    made = []
    for phase in (0.0, 2.0):
        v = [0.4 + 0.3 * math.sin(0.02 * i + phase) for i in range(300)]
        made.append(
            [[f"{0.1 * i + offset * phase:.2f}", f"{7 + 8 * v[i] + 10 * phase:.3f}", f"{v[i]:.4f}"] for i in range(300)]
        )
    return made[0], made[1]


@pytest.mark.parametrize("name", ["id", ""])
def test_rows_of_two_robots_in_turn(tmp_path: Path, name: str) -> None:
    """The stamps of one lie between those of the other: both were read as one robot, with the mean of their power."""
    rows = []
    for one, other in zip(*two_recordings(0.015), strict=True):
        rows += [[*one, "7"][: 3 + bool(name)], [*other, "9"][: 3 + bool(name)]]
    header = ["time_s", "power_w", "speed_m_s", *([name] if name else [])]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    made = suggest_map([tmp_path / "log.csv"])
    (tmp_path / "map.yaml").write_text(made.text)
    if name:
        logs = import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))
        assert [round(float(log.power_w["robot"].mean()) / 10) for log in logs] == [1, 3]
        return
    assert list(made.missing) == ["rows of several recordings in turn, and no column tells them apart: part the file"]
    with pytest.raises(InputError, match="power_robot_w and speed_m_s jump back and forth"):
        import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))


@pytest.mark.parametrize("name", ["mac", ""])
def test_rows_of_two_robots_in_bursts(tmp_path: Path, name: str) -> None:
    """Ten rows of one, ten of the other, at other places: energy and motion of both had been those of one."""
    rows = [[*one[:3], str(9.0 * (i // 10 % 2) + 0.003 * i), *(["ab"[i // 10 % 2]] if name else [])]
            for i, one in enumerate(two_recordings()[0])]  # fmt: skip
    header = ["time_s", "power_w", "speed_m_s", "x_m", *([name] if name else [])]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    made = suggest_map([tmp_path / "log.csv"])
    (tmp_path / "map.yaml").write_text(made.text)
    assert len(made.missing) == (not name)
    if name:
        assert len(import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))) == 2
    else:
        with pytest.raises(InputError, match="rows of several recordings in turn: x_m jump back and forth"):
            import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))


@pytest.mark.parametrize("how", ["stations", "lost"])
def test_places_that_one_robot_may_have(tmp_path: Path, how: str) -> None:
    """Rows 30 s apart while it goes between two stations; a localisation that is lost at times."""
    far = [20.0 * (i // 6 % 2) if how == "stations" else 0.0 if i % 60 > 50 else 30.0 + 0.01 * i for i in range(300)]
    step = 30 if how == "stations" else 0.1
    rows = [f"{step * i:.1f},{7 + i % 5},{x:g}\n" for i, x in enumerate(far)]
    (tmp_path / "log.csv").write_text("time_s,power_w,x_m\n" + "".join(rows))
    made = suggest_map([tmp_path / "log.csv"])
    (tmp_path / "map.yaml").write_text(made.text)
    assert not made.missing
    assert len(import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))) == 1


def test_a_load_that_is_switched_is_no_second_robot(tmp_path: Path) -> None:
    rows = [[*one[:1], f"{12 - 0.5 * (i % 2) + 1e-3 * (i % 7)}", f"{1 + i % 2 + 1e-3 * (i % 5)}", one[2]]
            for i, one in enumerate(two_recordings()[0])]  # fmt: skip
    header = ["time_s", "voltage_v", "current_a", "speed_m_s"]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    (log,) = suggested(tmp_path, tmp_path / "log.csv")
    assert log.rows == 300


@pytest.mark.parametrize(("name", "unit_s"), [("time_h", 3600.0), ("time [min]", 60.0), ("Elapsed", 86400.0)])
def test_times_below_one(tmp_path: Path, name: str, unit_s: float) -> None:
    """A unit says more than that parts of a day lie below one as well."""
    rows = [",".join([f"{float(one[0]) / unit_s:.10f}", *one[1:]]) for one in two_recordings()[0]]
    (tmp_path / "log.csv").write_text("\n".join([f"{name},power_w,speed_m_s", *rows]) + "\n")
    (log,) = suggested(tmp_path, tmp_path / "log.csv")
    assert log.duration_s == pytest.approx(30.0, abs=0.2)


@pytest.mark.parametrize("units", [["s", "W", "m/s"], []])
@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1)])
def test_a_header_that_stands_again(tmp_path: Path, order: tuple[int, ...], units: list[str]) -> None:
    """Two recordings one behind the other in a file: the second's power was read as its speed."""
    first, second = two_recordings()
    head = [["time_s", "power_w", "speed_m_s"], *([units] if units else [])]
    rows = [*head, *first, *([row[k] for k in order] for row in [*head, *second])]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    if order != (0, 1, 2):
        with pytest.raises(InputError, match="a second header, with its columns in another order") as caught:
            suggest_map([tmp_path / "log.csv"])
        assert caught.value.faults[0].line == 302 + bool(units)
        return
    for form in ("{}", "2025-03-14T09:{:02d}:{:06.3f}Z"):  # the second restarts, or begins half an hour later
        lines = [row if not row[0][0].isdigit() else [form.format(row[0]) if form == "{}" else
                 form.format(30 * (index > 300) + int(float(row[0])) // 60, float(row[0]) % 60), *row[1:]]
                 for index, row in enumerate(rows)]  # fmt: skip
        (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in lines) + "\n")
        (tmp_path / "map.yaml").write_text(suggest_map([tmp_path / "log.csv"]).text)
        logs = import_source(tmp_path / "log.csv", load_map(tmp_path / "map.yaml"))
        assert [log.rows for log in logs] == [300, 300]


@pytest.mark.parametrize(
    ("second", "told"),
    [
        ("t,watts,v", "a second header, with other names"),
        ("time_s,power_w", "a second header, with 2 columns in place of 3"),
    ],
)
def test_a_second_header_of_another_recording(tmp_path: Path, second: str, told: str) -> None:
    first, other = two_recordings()
    rows = [
        ["time_s", "power_w", "speed_m_s"],
        *first,
        second.split(","),
        *(row[: second.count(",") + 1] for row in other),
    ]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    with pytest.raises(InputError, match=told) as caught:
        suggest_map([tmp_path / "log.csv"])
    assert [fault.line for fault in caught.value.faults] == [302]


def test_a_header_that_stands_again_is_told_once(tmp_path: Path) -> None:
    first, second = two_recordings()
    head = ["time_s", "power_w", "speed_m_s"]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in [head, *first, head, *second]) + "\n")
    remarks = [one for one in read_csv(tmp_path / "log.csv", Options()).remarks if one.severity == "warning"]
    assert [(one.line, one.count) for one in remarks] == [(302, 1)]


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("ms:{},bus_V:11.8,current_mA:608", "each cell is a label with its value"),
        ("{},1,2,3", "40 of 40 rows have 4 values, where the header names 1 column"),
    ],
)
def test_lines_that_are_no_rows_are_told_once(tmp_path: Path, row: str, told: str) -> None:
    (tmp_path / "log.csv").write_text("logger v1\n" + "".join(row.format(i) + "\n" for i in range(40)))
    with pytest.raises(InputError, match=told) as caught:
        read_csv(tmp_path / "log.csv", Options())
    assert len(caught.value.faults) == 1


def test_units_of_a_load_and_of_the_air(tmp_path: Path) -> None:
    rows = "".join(f"{i},24,{0.1 * (i % 7)},11.02311311,{50 + i % 5},2\n" for i in range(60))
    (tmp_path / "run.csv").write_text("t,power_w,speed,payload_lb,ambient_temp_f,wheel_speed_lb\n" + rows)
    (log,) = suggested(tmp_path, tmp_path / "run.csv")
    near(log, "payload_kg", np.full(60, 5.0), 1e-6)
    near(log, "temp_ambient_c", (18.0 + np.arange(60) % 5) / 1.8, 1e-6)
    # the front one and the rear one
    assert words_of("motor_temp_f") == ("motor temp f", "")


def test_a_turn_rate_by_two_wheels_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{i},24,{0.1 * (i % 7)},{0.1 * (i % 5)}\n" for i in range(60))
    (tmp_path / "run.csv").write_text("t,power_w,left wheel [m/s],right wheel [m/s]\n" + rows)
    assert main(["import", str(tmp_path / "run.csv"), "--suggest", "--out", str(tmp_path / "m.yaml")]) == 0
    assert "`yaw_rate_rad_s` is (right - left) / track" in capsys.readouterr().out


def test_columns_that_are_called_as_components_of_the_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.csv").write_text(
        "t,power_w,Kinect,Lampe\n" + "".join(f"{i},24,{i % 2},{i % 3 // 2}\n" for i in range(60))
    )
    suggest = ["import", str(tmp_path / "run.csv"), "--suggest", "--out", str(tmp_path / "m.yaml"), "--robot"]
    assert main([*suggest, "pioneer3dx"]) == 0
    assert "on_kinect: Kinect" in (tmp_path / "m.yaml").read_text()
    assert "is it one of Lampe?" in capsys.readouterr().out.replace("\n", " ")


def test_a_speed_in_the_file_of_the_motors_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, head in (("motors", "time,speed"), ("battery", "time,voltage,current")):
        rows = "".join(f"{i},{0.1 * (i % 7)}{f',{2 + i % 3}' * head.count('voltage')}\n" for i in range(60))
        (tmp_path / f"run_1_{name}.csv").write_text(f"{head}\n{rows}")
    main(["import", str(tmp_path), "--suggest", "--out", str(tmp_path / "m.yaml")])
    assert "perhaps it is one of motors.speed" in capsys.readouterr().out
