"""Small files as loggers of one robot write them, made from one truth that the tests compare with."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

START = datetime(2025, 3, 14, 9, 21, 33, 250_000, tzinfo=UTC)
LENGTH_S = 120.0


def speed(t: np.ndarray | float) -> np.ndarray:
    """Forward speed [m/s] with stops."""
    return np.clip(0.6 * np.sin(np.asarray(t) / 6.0) + 0.35, 0.0, None)


def turn(t: np.ndarray | float) -> np.ndarray:
    """Turn rate [rad/s]."""
    return 0.3 * np.sin(np.asarray(t) / 4.0)


def way(t: np.ndarray | float) -> np.ndarray:
    """Path so far [m]."""
    grid = np.arange(0.0, LENGTH_S + 1.0, 0.01)
    return np.interp(t, grid, np.cumsum(speed(grid)) * 0.01)


def lamp(t: np.ndarray | float) -> np.ndarray:
    """Whether the lamp is on."""
    return (np.asarray(t) > 40.0) & (np.asarray(t) < 80.0)


def power(t: np.ndarray | float) -> np.ndarray:
    """Power of the battery [W]."""
    v = speed(t)
    return 5.0 + 12.0 * v + 4.0 * v**2 + 6.0 * lamp(t) + 0.5 * np.abs(turn(t))


def write_three(folder: Path, prefix: str = "") -> list[Path]:
    """power.csv (10 Hz, day-first dates, mA, Latin-1), odometry.csv (25 Hz, ISO), events.csv (at changes)."""
    folder.mkdir(exist_ok=True)
    files = [folder / f"{prefix}{name}.csv" for name in ("power", "odometry", "events")]
    rng = np.random.default_rng(5)
    rows = ["Zeitstempel;Spannung [V];Strom [mA];Gehäuse [°C]"]
    for t in np.arange(0.0, LENGTH_S, 0.1):
        volts = 25.0 - 0.02 * power(t)
        stamp = START + timedelta(seconds=float(t))
        cells = [stamp.strftime("%d.%m.%Y %H:%M:%S,%f")[:-3], f"{volts:.3f}", f"{1000 * power(t) / volts:.1f}", "31,5"]
        rows.append(";".join(cell.replace(".", ",") if i else cell for i, cell in enumerate(cells)))
    files[0].write_bytes("\n".join(rows).encode("latin-1"))
    rows = ["stamp,v_x [m/s],yaw_rate [deg/s]"]
    for t in np.arange(0.0, LENGTH_S, 0.04) + rng.uniform(0, 0.004, 3000):
        stamp = (START + timedelta(seconds=float(t))).strftime("%Y-%m-%dT%H:%M:%S.%f") + "Z"
        rows.append(f"{stamp},{speed(t):.5f},{np.degrees(turn(t)):.4f}")
    files[1].write_text("\n".join(rows) + "\n")
    rows = ["time,lamp_state"]
    for t, word in ((0.0, "off"), (40.0, "on"), (80.0, "off"), (LENGTH_S - 0.01, "off")):
        rows.append(f"{(START + timedelta(seconds=t)).timestamp() * 1000:.0f},{word}")
    files[2].write_text("\n".join(rows) + "\n")
    return files


def write_states(path: Path, version: str = "3.0.0", vehicles: int = 1) -> Path:
    """VDA 5050 state messages, one JSON a line; 2.x has no current."""
    lines = []
    for index, t in enumerate(np.arange(0.0, LENGTH_S, 0.5)):
        for vehicle in range(vehicles):
            message = {
                "headerId": index,
                "timestamp": (START + timedelta(seconds=float(t)))
                .isoformat(timespec="milliseconds")
                .replace("+00:00", "Z"),
                "version": version,
                "manufacturer": "acme",
                "serialNumber": f"agv{vehicle}",
                "orderId": "",
                "driving": bool(speed(t) > 0),
                "velocity": {"vx": float(speed(t)), "vy": 0.0, "omega": float(turn(t))},
                "loads": [{"loadId": "a", "weight": 12.5}] if t > 60 else [],
                "errors": [],
            }
            if version.startswith("3"):
                volts = 25.0 - 0.02 * float(power(t))
                message["powerSupply"] = {
                    "stateOfCharge": 80.0,
                    "batteryVoltage": volts,
                    "batteryCurrent": float(power(t)) / volts,
                    "charging": False,
                }
                message["mobileRobotPosition"] = {
                    "x": float(way(t)),
                    "y": 1.0,
                    "theta": 0.0,
                    "mapId": "m",
                    "localized": True,
                }
            else:
                message["batteryState"] = {"batteryCharge": 80.0, "batteryVoltage": 25.0, "charging": False}
                message["agvPosition"] = {
                    "x": float(way(t)),
                    "y": 1.0,
                    "theta": 0.0,
                    "mapId": "m",
                    "positionInitialized": True,
                }
            lines.append(json.dumps(message))
    path.write_text("\n".join(lines) + "\n")
    return path
