"""Made-up logs of the shape of the data sets of the stories, for trying their commands without the data.

``python docs/stories/stand_in.py data`` writes what is not there yet; measured files of the same names stay. The watts
in them were put there by us: about those that each story reports.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd


def wander(rng: np.random.Generator, count: int, size: float, rows: float) -> np.ndarray:
    """Slow noise: each row keeps all but 1/`rows` of the one before."""
    keep = np.exp(-1 / rows)
    values = np.zeros(count)
    for i, draw in enumerate(rng.normal(0, size * np.sqrt(1 - keep**2), count - 1), start=1):
        values[i] = keep * values[i - 1] + draw
    return values


def rover(rng: np.random.Generator) -> pd.DataFrame:
    """Five standing runs of 16 s for each governor, with the camera pipeline (0.9 W) off and on."""
    runs = []
    for config in (f"{g}_intervention_{c}" for g in ("before", "conservative", "powersave") for c in ("idle", "img")):
        for run in range(5):
            power = 6.65 + 0.9 * config.endswith("img") + rng.normal(0, 0.05) + wander(rng, 160, 0.2, 3)
            volts = 16.5 - 0.01 * power
            more = {"t_s": np.arange(160) / 10, "I_A": power / volts, "V": volts, "P_W": power}
            runs.append(pd.DataFrame({"config": config, "run": run, **more}))
    return pd.concat(runs)


def turtlebot(rng: np.random.Generator) -> pd.DataFrame:
    """Four runs of two minutes for each movement and camera policy; EE2 and EE4 save 0.6 W."""
    runs = []
    for movement, drive in {"N": 0.0, "F": 1.2, "A": 1.7}.items():
        for tactic, saved in {"baseline": 0.0, "EE2": 0.6, "EE4": 0.6}.items():
            for run in range(1, 5):
                t = np.arange(0, 120, 0.5)
                power = 8.4 + drive - saved + rng.normal(0, 0.05) + wander(rng, len(t), 0.15, 60)
                power += rng.normal(0, 0.1, len(t))
                more = {"t_s": t, "bus_V": 12.3, "I_A": power / 12.3, "P_W": power}
                names = {"movement": movement, "environment": "empty", "tactic": tactic, "run": run}
                runs.append(pd.DataFrame({**names, **more}))
    return pd.concat(runs)


def warthog(rng: np.random.Generator) -> pd.DataFrame:
    """Four minutes of random speeds and turns in 20 Hz rows: the drivers' values change once a second."""
    t = np.arange(0, 240, 0.05)
    command = rng.uniform([-1.5, -1.0], [2.5, 1.0], (41, 2))[(t // 6).astype(int)]
    kernel = np.exp(-np.arange(60) * 0.05 / 0.5)
    v, w = (np.convolve(column, kernel / kernel.sum())[: len(t)] for column in command.T)
    power = 250 + 90 * np.abs(v) + 3400 * np.abs(w) + wander(rng, len(t), 200, 20)
    second = (t + 1e-9).astype(int)
    mean = np.bincount(second, power) / np.bincount(second)
    seen = np.where(second > 1, mean[np.maximum(second - 1, 0)], 0.0)  # of the second before; at first no topic
    volts = np.where(second > 1, 47.0, 0.0)
    heading = np.cumsum(w) * 0.05
    wheels = {side: np.repeat((v + sign * w * 0.6)[::5], 5) / 0.30 for side, sign in (("left", -1), ("right", 1))}
    frame = {"t_s": t, "calib_state": "calib"} | {f"meas_{side}_vel": speed for side, speed in wheels.items()}
    frame |= {"icp_pos_x": np.cumsum(v * np.cos(heading)) * 0.05, "icp_pos_y": np.cumsum(v * np.sin(heading)) * 0.05}
    frame |= {
        "icp_quat_x": 0.0,
        "icp_quat_y": 0.0,
        "icp_quat_z": np.sin(heading / 2),
        "icp_quat_w": np.cos(heading / 2),
    }
    frame |= {"imu_z": w + rng.normal(0, 0.01, len(t))}
    for side in wheels:
        frame |= {f"{side}_wheel_voltage": volts, f"{side}_wheel_current": seen / 47.0 / 2}
    return pd.DataFrame(frame)


def main(folder: Path) -> None:
    rng = np.random.default_rng(1)
    made = {
        "ase_rover/ase_rover_10hz.csv": rover,
        "turtlebot3_msr2021/tb3_power_2hz.csv": turtlebot,
        **{f"warthog_drive/{ground}.csv": warthog for ground in ("asphalt", *(f"grass_{i}" for i in range(1, 5)))},
    }
    measured = {path.parent for path in folder.glob("*/*.csv")}
    for name, make in made.items():
        path = folder / name
        if path.parent not in measured:
            path.parent.mkdir(parents=True, exist_ok=True)
            make(rng).round(4).to_csv(path, index=False)
            print(f"made up: {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
