"""Messages of several kinds in one text, as ground stations, brokers and data bases keep them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command as main
from missionsim.importer.suggest import suggest_map
from missionsim.logs import read_log
from missionsim.logs.readers import is_echo
from tests.logs import loggers

T = np.arange(0.0, loggers.LENGTH_S, 0.5).round(1)
W, V = loggers.power(T), loggers.speed(T)
WH, WAY = float(W.mean() * loggers.LENGTH_S / 3600.0), float(V.mean() * loggers.LENGTH_S)
EPOCH = 1_732_367_440.0


def lines(*messages: Callable[[float, float, float], object]) -> str:
    texts = (made(t, w, v) for t, w, v in zip(T.tolist(), W.tolist(), V.tolist(), strict=True) for made in messages)
    return "".join(f"{one if isinstance(one, str) else json.dumps(one)}\n" for one in texts)


def mavlink(kind: str, t: float, **data: float | list[int]) -> object:
    return {"meta": {"type": kind, "timestamp": EPOCH + t}, "data": data}


KEPT = {
    "kinds.jsonl": lines(
        lambda t, w, v: {"type": "odom", "t": t, "speed": v},
        lambda t, w, v: {"type": "goal", "t": t + 0.1, "speed": 5.0},
        lambda t, w, v: {"type": "battery", "t": t, "voltage": 25.0, "current": w / 25.0},
        lambda t, w, v: {"type": "hello", "text": "no time"},
    ),
    "mavlink.json": lines(
        lambda t, w, v: mavlink("VFR_HUD", t, groundspeed=v, heading=90),
        lambda t, w, v: mavlink("SYS_STATUS", t, voltage_battery=25000, current_battery=round(4 * w)),
        lambda t, w, v: mavlink("GLOBAL_POSITION_INT", t, vx=round(60 * v), vy=round(80 * v)),
    ),
    "plain.log": lines(
        lambda t, w, v: f"{EPOCH + t:.3f} agv/battery/voltage 25.0",
        lambda t, w, v: f"{EPOCH + t:.3f} agv/battery/current {w / 25:.4f}",
        lambda t, w, v: f"{EPOCH + t:.3f} agv/speed {v:.4f}",
        lambda t, w, v: f'{EPOCH + t:.3f} agv/mode "auto"',
    ),
    "range.json": json.dumps(
        {
            "status": "success",
            "data": {
                "resultType": "matrix",
                "result": [
                    {"metric": {"__name__": name}, "values": [[EPOCH + t, f"{x:.5g}"] for t, x in zip(T, data)]}  # noqa: B905
                    for name, data in (
                        ("battery_voltage_volts", 0 * T + 25),
                        ("battery_current_amperes", W / 25),
                        ("speed_meters_per_second", V),
                    )
                ],
            },
        }
    ),
}


def imported(tmp_path: Path, source: Path, code: int = 0) -> tuple[float, float]:
    """Energy and way of a source by its suggested map."""
    made, out = tmp_path / "made.yaml", tmp_path / "out.parquet"
    assert main(["import", str(source), "--suggest", "--out", str(made), "--quiet"]) == code
    assert main(["import", str(source), "--map", str(made), "--out", str(out), "--quiet"]) == 0
    log = read_log(out)
    return log.energy_wh("robot"), float(log.number("speed_m_s") @ log.dt_s)


@pytest.mark.parametrize("name", KEPT)
def test_messages_of_several_kinds(tmp_path: Path, name: str) -> None:
    """Of one kind each: the speeds of goals were those of the robot, 10 mA of MAVLink 1 mA."""
    (tmp_path / name).write_text(KEPT[name])
    assert imported(tmp_path, tmp_path / name) == pytest.approx((WH, WAY), rel=0.015)


@pytest.mark.parametrize("result", [[3], {"a": 1}, [{"metric": None}], [{"values": [[1, 2, 3]]}]])
def test_what_is_no_range_of_prometheus_is_refused(tmp_path: Path, result: object) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"data": {"resultType": "matrix", "result": result}}))
    assert main(["import", str(tmp_path / "a.json"), "--suggest", "--out", str(tmp_path / "m.yaml"), "--quiet"]) == 2


def test_columns_are_as_long_as_the_times(tmp_path: Path) -> None:
    columns = {"fields": list("abc" * len(T)), "time": T.tolist(), "power_w": W.tolist(), "speed_m_s": V.tolist()}
    (tmp_path / "a.json").write_text(json.dumps(columns))
    assert imported(tmp_path, tmp_path / "a.json") == pytest.approx((WH, WAY), rel=0.01)


def test_states_of_one_kind_of_message_stay_together(tmp_path: Path) -> None:
    (tmp_path / "a.jsonl").write_text(
        lines(lambda t, w, v: {"type": "drive" if v > 0.5 else "slow", "t": t, "power": w, "speed": v})
    )
    assert imported(tmp_path, tmp_path / "a.jsonl") == pytest.approx((WH, WAY), rel=0.01)


def test_a_folder_of_what_ros_prints_of_two_topics_is_one_run(tmp_path: Path) -> None:
    stamp = [f"header:\n  stamp:\n    sec: {EPOCH + t // 1:.0f}\n    nanosec: {t % 1 * 1e9:.0f}\n" for t in T]
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "battery.yaml").write_text(
        "".join(f"{at}voltage: 25.0\ncurrent: {-w / 25:.4f}\n---\n" for at, w in zip(stamp, W, strict=True))
    )
    (folder / "odom.yaml").write_text(
        "".join(f"{at}twist:\n  linear:\n    x: {v:.4f}\n---\n" for at, v in zip(stamp, V, strict=True))
    )
    (folder / "map.yaml").write_text("kind: map\n")
    assert not is_echo(folder / "gone.yaml")
    assert imported(tmp_path, folder) == pytest.approx((WH, WAY), rel=0.015)


@pytest.mark.parametrize(("size", "asked"), [(3600.0, True), (1000.0, True), (1.0, False), (0.001, True)])
def test_a_counter_that_does_not_say_what_it_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size: float, asked: bool
) -> None:
    """Joules and milliwatt-hours were taken as watt-hours where these would be too much for any robot, or
    kilowatt-hours where they would be too little."""
    rows = zip(T, V, size * np.cumsum(5 * W) * 0.5 / 3600.0, strict=True)
    (tmp_path / "a.csv").write_text("t,speed,energy\n" + "".join(f"{t},{v:.4f},{e:.6f}\n" for t, v, e in rows))
    assert main(["import", str(tmp_path / "a.csv"), "--suggest", "--out", str(tmp_path / "m.yaml")]) == asked
    assert ("write what it counts in" in capsys.readouterr().err) == asked


@pytest.mark.parametrize(("name", "size"), [("cm_s", 100.0), ("Weg in m", 0.0), ("Strecke (m)", 0.0), ("odo_mm", -1e3)])
def test_a_speed_and_ways_by_other_names(tmp_path: Path, name: str, size: float) -> None:
    data = V * size if size > 0 else np.cumsum(V) * 0.5 * (abs(size) or 1.0)
    rows = "".join(f"{t};{w:.4f};{x:.4f}\n" for t, w, x in zip(T, W, data, strict=True))
    (tmp_path / "a.csv").write_text(f"t;power_w;{name}\n{rows}")
    assert imported(tmp_path, tmp_path / "a.csv")[1] == pytest.approx(WAY, rel=0.02)


def test_tables_that_influx_writes_one_under_the_other(tmp_path: Path) -> None:
    head = (
        "#datatype,string,long,dateTime:RFC3339,double,string\n#default,_result,,,,\n,result,table,_time,_value,_field"
    )
    at = [np.datetime64(int(1e3 * (EPOCH + t)), "ms") for t in T]
    blocks = [
        f"{head}\n" + "".join(f",,{i},{t}Z,{x:.4f},{name}\n" for t, x in zip(at, data, strict=True))
        for i, (name, data) in enumerate((("voltage", 0 * T + 25), ("current", W / 25), ("speed", V)))
    ]
    (tmp_path / "a.csv").write_text("\n".join(blocks))
    assert imported(tmp_path, tmp_path / "a.csv") == pytest.approx((WH, WAY), rel=0.015)


def test_a_way_whose_number_wraps(tmp_path: Path) -> None:
    """Each wrap of the counter had been 65 m in a second."""
    way = np.round(1000 * np.cumsum(V) * 0.5 + 60_000) % 65_536
    rows = "".join(f"{t},{w:.4f},{x:.0f}\n" for t, w, x in zip(T, W, way, strict=True))
    (tmp_path / "a.csv").write_text(f"t,power_w,odo_mm\n{rows}")
    assert imported(tmp_path, tmp_path / "a.csv")[1] == pytest.approx(WAY, rel=0.05)


def test_positions_that_lie_far_apart_are_told(tmp_path: Path) -> None:
    (tmp_path / "run_pose.csv").write_text(
        "t,x,y\n" + "".join(f"{t},{3 * np.cos(t / 9):.4f},{3 * np.sin(t / 9):.4f}\n" for t in T)
    )
    rows = zip(T[::20], W[::20], strict=True)
    (tmp_path / "run_battery.csv").write_text(
        "t,voltage,current\n" + "".join(f"{t},25,{w / 25:.4f}\n" for t, w in rows)
    )
    made = suggest_map([tmp_path / "run_pose.csv", tmp_path / "run_battery.csv"])
    assert any("positions 10 s apart" in told for told in made.remarks)
